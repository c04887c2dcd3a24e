"""Density ratios (beta) and transition ratios (zeta) by convex risk minimisation.

Every fit has a duality gap.

Objects
-------
::

    p, q          (n,) distributions of target and simulator on the same cells
    beta = p / q  (n,) their ratio, estimated by g (n,) in the box nu <= g <= mu
    P, n_sas'     (S*A, S) the simulator's transitions and the log's counts; n_sa and n
                  are their sums
    zeta          (S*A, S) on P's support, P_target / P (eq. 4.3); P_target = zeta * P

The program (eq. 3.6, 3.7)
--------------------------
g is p / q where it maximises a lower bound on KL(p || q), so that with the ridge lambda
and the constraint of [1]::

    minimise  sum q g - sum p log g + lambda/2 I(g)^2
    subject to  nu <= g <= mu,  sum q g = 1.

The Lagrangian is separable. With m = 1 + the multiplier of the sum, each cell has a
closed form g_x(m), and sum q g(m) = 1 is one bracketed root. At any g and m the
duality gap is the sum of the differences of each cell from the Lagrangian's least
value::

    gap = sum_x [h_x(g_x) - min h_x] + |m - 1| |sum q g - 1|,
    h_x(g) = m q g - p log g + lambda/2 g^2,

a sum of nonnegative terms. It is computed from the program as stated, by code that no
solver uses.

From counts to zeta
-------------------
::

    Conditional  P is known: in each row (s, a) the program above, q = P and p the log's
                 frequencies, shrunk to a prior row. Without ridge and box
                 zeta = (n_sas' / P + kappa zeta_prior) / (n_sa + kappa).
    InClass      one program for all rows, zeta = 1 + Phi w: features (linear) or a
                 kernel.
    Tied         entries with one key share one ratio.
    Quotient     the paper's: zeta = beta(s, a, s') / beta(s, a), each beta by eq. 3.7
                 (eq. 4.4); by tables, Algorithm 1 or networks. Its rows need not sum
                 to 1.
    Joint        both betas at once, under sum_s' d(s, a, s') beta(s, a, s') =
                 d(s, a) beta(s, a), which makes them sum to 1.

Where to find it
----------------
::

    transition   transition_ratio: zeta from a log by any method; true_ratio: zeta of
                 two MDPs
    density      density_ratio: the program for two distributions; dual checks and
                 solves it, _certificate computes its gap
    statements   every program as cvxpy states it: the reference, and Clarabel for
                 linear and kernel classes
    conditional, linear, ties, quotient, joint
                 one method each; method is their common base
    features     features of transitions, also from data frames; kernels by pivoted
                 Cholesky
    sgd, network Algorithm 1 on tables; the paper's networks (extra neural)
    prior        the distribution that Conditional shrinks to, and how strongly
    support      transitions to which the simulator gives probability 0
    result       zeta with its certificate, its standard error and its one-step
                 correction

Guarantees
----------
The gap of a fit is in nats; "optimal" is at most 1e-8. Rows of zeta * P sum to 1 except
with ``Quotient``. zeta is 1, or the prior's, where nothing was observed. A transition
that the simulator cannot make is an error that names it.

Reference: [1] Nguyen, Wainwright and Jordan, Estimating divergence functionals and the
likelihood ratio by convex risk minimization, IEEE Trans. Information Theory 56(11),
2010.
"""

import importlib

from oee_tabular.ratio.conditional import Conditional
from oee_tabular.ratio.density import RatioFit, density_ratio
from oee_tabular.ratio.exact_ratio import true_ratio
from oee_tabular.ratio.features import action_displacement, gaussian
from oee_tabular.ratio.functions import Kernel, Linear, Table
from oee_tabular.ratio.joint import Joint
from oee_tabular.ratio.linear import InClass
from oee_tabular.ratio.method import Method
from oee_tabular.ratio.network import Network
from oee_tabular.ratio.prior import NoPrior, Prior, PriorRows
from oee_tabular.ratio.quotient import Quotient
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.sgd import Sgd, SgdTrace
from oee_tabular.ratio.support import (
    Assumptions,
    check_assumptions,
    refuse_unsupported,
    uncovered_share,
)
from oee_tabular.ratio.ties import Tied

TYPE_CHECKING = False
if TYPE_CHECKING:
    from oee_tabular.shrinkage.transition import transition_ratio as transition_ratio

__all__ = [
    "Assumptions",
    "Conditional",
    "InClass",
    "Joint",
    "Kernel",
    "Linear",
    "Method",
    "Network",
    "NoPrior",
    "Prior",
    "PriorRows",
    "Quotient",
    "RatioFit",
    "Sgd",
    "SgdTrace",
    "Table",
    "Tied",
    "TransitionRatio",
    "action_displacement",
    "check_assumptions",
    "density_ratio",
    "gaussian",
    "refuse_unsupported",
    "transition_ratio",
    "true_ratio",
    "uncovered_share",
]

if not TYPE_CHECKING:  # type checkers know every name by the imports above

    def __getattr__(name: str) -> object:
        """Import ``transition_ratio`` on use: its default shrinks, in a room above."""
        if name != "transition_ratio":
            raise AttributeError(
                f"module 'oee_tabular.ratio' has no attribute {name!r}"
            )
        return importlib.import_module("oee_tabular.shrinkage").transition_ratio
