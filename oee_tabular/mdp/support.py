"""More support: action noise, and transitions of a log that P gives probability 0."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import (
    align,
    canonical,
    check_csr,
    csr_on_pattern,
    repeat_rows,
    row_of_entry,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.arrays import csr_from_entries, require_numbers
from oee_tabular.mdp.logs import LogLike, require_log
from oee_tabular.typing import Array, BoolArray, Csr, IntArray, SparseLike

if TYPE_CHECKING:
    from oee_tabular.mdp.finite_mdp import FiniteMDP

MIN_PROBABILITY = 1e-300  # of a transition; a smaller one supports no ratio


def add_action_noise(mdp: FiniteMDP, epsilon: float) -> dict[str, Any]:
    """Return the arguments of P_eps and r_eps (``FiniteMDP.with_action_noise``)."""
    eps = _checks.number_in(epsilon, "epsilon", 0.0, 1.0)
    n_states, n_actions = mdp.rewards.shape
    noise = sparse.kron(
        sparse.eye_array(n_states), np.full((n_actions, n_actions), 1.0 / n_actions)
    )
    same = sparse.eye_array(n_states * n_actions)
    if not mdp.has_all_actions:
        noise = mean_available(mdp.available)
        same = sparse.diags_array(mdp.available.reshape(-1).astype(np.float64))
    mixing = sparse.csr_array((1.0 - eps) * same + eps * noise)
    matrix = canonical(mixing @ mdp.transitions, drop_zeros=True)
    expected = mixing @ mdp.rewards.reshape(-1)
    rewards: Array | Csr = expected.reshape(mdp.rewards.shape)
    if mdp.reward_data is not None:
        weighted = mdp.transitions.data * mdp.reward_data
        flow = mixing @ csr_on_pattern(mdp.transitions, weighted, own=True)
        total, _ = align(canonical(flow, drop_zeros=False), matrix)
        rewards = csr_on_pattern(matrix, total / matrix.data, own=True)
    sampling = mdp.sampling
    if sampling is not None:
        # each pair rests on the least sampled action of its state
        pairs = sampling.pairs.reshape(-1, n_actions)
        least = pairs.min(axis=1, where=mdp.available, initial=np.inf)
        number = np.where(mdp.available, least[:, None], pairs)
        sampling = sampling._replace(pairs=number.reshape(-1))
    return {"transitions": matrix, "rewards": rewards, "sampling": sampling}


def mean_available(available: BoolArray) -> Any:
    """Return the matrix (S*A, S*A) that takes each row to the mean row of its state.

    The rows of actions that cannot be taken are neither averaged nor made.
    """
    n_states, n_actions = available.shape
    kept = sparse.diags_array(available.reshape(-1).astype(np.float64))
    shares = available / available.sum(axis=1, keepdims=True)
    among = sparse.kron(sparse.eye_array(n_states), np.ones((n_actions, n_actions)))
    return kept @ among @ sparse.diags_array(shares.reshape(-1))


def add_support(
    mdp: FiniteMDP, log: LogLike | SparseLike, epsilon: float
) -> dict[str, Any]:
    """Return the arguments that change where an MDP is to allow the log's transitions.

    ``FiniteMDP.with_support_of`` explains them.
    """
    eps = _checks.number_in(epsilon, "epsilon", 0.0, 1.0, open_ends=True)
    rows, columns, reward = _read_transitions(mdp, log)
    require_available_rows(mdp, rows, "log")
    matrix = mdp.transitions
    observed = csr_from_entries(rows, columns, np.ones(len(rows)), matrix.shape)
    is_impossible = align(matrix, observed)[0] < MIN_PROBABILITY
    if not is_impossible.any():
        return {}
    row = row_of_entry(observed)[is_impossible]
    column = observed.indices[is_impossible]
    number = np.bincount(row, minlength=matrix.shape[0])
    added = csr_from_entries(row, column, eps / number[row], matrix.shape)
    kept = sparse.csr_array(
        sparse.diags_array(np.where(number > 0, 1.0 - eps, 1.0)) @ matrix
    )
    new = canonical(kept + added, drop_zeros=True)
    table = mdp.transition_rewards
    if table is None:
        return {"transitions": new}
    value = _added_rewards(mdp, added, rows, columns, reward)
    is_undefined = ~align(table, added)[1]
    rewards = csr_from_entries(
        np.concatenate([row_of_entry(table), row[is_undefined]]),
        np.concatenate([table.indices, column[is_undefined]]),
        np.concatenate([table.data, value[is_undefined]]),
        matrix.shape,
    )
    return {"transitions": new, "rewards": rewards}


def require_available_rows(
    mdp: FiniteMDP, rows: IntArray, name: str, *, by_row: bool = False
) -> None:
    """Raise an ArgumentError where rows s*A + a are of actions that cannot be taken.

    ``rows`` are those of the transitions of ``name``, in its order, or ``by_row`` some
    of its own rows.
    """
    if mdp.has_all_actions:
        return
    bad = np.flatnonzero(~mdp.available.reshape(-1)[rows])
    if bad.size:
        state, action = divmod(int(rows[bad[0]]), mdp.n_actions)
        more = _checks.in_all(bad.size, "such transitions")
        place = int(rows[bad[0]] if by_row else bad[0])
        raise ArgumentError(
            f"{name}[{place}]",
            "must have an action that can be taken in its state; in state"
            f" {mdp.names.state(state)} action {mdp.names.action(action)} cannot be"
            f" taken, and is{more} (if the target can, set available[{state}, {action}]"
            " = True and give the row of transitions; if not, leave it out)",
        )


def require_same_available(target: FiniteMDP, simulator: FiniteMDP) -> None:
    """Raise an ArgumentError unless the same actions can be taken in both MDPs."""
    if target.has_all_actions and simulator.has_all_actions:
        return
    bad = np.argwhere(target.available != simulator.available)
    if len(bad):
        state, action = bad[0]
        whose = "simulator" if target.available[state, action] else "target"
        more = _checks.in_all(len(bad), "such pairs")
        raise ArgumentError(
            "target",
            "must have the simulator's available actions; in state"
            f" {simulator.names.state(state)} action {simulator.names.action(action)}"
            f" cannot be taken in the {whose}, but in the other{more} (make both with"
            " the same available=)",
        )


def _added_rewards(
    mdp: FiniteMDP, added: Csr, rows: IntArray, columns: IntArray, reward: Array | None
) -> Array:
    """Return the reward of each added transition: the log's mean, or r(s, a)."""
    value = repeat_rows(added, mdp.rewards.reshape(-1))
    if reward is None:
        return value
    has_reward = ~np.isnan(reward)  # some may be missing
    places = rows[has_reward], columns[has_reward]
    ones = np.ones(len(places[0]))
    sums = csr_from_entries(*places, reward[has_reward], added.shape)
    numbers = csr_from_entries(*places, ones, added.shape)
    total = align(sums, added)[0]
    count = align(numbers, added)[0]
    return np.where(count > 0, total / np.maximum(count, 1.0), value)


def _read_transitions(
    mdp: FiniteMDP, log: Any
) -> tuple[IntArray, IntArray, Array | None]:
    """Return the rows, next states and rewards of a log's transitions, or of counts.

    Terminated transitions lead to the terminal state of their next state.
    """
    shape = mdp.csr.shape
    if _checks.is_sparse(log):
        if log.shape != shape:
            raise ArgumentError(
                "log",
                f"must be of shape {shape} where it is counts; it has shape"
                f" {log.shape}",
            )
        counts = canonical(check_csr(log, "log"), drop_zeros=True)
        return row_of_entry(counts), counts.indices.astype(np.int64), None
    require_log(log)
    log = log.numbered(mdp)
    for name, limit in (
        ("state", mdp.n_states),
        ("action", mdp.n_actions),
        ("next_state", mdp.n_states),
    ):
        require_numbers(getattr(log, name), limit, f"log.{name}", ", the simulator's")
    ends = np.arange(mdp.n_states)
    ends[: len(mdp.terminal_state)] = mdp.terminal_state
    to = np.where(log.terminated, ends[log.next_state], log.next_state)
    return log.state * mdp.n_actions + log.action, to, log.reward
