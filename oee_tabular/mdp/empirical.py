"""Empirical MDPs: P(s' | s, a) = n(s, a, s') / n(s, a) of a log or of an environment.

The ``Explorer`` of an environment that is stepped goes where state-action pairs have
too few samples. With n(s, a) samples of each pair, N wanted, and the frequencies P_n,
mu_n of what has been met so far, value iteration solves

    V(s) = max(gamma V_0, max_a Q(s, a)),    V_0 = sum_s mu_n(s) V(s),
    Q(s, a) = 1 where n(s, a) < N (an action that was never taken among them),
              else gamma sum_s' P_n(s' | s, a) V(s'),

with V_0 in place of V(s') where the episode terminates; gamma V_0 is what a reset is
worth, so that traps are left. V is the largest E gamma^t, t the number of steps to the
nearest pair that lacks samples. Each state that was met was reached from a first state:
V > 0 as long as a pair lacks samples. On a warehouse of 144 states and 3 actions each
sample that is wanted takes 2.2 steps.
"""

from __future__ import annotations

import contextlib
from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks, _progress
from oee_tabular._sparse import (
    check_values,
    csr_on_pattern,
    is_matrix_list,
    row_of_entry,
    row_sums,
    stack_actions,
)
from oee_tabular.exceptions import ArgumentError, DataWarning, SimulatorWarning
from oee_tabular.mdp.arrays import check_layout, csr_from_entries
from oee_tabular.mdp.gymnasium_table import Outcomes, build_arguments
from oee_tabular.mdp.naming import (
    Name,
    Names,
    check_names,
    initial_distribution,
    numbers_of,
    renumber,
    to_plain,
)
from oee_tabular.mdp.stepping import (
    count_actions,
    count_observations,
    read_integer,
    require_environment,
    require_observation,
    reset_environment,
    step_environment,
)
from oee_tabular.mdp.support import require_log
from oee_tabular.typing import Array, Csr, IntArray, Seed


class Sampling(NamedTuple):
    """Hold the numbers of samples that an MDP of frequencies rests on.

    Attributes
    ----------
    pairs : ndarray of shape (S*A,)
        The samples of each (s, a): inf of terminal states, 0 where none was taken and
        the row was filled in.
    starts : float
        The number of first states that were sampled, inf if the initial distribution
        was given.
    reward_error : csr_array of shape (S*A, S), or None
        The variance of the mean reward of each transition; None where rewards were
        given.
    """

    pairs: Array
    starts: float
    reward_error: Csr | None


