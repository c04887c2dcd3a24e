"""Results that check what they are given, and whose texts never raise."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import reprlib
import sys
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from oee_tabular import _checks
from oee_tabular._sparse import check_csr
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, IntArray

C = TypeVar("C", bound=type)
# (value, name) -> the value that is kept
Check: TypeAlias = Callable[[Any, str], Any]


class _Numbers:
    """Stand for an array of numbers in annotations."""


class _Integers:
    """Stand for an array of integers."""


class _Flags:
    """Stand for an array of booleans."""


class _AnyArray:
    """Stand for an array of any kind."""


class _Matrix:
    """Stand for a sparse matrix."""


class _Frame:
    """Stand for a data frame of pandas."""


class _SeedNumbers:
    """Stand for the seed of a result: None, an integer, or a sequence of integers."""


class _Pandas:
    DataFrame = _Frame


# how errors name classes that people make themselves
_CALLED = {
    "Finding": "Finding(kind, severity, text)",
    "Problem": "Problem(simulator, log, ...)",
}
# arrays and matrices by the aliases of ``oee_tabular.typing``
_ALIASES: dict[Any, Any] = {Array: _Numbers, IntArray: _Integers, BoolArray: _Flags}
# what annotations name that is no class at run time, or is slow to import
_NAMES: dict[str, Any] = {
    "Array": _Numbers,
    "IntArray": _Integers,
    "BoolArray": _Flags,
    "Column": _AnyArray,
    "Csr": _Matrix,
    "SeedNumbers": _SeedNumbers,
    "DiagnosticsField": Mapping[str, Any],
    "pd": _Pandas,
}


class _Names(dict[str, Any]):
    """Find the names of annotations; what is not known at run time is not checked."""

    def __init__(self, module: str) -> None:
        super().__init__(vars(typing))
        self.update(vars(sys.modules[module]))
        self.update(_NAMES)

    def __missing__(self, name: str) -> Any:
        found = vars(sys.modules["builtins"])
        return found.get(name, Any)


def checked(
    *,
    shapes: Mapping[str, str] | None = None,
    levels: Collection[str] = (),
    counts: Collection[str] = (),
    positive: Collection[str] = (),
) -> Callable[[C], C]:
    """Make a dataclass check its fields by their annotations.

    A field that is not what its annotation says is an ArgumentError that names it. A
    list becomes the array or tuple that is declared; what fits stays the same object.
    The texts of the class (``repr``, ``str``, HTML) never raise, and ``==`` compares
    arrays by their entries.

    Parameters
    ----------
    shapes : mapping of str to str, optional
        A field -> the letters of its dimensions, ``"S A"``. One letter is one number in
        all fields; a tuple has its length.
    levels : collection of str, optional
        The fields that are in (0, 1), or 1 itself.
    counts : collection of str, optional
        The fields that are integers of at least 0.
    positive : collection of str, optional
        The fields that are integers of at least 1.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @checked(shapes={"names": "k", "values": "k"})
    ... @dataclass(frozen=True)
    ... class Scores:
    ...     names: tuple[str, ...]
    ...     values: Array
    >>> Scores(("a", "b"), [1.0])
    Traceback (most recent call last):
    oee_tabular.exceptions.ArgumentError: values must have shape (2,), for k = 2 of names; it has shape (1,)
    """

    def decorate(cls: C) -> C:
        """Check the fields before ``__post_init__``, and guard the texts."""
        check = functools.partial(
            _check, cls, shapes or {}, levels, counts, frozenset(positive)
        )
        if "__post_init__" in vars(cls):
            _check_before(cls, check)
        else:
            _check_after(cls, check)
        own = vars(cls)
        cls._is_checked = True  # type: ignore[attr-defined]
        if _is_generated(cls, "__repr__"):
            _set(cls, "__repr__", _show_fields)
        for name in ("__repr__", "__str__", "_repr_html_"):
            if name in own:
                _set(cls, name, _guard(own[name]))
        if _is_generated(cls, "__eq__"):
            _set(cls, "__eq__", _equal)
        return cls

    return decorate


def _set(cls: type, name: str, function: Callable[..., Any]) -> None:
    """Set a method of a class."""
    setattr(cls, name, function)


def _is_generated(cls: type, name: str) -> bool:
    """Return whether a method was written by ``dataclass``."""
    method = vars(cls).get(name)
    code = getattr(getattr(method, "__wrapped__", method), "__code__", None)
    return code is not None and code.co_filename == "<string>"


def _check_before(cls: type, check: Callable[[Any], None]) -> None:
    """Make a class check its fields before its own ``__post_init__``."""
    post_init = vars(cls)["__post_init__"]

    @functools.wraps(post_init)
    def prepare(self: Any) -> None:
        check(self)
        post_init(self)

    _set(cls, "__post_init__", prepare)


def _check_after(cls: type, check: Callable[[Any], None]) -> None:
    """Make a class check its fields at the end of its constructor."""
    init = vars(cls)["__init__"]

    @functools.wraps(init)
    def construct(self: Any, *args: Any, **kwargs: Any) -> None:
        init(self, *args, **kwargs)
        check(self)

    _set(cls, "__init__", construct)


# ---- the checks


def conform(value: Any, name: str, kind: Any) -> Any:
    """Require an argument to be what an annotation says, and return it.

    A list becomes the tuple or the array that is declared.

    >>> conform({"a": 1.0}, "values", dict[str, float])
    {'a': 1.0}
    >>> conform({"a": "1"}, "values", dict[str, float] | None)
    Traceback (most recent call last):
    oee_tabular.exceptions.ArgumentError: values['a'] must be a number; got '1'
    """
    return _check_of_argument(kind)(value, name)


@functools.lru_cache(maxsize=256)
def _check_of_argument(kind: Any) -> Check:
    """Return the check of an argument."""
    check = _check_of(kind)
    return check if check is not None else _accept


def _accept(value: Any, name: str) -> Any:
    """Return the value, whatever it is."""
    return value


def _check(
    cls: type,
    shapes: Mapping[str, str],
    levels: Collection[str],
    counts: Collection[str],
    positive: frozenset[str],
    result: Any,
) -> None:
    """Check all fields of a new result."""
    for name, check in _checks_of(cls, positive):
        value = getattr(result, name)
        kept = check(value, name)
        if kept is not value:
            object.__setattr__(result, name, kept)
    for name in levels:
        level = getattr(result, name)
        if not 0.0 < level <= 1.0:
            raise ArgumentError(name, f"must be in (0, 1]; it is {level:g}")
    for name in counts:
        number = getattr(result, name)
        if number is not None and not 0 <= number <= _checks.LARGEST_INTEGER:
            raise ArgumentError(
                name,
                "must be an integer of at least 0, and at most 2**63 - 1; it is"
                f" {_checks.show(number)}",
            )
    if shapes:
        _check_shapes(result, shapes)


def _check_shapes(result: Any, shapes: Mapping[str, str]) -> None:
    """Require the shapes of fields to fit together."""
    sizes: dict[str, tuple[int, str]] = {}
    for field, text in shapes.items():
        letters = text.split()
        for name, part in _parts(field, getattr(result, field)):
            shape = part.shape if hasattr(part, "shape") else (len(part),)
            if len(shape) != len(letters):
                raise ArgumentError(
                    name,
                    f"must have {len(letters)} dimension(s), ({', '.join(letters)}); it"
                    f" has shape {shape}",
                )
            for letter, size in zip(letters, shape, strict=True):
                if sizes.setdefault(letter, (size, name))[0] != size:
                    wanted = tuple(sizes.get(x, ("?",))[0] for x in letters)
                    least, first = sizes[letter]
                    raise ArgumentError(
                        name,
                        f"must have shape {wanted}, for {letter} = {least} of {first};"
                        f" it has shape {shape}",
                    )


def _parts(name: str, value: Any) -> Iterable[tuple[str, Any]]:
    """Return what a shape is of: a field, the values of a mapping, nothing for None."""
    if value is None:
        return ()
    if isinstance(value, Mapping):
        return [(f"{name}[{_checks.show(key)}]", part) for key, part in value.items()]
    return [(name, value)]


@functools.cache
def _checks_of(cls: type, positive: frozenset[str]) -> tuple[tuple[str, Check], ...]:
    """Return the checks of a class's fields, which are made at the first use."""
    found = []
    for field in dataclasses.fields(cls):
        # a base class of another module has names of its own
        owner = next(c for c in cls.__mro__ if field.name in inspect.get_annotations(c))
        check = _check_of(_evaluate(field.type, _Names(owner.__module__)))
        if check is not None and field.name in positive:
            check = functools.partial(_positive, check)
        if check is not None:
            found.append((field.name, check))
    return tuple(found)


