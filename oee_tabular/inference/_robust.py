"""The largest mean of v over a row's set of distributions: KL balls around the counts within a box.

    maximise sum P v  over  sum phat log(phat / P) <= epsilon,  low <= P <= high,  sum P = 1.

With multipliers lambda of the ball and eta of the sum, P = clip(lambda phat / (eta - v), low, high), ``high`` where eta <= v.
For a given lambda the sum is nonincreasing in eta (one bracketed root; at a jump the two ends are combined), and KL falls
as lambda grows (another).
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def fill_at(eta, lam, phat, v, low, high, start, stop, out):
    """P(eta, lambda) into ``out``; its sum and minus the sum's derivative."""
    total, slope = 0.0, 0.0
    for i in range(start, stop):
        gap = eta - v[i]
        if gap <= 0.0:
            out[i] = high[i]
        else:
            value = lam * phat[i] / gap
            out[i] = min(max(value, low[i]), high[i])
            slope += value / gap if out[i] == value else 0.0
        total += out[i]
    return total, slope


@njit(cache=True, error_model="numpy")
def greedy_row(v, low, high, start, stop, out):
    """Without a ball: what ``low`` leaves goes to the largest v, then to the next; returns the last v that got some."""
    rest, eta = 1.0, np.inf
    for i in range(start, stop):
        out[i] = low[i]
        rest -= low[i]
    for k in np.argsort(-v[start:stop], kind="mergesort"):
        i = start + k
        room = min(high[i] - low[i], rest)
        out[i] += room
        rest -= room
        eta = v[i]
        if rest <= 0.0:
            break
    return eta


@njit(cache=True, error_model="numpy")
def row_at(lam, phat, v, low, high, start, stop, out, spare):
    """P for a lambda above 0, summing to 1, into ``out``; returns eta. Needs sum low <= 1 <= sum high."""
    least, smallest, largest = 0.0, np.inf, -np.inf
    for i in range(start, stop):
        least += low[i]
        smallest, largest = min(smallest, v[i]), max(largest, v[i])
    left, room = smallest, max(1.0 - least, 1e-300)
    right = largest + max(lam / room, 1e-12 * max(abs(largest), abs(smallest), largest - smallest) + 1e-300)
    eta = right
    for _ in range(200):
        total, slope = fill_at(eta, lam, phat, v, low, high, start, stop, out)
        if total == 1.0:
            return eta
        if total > 1.0:
            left = eta
        else:
            right = eta
        trial = eta + (total - 1.0) / slope if slope > 0.0 else 0.5 * (left + right)
        if not left < trial < right:
            trial = 0.5 * (left + right)
        if not left < trial < right or abs(trial - eta) <= 1e-16 * abs(eta):
            break
        eta = trial
    upper, _ = fill_at(left, lam, phat, v, low, high, start, stop, out)
    lower, _ = fill_at(right, lam, phat, v, low, high, start, stop, spare)
    share = min(max((1.0 - lower) / (upper - lower), 0.0), 1.0) if upper > lower else 0.0
    for i in range(start, stop):
        out[i] = spare[i] if out[i] == spare[i] else spare[i] + share * (out[i] - spare[i])
    return right


@njit(cache=True, error_model="numpy")
def divergence(phat, p, start, stop):
    """KL(phat || P) = sum phat (-log(1 + u)) + u-terms, u = (P - phat) / phat, without cancellation where P is near phat."""
    total = 0.0
    for i in range(start, stop):
        if phat[i] == 0.0:
            total += p[i]  # sum P = sum phat = 1: the mass that the logarithm's terms leave out
        elif p[i] <= 0.0:
            return np.inf
        else:
            u = (p[i] - phat[i]) / phat[i]
            if abs(u) < 1e-4:
                total += phat[i] * 0.5 * u * u * (1.0 - 2.0 * u / 3.0 + 0.5 * u * u)
            else:
                total += phat[i] * (u - (np.log(p[i] / phat[i]) if u < -0.5 else np.log1p(u)))
    return total


@njit(cache=True, error_model="numpy")
def bound_above(eta, lam, epsilon, phat, v, low, high, start, stop):
    """The Lagrangian's maximum: an upper bound on the row's problem for any eta and lambda >= 0."""
    total = eta + (lam * epsilon if lam > 0.0 else 0.0)
    for i in range(start, stop):
        slope = v[i] - eta
        if phat[i] > 0.0 and lam > 0.0:
            best = high[i]
            if slope < 0.0:
                best = min(max(lam * phat[i] / -slope, low[i]), high[i])
            if best <= 0.0:
                return np.inf
            total += best * slope + lam * phat[i] * np.log(best / phat[i])
        else:
            total += (high[i] if slope > 0.0 else low[i]) * slope
    return total


@njit(cache=True, error_model="numpy")
def worst_row(epsilon, phat, v, low, high, start, stop, guess, out, spare):
    """Fill ``out`` with the maximiser; returns lambda, an upper bound on the maximum, and the KL (above epsilon: none)."""
    spread = v[start:stop].max() - v[start:stop].min()
    eta = greedy_row(v, low, high, start, stop, out)
    kl = 0.0 if epsilon == np.inf else divergence(phat, out, start, stop)
    if kl <= epsilon:
        return 0.0, bound_above(eta, 0.0, 0.0, phat, v, low, high, start, stop), kl
    if spread <= 0.0:
        row_at(1e30, phat, v, low, high, start, stop, out, spare)  # the nearest point of the box to the counts
        return 0.0, v[start], divergence(phat, out, start, stop)
    near, far, above, below = 0.0, np.inf, 1.0, -1.0  # lambdas outside and inside the ball, log(KL / epsilon) there
    lam = guess if guess > 0.0 else spread / np.sqrt(2.0 * epsilon + 1e-300)
    for step in range(200):
        row_at(lam, phat, v, low, high, start, stop, out, spare)
        excess = np.log(max(divergence(phat, out, start, stop), 1e-300) / epsilon)
        if excess > 0.0:
            near, above = lam, excess
        else:
            far, below = lam, excess
        if -1e-12 < excess <= 0.0 or far <= near * (1.0 + 1e-13) or far < 1e-15 * spread or near > 1e15 * spread:
            break
        if far == np.inf:
            lam = 4.0 * near
        elif near == 0.0:
            lam = 0.25 * far
        elif step % 3 == 2 or not above < np.inf:
            lam = np.sqrt(near * far)
        else:  # regula falsi in log lambda, log KL
            lam = near * (far / near) ** min(max(above / (above - below), 1e-3), 1.0 - 1e-3)
    lam = far if far < np.inf else near
    eta = row_at(lam, phat, v, low, high, start, stop, out, spare)
    kl = divergence(phat, out, start, stop)
    return lam, bound_above(eta, lam, epsilon, phat, v, low, high, start, stop), kl


@njit(cache=True, error_model="numpy")
def worst_rows(epsilon, phat, v, low, high, indptr, lam, out, above, kl):
    """Every row; ``lam`` holds guesses and gets the multipliers. inf in ``epsilon`` is a row without data."""
    spare = np.empty(len(phat))
    for k in range(len(indptr) - 1):
        start, stop = indptr[k], indptr[k + 1]
        lam[k], above[k], kl[k] = worst_row(epsilon[k], phat, v, low, high, start, stop, lam[k], out, spare)
