"""What the pictures show: where the log has been, where each policy goes, and where the target differs for certain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular._checks import Array, BoolArray, positive_integer
from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy
from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.plots import detect_grid
from oee_tabular.ratio import transition_ratio

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
    """Counts (S, A) of the log, ``over`` (S,) states that no action leaves, visits by policy, changed rows, and the grid."""

    counts: Array
    over: BoolArray
    visits: Mapping[str, Visits]
    changes: RowChanges
    grid: tuple[int, int] | None

    @property
    def never(self) -> int:
        """In how many states, of those that can be left, the log has no move."""
        return int(((self.counts.sum(axis=1) == 0) & ~self.over).sum())

    @property
    def alive(self) -> int:
        """How many states can be left."""
        return int((~self.over).sum())

    def where(self, state: int) -> str:
        """A state in words."""
        if self.grid is None:
            return f"state {state}"
        row, column = divmod(state, self.grid[1])
        return f"state {state} (row {row}, column {column})"


def portray(
    problem: Problem, policies: Mapping[str, Array], confidence: float, grid: tuple[int, int] | None
) -> Portrait:
    """The portrait of a problem; ``grid`` None: found from the simulator's moves."""
    simulator = problem.simulator
    changes = row_changes(problem, confidence=confidence)
    visits: dict[str, Visits] = {}
    over = simulator.closed()
    if problem.horizon is not None or simulator.discount < 1.0:
        shown = {name: policies[name] for name in list(policies)[:MOST_POLICIES]}
        zeta = transition_ratio(
            problem.observed, simulator, values_of=list(shown.values()) or None, horizon=problem.horizon
        )
        model = zeta.target_model(simulator)
        for name, policy in shown.items():
            time = occupancy(model, policy, horizon=problem.horizon)
            time = np.where(over[:, None], 0.0, time)
            total = float(time.sum())
            time = time / total if total > 0 else time
            visits[name] = Visits(time, np.where(changes.counts > 0, 0.0, time).sum(axis=1))
    shape = detect_grid(simulator) if grid is None else _grid(grid, simulator.n_states)
    return Portrait(changes.counts, over, visits, changes, shape)


def _grid(grid: Any, n_states: int) -> tuple[int, int]:
    try:
        rows, columns = grid
    except (TypeError, ValueError):
        raise ValueError(f"grid must be (rows, columns); got {grid!r}") from None
    shape = positive_integer(rows, "grid[0]"), positive_integer(columns, "grid[1]")
    if shape[0] * shape[1] != n_states:
        raise ValueError(
            f"grid must have as many cells as the simulator has states, {n_states}; {shape} has {shape[0] * shape[1]}"
        )
    return shape


def changed_rows(portrait: Portrait) -> tuple[list[dict[str, Any]], bool]:
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
            "cell": None if portrait.grid is None else divmod(s, portrait.grid[1]),
            "action": a,
            "moves": int(changes.counts[s, a]),
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
