"""Options that several commands share, and how a command prints its result.

A help text is one short sentence; ``details`` has the forms that a value may take.
Option names stand in backticks, which the terminal leaves out.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import Annotated, TextIO

import typer

from oee_tabular._printing import print_text

INPUT = "Input"
VALUE = "Value"
OUTPUT = "Output"
GROUPS = (INPUT, VALUE, OUTPUT)
# what the functions that the commands call name otherwise
ARGUMENTS = {
    "n": "transitions",
    "n_transitions": "transitions",
    "n_episodes": "episodes",
    "max_steps": "horizon",
    "behavior_policy": "behavior",
    "columns": "column",
    "epsilon": "action_noise",
    "lower_ratio and upper_ratio": "box",
    "shape": "grid",
}

# ---- input

_SIMULATOR = typer.Option(
    "--simulator",
    metavar="SIM",
    help="The simulator, by name or file.",
    rich_help_panel=INPUT,
)
SimulatorOption = Annotated[str, _SIMULATOR]
OptionalSimulatorOption = Annotated[str | None, _SIMULATOR]

SimulatorArgument = Annotated[
    str,
    typer.Argument(
        metavar="SIM", help="The simulator, by name or file.", rich_help_panel=INPUT
    ),
]

_LOG = typer.Option(
    "--log",
    metavar="FILE",
    help="Log of the target, repeatable: .npz, .csv, .csv.gz, .parquet, folder or"
    " Minari id.",
    rich_help_panel=INPUT,
)
LogOption = Annotated[list[str], _LOG]
OptionalLogOption = Annotated[list[str] | None, _LOG]

ColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        "--column",
        metavar="COLUMN=LABEL",
        help="What the log's files call a column, repeatable: state=pose_before"
        " (see info -h).",
        rich_help_panel=INPUT,
    ),
]

TableColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        "--column",
        metavar="COLUMN=LABEL",
        help="What a simulator's table or a log calls a column, repeatable:"
        " next_state=pose_after.",
        rich_help_panel=INPUT,
    ),
]

PoliciesOption = Annotated[
    list[str] | None,
    typer.Option(
        "--policy",
        metavar="NAME=SPEC",
        help="Policy to evaluate, repeatable: SPEC or NAME=SPEC; without it, optimal.",
        rich_help_panel=INPUT,
    ),
]

InitialOption = Annotated[
    str | None,
    typer.Option(
        "--initial",
        metavar="STATE",
        help="First state, by name or number, in place of the simulator's.",
        rich_help_panel=INPUT,
    ),
]

ActionNoiseOption = Annotated[
    float,
    typer.Option(
        "--action-noise",
        metavar="EPS",
        help="Probability with which the simulator takes a uniform action instead.",
        rich_help_panel=INPUT,
    ),
]

ImpossibleOption = Annotated[
    str,
    typer.Option(
        "--impossible",
        metavar="refuse|drop|allow=EPS",
        help="Logged transitions with simulator probability 0: raise an error, drop"
        " them, or give them probability EPS.",
        rich_help_panel=INPUT,
    ),
]

TrialsOption = Annotated[
    str | None,
    typer.Option(
        "--trials",
        metavar="TRIALS",
        help="Whole runs of the policy in the target: 9/12 (succeeded), .csv or .json.",
        rich_help_panel=INPUT,
    ),
]

SuccessOption = Annotated[
    list[str] | None,
    typer.Option(
        "--success",
        metavar="STATE",
        help="State whose entering is success, repeatable: the value is its"
        " probability.",
        rich_help_panel=INPUT,
    ),
]

# ---- value

BoxOption = Annotated[
    str | None,
    typer.Option(
        "--box",
        metavar="LOWER,UPPER",
        help="Bounds on P_target / P, for example 0.5,2; either may be left out.",
        rich_help_panel=VALUE,
    ),
]

UnrecordedOption = Annotated[
    str | None,
    typer.Option(
        "--unrecorded",
        metavar="FACTOR",
        help="Factor by which pairs never recorded may differ from the estimate: 1 to"
        " inf; 3 by default.",
        rich_help_panel=VALUE,
    ),
]

IntervalSecondsOption = Annotated[
    float | None,
    typer.Option(
        "--interval-seconds",
        metavar="SECONDS",
        help="Time for a large problem's intervals; by default that of the rest, at"
        " least 30.",
        rich_help_panel=VALUE,
    ),
]

HorizonOption = Annotated[
    int | None,
    typer.Option(
        "--horizon",
        metavar="T",
        help="Number of rewards; without it, the infinite sum or the task's horizon.",
        rich_help_panel=VALUE,
    ),
]

DiscountOption = Annotated[
    float | None,
    typer.Option(
        "--discount",
        metavar="GAMMA",
        help="Discount, in place of the simulator's.",
        rich_help_panel=VALUE,
    ),
]

RewardsOption = Annotated[
    str,
    typer.Option(
        "--rewards",
        metavar="simulator|log",
        help="Whose rewards oee and model-based use: the simulator's or the log's.",
        rich_help_panel=VALUE,
    ),
]

ConfidenceOption = Annotated[
    float,
    typer.Option(
        "--confidence",
        metavar="LEVEL",
        help="Level of the intervals.",
        rich_help_panel=VALUE,
    ),
]

SeedOption = Annotated[
    int,
    typer.Option(
        "--seed",
        metavar="N",
        min=0,
        help="Random seed; the same seed gives the same numbers.",
        rich_help_panel=VALUE,
    ),
]

JobsOption = Annotated[
    int,
    typer.Option(
        "--jobs",
        metavar="N",
        help="Number of processes on this machine; -1 means one for each core.",
        rich_help_panel=VALUE,
    ),
]

DaskOption = Annotated[
    str | None,
    typer.Option(
        "--dask",
        metavar="ADDRESS",
        help="Address of a dask scheduler that runs the work instead.",
        rich_help_panel=VALUE,
    ),
]

# ---- output

OverwriteOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace a file that exists (a link or a Minari folder is never"
        " replaced).",
        rich_help_panel=OUTPUT,
    ),
]

OverwriteFolderOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace also files of the folder that the command did not write, or that"
        " changed since.",
        rich_help_panel=OUTPUT,
    ),
]

OverwriteReportOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace an existing `--report`, and files of the `--output` folder that"
        " changed or are not its own.",
        rich_help_panel=OUTPUT,
    ),
]

SlidesOption = Annotated[
    bool,
    typer.Option(
        "--slides",
        help="Draw the pictures for slides: 1920 x 1080 pixels, in large letters.",
        rich_help_panel=OUTPUT,
    ),
]

JsonOption = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print JSON instead of text.",
        rich_help_panel=OUTPUT,
    ),
]


def slides_if(is_given: bool) -> AbstractContextManager[None]:
    """Return the context in which pictures are slides if the option is given."""
    if not is_given:
        return nullcontext()
    # imports matplotlib, which the help does without
    from oee_tabular.plots import slides

    return slides()


def say(text: str, *, err: bool = False) -> None:
    """Print lines, with control characters of file and column names escaped.

    Letters that the stream's encoding lacks become look-alikes. If the reader of
    standard output is gone (``oee evaluate | head -1``), the command ends quietly. What
    standard error does not take is dropped, because the exit code says it as well.
    """
    # imports numpy, which the help does without
    from oee_tabular._checks import escape_controls

    shown = escape_controls(text, keep="\n")
    try:
        print_text(shown, sys.stderr if err else sys.stdout)
    except OSError as error:
        if err:
            return
        if not isinstance(error, BrokenPipeError):
            raise
        drop_rest(sys.stdout)
        sys.exit(2)


def drop_rest(stream: TextIO) -> None:
    """Drop what is left in the buffer of a stream that takes no more, as a full disk.

    Python writes it when it ends; if that fails, it makes 120 of the exit code.
    """
    with suppress(OSError):  # of a stream that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


remarks: list[str] = []  # lines that a command prints on stderr once it has succeeded


def remark(text: str) -> None:
    """Have a line printed on stderr once the command has succeeded."""
    remarks.append(f"oee: {text}")


def print_remarks() -> None:
    """Print the lines that were remarked, each of them once."""
    for line in dict.fromkeys(remarks):
        say(line, err=True)
    remarks.clear()


def print_result(text: str, record: Mapping[str, object], as_json: bool) -> None:
    """Print the text, or one JSON object on stdout alone.

    Its keys are ``details.JSON_KEYS``: keys may be added, none is renamed or taken
    away. Values are in the report's unit; what is not known is null. States and actions
    are named where the simulator has names.
    """
    if not as_json:
        say(text)
        return
    from oee_tabular import __version__
    from oee_tabular.report import plain

    content = plain({"version": __version__} | dict(record))
    say(json.dumps(content, indent=2, allow_nan=False))
