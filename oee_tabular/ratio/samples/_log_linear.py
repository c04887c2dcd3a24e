"""Compiled loops of the log-linear class: argmin log mean exp(theta phi) - aim . theta + penalty/2 |theta|^2.

Features are (k, n): a row a feature. Nothing is validated here; no fastmath.
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def row_statistics(x):
    """Mean and standard deviation of each row of (k, n) numbers; a deviation that is only rounding is 0."""
    k, n = x.shape
    center, spread = np.zeros(k), np.zeros(k)
    for j in range(k):
        total, square = 0.0, 0.0
        for i in range(n):
            total += x[j, i] - x[j, 0]
        center[j] = x[j, 0] + total / n
        for i in range(n):
            square += (x[j, i] - center[j]) ** 2
        spread[j] = np.sqrt(square / n)
        if spread[j] <= 1e-12 * abs(center[j]):
            spread[j] = 0.0
    return center, spread


@njit(cache=True, error_model="numpy")
def words(x, center, scale, quadratic):
    """The features of (n, d) points: the rows z = (x - center) / scale, and where asked for z_i z_j for all i <= j."""
    n, d = x.shape
    rows = np.empty((d + (d * (d + 1) // 2 if quadratic else 0), n))
    for j in range(d):
        for i in range(n):
            rows[j, i] = (x[i, j] - center[j]) / scale[j]
    row = d
    for j in range(d if quadratic else 0):
        for other in range(j, d):
            for i in range(n):
                rows[row, i] = rows[j, i] * rows[other, i]
            row += 1
    return rows


@njit(cache=True, error_model="numpy")
def standardise(x, center, scale):
    """(x - center) / scale in place; returns the rows' means after it."""
    k, n = x.shape
    means = np.zeros(k)
    for j in range(k):
        total = 0.0
        for i in range(n):
            x[j, i] = (x[j, i] - center[j]) / scale[j]
        for i in range(n):
            total += x[j, i]
        means[j] = total / n
    return means


@njit(cache=True, error_model="numpy")
def log_tilt(x, center, slope, log_mean):
    """slope . (x - center) - log_mean for each column of x."""
    k, n = x.shape
    values = np.full(n, -log_mean)
    for j in range(k):
        for i in range(n):
            values[i] += slope[j] * (x[j, i] - center[j])
    return values


@njit(cache=True, error_model="numpy")
def weigh(phi, theta, weights):
    """``weights`` gets exp(theta phi) scaled to sum to 1. Returns log mean exp(theta phi)."""
    k, n = phi.shape
    weights[:] = 0.0
    for j in range(k):
        for i in range(n):
            weights[i] += theta[j] * phi[j, i]
    top = weights.max()
    total = 0.0
    for i in range(n):
        weights[i] = np.exp(weights[i] - top)
        total += weights[i]
    for i in range(n):
        weights[i] /= total
    return top + np.log(total / n)


@njit(cache=True, error_model="numpy")
def weighted_mean(phi, weights):
    """The mean of each row of phi."""
    k, n = phi.shape
    mean = np.empty(k)
    for j in range(k):
        total = 0.0
        for i in range(n):
            total += weights[i] * phi[j, i]
        mean[j] = total
    return mean


@njit(cache=True, error_model="numpy")
def newton(phi, aim, penalty):
    """(theta, |gradient|^2 / (2 penalty), log mean exp(theta phi), the weights exp(theta phi) / sum)."""
    k, n = phi.shape
    theta, weights, trial_weights = np.zeros(k), np.full(n, 1.0 / n), np.empty(n)
    off = np.empty((k, n))
    value, log_mean, gap = 0.0, 0.0, np.inf
    for iteration in range(201):
        mean = weighted_mean(phi, weights)
        gradient = mean - aim + penalty * theta
        gap = (gradient**2).sum() / (2.0 * penalty)
        if gap < 1e-22 or iteration == 200:
            break
        for j in range(k):
            for i in range(n):
                off[j, i] = weights[i] * (phi[j, i] - mean[j])
        hessian = np.dot(off, phi.T)
        for j in range(k):
            hessian[j, j] += penalty
        step = -np.linalg.solve(hessian, gradient)
        decrement = -(gradient * step).sum()
        if decrement < 1e-22:
            break
        blur = 1e-13 if decrement < 1e-9 else 0.0  # what rounding may add to a fall that it hides
        length = 1.0
        while length > 1e-12:
            trial = theta + length * step
            trial_mean = weigh(phi, trial, trial_weights)
            risk = trial_mean + ((0.5 * penalty * trial - aim) * trial).sum()
            if risk <= value - 1e-4 * length * decrement + blur:
                break
            length *= 0.5
        if length <= 1e-12:
            break
        theta, value, log_mean = trial, risk, trial_mean
        weights, trial_weights = trial_weights, weights
    return theta, gap, log_mean, weights
