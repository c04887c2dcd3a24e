"""The options of the commands with their help, and how a command prints its answer.

A command is a function. Its options are the function's arguments, and their help stands in groups above it, or in ``SHARED``
where several commands have one: an option, the name of its value, two spaces, and what it does.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar

import typer

from oee_tabular.estimators.names import names

Function = TypeVar("Function", bound=Callable[..., None])
TEXTS = {
    "{SIMULATOR}": "gridworld:10,slip=0.3 | a Gymnasium id with arguments, FrozenLake-v1:map_name=8x8,success_rate=0.6 | "
    "an .npz of a FiniteMDP | your own, module:Class or module:function,key=value (a FiniteMDP, or a Gymnasium environment "
    "with a table P), module:EnvId-v0 | a continuous task, cartpole:gravity=10, or a Gymnasium id with physics, "
    "Pendulum-v1:g=9 or module:EnvId-v0:key=value",
    "{POLICY}": ".npy or .npz of an (S, A) array or of (S,) actions | .csv with columns state, action (and probability), or "
    "state and one for each action | MODULE:FUNCTION of a state | uniform | optimal | expert | mix:0.5 (half expert, half "
    "uniform); optimal and expert are the simulator's; expert is optimal where a task has none of its own; a continuous task "
    "has expert, uniform and mix, arrays of its cells, and MODULE:FUNCTION of its states",
    "{ESTIMATORS}": f"{', '.join(names())}; with --target: {', '.join(names(needs_target=True))}; fqe is model-based",
    "{TRANSITIONS}": "file of the simulator's transitions, .csv (columns state, action, next_state, by number or name, ...) "
    "or .npy (S, A, S) or (entries,)",
}
SHARED = """
Input:
--simulator SIM  {SIMULATOR}.
--log FILE  Log of the target, repeatable: .npz (a log, or its counts), .csv, .parquet, a pattern or a folder of them, a
    Minari folder or id.
--policy NAME=SPEC  NAME=SPEC or SPEC, repeatable (none: optimal); SPEC: {POLICY}.
--initial STATE  First state, by name or number, in place of the simulator's.
--action-noise EPS  Use simulator.with_action_noise(EPS), where it is too deterministic for the log.
--impossible refuse|drop|allow=EPS  What to do with transitions of the log that the simulator gives probability 0: refuse them;
    drop them, and let them lead anywhere in the intervals; or allow=EPS, use simulator.with_support_of(log, EPS).

Value:
--box LOWER,UPPER  Bounds on P_target / P (0.5,2); either may be left out. They narrow every interval.
--horizon T  Number of rewards; none: the infinite discounted sum, or a continuous task's own.
--discount GAMMA  Replaces the simulator's discount.
--rewards simulator|log  Rewards of model-based values.
--confidence LEVEL  Level of the intervals.
--quick  Leave likelihood intervals out, which take most of the time of large problems.
--seed N  The same seed gives the same bits.
--jobs N  Processes on this machine; -1: one for each core.
--dask ADDRESS  Address of a dask scheduler, to run the cells there.

Output:
--overwrite  Replace the file if it exists (a Minari folder: never).
"""
GROUPS = ("Input", "Value", "Output")
# what the functions that the commands call name otherwise
ARGUMENTS = {"n": "transitions", "behavior_policy": "behavior", "lower_ratio and upper_ratio": "box", "shape": "grid"}


def read_help(text: str) -> dict[str, tuple[str, dict[str, Any]]]:
    """The option, and what typer is told of it, by the name of its argument."""
    found, group = {}, ""
    for line in re.sub(r"\n +", " ", text).splitlines():
        if line.rstrip(":") in GROUPS:
            group = line.rstrip(":")
        elif line:
            declaration, _, words = line.partition("  ")
            option, _, value = declaration.partition(" ")
            for placeholder, long in TEXTS.items():
                words = words.replace(placeholder, long)
            name = option.split("/")[0].strip("-").replace("-", "_")
            found[name] = option, {"help": words, "metavar": value or None, "rich_help_panel": group}
    return found


def with_options(text: str) -> Callable[[Function], Function]:
    """Annotate a command's arguments as typer takes them, with their help in ``text`` or ``SHARED``."""

    def annotate(command: Function) -> Function:
        known = read_help(SHARED) | read_help(text)
        for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
            option, info = known[name.rstrip("_")]
            made: Any = typer.Argument(**info)
            if option.startswith("-"):
                is_shown = parameter.default is not None
                made = typer.Option(option, **info, show_default=is_shown, min=0 if name == "seed" else None)
            command.__annotations__[name] = Annotated[parameter.annotation, made]
        return command

    return annotate


def say(text: str, *, err: bool = False) -> None:
    """Print lines in which no name of a file or of a column speaks to the terminal."""
    from oee_tabular._checks import escape_controls  # numpy, which the help does without

    typer.echo(escape_controls(text, keep="\n"), err=err)


def answer(text: str, record: Mapping[str, object], as_json: bool) -> None:
    """Print the text, or one JSON object on stdout alone.

    Its keys stand in the help of ``--json``: keys may be added, none is renamed or taken away. Values are in the report's unit;
    what is not known is null. States and actions are named where the simulator has names.
    """
    if not as_json:
        say(text)
        return
    from oee_tabular import __version__
    from oee_tabular.report.results import plain

    typer.echo(json.dumps(plain({"version": __version__} | dict(record)), indent=2, allow_nan=False))
