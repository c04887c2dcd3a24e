"""Reports: evaluate policies, and read the result as text, table, file or page."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from oee_tabular.report.evaluation import contest, evaluate
from oee_tabular.report.files import check_output, check_page
from oee_tabular.report.results import Report, Result

if TYPE_CHECKING:
    from oee_tabular.continuous.evaluation import evaluate_continuous
    from oee_tabular.continuous.simulator import Settings

__all__ = [
    "Report",
    "Result",
    "Settings",
    "check_output",
    "check_page",
    "contest",
    "evaluate",
    "evaluate_continuous",
]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module("oee_tabular.continuous"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()})
