"""The command's frame: its groups of options, ``-h``, completion."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand

NAMES = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class Grouped(TyperCommand):
    """A command whose help has its options in groups, by ``rich_help_panel``: those of typer's need boxes."""

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
