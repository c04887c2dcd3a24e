"""The HTML page of a report: one file, no network, the same bytes for the same input.

A template sets its contents and pictures. The last lines say what the page was made
from (names of files, their date, a short hash), and which command plans the next
recording.
"""

from __future__ import annotations

import math
import os
import platform
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import __version__, _files, _printing, plots
from oee_tabular._checks import positive_integer, show
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.estimators.names import NAMED
from oee_tabular.exact import time_in_pairs
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.mdp import Names
from oee_tabular.plots import draw_or_warn
from oee_tabular.report import columns, text
from oee_tabular.report.files import plain
from oee_tabular.report.uncertainty import GUARANTEED, LIKELIHOOD
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array, BoolArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from oee_tabular.report.results import Report

EPOCH = "SOURCE_DATE_EPOCH"
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
WIDTH = 4.6  # inches, at which text is readable on a phone as well
MAX_POLICIES = 6  # that are drawn
MAX_PAIRS = 10  # in the list of changes
# the share of a policy's time from which a state with unrecorded actions is crossed out
MIN_SHARE_TO_CROSS_OUT = 5e-4


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
        "count": text.count,
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
        limits={"policies": MAX_POLICIES, "share": MIN_SHARE_TO_CROSS_OUT},
        command=plan_command(report),
        date=date(report),
        fingerprint=inputs,
        diagnostics=columns.estimator_columns(report.content, columns.DIAGNOSTICS),
        versions=_versions(),
        estimators=NAMED,
        methods=text.METHODS,
        columns=_meanings(report),
    )
    return legible(page) + "\n"


def _meanings(report: Report) -> dict[str, str]:
    """Return what the columns mean whose titles do not say it."""
    shown = columns.estimator_columns(report.content, columns.DIAGNOSTICS)
    every = [columns.P_BEST_COLUMN, *shown]
    return {column.title: column.meaning for column in every if column.meaning}


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


def date_of(files: Iterable[str | os.PathLike[str]]) -> str:
    """Return the day (UTC) of the newest of the files; "" where none exists.

    The same inputs give the same day.
    """
    times = [Path(file).stat().st_mtime for file in files if Path(file).is_file()]
    return _day(max(times)) if times else ""


def date(report: Report) -> str:
    """Return the day to print; "" where there are no files.

    It is that of SOURCE_DATE_EPOCH where it is set, else of the newest input file.
    """
    given = os.environ.get(EPOCH, "")
    try:
        return _day(int(given)) if given else str(report.facts.get("date", ""))
    except (ValueError, OverflowError, OSError):
        raise ArgumentError(
            EPOCH, f"must be a whole number of seconds since 1970; it is {given!r}"
        ) from None


def _day(seconds: float) -> str:
    """Write the day (UTC) of a number of seconds since 1970."""
    day = datetime.fromtimestamp(seconds, UTC)
    return f"{day.day} {day:%B %Y}"


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


def plan_command(report: Report) -> str:
    """Return what plans the next recording, ready to be typed.

    It is the command in the files' own names, or the call in Python; "" where neither
    can plan (a continuous task's log).
    """
    facts = report.facts
    if report.problem is None:
        return ""
    n = max(1, int(report.problem.counts.sum()))
    if "policy_names" not in facts:
        if "simulator_name" in facts:
            return ""
        wanted = ", ".join(f"{name!r}: ..." for name in report.policies)
        return f"oee.plan_data_collection(problem, {{{wanted}}}, n={n})"
    words = ["oee", "plan", "--simulator", str(facts["simulator_name"])]
    for file in facts.get("log_files", [facts["log_name"]]):
        words += ["--log", str(file)]
    for name, spec in facts["policy_names"].items():
        words += ["--policy", spec if name == spec else f"{name}={spec}"]
    options = {
        "horizon": report.horizon,
        **{name: facts.get(name) for name in ("initial", "discount", "impossible")},
    }
    options["action-noise"] = facts.get("action_noise") or None
    for name, value in options.items():
        if value is not None:
            words += [f"--{name}", str(value)]
    return shlex.join([*words, "--transitions", str(n), "--output", "next.npy"])


# pictures


