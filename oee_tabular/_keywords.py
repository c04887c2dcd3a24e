"""Errors of misspelt keywords: they name the function and the nearest known keyword."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from decimal import Decimal
from fractions import Fraction
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar, overload

import numpy as np

from oee_tabular.exceptions import UnknownKeywordError

# numbers that do not mix with floats, or carry their own precision into what follows
OTHER_NUMBERS = (Decimal, Fraction, np.longdouble, np.float32, np.float16)

P = ParamSpec("P")
T = TypeVar("T")
C = TypeVar("C", bound=type)


@overload
def suggest_keywords(door: C) -> C: ...


@overload
def suggest_keywords(door: Callable[P, T]) -> Callable[P, T]: ...


@overload
def suggest_keywords(
    *, renamed: Mapping[str, str]
) -> Callable[[Callable[P, T]], Callable[P, T]]: ...


def suggest_keywords(
    door: Any = None, *, renamed: Mapping[str, str] | None = None
) -> Any:
    """Make a function, or the constructor of a class, answer a misspelt keyword well.

    A call that succeeds costs a tenth of a microsecond more. A ``TypeError`` that has
    another reason passes unchanged. ``renamed`` are keywords of former releases, and
    what is written in place of each.

    >>> @suggest_keywords
    ... def walk(*, horizon=None, seed=None): ...
    >>> walk(horizn=3)
    Traceback (most recent call last):
    oee_tabular.exceptions.UnknownKeywordError: walk() got an unexpected keyword argument 'horizn'. Did you mean 'horizon'?
    """
    if door is None:
        return lambda function: _wrap(function, function.__name__, renamed)
    if not isinstance(door, type):
        return _wrap(door, door.__name__)
    door.__init__ = _wrap(_take_floats(door.__init__), door.__name__)  # type: ignore[misc]
    if dataclasses.is_dataclass(door) and "__repr__" in vars(door):
        door.__repr__ = _safe(door.__repr__)  # type: ignore[method-assign]
    return door


def _take_floats(make: Callable[P, T]) -> Callable[P, T]:
    """Return a constructor that keeps a number of another type as a float.

    Options are kept as they were given; floats cannot be multiplied by a Decimal, and
    scipy has no functions of longer numbers.
    """

    @functools.wraps(make)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        if any(type(x) in OTHER_NUMBERS for x in (*args, *kwargs.values())):
            given = [_float_of(x) for x in args]
            named = {name: _float_of(x) for name, x in kwargs.items()}
            return make(*given, **named)  # type: ignore[arg-type]
        return make(*args, **kwargs)

    return call


def _float_of(value: object) -> object:
    """Return a number of another type as a float, if there is one, else the value."""
    if type(value) not in OTHER_NUMBERS:
        return value
    try:
        return float(value)  # type: ignore[arg-type]
    except (ValueError, OverflowError):
        return value  # the constructor refuses it


def _safe(write: Callable[[Any], str]) -> Callable[[Any], str]:
    """Return a ``__repr__`` that raises nothing, whatever an option's own raises."""

    @functools.wraps(write)
    def text(self: Any) -> str:
        try:
            return write(self)
        except Exception:  # the repr of a user's object may raise anything
            return object.__repr__(self)

    return text


def _wrap(
    function: Callable[P, T], name: str, renamed: Mapping[str, str] | None = None
) -> Callable[P, T]:
    """Return the function with better errors, under the name that a caller knows."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except TypeError:
            refuse_unknown(function, name, kwargs, renamed or {})
            raise

    return call


def refuse_unknown(
    function: Callable[..., object],
    name: str,
    keywords: Iterable[str],
    renamed: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Raise an ``UnknownKeywordError`` for a keyword that the function lacks."""
    parameters = inspect.signature(function).parameters.values()
    if any(each.kind is each.VAR_KEYWORD for each in parameters):
        return
    known = [
        each.name
        for each in parameters
        if each.kind in (each.KEYWORD_ONLY, each.POSITIONAL_OR_KEYWORD)
        and each.name not in ("self", "cls")
        and not each.name.startswith("_")
    ]
    for keyword in keywords:
        if keyword not in inspect.signature(function).parameters:
            near = difflib.get_close_matches(keyword, known, n=1)
            nearest = renamed.get(keyword, near[0] if near else None)
            raise UnknownKeywordError(name, keyword, nearest, known) from None
