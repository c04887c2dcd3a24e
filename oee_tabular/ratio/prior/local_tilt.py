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

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, IntArray
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import statements
from oee_tabular.ratio.prior.neighbours import REST, Factor, Neighbours, neighbours
from oee_tabular.ratio.prior.tilt import ENOUGH
from oee_tabular.ratio.program_types import TiltProgram
from oee_tabular.ratio.segments import segment_max, segment_sums, spread

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
    ratio : zeta on the simulator's entries
    theta : (S, d), theta + u_s, of the standardised features
    gap : bound on f less its minimum, divided by the number of moves
    scores : csr (entries, (K + 1) d), d log zeta / d (u, theta); information : f'', csc or, of few unknowns, dense
    """

    smoothness: float
    gain: float
    curve: list[tuple[float, float]]
    ratio: Array
    theta: Array
    gap: float
    scores: sparse.csr_array
    information: sparse.csc_array | Array


class _Risk:
    """f and its derivatives at (u, theta), from the rows that the log has visited."""

    def __init__(
        self, observed: Array, phi: Array, weights: Array, indptr: IntArray, n_actions: int, graph: Neighbours
    ):
        n_row = segment_sums(observed, indptr)
        rows = np.flatnonzero(n_row > 0)
        lengths = np.diff(indptr)
        entries = np.flatnonzero(spread(n_row > 0, indptr))
        self.total = float(n_row.sum())
        self.n_row, self.indptr = n_row[rows], np.concatenate([[0], np.cumsum(lengths[rows])])
        self.phi, self.weights, self.observed = phi[entries], weights[entries], observed[entries]
        self.graph, self.group = graph, graph.group[rows // n_actions]
        self.nodes, self.d = graph.penalty.shape[0], phi.shape[1]
        self.aim = self._by_group(segment_sums(self.observed[:, None] * self.phi, self.indptr))
        self.prior = sparse.csc_array(sparse.kron(graph.penalty, sparse.eye_array(self.d), format="csc"))
        self.prior_factor = Factor(self.prior)
        self._dense = self.prior.toarray() if (self.nodes + 1) * self.d <= DENSE else None
        blocks = np.arange(self.nodes * self.d).reshape(self.nodes, self.d)
        self._row = np.repeat(blocks, self.d, axis=1).reshape(-1)
        self._column = np.tile(blocks, (1, self.d)).reshape(-1)

    def _by_group(self, rows: Array) -> Array:
        """(rows, ...) summed over the rows of each group."""
        flat = rows.reshape(len(rows), -1)
        sums = [np.bincount(self.group, flat[:, j], self.nodes) for j in range(flat.shape[1])]
        return np.column_stack(sums).reshape(self.nodes, *rows.shape[1:])

    def value(self, u: Array, theta: Array, smoothness: float) -> tuple[float, Array]:
        """f, and the rows under the tilt."""
        local = spread((u + theta)[self.group], self.indptr)
        exponent = np.einsum("ij,ij->i", self.phi, local)
        top = segment_max(exponent, self.indptr)
        raw = self.weights * np.exp(exponent - spread(top, self.indptr))
        total = segment_sums(raw, self.indptr)
        risk = self.n_row @ (top + np.log(total)) - self.observed @ exponent + 0.5 * theta @ theta
        bend = 0.5 * smoothness * float(u.reshape(-1) @ (self.prior @ u.reshape(-1))) if np.any(u) else 0.0
        return float(risk) + bend, raw / spread(total, self.indptr)

    def slopes(self, u: Array, theta: Array, smoothness: float, model: Array) -> tuple[Array, Array]:
        """The gradient in u without and theta with its penalty's part, and the Fisher information by group (K, d, d)."""
        mean = segment_sums(model[:, None] * self.phi, self.indptr)
        scores = self.phi - spread(mean, self.indptr)
        mass = model * spread(self.n_row, self.indptr)
        information = np.empty((self.nodes, self.d, self.d))
        for i in range(self.d):  # one column at a time: (entries, d) of memory
            products = segment_sums((mass * scores[:, i])[:, None] * scores, self.indptr)
            information[:, i, :] = self._by_group(products)
        pull = self._by_group(self.n_row[:, None] * mean) - self.aim
        flat = pull.reshape(-1) + smoothness * (self.prior @ u.reshape(-1))
        return np.concatenate([flat, pull.sum(axis=0) + theta]), information

    def hessian(self, information: Array, smoothness: float) -> sparse.csc_array | Array:
        """f'' in (u, theta), of shape ((K + 1) d, (K + 1) d), and 1e-12 of the information on the diagonals of u and theta.

        Enormous counts would drown what the penalties alone determine: (u + c, theta - c), collinear features.
        """
        eye, whole = np.eye(self.d), information.sum(axis=0)
        corner = whole + (1.0 + 1e-12 * np.trace(whole)) * eye
        raised = information + 1e-12 * np.trace(information, axis1=1, axis2=2)[:, None, None] * eye
        if self._dense is not None:
            unknowns = len(self._dense)
            dense = np.empty((unknowns + self.d, unknowns + self.d))
            dense[:unknowns, :unknowns] = smoothness * self._dense
            dense[self._row, self._column] += raised.reshape(-1)
            dense[:unknowns, unknowns:] = information.reshape(unknowns, self.d)
            dense[unknowns:, :unknowns] = dense[:unknowns, unknowns:].T
            dense[unknowns:, unknowns:] = corner
            return dense
        diagonal = sparse.csc_array((raised.reshape(-1), (self._row, self._column)), self.prior.shape)
        edge = sparse.csc_array(information.reshape(self.nodes * self.d, self.d))
        return sparse.csc_array(
            sparse.block_array([[diagonal + smoothness * self.prior, edge], [edge.T, corner]], format="csc")
        )


