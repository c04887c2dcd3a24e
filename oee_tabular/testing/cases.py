"""The small pairs of environments that estimators are checked on, each known exactly.

Target and simulator differ much (the simulator's value is off by many standard
errors), with the same support and small integer probabilities. Every behaviour policy
takes every action, unless the case is about one that does not. The states lie on a
line, in the order of their numbers (``layout``): renamed states keep their places.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._results import checked, conform
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy, policy_value
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.simulate import sample_episodes
from oee_tabular.typing import Array, BoolArray, IntArray, IntArrayLike, Seed


@checked(shapes={"policy": "S A", "behavior": "S A"})
@dataclass(frozen=True, eq=False)
class Case:
    """Hold a pair, a policy to evaluate, and how logs of the target are recorded.

    Attributes
    ----------
    name : str
        The name, one of ``CASES``.
    simulator : FiniteMDP
        The simulator.
    target : FiniteMDP
        The target.
    policy : ndarray of shape (S, A)
        The policy to evaluate.
    behavior : ndarray of shape (S, A)
        The policy that records logs.
    horizon : int or None
        Number of rewards of the value; None means the infinite sum.
    steps : int
        Length of the longest episode of a log, in some cases beyond the horizon.

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

    def __post_init__(self) -> None:
        for name in ("policy", "behavior"):
            policy = check_policy(getattr(self, name), self.simulator, name=name)
            object.__setattr__(self, name, policy)
        _checks.optional_horizon(self.horizon)
        _checks.positive_integer(self.steps, "steps")

    @property
    def title(self) -> str:
        """Return its name, horizon and discount as a text."""
        end = "no horizon" if self.horizon is None else f"horizon {self.horizon}"
        return f"{self.name} ({end}, discount {self.simulator.discount:g})"

    @property
    def truth(self) -> float:
        """Return the exact value J of the policy in the target."""
        return policy_value(self.target, self.policy, horizon=self.horizon)

    @property
    def data_distribution(self) -> Array:
        """Return the expected shares (S, A) of the state-action pairs in a log."""
        return pair_shares(self.target, self.behavior, self.steps)

    def log(self, n: int, *, seed: Seed) -> Transitions:
        """Draw ``n`` episodes of the behaviour policy in the target.

        Parameters
        ----------
        n : int
            Number of episodes.
        seed : Seed
            What ``numpy.random.default_rng`` takes.

        Returns
        -------
        Transitions
            The log, with episodes and behaviour probabilities.
        """
        return sample_episodes(self.target, self.behavior, n, self.steps, seed=seed)

    def logs(self, n: int, repetitions: int, *, seed: Seed) -> Iterator[Transitions]:
        """Draw independent logs of ``n`` episodes each, one after the other.

        Parameters
        ----------
        n : int
            Number of episodes of each log.
        repetitions : int
            Number of logs, which are parts of a single draw.
        seed : Seed
            What ``numpy.random.default_rng`` takes.

        Returns
        -------
        iterator of Transitions
            The logs.
        """
        # checked and drawn at the call, not at the first log that is asked for
        n = _checks.positive_integer(n, "n")
        repetitions = _checks.positive_integer(repetitions, "repetitions")
        whole = self.log(n * repetitions, seed=seed)
        starts = whole.episode_starts
        columns = whole.columns()
        assert starts is not None
        slices = (slice(starts[k * n], starts[(k + 1) * n]) for k in range(repetitions))
        return (
            Transitions(**{name: column[rows] for name, column in columns.items()})
            for rows in slices
        )

    def exact_log(self, copies: int = 1) -> Transitions:
        """Return a log in which every episode is as frequent as it is probable.

        Frequencies in it are the target's probabilities, to the bit, and its mean
        return is the behaviour policy's value. So an estimator that is right for many
        episodes is right on it, without any chance.

        Parameters
        ----------
        copies : int, default 1
            How often the log repeats its episodes.

        Returns
        -------
        Transitions
            The log, with the columns of ``log``.

        Raises
        ------
        ValueError
            If the probabilities of ``initial``, behaviour and target have no small
            common denominators, so that such a log would have more than 100 000
            episodes.

        Examples
        --------
        >>> pair = case("exact")
        >>> log = pair.exact_log()
        >>> counts = log.counts(3, 2).toarray()[:4]  # of the pairs that do not absorb
        >>> (counts / counts.sum(axis=1, keepdims=True)).tolist() == (
        ...     pair.target.transitions.toarray()[:4].tolist()
        ... )
        True
        """
        copies = _checks.positive_integer(copies, "copies")
        return _exact_log(self, copies)

    def problem(self, n: int, *, seed: Seed) -> Problem:
        """Return the problem of a log of ``n`` episodes.

        Parameters
        ----------
        n : int
            Number of episodes.
        seed : Seed
            What ``numpy.random.default_rng`` takes.

        Returns
        -------
        Problem
            Simulator, log, horizon and behaviour policy.
        """
        return self.problem_of(self.log(n, seed=seed))

    def problem_of(self, log: Transitions) -> Problem:
        """Return the problem of a log, on copies of everything.

        Parameters
        ----------
        log : Transitions
            A log of the target.

        Returns
        -------
        Problem
            Simulator, log, horizon and behaviour policy.
        """
        _checks.instance(log, Transitions, "log", "Transitions")
        simulator = copy.deepcopy(self.simulator)
        own_log = Transitions(**log.columns())
        return Problem(
            simulator,
            own_log,
            horizon=self.horizon,
            behavior_policy=self.behavior.copy(),
        )

    def with_rewards(self, scale: float, shift: float) -> Case:
        """Return the same case with rewards scale * r + shift, in every state.

        Parameters
        ----------
        scale : float
            Factor of every reward.
        shift : float
            Summand of every reward.

        Returns
        -------
        Case
            The case with other rewards in simulator and target.
        """
        scale = _checks.number_in(scale, "scale", -np.inf, np.inf)
        shift = _checks.number_in(shift, "shift", -np.inf, np.inf)
        largest: float = max(
            np.abs(mdp.rewards).max() for mdp in (self.simulator, self.target)
        )
        with np.errstate(over="ignore"):
            size = abs(scale) * largest + abs(shift)
        if not np.isfinite(size):
            raise ArgumentError(
                "scale",
                "must leave rewards that double precision holds;"
                f" {scale:g} * {largest:g} + {shift:g} is too large",
            )
        pair = []
        for mdp in (self.simulator, self.target):
            rewards: Any = scale * mdp.rewards + shift
            if mdp.transition_rewards is not None:
                rewards = mdp.transition_rewards.copy()
                rewards.data = scale * rewards.data + shift
            pair.append(mdp.with_rewards(rewards))
        return replace(self, simulator=pair[0], target=pair[1])

    def relabelled(self, states: IntArrayLike, actions: IntArrayLike) -> Case:
        """Return the same case with states and actions renamed.

        Parameters
        ----------
        states : array_like of int, shape (S,)
            A permutation: state s becomes ``states[s]``.
        actions : array_like of int, shape (A,)
            A permutation: action a becomes ``actions[a]``.

        Returns
        -------
        Case
            The renamed case.
        """
        new_states = _permutation(states, "states", self.simulator.n_states)
        new_actions = _permutation(actions, "actions", self.simulator.n_actions)
        for name, numbers, size in (
            ("states", new_states, self.simulator.n_states),
            ("actions", new_actions, self.simulator.n_actions),
        ):
            if len(numbers) > size:
                raise ArgumentError(
                    name,
                    f"must have a number for each of {size} {name}; it has"
                    f" {len(numbers)}",
                )
        old = np.ix_(np.argsort(new_states), np.argsort(new_actions))
        simulator, target = (
            _relabel(mdp, old) for mdp in (self.simulator, self.target)
        )
        return replace(
            self,
            simulator=simulator,
            target=target,
            policy=self.policy[old],
            behavior=self.behavior[old],
        )


