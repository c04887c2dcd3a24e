"""The ratio of transition probabilities zeta = P_target / P_simulator: the paper's Section IV.B.

Two ways from counts to zeta:

"conditional" (the default)
    The simulator P is known. For each (s, a): minimise sum_s' P z - p log z (+ ridge) over the box, subject to
    sum_s' P z = 1, with p the row's frequencies after adding ``strength`` pseudo-counts of the prior. Without ridge and
    box this is zeta = (n_sas' / P + strength) / (n_sa + strength): at strength 0 the maximum-likelihood model.
"ratio_of_ratios" (the paper's)
    beta_sas' and beta_sa are fitted apart, target counts against data of the simulator, and zeta is their quotient.
    Nothing makes the rows of zeta * P sum to 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import align, canonical, on_pattern, row_of_entry, row_sums
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import dual, programs
from oee_tabular.ratio.density import Box, check_box, check_ridge
from oee_tabular.ratio.quotient import SimulatorData, fit_quotient
from oee_tabular.ratio.support import aligned_counts, refuse_unsupported

METHODS = ("conditional", "ratio_of_ratios")
PRIORS = ("simulator", "none")


@dataclass(frozen=True, eq=False)
class TransitionRatio:
    """zeta on the simulator's support, with what it rests on.

    Attributes
    ----------
    values : csr of shape (S*A, S) with the entries of ``simulator.transitions``
    method : how it was found
    gap : the largest duality gap of the programs solved (nats, each program scaled to probabilities)
    visited : (S, A), where the log has moves; elsewhere zeta is the prior's (1)
    row_sum_error : largest |sum_s' zeta P - 1| over (s, a)
    counts : (S, A) moves of the log in each row
    details : what the method adds (sums, bounds, how much was undetermined)
    """

    values: sparse.csr_array
    method: str
    gap: float
    visited: BoolArray
    row_sum_error: float
    counts: Array
    details: dict[str, Any] = field(default_factory=dict)
    _influence: Influence | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        data = self.values.data
        return (
            f"TransitionRatio({self.method}: {len(data)} values from {data.min():.4g} to {data.max():.4g}, "
            f"{int(self.visited.sum())} of {self.visited.size} (s, a) visited, gap {self.gap:.1e}, "
            f"row-sum error {self.row_sum_error:.1e})"
        )

    def on(self, simulator: FiniteMDP) -> Array:
        """The values on the entries of ``simulator.transitions``; ValueError where they are another simulator's."""
        if self.values.shape != simulator.transitions.shape:
            raise ValueError(
                f"ratio must be for {simulator.transitions.shape} rows and states; it is for {self.values.shape}"
            )
        zeta, stored = align(canonical(self.values, drop_zeros=False), simulator.transitions)
        if not stored.all() or self.values.nnz != simulator.transitions.nnz:
            raise ValueError("ratio must have the support of this simulator's transitions; it is another simulator's")
        return zeta

    def target_model(self, simulator: FiniteMDP, *, normalize: bool = False) -> FiniteMDP:
        """zeta * P as a FiniteMDP.

        Raises ValueError where its rows do not sum to 1 (the paper's quotient), unless ``normalize`` divides them.
        """
        zeta = self.on(simulator)
        data = zeta * simulator.transitions.data
        sums = row_sums(simulator.transitions, data)
        if normalize:
            data = data / sums[row_of_entry(simulator.transitions)]
        elif np.abs(sums - 1.0).max() > _checks.SUM_TOLERANCE:
            raise ValueError(
                f"rows of zeta * P must sum to 1; they sum to {sums.min():.4g} to {sums.max():.4g} (method {self.method!r} "
                "does not make them; normalize=True divides each row, exact.reweight keeps them as they are)"
            )
        return simulator.with_transitions(on_pattern(simulator.transitions, data))

    def log_standard_error(self, gradient: Array) -> float | None:
        """Delta-method standard error that the log's sampling noise gives to a function of zeta * P.

        ``gradient`` is its derivative in each entry of zeta * P (``exact.transition_gradient``). Rows are taken as
        multinomial given their counts; unvisited rows add nothing (they are no estimate). None where no formula is known.
        """
        return None if self._influence is None else self._influence.standard_error(gradient)