def minimise(risk: _Risk, smoothness: float, u: Array, theta: Array) -> tuple[float, Array, Array, float]:
    """Newton from (u, theta): the evidence, u, theta, and the bound on f less its minimum."""
    value, model = risk.value(u, theta, smoothness)
    last = np.inf
    for _ in range(100):
        gradient, information = risk.slopes(u, theta, smoothness, model)
        factored = Factor(risk.hessian(information, smoothness))
        step = -factored.solve(gradient)
        decrement, size = float(-gradient @ step), max(1.0, abs(value), risk.total)
        if decrement <= 1e-24 * size or 1e-12 * size > decrement > 0.25 * last:  # no more than rounding is left
            break
        last = decrement
        blur = 1e-13 * size if decrement < 1e-9 * size else 0.0  # what rounding may add to a fall that it hides
        length, du, dt = 1.0, step[: u.size].reshape(u.shape), step[u.size :]
        while length > 1e-12:
            trial, trial_model = risk.value(u + length * du, theta + length * dt, smoothness)
            if trial <= value - 1e-4 * length * decrement + blur:
                break
            length *= 0.5
        else:
            break
        u, theta, value, model = u + length * du, theta + length * dt, trial, trial_model
    logs = risk.d * (risk.nodes * np.log(smoothness) + risk.graph.log_determinant) - factored.log_determinant()
    bend, rest = gradient[: u.size], gradient[u.size :]
    gap = 0.5 * float(rest @ rest + bend @ risk.prior_factor.solve(bend) / smoothness)
    return float(-value + 0.5 * logs), u, theta, gap


def fit_local_tilt(
    observed: Array,
    simulator: FiniteMDP,
    phi: Array,
    theta: Array,
    smoothness: float | None,
    *,
    solver: str = "dual",
) -> LocalTilt | None:
    """The departures with the most evidence, or those of a given smoothness; None where one theta for all does as well.

    ``phi`` (entries, d) standardised, centred in each row; ``theta`` (d,) the best one for all states. Cost: about ten
    values of lambda, four Newton steps each, a step O(visited entries d^2) and a sparse factor of (K + 1) d unknowns,
    K <= 1024 / d.
    """
    indptr: IntArray = simulator.transitions.indptr.astype(np.int64)
    weights = simulator.transitions.data / spread(segment_sums(simulator.transitions.data, indptr), indptr)
    graph = neighbours(simulator, width=phi.shape[1])
    risk = _Risk(observed, phi, weights, indptr, simulator.n_actions, graph)
    start = np.zeros((risk.nodes, risk.d))
    value, model = risk.value(start, theta, 0.0)
    corner = risk.slopes(start, theta, 0.0, model)[1].sum(axis=0) + np.eye(risk.d)
    one_for_all = -value - 0.5 * float(np.linalg.slogdet(corner)[1])
    if smoothness is None:
        chosen, curve = _search(risk, theta, one_for_all)
        if chosen is None:
            return None
    else:
        evidence, at, theta, gap = minimise(risk, smoothness, start, theta)
        gain = evidence - max(one_for_all, _one_tilt(risk, theta, smoothness))
        chosen, curve = (gain, smoothness, at, theta, gap), [(smoothness, gain)]
    gain, smoothness, u, theta, gap = chosen
    if solver != "dual":
        u, theta, gap = _by_cvxpy(risk, smoothness, solver)
    return _result(risk, phi, weights, indptr, simulator, u, theta, (smoothness, gain, curve, gap), observed)


_Fit = tuple[float, float, Array, Array, float]  # gain, lambda, u, theta, gap


