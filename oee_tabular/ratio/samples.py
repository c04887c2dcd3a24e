"""The ratio of two densities from two samples of points, for those who know KLIEP and uLSIF.

"log-linear" (``features``)
    g(x) = exp(theta . phi(x)) / mean_q exp(theta . phi), the exponential tilt of the sample of q; theta minimises the KL risk
    -mean_p log g plus |theta|^2 / (2 n) on standardised features. Normalised on q by construction; certified.
"kernel" (``kernel``)
    g(x) = sum_j w_j k(x, c_j) over centres c_j of the sample of p; w minimises the least-squares risk
    mean_q g^2 / 2 - mean_p g + ridge/2 |w|^2 (uLSIF [1]), in closed form. Each pair of a bandwidth and a ridge has its exact
    leave-one-out risk R, in closed form too: with M = sum_q k k' + (n - 1) ridge I, leaving q_i out gives the value
    (n - 1) k_i' M^-1 h / (1 - k_i' M^-1 k_i) at q_i. g is the mean of the pairs' fits with weights that go as exp(-n R)
    (exponential weighting [2]: the one pair of least risk is a noisy choice), 2 / n = 1 / n_p + 1 / n_q.

References: [1] T. Kanamori, S. Hido and M. Sugiyama, A least-squares approach to direct importance estimation, JMLR 10, 2009.
[2] A. Dalalyan and A. Tsybakov, Aggregation by exponential weighting, sharp PAC-Bayesian bounds and sparsity, Machine Learning
72, 2008.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.ratio.features import Kernel, gaussian, gram, warn_of_rank


@dataclass(frozen=True, eq=False)
class SampleRatio:
    """A fitted ratio g = dP/dQ of densities.

    Attributes
    ----------
    p_ratio, q_ratio : g at the two samples
    gap : bound on the risk less its minimum (nats for "log-linear", squared units for "kernel": the largest of its pairs)
    method : "log-linear" or "kernel"
    details : theta, of the features (of (x - center) / scale for the words, both given); or centers, the leave-one-out score
        and the share of each pair, bandwidth and ridge of the pair of least score, and the weights for each bandwidth used
    """

    p_ratio: Array
    q_ratio: Array
    gap: float
    method: str
    _function: Callable[[Array], Array] = field(repr=False)
    _dimension: int = field(repr=False)
    details: dict[str, Any] = field(default_factory=dict)

    def at(self, x: Any) -> Array:
        """g at new points, (n,) or (n, d)."""
        points = _points(x, "x")
        if points.shape[1] != self._dimension:
            raise ValueError(
                f"x must have points of dimension {self._dimension}, as x_p has; they have dimension {points.shape[1]}"
            )
        return self._function(points)


def density_ratio_samples(
    x_p: Any,
    x_q: Any,
    *,
    features: Callable[[Array], Any] | str | None = None,
    kernel: str | Kernel | None = None,
    n_centers: int = 100,
    seed: Any = 0,
) -> SampleRatio:
    """The ratio of the density of ``x_p`` to that of ``x_q``.

    Parameters
    ----------
    x_p, x_q : (n,) or (n, d) samples
    features : the log-linear class: "linear" (x), "quadratic" (x, then all x_i x_j with i <= j, which has the ratio of any two
        Gaussians), both of standardised x; or a function of (n, d) points giving (n,) or (n, k) features
    kernel : "gaussian" (the default where no features are given), or a function of (n, d) and (m, d) points giving an
        (n, m) array: the kernel class
    n_centers, seed : centres drawn from the distinct points of x_p for the kernel class

    Raises
    ------
    ValueError
        Samples of different dimension, with nan, or too small; features of the wrong length; both classes asked for; samples
        so far apart that the log-linear class extrapolates to a ratio above 1e12 times the size of x_q.

    Warns
    -----
    UserWarning
        Features that are collinear on x_q, or constant there but not on x_p (not used); ratios above 1e3 times x_q's size.

    Notes
    -----
    Cost: log-linear O(n k^2) a Newton step; kernel O(n_centers^2 (n_p + n_q)) for each bandwidth, once for all ridges.
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


