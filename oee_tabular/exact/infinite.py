"""Infinite-horizon values: the policy's kernel from its rows in one compiled pass, and the linear system that it makes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csgraph

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import row_of_entry, row_sums
from oee_tabular.exact.certified import solve_certified
from oee_tabular.exact.finite import expected
from oee_tabular.exact.linear import DivergentKernelError, exponent, inverse_norm, scaled_back, solve_system
from oee_tabular.exact.reweighted import Model
from oee_tabular.exact.systems import TINY, System, readable, unsigned

Found = tuple[
    Array, float, float, str, float | None
]  # V, J, the bound on the error of V, the method, what is certified


def infinite_values(model: Model, policy: Array, certify: bool) -> Found:
    """V of the infinite sum; the bound on its error counts the rounding of the policy's kernel and rewards.

    Rewards that are so small or large that their products leave the range of floats are first scaled by a power of two.
    """
    shift = exponent(model.rewards)
    if shift == 0:
        return _values(model, 0, policy, certify)
    values, value, bound, method, certified = _values(model, shift, policy, certify)
    values, bound, certified = scaled_back(values, bound, certified, shift)
    with np.errstate(over="ignore", under="ignore"):
        return values, float(np.ldexp(value, shift)), bound, method, certified


def _values(model: Model, shift: int, policy: Array, certify: bool) -> Found:
    """The same for the rewards over 2^shift, which are of ordinary size."""
    policy, paid = readable(np.ascontiguousarray(policy)), _scaled(model.rewards, shift)
    if model.n_states <= TINY and model.discount < 1.0 and not certify:
        values, bound = _tiny(model, paid, policy)
        if np.isfinite(bound):
            return values, expected(model, policy, values), bound, "dense LU", None
    from oee_tabular.exact import _policy_rows as policy_rows
    from oee_tabular.exact import _twofold as twofold

    indptr, columns, data = (readable(part) for part in kernel_parts(model, policy, False))
    rewards, largest = policy_rows.average_rewards(policy, paid)
    system = System(indptr, columns, data, model.discount, formed=model.n_actions)
    recurrent = _recurrent(system, rewards) if model.discount == 1.0 else None
    if recurrent is not None:
        if recurrent.all():
            return np.zeros(len(rewards)), 0.0, 0.0, "absorbed", 1.0 if certify else None
        inner = np.where(np.repeat(recurrent, np.diff(indptr.astype(np.int64))), 0.0, data)
        system = System(indptr, columns, readable(inner), 1.0, formed=model.n_actions)
    if not certify:
        solution = solve_system(system, rewards, (model.n_actions + 1) * np.finfo(float).eps * largest)
        return solution.x, expected(model, policy, solution.x), solution.error_bound, solution.method, None
    rows = model.transitions
    given = unsigned(rows.indptr), unsigned(rows.indices), readable(rows.data), policy
    lost, widest = np.zeros_like(paid), 0
    if model.reward_data is not None:  # r(s, a) = sum P r(s, a, s') was rounded
        lost, size = twofold.expected_rest(given[0], given[2], _scaled(model.reward_data, shift), paid)
        widest, largest = int(np.diff(rows.indptr).max()), max(largest, size)
    low, high_pay, low_pay = twofold.average_rest(*given, paid, lost, indptr, columns, data)
    if recurrent is not None:
        low[np.repeat(recurrent, np.diff(indptr.astype(np.int64)))] = 0.0
    slack = (0.5 * np.finfo(float).eps * (model.n_actions + widest + 8)) ** 2 * largest
    found = solve_certified(system, low, readable(high_pay), low_pay, inverse_norm(system), slack)
    value = twofold.dot(model.initial, found.high, found.low)
    return found.high, float(value), found.error_bound, found.method, found.certified


def _scaled(numbers: Array, shift: int) -> Array:
    scaled: Array = readable(np.ascontiguousarray(np.ldexp(numbers, -shift) if shift else numbers))
    return scaled


def _tiny(model: Model, paid: Array, policy: Array) -> tuple[Array, float]:
    """V and a bound on its error from one compiled call, nan where there is no sum."""
    from oee_tabular.exact.solvers._elimination import small_value

    rows = model.transitions
    parts = unsigned(rows.indptr), unsigned(rows.indices), readable(rows.data), policy
    found: tuple[Array, float] = small_value(*parts, paid, model.discount)
    return found


def kernel_parts(model: Model, policy: Array, ordered: bool) -> tuple[Any, Any, Array]:
    """Row pointers, columns and values of sum_a policy[s, a] K(s' | s, a), with unsigned indices."""
    from oee_tabular.exact._policy_rows import average_rows

    rows = model.transitions
    columns, values = np.empty(rows.nnz, dtype=np.uint32), np.empty(rows.nnz)  # only what is filled becomes memory
    policy = readable(np.ascontiguousarray(policy, dtype=np.float64))
    indptr = average_rows(
        unsigned(rows.indptr), unsigned(rows.indices), readable(rows.data), policy, columns, values, ordered
    )
    return indptr, columns[: indptr[-1]], values[: indptr[-1]]


def _recurrent(system: System, rewards: Array) -> BoolArray:
    """(S,) mask of the closed classes at discount 1, which must pay nothing; the other states are solved for."""
    kernel = system.kernel()
    _, component = csgraph.connected_components(kernel, directed=True, connection="strong")
    rows = row_of_entry(kernel)
    crossing = (kernel.data > 0) & (component[rows] != component[kernel.indices])
    closed = np.ones(component.max() + 1, dtype=np.bool_)
    closed[component[rows[crossing]]] = False
    closed[component[row_sums(kernel) < 1.0 - 2.0 * _checks.SUM_TOLERANCE]] = False  # a kernel may lose mass
    recurrent = np.asarray(closed[component])
    paying: IntArray = np.flatnonzero(recurrent & (rewards != 0.0))
    if paying.size:
        raise DivergentKernelError(
            "horizon must be given: at discount 1 the infinite sum exists only where the policy is absorbed in states "
            f"that pay nothing; it stays for ever in {paying.size} states that do, the first: {paying[0]} "
            f"(reward {rewards[paying[0]]:g})"
        )
    return recurrent
