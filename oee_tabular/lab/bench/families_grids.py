"""Grids: the paper's, floors of 8 x 8 whose slip differs by place or by motor, Gymnasium's toy text; patients with sepsis.

Garnets: random MDPs, of which the simulator gets the probabilities wrong in several ways.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import row_of_entry
from oee_tabular.exact import optimal_policy, state_values
from oee_tabular.lab.bench.family import Family, Maker, normalize, pair, scale_rows
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.tasks import gridworld, gridworld_policy, toy_text

SIMULATED = 0.15  # slip of the floors
ROW, COLUMN = np.indices((8, 8)).reshape(2, 64, 1)
MISSING_ICU = "icu_sepsis is left out: it needs the package icu-sepsis (in a clone: pip install '.[bench]')."


def paper_grid(simulated: float, real: float, about: str) -> Maker:
    """The paper's 10 x 10 grid under half the expert's policy, recorded by uniform actions."""
    return lambda: pair(
        gridworld(10, simulated), gridworld(10, real), about, policy=gridworld_policy(10, 0.5), recorded=0.0, length=1000
    )  # fmt: skip


def make_floor(slip: Any = SIMULATED) -> FiniteMDP:
    """8 x 8 cells, started anywhere; ``slip`` is a number, or one for each cell, or each (cell, action)."""
    share = np.broadcast_to(np.asarray(slip, dtype=np.float64), (64, 4)).copy()
    share[-1] = 0.0
    always, never = gridworld(8, 1.0).transitions, gridworld(8, 0.0).transitions
    transitions = sparse.diags_array(share.ravel()) @ always + sparse.diags_array(1.0 - share.ravel()) @ never
    return FiniteMDP(transitions, 0.2 * (ROW + COLUMN - 14.0).ravel(), normalize(np.append(np.ones(63), 0.0)), 0.98)


def floor(slip: Array | float, about: str, **options: Any) -> Maker:
    """A floor that slips otherwise than simulated."""
    return lambda: pair(make_floor(), make_floor(slip), about, **options)


def floor_wind() -> Family:
    """A gust carries the robot up a row, whatever it does."""
    simulator = make_floor()
    gust = simulator.transitions[np.arange(64 * 4) // 4 * 4 + 1]
    about = "A wind blows along one direction, in a fifth of the steps; the simulator has none."
    return pair(simulator, 0.8 * simulator.transitions + 0.2 * gust, about)


FLOORS: dict[str, Maker] = {
    "paper_grid": paper_grid(0.3, 0.1, "The paper's: moves slip less than simulated."),
    "paper_grid_reversed": paper_grid(0.1, 0.3, "Moves slip more than simulated."),
    "floor_slippery": floor(
        np.where((ROW >= 3) & (ROW < 6) & (COLUMN >= 3) & (COLUMN < 6), 0.6, SIMULATED),
        "Nine cells in the middle of the floor are slippery, which the simulator does not know.",
    ),
    "floor_motor": floor(
        np.array([0.55, SIMULATED, SIMULATED, SIMULATED]), "One of the four motors is weak.", recorded=0.0
    ),
    "floor_chequered": floor(
        np.where((ROW + COLUMN) % 2, 0.4, SIMULATED),
        "Every other cell of the floor is more slippery than simulated.",
        recorded=0.9,
    ),
    "floor_wind": floor_wind,
    "floor_identical": floor(SIMULATED, "The simulator of the floor is right."),
}


def one_way_grid() -> Family:
    """The paper's grid from its corner with a log of its expert alone: much of what the policy does is never seen."""
    simulator, target = (gridworld(6, slip, discount=0.97) for slip in (0.3, 0.15))
    family = pair(simulator, target, "Moves slip less than simulated, and the log shows one way only.", optimal=0.6)
    narrow = pair(simulator, target, family.about, optimal=0.97).policy
    return Family(simulator, target, family.policy, narrow, family.about)


