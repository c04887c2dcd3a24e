"""Names of states and actions by their place on a grid: "action down in cell (8, 6)".

A state without a name of its own is called by its cell where the layout has a whole row
and column of its own for every state that can be left. An action without a name is
called by the direction in which it leads in most states.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from oee_tabular.mdp.finite_mdp import FiniteMDP
from oee_tabular.mdp.naming import Names
from oee_tabular.typing import Array, BoolArray, IntArray

# the share of an action's states that must lead in its direction; walls and slips
# change a few
MIN_SHARE_OF_DIRECTION = 0.75
MIN_STEP = 1e-9  # cells; a shorter one is rounding
# (rows down, columns right) -> the word
DIRECTIONS = {
    (-1, 0): "up",
    (1, 0): "down",
    (0, -1): "left",
    (0, 1): "right",
    (-1, -1): "up left",
    (-1, 1): "up right",
    (1, -1): "down left",
    (1, 1): "down right",
    (0, 0): "stay",
}


@dataclass(frozen=True)
class PlacedNames(Names):
    """Hold names, the cells of states without a name, and the actions' directions.

    Attributes
    ----------
    cells : ndarray of int of shape (S, 2)
        The row and column of each state.
    is_placed : ndarray of bool of shape (S,)
        Whether no other state is in a state's cell.
    directions : tuple of str, or None
        The direction of each action; None where they have none of their own.
    """

    cells: IntArray = field(
        default_factory=lambda: np.zeros((0, 2), dtype=np.int64), compare=False
    )
    is_placed: BoolArray = field(
        default_factory=lambda: np.zeros(0, dtype=np.bool_), compare=False
    )
    directions: tuple[str, ...] | None = field(default=None, compare=False)

    def describe_state(self, state: int) -> str:
        """Name a state by its cell, "cell (8, 6)" of row and column."""
        if not self.is_placed[state]:
            return super().describe_state(state)
        row, column = self.cells[state]
        return f"cell ({row}, {column})"

    def is_named(self, state: int) -> bool:
        """Return whether a state is named by its cell."""
        return bool(self.is_placed[state])

    def action_word(self, action: int) -> str | None:
        """Return the name of an action, or its direction."""
        if self.actions is None and self.directions is not None:
            return self.directions[action]
        return super().action_word(action)


def place_names(mdp: FiniteMDP) -> Names:
    """Return the names of an MDP, with cells where its layout is a grid.

    Cost: O(S log S + nnz).
    """
    layout = mdp.layout
    if mdp.state_names is not None or layout is None or layout.shape[1] != 2:
        return mdp.names
    if not np.array_equal(layout, np.rint(layout)):
        return mdp.names
    cells = layout.astype(np.int64)
    is_left = ~mdp.closed()
    _, place = np.unique(cells, axis=0, return_inverse=True)
    place = place.reshape(-1)
    # states of a task with more than a position share cells
    if np.bincount(place[is_left]).max(initial=0) > 1:
        return mdp.names
    is_placed = np.bincount(place)[place] == 1
    directions = None if mdp.action_names is not None else _directions(mdp, layout)
    return PlacedNames(
        mdp.state_names,
        mdp.action_names,
        cells,
        is_placed | is_left,
        directions,
    )


def _directions(mdp: FiniteMDP, layout: Array) -> tuple[str, ...] | None:
    """Return the direction of each action; None unless they all differ.

    It is that of the mean step in most states, beyond the mean step of all actions
    there: what slips, wind and walls do to all of them alike says nothing.
    """
    shape = (mdp.n_states, mdp.n_actions, 2)
    step = np.asarray(mdp.transitions @ layout).reshape(shape) - layout[:, None, :]
    is_used = mdp.available & ~mdp.closed()[:, None]
    number = np.maximum(is_used.sum(axis=1), 1)
    common = np.where(is_used[:, :, None], step, 0.0).sum(axis=1) / number[:, None]
    step -= common[:, None, :]
    found = []
    for action in range(mdp.n_actions):
        steps = step[is_used[:, action], action]
        size = np.abs(steps).max(axis=1, initial=0.0)
        # against a wall a step is short
        is_long = size > max(0.5 * size.max(initial=0.0), MIN_STEP)
        steps = steps[is_long] / size[is_long, None]
        if not len(steps):
            found.append((0, 0))
            continue
        ways, counts = np.unique(np.rint(steps), axis=0, return_counts=True)
        if counts.max() < MIN_SHARE_OF_DIRECTION * len(steps):
            return None
        row, column = ways[counts.argmax()]
        found.append((int(row), int(column)))
    if mdp.n_actions == 1 or len(set(found)) < len(found):
        return None
    return tuple(DIRECTIONS[way] for way in found)
