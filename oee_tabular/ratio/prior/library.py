"""Directions in which a target may differ from the simulator, made from the simulator and the policies alone.

A feature is a function phi(s, a, s'); the tilt zeta proportional to exp(theta phi) moves every row along it. What the
library holds, and the changes of environment that it stands for:

log P, (log P)^2    all noise a little less or more than simulated
stay                s' = s: a weak motor, a process that is slower
u2, u3, u4          the smoothest functions of s' on the simulator's graph: a drift from one end of it to another
V                   r(s, a, s') + gamma V_pi(s') in the simulator: everything a little worse. Small misfits of many rows add up
                    to an error of J along this direction alone, since J's derivative in P(s' | s, a) is d(s, a) times it
move (c)            the most frequent displacements of s, in ``layout`` or in the states' numbers: an event (an arrival, a
                    service, a slip to the left) that is more frequent than simulated

u and V also divided by their standard deviation in each row, so that rows with large and with small differences are moved
alike; each but (log P)^2 also for every action alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.exact import state_values
from oee_tabular.exact.linear import DivergentKernelError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows, distinct_rows, round_displacements
from oee_tabular.ratio.prior.neighbours import smooth_functions

SMOOTH, MOVES = 3, 8  # functions on the graph, displacements
FREQUENT = 0.02  # share of the simulated moves that a displacement must have


@dataclass(frozen=True, eq=False)
class Feature:
    """One function of (s, a, s').

    Attributes
    ----------
    name : as it is shown
    values : its values at the entries of rows
    by_deviation : whether they are divided by their standard deviation in each row
    by_action : whether the library has it for each action alone as well
    expected : whether theory names it beforehand (log P, V): it enters on less evidence than one found by searching
    """

    name: str
    values: Callable[[Rows], Array]
    by_deviation: bool = False
    by_action: bool = True
    expected: bool = False

    def column(self, rows: Rows) -> Array:
        """Its values at the entries of ``rows``, centred in each row under the simulator."""
        found = rows.center(np.asarray(self.values(rows), dtype=np.float64))
        if not self.by_deviation:
            return found
        deviation = np.sqrt(rows.sums(rows.weights * found**2))
        return np.asarray(found / rows.spread(np.where(deviation > 1e-9, deviation, np.inf)))


def library(simulator: FiniteMDP, values: Sequence[Array], rows: Rows, levels: Array | None = None) -> list[Feature]:
    """The features.

    Parameters
    ----------
    simulator : FiniteMDP
    values : of each policy whose value matters, V_pi in the simulator, (S,)
    rows : those that the log has visited; displacements are counted there
    levels : ``smooth_functions(simulator, SMOOTH)``, where they are known

    Notes
    -----
    O(nnz) and the smoothest functions of a graph of at most 1024 nodes.
    """
    found = [
        Feature("log P", lambda at: np.log(at.weights), expected=True),
        Feature("(log P)^2", lambda at: np.log(at.weights) ** 2, by_action=False),
        Feature("stay", lambda at: at.arrival == at.spread(at.state)),
    ]
    levels = smooth_functions(simulator, SMOOTH) if levels is None else levels
    for number, level in enumerate(levels.T, start=2):
        found += _both(f"u{number}", _at_arrival(level))
    for number, level in enumerate(values, start=1):
        name = "V" if len(values) == 1 else f"V of policy {number}"
        found += _both(name, _ahead(simulator, level), expected=True)
    return found + _displacements(simulator, rows)


def values_in(simulator: FiniteMDP, policies: Sequence[Array], horizon: int | None) -> list[Array]:
    """V_pi of each policy in the simulator, where it exists."""
    found = []
    for policy in policies:
        try:
            level = state_values(simulator, policy, horizon=horizon)
        except DivergentKernelError:
            continue
        if np.isfinite(level).all():
            found.append(level)
    return found


def _both(name: str, values: Callable[[Rows], Array], *, expected: bool = False) -> list[Feature]:
    """A feature, and itself in standard deviations of each row."""
    return [
        Feature(name, values, expected=expected),
        Feature(f"{name} / sd", values, by_deviation=True, expected=expected),
    ]


def _at_arrival(level: Array) -> Callable[[Rows], Array]:
    return lambda rows: level[rows.arrival]


def _ahead(simulator: FiniteMDP, level: Array) -> Callable[[Rows], Array]:
    """r(s, a, s') + gamma V(s'), scaled to at most 1."""
    pay = simulator.reward_data
    size = max(float(np.abs(level).max()), 0.0 if pay is None else float(np.abs(pay).max()), 1e-300)

    def values(rows: Rows) -> Array:
        ahead = simulator.discount * (level / size)[rows.arrival]
        return ahead if pay is None else ahead + pay[rows.entries] / size

    return values


def _displacements(simulator: FiniteMDP, rows: Rows) -> list[Feature]:
    """Indicators of the most frequent displacements that some row can choose against another."""
    places = _places(simulator)
    kinds, kind = distinct_rows(_steps(places, rows))
    mass = np.bincount(kind, weights=rows.weights) / max(len(rows), 1)
    order = np.argsort(-np.round(mass, 12), kind="stable")[:MOVES]
    return [
        Feature(f"move {_words(kinds[k])}", _indicator(places, kinds[k]))
        for k in order
        if mass[k] >= FREQUENT
    ]  # fmt: skip


def _places(simulator: FiniteMDP) -> Array:
    if simulator.layout is not None:
        return simulator.layout
    return np.arange(simulator.n_states, dtype=np.float64)[:, None]


def _steps(places: Array, rows: Rows) -> Array:
    return round_displacements(places[rows.arrival] - rows.spread(places[rows.state]))


def _indicator(places: Array, step: Array) -> Callable[[Rows], Array]:
    return lambda rows: (_steps(places, rows) == step).all(axis=1)


def _words(step: Array) -> str:
    numbers = ", ".join(f"{x:+g}" if x else "0" for x in step)
    return numbers if len(step) == 1 else f"({numbers})"


def by_action(features: Sequence[Feature], n_actions: int) -> BoolArray:
    """(1 + A, d) whether the library has feature j for all actions (first row) and for action b alone (row 1 + b)."""
    alone = np.array([feature.by_action and n_actions > 1 for feature in features])
    return np.vstack([np.ones(len(features), dtype=bool), np.tile(alone, (n_actions, 1))])


Chosen = tuple[int, int]  # a feature's number, and 0 for all actions or 1 + the action that it is for


def name_of(chosen: Chosen, features: Sequence[Feature]) -> str:
    """A chosen feature in words."""
    name = features[chosen[0]].name
    return name if chosen[1] == 0 else f"{name}, action {chosen[1] - 1}"


def columns_of(chosen: Sequence[Chosen], base: Any, scale: Array, action: IntArray) -> Array:
    """(entries, k) of the chosen features, from ``base(j)``, the column of feature j, each divided by its scale."""
    found = [
        base(j) * (1.0 if part == 0 else action == part - 1) / scale[part, j] for j, part in chosen
    ]  # fmt: skip
    return np.column_stack(found)