MAX_EPISODES = 100_000  # of an exact log
MAX_DENOMINATOR = 64  # of the probabilities that it has


def _equally_likely(chances: Array, name: str) -> IntArray:
    """Return outcomes (rows, D), each with the chance 1 / D in its row of ``chances``.

    D is the least common denominator of all rows.
    """
    for size in range(1, MAX_DENOMINATOR + 1):
        times = np.rint(chances * size)
        if float(np.abs(times - chances * size).max()) < 1e-9:
            outcomes = np.tile(np.arange(chances.shape[1]), len(chances))
            repeated = np.repeat(outcomes, times.astype(np.int64).ravel())
            return repeated.reshape(len(chances), size)
    raise ArgumentError(
        name,
        f"must be multiples of 1/D with a D of at most {MAX_DENOMINATOR} for an exact"
        " log; they are not (pair.log draws one)",
    )


def _exact_log(pair: Case, copies: int) -> Transitions:
    """Return every episode of a case as often as it is probable, ``copies`` times."""
    target = pair.target
    paths = np.tile(_equally_likely_paths(pair, copies), (copies, 1, 1))
    ended = target.absorbing()
    # an episode ends on its first arrival in an absorbing state, after at least a step
    over = ended[paths[:, :, 2]].astype(np.int64)
    goes_on: BoolArray = over.cumsum(axis=1) == over
    episode, timestep = np.nonzero(goes_on)
    states, actions, next_states = paths[episode, timestep].T
    rewards = target.rewards[states, actions]
    if target.transition_rewards is not None:
        table = target.transition_rewards.toarray()
        rewards = table[states * target.n_actions + actions, next_states]
    return Transitions(
        states,
        actions,
        next_states,
        rewards,
        terminated=ended[next_states],
        episode=episode,
        timestep=timestep,
        behavior_probability=pair.behavior[states, actions],
    )


