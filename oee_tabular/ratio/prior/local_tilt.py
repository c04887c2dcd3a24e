"""A tilt that varies over the states: one theta for all of them, and smooth departures from it.

    zeta(s, a, s') proportional to exp((theta + u_s) . phi(s, a, s')) in each row,

u smooth over the simulator's graph (``neighbours``). theta and u minimise

    f(theta, u) = -log likelihood of the counts + 1/2 |theta|^2 + lambda/2 sum_j u_j' Q u_j        (j: the features)

which is convex. lambda = infinity is one theta for all states (``tilt``); it is chosen by the evidence, the integral of
exp(-f) over theta and u (Laplace's approximation [1]):

    -f(min) + 1/2 ln |lambda Q x I| - 1/2 ln |f''(min)|.

Newton's method with sparse factors; f'' - diag(I, lambda Q x I) is positive semidefinite, so g' diag(I, lambda Q x I)^-1 g / 2
at a point with gradient g bounds f there less its minimum.

Reference: [1] H. Rue, S. Martino, N. Chopin, Approximate Bayesian inference for latent Gaussian models, JRSS B 71(2), 2009.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, IntArray
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio import statements
from oee_tabular.ratio.prior.neighbours import REST, Factor, Neighbours, neighbours
from oee_tabular.ratio.prior.tilt import ENOUGH, Minimum, Tilt, TiltRisk, minimise
from oee_tabular.ratio.statements import TiltProgram

SMALLEST, LARGEST = -2.0, 6.0  # log10 of lambda
HOPELESS = 20.0  # nats below the best at which the search stops
DENSE = 128  # unknowns up to which the Hessian is dense


@dataclass(frozen=True, eq=False)
class LocalTilt:
    """Departures from one tilt.

    Attributes
    ----------
    smoothness : lambda
    gain : evidence (nats) less that of one theta for all states (with the unit prior, or one as wide as u gives the level)
    curve : (lambda, gain) of every lambda tried
    theta : (S, d), theta + u_s, of the standardised features
    gap : bound on f less its minimum, divided by the number of moves
    information : f'', csc or, of few unknowns, dense
    graph : the groups of states that share u
    tilt : the one for all states
    """

    smoothness: float
    gain: float
    curve: list[tuple[float, float]]
    theta: Array
    gap: float
    information: sparse.csc_array | Array
    graph: Neighbours
    tilt: Tilt

    def at(self, rows: Rows) -> tuple[Array, sparse.csr_array]:
        """(entries,) the tilted rows, and the scores, csr (entries, (K + 1) d): d log zeta / d (u, theta)."""
        phi = self.tilt.phi(rows)
        model, _ = rows.tilt(np.einsum("ij,ij->i", phi, rows.spread(self.theta[rows.state])))
        group, nodes = rows.spread(self.graph.group[rows.state]), self.graph.penalty.shape[0]
        return model, _scatter(phi - rows.spread(rows.mean(model, phi)), group, nodes)

    @property
    def whole(self) -> Rows:
        """All rows of the simulator."""
        return self.tilt.whole

    @property
    def ratio(self) -> Array:
        """zeta on the simulator's entries."""
        return np.asarray(self.at(self.whole)[0] / self.whole.weights)


