"""The conditional exponential tilt of the simulator: few parameters, every row.

    zeta_theta(s, a, s') = exp(theta . phi(s, a, s')) / sum_s'' P(s'' | s, a) exp(theta . phi(s, a, s''))

normalised in each row by construction. theta minimises the KL risk over this class, which is the negative log-likelihood
of the counts, plus a unit Gaussian penalty on the standardised coordinates (worth one observation; it keeps theta finite
where the counts alone do not):

    f(theta) = sum_k n_k log Z_k(theta) - sum_x n_x theta . phi_x + 1/2 |theta|^2,

smooth and strongly convex. Newton's method; since f is 1-strongly convex, f(theta) - min f <= |grad f|^2 / 2 certifies the
answer. The class, exponential tilting, is Efron and Tibshirani's [1].

Reference: [1] B. Efron and R. Tibshirani, Using specially designed exponential families for density estimation, Annals of
Statistics 24(6), 1996.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio import statements
from oee_tabular.ratio.features import feature_array
from oee_tabular.ratio.prior.neighbours import Factor
from oee_tabular.ratio.prior.strength import choose_strength
from oee_tabular.ratio.statements import TiltProgram

ENOUGH = 2.0  # nats of evidence that a theta which varies over the states must gain
DECISIVE = 5.0  # that a second number for all rows must gain


Columns = Callable[[Rows], Array]


@dataclass(frozen=True, eq=False)
class Tilt:
    """A fitted tilt.

    Attributes
    ----------
    theta : (d,) in the units of the features
    gap : bound on f(theta) - min f, divided by the number of moves (nats)
    rank : how many directions of the features differ within rows
    information : (d, d), Hessian of f
    evidence : integral of exp(-f) over theta by Laplace's approximation, as a logarithm (nats); f = 0 at theta = 0
    phi : of any rows (entries, d), centred in the simulator's rows and divided by scale (d,); coefficients : theta scale
    whole : all rows of the simulator
    """

    theta: Array
    gap: float
    rank: int
    information: Array
    evidence: float
    phi: Columns
    scale: Array
    coefficients: Array
    whole: Rows

    def at(self, rows: Rows) -> tuple[Array, Array]:
        """(entries,) the tilted rows, and the scores (entries, d): phi less its mean under the tilt."""
        phi = self.phi(rows)
        model, _ = rows.tilt(phi @ self.coefficients)
        return model, phi - rows.spread(rows.mean(model, phi))

    @property
    def ratio(self) -> Array:
        """zeta_theta on the simulator's entries."""
        return np.asarray(self.at(self.whole)[0] / self.whole.weights)


class TiltRisk:
    """f(theta) = sum_k n_k ln Z_k(theta) - sum_x n_x theta . phi_x + 1/2 sum_j precision_j theta_j^2 and its derivatives.

    The one objective of every tilt of rows: ``ratio.prior.selection`` weighs the counts, ``ratio.prior.local_tilt`` adds
    departures to the parameters.

    Parameters
    ----------
    rows : those that the log has visited; counts : (entries,) their counts; phi : (entries, d), centred; precision : (d,)
    """

    def __init__(self, rows: Rows, counts: Array, phi: Array, precision: Array) -> None:
        self.rows, self.counts, self.phi, self.precision = rows, counts, phi, precision
        self.n = rows.sums(counts)
        self.pulled = counts @ phi

    def exponent(self, theta: Array) -> Array:
        """theta . phi."""
        return np.asarray(self.phi @ theta)

    def penalty(self, theta: Array) -> float:
        """The term of the parameters alone."""
        return 0.5 * float(self.precision @ theta**2)

    def value(self, theta: Array) -> tuple[float, Array]:
        """f, and the rows under the tilt."""
        exponent = self.exponent(theta)
        model, log_normalizer = self.rows.tilt(exponent)
        return float(self.n @ log_normalizer - self.counts @ exponent) + self.penalty(theta), model

    def slopes(self, theta: Array, model: Array) -> tuple[Array, Any]:
        """f' and f''."""
        mean = self.rows.mean(model, self.phi)
        scores = self.phi - self.rows.spread(mean)
        hessian = (scores * (model * self.rows.spread(self.n))[:, None]).T @ scores + np.diag(self.precision)
        return self.n @ mean - self.pulled + self.precision * theta, hessian

    def factor(self, hessian: Any) -> Factor:
        """Of f'', for steps: enormous counts would drown what the penalty alone determines, collinear features."""
        return Factor(hessian + 1e-12 * np.trace(hessian) * np.eye(len(hessian)))

    def bound(self, gradient: Array) -> float:
        """f - min f where the gradient is ``gradient``: f'' less the penalty's is positive semidefinite."""
        return 0.5 * float(np.sum(gradient**2 / self.precision))

    def by_cvxpy(self, solver: str) -> Array:
        """theta by a cvxpy solver, which is handed features of one scale: theta sqrt(precision) is as large for each."""
        root = np.sqrt(self.precision)
        program = TiltProgram(self.counts, np.log(self.rows.weights), self.phi / root, self.rows.indptr)
        return statements.solve_tilt(program, solver=solver) / root


class Minimum(NamedTuple):
    """The minimiser of a ``TiltRisk``, f there, the rows, f'', its factor, and the bound on f less its minimum."""

    theta: Array
    value: float
    model: Array
    hessian: Any
    factor: Factor
    gap: float

    @property
    def evidence(self) -> float:
        """ln of the integral of exp(-f) over theta by Laplace's approximation, but for its prior's constant."""
        return -self.value - 0.5 * float(np.linalg.slogdet(self.hessian)[1])


