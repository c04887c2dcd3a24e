"""The work of ``oee evaluate``: its options checked and carried out."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _printing, _writing
from oee_tabular.cli.evaluation_options import Asked
from oee_tabular.cli.inputs import (
    describe_default_discount,
    note_warnings,
    policies_of,
    read_box,
    read_columns,
    read_entries,
    read_problem,
    read_success,
    task_of,
)
from oee_tabular.cli.options import remark
from oee_tabular.continuous import (
    evaluate_files,
    is_continuous,
    read_grid,
    task_options,
)
from oee_tabular.exceptions import ArgumentError

if TYPE_CHECKING:
    from oee_tabular.report import Report

CONTINUOUS_DISCOUNT = 0.99  # of a continuous task where --discount gives none
# what these options are when they are not given
DEFAULTS = (None, 0.0, "refuse", "simulator")


def evaluate_asked(asked: Asked, show: Callable[[Report], object] | None) -> Report:
    """Evaluate what was asked for: the paper's grid, a continuous task or files.

    ``show`` gets the report of a large problem before its intervals are known.
    """
    settings = task_options(asked.task_option)
    cells = read_grid(asked.grid)
    _refuse_task_options(asked.simulator, settings, cells, asked.fit, asked.history)
    knob = read_knob(asked.unrecorded, asked.interval_seconds)
    refuse_beside_quick(
        asked.is_quick, asked.box, asked.unrecorded, asked.interval_seconds
    )
    if asked.simulator is None and not asked.log:
        return _evaluate_example(asked, knob)
    if asked.simulator is None or not asked.log:
        given, missing = ("log", "simulator") if asked.log else ("simulator", "log")
        raise ArgumentError(
            f"--{missing}",
            f"must be given with --{given} (record a log with: oee sample)",
        )
    if is_continuous(asked.simulator):
        return _evaluate_continuous(asked, asked.simulator, asked.log, settings, cells)
    return _evaluate_finite(asked, asked.simulator, asked.log, knob, show)


def _evaluate_example(asked: Asked, knob: Mapping[str, Any]) -> Report:
    """Evaluate the paper's grid, which needs no files."""
    _refuse_given(
        {
            "--column": asked.column,
            "--behavior": asked.behavior,
            "--target": asked.target,
        }
        | asked.for_files,
        "needs --simulator and --log",
    )
    discount = 0.99 if asked.discount is None else asked.discount
    default = oee.tasks.embedded_default(seed=asked.seed, discount=discount)
    horizon = default.horizon if asked.horizon is None else asked.horizon
    rewards: Any = asked.rewards
    problem = oee.Problem(
        default.simulator,
        default.log,
        horizon=horizon,
        rewards=rewards,
        episodes=default.episodes,
        behavior_policy=default.behavior_policy,
    )
    policies: Any = default.policies
    if asked.policy is not None:
        task = task_of("gridworld:10,slip=0.3", asked.discount)
        policies = policies_of(asked.policies, task)
    common = asked.common | {"normalized": asked.normalized is not False}
    return oee.evaluate(problem, policies, target=default.target, **common, **knob)


def _evaluate_continuous(
    asked: Asked,
    simulator: str,
    log: list[str],
    settings: dict[str, Any],
    cells: Any,
) -> Report:
    """Evaluate policies of a continuous task."""
    from oee_tabular.report import add_log_notes

    _refuse_given(
        {
            "--rewards": asked.rewards,
            "--unrecorded": asked.unrecorded,
            "--interval-seconds": asked.interval_seconds,
        }
        | asked.for_files,
        "must be left out for a continuous task, whose states have no numbers; it"
        " is {}",
    )
    if asked.discount is None:
        remark(describe_default_discount(CONTINUOUS_DISCOUNT))
    with note_warnings() as notes:
        report = evaluate_files(
            simulator,
            log,
            asked.policy,
            asked.behavior,
            asked.target,
            settings,
            grid=cells,
            columns=read_columns(asked.column, log),
            horizon=asked.horizon,
            discount=CONTINUOUS_DISCOUNT if asked.discount is None else asked.discount,
            **asked.common,
            **asked.for_continuous,
        )
    return add_log_notes(report, notes)


