"""Cells of a league: numbers of an estimator over the seeds of a family and a size."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular.lab.bench.league.best_rule import LEAST, floor
from oee_tabular.lab.bench.league.labels import LIKELIHOOD, SIMULATOR
from oee_tabular.typing import Array, BoolArray

N_RESAMPLES = 2000  # of the seeds
# A ratio is surely above SURE_RATIO where this quantile of its bootstrap is.
SURE_QUANTILE = 0.05
# Intervals count on logs of at least so many transitions per stochastic pair that cover
# more than this share of the policy's time.
MIN_INTERVAL_SIZE = 3.0
MIN_INTERVAL_COVER = 0.9
NORMAL = 1.959963984540054


def wide(
    frame: pd.DataFrame,
    index: str | list[str],
    values: str,
    columns: str | list[str] = "estimator",
) -> pd.DataFrame:
    """Pivot a table to a column for each estimator, or each value of ``columns``."""
    # ``pivot_table`` drops what is nan
    return frame.pivot(index=index, columns=columns, values=values)  # noqa: PD010


def cell_rows(key: Any, part: pd.DataFrame) -> list[dict[str, Any]]:
    """Return one row for each estimator of a cell."""
    family, size = key
    errors = wide(part, ["seed"], "error")
    first = part.drop_duplicates("seed").set_index("seed").reindex(errors.index)
    eff = np.sqrt(first["bound"].to_numpy())
    is_counted = (first["covered"] > MIN_INTERVAL_COVER).to_numpy() & (
        size >= MIN_INTERVAL_SIZE
    )
    is_far_known = "distance" in first
    rows = []
    for name, mine in part.groupby("estimator", sort=False):
        mine = mine.set_index("seed").reindex(errors.index)
        known = errors[name].notna().to_numpy()
        squares = (errors[[name, LIKELIHOOD, SIMULATOR]].to_numpy()[known] ** 2).T
        ratios = {}
        if known.any():
            ratios = _ratios(squares, eff[known])
        rows.append(
            {
                "family": family,
                "size": size,
                "estimator": name,
                "families": first["families"].iloc[0],
                "identical": bool(first["identical"].iloc[0]),
                "seeds": len(mine),
                "failed": int((~known).sum()),
                **ratios,
                "bias": float(errors[name].mean()),
                "covered": float(first["covered"].mean()),
                "distance": float(
                    first["distance"].mean() if is_far_known else math.nan
                ),
                **_intervals(mine, eff, is_counted),
                "seconds": float(mine["seconds"].dropna().median()),
            }
        )
    return rows


def _ratios(squares: Array, eff: Array) -> dict[str, float]:
    """Compute the RMSE of an estimator and of both references, and their ratios.

    ``squares`` (3, seeds) are squared errors. ``low`` is the 5% bootstrap quantile of
    the estimator's ratio, ``ratio_error`` its standard error as a share of it (as
    ``rmse_error`` of the RMSE), ``floor`` the floor at the simulator's error.
    """
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
        "low": float(np.quantile(ratio[1:], SURE_QUANTILE, method="lower")),
        "ratio_error": _spread_of_log(ratio[1:], n),
        "rmse_error": _spread_of_log(rmse[1:], n),
        "b": float(simulator[0] / unit),
        "floor": float(floor(simulator[0] / unit)),
        "over_likelihood": float(_divide(rmse, likelihood)[0]),
        "over_eff": float(rmse[0] / unit),
    }


def _spread_of_log(samples: Array, n: int) -> float:
    """Return the standard error of a positive number, as a share of it.

    It is the standard deviation of its logarithm over bootstrap samples of ``n`` seeds;
    nan where there is one seed, or a sample is 0 or infinite.
    """
    is_number = (samples > 0) & np.isfinite(samples)
    if n < 2 or not is_number.all():
        return math.nan
    return float(np.log(samples).std())


def _divide(own: Array, reference: Array) -> Array:
    """Divide own by reference, with the ratio 1 where both are 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where((own == 0) & (reference == 0), 1.0, own / reference))


@functools.lru_cache(maxsize=8)
def resamples(seeds: int) -> Array:
    """Return the shares of the seeds in each bootstrap sample, (resamples, seeds).

    They are the same for every cell of as many seeds.
    """
    drawn = np.random.default_rng(seeds).multinomial(
        seeds, np.full(seeds, 1 / seeds), size=N_RESAMPLES
    )
    return np.asarray(drawn / seeds)


def _intervals(
    mine: pd.DataFrame, eff: Array, is_counted: BoolArray
) -> dict[str, float]:
    """Count the logs whose intervals cover the truth, and measure the widths.

    Both the reported interval and value +- 1.96 standard errors have the number of logs
    that count, how many of them cover the truth, and the median width / (2 * 1.96 eff).
    """
    half = NORMAL * mine["standard_error"]
    numbers = dict[str, float]()
    ends = {
        "": (mine["lower"], mine["upper"]),
        "se_": (mine["value"] - half, mine["value"] + half),
    }
    for prefix, (lower, upper) in ends.items():
        here = is_counted & np.isfinite(lower) & np.isfinite(upper)
        is_measured = here & (eff > 0) & np.isfinite(eff)
        relative = ((upper - lower) / (2.0 * NORMAL * eff))[is_measured]
        covers = here & mine["truth"].between(lower, upper)
        numbers[f"{prefix}logs"] = int(here.sum())
        numbers[f"{prefix}held"] = int(covers.sum())
        numbers[f"{prefix}width"] = float(relative.dropna().median())
    return numbers
