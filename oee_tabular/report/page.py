"""The page: contents and pictures set by the template. One file, no network, the same
input the same bytes.

Below it what it was made from: names of files, their date, a short hash; and the
command that plans the next recording.
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
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.mdp.naming import Names
from oee_tabular.ratio import transition_ratio
from oee_tabular.report import text
from oee_tabular.report.tables import diagnostic_columns
from oee_tabular.report.uncertainty import GUARANTEED, LIKELIHOOD
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
WIDTH = 4.6  # inches: text that is readable on a phone as well
# at most
N_POLICIES = 6
N_PAIRS = 10
# share of a policy's time from which a state with unrecorded actions is crossed out
NOTABLE = 5e-4


def render(
    report: Report, *, title: str | None = None, grid: tuple[int, int] | None = None
) -> str:
    """The page of a report."""
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
    page = environment.get_template("report.html.j2").render(
        title=title or f"Evaluation of {name}",
        report=report,
        answers=answers,
        lines={answer.policy: list_lines(report, answer.policy) for answer in answers},
        comparison={row["policy"]: row for row in report.comparison()},
        level=text.format_level(report.confidence),
        portrait=portrait,
        draw_forest=draw_forest,
        limits={"policies": N_POLICIES, "share": NOTABLE},
        command=plan_command(report),
        date=date(report),
        fingerprint=(
            ""
            if report.problem is None
            else f"inputs {fingerprint(report.problem, report.policies)}"
        ),
        diagnostics=diagnostic_columns(report),
        versions=_versions(),
        estimators=NAMED,
        methods=text.METHODS,
        columns=text.COLUMNS,
    )
    return legible(page) + "\n"


def legible(words: object) -> str:
    """Without the control characters that a name from a file may hold, which no page
    can show.
    """
    return re.sub(
        r"[^\t\n -~]",
        lambda x: x[0] if x[0].isprintable() or x[0].isspace() else "\ufffd",
        str(words),
    )


def _versions() -> dict[str, str]:
    """oee_tabular's, Python's and the libraries' versions."""
    versions = {"oee_tabular": __version__, "Python": platform.python_version()}
    there = {
        name for name in LIBRARIES if any(metadata.Distribution.discover(name=name))
    }
    return versions | {
        name: metadata.version(name) for name in LIBRARIES if name in there
    }


# what it was made from


def date_of(files: Iterable[str | os.PathLike[str]]) -> str:
    """The day (UTC) of the newest of the files that exist: the same inputs, the same
    day; "" where none does.
    """
    times = [Path(file).stat().st_mtime for file in files if Path(file).is_file()]
    return _day(max(times)) if times else ""


def date(report: Report) -> str:
    """The day to print: of SOURCE_DATE_EPOCH where it is set, else of the newest input
    file; "" where there are no files.
    """
    given = os.environ.get(EPOCH, "")
    try:
        return _day(int(given)) if given else str(report.facts.get("date", ""))
    except (ValueError, OverflowError, OSError):
        raise ArgumentError(
            EPOCH, f"must be a whole number of seconds since 1970; it is {given!r}"
        ) from None


def _day(seconds: float) -> str:
    day = datetime.fromtimestamp(seconds, UTC)
    return f"{day.day} {day:%B %Y}"


def fingerprint(problem: Problem, policies: Mapping[str, np.ndarray]) -> str:
    """Eight letters that differ where simulator, log, horizon or policies do."""
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
    plain = {
        name: x.astype(np.float64 if x.dtype.kind in "biuf" else str)
        for name, x in arrays.items()
    }
    return _files.digest(plain)[:8]


def plan_command(report: Report) -> str:
    """What plans the next recording, ready to be typed: the command in the files' own
    names, or the call in Python.

    "" where neither can (a continuous task's log).
    """
    facts = report.facts
    if report.problem is None:
        return ""
    n = max(1, int(report.problem.counts.sum()))
    if "policy_names" not in facts:
        wanted = ", ".join(f"{name!r}: ..." for name in report.policies)
        return (
            ""
            if "simulator_name" in facts
            else f"oee.plan_data_collection(problem, {{{wanted}}}, n={n})"
        )
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
        words += [] if value is None else [f"--{name}", str(value)]
    return shlex.join([*words, "--transitions", str(n), "--output", "next.npy"])


# pictures