def frozen_lake() -> Family:
    """FrozenLake 8 x 8: a step goes where it is meant with probability 1/3 simulated, .6 real."""
    simulator, target = (toy_text("FrozenLake-v1", map_name="8x8", success_rate=rate) for rate in (1 / 3, 0.6))
    return pair(simulator, target, "The ice is less slippery than simulated.")


def taxi_rain() -> Family:
    """Taxi in the rain: it goes where it is sent with probability .8 simulated, .6 real."""
    simulator, target = (
        toy_text("Taxi-v4", discount=0.95, is_rainy=True, rainy_probability=rate) for rate in (0.8, 0.6)
    )
    return pair(simulator, target, "It rains harder than simulated: the taxi misses more turns.", recorded=0.9)


def cliff_walking() -> Family:
    """CliffWalking: one action in ten is replaced by a random one in the simulator, three in ten in the target."""
    simulator, wet = (toy_text("CliffWalking-v1", discount=0.95).with_action_noise(noise) for noise in (0.1, 0.3))
    about = "The edge of the cliff is more slippery than simulated."
    return pair(simulator, wet.transitions, about, recorded=0.9)


def icu_file() -> Path | None:
    """The table that the package icu-sepsis ships, or None without it (the package need not be imported)."""
    package = importlib.util.find_spec("icu_sepsis")
    if package is None or not package.submodule_search_locations:
        return None
    return Path(package.submodule_search_locations[0]) / "envs" / "assets" / "dynamics.npz"


def icu_sepsis() -> Family:
    """Patients with sepsis [1], five levels of the first drug, the second's as the clinicians chose them; discount .99.

    In the target death is twice as likely and survival .7 times, the rows scaled. Policy: the clinicians' levels.

    Reference: [1] K. Choudhary, D. Gupta, P. S. Thomas, ICU-Sepsis: a benchmark MDP built from real medical data, RLC 2024.
    """
    path = icu_file()
    if path is None:
        raise ImportError(MISSING_ICU)
    with np.load(path) as table:
        moves, start, chosen = table["tx_mat"], table["d_0"], table["expert_policy"]
    n_states, ends = len(start), slice(713, None)  # 713 states of patients; then death, survival, and what follows
    chosen = chosen.reshape(n_states, 5, 5)
    levels = chosen.sum(axis=2, keepdims=True)
    given = np.where(levels > 0, chosen / np.where(levels > 0, levels, 1.0), 0.2)
    averaged = np.einsum("sab,sabt->sat", given, moves.reshape(n_states, 5, 5, n_states))
    sicker = averaged.copy()
    sicker[:713, :, 713:715] *= [2.0, 0.7]
    rewards = np.zeros_like(averaged)
    rewards[:713, :, 714] = 1.0
    clinicians = levels[:, :, 0].copy()
    clinicians[ends] = 0.2
    clinicians = normalize(clinicians)
    simulator = FiniteMDP(normalize(averaged), rewards, start / start.sum(), 0.99)
    about = "Patients are sicker than simulated: death is twice as likely, survival .7 times."
    return Family(
        simulator, simulator.with_transitions(normalize(sicker)), clinicians,
        mix(clinicians, uniform_policy(simulator), 0.5), about,
    )  # fmt: skip


ACTIONS, SUCCESSORS = 3, 5
Change = Callable[[FiniteMDP, np.random.Generator], Any]  # new weights of the simulator's transitions, row by row


def garnet(about: str, change: Change | None = None, *, n_states: int = 40, recorded: float = 0.5) -> Maker:
    """Each (s, a) leads to five random states with uniform Dirichlet probabilities, r(s, a) is normal; and its ``change``."""

    def make(rng: np.random.Generator) -> Family:
        rows = n_states * ACTIONS
        to = np.argsort(rng.random((rows, n_states)), axis=1)[:, :SUCCESSORS]
        data = rng.dirichlet(np.ones(SUCCESSORS), rows)
        entries = data.ravel(), (np.repeat(np.arange(rows), SUCCESSORS), to.ravel())
        rewards = rng.normal(size=(n_states, ACTIONS))
        simulator = FiniteMDP(
            sparse.csr_array(entries, (rows, n_states)), rewards, np.full(n_states, 1 / n_states), 0.95
        )
        matrix = target = simulator.transitions
        if change is not None:
            target = scale_rows(sparse.csr_array((change(simulator, rng), matrix.indices, matrix.indptr), matrix.shape))
        return pair(simulator, target, about, recorded=recorded)

    return make


