"""How sure: intervals, comparisons of policies, and where the log contradicts the simulator.

The theorems (``oee_tabular.theory``) and plans (``oee_tabular.design``) are reachable here as well.
"""

from __future__ import annotations

import importlib

from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.inference.comparison import Comparison, Decision, Selection, compare_policies, selection_measures
from oee_tabular.inference.intervals import Interval, interval
from oee_tabular.inference.ranges import value_range

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from oee_tabular.design import *  # noqa: F403
    from oee_tabular.theory import *  # noqa: F403

__all__ = [
    "Comparison",
    "Decision",
    "Interval",
    "RowChanges",
    "Selection",
    "compare_policies",
    "interval",
    "row_changes",
    "selection_measures",
    "value_range",
]


def __getattr__(name: str) -> Any:
    for room in ("theory", "design"):
        module = importlib.import_module(f"oee_tabular.{room}")
        if name in module.__all__:
            return getattr(module, name)
    raise AttributeError(f"module 'oee_tabular.inference' has no attribute {name!r}")
