"""The log-linear class of ``samples``: the fit, its certificate, and the test that may refuse the quadratic one."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio.features import warn_of_rank
from oee_tabular.ratio.samples._log_linear import newton
from oee_tabular.ratio.samples.result import SampleRatio


class SampleTilt(NamedTuple):
    """A log-linear fit, the standardised features (k, n) of both samples, and what is to be said against it."""

    fit: SampleRatio
    at_p: Array
    at_q: Array
    lost: IntArray  # the features that are constant on q and not on p
    collinear: Array | None  # the features used, (n, k), where they seem so
    farthest: int  # the point of p of the largest ratio
    log_ratio: float  # log g there
    beyond: float  # the same less log n_q: no g that is normalised on x_q is above n_q there


def fit_log_linear(p: Array, q: Array, features: Callable[[Array], Any] | str) -> SampleRatio:
    """The class as asked for; what is to be said against its features is an error or a warning."""
    tilt = sample_tilt(p, q, features)
    if len(tilt.lost):
        warnings.warn(
            f"features must vary on x_q to be used; features[:, {tilt.lost[0]}] is constant there and not on x_p"
            + (f" ({len(tilt.lost)} such features in all)" if len(tilt.lost) > 1 else ""),
            stacklevel=4,
        )
    if tilt.collinear is not None:
        warn_of_rank(tilt.collinear, where=" on x_q")
    if tilt.beyond > math.log(1e3):
        text = (
            f"x_q must cover x_p; the features extrapolate to a ratio of exp({tilt.log_ratio:.3g}) "
            f"at x_p[{tilt.farthest}]"
        )
        if tilt.beyond > math.log(1e12):
            raise ValueError(text)
        warnings.warn(text, stacklevel=4)
    return tilt.fit


def sample_tilt(p: Array, q: Array, features: Callable[[Array], Any] | str, *, capped: bool = False) -> SampleTilt:
    """The fit; where ``capped`` its function gives no more than the largest ratio at the two samples."""
    phi, details = _feature_function(q, features)
    at_p, at_q = phi(p), phi(q)
    center, spread = _mean_and_deviation(at_q)
    used, lost = spread > 0.0, np.zeros(0, dtype=np.int64)
    if not used.all():
        moves = np.abs(at_p - center[:, None]).max(axis=1) > 1e-12 * np.abs(center)
        lost = np.flatnonzero(moves & ~used)
    scale = np.where(used, spread, np.inf)
    for points in (at_p, at_q):
        points -= center[:, None]
        points /= scale[:, None]
    values = np.linalg.eigvalsh(at_q @ at_q.T)[len(used) - used.sum() :]
    collinear = at_q[used].T if len(values) and values[0] <= 1e-10 * values[-1] else None
    theta, _, log_mean, weights = newton(at_q, at_p.mean(axis=1), 1.0 / len(p))
    gap = _gap(theta, weights, at_p, at_q)
    log_p, q_ratio, slope = theta @ at_p - log_mean, weights * len(q), theta / scale
    farthest = int(log_p.argmax())
    log_ratio = float(log_p[farthest])
    limit = max(log_ratio, math.log(q_ratio.max())) if capped else 700.0  # exp of more is not a float

    def ratio(x: Array) -> Array:
        values = phi(x) - center[:, None]
        values *= slope[:, None]
        return np.asarray(np.exp(np.minimum(values.sum(axis=0) - log_mean, limit)))

    details = {"theta": slope, **details}
    p_ratio = np.exp(np.minimum(log_p, 700.0))
    fit = SampleRatio(p_ratio, q_ratio, gap, "log-linear", ratio, p.shape[1], details)
    return SampleTilt(fit, at_p, at_q, lost, collinear, farthest, log_ratio, log_ratio - math.log(len(q)))


def _gap(theta: Array, weights: Array, at_p: Array, at_q: Array) -> float:
    """|f'|^2 / (2 penalty), a bound on the risk less its minimum: the larger of theta's own and of the handed-over weights'.

    The penalty 1 / n_p makes f strongly convex. Nothing here is the solver's.
    """
    n_p, exponents = at_p.shape[1], theta @ at_q
    own = np.exp(exponents - exponents.max())
    slopes = at_q @ np.column_stack([own / own.sum(), weights]) - (at_p.mean(axis=1) - theta / n_p)[:, None]
    with np.errstate(over="ignore"):
        return float((slopes**2).sum(axis=0).max() * n_p / 2.0)


def score_test(tilt: SampleTilt, d: int) -> float:
    """The p-value of "the ratio is in the class", by means over p and over q weighted by g of Gaussian bumps [3].

    The 6 bumps psi stand at points of both samples; their bandwidth is half a standard deviation times sqrt(d). Less their
    regression on the features under g q, so that theta's error cancels, the difference of means r has the covariance
    V = cov_p(psi) / n_p + mean_q (g psi)^2 / n_q, and r' V^-1 r is chi-square of as many degrees as V has directions.
    """
    n_p, n_q = tilt.at_p.shape[1], tilt.at_q.shape[1]
    weights = tilt.fit.q_ratio / n_q
    z_p, z_q = tilt.at_p[:d], tilt.at_q[:d]
    places = np.concatenate([z_p[:, :: -(-n_p // 3)], z_q[:, :: -(-n_q // 3)]], axis=1)
    psi_p, psi_q = _bumps(z_p, places), _bumps(z_q, places)
    off = tilt.at_q - (tilt.at_q @ weights)[:, None]
    off *= weights
    slopes = np.linalg.solve(off @ tilt.at_q.T + np.eye(len(off)) / n_p, off @ psi_q.T).T
    psi_p -= slopes @ tilt.at_p
    psi_q -= slopes @ tilt.at_q
    center = psi_q @ weights
    rise = psi_p.sum(axis=1) / n_p - center
    psi_p -= (center + rise)[:, None]
    psi_q -= center[:, None]
    psi_q *= weights
    values, vectors = np.linalg.eigh(psi_p @ psi_p.T / n_p**2 + psi_q @ psi_q.T)
    known = values > 1e-6 * values[-1]
    statistic = ((rise @ vectors)[known] ** 2 / values[known]).sum()
    return float(special.gammaincc(known.sum() / 2.0, statistic / 2.0))


def _mean_and_deviation(x: Array) -> tuple[Array, Array]:
    """Of each row of (k, n) numbers; a deviation that is only rounding is 0."""
    center = x[:, 0] + (x - x[:, :1]).mean(axis=1)
    deviation = np.sqrt(((x - center[:, None]) ** 2).mean(axis=1))
    return center, np.where(deviation <= 1e-12 * np.abs(center), 0.0, deviation)


def _bumps(z: Array, places: Array) -> Array:
    """exp(-2 |z - c|^2 / d) for the columns of z (d, n) and of places (d, m), as (m, n)."""
    values = places.T @ z
    values -= 0.5 * (z * z).sum(axis=0)
    values -= 0.5 * (places * places).sum(axis=0)[:, None]
    values *= 4.0 / len(z)
    return np.asarray(np.exp(values, out=values))


def _feature_function(
    q: Array, features: Callable[[Array], Any] | str
) -> tuple[Callable[[Array], Array], dict[str, Any]]:
    """The features of points as new (k, n) rows, checked, and what the words make of x first: (x - center) / scale."""
    if not callable(features):
        _checks.one_of(features, "features", ("linear", "quadratic"))
        center, spread = _mean_and_deviation(q.T)
        scale = np.where(spread > 0.0, spread, 1.0)

        def standard(x: Array) -> Array:
            return np.array((x - center).T / scale[:, None], order="C")

        def products(x: Array) -> Array:
            z = standard(x)
            return np.concatenate([z, *(z[j] * z[j:] for j in range(len(z)))])

        return {"linear": standard, "quadratic": products}[str(features)], {"center": center, "scale": scale}

    def phi(x: Array) -> Array:
        array = _checks.float_array(features(x), "features", ndim=(1, 2))
        if len(array) != len(x):
            raise ValueError(f"features must give one row a point; they give {len(array)} for {len(x)}")
        _checks.require_finite(array, "features")
        return np.array(array.reshape(len(x), -1).T, order="C")

    return phi, {}
