"""Checks of arguments: each error names the argument, the place, the rule and the value
found.
"""

from __future__ import annotations

import contextlib
import math
import operator
import os
import reprlib
import sys
import unicodedata
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import (
    Array,
    BoolArray,
    Seed,
)

T = TypeVar("T")

LARGEST_INTEGER = 2**63 - 1
SUM_TOLERANCE = 1e-8
SUM_RULE = f"sum to 1 (tolerance {SUM_TOLERANCE:g}); it sums to {{:.10g}}"
_PACKAGE = os.path.dirname(os.path.abspath(__file__)) + os.sep
SINGLE_TOLERANCE = 1e-5  # of sums of single-precision numbers, which are then scaled


class _Shown(reprlib.Repr):
    """Reprs of bounded length and depth; of an array or a matrix of more than a few
    entries only type and shape.
    """

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxstring = 200
        self.maxother = 200
        self.maxlong = 60

    def repr_instance(self, x: Any, level: int) -> str:
        if hasattr(x, "shape") and (
            is_sparse(x)
            or (isinstance(x, np.ndarray) and (x.size > 12 or x.dtype.hasobject))
        ):
            return f"<{type(x).__name__} of shape {x.shape}, dtype {x.dtype}>"
        return " ".join(super().repr_instance(x, level).split())

    repr_ndarray = repr_instance


_SHOWN = _Shown()


def show(value: object) -> str:
    """``repr(value)`` for an error: at most 300 characters, quick and safe whatever the
    value is, nothing invisible.
    """
    try:
        text = _SHOWN.repr(value)
    except Exception:  # whatever the repr of an object of somebody else's raises
        text = f"<{type(value).__name__}>"
    return escape_controls(text if len(text) <= 300 else f"{text[:200]}...{text[-97:]}")


def escape_controls(text: str, keep: str = "") -> str:
    """``text`` with control characters, which a terminal obeys, as Python writes them;
    those in ``keep`` stay.
    """
    if text.isprintable():
        return text
    return "".join(
        (
            c
            if c.isprintable() or c in keep or unicodedata.category(c) == "Zs"
            else repr(c)[1:-1]
        )
        for c in text
    )


def is_sparse(value: object) -> bool:
    """Whether it is one of scipy's sparse matrices; no method of it is called, since a
    malformed one may end the process.
    """
    sparse = sys.modules.get("scipy.sparse")
    return sparse is not None and bool(sparse.issparse(value))


def place(name: str, index: tuple[int, ...]) -> str:
    """``policy[3, 1]`` for ("policy", (3, 1))."""
    return f"{name}[{', '.join(str(int(i)) for i in index)}]"


def float_array(
    value: object, name: str, *, ndim: int | tuple[int, ...] | None = None
) -> Array:
    """``value`` as a new float64 array of finite numbers, or a ValueError that says
    where it is not one.
    """
    given: Any = as_array(value, name, "an array of numbers")
    kind = given.dtype.kind
    is_text = kind in "USMm" or (
        kind == "O" and any(isinstance(x, str | bytes) for x in given.flat)
    )
    try:
        if is_text or kind not in "biufO":
            raise TypeError(
                "text or dates"
                if is_text
                else "complex numbers"
                if kind == "c"
                else f"of {given.dtype}"
            )
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
    """``numpy.array(value)``, with an error that names the argument where rows have
    different lengths.
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
    """Every entry is a finite number."""
    _require(np.isfinite(array), array, name, "be finite; it is {}")


def require_nonnegative(array: Array, name: str) -> None:
    """Every entry is a finite number, none below 0."""
    # two passes that make no array
    if array.size and not (array.min() >= 0 and array.max() < np.inf):
        require_finite(array, name)
        _require(array >= 0, array, name, "be nonnegative; it is {}")


def require_sums_to_one(sums: Array, name: str) -> None:
    """Every entry of ``sums`` (the sums of the rows of ``name``) is 1 up to the
    tolerance.
    """
    _require(np.abs(sums - 1.0) <= SUM_TOLERANCE, sums, name, SUM_RULE, "rows")


def _require(
    fine: BoolArray, array: Array, name: str, rule: str, counted: str = ""
) -> None:
    """A ValueError that names the first entry of ``array`` that is not ``fine``, and
    how many such there are.
    """
    if fine.all():
        return
    bad = np.argwhere(~fine)
    first = tuple(bad[0])  # of a single number the index is empty
    more = f" ({len(bad)} such {counted} in all)" if counted and len(bad) > 1 else ""
    raise ArgumentError(
        place(name, first) if first else name, f"must {rule.format(array[first])}{more}"
    )


def scale_if_single(array: Array, given: object) -> Array:
    """The rows of an array that was given in single precision, scaled to sum to 1 where
    they nearly do.
    """
    if getattr(given, "dtype", None) != np.float32:
        return array
    sums = array.sum(axis=-1, keepdims=True)
    near = np.abs(sums - 1.0) <= SINGLE_TOLERANCE
    return np.asarray(np.where(near, array / np.where(near, sums, 1.0), array))


def distribution(value: object, name: str, shape: tuple[int, ...]) -> Array:
    """``value`` as an array of ``shape``, nonnegative, with a total of 1."""
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
    """``value`` as a float in [low, high], or in (low, high); infinity only where it is
    allowed.
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
        left, right = (
            "()" if open_ends else ("[", "]" if infinite or np.isfinite(high) else ")")
        )
        raise ArgumentError(
            name, f"must be in {left}{low:g}, {high:g}{right}; it is {number:g}"
        )
    return number


