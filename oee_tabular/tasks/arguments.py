"""What the command line's words are made of: ``NAME=SPEC``, and a spec's arguments, ``10,slip=0.3``."""

from __future__ import annotations

import ast
from typing import Any


def named_specs(specs: list[str]) -> dict[str, str]:
    """Name -> SPEC from NAME=SPEC, or from SPEC, which is its own name."""
    found: dict[str, str] = {}
    for text in specs:
        name, equals, spec = text.partition("=")
        label, source = (name, spec) if equals else (text, text)
        if label in found:
            raise ValueError(f"--policy names must differ; {label!r} is given twice")
        found[label] = source
    return found


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
            keywords[key.strip()] = _literal(value.strip(), key.strip())
        else:
            positional.append(_literal(part.strip()))
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


def _literal(text: str, name: str = "an argument") -> Any:
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
