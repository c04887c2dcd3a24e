"""From the rows of a run to numbers of each cell (family x size x estimator), and of each estimator over the cells.

A cell's reference is max(min(RMSE of maximum likelihood, RMSE of the simulator), eff / 2) on the same logs, with
eff = sqrt(efficiency bound / n). A ratio is *surely* above 1.1 where the 5% quantile of its paired bootstrap over the seeds is.

No estimator can know the reference, and none can reach it everywhere; ``floor`` says how near a rule can come that sees the
value alone. Let x be the maximum-likelihood value less the simulator's and b the simulator's error, over eff, so that
x ~ N(b, 1) for large n. A rule delta(x) has the ratio sqrt(E (delta(x) - b)^2) / max(min(|b|, 1), 1/2) at b. No rule has a
ratio below 1.22 at every b (T. Armstrong, P. Kline and L. Sun, Adapting to Misspecification, 2023, arXiv 2305.14265).
``floor(b)`` is the ratio at b of the rule whose worst ratio is least. An estimator that sees more than the value, such as
where the log differs from the simulator, can be below it.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular._checks import Array, BoolArray

LIKELIHOOD, SIMULATOR = "maximum-likelihood", "simulator"  # the references
LEAST = 0.5  # a ratio is over max(min(RMSE of maximum likelihood, simulator's error), LEAST * eff)
ERRORS = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 5.0])
RATIOS = np.array(  # python tests/benchmarks/floor.py
    [1.009, 1.019, 1.048, 1.093, 1.153, 1.224, 1.086, 0.991, 0.922, 0.869, 0.827, 0.933, 1.027, 1.103, 1.160, 1.217, 1.222,
     1.214, 1.224]
)  # fmt: skip
N_RESAMPLES = 2000  # of the seeds
LOW = 0.05  # the bootstrap quantile that a sure ratio exceeds
LIMIT = 1.1
TRUSTED_SIZE = 3.0  # transitions per stochastic pair from which intervals count
TRUSTED_COVER = 0.9  # share of the policy's time above which they do
FEW = 10  # logs of a family, below which its coverage is not called the worst
NORMAL = 1.959963984540054


def score(table: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The cells of a run's rows, and the league."""
    groups = table.groupby(["family", "size"], sort=False)
    cells = pd.DataFrame([row for key, part in groups for row in _cell_rows(key, part)])
    league = [_league_row(part) for _, part in cells.groupby(["families", "estimator"], sort=False)]
    return cells, pd.DataFrame(league)


def wide(frame: pd.DataFrame, index: Any, values: str, columns: Any = "estimator") -> pd.DataFrame:
    """A column for each estimator, or for each value of other ``columns``."""
    return frame.pivot(index=index, columns=columns, values=values)  # noqa: PD010 (the other one drops what is nan)


def _cell_rows(key: Any, part: pd.DataFrame) -> list[dict[str, Any]]:
    """One row for each estimator of a cell."""
    family, size = key
    errors = wide(part, ["seed"], "error")
    first = part.drop_duplicates("seed").set_index("seed").reindex(errors.index)
    eff = np.sqrt(first["bound"].to_numpy())
    is_counted = (first["covered"] > TRUSTED_COVER).to_numpy() & (size >= TRUSTED_SIZE)
    rows = []
    for name, mine in part.groupby("estimator", sort=False):
        mine = mine.set_index("seed").reindex(errors.index)
        known = errors[name].notna().to_numpy()
        squares = (errors[[name, LIKELIHOOD, SIMULATOR]].to_numpy()[known] ** 2).T
        rows.append(
            {
                "family": family,
                "size": size,
                "estimator": name,
                "families": first["families"].iloc[0],
                "identical": bool(first["identical"].iloc[0]),
                "seeds": len(mine),
                "failed": int((~known).sum()),
                **(_ratios(squares, eff[known]) if known.any() else {}),
                "bias": float(errors[name].mean()),
                "covered": float(first["covered"].mean()),
                **_intervals(mine, eff, is_counted),
                "seconds": float(mine["seconds"].median()),
            }
        )
    return rows


