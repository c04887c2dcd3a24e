"""An explorer of an environment: it goes where state-action pairs have too few samples.

With n(s, a) samples of each pair, N wanted, and the frequencies P_n, mu_n of what has been met so far, value iteration solves

    V(s) = max(gamma V_0, max_a Q(s, a)),    V_0 = sum_s mu_n(s) V(s),
    Q(s, a) = 1 where n(s, a) < N (an action that was never taken among them), else gamma sum_s' P_n(s' | s, a) V(s'),

with V_0 in place of V(s') where the episode terminates; gamma V_0 is what a reset is worth, so that traps are left. V is the
largest E gamma^t, t the steps to the nearest pair that lacks samples. Each state that was met was reached from a first state:
V > 0 as long as a pair lacks. On a warehouse of 144 states and 3 actions each sample that is wanted takes 2.2 steps.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular.mdp.naming import to_plain

GAMMA = 0.99  # of the exploration alone: a pair 1000 steps away still counts 4e-5
TOLERANCE, MAX_SWEEPS = 1e-6, 2000  # of value iteration
MIN_PLAN_AGE = 64  # steps, or half the number of states: a younger plan is not renewed
RANDOM_SHARE = 0.05  # of the steps that a plan decides: an environment that is not Markov cannot lead it in circles
MAX_CUTS = 10  # episodes truncated in a state, before it counts as out of reach
RESET = -1  # the action of leaving an episode; the next state where it terminates


class Explorer:
    """Samples of an environment: ``transitions`` (state, action, next state, reward, terminated), and ``starts``.

    ``states``: the number of each observation, in the order in which they are met. ``open``: those in which an episode can
    act; ``lacking``: their pairs (state, action) with too few samples.
    """

    def __init__(self, env: Any, n_actions: int, n_wanted: int, generator: np.random.Generator) -> None:
        self.env, self.n_actions, self.n_wanted, self.generator = env, n_actions, n_wanted, generator
        self.states: dict[Any, int] = {}
        self.transitions: list[tuple[int, int, int, float, bool]] = []
        self.starts: list[int] = []
        self.lacking: set[tuple[int, int]] = set()
        self.open: set[int] = set()
        self._counts: Counter[tuple[int, int]] = Counter()
        self._outcomes: defaultdict[tuple[int, int], Counter[int]] = defaultdict(Counter)
        self._cuts: Counter[int] = Counter()
        self._best: list[int] = []
        self._values: list[list[float]] = []
        self._plan_step = 0

    def explore(self, max_steps: int) -> None:
        """Step until no pair lacks samples, or ``max_steps`` times."""
        seed: int | None = int(self.generator.integers(2**31))
        is_over, state = True, 0
        while len(self.transitions) < max_steps and (self.lacking or not self.transitions):
            is_first = is_over
            if is_over:
                state, seed = self._number(self.env.reset(seed=seed)[0]), None
                self.starts.append(state)
                self._set_open(state, True)
            action = self._choose(state, is_first)
            if action == RESET:
                is_over = True
            else:
                state, is_over = self._step(state, action)

    def _step(self, state: int, action: int) -> tuple[int, bool]:
        """Take an action; return the next state and whether the episode is over."""
        observation, reward, terminated, truncated, _ = self.env.step(action)
        following = self._number(observation)
        self.transitions.append((state, action, following, float(reward), bool(terminated)))
        self._outcomes[state, action][RESET if terminated else following] += 1
        self._counts[state, action] += 1
        if self._counts[state, action] == self.n_wanted:
            self.lacking.discard((state, action))
        if not terminated and truncated and not any(self._counts[following, a] for a in range(self.n_actions)):
            self._cuts[following] += 1
            self._set_open(following, self._cuts[following] < MAX_CUTS)
        elif not terminated:
            self._set_open(following, True)
        return following, bool(terminated or truncated)

    def _number(self, observation: object) -> int:
        return self.states.setdefault(to_plain(observation), len(self.states))

    def _actions_that_lack(self, state: int) -> list[int]:
        return [a for a in range(self.n_actions) if self._counts[state, a] < self.n_wanted]

    def _set_open(self, state: int, is_open: bool) -> None:
        """Keep whether an episode can act in a state, so that its pairs are to have samples."""
        if is_open and state not in self.open:
            self.open.add(state)
            self.lacking.update((state, a) for a in self._actions_that_lack(state))
        elif not is_open and state in self.open:
            self.open.remove(state)
            self.lacking.difference_update((state, a) for a in range(self.n_actions))

    def _choose(self, state: int, is_first: bool) -> int:
        """Return a lacking action, the one that leads nearest to others; else what the plan says."""
        is_planned = state < len(self._values)
        if lacking := self._actions_that_lack(state):
            ahead = self._values[state] if is_planned else [0.0] * self.n_actions
            return max(lacking, key=lambda a: (ahead[a], -self._counts[state, a]))
        age = len(self.transitions) - self._plan_step
        if not is_planned or age >= max(MIN_PLAN_AGE, len(self.states) // 2):
            self._plan()
        if self.generator.random() < RANDOM_SHARE:
            return int(self.generator.integers(self.n_actions))
        best = self._best[state]
        return int(np.argmax(self._values[state])) if best == RESET and is_first else best

    def _plan(self) -> None:
        """Solve for V by value iteration from 0, and keep the best actions and gamma sum_s' P_n V of each pair."""
        n = len(self.states)
        is_lacking, is_taken = np.zeros((2, n, self.n_actions), dtype=np.bool_)
        for pair in self.lacking:
            is_lacking[pair] = True
        for pair in self._counts:
            is_taken[pair] = True
        entries = [
            (number / self._counts[s, a], s * self.n_actions + a, n if k == RESET else k)
            for (s, a), met in self._outcomes.items()
            for k, number in met.items()
        ]
        share, rows, columns = (np.array(part) for part in zip(*entries, strict=True))
        frequencies = sparse.csr_array((share, (rows, columns)), shape=(n * self.n_actions, n + 1))
        starts = np.bincount(self.starts, minlength=n) / len(self.starts)
        values = np.zeros(n + 1)  # the last one is V_0
        for _ in range(MAX_SWEEPS):
            ahead = GAMMA * (frequencies @ values).reshape(n, -1)
            best = np.where(is_lacking, 1.0, ahead).max(axis=1)
            new = np.maximum(best, GAMMA * values[n])
            new = np.append(new, starts @ new)
            change = float(np.abs(new - values).max())
            values = new
            if change < TOLERANCE:
                break
        actions = np.where(is_lacking, 1.0, ahead).argmax(axis=1)
        self._best = np.where(best < GAMMA * values[n] - TOLERANCE, RESET, actions).tolist()
        self._values = np.where(is_taken, ahead, 1.0).tolist()
        self._plan_step = len(self.transitions)
