"""Texts of a league: what is printed, the page of markdown and the LaTeX table."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from oee_tabular.lab.bench.league.pictures import PICTURES
from oee_tabular.lab.experiment import pipe_table

SHARES = ("surely above 1.1", "coverage", "its coverage", "coverage of 1.96 se")
EXPLAINED = (
    "A ratio is the RMSE over max(min(RMSE of maximum likelihood, RMSE of the"
    " simulator), eff / 2) on the same logs, where eff = sqrt(efficiency bound / n) and"
    " maximum likelihood has the simulator in unrecorded pairs. `over reference`:"
    " geometric mean of the ratios over cells (family x size). `floor`: the same of the"
    " best rule that sees the value alone. `surely above 1.1`: share of cells where the"
    " 5% quantile of the paired bootstrap over the seeds is above 1.1. `over"
    " likelihood`, `over eff`: RMSE over maximum likelihood's, over eff; `near`,"
    " `between`, `far`: of families whose policy is less than 0.3 from the recorded"
    " one, from 0.3 to 0.5, and farther, as the total variation between the shares of"
    " state-action pairs. `coverage`,"
    " `width`: of the reported interval, over logs of at least 3 transitions per"
    " stochastic pair that cover more than 90% of the policy's time; widths are over 2"
    " x 1.96 eff. `of 1.96 se`: of value +- 1.96 standard errors. `seconds`: processor"
    " time of one log. `else` in a name: what stands for unrecorded pairs, the"
    " simulator's transitions, a state that stays as it is, or Q = 0. A mean is empty"
    " where the estimator is exactly right in a cell. Tuned families are those on which"
    " a constant of the default was chosen; in real ones the simulator and the target"
    " are both measured."
)


def league_text(league: pd.DataFrame, failed: pd.DataFrame) -> str:
    """Return the league as a table, what it means, and why values are missing."""
    league = league.astype(object)
    for column in league.columns[2:]:
        form = "{:.0%}" if column in SHARES else "{:.3g}"
        texts = (
            form.format(x) if isinstance(x, float) else str(x) for x in league[column]
        )
        league[column] = np.where(league[column].isna(), "", list(texts))
    tables = []
    for kind, part in league.groupby("families", sort=False):
        columns = part.drop(columns="families").set_index("estimator")
        tables.append(f"{kind} families\n{columns.T.to_string()}")
    parts = [*tables, EXPLAINED]
    missing = [
        f"{row.estimator}: no value on {row.logs} logs: {row.status}"
        for row in failed.itertuples()
    ]
    if missing:
        parts.append("\n".join(missing))
    return "\n\n".join(parts)


def count_failures(table: pd.DataFrame) -> pd.DataFrame:
    """Count the rows without a value by estimator and status."""
    lost = table[table["value"].isna()]
    return (
        lost.groupby(["estimator", "status"], sort=False)
        .size()
        .rename("logs")
        .reset_index()
    )


def league_page(
    league: pd.DataFrame, failed: pd.DataFrame, about: Mapping[str, str], command: str
) -> str:
    """Return the league as a page of markdown, with links to its pictures."""
    parts = ["# Estimators on families of environment shift"]
    if command:
        parts.append(f"`{command}`")
    for kind, part in league.groupby("families", sort=False):
        table = (
            part.drop(columns="families")
            .set_index("estimator")
            .T.reset_index(names="measure")
        )
        parts += [f"## {str(kind).capitalize()} families", pipe_table(table)]
    parts.append(EXPLAINED)
    parts += [f"![{text}]({name}.png)" for name, text in PICTURES.items()]
    if len(failed):
        parts += ["## Without a value", pipe_table(failed)]
    if about:
        frame = pd.DataFrame(
            {
                "family": list(about),
                "what the simulator has wrong": list(about.values()),
            }
        )
        parts += ["## Families", pipe_table(frame)]
    return "\n\n".join(parts) + "\n"


def league_latex(league: pd.DataFrame, errors: pd.DataFrame) -> str:
    """Return the league as a LaTeX table (booktabs), errors in parentheses."""
    shown = [
        "estimator",
        "families",
        "cells",
        "over reference",
        "floor",
        "worst",
        "over eff",
        "coverage",
        "width",
    ]
    texts = league[shown].astype(object)
    for name in errors:
        texts[name] = [
            _with_error(value, error)
            for value, error in zip(league[name], errors[name], strict=True)
        ]
    return texts.rename(columns=str.capitalize).to_latex(
        index=False,
        escape=True,  # of names and labels, which are plain text
        na_rep="--",
        float_format="%.2f",
        column_format="llrrrrrrr",  # two columns of text, seven of numbers
    )


def _with_error(value: float, error: float) -> str:
    """Write a number with its standard error in parentheses, if there is one."""
    if math.isnan(value):
        return "--"
    return f"{value:.2f}" + ("" if math.isnan(error) else f" ({error:.2f})")
