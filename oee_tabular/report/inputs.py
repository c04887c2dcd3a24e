"""What a page was made from: names of files, their date, a short hash; and the command that plans the next recording."""

from __future__ import annotations

import hashlib
import os
import shlex
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem

if TYPE_CHECKING:
    from oee_tabular.report.results import Evaluation

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
    words = ["oee", "plan", "--simulator", str(facts["simulator_name"]), "--log", str(facts["log_name"])]
    for name, spec in facts["policy_names"].items():
        words += ["--policy", spec if name == spec else f"{name}={spec}"]
    given = {"horizon": report.horizon, **{name: facts.get(name) for name in ("initial", "discount", "impossible")}}
    given["action-noise"] = facts.get("action_noise") or None
    for name, value in given.items():
        words += [] if value is None else [f"--{name}", str(value)]
    return shlex.join([*words, "--transitions", str(n), "--output", "next.npy"])
