"""What the command line's words are made of: ``NAME=SPEC``, and a spec's arguments, ``10,slip=0.3``."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Sequence
from typing import Any


def named_specs(given: list[str], option: str = "--policy", known: Sequence[str] = ()) -> dict[str, str]:
    """Name -> SPEC from NAME=SPEC, or from SPEC, which is its own name.

    ``known``: the names there are, where there are no others; each then needs its value.
    """
    specs: dict[str, str] = {}
    for text in given:
        name, equals, spec = text.partition("=")
        if known and (not equals or name not in known):
            near = difflib.get_close_matches(name, known, n=1)
            hint = f" (did you mean {near[0]}=VALUE?)" if near else ""
            raise ValueError(f"{option} must be NAME=VALUE, NAME one of {', '.join(known)}; got {text!r}{hint}")
        if equals and not name:
            raise ValueError(f"{option} must have a name before its '='; got {text!r}")
        if name in specs:
            raise ValueError(f"{option} names must differ; {name!r} is given twice")
        specs[name] = spec if equals else text
    return specs


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
                raise ValueError(f"{key.strip()} must be given once; {text!r} has it twice")
            keywords[key.strip()] = literal(value.strip(), key.strip())
        else:
            positional.append(literal(part.strip()))
    return positional, keywords


def _split(text: str) -> list[str]:
    """At commas that stand outside brackets and quotes."""
    parts, depth, quote, current = [], 0, "", ""
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
            raise ValueError(f"{name} must be a finite number; {text!r} divides by 0")
        return int(top) / int(bottom)
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text
