"""The options of ``oee evaluate``, as data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from oee_tabular._arguments import literal
from oee_tabular.cli.inputs import read_named_policies
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
    IntervalSecondsOption,
    JsonOption,
    OptionalLogOption,
    OptionalSimulatorOption,
    OverwriteReportOption,
    PoliciesOption,
    RewardsOption,
    SeedOption,
    SlidesOption,
    SuccessOption,
    TrialsOption,
    UnrecordedOption,
)


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Hold the options of ``oee evaluate`` that a value depends on, as they are given.

    The names are those of the options, whose help says what they are.
    """

    simulator: OptionalSimulatorOption = None
    log: OptionalLogOption = None
    column: ColumnOption = None
    policy: PoliciesOption = None
    history: Annotated[
        str,
        typer.Option(
            "--history",
            metavar="STEPS",
            help="Last actions in a continuous task's state: a number, or auto.",
            rich_help_panel=INPUT,
        ),
    ] = "auto"
    fit: Annotated[
        str | None,
        typer.Option(
            "--fit",
            metavar="NAME,...",
            help="Parameters of a continuous task that are fitted to the log first.",
            rich_help_panel=INPUT,
        ),
    ] = None
    behavior: Annotated[
        str | None,
        typer.Option(
            "--behavior",
            metavar="SPEC",
            help="Policy that recorded the log.",
            rich_help_panel=INPUT,
        ),
    ] = None
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            metavar="SIM",
            help="The true target, to show errors.",
            rich_help_panel=INPUT,
        ),
    ] = None
    initial: InitialOption = None
    action_noise: ActionNoiseOption = 0.0
    impossible: ImpossibleOption = "refuse"
    trials: TrialsOption = None
    success: SuccessOption = None
    features: Annotated[
        Path | None,
        typer.Option(
            "--features",
            metavar="FILE",
            help="Your own features of transitions; adds the row oee-features.",
            rich_help_panel=INPUT,
        ),
    ] = None
    tie: Annotated[
        Path | None,
        typer.Option(
            "--tie",
            metavar="FILE",
            help="Keys of transitions that share a ratio; adds the row oee-tied.",
            rich_help_panel=INPUT,
        ),
    ] = None
    grid: Annotated[
        str | None,
        typer.Option(
            "--grid",
            metavar="CELLS",
            help="Add rows on a finite MDP: 60x60, 3000 or auto.",
            rich_help_panel=INPUT,
        ),
    ] = None
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
    ] = None
    box: BoxOption = None
    horizon: HorizonOption = None
    discount: DiscountOption = None
    normalized: Annotated[
        bool | None,
        typer.Option(
            "--normalized/--raw",
            help="Multiply values by (1 - discount), or not.",
            rich_help_panel=VALUE,
        ),
    ] = None
    estimators: Annotated[
        str | None,
        typer.Option(
            "--estimators",
            metavar="NAME,...",
            help="Names of estimators, comma-separated.",
            rich_help_panel=VALUE,
        ),
    ] = None
    rewards: RewardsOption = "simulator"
    confidence: ConfidenceOption = 0.95
    guaranteed: Annotated[
        bool | None,
        typer.Option(
            "--guaranteed/--quick",
            help="Add guaranteed intervals, or leave out likelihood ones; by default"
            " neither.",
            rich_help_panel=VALUE,
        ),
    ] = None
    unrecorded: UnrecordedOption = None
    interval_seconds: IntervalSecondsOption = None
    seed: SeedOption = 0

    @property
    def is_quick(self) -> bool:
        """Return whether --quick is given."""
        return self.guaranteed is False

    @property
    def for_files(self) -> dict[str, object]:
        """Return the options that need a simulator with numbered states, and a log."""
        return {
            "--features": self.features,
            "--tie": self.tie,
            "--box": self.box,
            "--action-noise": self.action_noise,
            "--initial": self.initial,
            "--impossible": self.impossible,
            "--trials": self.trials,
            "--success": self.success,
        }

    @property
    def policies(self) -> dict[str, str]:
        """Return the SPECs of the policies by their names."""
        return read_named_policies(self.policy)

    @property
    def for_continuous(self) -> dict[str, Any]:
        """Return the keyword arguments that only a continuous task has."""
        return {
            "fit": self.fit.split(",") if self.fit else self.fit,
            "history": literal(self.history, "--history"),
        }

    @property
    def common(self) -> dict[str, Any]:
        """Return the keyword arguments that every kind of evaluation has."""
        names = None if self.estimators is None else _split_names(self.estimators)
        return {
            "confidence": self.confidence,
            "seed": self.seed,
            "guaranteed": self.guaranteed is True,
            "quick": self.is_quick,
            "estimators": names,
            "normalized": bool(self.normalized),
        }


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Hold the options of ``oee evaluate`` that say what is printed and written."""

    show_all: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Print the rows that a short report leaves out.",
            rich_help_panel=OUTPUT,
        ),
    ] = False
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            help="Print every note and row, and diagnostics.",
            rich_help_panel=OUTPUT,
        ),
    ] = False
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="FOLDER",
            help="Folder for report.json, table.csv and values.png, .pdf, .svg; those"
            " of the last run are replaced.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    slides: SlidesOption = False
    report: Annotated[
        str | None,
        typer.Option(
            "--report",
            metavar="FILE.html",
            help="One self-contained page, for people who did not run the command.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    overwrite: OverwriteReportOption = False
    as_json: JsonOption = False


def _split_names(text: str) -> list[str]:
    """Split names at commas."""
    parts = [part.strip() for part in text.split(",")]
    return [part for part in parts if part]
