"""The command ``oee``: its commands, in the order of the help, and their frame.

What is slow to import (numba, cvxpy, pandas) is imported where it is used.
"""

from __future__ import annotations

import atexit
import gc
import sys
import warnings
from collections import Counter
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from oee_tabular import _progress
from oee_tabular.cli import files, values
from oee_tabular.cli.options import ARGUMENTS, GROUPS, say
from oee_tabular.exceptions import ArgumentError


class Command(TyperCommand):
    """A command that refuses an option given twice, whose errors name its options, and
    whose help has them in groups.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the words; refuse a second value of an option that takes one, of which
        the first would be lost.
        """
        _, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter, times in Counter(order).items():
            if times > 1 and not getattr(parameter, "multiple", False):
                raise ArgumentError(
                    parameter.opts[0], f"must be given once; it is given {times} times"
                )
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; an error that begins with the name of an argument begins
        with the option's instead.
        """
        try:
            return super().invoke(ctx)
        except ArgumentError as error:
            argument = ARGUMENTS.get(error.argument, error.argument)
            options = {
                p.name: p.opts[0] for p in self.params if p.opts[0].startswith("-")
            }
            for option in ("task_option", "plan_option"):
                named = [
                    text.partition("=")[0] for text in ctx.params.get(option) or []
                ]
                options |= {name: f"{options[option]} {name}" for name in named}
            if argument in options:
                raise ArgumentError(options[argument], error.rule) from error
            raise

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write one list for each group."""
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in GROUPS}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is not None:
                groups.setdefault(
                    getattr(parameter, "rich_help_panel", None) or "Options", []
                ).append(record)
        for title in filter(groups.get, groups):  # which has no empty lists
            with formatter.section(title):
                formatter.write_dl(groups[title])


app = typer.Typer(
    help=(
        "What return will a policy get in the target, given a simulator and a log of"
        " the target?"
    ),
    epilog=(
        "Begin with: oee evaluate (an example), oee sample --help (a log), oee evaluate"
        " --help (your own files)."
    ),
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (
    values.evaluate,
    values.compare,
    values.plan,
    files.sample,
    files.policy,
    files.export,
    files.counts,
    files.info,
    values.reproduce,
    values.bench,
    values.check,
):
    app.command(cls=Command)(command)


def print_version(is_asked: bool) -> None:
    """Print the version and end."""
    if is_asked:
        from oee_tabular import __version__

        typer.echo(f"oee {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=print_version,
            is_eager=True,
            help="Print the version.",
        ),
    ] = False,
) -> None:
    """Evaluate policies in a target environment, given a simulator and a log."""


def _tell(message: Warning | str, *_: object, **__: object) -> None:
    say(f"oee: warning: {message}", err=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the command; an error of the user's is one line on stderr and exit code 2."""
    # the interpreter's last collection, of all modules, would take .2 s
    atexit.register(gc.freeze)
    warnings.showwarning = _tell
    _progress.tell = lambda sentence: typer.echo(f"oee: {sentence}", err=True)
    try:
        with _progress.show_steps():
            app(arguments, standalone_mode=True)
    except (ValueError, OSError, ImportError, RuntimeError, MemoryError) as error:
        say(f"oee: {_sentence(error)}", err=True)
        sys.exit(2)


def _sentence(error: Exception) -> str:
    if isinstance(error, MemoryError):
        words = str(error).replace("Unable to allocate", "this needs", 1)
        return f"not enough memory; {words or 'this needs more than there is'}"
    if isinstance(error, FileNotFoundError) and error.filename:
        return (
            f"no such {'folder' if error.strerror == 'no such folder' else 'file'}:"
            f" {error.filename}"
        )
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    # of no file that we opened: standard output
    if isinstance(error, OSError) and error.strerror:
        return f"the output cannot be written ({error.strerror})"
    return str(error)
