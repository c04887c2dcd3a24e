"""Cell of a run: every estimator on the logs of a family and a size."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from oee_tabular._parallel import time_limit
from oee_tabular._sparse import row_sums
from oee_tabular.estimators import Problem
from oee_tabular.estimators.estimate import UNEXPLAINED
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.estimators.off_environment import NORMAL
from oee_tabular.exact import efficiency_bound, occupancy
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.estimators import estimator_of
from oee_tabular.lab.bench.families import HELD, REAL
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.sources import find_family
from oee_tabular.lab.experiment import Cell, Row, Stream


def measure_cell(
    cell: Cell,
    stream: Stream,
    *,
    estimators: Mapping[str, Any],
    source: Any,
    timeout: float,
) -> list[Row]:
    """Measure every estimator on the log of one seed of a family and a size.

    The seed of the family is the run's first seed plus the repetition.
    """
    seed = stream.seed + int(cell["repetition"])
    name = str(cell["family"])
    size = float(cell["size"])
    family = find_family(source, name, seed)
    try:
        number = family.size(size)
    except ArgumentError as error:
        raise ArgumentError("sizes", f"{error.rule}, for the family {name}") from None
    own = Stream(stream.experiment, seed, {"family": name, "size": size})
    problem = family.problem(number, own.generator(use="log"))
    facts = {
        "seed": seed,
        "families": kind_of(name, source),
        **facts_of(family, problem),
    }
    seeds = {key: int(own.sequence(use=key).generate_state(1)[0]) for key in estimators}
    return [
        {
            **facts,
            "estimator": key,
            **measure(key, given, family, problem, seeds[key], timeout),
        }
        for key, given in estimators.items()
    ]


def kind_of(name: str, source: object) -> str:
    """Return how the league marks a family: tuned, held or real.

    Families of a user's own count as held.
    """
    if source is not None or name in HELD:
        return "held"
    return "real" if name in REAL else "tuned"


def facts_of(family: Family, problem: Problem) -> Row:
    """Compute what is known exactly about a log.

    These are the truth, the share of the policy's time that the log covers, the
    efficiency bound / n, and how far the policy is from the recorded one.
    """
    n = len(problem.log)
    horizon = family.horizon
    # Without a discount and a horizon the occupancy may be infinite. An episode's is
    # finite.
    is_endless = horizon is None and family.target.discount == 1.0
    steps = family.length if is_endless else horizon
    time = occupancy(family.target, family.policy, horizon=steps)
    time = np.where(family.target.absorbing()[:, None], 0.0, time)
    observed = row_sums(problem.counts).reshape(time.shape) > 0
    covered = 1.0
    distance = 0.0
    if time.sum() > 0:
        covered = float(time[observed].sum() / time.sum())
        shares = time / time.sum()
        distance = 1.0 - float(np.minimum(shares, family.data_distribution).sum())
    bound = math.inf
    if not is_endless:
        bound = efficiency_bound(
            family.target, family.policy, family.data_distribution, horizon=horizon
        )
    return {
        "n": n,
        "open_rows": family.open_rows,
        "identical": family.identical,
        "truth": family.truth,
        "covered": covered,
        "distance": distance,
        "bound": bound / n if math.isfinite(bound) else math.nan,
    }


def measure(
    name: str,
    given: object,
    family: Family,
    problem: Problem,
    seed: int,
    timeout: float,
) -> Row:
    """Measure what one estimator gives on one log.

    The row has its value, error, interval, seconds and status; an exception is its
    status. The interval is the reported one, else value +- 1.96 standard errors, else
    none.
    """
    row: Row = dict.fromkeys(
        ("value", "error", "standard_error", "lower", "upper", "interval", "seconds"),
        math.nan,
    )
    row |= {"interval": "", "status": "ok"}
    start = time.process_time()
    try:
        with warnings.catch_warnings(), time_limit(timeout):
            warnings.simplefilter("ignore")
            estimate = as_estimator(estimator_of(name, given, family))(
                problem, family.policy, seed=seed
            )
        seconds = time.process_time() - start
        value = float(estimate.value)
        if not math.isfinite(value):
            reason = estimate.status
            if reason in ("ok", UNEXPLAINED):
                reason = f"the value is {value}"
            return row | {"seconds": seconds, "status": reason}
        error = math.nan
        if estimate.standard_error is not None:
            error = float(estimate.standard_error)
        lower = value - NORMAL * error
        upper = value + NORMAL * error
        method = "value +- 1.96 standard errors"
        if estimate.interval is not None:
            lower, upper = (float(end) for end in estimate.interval)
            method = str(estimate.diagnostics.get("interval_method", "reported"))
        elif not math.isfinite(error):
            lower = math.nan
            upper = math.nan
            method = ""
    except Exception as failure:
        return row | {"status": f"{type(failure).__name__}: {failure}"}
    return row | {
        "value": value,
        "error": value - family.truth,
        "standard_error": error,
        "lower": lower,
        "upper": upper,
        "interval": method,
        "seconds": seconds,
        "status": estimate.status,
    }
