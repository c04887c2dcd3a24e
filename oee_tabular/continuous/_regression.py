"""Kernel of a regression's values: for each row the sum of its coefficients times products of inputs and cosines.

    g_k = sum_j w[a, j, k] phi_j,    phi_j = z[first_j] z[second_j],  j < q,    phi_j = cos(sum_i z_i frequency_ij + phase_j)

over z = (1, inputs clipped and standardised). A row is summed in the order of j, whatever rows stand beside it, so its bits
depend on nothing else; the inner loops run over rows of one action, side by side in the processor's registers.
"""

import math

import numpy as np
from numba import njit

ROWS = 256  # at a time: their inputs stay in the nearest cache


@njit(cache=True)
def predict(x, commands, d, actions, kept, limits, first, second, frequencies, phases, w, ends):
    """(n, k) values. Inputs are x (n, .), the command of each action, d (n, .); ``kept`` numbers those that are used.

    ``limits`` (4, m): the least and the most of each, its centre and 1 over its scale; ``w`` (A, columns, k).
    ``ends`` (2, k): what the values are kept within.
    """
    n, m, q = len(x), len(kept), len(first)
    n_x, n_c, k = x.shape[1], commands.shape[1], w.shape[2]
    found = np.zeros((n, k))
    place = np.zeros(len(commands) + 1, dtype=np.int64)  # where each action's rows begin
    for a in actions:
        place[a + 1] += 1
    place = np.cumsum(place)
    order = np.empty(n, dtype=np.int64)
    for row in range(n):
        order[place[actions[row]]] = row
        place[actions[row]] += 1
    z, phi, total = np.ones((m + 1, ROWS)), np.empty(ROWS), np.empty((k, ROWS))
    begin = 0
    while begin < n:
        a = actions[order[begin]]
        size = 1
        while size < ROWS and begin + size < n and actions[order[begin + size]] == a:
            size += 1
        for i in range(m):
            j = kept[i]
            for r in range(size):
                row = order[begin + r]
                value = x[row, j] if j < n_x else commands[a, j - n_x] if j < n_x + n_c else d[row, j - n_x - n_c]
                z[i + 1, r] = (min(max(value, limits[0, i]), limits[1, i]) - limits[2, i]) * limits[3, i]
        total[:] = 0.0
        for j in range(w.shape[1]):
            if not w[a, j].any():
                continue
            if j < q:
                left, right = z[first[j]], z[second[j]]
                for r in range(size):
                    phi[r] = left[r] * right[r]
            else:
                phi[:size] = phases[j - q]
                for i in range(m):
                    c, left = frequencies[i, j - q], z[i + 1]
                    for r in range(size):
                        phi[r] += c * left[r]
                for r in range(size):
                    phi[r] = math.cos(phi[r])
            for t in range(k):
                c, part = w[a, j, t], total[t]
                if c != 0.0:
                    for r in range(size):
                        part[r] += c * phi[r]
        for r in range(size):
            for t in range(k):
                found[order[begin + r], t] = min(max(total[t, r], ends[0, t]), ends[1, t])
        begin += size
    return found
