"""The figures of the CartPole experiments."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular.lab.experiments import paper
from oee_tabular.lab.findings import listed, number
from oee_tabular.lab.panels import panels
from oee_tabular.lab.robots.cartpole_truth import DELTAS, SIMULATED
from oee_tabular.plots import label_ends

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ON_CELLS = ("simulator", "OEE", "OEE, calibrated", "model-based", "model-based, calibrated", "linear model")
OTHERS = ("simulator", "OEE, calibrated", "IS, per decision", "IS, self-normalised", "oracle", "oracle, calibrated")
PAPERS = {"true_value": ("true", "x"), "oee": ("OEE", "o"), "mle": ("model (MLE)", "s"), "is": ("IS", "^")}
PAPER_COLOR = "0.35"
DELTA = "delta (share of the uniform policy)"


def styles(table: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """One style for each estimator, everywhere: raw ones dashed and hollow, calibrated ones solid, the oracle broad."""
    from oee_tabular.plots.style import COLORS, MARKERS

    names = list(table.estimator.unique())
    bases = list(dict.fromkeys(name.removesuffix(", calibrated") for name in names))
    found: dict[str, dict[str, object]] = {}
    for name in names:
        k = bases.index(name.removesuffix(", calibrated"))
        raw = f"{name}, calibrated" in names
        found[name] = {"color": COLORS[k % len(COLORS)], "marker": MARKERS[k % len(MARKERS)], "ms": 5, "lw": 1.5,
                       "ls": "--" if raw else "-", "mfc": "white" if raw else COLORS[k % len(COLORS)]}  # fmt: skip
        if name.startswith("oracle"):
            found[name] |= {"marker": "", "lw": 5, "alpha": 0.5, "zorder": 1, "color": COLORS[-1]}
            found[name]["ls"] = (0, (1.0, 0.5)) if raw else "-"
    return found


def figure_2(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Values; errors at each delta, of two groups of estimators; mean errors of both kinds of target."""
    gravities, n = sorted(table.gravity.unique()), int(table.n.max())
    own = table[(table.target == "compiled") & (table.n == n)]
    mean = own.groupby(["estimator", "gravity"]).error.mean()
    axes = panels(figure, _findings(mean, gravities, n), columns=len(gravities), size=(4.5, 3.3))
    grid = np.array(axes).reshape(4, len(gravities))
    style = styles(table)
    for column, gravity in enumerate(gravities):
        part = own[own.gravity == gravity]
        _values(grid[0, column], part, gravity, style)
        _errors(grid[1, column], part[part.estimator.isin(ON_CELLS)], style)
        _errors(grid[2, column], part[part.estimator.isin(OTHERS)], style)
        _means(grid[-1, column], table[table.gravity == gravity], summary, style)
    for shared in grid:
        for ax in shared[1:]:
            ax.sharey(shared[0])
    for ax in grid[-1, 1:]:
        ax.tick_params(labelleft=False)
    grid[0, 0].set_ylabel("value times (1 - discount)")
    for ax in grid[1:-1, 0]:
        ax.set_ylabel("mean |error| of the value\ntimes (1 - discount)")
    for ax in grid[:-1, -1]:  # the same lines in every panel of a row
        label_ends(ax, fontsize=7.5)
    _legend(figure, grid[-1], ncols=2 if len(gravities) == 1 else 6)


def _findings(mean: pd.Series[float], gravities: Iterable[float], n: int) -> list[str]:
    """The title of every panel, row by row: what it shows, in numbers."""
    rows: list[list[str]] = [[], [], [], []]
    for g in gravities:
        by = mean.xs(g, level="gravity")
        cells = str(by[list(ON_CELLS)].drop("simulator").idxmin())
        weights = by[["IS, per decision", "IS, self-normalised"]].min()
        where = "the target is the simulator" if g == SIMULATED else f"the simulator is off by {by['simulator']:.2g}"
        rows[0].append(f"gravity {g:g} m/s²: {where}")
        rows[1].append(f"n = {n}: least error {by[cells]:.1g}, {cells}")
        rows[2].append(f"importance sampling {weights:.1g} at best, OEE {by['OEE, calibrated']:.1g}")
        rows[3].append("mean over delta, for every n")
    return [title for row in rows for title in row]


