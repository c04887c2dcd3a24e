"""An explorer of an environment: it goes where state-action pairs have too few samples.

With n(s, a) samples of each pair, N wanted, and the frequencies P_n, mu_n of what has been met so far, value iteration solves

    V(s) = max(gamma V_0, max_a Q(s, a)),    V_0 = sum_s mu_n(s) V(s),
    Q(s, a) = 1 where n(s, a) < N (an action that was never taken among them), else gamma sum_s' P_n(s' | s, a) V(s'),

with V_0 in place of V(s') where the episode terminates; gamma V_0 is what a reset is worth, so that traps are left. V is the
largest E gamma^t, t the steps to the nearest pair that lacks samples. Each state that was met was reached from a first state:
V > 0 as long as a pair lacks. On a warehouse of 144 states and 3 actions each sample that is wanted takes 2.2 steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import BoolArray, IntArray
from oee_tabular.mdp.naming import to_plain

GAMMA = 0.99  # of the exploration alone: a pair 1000 steps away still counts 4e-5
TOLERANCE, MAX_SWEEPS = 1e-6, 2000  # of value iteration
MIN_PLAN_AGE = 64  # steps, or half the number of states: a younger plan is not renewed
RANDOM_SHARE = 0.05  # of the steps that a plan decides: an environment that is not Markov cannot lead it in circles
MAX_CUTS = 10  # episodes truncated in a state, before it counts as out of reach
RESET = -1  # the action of leaving an episode; the next state where it terminates


class Explorer:
    """Samples of an environment: ``transitions`` (state, action, next state, reward, terminated), and ``starts``.

    ``states``: the number of each observation, in the order in which they are met.
    """

    def __init__(self, env: Any, n_actions: int, n_wanted: int, generator: np.random.Generator) -> None:
        self.env, self.n_actions, self.n_wanted, self.generator = env, n_actions, n_wanted, generator
        self.states: dict[Any, int] = {}
        self.transitions: list[tuple[int, int, int, float, bool]] = []
        self.starts: list[int] = []
        self.n_lacking = 0
        self._counts: list[list[int]] = []
        self._outcomes: list[dict[int, int]] = []  # of row s * A + a: next state -> number
        self._is_wanted: list[bool] = []
        self._cuts: list[int] = []
        self._best: list[int] = []
        self._values: list[list[float]] = []
        self._plan_step = 0

    def explore(self, max_steps: int) -> BoolArray:
        """Step until no pair lacks samples, or ``max_steps`` times; return the (S, A) mask of the pairs that lack them."""
        seed: int | None = int(self.generator.integers(2**31))
        is_over, state = True, 0
        while len(self.transitions) < max_steps and (self.n_lacking or not self.transitions):
            is_first = is_over
            if is_over:
                state, seed = self._number(self.env.reset(seed=seed)[0]), None
                self.starts.append(state)
                self._want(state, True)
            action = self._choose(state, is_first)
            if action == RESET:
                is_over = True
            else:
                state, is_over = self._step(state, action)
        return self._lacking(np.array(self._counts))

    def _lacking(self, counts: IntArray) -> BoolArray:
        return np.asarray((counts < self.n_wanted) & np.array(self._is_wanted)[:, None])

    @property
    def n_pairs(self) -> int:
        """The number of state-action pairs in which an action can be taken."""
        return self.n_actions * sum(self._is_wanted)

    def _step(self, state: int, action: int) -> tuple[int, bool]:
        """Take an action; return the next state and whether the episode is over."""
        observation, reward, terminated, truncated, _ = self.env.step(action)
        following = self._number(observation)
        self.transitions.append((state, action, following, float(reward), bool(terminated)))
        self._counts[state][action] += 1
        self.n_lacking -= self._counts[state][action] == self.n_wanted
        outcomes, outcome = self._outcomes[state * self.n_actions + action], RESET if terminated else following
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
        if not terminated and truncated and not any(self._counts[following]):
            self._cuts[following] += 1
            self._want(following, self._cuts[following] < MAX_CUTS)
        elif not terminated:
            self._want(following, True)
        return following, bool(terminated or truncated)

    def _number(self, observation: object) -> int:
        state = self.states.setdefault(to_plain(observation), len(self.states))
        if state == len(self._counts):
            self._counts.append([0] * self.n_actions)
            self._outcomes.extend({} for _ in range(self.n_actions))
            self._is_wanted.append(False)
            self._cuts.append(0)
        return state

    def _want(self, state: int, is_wanted: bool) -> None:
        """Keep whether a state's pairs are to have samples: it was met, and some episode can act there."""
        if self._is_wanted[state] != is_wanted:
            self._is_wanted[state] = is_wanted
            lacking = sum(count < self.n_wanted for count in self._counts[state])
            self.n_lacking += lacking if is_wanted else -lacking

    def _choose(self, state: int, is_first: bool) -> int:
        """Return a lacking action, the one that leads nearest to others; else what the plan says."""
        counts, is_planned = self._counts[state], state < len(self._values)
        lacking = [a for a in range(self.n_actions) if counts[a] < self.n_wanted]
        if lacking:
            ahead = self._values[state] if is_planned else [0.0] * self.n_actions
            return max(lacking, key=lambda a: (ahead[a], -counts[a]))
        age = len(self.transitions) - self._plan_step
        if not is_planned or age >= max(MIN_PLAN_AGE, len(self.states) // 2):
            self._plan()
        if self.generator.random() < RANDOM_SHARE:
            return int(self.generator.integers(self.n_actions))
        best = self._best[state]
        return int(np.argmax(self._values[state])) if best == RESET and is_first else best

    def _plan(self) -> None:
        """Solve for V by value iteration from 0, and keep the best actions and gamma sum_s' P_n V of each pair."""
        counts, n = np.array(self._counts), len(self._counts)
        is_lacking = self._lacking(counts)
        entries = [
            (row, n if k == RESET else k, number) for row, met in enumerate(self._outcomes) for k, number in met.items()
        ]
        rows, columns, numbers = (np.array(part) for part in zip(*entries, strict=True))
        share = numbers / counts.reshape(-1)[rows]
        frequencies = sparse.csr_array((share, (rows, columns)), shape=(n * self.n_actions, n + 1))
        starts = np.bincount(self.starts, minlength=n) / len(self.starts)
        values = np.zeros(n + 1)  # the last one is V_0
        for _ in range(MAX_SWEEPS):
            ahead = GAMMA * (frequencies @ values).reshape(counts.shape)
            best = np.where(is_lacking, 1.0, ahead).max(axis=1)
            new = np.maximum(best, GAMMA * values[n])
            new = np.append(new, starts @ new)
            change = float(np.abs(new - values).max())
            values = new
            if change < TOLERANCE:
                break
        actions = np.where(is_lacking, 1.0, ahead).argmax(axis=1)
        self._best = np.where(best < GAMMA * values[n] - TOLERANCE, RESET, actions).tolist()
        self._values = np.where(counts > 0, ahead, 1.0).tolist()
        self._plan_step = len(self.transitions)
