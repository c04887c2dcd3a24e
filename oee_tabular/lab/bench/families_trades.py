"""Families of trades: assets, patients, drivers, players, fishers, an elevator."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from oee_tabular.lab.bench.laws import binomial, cross, poisson
from oee_tabular.lab.bench.shift import Maker, Moves, shift
from oee_tabular.typing import BoolArray, IntArray

PEOPLE = 12
SUSCEPTIBLE, INFECTED = np.array(
    [(s, i) for s in range(PEOPLE + 1) for i in range(PEOPLE + 1 - s)]
).T
PATIENTS = 6
# Counts of cured and failed patients with one arm, and with the other.
TRIALS = np.array(
    [
        counts
        for counts in itertools.product(range(7), repeat=4)
        if sum(counts) <= PATIENTS
    ]
)
NUMBER_OF_TRIAL = np.zeros((8,) * 4, dtype=np.int64)
NUMBER_OF_TRIAL[tuple(TRIALS.T)] = np.arange(len(TRIALS))
CURES = TRIALS[:, 0] + TRIALS[:, 2]
# States of the search for a place: 2 * distance + (whether it is free); 30 is the end.
PLACES = np.arange(31)[:, None]
PARKS = PLACES % 2 * np.array([0, 1])
PARKING_REWARDS = np.where(PARKS, -0.2 - 0.5 * (PLACES // 2), -0.3)
PARKING_REWARDS[30] = 0.0
NOISE = np.array([0.05, 0.2, 0.5, 0.2, 0.05])
WIDE = NOISE**0.5 / (NOISE**0.5).sum()
HARVESTS = np.array([0, 1, 2, 4, 6])


def ageing_asset(state: IntArray, action: IntArray, shock: float) -> Moves:
    """Return the transitions of an asset of age 0 to 9.

    It may fail by wear (state 10) or by a shock (state 11). Actions are run gently, run
    hard and renew. Hard running ages and earns more.
    """
    runs = (state < 10) & (action < 2)
    repaired = np.where(
        action < 2, 0.05, np.select([state == 10, state == 11], [0.5, 0.7], 0.95)
    )
    wear = 0.003 * (1 + action) * state
    shocked = shock * (1 + action)
    older = 0.4 + 0.3 * action
    yield np.where(runs, 0.0, repaired), 0
    yield np.where(runs, 0.0, 1 - repaired), state
    yield runs * wear, 10
    yield runs * shocked, 11
    yield runs * (1 - wear - shocked) * older, np.minimum(state + 1, 9)
    yield runs * (1 - wear - shocked) * (1 - older), state


def number_of_sick(susceptible: Any, infected: Any) -> Any:
    """Return the state of so many susceptible and infected people."""
    return susceptible * (PEOPLE + 1) - susceptible * (susceptible - 1) // 2 + infected


def epidemic(state: IntArray, action: IntArray, infection: float) -> Moves:
    """Return the transitions of an epidemic among twelve people.

    States are the numbers of susceptible and infected. Actions are nothing, distance
    (which costs .5) and lockdown (1.2); an infected person costs 1 a step.
    """
    s = SUSCEPTIBLE[state]
    i = INFECTED[state]
    rate = infection * np.array([1.0, 0.55, 0.25])[action]
    new, cured = np.divmod(np.arange((PEOPLE + 1) ** 2), PEOPLE + 1)
    law = cross(binomial(s, 1 - (1 - rate / PEOPLE) ** i), binomial(i, 0.25))
    yield (
        law * np.where(s < PEOPLE, 0.98, 1.0),
        number_of_sick(s - new, i - cured + new),
    )
    # Immunity may be lost, and all begins again.
    yield 0.02 * (s < PEOPLE), number_of_sick(PEOPLE - 2, 2)


def clinical_trial(state: IntArray, arm: IntArray, *arms: float) -> Moves:
    """Return the transitions of a trial of six patients and two arms.

    The simulator predicts from the counts so far, with the prior Beta(1, 1). In truth
    the arms cure with probabilities .6 and .25.
    """
    a, b, c, d = TRIALS[state[:, :, 0]].transpose(2, 0, 1)[..., None]
    cured = np.where(arm, c, a)
    failed = np.where(arm, d, b)
    cure = np.choose(arm, arms) if arms else (cured + 1) / (cured + failed + 2)
    yield cure, NUMBER_OF_TRIAL[a + 1 - arm, b, c + arm, d]
    yield 1 - cure, NUMBER_OF_TRIAL[a, b + 1 - arm, c, d + arm]


def parking(state: IntArray, action: IntArray, free: float) -> Moves:
    """Return the transitions of a search for a place among fifteen before a shop.

    Actions are drive on, and park where the place is free. Walking costs more than
    driving, and after the last place another round begins.
    """
    distance, empty = np.divmod(state, 2)
    drives = 1 - action * empty
    ahead = np.where(distance > 0, distance - 1, 14)
    chance = free * (0.4 + 0.6 * ahead / 14)
    return (
        (1 - drives, 30),
        (drives * chance, 2 * ahead + 1),
        (drives * (1 - chance), 2 * ahead),
    )


def wins(s: IntArray, a: IntArray, to: IntArray) -> BoolArray:
    """Return whether a transition arrives at 20."""
    return np.asarray((to == 20) & (s != 20))


def gambler(capital: IntArray, action: IntArray, win: float) -> Moves:
    """Return the transitions of a gambler's capital of 0 to 20.

    Stakes are 1, 2 or 4. At 20 the game is won with reward 1, at 0 it is lost.
    """
    put = np.minimum(2**action, np.minimum(capital, 20 - capital))
    return (win, capital + put), (1 - win, capital - put)


def fishery(stock: IntArray, action: IntArray, growth: float) -> Moves:
    """Return the transitions of a fish stock of 0 to 20.

    Harvests are 0, 1, 2, 4 or 6. Growth is logistic with Poisson noise; an empty sea is
    restocked.
    """
    left = np.maximum(stock - HARVESTS[action], 0)
    return [(poisson(0.3 + left + growth * left * (1 - left / 20), 20), np.arange(21))]


def traffic(state: IntArray, change: IntArray, *lanes: float) -> Moves:
    """Return the transitions on a road of twenty stretches and two lanes.

    Actions are stay, and change the lane (which costs .3). Each lane moves with its own
    probability, and a step costs 1.
    """
    there = state ^ change  # the same stretch, in the lane that is chosen
    go = np.array(lanes)[there % 2] * np.where(change, 0.8, 1.0)
    return (go, there + 2), (1 - go, there)


def elevator(state: IntArray, action: IntArray, low: float) -> Moves:
    """Return the transitions of an elevator on nine floors.

    It goes up, down or waits. In the target calls come from the lower floors more often
    than simulated.
    """
    # Call 9 means that nobody calls.
    at = np.clip(state // 10 + action - 1, 0, 8)
    call = state % 10
    floors = np.arange(9)
    goes = (call < 9) & (at != call)
    yield goes, at * 10 + call
    yield 0.4 * ~goes, at * 10 + 9
    yield 0.6 * np.where(floors < 4, low / 4, (1 - low) / 5) * ~goes, at * 10 + floors


TRADES: dict[str, Maker] = {
    "ageing_asset": shift(
        "One of two ways to fail, the shock, is more frequent than simulated.",
        (12, 3),
        np.array([[1.0, 1.6, -2.0]] * 10 + [[-1.0, -1.0, -3.0], [-0.5, -0.5, -1.5]]),
        0.98,
        (0.02,),
        (0.05,),
        ageing_asset,
        start=range(10),
    ),
    "epidemic": shift(
        "Infection is more likely than simulated.",
        (len(INFECTED), 3),
        -INFECTED[:, None] - np.array([0.0, 0.5, 1.2]),
        0.95,
        (0.5,),
        (0.7,),
        epidemic,
        start=number_of_sick(np.array([10, 8, 6]), np.array([2, 2, 3])),
        recorded=0.0,
    ),
    "clinical_trial": shift(
        "The simulator predicts two arms of a trial from a uniform prior; one cures"
        " often, one seldom.",
        (len(TRIALS), 2),
        lambda s, a, to: CURES[to] - CURES[s],
        0.99,
        (),
        (0.6, 0.25),
        clinical_trial,
        start=0,
        ends=np.flatnonzero(TRIALS.sum(axis=1) == PATIENTS),
        optimal=0.85,
    ),
    "parking": shift(
        "Free places are rarer than simulated.",
        (31, 2),
        PARKING_REWARDS,
        0.99,
        (0.5,),
        (0.3,),
        parking,
        start=range(16, 30),
        ends=[30],
        recorded=0.0,
    ),
    # There are 21 places with absorbing ends, of which the right one has the reward 1,
    # and steps of two sizes. The drift is towards the left.
    "random_walk": shift(
        "The walk drifts to the losing side; the simulator has it fair.",
        (21, 2),
        wins,
        0.99,
        (0.5,),
        (0.56,),
        lambda s, far, left: [(left, s - 1 - far), (1 - left, s + 1 + far)],
        start=range(5, 16),
        ends=[0, 20],
    ),
    # The places are a ring of 30, with steps of -1, 0 or 2, noise of two places and a
    # reward at one place. The noise is wider in one half.
    "sensors": shift(
        "In half of the places the motion is noisier than simulated.",
        (30, 3),
        np.exp(-((np.arange(30) - 20.0) ** 2) / 4.0),
        0.95,
        (30,),
        (15,),
        lambda s, a, half: [
            (
                np.where(s >= half, WIDE, NOISE),
                (s + np.array([-1, 0, 2])[a] + np.arange(-2, 3)) % 30,
            )
        ],
    ),
    "fishery": shift(
        "Fish grow back more slowly than simulated.",
        (21, 5),
        np.minimum(np.arange(21)[:, None], HARVESTS) ** 0.8,
        0.96,
        (0.8,),
        (0.5,),
        fishery,
    ),
    "traffic": shift(
        "The fast lane is jammed, which the simulator does not know.",
        (41, 2),
        np.array([[-1.0, -1.3]] * 40 + [[0.0, 0.0]]),
        0.98,
        (0.7, 0.5),
        (0.45, 0.55),
        traffic,
        start=range(20),
        ends=[40],
    ),
    "elevator": shift(
        "Most calls come from the lower floors; simulated, they come from anywhere.",
        (90, 3),
        np.where(np.arange(90) % 10 < 9, -1.0, 0.0)[:, None]
        - np.array([0.1, 0.0, 0.1]),
        0.95,
        (4 / 9,),
        (0.8,),
        elevator,
        start=range(9, 90, 10),
    ),
    "gambler": shift(
        "The bank wins more often than simulated.",
        (21, 3),
        wins,
        0.99,
        (0.48,),
        (0.42,),
        gambler,
        start=range(1, 20),
        ends=[0, 20],
        recorded=0.9,
    ),
}
