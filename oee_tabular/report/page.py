"""The page: contents and pictures set by the template. One file, no network, the same input the same bytes.

Below it what it was made from: names of files, their date, a short hash; and the command that plans the next recording.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shlex
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import __version__, _printing
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.estimators.names import NAMED
from oee_tabular.report import figures, text
from oee_tabular.report.figures import MOST_POLICIES, NOTABLE, Portrait, intervals_alone, largest_changes, portray
from oee_tabular.report.terminal import DIAGNOSTICS, diagnostic_cells, format_or_blank
from oee_tabular.report.text import Answer

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

LIBRARIES = ("numpy", "scipy", "numba", "cvxpy", "clarabel", "gymnasium", "matplotlib", "jinja2")


def render(report: Report, *, title: str | None = None, grid: tuple[int, int] | None = None) -> str:
    """The page of a report."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    portrait = None
    if report.problem is not None:
        portrait = portray(report.problem, report.policies, report.confidence, grid)
    elif grid is not None:
        raise ValueError("grid must be None for a report without its problem: there is nothing to draw")
    answers = report.answers
    environment = Environment(
        loader=PackageLoader("oee_tabular.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {
        "number": text.format_number, "between": text.format_interval, "within": text.format_value, "legible": legible,
        "share": _printing.share,
    }  # fmt: skip
    name = answers[0].policy if len(answers) == 1 else f"{len(answers)} policies"
    page = environment.get_template("report.html.j2").render(
        title=title or f"Evaluation of {name}",
        style=Markup(environment.get_template("report.css").render()),
        report=report,
        level=text.format_level(report.confidence),
        has_simulator=any(answer.simulator is not None and answer.is_from_log for answer in answers),
        comparison={row["policy"]: row for row in report.comparison()},
        answers=[
            {
                "about": answer,
                "sentence": report.uncertainty.policies.get(answer.policy, ""),
                "picture": Markup(figures.draw_forest(report, answer, f"forest{k}")),
                "rows": _rows(report, answer),
            }
            for k, answer in enumerate(answers)
        ],
        command=plan_command(report),
        stamp=_stamp(report),
        coverage=None if portrait is None else _coverage(portrait, report, Markup),
        changes=None if portrait is None else _changes(portrait, Markup),
        diagnostics=_diagnostics(report),
        diagnostics_header=[
            "std. error",
            *(["error"] if report.truth else []),
            *(title for _, title, _ in DIAGNOSTICS),
        ],
        facts=_facts(report),
        versions=_versions(),
        seed=f"seed {report.seed}" if isinstance(report.seed, int) else "no whole number as seed",
        glossary=_glossary(report),
    )
    return legible(page) + "\n"


def legible(text: object) -> str:
    """Without the control characters that a name from a file may hold, which no page can show."""

    def replace_controls(match: re.Match[str]) -> str:
        return match[0] if match[0].isprintable() or match[0].isspace() else "\ufffd"

    return re.sub(r"[^\t\n -~]", replace_controls, str(text))


def _stamp(report: Report) -> str:
    """Which inputs the page was made from: their names, their day, their hash."""
    told = [*names(report), date(report)]
    if report.problem is not None:
        told.append(f"inputs {fingerprint(report.problem, report.policies)}")
    return " · ".join(filter(None, told))


def _rows(report: Report, answer: Answer) -> list[dict[str, Any]]:
    """The rows of one policy's table: the intervals that stand alone, then one row an estimator; the answer's is strong."""
    rows: list[dict[str, Any]] = [
        {"name": name, "value": "", "method": "", "notes": (), "strong": False,
         "interval": "none" if ends is None else text.format_interval(ends[0] * report.scale, ends[1] * report.scale)}
        for name, ends in intervals_alone(report, answer.policy).items()
    ]  # fmt: skip
    for row in report.records():
        if row["policy"] == answer.policy:
            ends = row["lower"], row["upper"]
            rows.append(
                {"name": row["estimator"], "value": text.format_value(row["value"], *ends),
                 "interval": text.format_interval(*ends), "method": row["interval_method"] or "", "notes": row["notes"],
                 "strong": row["estimator"] == answer.estimator}
            )  # fmt: skip
    return rows


def _facts(report: Report) -> list[tuple[str, str]]:
    """How it was computed."""
    facts = dict(report.facts)
    unit = f"{report.unit} ({'normalised' if report.normalized else 'not normalised'})"
    paid = "the log's mean where it has any" if facts.get("rewards") == "log" else "the simulator's"
    names = ", ".join(dict.fromkeys(result.estimator for result in report.results))
    specs = ", ".join(f"{name}: {spec}" for name, spec in facts.get("policy_names", {}).items())
    rows = {
        "A value is": unit,
        "Simulator": facts["simulator"],
        "Simulator from": facts.get("simulator_name"),
        "Log of the target": facts["log"],
        "Log from": facts.get("log_name"),
        "Target": facts.get("target"),
        "Rewards of model-based values": paid,
        "Horizon": "infinite" if report.horizon is None else f"{report.horizon} rewards",
        "Discount": f"{report.discount:g}",
        "Estimators": names,
        "Seed": report.seed,
        "Policies from": specs or None,
    }
    told = {"simulator", "simulator_name", "log", "log_name", "log_files", "target", "rewards", "policy_names", "date",
            "discount"}  # fmt: skip
    rows |= {str(key).replace("_", " "): value for key, value in facts.items() if key not in told and value}
    return [(name, str(value)) for name, value in rows.items() if value is not None]


def _versions() -> list[tuple[str, str]]:
    """oee_tabular's, Python's and the libraries' versions."""
    versions = [("oee_tabular", __version__), ("Python", platform.python_version())]
    for name in LIBRARIES:
        try:
            versions.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return versions


def _glossary(report: Report) -> list[tuple[str, str]]:
    """What the words of the tables mean, for a reader who did not run it."""
    used = dict.fromkeys(result.estimator for result in report.results)
    methods = dict.fromkeys(
        row["interval_method"] for row in report.records() if row["interval_method"] in text.METHODS
    )
    alone = {name for policy in report.uncertainty.intervals for name in intervals_alone(report, policy)}
    return [
        *((name, NAMED[name].meaning) for name in used if name in NAMED),
        *((f"interval: {name}", f"{text.METHODS[name][0].upper()}{text.METHODS[name][1:]}") for name in methods),
        *((name, meaning) for name, meaning in text.GLOSSARY.items() if name in alone or not name.endswith("interval")),
    ]


def _coverage(portrait: Portrait, report: Report, markup: Any) -> dict[str, Any]:
    rows = [
        {
            "policy": name,
            "coverage": _printing.share(visits.coverage),
            "picture": markup(figures.draw_visits(portrait, name, visits, f"visits{k}")),
        }
        for k, (name, visits) in enumerate(portrait.visits.items())
    ]
    return {
        "recorded": None if portrait.map is None else markup(figures.draw_recorded(portrait, "recorded")),
        "policies": rows,
        "left_out": max(0, len(report.policies) - MOST_POLICIES) if portrait.visits else 0,
        "never": portrait.never,
        "alive": portrait.alive,
        "transitions": int(portrait.counts.sum()),
        "pairs": int((portrait.counts[~portrait.over] == 0).sum()),
        "all_pairs": portrait.alive * portrait.counts.shape[1],
        "notable": NOTABLE,
    }


def _changes(portrait: Portrait, markup: Any) -> dict[str, Any]:
    rows, certain = largest_changes(portrait)
    picture = None
    if certain and portrait.map is not None:
        picture = markup(figures.draw_changes(portrait, "changes"))
    return {
        "rows": rows,
        "named": portrait.names.states is not None,
        "certain": certain,
        "number": portrait.changes.n_certain,
        "tested": portrait.changes.tested,
        "picture": picture,
    }


def _diagnostics(report: Report) -> list[dict[str, Any]]:
    table = []
    for row in report.records():
        errors = [
            format_or_blank(row["standard_error"], ".2g"),
            *([format_or_blank(row["error"], "+.2g")] if report.truth else []),
        ]
        cells = [cell.replace("-", "−") for cell in (*errors, *diagnostic_cells(row))]
        table.append({"policy": row["policy"], "estimator": row["estimator"], "cells": cells, "status": row["status"]})
    return table


EPOCH = "SOURCE_DATE_EPOCH"


def date_of(files: Iterable[str | os.PathLike[str]]) -> str:
    """The day (UTC) of the newest of the files that exist: the same inputs, the same day; "" where none does."""
    there = [Path(file) for file in files if Path(file).is_file()]
    return _day(max(file.stat().st_mtime for file in there)) if there else ""


def date(report: Report) -> str:
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


def names(report: Report) -> list[str]:
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


def plan_command(report: Report) -> str:
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
