"""Every public name of before the wing, and every module that moved into it, is where users' scripts have it."""

import importlib
import subprocess
import sys

import pytest

from oee_tabular._moved import MOVED

NAMES = {
    "oee_tabular": (
        "ContinuousTransitions Estimate FiniteMDP Interval Moments Plan Problem RatioFit Report TransitionRatio "
        "Transitions action_values bench check_assumptions data density_ratio density_ratio_samples "
        "doubly_robust_moments efficiency_bound estimators evaluate exact inference interval mdp mix occupancy "
        "optimal_policy plan_data_collection plots policy_is_moments policy_value ratio record_episodes report "
        "return_moments sample_episodes sample_returns sample_transitions simulate state_values tasks testing "
        "trajectory_efficiency_bound transition_ratio true_ratio uniform_policy weighted_return_moments "
    ),
    "oee_tabular.tasks": (
        "ArmCells CartPole Closure ContinuousTask Discretization GridInterpolation GymnasiumTask KinovaArm "
        "KinovaHand LinearReacher MonteCarlo Moves NamedTask Reacher StatePolicy VisitedCells arm_cells cartpole "
        "cartpole_expert cartpole_policy continuous continuous_sampling continuous_simulator defensive_mixture "
        "discretize discretize_cells discretize_closure discretize_geometry discretize_grid discretize_gymnasium "
        "discretize_mixture fit_hand gridworld gridworld_expert gridworld_policy hand_log kinova kinova_arm "
        "kinova_kinematics kinova_logs kinova_model kinova_policy load_kinova_log make_environment "
        "monte_carlo_value named_arguments named_arms named_continuous named_task reacher reacher_cells "
        "reacher_expert reacher_linear reacher_log reacher_policy record record_episodes record_goals recording "
        "resimulate specs toy_text train_expert visited_states "
    ),
    "oee_tabular.data": ("ContinuousTransitions Transitions continuous continuous_files files tables transitions "),
    "oee_tabular.report": (
        "Report Result Settings check_output check_page continuous continuous_estimators evaluate "
        "evaluate_continuous evaluation files quoting results "
    ),
    "oee_tabular.experiments": ("Embedded embedded_default "),
}


@pytest.mark.parametrize("module", NAMES)
def test_every_name_is_there(module):
    face = importlib.import_module(module)
    names = NAMES[module].split()
    assert names
    for name in names:
        assert getattr(face, name) is not None
    assert set(face.__all__) <= set(dir(face))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        face.nothing  # noqa: B018


@pytest.mark.parametrize("name", MOVED)
def test_a_former_module_is_the_module_itself(name):
    found = importlib.import_module(f"oee_tabular.{name}")
    assert found is importlib.import_module(f"oee_tabular.{MOVED[name]}")
    assert found.__spec__.name == found.__name__ == f"oee_tabular.{MOVED[name]}"


def test_the_core_does_not_import_the_wing():
    code = (
        "import sys, oee_tabular as oee\n"
        "oee.tasks.gridworld, oee.Transitions, oee.report.evaluate, oee.experiments if hasattr(oee, 'experiments') else 0\n"
        "assert not [name for name in sys.modules if name.startswith('oee_tabular.continuous')]\n"
        "assert oee.tasks.CartPole is oee.tasks.cartpole.CartPole\n"
        "from oee_tabular.tasks.reacher import fingertip\n"
        "from oee_tabular.data import ContinuousTransitions\n"
        "assert ContinuousTransitions is oee.ContinuousTransitions\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
