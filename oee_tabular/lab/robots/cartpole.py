"""fig2: CartPole under four gravities; what its estimates cost in grid, data and data quality; how they were configured."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular._checks import Array
from oee_tabular.continuous.cartpole import PAPER_NOISE, CartPole
from oee_tabular.continuous.discretization import VisitedCells, discretize
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.lab.experiments.common import published
from oee_tabular.lab.panels import Panels, listed
from oee_tabular.lab.registry import Cell, Row, Stream, experiment
from oee_tabular.lab.robots import distance_between, mark_paper, select_deltas
from oee_tabular.lab.robots.cartpole_estimates import (
    BEHAVIOR,
    DELTAS,
    GRAVITIES,
    SIMULATED,
    VISITING,
    Corrected,
    calibrated,
    estimates,
    exact_values,
    fine_values,
    off_environment,
    policies_of,
    target_log,
    true_values,
)
from oee_tabular.plots import label_ends

PAPERS_N = 80_000
MISTAKEN = (7.5, 12.5, 15.0)
TRUTHS = {"compiled": ("target", PAPER_NOISE), "gymnasium": ("target without noise", 0.0)}
ERROR = "mean |error| of the value, times (1 - discount)"
RESIDUAL = "residual"
ON_CELLS = ("simulator", "OEE", "OEE, calibrated", "model-based", "model-based, calibrated", "linear model")
OTHERS = ("OEE, calibrated", RESIDUAL, "IS, per decision", "IS, self-normalised", "oracle", "oracle, calibrated")
PAPERS = {"true_value": ("true", "x"), "oee": ("OEE", "o"), "mle": ("model (MLE)", "s"), "is": ("IS", "^")}

PAPERS_NAMES = {
    "OEE": "oee", "OEE, calibrated": "oee", "model-based": "mle", "model-based, calibrated": "mle",
    "IS, per decision": "is", "IS, self-normalised": "is",
}  # fmt: skip


def rows_of(values: dict[str, Array], case: str, gravity: float, found: Corrected | None = None) -> list[Row]:
    """A row for each estimator: its mean |error| over the policies, and value and truth of each."""
    truth = true_values(case, gravity)
    facts: Row = {f"truth_{delta:g}": value for delta, value in zip(DELTAS, truth, strict=True)}
    facts["truth_standard_error"] = float(true_values(case, gravity, "standard_error").max())
    if found is not None:
        facts |= {"visited": float(found.zeta.visited.mean()), "largest_zeta": float(found.zeta.values.data.max())}
    return [
        {"estimator": name, "error": float(np.abs(value - truth).mean())}
        | {f"value_{delta:g}": x for delta, x in zip(DELTAS, value, strict=True)}
        | facts
        for name, value in values.items()
    ]


def published_error(gravity: float, estimator: str) -> float:
    """Mean |error| of the paper's own curve from its own true curve; of the simulator, between its two true curves."""
    setting, name = f"gravity={gravity}", PAPERS_NAMES.get(estimator)
    right = published("cartpole", setting, "true_value")
    if estimator == "simulator" and gravity != SIMULATED:
        return distance_between(published("cartpole", f"gravity={SIMULATED}", "true_value"), right)
    return float("nan") if name is None else distance_between(published("cartpole", setting, name), right)


def published_numbers(summary: pd.DataFrame) -> list[float]:
    """At the paper's gravities and n, for the target with its noise."""
    return [
        published_error(gravity, name) if kind == "compiled" and n == PAPERS_N else float("nan")
        for kind, gravity, n, name in summary[["target", "gravity", "n", "estimator"]].itertuples(index=False)
    ]