def minimise(risk: TiltRisk, start: Array, solver: str = "dual") -> Minimum:
    """Newton's method with backtracking from ``start``, to rounding; or a cvxpy solver's minimiser with our bound."""
    theta = start if solver == "dual" else risk.by_cvxpy(solver)
    value, model = risk.value(theta)
    last, total = np.inf, float(risk.n.sum())
    for _ in range(100):
        gradient, hessian = risk.slopes(theta, model)
        factor = risk.factor(hessian)
        step = -factor.solve(gradient)
        decrement, size = float(-gradient @ step), max(1.0, abs(value), total)
        if (
            solver != "dual" or decrement <= 1e-24 * size or 1e-12 * size > decrement > 0.25 * last
        ):  # only rounding is left
            break
        last = decrement
        slack = 1e-13 * size if decrement < 1e-9 * size else 0.0  # what rounding may add to a fall that it hides
        length = 1.0
        while length > 1e-12:
            trial, found = risk.value(theta + length * step)
            if trial <= value - 1e-4 * length * decrement + slack:
                break
            length *= 0.5
        else:
            break
        theta, value, model = theta + length * step, trial, found
    return Minimum(theta, value, model, hessian, factor, risk.bound(gradient))


def fit_default_tilt(observed: Array, simulator: FiniteMDP, *, solver: str = "dual", whole: Rows | None = None) -> Tilt:
    """phi = log P, and (log P)^2 beside it where that gains 5 nats of evidence: a second number for rows of three values.

    With (log P)^2 the tilted row is P^(1 + theta_1 + theta_2 log P) / Z: most probable moves and least probable ones need
    not change by one power. The evidence is that of the Dirichlet rows around the tilt (``choose_strength``), which
    forgives a tilt the kinds of rows that it misses, less ln |f''| / 2 + |theta|^2 / 2. Five nats (odds of 150), since the
    second number also bends the rows that one power fits.
    """
    whole = Rows.of(simulator) if whole is None else whole
    visited = whole.select(whole.sums(observed) > 0)
    counts = observed[visited.entries]
    one = _fit(counts, visited, _powers(1), whole, solver)
    two = _fit(counts, visited, _powers(2), whole, solver)
    if two.evidence < one.evidence + DECISIVE:
        return one
    first, second = (_dirichlet_evidence(tilt, counts, visited) for tilt in (one, two))
    return two if second > first + DECISIVE else one


def _powers(most: int) -> Columns:
    """log P, and its square."""

    def columns(rows: Rows) -> Array:
        logs = np.log(rows.weights)
        return np.column_stack([logs, logs * logs][:most])

    return columns


def _dirichlet_evidence(tilt: Tilt, counts: Array, rows: Rows) -> float:
    score = choose_strength(counts, tilt.at(rows)[0], rows).score
    size = float(np.linalg.slogdet(tilt.information)[1]) + float(tilt.coefficients @ tilt.coefficients)
    return score - 0.5 * size


def fit_tilt(
    observed: Array, simulator: FiniteMDP, features: object = None, *, solver: str = "dual", whole: Rows | None = None
) -> Tilt:
    """Fit theta to counts on the simulator's entries, by Newton's method ("dual") or by a cvxpy solver.

    Warns where features are collinear within rows, with their rank; the penalty then picks the smallest theta.
    Cost: O(visited entries d^2) a step, about ten steps, and a pass over all. ``whole``: ``Rows.of(simulator)``, where known.
    """
    whole = Rows.of(simulator) if whole is None else whole
    visited = whole.select(whole.sums(observed) > 0)
    counts = observed[visited.entries]
    if features is None:
        return _fit(counts, visited, _powers(1), whole, solver)
    given = feature_array(features, simulator)
    return _fit(counts, visited, lambda rows: given[rows.entries], whole, solver, warn=True)


def _fit(counts: Array, visited: Rows, columns: Columns, whole: Rows, solver: str, *, warn: bool = False) -> Tilt:
    """theta of features (entries, d), which are standardised over all rows."""
    sums: Any = 0.0
    largest = 1.0
    for rows in whole.blocks():
        each = rows.center(columns(rows))
        sums = sums + (each * rows.weights[:, None]).T @ each
        largest = max(largest, float(np.abs(each).max(initial=0.0)))
    gram = sums / len(whole)
    scale = np.sqrt(np.diag(gram))
    scale = np.where(scale > 1e-12 * largest, scale, np.inf)  # constant: no use
    d = len(scale)
    rank = _rank(gram / np.outer(scale, scale), d, warn=warn)

    def phi(rows: Rows) -> Array:
        return np.asarray(rows.center(columns(rows)) / scale)

    found = minimise(TiltRisk(visited, counts, phi(visited), np.ones(d)), np.zeros(d), solver)
    gap = found.gap / max(float(counts.sum()), 1.0)
    return Tilt(found.theta / scale, gap, rank, found.hessian, found.evidence, phi, scale, found.theta, whole)


def _rank(gram: Array, d: int, *, warn: bool) -> int:
    """Independent directions within rows; log P may have none (a simulator of even rows), which is no fault of the caller."""
    eigenvalues = np.linalg.eigvalsh(gram)
    rank = int(np.sum(eigenvalues > 1e-10 * max(float(eigenvalues.max()), 1e-300)))
    if rank < d and warn:
        _checks.warn(
            f"features should be linearly independent within rows; they have rank {rank} of {d} (the smallest parameters "
            "that fit are taken)"
        )
    return rank