@dataclass(frozen=True, eq=False)
class Portrait:
    """The log and the policies, on the task's map where it has one.

    ``changes`` has the log's counts (S, A), and how far each pair is from the
    simulator. ``over`` (S,) are states that no action leaves. ``time`` of each policy
    (S, A) are its shares of discounted time before an episode is over, in the simulator
    as the log corrects it; they sum to 1.
    """

    names: Names
    changes: RowChanges
    over: BoolArray
    time: Mapping[str, Array]
    map: plots.Map | None

    @property
    def alive(self) -> int:
        """How many states can be left."""
        return int((~self.over).sum())

    @property
    def never(self) -> int:
        """In how many of them the log has no transition."""
        return int(((self.changes.counts.sum(axis=1) == 0) & ~self.over).sum())

    @property
    def missing_pairs(self) -> int:
        """How many of their pairs the log does not have."""
        return int((self.changes.counts[~self.over] == 0).sum())

    def unrecorded(self, policy: str) -> Array:
        """(S,) the part of each state's time in unrecorded pairs."""
        unrecorded: Array = np.where(
            self.changes.counts > 0, 0.0, self.time[policy]
        ).sum(axis=1)
        return unrecorded

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The pairs with the largest certain change; where none is certain, those with
        the most evidence.
        """
        evidence = self.changes.evidence
        order = np.argsort(-evidence, axis=None, kind="stable")[:N_PAIRS]
        likely = (divmod(int(k), evidence.shape[1]) for k in order)
        return self.changes.largest(N_PAIRS) or [
            pair for pair in likely if evidence[pair] > 0
        ]

    def where(self, state: Any) -> str:
        """A state in words."""
        place = None if self.map is None else self.map.place(int(state))
        words = "" if place is None else f" (row {place[0]:.6g}, column {place[1]:.6g})"
        return f"state {self.names.state(state)}{words}"

    def longest(self, policy: str) -> list[str]:
        """The states where a policy is most of the time, in words."""
        time = self.time[policy].sum(axis=1)
        return [
            f"{self.where(s)} {time[s]:.1%}"
            for s in np.argsort(-time, kind="stable")[:5]
            if time[s] > 0
        ]

    def plot_recorded(self, ax: Axes) -> Axes:
        """How many transitions the log has from each state."""
        assert self.map is not None
        return plots.plot_coverage(self.changes.counts, self.map, ax, over=self.over)

    def plot_time(self, policy: str, ax: Axes) -> Axes:
        """Where a policy goes, on the map or as a ranking of states."""
        time = self.time[policy]
        if self.map is not None:
            crossed = self.unrecorded(policy) > NOTABLE
            return plots.plot_occupancy(
                time.sum(axis=1), self.map, ax, unrecorded=crossed, over=self.over
            )
        names = (
            None
            if self.names.states is None
            else [self.names.state(s) for s in range(len(time))]
        )
        return plots.plot_states(time, self.changes.counts, ax, names=names)

    def plot_changes(self, ax: Axes) -> Axes:
        """By how much the target differs for certain: the largest of each state's
        actions.
        """
        assert self.map is not None
        least = 100.0 * self.changes.certain.max(axis=1)
        shown = np.where(
            self.over | (self.changes.counts.sum(axis=1) == 0), np.nan, least
        )
        words = [
            "end" if over else f"{x:.0f}" if x > 0 else ""
            for x, over in zip(shown, self.over, strict=True)
        ]
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
        """A picture as wide as the others: of a map its square cells and the colour
        bar, else 20 bars at most.
        """
        if self.map is None:
            height = 1.1 + 0.25 * min(
                20, max(1, int((self.time[policy].sum(axis=1) > 0).sum()))
            )
        else:
            tall = (WIDTH - 1.3) * len(self.map.rows) / len(self.map.columns)
            height = min(max(tall, 0.9) + 0.6, 7.0)
        about = {"name": name, "title": title, "description": description}
        return plots.figure_svg(
            partial(plot, policy) if policy else plot, size=(WIDTH, height), **about
        )


def portray(
    problem: Problem,
    policies: Mapping[str, Array],
    confidence: float,
    grid: tuple[int, int] | None,
) -> Portrait:
    """The portrait of a problem; ``grid`` None: ``plots.map_of`` finds the map."""
    simulator = problem.simulator
    over = problem.simulator.closed()
    shown = dict(list(policies.items())[:N_POLICIES])
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
            time = np.where(
                over[:, None], 0.0, time_in_pairs(model, policy, problem.horizon)
            )
        except DivergentKernelError:  # it never ends at discount 1
            continue
        times[name] = time / (float(time.sum()) or 1.0)
    places = (
        plots.map_of(simulator)
        if grid is None
        else _read_grid(grid, simulator.n_states)
    )
    return Portrait(
        simulator.names,
        row_changes(problem, confidence=confidence),
        over,
        times,
        places,
    )


def _read_grid(grid: Any, n_states: int) -> plots.Map:
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
    """The rows of a policy, and below them its intervals that stand beside no value."""
    rows = [row for row in report.records() if row["policy"] == policy]
    beside = {row["interval_method"] for row in rows}
    intervals = report.uncertainty.intervals.get(policy, {})
    alone = {
        each.method: (each.lower, each.upper)
        for each in intervals.values()
        if each.method not in beside
    }
    quoted = intervals.get(LIKELIHOOD)
    if quoted is not None and quoted.sampling not in (
        None,
        (quoted.lower, quoted.upper),
    ):
        alone["sampling"] = quoted.sampling
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
    """Values and intervals of one policy, by estimator."""
    policy = rows[0]["policy"]
    truth = rows[0]["true_value"]
    values, lower, upper = np.array(
        [[row[key] for row in rows] for key in ("value", "lower", "upper")], dtype=float
    )
    # lines that say "no value"
    limits = None if np.isfinite([values, lower]).any() else (0.0, 1.0)
    valued = (row for row in rows if row["status"])
    values_by_estimator = "; ".join(
        f"{row['estimator']}"
        f" {text.format_value(row['value'], row['lower'], row['upper'])}"
        for row in valued
    )
    exact = (
        ""
        if truth is None
        else f" The dashed line is the exact value, {text.format_number(truth)}."
    )
    factor = "(1 − discount) × " if report.normalized else ""
    return plots.figure_svg(
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
        description=f"One line for each estimator. {values_by_estimator}.{exact}",
    )