def _one_tilt(risk: _Risk, theta: Array, smoothness: float) -> float:
    """The evidence of one theta for all states whose prior is as wide as that of the level of u + theta at this lambda.

    That level has the precision tau = lambda REST S / (1 + lambda REST S) <= 1: departures must not be credited with what a
    wider prior of the level alone would gain.
    """
    wide = smoothness * REST * len(risk.graph.group)
    tau, still = wide / (1.0 + wide), np.zeros((risk.nodes, risk.d))

    def value(at: Array) -> tuple[float, Array]:
        whole, model = risk.value(still, at, 0.0)
        return whole + 0.5 * (tau - 1.0) * float(at @ at), model

    best, model = value(theta)
    for _ in range(50):
        gradient, information = risk.slopes(still, theta, 0.0, model)
        curvature = information.sum(axis=0) + tau * np.eye(risk.d)
        slope = gradient[still.size :] + (tau - 1.0) * theta
        step, length = -np.linalg.solve(curvature, slope), 1.0
        trial, found = value(theta + step)
        while not trial <= best and length > 1e-6:
            length *= 0.5
            trial, found = value(theta + length * step)
        if not trial < best - 1e-9:
            break
        theta, best, model = theta + length * step, trial, found
    half_log = 0.5 * risk.d * float(np.log(tau)) - 0.5 * float(np.linalg.slogdet(curvature)[1])
    return float(half_log - best)


def _search(risk: _Risk, theta: Array, one_for_all: float) -> tuple[_Fit | None, list[tuple[float, float]]]:
    """From the smoothest downwards by decades, then around the best."""
    curve: list[tuple[float, float]] = []
    best: _Fit | None = None
    u, start = np.zeros((risk.nodes, risk.d)), theta

    def attempt(level: float) -> _Fit:
        nonlocal u, theta, best
        evidence, u, theta, gap = minimise(risk, 10.0**level, u, theta)
        alone = max(one_for_all, _one_tilt(risk, start, 10.0**level))
        fit = (evidence - alone, 10.0**level, u, theta, gap)
        curve.append((10.0**level, fit[0]))
        if best is None or fit[0] > best[0]:
            best = fit
        return fit

    for level in np.arange(LARGEST, SMALLEST - 0.5, -1.0):
        fit = attempt(float(level))
        assert best is not None
        if fit[0] < max(best[0], 0.0) - HOPELESS:
            break
    assert best is not None
    if best[0] < ENOUGH - HOPELESS:
        return None, sorted(curve)
    center = np.log10(best[1])
    for offset in (0.5, -0.5, 0.25, -0.25):
        if abs(offset) == 0.25:
            center = np.log10(best[1])
        u, theta = best[2], best[3]
        attempt(float(center + offset))
    return (best if best[0] >= ENOUGH else None), sorted(curve)


def _by_cvxpy(risk: _Risk, smoothness: float, solver: str) -> tuple[Array, Array, float]:
    """The same program by a cvxpy solver, with our bound on what it leaves."""
    entries, size = len(risk.phi), risk.nodes * risk.d
    features = _scatter(risk.phi, spread(risk.group, risk.indptr), risk.nodes)
    prior = sparse.block_diag([smoothness * risk.prior, sparse.eye_array(risk.d)], format="csc")
    program = TiltProgram(risk.observed, np.log(risk.weights), features, risk.indptr, penalty=prior)
    assert features.shape == (entries, size + risk.d)
    both = statements.solve_tilt(program, solver=solver)
    u, theta = both[:size].reshape(risk.nodes, risk.d), both[size:]
    _, model = risk.value(u, theta, smoothness)
    gradient, _ = risk.slopes(u, theta, smoothness, model)
    return u, theta, 0.5 * float(gradient @ Factor(sparse.csc_array(prior)).solve(gradient))


def _scatter(values: Array, group: IntArray, nodes: int) -> sparse.csr_array:
    """(entries, d) values in the columns of their group and again in the last d."""
    entries, d = values.shape
    columns = np.hstack([group[:, None] * d + np.arange(d), np.broadcast_to(nodes * d + np.arange(d), (entries, d))])
    data = np.hstack([values, values])
    indptr = np.arange(0, 2 * d * entries + 1, 2 * d)
    return sparse.csr_array((data.reshape(-1), columns.reshape(-1), indptr), (entries, (nodes + 1) * d))


def _result(
    risk: _Risk,
    phi: Array,
    weights: Array,
    indptr: IntArray,
    simulator: FiniteMDP,
    u: Array,
    theta: Array,
    found: tuple[float, float, list[tuple[float, float]], float],
    observed: Array,
) -> LocalTilt:
    """On all rows, visited or not."""
    smoothness, gain, curve, gap = found
    group = risk.graph.group
    of_entry = spread(group[np.arange(len(indptr) - 1) // simulator.n_actions], indptr)
    exponent = np.einsum("ij,ij->i", phi, (u + theta)[of_entry])
    raw = np.exp(exponent - spread(segment_max(exponent, indptr), indptr))
    ratio = raw / spread(segment_sums(weights * raw, indptr), indptr)
    mean = segment_sums((weights * ratio)[:, None] * phi, indptr)
    _, model = risk.value(u, theta, smoothness)
    information = risk.hessian(risk.slopes(u, theta, smoothness, model)[1], smoothness)
    scores = _scatter(phi - spread(mean, indptr), of_entry, risk.nodes)
    return LocalTilt(
        smoothness, gain, curve, ratio, (u + theta)[group], gap / max(float(observed.sum()), 1.0), scores, information
    )
