"""Containers of numbers from other libraries: their values, or why position loses some.

``numpy.array`` takes from a container its numbers alone. What else it says is lost:
which values are missing (masked arrays), the unit, the labels of rows (pandas), the
order of dimensions (xarray). Here such a container is turned into a plain array where
that loses nothing, and is refused, with the remedy, where it does.
"""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterable, Mapping, Sequence, Set
from datetime import date, time, timedelta
from decimal import Decimal
from fractions import Fraction
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

Index = tuple[int, ...]

MAX_DEPTH = 64  # of lists in lists, the most dimensions of numpy's arrays
MAX_SEQUENCE = 10**7  # items of a range, or of a sequence by its methods alone
MAX_SHOWN_LABELS = 3
# types of single values, of which an array is made as it stands
_PLAIN = {int, float, bool, complex, str, bytes, type(None), Decimal, Fraction}
_SINGLE = (np.generic, str, bytes, date, time, timedelta)
_KNOWN = {np.ndarray, list, tuple, type(None)}  # columns without labels
_HOLDERS = ("magnitude", "value", "_value")  # of the numbers of a quantity
_CONVERSIONS = ("m_as", "to_value", "value_in_unit")  # to numbers without a unit
_DIMENSIONLESS = re.compile(r"(1(\.0*)?)?\s*\(?(dimensionless|unitless)?\)?")


class LossError(ValueError):
    """Say that an argument is no plain array: its place, and the rest of the sentence.

    Whoever asks makes the package's own error of it.
    """

    def __init__(self, argument: str, rule: str) -> None:
        super().__init__(f"{argument} {rule}")
        self.argument = argument
        self.rule = rule


def place(name: str, index: Index) -> str:
    """Name an entry of an argument: ``policy[3, 1]`` for ("policy", (3, 1))."""
    return f"{name}[{', '.join(str(int(i)) for i in index)}]"


def is_sparse(value: object) -> TypeGuard[Any]:
    """Return whether a value is one of scipy's sparse matrices or arrays.

    No method of it is called, since a malformed one may end the process.
    """
    # without this module, which is slow to import, there is no such object
    sparse = sys.modules.get("scipy.sparse")
    return sparse is not None and bool(sparse.issparse(value))


def to_plain_array(
    value: object, name: str, index: Index = (), *, allow_missing: bool = False
) -> Any:
    """Return what ``numpy.array`` makes the same numbers of, without losing anything.

    That is a plain array, a number, a text, or a list of such.

    Parameters
    ----------
    value : object
        What the caller was given.
    name : str
        The argument's name, for errors.
    index : tuple of int, default ()
        The value's place in the argument.
    allow_missing : bool, default False
        Whether values may be missing, which then are nan. Otherwise they are errors.

    Returns
    -------
    object
        The value itself where it is plain.

    Raises
    ------
    LossError
        If a value is missing, has a unit, or has labels that position loses.
    TypeError, ValueError
        If it is no array; what other libraries raise on the way becomes one of these.
    """
    kind = type(value)
    if kind is np.ndarray:
        if value.dtype.hasobject:  # type: ignore[attr-defined]
            return _plain_objects(value, name, index, allow_missing)  # type: ignore[arg-type]
        return value
    if kind in _PLAIN or isinstance(value, _SINGLE):
        return value
    if isinstance(value, list | tuple):
        return _plain_items(value, name, index, allow_missing)
    if isinstance(value, range):
        _refuse_long_ranges([value], name, index)
        return np.array(value)
    if is_sparse(value):
        raise TypeError("a sparse matrix: give .toarray()")
    if _is_missing(value):
        return _missing(name, index, allow_missing, "missing")
    try:
        native = to_native(value)
        if native is not value:
            return to_plain_array(native, name, index, allow_missing=allow_missing)
        inner = _unwrap(value, name, index)
        if isinstance(inner, np.ma.MaskedArray) or hasattr(inner, "unmasked"):
            return _plain_masked(inner, name, index, allow_missing)
        if inner is not value and type(inner) is not np.ndarray:
            return to_plain_array(inner, name, index, allow_missing=allow_missing)
        if _is_sequence(inner):
            items = _read_sequence(inner)
            return to_plain_array(items, name, index, allow_missing=allow_missing)
        # an array of another class may come of this
        array = np.asanyarray(inner)
    except (LossError, TypeError, ValueError):
        raise
    except Exception as error:
        # a user's object, or another library's, may raise anything
        raise TypeError(f"{type(error).__name__}: {error}") from None
    if isinstance(array, np.ma.MaskedArray):
        return _plain_masked(array, name, index, allow_missing)
    array = np.asarray(array)
    mask = _missing_of(value)
    if mask is not None and mask.shape == array.shape and mask.any():
        return _fill(array, mask, name, index, allow_missing, "missing")
    if array.dtype.hasobject:
        if array.ndim == 0:  # it is no array
            return inner
        return _plain_objects(array, name, index, allow_missing)
    return array


