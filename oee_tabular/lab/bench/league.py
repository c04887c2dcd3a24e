"""The league of a run: its tables, in words, as JSON, as pictures and as files."""

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
from oee_tabular.lab.bench.given import LIKELIHOOD, REFERENCES
from oee_tabular.lab.bench.scores import coverage, geometric_mean, scored, summary, wide
from oee_tabular.lab.output import drawn, pipe_table
from oee_tabular.plots.style import DIVERGING, INK, disable_math, series, shorten
from oee_tabular.report.results import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REACH = 3.0  # powers of two on either side of 1 that the heat map's colours tell apart
PARTING = 3.0  # sizes below it, and from it on, are stated apart
WIDE = (10.0, 30.0)  # sizes at which widths are compared
EXPLAINED = (
    "RMSE over the better of maximum likelihood (the simulator in unseen rows) and the bare simulator on the same logs, over "
    "cells (family x size): geometric mean (geo), 90% quantile, worst; share of cells whose ratio is surely above 1.1, 1.5 "
    "(the 5% quantile of the paired bootstrap over the seeds is). `geo, over bound`: over the square root of the efficiency "
    "bound / n. Where the target is the simulator (identical): over maximum likelihood alone. Coverage and width of the "
    "interval that the estimator reports, over logs of at least 3 moves per open row that hold more than 90% of the policy's "
    "time; width over that of maximum likelihood's +- 1.96 standard errors. Seconds: of one log, processor time."
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
        shares = ("above 1.1", "above 1.5", "coverage", "its coverage")
        league = self.league.copy()
        for column in league.columns[1:]:
            form = "{:.0%}" if column in shares else "{:.3g}"
            league[column] = [
                "" if isinstance(x, float) and math.isnan(x) else form.format(x) if isinstance(x, float) else str(x)
                for x in league[column]
            ]
        failed = [
            f"{row.estimator}: no value on {row.logs} logs: {row.status}" for row in self._failures().itertuples()
        ]
        return "\n".join(
            [league.set_index("estimator").T.to_string(), "", EXPLAINED, *(["", *failed] if failed else [])]
        )

    def _failures(self) -> pd.DataFrame:
        """(estimator, status, logs) of the rows without a value."""
        lost = self.table[self.table["value"].isna()]
        return lost.groupby(["estimator", "status"], sort=False).size().rename("logs").reset_index()

    def statement(self) -> dict[str, Any]:
        """Each estimator's numbers by group of sizes, for JSON: ratios, bounds, worst cells, coverage, width, time."""
        names = list(self.league["estimator"])
        return {name: _statement(self.cells, name, names) for name in names}

    def profile(self, figure: Figure) -> None:
        """Draw for each estimator the share of cells (identical pairs left out) whose ratio is at most tau."""
        figure.set_size_inches(7.0, 4.4)
        ax = figure.subplots()
        shifted = self.cells[~self.cells["identical"]]
        known = shifted["ratio"][(shifted["ratio"] > 0) & np.isfinite(shifted["ratio"])]
        low, high = (0.5, 2.0) if known.empty else (max(known.min() / 1.2, 1e-3), min(known.max() * 1.2, 1e3))
        for k, name in enumerate(dict.fromkeys(self.cells["estimator"])):
            own = shifted[shifted["estimator"] == name]
            ratios = np.sort(own["ratio"].dropna().to_numpy())
            style = series(k)
            share = np.arange(len(ratios) + 1) / max(1, len(own))
            ratios = np.concatenate([[low], np.clip(ratios, low, high)])
            ratios, share = np.append(ratios, high), np.append(share, share[-1])
            ax.step(
                ratios, share, where="post", color=style["color"], ls=style["linestyle"], lw=1.7, label=shorten(name)
            )
        ax.axvline(1.0, color=INK, lw=0.9, ls=(0, (4, 2)))
        ax.set_xscale("log")
        ax.set_ylim(0.0, 1.02)
        ax.set_xlabel("tau: RMSE over min(maximum likelihood, simulator)")
        ax.set_ylabel("share of cells with a ratio of at most tau")
        disable_math(ax.legend(fontsize="small", loc="best").get_texts())

    def heat(self, figure: Figure) -> None:
        """Draw the ratio of each family and size, a panel for each estimator that is no reference, a number in each cell."""
        names = [name for name in dict.fromkeys(self.cells["estimator"]) if name not in REFERENCES] or list(REFERENCES)
        families, sizes = list(dict.fromkeys(self.cells["family"])), sorted(self.cells["size"].unique())
        figure.set_size_inches(2.6 + (0.9 + 0.55 * len(sizes)) * len(names), 1.6 + 0.21 * len(families))
        axes: Any = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
        image = None
        for ax, name in zip(axes, names, strict=True):
            own = wide(self.cells, ["family", "size"], "ratio")[name]
            ratios = np.array([[own.get((family, size), np.nan) for size in sizes] for family in families])
            with np.errstate(divide="ignore"):
                power = np.clip(np.log2(ratios), -REACH, REACH)
            image = ax.imshow(power, cmap=DIVERGING, vmin=-REACH, vmax=REACH, aspect="auto")
            for (i, j), ratio in np.ndenumerate(ratios):
                pale = abs(power[i, j]) < 0.6 * REACH
                text = "-" if np.isnan(ratio) else f"{ratio:.2g}"
                ax.text(j, i, text, ha="center", va="center", fontsize=6, color="black" if pale else "white")
            ax.set_title(shorten(name), fontsize="medium")
            ax.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes], fontsize=7)
            ax.set_yticks(range(len(families)), [shorten(family) for family in families], fontsize=7)
            ax.set_xlabel("moves per open row", fontsize="small")
            disable_math([ax.title, *ax.get_yticklabels()])
        assert image is not None
        bar = figure.colorbar(image, ax=list(axes), shrink=0.6)
        bar.set_ticks([-3, -2, -1, 0, 1, 2, 3], labels=["1/8", "1/4", "1/2", "1", "2", "4", "8"])
        bar.ax.tick_params(labelsize=7)
        bar.set_label("RMSE over the reference's", fontsize="small")

    def page(self, about: Mapping[str, str], command: str) -> str:
        """The league as a page of markdown; ``about``: what the simulator of each family has wrong."""
        failed = self._failures()
        lines = ["# Estimators on families of environment shift", ""]
        lines += [f"`{command}`", ""] if command else []
        lines += [pipe_table(self.league.set_index("estimator").T.reset_index(names="measure")), "", EXPLAINED, ""]
        lines += ["![Share of cells by ratio](profile.png)", "", "![Ratio by family and size](heat.png)", ""]
        lines += ["## Without a value", "", pipe_table(failed), ""] if len(failed) else []
        if about:
            frame = pd.DataFrame({"family": list(about), "what the simulator has wrong": list(about.values())})
            lines += ["## Families", "", pipe_table(frame), ""]
        return "\n".join(lines)

    def save(self, folder: Any, *, about: Mapping[str, str] | None = None, command: str = "") -> list[Path]:
        """Write table.csv, cells.csv, league.csv, league.md, shown.json, profile.png and heat.png, all or none."""
        contents = {
            "table.csv": _files.csv_bytes(self.table),
            "cells.csv": _files.csv_bytes(self.cells, float_format="%.6g"),
            "league.csv": _files.csv_bytes(self.league, float_format="%.6g"),
            "league.md": self.page(about or {}, command).encode(),
            "shown.json": (json.dumps(plain(self.statement()), indent=1) + "\n").encode(),
            "profile.png": drawn(self.profile, salt="bench", kinds=("png",))["png"],
            "heat.png": drawn(self.heat, salt="bench", kinds=("png",))["png"],
        }
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
    return League(table, *scored(table))


