"""Hypothesis strategies of finite MDPs, policies, pairs, horizons and logs.

Everything is made of small integers: probabilities are small weights over their sum,
with exact zeros and many ties; rewards are integers from -5 to 5. Examples shrink
towards one state, one action, discount 0 and even chances. Nothing is filtered. At
discount 1 every state has a chance to end whatever is done (the last state is absorbing
with reward 0), so that the infinite sum exists for every policy. Hypothesis prints what
is drawn as code of ``np`` and ``oee`` that evaluates to it.

Needs hypothesis: ``pip install '.[testing]'``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy, uniform_policy
from oee_tabular.testing.code import as_code
from oee_tabular.typing import Array, IntArray, PolicyLike

try:
    from hypothesis import strategies as st
    from hypothesis.vendor import pretty
except ImportError as error:  # pragma: no cover (tested in a process without it)
    raise ImportError(
        "oee_tabular.testing.strategies needs hypothesis, which is not installed; in a"
        " clone: pip install '.[testing]'"
    ) from error

# of which probabilities are made; the first is what they shrink to
WEIGHTS = (1, 0, 2, 0, 0, 5)
REWARDS: tuple[Literal["s", "sa", "sas"], ...] = ("s", "sa", "sas")
KINDS = ("episodes", "transitions")
SUPPORTS = ("equal", "inside", "violated")


@suggest_keywords
def mdps(
    *,
    min_states: int = 1,
    max_states: int = 5,
    max_actions: int = 3,
    discounts: Sequence[float] = (0.0, 0.5, 0.9, 1.0),
    rewards: Sequence[Literal["s", "sa", "sas"]] = REWARDS,
    absorbing: bool | None = None,
    allow_unavailable: bool = False,
) -> st.SearchStrategy[FiniteMDP]:
    """Draw small finite MDPs with probabilities that are easy to read.

    Parameters
    ----------
    min_states : int, default 1
        Least number of states, from 1.
    max_states : int, default 5
        Largest number of states.
    max_actions : int, default 3
        Largest number of actions.
    discounts : sequence of float, default (0.0, 0.5, 0.9, 1.0)
        Discounts to draw from.
    rewards : sequence of {"s", "sa", "sas"}
        Forms of rewards to draw from: r(s), r(s, a), or r(s, a, s'), which is defined
        for every s'.
    absorbing : bool, optional
        Whether the last state is absorbing with reward 0; None means either. At
        discount 1 it always is, and every row reaches it with positive probability.
    allow_unavailable : bool, default False
        Whether there may be actions that cannot be taken in a state
        (``FiniteMDP.available``).

    Returns
    -------
    hypothesis.strategies.SearchStrategy
        Draws a ``FiniteMDP``.

    Raises
    ------
    ValueError
        If sizes are below 1 or in the wrong order, a discount is outside [0, 1], or a
        form is unknown.

    See Also
    --------
    mdp_pairs : Draws a simulator and a target.

    Examples
    --------
    >>> from hypothesis import given, settings
    >>> @settings(max_examples=10)
    ... @given(mdps(max_states=3))
    ... def law(mdp):
    ...     assert (
    ...         mdp.n_states <= 3 and abs(mdp.transitions.sum(axis=1) - 1).max() < 1e-12
    ...     )
    >>> law()
    """
    low, high = (
        _checks.positive_integer(n, f"{end}_states")
        for n, end in ((min_states, "min"), (max_states, "max"))
    )
    if low > high:
        raise ArgumentError(
            "min_states", f"must be at most max_states; they are {low} and {high}"
        )
    _checks.boolean(allow_unavailable, "allow_unavailable")
    most_actions = _checks.positive_integer(max_actions, "max_actions")
    discounts = _checks.collection(discounts, "discounts", "a list of numbers")
    rewards = _checks.collection(rewards, "rewards", "a list of words")
    for name, values in (("discounts", discounts), ("rewards", rewards)):
        if not values:
            raise ArgumentError(name, "must hold at least one; it is empty")
    factors = [_checks.number_in(value, "discounts", 0.0, 1.0) for value in discounts]
    for form in rewards:
        _checks.one_of(form, "rewards", REWARDS)

    @st.composite
    def draw_mdp(draw: st.DrawFn) -> FiniteMDP:
        n = draw(st.integers(low, high))
        a = draw(st.integers(1, most_actions))
        discount = draw(st.sampled_from(factors))
        does_end = (
            draw(st.booleans() if absorbing is None else st.just(absorbing))
            or discount == 1.0
        )
        row = _rows(n, [n - 1] if discount == 1.0 else [])
        transitions = np.array([[draw(row) for _ in range(a)] for _ in range(n)])
        shape = (n, a, n)[: len(draw(st.sampled_from(rewards)))]
        size = int(np.prod(shape))
        table = np.reshape(
            draw(st.lists(st.integers(-5, 5), min_size=size, max_size=size)), shape
        )
        if does_end:
            transitions[-1] = np.eye(n)[-1]
            table[-1] = 0
        initial = draw(_rows(n))
        available = np.ones((n, a), dtype=np.bool_)
        if allow_unavailable:
            flags = st.lists(st.booleans(), min_size=n * a, max_size=n * a)
            available[np.reshape(draw(flags), (n, a))] = False
            # an action is left in each state
            kept = draw(st.lists(st.integers(0, a - 1), min_size=n, max_size=n))
            available[np.arange(n), kept] = True
            transitions[~available] = 0.0
        return FiniteMDP(transitions, table, initial, discount, available=available)

    return draw_mdp()


@suggest_keywords
def policies(mdp: FiniteMDP, *, zeros: bool = True) -> st.SearchStrategy[Array]:
    """Draw policies of an MDP.

    Parameters
    ----------
    mdp : FiniteMDP
        The model whose states and actions they have.
    zeros : bool, default True
        False gives every action a chance in every state where it can be taken.

    Returns
    -------
    hypothesis.strategies.SearchStrategy
        Draws an array of shape (S, A) whose rows sum to 1.

    Examples
    --------
    >>> from hypothesis import given, settings
    >>> coin = FiniteMDP([[[0.5, 0.5], [0.9, 0.1]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> @settings(max_examples=10)
    ... @given(policies(coin, zeros=False))
    ... def law(policy):
    ...     assert policy.shape == (2, 2) and policy.min() > 0
    >>> law()
    """
    _checks.boolean(zeros, "zeros")
    model = _checks.instance(mdp, FiniteMDP, "mdp")

    @st.composite
    def draw_rows(draw: st.DrawFn) -> list[list[float]]:
        rows = np.zeros(model.rewards.shape)
        for chances, can in zip(rows, model.available, strict=True):
            number = int(np.count_nonzero(can))
            chances[can] = draw(_rows(number, [] if zeros else range(number)))
        return [list(map(float, chances)) for chances in rows]

    return draw_rows().map(_array)


@suggest_keywords
def mdp_pairs(
    *,
    support: Literal["equal", "inside", "violated"] = "equal",
    min_states: int | None = None,
    max_states: int = 5,
    max_actions: int = 3,
    discounts: Sequence[float] = (0.0, 0.5, 0.9, 1.0),
    rewards: Sequence[Literal["s", "sa", "sas"]] = REWARDS,
    absorbing: bool | None = None,
) -> st.SearchStrategy[tuple[FiniteMDP, FiniteMDP]]:
    """Draw pairs (simulator, target) that differ in their transitions alone.

    Parameters
    ----------
    support : {"equal", "inside", "violated"}, default "equal"
        With "equal" target and simulator have one support. With "inside" the target's
        lies in the simulator's, so that a ratio exists. With "violated" some action, in
        some state that an episode may begin in, takes the target to where the simulator
        has probability 0.
    min_states : int, optional
        Least number of states; None means 1, and 2 for "violated".
    max_states : int, default 5
        Largest number of states.
    max_actions : int, default 3
        Largest number of actions.
    discounts : sequence of float, default (0.0, 0.5, 0.9, 1.0)
        Discounts to draw from.
    rewards : sequence of {"s", "sa", "sas"}
        Forms of rewards to draw from, as in ``mdps``.
    absorbing : bool, optional
        Whether the last state is absorbing, as in ``mdps``.

    Returns
    -------
    hypothesis.strategies.SearchStrategy
        Draws a pair of ``FiniteMDP``.

    Raises
    ------
    ValueError
        If ``mdps`` raises one, or the support is unknown.

    See Also
    --------
    mdps : Draws a single model.

    Examples
    --------
    >>> from hypothesis import given, settings
    >>> @settings(max_examples=10)
    ... @given(mdp_pairs(support="inside", max_states=2))
    ... def law(pair):
    ...     assert not ((pair[1].transitions > 0) > (pair[0].transitions > 0)).nnz
    >>> law()
    """
    _checks.one_of(support, "support", SUPPORTS)
    if min_states is None:
        min_states = 2 if support == "violated" else 1
    if support == "violated" and _checks.positive_integer(min_states, "min_states") < 2:
        raise ArgumentError(
            "min_states", "must be at least 2 for support 'violated'; it is 1"
        )
    simulators = mdps(
        min_states=min_states,
        max_states=max_states,
        max_actions=max_actions,
        discounts=discounts,
        rewards=rewards,
        absorbing=absorbing,
    )

    @st.composite
    def draw_pair(draw: st.DrawFn) -> tuple[FiniteMDP, FiniteMDP]:
        simulator = draw(simulators)
        n = simulator.n_states
        a = simulator.n_actions
        # where every row must be able to end
        last = [n - 1] if simulator.discount == 1.0 else []
        matrix = simulator.transitions.toarray()
        # the simulator has no chance of a transition that the target makes
        if support == "violated":
            start, action, to = (
                draw(st.integers(0, most)) for most in (n - 2, a - 1, n - 2)
            )
            row = start * a + action
            initial = simulator.initial
            matrix[row] = np.insert(draw(_rows(n - 1, [k - 1 for k in last])), to, 0.0)
            if initial[start] == 0.0:
                initial = (initial + np.eye(n)[start]) / 2.0
            simulator = simulator.with_transitions(
                matrix.reshape(n, a, n)
            ).with_initial(initial)
            matrix[row] = draw(_rows(n, [*last, to]))
        else:
            for chances in matrix:
                where = np.flatnonzero(chances)
                certain = where if support == "equal" else last
                chances[where] = draw(
                    _rows(len(where), np.flatnonzero(np.isin(where, certain)))
                )
        return simulator, simulator.with_transitions(matrix.reshape(n, a, n))

    return draw_pair()


@suggest_keywords
def horizons(mdp: FiniteMDP, *, max_horizon: int = 6) -> st.SearchStrategy[int | None]:
    """Draw horizons from 1, and None where the infinite sum exists.

    Parameters
    ----------
    mdp : FiniteMDP
        None is drawn where the infinite sum exists for every policy of it: at a
        discount below 1, and for all that ``mdps`` draws.
    max_horizon : int, default 6
        The largest horizon.

    Returns
    -------
    hypothesis.strategies.SearchStrategy
        Draws an int or None.

    Examples
    --------
    >>> from hypothesis import given, settings
    >>> @settings(max_examples=10)
    ... @given(horizons(FiniteMDP([[[1.0]]], [1.0], [1.0], 0.9), max_horizon=3))
    ... def law(horizon):
    ...     assert horizon is None or 1 <= horizon <= 3
    >>> law()
    """
    model = _checks.instance(mdp, FiniteMDP, "mdp")
    finite = st.integers(1, _checks.positive_integer(max_horizon, "max_horizon"))
    ended = model.absorbing()
    ends_anyhow = bool(
        ended.any() and (model.transitions[:, ended].sum(axis=1) > 0).all()
    )
    return st.none() | finite if model.discount < 1.0 or ends_anyhow else finite


@suggest_keywords
def logs(
    mdp: FiniteMDP,
    *,
    kind: Literal["episodes", "transitions"] | None = "episodes",
    behavior_policy: PolicyLike | None = None,
    max_episodes: int = 4,
    max_steps: int = 5,
    rewards: bool = True,
) -> st.SearchStrategy[Transitions]:
    """Draw logs of an MDP, of any transitions that it can make.

    Parameters
    ----------
    mdp : FiniteMDP
        The model that makes the transitions.
    kind : {"episodes", "transitions"} or None, default "episodes"
        With "episodes" a log has ragged episodes from the initial distribution's
        support, terminated on arrival in an absorbing state and truncated otherwise.
        With "transitions" it is a bag of transitions from anywhere. None means either.
    behavior_policy : PolicyLike, optional
        The policy whose actions are taken and whose probabilities are recorded; None
        means the uniform one.
    max_episodes : int, default 4
        Largest number of episodes, from 1.
    max_steps : int, default 5
        Largest number of transitions of an episode, from 1; a bag has at most
        max_episodes * max_steps rows.
    rewards : bool, default True
        Whether rewards are recorded.

    Returns
    -------
    hypothesis.strategies.SearchStrategy
        Draws a ``Transitions``.

    Raises
    ------
    ValueError
        If a size is below 1, or the kind is unknown.

    Examples
    --------
    >>> from hypothesis import given, settings
    >>> coin = FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> @settings(max_examples=10)
    ... @given(logs(coin, max_episodes=3))
    ... def law(log):
    ...     assert 1 <= log.n_episodes <= 3 and (log.reward == log.state).all()
    >>> law()
    """
    _checks.boolean(rewards, "rewards")
    model = _checks.instance(mdp, FiniteMDP, "mdp")
    if kind is not None:
        _checks.one_of(kind, "kind", KINDS)
    behavior = uniform_policy(model)
    if behavior_policy is not None:
        behavior = check_policy(behavior_policy, model, name="behavior_policy")
    n = _checks.positive_integer(max_episodes, "max_episodes")
    steps = _checks.positive_integer(max_steps, "max_steps")
    ended = model.absorbing()

    @st.composite
    def draw_log(draw: st.DrawFn) -> Transitions:
        kinds = KINDS if kind is None else (kind,)
        is_bag = draw(st.sampled_from(kinds)) == "transitions"
        starts = np.arange(model.n_states)
        if not is_bag:
            starts = np.flatnonzero(model.initial)
        made = []
        for k in range(draw(st.integers(1, n * steps if is_bag else n))):
            state = draw(st.sampled_from(starts.tolist()))
            length = 1 if is_bag else draw(st.integers(1, steps))
            path = _draw_path(draw, model, behavior, state, length)
            made += [(*step, k) for step in path]
        states, actions, next_states, episode = np.array(made).T
        columns = {"behavior_probability": behavior[states, actions]}
        if rewards:
            columns["reward"] = _rewards_of(model, states, actions, next_states)
        if not is_bag:
            columns |= {"episode": episode, "terminated": ended[next_states]}
        return Transitions(states, actions, next_states, **columns)

    return draw_log()


def _draw_path(
    draw: st.DrawFn, model: FiniteMDP, behavior: Array, state: int, length: int
) -> list[tuple[int, int, int]]:
    """Draw at most ``length`` steps s, a, s' from a state, until an absorbing one."""
    ended = model.absorbing()
    path = []
    for _ in range(length):
        action = draw(st.sampled_from(np.flatnonzero(behavior[state]).tolist()))
        row = model.transitions[[state * model.n_actions + action]]
        next_state = draw(st.sampled_from(row.indices.tolist()))
        path.append((state, action, next_state))
        state = next_state
        if ended[state]:
            break
    return path


def _array(rows: list[list[float]]) -> Array:
    """Return rows as an array; Hypothesis prints the call by the function's name."""
    return np.array(rows)


_array.__name__ = "np.array"


def _print_as_code(
    value: object, printer: pretty.RepresentationPrinter, is_cycle: bool
) -> None:
    """Print an example of Hypothesis as code, or as usual if it is large."""
    try:
        text = as_code(value)
    except ArgumentError:
        text = repr(value)
    for k, line in enumerate(text.split("\n")):
        if k:
            printer.break_()
        printer.text(line)


for _kind in (FiniteMDP, Transitions):
    pretty.for_type_by_name(_kind.__module__, _kind.__name__, _print_as_code)


def _rewards_of(
    model: FiniteMDP, states: IntArray, actions: IntArray, next_states: IntArray
) -> Array:
    """Return the reward of each transition."""
    if model.transition_rewards is None:
        return np.asarray(model.rewards[states, actions])
    rows = states * model.n_actions + actions
    return np.asarray(model.transition_rewards.toarray()[rows, next_states])


def _rows(size: int, certain: Iterable[int] = ()) -> st.SearchStrategy[Array]:
    """Draw distributions of small weights; the entries in ``certain`` are positive."""

    def normalize(drawn: list[int]) -> Array:
        weights = np.array(drawn, dtype=np.float64)
        weights[list(certain)] += 1.0
        weights[0] += weights.sum() == 0.0
        return np.asarray(weights / weights.sum())

    return st.lists(st.sampled_from(WEIGHTS), min_size=size, max_size=size).map(
        normalize
    )
