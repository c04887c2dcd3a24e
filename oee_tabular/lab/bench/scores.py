"""From the rows of a run to numbers of each cell (family x size x estimator), and of each estimator over the cells.

RMSE ratios are over the better of two references on the same logs: min(RMSE of maximum likelihood with the simulator in unseen
rows, RMSE of the bare simulator), which no estimator can know; where the target is the simulator, over maximum likelihood
alone, and those cells are counted apart. A ratio is *surely* above b where the 5% quantile of its paired bootstrap over the
seeds is.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular._checks import Array
from oee_tabular.lab.bench.given import LIKELIHOOD, REFERENCES, SIMULATOR

RESAMPLES = 2000  # of the seeds
LOW = 0.05  # the bootstrap quantile that a sure ratio exceeds
LIMITS = (1.1, 1.5)
TRUSTED_SIZE, TRUSTED_COVER = (
    3.0,
    0.9,
)  # moves per open row, and share of the policy's time: logs whose intervals are counted
FEW = 10  # logs of a family, below which its coverage is not called the worst


def scored(table: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The cells of a run's rows, and the league."""
    cells = pd.DataFrame(
        [
            row
            for (family, size), part in table.groupby(["family", "size"], sort=False)
            for row in _cell_rows(str(family), float(size), part)  # type: ignore[arg-type]
        ]
    )
    names = list(dict.fromkeys(table["estimator"]))
    return cells, pd.DataFrame([_league_row(name, cells[cells["estimator"] == name]) for name in names])


def _cell_rows(family: str, size: float, part: pd.DataFrame) -> list[dict[str, Any]]:
    """One row for each estimator of a cell."""
    errors, lower, upper = (wide(part, ["seed"], column) for column in ("error", "lower", "upper"))
    identical = bool(part["identical"].iloc[0])
    first = part.drop_duplicates("seed").set_index("seed").reindex(errors.index)
    counted = (first["covered"] > TRUSTED_COVER).to_numpy() & (size >= TRUSTED_SIZE)
    rows = []
    for name in dict.fromkeys(part["estimator"]):
        mine = part[part["estimator"] == name]
        found = errors[name].notna().to_numpy()
        squares = {key: errors[key].to_numpy()[found] ** 2 for key in {name, *REFERENCES}}
        interval = _interval(
            lower[name].to_numpy(), upper[name].to_numpy(), first["truth"].to_numpy(),
            (upper[LIKELIHOOD] - lower[LIKELIHOOD]).to_numpy(), counted,
        )  # fmt: skip
        rows.append(
            {"family": family, "size": size, "estimator": name, "identical": identical, "seeds": len(mine),
             "failed": int((~found).sum()), **_ratios(squares, name, identical),
             "over_bound": _over_bound(squares[name], first["bound"].to_numpy()[found]),
             "bias": float(errors[name].mean()), "covered": float(first["covered"].mean()), **interval,
             "seconds": float(mine["seconds"].dropna().median())}
        )  # fmt: skip
    return rows


def wide(frame: pd.DataFrame, index: list[str], values: str) -> pd.DataFrame:
    """A column for each estimator."""
    return frame.pivot(index=index, columns="estimator", values=values)  # noqa: PD010 (the other one drops what is nan)


def _ratios(squares: dict[str, Array], name: str, identical: bool) -> dict[str, Any]:
    """RMSE, that of the references, the ratio, and its 5% bootstrap quantile."""
    own, likelihood, simulator = squares[name], squares[LIKELIHOOD], squares[SIMULATOR]
    if len(own) == 0:
        return dict.fromkeys(("rmse", LIKELIHOOD, SIMULATOR, "ratio", "low"), math.nan)
    weights = resamples(len(own))
    boot = [_rmse(values, weights) for values in (own, likelihood, simulator)]
    rmse = [_rmse(values, np.full((1, len(own)), 1 / len(own))) for values in (own, likelihood, simulator)]
    ratio, low = (_over(part[0], part[1] if identical else np.minimum(part[1], part[2])) for part in (rmse, boot))
    return {
        "rmse": float(rmse[0][0]), LIKELIHOOD: float(rmse[1][0]), SIMULATOR: float(rmse[2][0]),
        "ratio": float(ratio[0]), "low": float(np.quantile(low, LOW, method="lower")),
    }  # fmt: skip


