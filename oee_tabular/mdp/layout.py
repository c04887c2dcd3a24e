"""Where the states of an MDP lie, and how far its moves lead: what is alike about moves from different states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import row_of_entry
from oee_tabular.mdp.arrays import check_layout
from oee_tabular.mdp.finite_mdp import FiniteMDP

DIGITS = 9  # displacements that differ by less than 1e-9 are one


def displacements(mdp: FiniteMDP, *, layout: ArrayLike | None = None) -> tuple[Array, IntArray]:
    """How far each transition leads: layout[s'] - layout[s], or s' - s in the states' numbers where there is no layout.

    Parameters
    ----------
    mdp : FiniteMDP
    layout : (S,) or (S, c), in place of ``mdp.layout``

    Returns
    -------
    kinds : (k, c) the displacements that occur, in the layout's units, rounded to 1e-9; c = 1 without a layout. Sorted by
        the sum of P over their transitions, the largest first; of equal ones the smaller displacement (by its first
        coordinate, then its second, ...)
    kind_of_entry : (nnz,) integers: the displacement of the transition at ``mdp.transitions.data[j]`` is
        ``kinds[kind_of_entry[j]]``

    Raises
    ------
    ValueError
        A layout of another length, or with a place that is not finite.

    Notes
    -----
    O(c nnz log nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> line = oee.FiniteMDP([[[0.4, 0.6, 0]], [[0, 0.4, 0.6]], [[0, 0, 1]]], [0, 0, 0], [1, 0, 0], 0.9)
    >>> kinds, kind = displacements(line)
    >>> kinds.tolist(), kind.tolist()  # 0 -> 0, 0 -> 1, 1 -> 1, 1 -> 2, 2 -> 2
    ([[0.0], [1.0]], [0, 1, 0, 1, 0])
    >>> displacements(oee.tasks.gridworld(3, slip=0.3))[0].tolist()  # staying, then the directions; none leaves the goal
    [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    matrix = mdp.transitions
    given = mdp.layout if layout is None else check_layout(layout, mdp.n_states)
    places = np.arange(mdp.n_states, dtype=np.float64)[:, None] if given is None else given
    state = row_of_entry(matrix) // mdp.n_actions
    kind = np.zeros(matrix.nnz, dtype=np.int64)
    for place in places.T:
        _, step = np.unique(_steps(place, state, matrix.indices), return_inverse=True)
        _, kind = np.unique(kind * (int(step.max()) + 1) + step, return_inverse=True)
    _, first = np.unique(kind, return_index=True)
    mass = np.bincount(kind, weights=matrix.data)
    order = np.argsort(-np.round(mass / mass.sum(), 12), kind="stable")  # equal but for the order of their sums: equal
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    moves = first[order]
    kinds = np.stack([_steps(place, state[moves], matrix.indices[moves]) for place in places.T], axis=1)
    return kinds, rank[kind]


def _steps(place: Array, state: IntArray, following: Any) -> Array:
    """Differences along one coordinate; + 0.0 makes -0.0 plain."""
    return np.asarray(np.round(place[following] - place[state], DIGITS) + 0.0)
