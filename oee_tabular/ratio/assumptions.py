"""The paper's assumptions about a ratio, checked on a given pair: nu < 1 < mu, nu <= p/q <= mu, and the support."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks


@dataclass(frozen=True)
class Assumptions:
    """What holds of p, q and the box [lower, upper].

    Attributes
    ----------
    box_contains_one : nu < 1 < mu (Assumption V.1)
    inside : nu <= p/q <= mu wherever q > 0 (Assumption V.2 for the class of all functions in the box)
    supported : p = 0 wherever q = 0
    below, above, unsupported : how many entries miss each
    smallest, largest : of p/q where q > 0
    renyi_infinity : D_inf(p || q) = log max p/q, infinite without support

    Examples
    --------
    >>> found = check_assumptions([3, 1], [2, 2], lower=0.1, upper=1.2)
    >>> found.inside, found.above, found.largest, found.supported
    (False, 1, 1.5, True)
    """

    box_contains_one: bool
    inside: bool
    supported: bool
    below: int
    above: int
    unsupported: int
    smallest: float
    largest: float
    renyi_infinity: float

    def __str__(self) -> str:
        box = "holds" if self.box_contains_one else "fails"
        inside = "holds" if self.inside else f"fails ({self.below} entries below, {self.above} above)"
        support = "holds" if self.supported else f"fails at {self.unsupported} entries"
        return (
            f"nu < 1 < mu: {box}; nu <= p/q <= mu: {inside}, p/q from {self.smallest:.4g} to {self.largest:.4g}; support: "
            f"{support}; D_inf = {self.renyi_infinity:.4g}"
        )


def check_assumptions(p: ArrayLike, q: ArrayLike, *, lower: float, upper: float) -> Assumptions:
    """Whether assumptions V.1 and V.2 hold of the distributions p, q (counts are scaled) and the box [lower, upper].

    Parameters
    ----------
    p, q : (n,) nonnegative; counts or probabilities, each is scaled to sum to 1
    lower, upper : the paper's nu >= 0 and mu, inf allowed

    Examples
    --------
    >>> print(check_assumptions([3, 1], [2, 2], lower=0.1, upper=1.2))
    nu < 1 < mu: holds; nu <= p/q <= mu: fails (0 entries below, 1 above), p/q from 0.5 to 1.5; support: holds; D_inf = 0.4055
    """
    ps, qs = _checks.distribution_pair(p, q)
    nu = _checks.number_in(lower, "lower", 0.0, np.inf)
    mu = _checks.number_in(upper, "upper", 0.0, np.inf, infinite=True)
    ratio = ps[qs > 0] / qs[qs > 0]
    unsupported = int(np.sum((qs == 0) & (ps > 0)))
    below, above = int(np.sum(ratio < nu)), int(np.sum(ratio > mu))
    return Assumptions(
        box_contains_one=nu < 1.0 < mu,
        inside=below == above == 0,
        supported=unsupported == 0,
        below=below,
        above=above,
        unsupported=unsupported,
        smallest=float(ratio.min()),
        largest=float(ratio.max()),
        renyi_infinity=float("inf") if unsupported else float(np.log(ratio.max())),
    )
