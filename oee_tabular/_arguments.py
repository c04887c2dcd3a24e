"""What the command line's words are made of: ``NAME=SPEC``, a spec's arguments,
``10,slip=0.3``, and ``MODULE:OBJECT``.
"""

from __future__ import annotations

import ast
import difflib
import importlib
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError


def named_specs(
    given: list[str], option: str = "--policy", known: Sequence[str] = ()
) -> dict[str, str]:
    """Name -> SPEC from NAME=SPEC, or from SPEC, which is its own name.

    ``known``: the names there are, where there are no others; each then needs its
    value.
    """
    specs: dict[str, str] = {}
    for text in given:
        name, equals, spec = text.partition("=")
        if known and (not equals or name not in known):
            near = difflib.get_close_matches(name, known, n=1)
            hint = f" (did you mean {near[0]}=VALUE?)" if near else ""
            raise ArgumentError(
                option,
                f"must be NAME=VALUE, NAME one of {', '.join(known)}; got"
                f" {text!r}{hint}",
            )
        if equals and not name:
            raise ArgumentError(
                option, f"must have a name before its '='; got {text!r}"
            )
        if name in specs:
            raise ValueError(f"{option} names must differ; {name!r} is given twice")
        specs[name] = spec if equals else text
    return specs


def parse_spec(spec: str) -> tuple[str, dict[str, Any]]:
    """The name and the keywords of "NAME:key=value,..."; ValueError where a value has
    no key.

    >>> parse_spec("cartpole:gravity=10,form=full")
    ('cartpole', {'gravity': 10, 'form': 'full'})
    """
    name, _, rest = spec.partition(":")
    positional, keywords = arguments(rest)
    if positional:
        raise ValueError(
            f"simulator {spec!r} must give its arguments as key=value; found"
            f" {positional[0]!r}"
        )
    return name, keywords


def arguments(text: str) -> tuple[list[Any], dict[str, Any]]:
    """Positional values and keywords; values are Python literals or words.

    >>> arguments("10,slip=0.3,pay=next,desc=['SF','FG']")
    ([10], {'slip': 0.3, 'pay': 'next', 'desc': ['SF', 'FG']})
    """
    positional: list[object] = []
    keywords: dict[str, object] = {}
    for part in _split(text):
        key, equals, value = part.partition("=")
        if equals and key.strip().isidentifier():
            if key.strip() in keywords:
                raise ArgumentError(
                    key.strip(), f"must be given once; {text!r} has it twice"
                )
            keywords[key.strip()] = literal(value.strip(), key.strip())
        else:
            positional.append(literal(part.strip()))
    return positional, keywords


def _split(text: str) -> list[str]:
    """At commas that stand outside brackets and quotes."""
    parts = []
    depth = 0
    quote = ""
    current = ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        else:
            depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0 and not quote:
            parts.append(current)
            current = ""
        else:
            current += letter
    return [part for part in [*parts, current] if part.strip()]


def literal(text: str, name: str = "an argument") -> Any:
    """A Python literal, true, false, none, a fraction, or else the word itself."""
    lowered = {"true": True, "false": False, "none": None}
    if text.lower() in lowered:
        return lowered[text.lower()]
    if "/" in text and all(part.strip().isdigit() for part in text.split("/", 1)):
        top, bottom = text.split("/", 1)
        if int(bottom) == 0:
            raise ArgumentError(name, f"must be a finite number; {text!r} divides by 0")
        return int(top) / int(bottom)
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text


@contextmanager
def own_modules() -> Iterator[None]:
    """Modules of the current directory can be imported, as those that are installed."""
    folder = os.getcwd()
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def module_and_path(spec: str, what: str, example: str) -> tuple[str, str]:
    """The two parts of "module:object"; nothing is imported."""
    module_name, colon, path = spec.partition(":")
    if not (colon and module_name and path):
        raise ArgumentError(
            what, f"must be given as MODULE:OBJECT, {example}; got {_checks.show(spec)}"
        )
    if module_name.endswith(".py") or os.sep in module_name:
        hint = module_name.removesuffix(".py").replace(os.sep, ".").strip(".")
        raise ArgumentError(
            "MODULE",
            f"must be a module's name, not a file's; got {_checks.show(module_name)}"
            f" (try {hint}:{path})",
        )
    return module_name, path


def own_object(spec: str, what: str, example: str) -> Any:
    """The object of "module:object"; errors call it ``what`` and give an ``example`` of
    the form.
    """
    module_name, path = module_and_path(spec, what, example)
    result: object = own_module(module_name)
    for name in path.split("."):
        if not hasattr(result, name):
            public = [
                key
                for key, value in vars(result).items()
                if callable(value) and not key.startswith("_")
            ]
            known = f" (it has {', '.join(sorted(public)[:8])})" if public else ""
            raise ValueError(f"{module_name!r} has no object {path!r}{known}")
        result = getattr(result, name)
    return result


def own_module(module_name: str) -> ModuleType:
    """The module of that name, imported; a ValueError where that fails."""
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (
            module_name == error.name or module_name.startswith(f"{error.name}.")
        ):
            raise ValueError(
                f"module {module_name!r} cannot be found, neither in {os.getcwd()} nor"
                " installed"
            ) from None
        raise ValueError(
            f"module {module_name!r} cannot be imported: {type(error).__name__}:"
            f" {error}"
        ) from error
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"module {module_name!r} cannot be imported: {type(error).__name__}:"
            f" {error}"
        ) from error
