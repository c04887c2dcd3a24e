"""Ratios fitted row by row against the known simulator: eq. 3.7 with q = P.

A row is the distribution of s' in one state-action pair. Its frequencies are mixed with
``kappa`` pseudo-counts of a prior row m, p = (n + kappa m) / (n_sa + kappa), and zeta
minimises sum_s' P z - p log z (+ ridge) over the box, subject to sum_s' P z = 1.
Without ridge and box that is zeta = (n_sas' / P + kappa m / P) / (n_sa + kappa), the
posterior mean under a Dirichlet prior. With ``NoPrior`` kappa is 0, and the risk is
the paper's, but with the known q = P, and sums that are imposed.

The prior is an object (``ratio.prior``). Names of priors, strengths and features are
shorthands for ``oee_tabular.shrinkage.Shrinkage``, which is imported where it is used:
nothing else of this room knows it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeAlias, get_args

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, csr_on_pattern, row_of_entry
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import BLOCK, Rows
from oee_tabular.ratio import dual, statements
from oee_tabular.ratio.dual import check_box, check_ridge
from oee_tabular.ratio.features import FeaturesLike
from oee_tabular.ratio.method import Method, Population, RatioInput
from oee_tabular.ratio.network import Network, check_network, fit_rows
from oee_tabular.ratio.prior import Criterion, NoPrior, Prior, PriorName, PriorRows
from oee_tabular.ratio.result import Influence, TransitionRatio
from oee_tabular.typing import Array, Csr

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
    prior : Prior, {'ridge', 'tilt', 'simulator', 'none'}, default 'ridge'
        What each pair's frequencies are mixed with: an object such as
        ``oee.shrinkage.Shrinkage(...)``, or the name of one of its priors. 'none' is
        the paper's program, which has none; 'average' is an older name of 'ridge'.
        None means 'ridge'. It has nothing to do with the option ``ridge``.
    strength : float, 'evidence' or 'loo', default 'evidence'
        How many transitions a named prior is worth in each pair (kappa); as in
        ``oee.shrinkage.Shrinkage``. Left out where ``prior`` is an object, which has
        its own.
    features : array-like, data frame or callable, optional
        Directions of your own for the tilt of a named prior; as in
        ``oee.shrinkage.Shrinkage``. Left out where ``prior`` is an object.
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

    prior: PriorName | Prior | None = None
    strength: float | Criterion | None = None
    features: FeaturesLike | None = field(default=None, repr=False)
    lower: float | None = None
    upper: float | None = None
    ridge: RidgeLike = 0.0
    toward: float | None = 1.0
    solver: str = "dual"
    functions: Network | None = None

    USES: ClassVar = frozenset({"values_of", "horizon"})

    def __post_init__(self) -> None:
        """Check the method's options."""
        _checks.instance(self.solver, str, "solver")
        box = check_box(self.lower, self.upper, normalized=True)
        prior = self.prior
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
        if prior is None or isinstance(prior, str):
            object.__setattr__(self, "prior", "ridge" if prior is None else prior)
            if self.strength is None:
                object.__setattr__(self, "strength", "evidence")
        else:
            self._check_object(prior)
        self._make_prior()

    def _check_object(self, prior: object) -> None:
        """Raise an error unless the prior is an object that has all its options."""
        if isinstance(prior, type) or not isinstance(prior, Prior):
            raise ArgumentError(
                "prior",
                "must be a name or an object such as oee.shrinkage.Shrinkage(); got"
                f" {_checks.show(prior)}",
            )
        for name in ("strength", "features"):
            value = getattr(self, name)
            if value is not None:
                raise ArgumentError(
                    name,
                    f"must be left out where prior is an object: {prior!r} has its own;"
                    f" got {_checks.show(value)}",
                )

    def _make_prior(self) -> Prior:
        """Return the prior as an object; bad options of a named one are an error."""
        if self.prior == "none" and self.features is None:
            return NoPrior()
        if isinstance(self.prior, str):
            return _shrinkage(self.prior, self.strength, self.features)
        assert self.prior is not None
        return self.prior

    def _fit_prior(self, given: RatioInput) -> PriorRows:
        """Fit the prior's rows; an object that returns something else is an error."""
        prior = self._make_prior().fit_rows(given, solver=self.solver)
        found: Any = prior
        if not isinstance(found, PriorRows):
            raise ArgumentError(
                "prior",
                "must return PriorRows(...) from fit_rows; it returned"
                f" {_checks.show(found)}",
            )
        if len(prior.kappa) != len(given.rows):
            raise ArgumentError(
                "prior",
                f"must return a kappa for each of {len(given.rows)} rows; it returned"
                f" {len(prior.kappa)}",
            )
        return prior

    @property
    def uses(self) -> frozenset[str]:
        """Return the inputs that matter: those that the prior uses."""
        return self._make_prior().uses

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
        """Fit the prior, and then each row's program."""
        observed = given.observed
        rows = given.rows
        box = check_box(self.lower, self.upper, normalized=True)
        n_row = rows.sums(observed)
        prior = self._fit_prior(given)
        kappa = prior.kappa
        fitted = prior.fitted
        details = dict(prior.details)
        lam = self._choose_ridge(given, n_row, details)
        center = 0.0
        if self.toward is not None:
            center = _checks.number_in(self.toward, "toward", 0.0, np.inf)
        details |= {"lower": box.lower, "upper": box.upper}
        share = np.divide(
            n_row, n_row + kappa, out=np.zeros_like(n_row), where=n_row > 0
        )
        zeta = np.empty(len(observed))
        curvature = np.empty(len(observed))
        below = np.empty(len(observed))
        above = np.empty(len(observed))
        is_structured = self.solver == "dual"
        gaps = [0.0 if fitted is None else fitted.gap]
        # Blocks of rows keep memory small. A network is trained on all rows together,
        # and a conic solver is called once.
        in_blocks = is_structured and self.functions is None and len(observed) > BLOCK
        parts: Iterable[Rows] = rows.blocks() if in_blocks else (rows,)
        for some in parts:
            number = some.number
            at = some.entries
            spread = some.spread
            m = some.weights if fitted is None else fitted.at(some)
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
        influence = Influence(rows, observed, zeta, curvature, share, fitted)
        return given.ratio(zeta, "conditional", max(gaps), details, influence)

    def _choose_ridge(
        self, given: RatioInput, n_row: Array, details: dict[str, Any]
    ) -> Array:
        """Return lambda of each row, (rows,), 0 where a row has no data.

        Chosen on the data it is kappa / n_sa, which to second order has the effect of a
        Dirichlet prior.
        """
        if isinstance(self.ridge, str):
            _checks.one_of(self.ridge, "ridge", get_args(Criterion))
            simulator = _shrinkage("simulator", self.ridge, None)
            chosen = simulator.fit_rows(given, solver=self.solver)
            details |= {
                "ridge_times_count": chosen.details["strength"],
                "ridge_by": self.ridge,
            }
            return np.divide(
                chosen.kappa, n_row, out=np.zeros_like(n_row), where=n_row > 0
            )
        sizes, index = np.unique(n_row, return_inverse=True)
        ridges = [check_ridge(self.ridge, float(n)) if n > 0 else 0.0 for n in sizes]
        return np.array(ridges)[index]


def _shrinkage(prior: str, strength: object, features: object) -> Prior:
    """Make the prior that a name stands for.

    Its room is above this one and is asked for by name, where it is used.
    """
    module = importlib.import_module("oee_tabular.shrinkage.prior")
    made: Prior = module.Shrinkage(prior, strength, features)
    return made
