"""Eight kinds of faults that lie exactly where nothing was ever recorded.

The recorded policy never takes the pairs in which target and simulator differ; a near
policy spends 3 to 5% of its time in them, a far one 5 to 8%, or as near to that as the
pairs allow. In half of the seeds the recorded pairs agree with the simulator, in the
other half nearly. Models and policies are drawn anew for each seed.

``families`` makes these and the kinds of ``families_redrawn``. Rules and
constants of the interval were chosen on those that ``SPLIT`` calls tuned, and the held
ones were run once when the choice was fixed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import optimize

from oee_tabular._sparse import csr_on_pattern, row_of_entry
from oee_tabular.exact import occupancy, optimal_policy, state_values
from oee_tabular.lab.bench import families_redrawn as redrawn
from oee_tabular.lab.bench.families_redrawn import KINDS
from oee_tabular.lab.bench.families_redrawn.coordinates import (
    COLUMNS_RIGHT,
    ROWS_UP,
    clipped,
    parts,
)
from oee_tabular.lab.bench.families_redrawn.draws import Generator, between, both
from oee_tabular.lab.bench.families_redrawn.kind import Kind, make_pairs
from oee_tabular.lab.bench.families_redrawn.living import LEVEL
from oee_tabular.lab.bench.families_redrawn.queues import LARGE_JOBS
from oee_tabular.lab.bench.families_redrawn.stores import CHARGE
from oee_tabular.lab.bench.family import Family, check_seed
from oee_tabular.lab.bench.laws import poisson, scale_rows
from oee_tabular.lab.bench.mapping import Families
from oee_tabular.lab.bench.shift import Moves
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.typing import Array, BoolArray, IntArray

SPLIT: Mapping[str, str] = {
    "sticky_places": "tuned",
    "closed_doors": "held",
    "broken_orders": "tuned",
    "steep_slope": "held",
    "worn_out": "tuned",
    "deep_discharge": "held",
    "strong_dose": "held",
    "thrashing_queue": "tuned",
}

# columns 0 to 8 of six rows; a wall of two doors is between columns 4 and 5
DOORS = np.array([1 * 9 + 4, 4 * 9 + 4])


def floor(s: IntArray, a: IntArray, slip: float) -> Moves:
    """Move on 8 x 8 places, with some slips to any side and some stops."""
    row, column = parts(s, 8, 8)
    yield 0.9 - slip, clipped((8, 8), row + ROWS_UP[a], column + COLUMNS_RIGHT[a])
    yield 0.1 + 0.0 * a, s
    for k in range(4):
        to = clipped((8, 8), row + ROWS_UP[k], column + COLUMNS_RIGHT[k])
        yield slip / 4 + 0.0 * a, to


def rooms(s: IntArray, a: IntArray, slip: float) -> Moves:
    """Move in two rooms with a wall between them that has two doors."""
    row, column = parts(s, 6, 9)

    def step(k: Any) -> Any:
        """Return the place after a step that walls may stop."""
        to = clipped((6, 9), row + ROWS_UP[k], column + COLUMNS_RIGHT[k])
        crosses = (column == 4) & (to % 9 == 5) | (column == 5) & (to % 9 == 4)
        return np.where(crosses & (row != 1) & (row != 4), s, to)

    yield 0.92 - slip, step(a)
    yield 0.08 + 0.0 * a, s
    for k in (0, 1):
        yield slip / 2 + 0.0 * a, step(k)


def orders(s: IntArray, a: IntArray, demand: float, fails: float) -> Moves:
    """Order 0 to 12 units; now and then only a third of an order comes."""
    for p, come in ((1 - fails, 3 * a), (fails, a)):
        full = np.minimum(s + come, 19)
        yield p * poisson(demand, full), full - np.arange(20)


def slope(s: IntArray, a: IntArray, pull: float) -> Moves:
    """Climb 30 places by running, walking or resting."""
    up = np.choose(a, [0.05, 0.3, 0.55])
    back = pull * (1 + s / 30)
    return (up, s + 1), (back, s - 1), (0.9 - up - back, s), (0.1, s - 2)


def wear(s: IntArray, a: IntArray, one: float, two: float) -> Moves:
    """Keep, repair or replace a machine with wear 0 to 23."""
    after = np.choose(a, [s, s // 2, 0])
    return (
        (1 - one - two, after),
        (one, after + 1),
        (0.8 * two, after + 2),
        (0.2 * two, after + 5),
    )


FLOOR = Kind(
    "In eight places the move that leads on was never recorded, and mostly sticks.",
    (64, 4),
    np.append(-np.ones(63), 0.0),
    0.97,
    both(between((0.1, 0.25)), between((1.0, 1.0))),
    floor,
    start=range(63),
    ends=[63],
)
ROOMS = Kind(
    "Nobody recorded a passage of the doors between two rooms, which are mostly shut.",
    (54, 4),
    np.append(-np.ones(53), 0.0),
    0.98,
    both(between((0.08, 0.2)), between((1.0, 1.0))),
    rooms,
    start=range(53),
    ends=[53],
)
ORDERS = Kind(
    "Large orders were never recorded, and mostly come incomplete.",
    (20, 5),
    lambda s, a, to: 2.5 * np.maximum(s + 3 * a - to, 0) - 4.0 * a - 0.1 * to,
    0.95,
    both(
        between((3.0, 5.0), (0.05, 0.15)),
        between((1.0, 1.0), (1.0, 1.0)),
    ),
    orders,
)
SLOPE = Kind(
    "Nobody ran on the upper half of the slope, which is steeper there than simulated.",
    (31, 3),
    lambda s, a, to: np.where(s == 30, 0.0, 10.0 * (to == 30) - 0.1 - 0.1 * a),
    0.98,
    both(between((0.08, 0.12)), between((1.0, 1.0))),
    slope,
    ends=[30],
    start=range(5, 25),
)
WEAR = Kind(
    "A worn machine was always repaired; kept, it wears faster than simulated.",
    (24, 3),
    3.0 - 0.01 * np.arange(24.0)[:, None] ** 2 - np.array([0.0, 1.5, 5.0]),
    0.96,
    both(
        between((0.3, 0.45), (0.1, 0.2)),
        between((1.0, 1.0), (1.0, 1.0)),
    ),
    wear,
)


def best_in_some_places(family: Family, rng: Generator) -> BoolArray:
    """Return the best action's pair in eight places that the optimum visits often."""
    best = optimal_policy(family.simulator)
    time = occupancy(family.simulator, best).sum(axis=1)
    often = np.argsort(-np.where(family.simulator.absorbing(), 0.0, time))[:32]
    hidden = np.zeros(best.shape, dtype=np.bool_)
    hidden[rng.permutation(often)[:8]] = True
    return hidden & (best > 0)


