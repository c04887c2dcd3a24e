"""What the families are made of: models from lists of moves, policies, changes of rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, Literal

import numpy as np
from scipy import sparse, stats

from oee_tabular._checks import Array
from oee_tabular._sparse import row_of_entry, row_sums
from oee_tabular.bench.family import Family
from oee_tabular.exact import optimal_policy
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy

Moves = Iterator[tuple[float, int]]
Recorded = Literal["uniform", "half", "policy"]
RECORDED_BY: dict[str, float] = {"uniform": 0.0, "half": 0.5, "policy": 0.9}  # the policy's share; the rest is uniform


def pair(
    simulator: FiniteMDP,
    target: FiniteMDP | object,
    about: str,
    *,
    optimal: float = 0.9,
    recorded: Recorded = "half",
    length: int = 200,
    policy: Array | None = None,
) -> Family:
    """A family whose policy is the simulator's optimum, ``optimal`` of it, the rest uniform; ``recorded`` by a share of it.

    Parameters
    ----------
    simulator : FiniteMDP
    target : FiniteMDP, or its transitions (then with the simulator's rewards)
    about, length, policy : as in ``Family``; a policy is used instead of the optimum
    optimal : the share of the optimum in the policy
    recorded : "uniform", "half" of the policy, or "policy" (90% of it); the rest uniform
    """
    if not isinstance(target, FiniteMDP):
        target = simulator.with_transitions(target)
    uniform = uniform_policy(simulator)
    pi = mix(optimal_policy(simulator), uniform, optimal) if policy is None else policy
    return Family(simulator, target, pi, mix(pi, uniform, RECORDED_BY[recorded]), about, length=length)


def shifted(
    moves: Callable[..., Moves],
    shape: tuple[int, int],
    pay: object,
    discount: float,
    believed: tuple[float, ...],
    real: tuple[float, ...],
    about: str,
    *,
    start: object = None,
    **options: Any,
) -> Family:
    """A family of two models of the same ``moves``, with the parameters that the simulator believes and with the real ones.

    Parameters
    ----------
    moves, shape, pay, discount, start : as in ``model``; about, options : as in ``pair``
    """
    simulator, target = (model(moves, shape, pay, discount, how, start=start) for how in (believed, real))
    return pair(simulator, target, about, **options)


def model(
    moves: Callable[..., Moves],
    shape: tuple[int, int],
    pay: object,
    discount: float,
    how: tuple[float, ...],
    *,
    start: object,
) -> FiniteMDP:
    """The MDP of moves with the parameters ``how``.

    Parameters
    ----------
    moves : (s, a, *how) -> (probability, next state), one after the other; equal next states are added up
    shape : (S, A)
    pay : rewards as of ``FiniteMDP``, or a function of the arrays s, a, s'
    start : states in which episodes begin, evenly; None: all
    """
    n_states, n_actions = shape
    entries = [
        (s * n_actions + a, to, probability)
        for s in range(n_states)
        for a in range(n_actions)
        for probability, to in moves(s, a, *how)
        if probability > 0
    ]
    rows, columns, data = (np.array(column) for column in zip(*entries, strict=True))
    matrix = sparse.csr_array((data, (rows, columns)), shape=(n_states * n_actions, n_states))
    matrix.sum_duplicates()
    transitions = scaled(matrix)
    rewards = paid_on(transitions, pay, n_actions) if callable(pay) else pay
    return FiniteMDP(transitions, rewards, spread(n_states, range(n_states) if start is None else start), discount)


def paid_on(transitions: sparse.csr_array, paid: Callable[[Any, Any, Any], Any], n_actions: int) -> sparse.csr_array:
    """r(s, a, s') on the moves of ``transitions``; ``paid`` takes and gives arrays."""
    state, action = np.divmod(row_of_entry(transitions), n_actions)
    rewards = np.asarray(paid(state, action, transitions.indices.astype(np.int64)), dtype=np.float64)
    return sparse.csr_array((rewards, transitions.indices, transitions.indptr), transitions.shape)


def scaled(matrix: sparse.csr_array) -> sparse.csr_array:
    """Rows that sum to 1."""
    return sparse.csr_array(
        (matrix.data / row_sums(matrix)[row_of_entry(matrix)], matrix.indices, matrix.indptr), matrix.shape
    )


def poisson(mean: float, largest: int) -> Array:
    """Pr(N = 0), ..., Pr(N = largest), the last one Pr(N >= largest)."""
    found = np.empty(largest + 1)
    found[:largest] = stats.poisson.pmf(np.arange(largest), mean)
    found[largest] = stats.poisson.sf(largest - 1, mean)
    return found


def binomial(n: int, probability: float) -> Array:
    """Pr(N = 0), ..., Pr(N = n)."""
    return np.array([math.comb(n, k) * probability**k * (1.0 - probability) ** (n - k) for k in range(n + 1)])


def spread(n_states: int, states: Any) -> Array:
    """The uniform distribution over these states, (S,)."""
    found = np.zeros(n_states)
    found[states] = 1.0
    return np.asarray(found / found.sum())
