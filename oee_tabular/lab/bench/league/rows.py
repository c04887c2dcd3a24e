"""Rows of a run, as a league takes them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from oee_tabular._results import conform
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.league.labels import LIKELIHOOD, SIMULATOR

TEXT_COLUMNS = ("family", "families", "estimator", "status")
NUMBER_COLUMNS = (
    *("size", "value", "standard_error", "error", "lower", "upper"),
    *("seconds", "covered", "bound", "truth"),
)


def require_rows(table: pd.DataFrame) -> None:
    """Require the rows of a run: their columns, one of each log, and the references."""
    conform(table, "table", pd.DataFrame)
    wanted = [*TEXT_COLUMNS, *NUMBER_COLUMNS, "seed", "identical"]
    missing = [name for name in wanted if name not in table.columns]
    if missing:
        raise ArgumentError(
            "table", f"must have the columns {', '.join(wanted)}; it lacks {missing[0]}"
        )
    if not len(table) or not table.columns.is_unique:
        raise ArgumentError(
            "table", f"must have rows, and each column once; it has {len(table)} rows"
        )
    for name in NUMBER_COLUMNS:
        try:
            table[name].astype(float)
        except (TypeError, ValueError):
            raise ArgumentError(
                f"table[{name!r}]", f"must be numbers; it is {table[name].dtype}"
            ) from None
    key = ["family", "size", "seed", "estimator"]
    if table.duplicated(key).any():
        row = int(np.argmax(table.duplicated(key)))
        raise ArgumentError(
            "table", f"must have one row for each {', '.join(key)}; row {row} is double"
        )
    for cell, part in table.groupby(["family", "size"], sort=False):
        for reference in (LIKELIHOOD, SIMULATOR):
            if not (part["estimator"] == reference).any():
                raise ArgumentError(
                    "table",
                    f"must have rows of {reference!r} for each family and size; those"
                    f" of {cell} have none",
                )
