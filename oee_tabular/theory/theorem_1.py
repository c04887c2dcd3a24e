"""Theorem V.1 of the paper, on the error of a ratio of distributions, and true bounds.

The file also has divergences, risks, and ``Sides``, the two sides of a statement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio.dual import check_distributions
from oee_tabular.typing import Array, RealArrayLike


@checked()
@dataclass(frozen=True)
class Sides:
    """Hold both sides of an inequality ``left <= right``, without any tolerance.

    Attributes
    ----------
    left : float
        The left side, which may be inf.
    right : float
        The right side, which may be inf.

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
        """Return whether left <= right."""
        return self.left <= self.right

    @property
    def ratio(self) -> float:
        """Return left / right, by which factor the inequality fails if it is above 1.

        It is 0 where left is 0.
        """
        if self.left == 0.0:
            return 0.0
        return self.left / self.right if self.right > 0.0 else math.inf


def renyi_divergence(p: RealArrayLike, q: RealArrayLike, order: float) -> float:
    """Compute the Renyi divergence D_a(P || Q) of two distributions.

    Parameters
    ----------
    p : array_like of shape (n,)
        The distribution P: nonnegative counts or probabilities, scaled to sum to 1.
    q : array_like of shape (n,)
        The distribution Q, likewise.
    order : float
        The order a > 0; 1 gives KL(P || Q), and inf the logarithm of the largest
        p/q.

    Returns
    -------
    float
        The divergence in nats. It is inf where p > 0 = q somewhere and a >= 1, and for
        a < 1 where p and q have no common support.

    Notes
    -----
    D_a(P || Q) = log(sum p^a q^{1-a}) / (a - 1) grows with a [1]_. exp(D_2) =
    E_Q (p/q)^2 = 1 + chi^2.

    References
    ----------
    .. [1] van Erven and Harremoes, IEEE Trans. Information Theory 60(7), 2014.

    Examples
    --------
    >>> [
    ...     round(renyi_divergence([3, 1], [1, 1], a), 6)
    ...     for a in (0.5, 1, 2, float("inf"))
    ... ]
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
    # for orders near 1 the sum is near 1, and its distance from 1 is more accurate
    if np.abs(powers).max() < 0.5 and unshared_mass < 0.5:
        log_sum = math.log1p(float(ps[shared] @ np.expm1(powers)) - unshared_mass)
    else:
        log_sum = float(special.logsumexp(powers + np.log(ps[shared])))
    return max(0.0, log_sum / (a - 1.0))


def divergence_terms(p: Array, q: Array) -> Array:
    """Compute the terms p log(p/q) - p + q >= 0 of a divergence, entry by entry.

    They have full relative precision for q near p. A term is q where p = 0, and inf
    where q = 0 < p.
    """
    terms: Array = np.asarray(special.kl_div(p, q))
    near = (p > 0.0) & (np.abs(q - p) < 0.5 * p)
    change = (q[near] - p[near]) / p[near]
    terms[near] = p[near] * (change - np.log1p(change))
    return terms


def estimation_bound(
    n: int, mu: float, nu: float, confidence: float, renyi: float, constant: float
) -> float:
    """Compute the right-hand side of Theorem V.1 (eq. 5.1), for a given constant.

    Parameters
    ----------
    n : int
        The number of samples from each of P and Q.
    mu : float
        The upper end of the box of ratios, in (1, inf).
    nu : float
        The lower end of the box of ratios, in (0, 1).
    confidence : float
        1 - delta, in (0, 1).
    renyi : float
        D_inf(P || Q) >= 0 in nats, which is ``renyi_divergence(p, q, inf)``; it may be
        inf.
    constant : float
        K > 0, which the paper takes to be universal.

    Returns
    -------
    float
        The bound on the square of the sup error of ghat, with probability
        ``confidence``.

    See Also
    --------
    universal_constant_counterexample : Why no universal K exists.
    sup_error_bound : A true bound with its constants.

    Notes
    -----
    The bound is K e^{D_inf(P || Q)} (sqrt(1/n) (mu + max(log mu, -log nu)) +
    sqrt(2 log(1/delta) / n)). The paper calls both this bound and its root M(G, delta).

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
    g: RealArrayLike,
    p: RealArrayLike,
    q: RealArrayLike,
    *,
    n: int,
    mu: float,
    nu: float,
    confidence: float,
    constant: float,
) -> Sides:
    """Compute both sides of Theorem V.1 on tables.

    Parameters
    ----------
    g : array_like of shape (n_cells,)
        The estimate of p/q, in [nu, mu].
    p : array_like of shape (n_cells,)
        The distribution P, nonnegative and scaled to sum to 1; for a pair of MDPs the
        target's occupancy of transitions.
    q : array_like of shape (n_cells,)
        The distribution Q, likewise; the simulator's occupancy of transitions.
    n : int
        The number of samples from each of P and Q.
    mu : float
        The upper end of the box of ratios, in (1, inf).
    nu : float
        The lower end of the box of ratios, in (0, 1).
    confidence : float
        1 - delta, in (0, 1).
    constant : float
        K > 0, which the paper takes to be universal.

    Returns
    -------
    Sides
        The largest squared error of g where p + q > 0, and ``estimation_bound``. Both
        are inf where p > 0 = q.

    See Also
    --------
    estimation_bound : The right-hand side from its constants.

    Examples
    --------
    >>> estimation_sides(
    ...     [1.4, 0.6],
    ...     [3, 1],
    ...     [2, 2],
    ...     n=100,
    ...     mu=10.0,
    ...     nu=0.1,
    ...     confidence=0.95,
    ...     constant=1.0,
    ... ).holds
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


@checked()
@dataclass(frozen=True)
class EstimationCounterexample(Sides):
    """Hold a counterexample to Theorem V.1 with K = 1; ``ratio`` is the K it needs.

    Attributes
    ----------
    left : float
        The squared sup error, (mu - 1)^2.
    right : float
        The bound of Theorem V.1 at K = 1.
    probability_flat : float
        The probability that neither sample has the atom, so that every ghat there
        minimises the empirical risk; above 0.05.
    probability_forced : float
        The probability that only P's sample has the atom, so that ghat = mu is the only
        minimiser; above 0.05.

    Examples
    --------
    >>> example = universal_constant_counterexample(100)
    >>> example.holds, example.left, round(example.right, 3)
    (False, 81.0, 1.475)
    """

    probability_flat: float
    probability_forced: float


@suggest_keywords
def universal_constant_counterexample(
    n: int, *, mu: float = 10.0, nu: float = 0.1, confidence: float = 0.95
) -> EstimationCounterexample:
    """Construct a counterexample to the universal constant of Theorem V.1.

    Parameters
    ----------
    n : int
        The number of samples from each of P and Q, at least 2.
    mu : float, default 10.0
        The upper end of the box of ratios, in (1, inf).
    nu : float, default 0.1
        The lower end of the box of ratios, in (0, 1).
    confidence : float, default 0.95
        1 - delta, in (0, 1).

    Returns
    -------
    EstimationCounterexample
        The squared sup error (mu - 1)^2, the bound of Theorem V.1 at K = 1, and the
        probabilities of such an error.

    Notes
    -----
    P = Q = (1/n, 1 - 1/n), so g* = 1 and D_inf = 0, and with constant probability the
    sup error is mu - 1, whatever n is. The bound is of order n^-1/2, so the K that is
    needed grows as sqrt(n).

    Examples
    --------
    >>> [
    ...     round(universal_constant_counterexample(n).ratio)
    ...     for n in (100, 10_000, 1_000_000)
    ... ]
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
    """Compute a true bound on the sup error of a table of ratios, phat/qhat.

    It takes the place of Theorem V.1.

    Parameters
    ----------
    n : int
        The number of samples from each of P and Q.
    p_min : float
        The smallest positive probability of a cell under P, in [0, 1].
    q_min : float
        The smallest positive probability of a cell under Q, in [0, 1].
    n_cells : int
        The number of cells of the table.
    mu : float
        The largest p/q, at least 1.
    confidence : float
        1 - delta, in (0, 1).

    Returns
    -------
    float
        The bound on the error itself, not its square, with probability ``confidence``.
        It is inf where e_q >= 1: a cell that Q's sample misses is then not excluded.

    See Also
    --------
    estimation_bound : The bound of the paper.

    Notes
    -----
    The bound is mu (e_p + e_q) / (1 - e_q) with e_p = sqrt(3 log(4 n_cells / delta) /
    (n p_min)), and e_q likewise. Chernoff's exp(-n p e^2 / 3), for each cell and each
    side, holds for e <= 1; where e_p would be larger it solves n p e^2 / (2 + e) =
    log(4 n_cells / delta) instead.

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
    if e_q >= 1.0:
        return math.inf
    return largest * (e_p + e_q) / (1.0 - e_q)


def _chernoff(log_term: float, mean: float) -> float:
    """Solve n p e^2 / 3 = log_term for e, where mean = n p.

    If that e is above 1, 2 + e takes the place of 3.
    """
    if mean == 0.0:
        return math.inf
    small = math.sqrt(3.0 * log_term / mean)
    if small <= 1.0:
        return small
    return (log_term + math.sqrt(log_term**2 + 8.0 * log_term * mean)) / (2.0 * mean)


def excess_risk(g: RealArrayLike, p: RealArrayLike, q: RealArrayLike) -> Sides:
    """Compute the excess risk of a ratio, directly and as an expectation.

    Parameters
    ----------
    g : array_like of shape (n,)
        The ratio, nonnegative.
    p : array_like of shape (n,)
        The distribution P: nonnegative counts or probabilities, scaled to sum to 1.
    q : array_like of shape (n,)
        The distribution Q, likewise.

    Returns
    -------
    Sides
        The difference of the two risks, and the expectation, which is accurate for g
        near g* as well. They are equal up to rounding, and inf where g = 0 < p or
        q = 0 < p.

    Notes
    -----
    L(g) - L(g*) = E_P[phi(g/g*)], plus the sum of q g where p = 0, with the risk
    L(g) = sum q g - sum p log g and phi(u) = u - 1 - log u.

    Examples
    --------
    >>> sides = excess_risk([1.0, 1.0], [3, 1], [2, 2])
    >>> round(sides.left, 12) == round(sides.right, 12) == round(
    ...     renyi_divergence([3, 1], [2, 2], 1), 12
    ... )
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


