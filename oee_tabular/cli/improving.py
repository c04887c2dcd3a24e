"""The command ``oee improve``: which policy to deploy, or what to record first."""

from __future__ import annotations

from typing import Annotated, Any

import typer

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _writing
from oee_tabular._arguments import named_specs
from oee_tabular.cli.inputs import policy_of, read_box, read_problem
from oee_tabular.cli.options import (
    INPUT,
    OUTPUT,
    VALUE,
    ActionNoiseOption,
    BoxOption,
    ColumnOption,
    ConfidenceOption,
    DiscountOption,
    HorizonOption,
    ImpossibleOption,
    InitialOption,
    JsonOption,
    LogOption,
    OverwriteOption,
    RewardsOption,
    SeedOption,
    SimulatorOption,
    print_result,
    say,
)
from oee_tabular.continuous import is_continuous
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array

NOTHING_TO_DEPLOY = 3  # the exit code of "keep" and "record"


def improve(
    *,
    simulator: SimulatorOption,
    log: LogOption,
    running: Annotated[
        str,
        typer.Option(
            "--running",
            metavar="SPEC",
            help="Policy that runs in the target now.",
            rich_help_panel=INPUT,
        ),
    ],
    candidate: Annotated[
        list[str] | None,
        typer.Option(
            "--candidate",
            metavar="NAME=SPEC",
            help="Policy of your own that may be deployed, repeatable.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    column: ColumnOption = None,
    initial: InitialOption = None,
    action_noise: ActionNoiseOption = 0.0,
    impossible: ImpossibleOption = "refuse",
    box: BoxOption = None,
    horizon: HorizonOption = None,
    discount: DiscountOption = None,
    rewards: RewardsOption = "simulator",
    confidence: ConfidenceOption = 0.95,
    unrecorded: Annotated[
        str,
        typer.Option(
            "--unrecorded",
            metavar="FACTOR",
            help="Factor by which pairs never recorded may differ from the estimate: 1"
            " to inf.",
            rich_help_panel=VALUE,
        ),
    ] = "inf",
    split: Annotated[
        float | None,
        typer.Option(
            "--split",
            metavar="SHARE",
            help="Share of the log that makes the policies; the rest certifies them.",
            rich_help_panel=VALUE,
        ),
    ] = None,
    seed: SeedOption = 0,
    report: Annotated[
        str | None,
        typer.Option(
            "--report",
            metavar="FILE.html",
            help="One self-contained page with the decision.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Say whether to deploy another policy than the one that runs.

    It prints a gain with its certified lower end, or what to record first. The exit
    code is 3 where nothing is to be deployed.
    """
    _require_numbered_states(simulator)
    page = _check_page(report, overwrite=overwrite)
    factor = _read_factor(unrecorded)
    known: dict[str, Any] = read_box(box)
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
    found = oee.improve(
        problem,
        policy_of(running, task, "--running"),
        candidates=_read_candidates(candidate or [], task),
        confidence=confidence,
        unrecorded=factor,
        split=split,
        seed=seed,
        **known,
    )
    _print_and_write(found, notes, page, as_json)
    if not found.deploy:
        raise typer.Exit(NOTHING_TO_DEPLOY)


def _require_numbered_states(simulator: str) -> None:
    """Refuse a continuous task."""
    if is_continuous(simulator):
        raise ArgumentError(
            "--simulator",
            f"must have numbered states to improve a policy; {simulator!r} is"
            " continuous: oee evaluate",
        )


def _check_page(report: str | None, *, overwrite: bool) -> _writing.Output | None:
    """Check that the page can be written; None where none is asked for."""
    from oee_tabular.report import new_page

    if report is None:
        return None
    return new_page(report, "--report", overwrite=overwrite)


def _read_factor(unrecorded: str) -> float:
    """Read --unrecorded; ``oee.improve`` checks its range."""
    try:
        return float(unrecorded)
    except ValueError:
        raise ArgumentError(
            "--unrecorded", f"must be a number from 1 to inf; it is {unrecorded!r}"
        ) from None


def _read_candidates(
    specs: list[str], task: oee.tasks.NamedTask
) -> dict[str, Array] | None:
    """Read the policies that may be deployed; None where none are given."""
    named = named_specs(specs, "--candidate")
    own = {name: policy_of(spec, task, "--candidate") for name, spec in named.items()}
    return own or None


def _print_and_write(
    found: oee.Improvement,
    notes: list[str],
    page: _writing.Output | None,
    as_json: bool,
) -> None:
    """Print a decision, and write its page."""
    file = None if page is None else str(page.path)
    try:
        record = found.to_dict() | {"file": file, "log_notes": notes}
        print_result(str(found), record, as_json)
    finally:
        # the page is written whatever becomes of standard output
        if page is not None:
            with page.writing():
                found.to_html(page.path)
    if page is not None and not as_json:
        say(f"\nWritten: {file}")
