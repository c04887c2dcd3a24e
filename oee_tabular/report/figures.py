"""The page's pictures, as inline SVG with a title and a description each, and what they show.

Where the log has been, where each policy goes, and where the target differs for certain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _printing, plots
from oee_tabular._checks import Array, BoolArray, positive_integer, show
from oee_tabular.estimators import Problem
from oee_tabular.exact.linear import DivergentKernelError
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.mdp.naming import NAMELESS, Names
from oee_tabular.plots import Map, map_of
from oee_tabular.ratio import transition_ratio
from oee_tabular.report.text import Answer, format_number, format_value
from oee_tabular.report.uncertainty import GUARANTEED, LIKELIHOOD

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

WIDTH = 4.6  # inches: text that is readable on a phone as well
MOST_POLICIES, MOST_ROWS = 6, 10
NOTABLE = 5e-4  # share of a policy's time from which a state with unrecorded actions is crossed out


@dataclass(frozen=True, eq=False)
class Visits:
    """Where one policy goes, in the simulator as the log corrects it.

    ``time`` (S, A) its shares of discounted time before an episode is over, summing to 1; ``unseen`` (S,) the part of each
    state's that is in actions never recorded.
    """

    time: Array
    unseen: Array

    @property
    def states(self) -> Array:
        """(S,)."""
        return np.asarray(self.time.sum(axis=1))

    @property
    def coverage(self) -> float:
        """Share of the time in (s, a) that the log has seen."""
        return 1.0 - float(self.unseen.sum())


@dataclass(frozen=True, eq=False)
class Portrait:
    """Counts (S, A) of the log, ``over`` (S,) states that no action leaves, visits by policy, changed rows, and the map."""

    counts: Array
    over: BoolArray
    visits: Mapping[str, Visits]
    changes: RowChanges
    map: Map | None
    names: Names = NAMELESS

    @property
    def never(self) -> int:
        """In how many states, of those that can be left, the log has no transition."""
        return int(((self.counts.sum(axis=1) == 0) & ~self.over).sum())

    @property
    def alive(self) -> int:
        """How many states can be left."""
        return int((~self.over).sum())

    def where(self, state: int) -> str:
        """A state in words."""
        place = self.place(state)
        words = "" if place is None else f" (row {place[0]:.6g}, column {place[1]:.6g})"
        return f"state {self.names.state(state)}{words}"

    def place(self, state: int) -> tuple[float, float] | None:
        """The row and the column of a state, as the map's axes call them; None where there is none."""
        return None if self.map is None else self.map.place(state)


def portray(
    problem: Problem, policies: Mapping[str, Array], confidence: float, grid: tuple[int, int] | None
) -> Portrait:
    """The portrait of a problem; ``grid`` None: ``plots.map_of`` finds the map."""
    simulator = problem.simulator
    changes = row_changes(problem, confidence=confidence)
    visits: dict[str, Visits] = {}
    over = simulator.closed()
    shown = {name: policies[name] for name in list(policies)[:MOST_POLICIES]}
    zeta = transition_ratio(
        problem.observed, simulator, values_of=list(shown.values()) or None, horizon=problem.horizon
    )
    model = zeta.target_model(simulator)
    for name, policy in shown.items():
        try:
            time = np.where(over[:, None], 0.0, time_in_pairs(model, policy, problem.horizon))
        except DivergentKernelError:
            continue
        total = float(time.sum())
        time = time / total if total > 0 else time
        visits[name] = Visits(time, np.where(changes.counts > 0, 0.0, time).sum(axis=1))
    places = map_of(simulator) if grid is None else _grid(grid, simulator.n_states)
    return Portrait(changes.counts, over, visits, changes, places, simulator.names)


def _grid(grid: Any, n_states: int) -> Map:
    try:
        rows, columns = grid
    except (TypeError, ValueError):
        raise ValueError(f"grid must be (rows, columns); got {show(grid)}") from None
    shape = positive_integer(rows, "grid[0]"), positive_integer(columns, "grid[1]")
    if shape[0] * shape[1] != n_states:
        raise ValueError(
            f"grid must have as many cells as the simulator has states, {n_states}; {shape} has {shape[0] * shape[1]}"
        )
    return Map.of_shape(*shape)


def largest_changes(portrait: Portrait) -> tuple[list[dict[str, Any]], bool]:
    """The rows with the largest certain change; where none is certain, those with the most evidence, and False."""
    changes = portrait.changes
    pairs = changes.largest(MOST_ROWS)
    certain = bool(pairs)
    if not certain:
        order = np.argsort(-changes.evidence, axis=None, kind="stable")[:MOST_ROWS]
        found = (divmod(int(k), changes.estimated.shape[1]) for k in order)
        pairs = [pair for pair in found if changes.evidence[pair] > 0]
    used = np.max([v.time for v in portrait.visits.values()], axis=0) if portrait.visits else None
    rows = [
        {
            "state": s,
            "names": (
                portrait.names.state(s),
                portrait.names.action(a),
                portrait.names.state(changes.next_state[s, a]),
            ),
            "cell": portrait.place(s),
            "action": a,
            "transitions": int(changes.counts[s, a]),
            "certain": float(changes.certain[s, a]),
            "estimated": float(changes.estimated[s, a]),
            "next": int(changes.next_state[s, a]),
            "simulated": float(changes.simulated[s, a]),
            "observed": float(changes.observed[s, a]),
            "time": None if used is None else float(used[s, a]),
        }
        for s, a in pairs
    ]
    return rows, certain


