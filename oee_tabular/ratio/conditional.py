"""zeta row by row against the known simulator: shrunk frequencies, then the KL program of each row.

A row's frequencies get ``strength`` pseudo-counts of a prior row m (the simulator, or its tilt), p = (n + kappa m) / (n_sa +
kappa), and zeta minimises sum_s' P z - p log z (+ ridge) over the box, subject to sum_s' P z = 1. Without ridge and box that is
zeta = (n_sas' / P + kappa zeta_prior) / (n_sa + kappa), the posterior mean under a Dirichlet prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, csr_on_pattern, row_of_entry
from oee_tabular.exact.linear import DivergentKernelError
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import BLOCK, Rows
from oee_tabular.ratio import dual, statements
from oee_tabular.ratio.arguments import check_box, check_ridge
from oee_tabular.ratio.method import Given, Method, Population
from oee_tabular.ratio.network import Network, check_network
from oee_tabular.ratio.prior.centre import Log, fit_centre
from oee_tabular.ratio.prior.library import values_in
from oee_tabular.ratio.prior.local_tilt import LocalTilt, fit_local_tilt
from oee_tabular.ratio.prior.neighbours import Neighbours, neighbours
from oee_tabular.ratio.prior.strength import CRITERIA, choose_strength, kinds_of_rows, meaning
from oee_tabular.ratio.prior.tilt import Columns, Tilt, fit_default_tilt, fit_tilt
from oee_tabular.ratio.result import Influence, Part, TransitionRatio
from oee_tabular.ratio.trained import fit_rows

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
        ``simulator.transitions.data``, one of shape (S, A, S) or (S, A, S, d), a function of (s, a, s'),
        or a data frame (columns state, action, next_state, by number or name, and one a feature);
        ``oee.ratio.action_displacement`` makes some
    smoothness : "evidence" (default), a positive number, or ``numpy.inf``; with the tilt only
        How much alike theta is in neighbouring states (lambda of ``ratio.prior.local_tilt``): chosen by its evidence, given, or
        infinite: one theta for all states. ``details["theta_by_state"]`` shows where the target differs.
    lower, upper : bounds on zeta; None: 0 and no bound
    ridge, toward : as above (default 0); toward None: ridge/2 * sum zeta^2. A function gets the count n_sa of each row that
        has one, and "evidence" or "loo" chooses kappa / n_sa on the data
    solver : "dual", or a cvxpy solver
    functions : None (tables: one number an entry), or ``Network(layers, ...)``: zeta = exp f / sum_s' P exp f, f a network
        trained by Algorithm 1 on the rows together, each with its share n_sa / n: the log's mean -log zeta, and the ridge.
        Without a prior, a box or a solver; what it says of rows without data is the network's own

    Notes
    -----
    Limit: the target's own rows where the data are, the prior's elsewhere; at rate n^-1/2; training is no part of it. O(nnz)
    with "dual". Of a network ``gap`` is that of the mean over the log's moves, to the optimum over all rows, and ``details``
    has ``trace``, ``kept`` and ``held_out_risk``.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> Conditional(prior="none").fit(log, simulator).values.data.round(2).tolist()
    [0.82, 1.18, 0.79, 1.21]
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
    functions: Network | None = None

    HEEDS: ClassVar = frozenset({"values_of", "horizon"})

    def __post_init__(self) -> None:
        _checks.instance(self.solver, str, "solver")
        if self.functions is not None:
            self._check_network()
        if self.prior is None:
            plain = self.features is None and self.smoothness is None
            object.__setattr__(self, "prior", "average" if plain else "tilt")
        _checks.one_of(self.prior, "prior", tuple(PRIORS))
        for name in ("features", "smoothness"):
            if getattr(self, name) is not None and self.prior != "tilt":
                raise ValueError(f"{name} must be left out with prior {self.prior!r}, which does not use them")
        check_box(self.lower, self.upper, normalized=True)

    def _check_network(self) -> None:
        """A network has no prior, no box and no solver: a ValueError that names what is there."""
        check_network(self.functions, solver=self.solver)
        if self.prior is None:
            object.__setattr__(self, "prior", "none")
        if self.prior != "none":
            raise ValueError(
                f"prior must be left out with functions=Network(...), which has none; got {_checks.show(self.prior)}"
            )
        box = check_box(self.lower, self.upper, normalized=True)
        if box != (0.0, np.inf):
            raise ValueError(
                "lower and upper must be left out with functions=Network(...), whose rows sum to 1 without a box; "
                f"it is [{box.lower:g}, {box.upper:g}]"
            )

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
        fitted = super(Conditional, replace(self, functions=None)).limit(population)
        plain = self.lower is None and self.upper is None and self.ridge == 0.0
        return _with_exact_rows(population, fitted) if plain else fitted

    def _fit(self, given: Given) -> TransitionRatio:
        observed, rows = given.observed, given.rows
        box = check_box(self.lower, self.upper, normalized=True)
        n_row = rows.sums(observed)
        prior = PRIORS[str(self.prior)](given, self)
        weight = n_row + prior.kappa
        known = weight > 0
        details: dict[str, object] = dict(prior.details)
        if isinstance(self.ridge, str):
            lam = self._chosen_ridge(given, n_row, details)
        else:
            sizes, index = np.unique(n_row, return_inverse=True)
            lam = np.array([check_ridge(self.ridge, float(n)) if n > 0 else 0.0 for n in sizes])[index]
        center = 0.0 if self.toward is None else _checks.number_in(self.toward, "toward", 0.0, np.inf)
        details |= {"prior": self.prior, "lower": box.lower, "upper": box.upper}
        zeta, bent, *ends = (np.empty(len(observed)) for _ in range(4 if self.solver == "dual" else 2))
        gaps = [part.gap for part in prior.parts]
        whole = self.solver != "dual" or self.functions is not None or len(observed) <= BLOCK
        for some in (rows,) if whole else rows.blocks():
            number, at, spread, m = some.number, some.entries, some.spread, prior.at(some)
            smoothed = observed[at] + spread(prior.kappa[number]) * m
            p = np.where(spread(n_row[number] == 0), m, smoothed / spread(np.where(known, weight, 1.0)[number]))
            curvature = np.asarray(spread(lam[number]) if self.toward is None else spread(lam[number]) * some.weights)
            program = dual.Coordinates(p, some.weights, curvature, np.full(len(p), center))
            if self.functions is not None:
                fit = fit_rows(self.functions, observed, program, rows, seed=given.seed)
                return given.ratio(fit.ratio, "conditional", fit.gap, details | fit.details)
            if self.solver == "dual":
                found = dual.solve_rows(program, *box, some.indptr)
                zeta[at], gap, (ends[0][at], ends[1][at]) = found.ratio, found.gap, found.enclosure()
            else:
                zeta[at], eta = statements.solve_rows(program, *box, some.indptr, solver=self.solver)
                gap = dual.row_gaps(program, zeta[at], 1.0 + eta, *box, some.indptr)
            gaps.append(float(gap.max()))
            inside = (zeta[at] > box.lower) & (zeta[at] < box.upper) & (zeta[at] > 0)
            safe = np.where(inside, zeta[at], 1.0)
            bent[at] = np.where(inside, (p / safe) / safe + curvature, 0.0)
        if ends:
            details["enclosure"] = tuple(ends)
        share = np.divide(n_row, weight, out=np.zeros_like(n_row), where=known)
        influence = Influence(rows, observed, zeta, bent, share, prior.parts)
        return given.ratio(zeta, "conditional", max(gaps), details, influence)

    def _chosen_ridge(self, given: Given, n_row: Array, details: dict[str, Any]) -> Array:
        """kappa / n_sa of each row, kappa chosen on the data: the quadratic form, to second order, of a Dirichlet prior."""
        assert isinstance(self.ridge, str)
        _checks.one_of(self.ridge, "ridge", CRITERIA)
        choice = choose_strength(given.observed, given.rows.weights, given.rows, self.ridge)
        details |= {"ridge_times_count": choice.strength, "ridge_by": choice.criterion}
        return np.divide(choice.by_row, n_row, out=np.zeros_like(n_row), where=n_row > 0)


def _with_exact_rows(population: Population, fitted: TransitionRatio) -> sparse.csr_array:
    """``fitted`` with the exact P_target / P_simulator on the rows that have data."""
    matrix = population.simulator.transitions
    inside, _ = align(population.target.transitions, matrix)
    seen = population.support[row_of_entry(matrix)]
    safe = np.where(matrix.data > 0, matrix.data, 1.0)
    return csr_on_pattern(matrix, np.where(seen, inside / safe, fitted.on(population.simulator)))


def _tilt(
    given: Given, features: object, smoothness: float | str | None, solver: str
) -> tuple[Tilt | LocalTilt, dict[str, Any], float]:
    """One tilt for all states, or one that varies over them, its diagnostics and its evidence."""
    observed, simulator = given.observed, given.simulator
    smoothness = "evidence" if smoothness is None else smoothness
    if not (isinstance(smoothness, str | float) and smoothness in ("evidence", np.inf)):
        smoothness = _checks.number_in(smoothness, "smoothness", 0.0, np.inf, open_ends=True)
    if features is None:
        whole = fit_default_tilt(observed, simulator, solver=solver, whole=given.rows)
    else:
        whole = fit_tilt(observed, simulator, features, solver=solver, whole=given.rows)
    details = {"theta": whole.theta, "tilt_gap": whole.gap, "feature_rank": whole.rank, "smoothness": np.inf}
    if smoothness == np.inf or not (whole.information > 1e-9 + np.eye(len(whole.theta))).any():
        return whole, details, whole.evidence
    asked = None if isinstance(smoothness, str) else smoothness
    graph = given.once(_graph, len(whole.coefficients))
    local = fit_local_tilt(observed, simulator, whole, asked, solver=solver, graph=graph)
    if local is None:
        return whole, details, whole.evidence
    of_states = {
        "theta_by_state": local.theta / whole.scale,
        "tilt_gap": local.gap,
        "smoothness": local.smoothness,
        "smoothness_gain": local.gain,
        "smoothness_curve": local.curve,
    }
    return local, details | of_states, whole.evidence + local.gain


class _Prior(NamedTuple):
    """What rows are shrunk to (of any rows, (entries,)), the moves that it is worth in each, its parts, what is said of it."""

    at: Columns
    kappa: Array
    parts: tuple[Part, ...]
    details: dict[str, Any]


def _none(given: Given, method: Conditional) -> _Prior:
    """Nothing: maximum likelihood, the simulator where there are no data."""
    return _Prior(_simulated, np.zeros(given.rows.number.shape), (), {"strength": 0.0})


_simulated = attrgetter("weights")


def _simulator(given: Given, method: Conditional) -> _Prior:
    return _of_strength(given, method, _simulated, (), {}, "simulator")


def _tilted(given: Given, method: Conditional) -> _Prior:
    tilt, details, likelihood = _tilt(given, method.features, method.smoothness, method.solver)
    part = Part("tilt", 1.0, likelihood, tilt.at, tilt.whole, tilt.information, gap=tilt.gap)
    return _of_strength(given, method, lambda rows: tilt.at(rows)[0], (part,), details, "tilt")


def _average(given: Given, method: Conditional) -> _Prior:
    simulator, horizon = given.simulator, given.horizon
    tilt, shared, likelihood, log = given.once(_of_all_policies, method.solver)
    details = deepcopy(shared)
    values = values_in(simulator, given.policies, horizon)
    time = _time_in_rows(simulator, given.policies, horizon)
    parts = fit_centre(given.observed, simulator, values, tilt, likelihood, time=time, solver=method.solver, log=log)
    details["centre"] = [(part.name, part.weight, part.theta) for part in parts]

    def centre(rows: Rows) -> Array:
        return np.asarray(sum(part.weight * part.at(rows)[0] for part in parts))

    return _of_strength(given, method, centre, parts, details, "centre")


def _of_all_policies(given: Given, solver: str) -> tuple[Tilt | LocalTilt, dict[str, Any], float, Log | None]:
    """The tilt by log P, what is said of it, its evidence, and the log beside it."""
    tilt, details, likelihood = _tilt(given, None, None, solver)
    return tilt, details, likelihood, Log.of(given.observed, given.simulator, tilt, given.once(_graph, 1))


def _graph(given: Given, width: int) -> Neighbours:
    """The simulator's."""
    return neighbours(given.simulator, width=width)