def _evaluate_finite(
    asked: Asked,
    simulator: str,
    log: list[str],
    knob: Mapping[str, Any],
    show: Callable[[Report], object] | None,
) -> Report:
    """Evaluate policies by the files of a simulator and a log."""
    from oee_tabular.report import add_log_notes, evaluate_showing

    task, problem, notes, n_files = read_problem(
        simulator,
        log,
        discount=asked.discount,
        initial=asked.initial,
        action_noise=asked.action_noise,
        impossible=asked.impossible,
        horizon=asked.horizon,
        rewards=asked.rewards,
        behavior=asked.behavior,
        column=asked.column,
        trials=asked.trials,
        success=asked.success,
    )
    facts = _describe_files(asked, simulator, log, n_files, task)
    known: dict[str, Any] = read_box(asked.box)
    for name, path in (("features", asked.features), ("tie", asked.tie)):
        if path is not None:
            known[name], content = read_entries(path, name, task.mdp)
            facts[name] = f"{path} ({content})"
    target = _read_target(asked, task)

    def show_with_notes(report: Report) -> None:
        """Show the report of a large problem with what the log's reader warned of."""
        assert show is not None
        show(add_log_notes(report, notes))

    report = evaluate_showing(
        problem,
        policies_of(asked.policies, task),
        None if show is None else show_with_notes,
        facts=facts,
        target=target,
        **known,
        **asked.common,
        **knob,
    )
    return add_log_notes(report, notes)


def _describe_files(
    asked: Asked,
    simulator: str,
    log: list[str],
    n_files: int,
    task: oee.tasks.NamedTask,
) -> dict[str, Any]:
    """Return the facts of a report on what it was made from."""
    specs = asked.policies
    facts: dict[str, Any] = {
        "simulator_name": simulator,
        "log_name": ", ".join(log),
        "log_files": log,
        "number_of_log_files": n_files,
        "action_noise": asked.action_noise,
        "policy_names": specs,
        "date": date_of([simulator, *log, *specs.values()]),
    }
    if asked.initial is not None:
        facts["initial"] = asked.initial
    if asked.impossible != "refuse":
        facts["impossible"] = asked.impossible
    if asked.column:
        facts["columns"] = ", ".join(asked.column)
        facts["column_options"] = asked.column
    if asked.box is not None:
        facts["box"] = asked.box
    if asked.discount is not None:
        facts["discount"] = asked.discount
    if asked.success:
        facts["success"] = ", ".join(asked.success)
    if asked.action_noise:
        facts["simulator"] = (
            f"{simulator} with action noise {asked.action_noise:g}: {task.mdp!r}"
        )
    return facts


def date_of(files: Iterable[str | os.PathLike[str]]) -> str:
    """Return the day (UTC) of the newest of the files; "" where none exists.

    The same inputs give the same day.
    """
    times = [Path(file).stat().st_mtime for file in files if Path(file).is_file()]
    return _printing.write_day(max(times)) if times else ""


def _read_target(asked: Asked, task: oee.tasks.NamedTask) -> oee.FiniteMDP | None:
    """Read the true target, with the simulator's discount; None where it is unknown."""
    if asked.target is None:
        return None
    discount = asked.discount if asked.success else task.mdp.discount
    target: oee.FiniteMDP = task_of(asked.target, discount, asked.initial).mdp
    if asked.success:
        target = read_success(asked.success, target, asked.discount, asked.rewards)
    return target


