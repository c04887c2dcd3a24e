"""Off-environment evaluation, exactly.

A policy was made in a simulator; given a few logged transitions from the target
environment, what return will it get there, and how sure are we? For finite MDPs this
package answers with exact linear algebra and certified convex programs.

>>> import oee_tabular as oee
>>> simulator = oee.tasks.gridworld(4, slip=0.3)
>>> target = oee.tasks.gridworld(4, slip=0.1)
>>> log = oee.sample_episodes(
...     target, oee.uniform_policy(target), 50, horizon=50, seed=0
... )
>>> problem = oee.Problem(simulator, log, horizon=50)
>>> expert = oee.tasks.gridworld_expert(4)
>>> round(oee.estimators.OffEnvironment()(problem, expert).value, 1)
-3.6
"""

# "python -m oee_tabular" runs this file with the current folder first on the path:
# "from __future__" would be imported from there; importlib is there already
import importlib

# typing takes most of the time of an import, in which the command cannot catch Ctrl-C
TYPE_CHECKING = False

__version__ = "0.1.0"

# module -> its names at the top; imported on first use, so that "import oee_tabular"
# and "oee --help" stay quick
_EXPORTS: dict[str, tuple[str, ...]] = {
    "bench": (),
    "data": (
        "ContinuousTransitions",
        "TransitionCounts",
        "Transitions",
    ),
    "decision": (
        "Improvement",
        "improve",
    ),
    "design": (
        "Plan",
        "plan_data_collection",
    ),
    "estimators": (
        "Estimate",
        "Problem",
    ),
    "exact": (
        "Moments",
        "action_values",
        "doubly_robust_moments",
        "efficiency_bound",
        "occupancy",
        "optimal_policy",
        "policy_is_moments",
        "policy_value",
        "return_moments",
        "state_values",
        "trajectory_efficiency_bound",
        "weighted_return_moments",
    ),
    "exceptions": (),
    "inference": (
        "Interval",
        "RobustPolicy",
        "interval",
        "robust_policy",
        "value_range",
    ),
    "mdp": (
        "FiniteMDP",
        "mix",
        "uniform_policy",
    ),
    "plots": (),
    "ratio": (
        "RatioFit",
        "TransitionRatio",
        "check_assumptions",
        "density_ratio",
        "true_ratio",
    ),
    "report": (
        "Report",
        "evaluate",
    ),
    "shrinkage": ("transition_ratio",),
    "simulate": (
        "sample_episodes",
        "sample_returns",
        "sample_transitions",
    ),
    "tasks": ("record_episodes",),
    "testing": (),
    "theory": (),
}

if TYPE_CHECKING:  # the same for type checkers
    from typing import Any

    from oee_tabular import data as data
    from oee_tabular import decision as decision
    from oee_tabular import design as design
    from oee_tabular import estimators as estimators
    from oee_tabular import exact as exact
    from oee_tabular import exceptions as exceptions
    from oee_tabular import inference as inference
    from oee_tabular import mdp as mdp
    from oee_tabular import plots as plots
    from oee_tabular import ratio as ratio
    from oee_tabular import report as report
    from oee_tabular import shrinkage as shrinkage
    from oee_tabular import simulate as simulate
    from oee_tabular import tasks as tasks
    from oee_tabular import testing as testing
    from oee_tabular import theory as theory
    from oee_tabular.data import ContinuousTransitions as ContinuousTransitions
    from oee_tabular.data import TransitionCounts as TransitionCounts
    from oee_tabular.data import Transitions as Transitions
    from oee_tabular.decision import Improvement as Improvement
    from oee_tabular.decision import improve as improve
    from oee_tabular.design import Plan as Plan
    from oee_tabular.design import plan_data_collection as plan_data_collection
    from oee_tabular.estimators import Estimate as Estimate
    from oee_tabular.estimators import Problem as Problem
    from oee_tabular.exact import Moments as Moments
    from oee_tabular.exact import action_values as action_values
    from oee_tabular.exact import doubly_robust_moments as doubly_robust_moments
    from oee_tabular.exact import efficiency_bound as efficiency_bound
    from oee_tabular.exact import optimal_policy as optimal_policy
    from oee_tabular.exact import policy_is_moments as policy_is_moments
    from oee_tabular.exact import policy_value as policy_value
    from oee_tabular.exact import return_moments as return_moments
    from oee_tabular.exact import state_values as state_values
    from oee_tabular.exact import (
        trajectory_efficiency_bound as trajectory_efficiency_bound,
    )
    from oee_tabular.exact import weighted_return_moments as weighted_return_moments
    from oee_tabular.exact.occupancy import occupancy as occupancy
    from oee_tabular.inference import Interval as Interval
    from oee_tabular.inference import RobustPolicy as RobustPolicy
    from oee_tabular.inference import interval as interval
    from oee_tabular.inference import robust_policy as robust_policy
    from oee_tabular.inference import value_range as value_range
    from oee_tabular.lab import bench as bench
    from oee_tabular.mdp import FiniteMDP as FiniteMDP
    from oee_tabular.mdp import mix as mix
    from oee_tabular.mdp import uniform_policy as uniform_policy
    from oee_tabular.ratio import RatioFit as RatioFit
    from oee_tabular.ratio import TransitionRatio as TransitionRatio
    from oee_tabular.ratio import check_assumptions as check_assumptions
    from oee_tabular.ratio import density_ratio as density_ratio
    from oee_tabular.ratio import true_ratio as true_ratio
    from oee_tabular.report import Report as Report
    from oee_tabular.report import evaluate as evaluate
    from oee_tabular.shrinkage import transition_ratio as transition_ratio
    from oee_tabular.simulate import sample_episodes as sample_episodes
    from oee_tabular.simulate import sample_returns as sample_returns
    from oee_tabular.simulate import sample_transitions as sample_transitions
    from oee_tabular.tasks import record_episodes as record_episodes

_ROOM_OF = {name: room for room, names in _EXPORTS.items() for name in (room, *names)}
__all__ = sorted(_ROOM_OF)  # noqa: PLE0605


def __getattr__(name: str) -> "Any":
    if name not in _ROOM_OF:
        raise AttributeError(f"module 'oee_tabular' has no attribute {name!r}")
    path = _ROOM_OF[name].replace("bench", "lab.bench")
    room = importlib.import_module(f"oee_tabular.{path}")
    value = globals()[name] = room if name in _EXPORTS else getattr(room, name)
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
