"""zeta row by row against the known simulator: shrunk frequencies, then the KL program of each row.

A row's frequencies get ``strength`` pseudo-counts of a prior row m (the simulator, or its tilt), p = (n + kappa m) / (n_sa +
kappa), and zeta minimises sum_s' P z - p log z (+ ridge) over the box, subject to sum_s' P z = 1. Without ridge and box that is
zeta = (n_sas' / P + kappa zeta_prior) / (n_sa + kappa), the posterior mean under a Dirichlet prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, on_pattern, row_of_entry
from oee_tabular.exact import occupancy
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import dual, statements
from oee_tabular.ratio.box import Box, check_box, check_ridge
from oee_tabular.ratio.method import Given, Method
from oee_tabular.ratio.population import Population
from oee_tabular.ratio.prior.centre import fit_centre
from oee_tabular.ratio.prior.library import values_in
from oee_tabular.ratio.prior.local_tilt import LocalTilt, fit_local_tilt
from oee_tabular.ratio.prior.strength import CRITERIA, choose_strength, meaning
from oee_tabular.ratio.prior.tilt import Tilt, fit_default_tilt, fit_tilt
from oee_tabular.ratio.result import Influence, Part, TransitionRatio, make_result
from oee_tabular.ratio.segments import segment_sums, spread

PRIORS = ("average", "tilt", "simulator", "none")
Ridge = float | str | Callable[[float], float]


@dataclass(frozen=True, eq=False)
class Conditional(Method):
    """zeta row by row against the known simulator: the default. Rows of zeta * P sum to 1.

    For each (s, a): minimise  sum_s' P z - p log z + ridge/2 sum_s' P (z - toward)^2  over the box, subject to sum_s' P z = 1,
    with p the row's frequencies shrunk to a prior row m, p = (n + kappa m) / (n_sa + kappa): eq. 3.7 with q = P known. Without
    ridge and box zeta = (n_sas' / P + kappa m / P) / (n_sa + kappa); at kappa = 0 the maximum-likelihood model.

    Parameters
    ----------
    prior : "average" (default) | "tilt" (default where ``features`` or ``smoothness`` is given) | "simulator" | "none"
        The row that every row is shrunk to: the simulator's, that of its conditional exponential tilt zeta proportional to
        exp(theta . phi), fitted to all rows together under the penalty |theta|^2 / 2 on standardised features, a unit
        Gaussian prior (theta varies over the states where the log gives evidence that it does), or the average by
        evidence of these two and of tilts along directions made from the simulator and the values of the policies that
        matter (``ratio.prior.centre``).
    strength : "evidence" (default) | "loo", or a nonnegative number
        How many moves the prior's row is worth (kappa, the strength of a Dirichlet prior): chosen by its marginal
        likelihood or by leave-one-out, at least 1, one for each kind of rows (those in which the simulator has the same
        probabilities; kinds with fewer than 5 visited rows or 100 moves are pooled), or given. ``details`` has the choice,
        its curve and its meaning.
    features : phi for the tilt: None (log P, and (log P)^2 where the evidence asks for it), an array aligned with
        ``simulator.transitions.data``, one of shape (S, A, S) or (S, A, S, d), or a function of (s, a, s');
        ``oee.ratio.action_displacement`` makes some
    smoothness : "evidence" (default), a positive number, or ``numpy.inf``; with the tilt only
        How much alike theta is in neighbouring states (lambda of ``ratio.prior.local_tilt``): chosen by its evidence, given, or
        infinite: one theta for all states. ``details["theta_by_state"]`` shows where the target differs.
    lower, upper : bounds on zeta; None: 0 and no bound
    ridge, toward : as above (default 0); toward None: ridge/2 * sum zeta^2. A function gets the count n_sa of each row that
        has one, and "evidence" or "loo" chooses kappa / n_sa on the data
    solver : "dual", or a cvxpy solver

    Notes
    -----
    Limit: the target's own rows where the data are, the prior's elsewhere; at rate n^-1/2. O(nnz) with "dual".

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> Conditional(prior="none").fit(log, simulator).values.data.round(2).tolist()
    [0.8, 1.2, 0.79, 1.21]
    """

    prior: str | None = None
    strength: float | str = "evidence"
    features: Any = field(default=None, repr=False)
    smoothness: float | str | None = None
    lower: float | None = None
    upper: float | None = None
    ridge: Ridge = 0.0
    toward: float | None = 1.0
    solver: str = "dual"

    HEEDS: ClassVar = frozenset({"values_of", "horizon"})

    def __post_init__(self) -> None:
        _checks.instance(self.solver, str, "solver")
        if self.prior is None:
            plain = self.features is None and self.smoothness is None
            object.__setattr__(self, "prior", "average" if plain else "tilt")
        _checks.one_of(self.prior, "prior", PRIORS)
        for name in ("features", "smoothness"):
            if getattr(self, name) is not None and self.prior != "tilt":
                raise ValueError(f"{name} must be left out with prior {self.prior!r}, which does not use them")
        check_box(self.lower, self.upper, normalized=True)

    @property
    def uses(self) -> frozenset[str]:
        """The policies' values are directions of the average's tilts."""
        return self.HEEDS if self.prior == "average" else frozenset()

    @property
    def refuses(self) -> str:
        """What is said of the others."""
        return f"must be left out with prior {self.prior!r}, which does not use them"

    def limit(self, population: Population) -> TransitionRatio | sparse.csr_array:
        """The exact P_target / P_simulator on the rows that have data, the prior's elsewhere."""
        fitted = super().limit(population)
        plain = self.lower is None and self.upper is None and self.ridge == 0.0
        return _with_exact_rows(population, fitted) if plain else fitted

    def _fit(self, given: Given) -> TransitionRatio:
        observed, simulator = given.observed, given.simulator
        box = check_box(self.lower, self.upper, normalized=True)
        indptr: IntArray = simulator.transitions.indptr.astype(np.int64)
        q = simulator.transitions.data / spread(segment_sums(simulator.transitions.data, indptr), indptr)
        n_row = segment_sums(observed, indptr)
        base = q
        parts: tuple[Part, ...] = ()
        told: dict[str, Any] = {}
        if self.prior in ("average", "tilt"):
            tilt, told, likelihood = _tilt(observed, simulator, self.features, self.smoothness, self.solver)
            if self.prior == "tilt":
                parts = (Part("tilt", 1.0, likelihood, q * tilt.ratio, tilt.scores, tilt.information, gap=tilt.gap),)
            else:
                values, time = _of_policies(given)
                parts = fit_centre(observed, simulator, values, tilt, likelihood, time=time, solver=self.solver)
                told |= {"centre": [(part.name, part.weight, part.theta) for part in parts]}
            base = np.asarray(sum(part.weight * part.rows for part in parts))
        kappa, details = _strength(observed, base, q, indptr, self.prior, self.strength)
        details |= told
        weight = n_row + kappa
        known = weight > 0
        smoothed = (observed + spread(kappa, indptr) * base) / spread(np.where(known, weight, 1.0), indptr)
        unseen = spread(n_row == 0, indptr)
        p = np.where(unseen, base, smoothed)
        bend = spread(_ridge_by_row(self.ridge, observed, q, n_row, indptr, details), indptr)
        center = 0.0 if self.toward is None else _checks.number_in(self.toward, "toward", 0.0, np.inf)
        curvature = np.asarray(bend if self.toward is None else bend * q)
        zeta, gap, enclosure = _solve(dual.kl_coordinates(p, q, curvature, center), box, indptr, self.solver)
        gap = float(np.max([gap, *(part.gap for part in parts)]))
        inside = (zeta > box.lower) & (zeta < box.upper) & (zeta > 0)
        safe = np.where(inside, zeta, 1.0)
        influence = Influence(
            frequencies=np.where(unseen, 0.0, observed / spread(np.maximum(n_row, 1e-300), indptr)),
            row_counts=n_row,
            kernel=zeta * q,
            weights=q,
            stiffness=np.where(inside, (p / safe) / safe + curvature, 0.0),
            share=np.divide(n_row, weight, out=np.zeros_like(n_row), where=known),
            indptr=indptr,
            parts=parts,
        )
        details |= {"prior": self.prior, "lower": box.lower, "upper": box.upper, **enclosure}
        return make_result(simulator, zeta, "conditional", gap, observed, details, influence)


def _of_policies(given: Given) -> tuple[list[Array], Array | None]:
    """V of each policy in the simulator, and the time that they spend in each row, all together (None: no such thing)."""
    simulator, horizon = given.simulator, given.horizon
    values = values_in(simulator, given.policies, horizon)
    if not given.policies or (horizon is None and simulator.discount == 1.0):
        return values, None
    times = [occupancy(simulator, policy, horizon=horizon).reshape(-1) for policy in given.policies]
    return values, np.asarray(np.sum(times, axis=0))


def _with_exact_rows(population: Population, fitted: TransitionRatio) -> sparse.csr_array:
    """``fitted`` with the exact P_target / P_simulator on the rows that have data."""
    matrix = population.simulator.transitions
    inside, _ = align(population.target.transitions, matrix)
    seen = population.support[row_of_entry(matrix)]
    safe = np.where(matrix.data > 0, matrix.data, 1.0)
    return on_pattern(matrix, np.where(seen, inside / safe, fitted.on(population.simulator)))


def _tilt(
    observed: Array, simulator: FiniteMDP, features: Any, smoothness: float | str | None, solver: str
) -> tuple[Tilt | LocalTilt, dict[str, Any], float]:
    """One tilt for all states, or one that varies over them, its diagnostics and its evidence."""
    smoothness = "evidence" if smoothness is None else smoothness
    if not (isinstance(smoothness, str | float) and smoothness in ("evidence", np.inf)):
        smoothness = _checks.number_in(smoothness, "smoothness", 0.0, np.inf, open_ends=True)
    if features is None:
        whole = fit_default_tilt(observed, simulator, solver=solver)
    else:
        whole = fit_tilt(observed, simulator, features, solver=solver)
    details = {"theta": whole.theta, "tilt_gap": whole.gap, "feature_rank": whole.rank, "smoothness": np.inf}
    if smoothness == np.inf or not (whole.information > 1e-9 + np.eye(len(whole.theta))).any():
        return whole, details, whole.evidence
    local = fit_local_tilt(
        observed,
        simulator,
        whole.features,
        whole.coefficients,
        None if isinstance(smoothness, str) else smoothness,
        solver=solver,
    )
    if local is None:
        return whole, details, whole.evidence
    told = {
        "theta_by_state": local.theta / whole.scale,
        "tilt_gap": local.gap,
        "smoothness": local.smoothness,
        "smoothness_gain": local.gain,
        "smoothness_curve": local.curve,
    }
    return local, details | told, whole.evidence + local.gain


def _strength(
    observed: Array, base: Array, q: Array, indptr: IntArray, prior: str | None, strength: float | str
) -> tuple[Array, dict[str, Any]]:
    """kappa of each row, and the diagnostics of the choice."""
    n_row = segment_sums(observed, indptr)
    if prior == "none":
        return np.zeros(len(n_row)), {"strength": 0.0}
    if not isinstance(strength, str):
        kappa = _checks.number_in(strength, "strength", 0.0, np.inf)
        return np.full(len(n_row), kappa), {"strength": kappa}
    _checks.one_of(strength, "strength", CRITERIA)
    choice = choose_strength(observed, base, q, indptr, strength)
    return choice.by_row, {
        "strength": choice.strength,
        "strength_by": choice.criterion,
        "strength_score": choice.score,
        "strength_curve": (choice.grid, choice.curve),
        "strength_kinds": choice.kinds,
        "meaning": meaning(choice, n_row, "centre" if prior == "average" else str(prior)),
    }


def _ridge_by_row(
    ridge: Ridge, observed: Array, q: Array, n_row: Array, indptr: IntArray, details: dict[str, Any]
) -> Array:
    """The ridge of each row: a number, a function of the row's count, or kappa / n_sa with kappa chosen on the data.

    The last is the quadratic form of a Dirichlet prior centred on the simulator (equal to it to second order).
    """
    if isinstance(ridge, str):
        _checks.one_of(ridge, "ridge", CRITERIA)
        choice = choose_strength(observed, q, q, indptr, ridge)
        details |= {"ridge_times_count": choice.strength, "ridge_by": choice.criterion}
        return np.divide(choice.by_row, n_row, out=np.zeros_like(n_row), where=n_row > 0)
    sizes, index = np.unique(n_row, return_inverse=True)
    return np.array([check_ridge(ridge, float(n)) if n > 0 else 0.0 for n in sizes])[index]


def _solve(program: dual.Coordinates, box: Box, indptr: IntArray, solver: str) -> tuple[Array, float, dict[str, Any]]:
    """zeta, the largest gap of a row, and the enclosure where the solver gives one."""
    if solver == "dual":
        solution = dual.solve_rows(program, box.lower, box.upper, indptr)
        return solution.ratio, float(solution.gap.max()), {"enclosure": solution.enclosure()}
    found = statements.solve_rows(program, box.lower, box.upper, indptr, solver=solver)
    zeta = np.clip(found.ratio, max(box.lower, np.finfo(float).tiny), box.upper)
    gaps = dual.row_gaps(program, zeta, 1.0 + found.multiplier, box.lower, box.upper, indptr)
    return zeta, float(gaps.max()), {}
