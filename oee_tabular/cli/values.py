"""Commands of values (of policies, of the best policy, of new data) and of studies."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _files, _progress, _writing
from oee_tabular._arguments import literal, named_specs
from oee_tabular.cli.inputs import (
    count_log_files,
    policies_of,
    policy_of,
    read_box,
    read_columns,
    read_entries,
    read_problem,
    read_success,
    task_of,
    write_array,
)
from oee_tabular.cli.options import (
    INPUT,
    OUTPUT,
    VALUE,
    ActionNoiseOption,
    BoxOption,
    ColumnOption,
    ConfidenceOption,
    DaskOption,
    DiscountOption,
    HorizonOption,
    ImpossibleOption,
    InitialOption,
    IntervalSecondsOption,
    JobsOption,
    JsonOption,
    LogOption,
    OptionalLogOption,
    OptionalSimulatorOption,
    OverwriteFolderOption,
    OverwriteOption,
    PoliciesOption,
    RewardsOption,
    SeedOption,
    SimulatorOption,
    SlidesOption,
    SuccessOption,
    TrialsOption,
    UnrecordedOption,
    print_result,
    say,
    slides_if,
)
from oee_tabular.continuous import (
    evaluate_files,
    is_continuous,
    read_grid,
    task_options,
)
from oee_tabular.exceptions import ArgumentError

if TYPE_CHECKING:
    from oee_tabular.report import Report

PLAN_OPTIONS = ("model", "optimistic", "restart", "restart_costs_a_move", "solver")
# the exit code of `compare --expect-best` where the first policy is not the best
NOT_THE_BEST = 3
# what these options are when they are not given
DEFAULTS = (None, 0.0, "refuse", "simulator")


def evaluate(
    *,
    simulator: OptionalSimulatorOption = None,
    log: OptionalLogOption = None,
    column: ColumnOption = None,
    policy: PoliciesOption = None,
    history: Annotated[
        str,
        typer.Option(
            "--history",
            metavar="STEPS",
            help="Last actions in a continuous task's state: a number, or auto.",
            rich_help_panel=INPUT,
        ),
    ] = "auto",
    fit: Annotated[
        str | None,
        typer.Option(
            "--fit",
            metavar="NAME,...",
            help="Parameters of a continuous task that are fitted to the log first.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    behavior: Annotated[
        str | None,
        typer.Option(
            "--behavior",
            metavar="SPEC",
            help="Policy that recorded the log.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            metavar="SIM",
            help="The true target, to show errors.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    initial: InitialOption = None,
    action_noise: ActionNoiseOption = 0.0,
    impossible: ImpossibleOption = "refuse",
    trials: TrialsOption = None,
    success: SuccessOption = None,
    features: Annotated[
        Path | None,
        typer.Option(
            "--features",
            metavar="FILE",
            help="Your own features of transitions; adds the row oee-features.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    tie: Annotated[
        Path | None,
        typer.Option(
            "--tie",
            metavar="FILE",
            help="Keys of transitions that share a ratio; adds the row oee-tied.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    grid: Annotated[
        str | None,
        typer.Option(
            "--grid",
            metavar="CELLS",
            help="Add rows on a finite MDP: 60x60, 3000 or auto.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    task_option: Annotated[
        list[str] | None,
        typer.Option(
            "--task-option",
            metavar="NAME=VALUE",
            help=(
                "Setting of a continuous task, repeatable: outside, strict,"
                " calibration, floor, simulations, state or actions."
            ),
            rich_help_panel=INPUT,
        ),
    ] = None,
    box: BoxOption = None,
    horizon: HorizonOption = None,
    discount: DiscountOption = None,
    normalized: Annotated[
        bool | None,
        typer.Option(
            "--normalized/--raw",
            help="Multiply values by (1 - discount), or not.",
            rich_help_panel=VALUE,
        ),
    ] = None,
    estimators: Annotated[
        str | None,
        typer.Option(
            "--estimators",
            metavar="NAME,...",
            help="Names of estimators, comma-separated.",
            rich_help_panel=VALUE,
        ),
    ] = None,
    rewards: RewardsOption = "simulator",
    confidence: ConfidenceOption = 0.95,
    guaranteed: Annotated[
        bool | None,
        typer.Option(
            "--guaranteed/--quick",
            help="Add guaranteed intervals, or leave out likelihood ones; by default"
            " neither.",
            rich_help_panel=VALUE,
        ),
    ] = None,
    unrecorded: UnrecordedOption = None,
    interval_seconds: IntervalSecondsOption = None,
    seed: SeedOption = 0,
    show_all: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Print the rows that a short report leaves out.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            help="Print every note and the columns of diagnostics.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="FOLDER",
            help="Folder for report.json, table.csv and values.png, .pdf, .svg; those of"
            " the last run are replaced.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    slides: SlidesOption = False,
    report: Annotated[
        str | None,
        typer.Option(
            "--report",
            metavar="FILE.html",
            help="One self-contained page, for people who did not run the command.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    overwrite: OverwriteFolderOption = False,
    as_json: JsonOption = False,
) -> None:
    """Estimate the value of policies in the target.

    It takes a simulator and a log of the target. Without arguments, it evaluates the
    paper's 10 x 10 grid.
    """
    from oee_tabular.report import render_intervals

    if slides and output is None:
        raise ArgumentError(
            "--slides", "must be given with --output, whose pictures it draws"
        )
    title, outputs = _read_outputs(output, report, overwrite=overwrite)
    settings = task_options(task_option)
    cells = read_grid(grid)
    _refuse_task_options(simulator, settings, cells, fit, history)
    # options that need a simulator whose states are numbered, and a log
    for_files: dict[str, object] = {
        "--features": features,
        "--tie": tie,
        "--box": box,
        "--action-noise": action_noise,
        "--initial": initial,
        "--impossible": impossible,
        "--trials": trials,
        "--success": success,
    }
    knob = _read_knob(unrecorded, interval_seconds)
    _refuse_beside_quick(guaranteed is False, box, unrecorded, interval_seconds)
    common: dict[str, Any] = {
        "confidence": confidence,
        "seed": seed,
        "guaranteed": guaranteed is True,
        "quick": guaranteed is False,
        "estimators": None if estimators is None else _split_names(estimators),
        "normalized": bool(normalized),
    }
    is_shown: list[bool] = []

    def show(report: Report) -> None:
        """Print the report of a large problem before its intervals are known."""
        is_shown.append(True)
        say(report.to_text(all=show_all, verbose=verbose))

    if simulator is None and not log:
        _refuse_given(
            {"--column": column, "--behavior": behavior, "--target": target}
            | for_files,
            "needs --simulator and --log",
        )
        common["normalized"] = normalized is not False
        made = _evaluate_example(
            policy,
            horizon=horizon,
            discount=discount,
            rewards=rewards,
            common=common | knob,
        )
    elif simulator is None or not log:
        given, missing = ("log", "simulator") if log else ("simulator", "log")
        raise ArgumentError(
            f"--{missing}",
            f"must be given with --{given} (record a log with: oee sample)",
        )
    elif is_continuous(simulator):
        common["fit"] = fit.split(",") if fit else fit
        common["history"] = literal(history, "--history")
        _refuse_given(
            {
                "--rewards": rewards,
                "--unrecorded": unrecorded,
                "--interval-seconds": interval_seconds,
            }
            | for_files,
            "must be left out for a continuous task, whose states have no numbers; it"
            " is {}",
        )
        made = evaluate_files(
            simulator,
            log,
            policy,
            behavior,
            target,
            settings,
            grid=cells,
            columns=read_columns(column, log),
            horizon=horizon,
            discount=0.99 if discount is None else discount,
            **common,
        )
    else:
        made = _evaluate_finite(
            simulator,
            log,
            policy,
            column=column,
            behavior=behavior,
            target=target,
            initial=initial,
            action_noise=action_noise,
            impossible=impossible,
            trials=trials,
            success=success,
            features=features,
            tie=tie,
            box=box,
            horizon=horizon,
            discount=discount,
            rewards=rewards,
            common=common | knob,
            show=None if as_json else show,
        )
    record = made.to_dict() if as_json else {}
    shown = made.to_text(all=show_all, verbose=verbose)
    if is_shown:
        shown = f"\n{render_intervals(made)}"
    try:
        print_result(shown, record, as_json)
    finally:
        # the files are written whatever becomes of standard output
        with slides_if(slides):
            written = _write_report(made, outputs, title)
    if written and not as_json:
        say(f"\nWritten: {', '.join(map(str, written))}")


def _read_outputs(
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
    page = new_page(path, "--report", overwrite=overwrite)
    if folder is not None and os.path.realpath(folder) == os.path.realpath(page.path):
        raise ArgumentError(
            "--report", f"must be no folder; {text!r} is the folder of --output"
        )
    return title or None, [*outputs, page]


def _is_place_of_page(page: Path, text: str) -> bool:
    """Say whether a page is there, or, of a text like a=b/c.html, its folder is."""
    has_folder = "=" in str(Path(text).parent) and page.parent.is_dir()
    return page.is_file() or has_folder


def _split_names(text: str) -> list[str]:
    """Split names at commas."""
    parts = [part.strip() for part in text.split(",")]
    return [part for part in parts if part]


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


def _read_knob(
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


def _refuse_beside_quick(
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


def _evaluate_example(
    policy: list[str] | None,
    *,
    horizon: int | None,
    discount: float | None,
    rewards: Any,
    common: Mapping[str, Any],
) -> Report:
    """Evaluate the paper's grid, which needs no files."""
    default = oee.tasks.embedded_default(
        seed=common["seed"], discount=0.99 if discount is None else discount
    )
    problem = oee.Problem(
        default.simulator,
        default.log,
        horizon=default.horizon if horizon is None else horizon,
        rewards=rewards,
        episodes=default.episodes,
        behavior_policy=default.behavior_policy,
    )
    policies: Any = default.policies
    if policy is not None:
        policies = policies_of(policy, task_of("gridworld:10,slip=0.3", discount))
    return oee.evaluate(problem, policies, target=default.target, **common)