def redraw_a_twentieth(simulator: FiniteMDP, rng: np.random.Generator) -> Array:
    """A twentieth of the rows is drawn anew from the uniform Dirichlet distribution."""
    matrix = simulator.transitions
    rows = rng.permutation(matrix.shape[0])[: matrix.shape[0] // 20]
    return np.asarray(np.where(np.isin(row_of_entry(matrix), rows), rng.exponential(size=matrix.nnz), matrix.data))


def redraw(strength: float) -> Change:
    """Every row is drawn anew from Dirichlet(strength * row)."""
    return lambda simulator, rng: rng.gamma(strength * simulator.transitions.data) + np.finfo(float).tiny


def tilt(exponent: float, *, action: int | None = None) -> Change:
    """P exp(exponent z(V)), V of the family's policy, standardised, in the rows of all actions or of one."""

    def change(simulator: FiniteMDP, _: np.random.Generator) -> Array:
        matrix = simulator.transitions
        mine = action is None or row_of_entry(matrix) % ACTIONS == action
        values = state_values(simulator, mix(optimal_policy(simulator), uniform_policy(simulator), 0.9))
        z = ((values - values.mean()) / values.std())[matrix.indices]
        return np.asarray(matrix.data * np.exp(exponent * z * mine))

    return change


def worse(n_states: int = 40) -> Maker:
    """What makes a Garnet of that size, a little worse everywhere along V."""
    return garnet("Every move is a little worse than simulated, along V.", tilt(-0.25), n_states=n_states)


GARNETS: dict[str, Maker] = {
    "garnet_dirichlet100": garnet("Every row is a little off, at random.", redraw(100.0)),
    "garnet_dirichlet10": garnet("Every row is far off, at random.", redraw(10.0), recorded=0.0),
    "garnet_replaced": garnet("A twentieth of the rows is wrong.", redraw_a_twentieth, recorded=0.9),
    "garnet_worse": worse(),
    "garnet_better": garnet("Every move is a little better than simulated, along V.", tilt(0.25), recorded=0.0),
    "garnet_one_action": garnet("The moves of one action are worse.", tilt(-0.5, action=0)),
    "garnet_tempered": garnet(
        "Moves are noisier than simulated.", lambda simulator, _: simulator.transitions.data**0.7, recorded=0.9
    ),
    "garnet_identical": garnet("The simulator of the random MDP is right."),
}
LARGE_GARNETS = {f"garnet_worse{n}": worse(n) for n in (10, 20, 80, 160)}


def garnet_worse(n_states: int = 40, seed: int = 0) -> Family:
    """A Garnet that is a little worse everywhere along V: P exp(-.25 z(V)), as ``garnet_worse``, of any size.

    Parameters
    ----------
    n_states : int of at least 5
    seed : int from 0; the Garnet is another one for each

    Examples
    --------
    >>> family = garnet_worse(10)
    >>> family.open_rows, family.truth < 20
    (30, True)
    """
    if _checks.positive_integer(n_states, "n_states") < SUCCESSORS:
        raise ValueError(f"n_states must be at least {SUCCESSORS}; it is {n_states}")
    return worse(n_states)(np.random.default_rng([seed, n_states]))


TABLES: dict[str, Maker] = {
    "frozen_lake": frozen_lake, "taxi_rain": taxi_rain, "cliff_walking": cliff_walking, "icu_sepsis": icu_sepsis,
}  # fmt: skip
LAST: dict[str, Maker] = {"one_way_grid": one_way_grid}
