"""The pictures of a page: where the log, the policies and the differences are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import plots
from oee_tabular._checks import positive_integer, show
from oee_tabular.estimators import Problem
from oee_tabular.exact import time_in_pairs
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.mdp import Names, place_names
from oee_tabular.plots import draw_or_warn
from oee_tabular.report import text
from oee_tabular.report.tooltips import Tooltip, draw_with_tooltips
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array, BoolArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 4.6  # inches, at which text is readable on a phone as well
MAX_POLICIES = 6  # that are drawn
MAX_PAIRS = 10  # in the list of changes
# the share of a policy's time from which a state with unrecorded actions is crossed out
MIN_SHARE_TO_CROSS_OUT = 5e-4
MAX_TOOLTIPS = 2500  # cells of a map; larger ones are an image without tooltips
MAX_ACTIONS_TOLD = 6  # in the tooltip of a state


@dataclass(frozen=True, eq=False)
class Portrait:
    """Draw the log and the policies, on the task's map where it has one.

    Attributes
    ----------
    names : Names
        The names of states and actions.
    changes : RowChanges
        The log's counts, of shape (S, A), and how far each pair is from the simulator.
    over : ndarray of shape (S,)
        Whether no action leaves the state.
    time : dict of str to ndarray of shape (S, A)
        The shares of each policy's discounted time before an episode ends, in the
        simulator as the log corrects it; they sum to 1.
    map : Map or None
        Where the states lie.
    available : ndarray of bool of shape (S, A)
        Which actions can be taken in each state.
    """

    names: Names
    changes: RowChanges
    over: BoolArray
    time: Mapping[str, Array]
    map: plots.Map | None
    available: BoolArray

    @property
    def alive(self) -> int:
        """Return the number of states that can be left."""
        return int((~self.over).sum())

    @property
    def never(self) -> int:
        """Return in how many of these states the log has no transition."""
        return int(((self.changes.counts.sum(axis=1) == 0) & ~self.over).sum())

    @property
    def alive_pairs(self) -> int:
        """Return the number of state-action pairs of these states."""
        return int(self.available[~self.over].sum())

    @property
    def missing_pairs(self) -> int:
        """Return how many of the pairs of these states were never recorded."""
        never = (self.changes.counts == 0) & self.available
        return int(never[~self.over].sum())

    def unrecorded(self, policy: str) -> Array:
        """Return the part (S,) of a policy's time in unrecorded pairs of each state."""
        unrecorded = np.where(self.changes.counts > 0, 0.0, self.time[policy])
        return np.asarray(unrecorded.sum(axis=1))

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Return the pairs with the largest certain change.

        Where no change is certain, they are the pairs with the most evidence.
        """
        evidence = self.changes.evidence
        order = np.argsort(-evidence, axis=None, kind="stable")[:MAX_PAIRS]
        likely = (divmod(int(k), evidence.shape[1]) for k in order)
        return self.changes.largest(MAX_PAIRS) or [
            pair for pair in likely if evidence[pair] > 0
        ]

    def where(self, state: Any) -> str:
        """Name a state: by its name or cell, else by its number and place."""
        name = self.names.describe_state(int(state))
        place = None if self.map is None else self.map.place(int(state))
        if place is None or self.names.is_named(int(state)):
            return name
        return f"{name} (row {place[0]:.6g}, column {place[1]:.6g})"

    def number(self, state: int, action: int) -> str:
        """Return the numbers of a pair where its label has none; "" where it has."""
        is_named = self.names.is_named(state)
        if not is_named and self.names.action_word(action) is None:
            return ""
        return f"state {state}, action {action}"

    def longest(self, policy: str) -> list[str]:
        """Name the states in which a policy spends most time."""
        time = self.time[policy].sum(axis=1)
        return [
            f"{self.where(s)} {time[s]:.1%}"
            for s in np.argsort(-time, kind="stable")[:5]
            if time[s] > 0
        ]

    def tell_recorded(self, state: int) -> str:
        """Say how many transitions the log has from a state, and by which actions."""
        counts = self.changes.counts[state]
        number = text.count(round(float(counts.sum())), "recorded transition")
        told = f"{self.where(state)}: {number}"
        taken = [a for a in range(len(counts)) if self.available[state, a]]
        if self.over[state] or len(taken) > MAX_ACTIONS_TOLD:
            return told
        each = ", ".join(
            f"{self.names.action_word(a) or a} {counts[a]:,.0f}" for a in taken
        )
        return f"{told} ({each})"

    def tell_time(self, policy: str, state: int) -> str:
        """Say how much of its time a policy spends in a state."""
        share = self.time[policy][state].sum()
        told = f"{self.where(state)}: {share:.1%} of the time"
        unrecorded = self.unrecorded(policy)[state]
        if unrecorded > MIN_SHARE_TO_CROSS_OUT:
            told += f", {unrecorded:.1%} in unrecorded actions"
        return told

    def tell_changes(self, state: int) -> str:
        """Say how far the actions of a state are from the simulator for certain."""
        if self.changes.counts[state].sum() == 0:
            return f"{self.where(state)}: never recorded"
        certain = self.changes.certain[state]
        action = int(certain.argmax())
        pair = self.names.label_pair(state, action)
        if certain[action] <= 0.0:
            return f"{self.where(state)}: no bound on the difference is above 0"
        return f"{pair}: at least {certain[action]:.0%} of transitions end elsewhere"

    def tooltips(self, tell: Callable[[int], str]) -> list[Tooltip]:
        """Return a tooltip for each state on the map; none on a large one."""
        if self.map is None or self.map.shape[0] * self.map.shape[1] > MAX_TOOLTIPS:
            return []
        tips = []
        for state in np.flatnonzero(self.map.cell >= 0):
            row, column = divmod(int(self.map.cell[state]), self.map.shape[1])
            tips.append(Tooltip(column, row, 1.0, 1.0, tell(int(state))))
        return tips

    def plot_recorded(self, ax: Axes) -> Axes:
        """Draw how many transitions the log has from each state."""
        assert self.map is not None
        return plots.plot_coverage(self.changes.counts, self.map, ax, over=self.over)

    def plot_time(self, policy: str, ax: Axes) -> Axes:
        """Draw where a policy spends its time, on the map or as a ranking of states."""
        time = self.time[policy]
        if self.map is not None:
            crossed = self.unrecorded(policy) > MIN_SHARE_TO_CROSS_OUT
            return plots.plot_occupancy(
                time.sum(axis=1), self.map, ax, unrecorded=crossed, over=self.over
            )
        names = None
        if self.names.states is not None:
            names = [self.names.state(s) for s in range(len(time))]
        return plots.plot_states(time, self.changes.counts, ax, names=names)

    def plot_changes(self, ax: Axes) -> Axes:
        """Draw by how much the target differs for certain.

        Each state shows the largest change of its actions.
        """
        assert self.map is not None
        least = 100.0 * self.changes.certain.max(axis=1)
        shown = np.where(
            self.over | (self.changes.counts.sum(axis=1) == 0), np.nan, least
        )
        words = [f"{x:.0f}" if x > 0 else "" for x in shown]
        for state in np.flatnonzero(self.over):
            words[state] = "end"
        label = "transitions that end elsewhere, at least (%)"
        return plots.plot_grid(shown, self.map, ax, text=words, label=label)

    def draw(
        self,
        plot: Callable[..., Axes],
        name: str,
        title: str,
        description: str,
        *,
        policy: str = "",
        tell: Callable[..., str] | None = None,
    ) -> str:
        """Draw a picture as wide as the others, with a tooltip for each state.

        A map has square cells and a colour bar; a ranking has at most 20 bars.
        """
        if self.map is None:
            n_states = int((self.time[policy].sum(axis=1) > 0).sum())
            height = 1.1 + 0.25 * min(20, max(1, n_states))
        else:
            tall = (WIDTH - 1.3) * len(self.map.rows) / len(self.map.columns)
            height = min(max(tall, 0.9) + 0.6, 7.0)
        tips: Sequence[Tooltip] = ()
        if tell is not None:
            tips = self.tooltips(partial(tell, policy) if policy else tell)
        drawn = draw_or_warn(
            f"the picture {title!r}",
            lambda: draw_with_tooltips(
                partial(plot, policy) if policy else plot,
                tips,
                name=name,
                title=title,
                description=description,
                size=(WIDTH, height),
            ),
        )
        return drawn or ""


def portray(
    problem: Problem,
    policies: Mapping[str, Array],
    confidence: float,
    grid: tuple[int, int] | None,
) -> Portrait:
    """Make the portrait of a problem.

    Without a ``grid`` the map is that of ``plots.map_of``.
    """
    simulator = problem.simulator
    over = problem.simulator.closed()
    shown = dict(list(policies.items())[:MAX_POLICIES])
    zeta = transition_ratio(
        problem.observed,
        simulator,
        values_of=list(shown.values()) or None,
        horizon=problem.horizon,
    )
    model = zeta.target_model(simulator)
    times = {}
    for name, policy in shown.items():
        try:
            time = time_in_pairs(model, policy, problem.horizon)
        except DivergentKernelError:  # at discount 1 a policy need not end
            continue
        time = np.where(over[:, None], 0.0, time)
        times[name] = time / (float(time.sum()) or 1.0)
    if grid is None:
        places = plots.map_of(simulator)
    else:
        places = _read_grid(grid, simulator.n_states)
    return Portrait(
        place_names(simulator),
        row_changes(problem, confidence=confidence),
        over,
        times,
        places,
        simulator.available,
    )


def _read_grid(grid: Any, n_states: int) -> plots.Map:
    """Check a (rows, columns) against the number of states, and make the map."""
    try:
        rows, columns = grid
    except (TypeError, ValueError):
        raise ArgumentError(
            "grid", f"must be (rows, columns); got {show(grid)}"
        ) from None
    shape = positive_integer(rows, "grid[0]"), positive_integer(columns, "grid[1]")
    if shape[0] * shape[1] != n_states:
        raise ArgumentError(
            "grid",
            f"must have as many cells as the simulator has states, {n_states}; {shape}"
            f" has {shape[0] * shape[1]}",
        )
    return plots.Map.of_shape(*shape)