def _ratios(squares: Array, eff: Array) -> dict[str, float]:
    """RMSE of all three, their ratios, the 5% bootstrap quantile of the first, the floor at the simulator's error."""
    n = squares.shape[1]
    mean_eff = math.sqrt(float(np.mean(eff**2)))
    least = LEAST * mean_eff if math.isfinite(mean_eff) else 0.0
    samples = np.vstack([np.full(n, 1.0 / n), resamples(n)])
    rmse, likelihood, simulator = (np.sqrt(samples @ own) for own in squares)
    ratio = _divide(rmse, np.maximum(np.minimum(likelihood, simulator), least))
    unit = mean_eff if 0 < mean_eff < math.inf else math.nan
    return {
        "rmse": float(rmse[0]),
        LIKELIHOOD: float(likelihood[0]),
        SIMULATOR: float(simulator[0]),
        "ratio": float(ratio[0]),
        "low": float(np.quantile(ratio[1:], LOW, method="lower")),
        "b": float(simulator[0] / unit),
        "floor": float(floor(simulator[0] / unit)),
        "over_likelihood": float(_divide(rmse[:1], likelihood[:1])[0]),
        "over_eff": float(rmse[0] / unit),
    }


def _divide(own: Array, reference: Array) -> Array:
    """own / reference; 1 where both are 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where((own == 0) & (reference == 0), 1.0, own / reference))


@functools.lru_cache(maxsize=8)
def resamples(seeds: int) -> Array:
    """(resamples, seeds): shares of the seeds in each bootstrap sample, the same for every cell of as many seeds."""
    drawn = np.random.default_rng(seeds).multinomial(seeds, np.full(seeds, 1 / seeds), size=N_RESAMPLES)
    return np.asarray(drawn / seeds)


def _intervals(mine: pd.DataFrame, eff: Array, is_counted: BoolArray) -> dict[str, float]:
    """Of the reported interval and of value +- 1.96 standard errors: logs that count, those covered, width / (2 * 1.96 eff)."""
    half, numbers = NORMAL * mine["standard_error"], dict[str, float]()
    ends = {"": (mine["lower"], mine["upper"]), "se_": (mine["value"] - half, mine["value"] + half)}
    for prefix, (lower, upper) in ends.items():
        here = is_counted & np.isfinite(lower) & np.isfinite(upper)
        relative = ((upper - lower) / (2.0 * NORMAL * eff))[here & (eff > 0) & np.isfinite(eff)]
        numbers[f"{prefix}logs"] = int(here.sum())
        numbers[f"{prefix}held"] = int((here & mine["truth"].between(lower, upper)).sum())
        numbers[f"{prefix}width"] = float(relative.median())
    return numbers


def _league_row(cells: pd.DataFrame) -> dict[str, Any]:
    """One estimator over the cells of one kind of families."""
    known = cells[cells["ratio"].notna()]
    worst = known.iloc[int(known["ratio"].to_numpy().argmax())] if len(known) else None
    sums = cells[["logs", "held", "se_logs", "se_held"]].sum()
    by = cells.groupby("family", sort=False)[["logs", "held"]].sum()
    share = (by["held"] / by["logs"])[by["logs"] >= FEW]
    return {
        "estimator": cells["estimator"].iloc[0],
        "families": cells["families"].iloc[0],
        "cells": len(cells),
        "over reference": geometric_mean(known["ratio"]),
        "floor": geometric_mean(known["floor"]),
        "worst": math.nan if worst is None else float(worst["ratio"]),
        "worst cell": "" if worst is None else f"{worst['family']} at {worst['size']:g}",
        "surely above 1.1": float((known["low"] > LIMIT).mean()),
        "over likelihood": geometric_mean(known["over_likelihood"]),
        "over eff": geometric_mean(known["over_eff"]),
        "logs": int(sums["logs"]),
        "coverage": float(sums["held"] / (sums["logs"] or math.nan)),
        "worst family": str(share.idxmin()) if len(share) else "",
        "its coverage": float(share.min()),
        "width": float(cells["width"].median()),
        "coverage of 1.96 se": float(sums["se_held"] / (sums["se_logs"] or math.nan)),
        "width of 1.96 se": float(cells["se_width"].median()),
        "seconds": float(cells["seconds"].mean()),
        "failed": int(cells["failed"].sum()),
    }


def floor(error: Array) -> Array:
    """The ratio of the best rule where the simulator's error is ``error`` times eff; from 5 on that of 5.

    Examples
    --------
    >>> floor(np.array([0.0, 0.5, 1.0, 3.0, 50.0])).round(2).tolist()
    [1.01, 1.22, 0.83, 1.22, 1.22]
    """
    return np.asarray(np.interp(np.abs(error), ERRORS, RATIOS))


def geometric_mean(values: Any) -> float:
    """exp(mean log), of those that are numbers; nan without any."""
    with np.errstate(divide="ignore"):
        return float(np.exp(np.log(pd.Series(values, dtype=float)).mean()))
