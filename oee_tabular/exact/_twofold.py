"""Sums and products with their rounding errors kept beside them: residuals of linear systems to twice the precision.

A number is a pair (high, low), not evaluated. Error-free transformations of [1], the compensated dot product of [2].

References: [1] Dekker, A floating-point technique for extending the available precision, Numer. Math. 18 (1971).
[2] Ogita, Rump and Oishi, Accurate sum and dot product, SIAM J. Sci. Comput. 26 (2005).
"""

import numpy as np
from numba import njit
from numba.core import types
from numba.extending import intrinsic


@intrinsic
def fused(typing, a, b, c):
    """A * b + c with one rounding: an instruction where the machine has it, else the C library's fma."""

    def build(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), build


@njit(cache=True)
def two_sum(a, b):
    """a + b and what its rounding left."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@njit(cache=True)
def two_product(a, b):
    """A * b and what its rounding left."""
    product = a * b
    return product, fused(a, b, -product)


@njit(cache=True)
def expected_rest(rows, pay, rewards):
    """What ``rewards`` (S, A), the rounded sums of data * pay over the rows, have lost; the largest sum of |data * pay|."""
    indptr, _, data = rows
    n_actions = rewards.shape[1]
    low, largest = np.empty_like(rewards), 0.0
    for row in range(rewards.size):
        total, rest, size = 0.0, 0.0, 0.0
        for k in range(indptr[row], indptr[row + 1]):
            product, error = two_product(data[k], pay[k])
            total, carry = two_sum(total, product)
            rest += carry + error
            size += abs(product)
        state, action = row // n_actions, row % n_actions
        low[state, action] = (total - rewards[state, action]) + rest
        largest = max(largest, size)
    return low, largest


@njit(cache=True)
def average_rest(rows, policy, rewards, rest_of, kernel):
    """What averaging over a policy's actions rounded away: low parts of the kernel, the rewards and theirs.

    ``rest_of`` (S, A): low parts of ``rewards``.
    """
    indptr, indices, data = rows
    starts, columns, values, _ = kernel
    n_states, n_actions = policy.shape
    low = np.empty(len(columns))
    high_sums, low_sums = np.zeros(n_states), np.zeros(n_states)
    pay, pay_low = np.empty(n_states), np.empty(n_states)
    for state in range(n_states):
        for k in range(starts[state], starts[state + 1]):
            j = columns[k]
            high_sums[j] = 0.0
            low_sums[j] = 0.0
        total, rest = 0.0, 0.0
        for action in range(n_actions):
            weight = policy[state, action]
            if weight == 0.0:
                continue
            product, error = two_product(weight, rewards[state, action])
            total, carry = two_sum(total, product)
            rest += carry + error + weight * rest_of[state, action]
            for k in range(indptr[state * n_actions + action], indptr[state * n_actions + action + 1]):
                j = indices[k]
                product, error = two_product(weight, data[k])
                high_sums[j], carry = two_sum(high_sums[j], product)
                low_sums[j] += carry + error
        pay[state], pay_low[state] = total, rest
        for k in range(starts[state], starts[state + 1]):
            j = columns[k]
            low[k] = (high_sums[j] - values[k]) + low_sums[j]
    return low, pay, pay_low


@njit(cache=True)
def residual(kernel, low, b, b_low, x, x_low, formed, total):
    """b - (I - discount K) x of pairs; its largest magnitude and a bound on the exact one, or their sums if ``total``.

    The pair sums are exact to (entries + formed + 8)^2 u^2 times the sum of magnitudes, u = 2^-53.
    """
    indptr, indices, data, discount = kernel
    n = len(b)
    missed = np.empty(n)
    unit = 0.25 * np.finfo(np.float64).eps ** 2 * (1.0 + 1e-9)
    largest, bound, rounding = 0.0, 0.0, 0.0
    start = indptr[0]
    for i in range(n):
        end = indptr[i + 1]
        high, rest, low_terms, size = 0.0, 0.0, 0.0, 0.0
        for k in range(start, end):
            j, value = indices[k], data[k]
            x_j = x[j]
            product = value * x_j
            after = high + product  # two_sum and two_product, written out: with calls the loop takes four times as long
            part = after - high
            rest += (high - (after - part)) + (product - part)
            low_terms += fused(value, x_j, -product) + fused(value, x_low[j], low[k] * x_j)
            high = after
            size += abs(product)
        terms = np.float64(end - start) + (8.0 + formed)
        start = end
        product, error = two_product(discount, high)
        rest = discount * (rest + low_terms) + error
        with_b, carry = two_sum(product, b[i])
        left, carry_x = two_sum(with_b, -x[i])
        value = left + (rest + (carry + b_low[i]) + (carry_x - x_low[i]))
        missed[i] = value
        value = abs(value)
        here = unit * terms * terms * (discount * size + abs(x[i]) + abs(b[i])) + 2e-16 * value
        rounding = here if here > rounding else rounding
        if total:
            largest += value
            bound += value + here
        else:  # so that a nan stays
            largest = value if not value <= largest else largest
            bound = value + here if not value + here <= bound else bound
    return missed, largest, bound * (1.0 + 1e-9), rounding


@njit(cache=True)
def add(x, x_low, step):
    """x += step, for a pair, in place."""
    for i in range(len(x)):
        high, low = two_sum(x[i], step[i])
        low += x_low[i]
        x[i], x_low[i] = two_sum(high, low)


@njit(cache=True)
def dot(weights, x, x_low):
    """sum weights * x of a pair, rounded once."""
    total, rest = 0.0, 0.0
    for i in range(len(x)):
        product, error = two_product(weights[i], x[i])
        total, carry = two_sum(total, product)
        rest += (carry + error) + weights[i] * x_low[i]
    return total + rest


@njit(cache=True)
def settled(x, x_low, bound):
    """Where every number within ``bound`` of the pair is rounded to the same float."""
    sure = np.empty(len(x), dtype=np.bool_)
    for i in range(len(x)):
        if abs(x_low[i]) + bound < 0.25 * np.finfo(np.float64).eps * abs(x[i]):  # within half the smaller gap
            sure[i] = True
            continue
        above = 0.5 * (np.nextafter(x[i], np.inf) - x[i])
        below = 0.5 * (np.nextafter(x[i], -np.inf) - x[i])
        sure[i] = x_low[i] + bound < above and x_low[i] - bound > below
    return sure


@njit(cache=True)
def nothing_ahead(kernel, b, b_low, x, x_low):
    """States of a set of zeros in x that no row leaves and where b is 0: there the solution is 0, exactly."""
    indptr, indices, _, _ = kernel
    n = len(b)
    zero = np.empty(n, dtype=np.bool_)
    for i in range(n):
        zero[i] = x[i] == 0.0 and x_low[i] == 0.0 and b[i] == 0.0 and b_low[i] == 0.0
    changed = True
    while changed:
        changed = False
        for i in range(n):
            if zero[i]:
                for k in range(indptr[i], indptr[i + 1]):
                    if not zero[indices[k]]:
                        zero[i] = False
                        changed = True
                        break
    return zero
