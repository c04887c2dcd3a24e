"""Logged transitions: checked, counted, loaded and saved."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from oee_tabular import _moved
from oee_tabular.data.counted import TransitionCounts
from oee_tabular.data.transitions import Transitions

if TYPE_CHECKING:
    from oee_tabular.continuous.log import ContinuousTransitions

__all__ = ["ContinuousTransitions", "TransitionCounts", "Transitions"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module("oee_tabular.continuous"), name)
    return _moved.former(__name__, name)


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()})
