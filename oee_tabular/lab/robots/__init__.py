"""Studies of CartPole, Reacher and Kinova, the paper's robots, and of changes that nobody tuned for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse

from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import row_sums
from oee_tabular._threads import ONE_THREAD
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, DerivedTask, Moves
from oee_tabular.lab.experiments.common import published


def frequencies(counts: sparse.csr_array, n_actions: int) -> sparse.csr_array:
    """The log's own rows n(s, a, s') / n(s, a); a pair that was never recorded stays where it is."""
    total = row_sums(counts)
    unseen = np.flatnonzero(total == 0)
    staying = sparse.csr_array((np.ones(len(unseen)), (unseen, unseen // n_actions)), shape=counts.shape)
    return sparse.csr_array(sparse.diags_array(1.0 / np.where(total > 0, total, 1.0)) @ counts + staying)


def distance_between(first: pd.DataFrame, second: pd.DataFrame) -> float:
    """The mean |difference| of two of the paper's curves; nan where they have no points in common."""
    both = first.merge(second, on="x")
    return float((both["mean_x"] - both["mean_y"]).abs().mean()) if len(both) else float("nan")


def mark_paper(ax: Any, figure: str, setting: str, markers: Mapping[str, tuple[str, str]]) -> None:
    """What the paper published, series -> (name, marker); its expert is lost, so its points need not lie on our lines."""
    for series, (name, marker) in markers.items():
        points = published(figure, setting, series)
        if len(points):
            label = f"the paper's {name}"
            ax.plot(points.x, points["mean"], ls="none", marker=marker, mfc="none", color="0.35", label=label)


def select_deltas(table: pd.DataFrame, deltas: Iterable[float]) -> pd.DataFrame:
    """A row for each policy, with delta, value, truth and error, of columns value_0.1, truth_0.1, ...; for figures."""
    parts = [
        table.assign(delta=delta, value=table[f"value_{delta:g}"], truth=table[f"truth_{delta:g}"]) for delta in deltas
    ]
    found = pd.concat(parts)
    return found.assign(error=(found.value - found.truth).abs())


class LinearGaussian(DerivedTask):
    """s' = s + A s + B u + c + N(0, Sigma) in some coordinates, by least squares; rewards, ends and beginnings are the task's.

    One model of all actions u, where ``LinearModel`` has one of each. The coordinates that are left out stay as they are.
    """

    def __init__(self, task: ContinuousTask, log: ContinuousTransitions, coordinates: slice = slice(None)) -> None:
        super().__init__(task, f"linear-Gaussian model of a log of {task.name}")
        self._at = coordinates
        design = self._inputs(log.state, log.action_numbers(task.actions))
        change = (log.next_state - log.state)[:, coordinates]
        self.n_disturbances = change.shape[1]
        with ONE_THREAD:
            self.coefficients = np.linalg.lstsq(design, change)[0]
            rest = change - design @ self.coefficients
            self.root = np.linalg.cholesky(rest.T @ rest / len(rest) + 1e-12 * np.eye(self.n_disturbances))

    def _inputs(self, states: Array, actions: IntArray) -> Array:
        return np.column_stack([np.ones(len(states)), states[:, self._at], self.actions[actions]])

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One step of the model."""
        following = np.array(states)
        following[:, self._at] += self._inputs(states, actions) @ self.coefficients + disturbance @ self.root.T
        moved = self.task.moves(states, actions, np.zeros((len(states), self.task.n_disturbances)))
        paid = self.task.reward_between(states, actions, following)
        reward = moved.reward if paid is None else paid
        return replace(moved, next_state=following, reward=reward, terminated=self.task.terminated(following))
