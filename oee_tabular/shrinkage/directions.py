"""Directions in which a target may differ from the simulator.

They are made from the simulator, the policies and the user's features. A direction is a
function phi(s, a, s'). They come in groups, each with the changes of environment that
it stands for::

    log P         log P and (log P)^2: all noise a little less or more than simulated
    V             r(s, a, s') + gamma V_pi(s') in the simulator: everything a little
                  worse. Small misfits of many rows add up to an error of J along this
                  direction alone, since J's derivative in P(s' | s, a) is d(s, a)
                  times it
    steps         indicators of the most frequent displacements, in ``layout`` or in
                  the states' numbers: an event (an arrival, a slip to the left) that
                  is more frequent than simulated
    log P at s    log P times the coordinates of s: a floor that is more slippery on
                  one side
    drift         the displacement itself, one direction a coordinate: a wind, a
                  weaker motor
    drift at s    the displacement times the coordinates of s: a wind that blows in
                  one half, a motor that fades
    features      the user's own

Each direction exists for all actions together, and for each action alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oee_tabular.exact import state_values, values_or_zeros
from oee_tabular.exceptions import DivergentKernelError
from oee_tabular.mdp import (
    BLOCK,
    DIGITS,
    FiniteMDP,
    Rows,
    distinct_rows,
    round_displacements,
)
from oee_tabular.shrinkage._ridge import Columns, find_codes
from oee_tabular.typing import Array, IntArray

# The largest number of displacements that are directions of their own.
MAX_STEP_DIRECTIONS = 24
# Up to this number of coordinates each displacement is multiplied by each coordinate of
# s; beyond, by its own.
MAX_COORDINATES_OF_ALL_PRODUCTS = 4

GROUPS = ("log P", "log P at s", "drift", "drift at s", "features", "V", "steps")


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions, with their columns at any rows.

    Attributes
    ----------
    names : tuple of str
        Names of the d columns.
    group : ndarray of int of shape (d,)
        Places of the columns' groups in ``GROUPS``.
    simulator : FiniteMDP
        The simulator.
    powers : int
        Number of powers of log P.
    places : ndarray of shape (S, c)
        Coordinates of the states, standardised.
    steps : ndarray of shape (k, c)
        The displacements with a column of their own.
    features : ndarray of shape (entries, f)
        The user's features.
    ahead : ndarray of shape (S, p)
        V of each policy, scaled to at most 1 together with the rewards.
    rewards : ndarray of shape (entries,) or None
        r(s, a, s') in the same scale.
    without : Directions or None
        The directions without V; None where there is no V.
    keys : ndarray of int of shape (entries,) or None
        In place of ``steps``: transitions of one key have a column of their own.
    """

    names: tuple[str, ...]
    group: IntArray
    simulator: FiniteMDP
    powers: int
    places: Array
    steps: Array
    features: Array
    ahead: Array
    rewards: Array | None = None
    without: Directions | None = None
    keys: IntArray | None = None
    _kept: dict[int, tuple[Rows, Columns]] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to be pickled, without stored columns."""
        return vars(self) | {"_kept": {}}

    def columns(self, rows: Rows) -> Columns:
        """Return the columns at the entries of ``rows``.

        Each column, except the indicators, is less its mean in its row under the
        simulator. Those of a small simulator are stored.
        """
        if self.without is not None:
            fixed = self.without.columns(rows)
            ahead = self.simulator.discount * self.ahead[rows.arrival]
            if self.rewards is not None:
                ahead = ahead + self.rewards[rows.entries][:, None]
            both = np.concatenate([fixed.base, rows.center(ahead)], axis=1)
            return fixed._replace(base=both)
        kept = self._kept.get(id(rows))
        if kept is None:
            kept = rows, self._columns(rows)
            if len(self.features) <= BLOCK:
                self._kept[id(rows)] = kept
        return kept[1]

    def _columns(self, rows: Rows) -> Columns:
        """Compute all columns but V's."""
        logs = np.log(rows.weights)
        parts = [logs[:, None], (logs * logs)[:, None]][: self.powers]
        if self.keys is None:
            code = np.full(len(rows.arrival), -1)
        else:
            code = self.keys[rows.entries]
        if self.places.shape[1]:
            start = rows.spread(self.places[rows.state])
            drift = self.places[rows.arrival] - start
            parts += [logs[:, None] * start, drift, _products(drift, start)]
            tolerance = 10.0**-DIGITS
            code = find_codes(
                self.places,
                rows.state,
                rows.arrival,
                rows.indptr,
                self.steps,
                tolerance,
            )
        parts.append(self.features[rows.entries])
        base = np.ascontiguousarray(rows.center(np.concatenate(parts, axis=1)))
        return Columns(
            base, code, len(self.steps), rows.indptr, rows.action, rows.weights
        )


def _products(drift: Array, start: Array) -> Array:
    """Multiply displacements by coordinates of s, (entries, c c).

    With many coordinates each displacement is multiplied by its own, (entries, c).
    """
    if drift.shape[1] > MAX_COORDINATES_OF_ALL_PRODUCTS:
        return np.asarray(drift * start)
    products = drift[:, :, None] * start[:, None, :]
    return np.asarray(products.reshape(len(drift), -1))


