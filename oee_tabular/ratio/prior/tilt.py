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

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import row_of_entry
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import statements
from oee_tabular.ratio.prior.strength import choose_strength
from oee_tabular.ratio.program_types import TiltProgram
from oee_tabular.ratio.segments import segment_max, segment_sums, spread

ENOUGH = 2.0  # nats of evidence that a theta which varies over the states must gain
DECISIVE = 5.0  # that a second number for all rows must gain


@dataclass(frozen=True, eq=False)
class Tilt:
    """A fitted tilt.

    Attributes
    ----------
    ratio : zeta_theta on the simulator's entries
    theta : (d,) in the units of the features
    gap : bound on f(theta) - min f, divided by the number of moves (nats)
    rank : how many directions of the features differ within rows
    scores : (entries, d), phi less its mean under the tilt, standardised; information : (d, d), Hessian of f
    evidence : integral of exp(-f) over theta by Laplace's approximation, as a logarithm (nats); f = 0 at theta = 0
    features : (entries, d), phi centred in the simulator's rows and divided by scale (d,); coefficients : theta scale
    """

    ratio: Array
    theta: Array
    gap: float
    rank: int
    scores: Array
    information: Array
    evidence: float
    features: Array
    scale: Array
    coefficients: Array


def feature_array(features: Any, simulator: FiniteMDP) -> Array:
    """phi as an (entries, d) array of finite numbers.

    ``features``: None (log P), a function of (s, a, s') arrays, an array of (entries,) or (entries, d)
    aligned with ``simulator.transitions.data``, or of (S, A, S) or (S, A, S, d).
    """
    matrix = simulator.transitions
    rows = row_of_entry(matrix)
    state, action, arrival = rows // simulator.n_actions, rows % simulator.n_actions, matrix.indices.astype(np.int64)
    if features is None:
        return np.asarray(np.log(matrix.data)[:, None])
    given = features(state, action, arrival) if callable(features) else features
    array = _checks.float_array(given, "features")
    shape = (simulator.n_states, simulator.n_actions, simulator.n_states)
    if array.ndim >= 3 and array.shape[:3] == shape:
        array = array[state, action, arrival]
    if array.ndim not in (1, 2) or array.shape[0] != matrix.nnz or array.size == 0:
        raise ValueError(
            f"features must have {matrix.nnz} rows, one for each transition of the simulator, or shape {shape} (+ d); "
            f"they have shape {array.shape}"
        )
    _checks.require_finite(array, "features")
    return array.reshape(matrix.nnz, -1)