def _evaluate_finite(
    simulator: str,
    log: list[str],
    policy: list[str] | None,
    *,
    column: list[str] | None,
    behavior: str | None,
    target: str | None,
    initial: str | None,
    action_noise: float,
    impossible: str,
    trials: str | None,
    success: list[str] | None,
    features: Path | None,
    tie: Path | None,
    box: str | None,
    horizon: int | None,
    discount: float | None,
    rewards: str,
    common: Mapping[str, Any],
    show: Callable[[Report], object] | None,
) -> Report:
    """Evaluate policies by the files of a simulator and a log."""
    from oee_tabular.report import evaluate_showing
    from oee_tabular.report.page import date_of

    task, problem = read_problem(
        simulator,
        log,
        discount=discount,
        initial=initial,
        action_noise=action_noise,
        impossible=impossible,
        horizon=horizon,
        rewards=rewards,
        behavior=behavior,
        column=column,
        trials=trials,
        success=success,
    )
    specs = named_specs(policy or ["optimal"])
    facts: dict[str, Any] = {
        "simulator_name": simulator,
        "log_name": ", ".join(log),
        "log_files": log,
        "number_of_log_files": count_log_files(log, problem.log),
        "action_noise": action_noise,
        "policy_names": specs,
        "date": date_of([simulator, *log, *specs.values()]),
    }
    if initial is not None:
        facts["initial"] = initial
    if impossible != "refuse":
        facts["impossible"] = impossible
    if column:
        facts["columns"] = ", ".join(column)
    if discount is not None:
        facts["discount"] = discount
    if success:
        facts["success"] = ", ".join(success)
    if action_noise:
        facts["simulator"] = (
            f"{simulator} with action noise {action_noise:g}: {task.mdp!r}"
        )
    known: dict[str, Any] = read_box(box)
    for name, path in (("features", features), ("tie", tie)):
        if path is not None:
            known[name], content = read_entries(path, name, task.mdp)
            facts[name] = f"{path} ({content})"
    true_mdp = None
    if target is not None:
        known_discount = discount if success else task.mdp.discount
        true_mdp = task_of(target, known_discount, initial).mdp
        if success:
            true_mdp = read_success(success, true_mdp, discount, rewards)
    return evaluate_showing(
        problem,
        policies_of(policy, task),
        show,
        facts=facts,
        target=true_mdp,
        **known,
        **common,
    )


