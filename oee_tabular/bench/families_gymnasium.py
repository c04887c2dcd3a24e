"""Families from other packages: Gymnasium's toy text and ICU-Sepsis."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from oee_tabular.bench.family import Family
from oee_tabular.bench.making import pair
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.tasks import toy_text

MISSING_ICU = "icu_sepsis is left out: it needs the package icu-sepsis (pip install 'oee-tabular[bench]')."
PATIENTS, DEATH, SURVIVAL = 713, 713, 714  # states of the package: patients, then the two ends


def frozen_lake() -> Family:
    """FrozenLake 8 x 8: a step goes where it is meant with probability 1/3 simulated, .6 real."""
    simulator, target = (toy_text("FrozenLake-v1", map_name="8x8", success_rate=rate) for rate in (1 / 3, 0.6))
    return pair(simulator, target, "The ice is less slippery than simulated.", recorded="half")


def taxi_rain() -> Family:
    """Taxi in the rain: it goes where it is sent with probability .8 simulated, .6 real."""
    simulator, target = (
        toy_text("Taxi-v4", discount=0.95, is_rainy=True, rainy_probability=rate) for rate in (0.8, 0.6)
    )
    return pair(simulator, target, "It rains harder than simulated: the taxi misses more turns.", recorded="policy")


def cliff_walking() -> Family:
    """CliffWalking: one action in ten is replaced by a random one in the simulator, three in ten in the target."""
    simulator = toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.1)
    wet = toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.3)
    return pair(simulator, wet.transitions, "The edge of the cliff is more slippery than simulated.", recorded="policy")


def icu_file() -> Path | None:
    """The table that the package icu-sepsis ships, or None without it (the package need not be imported)."""
    found = importlib.util.find_spec("icu_sepsis")
    if found is None or not found.submodule_search_locations:
        return None
    return Path(found.submodule_search_locations[0]) / "envs" / "assets" / "dynamics.npz"


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
    n_states = len(start)
    chosen = chosen.reshape(n_states, 5, 5)
    levels = chosen.sum(axis=2, keepdims=True)
    given = np.where(levels > 0, chosen / np.where(levels > 0, levels, 1.0), 0.2)
    averaged = np.einsum("sab,sabt->sat", given, moves.reshape(n_states, 5, 5, n_states))
    sicker = averaged.copy()
    sicker[:PATIENTS, :, DEATH] *= 2.0
    sicker[:PATIENTS, :, SURVIVAL] *= 0.7
    rewards = np.zeros_like(averaged)
    rewards[:PATIENTS, :, SURVIVAL] = 1.0
    rows, worse = (table / table.sum(axis=2, keepdims=True) for table in (averaged, sicker))
    ends = np.arange(n_states) >= PATIENTS
    clinicians = np.where(ends[:, None], 0.2, levels[:, :, 0])
    clinicians /= clinicians.sum(axis=1, keepdims=True)
    simulator = FiniteMDP(rows, rewards, start / start.sum(), 0.99)
    target = simulator.with_transitions(worse)
    return Family(
        simulator, target, clinicians, mix(clinicians, uniform_policy(simulator), 0.5),
        "Patients are sicker than simulated: death is twice as likely, survival .7 times.",
    )  # fmt: skip