def _evaluate(annotation: Any, names: _Names) -> Any:
    """Return what an annotation means; Any where that is known to type checkers alone."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return eval(annotation, {}, names)
    except (AttributeError, TypeError, NameError):
        return Any


def _check_of(kind: Any) -> Check | None:
    """Return the check of an annotation, or None where it says nothing."""
    kind = _ALIASES.get(kind, kind)
    if kind in _SIMPLE:
        return _SIMPLE[kind]
    origin = typing.get_origin(kind)
    inside = typing.get_args(kind)
    if origin is Literal:
        return functools.partial(_one_of, inside)
    if origin in (typing.Union, types.UnionType):
        return _union(inside)
    if origin is tuple:
        return _tuple(inside)
    if origin in (dict, Mapping):
        return functools.partial(_mapping, _check_of(inside[0]), _check_of(inside[1]))
    if origin is frozenset:
        return functools.partial(_frozenset, _check_of(inside[0]))
    if origin is Callable or getattr(kind, "_is_protocol", False):
        return _callable
    if isinstance(kind, type) and origin is None:
        return functools.partial(_instance, kind)
    return None


def _number(value: Any, name: str) -> Any:
    """Require a number; nan and infinity are numbers."""
    if isinstance(value, np.longdouble):
        return float(value)  # scipy has no functions of longer numbers
    if isinstance(value, float | np.floating):
        return value
    try:
        if isinstance(value, int | np.integer):
            number = float(value)  # a larger one is no float
            # numpy has no functions of integers of more than 64 bits
            return value if abs(number) < 2.0**63 else number
        # sequences are refused by their type: of a range the array may be endless
        is_array = not (
            isinstance(value, list | tuple | range) or _checks.is_sparse(value)
        )
        array = np.asarray(value) if is_array else None
        if array is None or array.ndim or array.dtype.kind not in "biufO":
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(
            name, f"must be a number; got {_checks.show(value)}"
        ) from None


def _integer(value: Any, name: str) -> Any:
    """Require an integer of 64 bits."""
    if not _checks.is_integer(value):
        raise ArgumentError(name, f"must be an integer; got {_checks.show(value)}")
    if abs(value) > _checks.LARGEST_INTEGER:
        raise ArgumentError(
            name, f"must be at most 2**63 - 1 in size; it is {_checks.show(value)}"
        )
    return value


def _positive(check: Check, value: Any, name: str) -> Any:
    """Require an integer of at least 1, or None where ``check`` allows it."""
    return check(
        value if value is None else _checks.positive_integer(value, name), name
    )


def _text(value: Any, name: str) -> Any:
    """Require a text."""
    if isinstance(value, str):
        return value
    return _checks.instance(value, str, name, "text")


def _flag(value: Any, name: str) -> Any:
    """Require True or False."""
    if value is True or value is False:
        return value
    return _checks.boolean(value, name)


def _nothing(value: Any, name: str) -> Any:
    """Require None."""
    if value is not None:
        raise ArgumentError(name, f"must be None; got {_checks.show(value)}")
    return value


def _array(kinds: str, what: str, value: Any, name: str) -> Any:
    """Require an array whose entries are of certain kinds; make one of a list."""
    if type(value) is np.ndarray and value.dtype.kind in kinds:
        return value
    if kinds == _ANY_KIND:
        return _checks.as_array(value, name)
    if kinds == _NUMBER_KINDS:
        return _checks.float_array(value, name)
    array = _checks.as_array(value, name, what)
    if array.size == 0:
        return array.astype(bool if kinds == "b" else np.int64)
    if array.dtype.kind not in kinds:
        raise ArgumentError(
            name, f"must be {what}; its entries are of type {array.dtype}"
        )
    return array


def _sparse(value: Any, name: str) -> Any:
    """Require a sparse matrix of real numbers whose parts fit together."""
    if not _checks.is_sparse(value):
        raise ArgumentError(
            name, f"must be a sparse matrix; got {type(value).__name__}"
        )
    if value.ndim != 2 or value.format != "csr" or value.dtype.kind not in "biuf":
        raise ArgumentError(
            name,
            "must be a csr matrix of real numbers; it has format"
            f" {value.format}, shape {value.shape} and type {value.dtype}",
        )
    # native code follows its pointers and indices wherever they lead
    check_csr(value, name)
    return value


def _seed(value: Any, name: str) -> Any:
    """Require None, an integer, or a sequence of integers."""
    if value is None or _checks.is_integer(value):
        return value
    is_sequence = isinstance(value, list | tuple) or (
        isinstance(value, np.ndarray) and value.ndim == 1
    )
    if not is_sequence or not all(_checks.is_integer(number) for number in value):
        raise ArgumentError(
            name,
            "must be None, an integer or a sequence of integers; got"
            f" {_checks.show(value)}",
        )
    return value


def _frame(value: Any, name: str) -> Any:
    """Require a data frame of pandas."""
    pandas = sys.modules.get("pandas")
    if pandas is None or not isinstance(value, pandas.DataFrame):
        raise ArgumentError(
            name, f"must be a pandas.DataFrame; got {type(value).__name__}"
        )
    return value


def _callable(value: Any, name: str) -> Any:
    """Require what can be called."""
    _checks.function(value, name)
    return value


def _instance(kind: type, value: Any, name: str) -> Any:
    """Require an object of a class."""
    return _checks.instance(value, kind, name, _CALLED.get(kind.__name__, ""))


def _one_of(allowed: tuple[Any, ...], value: Any, name: str) -> Any:
    """Require one of some words."""
    _checks.one_of(value, name, allowed)
    return value


def _union(kinds: tuple[Any, ...]) -> Check | None:
    """Return the check of a field that may be of one of several kinds."""
    checks = [_check_of(kind) for kind in kinds if kind is not type(None)]
    others = [check for check in checks if check is not None]
    if len(others) < len(checks):
        return None  # anything
    has_none = type(None) in kinds

    def check_one(value: Any, name: str) -> Any:
        """Return what the first check returns that does not refuse the value."""
        if value is None and has_none:
            return value
        rules = []
        for check in others:
            try:
                return check(value, name)
            except ArgumentError as error:
                if error.argument != name:
                    raise
                rules.append(error.rule)
        end = " (None is allowed)" if has_none else ""
        raise ArgumentError(name, f"{', or '.join(rules)}{end}")

    return check_one


def _tuple(inside: tuple[Any, ...]) -> Check:
    """Return the check of a tuple, with as many items as there are or as are given."""
    if len(inside) == 2 and inside[1] is Ellipsis:
        return functools.partial(_items, _check_of(inside[0]))
    return functools.partial(_fixed_items, [_check_of(kind) for kind in inside])


def _as_tuple(value: Any, name: str) -> Any:
    """Return a tuple as it is, and a list or an array as a tuple."""
    if isinstance(value, tuple):
        return value
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list):
        raise ArgumentError(name, f"must be a tuple; got {_checks.show(value)}")
    return tuple(value)


def _items(check: Check | None, value: Any, name: str) -> Any:
    """Require a tuple of items of one kind."""
    items = _as_tuple(value, name)
    if check is None:
        return items
    kept = tuple(check(item, f"{name}[{k}]") for k, item in enumerate(items))
    return _same_or(items, kept)


def _fixed_items(checks: list[Check | None], value: Any, name: str) -> Any:
    """Require a tuple of a certain length."""
    items = _as_tuple(value, name)
    if len(items) != len(checks):
        raise ArgumentError(
            name, f"must have {len(checks)} entries; it has {len(items)}"
        )
    kept = tuple(
        item if check is None else check(item, f"{name}[{k}]")
        for k, (item, check) in enumerate(zip(items, checks, strict=True))
    )
    return _same_or(items, kept)


def _same_or(items: tuple[Any, ...], kept: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the items themselves where nothing was converted."""
    is_same = all(a is b for a, b in zip(items, kept, strict=True))
    return items if is_same else kept


