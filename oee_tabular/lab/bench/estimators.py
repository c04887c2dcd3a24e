"""Estimators of a run: as they are given, looked up, and told the target."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from oee_tabular import _checks
from oee_tabular._arguments import own_modules
from oee_tabular.estimators import Estimate, Estimator, ModelBased, Problem, Simulator
from oee_tabular.estimators.names import named_estimators
from oee_tabular.estimators.names import names as estimator_names
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.league import LIKELIHOOD, SIMULATOR
from oee_tabular.testing import own_estimator
from oee_tabular.typing import PolicyLike, SeedNumbers

# An estimator is given by name, or as a callable as in ``oee.testing``.
EstimatorLike: TypeAlias = str | Callable[..., Any]
EstimatorsLike: TypeAlias = (
    EstimatorLike | Sequence[EstimatorLike] | Mapping[str, EstimatorLike]
)
REFERENCES: Mapping[str, Estimator] = {
    LIKELIHOOD: ModelBased(fallback="simulator"),
    SIMULATOR: Simulator(),
}


def choose_estimators(given: Any) -> dict[str, Any]:
    """Return name -> name or estimator of what ``run`` takes, each looked up once.

    Raises ValueError for what is no estimator.
    """
    if isinstance(given, str):
        given = split(given)
    elif not isinstance(given, Mapping | Sequence):
        given = [given]
    named: Iterable[tuple[Any, Any]]
    if isinstance(given, Mapping):
        named = given.items()
    else:
        named = [(None, item) for item in given]
    chosen: dict[str, Any] = {}
    for key, item in named:
        if not isinstance(item, str) and not callable(item):
            raise ArgumentError(
                "estimators",
                f"must be names, MODULE:OBJECT or callables; got {_checks.show(item)}",
            )
        name = item
        if key is not None:
            name = str(key)
        elif not isinstance(item, str):
            name = str(getattr(item, "__name__", type(item).__name__))
        while key is None and name in chosen and not isinstance(item, str):
            name += "'"
        if name in chosen:
            raise ArgumentError(
                "estimators", f"must have different names; {name!r} is there twice"
            )
        if name in REFERENCES and item != name:
            raise ArgumentError(
                "estimators",
                f"must not be called {name!r}, which is a reference;"
                f" {_checks.show(item)} is",
            )
        # An oracle needs the family's target; references need no look-up.
        special = (*REFERENCES, *estimator_names(needs_target=True))
        if isinstance(item, str) and item not in special:
            look_up_estimator(item)
        chosen[name] = item
    if not chosen:
        raise ArgumentError("estimators", "must name at least one; it is empty")
    return chosen


def split(text: str) -> list[str]:
    """Return the words between commas."""
    return [word.strip() for word in text.split(",") if word.strip()]


def estimator_of(name: str, given: Any, family: Family) -> Any:
    """Return the estimator of a name on a family.

    An oracle is told the family's target.
    """
    if name in REFERENCES or not isinstance(given, str):
        return REFERENCES.get(name, given)
    if given in estimator_names(needs_target=True):
        return named_estimators([given], family.target)[given]
    return look_up_estimator(given)


@functools.lru_cache(maxsize=64)
def look_up_estimator(spec: str) -> Any:
    """Return the estimator of a name, or of MODULE:OBJECT."""
    if spec.partition(":")[2]:
        with own_modules():
            return own_estimator(spec)
    if spec == "evaluate":
        return evaluate_as_printed
    (estimator,) = named_estimators([spec]).values()
    return estimator


def evaluate_as_printed(
    problem: Problem, policy: PolicyLike, *, seed: SeedNumbers = None
) -> Estimate:
    """Return the value of ``oee`` and the interval that ``oee.evaluate`` prints."""
    from oee_tabular.report import evaluate

    report = evaluate(
        problem, {"policy": policy}, estimators=["oee"], confidence=0.95, seed=seed
    )
    return report.results[0].estimate
