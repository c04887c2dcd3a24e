"""The command ``oee``: its subcommands, their help and their errors.

What is slow to import (numba, cvxpy, pandas) is imported where it is used.
"""

from __future__ import annotations

import atexit
import gc
import os
import sys
import warnings
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperCommand, TyperGroup

from oee_tabular import _progress
from oee_tabular._memory import require_room
from oee_tabular._printing import read_epoch
from oee_tabular.cli import files, improving, values
from oee_tabular.cli.details import IN_TERMINAL, details_of, to_markdown
from oee_tabular.cli.options import (
    ARGUMENTS,
    GROUPS,
    drop_rest,
    print_remarks,
    remarks,
    say,
)
from oee_tabular.exceptions import ArgumentError

THREADS = "NUMBA_NUM_THREADS"  # the variable with the number of numba's threads


def _as_terminal_text(markdown: str) -> str:
    """Leave out the backticks that the site's page needs."""
    return markdown.replace("`", "")


class Command(TyperCommand):
    """A command whose options are given once, and whose errors name its options.

    Its help has the options in groups. The epilog, which the site's page of commands
    shows, has the details of the values; the terminal shows some of them.
    """

    def __init__(self, name: str | None, **options: Any) -> None:
        super().__init__(name, **options)
        self.epilog = to_markdown(name or "", self.params)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words, and refuse a second value of an option that takes one.

        Without this check, the first value would be lost. Files that follow that of
        --log are those of a pattern that the shell has replaced.
        """
        texts, rest, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter, times in Counter(order).items():
            if times > 1 and not getattr(parameter, "multiple", False):
                _refuse_again(parameter, times, args)
        has_log = any("--log" in parameter.opts for parameter in order)
        if has_log and rest and all(Path(word).exists() for word in rest):
            pattern = Path(rest[0]).with_name(f"*{Path(rest[0]).suffix}")
            raise ArgumentError(
                "--log",
                f"must stand before each file; before {rest[0]!r} it does not (quote a"
                f" pattern: --log '{pattern}')",
            )
        try:
            rest = super().parse_args(ctx, args)
        except typer.BadParameter as error:
            _add_value(error, texts)
            raise
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            # which is the current folder to pathlib
            if isinstance(value, Path) and texts.get(parameter.name) == "":
                raise ArgumentError(
                    parameter.opts[0], "must name a file or a folder; it is ''"
                )
        return rest

    def invoke(self, ctx: Any) -> Any:
        """Run the command; in an error, an argument gets the name of its option."""
        require_room()
        _require_variables()
        remarks.clear()
        try:
            result = super().invoke(ctx)
            print_remarks()
            return result
        except typer.Exit:
            print_remarks()
            raise
        except KeyboardInterrupt:
            _say_finished()
            raise
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
        """Write one list of options for each group."""
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in GROUPS}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                option, text = record
                title = getattr(parameter, "rich_help_panel", None) or "Options"
                groups.setdefault(title, []).append((option, _as_terminal_text(text)))
        for title, rows in groups.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the values that most calls need, in place of the whole epilog."""
        for title, forms in details_of(self.name or "", self.params).items():
            if title in IN_TERMINAL:
                rows = [(form, _as_terminal_text(text)) for form, text in forms.items()]
                with formatter.section(f"Values of {title}"):
                    formatter.write_dl(rows)


def _require_variables() -> None:
    """Refuse variables of the environment that libraries cannot read.

    numpy reads the date, and numba the number, while they are imported.
    """
    read_epoch()
    text = os.environ.get(THREADS, "1")
    try:
        is_positive = int(text) > 0
    except ValueError:
        is_positive = not text  # numba takes its default
    if not is_positive:
        raise ArgumentError(
            THREADS,
            f"must be a positive integer; it is {text[:100]!r} (a variable of the"
            " environment)",
        )


