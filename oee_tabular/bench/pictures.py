"""The pictures of a league: a performance profile, and a heat map family x size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular.bench.given import REFERENCES
from oee_tabular.bench.scores import wide
from oee_tabular.plots.style import DIVERGING, ink, literally, series, shown

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

REACH = 3.0  # powers of two on either side of 1 that the heat map's colours tell apart


def draw_profile(cells: pd.DataFrame, figure: Figure) -> None:
    """For each estimator the share of cells (identical pairs left out) whose ratio is at most tau."""
    figure.set_size_inches(7.0, 4.4)
    ax = figure.subplots()
    shifted = cells[~cells["identical"]]
    known = shifted["ratio"][(shifted["ratio"] > 0) & np.isfinite(shifted["ratio"])]
    low, high = (0.5, 2.0) if known.empty else (max(known.min() / 1.2, 1e-3), min(known.max() * 1.2, 1e3))
    for k, name in enumerate(dict.fromkeys(cells["estimator"])):
        own = shifted[shifted["estimator"] == name]
        ratios = np.sort(own["ratio"].dropna().to_numpy())
        style = series(k)
        share = np.arange(len(ratios) + 1) / max(1, len(own))
        ratios = np.concatenate([[low], np.clip(ratios, low, high)])
        ratios, share = np.append(ratios, high), np.append(share, share[-1])
        ax.step(ratios, share, where="post", color=style["color"], ls=style["linestyle"], lw=1.7, label=shown(name))
    ax.axvline(1.0, color=ink(), lw=0.9, ls=(0, (4, 2)))
    ax.set_xscale("log")
    ax.set_ylim(0.0, 1.02)
    ax.set_xlabel("tau: RMSE over min(maximum likelihood, simulator)")
    ax.set_ylabel("share of cells with a ratio of at most tau")
    literally(ax.legend(fontsize="small", loc="best").get_texts())


def draw_heat(cells: pd.DataFrame, figure: Figure) -> None:
    """The ratio of each family and size, a panel for each estimator that is no reference, a number in each cell."""
    names = [name for name in dict.fromkeys(cells["estimator"]) if name not in REFERENCES] or list(REFERENCES)
    families, sizes = list(dict.fromkeys(cells["family"])), sorted(cells["size"].unique())
    figure.set_size_inches(2.6 + (0.9 + 0.55 * len(sizes)) * len(names), 1.6 + 0.21 * len(families))
    axes: Any = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    image = None
    for ax, name in zip(axes, names, strict=True):
        own = wide(cells, ["family", "size"], "ratio")[name]
        ratios = np.array([[own.get((family, size), np.nan) for size in sizes] for family in families])
        with np.errstate(divide="ignore"):
            power = np.clip(np.log2(ratios), -REACH, REACH)
        image = ax.imshow(power, cmap=DIVERGING, vmin=-REACH, vmax=REACH, aspect="auto")
        for (i, j), ratio in np.ndenumerate(ratios):
            pale = abs(power[i, j]) < 0.6 * REACH
            text = "-" if np.isnan(ratio) else f"{ratio:.2g}"
            ax.text(j, i, text, ha="center", va="center", fontsize=6, color="black" if pale else "white")
        ax.set_title(shown(name), fontsize="medium")
        ax.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes], fontsize=7)
        ax.set_yticks(range(len(families)), [shown(family) for family in families], fontsize=7)
        ax.set_xlabel("moves per open row", fontsize="small")
        literally([ax.title, *ax.get_yticklabels()])
    assert image is not None
    bar = figure.colorbar(image, ax=list(axes), shrink=0.6)
    bar.set_ticks([-3, -2, -1, 0, 1, 2, 3], labels=["1/8", "1/4", "1/2", "1", "2", "4", "8"])
    bar.ax.tick_params(labelsize=7)
    bar.set_label("RMSE over the reference's", fontsize="small")
