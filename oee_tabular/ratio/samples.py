"""The ratio of two densities from two samples of points, for those who know KLIEP and uLSIF.

"log-linear" (``features``)
    g(x) = exp(theta . phi(x)) / mean_q exp(theta . phi), the exponential tilt of the sample of q; theta minimises the KL risk
    -mean_p log g plus |theta|^2 / (2 n) on standardised features. Normalised on q by construction; certified.
"kernel" (``kernel``)
    g(x) = sum_j w_j k(x, c_j) over centres c_j of the sample of p; w minimises the least-squares risk
    mean_q g^2 / 2 - mean_p g + ridge/2 |w|^2 (uLSIF [1]), in closed form; bandwidth and ridge by exact leave-one-out, in
    closed form too: with M = sum_q k k' + (n - 1) ridge I, leaving q_i out gives (n - 1) k_i' M^-1 h / (1 - k_i' M^-1 k_i).

Reference: [1] T. Kanamori, S. Hido and M. Sugiyama, A least-squares approach to direct importance estimation, JMLR 10, 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.ratio.features import Kernel, gaussian, gram


@dataclass(frozen=True, eq=False)
class SampleRatio:
    """A fitted ratio g = dP/dQ of densities.

    Attributes
    ----------
    p_ratio, q_ratio : g at the two samples
    gap : bound on the risk less its minimum (nats for "log-linear", squared units for "kernel")
    method : "log-linear" or "kernel"
    details : theta; or bandwidth, ridge, centers, and the leave-one-out score of each pair tried
    """

    p_ratio: Array
    q_ratio: Array
    gap: float
    method: str
    _function: Callable[[Array], Array] = field(repr=False)
    details: dict[str, Any] = field(default_factory=dict)

    def at(self, x: Any) -> Array:
        """g at new points, (n,) or (n, d)."""
        return self._function(_points(x, "x"))


def density_ratio_samples(
    x_p: Any,
    x_q: Any,
    *,
    features: Callable[[Array], Any] | None = None,
    kernel: str | Kernel | None = None,
    n_centers: int = 100,
    seed: Any = 0,
) -> SampleRatio:
    """The ratio of the density of ``x_p`` to that of ``x_q``.

    Parameters
    ----------
    x_p, x_q : (n,) or (n, d) samples
    features : function of (n, d) points giving (n,) or (n, k) features: the log-linear class
    kernel : "gaussian" (the default where no features are given), or a function of (n, d) and (m, d) points giving an
        (n, m) array: the kernel class
    n_centers, seed : centres drawn from x_p for the kernel class

    Raises
    ------
    ValueError
        Samples of different dimension, with nan, or too small; features of the wrong length; both classes asked for.

    Notes
    -----
    Cost: log-linear O(n k^2) a Newton step; kernel O(n_centers^2 (n_p + n_q)) for each bandwidth.
    """
    p, q = _points(x_p, "x_p"), _points(x_q, "x_q")
    if p.shape[1] != q.shape[1]:
        raise ValueError(f"x_p and x_q must have one dimension; they have {p.shape[1]} and {q.shape[1]}")
    if features is not None and kernel is not None:
        raise ValueError("one of features and kernel must be given, not both")
    if features is not None:
        return _log_linear(p, q, features)
    return _kernel(
        p, q, "gaussian" if kernel is None else kernel, _checks.positive_integer(n_centers, "n_centers"), seed
    )


def _points(value: Any, name: str) -> Array:
    array = _checks.float_array(value, name, ndim=(1, 2))
    _checks.require_finite(array, name)
    if array.size == 0:
        raise ValueError(f"{name} must have at least one point; it is empty")
    points = array.reshape(len(array), -1)
    if len(points) < 2 and name != "x":
        raise ValueError(f"{name} must have at least 2 points; it has {len(points)}")
    return points


def _log_linear(p: Array, q: Array, features: Callable[[Array], Any]) -> SampleRatio:
    def phi(x: Array) -> Array:
        array = _checks.float_array(features(x), "features", ndim=(1, 2))
        if len(array) != len(x):
            raise ValueError(f"features must give one row a point; they give {len(array)} for {len(x)}")
        _checks.require_finite(array, "features")
        return array.reshape(len(x), -1)

    at_p, at_q = phi(p), phi(q)
    center, scale = at_q.mean(axis=0), at_q.std(axis=0)
    scale = np.where(scale > 1e-12 * (1.0 + np.abs(center)), scale, np.inf)
    aim = ((at_p - center) / scale).mean(axis=0)
    standard = (at_q - center) / scale
    penalty = 1.0 / len(p)

    def risk(theta: Array) -> tuple[float, Array, float]:
        exponent = standard @ theta
        top = float(exponent.max())
        weights = np.exp(exponent - top)
        log_mean = top + float(np.log(weights.mean()))
        return log_mean - float(aim @ theta) + 0.5 * penalty * float(theta @ theta), weights / weights.sum(), log_mean

    theta = np.zeros(standard.shape[1])
    value, weights, log_mean = risk(theta)
    gradient = weights @ standard - aim
    for _ in range(100):
        mean = weights @ standard
        gradient = mean - aim + penalty * theta
        spread = standard - mean
        hessian = (spread * weights[:, None]).T @ spread + penalty * np.eye(len(theta))
        step = -np.linalg.solve(hessian, gradient)
        decrement = float(-gradient @ step)
        if decrement < 1e-22:
            break
        length, blur = 1.0, 1e-13 if decrement < 1e-9 else 0.0  # what rounding may add to a fall that it hides
        while length > 1e-12 and risk(theta + length * step)[0] > value - 1e-4 * length * decrement + blur:
            length *= 0.5
        if length <= 1e-12:
            break
        theta = theta + length * step
        value, weights, log_mean = risk(theta)
    gap = float(gradient @ gradient) / (2.0 * penalty)

    def ratio(x: Array) -> Array:
        return np.asarray(np.exp((phi(x) - center) / scale @ theta - log_mean))

    return SampleRatio(ratio(p), ratio(q), gap, "log-linear", ratio, {"theta": theta / scale})


def _kernel(p: Array, q: Array, kernel: str | Kernel, n_centers: int, seed: Any) -> SampleRatio:
    chosen = _checks.generator(seed).permutation(len(p))[: min(n_centers, len(p))]
    centers = p[np.sort(chosen)]
    if isinstance(kernel, str):
        _checks.one_of(kernel, "kernel", ("gaussian",))
        together = np.concatenate([p, q])
        size = float(np.sqrt(together.var(axis=0).sum())) or 1.0
        kernels = {float(h): gaussian(float(h)) for h in size * np.logspace(-0.5, 0.75, 7)}
    else:
        kernels = {float("nan"): kernel}
    ridges = np.logspace(-2, 1, 10)
    best, scores = (np.inf, 0.0, 0.0, np.zeros(0)), {}
    for bandwidth, function in kernels.items():
        at_p, at_q = (gram(function, x, centers) for x in (p, q))
        for ridge, score in zip(ridges, _leave_one_out(at_p, at_q, ridges), strict=True):
            scores[bandwidth, float(ridge)] = score
            if score < best[0]:
                matrix = at_q.T @ at_q / len(q) + ridge * np.eye(len(centers))
                best = (score, bandwidth, float(ridge), np.linalg.solve(matrix, at_p.mean(axis=0)))
    _, bandwidth, ridge, weights = best
    function = kernels[bandwidth]
    at_p, at_q = (gram(function, x, centers) for x in (p, q))
    slope = at_q.T @ (at_q @ weights) / len(q) - at_p.mean(axis=0) + ridge * weights

    def ratio(x: Array) -> Array:
        return np.maximum(gram(function, x, centers) @ weights, 0.0)

    details = {"bandwidth": bandwidth, "ridge": ridge, "centers": centers, "weights": weights, "scores": scores}
    return SampleRatio(ratio(p), ratio(q), float(slope @ slope) / (2.0 * ridge), "kernel", ratio, details)


def _leave_one_out(at_p: Array, at_q: Array, ridges: Array) -> Array:
    """mean_i g_-i(q_i)^2 / 2 - mean_j g_-j(p_j) for each ridge, from one eigendecomposition."""
    n_q, n_p = len(at_q), len(at_p)
    values, vectors = np.linalg.eigh(at_q.T @ at_q)
    values = np.maximum(values, 0.0)
    in_p, in_q = at_p @ vectors, at_q @ vectors
    mean = in_p.mean(axis=0)
    scores = []
    for ridge in ridges:
        left = values + (n_q - 1) * ridge
        inverse = in_q / left
        off = np.maximum(1.0 - (inverse * in_q).sum(axis=1), 1e-12)
        without_q = (n_q - 1) * (inverse @ mean) / off
        full = in_p / (values / n_q + ridge)
        without_p = (n_p * (full @ mean) - (full * in_p).sum(axis=1)) / (n_p - 1)
        scores.append(0.5 * float(np.mean(without_q**2)) - float(without_p.mean()))
    return np.array(scores)
