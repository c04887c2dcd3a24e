"""Value iteration, until the change is the same in all states.

    x_{n+1} = b + gamma K x_n;    x* = x_{n+1} + g / (1 - g) (x_{n+1} - x_n),    g = gamma times the sum of a row [1, 6.6.3].

Reference: [1] Puterman, Markov Decision Processes, 1994.
"""

import numpy as np

from oee_tabular._kernels import njit


@njit(cache=True)
def sweeps(kernel, mass, b, relative):
    """x, for rows with the sum ``mass``; None where the spread of the change does not fall like 2^-sweeps, or after 200."""
    indptr, indices, data, discount = kernel
    n = len(b)
    x, new = b.copy(), np.empty(n)
    allowed = np.inf
    carried = discount * mass
    for _ in range(200):
        low, high, largest = np.inf, -np.inf, 0.0
        for i in range(n):
            total = 0.0
            for k in range(indptr[i], indptr[i + 1]):
                total += data[k] * x[indices[k]]
            value = b[i] + discount * total
            new[i] = value
            change = value - x[i]
            low = min(low, change)
            high = max(high, change)
            largest = max(largest, abs(value))
        x, new = new, x
        spread = high - low
        shift = carried / (1.0 - carried) * (0.5 * (low + high))
        failing = not spread <= allowed
        near = max(relative, 8e-16) * max(largest, abs(shift))
        if spread <= near or (failing and spread <= 64.0 * near):  # rounding keeps it from falling any more
            for i in range(n):
                x[i] += shift
            return x
        if failing:
            return None
        allowed = 0.5 * (4.0 * spread if allowed == np.inf else allowed)
    return None
