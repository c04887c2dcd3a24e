"""Further families, from other trades: nobody's prior was made for them."""

from __future__ import annotations

import importlib.util
import itertools
from pathlib import Path

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.lab.bench.family import Family, Moves, binomial, poisson, shift
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy

MISSING_ICU = "icu_sepsis is left out: it needs the package icu-sepsis (in a clone: pip install '.[bench]')."
LIVING, DEATH, SURVIVAL = 713, 713, 714  # states of the package: patients, then the two ends


@shift(
    (12, 3), np.array([[1.0, 1.6, -2.0]] * 10 + [[-1.0, -1.0, -3.0], [-0.5, -0.5, -1.5]]), 0.98, (0.02,), (0.05,),
    "One of two ways to fail, the shock, is more frequent than simulated.", start=range(10),
)  # fmt: skip
def ageing_asset(state: int, action: int, shock: float) -> Moves:
    """Age 0 to 9, or failed by wear (10), or by a shock (11); run gently, run hard, renew. Hard running ages and earns more."""
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


PEOPLE = 12
SICK = [(s, i) for s in range(PEOPLE + 1) for i in range(PEOPLE + 1 - s)]  # susceptible, infected
NUMBER_OF_SICK = {state: k for k, state in enumerate(SICK)}


@shift(
    (len(SICK), 3), -np.array([i for _, i in SICK])[:, None] - np.array([0.0, 0.5, 1.2]), 0.95, (0.5,), (0.7,),
    "Infection is more likely than simulated.", recorded="uniform",
    start=[NUMBER_OF_SICK[state] for state in ((PEOPLE - 2, 2), (PEOPLE - 4, 2), (6, 3))],
)  # fmt: skip
def epidemic(state: int, action: int, infection: float) -> Moves:
    """Twelve people, susceptible and infected; nothing, distance (.5) or lockdown (1.2); an infected one costs 1 a step."""
    s, i = SICK[state]
    rate = infection * (1.0, 0.55, 0.25)[action]
    caught = binomial(s, 1 - (1 - rate / PEOPLE) ** i)
    for new, p in enumerate(caught):
        for well, q in enumerate(binomial(i, 0.25)):
            yield p * q * (0.98 if s < PEOPLE else 1.0), NUMBER_OF_SICK[s - new, i - well + new]
    if s < PEOPLE:  # immunity is lost: all begins again
        yield 0.02, NUMBER_OF_SICK[PEOPLE - 2, 2]


PATIENTS = 6
TRIALS = [state for state in itertools.product(range(7), repeat=4) if sum(state) <= PATIENTS]  # cured, failed, twice
NUMBER_OF_TRIAL = {state: k for k, state in enumerate(TRIALS)}
CURES = np.array([a + c for a, _, c, _ in TRIALS], dtype=np.float64)


@shift(
    (len(TRIALS), 2), lambda s, a, to: CURES[to] - CURES[s], 0.99, (), (0.6, 0.25),
    "The simulator predicts two arms of a trial from a uniform prior; one cures often, one seldom.",
    start=NUMBER_OF_TRIAL[0, 0, 0, 0], optimal=0.85,
)  # fmt: skip
def clinical_trial(state: int, arm: int, *arms: float) -> Moves:
    """Six patients, two arms; the simulator predicts by the counts so far, Beta(1, 1); the arms cure .6 and .25 in truth."""
    counts = list(TRIALS[state])
    if sum(counts) == PATIENTS:
        yield 1.0, state
        return
    cured, failed = counts[2 * arm], counts[2 * arm + 1]
    cure = arms[arm] if arms else (cured + 1) / (cured + failed + 2)
    for place, probability in ((2 * arm, cure), (2 * arm + 1, 1 - cure)):
        after = counts.copy()
        after[place] += 1
        yield probability, NUMBER_OF_TRIAL[after[0], after[1], after[2], after[3]]


def _parking_pay() -> Array:
    pay = np.full((31, 2), -0.3)
    pay[1:30:2, 1] = -0.2 - 0.5 * np.arange(15)
    pay[30] = 0.0
    return pay


@shift(
    (31, 2), _parking_pay(), 0.99, (0.5,), (0.3,), "Free places are rarer than simulated.", start=range(16, 30),
    recorded="uniform",
)  # fmt: skip
def parking(state: int, park: int, free: float) -> Moves:
    """Fifteen places on the way to a shop; drive on, or park where it is free; walking costs more than driving; rounds."""
    distance, empty = divmod(state, 2)
    if state == 30 or (park and empty):
        yield 1.0, 30
        return
    ahead = distance - 1 if distance else 14
    chance = free * (0.4 + 0.6 * ahead / 14)
    yield chance, 2 * ahead + 1
    yield 1 - chance, 2 * ahead


def _arrive_at_20(s: IntArray, a: IntArray, to: IntArray) -> BoolArray:
    return np.asarray((to == 20) & (s != 20))


