"""Where the families of a run come from: the package's, a user's MODULE:FUNCTION, a function of the seed, a mapping."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from oee_tabular.bench.families import families
from oee_tabular.bench.family import Family
from oee_tabular.testing.command import own_modules, own_object


@dataclass(frozen=True, eq=False)
class Source:
    """The families at each seed, by name.

    Attributes
    ----------
    given : None (the package's), "module:function", a function of the seed or without parameters, or a mapping
    names : those that are run, in order
    """

    given: Any
    names: tuple[str, ...]

    def at(self, seed: int) -> Mapping[str, Family]:
        """The families of one seed."""
        if self.given is None:
            return _own(seed)
        return _named(self.given, seed) if isinstance(self.given, str) else _called(self.given, seed)

    def family(self, name: str, seed: int) -> Family:
        """One family; ValueError where it is missing, is no Family or cannot be made."""
        every = self.at(seed)
        if name not in every:
            raise ValueError(f"families must have {name!r} at every seed; at seed {seed} it is missing")
        found = every[name]
        if not isinstance(found, Family):
            raise ValueError(f"family {name!r} must be a Family; it is a {type(found).__name__}")
        return found

    @property
    def label(self) -> str:
        """What a results folder says about it."""
        return "the package's" if self.given is None else self.given if isinstance(self.given, str) else "given"


def source_of(given: Any, seed: int) -> Source:
    """The source of what a user gave; every family of the first seed is made, so that a bad one is told at once.

    Parameters
    ----------
    given : None (all of the package's), names of the package's, "module:function", a function of the seed or without
        parameters that makes a mapping, or a mapping name -> Family
    seed : of the first repetition

    Raises
    ------
    ValueError
        An unknown name; what is no mapping of families; a family that cannot be made (its name and why).
    """
    if isinstance(given, str):
        given = given if ":" in given else [name.strip() for name in given.split(",") if name.strip()]
    if given is None:
        source = Source(None, tuple(families(seed)))
    elif isinstance(given, str | Mapping) or callable(given):
        source = Source(given, tuple(Source(given, ()).at(seed)))
    else:
        source = Source(None, tuple(dict.fromkeys(given)))
        every = families(seed, large=True)
        for name in source.names:
            if name not in every:
                raise ValueError(every.missing(name))
    if not source.names:
        raise ValueError("families must name at least one; it is empty")
    for name in source.names:
        source.family(name, seed)
    return source


@functools.lru_cache(maxsize=128)
def _own(seed: int) -> Mapping[str, Family]:
    return families(seed, large=True)


@functools.lru_cache(maxsize=128)
def _named(spec: str, seed: int) -> Mapping[str, Family]:
    with own_modules():
        return _called(own_object(spec, "families", "my_package.mine:families"), seed)


def _called(given: Any, seed: int) -> Mapping[str, Family]:
    """The mapping that a function makes, or a mapping itself."""
    found = given if isinstance(given, Mapping) else _call(given, seed)
    if not isinstance(found, Mapping) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"families must make a mapping name -> Family; they make a {type(found).__name__}")
    return found


def _call(function: Callable[..., Any], seed: int) -> Any:
    if not callable(function):
        raise ValueError(f"families must be names, a function or a mapping; got {function!r}")
    return function(seed) if inspect.signature(function).parameters else function()