def fig2_finding(table: pd.DataFrame) -> str:
    """Errors on the gravities that are not the simulator's, at the largest n."""
    n = table.n.max()
    own = table[(table.target == "compiled") & (table.n == n) & (table.gravity != SIMULATED)]
    names = ["OEE, calibrated", "linear model", "IS, per decision", "IS, self-normalised", "simulator"]
    means = own[own.estimator.isin(names)].groupby("estimator").error.mean().sort_values()
    return f"Mean error at n = {n} under other gravities: {listed(means)}" if len(means) else ""


def _legend(figure: Figure, axes: Iterable[Axes], *, ncols: int) -> None:
    """One below all panels."""
    every: dict[str, Any] = {}
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        every |= {label: handle for label, handle in zip(labels, handles, strict=True) if label not in every}
    figure.legend(list(every.values()), list(every), loc="outside lower center", ncols=ncols, fontsize="small")


def _values(ax: Axes, part: pd.DataFrame, gravity: float, style: dict[str, Any]) -> None:
    from oee_tabular.plots.style import INK

    truth = [float(part[f"truth_{delta:g}"].iloc[0]) for delta in DELTAS]
    ax.plot(DELTAS, truth, color=INK, lw=3.5, alpha=0.25, label="true (Monte Carlo)", zorder=0)
    values = part[part.estimator == "OEE, calibrated"][[f"value_{delta:g}" for delta in DELTAS]]
    ax.plot(DELTAS, values.mean(), label="OEE, calibrated", **style["OEE, calibrated"])
    for series, (name, marker) in PAPERS.items():
        points = paper.curve("cartpole", f"gravity={gravity}", series)
        if len(points):
            ax.plot(points.x, points["mean"], ls="none", marker=marker, ms=8, mfc="none", mew=1.3, color=PAPER_COLOR,
                    label=f"the paper's {name}")  # fmt: skip
    ax.set_xlabel(DELTA)
    ax.grid(visible=True)


def _errors(ax: Axes, part: pd.DataFrame, style: dict[str, Any]) -> None:
    for name, own in part.groupby("estimator", sort=False):
        columns = [(f"value_{delta:g}", f"truth_{delta:g}") for delta in DELTAS]
        errors = np.array([np.abs(own[value] - own[truth]) for value, truth in columns])
        ax.plot(DELTAS, errors.mean(axis=1), label=name, **style[str(name)])
        if len(own) > 1:
            low, high = np.quantile(errors, [0.1, 0.9], axis=1)
            ax.fill_between(DELTAS, low, high, color=style[str(name)]["color"], alpha=0.1, lw=0)
    ax.set(yscale="log", ylim=(5e-5, 0.5))
    ax.set_xlabel(DELTA)
    ax.grid(visible=True)


