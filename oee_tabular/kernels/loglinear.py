"""Newton's method for the log-linear class: argmin log mean exp(phi theta) - aim . theta + penalty/2 |theta|^2."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


def column_statistics(x: Any) -> Any:
    """Mean, standard deviation and largest size of each column of (n, d) numbers."""
    n, d = x.shape
    center, spread, size = np.zeros(d), np.zeros(d), np.zeros(d)
    for i in range(n):
        for j in range(d):
            center[j] += x[i, j]
            size[j] = max(size[j], abs(x[i, j]))
    center /= n
    for i in range(n):
        for j in range(d):
            spread[j] += (x[i, j] - center[j]) ** 2
    return center, np.sqrt(spread / n), size


column_statistics = njit(cache=True, error_model="numpy")(column_statistics)


def risk_at(theta: Any, phi: Any, aim: Any, penalty: Any, weights: Any) -> Any:
    """The risk; ``weights`` gets exp(phi theta) scaled to sum to 1. Returns (risk, log mean exp)."""
    n, d = phi.shape
    top = -np.inf
    for i in range(n):
        value = 0.0
        for j in range(d):
            value += phi[i, j] * theta[j]
        weights[i] = value
        top = max(top, value)
    total = 0.0
    for i in range(n):
        weights[i] = np.exp(weights[i] - top)
        total += weights[i]
    for i in range(n):
        weights[i] /= total
    log_mean = top + np.log(total / n)
    risk = log_mean
    for j in range(d):
        risk += (0.5 * penalty * theta[j] - aim[j]) * theta[j]
    return risk, log_mean


risk_at = njit(cache=True, error_model="numpy")(risk_at)


def newton(phi: Any, aim: Any, penalty: Any) -> Any:
    """(theta, |gradient|^2 / (2 penalty), log mean exp(phi theta))."""
    n, d = phi.shape
    theta, trial = np.zeros(d), np.zeros(d)
    weights = np.empty(n)
    value, log_mean = risk_at(theta, phi, aim, penalty, weights)
    mean, hessian = np.zeros(d), np.zeros((d, d))
    for _ in range(200):
        for j in range(d):
            mean[j] = 0.0
            for k in range(d):
                hessian[j, k] = penalty if j == k else 0.0
        for i in range(n):
            for j in range(d):
                mean[j] += weights[i] * phi[i, j]
        for i in range(n):
            for j in range(d):
                off = weights[i] * (phi[i, j] - mean[j])
                for k in range(j + 1):
                    hessian[j, k] += off * (phi[i, k] - mean[k])
        for j in range(d):
            for k in range(j):
                hessian[k, j] = hessian[j, k]
        gradient = mean - aim + penalty * theta
        step = -np.linalg.solve(hessian, gradient)
        decrement = 0.0
        for j in range(d):
            decrement -= gradient[j] * step[j]
        if decrement < 1e-22:
            break
        blur = 1e-13 if decrement < 1e-9 else 0.0  # what rounding may add to a fall that it hides
        length = 1.0
        new = np.inf
        while length > 1e-12:
            trial[:] = theta + length * step
            new, new_mean = risk_at(trial, phi, aim, penalty, weights)
            if new <= value - 1e-4 * length * decrement + blur:
                break
            length *= 0.5
        if length <= 1e-12:
            value, log_mean = risk_at(theta, phi, aim, penalty, weights)
            break
        theta[:] = trial
        value, log_mean = new, new_mean
    slope = 0.0
    for j in range(d):
        level = penalty * theta[j] - aim[j]
        for i in range(n):
            level += weights[i] * phi[i, j]
        slope += level * level
    return theta, slope / (2.0 * penalty), log_mean


newton = njit(cache=True, error_model="numpy")(newton)
