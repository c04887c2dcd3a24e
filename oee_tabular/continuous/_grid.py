"""Multilinear interpolation onto the vertices of a regular grid."""

import numpy as np
from numba import njit


@njit(cache=True)
def locate(points, low, spacing, shape, periodic):
    """The lower corner of each point's cell (n, d), its place in the cell in [0, 1] (n, d), and which points lie outside.

    Points outside are moved to the nearest face. A periodic coordinate has ``shape`` cells and none outside.
    """
    n, d = points.shape
    corner = np.empty((n, d), dtype=np.int64)
    fraction = np.empty((n, d))
    outside = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        for k in range(d):
            place = (points[i, k] - low[k]) / spacing[k]
            if periodic[k]:
                place -= np.floor(place / shape[k]) * shape[k]
                cell = min(int(np.floor(place)), shape[k] - 1)
            else:
                last = shape[k] - 1
                if place < -1e-9 or place > last + 1e-9:
                    outside[i] = True
                place = min(max(place, 0.0), float(last))
                cell = min(int(np.floor(place)), last - 1)
            corner[i, k] = cell
            fraction[i, k] = place - cell
    return corner, fraction, outside


@njit(cache=True)
def vertices_of(corner, fraction, shape, periodic):
    """The 2**d vertices around each point and their weights: vertex numbers (n, 2**d) in C order, weights (n, 2**d)."""
    n, d = corner.shape
    many = 1 << d
    numbers = np.empty((n, many), dtype=np.int64)
    weights = np.empty((n, many))
    for i in range(n):
        for m in range(many):
            number, weight = 0, 1.0
            for k in range(d):
                index = corner[i, k]
                if (m >> k) & 1:
                    index += 1
                    weight *= fraction[i, k]
                    if periodic[k] and index == shape[k]:
                        index = 0
                else:
                    weight *= 1.0 - fraction[i, k]
                number = number * shape[k] + index
            numbers[i, m] = number
            weights[i, m] = weight
    return numbers, weights