def action_displacement(simulator: FiniteMDP, coordinates: Any) -> Array:
    """Indicator features of (action, displacement), which share what is learned between all states.

    Parameters
    ----------
    simulator : FiniteMDP
    coordinates : (S,) or (S, c): where each state is; the displacement is the difference of the two ends' coordinates

    Returns
    -------
    (entries, d) : one column per action and displacement; of each action the commonest displacement is the reference

    Examples
    --------
    >>> line = FiniteMDP([[[0.5, 0.5, 0]], [[0, 0.5, 0.5]], [[0, 0, 1]]], [0, 0, 0], [1, 0, 0], 0.9)
    >>> action_displacement(line, [0, 1, 2]).ravel().tolist()  # 0 -> 0, 0 -> 1, 1 -> 1, 1 -> 2, 2 -> 2: ahead?
    [0.0, 1.0, 0.0, 1.0, 0.0]
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    given = _checks.float_array(coordinates, "coordinates", ndim=(1, 2))
    _checks.require_finite(given, "coordinates")
    places = given[:, None] if given.ndim == 1 else given
    if places.shape[0] != simulator.n_states:
        raise ValueError(f"coordinates must have {simulator.n_states} rows, one a state; they have {places.shape[0]}")
    matrix = simulator.transitions
    rows = row_of_entry(matrix)
    state, action = rows // simulator.n_actions, rows % simulator.n_actions
    keys = np.column_stack([action, np.round(places[matrix.indices] - places[state], 9)])
    kinds, kind = np.unique(keys, axis=0, return_inverse=True)
    kind = kind.reshape(-1)
    mass = np.bincount(kind, weights=matrix.data)
    reference = [
        int(np.flatnonzero(kinds[:, 0] == a)[np.argmax(mass[kinds[:, 0] == a])]) for a in np.unique(kinds[:, 0])
    ]
    kept = np.setdiff1d(np.arange(len(kinds)), reference)
    return np.asarray(kind[:, None] == kept, dtype=np.float64)


def fit_default_tilt(observed: Array, simulator: FiniteMDP, *, solver: str = "dual") -> Tilt:
    """phi = log P, and (log P)^2 beside it where that gains 5 nats of evidence: a second number for rows of three values.

    With (log P)^2 the tilted row is P^(1 + theta_1 + theta_2 log P) / Z: most probable moves and least probable ones need
    not change by one power. The evidence is that of the Dirichlet rows around the tilt (``choose_strength``), which
    forgives a tilt the kinds of rows that it misses, less ln |f''| / 2 + |theta|^2 / 2. Five nats (odds of 150), since the
    second number also bends the rows that one power fits.
    """
    one = fit_tilt(observed, simulator, solver=solver)
    log_p = np.log(simulator.transitions.data)
    two = fit_tilt(observed, simulator, np.column_stack([log_p, log_p**2]), solver=solver, warn=False)
    if two.evidence < one.evidence + DECISIVE:
        return one
    first, second = (_dirichlet_evidence(tilt, observed, simulator) for tilt in (one, two))
    return two if second > first + DECISIVE else one


def _dirichlet_evidence(tilt: Tilt, observed: Array, simulator: FiniteMDP) -> float:
    indptr: IntArray = simulator.transitions.indptr.astype(np.int64)
    weights = simulator.transitions.data / spread(segment_sums(simulator.transitions.data, indptr), indptr)
    score = choose_strength(observed, weights * tilt.ratio, weights, indptr).score
    size = float(np.linalg.slogdet(tilt.information)[1]) + float(tilt.coefficients @ tilt.coefficients)
    return score - 0.5 * size


def fit_tilt(
    observed: Array, simulator: FiniteMDP, features: Any = None, *, solver: str = "dual", warn: bool = True
) -> Tilt:
    """Fit theta to counts on the simulator's entries, by Newton's method ("dual") or by a cvxpy solver.

    Warns where features are collinear within rows, with their rank; the penalty then picks the smallest theta.
    Cost: O(entries d^2) a step, about ten steps.
    """
    phi = feature_array(features, simulator)
    matrix = simulator.transitions
    indptr: IntArray = matrix.indptr.astype(np.int64)
    weights = matrix.data / spread(segment_sums(matrix.data, indptr), indptr)
    phi = phi - spread(segment_sums(weights[:, None] * phi, indptr), indptr)
    n_row = segment_sums(observed, indptr)
    gram = (phi * weights[:, None]).T @ phi / max(len(n_row), 1)
    scale = np.sqrt(np.diag(gram))
    scale = np.where(scale > 1e-12 * max(1.0, float(np.abs(phi).max(initial=0.0))), scale, np.inf)  # constant: no use
    phi = phi / scale
    rank = _rank(gram / np.outer(scale, scale), len(scale), warn=warn and features is not None)

    def tilted(theta: Array) -> tuple[Array, Array]:
        exponent = phi @ theta
        top = segment_max(exponent, indptr)
        raw = weights * np.exp(exponent - spread(top, indptr))
        total = segment_sums(raw, indptr)
        return raw / spread(total, indptr), top + np.log(total)

    def risk(theta: Array, log_normalizer: Array) -> float:
        return float(n_row @ log_normalizer - observed @ (phi @ theta) + 0.5 * theta @ theta)

    def slopes(theta: Array, model: Array) -> tuple[Array, Array, Array]:
        mean = segment_sums(model[:, None] * phi, indptr)
        scores = phi - spread(mean, indptr)
        mass = model * spread(n_row, indptr)
        information = (scores * mass[:, None]).T @ scores + np.eye(len(theta))
        return scores, n_row @ mean - observed @ phi + theta, information

    if solver == "dual":
        theta = np.zeros(phi.shape[1])
        model, log_normalizer = tilted(theta)
        value = risk(theta, log_normalizer)
        for _ in range(100):
            _, gradient, information = slopes(theta, model)
            step = -_solve_positive(information, gradient)
            decrement = float(-gradient @ step)
            if decrement <= 1e-22 * max(1.0, abs(value)):
                break
            size = max(1.0, abs(value), float(n_row.sum()))
            blur = 1e-13 * size if decrement < 1e-9 * size else 0.0  # what rounding may add to a fall that it hides
            length = 1.0
            while length > 1e-12:
                trial = theta + length * step
                trial_model, trial_normalizer = tilted(trial)
                trial_value = risk(trial, trial_normalizer)
                if trial_value <= value - 1e-4 * length * decrement + blur:
                    break
                length *= 0.5
            else:
                break
            theta, model, value = trial, trial_model, trial_value
    else:
        program = TiltProgram(observed, np.log(weights), phi, indptr)
        theta = statements.solve_tilt(program, solver=solver)
        model, _ = tilted(theta)
    scores, gradient, information = slopes(theta, model)
    gap = 0.5 * float(gradient @ gradient) / max(float(observed.sum()), 1.0)
    ratio = model / weights
    value = risk(theta, tilted(theta)[1])
    evidence = -value - 0.5 * float(np.linalg.slogdet(information)[1])
    return Tilt(ratio, theta / scale, gap, rank, scores, information, evidence, phi, scale, theta)


def _solve_positive(matrix: Array, b: Array) -> Array:
    """matrix^-1 b for a symmetric matrix whose eigenvalues are at least 1, whatever rounding has made of them."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors @ ((vectors.T @ b) / np.maximum(values, 1.0)))


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
