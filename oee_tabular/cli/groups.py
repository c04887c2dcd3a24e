"""Commands whose options are the fields of dataclasses.

typer makes an option of each argument of a function. A command with many options takes
them in groups instead: dataclasses whose fields are annotated as arguments would be.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Any, get_type_hints


def take_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Make a command with options of a function whose arguments are dataclasses.

    The options are the fields of all of them, in their order.
    """
    groups: dict[str, Any] = get_type_hints(command)
    groups.pop("return")
    parameters = []
    for group in groups.values():
        types = get_type_hints(group, include_extras=True)
        parameters += [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=types[field.name],
            )
            for field in fields(group)
        ]

    @functools.wraps(command)
    def run(**options: Any) -> None:
        """Fill the groups and run the command; options left out have their defaults."""
        given = {}
        for name, group in groups.items():
            own = [field.name for field in fields(group) if field.name in options]
            given[name] = group(**{option: options.pop(option) for option in own})
        if options:
            raise TypeError(f"{command.__name__} has no option {next(iter(options))!r}")
        command(**given)

    # what typer reads
    made: Any = run
    made.__signature__ = inspect.Signature(parameters)
    made.__annotations__ = {each.name: each.annotation for each in parameters}
    return run