@shift(
    (21, 2), _arrive_at_20, 0.99, (0.5,), (0.56,), "The walk drifts to the losing side; the simulator has it fair.",
    start=range(5, 16),
)  # fmt: skip
def random_walk(place: int, far: int, left: float) -> Moves:
    """21 places with absorbing ends, the right one pays 1; two steps' sizes; the drift is towards the left."""
    if place in (0, 20):
        yield 1.0, place
        return
    yield left, max(place - 1 - far, 0)
    yield 1 - left, min(place + 1 + far, 20)


@shift(
    (21, 3), _arrive_at_20, 0.99, (0.48,), (0.42,), "The bank wins more often than simulated.", start=range(1, 20),
    recorded="policy",
)  # fmt: skip
def gambler(capital: int, action: int, win: float) -> Moves:
    """Capital 0 to 20, stakes of 1, 2 or 4; at 20 the game is won and pays 1, at 0 it is lost."""
    if capital in (0, 20):
        yield 1.0, capital
        return
    stake = min((1, 2, 4)[action], capital, 20 - capital)
    yield win, capital + stake
    yield 1 - win, capital - stake


NOISE = np.array([0.05, 0.2, 0.5, 0.2, 0.05])
WIDE = NOISE**0.5 / (NOISE**0.5).sum()


@shift(
    (30, 3), np.exp(-((np.arange(30) - 20.0) ** 2) / 4.0), 0.95, (30,), (15,),
    "In half of the places the motion is noisier than simulated.",
)  # fmt: skip
def sensors(place: int, action: int, half: int) -> Moves:
    """A ring of 30 places, moves of -1, 0 or 2 with noise of two places; a pay at one place; noise is wider in one half."""
    for step, probability in enumerate(WIDE if place >= half else NOISE):
        yield probability, (place + (-1, 0, 2)[action] + step - 2) % 30


HARVESTS = np.array([0, 1, 2, 4, 6])


@shift(
    (21, 5), np.minimum(np.arange(21)[:, None], HARVESTS) ** 0.8, 0.96, (0.8,), (0.5,),
    "Fish grow back more slowly than simulated.",
)  # fmt: skip
def fishery(stock: int, action: int, growth: float) -> Moves:
    """Stock 0 to 20, harvests of 0, 1, 2, 4 or 6; logistic growth with Poisson noise; a restocked sea starts at 0 or more."""
    left = max(stock - HARVESTS[action], 0)
    mean = 0.3 + left + growth * left * (1 - left / 20)
    for after, probability in enumerate(poisson(mean, 20)):
        yield probability, after


@shift(
    (41, 2), np.array([[-1.0, -1.3]] * 40 + [[0.0, 0.0]]), 0.98, (0.7, 0.5), (0.45, 0.55),
    "The fast lane is jammed, which the simulator does not know.", start=range(20),
)  # fmt: skip
def traffic(state: int, change: int, *lanes: float) -> Moves:
    """Twenty stretches of a road, two lanes; stay or change (.3); each lane moves with its own probability; a step costs 1."""
    stretch, lane = divmod(state, 2)
    if state >= 40:
        yield 1.0, state
        return
    new = lane ^ change
    go = lanes[new] * (0.8 if change else 1.0)
    yield go, min(2 * (stretch + 1) + new, 40)
    yield 1 - go, 2 * stretch + new


@shift(
    (90, 3), np.where(np.arange(90) % 10 < 9, -1.0, 0.0)[:, None] - np.array([0.1, 0.0, 0.1]), 0.95, (4 / 9,), (0.8,),
    "Most calls come from the lower floors; simulated, they come from anywhere.", start=range(9, 90, 10),
)  # fmt: skip
def elevator(state: int, action: int, low: float) -> Moves:
    """Nine floors, a lift up, down or waiting; calls come from floors below the middle more often than simulated."""
    lift, call = divmod(state, 10)  # call 9: none
    at = min(max(lift + action - 1, 0), 8)
    if call < 9 and at != call:
        yield 1.0, at * 10 + call
        return
    yield 0.4, at * 10 + 9
    for floor, probability in enumerate(np.where(np.arange(9) < 4, low / 4, (1 - low) / 5)):
        yield 0.6 * probability, at * 10 + floor


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
    sicker[:LIVING, :, DEATH] *= 2.0
    sicker[:LIVING, :, SURVIVAL] *= 0.7
    rewards = np.zeros_like(averaged)
    rewards[:LIVING, :, SURVIVAL] = 1.0
    rows, worse = (table / table.sum(axis=2, keepdims=True) for table in (averaged, sicker))
    ends = np.arange(n_states) >= LIVING
    clinicians = np.where(ends[:, None], 0.2, levels[:, :, 0])
    clinicians /= clinicians.sum(axis=1, keepdims=True)
    simulator = FiniteMDP(rows, rewards, start / start.sum(), 0.99)
    target = simulator.with_transitions(worse)
    return Family(
        simulator, target, clinicians, mix(clinicians, uniform_policy(simulator), 0.5),
        "Patients are sicker than simulated: death is twice as likely, survival .7 times.",
    )  # fmt: skip
