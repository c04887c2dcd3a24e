"""Samples of an environment that is stepped, by an agent that goes where they lack.

The ``Explorer`` goes to the state-action pairs that have too few samples. With n(s, a)
samples of each pair, N wanted, and the frequencies P_n, mu_n of what has been met so
far, value iteration solves

    V(s) = max(gamma V_0, max_a Q(s, a)),    V_0 = sum_s mu_n(s) V(s),
    Q(s, a) = 1 where n(s, a) < N (an action that was never taken among them),
              else gamma sum_s' P_n(s' | s, a) V(s'),

with V_0 in place of V(s') where the episode terminates; gamma V_0 is what a reset is
worth, so that traps are left. V is the largest E gamma^t, t the number of steps to the
nearest pair that lacks samples. Each state that was met was reached from a first state:
V > 0 as long as a pair lacks samples. Where the environment's info has a mask of
actions, the others are no pairs. On a warehouse of 144 states and 3 actions each
sample that is wanted takes 2.2 steps.
"""

from __future__ import annotations

import contextlib
from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks, _progress
from oee_tabular.exceptions import ArgumentError, SimulatorWarning

# not by the room's door: FiniteMDP.from_env asks for this file on use
from oee_tabular.mdp.empirical import Samples
from oee_tabular.mdp.environments import (
    read_integer,
    read_mask,
    require_environment,
)
from oee_tabular.mdp.gymnasium_table import Outcomes
from oee_tabular.mdp.naming import Name, Names, check_names, numbers_of, to_plain
from oee_tabular.tasks.stepping import (
    count_actions,
    count_observations,
    require_observation,
    reset_environment,
    step_environment,
)
from oee_tabular.typing import BoolArray, Csr, IntArray, Seed

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
MASK = "action_mask"  # its name in an environment's info
RESET = -1  # the action of leaving an episode; the next state where it terminates


def explore_environment(
    env: Any,
    samples_per_pair: object,
    seed: Seed,
    max_steps: object,
    names: tuple[Any, Any],
    *,
    masked: bool = True,
) -> Samples:
    """Draw the samples that ``FiniteMDP.from_env`` makes its model of.

    The arguments are explained there; ``names`` are of states and of actions.
    """
    n_wanted = _checks.positive_integer(samples_per_pair, "samples_per_pair")
    limit = _checks.positive_integer(max_steps, "max_steps")
    require_environment(env)
    n_actions = count_actions(env)
    _refuse_vectors(env)
    size = count_observations(env)
    states, actions = _check_both_names(names, size, n_actions)
    explorer = Explorer(
        env, n_actions, n_wanted, _checks.generator(seed), size, masked=masked
    )
    explorer.explore(limit)
    n_states, state_names, number = _number_states(explorer, states)
    called = Names(state_names, actions)
    if explorer.lacking:
        _warn_of_lacking_pairs(explorer, number, called, limit)
    shape = (n_states, n_actions)
    return Samples(
        _outcomes_of(explorer, number),
        number[explorer.starts],
        called,
        shape,
        _available_of(explorer, number, shape),
    )


def _refuse_vectors(env: Any) -> None:
    """Raise an error where observations are vectors of floating-point numbers."""
    space = getattr(env, "observation_space", None)
    if getattr(getattr(space, "dtype", None), "kind", "i") == "f":
        raise ArgumentError(
            "env.observation_space",
            f"must be discrete (cut a continuous one into cells first); it is {space}",
        )


def _check_both_names(
    names: tuple[Any, Any], n_observations: int | None, n_actions: int
) -> tuple[tuple[Name, ...] | None, tuple[Name, ...] | None]:
    """Check the names of states and of actions, where they are given."""
    actions = None
    if names[1] is not None:
        actions = check_names(names[1], "action_names", n_actions)
    states = None
    if names[0] is not None:
        rule = "a sequence of texts or tuples"
        states = _checks.collection(names[0], "state_names", rule)
        states = check_names(states, "state_names", n_observations or len(states))
    return states, actions


def _outcomes_of(explorer: Explorer, number: IntArray) -> Outcomes:
    """Return the transitions that the agent made, each once, by numbers of states."""
    state, action, following, reward, terminated = (
        np.array(c) for c in zip(*explorer.transitions, strict=True)
    )
    return Outcomes(
        number[state],
        action,
        number[following],
        np.ones(len(state)),
        reward,
        terminated,
    )


