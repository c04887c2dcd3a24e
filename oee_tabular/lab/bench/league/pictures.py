"""Pictures of a league: ratios as a profile and a heat map, and errors by size."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.league.cells import wide
from oee_tabular.lab.bench.league.labels import LIKELIHOOD, SIMULATOR
from oee_tabular.plots import DIVERGING, INK, disable_math, series, shorten

PICTURES = {
    "profile": "Share of cells by ratio",
    "sizes": "RMSE by size",
    "heat": "Ratio by family and size",
}
KINDS = ("png", "pdf", "svg")  # of each picture
MAX_HEAT_POWER = (
    3.0  # powers of two on either side of 1 that the heat map's colours tell apart
)
N_CURVES = 10  # estimators that the picture over sizes shows


def draw_profile(figure: Any, cells: pd.DataFrame) -> None:
    """Draw for each estimator the share of cells whose ratio is at most tau."""
    _require_figure(figure)
    ax = _axes(
        figure,
        xlabel="tau: RMSE over the reference's",
        ylabel="share of cells with a ratio of at most tau",
    )
    ratio = cells["ratio"]
    known = ratio[(ratio > 0) & np.isfinite(ratio)]
    low = 0.5
    high = 2.0
    if len(known):
        low = max(known.min() / 1.2, 1e-3)
        high = min(known.max() * 1.2, 1e3)
    for k, (name, own) in enumerate(cells.groupby("estimator", sort=False)):
        ratios = np.clip(np.sort(own["ratio"].dropna().to_numpy()), low, high)
        share = np.arange(len(ratios) + 1) / len(own)
        ax.step(
            [low, *ratios, high],
            [*share, share[-1]],
            where="post",
            markevery=0.12,
            ms=5,
            label=shorten(name),
            **series(k),
        )
    ax.axvline(1.0, color=INK, lw=0.9, ls=(0, (4, 2)))
    ax.set(xscale="log", ylim=(0.0, 1.02))
    disable_math(ax.legend(fontsize="small", loc="best").get_texts())


def draw_sizes(figure: Any, cells: pd.DataFrame) -> None:
    """Draw the RMSE over eff of each estimator by size of the log."""
    _require_figure(figure)
    ax = _axes(figure, xlabel="transitions per stochastic pair", ylabel="RMSE over eff")
    over_eff = cells["over_eff"]
    logs = cells.assign(log=np.log(over_eff.where(over_eff > 0)))
    shown = list(logs.groupby("estimator", sort=False))[:N_CURVES]
    for k, (name, own) in enumerate(shown):
        points = own.groupby("size")["log"].agg(["mean", "sem"])
        shift = 1.0 + 0.02 * (k - N_CURVES / 2)
        middle = np.exp(points["mean"].to_numpy())
        error = points["sem"].fillna(0.0).to_numpy()
        ends = [
            (middle * -np.expm1(-error)).tolist(),
            (middle * np.expm1(error)).tolist(),
        ]
        ax.errorbar(
            points.index * shift,
            middle,
            ends,
            **series(k),
            ms=5,
            capsize=2,
            label=shorten(name),
        )
    ax.set(xscale="log", yscale="log")
    disable_math(ax.legend(fontsize="small", loc="best").get_texts())


def draw_heat(figure: Any, cells: pd.DataFrame, own: pd.Series[str]) -> None:
    """Draw the ratio of each family and size, with a number in each cell.

    ``cells`` have labels of estimators, ``own`` their names.
    """
    _require_figure(figure)
    references = [LIKELIHOOD, SIMULATOR]
    own_names = dict(zip(cells["estimator"], own, strict=True))
    names = [
        name
        for name in cells["estimator"].unique()
        if own_names[name] not in references
    ]
    # A run of the references alone shows them.
    names = names or list(own_names)
    families = list(cells["family"].unique())
    sizes = sorted(cells["size"].unique())
    figure.set_size_inches(
        2.6 + (1.2 + 0.62 * len(sizes)) * len(names), 1.6 + 0.25 * len(families)
    )
    axes: Any = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for ax, name in zip(axes, names, strict=True):
        here = cells[cells["estimator"] == name]
        ratios = (
            wide(here, "family", "ratio", "size")
            .reindex(index=families, columns=sizes)
            .to_numpy()
        )
        with np.errstate(divide="ignore"):
            power = np.clip(np.log2(ratios), -MAX_HEAT_POWER, MAX_HEAT_POWER)
        image = ax.imshow(
            power,
            cmap=DIVERGING,
            vmin=-MAX_HEAT_POWER,
            vmax=MAX_HEAT_POWER,
            aspect="auto",
        )
        for (i, j), ratio in np.ndenumerate(ratios):
            color = "black" if abs(power[i, j]) < 0.6 * MAX_HEAT_POWER else "white"
            text = "-" if np.isnan(ratio) else f"{ratio:.2g}"
            ax.text(j, i, text, ha="center", va="center", fontsize=8.5, color=color)
        ax.set_title(shorten(name), fontsize="medium")
        ax.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes], fontsize=9)
        ax.set_yticks(
            range(len(families)),
            [shorten(family) for family in families],
            fontsize=9,
        )
        ax.set_xlabel("transitions per stochastic pair", fontsize="small")
        disable_math([ax.title, *ax.get_yticklabels()])
    bar = figure.colorbar(image, ax=list(axes), shrink=0.6)
    bar.set_ticks(
        [-3, -2, -1, 0, 1, 2, 3], labels=["1/8", "1/4", "1/2", "1", "2", "4", "8"]
    )
    bar.ax.tick_params(labelsize=9)
    bar.set_label("RMSE over the reference's", fontsize="small")


def _axes(figure: Any, **labels: str) -> Any:
    """Return the only axes of a figure, with these labels."""
    figure.set_size_inches(7.0, 4.4)
    ax = figure.subplots()
    ax.set(**labels)
    return ax


def _require_figure(figure: object) -> None:
    """Require a figure of matplotlib."""
    if not callable(getattr(type(figure), "set_size_inches", None)):
        raise ArgumentError(
            "figure",
            f"must be a matplotlib.figure.Figure; got {type(figure).__name__}",
        )
