"""Estimators of a policy's value in the target environment.

An estimator is called as ``estimator(problem, policy, seed=...)`` and returns an
``Estimate``. In the overview P (S*A, S) is the simulator, P* the target, mu (S,) the
initial distribution, gamma the discount, pi (S, A) the policy and b (S, A) that of the
log. n(s, a, s') are the log's counts, and f = n(s, a, s') / n(s, a) its frequencies;
zeta is P* / P on the support of P, or an estimate of it, and m = zeta P unless said
otherwise. V_M, Q_M and J_M are values of pi in a model M, and d_M(s, a) = sum_t gamma^t
Pr(s_t = s, a_t = a) are its occupancies. Along a path W_t = zeta_1 ... zeta_t, and
rho_t is the product of pi / b up to t.

======================  ==============================================================
Estimator               Value
======================  ==============================================================
``Simulator``           J_P.
``OffEnvironment``      J_m (eq. 4.2), moved towards the log where that contradicts
                        it; with evaluation "monte_carlo" the mean over rollouts in P
                        of sum_t gamma^t W r_t.
``Oracle``              The same with the true zeta.
``ModelBased``          J_f: fitted Q evaluation in a table, whose unrecorded pairs
                        stay, take the simulator's rows, or have Q = 0.
``ImportanceSampling``  The mean over episodes of sum_t gamma^t rho_t r_t (eq. 3.5).
``DoublyRobust``        J_P + sum d_m (f - P) (r + gamma V_P); with data "rollouts" or
                        "episodes" a mean of sums with control variates (Jiang and Li
                        2016).
``Magic``               Doubly robust for j steps, then V_m; the weights of the j are
                        those of a quadratic program (Thomas and Brunskill 2016).
``Marginalized``        E_log[beta w r] / (1 - gamma), with beta = d_P / d_log and w =
                        d_P* / d_P from d_m, or from features (Katdare et al. 2023).
``DualDice``            The same w = nu - gamma f^pi nu at the least of a quadratic
                        (Nachum et al. 2019).
======================  ==============================================================

``estimator.limit(simulator, target, policy, ...)`` is the limit of the value as the log
(and the number of rollouts) grows, bias included. Where the log covers the policy it is
J_P* except for the simulator, ``DoublyRobust(weights="beta")`` (an error of second
order), clipped ratios, and features whose class lacks d_P* / d_P. In unrecorded pairs
the model has the rows of the prior (OffEnvironment), of the fallback (ModelBased) or of
the simulator (DoublyRobust, DualDice), or their reward counts as 0 (Marginalized).

Standard errors are those of the log by the delta method, the root of the sum over
recorded pairs of Var_f(G) / n with G = dJ / dP(s' | s, a)
(``exact.transition_gradient``), or those of independent episodes or rollouts.
OffEnvironment takes the variances under zeta P, and adds Var(G) of each unrecorded pair
inside the root.

``estimate`` and ``diagnostics`` are what estimators return; ``base`` is their base
class, ``ratio_based`` that of those that use zeta. ``errors`` has standard errors,
``recorded_time`` the share of the policy's time that the log has recorded. ``problem``
checks the inputs (``rewards``: those of the log), ``functions`` makes estimators of
functions (``as_estimator``), ``findings`` has the warnings, ``names`` the short names,
and ``calibrated`` removes the error of a discretised task.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False
if TYPE_CHECKING:  # the same for type checkers
    from typing import Any

    from oee_tabular.estimators.calibrated import calibrate as calibrate
    from oee_tabular.estimators.diagnostics import Diagnostics as Diagnostics
    from oee_tabular.estimators.doubly_robust import DoublyRobust as DoublyRobust
    from oee_tabular.estimators.doubly_robust import Magic as Magic
    from oee_tabular.estimators.estimate import Estimate as Estimate
    from oee_tabular.estimators.estimate import Estimator as Estimator
    from oee_tabular.estimators.findings import Finding as Finding
    from oee_tabular.estimators.importance_sampling import (
        ImportanceSampling as ImportanceSampling,
    )
    from oee_tabular.estimators.marginalized import DualDice as DualDice
    from oee_tabular.estimators.marginalized import Marginalized as Marginalized
    from oee_tabular.estimators.model_based import ModelBased as ModelBased
    from oee_tabular.estimators.off_environment import OffEnvironment as OffEnvironment
    from oee_tabular.estimators.problem import Problem as Problem
    from oee_tabular.estimators.simulator import Oracle as Oracle
    from oee_tabular.estimators.simulator import Simulator as Simulator

# the public names of each file, which is imported on first use: ``oee --help`` needs
# the table of short names alone
_NAMES = {
    "calibrated": "calibrate",
    "diagnostics": "Diagnostics",
    "doubly_robust": "DoublyRobust Magic",
    "estimate": "Estimate Estimator",
    "findings": "Finding",
    "importance_sampling": "ImportanceSampling",
    "marginalized": "DualDice Marginalized",
    "model_based": "ModelBased",
    "off_environment": "OffEnvironment",
    "problem": "Problem",
    "simulator": "Oracle Simulator",
}
_FILE_OF = {name: file for file, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_FILE_OF)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Import a public name on its first use."""
    if name not in _FILE_OF:
        raise AttributeError(
            f"module 'oee_tabular.estimators' has no attribute {name!r}"
        )
    module = importlib.import_module(f"oee_tabular.estimators.{_FILE_OF[name]}")
    value = globals()[name] = getattr(module, name)
    return value
