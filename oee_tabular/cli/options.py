"""Options that several commands have, each in its group of the help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from oee_tabular.cli.answers import shape_help
from oee_tabular.cli.policies import POLICY_HELP
from oee_tabular.cli.simulators import SIMULATOR_HELP

INPUT, VALUE, OUTPUT, CONTINUOUS = "Input", "Value", "Output", "Continuous tasks"


def option(group: str, text: str, *names: str, metavar: str | None = None, **more: Any) -> Any:
    """An option of a group of the help."""
    return typer.Option(*names, help=text, metavar=metavar, rich_help_panel=group, **more)


def json_option(command: str) -> Any:
    """``--json`` of a command."""
    return option(OUTPUT, shape_help(command), "--json")


Simulator = Annotated[str, typer.Argument(help=f"{SIMULATOR_HELP}.", metavar="SIM")]
SimulatorOption = Annotated[str, option(INPUT, f"{SIMULATOR_HELP}.", metavar="SIM")]
LOG_HELP = "Log of the target: .npz (a log, or its counts), .csv, .parquet, Minari folder or id."
Log = Annotated[Path, option(INPUT, LOG_HELP, metavar="FILE")]
Policies = Annotated[
    list[str] | None,
    option(INPUT, f"NAME=SPEC or SPEC, repeatable (none: optimal); SPEC: {POLICY_HELP}.", metavar="NAME=SPEC"),
]
Initial = Annotated[
    str | None, option(INPUT, "First state, by name or number, in place of the simulator's.", metavar="STATE")
]
Noise = Annotated[
    float,
    option(
        INPUT,
        "Use simulator.with_action_noise(EPS), where it is too deterministic for the log.",
        "--action-noise",
        metavar="EPS",
    ),
]
Impossible = Annotated[
    str,
    option(
        INPUT,
        "Moves of the log that the simulator gives probability 0: refuse them; drop them, and let them lead anywhere in the "
        "intervals; or allow=EPS, use simulator.with_support_of(log, EPS).",
        metavar="refuse|drop|allow=EPS",
    ),
]
Discount = Annotated[float | None, option(VALUE, "Replaces the simulator's discount.", metavar="GAMMA")]
Horizon = Annotated[
    int | None,
    option(VALUE, "Number of rewards; none: the infinite discounted sum, or a continuous task's own.", metavar="T"),
]
Rewards = Annotated[
    str, option(VALUE, "Rewards that model-based values pay: simulator or log.", metavar="simulator|log")
]
Confidence = Annotated[float, option(VALUE, "Level of the intervals.", metavar="LEVEL")]
Quick = Annotated[bool, option(VALUE, "Leave likelihood intervals out, most of the time of large problems.", "--quick")]
Seed = Annotated[int, option(VALUE, "The same seed gives the same bits.", metavar="N", min=0)]
Overwrite = Annotated[bool, option(OUTPUT, "Replace the file if it exists (a Minari folder: never).", "--overwrite")]
Jobs = Annotated[int, option(VALUE, "Processes on this machine; -1: one a core.", metavar="N")]
Dask = Annotated[str | None, option(VALUE, "Address of a dask scheduler, to run the cells there.", metavar="ADDRESS")]
