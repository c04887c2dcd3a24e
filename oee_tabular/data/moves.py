"""The transitions (s, a, s') of a log, counted, and a log in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import canonical
from oee_tabular.mdp.naming import Name


def counts_of(log: Any, weights: Array, n_states: int, n_actions: int) -> sparse.csr_array:
    """The sums of the weights of the rows of each (s, a, s'): csr of shape (S*A, S); ValueError for numbers out of range."""
    _checks.positive_integer(n_states, "n_states")
    _checks.positive_integer(n_actions, "n_actions")
    _checks.require_memory(float(n_states) * n_actions, "n_states * n_actions", n_states * n_actions)
    for name, column, limit in (
        ("state", log.state, n_states),
        ("action", log.action, n_actions),
        ("next_state", log.next_state, n_states),
    ):
        bad = np.flatnonzero(column >= limit)
        if bad.size:
            given = "n_actions" if name == "action" else "n_states"
            raise ValueError(
                f"log.{name}[{bad[0]}] must be in 0..{limit - 1}; it is {column[bad[0]]} ({bad.size} such rows in all; "
                f"{given} is {limit})"
            )
    rows = log.state * n_actions + log.action
    matrix = sparse.csr_array((weights, (rows, log.next_state)), shape=(n_states * n_actions, n_states))
    return canonical(matrix, drop_zeros=True)


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
        text += f"; rewards {facts['reward_min']:g} to {facts['reward_max']:g}"
    if facts.get("behavior_probability"):
        text += "; behaviour probabilities"
    if facts.get("sampled_episodes") is not None:
        text += f"; {facts['sampled_episodes']} whole episodes kept"
    if facts.get("rows_dropped"):
        text += f"; {facts['rows_dropped']} bad rows dropped, {facts['broken_episodes'] or 0} episodes broken"
    return text