def read_outputs(
    folder: Path | None, report: str | None, *, overwrite: bool
) -> tuple[str | None, list[_writing.Output]]:
    """Split TITLE=FILE.html, and check that folder and page can be written."""
    from oee_tabular.report import ReportOutput, new_page

    outputs: list[_writing.Output] = []
    if folder is not None:
        outputs.append(ReportOutput(folder, "--output", overwrite=overwrite))
    if report is None:
        return None, outputs
    title, _, name = report.rpartition("=")
    text = name or report
    path = Path(text)
    if title and _is_place_of_page(Path(report), report):
        if _is_place_of_page(path, report):
            raise ArgumentError(
                "--report",
                f"must be clear; {report!r} and {name!r} can both be the file (write"
                f" {title}=./{name}, or ./{report})",
            )
        title = ""
        text = report
        path = Path(report)
    page = new_page(text, "--report", overwrite=overwrite)
    if folder is not None and os.path.realpath(folder) == os.path.realpath(page.path):
        raise ArgumentError(
            "--report", f"must be no folder; {text!r} is the folder of --output"
        )
    return title or None, [*outputs, page]


def _is_place_of_page(page: Path, text: str) -> bool:
    """Say whether a page is there, or, of a text like a=b/c.html, its folder is."""
    has_folder = "=" in str(Path(text).parent) and page.parent.is_dir()
    return page.is_file() or has_folder


def _refuse_task_options(
    simulator: str | None,
    settings: Mapping[str, object],
    cells: object,
    fit: str | None,
    history: str,
) -> None:
    """Refuse options of continuous tasks if the simulator is none."""
    is_given = {
        "--task-option": bool(settings),
        "--grid": cells is not None,
        "--fit": bool(fit),
        "--history": history != "auto",
    }
    given = [option for option in is_given if is_given[option]]
    if not given or is_continuous(simulator):
        return
    if simulator is not None:
        task_of(simulator)  # a simulator that does not exist is the better error
    raise ValueError(
        f"{given[0]} needs a continuous task (--simulator cartpole:gravity=10)"
    )


def read_knob(
    unrecorded: str | None, interval_seconds: float | None
) -> dict[str, float]:
    """Read --unrecorded and --interval-seconds; return those that were given."""
    knob: dict[str, float] = {}
    if unrecorded is not None:
        try:
            knob["unrecorded"] = float(unrecorded)
        except ValueError:
            raise ArgumentError(
                "--unrecorded", f"must be a number from 1 to inf; it is {unrecorded!r}"
            ) from None
        if not knob["unrecorded"] >= 1.0:
            raise ArgumentError(
                "--unrecorded", f"must be in [1, inf]; it is {unrecorded}"
            )
    if interval_seconds is not None:
        if not 0.0 < interval_seconds < math.inf:
            raise ArgumentError(
                "--interval-seconds",
                f"must be a number of seconds above 0; it is {interval_seconds:g}"
                " (--quick leaves the intervals out)",
            )
        knob["interval_seconds"] = interval_seconds
    return knob


def refuse_beside_quick(
    quick: bool,
    box: str | None,
    unrecorded: str | None,
    interval_seconds: float | None,
) -> None:
    """Refuse what is about intervals beside --quick; a box may be none."""
    if read_box(box) and quick:
        raise ArgumentError(
            "--quick",
            "must be left out with --box: it leaves out the intervals that a box"
            " narrows",
        )
    if not quick:
        return
    if unrecorded is not None and math.isinf(float(unrecorded)):
        raise ArgumentError(
            "--quick",
            "must be left out with --unrecorded inf: it leaves out the search for this"
            " worst case",
        )
    if interval_seconds is not None:
        raise ArgumentError(
            "--quick",
            "must be left out with --interval-seconds: it leaves out the search that"
            " this is about",
        )


def _refuse_given(options: Mapping[str, object], rule: str) -> None:
    """Refuse the first of these options that has another value than its default."""
    for option, value in options.items():
        if value not in DEFAULTS:
            raise ArgumentError(option, rule.format(value))


def write_report(
    report: Report, outputs: Sequence[_writing.Output], title: str | None
) -> list[Path]:
    """Write the folder and the page of a report; return the files."""
    written: list[Path] = []
    for output in outputs:
        with output.writing():
            if output.name == "--output":
                written += report.save(output.path)
            else:
                report.to_html(output.path, title=title)
                written.append(output.path)
    return written
