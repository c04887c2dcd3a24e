"""The public names by subject, as the site lists them: module -> heading -> names, what
is used first in front.
"""

import importlib

import oee_tabular

SUBJECTS = {
    "report": {
        "From a problem to a report": (
            "evaluate",
            "evaluate_continuous",
            "ContinuousSimulator",
            "Settings",
            "Report",
            "Result",
        ),
        "Which policy is better": ("contest",),
        "Files": ("check_output", "check_page"),
    },
    "mdp": {
        "Simulators": ("FiniteMDP", "displacements"),
        "Policies": ("check_policy", "uniform_policy", "mix"),
    },
    "data": {
        "Logs": ("Transitions", "TransitionCounts", "ContinuousTransitions"),
        "Trials": ("Trials", "success_simulator"),
    },
    "inference": {
        "How sure": ("interval", "Interval", "value_range"),
        "The best policy in the worst case": ("robust_policy", "RobustPolicy"),
        "Trials beside the log": ("join_trials", "JoinedTrials"),
        "Which policy is better": (
            "compare_policies",
            "Comparison",
            "Decision",
            "selection_measures",
            "Selection",
        ),
        "Where the log contradicts the simulator": ("row_changes", "RowChanges"),
    },
    "decision": {"Which policy to deploy": ("improve", "Improvement", "Candidate")},
    "design": {"What to record next": ("plan_data_collection", "Plan", "Outlook")},
    "estimators": {
        "The problem, and what an estimator returns": (
            "Problem",
            "Estimator",
            "Estimate",
            "Diagnostics",
            "Finding",
        ),
        "From the simulator and the log": (
            "OffEnvironment",
            "ModelBased",
            "Simulator",
            "Oracle",
        ),
        "From the log's episodes": ("ImportanceSampling", "DoublyRobust", "Magic"),
        "From occupancies": ("Marginalized", "DualDice"),
        "Continuous tasks": ("calibrate",),
    },
    "shrinkage": {
        "The default": ("transition_ratio", "Shrinkage", "SoftThreshold"),
    },
    "ratio": {
        "The ratio of transitions": ("true_ratio", "TransitionRatio"),
        "Methods": (
            "Method",
            "Conditional",
            "Tied",
            "InClass",
            "Quotient",
            "Joint",
            "Network",
            "Sgd",
            "SgdTrace",
        ),
        "Priors": ("Prior", "PriorRows", "NoPrior"),
        "Ratios of two densities": (
            "density_ratio",
            "RatioFit",
            "Table",
            "Linear",
            "Kernel",
            "gaussian",
        ),
        "Support and assumptions": (
            "refuse_unsupported",
            "uncovered_share",
            "check_assumptions",
            "Assumptions",
            "action_displacement",
        ),
    },
    "exact": {
        "Values and occupancies": (
            "policy_value",
            "state_values",
            "action_values",
            "occupancy",
            "optimal_policy",
            "policy_values_by_horizon",
        ),
        "Moments of returns": (
            "return_moments",
            "weighted_return_moments",
            "policy_is_moments",
            "doubly_robust_moments",
            "Moments",
            "weight_moments",
            "weight_growth",
        ),
        "The best that an estimator can do": (
            "efficiency_bound",
            "trajectory_efficiency_bound",
            "ratio_of_ratios_variance",
            "leading_bias",
        ),
        "Models, many at once, solvers": (
            "Model",
            "ReweightedModel",
            "reweight",
            "transition_gradient",
            "evaluate_policy",
            "solve_policy_system",
            "LinearSolution",
        ),
    },
    "simulate": {
        "Sampling": (
            "sample_episodes",
            "sample_transitions",
            "sample_returns",
            "SampledReturns",
        ),
    },
    "tasks": {
        "Finite tasks": (
            "gridworld",
            "gridworld_expert",
            "gridworld_policy",
            "recycling_robot",
            "bus_engines",
            "BusEngines",
            "toy_text",
            "make_environment",
            "record_episodes",
            "named_task",
            "NamedTask",
            "embedded_default",
            "Embedded",
        ),
        "Continuous tasks as finite ones": (
            "ContinuousTask",
            "GymnasiumTask",
            "discretize",
            "GridInterpolation",
            "VisitedCells",
            "Discretization",
            "resimulate",
            "visited_states",
            "record",
            "Moves",
            "MonteCarlo",
            "monte_carlo_value",
            "StatePolicy",
            "gymnasium_simulator",
        ),
        "Continuous tasks corrected by a log": (
            "ResidualSimulator",
            "corrected_value",
            "HistoryTask",
            "fit_parameters",
            "ParameterFit",
            "LinearModel",
        ),
        "CartPole": ("CartPole", "cartpole_policy"),
        "Reacher": ("Reacher", "reacher_policy", "reacher_log"),
        "Kinova arm": (
            "KinovaArm",
            "KinovaHand",
            "kinova_policy",
            "fit_hand",
            "hand_log",
            "load_kinova_log",
            "record_goals",
            "train_expert",
        ),
    },
    "testing": {
        "Check an estimator": (
            "check_estimator",
            "Verdicts",
            "Verdict",
            "LAWS",
            "CLAIMS",
            "DEFAULT",
            "claims_of",
        ),
        "Beside an oracle": (
            "compare_with_oracle",
            "OracleComparison",
            "as_code",
            "case",
            "Case",
            "CASES",
        ),
        "Hypothesis strategies": (
            "mdps",
            "mdp_pairs",
            "policies",
            "logs",
            "horizons",
            "padded_log",
            "relabelled_log",
        ),
    },
    "testing.assignments": {
        "Code exercises of the assignments": (
            "check",
            "draw_case",
            "TASKS",
            "RefusedAnswer",
        ),
    },
    "lab.bench": {
        "Run": ("run", "League", "league_of"),
        "Families of environment shift": (
            "families",
            "Family",
            "Families",
            "garnet_worse",
            "tandem",
        ),
    },
    "theory": {
        "The paper's theorems": (
            "estimation_bound",
            "estimation_sides",
            "ratio_error_bound",
            "ratio_error_sides",
            "value_error_bound",
            "value_error_sides",
            "Sides",
        ),
        "Their counterexamples": (
            "EstimationCounterexample",
            "universal_constant_counterexample",
            "value_bound_counterexample",
        ),
        "What holds instead": (
            "simulation_lemma",
            "SimulationLemma",
            "corrected_value_error_bound",
            "normalised_bound",
            "normalised_sides",
            "unnormalised_bound",
            "unnormalised_sides",
            "sup_error_bound",
            "squared_error_sides",
            "excess_risk",
            "kl_path_bound",
            "kl_path_sides",
            "path_kl",
            "renyi_divergence",
        ),
    },
    "plots": {
        "Values": (
            "plot_values",
            "plot_intervals",
            "plot_curves",
            "plot_errors",
            "plot_variance_growth",
        ),
        "Grids and states": (
            "plot_grid",
            "plot_occupancy",
            "plot_coverage",
            "plot_ratio",
            "plot_states",
            "plot_policy",
            "plot_paths",
            "animate_two",
            "detect_grid",
            "map_of",
            "Map",
        ),
        "Files and style": (
            "label_ends",
            "schematic",
            "save_figure",
            "slides",
            "figure_png",
            "figure_svg",
            "COLORS",
            "LINES",
            "MARKERS",
        ),
    },
    "exceptions": {
        "Errors": (
            "ArgumentError",
            "AnswerError",
            "DivergentKernelError",
            "NoCellsError",
            "SolverStatusError",
            "UnknownKeywordError",
        ),
        "Warnings": (
            "OeeWarning",
            "CostWarning",
            "DataWarning",
            "DiscretizationWarning",
            "NumericalWarning",
            "OutputWarning",
            "SimulatorWarning",
        ),
    },
    "paper": {
        "Equation by equation": (
            "J",
            "d",
            "d_moves",
            "risk",
            "beta",
            "zeta",
            "zeta_of",
            "J_of_products",
            "algorithm_1",
            "theorem_1",
            "lemma",
            "theorem_2",
        )
    },
}


def public(module):
    """The public names of a module: its ``__all__``, or those of the package that come
    from it.
    """
    loaded = importlib.import_module(f"oee_tabular.{module}")
    names = getattr(loaded, "__all__", None)
    if names is not None:
        return set(names)
    top = {
        name: getattr(getattr(oee_tabular, name), "__module__", "")
        for name in oee_tabular.__all__
    }
    return {
        name
        for name, origin in top.items()
        if origin.startswith(f"oee_tabular.{module}")
    }