def _equally_likely_paths(pair: Case, copies: int) -> IntArray:
    """Return (n, steps, 3) paths of s, a, s', each as often as it is probable.

    Raises an ArgumentError where ``copies`` of them are more than ``MAX_EPISODES``.
    """
    target = pair.target
    n_actions = target.n_actions
    state = _equally_likely(target.initial[None, :], "initial")[0]
    action_of = _equally_likely(pair.behavior, "behavior")
    rows = target.transitions.toarray()
    # a row for the actions that cannot be taken, which no path takes
    rows[~target.available.reshape(-1), 0] = 1.0
    next_of = _equally_likely(rows, "transitions")
    n_choices = action_of.shape[1]
    n_moves = next_of.shape[1]
    n_paths = len(state) * (n_choices * n_moves) ** pair.steps
    total = copies * n_paths
    if total > MAX_EPISODES >= n_paths:
        raise ArgumentError(
            "copies",
            f"must be at most {MAX_EPISODES // n_paths}: a log has at most"
            f" {MAX_EPISODES} episodes, and each copy {n_paths}; got {copies}",
        )
    if total > MAX_EPISODES:
        exponent = math.log10(total)
        shown = str(total) if exponent < 15 else f"about 10^{exponent:.0f}"
        raise ArgumentError(
            "pair",
            f"must have at most {MAX_EPISODES} equally likely episodes for an exact"
            f" log; it has {shown} (fewer steps, or pair.log, which draws one)",
        )
    paths = np.zeros((len(state), 0, 3), dtype=np.int64)
    for _ in range(pair.steps):
        here = np.repeat(state, n_choices)
        action = action_of[state].ravel()
        arrival = next_of[here * n_actions + action].ravel()
        step = np.stack(
            [np.repeat(here, n_moves), np.repeat(action, n_moves), arrival], axis=1
        )
        paths = np.concatenate(
            [np.repeat(paths, n_choices * n_moves, axis=0), step[:, None]], axis=1
        )
        state = arrival
    return paths


def pair_shares(target: FiniteMDP, behavior: Array, steps: int) -> Array:
    """Return the expected shares (S, A) of the state-action pairs of episodes.

    An episode ends on arrival in an absorbing state.
    """
    time = occupancy(target.with_discount(1.0), behavior, horizon=steps)
    alive = np.where(target.absorbing()[:, None], 0.0, time)
    shares = alive if alive.any() else time
    return np.asarray(shares / shares.sum())


def relabelled_log(
    log: Transitions, states: IntArrayLike, actions: IntArrayLike
) -> Transitions:
    """Return a log with renamed states and actions, that of ``Case.relabelled``.

    Parameters
    ----------
    log : Transitions
        A log with any columns. States or actions that have names keep them, as in a
        simulator that is relabelled.
    states : array_like of int, shape (S,)
        A permutation: state s gets the number ``states[s]``.
    actions : array_like of int, shape (A,)
        A permutation: action a gets the number ``actions[a]``.

    Returns
    -------
    Transitions
        The renamed log.

    Raises
    ------
    ValueError
        If one is no permutation, or too short for the log.

    Examples
    --------
    >>> log = case("ragged").log(2, seed=0)
    >>> new = relabelled_log(log, [1, 0, 2, 3], [0, 1])
    >>> log.state[:4].tolist(), new.state[:4].tolist()
    ([0, 0, 1, 1], [1, 1, 0, 0])
    """
    columns = _checks.instance(log, Transitions, "log", "Transitions").columns()
    for name, numbers in (
        ("state", states),
        ("action", actions),
        ("next_state", states),
    ):
        if columns[name].dtype.kind in "iu":
            most = int(columns[name].max()) + 1
            columns[name] = _permutation(
                numbers, "actions" if name == "action" else "states", most
            )[columns[name]]
    return Transitions(**columns)