def positive_integer(value: Any, name: str) -> int:
    """``value`` as an int of at least 1 that 64 bits hold."""
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
    """Whether it is a whole number, Python's or numpy's, and no flag."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def boolean(value: object, name: str) -> bool:
    """True or False, Python's or numpy's; nothing else stands for them."""
    if not isinstance(value, bool | np.bool_):
        raise ArgumentError(name, f"must be True or False; got {show(value)}")
    return bool(value)


def instance(
    value: object, kind: type[T] | tuple[type[T], ...], name: str, called: str = ""
) -> T:
    """``value``, which is an object of the class ``kind``, or of one of them;
    ``called``: how the error says it.
    """
    if not isinstance(value, kind):
        rule = called or " or ".join(
            k.__name__ for k in (kind if isinstance(kind, tuple) else (kind,))
        )
        article = "" if rule.endswith("s") else "an " if rule[0] in "AEIOU" else "a "
        raise ArgumentError(
            name, f"must be {article}{rule}; got {type(value).__name__}"
        )
    return value


def function(value: object, name: str) -> None:
    """``value`` can be called."""
    if not callable(value):
        raise ArgumentError(name, f"must be a function; got {type(value).__name__}")


def warn(text: str, category: type[Warning]) -> None:
    """Warn at the line that called the package, however deep in it that is noticed."""
    frame = sys._getframe(1)
    level = 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame = frame.f_back
        level = level + 1
    warnings.warn(text, category, stacklevel=level)


def collection(value: Any, name: str, rule: str) -> tuple[Any, ...]:
    """``value`` as a tuple of what it holds; a text is no collection. ``rule`` says of
    what it must be one.
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
    """``count`` numbers of ``size`` bytes fit into memory: asked before, since a system
    may grant what it does not have.

    A ValueError where the ``value`` of an argument asks for them, else (a file that is
    read) a MemoryError.
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
    """Bytes that a process can still take; infinite where the system does not say."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        return 1024.0 * int(
            Path("/proc/meminfo").read_text().partition("MemAvailable:")[2].split()[0]
        )
    return math.inf


def optional_horizon(horizon: object) -> int | None:
    """None (the infinite sum) or a number of rewards of at least 1."""
    return None if horizon is None else positive_integer(horizon, "horizon")


def one_of(value: object, name: str, allowed: tuple[str, ...], hint: str = "") -> None:
    """``value`` is one of the allowed words; ``hint``: what else there is to do."""
    if not isinstance(value, str) or value not in allowed:
        words = ", ".join(repr(word) for word in allowed)
        raise ArgumentError(name, f"must be one of {words}; got {show(value)}{hint}")


def generator(seed: Seed) -> np.random.Generator:
    """``numpy.random.default_rng(seed)``, with an error that names the argument."""
    return _call_numpy(np.random.default_rng, seed)


def seed_sequence(seed: Any, key: tuple[int, ...]) -> np.random.SeedSequence:
    """The stream ``key`` of ``seed``, with an error that names the argument."""
    return _call_numpy(np.random.SeedSequence, seed, spawn_key=key)


def _call_numpy(make: Callable[..., T], seed: Any, **options: Any) -> T:
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
    """The same array, no longer writable."""
    array.flags.writeable = False
    return array
