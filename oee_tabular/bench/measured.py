"""The rows of a cell: every estimator on one log of a family, and what is known exactly about the log."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular._sparse import row_sums
from oee_tabular.bench.family import Family
from oee_tabular.bench.given import Source, estimator_of
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import UNEXPLAINED
from oee_tabular.estimators.off_environment import NORMAL
from oee_tabular.exact import efficiency_bound, occupancy
from oee_tabular.experiments.registry import Cell, Row, Stream


@dataclass(frozen=True, eq=False)
class Cells:
    """The rows of one cell: a log of a family, every estimator on it."""

    estimators: Mapping[str, Any]
    source: Source

    def __call__(self, cell: Cell, stream: Stream) -> list[Row]:
        """One seed of family x size; the seed of the family is the run's first plus the repetition."""
        seed, name, size = stream.seed + int(cell["repetition"]), str(cell["family"]), float(cell["size"])
        family = self.source.family(name, seed)
        own = Stream(stream.experiment, seed, {"family": name, "size": size})
        problem = family.problem(family.size(size), own.generator(use="log"))
        facts = {"seed": seed, **facts_of(family, problem)}
        return [
            facts | measure(key, given, family, problem, int(own.sequence(use=key).generate_state(1)[0]))
            for key, given in self.estimators.items()
        ]


def facts_of(family: Family, problem: Problem) -> Row:
    """What is known exactly about a log: truth, the share of the policy's time that it covers, efficiency bound / n."""
    n, horizon = len(problem.log), family.horizon
    endless = horizon is None and family.target.discount == 1.0
    time = occupancy(family.target, family.policy, horizon=family.length if endless else horizon)
    time = np.where(family.target.absorbing()[:, None], 0.0, time)
    seen = row_sums(problem.counts).reshape(time.shape) > 0
    bound = np.inf
    if not endless:
        bound = efficiency_bound(family.target, family.policy, family.data_distribution, horizon=horizon)
    return {
        "n": n,
        "open_rows": family.open_rows,
        "identical": family.identical,
        "truth": family.truth,
        "covered": float(time[seen].sum() / time.sum()) if time.sum() > 0 else 1.0,
        "bound": bound / n if np.isfinite(bound) else float("nan"),
    }


def measure(name: str, given: Any, family: Family, problem: Problem, seed: int) -> Row:
    """The row of one estimator on one log: value, error, interval, seconds, status; what it raises is its status."""
    row: Row = {"estimator": name, "value": math.nan, "error": math.nan, "lower": math.nan, "upper": math.nan,
                "interval": "", "seconds": math.nan, "status": "ok"}  # fmt: skip
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = estimator_of(name, given, family)(problem, family.policy, seed=seed)
        seconds = time.process_time() - start
        return row | {"seconds": seconds} | _read(estimate, family.truth)
    except Exception as error:
        return row | {"status": f"{type(error).__name__}: {error}"}


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
