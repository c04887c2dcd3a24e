"""The tilt: the simulator's rows tilted along all directions, shrunk by evidence.

    zeta(s, a, s') proportional to exp((theta_0 + theta_a) . phi(s, a, s')) in each row,
    theta_gj s_gj ~ N(0, 1 / lambda_g),

phi the ``directions``, theta_0 for all actions and theta_a for action a alone, s_gj the
root mean square of a column over the recorded rows, and lambda_g >= 1 one strength a
group of columns. The tilt is Efron and Tibshirani's [1].

The counts of a row are not those of the tilt alone: rows have misfits of their own,
Dirichlet(kappa). n transitions of one row then tell about the tilt what n (1 + kappa) /
(n + kappa) would tell of rows without: each row's log-likelihood has the weight w = (1
+ kappa) / (n + kappa). theta minimises the KL risk of the weighted counts and the
penalty,

    f(theta) = sum_rows w [n ln Z(theta) - sum_x n_x theta . phi_x]
               + 1/2 sum_gj lambda_g (s_gj theta_gj)^2,

smooth and strongly convex, by Newton's method. f - min f <= sum (df / dtheta_j)^2 / (2
lambda_j s_j^2) certifies it. The strengths maximise the evidence by MacKay's rule [2],

    lambda_g <- [c + sum_{j in g} (1 - lambda_g s_j^2 (f''^-1)_jj)]
                / sum_{j in g} (s_j theta_j)^2,

within [1, 1e6], where c = 1/4 is the hyperprior lambda^(c/2 - 1). With c = 0, which is
MacKay's rule, 1/4 and 1 the error where the simulator is right is about .5, .4 and .2
of maximum likelihood's; where it is not, harm grows with c.

The directions that no policy changes are fitted first, once for a log; with V of a
policy the fit goes on from there.

f'' has the shape of an arrow: with G_a the weighted covariances of phi over the rows of
action a and L_a the penalty's diagonal, its blocks are L_0 + sum_a G_a, beside it G_a,
and G_a + L_a.

References: [1] B. Efron and R. Tibshirani, Using specially designed exponential
families for density estimation, Annals of Statistics 24(6), 1996. [2] D. J. C. MacKay,
Bayesian interpolation, Neural Computation 4(3), 1992.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oee_tabular.mdp import Rows
from oee_tabular.ratio import statements
from oee_tabular.ratio.prior import FittedRows
from oee_tabular.ratio.statements import TiltProgram
from oee_tabular.shrinkage._ridge import (
    Columns,
    sum_columns,
    sum_covariances,
    tilt_rows,
)
from oee_tabular.shrinkage.directions import GROUPS, Directions
from oee_tabular.shrinkage.newton import (
    Risk,
    differentiate,
    fit_tilt,
    invert_arrow,
    spread_strengths,
)
from oee_tabular.typing import Array

# The numbers of rounds of MacKay's rule, for kappa around the first rows, then for
# kappa around the tilt; more rounds change nothing.
N_ROUNDS = (6, 3)


@dataclass(frozen=True, eq=False)
class Tilt(FittedRows):
    """A fitted tilt of the simulator's rows.

    Attributes
    ----------
    directions : Directions
        The directions.
    theta : ndarray of shape (1 + A, d)
        The parameters, in the directions' units; the rows of actions are 0 where
        actions have no parameters of their own.
    covariances : ndarray of shape (A, d, d)
        G, the weighted covariances of the directions over each action's rows.
    penalty : ndarray of shape (blocks, d)
        L, the penalty's diagonal; blocks = 1 where no action has parameters of its own.
    strengths : ndarray of shape (2, groups)
        lambda of each group, for all actions and for each action alone.
    gap : float
        A bound on f less its minimum, divided by the number of transitions (nats).
    """

    directions: Directions
    theta: Array
    covariances: Array
    penalty: Array
    strengths: Array
    gap: float

    @property
    def is_finite(self) -> bool:
        """Return whether the parameters and their precision are finite numbers."""
        return bool(
            np.isfinite(self.theta).all() and np.isfinite(self.covariances).all()
        )

    def at(self, rows: Rows) -> Array:
        """Return the tilted rows, (entries,)."""
        return np.asarray(tilt_rows(self.directions.columns(rows), self.theta)[0])

    def pull(self, rows: Rows, values: Array) -> Array:
        """Sum values_x d log zeta_x / d theta over each action's rows, (A, d)."""
        columns = self.directions.columns(rows)
        model, _ = tilt_rows(columns, self.theta)
        rest = values - rows.spread(rows.sums(values)) * model
        return np.asarray(sum_columns(columns, rest, len(self.theta) - 1))

    def named_theta(self) -> dict[str, float]:
        """Return theta of each direction by name, in the direction's unit.

        First the parameters of all actions, then those of each action alone.
        """
        names = self.directions.names
        named = dict(zip(names, self.theta[0].tolist(), strict=True))
        for action in range(len(self.penalty) - 1):
            named |= {
                f"{name}, action {action}": float(value)
                for name, value in zip(names, self.theta[1 + action], strict=True)
            }
        return named

    def named_strengths(self) -> dict[str, tuple[float, float]]:
        """Return lambda of each group, for all actions and for each action alone."""
        both = zip(GROUPS, *self.strengths.tolist(), strict=True)
        present = set(self.directions.group.tolist())
        return {
            name: (shared, own)
            for k, (name, shared, own) in enumerate(both)
            if k in present
        }

    def variance(self, pull: Array) -> float:
        """Compute the posterior variance p' f''^-1 p of a value.

        ``pull`` (A, d) is the value's derivative p in the parameters (``Tilt.pull``).
        """
        both = np.concatenate([pull.sum(axis=0)[None], pull[: len(self.penalty) - 1]])
        arrow = invert_arrow(self.covariances, self.penalty)
        return float(np.sum(both * arrow.solve(both)))


