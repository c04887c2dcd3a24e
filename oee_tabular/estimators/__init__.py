"""Estimators of a policy's value in the target: ``estimator(problem, policy, seed=...) -> Estimate``.

Objects. P (S*A, S) is the simulator, P* the target, mu (S,) the start, gamma the discount, pi (S, A) the policy, b (S, A) the
log's. n(s, a, s') are the log's counts, f = n(s, a, s') / n(s, a) its frequencies; zeta = P* / P on the support of P, or an
estimate. V_M, Q_M, J_M are values of pi in a model M, d_M(s, a) = sum_t gamma^t Pr(s_t = s, a_t = a), m = zeta P unless said
otherwise. Along a path W_t = zeta_1 ... zeta_t and rho_t = product of pi / b up to t::

    Simulator           J_P                                                                      simulator
    OffEnvironment      J_m (eq. 4.2), moved towards the log where that contradicts it           off_environment
      "monte_carlo"     mean over rollouts in P of sum_t gamma^t W r_t                           rollouts
    Oracle              the same with the true zeta                                              simulator
    ModelBased          J_f (fitted Q evaluation in a table)                                     model_based
    ImportanceSampling  mean over episodes of sum_t gamma^t rho_t r_t (eq. 3.5)                  importance_sampling
    DoublyRobust        J_P + sum d_m (f - P) (r + gamma V_P)                                    doubly_robust
      "rollouts"        D = sum_s' m (r + gamma V_P) + zeta (gamma D' - gamma V_P(s'))
      "episodes"        D = V_m(s) + rho [r + gamma D' - Q_m(s, a)]  (Jiang & Li 2016)           doubly_robust
    Magic               doubly robust for j steps, then V_m; weights on j by a quadratic
                        program (Thomas & Brunskill 2016)                                        doubly_robust
    Marginalized        E_log[beta w r] / (1 - gamma), beta = d_P / d_log, w = d_P* / d_P:
                        d_m / d_P, or A^T theta = -(1 - gamma) E phi_0 (Katdare et al. 2023)     marginalized
    DualDice            w = nu - gamma f^pi nu at the least of a quadratic (Nachum et al. 2019)  marginalized

``estimator.limit(simulator, target, policy, ...)`` is the limit of the value as the log (and its rollouts)
grow, bias included. Where the log covers the policy it is J_P* for all but the simulator,
DoublyRobust(weights="beta") (an error of second order), clipped ratios, and features whose class lacks
d_P* / d_P. Pairs never recorded are the prior's (OffEnvironment), the fallback's (ModelBased), the simulator's
(DoublyRobust, DualDice), or count nothing (Marginalized).

Standard errors are those of the log by the delta method, sqrt(sum over recorded pairs of Var_f(G) / n) with
G = dJ / dP(s' | s, a) (``exact.transition_gradient``), or of independent episodes or rollouts. OffEnvironment takes
the variances under zeta P, and adds Var(G) of each unrecorded pair inside the root.

``base`` has the common parts, ``problem`` checks the inputs (``rewards``: the log's), ``functions`` makes estimators
of functions (``as_estimator``), ``findings`` has the warnings, ``names`` the short names, ``calibrated`` removes the
error of a discretised task.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from oee_tabular.estimators.base import Estimate, Estimator
    from oee_tabular.estimators.calibrated import calibrate
    from oee_tabular.estimators.doubly_robust import DoublyRobust, Magic
    from oee_tabular.estimators.findings import Finding
    from oee_tabular.estimators.importance_sampling import ImportanceSampling
    from oee_tabular.estimators.marginalized import DualDice, Marginalized
    from oee_tabular.estimators.model_based import ModelBased
    from oee_tabular.estimators.off_environment import OffEnvironment
    from oee_tabular.estimators.problem import Problem
    from oee_tabular.estimators.simulator import Oracle, Simulator

__all__ = [  # imported on first use: ``oee --help`` reads the table of names alone
    "DoublyRobust", "DualDice", "Estimate", "Estimator", "Finding", "ImportanceSampling", "Magic", "Marginalized", "ModelBased",
    "OffEnvironment", "Oracle", "Problem", "Simulator", "calibrate",
]  # fmt: skip
_FILES = {
    "Estimate": "base", "Estimator": "base", "Finding": "findings", "DualDice": "marginalized", "Oracle": "simulator",
    "DoublyRobust": "doubly_robust", "Magic": "doubly_robust", "ImportanceSampling": "importance_sampling",
    "ModelBased": "model_based", "OffEnvironment": "off_environment", "calibrate": "calibrated",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'oee_tabular.estimators' has no attribute {name!r}")
    module = importlib.import_module(f"oee_tabular.estimators.{_FILES.get(name, name.lower())}")
    value = globals()[name] = getattr(module, name)
    return value
