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
neither (the default)
    The quadratic log-linear class where both samples have at least 8 (k + 6)^2 points, k = d (d + 3) / 2 (d = 1: 512, 2: 968,
    3: 1800), and a score test of its fit with 6 Gaussian bumps (of the kind of [3]) does not refuse it at level 0.2; else the
    kernel class. The test costs about a hundredth of the kernel fit, which is made only after a refusal.

References: [1] T. Kanamori, S. Hido and M. Sugiyama, A least-squares approach to direct importance estimation, JMLR 10, 2009.
[2] A. Dalalyan and A. Tsybakov, Aggregation by exponential weighting, sharp PAC-Bayesian bounds and sparsity, Machine Learning
72, 2008. [3] K. Chwialkowski, A. Ramdas, D. Sejdinovic and A. Gretton, Fast two-sample testing with analytic representations
of probability measures, NeurIPS 2015.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._threads import one_thread
from oee_tabular.ratio.features import Kernel
from oee_tabular.ratio.samples.kernel import fit_kernel
from oee_tabular.ratio.samples.log_linear import fit_log_linear, sample_tilt, score_test
from oee_tabular.ratio.samples.result import SampleRatio, sample_points


@one_thread
def density_ratio_samples(
    x_p: object,
    x_q: object,
    *,
    features: Callable[[Array], Any] | str | None = None,
    kernel: str | Kernel | None = None,
    n_centers: int = 100,
    seed: Seed = 0,
) -> SampleRatio:
    """The ratio of the density of ``x_p`` to that of ``x_q``.

    Parameters
    ----------
    x_p, x_q : (n,) or (n, d) samples
    features : the log-linear class: "linear" (x), "quadratic" (x, then all x_i x_j with i <= j, which has the ratio of any two
        Gaussians), both of standardised x; or a function of (n, d) points giving (n,) or (n, k) features
    kernel : the kernel class: "gaussian", or a function of (n, d) and (m, d) points giving an (n, m) array
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
    With neither class named, the quadratic one is taken unless a test of its fit refuses it or the samples are small for it,
    then the Gaussian kernel; ``method`` says which. The quadratic so chosen gives no more at new points than its largest
    ratio at the two samples.

    Cost: log-linear O(n k^2) a Newton step, of which there are about 6; kernel O(n_centers^2 (n_p + n_q)) for each of 7
    bandwidths, once for all ridges.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x_p, x_q = rng.normal(1, 1, (2000, 1)), rng.normal(0, 1, (2000, 1))
    >>> fit = density_ratio_samples(x_p, x_q, features="linear")
    >>> round(float(fit.details["theta"][0]), 1), fit.gap < 1e-9  # of x, standardised: 1 in truth
    (1.0, True)
    """
    p, q = sample_points(x_p, "x_p"), sample_points(x_q, "x_q")
    if p.shape[1] != q.shape[1]:
        raise ValueError(f"x_p and x_q must have one dimension; they have {p.shape[1]} and {q.shape[1]}")
    for points, name in ((p, "x_p"), (q, "x_q")):
        if np.abs(points).max() > 1e150:
            raise ValueError(
                f"{name} must be below 1e150, so that floats hold its squares; it reaches {np.abs(points).max():g}"
            )
    if features is not None and kernel is not None:
        raise ValueError("one of features and kernel must be given, not both")
    if features is not None:
        return fit_log_linear(p, q, features)
    n_centers, generator = _checks.positive_integer(n_centers, "n_centers"), _checks.generator(seed)
    if kernel is not None:
        return fit_kernel(p, q, kernel, n_centers, generator)
    return _quadratic_or_kernel(p, q, n_centers, generator)


def _quadratic_or_kernel(p: Array, q: Array, n_centers: int, generator: np.random.Generator) -> SampleRatio:
    """The default: the quadratic class unless it is too large for the samples, not to be relied on, or refused.

    The level of 0.2 is high because a false refusal costs time and little accuracy, a missed one accuracy. The chi-square law
    and small errors of theta need (k + 6)^2 / n to be small.
    """
    n, d = min(len(p), len(q)), p.shape[1]
    if n < 8 * (d * (d + 3) // 2 + 6) ** 2:
        return fit_kernel(p, q, "gaussian", n_centers, generator)
    p_value, tilt = 0.0, sample_tilt(p, q, "quadratic", capped=True)
    if not len(tilt.lost) and tilt.collinear is None and tilt.beyond < 0.0 and tilt.fit.gap < 1e-9:
        p_value = score_test(tilt, d)
    fit = tilt.fit if p_value > 0.2 else fit_kernel(p, q, "gaussian", n_centers, generator)
    fit.details["p_value"] = p_value
    return fit