def draw_figure_2(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Values and errors at each delta, under each gravity, of the largest logs of the compiled target."""
    own = table[(table.target == "compiled") & (table.n == table.n.max())]
    shared: dict[str, Any] = {"curves": "estimator", "x": "delta", "xlabel": "delta (share of the uniform policy)"}
    errors = shared | {"title": "gravity {gravity:g} m/s²: errors", "ylabel": ERROR, "log": True}
    Panels(
        "value", title="gravity {gravity:g} m/s²: values", ylabel="value times (1 - discount)", beneath=mark,
        extra={"true value": "truth"}, only=partial(keep, ("OEE, calibrated",)), **shared,
        beside=[Panels("error", only=partial(keep, names), **errors) for names in (ON_CELLS, OTHERS)],
        by=("gravity",), columns=3, size=(6.0, 4.4),
    )(select_deltas(own, DELTAS), summary, figure)  # fmt: skip
    for ax in figure.axes:
        if not ax.get_title().endswith("values"):
            label_ends(ax)


def keep(names: tuple[str, ...], rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of these estimators."""
    return rows[rows.estimator.isin(names)]


def mark(ax: Any, rows: pd.DataFrame) -> None:
    """What the paper published under this gravity."""
    mark_paper(ax, "cartpole", f"gravity={rows.gravity.iloc[0]}", PAPERS)


def finding_2(table: pd.DataFrame) -> str:
    """Errors on the gravities that are not the simulator's, at the largest n."""
    n = table.n.max()
    own = table[(table.target == "compiled") & (table.n == n) & (table.gravity != SIMULATED)]
    names = [RESIDUAL, "OEE, calibrated", "linear model", "IS, per decision", "IS, self-normalised", "simulator"]
    means = own[own.estimator.isin(names)].groupby("estimator").error.mean().sort_values()
    return f"Mean error at n = {n} under other gravities: {listed(means)}" if len(means) else ""


def smallest(table: pd.DataFrame, column: str) -> pd.Series[float]:
    """The mean errors by the values of a column, the least first; the simulator's own left out."""
    return table[table.estimator != "simulator"].groupby(column).error.mean().sort_values()[:3]


@experiment(
    "Figure 2: CartPole under four gravities, with a simulator of gravity 10", group="continuous",
    axes={"target": ("compiled", "gymnasium"), "gravity": GRAVITIES, "n": (10_000, PAPERS_N)},
    smoke={"gravity": (15.0,), "n": (10_000,)},
    keys=("target", "gravity", "n", "estimator"), measures=("error",),
    draw=draw_figure_2, finding=finding_2, paper=published_numbers,
)  # fmt: skip
def fig2(settings: Cell, stream: Stream) -> list[Row]:
    """Values are (1 - discount) times the discounted sum of 100 rewards, at most 0.634, of delta uniform + (1 - delta)
    expert; logs of delta = 0.3. The truth is a mean of 400 000 episodes (standard error at most 0.0003). 32 x 32 vertices over
    angle and angular velocity, the simulator looked at in the log's places, strength 0.01. Calibrated: times the simulator's
    Monte Carlo value / its value on the grid. The oracle is the target itself on the same grid. Residual: the simulator
    corrected by what the log's steps leave over its own. Hollow grey marks: the paper's.
    """
    kind, gravity = str(settings["target"]), float(settings["gravity"])
    log = target_log(kind, gravity, int(settings["n"]), stream.generator())
    case, noise = TRUTHS[kind]
    values, found = estimates(log, gravity, noise=noise)
    values[RESIDUAL] = fine_values(ResidualSimulator(CartPole(SIMULATED), log, seed=0))
    return rows_of(values, case, gravity, found)


# ---- resolution ------------------------------------------------------------------------------------------------------------

# what is discretised, and on which cells
STATES: dict[str, tuple[str, Any]] = {
    **{f"{k} x {k}": ("angle", (k, k)) for k in (20, 32, 60, 100)},
    **{f"whole state, {k}^4 grid": ("full", (k,) * 4) for k in (10, 18)},
    **{f"whole state, {k} cells": ("full", k) for k in (1000, 5000)},
}
FULL_STRENGTH = 1.0  # of zeta on cells of the whole state


def draw_resolution(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Errors against n, raw and calibrated; without data they are in the table."""
    panel = Panels(
        "error", "states", by=("estimator",), title="{estimator}", log=True, bands=True, ylabel=ERROR,
        axes={"xscale": "log"}, columns=2, size=(6.0, 4.0),
    )  # fmt: skip
    panel(table[table.n > 0], summary, figure)


@experiment(
    "CartPole: error against the grid's resolution and against n, in two and in four dimensions", group="continuous",
    axes={"states": tuple(STATES), "n": (0, 3162, 10_000, 31_623, PAPERS_N), "gravity": MISTAKEN},
    smoke={"states": ("20 x 20", "32 x 32", "whole state, 1000 cells"), "n": (0, 10_000), "gravity": (15.0,)}, repetitions=3,
    keys=("states", "n", "gravity", "estimator"), measures=("error", "number_of_states", "entries", "uncovered"),
    draw=draw_resolution,
    finding=lambda table: f"Least error without data: {listed(smallest(table[table.n == 0], 'states'))}",
)  # fmt: skip
def cartpole_resolution(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |error| over six policies and three gravities. n = 0: the target itself on these states, no data; else estimates
    from n transitions, raw and calibrated. Two dimensions (angle, angular velocity) are exact for policies of the angle; no
    log covers a grid of the whole state. uncovered: share of the log's transitions without probability, which are left out.
    """
    (form, cells), n, gravity = STATES[str(settings["states"])], int(settings["n"]), float(settings["gravity"])
    if n > 0 and len(np.atleast_1d(cells)) == 4:
        return []
    if n > 0:
        log = target_log("compiled", gravity, n, stream.generator("n", "gravity"))
        whole = {"cells": VisitedCells(cells, n_simulated=2000), "strength": FULL_STRENGTH} if form == "full" else {}
        found = off_environment(log, **({"cells": cells, "form": form} | whole))
        values, model, uncovered = (
            {"OEE": found.raw, "OEE, calibrated": found.calibrated},
            found.simulator,
            found.uncovered,
        )
    else:
        model = discretize(CartPole(SIMULATED, form=form), cells=cells, policies=VISITING, closure_episodes=0)
        target = discretize(CartPole(gravity, form=form), cells=model, closure_episodes=0)
        raw, inside = (exact_values(each.mdp, policies_of(model)) for each in (target, model))
        values, uncovered = {"target on these states": raw, "the same, calibrated": calibrated(raw, inside)}, 0.0
    values = {"simulator": true_values("simulator", SIMULATED)} | values
    cost: Row = {"number_of_states": model.mdp.n_states, "entries": int(model.mdp.transitions.nnz)}
    return [row | cost | {"uncovered": uncovered} for row in rows_of(values, "target", gravity)]


# ---- data quality, configuration -------------------------------------------------------------------------------------------


@experiment(
    "CartPole: which policy should record the log", group="continuous", repetitions=5,
    axes={"behavior": (0.0, BEHAVIOR, 0.6, 1.0), "gravity": MISTAKEN, "n": (10_000, PAPERS_N)},
    smoke={"behavior": (0.0, 1.0), "gravity": (15.0,), "n": (10_000,)},
    keys=("behavior", "gravity", "n", "estimator"), measures=("error", "visited"),
    draw=Panels(
        "error", "estimator", "behavior", ("n", "gravity"), only=partial(keep, ON_CELLS), log=True, ylabel=ERROR, columns=3,
        xlabel="delta of the policy that recorded the log",
    ),
    finding=lambda table: (
        "OEE's calibrated error, by delta of the recording policy: "
        + listed(table[table.estimator == "OEE, calibrated"].groupby("behavior").error.mean())
    ),
)  # fmt: skip
def cartpole_data(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |error| over six policies from logs that delta = 0 (the expert), 0.3, 0.6 or 1 (uniform) recorded. visited: share
    of states and actions of the grid that the log has seen.
    """
    gravity = float(settings["gravity"])
    log = target_log("compiled", gravity, int(settings["n"]), stream.generator(), float(settings["behavior"]))
    values, found = estimates(log, gravity, noise=PAPER_NOISE)
    return rows_of(values, "target", gravity, found)


@experiment(
    "CartPole: how grid and strength were chosen", group="continuous", repetitions=4,
    axes={
        "vertices": (24, 32, 60), "strength": (0.01, 0.1, 0.3, 1.0), "gravity": MISTAKEN, "n": (10_000, PAPERS_N),
    },
    smoke={"vertices": (24, 32), "strength": (0.01, 1.0), "gravity": (15.0,), "n": (10_000,)},
    keys=("vertices", "strength", "gravity", "n", "estimator"), measures=("error",),
    draw=Panels(
        "error", "vertices", "strength", ("n",), log=True, ylabel=ERROR, xlabel="strength of the prior (transitions a row)",
        only=partial(keep, ("OEE, calibrated",)), axes={"xscale": "log"},
    ),
    finding=lambda table: f"Least error, by vertices: {listed(smallest(table, 'vertices'))}",
)  # fmt: skip
def cartpole_choice(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |error| over six policies and three gravities of the calibrated estimate, by the vertices along each side and the
    strength of the prior, on logs of its own. fig2 uses 32 and 0.01 everywhere.
    """
    gravity = float(settings["gravity"])
    log = target_log("compiled", gravity, int(settings["n"]), stream.generator("gravity", "n"))
    found = off_environment(log, cells=(int(settings["vertices"]),) * 2, strength=float(settings["strength"]))
    return rows_of({"OEE": found.raw, "OEE, calibrated": found.calibrated}, "target", gravity, found)