@dataclass(frozen=True, eq=False)
class Influence:
    """How a row's frequencies move its entries of zeta * P, by differentiating the row's optimality conditions."""

    frequencies: Array
    row_counts: Array
    kernel: Array
    weights: Array
    stiffness: Array
    share: Array
    indptr: IntArray

    def standard_error(self, gradient: Array) -> float:
        """sqrt(sum_rows share^2 / n * Var(psi)), psi = d value / d frequency."""
        lengths = np.diff(self.indptr)

        def total(values: Array) -> Array:
            return np.repeat(_segment_sums(values, self.indptr), lengths)

        # g = zeta; stiffness H = p/g^2 + A on entries inside the box, infinite at the bounds; dg = (dp/g - q dm) / H
        soft = np.divide(1.0, self.stiffness, out=np.zeros_like(self.stiffness), where=self.stiffness > 0)
        q = self.weights
        pull = gradient * q
        slope = total(pull * q * soft)
        scale = total(q * q * soft)
        mean = np.divide(slope, scale, out=np.zeros_like(slope), where=scale > 0)
        zeta = np.divide(self.kernel, q, out=np.zeros_like(q), where=q > 0)
        psi = np.divide((pull - q * mean) * soft, zeta, out=np.zeros_like(q), where=zeta > 0)
        center = total(self.frequencies * psi)
        variance = _segment_sums(self.frequencies * (psi - center) ** 2, self.indptr)
        n = np.maximum(self.row_counts, 1.0)
        return float(np.sqrt(np.sum(np.where(self.row_counts > 0, self.share**2 * variance / n, 0.0))))


def _segment_sums(values: Array, indptr: IntArray) -> Array:
    return np.add.reduceat(values, indptr[:-1])  # rows of a simulator are never empty


def transition_ratio(
    log_or_counts: Transitions | sparse.csr_array,
    simulator: FiniteMDP,
    *,
    method: str = "conditional",
    simulator_data: SimulatorData = None,
    prior: str | None = None,
    strength: float | None = None,
    lower: float | None = None,
    upper: float | None = None,
    ridge: float | Callable[[Any], Any] = 0.0,
    toward: float | None = 1.0,
    behavior_policy: Any = None,
    seed: Any = None,
    solver: str = "dual",
) -> TransitionRatio:
    """zeta(s, a, s') = P_target / P_simulator from a log of the target.

    Parameters
    ----------
    log_or_counts : Transitions, or csr of counts of shape (S*A, S)
    simulator : FiniteMDP
    method : "conditional" | "ratio_of_ratios"
    prior, strength : "simulator" (default) | "none", nonnegative (default 1)
        Conditional only: ``strength`` pseudo-counts of P are added to each row, which is the posterior mean under a
        Dirichlet prior centred on the simulator, and the KL program with the term -strength * sum P log zeta.
    lower, upper : bounds on zeta (conditional; default none) or on each beta (ratio_of_ratios; default 0.01 and 10, the
        paper's nu and mu; ``numpy.inf`` for none), so that the quotient lies in [lower/upper, upper/lower]
    ridge, toward : as in ``density_ratio``; conditional: a row's program has ridge/2 * sum P (zeta - toward)^2 (toward
        None: sum zeta^2), and a function gets the count n_sa of each row that has one
    simulator_data : ratio_of_ratios only
        A log of the simulator; None: one of the target log's size is sampled under its estimated behaviour policy, with
        ``seed``; "exact": the simulator's exact occupancy under that policy
    behavior_policy : (S, A), instead of the estimated one; ratio_of_ratios only
    solver : "dual", or a cvxpy solver

    Returns
    -------
    TransitionRatio
        Rows without data have zeta = 1; ``visited`` says which have some.

    Raises
    ------
    ValueError
        A move of the log to which the simulator gives probability 0 (named); bad options.

    Notes
    -----
    conditional -> the true zeta on every row visited, at rate n^-1/2; O(nnz) with "dual".
    """
    _checks.one_of(method, "method", METHODS)
    if isinstance(log_or_counts, Transitions):
        counts = log_or_counts.counts(simulator.n_states, simulator.n_actions)
    elif sparse.issparse(log_or_counts):
        counts = sparse.csr_array(log_or_counts)
    else:
        raise ValueError(f"log_or_counts must be Transitions or sparse counts; got {type(log_or_counts).__name__}")
    observed = aligned_counts(counts, simulator)
    if not observed.sum() > 0:
        raise ValueError("log_or_counts must have at least one move; it has none")
    conditional = method == "conditional"
    foreign = {"simulator_data": simulator_data, "behavior_policy": behavior_policy}
    if not conditional:
        foreign = {"prior": prior, "strength": strength}
    for name, value in foreign.items():
        if value is not None:
            raise ValueError(f"{name} must not be given with method {method!r}, which does not use it; got {value!r}")
    if conditional:
        prior = "simulator" if prior is None else prior
        _checks.one_of(prior, "prior", PRIORS)
        added = _checks.number_in(1.0 if strength is None else strength, "strength", 0.0, np.inf)
        added = added if prior == "simulator" else 0.0
        box = check_box(lower, upper, normalized=True)
        return _conditional(observed, simulator, added, box, ridge, toward, solver)
    quotient = fit_quotient(
        observed,
        log_or_counts if isinstance(log_or_counts, Transitions) else None,
        simulator,
        simulator_data,
        behavior_policy=behavior_policy,
        seed=seed,
        lower=0.01 if lower is None else lower,
        upper=10.0 if upper is None else upper,
        ridge=ridge,
        toward=toward,
        solver=solver,
    )
    return _result(simulator, quotient.zeta, "ratio_of_ratios", quotient.gap, observed, quotient.details, None)


