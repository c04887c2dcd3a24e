"""Commands of values (of policies, of the best policy, of new data) and of studies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _files, _progress, _writing
from oee_tabular._arguments import literal, named_specs
from oee_tabular.cli.evaluation import (
    evaluate_asked,
    read_knob,
    read_outputs,
    refuse_beside_quick,
    write_report,
)
from oee_tabular.cli.evaluation_options import Asked, OutputOptions
from oee_tabular.cli.groups import take_groups
from oee_tabular.cli.inputs import (
    policies_of,
    policy_of,
    read_box,
    read_named_policies,
    read_problem,
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
    OverwriteFolderOption,
    OverwriteOption,
    PoliciesOption,
    RewardsOption,
    SeedOption,
    SimulatorOption,
    SlidesOption,
    UnrecordedOption,
    print_result,
    say,
    slides_if,
)
from oee_tabular.continuous import (
    is_continuous,
)
from oee_tabular.exceptions import ArgumentError

if TYPE_CHECKING:
    from oee_tabular.report import Report

PLAN_OPTIONS = ("model", "optimistic", "restart", "restart_costs_a_move", "solver")
# the exit code of `compare --expect-best` where the first policy is not the best
NOT_THE_BEST = 3


@take_groups
def evaluate(asked: Asked, shown: OutputOptions) -> None:
    """Estimate the value of policies in the target.

    It takes a simulator and a log of the target. Without arguments, it evaluates the
    paper's 10 x 10 grid.
    """
    if shown.slides and shown.output is None:
        raise ArgumentError(
            "--slides", "must be given with --output, whose pictures it draws"
        )
    title, outputs = read_outputs(shown.output, shown.report, overwrite=shown.overwrite)
    is_shown: list[bool] = []

    def write(report: Report) -> str:
        """Return a report as text."""
        return report.to_text(all=shown.show_all, verbose=shown.verbose)

    def show(report: Report) -> None:
        """Print the report of a large problem before its intervals are known."""
        is_shown.append(True)
        say(write(report))

    made = evaluate_asked(asked, None if shown.as_json else show)
    record = made.to_dict() if shown.as_json else {}
    text = write(made)
    if is_shown:
        text = f"\n{oee.report.render_intervals(made, verbose=shown.verbose)}"
    try:
        print_result(text, record, shown.as_json)
    finally:
        # the files are written whatever becomes of standard output
        with slides_if(shown.slides):
            written = write_report(made, outputs, title)
    if written and not shown.as_json:
        say(f"\nWritten: {', '.join(map(str, written))}")


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
            help="End with exit code 3 unless the first policy is found to be the"
            " best.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            help="Print every note.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Say which of several policies is worth most.

    It prints differences with their intervals and P(best), or says that the log cannot
    tell.
    """
    from oee_tabular.report import add_log_notes, contest_showing

    _require_contest(simulator, policy)
    refuse_beside_quick(quick, box, unrecorded, interval_seconds)
    known: dict[str, Any] = read_box(box) | read_knob(unrecorded, interval_seconds)
    task, problem, notes, _ = read_problem(
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

    def show(report: Report) -> None:
        """Print the answer of a large problem before its intervals are known."""
        noted = add_log_notes(report, notes)
        say(f"{oee.report.render_comparison(noted, verbose=verbose)}\n")

    report = contest_showing(
        problem,
        policies_of(read_named_policies(policy), task),
        None if as_json else show,
        confidence=confidence,
        quick=quick,
        **known,
    )
    report = add_log_notes(report, notes)
    shown = oee.report.render_comparison(report, verbose=verbose)
    told = [*map(str, problem.findings), *notes]
    print_result(shown, _record_contest(report, told), as_json)
    if expect_best and report.best != next(iter(report.policies)):
        raise typer.Exit(NOT_THE_BEST)


def _require_contest(simulator: str, policy: list[str]) -> None:
    """Refuse a continuous task, and a single policy."""
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


def _record_contest(report: Report, warnings: Sequence[str]) -> dict[str, Any]:
    """Return what ``oee compare --json`` prints."""
    rows = report.comparison()
    return {
        "confidence": report.confidence,
        "best": report.best,
        "sentence": report.headline,
        "policies": rows,
        "differences": [_difference(row, rows[0]["policy"]) for row in rows[1:]],
        "warnings": list(warnings),
    }


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
            help="Policy that runs now: plan for the gains over it, not for the"
            " values.",
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
            help="The behaviour policy (with `--free`, shares of the pairs): .npy, or"
            " .csv with names.",
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
    from oee_tabular.cli.policies import ENDINGS

    file = None
    if output is not None:
        file = _files.new_file(output, "--output", overwrite=overwrite, endings=ENDINGS)
    asked = _read_plan_options(plan_option or []) | read_box(box)
    task, problem, notes, _ = read_problem(
        simulator,
        log,
        discount=discount,
        initial=initial,
        action_noise=action_noise,
        impossible=impossible,
        horizon=horizon,
        column=column,
    )
    if minus is not None:
        asked["minus"] = policy_of(minus, task, "--minus")
    _progress.report_step(f"plan for {transitions} transitions")
    made = oee.plan_data_collection(
        problem,
        policies_of(read_named_policies(policy), task),
        n=transitions,
        sampling="free" if free else "behavior",
        confidence=confidence,
        **asked,
    )
    lines = [str(made)]
    record = made.to_dict() | {
        "file": None if output is None else str(output),
        "log_notes": notes,
    }
    if file is not None:
        lines.append(f"{output}: {_save_plan(made, file, task.mdp, free=free)}")
    print_result("\n".join(lines), record, as_json)


def _read_plan_options(texts: list[str]) -> dict[str, Any]:
    """Read the settings of a plan by their names."""
    settings = named_specs(texts, "--plan-option", PLAN_OPTIONS)
    return {name: literal(text) for name, text in settings.items()}


def _save_plan(
    made: oee.design.Plan, file: _writing.Output, mdp: oee.FiniteMDP, *, free: bool
) -> str:
    """Save what a plan says to record; return what the file holds."""
    from oee_tabular.cli.policies import write_pairs

    with file.writing():
        if free:
            write_pairs(file.path, made.distribution, mdp, "share")
            return "shares of the pairs, (S, A), that sum to 1"
        write_pairs(file.path, made.behavior_policy, mdp)
        return "policy to record with"


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
    from oee_tabular.lab.bench.command import bench as run

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