def _mapping(
    key_check: Check | None, value_check: Check | None, value: Any, name: str
) -> Any:
    """Require a mapping whose keys and values are of certain kinds."""
    # one of scipy's formats of matrices is a dict
    if not isinstance(value, Mapping) or _checks.is_sparse(value):
        raise ArgumentError(name, f"must be a mapping; got {type(value).__name__}")
    changed = {}
    if key_check is None and value_check is None:
        return value
    key_name = f"a key of {name}"
    for key, item in value.items():
        if key_check is not None:
            key_check(key, key_name)
        if value_check is None:
            continue
        try:
            kept = value_check(item, name)
        except ArgumentError:
            # the place is written only where it is needed, since that takes long
            kept = value_check(item, f"{name}[{_checks.show(key)}]")
        if kept is not item:
            changed[key] = kept
    return {**value, **changed} if changed else value


def _frozenset(check: Check | None, value: Any, name: str) -> Any:
    """Require a set of items of one kind."""
    if not isinstance(value, set | frozenset):
        raise ArgumentError(name, f"must be a set; got {type(value).__name__}")
    for item in value if check is not None else ():
        check(item, f"an item of {name}")  # type: ignore[misc]
    return frozenset(value)


_NUMBER_KINDS = "biuf"
_ANY_KIND = "biufOSUMmcV"
_SIMPLE: dict[Any, Check | None] = {
    Any: None,
    object: None,
    float: _number,
    int: _integer,
    str: _text,
    bool: _flag,
    None: _nothing,
    type(None): _nothing,
    dict: functools.partial(_mapping, None, None),
    tuple: _as_tuple,
    Callable: _callable,
    _Numbers: functools.partial(_array, _NUMBER_KINDS, "an array of numbers"),
    _Integers: functools.partial(_array, "iu", "an array of integers"),
    _Flags: functools.partial(_array, "b", "an array of True and False"),
    _AnyArray: functools.partial(_array, _ANY_KIND, "an array"),
    _Matrix: _sparse,
    _SeedNumbers: _seed,
    _Frame: _frame,
}


