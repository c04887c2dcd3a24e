"""From a problem and policies to a table, warnings in plain language, a picture, a JSON file and a page for people."""

from oee_tabular.report.continuous import Settings, evaluate_continuous
from oee_tabular.report.evaluation import evaluate
from oee_tabular.report.files import check_output, check_page
from oee_tabular.report.results import Report, Result

__all__ = ["Report", "Result", "Settings", "check_output", "check_page", "evaluate", "evaluate_continuous"]