def _time_in_rows(simulator: FiniteMDP, policies: Sequence[Array], horizon: int | None) -> Array | None:
    """(S*A,): the policies' time in each row; None without policies, or where one of them earns or pays for ever."""
    try:
        found = [time_in_pairs(simulator, policy, horizon).reshape(-1) for policy in policies]
    except DivergentKernelError:
        return None
    return np.asarray(np.sum(found, axis=0)) if found else None


PRIORS = {"average": _average, "tilt": _tilted, "simulator": _simulator, "none": _none}


def _of_strength(
    given: Given, method: Conditional, at: Columns, parts: tuple[Part, ...], details: dict[str, Any], name: str
) -> _Prior:
    """kappa of each row as ``strength`` says; ``name`` is what its meaning calls the prior."""
    if not isinstance(method.strength, str):
        kappa = _checks.number_in(method.strength, "strength", 0.0, np.inf)
        return _Prior(at, np.full(len(given.rows), kappa), parts, details | {"strength": kappa})
    _checks.one_of(method.strength, "strength", CRITERIA)
    rows, kind = given.visited, given.once(_kinds)
    counts = given.observed[rows.entries]
    choice = choose_strength(counts, at(rows), rows, method.strength, kind=kind[rows.number])
    chosen = {
        "strength": choice.strength,
        "strength_by": choice.criterion,
        "strength_score": choice.score,
        "strength_curve": (choice.grid, choice.curve),
        "strength_kinds": choice.kinds,
        "meaning": meaning(choice, rows.sums(counts), name),
    }
    return _Prior(at, choice.by_kind[kind], parts, chosen | details)


def _kinds(given: Given) -> IntArray:
    """The kind of each row; those that none of the log's are of have the first's."""
    return kinds_of_rows(given.observed, given.rows)
