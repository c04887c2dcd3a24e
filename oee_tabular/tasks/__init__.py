"""Tasks that become finite MDPs: the paper's gridworld, Gymnasium's toy text, and continuous tasks by discretisation."""

from oee_tabular.tasks.cartpole import CartPole, cartpole_policy
from oee_tabular.tasks.cartpole_expert import train_expert
from oee_tabular.tasks.continuous import ContinuousTask, Moves, StatePolicy
from oee_tabular.tasks.continuous_sampling import MonteCarlo, monte_carlo_value, record, resimulate
from oee_tabular.tasks.discretize import Discretization
from oee_tabular.tasks.discretize_cells import VisitedCells, visited_states
from oee_tabular.tasks.discretize_closure import Closure
from oee_tabular.tasks.discretize_grid import GridInterpolation
from oee_tabular.tasks.discretize_gymnasium import GymnasiumTask
from oee_tabular.tasks.discretize_mixture import defensive_mixture
from oee_tabular.tasks.gridworld import gridworld, gridworld_expert, gridworld_policy
from oee_tabular.tasks.kinova import (
    KinovaArm,
    KinovaHand,
    fit_hand,
    hand_log,
    kinova_model,
    kinova_policy,
    load_kinova_log,
    record_goals,
)
from oee_tabular.tasks.reacher import Reacher
from oee_tabular.tasks.reacher_cells import ArmCells, arm_cells, reacher_log
from oee_tabular.tasks.reacher_expert import reacher_policy
from oee_tabular.tasks.reacher_linear import LinearReacher
from oee_tabular.tasks.recording import record_episodes
from oee_tabular.tasks.specs import NamedTask, named_task
from oee_tabular.tasks.toy_text import make_environment, toy_text

__all__ = [
    "ArmCells",
    "CartPole",
    "Closure",
    "ContinuousTask",
    "Discretization",
    "GridInterpolation",
    "GymnasiumTask",
    "KinovaArm",
    "KinovaHand",
    "LinearReacher",
    "MonteCarlo",
    "Moves",
    "NamedTask",
    "Reacher",
    "StatePolicy",
    "VisitedCells",
    "arm_cells",
    "cartpole_policy",
    "defensive_mixture",
    "fit_hand",
    "gridworld",
    "gridworld_expert",
    "gridworld_policy",
    "hand_log",
    "kinova_model",
    "kinova_policy",
    "load_kinova_log",
    "make_environment",
    "monte_carlo_value",
    "named_task",
    "reacher_log",
    "reacher_policy",
    "record",
    "record_episodes",
    "record_goals",
    "resimulate",
    "toy_text",
    "train_expert",
    "visited_states",
]
