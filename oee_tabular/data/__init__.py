"""Logged transitions: checked, counted, loaded and saved."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

from oee_tabular.data.counting import open_log
from oee_tabular.data.counts import TransitionCounts, holds_counts
from oee_tabular.data.transitions import Transitions, as_log

if TYPE_CHECKING:
    from oee_tabular.continuous.log import ContinuousTransitions


Transitions.open = staticmethod(open_log)  # here, for counts are made of logs: logs need not know how they are counted


def read_log(source: Any, simulator: Any, name: str = "log") -> Transitions | TransitionCounts:
    """What was recorded, in the simulator's numbers, of whatever form it has.

    ``source``: Transitions, counts, a data frame, episodes as lists of steps, a path, or a list of paths, a pattern or a
    folder. ``name``: what errors call it.
    """
    if isinstance(source, TransitionCounts):
        return source
    if isinstance(source, str | os.PathLike) and holds_counts(source):
        return TransitionCounts.load(source)
    return as_log(source, simulator, name)


__all__ = ["ContinuousTransitions", "TransitionCounts", "Transitions"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module("oee_tabular.continuous"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()})