def length_of_range(numbers: range) -> int:
    """Return the number of items of a range, which ``len`` refuses where it is large.

    >>> length_of_range(range(0, 10**30, 3)) == (10**30 + 2) // 3
    True
    """
    step = numbers.step
    toward = 1 if step > 0 else -1
    return max(0, (numbers.stop - numbers.start + step - toward) // step)


def count_in_ranges(items: Iterable[object]) -> int:
    """Return the number of items of all ranges among some values."""
    return sum(length_of_range(x) for x in items if isinstance(x, range))


def _refuse_long_ranges(items: Iterable[object], name: str, index: Index) -> None:
    """Raise a LossError where ranges would fill the memory as arrays.

    A range takes none itself, whatever its length.
    """
    count = count_in_ranges(items)
    if count > MAX_SEQUENCE:
        raise LossError(
            place(name, index) if index else name,
            f"must have at most {MAX_SEQUENCE} numbers as a range; it has"
            f" {_show_count(count)} (more of them: numpy.arange)",
        )


def _show_count(count: int) -> str:
    """Write a number; Python writes none of more than 4300 digits."""
    return str(count) if count < 2**63 else "2**63 or more"


def to_native(value: Any) -> Any:
    """Return what narwhals wraps, or what dask has yet to compute; else the value.

    What numpy would make of them has no mask and no labels any more.
    """
    kind = type(value)
    if hasattr(kind, "__dask_graph__") and hasattr(kind, "compute"):
        return value if value.__dask_graph__() is None else value.compute()
    if kind.__module__.startswith("narwhals.") and hasattr(kind, "to_native"):
        return value.to_native()
    return value


def _is_sequence(value: Any) -> bool:
    """Say whether a value is a sequence by its methods alone, such as a deque."""
    if isinstance(value, Mapping | Set | type) or not (
        hasattr(value, "__getitem__") and hasattr(value, "__len__")
    ):
        return False
    protocols = ("__array__", "__array_interface__", "__array_struct__")
    if any(hasattr(value, protocol) for protocol in protocols):
        return False
    try:
        memoryview(value)
    except TypeError:
        return True
    return False  # it gives numpy its memory


def _read_sequence(value: Any) -> list[Any]:
    """Return the items of a sequence, which numpy would read beyond its length."""
    length = len(value)
    if length > MAX_SEQUENCE:
        raise ValueError(f"a sequence of more than {MAX_SEQUENCE} items")
    items = list(itertools.islice(iter(value), length + 1))
    if len(items) != length:
        raise ValueError("a sequence that has not as many items as it says")
    return items


def _is_missing(value: object) -> bool:
    """Say whether a value is pandas's or polars's sign for a missing value."""
    return type(value).__name__ in ("NAType", "NaTType")


def _missing_of(value: Any) -> NDArray[Any] | None:
    """Say which values of pandas's, polars's or Arrow's own types are missing.

    None for numpy's types, which have only nan.
    """
    is_frame = getattr(value, "ndim", 0) == 2 and hasattr(value, "dtypes")
    types = list(value.dtypes) if is_frame else [getattr(value, "dtype", None)]
    if all(isinstance(dtype, np.dtype) for dtype in types):
        return None
    for part in ("isna", "is_null"):
        if hasattr(value, part):
            return np.asarray(getattr(value, part)(), dtype=np.bool_)
    return None


def _missing(name: str, index: Index, allow_missing: bool, what: str) -> float:
    """Return nan for a missing value where it is allowed, else raise an error."""
    if allow_missing:
        return float("nan")
    raise LossError(
        place(name, index) if index else name, f"must have a value; it is {what}"
    )


def _plain_items(
    items: list[Any] | tuple[Any, ...], name: str, index: Index, allow_missing: bool
) -> Any:
    """Return a list whose items are plain; itself where they are."""
    if len(index) > MAX_DEPTH or _are_plain(items, len(index)):
        return items
    _refuse_long_ranges(items, name, index)  # all of them together
    return [
        to_plain_array(item, name, (*index, k), allow_missing=allow_missing)
        for k, item in enumerate(items)
    ]


def _are_plain(items: list[Any] | tuple[Any, ...], depth: int) -> bool:
    """Say whether a list holds single values, and lists of such, alone."""
    kinds = set(map(type, items))
    if kinds <= _PLAIN:
        return True
    if kinds <= {list, tuple}:
        # one that holds itself is numpy's to refuse
        return depth > MAX_DEPTH or all(_are_plain(item, depth + 1) for item in items)
    return all(kind in _PLAIN or issubclass(kind, _SINGLE) for kind in kinds)


def _plain_objects(
    array: NDArray[Any], name: str, index: Index, allow_missing: bool
) -> NDArray[Any]:
    """Return an array of objects without missing values, units and arrays in it.

    Names (texts and tuples) stay as they are.
    """
    known = (*_SINGLE, list, tuple)
    kinds = set(map(type, array.reshape(-1).tolist()))
    if all(kind in _PLAIN or issubclass(kind, known) for kind in kinds):
        return array
    plain = np.empty(array.shape, dtype=object)
    for at, item in np.ndenumerate(array):
        if isinstance(item, np.ndarray) and item.dtype.hasobject:
            # it may hold itself, which numpy follows until the stack ends
            raise ValueError("an array of objects in an array")
        known_item = type(item) in _PLAIN or isinstance(item, known)
        if not known_item:
            item = to_plain_array(
                item, name, (*index, *at), allow_missing=allow_missing
            )
        plain[at] = item
    return plain


def _plain_masked(
    value: Any, name: str, index: Index, allow_missing: bool
) -> NDArray[Any]:
    """Return the values of a masked array; nan where they are masked, or an error."""
    if isinstance(value, np.ma.MaskedArray):
        data, mask = np.asarray(np.ma.getdata(value)), np.ma.getmaskarray(value)
    else:  # of astropy
        data, mask = np.asarray(value.unmasked), np.asarray(value.mask)
    if mask.dtype.names is not None:
        raise TypeError("an array of records")
    mask = np.broadcast_to(mask, data.shape)
    if not mask.any():
        if data.dtype.hasobject:
            return _plain_objects(data, name, index, allow_missing)
        return data
    return _fill(data, mask, name, index, allow_missing, "masked")


def _fill(
    data: NDArray[Any],
    mask: NDArray[Any],
    name: str,
    index: Index,
    allow_missing: bool,
    what: str,
) -> NDArray[Any]:
    """Return values with nan where the mask says that one is missing, or an error."""
    first = tuple(np.argwhere(mask)[0])
    nan = _missing(name, (*index, *first), allow_missing, what)
    kind = data.dtype if data.dtype.kind in "fcO" else np.float64
    filled = np.array(data, dtype=kind)
    filled[mask] = nan
    return filled


def _unwrap(value: Any, name: str, index: Index) -> Any:
    """Return what a container holds, or the value itself.

    Raises an LossError where it says more than its numbers.
    """
    where = place(name, index) if index else name
    if hasattr(value, "iloc") and hasattr(value, "index"):
        return _unwrap_pandas(value, where)
    if _is_table(value):
        return _unwrap_table(value, where)
    dims = getattr(value, "dims", None)
    if isinstance(dims, tuple | list) and hasattr(value, "__array__"):
        return _unwrap_dims(value, tuple(dims), where)
    require_no_unit_of(value, where)
    return _without_unit(value, where)


def _unwrap_pandas(value: Any, where: str) -> Any:
    """Return the values of a Series or DataFrame whose labels are 0, 1, 2, ..."""
    axes = {"index": value.index}
    if getattr(value, "ndim", 1) == 2:
        axes["columns"] = value.columns
    for axis, labels in axes.items():
        if not _counts_from_zero(labels):
            raise LossError(
                where,
                "must be a plain array, which is read by position; got"
                f" {type(value).__name__} whose {axis} {_show_labels(labels)}"
                f" {'is' if axis == 'index' else 'are'} not 0, 1, 2, ... (in the order"
                " in which it stands: .to_numpy())",
            )
    require_no_unit_of(value, where)
    return np.asarray(value)


def require_no_unit_of(value: Any, where: str) -> None:
    """Raise an LossError where the type of a column's values has a unit.

    So it has in extensions of pandas (pint). In those of time a unit is a resolution.
    """
    is_table = getattr(value, "ndim", 1) == 2 and hasattr(value, "dtypes")
    types = list(value.dtypes) if is_table else [getattr(value, "dtype", None)]
    for dtype in types:
        if isinstance(dtype, np.dtype) or getattr(dtype, "kind", "") in ("M", "m"):
            continue
        for part in ("units", "unit"):
            unit = getattr(dtype, part, None)
            if unit is not None:
                _require_no_unit(unit, value, where)


def is_labelled_series(value: object) -> TypeGuard[Any]:
    """Say whether a value is a Series whose labels are not 0, 1, 2, ..."""
    is_series = hasattr(value, "iloc") and hasattr(value, "to_dict")
    return (
        is_series
        and getattr(value, "ndim", 0) == 1
        and not _counts_from_zero(getattr(value, "index", None))
    )


def without_shared_labels(columns: dict[str, Any]) -> dict[str, Any]:
    """Return columns of one table without their labels, where these are the same.

    The columns of a frame whose rows were chosen keep the numbers that these had.
    """
    columns = {
        name: value if type(value) in _KNOWN else to_native(value)
        for name, value in columns.items()
    }
    series = [value for value in columns.values() if hasattr(value, "iloc")]
    if len(series) < 2 or not all(map(is_labelled_series, series)):
        return columns
    first = series[0].index
    if not all(first.equals(other.index) for other in series[1:]):
        return columns
    return {
        name: value.reset_index(drop=True) if hasattr(value, "iloc") else value
        for name, value in columns.items()
    }


def without_known_labels(values: Any, labels: Sequence[Any]) -> Any:
    """Return a Series whose labels are these, in this order, as a plain array.

    Then position loses nothing. Anything else is returned as it is.
    """
    if not hasattr(values, "iloc") or getattr(values, "ndim", 1) != 1:
        return values
    own = list(values.index)
    if len(own) == len(labels) and own == list(labels):
        return values.to_numpy()
    return values


def _counts_from_zero(labels: Any) -> bool:
    """Say whether labels are 0, 1, 2, ..."""
    parts = [getattr(labels, part, None) for part in ("start", "step")]
    if all(type(part) is int for part in parts):  # a RangeIndex
        return parts == [0, 1] or len(labels) == 0 or (parts[0] == 0 == len(labels) - 1)
    array = np.asarray(labels)
    return array.ndim == 1 and bool(
        array.size == 0
        or (array.dtype.kind in "iu" and (array == np.arange(len(array))).all())
    )


def _show_labels(labels: Any) -> str:
    """Return the first labels in brackets."""
    first = [str(label)[:40] for label in list(labels[: MAX_SHOWN_LABELS + 1])]
    shown = ", ".join(first[:MAX_SHOWN_LABELS])
    if len(first) > MAX_SHOWN_LABELS:
        shown += ", ..."
    printable = "".join(c if c.isprintable() else repr(c)[1:-1] for c in shown)
    return f"({printable})"


def _is_table(value: Any) -> bool:
    """Say whether a value is a table with named columns and without labels of rows."""
    names = _column_names(value)
    is_shaped = any(hasattr(value, part) for part in ("shape", "num_rows"))
    return names is not None and is_shaped and not isinstance(value, np.ndarray)


def _column_names(value: Any) -> list[str] | None:
    """Return the names of a table's columns (polars, Arrow), or None."""
    for part in ("column_names", "columns"):
        names = getattr(value, part, None)
        if isinstance(names, list | tuple) and all(isinstance(n, str) for n in names):
            return list(names)
    return None


def _unwrap_table(value: Any, where: str) -> Any:
    """Return a table of unnamed columns; an error where they have names."""
    names = _column_names(value) or []
    if names != [f"column_{k}" for k in range(len(names))]:
        way = ".to_numpy()" if hasattr(value, "to_numpy") else "numpy.asarray(table)"
        raise LossError(
            where,
            "must be a plain array, which is read by position; got"
            f" {type(value).__name__} with the columns {_show_labels(names)} (in the"
            f" order in which they stand: {way})",
        )
    return np.asarray(value)


def _unwrap_dims(value: Any, dims: tuple[Any, ...], where: str) -> Any:
    """Return the array inside of one with named dimensions (xarray).

    One dimension, or unnamed ones, counted from 0, lose nothing by position.
    """
    is_unnamed = dims == tuple(f"dim_{k}" for k in range(len(dims)))
    if len(dims) > 1 and not is_unnamed:
        order = ", ".join(map(repr, dims))
        raise LossError(
            where,
            "must be a plain array, whose dimensions are read by position; got"
            f" {type(value).__name__} with the dimensions {order} (say in which order:"
            " .transpose(...).to_numpy())",
        )
    coords = getattr(value, "coords", None)
    for dim in dims:
        labels = coords[dim] if coords is not None and dim in coords else None
        if labels is not None and not _counts_from_zero(labels):
            raise LossError(
                where,
                "must be a plain array, which is read by position; got"
                f" {type(value).__name__} whose coordinate {dim!r}"
                f" {_show_labels(np.asarray(labels))} is not 0, 1, 2, ... (in the order"
                " in which it stands: .to_numpy())",
            )
    inner = getattr(value, "data", None)
    has_unit = inner is not None and not isinstance(inner, memoryview)
    return inner if has_unit else np.asanyarray(value)


def _without_unit(value: Any, where: str) -> Any:
    """Return the numbers of a quantity without unit, and anything else as it is.

    Quantities (pint, astropy, unyt, brian2) are known by their attributes.
    """
    dimensions = getattr(value, "dimensions", None)
    if getattr(dimensions, "is_dimensionless", None) is False:
        _require_no_unit(dimensions, value, where)
    holder = next((part for part in _HOLDERS if hasattr(value, part)), None)
    if holder is None:
        return value
    for part in ("units", "unit"):
        unit = getattr(value, part, None)
        if unit is not None:
            _require_no_unit(unit, value, where)
            inner = getattr(value, holder)
            return np.asarray(value) if callable(inner) else inner
    return value


def _require_no_unit(unit: object, value: object, where: str) -> None:
    """Raise an error that names the unit of a value unless there is none."""
    text = str(unit).strip()
    if _DIMENSIONLESS.fullmatch(text):
        return
    way = next((way for way in _CONVERSIONS if hasattr(value, way)), None)
    remedy = "give its numbers alone, in the unit that you mean"
    if way is not None:
        remedy = f"give its numbers in the unit that you mean: .{way}({text[:40]!r})"
    raise LossError(
        where, f"must be numbers without a unit; it is in {text[:80]} ({remedy})"
    )
