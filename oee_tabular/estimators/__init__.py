"""Estimators of a policy's value in the target: ``estimator(problem, policy, seed=...)
-> Estimate``.

Objects. P (S*A, S) is the simulator, P* the target, mu (S,) the start, gamma the
discount, pi (S, A) the policy, b (S, A) the log's. n(s, a, s') are the log's counts, f
= n(s, a, s') / n(s, a) its frequencies; zeta = P* / P on the support of P, or an
estimate. V_M, Q_M, J_M are values of pi in a model M, d_M(s, a) = sum_t gamma^t Pr(s_t
= s, a_t = a), m = zeta P unless said otherwise. Along a path W_t = zeta_1 ... zeta_t
and rho_t = product of pi / b up to t::

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

``estimator.limit(simulator, target, policy, ...)`` is the limit of the value as the log
(and its rollouts)
grow, bias included. Where the log covers the policy it is J_P* for all but the
simulator, DoublyRobust(weights="beta") (an error of second order), clipped ratios, and
features whose class lacks
d_P* / d_P. Pairs never recorded are the prior's (OffEnvironment), the fallback's
(ModelBased), the simulator's (DoublyRobust, DualDice), or count nothing (Marginalized).

Standard errors are those of the log by the delta method, sqrt(sum over recorded pairs
of Var_f(G) / n) with
G = dJ / dP(s' | s, a) (``exact.transition_gradient``), or of independent episodes or
rollouts. OffEnvironment takes the variances under zeta P, and adds Var(G) of each
unrecorded pair inside the root.

``base`` has the common parts, ``problem`` checks the inputs (``rewards``: the log's),
``functions`` makes estimators of functions (``as_estimator``), ``findings`` has the
warnings, ``names`` the short names, ``calibrated`` removes the error of a discretised
task.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False
if TYPE_CHECKING:  # the same for type checkers
    from typing import Any

    from oee_tabular.estimators.base import Estimate as Estimate
    from oee_tabular.estimators.base import Estimator as Estimator
    from oee_tabular.estimators.calibrated import calibrate as calibrate
    from oee_tabular.estimators.doubly_robust import DoublyRobust as DoublyRobust
    from oee_tabular.estimators.doubly_robust import Magic as Magic
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

# of each file, imported on first use: ``oee --help`` reads the table of names alone
_NAMES = {
    "base": "Estimate Estimator",
    "calibrated": "calibrate",
    "doubly_robust": "DoublyRobust Magic",
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
    if name not in _FILE_OF:
        raise AttributeError(
            f"module 'oee_tabular.estimators' has no attribute {name!r}"
        )
    module = importlib.import_module(f"oee_tabular.estimators.{_FILE_OF[name]}")
    value = globals()[name] = getattr(module, name)
    return value