@dataclass(frozen=True, eq=False)
class Portrait:
    """Draw the log and the policies, on the task's map where it has one.

    Attributes
    ----------
    names : Names
        The names of states and actions.
    changes : RowChanges
        The log's counts, of shape (S, A), and how far each pair is from the simulator.
    over : ndarray of shape (S,)
        Whether no action leaves the state.
    time : dict of str to ndarray of shape (S, A)
        The shares of each policy's discounted time before an episode ends, in the
        simulator as the log corrects it; they sum to 1.
    map : Map or None
        Where the states lie.
    available : ndarray of bool of shape (S, A)
        Which actions can be taken in each state.
    """

    names: Names
    changes: RowChanges
    over: BoolArray
    time: Mapping[str, Array]
    map: plots.Map | None
    available: BoolArray

    @property
    def alive(self) -> int:
        """Return the number of states that can be left."""
        return int((~self.over).sum())

    @property
    def never(self) -> int:
        """Return in how many of these states the log has no transition."""
        return int(((self.changes.counts.sum(axis=1) == 0) & ~self.over).sum())

    @property
    def alive_pairs(self) -> int:
        """Return the number of state-action pairs of these states."""
        return int(self.available[~self.over].sum())

    @property
    def missing_pairs(self) -> int:
        """Return how many of the pairs of these states were never recorded."""
        never = (self.changes.counts == 0) & self.available
        return int(never[~self.over].sum())

    def unrecorded(self, policy: str) -> Array:
        """Return the part (S,) of a policy's time in unrecorded pairs of each state."""
        unrecorded = np.where(self.changes.counts > 0, 0.0, self.time[policy])
        return np.asarray(unrecorded.sum(axis=1))

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Return the pairs with the largest certain change.

        Where no change is certain, they are the pairs with the most evidence.
        """
        evidence = self.changes.evidence
        order = np.argsort(-evidence, axis=None, kind="stable")[:MAX_PAIRS]
        likely = (divmod(int(k), evidence.shape[1]) for k in order)
        return self.changes.largest(MAX_PAIRS) or [
            pair for pair in likely if evidence[pair] > 0
        ]

    def where(self, state: Any) -> str:
        """Name a state, with its place on the map."""
        place = None if self.map is None else self.map.place(int(state))
        words = "" if place is None else f" (row {place[0]:.6g}, column {place[1]:.6g})"
        return f"state {self.names.state(state)}{words}"

    def longest(self, policy: str) -> list[str]:
        """Name the states in which a policy spends most time."""
        time = self.time[policy].sum(axis=1)
        return [
            f"{self.where(s)} {time[s]:.1%}"
            for s in np.argsort(-time, kind="stable")[:5]
            if time[s] > 0
        ]

    def plot_recorded(self, ax: Axes) -> Axes:
        """Draw how many transitions the log has from each state."""
        assert self.map is not None
        return plots.plot_coverage(self.changes.counts, self.map, ax, over=self.over)

    def plot_time(self, policy: str, ax: Axes) -> Axes:
        """Draw where a policy spends its time, on the map or as a ranking of states."""
        time = self.time[policy]
        if self.map is not None:
            crossed = self.unrecorded(policy) > MIN_SHARE_TO_CROSS_OUT
            return plots.plot_occupancy(
                time.sum(axis=1), self.map, ax, unrecorded=crossed, over=self.over
            )
        names = None
        if self.names.states is not None:
            names = [self.names.state(s) for s in range(len(time))]
        return plots.plot_states(time, self.changes.counts, ax, names=names)

    def plot_changes(self, ax: Axes) -> Axes:
        """Draw by how much the target differs for certain.

        Each state shows the largest change of its actions.
        """
        assert self.map is not None
        least = 100.0 * self.changes.certain.max(axis=1)
        shown = np.where(
            self.over | (self.changes.counts.sum(axis=1) == 0), np.nan, least
        )
        words = [f"{x:.0f}" if x > 0 else "" for x in shown]
        for state in np.flatnonzero(self.over):
            words[state] = "end"
        label = "transitions that end elsewhere, at least (%)"
        return plots.plot_grid(shown, self.map, ax, text=words, label=label)

    def draw(
        self,
        plot: Callable[..., Axes],
        name: str,
        title: str,
        description: str,
        *,
        policy: str = "",
    ) -> str:
        """Draw a picture as wide as the others.

        A map has square cells and a colour bar; a ranking has at most 20 bars.
        """
        if self.map is None:
            n_states = int((self.time[policy].sum(axis=1) > 0).sum())
            height = 1.1 + 0.25 * min(20, max(1, n_states))
        else:
            tall = (WIDTH - 1.3) * len(self.map.rows) / len(self.map.columns)
            height = min(max(tall, 0.9) + 0.6, 7.0)
        about = {"name": name, "title": title, "description": description}
        drawn = draw_or_warn(
            f"the picture {title!r}",
            lambda: plots.figure_svg(
                partial(plot, policy) if policy else plot, size=(WIDTH, height), **about
            ),
        )
        return drawn or ""


def portray(
    problem: Problem,
    policies: Mapping[str, Array],
    confidence: float,
    grid: tuple[int, int] | None,
) -> Portrait:
    """Make the portrait of a problem.

    Without a ``grid`` the map is that of ``plots.map_of``.
    """
    simulator = problem.simulator
    over = problem.simulator.closed()
    shown = dict(list(policies.items())[:MAX_POLICIES])
    zeta = transition_ratio(
        problem.observed,
        simulator,
        values_of=list(shown.values()) or None,
        horizon=problem.horizon,
    )
    model = zeta.target_model(simulator)
    times = {}
    for name, policy in shown.items():
        try:
            time = time_in_pairs(model, policy, problem.horizon)
        except DivergentKernelError:  # at discount 1 a policy need not end
            continue
        time = np.where(over[:, None], 0.0, time)
        times[name] = time / (float(time.sum()) or 1.0)
    if grid is None:
        places = plots.map_of(simulator)
    else:
        places = _read_grid(grid, simulator.n_states)
    return Portrait(
        simulator.names,
        row_changes(problem, confidence=confidence),
        over,
        times,
        places,
        simulator.available,
    )


def _read_grid(grid: Any, n_states: int) -> plots.Map:
    """Check a (rows, columns) against the number of states, and make the map."""
    try:
        rows, columns = grid
    except (TypeError, ValueError):
        raise ArgumentError(
            "grid", f"must be (rows, columns); got {show(grid)}"
        ) from None
    shape = positive_integer(rows, "grid[0]"), positive_integer(columns, "grid[1]")
    if shape[0] * shape[1] != n_states:
        raise ArgumentError(
            "grid",
            f"must have as many cells as the simulator has states, {n_states}; {shape}"
            f" has {shape[0] * shape[1]}",
        )
    return plots.Map.of_shape(*shape)


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
    draw = partial(
        plots.figure_svg,
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
        name=name,
        size=(WIDTH, 0.85 + 0.31 * len(rows)),
        title=f"Values of {policy} in the target, with intervals",
        description=f"One line for each estimator. {values_in_words}.{exact}",
    )
    return draw_or_warn(f"the picture {name!r}", draw) or ""
