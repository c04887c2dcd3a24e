"""The kernel class of ``samples``: least squares with every leave-one-out score in closed form, averaged."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.ratio.features import Kernel, gaussian, gram
from oee_tabular.ratio.samples.result import SampleRatio


def fit_kernel(p: Array, q: Array, kernel: str | Kernel, n_centers: int, generator: np.random.Generator) -> SampleRatio:
    """Least squares over kernels at centres of p, averaged over bandwidths and ridges."""
    distinct = np.sort(np.unique(p, axis=0, return_index=True)[1])
    chosen = generator.permutation(distinct)[:n_centers]
    centers, together = p[np.sort(chosen)], np.concatenate([p, q])
    origin = np.zeros(p.shape[1]) if callable(kernel) else q.mean(axis=0)
    kernels: dict[float | None, Kernel]
    if callable(kernel):
        kernels, distances = {None: kernel}, np.zeros(0)
    else:
        _checks.one_of(kernel, "kernel", ("gaussian",))
        size = float(np.sqrt(together.var(axis=0).sum())) or 1.0
        kernels = {float(h): gaussian(float(h)) for h in size * np.logspace(-0.5, 0.75, 7)}
        distances = np.maximum(_squared_distances(together - origin, centers - origin), 0.0)
        at = np.empty_like(distances)
    ridges = np.logspace(-3, 1, 13)
    fits, values = {}, {}
    for h, function in kernels.items():
        if h is None:
            at = np.concatenate([gram(function, x, centers) for x in (p, q)])
        else:
            np.exp(np.divide(distances, -2.0 * h**2, out=at), out=at)
        fits[h] = _leave_one_out(at[: len(p)], at[len(p) :], ridges)
        values[h] = at @ fits[h].weights
    scores = np.array([fit.scores for fit in fits.values()])
    shares = np.exp((scores.min() - scores) * 2.0 / (1.0 / len(p) + 1.0 / len(q)))
    shares = np.where(shares > 1e-6 * shares.sum(), shares, 0.0)
    share = dict(zip(kernels, shares / shares.sum(), strict=True))
    used = {h: fits[h].weights @ share[h] for h in kernels if share[h].any()}

    def ratio(x: Array) -> Array:
        parts = [gram(kernels[h], x - origin, centers - origin) @ w for h, w in used.items()]
        return np.asarray(np.maximum(np.sum(parts, axis=0), 0.0))

    fitted = np.maximum(np.sum([values[h] @ share[h] for h in used], axis=0), 0.0)
    pairs = [(h, float(ridge)) for h in kernels for ridge in ridges]
    bandwidth, ridge = pairs[int(np.argmin(scores))]
    details = {
        "bandwidth": bandwidth,
        "ridge": ridge,
        "centers": centers,
        "weights": used,
        "scores": dict(zip(pairs, scores.ravel().tolist(), strict=True)),
        "shares": dict(zip(pairs, (shares / shares.sum()).ravel().tolist(), strict=True)),
    }
    gap = max(float(fits[h].gaps[share[h] > 0].max()) for h in used)
    return SampleRatio(fitted[: len(p)], fitted[len(p) :], gap, "kernel", ratio, p.shape[1], details)


def _squared_distances(x: Array, c: Array) -> Array:
    distance: Array = (x * -2.0) @ c.T
    distance += (x**2).sum(axis=1)[:, None]
    distance += (c**2).sum(axis=1)
    return distance


class _Fits(NamedTuple):
    """The fits of one bandwidth, by ridge: leave-one-out risks (r,), weights (m, r), bounds on the risk less its minimum."""

    scores: Array
    weights: Array
    gaps: Array


def _leave_one_out(at_p: Array, at_q: Array, ridges: Array) -> _Fits:
    """mean_i g_-i(q_i)^2 / 2 - mean_j g_-j(p_j), from one eigendecomposition of sum_q k k'; at_p (n_p, m), at_q (n_q, m)."""
    n_q, n_p = len(at_q), len(at_p)
    moment, mean = at_q.T @ at_q, at_p.mean(axis=0)
    values, vectors = np.linalg.eigh(moment)
    values = np.maximum(values, 0.0)[:, None]
    h = (mean @ vectors)[:, None]
    # q_i left out: the values k_i' M^-1 h and k_i' M^-1 k_i for all i and ridges are two matrix products
    inverse = 1.0 / (values + (n_q - 1) * ridges)
    in_q = at_q @ vectors
    without_q = (n_q - 1) * (in_q @ (inverse * h))
    without_q /= np.maximum(1.0 - (in_q**2) @ inverse, 1e-12)
    # p_j left out: (n_p h - k_j)' H^-1 k_j / (n_p - 1), whose mean needs the second moments of k(p_j) alone
    full = 1.0 / (values / n_q + ridges)
    squares = ((vectors.T @ (at_p.T @ at_p / n_p)) * vectors.T).sum(axis=1)
    without_p = (n_p * (h[:, 0] ** 2 @ full) - squares @ full) / (n_p - 1)
    weights = vectors @ (full * h)
    slopes = moment @ weights / n_q - mean[:, None] + ridges * weights
    return _Fits(0.5 * (without_q**2).mean(axis=0) - without_p, weights, (slopes**2).sum(axis=0) / (2.0 * ridges))
