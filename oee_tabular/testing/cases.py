"""The small pairs of environments that estimators are checked on, each known exactly.

Target and simulator differ much (the simulator's value is off by many standard errors), with the same support and small
integer probabilities; every behaviour policy takes every action, unless the case is about one that does not. The states lie on
a line, in the order of their numbers (``layout``): renamed states keep their places.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, Seed
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy, policy_value
from oee_tabular.mdp import FiniteMDP
from oee_tabular.simulate import sample_episodes


@dataclass(frozen=True, eq=False)
class Case:
    """A pair, a policy to evaluate, and how logs of the target are recorded.

    Attributes
    ----------
    name : str, as in ``CASES``
    simulator, target : FiniteMDP
    policy, behavior : (S, A)
    horizon : of the value; None: the infinite sum
    steps : longest episode of a log (beyond the horizon in some cases)

    Examples
    --------
    >>> pair = case("ragged")
    >>> round(pair.truth, 4), len(pair.log(100, seed=0)) < 600
    (10.0696, True)
    """

    name: str
    simulator: FiniteMDP
    target: FiniteMDP
    policy: Array
    behavior: Array
    horizon: int | None
    steps: int

    @property
    def truth(self) -> float:
        """J of the policy in the target."""
        return policy_value(self.target, self.policy, horizon=self.horizon)

    @property
    def data_distribution(self) -> Array:
        """(S, A): how the rows of a log are distributed."""
        return recorded(self.target, self.behavior, self.steps)

    def log(self, n: int, *, seed: Seed) -> Transitions:
        """``n`` episodes of the behaviour policy in the target."""
        return sample_episodes(self.target, self.behavior, n, self.steps, seed=seed)

    def logs(self, n: int, repetitions: int, *, seed: Seed) -> Iterator[Transitions]:
        """``repetitions`` independent logs of ``n`` episodes (one after the other of a single draw)."""
        whole = self.log(n * repetitions, seed=seed)
        starts, columns = whole.episode_starts, whole.columns()
        assert starts is not None
        for k in range(repetitions):
            rows = slice(starts[k * n], starts[(k + 1) * n])
            yield Transitions(**{name: column[rows] for name, column in columns.items()})

    def problem(self, n: int, *, seed: Seed) -> Problem:
        """The problem of a log of ``n`` episodes."""
        return self.problem_of(self.log(n, seed=seed))

    def problem_of(self, log: Transitions) -> Problem:
        """The problem of a log, on copies of everything."""
        return Problem(
            copy.deepcopy(self.simulator),
            Transitions(**log.columns()),
            horizon=self.horizon,
            behavior_policy=self.behavior.copy(),
        )

    def with_rewards(self, scale: float, shift: float) -> Case:
        """The same with rewards scale * r + shift, in every state."""
        changed = [_affine(mdp, scale, shift) for mdp in (self.simulator, self.target)]
        return replace(self, simulator=changed[0], target=changed[1])

    def relabelled(self, states: IntArray, actions: IntArray) -> Case:
        """The same with state s named ``states[s]`` and action a named ``actions[a]``."""
        pair = [_renamed(mdp, states, actions) for mdp in (self.simulator, self.target)]
        policies = [_table(table, states, actions) for table in (self.policy, self.behavior)]
        return replace(self, simulator=pair[0], target=pair[1], policy=policies[0], behavior=policies[1])


def recorded(target: FiniteMDP, behavior: Array, steps: int) -> Array:
    """(S, A): how the rows of episodes are distributed; an episode ends on arrival in an absorbing state."""
    time = occupancy(target.with_discount(1.0), behavior, horizon=steps)
    alive = np.where(target.absorbing()[:, None], 0.0, time)
    found = alive if alive.any() else time
    return np.asarray(found / found.sum())


def relabelled_log(log: Transitions, states: IntArray, actions: IntArray) -> Transitions:
    """The log of ``Case.relabelled``.

    Parameters
    ----------
    log : Transitions
    states, actions : (S,) and (A,) permutations: state s is named ``states[s]``, action a ``actions[a]``

    Examples
    --------
    >>> log = case("ragged").log(2, seed=0)
    >>> new = relabelled_log(log, np.array([1, 0, 2, 3]), np.array([0, 1]))
    >>> log.state[:4].tolist(), new.state[:4].tolist()
    ([0, 0, 1, 1], [1, 1, 0, 0])
    """
    states, actions = np.asarray(states), np.asarray(actions)  # a Series is looked up by its labels
    names = {"state": states[log.state], "action": actions[log.action], "next_state": states[log.next_state]}
    return Transitions(**(log.columns() | names))


def padded_log(log: Transitions, actions: tuple[int, ...], probability: float) -> Transitions:
    """Further moves in the absorbing state, with these actions, after every episode that ended there.

    Parameters
    ----------
    log : Transitions, with episodes, rewards and behaviour probabilities
    actions : of the rows that are added to each such episode
    probability : what the behaviour policy gives each of them

    Examples
    --------
    >>> log = case("ragged").log(2, seed=0)
    >>> len(log), int(log.terminated.sum()), len(padded_log(log, (0, 1), 0.5))
    (4, 2, 8)
    """
    starts, rows = log.episode_starts, len(actions)
    assert starts is not None
    columns = {name: column for name, column in log.columns().items() if name not in ("timestep", "truncated")}
    parts: list[dict[str, Any]] = []
    for low, high in zip(starts[:-1], starts[1:], strict=True):
        own = {name: column[low:high].copy() for name, column in columns.items()}
        if own["terminated"][-1]:
            end = own["next_state"][-1]
            more = {
                "state": np.full(rows, end),
                "action": np.array(actions),
                "next_state": np.full(rows, end),
                "reward": np.zeros(rows),
                "terminated": np.arange(rows) == rows - 1,
                "episode": np.full(rows, own["episode"][-1]),
                "behavior_probability": np.full(rows, probability),
            }
            own["terminated"][-1] = False
            own = {name: np.concatenate([column, more[name]]) for name, column in own.items()}
        parts.append(own)
    return Transitions(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def _affine(mdp: FiniteMDP, scale: float, shift: float) -> FiniteMDP:
    if mdp.transition_rewards is None:
        return mdp.with_rewards(scale * mdp.rewards + shift)
    table = mdp.transition_rewards.copy()
    table.data = scale * table.data + shift
    return mdp.with_rewards(table)


def _renamed(mdp: FiniteMDP, states: IntArray, actions: IntArray) -> FiniteMDP:
    shape = (mdp.n_states, mdp.n_actions, mdp.n_states)
    back_s, back_a = np.argsort(states), np.argsort(actions)
    index = np.ix_(back_s, back_a, back_s)
    if mdp.transition_rewards is None:
        rewards = mdp.rewards[np.ix_(back_s, back_a)]
    else:
        rewards = mdp.transition_rewards.toarray().reshape(shape)[index]
    layout = None if mdp.layout is None else mdp.layout[back_s]
    renamed = mdp.transitions.toarray().reshape(shape)[index]
    called = (
        None if names is None else [names[k] for k in back]
        for names, back in ((mdp.state_names, back_s), (mdp.action_names, back_a))
    )
    return FiniteMDP(renamed, rewards, mdp.initial[back_s], mdp.discount, layout=layout).with_names(*called)


def _table(table: Array, states: IntArray, actions: IntArray) -> Array:
    return np.ascontiguousarray(table[np.ix_(np.argsort(states), np.argsort(actions))])


_PAY = np.array([[4.0, -1.0], [2.0, 7.0], [-3.0, 5.0], [0.0, 0.0]])
_POLICY = np.array([[0.8, 0.2], [0.3, 0.7], [0.5, 0.5], [1.0, 0.0]])
_BEHAVIOR = np.array([[0.6, 0.4], [0.4, 0.6], [0.6, 0.4], [1.0, 0.0]])


def _mortal(rows: object, discount: float) -> FiniteMDP:
    """Three states that pay, each left for one that is over; ``rows`` (3, 2, 4) in tenths."""
    transitions = np.zeros((4, 2, 4))
    transitions[:3] = np.asarray(rows) / 10.0
    transitions[3, :, 3] = 1.0
    return FiniteMDP(transitions, _PAY, np.array([0.8, 0.2, 0.0, 0.0]), discount, layout=np.arange(4))


_TARGET = [[[3, 3, 3, 1], [1, 2, 2, 5]], [[5, 1, 1, 3], [2, 5, 2, 1]], [[1, 2, 2, 5], [3, 1, 3, 3]]]
_SIMULATOR = [[[2, 2, 3, 3], [1, 2, 3, 4]], [[4, 1, 2, 3], [3, 3, 2, 2]], [[2, 2, 2, 4], [2, 2, 2, 4]]]


def _ragged(name: str, horizon: int | None, discount: float, steps: int) -> Case:
    pair = _mortal(_SIMULATOR, discount), _mortal(_TARGET, discount)
    return Case(name, *pair, _POLICY.copy(), _BEHAVIOR.copy(), horizon, steps)


def _moves(name: str, horizon: int | None, discount: float, steps: int) -> Case:
    """Nothing ends, and a reward belongs to the move."""
    target = np.array([[[1, 7, 2], [5, 0, 5]], [[0, 2, 8], [6, 2, 2]], [[8, 2, 0], [3, 4, 3]]]) / 10.0
    simulator = np.array([[[2, 5, 3], [4, 0, 6]], [[0, 4, 6], [4, 3, 3]], [[6, 4, 0], [4, 3, 3]]]) / 10.0
    rewards = np.arange(18).reshape(3, 2, 3) * 7 % 11 - 3.0
    rewards[:, :, 0] += 4.0
    policy, behavior = np.array([[0.7, 0.3], [0.2, 0.8], [0.6, 0.4]]), np.full((3, 2), 0.5)
    start = np.array([0.5, 0.5, 0.0])
    made = [FiniteMDP(kernel, rewards, start, discount, layout=np.arange(3)) for kernel in (simulator, target)]
    return Case(name, made[0], made[1], policy, behavior, horizon, steps)


def _survival(name: str, horizon: int | None, steps: int) -> Case:
    """One action; alive pays 1. Episodes that are over count: without them the value would be sum gamma^t."""
    simulator, target = (
        FiniteMDP([[[stay, 1 - stay]], [[0.0, 1.0]]], [1.0, 0.0], [1.0, 0.0], 0.9, layout=[0.0, 1.0])
        for stay in (0.5, 0.7)
    )
    return Case(name, simulator, target, np.ones((2, 1)), np.ones((2, 1)), horizon, steps)


def _partial(name: str, horizon: int | None, discount: float, steps: int) -> Case:
    """Some (s, a) are never recorded, and the policy takes them."""
    whole = _ragged(name, horizon, discount, steps)
    behavior = whole.behavior.copy()
    behavior[1] = [1.0, 0.0]
    return replace(whole, behavior=behavior)


def _violated(name: str, horizon: int | None) -> Case:
    """The target moves where the simulator never does: from state 0 to state 2."""
    whole = _ragged(name, horizon, 0.9, 6)
    rows = np.array(_SIMULATOR)
    rows[0, :, 3] += rows[0, :, 2]
    rows[0, :, 2] = 0
    return replace(whole, simulator=_mortal(rows, 0.9))


_MADE: Mapping[str, Callable[[str], Case]] = {
    "ragged": lambda name: _ragged(name, 6, 0.9, 6),
    "ragged infinite": lambda name: _ragged(name, None, 0.8, 80),
    "moves": lambda name: _moves(name, 4, 1.0, 5),
    "moves infinite": lambda name: _moves(name, None, 0.3, 18),
    "survival": lambda name: _survival(name, 12, 12),
    "survival infinite": lambda name: _survival(name, None, 120),
    "partial": lambda name: _partial(name, 5, 0.9, 5),
    "partial infinite": lambda name: _partial(name, None, 0.5, 60),
    "violated": lambda name: _violated(name, 6),
    "violated infinite": lambda name: _violated(name, None),
}
CASES = tuple(_MADE)


def case(name: str) -> Case:
    """The case of that name, made anew; "same NAME": with the target for the simulator.

    Parameters
    ----------
    name : one of ``CASES``, or "same " and one of them

    Examples
    --------
    >>> CASES[:3]
    ('ragged', 'ragged infinite', 'moves')
    >>> round(case("ragged").truth, 2), round(case("same ragged").truth, 2)
    (10.07, 10.07)
    """
    _checks.instance(name, str, "name")
    bare = name.removeprefix("same ")
    _checks.one_of(bare, "name", CASES)
    found = _MADE[bare](bare)
    return found if bare == name else replace(found, name=name, simulator=copy.deepcopy(found.target))
