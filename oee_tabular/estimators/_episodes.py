"""Sums over weighted episodes of any lengths that stand in a row, ``starts`` (n + 1,) apart; in a fixed order."""

from numba import njit


@njit(cache=True)
def carried(starts, path, ratio, pay, discounts, by_move, weight, reward):
    """Of each step, from the entry of P that it takes: gamma^t r_t, and its weight W_t, or W_{t+1} where ``by_move``."""
    for i in range(len(starts) - 1):
        w = 1.0
        for t in range(starts[i + 1] - starts[i]):
            row = starts[i] + t
            after = w * ratio[path[row]]
            weight[row] = after if by_move else w
            reward[row] = discounts[t] * pay[path[row]]
            w = after


@njit(cache=True)
def step_sums(starts, weight, reward, mass, paid):
    """mass[t] = sum_i w_it, paid[t] = sum_i w_it r_it, over the episodes that have a step t; both begin at 0."""
    for i in range(len(starts) - 1):
        for row in range(starts[i], starts[i + 1]):
            mass[row - starts[i]] += weight[row]
            paid[row - starts[i]] += weight[row] * reward[row]


@njit(cache=True)
def linearised(starts, weight, reward, value, scale, out):
    """out[i] = sum_t (w_it r_it - value_t w_it) scale_t."""
    for i in range(len(starts) - 1):
        total = 0.0
        for row in range(starts[i], starts[i + 1]):
            t = row - starts[i]
            total += (weight[row] * reward[row] - value[t] * weight[row]) * scale[t]
        out[i] = total


@njit(cache=True)
def control_variates(places, path, columns, rows, ratio, known, going, discount, ahead):
    """ahead[i] of the episodes i < len(places), a step further back, the one whose entry is at places[i] of the path.

    D = known(s, a) + zeta (gamma D' - gamma V(s')), with ``going`` = gamma V.
    """
    for i in range(len(places)):
        entry = path[places[i]]
        ahead[i] = known[rows[entry]] + ratio[entry] * (discount * ahead[i] - going[columns[entry]])
