"""Tasks that become finite MDPs: the paper's gridworld and Gymnasium's toy text; recording by stepping an environment."""

from oee_tabular.tasks.gridworld import gridworld, gridworld_expert, gridworld_policy
from oee_tabular.tasks.recording import record_episodes
from oee_tabular.tasks.specs import NamedTask, named_task
from oee_tabular.tasks.toy_text import make_environment, toy_text

__all__ = [
    "NamedTask",
    "gridworld",
    "gridworld_expert",
    "gridworld_policy",
    "make_environment",
    "named_task",
    "record_episodes",
    "toy_text",
]
