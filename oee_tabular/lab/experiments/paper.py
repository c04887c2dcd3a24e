"""The paper's published figures as numbers (``paper.csv``: mean and band of each point; some curves were never published)."""

from __future__ import annotations

import functools
from pathlib import Path

import pandas as pd


@functools.cache
def published() -> pd.DataFrame:
    """figure, setting, series, x, mean, lo, hi."""
    return pd.read_csv(Path(__file__).with_name("paper.csv"))


def curve(figure: str, setting: str, series: str) -> pd.DataFrame:
    """The points of one curve, by x; empty where it was not published."""
    table = published()
    points = table[(table.figure == figure) & (table.setting == setting) & (table.series == series)]
    return points.sort_values("x").reset_index(drop=True)


def at(figure: str, setting: str, series: str, x: float) -> float:
    """The mean at one point; nan where none was published."""
    return float(curve(figure, setting, series).set_index("x")["mean"].get(x, float("nan")))
