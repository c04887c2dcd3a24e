"""The words after ``oee``, in the order of the help."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from oee_tabular.cli import files, studies, values
from oee_tabular.cli.app import Grouped, app

__all__ = ["app"]

COMMANDS: dict[Callable[..., None], str] = {
    values.evaluate: "Value of policies in the target, with intervals.",
    values.compare: "Which of several policies is worth most, or that the log cannot say.",
    values.plan: "What to record next.",
    files.sample: "Record a log.",
    files.policy: "Write a policy of a simulator to a file.",
    files.export: "Write a simulator to a file.",
    files.counts: "Count the moves of a log of any size.",
    files.info: "Say what a file holds.",
    studies.reproduce: "The paper's figures, and more.",
    studies.bench: "Measure estimators where the truth is exact.",
    studies.check: "Check an estimator of yours against the laws.",
}
for command, short in COMMANDS.items():
    app.command(cls=Grouped, short_help=short)(command)


def _version(asked: bool) -> None:
    if asked:
        from oee_tabular import __version__

        typer.echo(f"oee {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Evaluate policies in a target environment, given a simulator and a log."""