def make_directions(simulator: FiniteMDP, visited: Rows, features: Array) -> Directions:
    """Make the directions of all groups but V.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator.
    visited : Rows
        The rows with data, in which displacements are counted.
    features : ndarray of shape (entries, f)
        The user's features, f = 0 without any.

    Returns
    -------
    Directions
        The directions.

    Notes
    -----
    Cost: O(c nnz log nnz) for displacements in c coordinates.
    """
    places, size = _standard_places(simulator)
    drift = places[visited.arrival] - visited.spread(places[visited.state])
    kinds, kind = distinct_rows(round_displacements(drift))
    mass = np.bincount(kind, weights=visited.weights) / len(visited)
    steps = np.ascontiguousarray(
        kinds[np.argsort(-np.round(mass, 12), kind="stable")[:MAX_STEP_DIRECTIONS]]
    )
    n_products = _products(drift[:1], places[:1]).shape[1]
    names: tuple[list[str], ...] = (
        ["log P", "(log P)^2"],
        [f"log P at s {k}" for k in range(places.shape[1])],
        [f"drift {k}" for k in range(places.shape[1])],
        [f"drift at s {k}" for k in range(n_products)],
        [f"feature {k}" for k in range(features.shape[1])],
        [],
        [_step_name(step * size) for step in steps],
    )
    return _directions(names, simulator, places, steps, features)


def _step_name(displacement: Array) -> str:
    """Return the name of a displacement's direction."""
    shown = [f"{x:+.4g}" if abs(x) > 1e-9 else "0" for x in displacement]
    return f"step ({', '.join(shown)})"


def own_directions(
    simulator: FiniteMDP, features: Array | None = None, keys: IntArray | None = None
) -> Directions:
    """Make directions of the user's features, or one for each key; else log P.

    Features are (entries, f); keys are (entries,) integers from 0.
    """
    given = np.zeros((len(simulator.csr.data), 0)) if features is None else features
    n_keys = 0 if keys is None else int(keys.max()) + 1
    none = list[str]()
    powers = ["log P"] if features is None and keys is None else none
    own = [f"feature {k}" for k in range(given.shape[1])]
    names = (powers, none, none, none, own, none, [f"key {k}" for k in range(n_keys)])
    nowhere = np.zeros((simulator.n_states, 0))
    steps = np.zeros((n_keys, 0))
    return replace(_directions(names, simulator, nowhere, steps, given), keys=keys)


def _directions(
    names: tuple[list[str], ...],
    simulator: FiniteMDP,
    places: Array,
    steps: Array,
    features: Array,
) -> Directions:
    """Return directions with the columns ``names`` of each group, without V."""
    group = np.repeat(np.arange(len(GROUPS)), [len(own) for own in names])
    columns = tuple(itertools.chain(*names))
    nothing_ahead = np.zeros((simulator.n_states, 0))
    return Directions(
        columns, group, simulator, len(names[0]), places, steps, features, nothing_ahead
    )


def add_values(directions: Directions, values: Sequence[Array]) -> Directions:
    """Add V of each policy whose value matters to directions.

    ``values`` are the policies' state values in the simulator, each (S,).
    """
    simulator = directions.simulator
    ahead = np.stack(values, axis=1)
    rewards = simulator.reward_data
    unit = max(float(np.abs(ahead).max()), 1e-300)
    if rewards is not None:
        unit = max(unit, float(np.abs(rewards).max()))
        rewards = rewards / unit
    own = ["V"]
    if len(values) > 1:
        own = [f"V of policy {k + 1}" for k in range(len(values))]
    at = len(directions.names) - len(directions.steps)
    names = (*directions.names[:at], *own, *directions.names[at:])
    group = np.insert(directions.group, at, np.full(len(own), GROUPS.index("V")))
    return replace(
        directions,
        names=names,
        group=group,
        ahead=ahead / unit,
        rewards=rewards,
        without=directions,
    )


def _standard_places(simulator: FiniteMDP) -> tuple[Array, Array]:
    """Return the states' standardised coordinates and the coordinates' units.

    Without a layout the coordinate is the state's number.
    """
    places = simulator.layout
    if places is None:
        places = np.arange(simulator.n_states, dtype=np.float64)[:, None]
    largest = np.maximum(np.abs(places).max(axis=0), 1e-300)
    scaled = places / largest
    size = scaled.std(axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.ascontiguousarray((scaled - scaled.mean(axis=0)) / size), size * largest


def values_in(
    simulator: FiniteMDP, policies: Sequence[Array], horizon: int | None
) -> list[Array]:
    """Compute V_pi in the simulator of each policy for which it exists.

    In states that the policy never reaches it is 0 if it does not exist in all of them.
    """
    values = []
    for policy in policies:
        try:
            if horizon is None:
                level = values_or_zeros(simulator, policy)
            else:
                level = state_values(simulator, policy, horizon=horizon)
        except DivergentKernelError:
            continue
        if np.isfinite(level).all():
            values.append(level)
    return values
