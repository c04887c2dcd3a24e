"""The HTML page of a report: one file, no network, the same bytes for the same input.

A template sets its contents and pictures. The last lines say what the page was made
from (names of files, their date, a short hash), and which command plans the next
recording.
"""

from __future__ import annotations

import base64
import math
import platform
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import __version__, _files, _printing, plots
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.estimators.names import NAMED
from oee_tabular.exceptions import ArgumentError
from oee_tabular.plots import draw_or_warn
from oee_tabular.report import columns, text
from oee_tabular.report.content import explain_intervals
from oee_tabular.report.files import plain
from oee_tabular.report.portrait import (
    MAX_POLICIES,
    MIN_SHARE_TO_CROSS_OUT,
    WIDTH,
    portray,
)
from oee_tabular.report.tooltips import Tooltip, draw_with_tooltips
from oee_tabular.report.uncertainty import GUARANTEED, LIKELIHOOD

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "cvxpy",
    "clarabel",
    "gymnasium",
    "matplotlib",
    "jinja2",
)


def render(
    report: Report, *, title: str | None = None, grid: tuple[int, int] | None = None
) -> str:
    """Write the page of a report."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    portrait = None
    if report.problem is not None:
        portrait = portray(report.problem, report.policies, report.confidence, grid)
    elif grid is not None:
        raise ArgumentError(
            "grid",
            "must be None for a report without its problem: there is nothing to draw",
        )
    environment = Environment(
        loader=PackageLoader("oee_tabular.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": text.format_number,
        "between": text.format_interval,
        "within": text.format_value,
        "estimate": lambda row, answer: text.format_estimate(
            row["value"],
            (row["lower"], row["upper"]),
            (answer.lower, answer.upper),
        ),
        "legible": legible,
        "share": _printing.share,
        "probability": _printing.probability,
        "count": text.count,
        "ranks": rank_rows,
    }
    best_first = [row["policy"] for row in report.comparison()]
    answers = sorted(
        report.answers,
        key=lambda answer: best_first.index(answer.policy) if best_first else 0,
    )
    name = answers[0].policy if len(answers) == 1 else f"{len(answers)} policies"
    inputs = ""
    if report.problem is not None:
        inputs = f"inputs {fingerprint(report.problem, report.policies)}"
    page = environment.get_template("report.html.j2").render(
        title=title or f"Evaluation of {name}",
        report=report,
        facts=plain(report.facts),
        answers=answers,
        lines={answer.policy: list_lines(report, answer.policy) for answer in answers},
        comparison={row["policy"]: row for row in report.comparison()},
        level=text.format_level(report.confidence),
        portrait=portrait,
        draw_forest=draw_forest,
        csv=csv_url(report),
        limits={"policies": MAX_POLICIES, "share": MIN_SHARE_TO_CROSS_OUT},
        command=report.content.plan_command,
        planned=text.PLANNED,
        date=date(report),
        fingerprint=inputs,
        diagnostics=columns.estimator_columns(report.content, columns.DIAGNOSTICS),
        versions=_versions(),
        estimators=NAMED,
        meanings=_explain_lines(report),
        columns=_meanings(report),
    )
    return legible(page) + "\n"


def _meanings(report: Report) -> dict[str, str]:
    """Return what the columns mean whose titles do not say it."""
    shown = columns.estimator_columns(report.content, columns.DIAGNOSTICS)
    every = [columns.P_BEST_COLUMN, *shown]
    return {column.title: column.meaning for column in every if column.meaning}


def _explain_lines(report: Report) -> list[tuple[str, str]]:
    """Return each kind of interval of the page with its meaning.

    The rows of a method are named where it has several meanings.
    """
    lines = [
        line for answer in report.answers for line in list_lines(report, answer.policy)
    ]
    kinds = [
        kind for kind in explain_intervals(report, lines) if kind[0] in text.METHODS
    ]
    times = Counter(method for method, _, _ in kinds)
    return [
        (
            f"{method} ({', '.join(rows)})" if times[method] > 1 else method,
            f"{meaning[0].upper()}{meaning[1:]}",
        )
        for method, meaning, rows in kinds
    ]


def legible(words: object) -> str:
    """Replace the control characters that a name from a file may hold."""

    def replace_unprintable(found: re.Match[str]) -> str:
        """Return the character, or the replacement character if no page can show it."""
        is_shown = found[0].isprintable() or found[0].isspace()
        return found[0] if is_shown else "\ufffd"

    return re.sub(r"[^\t\n -~]", replace_unprintable, str(words))


def _versions() -> dict[str, str]:
    """Return the versions of oee_tabular, of Python and of the libraries."""
    versions = {"oee_tabular": __version__, "Python": platform.python_version()}
    there = {
        name for name in LIBRARIES if any(metadata.Distribution.discover(name=name))
    }
    return versions | {
        name: metadata.version(name) for name in LIBRARIES if name in there
    }


# what it was made from


def date(report: Report) -> str:
    """Return the day to print; "" where there are no files.

    It is that of SOURCE_DATE_EPOCH where it is set, else of the newest input file.
    """
    return _printing.read_epoch() or str(report.facts.get("date", ""))


def fingerprint(problem: Problem, policies: Mapping[str, np.ndarray]) -> str:
    """Return eight letters that differ where simulator, log, horizon or policies do."""
    simulator = problem.simulator
    arrays = {"rewards": simulator.rewards, "initial": simulator.initial}
    arrays["numbers"] = np.array([simulator.discount, problem.horizon or 0])
    for name, matrix in (
        ("transitions", simulator.transitions),
        ("counts", problem.counts),
    ):
        arrays |= {
            f"{name} {part}": getattr(matrix, part)
            for part in ("indptr", "indices", "data")
        }
    if isinstance(problem.recorded, Transitions):
        arrays |= {
            f"log {name}": column for name, column in problem.recorded.columns().items()
        }
    arrays |= {f"policy {name}": policy for name, policy in policies.items()}
    converted = {
        name: x.astype(np.float64 if x.dtype.kind in "biuf" else str)
        for name, x in arrays.items()
    }
    return _files.digest(converted)[:8]


# tables and pictures of values


def list_lines(report: Report, policy: str) -> list[dict[str, Any]]:
    """Return the rows of a policy, then its intervals that stand beside no value."""
    rows = [row for row in report.records() if row["policy"] == policy]
    beside = {row["interval_method"] for row in rows}
    intervals = report.uncertainty.intervals.get(policy, {})
    alone = {
        each.method: (each.lower, each.upper)
        for each in intervals.values()
        if each.method not in beside
    }
    quoted = intervals.get(LIKELIHOOD)
    ends_quoted = None if quoted is None else (quoted.lower, quoted.upper)
    # where every pair is recorded, all are the same interval
    if quoted is not None:
        for name, ends in (
            ("sampling", quoted.sampling),
            ("worst case", quoted.worst_case),
        ):
            if ends is not None and ends != ends_quoted:
                alone[name] = ends
    for method, ends in alone.items():
        name = "guaranteed" if method == GUARANTEED else method
        lower, upper = (None if math.isnan(end) else end * report.scale for end in ends)
        values = {
            "value": math.nan,
            "lower": lower,
            "upper": upper,
            "true_value": rows[0]["true_value"],
        }
        about = {
            "policy": policy,
            "estimator": f"{name} interval",
            "interval_method": name,
            "notes": [],
            "status": "",
        }
        rows.append(about | values)
    return rows


def tell_value(row: Mapping[str, Any], report: Report) -> str:
    """Say the value and interval of a row, for its tooltip."""
    ends = (row["lower"], row["upper"])
    told = ""
    if row["status"]:
        told = f" {text.format_value(row['value'], *ends)}"
    interval = ""
    if ends[0] is not None:
        level = text.format_level(report.confidence)
        interval = f" ({level} interval: {text.format_interval(*ends)})"
    return f"{row['estimator']}:{told}{interval}"


def rank_rows(values: Sequence[float | None]) -> list[int]:
    """Return the place of each row in the order of values, largest first, none last."""

    def key(k: int) -> tuple[bool, float]:
        """Return what a row is sorted by."""
        value = values[k]
        is_missing = value is None or math.isnan(value)
        return is_missing, 0.0 if is_missing or value is None else -float(value)

    places = [0] * len(values)
    for place, k in enumerate(sorted(range(len(values)), key=key)):
        places[k] = place
    return places


def csv_url(report: Report) -> str:
    """Return the report's table as a data: URL of a CSV file."""
    content = base64.b64encode(_files.csv_bytes(report.table)).decode()
    return f"data:text/csv;charset=utf-8;base64,{content}"