def _log_linear(p: Array, q: Array, features: Callable[[Array], Any] | str) -> SampleRatio:
    from oee_tabular.kernels.loglinear import column_statistics, newton

    phi, details = _feature_function(q, features)
    at_p, at_q = phi(p), phi(q)
    center, spread, size = column_statistics(at_q)
    level = 1e-12 * size
    used = spread > level
    lost = np.flatnonzero(~used & (np.abs(at_p - center).max(axis=0) > level))
    if len(lost):
        warnings.warn(
            f"features must vary on x_q to be used; features[:, {lost[0]}] is constant there and not on x_p"
            + (f" ({len(lost)} such features in all)" if len(lost) > 1 else ""),
            stacklevel=3,
        )
    scale = np.where(used, spread, np.inf)
    at_p, at_q = (at_p - center) / scale, (at_q - center) / scale
    if used.any():
        warn_of_rank(at_q[:, used], where=" on x_q")
    theta, gap, log_mean = newton(np.ascontiguousarray(at_q), at_p.mean(axis=0), 1.0 / len(p))
    log_p, q_ratio = at_p @ theta - log_mean, np.exp(at_q @ theta - log_mean)
    far = int(np.argmax(log_p))
    beyond = log_p[far] - np.log(len(q))  # no g that is normalised on x_q is above len(q) there
    if beyond > np.log(1e3):
        text = f"x_q must cover x_p; the features extrapolate to a ratio of exp({log_p[far]:.3g}) at x_p[{far}]"
        if beyond > np.log(1e12):
            raise ValueError(text)
        warnings.warn(text, stacklevel=3)

    def ratio(x: Array) -> Array:
        log_ratio = (phi(x) - center) / scale @ theta - log_mean
        return np.asarray(np.exp(np.minimum(log_ratio, 700.0)))  # exp of more is not a float

    details = {"theta": theta / scale, **details}
    return SampleRatio(np.exp(log_p), q_ratio / q_ratio.mean(), gap, "log-linear", ratio, p.shape[1], details)


def _feature_function(
    q: Array, features: Callable[[Array], Any] | str
) -> tuple[Callable[[Array], Array], dict[str, Any]]:
    """The features as a checked function of points, and what the words make of x first: (x - center) / scale."""
    function, details = features, {}
    if not callable(function):
        _checks.one_of(features, "features", ("linear", "quadratic"))
        from oee_tabular.kernels.loglinear import column_statistics

        center, scale, size = column_statistics(q)
        scale = np.where(scale > 1e-12 * size, scale, 1.0)
        details = {"center": center, "scale": scale}
        first, second = np.triu_indices(q.shape[1] if features == "quadratic" else 0)

        def function(x: Array) -> Array:
            z = (x - center) / scale
            return np.concatenate([z, z[:, first] * z[:, second]], axis=1) if len(first) else z

        return function, details  # finite, of the right shape

    def phi(x: Array) -> Array:
        array = _checks.float_array(function(x), "features", ndim=(1, 2))
        if len(array) != len(x):
            raise ValueError(f"features must give one row a point; they give {len(array)} for {len(x)}")
        _checks.require_finite(array, "features")
        return array.reshape(len(x), -1)

    return phi, details


def _kernel(p: Array, q: Array, kernel: str | Kernel, n_centers: int, seed: Any) -> SampleRatio:
    distinct = np.sort(np.unique(p, axis=0, return_index=True)[1])
    chosen = _checks.generator(seed).permutation(distinct)[:n_centers]
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
    ridges = np.logspace(-3, 1, 13)
    fits, values = {}, {}
    for h, function in kernels.items():
        if h is None:
            at = np.concatenate([gram(function, x, centers) for x in (p, q)])
        else:
            at = np.exp(distances / (-2.0 * h**2))
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
