"""Further families, from other trades: nobody's prior was made for them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oee_tabular.bench.family import Family
from oee_tabular.bench.making import binomial, paid_on, pair, poisson, spread, transitions_of
from oee_tabular.mdp import FiniteMDP
from oee_tabular.tasks import gridworld

Moves = Iterator[tuple[float, int]]


def ageing_asset() -> Family:
    """Age 0 to 9, or failed by wear (10), or by a shock (11); run gently, run hard, renew. Hard running ages and earns more."""

    def rows(shock: float) -> FiniteMDP:
        def moves(state: int, action: int) -> Moves:
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
        return FiniteMDP(transitions_of(12, 3, moves), pay, spread(12, range(10)), 0.98)

    return pair(rows(0.02), rows(0.05), "One of two ways to fail, the shock, is more frequent than simulated.")


def epidemic() -> Family:
    """Twelve people, susceptible and infected; nothing, distance (.5) or lockdown (1.2); an infected one costs 1 a step."""
    people = 12
    states = [(s, i) for s in range(people + 1) for i in range(people + 1 - s)]
    number = {state: k for k, state in enumerate(states)}

    def rows(infection: float) -> FiniteMDP:
        def moves(state: int, action: int) -> Moves:
            s, i = states[state]
            rate = infection * (1.0, 0.55, 0.25)[action]
            caught = binomial(s, 1 - (1 - rate / people) ** i)
            for new, p in enumerate(caught):
                for well, q in enumerate(binomial(i, 0.25)):
                    yield p * q * (0.98 if s < people else 1.0), number[s - new, i - well + new]
            if s < people:  # immunity is lost: all begins again
                yield 0.02, number[people - 2, 2]

        costs = -np.array([i for _, i in states])[:, None] - np.array([0.0, 0.5, 1.2])
        start = spread(len(states), [number[people - 2, 2], number[people - 4, 2], number[6, 3]])
        return FiniteMDP(transitions_of(len(states), 3, moves), costs, start, 0.95)

    return pair(rows(0.5), rows(0.7), "Infection is more likely than simulated.", recorded="uniform")


def clinical_trial() -> Family:
    """Six patients, two arms; the simulator predicts by the counts so far, Beta(1, 1); the arms cure .6 and .25 in truth."""
    patients, arms = 6, (0.6, 0.25)
    every = [(a, b, c, d) for a in range(7) for b in range(7) for c in range(7) for d in range(7)]
    states = [state for state in every if sum(state) <= patients]
    number = {state: k for k, state in enumerate(states)}

    def rows(real: bool) -> FiniteMDP:
        def moves(state: int, arm: int) -> Moves:
            counts = list(states[state])
            if sum(counts) == patients:
                yield 1.0, state
                return
            cured, failed = counts[2 * arm], counts[2 * arm + 1]
            cure = arms[arm] if real else (cured + 1) / (cured + failed + 2)
            for place, probability in ((2 * arm, cure), (2 * arm + 1, 1 - cure)):
                after = counts.copy()
                after[place] += 1
                yield probability, number[after[0], after[1], after[2], after[3]]

        transitions = transitions_of(len(states), 2, moves)
        cures = np.array([a + c for a, _, c, _ in states], dtype=np.float64)
        rewards = paid_on(transitions, lambda s, a, to: cures[to] - cures[s], 2)
        return FiniteMDP(transitions, rewards, spread(len(states), number[0, 0, 0, 0]), 0.99)

    about = "The simulator predicts two arms of a trial from a uniform prior; one cures often, one seldom."
    return pair(rows(False), rows(True), about, recorded="half", optimal=0.85)


def parking() -> Family:
    """Fifteen places on the way to a shop; drive on, or park where it is free; walking costs more than driving; rounds."""

    def rows(free: float) -> FiniteMDP:
        def moves(state: int, park: int) -> Moves:
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
        return FiniteMDP(transitions_of(31, 2, moves), pay, spread(31, range(16, 30)), 0.99)

    return pair(rows(0.5), rows(0.3), "Free places are rarer than simulated.", recorded="uniform")


def random_walk() -> Family:
    """21 places with absorbing ends, the right one pays 1; two steps' sizes; the drift is towards the left."""

    def rows(left: float) -> FiniteMDP:
        def moves(place: int, far: int) -> Moves:
            if place in (0, 20):
                yield 1.0, place
                return
            yield left, max(place - 1 - far, 0)
            yield 1 - left, min(place + 1 + far, 20)

        transitions = transitions_of(21, 2, moves)
        rewards = paid_on(transitions, lambda s, a, to: (to == 20) & (s != 20), 2)
        return FiniteMDP(transitions, rewards, spread(21, range(5, 16)), 0.99)

    return pair(
        rows(0.5), rows(0.56), "The walk drifts to the losing side; the simulator has it fair.", recorded="half"
    )