def _write_report(
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


def compare(
    *,
    simulator: SimulatorOption,
    log: LogOption,
    policy: Annotated[
        list[str],
        typer.Option(
            "--policy",
            metavar="NAME=SPEC",
            help="Policy to compare, two or more: SPEC or NAME=SPEC.",
            rich_help_panel=INPUT,
        ),
    ],
    column: ColumnOption = None,
    initial: InitialOption = None,
    action_noise: ActionNoiseOption = 0.0,
    impossible: ImpossibleOption = "refuse",
    box: BoxOption = None,
    horizon: HorizonOption = None,
    discount: DiscountOption = None,
    rewards: RewardsOption = "simulator",
    confidence: ConfidenceOption = 0.95,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Leave out likelihood intervals, which are slow for large problems.",
            rich_help_panel=VALUE,
        ),
    ] = False,
    unrecorded: UnrecordedOption = None,
    interval_seconds: IntervalSecondsOption = None,
    expect_best: Annotated[
        bool,
        typer.Option(
            "--expect-best",
            help="End with exit code 3 unless the first policy is found to be the best.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Say which of several policies is worth most.

    It prints differences with their intervals and P(best), or says that the log cannot
    tell.
    """
    from oee_tabular.report import contest_showing, render_comparison

    if is_continuous(simulator):
        raise ArgumentError(
            "--simulator",
            f"must have numbered states to compare policies; {simulator!r} is"
            " continuous: oee evaluate",
        )
    if len(named_specs(policy)) < 2:
        raise ArgumentError(
            "--policy",
            "must be given twice or more, for there is nothing to compare; there is"
            f" {policy[0]!r}",
        )
    _refuse_beside_quick(quick, box, unrecorded, interval_seconds)
    known: dict[str, Any] = read_box(box) | _read_knob(unrecorded, interval_seconds)
    task, problem = read_problem(
        simulator,
        log,
        discount=discount,
        initial=initial,
        action_noise=action_noise,
        impossible=impossible,
        horizon=horizon,
        rewards=rewards,
        column=column,
    )
    policies = policies_of(policy, task)

    def show(report: Report) -> None:
        """Print the answer of a large problem before its intervals are known."""
        say(f"{render_comparison(report)}\n")

    report = contest_showing(
        problem,
        policies,
        None if as_json else show,
        confidence=confidence,
        quick=quick,
        **known,
    )
    warnings = [str(finding) for finding in problem.findings]
    lines = [render_comparison(report)]
    if warnings:
        lines += ["", *warnings]
    rows = report.comparison()
    record = {
        "confidence": report.confidence,
        "best": report.best,
        "sentence": report.headline,
        "policies": rows,
        "differences": [_difference(row, rows[0]["policy"]) for row in rows[1:]],
        "warnings": warnings,
    }
    print_result("\n".join(lines), record, as_json)
    if expect_best and report.best != next(iter(policies)):
        raise typer.Exit(NOT_THE_BEST)


def _difference(row: Mapping[str, Any], best: str) -> dict[str, Any]:
    """Return how a policy's value differs from the best one's, with the interval."""
    lower = row["less_by_lower"]
    upper = row["less_by_upper"]
    return {
        "policy": row["policy"],
        "than": best,
        "difference": -row["less_by"],
        "lower": None if upper is None else -upper,
        "upper": None if lower is None else -lower,
    }


def plan(
    *,
    simulator: SimulatorOption,
    log: LogOption,
    transitions: Annotated[
        int,
        typer.Option(
            "--transitions",
            metavar="N",
            help="Number of transitions to record next.",
            rich_help_panel=INPUT,
        ),
    ],
    column: ColumnOption = None,
    policy: PoliciesOption = None,
    minus: Annotated[
        str | None,
        typer.Option(
            "--minus",
            metavar="SPEC",
            help="Policy that runs now: plan for the gains over it, not for the values.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    initial: InitialOption = None,
    action_noise: ActionNoiseOption = 0.0,
    impossible: ImpossibleOption = "refuse",
    free: Annotated[
        bool,
        typer.Option(
            "--free",
            help="Any state-action pair can be recorded, not only episodes.",
            rich_help_panel=INPUT,
        ),
    ] = False,
    plan_option: Annotated[
        list[str] | None,
        typer.Option(
            "--plan-option",
            metavar="NAME=VALUE",
            help=(
                "Setting of the plan, repeatable: model, optimistic, restart,"
                " restart_costs_a_move or solver."
            ),
            rich_help_panel=INPUT,
        ),
    ] = None,
    box: BoxOption = None,
    horizon: HorizonOption = None,
    discount: DiscountOption = None,
    confidence: ConfidenceOption = 0.95,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="FILE",
            help="The behaviour policy (with `--free`, shares of the pairs) as .npy.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Plan what to record next.

    It prints a behaviour policy, and the width of each value's interval before and
    after.
    """
    file = None
    if output is not None:
        file = _files.new_file(
            output, "--output", overwrite=overwrite, endings=(".npy",)
        )
    settings = named_specs(plan_option or [], "--plan-option", PLAN_OPTIONS)
    asked: dict[str, Any] = {name: literal(text) for name, text in settings.items()}
    asked |= read_box(box)
    task, problem = read_problem(
        simulator,
        log,
        discount=discount,
        initial=initial,
        action_noise=action_noise,
        impossible=impossible,
        horizon=horizon,
        column=column,
    )
    policies = policies_of(policy, task)
    if minus is not None:
        asked["minus"] = policy_of(minus, task, "--minus")
    _progress.report_step(f"plan for {transitions} transitions")
    made = oee.plan_data_collection(
        problem,
        policies,
        n=transitions,
        sampling="free" if free else "behavior",
        confidence=confidence,
        **asked,
    )
    text = str(made)
    record = made.to_dict() | {"file": None if output is None else str(output)}
    if file is not None:
        what = "shares of the pairs, (S, A), that sum to 1"
        with file.writing():
            if free:
                write_array(file.path, made.distribution)
            else:
                write_array(file.path, made.behavior_policy)
                what = "policy to record with"
        text += f"\n{output}: {what}"
    print_result(text, record, as_json)


# ---- studies


def reproduce(
    *,
    experiments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ID...",
            help="Ids or groups; `--list` shows them.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    run_all: Annotated[
        bool,
        typer.Option("--all", help="Run every experiment.", rich_help_panel=INPUT),
    ] = False,
    list_only: Annotated[
        bool,
        typer.Option(
            "--list", help="List the experiments and stop.", rich_help_panel=INPUT
        ),
    ] = False,
    smoke: Annotated[
        bool,
        typer.Option(
            "--smoke",
            help="Run a small subset of each sweep, into OUTPUT/smoke.",
            rich_help_panel=INPUT,
        ),
    ] = False,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds",
            metavar="N",
            help="Number of repetitions, in place of the experiment's own.",
            rich_help_panel=VALUE,
        ),
    ] = None,
    seed: SeedOption = 0,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            metavar="FOLDER",
            help="Folder for ID/table.csv, summary.md, figure.svg, ... and index.md.",
            rich_help_panel=OUTPUT,
        ),
    ] = Path("results"),
    slides: SlidesOption = False,
    fresh: Annotated[
        bool,
        typer.Option(
            "--fresh",
            help="Empty the experiments' folders first.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    overwrite: OverwriteFolderOption = False,
    as_json: JsonOption = False,
) -> None:
    """Reproduce the paper's figures, and more.

    An interrupted run goes on where it stopped.
    """
    from oee_tabular.lab.experiments import catalogue

    if list_only:
        _refuse_beside_list(
            {
                "ID": bool(experiments),
                "--all": run_all,
                "--smoke": smoke,
                "--seeds": seeds is not None,
                "--seed": seed != 0,
                "--jobs": jobs != -1,
                "--dask": dask is not None,
                "--slides": slides,
                "--fresh": fresh,
            }
        )
        _print_lines(lambda say: say(catalogue.listing()), as_json)
        return
    with slides_if(slides):
        _print_lines(
            lambda say: catalogue.reproduce(
                experiments or [],
                everything=run_all,
                smoke=smoke,
                seeds=seeds,
                seed=seed,
                jobs=jobs,
                dask=dask,
                output=output,
                fresh=fresh,
                overwrite=overwrite,
                say=say,
            ),
            as_json,
        )


def _refuse_beside_list(is_given: Mapping[str, bool]) -> None:
    """Refuse the first option that is given beside --list."""
    for option in is_given:
        if is_given[option]:
            raise ArgumentError(
                option, "must be left out with --list, which runs nothing"
            )


def _print_lines(run: Callable[[Callable[[str], None]], None], as_json: bool) -> None:
    """Print the lines of a run as it goes on, or as one JSON object at the end."""
    if not as_json:
        run(say)
        return
    lines: list[str] = []
    try:
        run(lines.append)
    except KeyboardInterrupt:
        for line in lines:
            _progress.report_finished(line)
        raise
    print_result("", {"lines": "\n".join(lines).split("\n")}, True)


def bench(
    *,
    estimators: Annotated[
        str,
        typer.Option(
            "--estimators",
            metavar="NAME,...",
            help="Estimators to measure, comma-separated.",
            rich_help_panel=INPUT,
        ),
    ] = "oee,model-based",
    families: Annotated[
        str | None,
        typer.Option(
            "--families",
            metavar="NAME,...",
            help="Families, comma-separated, or your own MODULE:FUNCTION; else all.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(
            "--sizes",
            metavar="N,...",
            help=(
                "Transitions of each stochastic state-action pair, comma-separated;"
                " else 0.3,1,3,10,30."
            ),
            rich_help_panel=VALUE,
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            "--seeds",
            metavar="N",
            help="Number of logs of each family and size.",
            rich_help_panel=VALUE,
        ),
    ] = 40,
    timeout: Annotated[
        float,
        typer.Option(
            "--timeout",
            metavar="SECONDS",
            help="Time limit of an estimate; a slower one is a row with that reason.",
            rich_help_panel=VALUE,
        ),
    ] = 600.0,
    seed: SeedOption = 0,
    jobs: JobsOption = -1,
    dask: DaskOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            metavar="FOLDER",
            help=(
                "Folder for table.csv, cells.csv, league.csv, league.md, league.tex,"
                " profile.png, .pdf, .svg, ..."
            ),
            rich_help_panel=OUTPUT,
        ),
    ] = Path("results/bench"),
    slides: SlidesOption = False,
    label: Annotated[
        list[str] | None,
        typer.Option(
            "--label",
            metavar="NAME=TEXT",
            help=(
                "What an estimator is called in the page, the LaTeX table and the"
                " pictures (repeatable)."
            ),
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    fresh: Annotated[
        bool,
        typer.Option("--fresh", help="Empty the folder first.", rich_help_panel=OUTPUT),
    ] = False,
    overwrite: OverwriteFolderOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure estimators where the truth is exact.

    They are measured on families of environment shift. An interrupted run goes on where
    it stopped.
    """
    from oee_tabular.lab.bench import bench as run

    with slides_if(slides):
        _print_lines(
            lambda say: run(
                estimators=estimators,
                families=families,
                sizes=sizes,
                seeds=seeds,
                timeout=timeout,
                seed=seed,
                jobs=jobs,
                dask=dask,
                output=output,
                fresh=fresh,
                overwrite=overwrite,
                labels=label or (),
                say=say,
            ),
            as_json,
        )


def check(
    *,
    estimator: Annotated[
        str,
        typer.Argument(
            metavar="MODULE:OBJECT",
            help="An estimator, or what makes one without arguments.",
            rich_help_panel=INPUT,
        ),
    ],
    seed: SeedOption = 0,
    repetitions: Annotated[
        int,
        typer.Option(
            "--repetitions",
            metavar="N",
            help="Logs of each comparison, at least 3; more logs find smaller biases.",
            rich_help_panel=VALUE,
        ),
    ] = 8,
    timeout: Annotated[
        float,
        typer.Option(
            "--timeout",
            metavar="SECONDS",
            help="Time limit of each law; a slower estimator breaks the law.",
            rich_help_panel=VALUE,
        ),
    ] = 60.0,
    as_json: JsonOption = False,
) -> None:
    """Check an estimator of yours against the laws.

    It runs in a process of its own. The exit code is 0 if the laws that it claims hold,
    else 1. Where it is 0, the last line begins with "all laws hold", or names the
    default laws that the estimator does not claim. It says at what tolerance each law
    holds, and what was not tested. Where it is 1, a case of a broken law stands before
    it as code.
    """
    from oee_tabular.testing import check_module

    _progress.report_step(f"laws of estimators, on {estimator}")
    verdicts = check_module(
        estimator, seed=seed, repetitions=repetitions, timeout=timeout
    )
    laws = [
        {
            "law": v.law,
            "outcome": v.outcome,
            "text": v.text,
            "example": v.example,
            "code": v.code,
            "tolerance": v.tolerance,
        }
        for v in verdicts.values()
    ]
    record = {
        "estimator": verdicts.estimator,
        "passed": verdicts.passed,
        "seed": seed,
        "conclusion": verdicts.conclusion,
        "laws": laws,
    }
    print_result(f"{verdicts}\n{verdicts.conclusion}", record, as_json)
    if not verdicts.passed:
        raise typer.Exit(1)
