"""Types of arguments, for annotations of your own code.

They exist for type checkers: mypy and pyright refuse with them a text where numbers
belong, or a number where a policy belongs. At run time the functions check values.

>>> import numpy as np
>>> from oee_tabular.typing import Array, PolicyLike
>>> def policy_of(logits: Array) -> PolicyLike:
...     return np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    # numbers, flags, and nested sequences or arrays of them; numpy's own name for it is
    # private, and numpy.typing.ArrayLike admits texts
    from numpy._typing import _ArrayLikeFloat_co as RealArrayLike
    from numpy._typing import _ArrayLikeInt_co as IntArrayLike
    from scipy import sparse

    Csr: TypeAlias = sparse.csr_array[np.float64, tuple[int, int]]
    SparseLike: TypeAlias = sparse.sparray[Any, Any] | sparse.spmatrix[Any]
else:
    from numpy.typing import ArrayLike as IntArrayLike
    from numpy.typing import ArrayLike as RealArrayLike

    Csr: TypeAlias = Any
    SparseLike: TypeAlias = Any

__all__ = [
    "Array",
    "BoolArray",
    "Column",
    "Csr",
    "FrameLike",
    "IntArray",
    "IntArrayLike",
    "PoliciesLike",
    "PolicyLike",
    "RealArrayLike",
    "Seed",
    "SeedNumbers",
    "SparseLike",
    "SupportsArray",
]

Array: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

# a column of a log: numbers, flags or names
Column: TypeAlias = NDArray[Any]

# what numpy.random.default_rng takes; ``evaluate`` takes only int, a sequence or None
Seed: TypeAlias = (
    int
    | np.integer[Any]
    | Sequence[int]
    | NDArray[np.integer[Any]]
    | np.random.SeedSequence
    | np.random.BitGenerator
    | np.random.Generator
    | None
)


# what a report takes: each of its estimators has a stream that is named by its place
SeedNumbers: TypeAlias = (
    int | np.integer[Any] | Sequence[int] | NDArray[np.integer[Any]] | None
)


class SupportsArray(Protocol):
    """Describe an object that turns into a NumPy array, such as a tensor or a frame."""

    def __array__(self, *args: Any, **kwargs: Any) -> NDArray[Any]:
        """Return the values as an array."""


class FrameLike(Protocol):
    """Describe a data frame of any library: named columns, taken by their names."""

    @property
    def columns(self) -> Any:
        """The names of the columns."""

    def __getitem__(self, key: Any, /) -> Any:
        """Return a column."""


# a policy in any of its forms (``mdp.check_policy``): (S, A) probabilities, (S,)
# actions or their names, a mapping by state, a function of a state
PolicyLike: TypeAlias = (
    SupportsArray
    | list[Any]
    | tuple[Any, ...]
    | range
    | Mapping[Any, Any]
    | Callable[[Any], object]
)

# one policy, a list of policies, or a mapping from names to policies
PoliciesLike: TypeAlias = PolicyLike | Mapping[str, PolicyLike]
