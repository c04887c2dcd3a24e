"""The labels of a log's columns, and words for a table that has others."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

from oee_tabular import _checks

MOVE = ("state", "action", "next_state")
COLUMNS = (*MOVE, "reward", "terminated", "truncated", "episode", "timestep", "behavior_probability")
N_SHOWN = 10  # of the columns that are left out
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}


def require_columns(name: str, required: Sequence[str], labels: Iterable[str], *, way: str = "") -> None:
    """ValueError where a required column is missing, with the separator or the spelling that was probably meant.

    ``way``: what else helps, where that cannot be said.
    """
    given = list(labels)
    if set(required) <= set(given):
        return
    shown = _checks.escape_controls(", ".join(given[:1000])[:300]) or "none"
    hint = suggest_columns(required, given) or f" (rename the columns that hold them{way})" * (
        len(given) >= len(required)
    )
    raise ValueError(f"{name} must have the columns {', '.join(required)}; it has {shown}{hint}")


def suggest_columns(required: Sequence[str], labels: Sequence[str]) -> str:
    """What is to be changed: the separator, or how a label is written; empty where that cannot be said."""
    for mark, word in SEPARATORS.items():
        if any(mark in label and set(_plain(label.split(mark))) & set(required) for label in labels[:1]):
            return f": its fields must be separated by commas; they are by {word}"
    written = {
        label: column
        for label, column in zip(labels, _plain(labels), strict=True)
        if column in required and column not in labels
    }
    return "".join(f"; write {column} for {_checks.show(label)}" for label, column in written.items())


def _plain(labels: Iterable[str]) -> list[str]:
    """Labels in lower case, with one underscore for what parts their words."""
    return ["_".join(label.strip(" \t\"'\ufeff").lower().replace("-", " ").split()) for label in labels]


def warn_left_out(name: str, unknown: Sequence[str], known: Sequence[str]) -> None:
    """Name the columns that are not read, the first of many, each with the known one that it resembles."""
    if not unknown:
        return
    named = [_checks.escape_controls(label[:80]) + suggest(label, known, likeness=0.8) for label in unknown[:N_SHOWN]]
    if len(unknown) > N_SHOWN:
        named.append(f"and {len(unknown) - N_SHOWN} more")
    _checks.warn(f"columns of {name!r} that a log does not know are left out: {', '.join(named)}")


def suggest(label: object, known: Sequence[str], *, quotes: bool = False, likeness: float = 0.6) -> str:
    """What was probably meant, in words; empty where nothing is near."""
    text = label if isinstance(label, str) else _checks.show(label)
    near = difflib.get_close_matches(text[:80], known, n=1, cutoff=likeness)
    return f" (did you mean {near[0]!r}?)" if near and quotes else f" (did you mean {near[0]}?)" if near else ""
