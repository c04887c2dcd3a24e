"""From the rows of a run to numbers of each cell (family x size x estimator), and of each estimator over the cells.

RMSE ratios are over the better of two references on the same logs, min(RMSE of maximum likelihood with the simulator in
unobserved pairs, RMSE of the bare simulator), which no estimator can know. Where the target is the simulator they are over
maximum likelihood alone, and those cells are counted apart. A ratio is *surely* above b where the 5% quantile of its paired
bootstrap over the seeds is.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular._checks import Array
from oee_tabular.lab.bench.inputs import LIKELIHOOD, SIMULATOR

N_RESAMPLES = 2000  # of the seeds
LOW = 0.05  # the bootstrap quantile that a sure ratio exceeds
LIMITS = (1.1, 1.5)
TRUSTED_SIZE, TRUSTED_COVER = 3.0, 0.9  # transitions per pair, share of the policy's time: logs whose intervals count
FEW = 10  # logs of a family, below which its coverage is not called the worst


def score(table: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The cells of a run's rows, and the league."""
    cells = pd.DataFrame(
        [
            {"family": family, "size": size, **row}
            for (family, size), part in table.groupby(["family", "size"], sort=False)
            for row in _cell_rows(float(size), part)  # type: ignore[arg-type]
        ]
    )
    names = table["estimator"].unique()
    return cells, pd.DataFrame([_league_row(name, cells[cells["estimator"] == name]) for name in names])


def pivot(frame: pd.DataFrame, index: list[str], values: str) -> pd.DataFrame:
    """A column for each estimator."""
    return frame.pivot(index=index, columns="estimator", values=values)  # noqa: PD010 (the other one drops what is nan)


def _cell_rows(size: float, part: pd.DataFrame) -> list[dict[str, Any]]:
    """One row for each estimator of a cell."""
    errors, lower, upper, seconds = (pivot(part, ["seed"], name) for name in ("error", "lower", "upper", "seconds"))
    facts = part.drop_duplicates("seed").set_index("seed").reindex(errors.index)
    is_identical = bool(facts["identical"].iloc[0])
    is_trusted = (facts["covered"] > TRUSTED_COVER) & (size >= TRUSTED_SIZE)
    likelihood = upper[LIKELIHOOD] - lower[LIKELIHOOD]
    rows = []
    for name in part["estimator"].unique():
        has_value = errors[name].notna()
        squares = {key: errors[key][has_value].to_numpy() ** 2 for key in (name, LIKELIHOOD, SIMULATOR)}
        has_interval = is_trusted & np.isfinite(lower[name]) & np.isfinite(upper[name])
        covers = has_interval & (lower[name] <= facts["truth"]) & (facts["truth"] <= upper[name])
        widths = ((upper[name] - lower[name]) / likelihood)[has_interval & (likelihood > 0)]
        rows.append(
            {"estimator": name, "identical": is_identical, "seeds": len(errors), "failed": int((~has_value).sum()),
             **_ratios(squares, name, is_identical), "over_bound": _over_bound(squares[name], facts["bound"][has_value]),
             "bias": float(errors[name].mean()), "covered": float(facts["covered"].mean()),
             "logs": int(has_interval.sum()), "held": int(covers.sum()), "width": float(widths.median()),
             "seconds": float(seconds[name].median())}
        )  # fmt: skip
    return rows


def _ratios(squares: dict[str, Array], name: str, is_identical: bool) -> dict[str, Any]:
    """RMSE, that of the references, the ratio, and its 5% bootstrap quantile."""
    own, likelihood, simulator = squares[name], squares[LIKELIHOOD], squares[SIMULATOR]
    if len(own) == 0:
        return dict.fromkeys(("rmse", LIKELIHOOD, SIMULATOR, "ratio", "low"), math.nan)
    shares = np.vstack([np.full(len(own), 1 / len(own)), resamples(len(own))])  # all of them first, then the bootstrap
    mine, first, second = (np.sqrt(shares @ errors) for errors in (own, likelihood, simulator))
    reference = first if is_identical else np.minimum(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where((mine == 0) & (reference == 0), 1.0, mine / reference)
    return {
        "rmse": float(mine[0]), LIKELIHOOD: float(first[0]), SIMULATOR: float(second[0]),
        "ratio": float(ratio[0]), "low": float(np.quantile(ratio[1:], LOW, method="lower")),
    }  # fmt: skip


@functools.lru_cache(maxsize=8)
def resamples(seeds: int) -> Array:
    """(resamples, seeds): shares of the seeds in each bootstrap sample, the same for every cell of as many seeds."""
    drawn = np.random.default_rng(seeds).multinomial(seeds, np.full(seeds, 1 / seeds), size=N_RESAMPLES)
    return np.asarray(drawn / seeds)


def _over_bound(squares: Array, bound: pd.Series[float]) -> float:
    """RMSE / sqrt(efficiency bound / n); nan where a bound is infinite or 0."""
    if len(squares) == 0 or not np.isfinite(bound).all() or not bound.mean() > 0:
        return math.nan
    return float(np.sqrt(squares.mean() / bound.mean()))


def _league_row(name: str, cells: pd.DataFrame) -> dict[str, Any]:
    """One estimator over its cells: those of other pairs, then those of identical ones, intervals and time of all."""
    shifted, same = cells[~cells["identical"]], cells[cells["identical"]]
    row = {"estimator": name, "cells": len(cells), **summarize(shifted)}
    row |= {"geo, over bound": geometric_mean(shifted["over_bound"])}
    row |= {"identical: geo": geometric_mean(same["ratio"]), "identical: worst": float(same["ratio"].max())}
    return row | coverage(cells) | {"seconds": float(cells["seconds"].mean()), "failed": int(cells["failed"].sum())}


def summarize(cells: pd.DataFrame) -> dict[str, Any]:
    """Geometric mean, 90% quantile and worst of the ratios, and the shares surely above 1.1 and 1.5."""
    known = cells[cells["ratio"].notna()].reset_index(drop=True)
    if known.empty:
        numbers = ("geo", "q90", "worst", "worst cell", *(f"above {limit:g}" for limit in LIMITS))
        return dict.fromkeys(numbers, math.nan) | {"worst cell": ""}
    worst = known.loc[known["ratio"].to_numpy().argmax()]
    return {
        "geo": geometric_mean(known["ratio"]),
        "q90": float(known["ratio"].quantile(0.9, interpolation="higher")),
        "worst": float(known["ratio"].max()),
        "worst cell": f"{worst['family']} at {worst['size']:g}",
        **{f"above {limit:g}": float((known["low"] > limit).mean()) for limit in LIMITS},
    }


def coverage(cells: pd.DataFrame) -> dict[str, Any]:
    """Of the counted logs: the share whose interval covers the truth, the worst family's, the median relative width."""
    by_family = cells.groupby("family", sort=False)[["logs", "held"]].sum()
    logs, held = by_family.sum()
    enough = by_family[by_family["logs"] >= FEW]
    share = enough["held"] / enough["logs"]
    return {
        "logs": int(logs),
        "coverage": held / logs if logs else math.nan,
        "worst family": str(share.idxmin()) if len(share) else "",
        "its coverage": float(share.min()),
        "width": float(cells["width"].median()),
    }


def geometric_mean(values: object) -> float:
    """exp(mean log), of those that are numbers; nan without any."""
    known = np.asarray(values, dtype=np.float64)
    known = known[~np.isnan(known)]
    if len(known) == 0:
        return math.nan
    with np.errstate(divide="ignore"):
        return float(np.exp(np.log(known).mean()))
