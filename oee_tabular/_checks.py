"""Checks of arguments, whose errors name the argument, the place, rule and value."""

from __future__ import annotations

import dataclasses
import math
import operator
import os
import reprlib
import sys
import unicodedata
import warnings
from collections.abc import Callable, ItemsView, KeysView, Mapping, Set
from decimal import Decimal
from typing import Any, TypeVar

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

from oee_tabular import _containers
from oee_tabular._containers import MAX_SEQUENCE, LossError, to_plain_array
from oee_tabular._containers import is_sparse as is_sparse
from oee_tabular._containers import place as place
from oee_tabular._containers import to_native as to_native
from oee_tabular._containers import without_known_labels as without_known_labels
from oee_tabular._memory import free_memory
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, Seed

T = TypeVar("T")

LARGEST_INTEGER = 2**63 - 1
SUM_TOLERANCE = 1e-8  # of a sum of probabilities, from 1
SUM_RULE = f"sum to 1 (tolerance {SUM_TOLERANCE:g}); it sums to {{:.10g}}"
# of a sum in single or half precision, which is then scaled to 1
SCALED_TOLERANCES: dict[type, float] = {np.float32: 1e-5, np.float16: 5e-3}
ROUNDED_HINT = " (of single precision, or rounded? Divide each row by its sum)"
ROUNDED_TOTAL_HINT = " (of single precision, or rounded? Divide by the sum)"
ROUNDED_TOLERANCE = 5e-3  # of a sum that rounding may explain
MAX_SEED_WORDS = 10_000  # 32-bit numbers of a seed, some milliseconds
MAX_SEED_DEPTH = 8  # of sequences in sequences
MAX_NESTED = 64  # lists in lists
MAX_SHOWN_CHARACTERS = 300  # of a value in an error
LEAST_ASKED_BYTES = 2**20  # less memory than this takes less time than asking for it
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


