"""Both sides of a statement; Theorem V.1 of the paper, on the error of g = p/q, beside
what is true; divergences and risks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio.dual import check_distributions
from oee_tabular.typing import Array


@dataclass(frozen=True)
class Sides:
    """Both sides of an inequality ``left <= right``, each as it was computed (no
    tolerance).

    Attributes
    ----------
    left, right : float, inf allowed

    Examples
    --------
    >>> sides = Sides(3.0, 2.0)
    >>> sides.holds, sides.ratio
    (False, 1.5)
    """

    left: float
    right: float

    @property
    def holds(self) -> bool:
        """left <= right."""
        return self.left <= self.right

    @property
    def ratio(self) -> float:
        """left / right: above 1 where the inequality fails, by that factor; 0 where
        left is 0.
        """
        if self.left == 0.0:
            return 0.0
        return self.left / self.right if self.right > 0.0 else math.inf


def renyi_divergence(p: ArrayLike, q: ArrayLike, order: float) -> float:
    """D_a(p || q) = log(sum p^a q^{1-a}) / (a - 1) in nats; a = 1: KL(p || q), a = inf:
    log max p/q.

    Parameters
    ----------
    p, q : (n,) nonnegative; counts or probabilities, each is scaled to sum to 1
    order : a > 0, inf included

    Notes
    -----
    It grows with a. inf where p > 0 = q somewhere and a >= 1, and for a < 1 where p and
    q have nothing in common. exp(D_2) = E_q (p/q)^2 = 1 + chi^2. Source: van Erven and
    Harremoes, IEEE Trans. Information Theory 60(7), 2014.

    Examples
    --------
    >>> [round(renyi_divergence([3, 1], [1, 1], a), 6) for a in (0.5, 1, 2, float("inf"))]
    [0.069336, 0.130812, 0.223144, 0.405465]
    """
    ps, qs = check_distributions(p, q)
    a = _checks.number_in(order, "order", 0.0, math.inf, infinite=True)
    if a == 0.0:
        raise ArgumentError("order", "must be positive; it is 0")
    if a == 1.0:
        return float(np.sum(divergence_terms(ps, qs)))
    shared = (ps > 0.0) & (qs > 0.0)
    unshared_mass = float(np.sum(ps[qs == 0.0]))
    if not shared.any() or (a > 1.0 and unshared_mass > 0.0):
        return math.inf
    log_ratio = np.log(ps[shared]) - np.log(qs[shared])
    if math.isinf(a):
        return max(0.0, float(log_ratio.max()))
    powers = (a - 1.0) * log_ratio
    # the sum is near 1: its distance from 1, for orders near 1
    if np.abs(powers).max() < 0.5 and unshared_mass < 0.5:
        log_sum = math.log1p(float(ps[shared] @ np.expm1(powers)) - unshared_mass)
    else:
        log_sum = float(special.logsumexp(powers + np.log(ps[shared])))
    return max(0.0, log_sum / (a - 1.0))


def divergence_terms(p: Array, q: Array) -> Array:
    """p log(p/q) - p + q >= 0, entry by entry, to full relative precision for q near p;
    q where p = 0, inf where q = 0 < p.
    """
    terms: Array = np.asarray(special.kl_div(p, q))
    near = (p > 0.0) & (np.abs(q - p) < 0.5 * p)
    change = (q[near] - p[near]) / p[near]
    terms[near] = p[near] * (change - np.log1p(change))
    return terms


def estimation_bound(
    n: int, mu: float, nu: float, confidence: float, renyi: float, constant: float
) -> float:
    """Theorem V.1's right-hand side (eq. 5.1): of the SQUARE |ghat_n - g*|_inf^2, with
    probability ``confidence`` = 1 - delta.

    K e^{D_inf(P || Q)} (sqrt(1/n) (mu + max(log mu, -log nu)) + sqrt(2 log(1/delta) /
    n)).

    Parameters
    ----------
    n : samples from each of P and Q
    mu, nu : the box, nu in (0, 1) and mu in (1, inf)
    confidence : 1 - delta, in (0, 1)
    renyi : D_inf(P || Q) >= 0 in nats, inf allowed; ``renyi_divergence(p, q, inf)``
    constant : the paper's universal K > 0

    Notes
    -----
    No such K exists (``universal_constant_counterexample``); ``sup_error_bound`` is a
    version with its constants. The paper calls both this bound and its root M(G,
    delta).

    Examples
    --------
    >>> round(estimation_bound(100, 10.0, 0.1, 0.95, 0.0, 1.0), 4)
    1.475
    """
    samples = _checks.positive_integer(n, "n")
    lower, upper = check_box(nu, mu)
    delta = 1.0 - _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    divergence = _checks.number_in(renyi, "renyi", 0.0, math.inf, infinite=True)
    k = _checks.number_in(constant, "constant", 0.0, math.inf, open_ends=True)
    with np.errstate(over="ignore"):
        scale = float(np.exp(divergence))
    spread = (
        upper
        + max(math.log(upper), -math.log(lower))
        + math.sqrt(-2.0 * math.log(delta))
    )
    return k * scale * spread / math.sqrt(samples)


def estimation_sides(
    g: ArrayLike,
    p: ArrayLike,
    q: ArrayLike,
    *,
    n: int,
    mu: float,
    nu: float,
    confidence: float,
    constant: float,
) -> Sides:
    """Theorem 1 on tables: left = max |g - p/q|^2 where p + q > 0, right =
    ``estimation_bound``; both inf where p > 0 = q.

    Parameters
    ----------
    g : (n_cells,) in [nu, mu]
    p, q : as in ``renyi_divergence``; for a pair of MDPs their occupancies of
        transitions
    n, mu, nu, confidence, constant : as in ``estimation_bound``

    Examples
    --------
    >>> estimation_sides([1.4, 0.6], [3, 1], [2, 2], n=100, mu=10.0, nu=0.1, confidence=0.95, constant=1.0).holds
    True
    """
    ps, qs = check_distributions(p, q)
    values = check_ratio(g, "g", *check_box(nu, mu))
    _check_same_length(values, ps)
    right = estimation_bound(
        n, mu, nu, confidence, renyi_divergence(ps, qs, math.inf), constant
    )
    with np.errstate(over="ignore"):  # a square beyond floats is infinite
        return Sides(
            float(np.max(np.abs(values - _ratio(ps, qs))[ps + qs > 0.0]) ** 2), right
        )


@dataclass(frozen=True)
class EstimationCounterexample(Sides):
    """A counterexample to Theorem 1 with K = 1: ``ratio`` is the K that it would need.

    Attributes
    ----------
    probability_flat : that neither sample has the atom, so that every ghat there
        minimises the empirical risk
    probability_forced : that only P's sample has it, so that ghat = mu is the one
        minimiser; both above 0.05

    Examples
    --------
    >>> example = universal_constant_counterexample(100)
    >>> example.holds, example.left, round(example.right, 3)
    (False, 81.0, 1.475)
    """

    probability_flat: float
    probability_forced: float


def universal_constant_counterexample(
    n: int, *, mu: float = 10.0, nu: float = 0.1, confidence: float = 0.95
) -> EstimationCounterexample:
    """P = Q = (1/n, 1 - 1/n), so g* = 1 and D_inf = 0: with constant probability |ghat
    - g*|_inf = mu - 1, whatever n is.

    left = (mu - 1)^2, right = the bound of Theorem 1 at K = 1, of order n^-1/2: the K
    needed grows as sqrt(n).

    Parameters
    ----------
    n, mu, nu, confidence : as in ``estimation_bound``; n at least 2

    Examples
    --------
    >>> [round(universal_constant_counterexample(n).ratio) for n in (100, 10_000, 1_000_000)]
    [55, 549, 5491]
    >>> example = universal_constant_counterexample(1_000_000)
    >>> round(example.probability_flat, 4), round(example.probability_forced, 4)
    (0.1353, 0.2325)
    """
    samples = _checks.positive_integer(n, "n")
    if samples < 2:
        raise ArgumentError("n", f"must be at least 2; it is {samples}")
    right = estimation_bound(samples, mu, nu, confidence, 0.0, 1.0)
    unseen = math.exp(samples * math.log1p(-1.0 / samples))
    return EstimationCounterexample(
        (mu - 1.0) * (mu - 1.0), right, unseen**2, unseen * (1.0 - unseen)
    )


def sup_error_bound(
    n: int, p_min: float, q_min: float, n_cells: int, mu: float, confidence: float
) -> float:
    """A true bound in place of Theorem 1 for tables, ghat = phat/qhat, with probability
    ``confidence`` = 1 - delta.

    |ghat - g*|_inf <= mu (e_p + e_q) / (1 - e_q),   e_p = sqrt(3 log(4 n_cells / delta) / (n p_min)), e_q likewise.

    Parameters
    ----------
    n : samples from each of P and Q
    p_min, q_min : smallest positive probability of a cell, in [0, 1]
    n_cells : cells of the table
    mu : max p/q, at least 1
    confidence : 1 - delta, in (0, 1)

    Notes
    -----
    The error itself, not its square. Chernoff's exp(-n p e^2 / 3), for each cell and
    each side, holds for e <= 1; where e_p would be larger it solves n p e^2 / (2 + e) =
    log(4 n_cells / delta) instead. inf where e_q >= 1: a cell that Q's sample misses is
    then not excluded.

    Examples
    --------
    >>> round(sup_error_bound(100_000, 0.1, 0.2, 4, 1.5, 0.95), 4)
    0.1097
    """
    samples = _checks.positive_integer(n, "n")
    cells = _checks.positive_integer(n_cells, "n_cells")
    smallest = [
        _checks.number_in(x, name, 0.0, 1.0)
        for x, name in ((p_min, "p_min"), (q_min, "q_min"))
    ]
    largest = _checks.number_in(mu, "mu", 1.0, math.inf)
    delta = 1.0 - _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    log_term = math.log(4.0 * cells / delta)
    e_p, e_q = (_chernoff(log_term, samples * x) for x in smallest)
    return largest * (e_p + e_q) / (1.0 - e_q) if e_q < 1.0 else math.inf


def _chernoff(log_term: float, mean: float) -> float:
    """The e with n p e^2 / 3 = log_term, mean = n p, or with 2 + e in place of 3 where
    that e is above 1.
    """
    if mean == 0.0:
        return math.inf
    small = math.sqrt(3.0 * log_term / mean)
    return (
        small
        if small <= 1.0
        else (log_term + math.sqrt(log_term**2 + 8.0 * log_term * mean)) / (2.0 * mean)
    )


def excess_risk(g: ArrayLike, p: ArrayLike, q: ArrayLike) -> Sides:
    """L(g) - L(g*) = E_p[phi(g/g*)] (+ sum of q g where p = 0), L(g) = sum q g - sum p
    log g, phi(u) = u - 1 - log u.

    left is the difference of the two risks, right the expectation, accurate for g near
    g* as well; equal up to rounding. inf where g = 0 < p or q = 0 < p.

    Parameters
    ----------
    g : (n,) nonnegative
    p, q : as in ``renyi_divergence``

    Examples
    --------
    >>> sides = excess_risk([1.0, 1.0], [3, 1], [2, 2])
    >>> round(sides.left, 12) == round(sides.right, 12) == round(renyi_divergence([3, 1], [2, 2], 1), 12)
    True
    """
    ps, qs = check_distributions(p, q)
    values = _checks.float_array(g, "g", ndim=1)
    _checks.require_nonnegative(values, "g")
    _check_same_length(values, ps)
    right = float(np.sum(divergence_terms(ps, qs * values)))
    if math.isinf(right):
        return Sides(right, right)
    with np.errstate(invalid="ignore"):
        best = np.where(qs > 0.0, _ratio(ps, qs), 0.0)
    risks = [float(qs @ h - np.sum(special.xlogy(ps, h))) for h in (values, best)]
    return Sides(risks[0] - risks[1], right)


def squared_error_sides(
    g: ArrayLike, p: ArrayLike, q: ArrayLike, *, mu: float | None = None
) -> Sides:
    """E_p (g - g*)^2 <= 2 mu^2 (L(g) - L(g*)) where g, g* <= mu: a risk bound controls
    L2(P), not the sup norm.

    Parameters
    ----------
    g, p, q : as in ``excess_risk``
    mu : at least g and g* where p > 0; None: the largest of them

    Examples
    --------
    >>> round(squared_error_sides([1.4, 0.6], [3, 1], [2, 2]).ratio, 3)
    0.361
    """
    risk = excess_risk(g, p, q).right
    ps, qs = check_distributions(p, q)
    values = _checks.float_array(g, "g")[ps > 0.0]
    best = _ratio(ps, qs)[ps > 0.0]
    largest = float(max(values.max(), best.max()))
    bound = (
        largest
        if mu is None
        else _checks.number_in(mu, "mu", 0.0, math.inf, infinite=True)
    )
    if bound < largest:
        raise ArgumentError(
            "mu",
            f"must be at least g and p/q, which reach {largest:g}; it is {bound:g}",
        )
    left = float(ps[ps > 0.0] @ (values - best) ** 2)
    return Sides(left, 0.0 if risk == 0.0 else 2.0 * bound * bound * risk)


def _check_same_length(g: Array, p: Array) -> None:
    if g.shape != p.shape:
        raise ArgumentError(
            "g", f"must have the length of p, {len(p)}; it has {len(g)}"
        )


def _ratio(p: Array, q: Array) -> Array:
    """p/q: inf where q = 0 < p, and 1 where p = q = 0 (nothing depends on it)."""
    return np.divide(p, q, out=np.where(p > 0.0, np.inf, 1.0), where=q > 0.0)


def check_box(nu: float, mu: float) -> tuple[float, float]:
    """nu in (0, 1) and mu > 1, or ValueError."""
    lower = _checks.number_in(nu, "nu", 0.0, 1.0, open_ends=True)
    return lower, _checks.number_in(mu, "mu", 1.0, math.inf, open_ends=True)


def check_ratio(value: object, name: str, nu: float, mu: float) -> Array:
    """The values of a g as an array, or ValueError where one is outside [nu, mu]."""
    array = _checks.float_array(value, name, ndim=1)
    bad = np.flatnonzero(~((array >= nu) & (array <= mu)))
    if bad.size:
        raise ArgumentError(
            f"{name}[{bad[0]}]",
            f"must be in [nu, mu] = [{nu:g}, {mu:g}]; it is {array[bad[0]]}",
        )
    return array