def _rmse(squares: Array, weights: Array) -> Array:
    return np.asarray(np.sqrt(weights @ squares))


def _over(own: Array, reference: Array) -> Array:
    """own / reference; 1 where both are 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where((own == 0) & (reference == 0), 1.0, own / reference))


@functools.lru_cache(maxsize=8)
def resamples(seeds: int) -> Array:
    """(resamples, seeds): shares of the seeds in each bootstrap sample, the same for every cell of as many seeds."""
    drawn = np.random.default_rng(seeds).multinomial(seeds, np.full(seeds, 1 / seeds), size=RESAMPLES)
    return np.asarray(drawn / seeds)


def _over_bound(squares: Array, bound: Array) -> float:
    """RMSE / sqrt(efficiency bound / n); nan where a bound is infinite or 0."""
    if len(squares) == 0 or not np.isfinite(bound).all() or not bound.mean() > 0:
        return math.nan
    return float(np.sqrt(squares.mean() / bound.mean()))


def _interval(lower: Array, upper: Array, truth: Array, likelihood: Array, counted: object) -> dict[str, Any]:
    """Logs whose interval is counted, how many hold the truth, and the median width over maximum likelihood's 1.96 se."""
    here = counted & np.isfinite(lower) & np.isfinite(upper)
    holds = here & (lower <= truth) & (truth <= upper)
    known = here & (likelihood > 0)
    width = float(np.median((upper - lower)[known] / likelihood[known])) if known.any() else math.nan
    return {"logs": int(here.sum()), "held": int(holds.sum()), "width": width}


def _league_row(name: str, cells: pd.DataFrame) -> dict[str, Any]:
    """One estimator over its cells: those of other pairs, then those of identical ones, intervals and time of all."""
    shifted, same = cells[~cells["identical"]], cells[cells["identical"]]
    row = {"estimator": name, "cells": len(cells), **summary(shifted)}
    row |= {"geo, over bound": geometric_mean(shifted["over_bound"])}
    row |= {"identical: geo": geometric_mean(same["ratio"]), "identical: worst": _largest(same["ratio"])}
    return row | coverage(cells) | {"seconds": float(cells["seconds"].mean()), "failed": int(cells["failed"].sum())}


def summary(cells: pd.DataFrame) -> dict[str, Any]:
    """Geometric mean, 90% quantile and worst of the ratios, and the shares surely above 1.1 and 1.5."""
    known = cells[cells["ratio"].notna()]
    worst = known.iloc[int(known["ratio"].to_numpy().argmax())] if len(known) else None
    return {
        "geo": geometric_mean(known["ratio"]),
        "q90": float(known["ratio"].quantile(0.9, interpolation="higher")) if len(known) else math.nan,
        "worst": math.nan if worst is None else float(worst["ratio"]),
        "worst cell": "" if worst is None else f"{worst['family']} at {worst['size']:g}",
        **{f"above {limit:g}": float((known["low"] > limit).mean()) if len(known) else math.nan for limit in LIMITS},
    }


def coverage(cells: pd.DataFrame) -> dict[str, Any]:
    """Of the counted logs: the share whose interval holds the truth, the worst family's, the median relative width."""
    logs, held = int(cells["logs"].sum()), int(cells["held"].sum())
    by = cells.groupby("family", sort=False)[["logs", "held"]].sum()
    enough = by[by["logs"] >= FEW]
    share = enough["held"] / enough["logs"]
    return {
        "logs": logs,
        "coverage": held / logs if logs else math.nan,
        "worst family": str(share.idxmin()) if len(share) else "",
        "its coverage": float(share.min()) if len(share) else math.nan,
        "width": float(cells["width"].median()) if cells["width"].notna().any() else math.nan,
    }


def geometric_mean(values: object) -> float:
    """exp(mean log), of those that are numbers; nan without any."""
    known = np.asarray(values, dtype=np.float64)
    known = known[~np.isnan(known)]
    if len(known) == 0:
        return math.nan
    with np.errstate(divide="ignore"):
        return float(np.exp(np.log(known).mean()))


def _largest(values: pd.Series[float]) -> float:
    return float(values.max()) if values.notna().any() else math.nan
