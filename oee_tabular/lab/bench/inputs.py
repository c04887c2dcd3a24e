"""What a run is given: estimators and families, by name, as MODULE:OBJECT or as objects; and the two references."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from oee_tabular import _checks
from oee_tabular._arguments import own_modules, own_object
from oee_tabular._checks import PolicyLike, Seed
from oee_tabular.estimators import Estimate, Estimator, ModelBased, Problem, Simulator
from oee_tabular.estimators.names import named_estimators, names
from oee_tabular.lab.bench.families import families
from oee_tabular.lab.bench.family import Family
from oee_tabular.testing.command import own_estimator

LIKELIHOOD, SIMULATOR = "maximum-likelihood", "simulator"
REFERENCES: Mapping[str, Estimator] = {LIKELIHOOD: ModelBased(fallback="simulator"), SIMULATOR: Simulator()}


@dataclass(frozen=True)
class Evaluated:
    """What ``oee.evaluate`` prints: its value of ``oee`` and the interval beside it."""

    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """The printed value and interval of one policy."""
        from oee_tabular.report import evaluate

        report = evaluate(problem, {"policy": policy}, estimators=["oee"], confidence=0.95, seed=seed)
        return report.results[0].estimate


# ---- estimators


def choose_estimators(given: object) -> dict[str, Any]:
    """Name -> spec or estimator, each looked up once, of what ``run`` takes; ValueError for one that is none."""
    if isinstance(given, str) or not isinstance(given, Mapping | Sequence):
        given = [given]
    chosen: dict[str, object] = {}
    for key, item in given.items() if isinstance(given, Mapping) else [(None, item) for item in given]:
        if not isinstance(item, str) and not callable(item):
            raise ValueError(f"estimators must be names, MODULE:OBJECT or callables; got {_checks.show(item)}")
        name = item if isinstance(item, str) else str(getattr(item, "__name__", type(item).__name__))
        while key is None and name in chosen and not isinstance(item, str):
            name += "'"
        name = name if key is None else str(key)
        if name in chosen:
            raise ValueError(f"estimators must have different names; {name!r} is there twice")
        if name in REFERENCES and item != name:
            raise ValueError(f"estimators must not be called {name!r}, which is a reference; {_checks.show(item)} is")
        if isinstance(item, str) and item not in REFERENCES and item not in names(needs_target=True):
            look_up_estimator(item)
        chosen[name] = item
    if not chosen:
        raise ValueError("estimators must name at least one; it is empty")
    return chosen


@functools.lru_cache(maxsize=64)
def look_up_estimator(spec: str) -> Estimator:
    """The estimator of a name or of MODULE:OBJECT."""
    if spec == "evaluate":
        return Evaluated()
    if ":" in spec:
        with own_modules():
            own: Estimator = own_estimator(spec)
            return own
    return named_estimators([spec])[spec]


def estimator_of(name: str, given: Any, family: Family) -> Estimator:
    """The estimator of that name on a family; an oracle is told its target."""
    if name in REFERENCES:
        return REFERENCES[name]
    if not isinstance(given, str):
        own: Estimator = given
        return own
    if given in names(needs_target=True):
        return named_estimators([given], family.target)[given]
    return look_up_estimator(given)


# ---- families


@dataclass(frozen=True, eq=False)
class Source:
    """The families of a run at each seed.

    Attributes
    ----------
    given : None (the package's), "module:function", a function of the seed or without parameters, or a mapping
    names : those that are run, in order
    """

    given: Any
    names: tuple[str, ...]

    def family(self, name: str, seed: int) -> Family:
        """One family; ValueError where it is missing, is no Family or cannot be made."""
        every = families_at(self.given, seed)
        if name not in every:
            raise ValueError(f"families must have {name!r} at every seed; at seed {seed} it is missing")
        family = every[name]
        if not isinstance(family, Family):
            raise ValueError(f"family {name!r} must be a Family; it is a {type(family).__name__}")
        return family

    @property
    def label(self) -> str:
        """What a results folder says about it."""
        return "the package's" if self.given is None else self.given if isinstance(self.given, str) else "given"


def choose_families(given: Any, seed: int) -> Source:
    """The source of what a user gave; every family of the first seed is made, so that a bad one is told at once.

    Raises
    ------
    ValueError
        An unknown name; what is no mapping of families; a family that cannot be made (its name and why).
    """
    if isinstance(given, str) and ":" not in given:
        given = [name.strip() for name in given.split(",") if name.strip()]
    if given is None:
        source = Source(None, tuple(families(seed)))
    elif isinstance(given, str | Mapping) or callable(given):
        source = Source(given, tuple(families_at(given, seed)))
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


def families_at(given: Any, seed: int) -> Mapping[str, Family]:
    """The families of one seed; those that have a name are made once a process."""
    return _named_families(given, seed) if given is None or isinstance(given, str) else _call(given, seed)


@functools.lru_cache(maxsize=128)
def _named_families(spec: str | None, seed: int) -> Mapping[str, Family]:
    if spec is None:
        return families(seed, large=True)
    with own_modules():
        return _call(own_object(spec, "families", "my_package.mine:families"), seed)


def _call(given: object, seed: int) -> Mapping[str, Family]:
    """The mapping that a function makes, or a mapping itself."""
    if not isinstance(given, Mapping) and not callable(given):
        raise ValueError(f"families must be names, a function or a mapping; got {_checks.show(given)}")
    every: Any = given
    if not isinstance(given, Mapping):
        every = given(seed) if inspect.signature(given).parameters else given()
    if not isinstance(every, Mapping) or not all(isinstance(name, str) for name in every):
        raise ValueError(f"families must make a mapping name -> Family; they make a {type(every).__name__}")
    return every


def modules_of(objects: Sequence[object]) -> tuple[str, ...]:
    """The modules that hold a user's own objects: their files are part of what the results depend on."""
    modules = set()
    for item in objects:
        if isinstance(item, str):
            name = item.partition(":")[0] if ":" in item else ""
        else:
            name = str(getattr(item, "__module__", "") or getattr(type(item), "__module__", ""))
        if name.split(".")[0] not in ("", "oee_tabular", "__main__", "builtins"):
            modules.add(name)
    return tuple(sorted(modules))
