"""Off-environment evaluation, exactly.

A policy was made in a simulator; given a few logged transitions from the target environment, what return will it get
there, and how sure are we? For finite MDPs this package answers with exact linear algebra and certified convex programs.

>>> import oee_tabular as oee
>>> simulator = oee.tasks.gridworld(4, slip=0.3)
>>> target = oee.tasks.gridworld(4, slip=0.1)
>>> log = oee.sample_episodes(target, oee.uniform_policy(target), 50, horizon=50, seed=0)
>>> problem = oee.Problem(simulator, log, horizon=50)
>>> expert = oee.tasks.gridworld_expert(4)
>>> round(oee.estimators.OffEnvironment()(problem, expert).value, 1)
-3.4
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # typing takes most of the time of an import, in which the command cannot catch Ctrl-C
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.1.0"

# module -> its names at the top; imported on first use, so that "import oee_tabular" and "oee --help" stay quick
_EXPORTS = {
    "bench": "",
    "data": "ContinuousTransitions TransitionCounts Transitions",
    "design": "plan_data_collection Plan",
    "estimators": "Problem Estimate",
    "exact": "policy_value state_values action_values occupancy optimal_policy Moments return_moments "
    "weighted_return_moments policy_is_moments doubly_robust_moments efficiency_bound "
    "trajectory_efficiency_bound",
    "inference": "interval Interval",
    "mdp": "FiniteMDP uniform_policy mix",
    "plots": "",
    "ratio": "density_ratio density_ratio_samples check_assumptions transition_ratio true_ratio RatioFit "
    "TransitionRatio",
    "report": "evaluate Report",
    "simulate": "sample_episodes sample_returns sample_transitions",
    "tasks": "record_episodes",
    "testing": "",
    "theory": "",
}

if TYPE_CHECKING:
    from oee_tabular import (
        bench,
        data,
        design,
        estimators,
        exact,
        inference,
        mdp,
        plots,
        ratio,
        report,
        simulate,
        tasks,
        testing,
        theory,
    )
    from oee_tabular.data import ContinuousTransitions, TransitionCounts, Transitions
    from oee_tabular.design import Plan, plan_data_collection
    from oee_tabular.estimators import Estimate, Problem
    from oee_tabular.exact import (
        Moments,
        action_values,
        doubly_robust_moments,
        efficiency_bound,
        optimal_policy,
        policy_is_moments,
        policy_value,
        return_moments,
        state_values,
        trajectory_efficiency_bound,
        weighted_return_moments,
    )
    from oee_tabular.exact.occupancy import occupancy
    from oee_tabular.inference import Interval, interval
    from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
    from oee_tabular.ratio import (
        RatioFit,
        TransitionRatio,
        check_assumptions,
        density_ratio,
        density_ratio_samples,
        transition_ratio,
        true_ratio,
    )
    from oee_tabular.report import Report, evaluate
    from oee_tabular.simulate import sample_episodes, sample_returns, sample_transitions
    from oee_tabular.tasks import record_episodes

__all__ = [
    "ContinuousTransitions",
    "Estimate",
    "FiniteMDP",
    "Interval",
    "Moments",
    "Plan",
    "Problem",
    "RatioFit",
    "Report",
    "TransitionCounts",
    "TransitionRatio",
    "Transitions",
    "action_values",
    "bench",
    "check_assumptions",
    "data",
    "density_ratio",
    "density_ratio_samples",
    "design",
    "doubly_robust_moments",
    "efficiency_bound",
    "estimators",
    "evaluate",
    "exact",
    "inference",
    "interval",
    "mdp",
    "mix",
    "occupancy",
    "optimal_policy",
    "plan_data_collection",
    "plots",
    "policy_is_moments",
    "policy_value",
    "ratio",
    "record_episodes",
    "report",
    "return_moments",
    "sample_episodes",
    "sample_returns",
    "sample_transitions",
    "simulate",
    "state_values",
    "tasks",
    "testing",
    "theory",
    "trajectory_efficiency_bound",
    "transition_ratio",
    "true_ratio",
    "uniform_policy",
    "weighted_return_moments",
]


def __getattr__(name: str) -> Any:
    room = name if name in _EXPORTS else next((m for m, names in _EXPORTS.items() if name in names.split()), None)
    if room is None:
        raise AttributeError(f"module 'oee_tabular' has no attribute {name!r}")
    module = importlib.import_module(f"oee_tabular.{room}")
    value = globals()[name] = module if room == name else getattr(module, name)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