def _statement(cells: pd.DataFrame, name: str, names: list[str]) -> dict[str, Any]:
    own = cells[cells["estimator"] == name]
    shifted, same = own[~own["identical"]], own[own["identical"]]
    groups = {
        "sizes below 3": shifted[shifted["size"] < PARTING],
        "sizes of 3 and more": shifted[shifted["size"] >= PARTING],
    }
    return {
        **{label: _group(part) for label, part in groups.items()},
        "identical, over maximum likelihood": {
            "geo": geometric_mean(same["ratio"]),
            "cells": {f"{row.family} at {row.size:g}": row.ratio for row in same.itertuples()},
        },
        "paper_grid, over maximum likelihood": _over_likelihood(own, "paper_grid"),
        "interval": coverage(own)
        | {"least covered": _least_covered(own)}
        | {"width over that of": {other: _width_over(cells, name, other) for other in names if other != name}},
        "seconds": float(own["seconds"].mean()),
        "failed": int(own["failed"].sum()),
    }


def _group(cells: pd.DataFrame) -> dict[str, Any]:
    """The ratios of a group of cells, and its worst."""
    if cells.empty:
        return {"cells": 0}
    worst = cells.sort_values("ratio", ascending=False).head(8)
    return {
        "cells": len(cells),
        **summary(cells),
        "share with bound at most 1.1": float((cells["low"] <= 1.1).mean()),
        "largest bound": float(cells["low"].max()),
        "cells with ratio above 2": int((cells["ratio"] > 2).sum()),
        "worst cells": {f"{row.family} at {row.size:g}": [row.ratio, row.low] for row in worst.itertuples()},
    }


def _over_likelihood(cells: pd.DataFrame, family: str) -> dict[str, Any]:
    here = cells[cells["family"] == family]
    return {
        f"{size:g}": [rmse, rmse / likelihood if likelihood else math.nan]
        for size, rmse, likelihood in zip(here["size"], here["rmse"], here[LIKELIHOOD], strict=True)
    }


def _least_covered(cells: pd.DataFrame) -> dict[str, list[float]]:
    """The five families whose intervals hold the truth least often: share, and logs."""
    by = cells.groupby("family", sort=False)[["logs", "held"]].sum()
    by = by[by["logs"] > 0].assign(share=lambda frame: frame["held"] / frame["logs"]).sort_values("share").head(5)
    return {str(row.Index): [float(row.share), int(row.logs)] for row in by.itertuples()}  # type: ignore[arg-type]


def _width_over(cells: pd.DataFrame, name: str, other: str) -> dict[str, float]:
    """Median over the cells of a size of this interval's width over the other's."""
    widths = wide(cells, ["family", "size"], "width")
    ratio = (widths[name] / widths[other]).groupby(level="size").median()
    return {f"{size:g}": float(ratio[size]) for size in WIDE if size in ratio.index and not math.isnan(ratio[size])}