class LocalRisk(TiltRisk):
    """f at (u, theta), flat: u of the first group, of the second, ..., then theta; ``smoothness`` is lambda."""

    def __init__(self, rows: Rows, counts: Array, phi: Array, graph: Neighbours, smoothness: float) -> None:
        super().__init__(rows, counts, phi, np.ones(phi.shape[1]))
        self.graph, self.smoothness, self.group = graph, smoothness, graph.group[rows.state]
        self.nodes, self.d = graph.penalty.shape[0], phi.shape[1]
        self.size = self.nodes * self.d
        self.aim = self._by_group(rows.mean(counts, phi))
        self.prior = sparse.csc_array(sparse.kron(graph.penalty, sparse.eye_array(self.d), format="csc"))
        self.prior_factor = Factor(self.prior)
        self._dense = self.prior.toarray() if self.size + self.d <= DENSE else None
        blocks = np.arange(self.size).reshape(self.nodes, self.d)
        self._row = np.repeat(blocks, self.d, axis=1).reshape(-1)
        self._column = np.tile(blocks, (1, self.d)).reshape(-1)

    def at(self, smoothness: float) -> LocalRisk:
        """The same at another lambda."""
        other = copy(self)
        other.smoothness = smoothness
        return other

    def level(self, parameters: Array) -> Array:
        """u + theta of each group, (K, d)."""
        return np.asarray(parameters[: self.size].reshape(self.nodes, self.d) + parameters[self.size :])

    def _by_group(self, rows: Array) -> Array:
        """(rows, ...) summed over the rows of each group."""
        flat = rows.reshape(len(rows), -1)
        sums = [np.bincount(self.group, flat[:, j], self.nodes) for j in range(flat.shape[1])]
        return np.column_stack(sums).reshape(self.nodes, *rows.shape[1:])

    def exponent(self, parameters: Array) -> Array:
        """(theta + u_s) . phi."""
        return np.asarray(np.einsum("ij,ij->i", self.phi, self.rows.spread(self.level(parameters)[self.group])))

    def penalty(self, parameters: Array) -> float:
        """1/2 |theta|^2 + lambda/2 u' (Q x I) u."""
        u, theta = parameters[: self.size], parameters[self.size :]
        return 0.5 * float(theta @ theta) + 0.5 * self.smoothness * float(u @ (self.prior @ u))

    def slopes(self, parameters: Array, model: Array) -> tuple[Array, Any]:
        """f' and f'', and 1e-12 of the information on the diagonals of u and theta: (u + c, theta - c) at enormous counts."""
        mean = self.rows.mean(model, self.phi)
        scores = self.phi - self.rows.spread(mean)
        mass = model * self.rows.spread(self.n)
        information = np.empty((self.nodes, self.d, self.d))
        for i in range(self.d):  # one column at a time: (entries, d) of memory
            information[:, i, :] = self._by_group(self.rows.mean(mass * scores[:, i], scores))
        pull = self._by_group(self.n[:, None] * mean) - self.aim
        u, theta = parameters[: self.size], parameters[self.size :]
        gradient = np.concatenate([pull.reshape(-1) + self.smoothness * (self.prior @ u), pull.sum(axis=0) + theta])
        return gradient, self._hessian(information)

    def _hessian(self, information: Array) -> sparse.csc_array | Array:
        """From the Fisher information by group (K, d, d)."""
        eye, whole = np.eye(self.d), information.sum(axis=0)
        corner = whole + (1.0 + 1e-12 * np.trace(whole)) * eye
        raised = information + 1e-12 * np.trace(information, axis1=1, axis2=2)[:, None, None] * eye
        if self._dense is not None:
            dense = np.empty((self.size + self.d, self.size + self.d))
            dense[: self.size, : self.size] = self.smoothness * self._dense
            dense[self._row, self._column] += raised.reshape(-1)
            dense[: self.size, self.size :] = information.reshape(self.size, self.d)
            dense[self.size :, : self.size] = dense[: self.size, self.size :].T
            dense[self.size :, self.size :] = corner
            return dense
        diagonal = sparse.csc_array((raised.reshape(-1), (self._row, self._column)), self.prior.shape)
        edge = sparse.csc_array(information.reshape(self.size, self.d))
        return sparse.csc_array(
            sparse.block_array([[diagonal + self.smoothness * self.prior, edge], [edge.T, corner]], format="csc")
        )

    def factor(self, hessian: object) -> Factor:
        """Of f'', which has its slack already."""
        return Factor(hessian)

    def bound(self, gradient: Array) -> float:
        """gradient' diag(lambda Q x I, I)^-1 gradient / 2."""
        of_u, rest = gradient[: self.size], gradient[self.size :]
        return 0.5 * float(rest @ rest + of_u @ self.prior_factor.solve(of_u) / self.smoothness)

    def evidence(self, found: Minimum) -> float:
        """The integral of exp(-f) over theta and u, as a logarithm."""
        prior = self.d * (self.nodes * np.log(self.smoothness) + self.graph.log_determinant)
        return float(-found.value + 0.5 * (prior - found.factor.log_determinant()))

    def by_cvxpy(self, solver: str) -> Array:
        """u and theta by a cvxpy solver."""
        features = _scatter(self.phi, self.rows.spread(self.group), self.nodes)
        prior = sparse.block_diag([self.smoothness * self.prior, sparse.eye_array(self.d)], format="csc")
        weights = np.log(self.rows.weights)
        program = TiltProgram(self.counts, weights, features, self.rows.indptr, sparse.csc_array(prior))
        return statements.solve_tilt(program, solver=solver)


