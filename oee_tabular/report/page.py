"""The page: contents and pictures set by the template. One file, no network, the same input the same bytes.

Below it what it was made from: names of files, their date, a short hash; and the command that plans the next recording.
"""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from oee_tabular import _printing
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.report import contents, figures
from oee_tabular.report.figures import MOST_POLICIES, NOTABLE, Portrait, changed_rows, portray
from oee_tabular.report.results import COLUMNS, Evaluation, diagnostic_cells, shown


def render(report: Evaluation, *, title: str | None = None, grid: tuple[int, int] | None = None) -> str:
    """The page of a report."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    portrait = None
    if report.problem is not None:
        portrait = portray(report.problem, report.policies, report.confidence, grid)
    elif grid is not None:
        raise ValueError("grid must be None for a report without its problem: there is nothing to draw")
    found = contents.answers(report)
    sentence, beside = contents.first_words(report, found)
    environment = Environment(
        loader=PackageLoader("oee_tabular.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {
        "number": contents.number, "between": contents.between, "within": contents.within, "legible": legible,
        "share": _printing.share,
    }  # fmt: skip
    page = environment.get_template("report.html.j2").render(
        title=title or _title(found),
        style=Markup(environment.get_template("report.css").render()),
        report=report,
        level=f"{100 * report.confidence:.4g}%",
        sentence=sentence,
        simulated=any(answer.simulator is not None and answer.from_log for answer in found),
        beside=beside,
        answers=[
            {
                "about": answer,
                "picture": Markup(figures.forest(report, answer, f"forest{k}")),
                "rows": _result_rows(report, answer),
            }
            for k, answer in enumerate(found)
        ],
        distance=" ".join(report.sureness.distance),
        advice=report.sureness.next,
        command=plan_command(report),
        stamp=_stamp(report),
        coverage=None if portrait is None else _coverage(portrait, report, Markup),
        changes=None if portrait is None else _changes(portrait, Markup),
        diagnostics=_diagnostics(report),
        diagnostics_header=["std. error", *(["error"] if report.truth else []), *(title for _, title, _ in COLUMNS)],
        methods=contents.method_facts(report),
        versions=contents.versions(),
        seed=contents.seed_words(report.seed),
        glossary=contents.glossary(report),
    )
    return legible(page) + "\n"


def legible(text: object) -> str:
    """Without the control characters that a name from a file may hold, which no page can show."""
    return "".join(c if c in "\n\t" or c.isprintable() or c.isspace() else "\ufffd" for c in str(text))


def _stamp(report: Evaluation) -> str:
    """Which inputs the page was made from: their names, their day, their hash."""
    told = [*names(report), date(report)]
    if report.problem is not None:
        told.append(f"inputs {fingerprint(report.problem, report.policies)}")
    return " · ".join(filter(None, told))


def _title(found: list[contents.Answer]) -> str:
    names = [answer.policy for answer in found]
    if len(names) == 1:
        return f"Evaluation of {names[0]}"
    return f"Evaluation of {len(names)} policies"


def _result_rows(report: Evaluation, answer: contents.Answer) -> list[dict[str, Any]]:
    """Intervals that stand alone, then one row an estimator; the answer's is strong."""
    alone: list[dict[str, object]] = [
        {
            "name": name,
            "value": "",
            "interval": contents.interval_words(found, report.scale),
            "method": "",
            "notes": (),
            "strong": False,
        }
        for name, found in contents.alone(report, answer.policy).items()
    ]
    return alone + [
        {
            "name": row["estimator"],
            "value": contents.within(row["value"], row["lower"], row["upper"]),
            "interval": contents.between(row["lower"], row["upper"]),
            "method": row["interval_method"] or "",
            "notes": row["notes"],
            "strong": row["estimator"] == answer.estimator,
        }
        for row in report.records()
        if row["policy"] == answer.policy
    ]


def _coverage(portrait: Portrait, report: Evaluation, markup: Any) -> dict[str, Any]:
    rows = [
        {
            "policy": name,
            "coverage": _printing.share(visits.coverage),
            "picture": markup(figures.visited(portrait, name, visits, f"visits{k}")),
        }
        for k, (name, visits) in enumerate(portrait.visits.items())
    ]
    return {
        "recorded": None if portrait.map is None else markup(figures.recorded(portrait, "recorded")),
        "policies": rows,
        "left_out": max(0, len(report.policies) - MOST_POLICIES) if portrait.visits else 0,
        "never": portrait.never,
        "alive": portrait.alive,
        "moves": int(portrait.counts.sum()),
        "pairs": int((portrait.counts[~portrait.over] == 0).sum()),
        "all_pairs": portrait.alive * portrait.counts.shape[1],
        "notable": NOTABLE,
    }