def _permutation(value: IntArrayLike, name: str, most: int) -> IntArray:
    """Return ``value`` as an array of integers, checked to be a permutation."""
    array = _checks.as_array(value, name)
    if (
        array.ndim != 1
        or array.dtype.kind not in "iuf"
        or not np.array_equal(np.sort(array, axis=None), np.arange(len(array)))
    ):
        raise ArgumentError(
            name, f"must be a permutation of 0, 1, ...; it is {_checks.show(value)}"
        )
    if len(array) < most:
        raise ArgumentError(
            name, f"must have a number for each of {most} {name}; it has {len(array)}"
        )
    return array.astype(np.int64)


def padded_log(
    log: Transitions, actions: Sequence[int], probability: float
) -> Transitions:
    """Add transitions in the absorbing state after every episode that ended there.

    Parameters
    ----------
    log : Transitions
        A log with episodes.
    actions : sequence of int
        Actions of the rows that are added to each such episode.
    probability : float
        What the behaviour policy gives each of them.

    Returns
    -------
    Transitions
        The longer log.

    Raises
    ------
    ValueError
        If the log has no episodes.

    Examples
    --------
    >>> log = case("ragged").log(2, seed=0)
    >>> len(log), int(log.terminated.sum()), len(padded_log(log, (0, 1), 0.5))
    (4, 2, 8)
    """
    _checks.instance(log, Transitions, "log", "Transitions")
    added: IntArray = conform(actions, "actions", IntArray)
    if added.ndim != 1:
        raise ArgumentError(
            "actions", f"must be a list of actions; it has shape {added.shape}"
        )
    if (added < 0).any():
        k = int(np.argmax(added < 0))
        raise ArgumentError(
            f"actions[{k}]", f"must be at least 0; it is {int(added[k])}"
        )
    probability = _checks.number_in(probability, "probability", 0.0, 1.0)
    starts = log.episode_starts
    n = len(added)
    if starts is None:
        raise ArgumentError("log", "must have episodes; it has none")
    columns = log.columns()
    last = starts[1:] - 1
    last = last[log.terminated[last]]
    columns["terminated"] = columns["terminated"] & ~np.isin(np.arange(len(log)), last)
    end = np.repeat(log.next_state[last], n)
    more: dict[str, Any] = {
        "state": end,
        "action": np.tile(added, len(last)),
        "next_state": end,
        "reward": 0.0,
        "terminated": np.tile(np.arange(n) == n - 1, len(last)),
        "episode": np.repeat(columns["episode"][last], n),
        "behavior_probability": probability,
    }
    after = np.repeat(last + 1, n)
    return Transitions(
        **{
            name: np.insert(columns[name], after, new)
            for name, new in more.items()
            if name in columns
        }
    )


def _relabel(mdp: FiniteMDP, old: tuple[IntArray, ...]) -> FiniteMDP:
    """Return the MDP whose state s was ``old[0][s]``; names and places go along."""
    states, actions = (index.ravel() for index in old)
    rows = (old[0] * mdp.n_actions + old[1]).ravel()
    rewards: Any = mdp.rewards[old]
    if mdp.transition_rewards is not None:
        rewards = mdp.transition_rewards[rows][:, states]
    layout = None if mdp.layout is None else mdp.layout[states]
    new = FiniteMDP(
        mdp.transitions[rows][:, states],
        rewards,
        mdp.initial[states],
        mdp.discount,
        layout=layout,
        available=None if mdp.has_all_actions else mdp.available[old],
    )
    names = ((mdp.state_names, states), (mdp.action_names, actions))
    return new.with_names(
        *(None if own is None else [own[k] for k in index] for own, index in names)
    )


# ---- the cases


class _Pair(NamedTuple):
    """Hold tables of transitions in tenths; a state that they only lead to absorbs."""

    simulator: Any
    target: Any
    rewards: Any
    initial: Any
    policy: Any
    behavior: Any

    def make(self, tenths: Any, discount: float) -> FiniteMDP:
        """Return the MDP of a table of transitions in tenths."""
        transitions = np.array(tenths) / 10.0
        n, n_actions, n_states = transitions.shape
        absorbing = np.tile(np.eye(n_states)[n:, None], (1, n_actions, 1))
        transitions = np.concatenate([transitions, absorbing])
        return FiniteMDP(
            transitions,
            self.rewards,
            self.initial,
            discount,
            layout=np.arange(n_states),
        )