@suggest_keywords
def squared_error_sides(
    g: RealArrayLike, p: RealArrayLike, q: RealArrayLike, *, mu: float | None = None
) -> Sides:
    """Compute both sides of the bound on the squared error by the excess risk.

    Parameters
    ----------
    g : array_like of shape (n,)
        The ratio, nonnegative.
    p : array_like of shape (n,)
        The distribution P: nonnegative counts or probabilities, scaled to sum to 1.
    q : array_like of shape (n,)
        The distribution Q, likewise.
    mu : float, optional
        A number that is at least g and g* where p > 0; None means the largest of them.

    Returns
    -------
    Sides
        E_P (g - g*)^2, and 2 mu^2 (L(g) - L(g*)).

    See Also
    --------
    excess_risk : The risk on the right-hand side.

    Notes
    -----
    A bound on the risk controls the error in L2(P), and not in the sup norm.

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
    bound = largest
    if mu is not None:
        bound = _checks.number_in(mu, "mu", 0.0, math.inf, infinite=True)
    if bound < largest:
        raise ArgumentError(
            "mu",
            f"must be at least g and p/q, which reach {largest:g}; it is {bound:g}",
        )
    left = float(ps[ps > 0.0] @ (values - best) ** 2)
    return Sides(left, 0.0 if risk == 0.0 else 2.0 * bound * bound * risk)


def _check_same_length(g: Array, p: Array) -> None:
    """Check that g has as many entries as p."""
    if g.shape != p.shape:
        raise ArgumentError(
            "g", f"must have the length of p, {len(p)}; it has {len(g)}"
        )


def _ratio(p: Array, q: Array) -> Array:
    """Compute p/q, which is inf where q = 0 < p, and 1 where p = q = 0.

    Nothing depends on the latter.
    """
    return np.divide(p, q, out=np.where(p > 0.0, np.inf, 1.0), where=q > 0.0)


def check_box(nu: float, mu: float) -> tuple[float, float]:
    """Check that nu is in (0, 1) and mu above 1, and return them in this order."""
    lower = _checks.number_in(nu, "nu", 0.0, 1.0, open_ends=True)
    return lower, _checks.number_in(mu, "mu", 1.0, math.inf, open_ends=True)


def check_ratio(value: object, name: str, nu: float, mu: float) -> Array:
    """Check that the values of a ratio are in [nu, mu], and return their array."""
    array = _checks.float_array(value, name, ndim=1)
    bad = np.flatnonzero(~((array >= nu) & (array <= mu)))
    if bad.size:
        raise ArgumentError(
            f"{name}[{bad[0]}]",
            f"must be in [nu, mu] = [{nu:g}, {mu:g}]; it is {array[bad[0]]}",
        )
    return array
