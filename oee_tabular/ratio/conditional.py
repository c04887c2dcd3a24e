"""Ratios fitted row by row against the known simulator, from shrunk frequencies.

A row is the distribution of s' in one state-action pair. Its frequencies get
``strength`` pseudo-counts of a prior row m (the simulator, or its tilt), p = (n + kappa
m) / (n_sa + kappa), and zeta minimises sum_s' P z - p log z (+ ridge) over the box,
subject to sum_s' P z = 1. Without ridge and box that is zeta = (n_sas' / P + kappa
zeta_prior) / (n_sa + kappa), the posterior mean under a Dirichlet prior.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, csr_on_pattern, row_of_entry
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import BLOCK, Rows
from oee_tabular.ratio import dual, statements
from oee_tabular.ratio.dual import check_box, check_ridge
from oee_tabular.ratio.features import FeaturesLike, count_rank, feature_array
from oee_tabular.ratio.method import Method, Population, RatioInput
from oee_tabular.ratio.network import Network, check_network, fit_rows
from oee_tabular.ratio.prior.directions import (
    add_values,
    make_directions,
    own_directions,
    values_in,
)
from oee_tabular.ratio.prior.ridge import Tilt, fit_ridge
from oee_tabular.ratio.prior.strength import (
    CRITERIA,
    Criterion,
    choose_strength,
    kinds_of_rows,
    meaning,
)
from oee_tabular.ratio.result import Influence, TransitionRatio
from oee_tabular.typing import Array, Csr, IntArray

Prior: TypeAlias = Literal["ridge", "tilt", "simulator", "none", "average"]
RidgeLike: TypeAlias = float | Criterion | Callable[[float], float]

# It replaces a row's weight of 0, by which counts are divided.
SMALLEST_WEIGHT = np.finfo(float).tiny


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Conditional(Method):
    """Ratio fitted row by row against the known simulator (the default method).

    For each (s, a): minimise  sum_s' P z - p log z + ridge/2 sum_s' P (z - toward)^2
    over the box, subject to sum_s' P z = 1, with p the row's frequencies shrunk to a
    prior row m, p = (n + kappa m) / (n_sa + kappa): eq. 3.7 with q = P known. Rows of
    zeta * P sum to 1. Without ridge and box zeta = (n_sas' / P + kappa m / P) / (n_sa +
    kappa); at kappa = 0 the maximum-likelihood model.

    Parameters
    ----------
    prior : {'ridge', 'tilt', 'simulator', 'none'}, default 'ridge'
        The distribution that each pair's is shrunk to: the simulator's, or its
        conditional exponential tilt, zeta proportional to exp(theta . phi), fitted to
        all pairs together. 'ridge': phi are all directions made from the simulator, the
        values of the policies that matter and ``features``, one strength per group by
        marginal likelihood (``ratio.prior``; 'average' is an older name). 'tilt':
        ``features`` alone (log P without any), under the penalty theta^2 / 2 on
        standardised features, a unit Gaussian prior. Neither has to do with the option
        ``ridge``.
    strength : float, 'evidence' or 'loo', default 'evidence'
        How many transitions the prior is worth in each pair (kappa, the strength of a
        Dirichlet prior): a nonnegative number, or chosen by marginal likelihood or by
        leave-one-out, at least 1, one for each kind of pairs (those with the same
        simulator probabilities; kinds with fewer than 5 recorded pairs or 100
        transitions are pooled). ``details`` has the choice, its curve and its meaning.
    features : array-like, data frame or callable, optional
        Directions of your own for the tilt: an array aligned with
        ``simulator.transitions.data``, one of shape (S, A, S) or (S, A, S, d), a
        function of (s, a, s'), or a data frame (columns state, action, next_state, by
        number or name, and one a feature). ``oee.ratio.action_displacement`` makes
        some.
    lower : float, optional
        Lower bound on zeta. None means 0.
    upper : float, optional
        Upper bound on zeta. None means no bound.
    ridge : float, callable, 'evidence' or 'loo', default 0.0
        The factor of the squares above. A function gets the count n_sa of each row that
        has one; 'evidence' or 'loo' chooses kappa / n_sa on the data.
    toward : float or None, default 1.0
        The number that the ridge pulls zeta to. None means ridge/2 * sum zeta^2.
    solver : str, default 'dual'
        'dual' (exact), or the name of a cvxpy solver.
    functions : Network, optional
        The class of functions. None means tables, one number an entry.
        ``Network(layers, ...)`` means zeta = exp f / sum_s' P exp f, f a network
        trained by Algorithm 1 on the rows together, each with its share n_sa / n: the
        log's mean -log zeta, and the ridge. It goes without a prior, a box or a solver;
        in unrecorded pairs it is the network's extrapolation.

    Notes
    -----
    Limit: the target's distributions in recorded pairs, the prior's elsewhere; at rate
    n^-1/2, without the error of training. Cost: O(nnz) with 'dual'. A network's ``gap``
    is the mean's over the log's transitions, to the optimum over all rows; ``details``
    has ``trace``, ``kept`` and ``held_out_risk``.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    ...     for p in (0.5, 0.6)
    ... )
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> Conditional(prior="none").fit(log, simulator).values.data.round(2).tolist()
    [0.82, 1.18, 0.79, 1.21]
    """

    prior: Prior | None = None
    strength: float | Criterion = "evidence"
    features: FeaturesLike | None = field(default=None, repr=False)
    lower: float | None = None
    upper: float | None = None
    ridge: RidgeLike = 0.0
    toward: float | None = 1.0
    solver: str = "dual"
    functions: Network | None = None

    USES: ClassVar = frozenset({"values_of", "horizon"})

    def __post_init__(self) -> None:
        """Check the options."""
        _checks.instance(self.solver, str, "solver")
        box = check_box(self.lower, self.upper, normalized=True)
        prior = self.prior
        given: Any = self.prior
        if given is not None and not isinstance(given, str):
            _checks.one_of(given, "prior", tuple(PRIORS))
        if self.functions is not None:
            check_network(self)
            if prior not in (None, "none"):
                raise ArgumentError(
                    "prior",
                    "must be left out with functions=Network(...), which has none; got"
                    f" {_checks.show(prior)}",
                )
            if box != (0.0, np.inf):
                raise ValueError(
                    "lower and upper must be left out with functions=Network(...),"
                    f" whose rows sum to 1 without a box; it is [{box.lower:g},"
                    f" {box.upper:g}]"
                )
            prior = "none"
        # The first edition called its default "average".
        if prior in (None, "average"):
            prior = "ridge"
        object.__setattr__(self, "prior", prior)
        _checks.one_of(prior, "prior", tuple(PRIORS))
        if self.features is not None and PRIORS[str(prior)] is _no_tilt:
            raise ArgumentError(
                "features",
                f"must be left out with prior {prior!r}, which does not use them",
            )

    @property
    def uses(self) -> frozenset[str]:
        """Return the inputs that matter: only the default's directions have values."""
        if PRIORS[str(self.prior)] is _tilt_along_all:
            return self.USES
        return frozenset()

    def _refusal(self, name: str) -> str:
        """Return the rule that an unused input breaks."""
        if name in self.USES:
            return (
                f"must be left out with prior {self.prior!r}, which does not use them"
            )
        return super()._refusal(name)

    def _exact(self) -> Conditional:
        """Return this method without a network."""
        return replace(self, functions=None)

    def limit(self, population: Population) -> TransitionRatio | Csr:
        """Return the exact P_target / P_simulator on rows with data, else the prior's.

        Parameters
        ----------
        population : Population
            The two models and the distribution of the data.

        Returns
        -------
        TransitionRatio or sparse array of shape (S*A, S)
            The limit of zeta; with a box or a ridge, that of their program.
        """
        fitted = self._fit_limit(population)
        if self.lower is not None or self.upper is not None or self.ridge != 0.0:
            return fitted
        matrix = population.simulator.transitions
        target, _ = align(population.target.transitions, matrix)
        exact = target / np.where(matrix.data > 0, matrix.data, 1.0)
        has_data = population.support[row_of_entry(matrix)]
        zeta = np.where(has_data, exact, fitted.on(population.simulator))
        return csr_on_pattern(matrix, zeta)

    def _fit(self, given: RatioInput) -> TransitionRatio:
        """Fit the prior, its strength, and then each row's program."""
        observed = given.observed
        rows = given.rows
        box = check_box(self.lower, self.upper, normalized=True)
        n_row = rows.sums(observed)
        tilt, details = PRIORS[str(self.prior)](given, self)
        kappa = self._choose_kappa(given, tilt, details)
        lam = self._choose_ridge(given, n_row, details)
        center = 0.0
        if self.toward is not None:
            center = _checks.number_in(self.toward, "toward", 0.0, np.inf)
        details |= {"prior": self.prior, "lower": box.lower, "upper": box.upper}
        share = np.divide(
            n_row, n_row + kappa, out=np.zeros_like(n_row), where=n_row > 0
        )
        zeta = np.empty(len(observed))
        curvature = np.empty(len(observed))
        below = np.empty(len(observed))
        above = np.empty(len(observed))
        is_structured = self.solver == "dual"
        gaps = [0.0 if tilt is None else tilt.gap]
        # Blocks of rows keep memory small. A network is trained on all rows together,
        # and a conic solver is called once.
        in_blocks = is_structured and self.functions is None and len(observed) > BLOCK
        parts: Iterable[Rows] = rows.blocks() if in_blocks else (rows,)
        for some in parts:
            number = some.number
            at = some.entries
            spread = some.spread
            m = some.weights if tilt is None else tilt.at(some)
            weight = np.maximum(n_row[number] + kappa[number], SMALLEST_WEIGHT)
            shrunk = (observed[at] + spread(kappa[number]) * m) / spread(weight)
            p = np.where(spread(n_row[number] == 0), m, shrunk)
            ridge = spread(lam[number])
            if self.toward is not None:
                ridge = ridge * some.weights
            program = dual.Coordinates(p, some.weights, ridge, np.full(len(p), center))
            if self.functions is not None:
                fit, excess, more = fit_rows(
                    self.functions, observed, program, rows, seed=given.seed
                )
                return given.ratio(fit, "conditional", excess, details | more)
            if is_structured:
                solution = dual.solve_rows(program, *box, some.indptr)
                zeta[at] = solution.ratio
                gap = solution.gap
                below[at] = solution.below
                above[at] = solution.above
            else:
                zeta[at], eta = statements.solve_rows(
                    program, *box, some.indptr, solver=self.solver
                )
                gap = dual.row_gaps(program, zeta[at], 1.0 + eta, *box, some.indptr)
            gaps.append(float(gap.max()))
            inside = (zeta[at] > box.lower) & (zeta[at] < box.upper) & (zeta[at] > 0)
            safe = np.where(inside, zeta[at], 1.0)
            with np.errstate(over="ignore"):  # inf: nothing can move such an entry
                bend = (p / safe) / safe + ridge
            curvature[at] = np.where(inside, bend, 0.0)
        if is_structured:
            details["enclosure"] = (below, above)
        influence = Influence(rows, observed, zeta, curvature, share, tilt)
        return given.ratio(zeta, "conditional", max(gaps), details, influence)

    def _choose_kappa(
        self, given: RatioInput, tilt: Tilt | None, details: dict[str, Any]
    ) -> Array:
        """Return kappa of each row, (rows,), and add the choice to ``details``.

        It is 0 without a prior.
        """
        if self.prior == "none" or not isinstance(self.strength, str):
            kappa = 0.0
            if self.prior != "none":
                kappa = _checks.number_in(self.strength, "strength", 0.0, np.inf)
            details["strength"] = kappa
            return np.full(len(given.rows), kappa)
        _checks.one_of(self.strength, "strength", CRITERIA)
        rows = given.visited
        kind = given.get_or_compute(_kinds)
        counts = given.observed[rows.entries]
        prior = rows.weights if tilt is None else tilt.at(rows)
        choice = choose_strength(
            counts, prior, rows, self.strength, kind=kind[rows.number]
        )
        name = "simulator" if tilt is None else "tilt"
        details |= {
            "strength": choice.strength,
            "strength_by": choice.criterion,
            "strength_score": choice.score,
            "strength_curve": (choice.grid, choice.curve),
            "strength_kinds": choice.kinds,
            "meaning": meaning(choice, rows.sums(counts), name),
        }
        return np.asarray(choice.by_kind[kind])

    def _choose_ridge(
        self, given: RatioInput, n_row: Array, details: dict[str, Any]
    ) -> Array:
        """Return lambda of each row, (rows,), 0 where a row has no data.

        Chosen on the data it is kappa / n_sa, which to second order has the effect of a
        Dirichlet prior.
        """
        if isinstance(self.ridge, str):
            _checks.one_of(self.ridge, "ridge", CRITERIA)
            prior = given.rows.weights
            choice = choose_strength(given.observed, prior, given.rows, self.ridge)
            details |= {
                "ridge_times_count": choice.strength,
                "ridge_by": choice.criterion,
            }
            return np.divide(
                choice.by_row, n_row, out=np.zeros_like(n_row), where=n_row > 0
            )
        sizes, index = np.unique(n_row, return_inverse=True)
        ridges = [check_ridge(self.ridge, float(n)) if n > 0 else 0.0 for n in sizes]
        return np.array(ridges)[index]


