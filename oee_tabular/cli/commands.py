"""The words after ``oee``, in the order of the help, and their frame: groups of options, ``-h``, completion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from oee_tabular.cli import files, studies, values

NAMES = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class Command(TyperCommand):
    """A command that refuses an option given twice, and whose help has options in groups, by ``rich_help_panel``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As ever; ValueError for an option that takes one value and has several, of which all but the last would be lost."""
        _, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter, times in Counter(order).items():
            if times > 1 and not getattr(parameter, "multiple", False):
                raise ValueError(f"{parameter.opts[0]} must be given once; it is given {times} times")
        rest: list[str] = super().parse_args(ctx, args)
        return rest

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """One list a group, in the order of the first of each."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is not None:
                positional = parameter.param_type_name == "argument"
                title = getattr(parameter, "rich_help_panel", None) or ("Arguments" if positional else "Options")
                groups.setdefault(title, []).append(record)
        for title, records in groups.items():
            with formatter.section(title):
                formatter.write_dl(records)


app = typer.Typer(
    help="What return will a policy get in the target, given a simulator and a log of the target?",
    epilog="Begin with: oee evaluate (an example), oee sample --help (a log), oee evaluate --help (your own files).",
    no_args_is_help=True,
    context_settings=NAMES,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


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
    app.command(cls=Command, short_help=short)(command)


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
