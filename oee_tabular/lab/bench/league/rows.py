"""Rows of a run, of its cells and of its league, as a league takes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from oee_tabular import _checks
from oee_tabular._results import conform
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.league.labels import LIKELIHOOD, SIMULATOR

TEXT_COLUMNS = ("family", "families", "estimator", "status")
NUMBER_COLUMNS = (
    *("size", "value", "standard_error", "error", "lower", "upper"),
    *("seconds", "covered", "bound", "truth"),
)
LOG_KEY = ("family", "size", "seed", "estimator")
CELL_KEY = ("family", "size", "estimator")
LEAGUE_KEY = ("families", "estimator")
# columns of a league's frames, texts and numbers, of which its methods make something;
# what others hold, an older version may have left out
OF_TABLE = (("family", "estimator", "status"), ("size", "value", "error"))
OF_CELLS = (("family", "families", "estimator"), ("size", "rmse", "ratio", "over_eff"))
OF_LEAGUE = (
    ("estimator", "families"),
    (
        *("cells", "over reference", "floor", "worst", "over eff"),
        *("logs", "coverage", "width"),
    ),
)


def require_rows(table: pd.DataFrame) -> None:
    """Require the rows of a run: their columns, one of each log, and the references."""
    conform(table, "table", pd.DataFrame)
    _require_columns(
        table, "table", (*TEXT_COLUMNS, *NUMBER_COLUMNS, "seed", "identical")
    )
    if not len(table):
        raise ArgumentError("table", "must have rows; it has none")
    _require_kinds(table, "table", TEXT_COLUMNS, NUMBER_COLUMNS)
    _require_key(table, "table", LOG_KEY)
    for cell, part in table.groupby(["family", "size"], sort=False):
        for reference in (LIKELIHOOD, SIMULATOR):
            if not (part["estimator"] == reference).any():
                raise ArgumentError(
                    "table",
                    f"must have rows of {reference!r} for each family and size; those"
                    f" of {cell} have none",
                )


def require_frames(
    table: pd.DataFrame, cells: pd.DataFrame, league: pd.DataFrame
) -> None:
    """Require of a league's frames what its texts, scores and pictures are made of.

    Each row of the table must have its cell, and each row of the league its cells.
    """
    frames = {
        "league": (league, OF_LEAGUE, LEAGUE_KEY),
        "cells": (cells, OF_CELLS, CELL_KEY),
        "table": (table, OF_TABLE, LOG_KEY),
    }
    for name, (frame, (texts, numbers), key) in frames.items():
        _require_columns(frame, name, (*key, *texts, *numbers))
        _require_kinds(frame, name, texts, numbers)
        _require_key(frame, name, key)
    _require_known(table, "table", cells, "cells", CELL_KEY)
    _require_known(league, "league", cells, "cells", LEAGUE_KEY)


def _require_columns(frame: pd.DataFrame, name: str, wanted: Sequence[str]) -> None:
    """Require that a frame has these columns, and each of its columns once."""
    for column in wanted:
        if column not in frame:
            raise ArgumentError(
                name,
                f"must have a column {column}; it has"
                f" {', '.join(map(str, frame.columns)) or 'none'}",
            )
    if not frame.columns.is_unique:
        twice = frame.columns[frame.columns.duplicated()][0]
        raise ArgumentError(
            name, f"must have each column once; {_checks.show(twice)} is there twice"
        )


def _require_kinds(
    frame: pd.DataFrame, name: str, texts: Sequence[str], numbers: Sequence[str]
) -> None:
    """Require columns of texts, none missing, and columns of numbers, or nan."""
    for column in texts:
        for k, value in enumerate(frame[column]):
            if not isinstance(value, str):
                raise ArgumentError(
                    f"{name}[{column!r}]",
                    f"must be texts; row {k} is {_checks.show(value)}",
                )
    for column in numbers:
        kind = frame[column].dtype
        if not pd.api.types.is_numeric_dtype(kind) or kind.kind == "c":
            raise ArgumentError(
                f"{name}[{column!r}]",
                f"must be real numbers; it is {kind} (astype(float) makes numbers)",
            )


def _require_key(frame: pd.DataFrame, name: str, key: Sequence[str]) -> None:
    """Require at most one row for each key."""
    is_double = frame.duplicated([*key])
    if is_double.any():
        raise ArgumentError(
            name,
            f"must have one row for each {', '.join(key)}; row"
            f" {int(np.argmax(is_double))} is double",
        )


def _require_known(
    frame: pd.DataFrame, name: str, others: pd.DataFrame, other: str, key: Sequence[str]
) -> None:
    """Require that each key of a frame is one of another frame's."""
    known = pd.MultiIndex.from_frame(others[[*key]])
    is_known = pd.MultiIndex.from_frame(frame[[*key]]).isin(known)
    if not is_known.all():
        k = int(np.argmin(is_known))
        row = frame.iloc[[k]].to_dict("records")[0]
        found = ", ".join(_checks.show(row[column]) for column in key)
        raise ArgumentError(
            name,
            f"must have rows whose {', '.join(key)} are in {other}; row {k}, {found}, is"
            " not",
        )