def float_array(
    value: object,
    name: str,
    *,
    ndim: int | tuple[int, ...] | None = None,
    allow_missing: bool = False,
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
    allow_missing : bool, default False
        Whether masked values and other signs for missing ones become nan. Otherwise
        they are errors.

    Returns
    -------
    ndarray of float64
        A copy. Its entries may be infinite or nan.

    Raises
    ------
    ArgumentError
        If the value holds text, dates or complex numbers, has a unit or labels that
        position loses, rows of different lengths, or another number of dimensions.
    """
    if isinstance(value, Mapping) and not is_sparse(value):
        raise ArgumentError(
            name,
            f"must be an array of numbers; got {type(value).__name__}, whose"
            " keys it has no use for (its values, in the order of their numbers:"
            " list(mapping.values()))",
        )
    given: Any = as_array(
        value, name, "an array of numbers", allow_missing=allow_missing
    )
    kind = given.dtype.kind
    holds_text = kind == "O" and any(isinstance(x, str | bytes) for x in given.flat)
    if kind in "US" or holds_text:
        refuse_text(value, name, "be an array of numbers", "float")
    try:
        if kind in "USMm" or holds_text:
            raise TypeError("text or dates")
        if kind == "c":
            raise TypeError("complex numbers")
        if kind not in "biufO":
            raise TypeError(f"of {given.dtype}")
        if kind == "O":
            given = _quiet(given)
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ArgumentError(
            name,
            "must be an array of numbers; got"
            f" {type(value).__name__} ({_reason(error)})",
        ) from None
    allowed = (ndim,) if isinstance(ndim, int) else ndim
    if allowed is not None and array.ndim not in allowed:
        rule = " or ".join(str(n) for n in allowed)
        raise ArgumentError(
            name, f"must have {rule} dimension(s); it has shape {array.shape}"
        )
    return array


def _quiet(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array of objects with nan for the signalling nans of decimals.

    They say what nan says; asked for a float, or to compare, they raise.
    """
    items = array.reshape(-1).tolist()
    signals = [isinstance(item, Decimal) and item.is_snan() for item in items]
    if not any(signals):
        return array
    quiet = array.copy()
    quiet[np.reshape(signals, array.shape)] = np.nan
    return quiet


def in_all(n: int, things: str) -> str:
    """Return how many things there are, where a sentence names the first of several.

    >>> in_all(3, "such rows")
    ' (3 such rows in all)'
    """
    return f" ({n} {things} in all)" if n > 1 else ""


def refuse_text(value: object, name: str, rule: str, kind: str, hint: str = "") -> None:
    """Raise an ArgumentError for the first text in an array or in nested lists.

    ``rule``: what it must do; ``kind``: the type of which the texts may be numbers;
    ``hint``: what errors of other texts add. Nothing is raised where there is no text.
    """
    try:
        items = np.array(value, dtype=object)
    except (ValueError, TypeError):  # rows of different lengths
        return
    texts = [at for at, item in np.ndenumerate(items) if isinstance(item, str | bytes)]
    if not texts:
        return
    more = in_all(len(texts), "texts")
    try:
        np.array([items[at] for at in texts]).astype(kind)
        hint = f" (numbers written as text? .astype({kind}))"
    except (ValueError, TypeError, OverflowError):
        pass
    first = texts[0]
    where = place(name, first) if first else "it"
    raise ArgumentError(
        name, f"must {rule}; {where} is {show(items[first])}{more}{hint}"
    )


def as_array(
    value: object, name: str, rule: str = "an array", *, allow_missing: bool = False
) -> NDArray[Any]:
    """Convert a value by ``numpy.array``, with an error that names the argument.

    Whatever ``numpy.array`` would lose is an error: masked values (but for nan with
    ``allow_missing``), units, labels other than 0, 1, 2, ... So are rows of different
    lengths and sparse matrices.
    """
    try:
        return np.array(_plain(value, name, allow_missing))
    except ArgumentError:
        raise
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise _no_array(value, name, rule, error) from None


def plain_array(value: object, name: str, rule: str = "an array") -> Any:
    """Return a plain array, or lists of plain values, by the rules of ``as_array``."""
    try:
        return _plain(value, name)
    except ArgumentError:
        raise
    except (TypeError, ValueError) as error:
        raise _no_array(value, name, rule, error) from None


def _plain(value: object, name: str, allow_missing: bool = False) -> Any:
    """Return ``to_plain_array`` of a value, at once where it is a plain array."""
    if type(value) is np.ndarray and not value.dtype.hasobject:
        return value
    try:
        return to_plain_array(value, name, allow_missing=allow_missing)
    except LossError as error:
        raise ArgumentError(error.argument, error.rule) from None


def require_no_unit_of(value: object, name: str) -> None:
    """Require a column whose values' type has no unit, as those of pint have."""
    try:
        _containers.require_no_unit_of(value, name)
    except LossError as error:
        raise ArgumentError(error.argument, error.rule) from None


def first_line(error: BaseException) -> str:
    """Return the first line of a library's error, for the end of one of ours."""
    lines = [line for line in str(error).splitlines() if line.strip()]
    return escape_controls((lines or [type(error).__name__])[0].strip())[
        :MAX_SHOWN_CHARACTERS
    ]


def _no_array(value: object, name: str, rule: str, error: Exception) -> ArgumentError:
    """Return the error for a value that is no array, with another library's reason."""
    return ArgumentError(
        name, f"must be {rule}; got {type(value).__name__} ({_reason(error)})"
    )


def _reason(error: Exception) -> str:
    """Return the text of a library's error on one short line."""
    return escape_controls(" ".join(str(error).split()))[:MAX_SHOWN_CHARACTERS]


def require_finite(array: Array, name: str) -> None:
    """Require every entry to be a finite number."""
    _require(np.isfinite(array), array, name, "be finite; it is {}")


def require_no_infinity(array: Array, name: str) -> None:
    """Require every entry to be a finite number, or nan, which stands for none."""
    _require(
        ~np.isinf(array),
        array,
        name,
        "be finite, or nan where it is not known; it is {}",
    )


def require_shape(array: Array, name: str, shape: tuple[int, ...]) -> None:
    """Require an array of a shape."""
    if array.shape != shape:
        raise ArgumentError(
            name, f"must have shape {shape}; it has shape {array.shape}"
        )


def require_nonnegative(array: Array, name: str) -> None:
    """Require every entry to be a finite number of at least 0."""
    # two passes that make no array decide in the usual case
    if array.size and not (array.min() >= 0 and array.max() < np.inf):
        require_finite(array, name)
        _require(array >= 0, array, name, "be nonnegative; it is {}")


def require_sums_to_one(sums: Array, name: str, empty_hint: str = "") -> None:
    """Require every sum to be 1 up to the tolerance.

    ``sums`` are the sums of the rows of ``name``; ``empty_hint`` is what the error adds
    where one is 0.
    """
    fine = np.abs(sums - 1.0) <= SUM_TOLERANCE
    if fine.all():
        return
    first = sums[tuple(np.argwhere(~fine)[0])]
    rule = SUM_RULE
    if abs(first - 1.0) <= ROUNDED_TOLERANCE:
        rule += ROUNDED_HINT if sums.ndim else ROUNDED_TOTAL_HINT
    if first == 0.0:
        rule += empty_hint
    _require(fine, sums, name, rule, "rows")


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
    more = in_all(len(bad), f"such {counted}") if counted else ""
    raise ArgumentError(
        place(name, first) if first else name, f"must {rule.format(array[first])}{more}"
    )


def scale_if_single(array: Array, given: object) -> Array:
    """Scale rows given in single or half precision to sum to 1 where they nearly do.

    ``given`` is what they were made of: an array of any library, a sparse matrix, or
    lists and mappings of numbers, of which none may be of double precision.
    """
    tolerance = _sum_tolerance(given)
    if tolerance == 0.0:
        return array
    sums = array.sum(axis=-1, keepdims=True)
    near = np.abs(sums - 1.0) <= tolerance
    return np.asarray(np.where(near, array / np.where(near, sums, 1.0), array))


def scale_sums(sums: Array, given: object) -> Array:
    """Return what to divide rows with these sums by, as ``scale_if_single`` does."""
    near = np.abs(sums - 1.0) <= _sum_tolerance(given)
    return np.where(near, sums, 1.0)


def _sum_tolerance(given: object) -> float:
    """Return how far from 1 sums may be that are then scaled; 0 in double precision."""
    if type(given) is np.ndarray and given.dtype == np.float64:
        return 0.0
    kinds = _float_kinds(given, 0)
    if not kinds or not kinds <= set(SCALED_TOLERANCES):
        return 0.0
    return max(SCALED_TOLERANCES[kind] for kind in kinds)


def _float_kinds(given: Any, depth: int) -> set[type]:
    """Return the types of the floats in what was given: numpy's, or float."""
    if isinstance(given, float):
        return {type(given)}
    if isinstance(given, str | bytes | int | None):
        return set()
    if isinstance(given, Mapping) and not is_sparse(given):
        given = list(given.values())
    if isinstance(given, list | tuple) and depth < MAX_NESTED:
        kinds: set[type] = set()
        for item in given:
            kinds |= _float_kinds(item, depth + 1)
            if not kinds <= set(SCALED_TOLERANCES):
                break  # one of double precision decides
        return kinds
    dtype = getattr(given, "dtype", None)
    if not isinstance(dtype, np.dtype):  # of torch, Arrow or pandas
        try:
            dtype = np.asarray(given).dtype
        except Exception:  # it is no array
            return {float}
    if dtype.hasobject and isinstance(given, np.ndarray):
        return _float_kinds(given.reshape(-1).tolist(), depth + 1)
    return {dtype.type} if dtype.kind == "f" else set()


def clip_if_single(array: Array, given: object) -> Array:
    """Return probabilities given in single or half precision, at most 1.

    Rounding may put them above by what ``scale_if_single`` forgives a sum.
    """
    if not array.size or array.max() <= 1.0:
        return array
    return np.where(array <= 1.0 + _sum_tolerance(given), np.minimum(array, 1.0), array)


def distribution(
    value: object, name: str, shape: tuple[int, ...], *, given: object = None
) -> Array:
    """Convert a value to an array of ``shape``, nonnegative, with a total of 1.

    ``given``: what the value was made of, where that is something else. In single
    precision it is scaled.
    """
    array = float_array(value, name)
    require_shape(array, name, shape)
    require_nonnegative(array, name)
    total = np.asarray(array.sum())
    if total != 1.0:
        array = array / scale_sums(total, value if given is None else given)
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
        number = float(_single(value, name, "iufO"))
    except ArgumentError:
        raise
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise ArgumentError(name, f"must be a number; got {show(value)}") from None
    inside = low < number < high if open_ends else low <= number <= high
    if np.isinf(number) and not infinite:
        raise ArgumentError(name, f"must be finite; it is {number:g}")
    if not inside:
        left = "(" if open_ends else "["
        has_high = infinite or np.isfinite(high)
        right = "]" if has_high and not open_ends else ")"
        raise ArgumentError(
            name,
            f"must be in {left}{low:g}, {high:g}{right}; it is"
            f" {show_number(number, low, high)}",
        )
    return number


def show_number(number: float, *limits: float) -> str:
    """Write a number in short, or whole where it would not tell it from a limit.

    >>> show_number(1.0000001, 0.0, 1.0), show_number(1 / 3, 1.0)
    ('1.0000001', '0.333333')
    """
    text = f"{number:g}"
    return (
        repr(float(number)) if float(text) in limits and number not in limits else text
    )


def _single(value: Any, name: str, kinds: str) -> Any:
    """Return a single value without what holds it; TypeError for other kinds of it."""
    if type(value) is int or type(value) is float:
        return value
    if isinstance(value, np.generic):
        if value.dtype.kind not in kinds:
            raise TypeError
        return value
    if isinstance(value, list | tuple | range):
        raise TypeError  # whatever is in it, and however long it is
    plain = _plain(value, name)
    if isinstance(plain, list | tuple):
        raise TypeError
    array = np.asarray(plain)
    if array.ndim or array.dtype.kind not in kinds:
        raise TypeError
    # of an array of objects what is in it: asked itself, it may never return
    single = array.item() if isinstance(plain, np.ndarray) else plain
    if isinstance(single, np.ndarray | bool | np.bool_):
        raise TypeError
    return single


def positive_integer(value: Any, name: str) -> int:
    """Convert a value to an int of at least 1 that fits in 64 bits."""
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        number = operator.index(_single(value, name, "iuO"))
    except ArgumentError:
        raise
    except (TypeError, ValueError, OverflowError, RecursionError):
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
    # a duration is an integer to numpy
    return isinstance(value, int | np.integer) and not isinstance(
        value, bool | np.timedelta64
    )


def is_zero(value: object) -> bool:
    """Return whether a value is the integer 0, or False, which turn a step off."""
    return (is_integer(value) or isinstance(value, bool | np.bool_)) and value == 0


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


def call_function(
    given: Callable[..., T], name: str, call: str, *arguments: object, **named: object
) -> T:
    """Call a user's function; what it raises becomes an ArgumentError that names it.

    ``call`` says how it is called. Errors of the package name an argument already.
    """
    try:
        return given(*arguments, **named)
    except (ArgumentError, MemoryError):
        raise
    except Exception as error:  # a user's function may raise anything
        raise ArgumentError(
            name,
            f"must be a function that can be called as {call}; it raises"
            f" {type(error).__name__}: {first_line(error)}",
        ) from error


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


def collection(
    value: Any, name: str, rule: str, *, may_be_set: bool = False
) -> tuple[Any, ...]:
    """Convert a collection to a tuple of its items.

    A text is none, and neither is what loses its order or its values on the way: a set,
    a mapping. ``rule`` says in the error what the items must be. ``may_be_set``: where
    nothing depends on the order.
    """
    if type(value) is tuple:
        return value
    try:
        if isinstance(value, str | bytes):
            raise TypeError
        if isinstance(value, range):
            _refuse_long_range(value, name, rule)
        is_known = type(value) is list or (may_be_set and isinstance(value, Set))
        if not is_known:
            _require_order(value, name, rule)
        # an array of another class, or a sparse matrix, which is a TypeError there
        is_array = hasattr(value, "__array__") or hasattr(value, "tocsr")
        if is_array and type(value) is not np.ndarray:
            value = _plain(value, name)
        return tuple(value)
    except ArgumentError:
        raise
    except (TypeError, ValueError):
        raise ArgumentError(
            name, f"must be {rule}; got {type(value).__name__}"
        ) from None


def _refuse_long_range(value: range, name: str, rule: str) -> None:
    """Refuse a range whose items would fill the memory, which it does not itself."""
    if _containers.length_of_range(value) > MAX_SEQUENCE:
        raise ArgumentError(
            name,
            f"must be {rule}, at most {MAX_SEQUENCE} of them; got {show(value)}",
        )


_SET_ITERATOR: type = type(iter(set[Any]()))


def _require_order(value: Any, name: str, rule: str) -> None:
    """Refuse a set and a mapping, which would give their items in an order of theirs.

    The keys and items of a mapping are sets to Python, and keep the mapping's order.
    """
    is_set = isinstance(value, Set | _SET_ITERATOR)
    if is_set and not isinstance(value, KeysView | ItemsView):
        raise ArgumentError(
            name,
            f"must be {rule}; got {type(value).__name__}, which has no order (a list of"
            " them, in the order that you mean)",
        )
    if isinstance(value, Mapping):
        raise ArgumentError(
            name,
            f"must be {rule}; got {type(value).__name__}, of which the keys alone would"
            f" be read ({_list_of(value, name)})",
        )


def _list_of(value: Mapping[Any, Any], name: str) -> str:
    """Return how to make a list of a mapping, in words of Python."""
    called = name if name.isidentifier() else "mapping"
    counted = list(range(len(value)))
    try:
        if sorted(value.values()) == counted:
            return f"in the order of their numbers: sorted({called}, key={called}.get)"
        if sorted(value) == counted:
            return f"in the order of their numbers: [{called}[k] for k in range(len({called}))]"
    except Exception:  # a user's objects may raise anything
        pass
    return f"a list: list({called}) or list({called}.values())"


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
    if needed < LEAST_ASKED_BYTES:
        return
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
        f" {needed / 2**30:.3g} GiB, and {free / 2**30:.3g} GiB are free",
    )


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
        return make(_check_seed(seed), **options)
    except ArgumentError:
        raise
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        reason = escape_controls(str(error))[:200]
        raise ArgumentError(
            "seed",
            f"must be what numpy.random.{make.__name__} takes; got {show(seed)}"
            f" ({reason})",
        ) from None


