"""Reports: evaluate policies, and read the result as text, table, file or page."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from oee_tabular.report.evaluation import contest, evaluate
from oee_tabular.report.evaluation import contest_showing as contest_showing
from oee_tabular.report.evaluation import evaluate_showing as evaluate_showing
from oee_tabular.report.evaluation import group_findings as group_findings
from oee_tabular.report.evaluation import kinds_of_findings as kinds_of_findings
from oee_tabular.report.evaluation import number_notes as number_notes
from oee_tabular.report.files import ReportOutput as ReportOutput
from oee_tabular.report.files import check_output, check_page
from oee_tabular.report.files import new_page as new_page
from oee_tabular.report.files import plain as plain
from oee_tabular.report.files import summary as summary
from oee_tabular.report.results import Report
from oee_tabular.report.results import Source as Source
from oee_tabular.report.results import add_log_notes as add_log_notes
from oee_tabular.report.rows import Result
from oee_tabular.report.selection import is_best_in_log as is_best_in_log
from oee_tabular.report.tables import render_comparison as render_comparison
from oee_tabular.report.tables import render_intervals as render_intervals
from oee_tabular.report.text import is_of_correction as is_of_correction
from oee_tabular.report.text import log_cannot_say as log_cannot_say
from oee_tabular.report.uncertainty import Uncertainty as Uncertainty
from oee_tabular.report.uncertainty import choose_interval as choose_interval

if TYPE_CHECKING:
    from oee_tabular.continuous import (
        ContinuousSimulator,
        Settings,
        evaluate_continuous,
    )

# what users find here; what is imported above "as" itself is for other rooms alone
__all__ = [
    "ContinuousSimulator",
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
