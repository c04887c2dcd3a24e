"""The options of the commands, in one table with their help, and how a command prints
its answer.

A line of a command's table is an option with its marks, the name of its value, two
spaces, and what it does. Marks: ``*`` may be repeated, ``!`` must be given, ``=0.95``
is the default. Tables name the options that they take from ``SHARED``.
"""

from __future__ import annotations

import functools
import inspect
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer

from oee_tabular.estimators.names import names

Options = SimpleNamespace  # what was given, by the names of the options
TEXTS = {
    "{SIMULATOR}": (
        "gridworld:10,slip=0.3 | a Gymnasium id with arguments,"
        " FrozenLake-v1:map_name=8x8,success_rate=0.6 | an .npz of a FiniteMDP | your"
        " own, module:Class or module:function,key=value (a FiniteMDP, or a Gymnasium"
        " environment with a table P), module:EnvId-v0 | a continuous task,"
        " cartpole:gravity=10, or a Gymnasium id with physics, Pendulum-v1:g=9 or"
        " module:EnvId-v0:key=value"
    ),
    "{POLICY}": (
        ".npy or .npz of an (S, A) array or of (S,) actions | .csv with columns state,"
        " action (and probability), or state and one for each action | MODULE:FUNCTION"
        " of a state | uniform | optimal | expert | mix:0.5 (half expert, half"
        " uniform); optimal and expert are the simulator's; expert is optimal where a"
        " task has none of its own; a continuous task has expert, uniform and mix,"
        " arrays of its cells, and MODULE:FUNCTION of its states"
    ),
    "{ESTIMATORS}": (
        f"{', '.join(names())}; with --target: {', '.join(names(needs_target=True))};"
        " fqe is model-based"
    ),
    "{TRANSITIONS}": (
        "file of the simulator's transitions, .csv (columns state, action, next_state,"
        " by number or name, ...) or .npy (S, A, S) or (entries,)"
    ),
}
SHARED = """
--simulator SIM  {SIMULATOR}.
--log* FILE  Log of the target, repeatable: .npz (a log, or its counts), .csv, .parquet, a pattern or a folder of them, a
    Minari folder or id.
--policy* NAME=SPEC  NAME=SPEC or SPEC, repeatable (none: optimal); SPEC: {POLICY}.
--initial STATE  First state, by name or number, in place of the simulator's.
--action-noise=0.0 EPS  Use simulator.with_action_noise(EPS), where it is too deterministic for the log.
--impossible=refuse refuse|drop|allow=EPS  What to do with transitions of the log that the simulator gives probability 0:
    refuse them; drop them, and let them lead anywhere in the intervals; or allow=EPS, use
    simulator.with_support_of(log, EPS).
--box LOWER,UPPER  Bounds on P_target / P (0.5,2); either may be left out. They narrow likelihood and guaranteed intervals.
--horizon T  Number of rewards; none: the infinite discounted sum, or a continuous task's own.
--discount GAMMA  Replaces the simulator's discount.
--rewards=simulator simulator|log  Rewards that oee and model-based use: the simulator's, or the log's mean where it has one.
--confidence=0.95 LEVEL  Level of the intervals.
--quick  Leave likelihood intervals out, which take most of the time of large problems.
--seed=0 N  Random seed; the same one gives the same numbers.
--jobs=1 N  Processes on this machine; -1: one for each core.
--dask ADDRESS  Address of a dask scheduler, to run the cells there.
--overwrite  Replace the file if it exists (a Minari folder: never).
"""
GROUPS = ("Input", "Value", "Output")
TYPES: dict[str, type] = {
    "N": int,
    "T": int,
    "EPS": float,
    "LEVEL": float,
    "GAMMA": float,
    "SECONDS": float,
    "FILE": Path,
    "FOLDER": Path,
}
# what the functions that the commands call name otherwise
ARGUMENTS = {
    "n": "transitions",
    "behavior_policy": "behavior",
    "lower_ratio and upper_ratio": "box",
    "shape": "grid",
}


LINE = re.compile(
    r"(?P<option>[\w/-]+)(?P<many>\*?)(?P<must>!?)(?:=(?P<default>\S+))?(?:"
    r" (?P<value>\S+))?(?:  (?P<help>.+))?"
)


def read_table(text: str) -> list[dict[str, str]]:
    """Read what the lines of a table say of each option, by the names of ``LINE``, and
    its group.
    """
    for placeholder, words in TEXTS.items():
        text = text.replace(placeholder, words)
    options = []
    group = ""
    for line in re.sub(r"\n +", " ", text).strip().splitlines():
        if line.rstrip(":") in GROUPS:
            group = line.rstrip(":")
            continue
        for declaration in [line] if "  " in line else line.split():
            match = LINE.fullmatch(declaration)
            assert match is not None, line
            options.append(
                {name: words for name, words in match.groupdict().items() if words}
                | {"group": group}
            )
    return options


def make_parameter(fields: Mapping[str, str]) -> inspect.Parameter:
    """The argument of a function from which typer makes an option."""
    option = fields["option"]
    value = fields.get("value", "")
    kind: Any = (
        list[str] if "many" in fields else TYPES.get(value, str) if value else bool
    )
    default: Any = None if value or "/" in option else False
    if "must" in fields:
        default = inspect.Parameter.empty
    elif "default" in fields:
        default = kind(fields["default"])
    name = option.split("/")[0].strip("-").replace("-", "_")
    about: Any = {
        "help": fields["help"],
        "metavar": value or None,
        "rich_help_panel": fields["group"],
    }
    made: Any = typer.Argument(**about)
    if option.startswith("-"):
        made = typer.Option(option, **about, min=0 if name == "seed" else None)
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[kind | None, made],
    )


def with_options(
    text: str,
) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Give a command the options of a table."""
    shared = {fields["option"]: fields for fields in read_table(SHARED)}
    table = [
        fields if "help" in fields else shared[fields["option"]] | fields
        for fields in read_table(text)
    ]

    def decorate(command: Callable[[Options], None]) -> Callable[..., None]:
        @functools.wraps(command)
        def run(**given: Any) -> None:
            command(Options(**given))

        run.__signature__ = inspect.Signature([*map(make_parameter, table)])  # type: ignore[attr-defined]
        return run

    return decorate


def say(text: str, *, err: bool = False) -> None:
    """Print lines in which no name of a file or of a column speaks to the terminal."""
    # numpy, which the help does without
    from oee_tabular._checks import escape_controls

    typer.echo(escape_controls(text, keep="\n"), err=err)


def answer(text: str, record: Mapping[str, object], as_json: bool) -> None:
    """Print the text, or one JSON object on stdout alone.

    Its keys stand in the help of ``--json``: keys may be added, none is renamed or
    taken away. Values are in the report's unit; what is not known is null. States and
    actions are named where the simulator has names.
    """
    if not as_json:
        say(text)
        return
    from oee_tabular import __version__
    from oee_tabular.report.files import plain

    typer.echo(
        json.dumps(
            plain({"version": __version__} | dict(record)), indent=2, allow_nan=False
        )
    )
