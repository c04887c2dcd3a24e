"""The largest variance of the values of each row over distributions between bounds."""

import numpy as np
from numba import njit


@njit(cache=True)
def largest_variances(indptr, rows, values, low, high):
    """max Var_p[v] over low <= p <= high, sum p = 1, of each of ``rows`` of a CSR pattern (sum low <= 1 <= sum high).

    A best p has what is free above ``low`` at both ends of the sorted values. All of it is put at the upper end, and from
    there, the least value y first, to the lower end, the least value x first: d Var / d mass = (y - x) (2 E v - x - y),
    which changes its sign once. The largest variance of v in {0, 1}; with the mass of the 1 at most 0.1; in [0.6, 0.7]:

    >>> bounds = np.array([0.0, 0.0, 0.0, 0.0, 0.1, 0.2]), np.array([1.0, 1.0, 1.0, 0.1, 0.4, 0.7])
    >>> largest_variances(np.array([0, 2, 4, 6]), np.arange(3), np.array([0.0, 1.0] * 3), *bounds).round(9)
    array([0.25, 0.09, 0.24])
    """
    result = np.empty(len(rows))
    for k, row in enumerate(rows):
        begin, end = indptr[row], indptr[row + 1]
        order = np.argsort(values[begin:end])
        v, p = values[begin:end][order], low[begin:end][order]
        room, moved = high[begin:end][order] - p, np.zeros(len(order))
        free, upper, lower = 1.0 - p.sum(), len(order), 0
        while free > 0.0 and upper > 0:
            upper -= 1
            moved[upper] = min(free, room[upper])
            free -= moved[upper]
        p, room, mean = p + moved, room - moved, np.sum((p + moved) * v)
        gain = 1.0
        while gain > 0.0:
            upper = max(upper, lower + 1)  # what lies on the entry that is being filled may stay
            if upper == len(order):
                break
            distance = v[upper] - v[lower]
            gain = 2.0 * mean - v[lower] - v[upper]
            mass = min(room[lower], moved[upper])
            if 2.0 * mass * distance >= gain:  # the best split is inside, or has been passed
                mass, gain = max(gain, 0.0) / max(2.0 * distance, 1e-300), 0.0
            p[lower], room[lower] = p[lower] + mass, room[lower] - mass
            p[upper], room[upper] = p[upper] - mass, room[upper] + mass
            moved[upper] -= mass
            mean -= mass * distance
            lower, upper = lower + (room[lower] <= 0.0), upper + (moved[upper] <= 0.0)
        result[k] = np.sum(p * (v - mean) ** 2)
    return result
