"""The labels of a log's columns, words for a table that has others, and a log in one line."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

from oee_tabular import _checks
from oee_tabular.mdp.naming import Name

MOVE = ("state", "action", "next_state")
KEY = (*MOVE, "terminated")  # of sums
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
    """Warn of columns that are not read, each with the known one that it resembles."""
    if not unknown:
        return
    named = [_checks.escape_controls(label[:80]) + suggest(label, known, likeness=0.8) for label in unknown[:N_SHOWN]]
    if len(unknown) > N_SHOWN:
        named.append(f"and {len(unknown) - N_SHOWN} more")
    _checks.warn(f"columns of {name!r} that a log does not use are left out: {', '.join(named)}")


def suggest(label: object, known: Sequence[str], *, quotes: bool = False, likeness: float = 0.6) -> str:
    """What was probably meant, in words; empty where nothing is near."""
    text = label if isinstance(label, str) else _checks.show(label)
    near = difflib.get_close_matches(text[:80], known, n=1, cutoff=likeness)
    return f" (did you mean {near[0]!r}?)" if near and quotes else f" (did you mean {near[0]}?)" if near else ""


def describe_facts(facts: dict[str, Any], **names: tuple[Name, ...] | None) -> str:
    """A log's summary in one line; ``names``: of its states and actions, where they have names."""
    text = f"{facts['transitions']} transitions"
    if facts.get("different"):
        text += f", {facts['different']} different"
    if facts.get("files"):
        text += f", of {facts['files']} file{'s' * (facts['files'] > 1)}"
    if facts["episodes"]:
        n, shortest, longest = (facts[name] for name in ("episodes", "episode_length_min", "episode_length_max"))
        steps = f"{shortest} to {longest} steps" if shortest < longest else f"{longest} step{'s' * (longest > 1)}"
        text += f" in {n} episode{'s' * (n > 1)} of {steps}"
    text += f": {facts['terminated']} terminated, {facts['truncated']} truncated"
    for word, mark in (("state", ";"), ("action", ",")):
        own = names.get(f"{word}_names")
        text += f"{mark} {len(own)} named {word}s" if own else f"{mark} {word}s 0..{facts[f'largest_{word}']}"
    if facts["reward_min"] is not None:
        text += f"; rewards {facts['reward_min'] + 0.0:g} to {facts['reward_max'] + 0.0:g}"  # no -0
        missing = facts["rewards_missing"]
        text += f", {missing} of {facts['transitions']} missing" if missing else ""
    if facts.get("behavior_probability"):
        text += "; behaviour probabilities"
    if facts.get("sampled_episodes") is not None:
        text += f"; {facts['sampled_episodes']} whole episodes kept"
    if facts.get("rows_dropped"):
        text += f"; {facts['rows_dropped']} invalid rows dropped, {facts['broken_episodes'] or 0} episodes broken"
    return text
