"""The league of a run: its tables as text, LaTeX, a page and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from oee_tabular import _files
from oee_tabular._checks import Array
from oee_tabular.lab.bench.scores import LIKELIHOOD, SIMULATOR, score, wide
from oee_tabular.lab.output import draw_bytes, pipe_table
from oee_tabular.lab.store import refuse_links
from oee_tabular.plots.style import DIVERGING, INK, disable_math, series, shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHARES = ("surely above 1.1", "coverage", "its coverage", "coverage of 1.96 se")
PICTURES = {"profile": "Share of cells by ratio", "sizes": "RMSE by size", "heat": "Ratio by family and size"}
REACH = 3.0  # powers of two on either side of 1 that the heat map's colours tell apart
N_CURVES = 10  # estimators that the picture over sizes shows
EXPLAINED = (
    "A ratio is the RMSE over max(min(RMSE of maximum likelihood, RMSE of the simulator), eff / 2) on the same logs, "
    "where eff = sqrt(efficiency bound / n) and maximum likelihood has the simulator in unrecorded pairs. `over "
    "reference`: geometric mean of the ratios over cells (family x size). `floor`: the same of the best rule that "
    "sees the value alone. `surely above 1.1`: share of cells where the 5% quantile of the paired bootstrap over the "
    "seeds is above 1.1. `over likelihood`, `over eff`: RMSE over maximum likelihood's, over eff. `coverage`, "
    "`width`: of the reported interval, over logs of at least 3 transitions per stochastic pair that cover more than "
    "90% of the policy's time; widths are over 2 x 1.96 eff. `of 1.96 se`: of value +- 1.96 standard errors. "
    "`seconds`: processor time of one log. Tuned families are those on which a constant of the default was chosen."
)


@dataclass(frozen=True, eq=False)
class League:
    """The results of a run.

    Attributes
    ----------
    table : DataFrame, a row for each family, size, seed and estimator
    cells : DataFrame, a row for each family, size and estimator, over the seeds
    league : DataFrame, a row for each estimator and kind of families ("tuned", "held"), over the cells

    Examples
    --------
    >>> import oee_tabular as oee
    >>> found = oee.bench.run("oee", families=["machine"], sizes=[3, 10], seeds=3)
    >>> sorted(found.cells["size"].unique().tolist()), found.league["families"].tolist(), found.scores()["oee"].shape
    ([3.0, 10.0], ['tuned', 'tuned', 'tuned'], (3, 2))
    """

    table: pd.DataFrame
    cells: pd.DataFrame
    league: pd.DataFrame

    def __repr__(self) -> str:
        return f"League({len(self.league)} estimators, {len(self.cells)} cells, {len(self.table)} rows)"

    def __str__(self) -> str:
        """The league table, what it means, and why estimators had no value."""
        league = self.league.astype(object)
        for column in league.columns[2:]:
            form = "{:.0%}" if column in SHARES else "{:.3g}"
            league[column] = [form.format(x) if isinstance(x, float) else str(x) for x in league[column].fillna("")]
        tables = [
            f"{kind} families\n{part.drop(columns='families').set_index('estimator').T.to_string()}"
            for kind, part in league.groupby("families", sort=False)
        ]
        failed = [
            f"{row.estimator}: no value on {row.logs} logs: {row.status}" for row in self._failures().itertuples()
        ]
        return "\n\n".join([*tables, EXPLAINED, *(["\n".join(failed)] if failed else [])])

    def _failures(self) -> pd.DataFrame:
        """(estimator, status, logs) of the rows without a value."""
        lost = self.table[self.table["value"].isna()]
        return lost.groupby(["estimator", "status"], sort=False).size().rename("logs").reset_index()

    def scores(self) -> dict[str, Array]:
        """|error| / reference of each estimator, (seeds, cells), smaller is better: runs x tasks, as ``rliable`` takes them."""
        keys = ["family", "size", "estimator"]
        both = self.table.merge(self.cells[[*keys, "rmse", "ratio"]], on=keys)
        both["score"] = both["error"].abs() * both["ratio"] / both["rmse"]
        groups = both.groupby("estimator", sort=False)
        return {str(name): wide(own, "seed", "score", ["family", "size"]).to_numpy() for name, own in groups}

    def profile(self, figure: Figure) -> None:
        """Draw for each estimator the share of cells whose ratio is at most tau."""
        ax = _axes(figure, xlabel="tau: RMSE over the reference's", ylabel="share of cells with a ratio of at most tau")
        known = self.cells["ratio"][(self.cells["ratio"] > 0) & np.isfinite(self.cells["ratio"])]
        low, high = (0.5, 2.0) if known.empty else (max(known.min() / 1.2, 1e-3), min(known.max() * 1.2, 1e3))
        for k, (name, own) in enumerate(self.cells.groupby("estimator", sort=False)):
            ratios = np.clip(np.sort(own["ratio"].dropna().to_numpy()), low, high)
            share = np.arange(len(ratios) + 1) / len(own)
            ax.step([low, *ratios, high], [*share, share[-1]], where="post", markevery=0.12, ms=5, label=shorten(name),
                    **series(k))  # fmt: skip
        ax.axvline(1.0, color=INK, lw=0.9, ls=(0, (4, 2)))
        ax.set(xscale="log", ylim=(0.0, 1.02))
        disable_math(ax.legend(fontsize="small", loc="best").get_texts())

    def sizes(self, figure: Figure) -> None:
        """Draw each estimator's RMSE over eff by size, its geometric mean over families with a standard error over them."""
        ax = _axes(figure, xlabel="transitions per stochastic pair", ylabel="RMSE over eff")
        logs = self.cells.assign(log=np.log(self.cells["over_eff"].where(self.cells["over_eff"] > 0)))
        for k, (name, own) in enumerate(list(logs.groupby("estimator", sort=False))[:N_CURVES]):
            points = own.groupby("size")["log"].agg(["mean", "sem"])
            shift = 1.0 + 0.02 * (k - N_CURVES / 2)
            middle, error = np.exp(points["mean"]), points["sem"].fillna(0.0)
            ends = [middle * -np.expm1(-error), middle * np.expm1(error)]
            ax.errorbar(points.index * shift, middle, ends, **series(k), ms=5, capsize=2, label=shorten(name))
        ax.set(xscale="log", yscale="log")
        disable_math(ax.legend(fontsize="small", loc="best").get_texts())

    def heat(self, figure: Figure) -> None:
        """Draw the ratio of each family and size, a panel for each estimator that is no reference, a number in each cell."""
        references = [LIKELIHOOD, SIMULATOR]
        names = [name for name in self.cells["estimator"].unique() if name not in references] or references
        families, sizes = list(self.cells["family"].unique()), sorted(self.cells["size"].unique())
        figure.set_size_inches(2.6 + (1.2 + 0.62 * len(sizes)) * len(names), 1.6 + 0.25 * len(families))
        axes: Any = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
        for ax, name in zip(axes, names, strict=True):
            own = self.cells[self.cells["estimator"] == name]
            ratios = wide(own, "family", "ratio", "size").reindex(index=families, columns=sizes).to_numpy()
            with np.errstate(divide="ignore"):
                power = np.clip(np.log2(ratios), -REACH, REACH)
            image = ax.imshow(power, cmap=DIVERGING, vmin=-REACH, vmax=REACH, aspect="auto")
            for (i, j), ratio in np.ndenumerate(ratios):
                color = "black" if abs(power[i, j]) < 0.6 * REACH else "white"
                text = "-" if np.isnan(ratio) else f"{ratio:.2g}"
                ax.text(j, i, text, ha="center", va="center", fontsize=8.5, color=color)
            ax.set_title(shorten(name), fontsize="medium")
            ax.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes], fontsize=9)
            ax.set_yticks(range(len(families)), [shorten(family) for family in families], fontsize=9)
            ax.set_xlabel("transitions per stochastic pair", fontsize="small")
            disable_math([ax.title, *ax.get_yticklabels()])
        bar = figure.colorbar(image, ax=list(axes), shrink=0.6)
        bar.set_ticks([-3, -2, -1, 0, 1, 2, 3], labels=["1/8", "1/4", "1/2", "1", "2", "4", "8"])
        bar.ax.tick_params(labelsize=9)
        bar.set_label("RMSE over the reference's", fontsize="small")

    def page(self, about: Mapping[str, str], command: str) -> str:
        """The league as a page of markdown; ``about``: what the simulator of each family has wrong."""
        parts = {"# Estimators on families of environment shift": f"`{command}`" if command else ""}
        for kind, part in self.league.groupby("families", sort=False):
            table = part.drop(columns="families").set_index("estimator").T.reset_index(names="measure")
            parts[f"## {str(kind).capitalize()} families"] = pipe_table(table)
        parts[EXPLAINED] = "\n\n".join(f"![{text}]({name}.png)" for name, text in PICTURES.items())
        if len(failed := self._failures()):
            parts["## Without a value"] = pipe_table(failed)
        if about:
            frame = pd.DataFrame({"family": list(about), "what the simulator has wrong": list(about.values())})
            parts["## Families"] = pipe_table(frame)
        return "\n\n".join(text for part in parts.items() for text in part if text) + "\n"

    def to_latex(self) -> str:
        """The league as a LaTeX table (booktabs)."""
        shown = ["estimator", "families", "cells", "over reference", "floor", "worst", "over eff", "coverage", "width"]
        return self.league[shown].rename(columns=str.capitalize).to_latex(
            index=False, escape=True, na_rep="--", float_format="%.2f", column_format="ll" + "r" * (len(shown) - 2)
        )  # fmt: skip

    def save(self, folder: Any, *, about: Mapping[str, str] | None = None, command: str = "") -> list[Path]:
        """Write table.csv, cells.csv, league.csv, league.md, league.tex and three pictures, all or none."""
        contents = {
            "table.csv": _files.csv_bytes(self.table),
            "cells.csv": _files.csv_bytes(self.cells, float_format="%.6g"),
            "league.csv": _files.csv_bytes(self.league, float_format="%.6g"),
            "league.md": self.page(about or {}, command).encode(),
            "league.tex": self.to_latex().encode(),
        }
        for name in PICTURES:
            contents[f"{name}.png"] = draw_bytes(getattr(self, name), salt="bench", kinds=("png",))["png"]
        refuse_links(Path(folder))
        _files.write_all(Path(folder), contents)
        return [Path(folder) / name for name in contents]


