"""An MDP that allows the moves of a log: some probability for those to which it gives none."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, canonical, check_csr, find, row_of_entry
from oee_tabular.mdp.arrays import canonical_table
from oee_tabular.mdp.policies import Sized

LEAST = 1e-300  # a smaller probability supports no ratio
_LOG = (
    "state",
    "action",
    "next_state",
    "terminated",
    "reward",
    "episode_starts",
    "state_names",
    "action_names",
    "numbered",
)


class Tables(Sized, Protocol):
    """What is read of a FiniteMDP."""

    transitions: sparse.csr_array
    rewards: Array
    transition_rewards: sparse.csr_array | None


def supporting(mdp: Tables, log: object, epsilon: object) -> dict[str, Any]:
    """What changes in an MDP that is to allow the log's moves; ``FiniteMDP.with_support_of`` explains them."""
    eps = _checks.number_in(epsilon, "epsilon", 0.0, 1.0, open_ends=True)
    rows, columns, reward = _moves_of(mdp, log)
    matrix = mdp.transitions
    shape = matrix.shape
    seen = canonical_table(rows, columns, np.ones(len(rows)), shape)
    position, stored = find(matrix, row_of_entry(seen), seen.indices.astype(np.int64))
    impossible = ~(stored & (matrix.data[position] >= LEAST))
    row, column = row_of_entry(seen)[impossible], seen.indices[impossible]
    if len(row) == 0:
        return {}
    number = np.bincount(row, minlength=shape[0])
    added = canonical_table(row, column, eps / number[row], shape)
    kept = sparse.csr_array(sparse.diags_array(np.where(number > 0, 1.0 - eps, 1.0)) @ matrix)
    new = canonical(kept + added, drop_zeros=True)
    if mdp.transition_rewards is None:
        return {"transitions": new}
    own, defined = align(mdp.transition_rewards, new)
    value = mdp.rewards.reshape(-1)[row_of_entry(new)]
    if reward is not None:
        total, paid = align(canonical_table(rows, columns, reward, shape), new)
        often, _ = align(seen, new)
        value = np.where(paid, total / np.where(paid, often, 1.0), value)
    again = sparse.csr_array((np.where(defined, own, value), new.indices, new.indptr), shape)
    beside, kept_there = mdp.transition_rewards, align(new, mdp.transition_rewards)[1]
    entries = np.flatnonzero(~kept_there)
    rest = (row_of_entry(beside)[entries], beside.indices[entries], beside.data[entries])
    table = canonical_table(
        np.concatenate([row_of_entry(again), rest[0]]), np.concatenate([again.indices, rest[1]]),
        np.concatenate([again.data, rest[2]]), shape,
    )  # fmt: skip
    return {"transitions": new, "rewards": table}


def _moves_of(mdp: Tables, log: Any) -> tuple[IntArray, IntArray, Array | None]:
    """Rows, next states and rewards of a log's moves, terminated ones led to where that leads; or of counts."""
    if sparse.issparse(log):
        if log.shape != mdp.transitions.shape:
            raise ValueError(
                f"log must be of shape {mdp.transitions.shape} where it is counts; it has shape {log.shape}"
            )
        counts = canonical(check_csr(log, "log"), drop_zeros=True)
        return row_of_entry(counts), counts.indices.astype(np.int64), None
    require_log(log)
    log = log.numbered(mdp)
    for name, limit in (("state", mdp.n_states), ("action", mdp.n_actions), ("next_state", mdp.n_states)):
        values = getattr(log, name)
        bad = np.flatnonzero(values >= limit)
        if bad.size:
            raise ValueError(f"log.{name}[{bad[0]}] must be in 0..{limit - 1}, the simulator's; it is {values[bad[0]]}")
    lead = np.arange(mdp.n_states)
    lead[: len(mdp.terminal_state)] = mdp.terminal_state
    to = np.where(log.terminated, lead[log.next_state], log.next_state)
    return log.state * mdp.n_actions + log.action, to, log.reward


def require_log(log: object) -> None:
    """ValueError where it is no log."""
    if isinstance(log, type) or not all(hasattr(log, name) for name in _LOG):
        frame = hasattr(log, "columns") and not isinstance(log, type)
        hint = " (of a data frame: Transitions.from_frame(log))" * frame
        raise ValueError(f"log must be Transitions; got {type(log).__name__}{hint}")
