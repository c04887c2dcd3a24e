"""The estimators that a run measures, by name, as MODULE:OBJECT or as objects, and the two references beside them."""

from __future__ import annotations

import functools
import math
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular.bench.family import Family
from oee_tabular.estimators import Estimate, Estimator, ModelBased, Problem, Simulator
from oee_tabular.estimators.base import UNEXPLAINED
from oee_tabular.estimators.names import named_estimators, names
from oee_tabular.estimators.off_environment import NORMAL
from oee_tabular.experiments.registry import Row
from oee_tabular.testing.command import own_estimator, own_modules

LIKELIHOOD, SIMULATOR = "maximum-likelihood", "simulator"


@dataclass(frozen=True)
class Evaluated:
    """What ``oee.evaluate`` prints: its value of ``oee`` and the interval beside it."""

    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
        """The printed value and interval of one policy."""
        from oee_tabular.report import evaluate

        report = evaluate(problem, {"policy": policy}, estimators=["oee"], confidence=0.95, seed=seed)
        return report.results[0].estimate


REFERENCES: Mapping[str, Estimator] = {LIKELIHOOD: ModelBased(fallback="simulator"), SIMULATOR: Simulator()}


def chosen_estimators(given: Any) -> dict[str, Any]:
    """Name -> spec or estimator, each tried once; ValueError for a name that is unknown or an object that is none.

    Parameters
    ----------
    given : names, "evaluate", "module:object", estimators, one of these or several; or a mapping name -> one of these
    """
    if isinstance(given, str) or not isinstance(given, Mapping | Sequence):
        given = [given]
    found: dict[str, Any] = {}
    for key, item in given.items() if isinstance(given, Mapping) else [(None, item) for item in given]:
        if not isinstance(item, str) and not callable(item):
            raise ValueError(f"estimators must be names, MODULE:OBJECT or callables; got {item!r}")
        name = str(key) if key is not None else item if isinstance(item, str) else _name_of(item, found)
        if name in found:
            raise ValueError(f"estimators must have different names; {name!r} is there twice")
        found[name] = item
    if not found:
        raise ValueError("estimators must name at least one; it is empty")
    for name, item in found.items():
        if name in REFERENCES and item != name:
            raise ValueError(f"estimators must not be called {name!r}, which is a reference; {item!r} is")
        if isinstance(item, str) and item not in REFERENCES and item not in names(needs_target=True):
            resolved(item)
    return found


def _name_of(item: Any, taken: Mapping[str, Any]) -> str:
    name = str(getattr(item, "__name__", type(item).__name__))
    while name in taken:
        name += "'"
    return name


@functools.lru_cache(maxsize=64)
def resolved(spec: str) -> Estimator:
    """The estimator of a name or of MODULE:OBJECT."""
    if spec == "evaluate":
        return Evaluated()
    if ":" in spec:
        with own_modules():
            made: Estimator = own_estimator(spec)
            return made
    return named_estimators([spec])[spec]


def measure(name: str, given: Any, family: Family, problem: Problem, seed: int) -> Row:
    """The row of one estimator on one log: value, error, interval, seconds, status; what it raises is its status."""
    row: Row = {"estimator": name, "value": math.nan, "error": math.nan, "lower": math.nan, "upper": math.nan,
                "interval": "", "seconds": math.nan, "status": "ok"}  # fmt: skip
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = _estimator(name, given, family)(problem, family.policy, seed=seed)
        seconds = time.process_time() - start
        return row | {"seconds": seconds} | _read(estimate, family.truth)
    except Exception as error:
        return row | {"status": f"{type(error).__name__}: {error}"}


def _estimator(name: str, given: Any, family: Family) -> Estimator:
    if name in REFERENCES:
        return REFERENCES[name]
    if not isinstance(given, str):
        own: Estimator = given
        return own
    if given in names(needs_target=True):
        return named_estimators([given], family.target)[given]
    return resolved(given)


def _read(estimate: Any, truth: float) -> Row:
    """What an estimate says; a value that is no finite number is none."""
    if not isinstance(estimate, Estimate):
        raise TypeError(f"an estimator must return an Estimate; it returned {type(estimate).__name__}")
    value = float(estimate.value)
    if not math.isfinite(value):
        return {"status": estimate.status if estimate.status not in ("ok", UNEXPLAINED) else f"the value is {value}"}
    lower, upper, method = _interval(estimate, value)
    return {"value": value, "error": value - truth, "lower": lower, "upper": upper, "interval": method,
            "status": estimate.status}  # fmt: skip


def _interval(estimate: Estimate, value: float) -> tuple[float, float, str]:
    """The interval that is reported, else value +- 1.96 standard errors, else none."""
    if estimate.interval is not None:
        lower, upper = (float(end) for end in estimate.interval)
        return lower, upper, str(estimate.diagnostics.get("interval_method", "reported"))
    error = estimate.standard_error
    if error is None or not np.isfinite(error):
        return math.nan, math.nan, ""
    return value - NORMAL * error, value + NORMAL * error, "value +- 1.96 standard errors"