def draw_forest(report: Report, rows: Sequence[Mapping[str, Any]], name: str) -> str:
    """Draw the values and intervals of one policy, a line for each estimator."""
    policy = rows[0]["policy"]
    truth = rows[0]["true_value"]
    values, lower, upper = np.array(
        [[row[key] for row in rows] for key in ("value", "lower", "upper")], dtype=float
    )
    # lines that say "no value"
    limits = None if np.isfinite([values, lower]).any() else (0.0, 1.0)
    parts = []
    for row in rows:
        if row["status"]:
            value = text.format_value(row["value"], row["lower"], row["upper"])
            parts.append(f"{row['estimator']} {value}")
    values_in_words = "; ".join(parts)
    exact = ""
    if truth is not None:
        exact = f" The dashed line is the exact value, {text.format_number(truth)}."
    factor = "(1 − discount) × " if report.normalized else ""
    tips = [
        Tooltip(0.0, k - 0.5 + (truth is not None), 1.0, 1.0, tell_value(row, report))
        for k, row in enumerate(rows)
    ]
    draw = partial(
        draw_with_tooltips,
        lambda ax: plots.plot_intervals(
            [row["estimator"] for row in rows],
            values,
            lower,
            upper,
            ax,
            truth=truth,
            limits=limits,
            xlabel=f"value: {factor}discounted sum of rewards",
        ),
        tips,
        across=True,
        name=name,
        size=(WIDTH, 0.85 + 0.31 * len(rows)),
        title=f"Values of {policy} in the target, with intervals",
        description=f"One line for each estimator. {values_in_words}.{exact}",
    )
    return draw_or_warn(f"the picture {name!r}", draw) or ""
