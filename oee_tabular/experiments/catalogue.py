"""All experiments by id."""

import importlib

from oee_tabular.experiments.convergence import MISSPECIFIED, RATE
from oee_tabular.experiments.efficiency import COLLECTION, EFFICIENCY
from oee_tabular.experiments.figure_1a import FIGURE_1A, NETWORKS
from oee_tabular.experiments.figure_1bcd import ESTIMANDS, FIGURE_1BCD
from oee_tabular.experiments.horizons import DATA_POLICY, HORIZON_EXPERIMENT
from oee_tabular.experiments.programs import LAMBDA, NORMALISATION, RENYI
from oee_tabular.experiments.registry import Registry
from oee_tabular.experiments.sureness import COVERAGE, COVERAGE_LAKE
from oee_tabular.experiments.toy_text import CLIFF_WALKING, FROZEN_LAKE, TAXI

WING = importlib.import_module("oee_tabular.continuous")  # which imports the core, and is not imported by it

EXPERIMENTS = Registry(
    [
        FIGURE_1A, FIGURE_1BCD, ESTIMANDS, HORIZON_EXPERIMENT, DATA_POLICY, RATE, RENYI, MISSPECIFIED, NORMALISATION, LAMBDA,
        FROZEN_LAKE, TAXI, CLIFF_WALKING, COVERAGE, COVERAGE_LAKE, EFFICIENCY, COLLECTION, NETWORKS,
        WING.FIGURE_2, WING.RESOLUTION, WING.CARTPOLE_DATA, WING.CARTPOLE_CHOICE, WING.FIGURE_3, WING.TABLE_1, WING.CHANGES,
        WING.RESIDUAL_COVERAGE,
    ]
)  # fmt: skip