# ---- texts and equality


@reprlib.recursive_repr()
def _show_fields(self: Any) -> str:
    """Return the text that a dataclass has; a field whose text raises shows its class."""
    parts = []
    for field in dataclasses.fields(self):
        if field.repr:
            value = getattr(self, field.name, None)
            try:
                text = repr(value)
            except Exception:  # a user's object may raise anything
                text = _checks.show(value)
            parts.append(f"{field.name}={text}")
    return f"{type(self).__qualname__}({', '.join(parts)})"


def _guard(function: Callable[[Any], str]) -> Callable[[Any], str]:
    """Return a method that shows the fields where the given one raises."""

    @functools.wraps(function)
    def write(self: Any) -> str:
        try:
            return function(self)
        except Exception:  # fields were edited, or hold a user's object
            return str(_show_fields(self))

    return write


def _equal(self: Any, other: object) -> Any:
    """Compare two results of one class field by field, arrays by their entries."""
    if other.__class__ is not self.__class__:
        return NotImplemented
    kind: Any = type(self)
    return all(
        _same(getattr(self, field.name), getattr(other, field.name))
        for field in dataclasses.fields(kind)
        if field.compare
    )


def _same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, also where they hold arrays."""
    if one is other:
        return True
    try:
        return bool(one == other)
    except Exception:  # of more than one entry, or a user's object
        pass
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return bool(np.array_equal(one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(
            _same(one[key], other[key]) for key in one
        )
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(_same, one, other))
    return False