def _available_of(
    explorer: Explorer, number: IntArray, shape: tuple[int, int]
) -> BoolArray | None:
    """Return the actions that can be taken in each state; None if no mask was met."""
    if not explorer.masks:
        return None
    available = np.ones(shape, dtype=np.bool_)
    for met, mask in explorer.masks.items():
        available[number[met]] = mask
    return available


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
    total = explorer.n_pairs
    short = [(number[s], a) for s, a in sorted(explorer.lacking)]
    _checks.warn(
        f"samples_per_pair, {explorer.n_wanted}, was not reached within max_steps,"
        f" {limit}, in {len(short)} of the {total} reached state-action pairs:"
        f" {names.first_pairs(short)}",
        SimulatorWarning,
    )


def _sort_states(states: list[Any]) -> list[Any]:
    """Return the states in an order that does not depend on which was met first."""
    try:
        return sorted(states)
    except TypeError:
        return sorted(states, key=str)


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
    masks : dict
        Which actions can be taken, (A,) booleans, in each state that had a mask.
    """

    def __init__(
        self,
        env: Any,
        n_actions: int,
        n_wanted: int,
        generator: np.random.Generator,
        size: int | None,
        *,
        masked: bool = True,
    ) -> None:
        self.env = env
        self._keeper = self._keep if masked else None
        self.masks: dict[int, BoolArray] = {}
        self._info: Any = None  # what came with the last observation, if it has a mask
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
                    seen = reset_environment(self.env, seed, keep=self._keeper)
                    state = self._number(seen, "env.reset")
                    self._read_mask(state, "env.reset")
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

    @property
    def n_pairs(self) -> int:
        """Return the number of pairs of the open states."""
        if not self.masks:
            return self.n_actions * len(self.open)
        return sum(len(self._actions_of(state)) for state in self.open)

    def _report(self, bar: Any) -> None:
        """Show how many of the reached pairs have their samples."""
        n_pairs = self.n_pairs
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
            self.env, action, self._seen, keep=self._keeper
        )
        following = self._number(observation, action)
        if not terminated and (self._info or self.masks):
            self._read_mask(following, action)
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

    def _keep(self, info: Any) -> None:
        """Keep the mask that came with an observation, and nothing else of its info."""
        is_mapping = type(info) is dict or isinstance(info, Mapping)
        has_mask = is_mapping and MASK in info
        self._info = info if has_mask else None

    def _read_mask(self, state: int, call: int | str) -> None:
        """Keep the mask of actions that the environment gave with a state.

        It is the same whenever the state is met.
        """
        info = self._info or {}
        known = self.masks.get(state)
        if known is None and not info:
            return
        name, _ = self._place(call)
        place = f'{name}: info["{MASK}"]'
        seen = _checks.show(self._seen)
        if not info:
            raise ArgumentError(
                place,
                f"must be given whenever state {seen} is met, as it was before; it is"
                " not there (masked=False leaves masks out)",
            )
        mask = read_mask(info[MASK], self.n_actions, place)
        if known is None:
            if not mask.any():
                raise ArgumentError(
                    place,
                    f"must allow an action in state {seen}, which does not terminate"
                    " the episode; it allows none",
                )
            if state in self.open or self._was_left(state):
                raise ArgumentError(
                    place,
                    f"must be given whenever state {seen} is met; it was not there"
                    " before (masked=False leaves masks out)",
                )
            self.masks[state] = mask
        elif (mask != known).any():
            raise ArgumentError(
                place,
                f"must be the same whenever state {seen} is met; it is"
                f" {mask.astype(int).tolist()} after {known.astype(int).tolist()} (what"
                " decides which actions can be taken belongs to the observation;"
                " masked=False leaves masks out)",
            )

    def _actions_of(self, state: int) -> list[int]:
        """List the actions that can be taken in a state."""
        if state not in self.masks:
            return list(range(self.n_actions))
        actions: list[int] = np.flatnonzero(self.masks[state]).tolist()
        return actions

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
        actions = self._actions_of(state) if self.masks else range(self.n_actions)
        return [a for a in actions if self._counts[state, a] < self.n_wanted]

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
            if state in self.masks:
                return int(self.generator.choice(self._actions_of(state)))
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
        from oee_tabular.tasks._exploring import solve  # compiled on use

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
        for state, mask in self.masks.items():
            ahead[state, ~mask] = -np.inf
        actions = np.where(is_lacking, 1.0, ahead).argmax(axis=1)
        is_reset_better = best < EXPLORATION_DISCOUNT * values[n] - VALUE_TOLERANCE
        self._best = np.where(is_reset_better, RESET, actions).tolist()
        # what was never taken may lead anywhere, but for what cannot be taken
        unknown = ~is_taken & (ahead > -np.inf)
        self._values = np.where(unknown, 1.0, ahead).tolist()
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
