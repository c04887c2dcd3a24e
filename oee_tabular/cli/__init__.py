"""The command ``oee``: what is slow to import (numba, cvxpy, pandas) is imported where it is used."""

from __future__ import annotations

import atexit
import gc
import sys
import warnings

import typer

from oee_tabular import _progress
from oee_tabular.cli import commands
from oee_tabular.cli.options import say


def _tell(message: Warning | str, *_: object, **__: object) -> None:
    say(f"oee: warning: {message}", err=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the command; an error of the user's is one line on stderr and exit code 2."""
    atexit.register(gc.freeze)  # the interpreter's last collection, of all modules, would take .2 s
    warnings.showwarning = _tell
    _progress.tell = lambda sentence: typer.echo(f"oee: {sentence}", err=True)
    try:
        with _progress.show_steps():
            commands.app(arguments, standalone_mode=True)
    except (ValueError, OSError, ImportError, RuntimeError, MemoryError) as error:
        say(f"oee: {_sentence(error)}", err=True)
        sys.exit(2)


def _sentence(error: Exception) -> str:
    if isinstance(error, MemoryError):
        words = str(error).replace("Unable to allocate", "this needs", 1)
        return f"not enough memory; {words or 'this needs more than there is'}"
    if isinstance(error, OSError) and not isinstance(error, FileNotFoundError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, FileNotFoundError) and error.filename:
        return f"{'no such folder' if error.strerror == 'no such folder' else 'no such file'}: {error.filename}"
    return str(error)
