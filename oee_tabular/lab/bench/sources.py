"""Sources of a run's families: the package's, MODULE:OBJECT, mappings and functions."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from oee_tabular import _checks
from oee_tabular._arguments import own_modules, own_object
from oee_tabular._results import conform
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.estimators import split
from oee_tabular.lab.bench.families import families
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.mapping import Families

FamiliesLike: TypeAlias = (
    str | Iterable[str] | Mapping[str, Family] | Callable[..., Mapping[str, Family]]
)


def choose_families(given: Any, seed: int) -> tuple[Any, tuple[str, ...]]:
    """Return the source of what a user gave, and the names of its families.

    Every family of the first seed is made, so that a bad one is reported at once.

    Raises
    ------
    ValueError
        If a name is unknown, what is given is no mapping of families, or a family
        cannot be made (its name and why).
    """
    if isinstance(given, str) and ":" not in given:
        given = split(given)
    if given is None:
        names = tuple(families(seed))
    elif isinstance(given, str | Mapping) or not isinstance(given, Iterable):
        names = tuple(families_at(given, seed))
    else:  # names of the package's families
        try:
            listed = tuple(given)
        except TypeError as error:  # an array without dimensions, for one
            raise ArgumentError(
                "families", f"must be names, or a mapping of families; {error}"
            ) from None
        names = tuple(dict.fromkeys(conform(listed, "families", tuple[str, ...])))
        given = None
    if not names:
        raise ArgumentError("families", "must name at least one; it is empty")
    for name in names:
        find_family(given, name, seed)
    return given, names


def find_family(source: Any, name: str, seed: int) -> Family:
    """Return one family of a source at a seed.

    Raises ValueError where it is missing, is no Family or cannot be made.
    """
    every = families_at(source, seed)
    if name not in every:
        if isinstance(every, Families):
            raise ArgumentError("families", every.missing(name))
        raise ArgumentError(
            "families",
            f"must have {name!r} at every seed; at seed {seed} it is missing",
        )
    family = every[name]
    if not isinstance(family, Family):
        raise ArgumentError(
            "families",
            f"must be Families; family {name!r} is a {type(family).__name__}",
        )
    return family


def families_at(source: Any, seed: int) -> Mapping[str, Family]:
    """Return the families of one seed.

    Those that are given by name are made once a process.
    """
    if source is None or isinstance(source, str):
        return _named_families(source, seed)
    if not isinstance(source, Mapping):
        _checks.function(source, "families")
        source = source(seed) if inspect.signature(source).parameters else source()
    if not isinstance(source, Mapping) or not all(
        isinstance(name, str) for name in source
    ):
        raise ArgumentError(
            "families",
            f"must make a mapping name -> Family; they make a {type(source).__name__}",
        )
    return source


@functools.lru_cache(maxsize=128)
def _named_families(spec: str | None, seed: int) -> Mapping[str, Family]:
    """Return the package's families, or those of MODULE:OBJECT, at a seed."""
    if spec is None:
        return families(seed, large=True)
    with own_modules():
        return families_at(
            own_object(spec, "families", "my_package.mine:families"), seed
        )


def modules_of(objects: Sequence[object]) -> tuple[str, ...]:
    """Return the modules that hold a user's own objects.

    Their files are part of what the results depend on.
    """
    modules = set()
    for item in objects:
        name = str(getattr(item, "__module__", "") or type(item).__module__)
        if isinstance(item, str):
            module, colon, _ = item.partition(":")
            name = module if colon else ""
        if name.split(".")[0] not in ("", "oee_tabular", "__main__", "builtins"):
            modules.add(name)
    return tuple(sorted(modules))
