"""The words after ``oee``, in the order of the help, and their frame: groups of options, ``-h``, completion."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from oee_tabular.cli import files, studies, values
from oee_tabular.cli.options import ARGUMENTS, GROUPS


class Command(TyperCommand):
    """A command that refuses an option given twice, whose errors name its options, and whose help has them in groups."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As ever; ValueError for an option that takes one value and has several, of which all but the last would be lost."""
        _, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter, times in Counter(order).items():
            if times > 1 and not getattr(parameter, "multiple", False):
                raise ValueError(f"{parameter.opts[0]} must be given once; it is given {times} times")
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run it; an error that begins with the name of an argument begins with the option's instead."""
        try:
            return super().invoke(ctx)
        except ValueError as error:
            name, must, rule = str(error).partition(" must ")
            argument = ARGUMENTS.get(name, name)
            options = [p.opts[0] for p in self.params if p.name == argument and p.opts[0].startswith("-")]
            for parameter in self.params:  # --task-option and --plan-option
                if getattr(parameter, "metavar", None) == "NAME=VALUE":
                    given = ctx.params.get(parameter.name) or []
                    options += [f"{parameter.opts[0]} {argument}" for text in given if text.startswith(f"{argument}=")]
            if must and options:
                raise ValueError(f"{options[0]} must {rule}") from error
            raise

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """One list for each group."""
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in GROUPS}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is not None:
                groups.setdefault(getattr(parameter, "rich_help_panel", None) or "Options", []).append(record)
        for title in filter(groups.get, groups):  # which has no empty lists
            with formatter.section(title):
                formatter.write_dl(groups[title])


app = typer.Typer(
    help="What return will a policy get in the target, given a simulator and a log of the target?",
    epilog="Begin with: oee evaluate (an example), oee sample --help (a log), oee evaluate --help (your own files).",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (
    values.evaluate, values.compare, values.plan, files.sample, files.policy, files.export, files.counts, files.info,
    studies.reproduce, studies.bench, studies.check,
):  # fmt: skip
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
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Evaluate policies in a target environment, given a simulator and a log."""
