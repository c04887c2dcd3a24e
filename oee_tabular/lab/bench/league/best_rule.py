"""Ratio of the best rule that sees the maximum-likelihood value and the simulator's.

Let x be the first less the second and b the simulator's error, over eff, so that x ~
N(b, 1) for large n. A rule delta(x) has the ratio sqrt(E (delta(x) - b)^2) /
max(min(|b|, 1), 1/2) at b. No rule has a ratio below 1.22 at every b (T. Armstrong, P.
Kline and L. Sun, Adapting to Misspecification, 2023, arXiv 2305.14265). ``floor(b)`` is
the ratio at b of the rule whose worst ratio is least. An estimator that sees more than
the value, such as where the log differs from the simulator, can be below it.
"""

from __future__ import annotations

import numpy as np

from oee_tabular.typing import Array, RealArrayLike

# A ratio is over max(min(RMSE of maximum likelihood, simulator's error), LEAST * eff).
LEAST = 0.5
ERRORS = np.array(
    [
        0.0,
        0.1,
        0.2,
        0.3,
        0.4,
        0.5,
        0.6,
        0.7,
        0.8,
        0.9,
        1.0,
        1.25,
        1.5,
        1.75,
        2.0,
        2.5,
        3.0,
        4.0,
        5.0,
    ]
)
FLOOR_RATIOS = np.array(
    [  # python tests/benchmarks/floor.py
        1.009,
        1.019,
        1.048,
        1.093,
        1.153,
        1.224,
        1.086,
        0.991,
        0.922,
        0.869,
        0.827,
        0.933,
        1.027,
        1.103,
        1.160,
        1.217,
        1.222,
        1.214,
        1.224,
    ]
)


def floor(error: RealArrayLike) -> Array:
    """Return the ratio of the best rule where the simulator's error is ``error`` eff.

    From 5 on it is that of 5.

    Examples
    --------
    >>> floor(np.array([0.0, 0.5, 1.0, 3.0, 50.0])).round(2).tolist()
    [1.01, 1.22, 0.83, 1.22, 1.22]
    """
    return np.asarray(np.interp(np.abs(error), ERRORS, FLOOR_RATIOS))