def _changes(portrait: Portrait, markup: Any) -> dict[str, Any]:
    rows, certain = changed_rows(portrait)
    picture = None
    if certain and portrait.map is not None:
        picture = markup(figures.changed(portrait, "changes"))
    return {
        "rows": rows,
        "named": portrait.names.states is not None,
        "certain": certain,
        "number": portrait.changes.n_certain,
        "tested": portrait.changes.tested,
        "picture": picture,
    }


def _diagnostics(report: Evaluation) -> list[dict[str, Any]]:
    table = []
    for row in report.records():
        errors = [shown(row["standard_error"], ".2g"), *([shown(row["error"], "+.2g")] if report.truth else [])]
        cells = [cell.replace("-", "−") for cell in (*errors, *diagnostic_cells(row))]
        table.append({"policy": row["policy"], "estimator": row["estimator"], "cells": cells, "status": row["status"]})
    return table


EPOCH = "SOURCE_DATE_EPOCH"


def date_of(files: Iterable[str | os.PathLike[str]]) -> str:
    """The day (UTC) of the newest of the files that exist: the same inputs, the same day; "" where none does."""
    there = [Path(file) for file in files if Path(file).is_file()]
    return _day(max(file.stat().st_mtime for file in there)) if there else ""


def date(report: Evaluation) -> str:
    """The day to print: of SOURCE_DATE_EPOCH where it is set, else of the newest input file; "" where there are no files."""
    given = os.environ.get(EPOCH, "")
    if not given:
        return str(report.facts.get("date", ""))
    try:
        return _day(int(given))
    except (ValueError, OverflowError, OSError):
        raise ValueError(f"{EPOCH} must be a whole number of seconds since 1970; it is {given!r}") from None


def _day(seconds: float) -> str:
    day = datetime.fromtimestamp(seconds, UTC)
    return f"{day.day} {day:%B %Y}"


def names(report: Evaluation) -> list[str]:
    """The inputs' names, as far as they are known."""
    facts = report.facts
    specs = facts.get("policy_names", {})
    return [str(facts[key]) for key in ("simulator_name", "log_name") if key in facts] + list(
        dict.fromkeys(specs.values())
    )


def fingerprint(problem: Problem, policies: Mapping[str, object]) -> str:
    """Eight letters that differ where simulator, log, horizon or policies do."""
    simulator, digest = problem.simulator, hashlib.sha256()
    kept = [simulator.transitions.indptr, simulator.transitions.indices, simulator.transitions.data, simulator.rewards,
            simulator.initial, np.array(simulator.discount), problem.counts.indptr, problem.counts.indices,
            problem.counts.data, np.array(problem.horizon or 0), *policies.values()]  # fmt: skip
    if isinstance(problem.recorded, Transitions):
        kept += problem.recorded.columns().values()
    for array in kept:
        words = array.dtype.kind not in "biuf"
        digest.update(repr(array.tolist()).encode() if words else array.astype(np.float64).tobytes())
    digest.update(repr(list(policies)).encode())
    return digest.hexdigest()[:8]


def plan_command(report: Evaluation) -> str:
    """What plans the next recording, ready to be typed: the command in the files' own names, or the call in Python.

    "" where neither can (a continuous task's log).
    """
    facts = report.facts
    if report.problem is None:
        return ""
    n = max(1, int(report.problem.counts.sum()))
    if "policy_names" not in facts:
        wanted = ", ".join(f"{name!r}: ..." for name in report.policies)
        return "" if "simulator_name" in facts else f"oee.plan_data_collection(problem, {{{wanted}}}, n={n})"
    words = ["oee", "plan", "--simulator", str(facts["simulator_name"])]
    for file in facts.get("log_files", [facts["log_name"]]):
        words += ["--log", str(file)]
    for name, spec in facts["policy_names"].items():
        words += ["--policy", spec if name == spec else f"{name}={spec}"]
    given = {"horizon": report.horizon, **{name: facts.get(name) for name in ("initial", "discount", "impossible")}}
    given["action-noise"] = facts.get("action_noise") or None
    for name, value in given.items():
        words += [] if value is None else [f"--{name}", str(value)]
    return shlex.join([*words, "--transitions", str(n), "--output", "next.npy"])
