"""Continuous tasks as finite MDPs: ``discretize`` (adapter), on a grid or on cells of visited states (places).

States s in R^d with features phi(s), cells j = 1, ..., N with weights w_j(phi) that sum to 1 over j, and pairs x_k at which
the task is stepped (places):

    P(j | i, a) = sum_k W_{(i,a),k} E_xi[w_j(phi(f(x_k, xi)))],     r(i, a) = sum_k W_{(i,a),k} E_xi[r(x_k, xi)],
    pi(a | i) = mean of pi(a | s) over the states of cell i

Another task stepped at the same places has the same states; a ratio between the two differs from 1 by their dynamics alone.
A log becomes soft counts n(i, a, j) = sum over its rows of w_i(s) w_j(s') (``Discretization.counts``) or numbered transitions
drawn by these weights (``encode``), so that the ratio of the target's and the simulator's transitions is a matrix as it is for
any finite MDP. Where episodes can end, one absorbing state that pays nothing, the last, stands for all that is over.

What is exact: the mean of a step on a grid, and rewards r(s, a) at the places. What is lost is measured (``closure_error``):
the value of a policy on the cells minus its Monte Carlo value in the task. No interval covers that error; ``calibrate`` takes
out the part that the simulator has itself.
"""

from oee_tabular.continuous.discretization.adapter import discretize
from oee_tabular.continuous.discretization.cells import Grid, VoronoiCells
from oee_tabular.continuous.discretization.model import Discretization
from oee_tabular.continuous.discretization.places import (
    GridInterpolation,
    Places,
    VisitedCells,
    gauss_hermite,
    visited_states,
)

__all__ = [
    "Discretization",
    "Grid",
    "GridInterpolation",
    "Places",
    "VisitedCells",
    "VoronoiCells",
    "discretize",
    "gauss_hermite",
    "visited_states",
]
