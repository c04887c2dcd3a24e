"""Further families, from other trades: nobody's prior was made for them."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from oee_tabular._checks import BoolArray, IntArray
from oee_tabular.lab.bench.family import Family, Moves, binomial, poisson, shifted
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy

MISSING_ICU = "icu_sepsis is left out: it needs the package icu-sepsis (in a clone: pip install '.[bench]')."
PATIENTS, DEATH, SURVIVAL = 713, 713, 714  # states of the package: patients, then the two ends


def ageing_asset() -> Family:
    """Age 0 to 9, or failed by wear (10), or by a shock (11); run gently, run hard, renew. Hard running ages and earns more."""

    def moves(state: int, action: int, shock: float) -> Moves:
        if state >= 10 or action == 2:
            repaired = {10: 0.5, 11: 0.7}.get(state, 0.95) if action == 2 else 0.05
            yield repaired, 0
            yield 1 - repaired, state
            return
        wear = 0.003 * (1 + action) * state
        older = 0.4 + 0.3 * action
        yield wear, 10
        yield shock * (1 + action), 11
        yield (1 - wear - shock * (1 + action)) * older, min(state + 1, 9)
        yield (1 - wear - shock * (1 + action)) * (1 - older), state

    pay = np.array([[1.0, 1.6, -2.0]] * 10 + [[-1.0, -1.0, -3.0], [-0.5, -0.5, -1.5]])
    about = "One of two ways to fail, the shock, is more frequent than simulated."
    return shifted(moves, (12, 3), pay, 0.98, (0.02,), (0.05,), about, start=range(10))


def epidemic() -> Family:
    """Twelve people, susceptible and infected; nothing, distance (.5) or lockdown (1.2); an infected one costs 1 a step."""
    people = 12
    states = [(s, i) for s in range(people + 1) for i in range(people + 1 - s)]
    number = {state: k for k, state in enumerate(states)}

    def moves(state: int, action: int, infection: float) -> Moves:
        s, i = states[state]
        rate = infection * (1.0, 0.55, 0.25)[action]
        caught = binomial(s, 1 - (1 - rate / people) ** i)
        for new, p in enumerate(caught):
            for well, q in enumerate(binomial(i, 0.25)):
                yield p * q * (0.98 if s < people else 1.0), number[s - new, i - well + new]
        if s < people:  # immunity is lost: all begins again
            yield 0.02, number[people - 2, 2]

    pay = -np.array([i for _, i in states])[:, None] - np.array([0.0, 0.5, 1.2])
    start = [number[people - 2, 2], number[people - 4, 2], number[6, 3]]
    about = "Infection is more likely than simulated."
    return shifted(moves, (len(states), 3), pay, 0.95, (0.5,), (0.7,), about, start=start, recorded="uniform")


def clinical_trial() -> Family:
    """Six patients, two arms; the simulator predicts by the counts so far, Beta(1, 1); the arms cure .6 and .25 in truth."""
    patients = 6
    every = [(a, b, c, d) for a in range(7) for b in range(7) for c in range(7) for d in range(7)]
    states = [state for state in every if sum(state) <= patients]
    number = {state: k for k, state in enumerate(states)}

    def moves(state: int, arm: int, *arms: float) -> Moves:
        counts = list(states[state])
        if sum(counts) == patients:
            yield 1.0, state
            return
        cured, failed = counts[2 * arm], counts[2 * arm + 1]
        cure = arms[arm] if arms else (cured + 1) / (cured + failed + 2)
        for place, probability in ((2 * arm, cure), (2 * arm + 1, 1 - cure)):
            after = counts.copy()
            after[place] += 1
            yield probability, number[after[0], after[1], after[2], after[3]]

    cures = np.array([a + c for a, _, c, _ in states], dtype=np.float64)
    about = "The simulator predicts two arms of a trial from a uniform prior; one cures often, one seldom."
    return shifted(
        moves, (len(states), 2), lambda s, a, to: cures[to] - cures[s], 0.99, (), (0.6, 0.25), about,
        start=number[0, 0, 0, 0], optimal=0.85,
    )  # fmt: skip


def parking() -> Family:
    """Fifteen places on the way to a shop; drive on, or park where it is free; walking costs more than driving; rounds."""

    def moves(state: int, park: int, free: float) -> Moves:
        distance, empty = divmod(state, 2)
        if state == 30 or (park and empty):
            yield 1.0, 30
            return
        ahead = distance - 1 if distance else 14
        chance = free * (0.4 + 0.6 * ahead / 14)
        yield chance, 2 * ahead + 1
        yield 1 - chance, 2 * ahead

    pay = np.full((31, 2), -0.3)
    pay[1:30:2, 1] = -0.2 - 0.5 * np.arange(15)
    pay[30] = 0.0
    about = "Free places are rarer than simulated."
    return shifted(moves, (31, 2), pay, 0.99, (0.5,), (0.3,), about, start=range(16, 30), recorded="uniform")


def random_walk() -> Family:
    """21 places with absorbing ends, the right one pays 1; two steps' sizes; the drift is towards the left."""

    def moves(place: int, far: int, left: float) -> Moves:
        if place in (0, 20):
            yield 1.0, place
            return
        yield left, max(place - 1 - far, 0)
        yield 1 - left, min(place + 1 + far, 20)

    about = "The walk drifts to the losing side; the simulator has it fair."
    return shifted(moves, (21, 2), _won, 0.99, (0.5,), (0.56,), about, start=range(5, 16))