def pairs(shape: tuple[int, int], states: Any, actions: Any) -> BoolArray:
    """Return a mask of these actions in these states."""
    hidden = np.zeros(shape, dtype=np.bool_)
    hidden[np.ix_(np.arange(shape[0])[states], np.atleast_1d(actions))] = True
    return hidden


def stay(family: Family, values: Array, entries: IntArray) -> BoolArray:
    """Return whether an entry leads to its own state."""
    model = family.simulator
    state = row_of_entry(model.transitions)[entries] // model.n_actions
    return np.asarray(model.transitions.indices[entries] == state)


def worst(family: Family, values: Array, entries: IntArray) -> BoolArray:
    """Return whether an entry leads to the worst next state of its pair."""
    matrix = family.simulator.transitions
    row = row_of_entry(matrix)[entries]
    ahead = values[matrix.indices[entries]]
    least = np.full(matrix.shape[0], np.inf)
    np.minimum.at(least, row, ahead)
    return np.asarray(ahead == least[row])


Outcome = Callable[[Family, Array, IntArray], BoolArray]
Where = Callable[[Family, Generator], BoolArray]

# kind, pairs that nobody recorded, what goes wrong there, and in which share of steps
FAULTS: Mapping[str, tuple[Kind, Where, Outcome, tuple[float, float]]] = {
    "sticky_places": (FLOOR, best_in_some_places, stay, (0.4, 0.75)),
    "closed_doors": (
        ROOMS,
        lambda family, rng: pairs((54, 4), DOORS, 3),
        stay,
        (0.4, 0.8),
    ),
    "broken_orders": (
        ORDERS,
        lambda family, rng: pairs((20, 5), slice(0, 12), [3, 4]),
        worst,
        (0.1, 0.4),
    ),
    "steep_slope": (
        SLOPE,
        lambda family, rng: pairs((31, 3), slice(15, 30), 2),
        worst,
        (0.2, 0.5),
    ),
    "worn_out": (
        WEAR,
        lambda family, rng: pairs((24, 3), slice(6, 24), 0),
        worst,
        (0.1, 0.3),
    ),
    "deep_discharge": (
        replace(
            KINDS["battery"],
            about="Nobody boosted a nearly empty battery, which then loses all at"
            " once.",
            draw=both(
                between((0.08, 0.14), (0.015, 0.03)),
                between((1.0, 1.0), (1.0, 1.0)),
            ),
        ),
        lambda family, rng: pairs((50, 3), (CHARGE <= 4) & (CHARGE > 0), 2),
        worst,
        (0.2, 0.5),
    ),
    "strong_dose": (
        replace(
            KINDS["dosing"],
            about="Nobody gave the strongest doses, which harm more than simulated.",
            draw=both(
                between((0.3, 0.45), (0.15, 0.3)),
                between((1.0, 1.0), (1.0, 1.0)),
            ),
        ),
        lambda family, rng: pairs((60, 4), LEVEL >= 3, 3),
        worst,
        (0.1, 0.4),
    ),
    "thrashing_queue": (
        replace(
            KINDS["admission"],
            about="Nobody admitted all jobs to a long queue, which then gets stuck.",
            draw=both(
                between((0.12, 0.18), (0.16, 0.22)),
                between((1.0, 1.0), (1.0, 1.0)),
            ),
        ),
        lambda family, rng: pairs((49, 3), LARGE_JOBS >= 2, 2),
        worst,
        (0.2, 0.6),
    ),
}


