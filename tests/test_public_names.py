"""Every name that other people's scripts may use, and where they find it: none is lost when a wall is moved."""

import importlib

import pytest

NAMES = {
    "oee_tabular": """
        ContinuousTransitions Estimate FiniteMDP Interval Moments Plan Problem RatioFit Report
        TransitionCounts TransitionRatio Transitions action_values bench check_assumptions data density_ratio
        doubly_robust_moments efficiency_bound estimators evaluate exact
        inference interval mdp mix occupancy optimal_policy plan_data_collection plots policy_is_moments
        policy_value ratio record_episodes report return_moments sample_episodes sample_returns sample_transitions
        simulate state_values tasks testing trajectory_efficiency_bound transition_ratio true_ratio uniform_policy
        value_range weighted_return_moments
    """,
    "oee_tabular.lab.bench": """
        Families Family League families garnet_worse league_of run tandem
    """,
    "oee_tabular.data": """
        ContinuousTransitions TransitionCounts Transitions
    """,
    "oee_tabular.estimators": """
        DoublyRobust DualDice Estimate Estimator ImportanceSampling Magic Marginalized ModelBased OffEnvironment
        Oracle Problem Simulator calibrate
    """,
    "oee_tabular.exact": """
        LinearSolution Model Moments ReweightedModel action_values doubly_robust_moments
        efficiency_bound evaluate_policy leading_bias occupancy optimal_policy policy_is_moments
        policy_value policy_values_by_horizon ratio_of_ratios_variance return_moments reweight solve_policy_system
        state_values trajectory_efficiency_bound transition_gradient weight_growth weight_moments
        weighted_return_moments
    """,
    "oee_tabular.lab.experiments": """
        load_saved_table published table
    """,
    "oee_tabular.inference": """
        Comparison Decision EstimationCounterexample Interval Outlook Plan RowChanges Selection Sides SimulationLemma
        compare_policies corrected_value_error_bound estimation_bound estimation_sides excess_risk interval
        kl_path_bound kl_path_sides normalised_bound normalised_sides path_kl plan_data_collection ratio_error_bound
        ratio_error_sides renyi_divergence row_changes selection_measures simulation_lemma squared_error_sides
        sup_error_bound universal_constant_counterexample unnormalised_bound unnormalised_sides
        value_bound_counterexample value_error_bound value_error_sides value_range
    """,
    "oee_tabular.mdp": """
        FiniteMDP check_policy displacements mix uniform_policy
    """,
    "oee_tabular.plots": """
        COLORS LINES MARKERS Map detect_grid map_of figure_png figure_svg label_ends plot_coverage plot_curves plot_errors
        plot_grid plot_intervals plot_occupancy plot_ratio plot_states plot_values plot_variance_growth
    """,
    "oee_tabular.ratio": """
        Assumptions Conditional InClass Joint Method Network Quotient RatioFit Sgd SgdTrace Tied
        TransitionRatio action_displacement check_assumptions density_ratio gaussian
        refuse_unsupported transition_ratio true_ratio uncovered_share
    """,
    "oee_tabular.report": """
        Report Result Settings check_output check_page evaluate evaluate_continuous
    """,
    "oee_tabular.simulate": """
        SampledReturns sample_episodes sample_returns sample_transitions
    """,
    "oee_tabular.tasks": """
        CartPole ContinuousSimulator ContinuousTask Discretization GridInterpolation GymnasiumTask HistoryTask
        KinovaArm KinovaHand LinearModel LinearReacher MonteCarlo Moves NamedTask ParameterFit Reacher ResidualSimulator
        Settings StatePolicy
        VisitedCells cartpole_policy Embedded embedded_default
        discretize evaluate_continuous
        fit_hand fit_parameters gridworld gridworld_expert gridworld_policy
        gymnasium_simulator hand_log kinova_policy
        load_kinova_log make_environment monte_carlo_value named_task reacher_log reacher_policy record
        record_episodes record_goals resimulate toy_text train_expert visited_states
    """,
    "oee_tabular.testing": """
        CASES CLAIMS Case Comparison DEFAULT LAWS Verdict Verdicts case check_estimator claims_of compare_with_oracle
        horizons logs mdp_pairs mdps padded_log policies relabelled_log
    """,
    "oee_tabular.testing.exercises": """
        check
    """,
    "oee_tabular.paper": """
        J J_of_products algorithm_1 beta d d_moves lemma risk theorem_1 theorem_2 zeta zeta_of
    """,
}


FACES = ("data", "estimators", "inference", "report", "tasks")


@pytest.mark.parametrize("module", NAMES)
def test_the_names_are_where_they_were(module):
    loaded = importlib.import_module(module)
    assert [name for name in NAMES[module].split() if not hasattr(loaded, name)] == []


@pytest.mark.parametrize("module", ["oee_tabular.data", "oee_tabular.report", "oee_tabular.tasks"])
def test_a_face_lists_what_comes_on_use(module):
    face = importlib.import_module(module)
    assert set(face.__all__) <= set(dir(face))


@pytest.mark.parametrize("module", ["oee_tabular", *(f"oee_tabular.{m}" for m in FACES)])
def test_what_is_not_there_is_said(module):
    with pytest.raises(AttributeError, match=rf"module '{module}' has no attribute 'nothing'"):
        importlib.import_module(module).nothing  # noqa: B018