def _no_tilt(
    given: RatioInput, method: Conditional
) -> tuple[Tilt | None, dict[str, Any]]:
    """Return no tilt: the prior is the simulator's own rows."""
    return None, {}


def _tilt_along_features(
    given: RatioInput, method: Conditional
) -> tuple[Tilt | None, dict[str, Any]]:
    """Fit the tilt along the user's features alone, under a unit Gaussian penalty.

    Without features it is along log P.
    """
    features, details = _features(given, method)
    rows: Rows = given.get_or_compute(_informative)
    if not len(rows):
        return None, {}
    directions = own_directions(given.simulator, features)
    tilt = fit_ridge(
        directions,
        rows,
        given.observed[rows.entries],
        None,
        by_evidence=False,
        solver=method.solver,
    )
    return tilt, details | {"theta": tilt.theta[0], "tilt_gap": tilt.gap}


def _tilt_along_all(
    given: RatioInput, method: Conditional
) -> tuple[Tilt | None, dict[str, Any]]:
    """Fit the tilt along all directions, each group's strength by evidence."""
    rows: Rows = given.get_or_compute(_informative)
    if not len(rows):
        return None, {}
    features, details = _features(given, method)
    if features is None:
        tilt = given.get_or_compute(_fit_without_values)
    else:
        tilt = _fit_without_values(given, features)
    values = values_in(given.simulator, given.policies, given.horizon)
    if values or method.solver != "dual":
        directions = add_values(tilt.directions, values) if values else tilt.directions
        kappa = _choice_of_kappa(given)
        tilt = fit_ridge(
            directions,
            rows,
            given.observed[rows.entries],
            kappa,
            start=tilt,
            solver=method.solver,
        )
    choice = {
        "directions": tilt.named_theta(),
        "direction_strengths": tilt.named_strengths(),
        "tilt_gap": tilt.gap,
    }
    return tilt, details | choice


