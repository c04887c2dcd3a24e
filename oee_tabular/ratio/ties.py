"""Ratios tied between transitions: all entries with one key share one ratio.

Their counts are pooled. With few transitions hardly any row (s, a) is recorded, but
rows may be alike: a command moves an arm by much the same displacement wherever it is.
Let c(s, a, s') be the key of an entry. The paper's risk, summed over the log's rows and
over g that depend on the key alone, is a program over one number a key:

    minimise  sum_c  M_c g_c - N_c log g_c     subject to  sum_c M_c g_c = sum_c N_c,
    N_c = sum n(s, a, s') + kappa M_c / M,
    M_c = sum n(s, a) P(s' | s, a) (1 + kappa / M),   both over entries with key c

for each group of keys that occur together in rows, M the group's total of n(s, a);
kappa transitions as the simulator makes them keep g near 1. Then zeta = g_c / sum_s' P
g_c, row by row, which leaves zeta alone where all rows of a group are alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data.frames import eager, is_frame
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, Rows
from oee_tabular.ratio import dual
from oee_tabular.ratio.dual import Coordinates
from oee_tabular.ratio.features import keys_in
from oee_tabular.ratio.method import Method, RatioInput
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.typing import FrameLike, IntArray, IntArrayLike

TieLike: TypeAlias = (
    IntArrayLike | FrameLike | Callable[[IntArray, IntArray, IntArray], IntArrayLike]
)
# how errors say that a function of transitions is called
TIE_CALL = "tie(state, action, next_state), of three arrays of integers"


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Tied(Method):
    """Ratio from pooled counts: one number for all transitions with the same key.

    Each row of zeta * P is then scaled to sum to 1.

    Parameters
    ----------
    tie : array-like of int, data frame or callable
        The keys: an array of integers, one for each entry of
        ``simulator.transitions.data`` or of shape (S, A, S); a function of the arrays
        (s, a, s') of all entries that returns one; or a data frame with columns state,
        action, next_state (numbers or the simulator's names) and one of keys.
    strength : float, default 3.0
        Number of transitions kappa >= 0 that the simulator is worth in each group of
        keys.

    Raises
    ------
    ValueError
        If keys are of another length or not integers, if the strength is negative, or
        if transitions are outside the simulator's support.

    Notes
    -----
    ``gap`` is the largest duality gap of the pooled programs (nats); ``visited`` and
    ``counts`` are the log's own, row by row. ``details``: ``n_keys``, ``n_groups``,
    ``groups_visited``, ``pooled_row_sums`` (smallest and largest sum_s' P g before the
    rows were scaled: far from 1 if rows of a group differ), ``strength``.

    Limit: the pooled ratio N_c / M_c, which is zeta if zeta is a function of the key;
    the error of a wrong tie does not vanish with more data. An unrecorded group keeps
    zeta = 1, and so does a key that occurs only in unrecorded pairs. No standard error
    is known. Cost: O(nnz log nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = oee.tasks.gridworld(5, 0.3), oee.tasks.gridworld(5, 0.1)
    >>> log = oee.sample_transitions(target, np.full((25, 4), 0.01), 300, seed=0)
    >>> def kind(s, a, following):  # the intended move, one of the others, or staying
    ...     steps = {(-1, 0): 0, (1, 0): 1, (0, -1): 2, (0, 1): 3}
    ...     apart = np.stack([following // 5 - s // 5, following % 5 - s % 5], axis=1)
    ...     return np.array([steps.get(tuple(d), 4) for d in apart.tolist()]) + 5 * a
    >>> zeta = Tied(kind).fit(log, simulator)
    >>> zeta.details["n_keys"], zeta.gap < 1e-9, zeta.row_sum_error < 1e-12
    (20, True, True)
    """

    tie: TieLike | None = field(default=None, repr=False)
    strength: float = 3.0

    def __post_init__(self) -> None:
        """Check the method's options."""
        if self.tie is None:
            raise ArgumentError(
                "tie",
                "must be given with method 'tied': a key for each entry, or a function"
                " of (s, a, s')",
            )
        _refuse_words(self.strength)
        _checks.number_in(self.strength, "strength", 0.0, np.inf)

    def _fit(self, given: RatioInput) -> TransitionRatio:
        """Solve the pooled programs and scale each row."""
        observed = given.observed
        simulator = given.simulator
        kappa = float(self.strength)
        matrix = simulator.transitions
        rows = given.rows
        keys = tie_keys(self.tie, rows, simulator)
        visits = rows.sums(observed)
        expected = rows.spread(visits) * matrix.data
        n_keys = int(keys.max()) + 1
        pooled_observed = np.bincount(keys, observed, n_keys)
        pooled_expected = np.bincount(keys, expected, n_keys)
        n_groups, group = _groups(rows, keys, n_keys)
        known = np.flatnonzero(pooled_expected > 0)
        known = known[np.argsort(group[known], kind="stable")]
        size = np.bincount(group, pooled_expected, n_groups)[group[known]]
        share = pooled_expected[known] / size
        p = (pooled_observed[known] + kappa * share) / (size + kappa)
        zero = np.zeros(len(known))
        ends = np.append(np.flatnonzero(np.diff(group[known], prepend=-1)), len(known))
        fit = dual.solve_rows(Coordinates(p, share, zero, zero), 0.0, np.inf, ends)
        ratio = np.ones(n_keys)
        ratio[known] = fit.ratio
        zeta = ratio[keys]
        sums = rows.sums(zeta * matrix.data)
        empty = np.flatnonzero(~(sums > 0) & simulator.available.reshape(-1))
        if empty.size:
            s, a = divmod(int(empty[0]), simulator.n_actions)
            raise ArgumentError(
                "strength",
                f"must be positive here: no key of row ({simulator.names.pair(s, a)})"
                f" was recorded, and zeta * P would have no mass there ({empty.size}"
                f" such rows in all); it is {kappa:g}",
            )
        zeta = zeta / rows.spread(sums)
        used = sums[visits > 0] if (visits > 0).any() else sums[sums > 0]
        details: dict[str, object] = {
            "n_keys": n_keys,
            "n_groups": n_groups,
            "groups_visited": len(fit.gap),
            "pooled_row_sums": (float(used.min()), float(used.max())),
            "strength": kappa,
        }
        return replace(
            given.ratio(zeta, "tied", float(fit.gap.max()), details), tied=True
        )


def _refuse_words(strength: object) -> None:
    """Raise an error for a strength that is to be chosen on the data."""
    if isinstance(strength, str):
        raise ArgumentError(
            "strength",
            f"must be a number with method 'tied'; got {_checks.show(strength)}",
        )


def tie_keys(tie: object, rows: Rows, simulator: FiniteMDP) -> IntArray:
    """Return keys numbered from 0, one for each entry of the simulator's transitions.

    ``tie`` is an array of (entries,) or (S, A, S), a function or a data frame.
    """
    if not callable(tie) and is_frame(tie):
        return keys_of(eager(tie), rows, simulator)
    if callable(tie):
        tie = _checks.call_function(tie, "tie", TIE_CALL, *rows.transitions)
    return keys_of(_checks.as_array(tie, "tie"), rows, simulator)


def keys_of(given: Any, rows: Rows, simulator: FiniteMDP) -> IntArray:
    """Return the keys of an array, or of a data frame whose rows are read, from 0."""
    if not isinstance(given, np.ndarray):
        given = keys_in(given, simulator, "tie")
    if given.shape == (simulator.n_states, simulator.n_actions, simulator.n_states):
        given = given[rows.transitions]
    if given.shape != rows.arrival.shape:
        raise ArgumentError(
            "tie",
            f"must have shape {rows.arrival.shape}, a key for each entry of"
            f" simulator.transitions; it has shape {given.shape}",
        )
    if given.dtype.kind not in "iu":
        raise ArgumentError("tie", f"must have integer keys; they are {given.dtype}")
    return np.asarray(np.unique(given, return_inverse=True)[1], dtype=np.int64)


def _groups(rows: Rows, keys: IntArray, n_keys: int) -> tuple[int, IntArray]:
    """Return the number of groups of keys that share rows, and each key's group."""
    # The other entries of a row are joined to its first. A row without any has none,
    # and the last ones would begin beyond the end.
    lead = keys[np.minimum(rows.indptr[:-1], len(keys) - 1)]
    pairs = np.unique(rows.spread(lead) * n_keys + keys)
    joined = sparse.csr_array(
        (np.ones(len(pairs)), np.divmod(pairs, n_keys)), shape=(n_keys, n_keys)
    )
    n_groups, group = sparse.csgraph.connected_components(joined, directed=False)
    return int(n_groups), np.asarray(group, dtype=np.int64)