_RAGGED = _Pair(  # three states that pay, each left for an absorbing one
    simulator=[
        [[2, 2, 3, 3], [1, 2, 3, 4]],
        [[4, 1, 2, 3], [3, 3, 2, 2]],
        [[2, 2, 2, 4], [2, 2, 2, 4]],
    ],
    target=[
        [[3, 3, 3, 1], [1, 2, 2, 5]],
        [[5, 1, 1, 3], [2, 5, 2, 1]],
        [[1, 2, 2, 5], [3, 1, 3, 3]],
    ],
    rewards=[[4.0, -1.0], [2.0, 7.0], [-3.0, 5.0], [0.0, 0.0]],
    initial=[0.8, 0.2, 0.0, 0.0],
    policy=[[0.8, 0.2], [0.3, 0.7], [0.5, 0.5], [1.0, 0.0]],
    behavior=[[0.6, 0.4], [0.4, 0.6], [0.6, 0.4], [1.0, 0.0]],
)
_MOVES = _Pair(  # nothing ends, and a reward belongs to the transition
    simulator=[[[2, 5, 3], [4, 0, 6]], [[0, 4, 6], [4, 3, 3]], [[6, 4, 0], [4, 3, 3]]],
    target=[[[1, 7, 2], [5, 0, 5]], [[0, 2, 8], [6, 2, 2]], [[8, 2, 0], [3, 4, 3]]],
    rewards=[
        [[1, 4, 0], [11, 3, -1]],
        [[10, 2, -2], [9, 1, -3]],
        [[8, 0, 7], [7, -1, 6]],
    ],
    initial=[0.5, 0.5, 0.0],
    policy=[[0.7, 0.3], [0.2, 0.8], [0.6, 0.4]],
    behavior=[[0.5, 0.5]] * 3,
)
# alive pays 1. Episodes that ended count: without them the value would be sum gamma^t
_SURVIVAL = _Pair(
    [[[5, 5]]],
    [[[7, 3]]],
    rewards=[1.0, 0.0],
    initial=[1.0, 0.0],
    policy=np.ones((2, 1)),
    behavior=np.ones((2, 1)),
)
# the policy takes an action that is never recorded
_PARTIAL = _RAGGED._replace(behavior=[[0.6, 0.4], [1.0, 0.0], [0.6, 0.4], [1.0, 0.0]])
# the simulator never moves from state 0 to state 2
_VIOLATED = _RAGGED._replace(
    simulator=[[[2, 2, 0, 6], [1, 2, 0, 7]], *_RAGGED.simulator[1:]]
)
# few episodes, all equally likely, which ``exact_log`` has; longer than the horizon
_EXACT = _Pair(
    simulator=[[[7, 3, 0], [0, 3, 7]], [[4, 0, 6], [8, 2, 0]]],
    target=[[[5, 5, 0], [0, 5, 5]], [[5, 0, 5], [5, 5, 0]]],
    rewards=[
        [[4, -1, 2], [3, 7, -2]],
        [[6, 1, -3], [2, 5, 9]],
        [[0, 0, 0], [0, 0, 0]],
    ],
    initial=[0.75, 0.25, 0.0],
    policy=[[0.3, 0.7], [0.8, 0.2], [1.0, 0.0]],
    behavior=[[0.75, 0.25], [0.25, 0.75], [1.0, 0.0]],
)
# the policy takes an action that is never recorded
_EXACT_PARTIAL = _EXACT._replace(behavior=[[0.75, 0.25], [1.0, 0.0], [1.0, 0.0]])
# without a horizon: whatever is done, the second step ends in state 4
_EXACT_ENDED = _Pair(
    simulator=[
        [[0, 0, 7, 3, 0], [0, 0, 0, 3, 7]],
        [[0, 0, 4, 0, 6], [0, 0, 8, 2, 0]],
        [[0, 0, 0, 0, 10]] * 2,
        [[0, 0, 0, 0, 10]] * 2,
    ],
    target=[
        [[0, 0, 5, 5, 0], [0, 0, 0, 5, 5]],
        [[0, 0, 5, 0, 5], [0, 0, 5, 5, 0]],
        [[0, 0, 0, 0, 10]] * 2,
        [[0, 0, 0, 0, 10]] * 2,
    ],
    rewards=[[4.0, -1.0], [2.0, 7.0], [-3.0, 5.0], [6.0, 1.0], [0.0, 0.0]],
    initial=[0.75, 0.25, 0.0, 0.0, 0.0],
    policy=[[0.3, 0.7], [0.8, 0.2], [0.1, 0.9], [0.6, 0.4], [1.0, 0.0]],
    behavior=[[0.75, 0.25], [0.25, 0.75], [0.5, 0.5], [0.25, 0.75], [1.0, 0.0]],
)
_EXACT_ENDED_PARTIAL = _EXACT_ENDED._replace(
    behavior=[[0.75, 0.25], [1.0, 0.0], [0.5, 0.5], [1.0, 0.0], [1.0, 0.0]]
)
# discount, horizon, steps
_MADE: Mapping[str, tuple[_Pair, float, int | None, int]] = {
    "ragged": (_RAGGED, 0.9, 6, 6),
    "ragged infinite": (_RAGGED, 0.8, None, 80),
    "moves": (_MOVES, 1.0, 4, 5),
    "moves infinite": (_MOVES, 0.3, None, 18),
    "survival": (_SURVIVAL, 0.9, 12, 12),
    "survival infinite": (_SURVIVAL, 0.9, None, 120),
    "partial": (_PARTIAL, 0.9, 5, 5),
    "partial infinite": (_PARTIAL, 0.5, None, 60),
    "violated": (_VIOLATED, 0.9, 6, 6),
    "violated infinite": (_VIOLATED, 0.9, None, 6),
    "exact": (_EXACT, 0.9, 2, 3),
    "exact infinite": (_EXACT_ENDED, 0.8, None, 2),
    "exact partial": (_EXACT_PARTIAL, 0.9, 2, 3),
    "exact partial infinite": (_EXACT_ENDED_PARTIAL, 0.8, None, 2),
}
CASES = tuple(_MADE)


