"""Sums over the entries of a tilt: its rows, and the moments of its directions.

A transition x has numbers phi_x (d,): the columns ``base`` (d_1,), and a one in column
d_1 + ``code`` (no one where the code is -1). The parameters are theta (1 + A, d): those
of all actions, then those of each action alone. Loops over entries are compiled here;
what is done once an iteration (``newton``) is numpy, which is as quick from a hundred
states on, and compiles in a seventh of the time.
"""

from math import exp, log
from typing import NamedTuple

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.typing import Array, IntArray


class Columns(NamedTuple):
    """The columns of directions on some rows.

    base (entries, d_1), code (entries,), n_codes, indptr (rows + 1,), action (rows,),
    weights (entries,) the simulator's.
    """

    base: Array
    code: IntArray
    n_codes: int
    indptr: IntArray
    action: IntArray
    weights: Array


def find_codes(
    places: Array,
    state: IntArray,
    arrival: IntArray,
    indptr: IntArray,
    kinds: Array,
    tolerance: float,
) -> IntArray:
    """Find the place of places[s'] - places[s] in ``kinds`` (k, c), or -1."""
    code = np.full(len(arrival), -1)
    fill_codes(places, state, arrival, indptr, kinds, tolerance, code)
    return code


@njit(cache=True, nogil=True)
def fill_codes(places, state, arrival, indptr, kinds, tolerance, code):
    """Write the place of each entry's difference in ``kinds``, where it has one."""
    for row in range(len(state)):
        for x in range(indptr[row], indptr[row + 1]):
            for k in range(len(kinds)):
                same = True
                for c in range(kinds.shape[1]):
                    difference = places[arrival[x], c] - places[state[row], c]
                    if abs(difference - kinds[k, c]) > tolerance:
                        same = False
                        break
                if same:
                    code[x] = k
                    break


def tilt_rows(columns: Columns, theta: Array) -> tuple[Array, Array]:
    """Compute the rows P exp((theta_0 + theta_a) . phi) / Z, (entries,), and ln Z."""
    model = np.empty(len(columns.weights))
    log_normalizer = np.empty(len(columns.action))
    fill_tilt(
        columns.base,
        columns.code,
        columns.indptr,
        columns.action,
        columns.weights,
        theta[0] + theta[1:],
        model,
        log_normalizer,
    )
    return model, log_normalizer


@njit(cache=True, nogil=True, error_model="numpy")
def fill_tilt(base, code, indptr, action, weights, theta, model, log_normalizer):
    """Write P exp(theta_a . phi) / Z of each row, and ln Z; theta is (A, d).

    The largest exponent of a row is subtracted first, so that exp does not overflow.
    """
    width = base.shape[1]
    for row in range(len(action)):
        a = action[row]
        largest = -np.inf
        for x in range(indptr[row], indptr[row + 1]):
            exponent = 0.0
            for j in range(width):
                exponent += theta[a, j] * base[x, j]
            if code[x] >= 0:
                exponent += theta[a, width + code[x]]
            model[x] = exponent
            if exponent > largest:
                largest = exponent
        total = 0.0
        for x in range(indptr[row], indptr[row + 1]):
            model[x] = weights[x] * exp(model[x] - largest)
            total += model[x]
        for x in range(indptr[row], indptr[row + 1]):
            model[x] /= total
        log_normalizer[row] = largest + log(total)


def sum_columns(columns: Columns, values: Array, n_actions: int) -> Array:
    """Sum values_x phi_x over each action's rows, (A, d)."""
    sums = np.zeros((n_actions, columns.base.shape[1] + columns.n_codes))
    add_columns(
        columns.base, columns.code, columns.indptr, columns.action, values, sums
    )
    return sums


@njit(cache=True, nogil=True)
def add_columns(base, code, indptr, action, values, sums):
    """Add values_x phi_x to the sums (A, d) of each entry's action."""
    width = base.shape[1]
    for row in range(len(action)):
        a = action[row]
        for x in range(indptr[row], indptr[row + 1]):
            for j in range(width):
                sums[a, j] += values[x] * base[x, j]
            if code[x] >= 0:
                sums[a, width + code[x]] += values[x]


def sum_covariances(
    columns: Columns, model: Array, mass: Array, n_actions: int
) -> tuple[Array, Array]:
    """Sum mass E[phi], (A, d), and mass Cov[phi], (A, d, d), over each action's rows.

    Moments are under ``model``; mass is (rows,). Cov[phi] = E[phi phi'] - E[phi]
    E[phi]'.
    """
    d = columns.base.shape[1] + columns.n_codes
    means = np.zeros((n_actions, d))
    covariances = np.zeros((n_actions, d, d))
    add_covariances(
        columns.base,
        columns.code,
        columns.indptr,
        columns.action,
        model,
        mass,
        np.zeros(d),
        np.arange(d),
        means,
        covariances,
    )
    return means, covariances


@njit(cache=True, nogil=True)
def add_covariances(
    base, code, indptr, action, model, mass, mean, used, means, covariances
):
    """Add mass E[phi] and mass Cov[phi] of each row, of which first the lower triangle.

    ``mean`` (d,), zeros, and ``used`` (d,), 0 ... d - 1, are room for one row: mass
    E[phi], and the columns that it has, first those of the base.
    """
    width = base.shape[1]
    for row in range(len(action)):
        if mass[row] == 0.0:
            continue
        a = action[row]
        n_used = width
        # mass E[phi phi'] of the row, and mass E[phi] into ``mean``
        for x in range(indptr[row], indptr[row + 1]):
            share = mass[row] * model[x]
            if share == 0.0:
                continue
            for i in range(width):
                part = share * base[x, i]
                mean[i] += part
                for j in range(i + 1):
                    covariances[a, i, j] += part * base[x, j]
                if code[x] >= 0:
                    covariances[a, width + code[x], i] += part
            if code[x] >= 0:
                c = width + code[x]
                if mean[c] == 0.0:
                    used[n_used] = c
                    n_used += 1
                mean[c] += share
                covariances[a, c, c] += share
        # less mass E[phi] E[phi]', for the columns that the row has
        for i in range(n_used):
            for j in range(n_used):
                if used[j] <= used[i]:
                    covariances[a, used[i], used[j]] -= (
                        mean[used[i]] * mean[used[j]] / mass[row]
                    )
        for i in range(n_used):
            means[a, used[i]] += mean[used[i]]
            mean[used[i]] = 0.0
    for a in range(len(covariances)):
        for i in range(len(mean)):
            for j in range(i):
                covariances[a, j, i] = covariances[a, i, j]
