"""The league of a run: its tables as text, JSON, LaTeX, a page and pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from oee_tabular import _files
from oee_tabular.lab.bench.inputs import REFERENCES
from oee_tabular.lab.bench.scores import coverage, geometric_mean, score, summarize
from oee_tabular.lab.output import draw_bytes, pipe_table
from oee_tabular.lab.store import refuse_links
from oee_tabular.plots.style import DIVERGING, INK, disable_math, series, shorten
from oee_tabular.report.results import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REACH = 3.0  # powers of two on either side of 1 that the heat map's colours tell apart
PARTING = 3.0  # sizes below it, and from it on, are stated apart
SHARES = ("above 1.1", "above 1.5", "coverage", "its coverage")  # columns that are printed in per cent
TEX = str.maketrans({char: f"\\{char}" for char in "&%$#_{}"} | {"\\": r"\textbackslash{}", "~": r"\~{}", "^": r"\^{}"})
EXPLAINED = (
    "RMSE over the better of maximum likelihood (the simulator in unobserved pairs) and the bare simulator on the same logs, "
    "over cells (family x size): geometric mean (geo), 90% quantile, worst; share of cells whose ratio is surely above 1.1, "
    "1.5 (the 5% quantile of the paired bootstrap over the seeds is). `geo, over bound`: over the square root of the "
    "efficiency bound / n. Where the target is the simulator (identical): over maximum likelihood alone. Coverage and width "
    "of the interval that the estimator reports, over logs of at least 3 transitions per stochastic state-action pair that "
    "observe more than 90% of the policy's time; width over that of maximum likelihood's value +- 1.96 standard errors. "
    "Seconds: of one log, processor time."
)


@dataclass(frozen=True, eq=False)
class League:
    """What a run found.

    Attributes
    ----------
    table : DataFrame, a row for each family, size, seed and estimator
    cells : DataFrame, a row for each family, size and estimator, over the seeds
    league : DataFrame, a row for each estimator, over the cells

    Examples
    --------
    >>> import oee_tabular as oee
    >>> found = oee.bench.run("oee", families=["machine"], sizes=[3, 10], seeds=3)
    >>> sorted(found.cells["size"].unique().tolist()), found.statement()["oee"]["sizes of 3 and more"]["cells"]
    ([3.0, 10.0], 2)
    """

    table: pd.DataFrame
    cells: pd.DataFrame
    league: pd.DataFrame

    def __repr__(self) -> str:
        return f"League({len(self.league)} estimators, {len(self.cells)} cells, {len(self.table)} rows)"

    def __str__(self) -> str:
        """The league table, what it means, and why estimators had no value."""
        failed = [
            f"{row.estimator}: no value on {row.logs} logs: {row.status}" for row in self._failures().itertuples()
        ]
        table = self._written().set_index("estimator").T.to_string()
        return "\n".join([table, "", EXPLAINED, *(["", *failed] if failed else [])])

    def _written(self) -> pd.DataFrame:
        """The league with numbers as people read them."""
        written = self.league.copy()
        for column in written.columns[1:]:
            form = "{:.0%}" if column in SHARES else "{:.3g}"
            written[column] = [
                "" if isinstance(x, float) and math.isnan(x) else form.format(x) if isinstance(x, float) else str(x)
                for x in written[column]
            ]
        return written

    def _failures(self) -> pd.DataFrame:
        """(estimator, status, logs) of the rows without a value."""
        failed = self.table[self.table["value"].isna()]
        return failed.groupby(["estimator", "status"], sort=False).size().rename("logs").reset_index()

    def statement(self) -> dict[str, Any]:
        """Each estimator's numbers by group of sizes, for JSON: ratios, worst cell, coverage, width, time."""
        stated = {}
        for name, own in self.cells.groupby("estimator", sort=False):
            shifted, same = own[~own["identical"]], own[own["identical"]]
            small, large = shifted[shifted["size"] < PARTING], shifted[shifted["size"] >= PARTING]
            stated[str(name)] = {
                "sizes below 3": {"cells": len(small), **summarize(small)},
                "sizes of 3 and more": {"cells": len(large), **summarize(large)},
                "identical, over maximum likelihood": {"cells": len(same), "geo": geometric_mean(same["ratio"])},
                "interval": coverage(own),
                "seconds": float(own["seconds"].mean()),
                "failed": int(own["failed"].sum()),
            }
        return stated

    def profile(self, figure: Figure) -> None:
        """Draw for each estimator the share of cells (identical pairs left out) whose ratio is at most tau."""
        figure.set_size_inches(7.0, 4.4)
        ax = figure.subplots()
        shifted = self.cells[~self.cells["identical"]]
        known = shifted["ratio"][(shifted["ratio"] > 0) & np.isfinite(shifted["ratio"])]
        low, high = (0.5, 2.0) if known.empty else (max(known.min() / 1.2, 1e-3), min(known.max() * 1.2, 1e3))
        for k, name in enumerate(self.cells["estimator"].unique()):
            own = shifted[shifted["estimator"] == name]
            ratios = np.sort(np.clip(own["ratio"].dropna(), low, high))
            share = np.arange(len(ratios) + 1) / max(1, len(own))
            style = series(k)
            ax.step(
                [low, *ratios, high], [*share, share[-1]], where="post", color=style["color"], ls=style["linestyle"],
                lw=1.7, label=shorten(name),
            )  # fmt: skip
        ax.axvline(1.0, color=INK, lw=0.9, ls=(0, (4, 2)))
        ax.set(
            xscale="log", ylim=(0.0, 1.02), xlabel="tau: RMSE over min(maximum likelihood, simulator)",
            ylabel="share of cells with a ratio of at most tau",
        )  # fmt: skip
        disable_math(ax.legend(fontsize="small", loc="best").get_texts())

    def heat(self, figure: Figure) -> None:
        """Draw the ratio of each family and size, a panel for each estimator that is no reference, a number in each cell."""
        every = self.cells["estimator"].unique()
        names = [name for name in every if name not in REFERENCES] or list(every)
        families, sizes = list(self.cells["family"].unique()), sorted(self.cells["size"].unique())
        figure.set_size_inches(2.6 + (0.9 + 0.55 * len(sizes)) * len(names), 1.6 + 0.21 * len(families))
        axes: Any = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
        for ax, name in zip(axes, names, strict=True):
            own = self.cells[self.cells["estimator"] == name].pivot_table("ratio", "family", "size", dropna=False)
            ratios = own.reindex(index=families, columns=sizes).to_numpy()
            with np.errstate(divide="ignore"):
                power = np.clip(np.log2(ratios), -REACH, REACH)
            image = ax.imshow(power, cmap=DIVERGING, vmin=-REACH, vmax=REACH, aspect="auto")
            for (i, j), ratio in np.ndenumerate(ratios):
                text = "-" if np.isnan(ratio) else f"{ratio:.2g}"
                color = "black" if abs(power[i, j]) < 0.6 * REACH else "white"
                ax.text(j, i, text, ha="center", va="center", fontsize=6, color=color)
            ax.set_title(shorten(name), fontsize="medium")
            ax.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes], fontsize=7)
            ax.set_yticks(range(len(families)), [shorten(family) for family in families], fontsize=7)
            disable_math([ax.title, *ax.get_yticklabels()])
        figure.supxlabel("transitions per stochastic state-action pair", fontsize="small")
        bar = figure.colorbar(image, ax=list(axes), shrink=0.6)
        bar.set_ticks([-3, -2, -1, 0, 1, 2, 3], labels=["1/8", "1/4", "1/2", "1", "2", "4", "8"])
        bar.ax.tick_params(labelsize=7)
        bar.set_label("RMSE over the reference's", fontsize="small")

    def page(self, about: Mapping[str, str], command: str) -> str:
        """The league as a page of markdown; ``about``: what the simulator of each family has wrong."""
        failed = self._failures()
        parts = ["# Estimators on families of environment shift", *([f"`{command}`"] if command else [])]
        parts += [pipe_table(self.league.set_index("estimator").T.reset_index(names="measure")), EXPLAINED]
        parts += ["![Share of cells by ratio](profile.png)", "![Ratio by family and size](heat.png)"]
        parts += ["## Without a value", pipe_table(failed)] if len(failed) else []
        if about:
            frame = pd.DataFrame({"family": list(about), "what the simulator has wrong": list(about.values())})
            parts += ["## Families", pipe_table(frame)]
        return "\n\n".join(parts) + "\n"

    def to_latex(self) -> str:
        """The league as a table for a paper: a row for each estimator (package booktabs)."""
        written = self._written().drop(columns=["worst cell", "worst family"])
        rows: list[Any] = [written.columns, *written.itertuples(index=False, name=None)]
        first, *lines = [" & ".join(str(text).translate(TEX) for text in row) + r" \\" for row in rows]
        columns = "l" + "r" * (written.shape[1] - 1)
        body = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", first, r"\midrule", *lines, r"\bottomrule"]
        return "\n".join([*body, r"\end{tabular}"]) + "\n"

    def save(self, folder: Any, *, about: Mapping[str, str] | None = None, command: str = "") -> list[Path]:
        """Write table.csv, cells.csv, league.csv, .md and .tex, shown.json, profile.png and heat.png, all or none."""
        contents = {
            "table.csv": _files.csv_bytes(self.table),
            "cells.csv": _files.csv_bytes(self.cells, float_format="%.6g"),
            "league.csv": _files.csv_bytes(self.league, float_format="%.6g"),
            "league.md": self.page(about or {}, command).encode(),
            "league.tex": self.to_latex().encode(),
            "shown.json": (json.dumps(plain(self.statement()), indent=1) + "\n").encode(),
            "profile.png": draw_bytes(self.profile, salt="bench", kinds=("png",))["png"],
            "heat.png": draw_bytes(self.heat, salt="bench", kinds=("png",))["png"],
        }
        refuse_links(Path(folder))
        _files.write_all(Path(folder), contents)
        return [Path(folder) / name for name in contents]


def league_of(table: pd.DataFrame) -> League:
    """The league of a run's rows.

    Parameters
    ----------
    table : columns family, size, seed, estimator, value, error, lower, upper, seconds, covered, bound, identical, status; among
        the estimators the references "maximum-likelihood" and "simulator"

    Examples
    --------
    >>> row = {"family": "f", "size": 3.0, "lower": 0.0, "upper": 2.0, "seconds": 0.1, "covered": 1.0, "bound": 0.01,
    ...        "identical": False, "status": "ok", "truth": 1.0}
    >>> errors = {"maximum-likelihood": (0.2, -0.2), "simulator": (0.4, 0.4), "mine": (0.1, 0.1)}
    >>> rows = [{**row, "seed": seed, "estimator": name, "value": 1 + pair[seed], "error": pair[seed]}
    ...         for seed in (0, 1) for name, pair in errors.items()]
    >>> league_of(pd.DataFrame(rows)).cells[["estimator", "ratio"]].round(3).values.tolist()
    [['maximum-likelihood', 1.0], ['simulator', 2.0], ['mine', 0.5]]
    """
    return League(table, *score(table))
