"""zeta row by row against the known simulator: shrunk frequencies, then the KL program of each row.

A row's frequencies get ``strength`` pseudo-counts of a prior row m (the simulator, or its tilt), p = (n + kappa m) / (n_sa +
kappa), and zeta minimises sum_s' P z - p log z (+ ridge) over the box, subject to sum_s' P z = 1. Without ridge and box that is
zeta = (n_sas' / P + kappa zeta_prior) / (n_sa + kappa), the posterior mean under a Dirichlet prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import dual, programs
from oee_tabular.ratio.box import Box, check_ridge
from oee_tabular.ratio.centre import fit_centre
from oee_tabular.ratio.local_tilt import LocalTilt, fit_local_tilt
from oee_tabular.ratio.prior import CRITERIA, choose_strength, meaning
from oee_tabular.ratio.result import Influence, Part, TransitionRatio, make_result
from oee_tabular.ratio.segments import segment_sums, spread
from oee_tabular.ratio.tilt import Tilt, fit_default_tilt, fit_tilt

PRIORS = ("average", "tilt", "simulator", "none")
Ridge = float | str | Callable[[float], float]


def fit_conditional(
    observed: Array,
    simulator: FiniteMDP,
    *,
    prior: str,
    strength: float | str,
    features: Any,
    smoothness: float | str,
    box: Box,
    ridge: Ridge,
    toward: float | None,
    solver: str,
    values: Sequence[Array] = (),
    time: Array | None = None,
) -> TransitionRatio:
    """zeta from counts on the simulator's entries; see ``transition_ratio``. ``values``: V of the policies that matter.

    ``time`` (S*A,): where they spend theirs in the simulator.
    """
    indptr: IntArray = simulator.transitions.indptr.astype(np.int64)
    q = simulator.transitions.data / spread(segment_sums(simulator.transitions.data, indptr), indptr)
    n_row = segment_sums(observed, indptr)
    base = q
    parts: tuple[Part, ...] = ()
    told: dict[str, Any] = {}
    if prior in ("average", "tilt"):
        tilt, told, likelihood = _tilt(observed, simulator, features, smoothness, solver)
        if prior == "tilt":
            parts = (Part("tilt", 1.0, likelihood, q * tilt.ratio, tilt.scores, tilt.information, gap=tilt.gap),)
        else:
            parts = fit_centre(observed, simulator, values, tilt, likelihood, time=time, solver=solver)
            told |= {"centre": [(part.name, part.weight, part.theta) for part in parts]}
        base = np.asarray(sum(part.weight * part.rows for part in parts))
    kappa, details = _strength(observed, base, q, indptr, prior, strength)
    details |= told
    weight = n_row + kappa
    known = weight > 0
    smoothed = (observed + spread(kappa, indptr) * base) / spread(np.where(known, weight, 1.0), indptr)
    unseen = spread(n_row == 0, indptr)
    p = np.where(unseen, base, smoothed)
    bend = spread(_ridge_by_row(ridge, observed, q, n_row, indptr, details), indptr)
    center = 0.0 if toward is None else _checks.number_in(toward, "toward", 0.0, np.inf)
    curvature = np.asarray(bend if toward is None else bend * q)
    zeta, gap, enclosure = _solve(dual.kl_coordinates(p, q, curvature, center), box, indptr, solver)
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
    details |= {"prior": prior, "lower": box.lower, "upper": box.upper, **enclosure}
    return make_result(simulator, zeta, "conditional", gap, observed, details, influence)


def _tilt(
    observed: Array, simulator: FiniteMDP, features: Any, smoothness: float | str, solver: str
) -> tuple[Tilt | LocalTilt, dict[str, Any], float]:
    """One tilt for all states, or one that varies over them, its diagnostics and its evidence."""
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
    observed: Array, base: Array, q: Array, indptr: IntArray, prior: str, strength: float | str
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
        "meaning": meaning(choice, n_row, "centre" if prior == "average" else prior),
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
    found = programs.solve_rows(program, box.lower, box.upper, indptr, solver=solver)
    zeta = np.clip(found.ratio, max(box.lower, np.finfo(float).tiny), box.upper)
    gaps = dual.row_gaps(program, zeta, 1.0 + found.multiplier, box.lower, box.upper, indptr)
    return zeta, float(gaps.max()), {}