def gambler() -> Family:
    """Capital 0 to 20, stakes of 1, 2 or 4; at 20 the game is won and pays 1, at 0 it is lost."""

    def moves(capital: int, action: int, win: float) -> Moves:
        if capital in (0, 20):
            yield 1.0, capital
            return
        stake = min((1, 2, 4)[action], capital, 20 - capital)
        yield win, capital + stake
        yield 1 - win, capital - stake

    about = "The bank wins more often than simulated."
    return shifted(moves, (21, 3), _won, 0.99, (0.48,), (0.42,), about, start=range(1, 20), recorded="policy")


def _won(s: IntArray, a: IntArray, to: IntArray) -> BoolArray:
    """1 on arrival at 20."""
    return np.asarray((to == 20) & (s != 20))


def sensors() -> Family:
    """A ring of 30 places, moves of -1, 0 or 2 with noise of two places; a pay at one place; noise is wider in one half."""
    noise = np.array([0.05, 0.2, 0.5, 0.2, 0.05])
    wide = noise**0.5 / (noise**0.5).sum()

    def moves(place: int, action: int, half: int) -> Moves:
        for shift, probability in enumerate(wide if place >= half else noise):
            yield probability, (place + (-1, 0, 2)[action] + shift - 2) % 30

    pay = np.exp(-((np.arange(30) - 20.0) ** 2) / 4.0)
    return shifted(
        moves, (30, 3), pay, 0.95, (30,), (15,), "In half of the places the motion is noisier than simulated."
    )


def fishery() -> Family:
    """Stock 0 to 20, harvests of 0, 1, 2, 4 or 6; logistic growth with Poisson noise; a restocked sea starts at 0 or more."""
    harvests = np.array([0, 1, 2, 4, 6])

    def moves(stock: int, action: int, growth: float) -> Moves:
        left = max(stock - harvests[action], 0)
        mean = 0.3 + left + growth * left * (1 - left / 20)
        for after, probability in enumerate(poisson(mean, 20)):
            yield probability, after

    pay = np.minimum(np.arange(21)[:, None], harvests) ** 0.8
    return shifted(moves, (21, 5), pay, 0.96, (0.8,), (0.5,), "Fish grow back more slowly than simulated.")


def traffic() -> Family:
    """Twenty stretches of a road, two lanes; stay or change (.3); each lane moves with its own probability; a step costs 1."""

    def moves(state: int, change: int, *lanes: float) -> Moves:
        stretch, lane = divmod(state, 2)
        if state >= 40:
            yield 1.0, state
            return
        new = lane ^ change
        go = lanes[new] * (0.8 if change else 1.0)
        yield go, min(2 * (stretch + 1) + new, 40)
        yield 1 - go, 2 * stretch + new

    pay = np.array([[-1.0, -1.3]] * 40 + [[0.0, 0.0]])
    about = "The fast lane is jammed, which the simulator does not know."
    return shifted(moves, (41, 2), pay, 0.98, (0.7, 0.5), (0.45, 0.55), about, start=range(20))


def elevator() -> Family:
    """Nine floors, a lift up, down or waiting; calls come from floors below the middle more often than simulated."""

    def moves(state: int, action: int, low: float) -> Moves:
        lift, call = divmod(state, 10)  # call 9: none
        at = min(max(lift + action - 1, 0), 8)
        if call < 9 and at != call:
            yield 1.0, at * 10 + call
            return
        yield 0.4, at * 10 + 9
        for floor, probability in enumerate(np.where(np.arange(9) < 4, low / 4, (1 - low) / 5)):
            yield 0.6 * probability, at * 10 + floor

    pay = np.where(np.arange(90) % 10 < 9, -1.0, 0.0)[:, None] - np.array([0.1, 0.0, 0.1])
    about = "Most calls come from the lower floors; simulated, they come from anywhere."
    return shifted(moves, (90, 3), pay, 0.95, (4 / 9,), (0.8,), about, start=range(9, 90, 10))


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