def sensors() -> Family:
    """A ring of 30 places, moves of -1, 0 or 2 with noise of two places; a pay at one place; noise is wider in one half."""
    noise = np.array([0.05, 0.2, 0.5, 0.2, 0.05])
    wide = noise**0.5 / (noise**0.5).sum()

    def rows(half: int) -> FiniteMDP:
        def moves(place: int, action: int) -> Moves:
            for shift, probability in enumerate(wide if place >= half else noise):
                yield probability, (place + (-1, 0, 2)[action] + shift - 2) % 30

        pay = np.exp(-((np.arange(30) - 20.0) ** 2) / 4.0)
        return FiniteMDP(transitions_of(30, 3, moves), pay, spread(30, range(30)), 0.95)

    return pair(rows(30), rows(15), "In half of the places the motion is noisier than simulated.", recorded="half")


def fishery() -> Family:
    """Stock 0 to 20, harvests of 0, 1, 2, 4 or 6; logistic growth with Poisson noise; a restocked sea starts at 0 or more."""
    harvests = np.array([0, 1, 2, 4, 6])

    def rows(growth: float) -> FiniteMDP:
        def moves(stock: int, action: int) -> Moves:
            left = max(stock - harvests[action], 0)
            mean = 0.3 + left + growth * left * (1 - left / 20)
            for after, probability in enumerate(poisson(mean, 20)):
                yield probability, after

        caught = np.minimum(np.arange(21)[:, None], harvests)
        return FiniteMDP(transitions_of(21, 5, moves), caught**0.8, spread(21, range(21)), 0.96)

    return pair(rows(0.8), rows(0.5), "Fish grow back more slowly than simulated.", recorded="half")


def traffic() -> Family:
    """Twenty stretches of a road, two lanes; stay or change (.3); each lane moves with its own probability; a step costs 1."""

    def rows(left: float, right: float) -> FiniteMDP:
        def moves(state: int, change: int) -> Moves:
            stretch, lane = divmod(state, 2)
            if state >= 40:
                yield 1.0, state
                return
            new = lane ^ change
            go = (left, right)[new] * (0.8 if change else 1.0)
            yield go, min(2 * (stretch + 1) + new, 40)
            yield 1 - go, 2 * stretch + new

        pay = np.array([[-1.0, -1.3]] * 40 + [[0.0, 0.0]])
        return FiniteMDP(transitions_of(41, 2, moves), pay, spread(41, range(20)), 0.98)

    return pair(rows(0.7, 0.5), rows(0.45, 0.55), "The fast lane is jammed, which the simulator does not know.")


def elevator() -> Family:
    """Nine floors, a lift up, down or waiting; calls come from floors below the middle more often than simulated."""

    def rows(low: float) -> FiniteMDP:
        share = np.where(np.arange(9) < 4, low / 4, (1 - low) / 5)

        def moves(state: int, action: int) -> Moves:
            lift, call = divmod(state, 10)  # call 9: none
            at = min(max(lift + action - 1, 0), 8)
            if call < 9 and at != call:
                yield 1.0, at * 10 + call
                return
            yield 0.4, at * 10 + 9
            for floor, probability in enumerate(share):
                yield 0.6 * probability, at * 10 + floor

        waiting = np.where(np.arange(90) % 10 < 9, -1.0, 0.0)[:, None] - np.array([0.1, 0.0, 0.1])
        return FiniteMDP(transitions_of(90, 3, moves), waiting, spread(90, range(9, 90, 10)), 0.95)

    return pair(rows(4 / 9), rows(0.8), "Most calls come from the lower floors; simulated, they come from anywhere.")


def gambler() -> Family:
    """Capital 0 to 20, stakes of 1, 2 or 4; at 20 the game is won and pays 1, at 0 it is lost."""

    def rows(win: float) -> FiniteMDP:
        def moves(capital: int, action: int) -> Moves:
            if capital in (0, 20):
                yield 1.0, capital
                return
            stake = min((1, 2, 4)[action], capital, 20 - capital)
            yield win, capital + stake
            yield 1 - win, capital - stake

        transitions = transitions_of(21, 3, moves)
        rewards = paid_on(transitions, lambda s, a, to: (to == 20) & (s != 20), 3)
        return FiniteMDP(transitions, rewards, spread(21, range(1, 20)), 0.99)

    return pair(rows(0.48), rows(0.42), "The bank wins more often than simulated.", recorded="policy")


def one_way_grid() -> Family:
    """The paper's grid from its corner with a log of its expert alone: much of what the policy does is never seen."""
    simulator, target = (gridworld(6, slip, discount=0.97) for slip in (0.3, 0.15))
    family = pair(simulator, target, "Moves slip less than simulated, and the log shows one way only.", optimal=0.6)
    narrow = pair(simulator, target, family.about, optimal=0.97).policy
    return Family(simulator, target, family.policy, narrow, family.about)