def _axes(figure: Figure, **labels: str) -> Axes:
    figure.set_size_inches(7.0, 4.4)
    ax = figure.subplots()
    ax.set(**labels)
    return ax


def league_of(table: pd.DataFrame) -> League:
    """The league of a run's rows.

    Parameters
    ----------
    table : columns family, families, size, seed, estimator, value, standard_error, error, lower, upper, seconds, covered,
        bound, identical, status; among the estimators the references "maximum-likelihood" and "simulator"

    Examples
    --------
    >>> row = {"family": "f", "families": "held", "size": 3.0, "standard_error": 0.2, "lower": 0.0, "upper": 2.0,
    ...        "seconds": 0.1, "covered": 1.0, "bound": 0.01, "identical": False, "status": "ok", "truth": 1.0}
    >>> errors = {"maximum-likelihood": (0.2, -0.2), "simulator": (0.4, 0.4), "mine": (0.1, 0.1)}
    >>> rows = [{**row, "seed": seed, "estimator": name, "value": 1 + pair[seed], "error": pair[seed]}
    ...         for seed in (0, 1) for name, pair in errors.items()]
    >>> league_of(pd.DataFrame(rows)).cells[["estimator", "ratio"]].round(3).values.tolist()
    [['maximum-likelihood', 1.0], ['simulator', 2.0], ['mine', 0.5]]
    """
    return League(table, *score(table))