def _conditional(
    observed: Array,
    simulator: FiniteMDP,
    strength: float,
    box: Box,
    ridge: float | Callable[[Any], Any],
    toward: float | None,
    solver: str,
) -> TransitionRatio:
    indptr = simulator.transitions.indptr.astype(np.int64)
    rows = row_of_entry(simulator.transitions)
    n_row = row_sums(simulator.transitions, observed)
    q = simulator.transitions.data / row_sums(simulator.transitions)[rows]
    weight = n_row + strength
    known = weight > 0
    p = np.where(known[rows], (observed + strength * q) / np.where(known, weight, 1.0)[rows], q)
    bend = _ridge_by_row(ridge, n_row)[rows]
    center = 0.0 if toward is None else _checks.number_in(toward, "toward", 0.0, np.inf)
    curvature = np.asarray(bend if toward is None else bend * q)
    unseen = n_row[rows] == 0
    p, curvature = np.where(unseen, q, p), np.where(unseen, 0.0, curvature)
    arguments = (p, q, curvature, center, box.lower, box.upper)
    if solver == "dual":
        solution = dual.solve_rows(*arguments, indptr)
        zeta, gap = solution.ratio, float(solution.gap.max())
    else:
        found = programs.solve_rows(*arguments, indptr, solver=solver)
        zeta = np.clip(found.ratio, max(box.lower, np.finfo(float).tiny), box.upper)
        gap = max(
            abs(
                dual.objective(zeta[low:high], p[low:high], q[low:high], curvature[low:high], center)
                - dual.dual_value(1.0 + m, p[low:high], q[low:high], curvature[low:high], *arguments[3:])
            )
            for low, high, m in zip(indptr[:-1], indptr[1:], found.multiplier, strict=True)
        )
    inside = (zeta > box.lower) & (zeta < box.upper) & (zeta > 0)
    safe = np.where(inside, zeta, 1.0)
    stiffness = np.where(inside, (p / safe) / safe + curvature, 0.0)
    influence = Influence(
        frequencies=np.where(unseen, 0.0, observed / np.maximum(n_row, 1e-300)[rows]),
        row_counts=n_row,
        kernel=zeta * q,
        weights=q,
        stiffness=stiffness,
        share=np.divide(n_row, weight, out=np.zeros_like(n_row), where=known),
        indptr=indptr,
    )
    details = {"strength": strength, "lower": box.lower, "upper": box.upper}
    return _result(simulator, zeta, "conditional", gap, observed, details, influence)


def _ridge_by_row(ridge: float | Callable[[Any], Any], n_row: Array) -> Array:
    """The ridge of each row: a number, or a function of the row's count, asked once for each positive count."""
    sizes, index = np.unique(n_row, return_inverse=True)
    return np.array([check_ridge(ridge, float(n)) if n > 0 else 0.0 for n in sizes])[index]


def true_ratio(target: FiniteMDP, simulator: FiniteMDP) -> TransitionRatio:
    """zeta = P_target / P_simulator on the simulator's support.

    Raises ValueError where the target moves outside that support, naming the moves.
    """
    for name, value in (("target", target), ("simulator", simulator)):
        if not isinstance(value, FiniteMDP):
            raise ValueError(f"{name} must be a FiniteMDP; got {type(value).__name__}")
    if target.transitions.shape != simulator.transitions.shape:
        raise ValueError(
            f"target and simulator must have the same states and actions; their transitions have shapes "
            f"{target.transitions.shape} and {simulator.transitions.shape}"
        )
    refuse_unsupported(target.transitions, simulator, what="target")
    data, _ = align(target.transitions, simulator.transitions)
    return _result(simulator, data / simulator.transitions.data, "true", 0.0, data, {}, None)


def _result(
    simulator: FiniteMDP,
    zeta: Array,
    method: str,
    gap: float,
    observed: Array,
    details: dict[str, Any],
    influence: Influence | None,
) -> TransitionRatio:
    shape = (simulator.n_states, simulator.n_actions)
    sums = row_sums(simulator.transitions, zeta * simulator.transitions.data)
    counts = row_sums(simulator.transitions, observed).reshape(shape)
    return TransitionRatio(
        values=on_pattern(simulator.transitions, zeta),
        method=method,
        gap=gap,
        visited=counts > 0,
        row_sum_error=float(np.abs(sums - 1.0).max()),
        counts=counts,
        details=details,
        _influence=influence,
    )
