"""Every name that other people's scripts may use, and where they find it (a room's:
notebooks/subjects.py).
"""

import importlib

import pytest

NAMES = {
    "oee_tabular": (
        """
        ContinuousTransitions Estimate FiniteMDP Interval Moments Plan Problem RatioFit Report
        RobustPolicy TransitionCounts TransitionRatio Transitions Trials action_values bench check_assumptions data
        density_ratio
        doubly_robust_moments efficiency_bound estimators evaluate exact
        Improvement decision improve inference interval mdp mix occupancy optimal_policy plan_data_collection plots
        policy_is_moments
        policy_value ratio record_episodes report return_moments robust_policy sample_episodes sample_returns sample_transitions
        shrinkage simulate state_values tasks testing trajectory_efficiency_bound transition_ratio true_ratio uniform_policy
        value_range weighted_return_moments
    """
    ),
    "oee_tabular.ratio": (
        """
        Conditional Joint Network Quotient Sgd density_ratio transition_ratio true_ratio
    """
    ),
    "oee_tabular.shrinkage": (
        """
        Shrinkage SoftThreshold transition_ratio
    """
    ),
    "oee_tabular.lab.experiments": (
        """
        load_saved_table published table
    """
    ),
    "oee_tabular.inference": (
        """
        Comparison Decision EstimationCounterexample Interval JoinedTrials Outlook Plan RowChanges
        Selection Sides SimulationLemma
        compare_policies corrected_value_error_bound estimation_bound estimation_sides excess_risk interval
        join_trials kl_path_bound kl_path_sides normalised_bound normalised_sides path_kl plan_data_collection ratio_error_bound
        ratio_error_sides renyi_divergence row_changes selection_measures simulation_lemma squared_error_sides
        sup_error_bound universal_constant_counterexample unnormalised_bound unnormalised_sides
        value_bound_counterexample value_error_bound value_error_sides value_range
    """
    ),
    "oee_tabular.testing.exercises": (
        """
        check
    """
    ),
    "oee_tabular.testing.assignments": (
        """
        TASKS RefusedAnswer check draw_case
    """
    ),
}


FACES = ("data", "estimators", "inference", "report", "tasks")


@pytest.mark.parametrize("module", NAMES)
def test_the_names_are_where_they_were(module):
    loaded = importlib.import_module(module)
    assert [name for name in NAMES[module].split() if not hasattr(loaded, name)] == []


@pytest.mark.parametrize(
    "module", ["oee_tabular.data", "oee_tabular.report", "oee_tabular.tasks"]
)
def test_a_face_lists_what_comes_on_use(module):
    face = importlib.import_module(module)
    assert set(face.__all__) <= set(dir(face))


@pytest.mark.parametrize(
    "module", ["oee_tabular", *(f"oee_tabular.{m}" for m in FACES)]
)
def test_missing_names_are_reported(module):
    with pytest.raises(
        AttributeError, match=rf"module '{module}' has no attribute 'nothing'"
    ):
        importlib.import_module(module).nothing  # noqa: B018
