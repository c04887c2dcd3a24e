"""The prior that the default shrinks to: its rows m and how much each is worth.

Each row of the target is a priori Dirichlet(kappa m). m is the simulator's row or its
tilt (``ridge``, along ``directions``), and kappa is chosen on the data (``strength``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import Rows
from oee_tabular.ratio.features import FeaturesLike, count_rank, feature_array
from oee_tabular.ratio.method import RatioInput
from oee_tabular.ratio.prior import Criterion, NoPrior, PriorName, PriorRows
from oee_tabular.shrinkage.directions import (
    add_values,
    make_directions,
    own_directions,
    values_in,
)
from oee_tabular.shrinkage.ridge import Tilt, fit_ridge
from oee_tabular.shrinkage.strength import (
    CRITERIA,
    choose_strength,
    kinds_of_rows,
    meaning,
)
from oee_tabular.typing import Array, IntArray

PRIORS = ("ridge", "tilt", "simulator", "none")
# the priors that are tilted along directions, which may be the user's features
TILTED_PRIORS = ("ridge", "tilt")


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Shrinkage:
    """The prior rows m and their strengths kappa, fitted to the log.

    A ``Conditional`` that is given this object mixes each row's frequencies with m as
    if m had been recorded kappa times: p = (n_x + kappa m_x) / (n + kappa).

    Parameters
    ----------
    prior : {'ridge', 'tilt', 'simulator', 'none'}, default 'ridge'
        The rows m. 'simulator': the simulator's. 'tilt': the simulator's tilted along
        ``features`` (along log P without any), m proportional to P exp(theta . phi),
        under the penalty theta^2 / 2 on standardised features. 'ridge': tilted along
        all directions that are made from the simulator, the values of the policies that
        matter and ``features``, one strength a group by marginal likelihood. 'none': no
        prior, kappa = 0.
    strength : float, 'evidence' or 'loo', default 'evidence'
        The number kappa of transitions that the prior is worth in each state-action
        pair: a nonnegative number, or chosen by marginal likelihood or by
        leave-one-out, at least 1, one for each kind of pairs (those with the same
        simulator probabilities; kinds with fewer than 5 recorded pairs or 100
        transitions are pooled).
    features : array-like, data frame or callable, optional
        Directions of your own for the tilt: an array aligned with
        ``simulator.transitions.data``, one of shape (S, A, S) or (S, A, S, d), a
        function of (s, a, s'), or a data frame (columns state, action, next_state, by
        number or name, and one a feature). ``oee.ratio.action_displacement`` makes
        some.

    Raises
    ------
    ValueError
        If an option is none of these, or if features are given to a prior that is not
        tilted.

    See Also
    --------
    oee_tabular.ratio.Conditional : The program that uses the prior.
    SoftThreshold : The default's second step, which moves the value.

    Notes
    -----
    The names of ``Conditional(prior=..., strength=..., features=...)`` are shorthands
    for this object. ``details`` of a fitted ratio has the choice of kappa, its curve
    and its meaning, and the parameters of the tilt. Cost: some twenty steps of Newton's
    method for the tilt, O(entries) for kappa.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.tasks.gridworld(3, slip=0.3),
    ...     oee.tasks.gridworld(3, slip=0.1),
    ... )
    >>> log = oee.sample_episodes(
    ...     target, oee.uniform_policy(target), 50, horizon=30, seed=0
    ... )
    >>> prior = Shrinkage("tilt", strength=5.0)
    >>> fit = oee.ratio.Conditional(prior=prior).fit(log, simulator)
    >>> fit.details["strength"], fit.row_sum_error < 1e-12
    (5.0, True)
    """

    prior: PriorName = "ridge"
    strength: float | Criterion = "evidence"
    features: FeaturesLike | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Check the name, the strength and the features."""
        _checks.one_of(self.prior, "prior", PRIORS)
        if self.features is not None and self.prior not in TILTED_PRIORS:
            raise ArgumentError(
                "features",
                f"must be left out with prior {self.prior!r}, which does not use them",
            )
        if self.prior == "none":
            return
        if isinstance(self.strength, str):
            _checks.one_of(self.strength, "strength", CRITERIA)
        else:
            _checks.number_in(self.strength, "strength", 0.0, np.inf)

    @property
    def uses(self) -> frozenset[str]:
        """Return the inputs that matter: only the directions of 'ridge' have values."""
        return frozenset({"values_of", "horizon"} if self.prior == "ridge" else ())

    def fit_rows(self, given: RatioInput, *, solver: str = "dual") -> PriorRows:
        """Fit m, and then kappa around it.

        Parameters
        ----------
        given : RatioInput
            The checked counts, the simulator and the policies that matter.
        solver : str, default 'dual'
            'dual', or the name of a cvxpy solver for the tilt.

        Returns
        -------
        PriorRows
            The rows m, the strengths kappa and the details of both fits.
        """
        if self.prior == "none":
            return NoPrior().fit_rows(given, solver=solver)
        tilt: Tilt | None = None
        details: dict[str, Any] = {"prior": self.prior}
        features = self._features(given, details)
        if self.prior in TILTED_PRIORS and len(given.get_or_compute(_informative)):
            if self.prior == "tilt":
                tilt = _tilt_along_features(given, features, solver)
                details["theta"] = tilt.theta[0]
            else:
                tilt = _tilt_along_all(given, features, solver)
                details["directions"] = tilt.named_theta()
                details["direction_strengths"] = tilt.named_strengths()
            details["tilt_gap"] = tilt.gap
        kappa = self._choose_kappa(given, tilt, details)
        return PriorRows(kappa, tilt, details)

    def _features(self, given: RatioInput, details: dict[str, Any]) -> Array | None:
        """Return the user's features on the simulator's entries; details get the rank.

        Warns where they are collinear within rows.
        """
        if self.features is None:
            return None
        features = feature_array(self.features, given.simulator)
        centred = np.sqrt(given.rows.weights)[:, None] * given.rows.center(features)
        rounding = 1e-12 * np.abs(features).max(axis=0) * np.sqrt(len(features))
        centred = np.where((centred**2).sum(axis=0) > rounding**2, centred, 0.0)
        details["feature_rank"] = count_rank(centred, where=" within rows")
        return features

    def _choose_kappa(
        self, given: RatioInput, tilt: Tilt | None, details: dict[str, Any]
    ) -> Array:
        """Return kappa of each row, (rows,), and add the choice to ``details``."""
        if not isinstance(self.strength, str):
            kappa = float(self.strength)
            details["strength"] = kappa
            return np.full(len(given.rows), kappa)
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


def _tilt_along_features(
    given: RatioInput, features: Array | None, solver: str
) -> Tilt:
    """Fit the tilt along the user's features alone, under a unit Gaussian penalty.

    Without features it is along log P.
    """
    rows: Rows = given.get_or_compute(_informative)
    return fit_ridge(
        own_directions(given.simulator, features),
        rows,
        given.observed[rows.entries],
        None,
        by_evidence=False,
        solver=solver,
    )


def _tilt_along_all(given: RatioInput, features: Array | None, solver: str) -> Tilt:
    """Fit the tilt along all directions, each group's strength by evidence."""
    rows: Rows = given.get_or_compute(_informative)
    tilt: Tilt
    if features is None:
        tilt = given.get_or_compute(_fit_without_values)
    else:
        tilt = _fit_without_values(given, features)
    values = values_in(given.simulator, given.policies, given.horizon)
    if not values and solver == "dual":
        return tilt
    directions = add_values(tilt.directions, values) if values else tilt.directions
    return fit_ridge(
        directions,
        rows,
        given.observed[rows.entries],
        _choice_of_kappa(given),
        start=tilt,
        solver=solver,
    )


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
