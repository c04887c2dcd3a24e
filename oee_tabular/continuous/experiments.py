"""The experiments on continuous tasks."""

from oee_tabular.continuous.cartpole.experiment import CARTPOLE_CHOICE, CARTPOLE_DATA, FIGURE_2, RESOLUTION
from oee_tabular.continuous.kinova.experiment import TABLE_1
from oee_tabular.continuous.reacher.experiment import FIGURE_3

CONTINUOUS = (FIGURE_2, RESOLUTION, CARTPOLE_DATA, CARTPOLE_CHOICE, FIGURE_3, TABLE_1)