def _check_seed(seed: Any) -> Any:
    """Return a seed of the types that numpy documents; TypeError for another.

    numpy follows other objects wherever they lead, to the end of the stack or of time.
    """
    own = (np.random.BitGenerator, np.random.Generator, np.random.RandomState)
    if seed is None or (type(seed) is int and -1 < seed < 2**64):
        return seed
    if isinstance(seed, bool | np.bool_):
        raise ArgumentError("seed", f"must be an integer; got {show(seed)}")
    if isinstance(seed, (*own, ISeedSequence)):
        return seed
    if not is_integer(seed) and not isinstance(seed, list | tuple | range):
        seed = _plain(seed, "seed")
    if isinstance(seed, np.ndarray):
        if seed.dtype.hasobject:
            seed = seed.reshape(-1)[: MAX_SEED_WORDS + 1].tolist()
        elif seed.dtype.kind == "b":
            raise ArgumentError("seed", "must hold integers; it holds truth values")
        elif seed.dtype.kind not in "iu":
            raise TypeError(f"an array of {seed.dtype}")
        elif seed.ndim == 0:
            seed = seed.item()
    if isinstance(seed, np.ndarray):
        n_words: float = seed.size
    else:
        n_words = _count_words(seed, 0)
    if n_words > MAX_SEED_WORDS:
        raise ValueError(f"it is longer than {MAX_SEED_WORDS} numbers of 32 bits")
    return seed


def _count_words(seed: Any, depth: int) -> float:
    """Count the 32-bit numbers of an integer, or of a sequence of such; inf beyond."""
    if isinstance(seed, bool | np.bool_):
        raise ArgumentError("seed", f"must hold integers; it holds {show(seed)}")
    if is_integer(seed):
        return 1.0 + int(seed).bit_length() // 32
    if not isinstance(seed, list | tuple | range) or depth > MAX_SEED_DEPTH:
        raise TypeError(f"{type(seed).__name__} is no integer")
    if len(seed) > MAX_SEED_WORDS:
        return math.inf
    total = 0.0
    for item in seed:
        total += _count_words(item, depth + 1)
        if total > MAX_SEED_WORDS:
            break
    return total


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only, and return it."""
    array.flags.writeable = False
    return array
