"""The paper's published figures as numbers (``paper.csv``: mean and band of each point; some curves were never published)."""

from __future__ import annotations

import functools
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd


@functools.cache
def published() -> pd.DataFrame:
    """figure, setting, series, x, mean, lo, hi."""
    import pandas as pd

    with resources.files("oee_tabular.lab.experiments").joinpath("paper.csv").open() as handle:
        return pd.read_csv(handle)


def curve(figure: str, setting: str, series: str) -> pd.DataFrame:
    """The points of one curve, by x; empty where it was not published."""
    table = published()
    found = table[(table.figure == figure) & (table.setting == setting) & (table.series == series)]
    return found.sort_values("x").reset_index(drop=True)


def at(figure: str, setting: str, series: str, x: float) -> float:
    """The mean at one point; nan where none was published."""
    points = curve(figure, setting, series)
    near = points[np.isclose(points.x, x)]
    return float(near["mean"].iloc[0]) if len(near) else float("nan")
