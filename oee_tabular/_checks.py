"""Checks of arguments, whose errors name the argument, the place, rule and value."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import operator
import os
import reprlib
import sys
import unicodedata
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np
from numpy.typing import NDArray

from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, Seed

T = TypeVar("T")

LARGEST_INTEGER = 2**63 - 1
SUM_TOLERANCE = 1e-8  # of a sum of probabilities, from 1
SUM_RULE = f"sum to 1 (tolerance {SUM_TOLERANCE:g}); it sums to {{:.10g}}"
SINGLE_TOLERANCE = 1e-5  # of a sum in single precision, which is then scaled to 1
MAX_SHOWN_CHARACTERS = 300  # of a value in an error
MAX_SHOWN_ENTRIES = 12  # of an array; a larger one is shown by its shape
_PACKAGE = os.path.dirname(os.path.abspath(__file__)) + os.sep


class _Shown(reprlib.Repr):
    """Write values for errors with bounded length and depth.

    An array or a matrix of more than a few entries is shown by its type and shape.
    """

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxstring = 200
        self.maxother = 200
        self.maxlong = 60

    def repr_instance(self, x: Any, level: int) -> str:
        """Write an object on one line."""
        is_large = isinstance(x, np.ndarray) and (
            x.size > MAX_SHOWN_ENTRIES or x.dtype.hasobject
        )
        if hasattr(x, "shape") and (is_sparse(x) or is_large):
            return f"<{type(x).__name__} of shape {x.shape}, dtype {x.dtype}>"
        return " ".join(super().repr_instance(x, level).split())

    repr_ndarray = repr_instance


_SHOWN = _Shown()


def show(value: object) -> str:
    """Write a value for an error, in at most 300 characters and without control ones.

    It is quick and raises nothing, whatever the value is.
    """
    try:
        text = _SHOWN.repr(value)
    except Exception:  # the repr of a user's object may raise anything
        text = f"<{type(value).__name__}>"
    if len(text) > MAX_SHOWN_CHARACTERS:
        text = f"{text[:200]}...{text[-97:]}"
    return escape_controls(text)


def escape_controls(text: str, keep: str = "") -> str:
    """Write control characters, which a terminal obeys, as Python escapes them.

    Those in ``keep`` stay.
    """
    if text.isprintable():
        return text
    letters = []
    for c in text:
        is_safe = c.isprintable() or c in keep or unicodedata.category(c) == "Zs"
        letters.append(c if is_safe else repr(c)[1:-1])
    return "".join(letters)


def is_sparse(value: object) -> TypeGuard[Any]:
    """Return whether a value is one of scipy's sparse matrices or arrays.

    No method of it is called, since a malformed one may end the process.
    """
    # without this module, which is slow to import, there is no such object
    sparse = sys.modules.get("scipy.sparse")
    return sparse is not None and bool(sparse.issparse(value))


def place(name: str, index: tuple[int, ...]) -> str:
    """Name an entry of an argument: ``policy[3, 1]`` for ("policy", (3, 1))."""
    return f"{name}[{', '.join(str(int(i)) for i in index)}]"


def float_array(
    value: object, name: str, *, ndim: int | tuple[int, ...] | None = None
) -> Array:
    """Convert a value to a new float64 array of numbers.

    Parameters
    ----------
    value : object
        What the caller was given.
    name : str
        The argument's name, for errors.
    ndim : int or tuple of int, optional
        The dimensions that are allowed. None allows any.

    Returns
    -------
    ndarray of float64
        A copy. Its entries may be infinite or nan.

    Raises
    ------
    ArgumentError
        If the value holds text, dates or complex numbers, has rows of different
        lengths, or
        another number of dimensions.
    """
    given: Any = as_array(value, name, "an array of numbers")
    kind = given.dtype.kind
    holds_text = kind == "O" and any(isinstance(x, str | bytes) for x in given.flat)
    try:
        if kind in "USMm" or holds_text:
            raise TypeError("text or dates")
        if kind == "c":
            raise TypeError("complex numbers")
        if kind not in "biufO":
            raise TypeError(f"of {given.dtype}")
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ArgumentError(
            name, f"must be an array of numbers; got {type(value).__name__} ({error})"
        ) from None
    allowed = (ndim,) if isinstance(ndim, int) else ndim
    if allowed is not None and array.ndim not in allowed:
        rule = " or ".join(str(n) for n in allowed)
        raise ArgumentError(
            name, f"must have {rule} dimension(s); it has shape {array.shape}"
        )
    return array


def as_array(value: object, name: str, rule: str = "an array") -> NDArray[Any]:
    """Convert a value by ``numpy.array``, with an error that names the argument.

    Rows of different lengths and sparse matrices are errors.
    """
    try:
        if is_sparse(value):
            raise TypeError("a sparse matrix")
        return np.array(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise ArgumentError(
            name, f"must be {rule}; got {type(value).__name__} ({error})"
        ) from None


def require_finite(array: Array, name: str) -> None:
    """Require every entry to be a finite number."""
    _require(np.isfinite(array), array, name, "be finite; it is {}")


def require_nonnegative(array: Array, name: str) -> None:
    """Require every entry to be a finite number of at least 0."""
    # two passes that make no array decide in the usual case
    if array.size and not (array.min() >= 0 and array.max() < np.inf):
        require_finite(array, name)
        _require(array >= 0, array, name, "be nonnegative; it is {}")


def require_sums_to_one(sums: Array, name: str) -> None:
    """Require every sum to be 1 up to the tolerance.

    ``sums`` are the sums of the rows of ``name``.
    """
    _require(np.abs(sums - 1.0) <= SUM_TOLERANCE, sums, name, SUM_RULE, "rows")


def _require(
    fine: BoolArray, array: Array, name: str, rule: str, counted: str = ""
) -> None:
    """Raise an error for the first entry of ``array`` that is not ``fine``.

    It says how many such entries there are where ``counted`` gives them a name.
    """
    if fine.all():
        return
    bad = np.argwhere(~fine)
    first = tuple(bad[0])  # empty for a single number
    more = f" ({len(bad)} such {counted} in all)" if counted and len(bad) > 1 else ""
    raise ArgumentError(
        place(name, first) if first else name, f"must {rule.format(array[first])}{more}"
    )


def scale_if_single(array: Array, given: object) -> Array:
    """Scale single-precision rows to sum to 1 where they nearly do."""
    if getattr(given, "dtype", None) != np.float32:
        return array
    sums = array.sum(axis=-1, keepdims=True)
    near = np.abs(sums - 1.0) <= SINGLE_TOLERANCE
    return np.asarray(np.where(near, array / np.where(near, sums, 1.0), array))


def distribution(value: object, name: str, shape: tuple[int, ...]) -> Array:
    """Convert a value to an array of ``shape``, nonnegative, with a total of 1."""
    array = float_array(value, name)
    if array.shape != shape:
        raise ArgumentError(
            name, f"must have shape {shape}; it has shape {array.shape}"
        )
    require_nonnegative(array, name)
    if array.ndim == 1:
        array = scale_if_single(array, value)
    require_sums_to_one(np.asarray(array.sum()), name)
    return array


def number_in(
    value: Any,
    name: str,
    low: float,
    high: float,
    *,
    open_ends: bool = False,
    infinite: bool = False,
) -> float:
    """Convert a value to a float in [low, high], or in (low, high).

    Infinity is allowed only with ``infinite``.
    """
    try:
        array: Any = None if is_sparse(value) else np.asarray(value)
        if array is None or array.ndim or array.dtype.kind not in "biufO":
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(name, f"must be a number; got {show(value)}") from None
    inside = low < number < high if open_ends else low <= number <= high
    if np.isinf(number) and not infinite:
        raise ArgumentError(name, f"must be finite; it is {number:g}")
    if not inside:
        left = "(" if open_ends else "["
        has_high = infinite or np.isfinite(high)
        right = "]" if has_high and not open_ends else ")"
        raise ArgumentError(
            name, f"must be in {left}{low:g}, {high:g}{right}; it is {number:g}"
        )
    return number


def positive_integer(value: Any, name: str) -> int:
    """Convert a value to an int of at least 1 that fits in 64 bits."""
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise ArgumentError(
            name, f"must be a positive integer; got {show(value)}"
        ) from None
    if number < 1:
        raise ArgumentError(name, f"must be a positive integer; it is {show(number)}")
    if number > LARGEST_INTEGER:
        raise ArgumentError(name, f"must be at most 2**63 - 1; it is {show(number)}")
    return number


def is_integer(value: object) -> bool:
    """Return whether a value is an integer of Python or numpy, and not a boolean."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def boolean(value: object, name: str) -> bool:
    """Convert True or False, of Python or numpy, to a bool; refuse all else."""
    if not isinstance(value, bool | np.bool_):
        raise ArgumentError(name, f"must be True or False; got {show(value)}")
    return bool(value)