def fit_ridge(
    directions: Directions,
    rows: Rows,
    counts: Array,
    choose_kappa: Callable[[Array], Array] | None,
    *,
    by_evidence: bool = True,
    start: Tilt | None = None,
    solver: str = "dual",
) -> Tilt:
    """Fit the parameters theta and the strengths of a tilt to counts.

    Parameters
    ----------
    directions : Directions
        The directions.
    rows : Rows
        The recorded rows.
    counts : ndarray of shape (entries,)
        Counts on the entries of these rows.
    choose_kappa : callable or None
        The function that takes rows, (entries,), and returns kappa around them,
        (rows,). None means that every transition counts once: rows have no misfits.
    by_evidence : bool, default True
        Whether each group has its strength by evidence, and directions for each action
        alone; else all strengths are 1.
    start : Tilt, optional
        A fit to the same counts along these directions without V, to start from.
    solver : str, default 'dual'
        'dual', or the name of a cvxpy solver for theta at the strengths that were
        found.

    Returns
    -------
    Tilt
        The fitted tilt.

    Notes
    -----
    Cost: O(entries d_1^2 + A d^3) a step of Newton's method, d_1 columns that are not
    indicators; some twenty steps.
    """
    n_actions = rows.n_actions
    columns = directions.columns(rows)
    # Actions that no state has leave nothing to differ. One that was never recorded
    # does: it has the shared part of what was seen, and not the recorded actions' own.
    has_several = int(directions.simulator.available.any(axis=0).sum()) > 1
    n_blocks = 1 + n_actions if by_evidence and has_several else 1
    scale = _root_mean_squares(columns, rows)[:n_blocks]
    theta = np.zeros((1 + n_actions, scale.shape[1]))
    strengths = np.ones((2, len(GROUPS)))
    model = rows.weights
    n = rows.sums(counts)
    rounds: tuple[int, ...] = N_ROUNDS if by_evidence else (0,)
    if start is not None:
        theta[:, directions.group != GROUPS.index("V")] = start.theta
        strengths = start.strengths.copy()
        model = start.at(rows)
        rounds = N_ROUNDS[:1]
        strengths[:, GROUPS.index("V")] = 1.0
    for n_rounds in rounds:
        weight = np.ones(len(rows))
        if choose_kappa is not None:
            kappa = choose_kappa(model)
            weight = np.minimum((1.0 + kappa) / (n + kappa), 1.0)
        weighted = rows.spread(weight) * counts
        risk = Risk(weight * n, sum_columns(columns, weighted, n_actions))
        theta, strengths, covariances, gap = fit_tilt(
            columns, risk, theta, strengths, scale, directions.group, n_rounds
        )
        model = tilt_rows(columns, theta)[0]
    penalty = spread_strengths(strengths, scale, directions.group)
    if solver != "dual":
        theta = _solve_by_cvxpy(columns, weighted, penalty, solver, rows)
        model, _ = tilt_rows(columns, theta)
        gradient, covariances = differentiate(columns, model, risk, theta, penalty)
        gap = 0.5 * float(np.sum(gradient**2 / penalty))
    gap_per_transition = float(gap) / max(float(n.sum()), 1.0)
    return Tilt(directions, theta, covariances, penalty, strengths, gap_per_transition)


def _root_mean_squares(columns: Columns, rows: Rows) -> Array:
    """Return the scales s of the columns over all rows and each action's, (1 + A, d).

    Sums of squares are divided by the number of all rows; s is 1 where a column is
    constant within rows.
    """
    _, squares = sum_covariances(
        columns, rows.weights, np.ones(len(rows)), rows.n_actions
    )
    own = np.diagonal(squares, axis1=1, axis2=2) / len(rows)
    mean = np.concatenate([own.sum(axis=0)[None], own])
    largest_base = np.abs(columns.base).max(axis=0, initial=0.0)
    largest = np.concatenate([largest_base, np.ones(columns.n_codes)])
    # A variance below the rounding of the column's square is none.
    varies = mean > 1e-20 * np.maximum(largest, 1e-150) ** 2
    return np.where(varies, np.sqrt(np.maximum(mean, 0.0)), 1.0)


def _solve_by_cvxpy(
    columns: Columns, counts: Array, penalty: Array, solver: str, rows: Rows
) -> Array:
    """Compute theta by a cvxpy solver.

    The solver gets columns divided by sqrt(penalty), so that its variables are of one
    scale.
    """
    width = columns.base.shape[1]
    dense = np.zeros((len(counts), width + columns.n_codes))
    dense[:, :width] = columns.base
    coded = np.flatnonzero(columns.code >= 0)
    dense[coded, width + columns.code[coded]] = 1.0
    action = rows.spread(rows.action)[:, None]
    of_actions = [dense * (action == a) for a in range(len(penalty) - 1)]
    features = np.concatenate([dense, *of_actions], axis=1)
    root = np.sqrt(penalty).reshape(-1)
    program = TiltProgram(counts, np.log(rows.weights), features / root, rows.indptr)
    theta = np.zeros((1 + rows.n_actions, dense.shape[1]))
    scaled = statements.solve_tilt(program, solver=solver)
    theta[: len(penalty)] = (scaled / root).reshape(penalty.shape)
    return theta
