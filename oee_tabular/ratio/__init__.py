"""The paper's programs: density ratios (beta) and transition ratios (zeta).

Each program stands below with its number in the paper, its dual, its certificate and
the file that solves it. The paper ends here: the prior that the default shrinks to is
in ``oee_tabular.shrinkage``.

Objects
-------
::

    p, q          (n,) distributions of target and simulator on the same cells
    beta = p / q  (n,) their ratio, estimated by g (n,) in the box nu <= g <= mu
    P, n_sas'     (S*A, S) the simulator's transitions and the log's counts; n_sa and n
                  are their sums
    zeta          (S*A, S) on P's support, P_target / P (eq. 4.3); P_target = zeta * P

``true_ratio`` (``exact_ratio``) is zeta of two models.

Density ratio (eq. 3.6, 3.7): ``density_ratio``
-----------------------------------------------
::

    primal       minimise  sum q g - p log g + lambda/2 I(g)^2
                 over      nu <= g <= mu,  and sum q g = 1 with [1]
    dual         maximise over m  sum_x min_g h_x(g; m) - (m - 1),
                 h_x(g; m) = m q g - p log g + lambda/2 g^2, one root in m
    certificate  gap = sum_x [h_x(g_x; m) - min h_x] + |m - 1| |sum q g - 1|
    files        density; solved in dual, certified in _certificate

g is p / q where it maximises a lower bound on KL(p || q). Every term of the gap is
nonnegative, and it is computed by code that no solver uses.

Quotient (eq. 4.4): ``Quotient``
--------------------------------
::

    primal       eq. 3.7 twice, on (s, a, s') and on (s, a):
                 zeta = beta(s, a, s') / beta(s, a), in [nu / mu, mu / nu]
    dual         as above, each by itself
    certificate  the larger of the two gaps
    file         quotient

Its rows zeta * P need not sum to 1: ``row_sum_error``.

Both betas in one program: ``Joint``
------------------------------------
::

    primal       the sum of the two risks of the quotient, subject to
                 sum_s' d(s, a, s') beta(s, a, s') = d(s, a) beta(s, a)   (of eq. 3.3)
    dual         a multiplier theta for each (s, a): two nested roots
    certificate  as above, with |theta| times what a constraint is missed by
    file         joint

The constraint makes the rows of zeta * P sum to 1.

Row by row, P known: ``Conditional``
------------------------------------
::

    primal       eq. 3.7 in each row (s, a) with q = P(. | s, a) and p the row's
                 frequencies, mixed with a prior row m that is worth kappa transitions:
                 p = (n_sas' + kappa m) / (n_sa + kappa)
    solution     without ridge and box zeta = (n_sas' + kappa m) / (n_sa + kappa) / P
    dual         that of eq. 3.7, a multiplier for each row
    certificate  the largest gap of a row
    files        conditional; the prior is an object: prior

``NoPrior`` (prior="none") is the paper's risk. Other names of priors are shorthands for
``oee_tabular.shrinkage.Shrinkage``.

One ratio for all entries with a key: ``Tied``
----------------------------------------------
::

    primal       minimise  sum_c M_c g_c - N_c log g_c,  sum_c M_c g_c = sum_c N_c,
                 with counts N_c and expected counts M_c of each key c
    dual         that of eq. 3.7, a multiplier for each group of keys
    certificate  the largest gap of a group
    file         ties

Linear and kernel classes: ``Linear``, ``Kernel``, ``InClass``
--------------------------------------------------------------
::

    primal       eq. 3.7 over g = offset + Phi w, with lambda/2 |w|^2
    dual         D(v, eta) = sum_x min {(q + v + eta q) g - p log g}
                             - v . offset - |Phi^T v|^2 / (2 lambda) - eta
    certificate  the value at w less D at the solver's v and eta
    files        linear, solved by Clarabel; classes of density_ratio in functions,
                 features and kernels (pivoted Cholesky) in features

``InClass`` has offset 1 and features centred in each row, so that rows of zeta * P sum
to 1 for every w.

Algorithm 1: ``Sgd``, ``Network``
---------------------------------
::

    iteration    g <- clip(g - step * gradient of a batch, nu, mu)
    certificate  none of its own: the trace is measured against the exact optimum
    files        sgd on tables; network, _neural for the paper's perceptrons (extra
                 neural)

Where the rest is
-----------------
::

    statements   every program as cvxpy states it: the reference of the tests
    method       the base of methods: checked input, ``fit``, ``limit``
    result       zeta with its certificate, its standard error and its one-step
                 correction
    support      transitions to which the simulator gives probability 0

To add a method, derive from ``Method`` and define ``_fit``. To add a solver of eq. 3.7,
return g and the multiplier of the sum, as ``statements.solve_rows`` does, and call it
beside that in ``density._solve_table`` and in ``Conditional._fit``; the certificate
judges it. A prior along directions is fitted by the solver of the same name.

Names of methods in ``transition_ratio`` and on the command line: "conditional" is
``Conditional``, "tied" ``Tied``, "linear" and "kernel" ``InClass``, "ratio_of_ratios"
``Quotient`` and "joint" ``Joint``.

Guarantees
----------
The gap of a fit is in nats; "optimal" is at most 1e-8. Rows of zeta * P sum to 1 except
with ``Quotient``. Where a pair was never recorded zeta is 1 with ``NoPrior``, else what
the method carries over to it: the prior's, that of the class of functions, of the keys,
or the quotient's. A transition that the simulator cannot make is an error that names
it.

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
