"""Options that several commands have, each in its group of the help, and what commands print.

That is sentences, or with ``--json`` one object whose keys stay (``SHAPES``), on stdout alone. Values are in the report's unit;
what is not known is null. States and actions are named where the simulator has names. Keys may be added, none is renamed or
taken away.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from oee_tabular.cli.simulators import POLICY_HELP, SIMULATOR_HELP

SHAPES: Mapping[str, Mapping[str, str]] = {
    "evaluate": {
        "version": "of oee_tabular", "answer": "in sentences", "unit": "what a value is",
        "discount": "", "horizon": "", "normalized": "",
        "confidence": "of the intervals", "interval": "what each kind of interval is", "seed": "", "facts": "inputs",
        "results": "a row each policy and estimator: value, standard_error, lower, upper, sampling_lower, sampling_upper, "
        "interval_method, notes, ...",
        "intervals": "a row each policy and method: lower, upper, sampling_lower, sampling_upper, confidence, status",
        "best": "a policy, null where the log cannot say",
        "comparison": "a row each policy, best first: probability_best, less_by, less_by_lower, less_by_upper, ...",
        "conclusion": "sentences", "warnings": "sentences to read before use",
    },
    "compare": {
        "version": "of oee_tabular", "confidence": "of the intervals", "best": "a policy, null where the log cannot say",
        "sentence": "the answer", "policies": "a row each, best first: value, lower, upper, probability_best, unseen_share",
        "differences": "a row each from the best: policy, than, difference, lower, upper", "warnings": "sentences",
    },
    "plan": {
        "version": "of oee_tabular", "sampling": "free or behavior", "n": "moves to record", "confidence": "of the widths",
        "status": "ok, or what is wrong", "gap": "at most so far from the best plan",
        "policies": "a row each: standard_error and width, now and after; inefficiency",
        "most": "a row each (state, action) with the largest shares: state, action, share",
        "advice": "the sentence on what would help most",
        "next": "rows: state, action to record next", "file": "that was written, or null",
    },
    "sample": {"version": "of oee_tabular", "file": "", "transitions": "how many", "episodes": "how many, or null"},
    "policy": {"version": "of oee_tabular", "file": "", "states": "how many", "actions": "how many"},
    "export": {
        "version": "of oee_tabular", "file": "", "states": "how many", "actions": "how many", "transitions": "how many",
        "discount": "",
    },
    "counts": {"version": "of oee_tabular", "file": "", "moves": "how many", "dropped": "sentences on rows left out"},
    "info": {"version": "of oee_tabular", "file": "", "kind": "what it holds", "text": "lines that say what"},
    "reproduce": {"version": "of oee_tabular", "lines": "what was run, or what there is"},
    "bench": {"version": "of oee_tabular", "lines": "the league"},
    "check": {
        "version": "of oee_tabular", "estimator": "", "passed": "whether all laws hold that are owed or claimed", "seed": "",
        "laws": "a row each: law, outcome, text, example",
    },
}  # fmt: skip


def shape_help(command: str) -> str:
    """The help of ``--json``."""
    return f"Print JSON instead, with {', '.join(SHAPES[command])}."


def say(text: str, *, err: bool = False) -> None:
    """Print lines in which no name of a file or of a column speaks to the terminal."""
    from oee_tabular._checks import escape_controls  # numpy, which the help does without

    typer.echo(escape_controls(text, keep="\n"), err=err)


def answer(command: str, text: str, record: Mapping[str, object], as_json: bool) -> None:
    """Print one or the other."""
    if not as_json:
        say(text)
        return
    from oee_tabular import __version__
    from oee_tabular.report.results import plain

    whole = {"version": __version__} | dict(record)
    assert set(whole) >= set(SHAPES[command]), f"the shape of {command}"
    typer.echo(json.dumps(plain(whole), indent=2, allow_nan=False))


INPUT, VALUE, OUTPUT, CONTINUOUS = "Input", "Value", "Output", "Continuous tasks"


def option(group: str, text: str, *names: str, metavar: str | None = None, **more: Any) -> Any:
    """An option of a group of the help."""
    return typer.Option(*names, help=text, metavar=metavar, rich_help_panel=group, **more)


def json_option(command: str) -> Any:
    """``--json`` of a command."""
    return option(OUTPUT, shape_help(command), "--json")


Simulator = Annotated[str, typer.Argument(help=f"{SIMULATOR_HELP}.", metavar="SIM")]
SimulatorOption = Annotated[str, option(INPUT, f"{SIMULATOR_HELP}.", metavar="SIM")]
LOG_HELP = (
    "Log of the target, repeatable: .npz (a log, or its counts), .csv, .parquet, a pattern or a folder of them, a Minari "
    "folder or id."
)
Log = Annotated[list[str], option(INPUT, LOG_HELP, metavar="FILE")]
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
Box = Annotated[
    str | None,
    option(VALUE, "Bounds on P_target / P: LOWER,UPPER (0.5,2); they narrow every interval.", metavar="LOWER,UPPER"),
]
Confidence = Annotated[float, option(VALUE, "Level of the intervals.", metavar="LEVEL")]
Quick = Annotated[bool, option(VALUE, "Leave likelihood intervals out, most of the time of large problems.", "--quick")]
Seed = Annotated[int, option(VALUE, "The same seed gives the same bits.", metavar="N", min=0)]
Overwrite = Annotated[bool, option(OUTPUT, "Replace the file if it exists (a Minari folder: never).", "--overwrite")]
Jobs = Annotated[int, option(VALUE, "Processes on this machine; -1: one a core.", metavar="N")]
Dask = Annotated[str | None, option(VALUE, "Address of a dask scheduler, to run the cells there.", metavar="ADDRESS")]
Grid = Annotated[
    str | None,
    option(
        CONTINUOUS,
        "Vertices along each feature of a continuous task, 60x60, or none; left out: the task's own (cartpole: 32x32).",
        metavar="NxM",
    ),
]
Outside = Annotated[
    str | None,
    option(
        CONTINUOUS,
        "A continuous log's states outside the grid: error (default), drop (and any moves without support) or nearest.",
        metavar="WORD",
    ),
]
Strict = Annotated[
    bool,
    option(
        CONTINUOUS,
        "An error, not a warning, for actions of a continuous log that are not in the task's set.",
        "--strict",
    ),
]
Calibration = Annotated[
    str | None,
    option(
        CONTINUOUS,
        "Of a continuous task's values: ratio, difference or none; none given: the task's own.",
        metavar="WORD",
    ),
]
Floor = Annotated[
    float | None,
    option(
        CONTINUOUS, "Share of other steps in a continuous simulator (defensive); none: the task's own.", metavar="SHARE"
    ),
]
Simulations = Annotated[
    int | None,
    option(
        CONTINUOUS,
        "Monte Carlo episodes of each policy in a continuous simulator; none: the task's own (cartpole: 50000).",
        metavar="N",
    ),
]
State = Annotated[
    str | None,
    option(
        CONTINUOUS,
        "MODULE:GET,SET, functions get(env) and set(env, state) of a Gymnasium environment whose state is not found.",
        metavar="MODULE:GET,SET",
    ),
]
Actions = Annotated[
    str | None,
    option(
        CONTINUOUS,
        "Of a Gymnasium environment with a Box of actions: levels of each coordinate (9, or -2,0,2), or the commands.",
        metavar="LEVELS",
    ),
]