def instance(
    value: object, kind: type[T] | tuple[type[T], ...], name: str, called: str = ""
) -> T:
    """Require an object of the class ``kind``, or of one of several, and return it.

    ``called`` is how the error names the class.
    """
    if isinstance(value, kind):
        return value
    kinds = kind if isinstance(kind, tuple) else (kind,)
    rule = called or " or ".join(k.__name__ for k in kinds)
    article = "an " if rule[0] in "AEIOU" else "a "
    if rule.endswith("s"):
        article = ""
    raise ArgumentError(name, f"must be {article}{rule}; got {type(value).__name__}")


def function(value: object, name: str) -> None:
    """Require a value that can be called."""
    if not callable(value):
        raise ArgumentError(name, f"must be a function; got {type(value).__name__}")


def warn(text: str, category: type[Warning]) -> None:
    """Warn at the line that called the package, however deep inside the cause is.

    ``dataclasses.replace`` and generated constructors are passed over, too.
    """
    frame = sys._getframe(1)
    level = 2
    glue = (dataclasses.__file__, "<string>")
    while frame.f_back is not None and (
        frame.f_code.co_filename.startswith(_PACKAGE)
        or frame.f_code.co_filename in glue
    ):
        frame = frame.f_back
        level = level + 1
    warnings.warn(text, category, stacklevel=level)