PRIORS = {
    "ridge": _tilt_along_all,
    "tilt": _tilt_along_features,
    "simulator": _no_tilt,
    "none": _no_tilt,
}


def _fit_without_values(given: RatioInput, features: Array | None = None) -> Tilt:
    """Fit the tilt along all directions but V, which do not depend on a policy."""
    rows: Rows = given.get_or_compute(_informative)
    if features is None:
        features = np.zeros((len(given.observed), 0))
    directions = make_directions(given.simulator, rows, features)
    return fit_ridge(
        directions, rows, given.observed[rows.entries], _choice_of_kappa(given)
    )


def _informative(given: RatioInput) -> Rows:
    """Return the recorded rows with more than one next state.

    The others have no information about the tilt.
    """
    return given.visited.select(np.diff(given.visited.indptr) > 1)


def _choice_of_kappa(given: RatioInput) -> Callable[[Array], Array]:
    """Return the function that chooses kappa of the informative rows around a model.

    It takes the model's rows, (entries,), and returns kappa, (rows,), from the grid
    alone: the weights that it is for hardly change beyond.
    """
    rows: Rows = given.get_or_compute(_informative)
    counts = given.observed[rows.entries]
    kind = given.get_or_compute(_kinds)[rows.number]

    def choose(model: Array) -> Array:
        """Choose kappa of each row by evidence on the grid."""
        return choose_strength(counts, model, rows, kind=kind, n_halvings=0).by_row

    return choose


def _kinds(given: RatioInput) -> IntArray:
    """Return the kind of each row; kinds without recorded rows count as the first."""
    return kinds_of_rows(given.observed, given.rows)


def _features(
    given: RatioInput, method: Conditional
) -> tuple[Array | None, dict[str, Any]]:
    """Return the user's features on the simulator's entries, and their rank.

    Warns where they are collinear within rows.
    """
    if method.features is None:
        return None, {}
    features = feature_array(method.features, given.simulator)
    centred = np.sqrt(given.rows.weights)[:, None] * given.rows.center(features)
    rounding = 1e-12 * np.abs(features).max(axis=0) * np.sqrt(len(features))
    centred = np.where((centred**2).sum(axis=0) > rounding**2, centred, 0.0)
    return features, {"feature_rank": count_rank(centred, where=" within rows")}
