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
        elif phat[i] == 0.0 or lam == 0.0:
            out[i] = low[i]
        else:
            value = lam * phat[i] / gap
            if value <= low[i]:
                out[i] = low[i]
            elif value >= high[i]:
                out[i] = high[i]
            else:
                out[i] = value
                slope += value / gap
        total += out[i]
    return total, slope


@njit(cache=True, error_model="numpy")
def greedy_row(v, low, high, start, stop, out, spare):
    """Without a ball: what ``low`` leaves goes to the largest v, then to the next; returns the last v that got some."""
    rest = 1.0
    for i in range(start, stop):
        out[i] = low[i]
        spare[i] = 0.0  # not yet filled
        rest -= low[i]
    eta = np.inf
    for _ in range(stop - start):
        best = -1
        for i in range(start, stop):
            if spare[i] == 0.0 and (best < 0 or v[i] > v[best]):
                best = i
        eta = v[best]
        spare[best] = 1.0
        room = min(high[best] - low[best], rest)
        out[best] += room
        rest -= room
        if rest <= 0.0:
            break
    return eta


@njit(cache=True, error_model="numpy")
def row_at(lam, phat, v, low, high, start, stop, out, spare):
    """P for a given lambda, summing to 1, into ``out``; returns eta. Needs sum low <= 1 <= sum high."""
    if lam == 0.0:
        return greedy_row(v, low, high, start, stop, out, spare)
    least, smallest, largest = 0.0, np.inf, -np.inf
    for i in range(start, stop):
        least += low[i]
        smallest, largest = min(smallest, v[i]), max(largest, v[i])
    left = smallest
    room = max(1.0 - least, 1e-300)
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
    share = (1.0 - lower) / (upper - lower) if upper > lower else 0.0
    share = min(max(share, 0.0), 1.0)
    for i in range(start, stop):
        out[i] = spare[i] if out[i] == spare[i] else spare[i] + share * (out[i] - spare[i])
    return right


@njit(cache=True, error_model="numpy")
def divergence(phat, p, start, stop):
    """KL(phat || P) = sum phat (-log(1 + u)) + u-terms, u = (P - phat) / phat, without cancellation where P is near phat."""
    total = 0.0
    for i in range(start, stop):
        if phat[i] > 0.0:
            if p[i] <= 0.0:
                return np.inf
            u = (p[i] - phat[i]) / phat[i]
            if abs(u) < 1e-4:
                total += phat[i] * 0.5 * u * u * (1.0 - 2.0 * u / 3.0 + 0.5 * u * u)
            else:
                total += phat[i] * (u - (np.log(p[i] / phat[i]) if u < -0.5 else np.log1p(u)))
        else:
            total += p[i]  # sum P = sum phat = 1: the mass that the logarithm's terms leave out
    return total


@njit(cache=True, error_model="numpy")
def bound_above(eta, lam, epsilon, phat, v, low, high, start, stop):
    """The Lagrangian's maximum: an upper bound on the row's problem for any eta and lambda >= 0."""
    total = eta + lam * epsilon
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
    smallest, largest = np.inf, -np.inf
    for i in range(start, stop):
        smallest, largest = min(smallest, v[i]), max(largest, v[i])
    spread = largest - smallest
    eta = row_at(0.0, phat, v, low, high, start, stop, out, spare)
    kl = divergence(phat, out, start, stop)
    if kl <= epsilon or spread <= 0.0:
        if spread <= 0.0:
            row_at(1e30, phat, v, low, high, start, stop, out, spare)  # the nearest point of the box to the counts
            kl = divergence(phat, out, start, stop)
            return 0.0, largest, kl
        return 0.0, bound_above(eta, 0.0, epsilon, phat, v, low, high, start, stop), kl
    near, far = 0.0, guess if guess > 0.0 else spread / np.sqrt(2.0 * epsilon + 1e-300)
    for _ in range(200):  # a lambda whose KL is inside the ball
        row_at(far, phat, v, low, high, start, stop, out, spare)
        kl = divergence(phat, out, start, stop)
        if kl <= epsilon:
            break
        near = far
        far *= 4.0
        if far > 1e15 * spread:
            return far, np.inf, kl
    value_far, value_near = np.log(max(kl, 1e-300) / epsilon), 1.0
    if near == 0.0:
        near = far
        for _ in range(200):
            near *= 0.25
            row_at(near, phat, v, low, high, start, stop, out, spare)
            value_near = np.log(max(divergence(phat, out, start, stop), 1e-300) / epsilon)
            if value_near > 0.0 or near < 1e-15 * spread:
                break
    else:
        row_at(near, phat, v, low, high, start, stop, out, spare)
        value_near = np.log(max(divergence(phat, out, start, stop), 1e-300) / epsilon)
    lam = far
    for step in range(100):  # regula falsi (Illinois) in log lambda, log KL; halving every third step
        if far <= near * (1.0 + 1e-13):
            break
        middle = np.sqrt(near * far)
        if step % 3 != 2 and np.isfinite(value_near) and value_near > value_far:
            share = value_near / (value_near - value_far)
            middle = near * (far / near) ** min(max(share, 1e-3), 1.0 - 1e-3)
        row_at(middle, phat, v, low, high, start, stop, out, spare)
        value = np.log(max(divergence(phat, out, start, stop), 1e-300) / epsilon)
        if value > 0.0:
            near, value_near = middle, value
        else:
            far, value_far = middle, value
            if value > -1e-12:
                break
    lam = far
    eta = row_at(lam, phat, v, low, high, start, stop, out, spare)
    kl = divergence(phat, out, start, stop)
    return lam, bound_above(eta, lam, epsilon, phat, v, low, high, start, stop), kl


@njit(cache=True, error_model="numpy")
def worst_rows(epsilon, phat, v, low, high, indptr, lam, out, above, kl):
    """Every row; ``lam`` holds guesses and gets the multipliers. inf in ``epsilon`` is a row without data."""
    spare = np.empty(len(phat))
    for k in range(len(indptr) - 1):
        start, stop = indptr[k], indptr[k + 1]
        if epsilon[k] == np.inf:
            eta = row_at(0.0, phat, v, low, high, start, stop, out, spare)
            above[k] = bound_above(eta, 0.0, 0.0, phat, v, low, high, start, stop)
            lam[k], kl[k] = 0.0, 0.0
        else:
            lam[k], above[k], kl[k] = worst_row(epsilon[k], phat, v, low, high, start, stop, lam[k], out, spare)