def fit_local_tilt(
    observed: Array,
    simulator: FiniteMDP,
    tilt: Tilt,
    smoothness: float | None,
    *,
    solver: str = "dual",
    graph: Neighbours | None = None,
) -> LocalTilt | None:
    """The departures with the most evidence, or those of a given smoothness; None where one theta for all does as well.

    ``tilt`` is the best one for all states, ``graph`` that of ``neighbours``, where it is known. Cost: about ten values of
    lambda, four Newton steps each, a step O(visited entries d^2) and a sparse factor of (K + 1) d unknowns, K <= 1024 / d.
    """
    rows = tilt.whole.select(tilt.whole.sums(observed) > 0)
    graph = neighbours(simulator, width=len(tilt.coefficients)) if graph is None else graph
    risk = LocalRisk(rows, observed[rows.entries], tilt.phi(rows), graph, np.inf)
    search = _Search(risk, tilt.coefficients)
    if smoothness is None:
        fit = search.best_of_all()
        if fit is None:
            return None
    else:
        fit = search.attempt(float(np.log10(smoothness)), smoothness)
    risk, found = risk.at(fit.smoothness), fit.found
    if solver != "dual":
        found = minimise(risk, found.theta, solver)
    theta = risk.level(found.theta)[graph.group]
    gap = found.gap / max(float(risk.n.sum()), 1.0)
    return LocalTilt(fit.smoothness, fit.gain, sorted(search.curve), theta, gap, found.hessian, graph, tilt)


class _Fit(NamedTuple):
    gain: float
    smoothness: float
    found: Minimum


class _Search:
    """For lambda, from the smoothest downwards by decades, then around the best; each fit starts where the last ended."""

    def __init__(self, risk: LocalRisk, theta: Array) -> None:
        self.risk, self.theta = risk, theta
        self.at = np.concatenate([np.zeros(risk.size), theta])
        self.one_for_all = self._one_tilt(1.0)
        self.curve: list[tuple[float, float]] = []
        self.best: _Fit | None = None

    def _one_tilt(self, precision: float) -> float:
        """The evidence of one theta for all states under a Gaussian prior of this precision."""
        risk = self.risk
        found = minimise(TiltRisk(risk.rows, risk.counts, risk.phi, np.full(risk.d, precision)), self.theta)
        return float(found.evidence + 0.5 * risk.d * np.log(precision))

    def attempt(self, level: float, smoothness: float | None = None) -> _Fit:
        """The fit at lambda = 10^level, and what it gains on one theta for all.

        The level of u + theta has the prior precision tau = lambda REST S / (1 + lambda REST S) <= 1: departures must not be
        credited with what a wider prior of the level alone would gain, so that one theta may have it as well.
        """
        smoothness = 10.0**level if smoothness is None else smoothness
        risk = self.risk.at(smoothness)
        found = minimise(risk, self.at)
        wide = smoothness * REST * len(risk.graph.group)
        alone = max(self.one_for_all, self._one_tilt(wide / (1.0 + wide)))
        fit = _Fit(risk.evidence(found) - alone, smoothness, found)
        self.at = found.theta
        self.curve.append((smoothness, fit.gain))
        if self.best is None or fit.gain > self.best.gain:
            self.best = fit
        return fit

    def best_of_all(self) -> _Fit | None:
        """None where no departures gain enough."""
        for level in np.arange(LARGEST, SMALLEST - 0.5, -1.0):
            fit = self.attempt(float(level))
            assert self.best is not None
            if fit.gain < max(self.best.gain, 0.0) - HOPELESS:
                break
        assert self.best is not None
        if self.best.gain < ENOUGH - HOPELESS:
            return None
        for width in (0.5, 0.25):
            center = float(np.log10(self.best.smoothness))
            for offset in (width, -width):
                self.at = self.best.found.theta
                self.attempt(center + offset)
        return self.best if self.best.gain >= ENOUGH else None


def _scatter(values: Array, group: IntArray, nodes: int) -> sparse.csr_array:
    """(entries, d) values in the columns of their group and again in the last d."""
    entries, d = values.shape
    columns = np.hstack([group[:, None] * d + np.arange(d), np.broadcast_to(nodes * d + np.arange(d), (entries, d))])
    data = np.hstack([values, values])
    indptr = np.arange(0, 2 * d * entries + 1, 2 * d)
    return sparse.csr_array((data.reshape(-1), columns.reshape(-1), indptr), (entries, (nodes + 1) * d))