def log_arguments(
    log: Any,
    rewards: Any,
    initial: object,
    sizes: tuple[Any, Any],
    names: tuple[Any, Any],
    layout: object,
) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP``, without the discount, from a log.

    ``FiniteMDP.from_log`` explains these. ``sizes`` and ``names`` are of states and of
    actions.
    """
    require_log(log)
    n_states, states, (state, following) = _resolve(
        log, "state", ("state", "next_state"), sizes[0], names[0]
    )
    n_actions, actions, (action,) = _resolve(
        log, "action", ("action",), sizes[1], names[1]
    )
    reward = _log_rewards(log, rewards)
    samples = Outcomes(
        state,
        action,
        following,
        np.ones(len(state)),
        np.nan_to_num(reward),
        log.terminated,
    )
    starts = state if log.episode_starts is None else state[log.episode_starts[:-1]]
    law: Array | None = None
    if initial is None and log.episode_starts is None and np.any(state != state[0]):
        _checks.warn(
            f"the log has no episodes: the simulator starts in each of its {len(state)}"
            " states alike (say where episodes start: initial=, --initial)",
            DataWarning,
        )
    if initial is not None:
        law = _checks.distribution(
            initial_distribution(initial, states, n_states), "initial", (n_states,)
        )
    return _empirical_arguments(
        samples,
        starts,
        law,
        Names(states, actions),
        (n_states, n_actions),
        rewards,
        layout,
    )


def _log_rewards(log: Any, rewards: Any) -> Array:
    """Return the rewards of a log's rows, 0 or nan where one is missing.

    Raises an ArgumentError where one is missing and no ``rewards`` are given.
    """
    lacking = ""
    reward: Array = np.zeros(len(log.state)) if log.reward is None else log.reward
    if log.reward is None:
        lacking = "the log has none"
    elif np.isnan(reward).any():
        lacking = "some rows of the log have none"
    if lacking and rewards is None:
        raise ArgumentError("rewards", f"must be given where {lacking}; they are None")
    return reward


def _resolve(
    log: Any, label: str, columns: tuple[str, ...], size: object, names: object
) -> tuple[int, tuple[Name, ...] | None, list[IntArray]]:
    """Return the number of states or actions, their names, and their columns."""
    own = getattr(log, f"{label}_names")
    codes = [getattr(log, column) for column in columns]
    called = own
    if names is not None:
        rule = "a sequence of texts or tuples"
        called = _checks.collection(names, f"{label}_names", rule)
    largest = max(int(each.max()) for each in codes)
    if size is None:
        size = largest + 1 if called is None else len(called)
    number = _checks.positive_integer(size, f"n_{label}s")
    if own is None and number <= largest:
        raise ArgumentError(
            f"n_{label}s",
            f"must be at least {largest + 1}, for the log has {label} {largest}; it is"
            f" {number}",
        )
    if called is not None:
        called = check_names(called, f"{label}_names", number)
    if own is not None:
        codes = [
            renumber(each, own, called, number, f"log.{name}")
            for each, name in zip(codes, columns, strict=True)
        ]
    return number, called, codes


def env_arguments(
    env: Any,
    samples_per_pair: object,
    seed: Seed,
    max_steps: object,
    names: tuple[Any, Any],
) -> dict[str, Any]:
    """Return the arguments of ``FiniteMDP``, without the discount, from an environment.

    ``FiniteMDP.from_env`` explains these. ``names`` are of states and of actions.
    """
    n_wanted = _checks.positive_integer(samples_per_pair, "samples_per_pair")
    limit = _checks.positive_integer(max_steps, "max_steps")
    require_environment(env)
    n_actions = count_actions(env)
    space = getattr(env, "observation_space", None)
    if getattr(getattr(space, "dtype", None), "kind", "i") == "f":
        raise ArgumentError(
            "env.observation_space",
            f"must be discrete (cut a continuous one into cells first); it is {space}",
        )
    size = count_observations(env)
    actions = None
    if names[1] is not None:
        actions = check_names(names[1], "action_names", n_actions)
    states = None
    if names[0] is not None:
        rule = "a sequence of texts or tuples"
        states = _checks.collection(names[0], "state_names", rule)
        states = check_names(states, "state_names", size or len(states))
    explorer = Explorer(env, n_actions, n_wanted, _checks.generator(seed), size)
    explorer.explore(limit)
    n_states, state_names, number = _number_states(explorer, states)
    called = Names(state_names, actions)
    if explorer.lacking:
        _warn_of_lacking_pairs(explorer, number, called, limit)
    state, action, following, reward, terminated = (
        np.array(c) for c in zip(*explorer.transitions, strict=True)
    )
    samples = Outcomes(
        number[state],
        action,
        number[following],
        np.ones(len(state)),
        reward,
        terminated,
    )
    return _empirical_arguments(
        samples,
        number[explorer.starts],
        None,
        called,
        (n_states, n_actions),
        None,
        None,
    )


def _number_states(
    explorer: Explorer, names: tuple[Name, ...] | None
) -> tuple[int, tuple[Name, ...] | None, IntArray]:
    """Return the number of states, their names, and the number of each state met.

    Observations that are integers are numbers of states; others become names. Given
    ``names`` order them.
    """
    met = list(explorer.states)
    if explorer.is_numbered:
        n_states = max(explorer.size or 0, 1 + max(met))
        if names is not None and len(names) != n_states:
            # the observations are not Discrete, so that their number was not known
            if len(names) < n_states:
                raise ArgumentError(
                    "state_names",
                    f"must have {n_states} names, for the environment has the state"
                    f" {max(met)}; it has {len(names)}",
                )
            n_states = len(names)
        return n_states, names, np.array(met)
    own = check_names(_sort_states(met), "the environment's observations", len(met))
    if names is None:
        names = own
    places = numbers_of(names)
    for name in own:
        if name not in places:
            raise ArgumentError(
                "state_names",
                f"must have every state that the environment shows; {name!r} is not"
                " there",
            )
    return len(names), names, np.array([places[state] for state in met])


def _warn_of_lacking_pairs(
    explorer: Explorer, number: IntArray, names: Names, limit: int
) -> None:
    """Warn of the state-action pairs that have too few samples after the last step."""
    total = explorer.n_actions * len(explorer.open)
    short = [(number[s], a) for s, a in sorted(explorer.lacking)]
    _checks.warn(
        f"samples_per_pair, {explorer.n_wanted}, was not reached within max_steps,"
        f" {limit}, in {len(short)} of the {total} reached state-action pairs:"
        f" {_list_pairs(short, names)}",
        SimulatorWarning,
    )


def _sort_states(states: list[Any]) -> list[Any]:
    """Return the states in an order that does not depend on which was met first."""
    try:
        return sorted(states)
    except TypeError:
        return sorted(states, key=str)


def _list_pairs(pairs: Any, names: Names) -> str:
    """Name the first three state-action pairs."""
    shown = "; ".join(names.pair(s, a) for s, a in pairs[:3])
    return f"{shown}; ..." if len(pairs) > 3 else shown


def _empirical_arguments(
    samples: Outcomes,
    starts: IntArray,
    initial: Array | None,
    names: Names,
    shape: tuple[int, int],
    rewards: Any,
    layout: object,
) -> dict[str, Any]:
    """Return the arguments of the MDP of samples, and the numbers of samples.

    ``initial`` None: the frequencies of ``starts``. ``rewards`` None: the mean reward
    of each transition.
    """
    n_states, n_actions = shape
    law = initial
    if law is None:
        law = np.bincount(starts, minlength=n_states) / len(starts)
    outcomes = _fill_pairs(samples, law, n_actions, names)
    by_pair = None
    if rewards is not None:
        table = _check_rewards(rewards, n_states, n_actions)
        if table.ndim < 3:
            by_pair = table.reshape(n_states, -1)
        else:
            reward = table[outcomes.state, outcomes.action, outcomes.next_state]
            outcomes = outcomes._replace(reward=reward)
    arguments = build_arguments(
        outcomes,
        law,
        n_actions,
        rewards=by_pair,
        layout=None if layout is None else check_layout(layout, n_states),
        state_names=names.states,
        action_names=names.actions,
    )
    counts = arguments["transitions"]
    terminal = arguments["terminal_state"]
    shares = counts.data / row_sums(counts)[row_of_entry(counts)]
    frequencies = csr_on_pattern(counts, shares, own=True)
    n_starts = float(len(starts)) if initial is None else np.inf
    sampling = _count_samples(
        samples, terminal, counts.shape, n_starts, has_rewards=rewards is None
    )
    return arguments | {"transitions": frequencies, "sampling": sampling}


def _check_rewards(rewards: Any, n_states: int, n_actions: int) -> Array:
    """Check rewards (S,), (S, A) or (S, A, S) and return them dense."""
    shape = n_states, n_actions, n_states
    if is_matrix_list(rewards):
        rewards = stack_actions(rewards, "rewards")
    is_sparse = _checks.is_sparse(rewards)
    given = check_values(rewards, "rewards").toarray() if is_sparse else rewards
    table = _checks.float_array(given, "rewards", ndim=(1, 2, 3))
    if is_sparse and table.shape == (n_states * n_actions, n_states):
        table = table.reshape(shape)
    if table.shape != shape[: table.ndim]:
        raise ArgumentError(
            "rewards",
            f"must have shape {shape[: table.ndim]}; it has shape {table.shape}",
        )
    return table


def _fill_pairs(
    samples: Outcomes, initial: Array, n_actions: int, names: Names
) -> Outcomes:
    """Return the samples, with others for the pairs (s, a) that have none.

    An action never taken in a state does what the other actions did there; a state
    never left is absorbing with reward 0, but for those that are entered by termination
    alone. A warning names such pairs.
    """
    state, action, following, _, _, terminated = samples
    n_states = len(initial)
    row = state * n_actions + action
    counts = np.bincount(row, minlength=n_states * n_actions).reshape(-1, n_actions)
    is_left = counts.any(axis=1)
    is_entered = np.bincount(following[~terminated], minlength=n_states) > 0
    is_alive = is_left | (initial > 0) | is_entered
    is_ended = np.bincount(following[terminated], minlength=n_states) > 0
    filled = np.argwhere((counts == 0) & is_alive[:, None])
    if len(filled):
        _checks.warn(
            f"{len(filled)} state-action pairs were never recorded and are filled in"
            " (by the state's other actions; without any the state is absorbing,"
            f" reward 0): {_list_pairs(filled, names)}",
            SimulatorWarning,
        )
    stays = np.flatnonzero(~is_left & (is_alive | ~is_ended))
    one = np.ones(len(stays))
    parts = [samples]
    for a in range(n_actions):
        others = np.flatnonzero((is_left & (counts[:, a] == 0))[state])
        copies = Outcomes._make(part[others] for part in samples)
        parts.append(copies._replace(action=np.full(len(others), a)))
        parts.append(
            Outcomes(stays, np.full(len(stays), a), stays, one, 0.0 * one, one < 0)
        )
    return Outcomes._make(np.concatenate(part) for part in zip(*parts, strict=True))


def _count_samples(
    samples: Outcomes,
    terminal: IntArray,
    shape: tuple[int, int],
    starts: float,
    *,
    has_rewards: bool,
) -> Sampling:
    """Count the samples of each pair, and estimate the variance of each mean reward.

    The variance of a mean of k rewards is s^2 / k, s^2 the transition's own, or the
    pooled one where k = 1. There is none without ``has_rewards``.
    """
    n_rows, n_states = shape
    row = samples.state * (n_rows // n_states) + samples.action
    to = np.where(samples.terminated, terminal[samples.next_state], samples.next_state)
    pairs = np.bincount(row, minlength=n_rows).astype(np.float64)
    is_terminal = np.bincount(to[samples.terminated], minlength=n_states) > 0
    pairs[np.repeat(is_terminal, n_rows // n_states)] = np.inf
    if not has_rewards:
        return Sampling(pairs, starts, None)
    number, total, squares = (
        csr_from_entries(row, to, samples.reward**k, shape) for k in range(3)
    )
    deviation = np.maximum(squares.data - total.data**2 / number.data, 0.0)
    freedom = float((number.data - 1.0).sum())
    pooled = float(deviation.sum()) / freedom if freedom else 0.0
    own = deviation / np.maximum(number.data - 1.0, 1.0)
    variance = np.where(number.data > 1, own, pooled) / number.data
    return Sampling(pairs, starts, csr_on_pattern(number, variance, own=True))


# The discount of the exploration alone: a pair 1000 steps away still counts 4e-5.
EXPLORATION_DISCOUNT = 0.99
VALUE_TOLERANCE = 1e-6  # of value iteration, absolute; values are at most 1
MAX_SWEEPS = 2000  # of value iteration
# Steps, or half the number of states if that is more: a younger plan is not renewed.
MIN_PLAN_AGE = 64
# The share of random steps among those that a plan decides: an environment that is not
# Markov cannot lead it in circles.
RANDOM_SHARE = 0.05
STEPS_OF_A_REPORT = 1000  # between two looks at the progress
MAX_CUTS = 10  # episodes truncated in a state, before it counts as out of reach
RESET = -1  # the action of leaving an episode; the next state where it terminates


class Explorer:
    """Draw samples of an environment until no reached state-action pair lacks them.

    Attributes
    ----------
    transitions : list of tuple
        The samples (state, action, next state, reward, terminated).
    starts : list of int
        The first state of each episode.
    states : dict
        The number of each observation, in the order in which they are met.
    open : set of int
        The states in which an episode can act.
    lacking : set of tuple
        The pairs (state, action) of open states with too few samples.
    size : int or None
        The number of states where observations are Discrete.
    is_numbered : bool
        Whether observations are numbers, and not names.
    """

    def __init__(
        self,
        env: Any,
        n_actions: int,
        n_wanted: int,
        generator: np.random.Generator,
        size: int | None,
    ) -> None:
        self.env = env
        self.size = size
        self.is_numbered = True
        self.n_actions = n_actions
        self.n_wanted = n_wanted
        self.generator = generator
        self.states: dict[Any, int] = {}
        self.transitions: list[tuple[int, int, int, float, bool]] = []
        self.starts: list[int] = []
        self.lacking: set[tuple[int, int]] = set()
        self.open: set[int] = set()
        self._counts: Counter[tuple[int, int]] = Counter()
        self._outcomes: defaultdict[tuple[int, int], Counter[int]]
        self._outcomes = defaultdict(Counter)
        self._cuts: Counter[int] = Counter()
        self._best: list[int] = []
        self._values: list[list[float]] = []
        self._plan_step = 0
        self._seen: object = None  # the observation that was made last

    def explore(self, max_steps: int) -> None:
        """Step until no pair lacks samples, or ``max_steps`` times."""
        seed: int | None = int(self.generator.integers(2**31))
        is_over = True
        state = 0
        with _progress.progress_bar("sampling", unit=" pairs") as bar:
            while len(self.transitions) < max_steps:
                if self.transitions and not self.lacking:
                    break
                is_first = is_over
                if is_over:
                    seen = reset_environment(self.env, seed)
                    state = self._number(seen, "env.reset")
                    seed = None
                    self.starts.append(state)
                    self._set_open(state, True)
                action = self._choose(state, is_first)
                if action == RESET:
                    is_over = True
                else:
                    state, is_over = self._step(state, action)
                if len(self.transitions) % STEPS_OF_A_REPORT == 0:
                    self._report(bar)

    def _report(self, bar: Any) -> None:
        """Show how many of the reached pairs have their samples."""
        n_pairs = self.n_actions * len(self.open)
        n_done = n_pairs - len(self.lacking)
        bar.total = n_pairs
        bar.update(n_done - bar.n)
        _progress.report_step(
            f"sampling: {n_done} of {n_pairs} reached state-action pairs have"
            f" {self.n_wanted} samples after {len(self.transitions)} steps"
        )

    def _step(self, state: int, action: int) -> tuple[int, bool]:
        """Take an action; return the next state and whether the episode is over."""
        observation, reward, terminated, truncated = step_environment(
            self.env, action, self._seen
        )
        following = self._number(observation, action)
        self.transitions.append((state, action, following, reward, terminated))
        self._outcomes[state, action][RESET if terminated else following] += 1
        self._counts[state, action] += 1
        if self._counts[state, action] == self.n_wanted:
            self.lacking.discard((state, action))
        is_cut = truncated and not terminated
        if is_cut and not self._was_left(following):
            # no episode may ever act there, and then its pairs cannot have samples
            self._cuts[following] += 1
            self._set_open(following, self._cuts[following] < MAX_CUTS)
        elif not terminated:
            self._set_open(following, True)
        return following, terminated or truncated

    def _was_left(self, state: int) -> bool:
        """Say whether any action was taken in a state."""
        return any(self._counts[state, a] for a in range(self.n_actions))

    def _number(self, observation: object, call: int | str) -> int:
        """Return the number of an observation, a new one if it was not met before.

        ``call`` is the action that it followed, or the name of a reset.
        """
        if self.size is not None:
            if type(observation) is not int or observation not in self.states:
                observation = require_observation(
                    observation, self.size, self.env, *self._place(call)
                )
        elif type(observation) is not int or observation not in self.states:
            observation = self._check_free(observation, call)
        self._seen = observation
        return self.states.setdefault(observation, len(self.states))

    def _check_free(self, observation: object, call: int | str) -> object:
        """Return an observation that is not Discrete as a number or a name."""
        seen = to_plain(observation)
        with contextlib.suppress(TypeError):  # what cannot be looked up
            if seen in self.states:
                return seen
        number = None if isinstance(seen, str | tuple) else read_integer(seen)
        name, state = self._place(call)
        where = "" if state is None else f"in state {_checks.show(state)} "
        rule = (
            "must give an observation that is a number from 0, a text, or a tuple or"
            f" array of integers; {where}it gives {_checks.show(observation)}"
        )
        if number is not None and number >= 0:
            seen = number
        elif isinstance(observation, Mapping):
            raise ArgumentError(
                name,
                f"{rule} (gymnasium.wrappers.FlattenObservation(env) makes an array of"
                " a dict)",
            )
        elif isinstance(seen, str | tuple):
            try:
                check_names([seen], name, 1)
            except ArgumentError as error:
                raise ArgumentError(name, f"{rule}; a name {error.rule}") from None
        else:
            raise ArgumentError(name, rule)
        is_number = not isinstance(seen, str | tuple)
        if self.states and is_number != self.is_numbered:
            raise ArgumentError(
                name,
                "must give numbers alone or names alone as observations; it gives"
                f" {_checks.show(observation)} after"
                f" {_checks.show(next(iter(self.states)))}",
            )
        self.is_numbered = is_number
        return seen

    def _place(self, call: int | str) -> tuple[str, object]:
        """Return the name of a step or reset, and the state in which it was made."""
        if isinstance(call, str):
            return call, None
        return f"env.step({call})", self._seen

    def _actions_that_lack(self, state: int) -> list[int]:
        """List the actions of a state that have too few samples."""
        return [
            a for a in range(self.n_actions) if self._counts[state, a] < self.n_wanted
        ]

    def _set_open(self, state: int, is_open: bool) -> None:
        """Keep whether an episode can act in a state, so that it needs samples."""
        if is_open and state not in self.open:
            self.open.add(state)
            self.lacking.update((state, a) for a in self._actions_that_lack(state))
        elif not is_open and state in self.open:
            self.open.remove(state)
            self.lacking.difference_update((state, a) for a in range(self.n_actions))

    def _choose(self, state: int, is_first: bool) -> int:
        """Return the lacking action nearest to others, else the plan's action."""
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
        if best == RESET and is_first:  # a reset would lead to where the episode is
            return int(np.argmax(self._values[state]))
        return best

    def _plan(self) -> None:
        """Solve for V by value iteration from 0, and keep the best actions and values.

        The values are gamma sum_s' P_n V of each pair.
        """
        n = len(self.states)
        is_lacking, is_taken = np.zeros((2, n, self.n_actions), dtype=np.bool_)
        for pair in self.lacking:
            is_lacking[pair] = True
        for pair in self._counts:
            is_taken[pair] = True
        frequencies = self._frequencies()
        starts = np.bincount(self.starts, minlength=n) / len(self.starts)
        from oee_tabular.mdp._exploring import solve  # compiled on use

        best, ahead, values = solve(
            frequencies.data,
            frequencies.indices,
            frequencies.indptr,
            starts,
            is_lacking,
            EXPLORATION_DISCOUNT,
            VALUE_TOLERANCE,
            MAX_SWEEPS,
        )
        actions = np.where(is_lacking, 1.0, ahead).argmax(axis=1)
        is_reset_better = best < EXPLORATION_DISCOUNT * values[n] - VALUE_TOLERANCE
        self._best = np.where(is_reset_better, RESET, actions).tolist()
        self._values = np.where(is_taken, ahead, 1.0).tolist()
        self._plan_step = len(self.transitions)

    def _frequencies(self) -> Csr:
        """Return P_n as csr of shape (S*A, S + 1), its last column ended episodes."""
        n = len(self.states)
        entries = []
        for (s, a), met in self._outcomes.items():
            for k, number in met.items():
                column = n if k == RESET else k
                share = number / self._counts[s, a]
                entries.append((share, s * self.n_actions + a, column))
        shares, rows, columns = (np.array(part) for part in zip(*entries, strict=True))
        shape = (n * self.n_actions, n + 1)
        return sparse.csr_array((shares, (rows, columns)), shape=shape)