def make_fault(name: str, rng: Generator) -> tuple[Family, Family]:
    """Draw a kind of faults, and make its families with a near and a far policy."""
    kind, where, outcome, shares = FAULTS[name]
    drawn, _ = kind.make(rng)
    hidden = where(drawn, rng)
    target = break_pairs(drawn, hidden, outcome, shares, rng)
    recorded, near, far = avoid_pairs(drawn.simulator, hidden, rng)
    policies = [
        spend_time(target, policy, hidden, float(rng.uniform(*goal)))
        for policy, goal in ((near, (0.03, 0.05)), (far, (0.05, 0.08)))
    ]
    one, other = (
        replace(drawn, target=target, policy=policy, data_policy=recorded)
        for policy in policies
    )
    return one, other


def break_pairs(
    drawn: Family,
    hidden: BoolArray,
    outcome: Outcome,
    shares: tuple[float, float],
    rng: Generator,
) -> FiniteMDP:
    """Make the target in which hidden pairs end badly in a share of their steps.

    In half of the draws the other pairs are a little off as well.
    """
    model = drawn.simulator
    matrix = model.transitions
    row = row_of_entry(matrix)
    p = matrix.data.copy()
    if rng.random() < 0.5:
        p = rng.gamma(300.0 * p) + np.finfo(float).tiny
        p = scale_rows(csr_on_pattern(matrix, p)).data
    # The fault takes a share of each hidden row and gives it to the bad outcome.
    values = state_values(model, optimal_policy(model))
    entries = np.flatnonzero(hidden.reshape(-1)[row])
    is_bad = outcome(drawn, values, entries)
    bad = np.zeros(len(p))
    bad[entries] = is_bad * matrix.data[entries]
    total = np.bincount(row, bad, minlength=matrix.shape[0])[row]
    share = np.where(total > 0, rng.uniform(*shares), 0.0)
    base = np.where(hidden.reshape(-1)[row], matrix.data, p)
    faulty = (1 - share) * base + share * bad / np.where(total > 0, total, 1.0)
    return model.with_transitions(scale_rows(csr_on_pattern(matrix, faulty)))


def avoid_pairs(
    model: FiniteMDP, hidden: BoolArray, rng: Generator
) -> tuple[Array, Array, Array]:
    """Return a recorded, a near and a far policy that never take hidden pairs."""
    uniform = np.where(hidden, 0.0, uniform_policy(model))
    uniform /= uniform.sum(axis=1, keepdims=True)
    is_here = hidden.any(axis=1, keepdims=True)
    best = np.where(is_here, uniform, optimal_policy(model))
    recorded = mix(best, uniform, float(rng.uniform(0.2, 0.6)))
    return recorded, mix(best, recorded, 0.3), mix(best, uniform, 0.95)


def spend_time(
    target: FiniteMDP, policy: Array, hidden: BoolArray, goal: float
) -> Array:
    """Return the policy that takes hidden pairs so often that its time in them is goal.

    Where they cannot take so much time, it takes them whenever it can.
    """
    bold = np.where(hidden, 1.0, 0.0)
    total = bold.sum(axis=1, keepdims=True)
    bold = np.where(total > 0, bold / np.where(total > 0, total, 1.0), policy)
    alive = ~target.absorbing()

    def excess(share: float) -> float:
        """Return the share of time in hidden pairs, less the goal."""
        time = occupancy(target, mix(bold, policy, share)) * alive[:, None]
        return float(time[hidden].sum() / time.sum()) - goal

    if excess(1.0) <= 0:
        return mix(bold, policy, 1.0)
    return mix(bold, policy, float(optimize.brentq(excess, 0.0, 1.0, xtol=1e-4)))


def families(seed: int = 0) -> Families:
    """Return the families whose kinds the benchmark of ``oee.bench`` does not have.

    Parameters
    ----------
    seed : int, default 0
        Seed from 0. All families differ between seeds.

    Returns
    -------
    Families
        Name -> Family: two of each kind, of which the one with the far policy has a
        name that ends in ``_far``.
    """
    number = check_seed(seed)
    makers: dict[str, Callable[[Generator], tuple[Family, Family]]] = {
        name: kind.make for name, kind in KINDS.items()
    }
    for name in FAULTS:
        makers[name] = functools.partial(make_fault, name)
    return Families(make_pairs(makers, {**redrawn.SPLIT, **SPLIT}, number), number, {})
