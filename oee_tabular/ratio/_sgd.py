"""The nearest point of a polytope {lower <= Phi w <= upper}, by Hildreth's row-action method [1].

Reference: [1] C. Hildreth, A quadratic programming procedure, Naval Research Logistics Quarterly 4, 1957.
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def project(w, phi, lengths, lower, upper):
    """Replace ``w`` by its projection; ``lengths`` are the squared lengths of phi's rows. Returns the sweeps made.

    Sweeps until no constraint moves Phi w by more than 1e-12, at most 10 000; a polytope without points never settles.
    """
    n, d = phi.shape
    pressed = np.zeros((n, 2))
    for sweep in range(10_000):
        largest = 0.0
        for x in range(n):
            if lengths[x] == 0.0:
                continue
            value = 0.0
            for j in range(d):
                value += phi[x, j] * w[j]
            for side in range(2):
                missing = lower - value if side == 0 else value - upper
                change = max(-pressed[x, side], missing)
                if change == 0.0:
                    continue
                pressed[x, side] += change
                change = change if side == 0 else -change
                for j in range(d):
                    w[j] += change / lengths[x] * phi[x, j]
                value += change
                largest = max(largest, abs(change))
        if largest <= 1e-12:
            return sweep + 1
    return 10_000