def collection(value: Any, name: str, rule: str) -> tuple[Any, ...]:
    """Convert a collection to a tuple of its items; a text is no collection.

    ``rule`` says in the error what the items must be.
    """
    try:
        if isinstance(value, str | bytes) or is_sparse(value):
            raise TypeError
        return tuple(value)
    except (TypeError, ValueError):
        raise ArgumentError(
            name, f"must be {rule}; got {type(value).__name__}"
        ) from None


def require_memory(
    count: float, name: str, value: object = None, *, size: int = 8
) -> None:
    """Require ``count`` numbers of ``size`` bytes to fit into memory.

    This is asked before they are allocated, since a system may grant memory that it
    does
    not have. Where the ``value`` of an argument asks for them, the error is an
    ArgumentError; else (for a file that is read) it is a MemoryError.
    """
    needed = count * size
    free = free_memory()
    if needed <= free:
        return
    if value is None:
        raise MemoryError(
            f"{name} needs {needed / 2**30:.3g} GiB of memory; {free / 2**30:.3g} GiB"
            " are free"
        )
    raise ArgumentError(
        name,
        f"must be small enough for this machine's memory; {value} needs"
        f" {needed / 2**30:.3g} GiB",
    )


def free_memory() -> float:
    """Return how many bytes a process can still take.

    It is infinite where the system does not say.
    """
    with contextlib.suppress(OSError, ValueError, IndexError):
        return 1024.0 * int(
            Path("/proc/meminfo").read_text().partition("MemAvailable:")[2].split()[0]
        )
    return math.inf


def optional_horizon(horizon: object) -> int | None:
    """Check a horizon: None (the infinite sum) or an integer of at least 1."""
    return None if horizon is None else positive_integer(horizon, "horizon")


def one_of(value: object, name: str, allowed: tuple[str, ...], hint: str = "") -> None:
    """Require one of the allowed words; ``hint`` ends the error's text."""
    if not isinstance(value, str) or value not in allowed:
        words = ", ".join(repr(word) for word in allowed)
        raise ArgumentError(name, f"must be one of {words}; got {show(value)}{hint}")


def generator(seed: Seed) -> np.random.Generator:
    """Make ``numpy.random.default_rng(seed)``; errors name the argument."""
    return _call_numpy(np.random.default_rng, seed)


def seed_sequence(seed: Any, key: tuple[int, ...]) -> np.random.SeedSequence:
    """Make the stream ``key`` of ``seed``; errors name the argument."""
    return _call_numpy(np.random.SeedSequence, seed, spawn_key=key)


def _call_numpy(make: Callable[..., T], seed: Any, **options: Any) -> T:
    """Call a function of numpy.random; its errors become an ArgumentError of seed."""
    try:
        if is_sparse(seed):
            raise TypeError("a sparse matrix")
        return make(seed, **options)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        reason = escape_controls(str(error))[:200]
        raise ArgumentError(
            "seed",
            f"must be what numpy.random.{make.__name__} takes; got {show(seed)}"
            f" ({reason})",
        ) from None


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only, and return it."""
    array.flags.writeable = False
    return array
