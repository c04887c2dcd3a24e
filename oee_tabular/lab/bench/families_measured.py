"""Families of measured models: the engines of buses, and patients with sepsis."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import normalize
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.tasks import bus_engines

MONTHS_PER_BUS = 117  # of group 4: each of its 37 buses was recorded as long
MISSING_ICU = (
    "icu_sepsis is left out: it needs the package icu-sepsis (in a clone: pip install"
    " '.[bench]')."
)


def real_buses() -> Family:
    """Make the family of Rust's bus engines, whose target is measured.

    The wear of group 3 simulates that of group 4. The log's engines are replaced as
    often as the recorded ones, by bin.
    """
    buses = bus_engines()
    return Family(
        buses.simulator,
        buses.target,
        buses.policy,
        buses.data_policy,
        "Other buses of the same company wear less than the simulated ones.",
        length=MONTHS_PER_BUS,
    )


def icu_file() -> Path | None:
    """Return the table that the package icu-sepsis ships, or None without it.

    The package need not be imported.
    """
    package = importlib.util.find_spec("icu_sepsis")
    if package is None or not package.submodule_search_locations:
        return None
    return (
        Path(package.submodule_search_locations[0]) / "envs" / "assets" / "dynamics.npz"
    )


def icu_sepsis() -> Family:
    """Make the family of patients with sepsis [1].

    Actions are five levels of the first drug; the second drug is given as the
    clinicians chose it. The discount is .99. In the target death is twice as likely and
    survival .7 times, with the rows scaled to sum to 1. The policy is the clinicians'
    levels.

    Reference: [1] K. Choudhary, D. Gupta, P. S. Thomas, ICU-Sepsis: a benchmark MDP
    built from real medical data, RLC 2024.
    """
    path = icu_file()
    if path is None:
        raise ImportError(MISSING_ICU)
    with np.load(path) as table:
        moves = table["tx_mat"]
        start = table["d_0"]
        chosen = table["expert_policy"]
    # 713 states are patients'; then come death, survival, and what follows.
    n_states = len(start)
    ends = slice(713, None)
    chosen = chosen.reshape(n_states, 5, 5)
    levels = chosen.sum(axis=2, keepdims=True)
    given = np.where(levels > 0, chosen / np.where(levels > 0, levels, 1.0), 0.2)
    averaged = np.einsum(
        "sab,sabt->sat", given, moves.reshape(n_states, 5, 5, n_states)
    )
    sicker = averaged.copy()
    sicker[:713, :, 713:715] *= [2.0, 0.7]
    rewards = np.zeros_like(averaged)
    rewards[:713, :, 714] = 1.0
    clinicians = levels[:, :, 0].copy()
    clinicians[ends] = 0.2
    clinicians = normalize(clinicians)
    simulator = FiniteMDP(normalize(averaged), rewards, start / start.sum(), 0.99)
    about = (
        "Patients are sicker than simulated: death is twice as likely, survival .7"
        " times."
    )
    return Family(
        simulator,
        simulator.with_transitions(normalize(sicker)),
        clinicians,
        mix(clinicians, uniform_policy(simulator), 0.5),
        about,
    )
