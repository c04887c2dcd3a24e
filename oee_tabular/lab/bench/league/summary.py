"""Summary of cells: a league's row for each estimator and kind of families."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

SURE_RATIO = 1.1
OVER = "over likelihood"
# A policy is near the recorded one, or far, by the total variation between the shares
# of state-action pairs of both in the target.
NEAR = 0.3
FAR = 0.5
MIN_FAMILY_LOGS = 10  # below it a family's coverage is not called the worst


def league_of_cells(cells: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each estimator and kind of families, over their cells."""
    groups = cells.groupby(["families", "estimator"], sort=False)
    return pd.DataFrame([_league_row(part) for _, part in groups])


def _league_row(cells: pd.DataFrame) -> dict[str, Any]:
    """Summarize one estimator over the cells of one kind of families."""
    known = cells[cells["ratio"].notna()]
    worst = None
    if len(known):
        worst = known.iloc[int(known["ratio"].to_numpy().argmax())]
    worst_ratio = math.nan
    worst_cell = ""
    if worst is not None:
        worst_ratio = float(worst["ratio"])
        worst_cell = f"{worst['family']} at {worst['size']:g}"
    sums = cells[["logs", "held", "se_logs", "se_held"]].sum()
    by = cells.groupby("family", sort=False)[["logs", "held"]].sum()
    share = (by["held"] / by["logs"])[by["logs"] >= MIN_FAMILY_LOGS]
    return {
        "estimator": cells["estimator"].iloc[0],
        "families": cells["families"].iloc[0],
        "cells": len(cells),
        "over reference": geometric_mean(known["ratio"]),
        "floor": geometric_mean(known["floor"]),
        "worst": worst_ratio,
        "worst cell": worst_cell,
        "surely above 1.1": float((known["low"] > SURE_RATIO).mean()),
        OVER: geometric_mean(known["over_likelihood"]),
        "over eff": geometric_mean(known["over_eff"]),
        **_by_distance(known),
        "logs": int(sums["logs"]),
        "coverage": float(sums["held"] / (sums["logs"] or math.nan)),
        "worst family": str(share.idxmin()) if len(share) else "",
        "its coverage": float(share.min()),
        "width": float(cells["width"].dropna().median()),
        "coverage of 1.96 se": float(sums["se_held"] / (sums["se_logs"] or math.nan)),
        "width of 1.96 se": float(cells["se_width"].dropna().median()),
        "seconds": float(cells["seconds"].mean()),
        "failed": int(cells["failed"].sum()),
    }


def _by_distance(cells: pd.DataFrame) -> dict[str, float]:
    """Return "over likelihood" of policies near the recorded one, far, and between."""
    distance = cells.get("distance", pd.Series(math.nan, cells.index))
    groups = {
        f"{OVER}, near": distance < NEAR,
        f"{OVER}, between": distance.between(NEAR, FAR, inclusive="left"),
        f"{OVER}, far": distance >= FAR,
    }
    return {
        label: geometric_mean(cells["over_likelihood"][is_here])
        for label, is_here in groups.items()
    }


def geometric_mean(values: pd.Series[float]) -> float:
    """Compute exp(mean log) of the values that are numbers.

    It is nan without any, and where one of them is 0: such a mean would be 0 whatever
    the others are.
    """
    numbers = pd.Series(values, dtype=float)
    if (numbers == 0).any():
        return math.nan
    return float(np.exp(np.log(numbers).mean()))


def league_errors(cells: pd.DataFrame, league: pd.DataFrame) -> pd.DataFrame:
    """Compute standard errors of a league's numbers, over the seeds of its cells."""
    keys = ["families", "estimator"]
    # cells that an older version wrote have no errors
    own = {"ratio_error": math.nan, "rmse_error": math.nan, **cells}
    known_cells = pd.DataFrame(own)
    groups = dict(iter(known_cells.groupby(keys, sort=False)))
    rows = []
    for row in league.to_dict("records"):
        part = groups[row["families"], row["estimator"]]
        known = part[part["ratio"].notna()]
        worst = math.nan
        if len(known):
            worst = float(
                known["ratio_error"].iloc[int(known["ratio"].to_numpy().argmax())]
            )
        share = row["coverage"]
        rows.append(
            {
                "over reference": row["over reference"]
                * _error_of_mean(known["ratio_error"]),
                "worst": row["worst"] * worst,
                "over eff": row["over eff"]
                * _error_of_mean(part["rmse_error"][part["over_eff"].notna()]),
                "coverage": math.sqrt(share * (1 - share) / row["logs"])
                if row["logs"]
                else math.nan,
            }
        )
    return pd.DataFrame(rows, index=league.index)


def _error_of_mean(errors: pd.Series[float]) -> float:
    """Return the standard error of a geometric mean, as a share of it.

    ``errors`` are those of the independent numbers, as shares of them.
    """
    if not len(errors):
        return math.nan
    return float(np.sqrt((errors.to_numpy() ** 2).sum())) / len(errors)