def _means(ax: Axes, part: pd.DataFrame, summary: pd.DataFrame, style: dict[str, Any]) -> None:
    """One line an estimator, in its colour: a mark for each n and kind of target, and the paper's."""
    names = list(part.estimator.unique())
    for (kind, n), own in part.groupby(["target", "n"]):
        means = own.groupby("estimator").error.mean()
        shift, marker, text = (-0.16, "o", "compiled") if kind == "compiled" else (0.16, "D", "Gymnasium stepped")
        full = n == part.n.max()
        for k, name in enumerate(names):
            color = style[name]["color"]
            ax.plot(
                means[name], k + shift, ls="none", marker=marker, ms=5.5, color=color, mfc=color if full else "white"
            )
        ax.plot([], [], ls="none", marker=marker, ms=5.5, color="black", mfc="black" if full else "white",
                label=f"last row: {text}, n = {n}")  # fmt: skip
    if "paper" in summary:
        known = summary[(summary.gravity == part.gravity.iloc[0]) & summary.paper.notna()]
        where = [names.index(name) for name in known.estimator]
        ax.plot(known.paper, where, ls="none", marker="*", ms=10, mfc="none", color=PAPER_COLOR,
                label="last row: the paper's")  # fmt: skip
    ax.set_xscale("log")
    ax.set_xlim(5e-5, 1.0)
    ax.set_yticks(np.arange(len(names)), names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlabel("mean |error| times (1 - discount)")
    ax.grid(visible=True)


def resolution(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Error against cost without data; against n in two dimensions, raw and calibrated, and in four."""
    names = ["the target itself on the states, no data", "two dimensions, from n moves", "the same, calibrated",
             "the whole state, from n moves"]  # fmt: skip
    axes = panels(figure, names, columns=2, size=(6.0, 4.0))
    whole = table.states.str.startswith("whole")
    kinds = [["OEE"], ["OEE, calibrated"], ["OEE", "OEE, calibrated"]]
    _cost(axes[0], table[table.n == 0])
    for ax, kind, rows in zip(axes[1:], kinds, (~whole, ~whole, whole), strict=True):
        _against_n(ax, table[(table.n > 0) & rows & table.estimator.isin(kind)])
    level = table[table.estimator == "simulator"].error.mean()
    for ax in axes:
        ax.axhline(level, color="0.5", lw=1.2, ls=":", label="simulator")
        ax.set_yscale("log")
        ax.grid(visible=True)
        ax.set_ylabel("mean |error| times (1 - discount)")
        ax.sharey(axes[0])
    for ax in axes:
        label_ends(ax)


def resolution_finding(table: pd.DataFrame) -> str:
    """The best states of two dimensions and of four, at the largest n."""
    n = table.n.max()
    last = table[(table.n == n) & table.estimator.isin(["OEE", "OEE, calibrated"])]
    kind = last.states.str.startswith("whole").map({False: "two dimensions", True: "the whole state"})
    best = (
        last.groupby([kind, last.states.rename("own"), "estimator"]).error.mean().groupby(level=0).min().sort_values()
    )
    level = number(table[table.estimator == "simulator"].error.mean())
    return f"Least error at n = {n}: {listed(best)}; the simulator's {level}"


def _cost(ax: Axes, table: pd.DataFrame) -> None:
    from oee_tabular.plots.style import COLORS

    families = {
        "grid of angle, velocity": ~table.states.str.startswith("whole"),
        "grid of the whole state": table.states.str.endswith("grid"),
        "cells of visited states": table.states.str.endswith("cells"),
    }
    for k, (name, mask) in enumerate(families.items()):
        for estimator, line in (("target on these states", "--"), ("the same, calibrated", "-")):
            part = table[mask & (table.estimator == estimator)]
            if len(part):
                means = part.groupby("states", sort=False)[["entries", "error"]].mean().sort_values("entries")
                ax.plot(means.entries, means.error, ls=line, marker="osD"[k], ms=5, color=COLORS[k],
                        mfc="white" if line == "--" else COLORS[k],
                        label=f"{name}{', calibrated' if line == '-' else ''}")  # fmt: skip
                if line == "--":
                    for states, point in means.iterrows():
                        text = str(states).removeprefix("whole state, ").removesuffix(" grid")
                        ax.annotate(
                            text, (point.entries, point.error), xytext=(4, 5), textcoords="offset points", fontsize=7
                        )
    ax.set_xscale("log")
    ax.set_xlabel("stored transition probabilities (cost of a step)")


def _against_n(ax: Axes, table: pd.DataFrame) -> None:
    from oee_tabular.plots.style import COLORS, MARKERS

    for k, (states, own) in enumerate(table.groupby("states", sort=False)):
        for estimator, part in own.groupby("estimator", sort=False):
            line = "-" if estimator == "OEE, calibrated" else "--"
            each = part.pivot_table("error", "n", "repetition")
            color = COLORS[k]
            ax.plot(each.index, each.mean(axis=1), ls=line, marker=MARKERS[k], ms=5, color=color,
                    mfc="white" if line == "--" else color,
                    label=f"{str(states).removeprefix('whole state, ')}{', calibrated' if line == '-' else ''}")  # fmt: skip
            ax.fill_between(each.index, each.min(axis=1), each.max(axis=1), color=color, alpha=0.15, lw=0)
    ax.set_xscale("log")
    sizes = sorted(table.n.unique())
    ax.set_xticks(sizes, [str(n) for n in sizes], fontsize="small")
    ax.minorticks_off()
    ax.set_xlabel("moves of the target in the log, n")


def data(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """A panel for each n, group of estimators and gravity."""
    gravities = sorted(table.gravity.unique())
    rows = [(n, names) for n in sorted(table.n.unique()) for names in (ON_CELLS, OTHERS)]
    titles = [f"gravity {g:g} m/s², n = {n}" for n, _ in rows for g in gravities]
    axes = panels(figure, titles, columns=len(gravities), size=(4.6, 3.3))
    style = styles(table)
    for ax, ((n, names), gravity) in zip(axes, itertools.product(rows, gravities), strict=True):
        part = table[(table.n == n) & (table.gravity == gravity) & table.estimator.isin(names)]
        for name, own in part.groupby("estimator", sort=False):
            groups = own.groupby("behavior").error
            ax.plot(groups.mean(), label=name, **style[str(name)])
            ax.fill_between(
                groups.mean().index, groups.min(), groups.max(), color=style[str(name)]["color"], alpha=0.1, lw=0
            )
        ax.set(
            yscale="log", xlabel="delta of the policy that recorded the log", ylabel="mean |error| times (1 - discount)"
        )
        ax.set_xticks(sorted(table.behavior.unique()))
        ax.grid(visible=True)
        ax.sharey(axes[0])
    for ax in axes[len(gravities) - 1 :: len(gravities)]:
        label_ends(ax)


def data_finding(table: pd.DataFrame) -> str:
    """Errors by the policy that recorded the log."""
    means = table[table.estimator == "OEE, calibrated"].groupby("behavior").error.mean().sort_values()
    level = number(table[table.estimator == "simulator"].error.mean())
    return f"OEE's calibrated error, by delta of the recording policy: {listed(means)}; the simulator's {level}"


def choice_finding(table: pd.DataFrame) -> str:
    """The best grid and strength at each n."""
    means = table[table.estimator == "OEE, calibrated"].groupby(["n", "vertices", "strength"]).error.mean()
    best = means.loc[means.groupby("n").idxmin()].reset_index()
    return "Least error: " + "; ".join(
        f"{number(error)} at n = {n} ({k} x {k}, strength {strength:g})"
        for n, k, strength, error in best.itertuples(index=False, name=None)
    )


def choice(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """A curve for each grid."""
    from oee_tabular.plots.style import series

    sizes = sorted(table.n.unique())
    axes = panels(figure, [f"n = {n}" for n in sizes], size=(4.8, 3.8))
    for ax, n in zip(axes, sizes, strict=True):
        part = table[(table.n == n) & (table.estimator == "OEE, calibrated")]
        for k, (vertices, own) in enumerate(part.groupby("vertices")):
            ax.plot(own.groupby("strength").error.mean(), label=f"{vertices} x {vertices}", **series(k))
        ax.set(
            xscale="log",
            yscale="log",
            xlabel="strength of the prior (moves a row)",
            ylabel="mean |error| times (1 - discount)",
        )
        ax.grid(visible=True)
        ax.legend(fontsize="small")
