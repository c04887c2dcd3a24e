"""Logged transitions: checked, counted, loaded and saved."""

from oee_tabular.data.continuous import ContinuousTransitions
from oee_tabular.data.transitions import Transitions

__all__ = ["ContinuousTransitions", "Transitions"]
