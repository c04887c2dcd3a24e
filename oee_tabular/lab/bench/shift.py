"""Families of two models that differ in the parameters of their transitions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Any, TypedDict, Unpack

import numpy as np
from scipy import sparse

from oee_tabular._sparse import csr_on_pattern, row_of_entry
from oee_tabular.exact import optimal_policy
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import normalize, scale_rows
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.typing import Array

Moves = Iterable[tuple[Any, Any]]  # (probability, next state)
Maker = Callable[..., Family]  # of a generator, or without parameters


class PairOptions(TypedDict, total=False):
    """Keywords of ``pair`` that makers of families pass on."""

    optimal: float
    recorded: float
    length: int
    policy: Array | None
    horizon: int | None


def pair(
    about: str,
    simulator: FiniteMDP,
    target: Any,
    *,
    optimal: float = 0.9,
    recorded: float = 0.5,
    length: int = 200,
    policy: Array | None = None,
    horizon: int | None = None,
) -> Family:
    """Make a family whose policy is a mixture of the simulator's optimum and uniform.

    Parameters
    ----------
    about : str
        One sentence that says what the simulator has wrong.
    simulator : FiniteMDP
        The model that estimators are given.
    target : FiniteMDP, or its transitions
        Transitions alone get the simulator's rewards.
    optimal : float, default 0.9
        The share of the optimum in the policy.
    recorded : float, default 0.5
        The share of the policy in what records the target; the rest is uniform.
    length : int, default 200
        Number of steps after which a recorded episode is cut, without a horizon.
    policy : ndarray of shape (S, A), optional
        The policy in place of the mixture.
    horizon : int, optional
        Number of rewards of the value; None means the infinite discounted sum.
    """
    if not isinstance(target, FiniteMDP):
        target = simulator.with_transitions(target)
    uniform = uniform_policy(simulator)
    if policy is None:
        policy = mix(optimal_policy(simulator), uniform, optimal)
    return Family(
        simulator,
        target,
        policy,
        mix(policy, uniform, recorded),
        about,
        horizon=horizon,
        length=horizon or length,
    )


def shift(
    about: str,
    shape: tuple[int, ...],
    rewards: Any,
    discount: float,
    believed: Any,
    real: Any,
    moves: Callable[..., Moves],
    *,
    start: Any = slice(None),
    ends: Collection[int] = (),
    **options: Unpack[PairOptions],
) -> Maker:
    """Return a maker of a family of two models that differ in some parameters.

    Parameters
    ----------
    about : str
        One sentence that says what the simulator has wrong.
    shape : tuple of int
        The numbers (S, A) of states and actions.
    rewards : array or callable
        As of ``FiniteMDP``, or a function of s, a and the next state: r(s, a, s') on
        the support.
    discount : float
        The discount of both models.
    believed, real : tuple, or callable for ``real``
        The simulator's and the target's parameters; ``real`` may be a function that
        draws them from a generator.
    moves : callable
        Function of the states s (S, 1, 1), the actions a (1, A, 1) and the parameters
        that gives pairs (probability, next state), each broadcast to (S, A, K), K
        possible next states at once. Equal ones are added up, and what lies beyond the
        first or last state is that state.
    start : index of states, optional
        States in which episodes begin, with equal probability; all by default.
    ends : collection of int, optional
        Terminal states.
    **options
        As in ``pair``.
    """
    initial = np.zeros(shape[0])
    initial[start] = 1.0

    def model(parameters: Any) -> FiniteMDP:
        """Return the model with these parameters."""
        transitions = tabulate(moves, parameters, shape, ends)
        paid = rewards
        if callable(rewards):
            paid = reward_entries(rewards, transitions, shape[1])
        return FiniteMDP(transitions, paid, normalize(initial), discount)

    def build(parameters: Any) -> Family:
        """Return the family of a target with these parameters."""
        return pair(about, model(believed), model(parameters), **options)

    if callable(real):
        return lambda rng: build(real(rng))
    return lambda: build(real)


def tabulate(
    moves: Callable[..., Moves],
    parameters: Any,
    shape: tuple[int, ...],
    ends: Collection[int],
) -> sparse.csr_array:
    """Tabulate the transitions of ``moves``, (S * A, S); terminal states stay."""
    n_states, n_actions = shape
    s, a = np.ogrid[:n_states, :n_actions, :1][:2]
    is_over = np.isin(s, list(ends))
    parts = [
        (is_over, s),
        *((np.where(is_over, 0.0, p), to) for p, to in moves(s, a, *parameters)),
    ]
    entries = [
        np.broadcast_arrays(p, np.clip(to, 0, n_states - 1), s * n_actions + a)
        for p, to in parts
    ]
    data, columns, rows = (
        np.concatenate(arrays, axis=2) for arrays in zip(*entries, strict=True)
    )
    present = data > 0
    where = (rows[present], columns[present])
    return scale_rows(
        sparse.csr_array((data[present], where), (n_states * n_actions, n_states))
    )


def reward_entries(
    rewards: Callable[..., Any], transitions: sparse.csr_array, n_actions: int
) -> sparse.csr_array:
    """Return r(s, a, s') of a function of s, a and s', on the transitions' support."""
    values = rewards(
        *np.divmod(row_of_entry(transitions), n_actions),
        transitions.indices.astype(int),
    )
    return csr_on_pattern(transitions, np.asarray(values, dtype=np.float64))