def case(name: str) -> Case:
    """Return the case of a name, made anew.

    Parameters
    ----------
    name : str
        One of ``CASES``; or "same " and one of them, the case in which the simulator is
        the target.

    Returns
    -------
    Case
        A pair of environments with a policy and how logs are recorded.

    Raises
    ------
    ValueError
        If there is no case of that name.

    Examples
    --------
    >>> CASES[:3]
    ('ragged', 'ragged infinite', 'moves')
    >>> round(case("ragged").truth, 2), round(case("same ragged").truth, 2)
    (10.07, 10.07)
    """
    bare = _checks.instance(name, str, "name").removeprefix("same ")
    _checks.one_of(bare, "name", CASES)
    pair, discount, horizon, steps = _MADE[bare]
    simulator = pair.make(pair.simulator if bare == name else pair.target, discount)
    policy = np.array(pair.policy)
    behavior = np.array(pair.behavior)
    return Case(
        name,
        simulator,
        pair.make(pair.target, discount),
        policy,
        behavior,
        horizon,
        steps,
    )


def odd_cases() -> Iterator[Case]:
    """Yield small cases at the edges of what a problem can be.

    They have one state, one action, discounts 0 and 1, one reward, nothing random, or
    actions that are never recorded.
    """
    single = FiniteMDP([[[1.0]]], [2.0], [1.0], 0.5)
    # half the starts are terminal
    fork = [[[0.5, 0.5], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]]
    leave = FiniteMDP(fork, [[1.0, 3.0], [0.0, 0.0]], [0.5, 0.5], 1.0)
    certain = FiniteMDP([[[0.0, 1.0]], [[1.0, 0.0]]], [1.0, -1.0], [1.0, 0.0], 0.9)
    first = [[1.0, 0.0]] * 2
    even = [[0.5, 0.5]] * 2
    one = [[1.0]]
    # policy, behaviour, horizon, steps
    rows: list[tuple[str, FiniteMDP, Any, Any, int | None, int]] = [
        ("one state", single, one, one, 3, 3),
        ("one state", single, one, one, None, 60),
        ("discount 0", leave.with_discount(0.0), first, even, None, 5),
        ("discount 1", leave, first, even, 4, 4),
        ("discount 1", leave, even, even, None, 40),
        ("one reward", leave, first, even, 1, 3),
        ("nothing random", certain, one * 2, one * 2, 4, 4),
        ("an action never recorded", leave, even, first, 4, 4),
        ("no episode of the policy's", leave, [[0.0, 1.0], [1.0, 0.0]], first, 4, 4),
    ]
    for name, mdp, policy, behavior, horizon, steps in rows:
        yield Case(name, mdp, mdp, np.array(policy), np.array(behavior), horizon, steps)