def _refuse_again(parameter: Any, times: int, args: list[str]) -> NoReturn:
    """Raise an ArgumentError for an option that is given several times.

    Both words of a pair like --normalized/--raw are one option.
    """
    words = (*parameter.opts, *parameter.secondary_opts)
    given = [word for word in words if word in args] or words
    if len(given) > 1 and parameter.secondary_opts:
        raise ArgumentError(
            given[0], f"must be left out with {given[1]}: the two exclude each other"
        )
    raise ArgumentError(given[0], f"must be given once; it is given {times} times")


def _add_value(error: typer.BadParameter, texts: dict[str, Any]) -> None:
    """Add to an error of typer the value that was given, where it has none."""
    # imports numpy, which the help does without
    from oee_tabular._checks import show

    name = None if error.param is None else error.param.name
    text = texts.get(name or "")
    if text is not None and show(text) not in error.message:
        error.message = f"{error.message}; it is {show(text)}"


class Group(TyperGroup):
    """The command ``oee`` itself, whose epilog has commands in backticks."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the epilog as text of a terminal."""
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(_as_terminal_text(self.epilog or ""))


app = typer.Typer(
    cls=Group,
    help=(
        "What return will a policy get in the target, given a simulator and a log of"
        " the target?"
    ),
    epilog=(
        "Begin with: `oee evaluate` (an example), `oee sample --help` (a log),"
        " `oee evaluate --help` (your own files)."
    ),
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (
    values.evaluate,
    values.compare,
    improving.improve,
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
    """Print the version and end the command."""
    if is_asked:
        from oee_tabular import __version__

        say(f"oee {__version__}")
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


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning as one line on stderr."""
    say(f"oee: warning: {message}", err=True)


def _show_step(sentence: str) -> None:
    """Print on stderr what is being done."""
    say(f"oee: {sentence}", err=True)


def _say_finished() -> None:
    """Print on stderr what an interrupted command has finished."""
    say("oee: interrupted", err=True)
    if _progress.finished:
        say("\n".join(["Finished so far:", *_progress.finished]), err=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the command; a user's error is one line on stderr and exit code 2."""
    if sys.stdout is None or getattr(sys.stdout, "closed", False):
        say(
            "oee: standard output is closed, so nothing can be shown (send it to a"
            " file: > result.txt)",
            err=True,
        )
        sys.exit(2)
    # the last garbage collection of the interpreter would take 0.2 s
    atexit.register(gc.freeze)
    warnings.showwarning = _show_warning
    _progress.tell = _show_step
    try:
        with _progress.show_steps():
            app(arguments, standalone_mode=True)
    except (ValueError, OSError, ImportError, RuntimeError, MemoryError) as error:
        say(f"oee: {_sentence(error)}", err=True)
        _flush(sys.stdout)
        sys.exit(2)
    finally:
        _flush(sys.stderr)


def _flush(stream: TextIO) -> None:
    """Write what is left for a stream, or drop what it does not take."""
    try:
        stream.flush()
    except OSError:
        drop_rest(stream)
    except (AttributeError, ValueError):  # there is none, or it is closed
        pass


def _sentence(error: Exception) -> str:
    """Return the message of an error as a user reads it."""
    if isinstance(error, MemoryError):
        words = str(error).replace("Unable to allocate", "this needs", 1)
        return f"not enough memory; {words or 'this needs more than there is'}"
    if isinstance(error, FileNotFoundError) and _is_in_removed_folder(error.filename):
        return "the current folder was removed (change to another one)"
    if isinstance(error, FileNotFoundError) and error.filename:
        kind = "folder" if error.strerror == "no such folder" else "file"
        return f"no such {kind}: {error.filename}"
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    # an error without a file name comes from standard output
    if isinstance(error, OSError) and error.strerror:
        return f"the output cannot be written ({error.strerror})"
    return str(error)


def _is_in_removed_folder(path: Any) -> bool:
    """Return whether a path, or None, is not found as the current folder is gone."""
    if path is not None and os.path.isabs(path):
        return False
    try:
        os.getcwd()
    except OSError:
        return True
    return False
