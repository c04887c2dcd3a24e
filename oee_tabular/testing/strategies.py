"""Hypothesis strategies of finite MDPs, policies, pairs of environments, horizons and
logs.

Everything is made of small integers: probabilities are small weights over their sum,
with exact zeros and many ties; rewards are integers from -5 to 5. Examples shrink
towards one state, one action, discount 0 and even chances. Nothing is filtered. At
discount 1 every state has a chance to end whatever is done (the last state is absorbing
with reward 0), so that the infinite sum exists for every policy.

Needs hypothesis: ``pip install '.[testing]'``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.typing import Array, PolicyLike

try:
    from hypothesis import strategies as st
except ImportError as error:  # pragma: no cover (tested in a process without it)
    raise ImportError(
        "oee_tabular.testing.strategies needs hypothesis, which is not installed; in a"
        " clone: pip install '.[testing]'"
    ) from error

# of which probabilities are made; the first is what they shrink to
WEIGHTS = (1, 0, 2, 0, 0, 5)
REWARDS = ("s", "sa", "sas")
KINDS = ("episodes", "transitions")
SUPPORTS = ("equal", "inside", "violated")


@suggest_keywords
def mdps(
    *,
    min_states: int = 1,
    max_states: int = 5,
    max_actions: int = 3,
    discounts: Sequence[float] = (0.0, 0.5, 0.9, 1.0),
    rewards: Sequence[str] = REWARDS,
    absorbing: bool | None = None,
) -> st.SearchStrategy[FiniteMDP]:
    """Finite MDPs.

    Parameters
    ----------
    min_states, max_states, max_actions : sizes, from 1
    discounts : to draw from
    rewards : forms to draw from: "s", "sa", "sas" for r(s), r(s, a), r(s, a, s')
        (defined for every s')
    absorbing : whether the last state is absorbing with reward 0; None: either. At
        discount 1 it always is, and every row reaches it with positive probability

    Raises
    ------
    ValueError
        Sizes below 1 or in the wrong order, discounts outside [0, 1], unknown forms.

    Examples
    --------
    >>> from hypothesis import given, settings
    >>> @settings(max_examples=10)
    ... @given(mdps(max_states=3))
    ... def law(mdp):
    ...     assert mdp.n_states <= 3 and abs(mdp.transitions.sum(axis=1) - 1).max() < 1e-12
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
    most_actions = _checks.positive_integer(max_actions, "max_actions")
    for name, values in (("discounts", discounts), ("rewards", rewards)):
        if not len(values):
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
        return FiniteMDP(transitions, table, draw(_rows(n)), discount)

    return draw_mdp()


@suggest_keywords
def policies(mdp: FiniteMDP, *, zeros: bool = True) -> st.SearchStrategy[Array]:
    """(S, A) policies of an MDP.

    Parameters
    ----------
    mdp : FiniteMDP
    zeros : False: every action has a chance in every state

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
    rows = _rows(model.n_actions, [] if zeros else range(model.n_actions))
    return st.lists(rows, min_size=model.n_states, max_size=model.n_states).map(
        np.array
    )


def mdp_pairs(
    *, support: Literal["equal", "inside", "violated"] = "equal", **options: Any
) -> st.SearchStrategy[tuple[FiniteMDP, FiniteMDP]]:
    """Pairs (simulator, target) that differ in their transitions alone.

    Parameters
    ----------
    support : "equal": target and simulator have one support; "inside": the target's
        lies in the simulator's (a ratio exists); "violated": from some state that an
        episode may begin in, some action takes the target to where the simulator has
        probability 0
    options : as in ``mdps``; for "violated" at least 2 states

    Raises
    ------
    ValueError
        As ``mdps``; an unknown support.

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
    if support == "violated":
        options = {"min_states": 2} | options
        if _checks.positive_integer(options["min_states"], "min_states") < 2:
            raise ArgumentError(
                "min_states", "must be at least 2 for support 'violated'; it is 1"
            )
    simulators = mdps(**options)

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
    """Horizons from 1, and None where the infinite sum exists for every policy
    (discount below 1, or all of ``mdps``).

    Parameters
    ----------
    mdp : FiniteMDP
    max_horizon : the largest, a positive int

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
    """Logs of ``mdp``: any transitions that it can make, whatever their probability.

    Parameters
    ----------
    mdp : FiniteMDP
    kind : "episodes": ragged, from the initial distribution's support, terminated on
        arrival in an absorbing state, truncated otherwise; "transitions": a bag of
        transitions from anywhere; None: either
    behavior_policy : (S, A) whose actions are taken and whose probabilities are
        recorded; None: uniform
    max_episodes, max_steps : sizes, from 1 (a bag has at most their product of rows)
    rewards : whether rewards are recorded

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
    even = np.full((model.n_states, model.n_actions), 1.0 / model.n_actions)
    behavior = (
        even
        if behavior_policy is None
        else check_policy(behavior_policy, model, name="behavior_policy")
    )
    n = _checks.positive_integer(max_episodes, "max_episodes")
    steps = _checks.positive_integer(max_steps, "max_steps")
    ended = model.absorbing()

    @st.composite
    def draw_log(draw: st.DrawFn) -> Transitions:
        is_bag = (
            draw(st.sampled_from(KINDS) if kind is None else st.just(kind))
            == "transitions"
        )
        starts = (
            list(range(model.n_states))
            if is_bag
            else np.flatnonzero(model.initial).tolist()
        )
        made = []
        for k in range(draw(st.integers(1, n * steps if is_bag else n))):
            state = draw(st.sampled_from(starts))
            for _ in range(1 if is_bag else draw(st.integers(1, steps))):
                action = draw(st.sampled_from(np.flatnonzero(behavior[state]).tolist()))
                row = model.transitions[[state * model.n_actions + action]]
                next_state = draw(st.sampled_from(row.indices.tolist()))
                made.append((state, action, next_state, k))
                state = next_state
                if ended[state]:
                    break
        states, actions, next_states, episode = np.array(made).T
        reward = model.rewards[states, actions]
        if model.transition_rewards is not None:
            reward = model.transition_rewards.toarray()[
                states * model.n_actions + actions, next_states
            ]
        columns = {"behavior_probability": behavior[states, actions]} | (
            {"reward": reward} if rewards else {}
        )
        if not is_bag:
            columns |= {"episode": episode, "terminated": ended[next_states]}
        return Transitions(states, actions, next_states, **columns)

    return draw_log()


def _rows(size: int, certain: Iterable[int] = ()) -> st.SearchStrategy[Array]:
    """Distributions of small weights; the entries in ``certain`` are positive."""

    def normalize(drawn: list[int]) -> Array:
        weights = np.array(drawn, dtype=np.float64)
        weights[list(certain)] += 1.0
        weights[0] += weights.sum() == 0.0
        return np.asarray(weights / weights.sum())

    return st.lists(st.sampled_from(WEIGHTS), min_size=size, max_size=size).map(
        normalize
    )