def intervals_alone(report: Report, policy: str) -> dict[str, tuple[float, float] | None]:
    """The intervals of a policy that stand beside no value, by name; None where the method gave none."""
    beside = {row["interval_method"] for row in report.records() if row["policy"] == policy}
    intervals = report.uncertainty.intervals.get(policy, {})
    shown = {
        f"{'guaranteed' if method == GUARANTEED else method} interval": found
        for method, found in intervals.items()
        if method not in beside
    }
    alone = {name: (found.lower, found.upper) if found.status == "ok" else None for name, found in shown.items()}
    likelihood = intervals.get(LIKELIHOOD)
    if likelihood is not None and likelihood.sampling not in (None, (likelihood.lower, likelihood.upper)):
        alone["sampling interval"] = likelihood.sampling
    return alone


def draw_forest(report: Report, answer: Answer, name: str) -> str:
    """Values and intervals of one policy, by estimator."""
    rows = [row for row in report.records() if row["policy"] == answer.policy]
    sure = {name: ends for name, ends in intervals_alone(report, answer.policy).items() if ends is not None}
    labels = [*(row["estimator"] for row in rows), *sure]
    values = [*(row["value"] for row in rows), *(math.nan for _ in sure)]
    lower, upper = (
        [*(math.nan if row[end] is None else row[end] for row in rows),
         *(ends[k] * report.scale for ends in sure.values())]
        for k, end in enumerate(("lower", "upper"))
    )  # fmt: skip
    limits = None if np.isfinite([*values, *lower]).any() else (0.0, 1.0)  # lines that say "no value"
    factor = "(1 − discount) × " if report.normalized else ""
    told = "; ".join(f"{row['estimator']} {format_value(row['value'], row['lower'], row['upper'])}" for row in rows)
    truth = "" if answer.truth is None else f" The dashed line is the exact value, {format_number(answer.truth)}."
    return plots.figure_svg(
        lambda ax: plots.plot_intervals(
            labels, values, lower, upper, ax, truth=answer.truth, limits=limits,
            xlabel=f"value: {factor}discounted sum of rewards",
        ),
        name=name, size=(WIDTH, 0.85 + 0.31 * len(labels)),
        title=f"Values of {answer.policy} in the target, with intervals",
        description=f"One line for each estimator. {told}.{truth}",
    )  # fmt: skip


def draw_recorded(portrait: Portrait, name: str) -> str:
    """What the log has seen, on the grid."""
    assert portrait.map is not None
    places, recorded_in = portrait.map, portrait.counts.sum(axis=1)
    return plots.figure_svg(
        lambda ax: plots.plot_coverage(portrait.counts, places, ax, over=portrait.over),
        name=name, size=_size(places), title="Transitions recorded in each state",
        description=f"A grid of {len(places.rows)} rows and {len(places.columns)} columns. The log has "
        f"transitions from {portrait.alive - portrait.never} of the {portrait.alive} states that are not terminal; the most, "
        f"{int(recorded_in.max())}, are from {portrait.where(int(recorded_in.argmax()))}.",
    )  # fmt: skip


def draw_visits(portrait: Portrait, policy: str, visits: Visits, name: str) -> str:
    """Where a policy goes, on the grid or as a ranking of states."""
    time = visits.states
    first = ", ".join(
        f"{portrait.where(int(s))} {100 * time[s]:.1f}%" for s in np.argsort(-time, kind="stable")[:5] if time[s] > 0
    )
    description = (
        f"Most of its time before an episode is over: {first}. {_printing.share(visits.coverage)} of it is in state-action "
        "pairs that the log has seen."
    )
    title = f"Where {policy} spends its time"
    if portrait.map is not None:
        places = portrait.map
        return plots.figure_svg(
            lambda ax: plots.plot_occupancy(time, places, ax, unseen=visits.unseen > NOTABLE, over=portrait.over),
            name=name, size=_size(places), title=title, description=description,
        )  # fmt: skip
    bars = min(20, max(1, int((time > 0).sum())))
    return plots.figure_svg(
        lambda ax: plots.plot_states(
            visits.time, portrait.counts, ax,
            names=None if portrait.names.states is None else [portrait.names.state(s) for s in range(len(time))],
        ),
        name=name, size=(WIDTH, 1.1 + 0.25 * bars), title=title, description=description,
    )  # fmt: skip


def draw_changes(portrait: Portrait, name: str) -> str:
    """On the grid, by how much the target differs for certain: the largest of each state's actions."""
    assert portrait.map is not None
    places, least = portrait.map, portrait.changes.certain.max(axis=1)
    shown = np.where(portrait.over | (portrait.counts.sum(axis=1) == 0), np.nan, 100.0 * least)
    words: list[object] = [
        "end" if over else "" if not x > 0 else f"{x:.0f}" for x, over in zip(shown, portrait.over, strict=True)
    ]
    most = int(np.argmax(least))
    return plots.figure_svg(
        lambda ax: plots.plot_grid(
            shown, places, ax, text=words, label="transitions that end elsewhere, at least (%)"
        ),
        name=name, size=_size(places), title="Where the target differs from the simulator for certain",
        description="For each state the largest certain change of its actions. The largest is at least "
        f"{100 * least[most]:.0f}% of transitions, in {portrait.where(most)}; {portrait.changes.n_certain} state-action pairs "
        "differ for certain.",
    )  # fmt: skip


def _size(places: Map) -> tuple[float, float]:
    """A figure as wide as the others, with a map of square cells and its colour bar."""
    tall = (WIDTH - 1.3) * len(places.rows) / len(places.columns)
    return (WIDTH, min(max(tall, 0.9) + 0.6, 7.0))
