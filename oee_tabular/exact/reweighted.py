"""The simulator reweighted by a ratio: K_zeta(s' | s, a) = zeta(s, a, s') P(s' | s, a).

Its rows need not sum to 1. The exact value of the per-decision product of ratios is
J(K_zeta) (statement 20):
a reward r(s, a) at time t carries zeta_1 ... zeta_t, a reward r(s, a, s') also
zeta_{t+1}.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._sparse import csr_on_pattern, ratio_on, row_sums
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.arrays import CsrArrays, name_transition
from oee_tabular.mdp.naming import NAMELESS, Names
from oee_tabular.typing import Array, IntArray


@dataclass(frozen=True, eq=False)
class ReweightedModel:
    """K_zeta with the simulator's rewards, initial distribution and discount; made by
    ``reweight``.

    Attributes
    ----------
    n_states, n_actions : int
    transitions : csr (S*A, S), zeta * P; nonnegative, rows of any sum
    rewards : (S, A) of a step: sum_s' zeta P r(s, a, s'), or the simulator's r(s, a)
    reward_data : r(s, a, s') aligned with ``transitions.data``, or None
    initial, discount, terminal_state, layout, names : the simulator's

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> ratio = 1.1 * (coin.transitions > 0)
    >>> model = reweight(coin, ratio)
    >>> model.transitions.sum(axis=1).round(6).tolist(), round(oee.policy_value(model, [[1.0]] * 2), 4)  # of coin: 1
    ([1.1, 1.1], 1.1111)
    """

    n_states: int
    n_actions: int
    transitions: sparse.csr_array
    rewards: Array
    reward_data: Array | None
    initial: Array
    discount: float
    terminal_state: IntArray
    layout: Array | None = None
    names: Names = NAMELESS

    @property
    def csr(self) -> CsrArrays:
        """The arrays of ``transitions``."""
        return CsrArrays.from_matrix(self.transitions)


MODELS = (FiniteMDP, ReweightedModel)
Model: TypeAlias = FiniteMDP | ReweightedModel  # what the functions of ``exact`` read


def require_model(value: object, name: str = "mdp") -> None:
    """A ValueError for what is neither a FiniteMDP nor a ReweightedModel."""
    _checks.instance(value, MODELS, name, "FiniteMDP")


def reweight(mdp: FiniteMDP, ratio: Any) -> ReweightedModel:
    """Make the model K_zeta = zeta * P.

    Parameters
    ----------
    mdp : FiniteMDP
        The simulator P.
    ratio : csr of shape (S*A, S), or any object with such a matrix as ``values``
        zeta on the support of P; nonnegative. An entry that is not stored is 0.

    Raises
    ------
    ValueError
        A ratio of another shape, negative or not finite on the support of P.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> reweight(simulator, oee.true_ratio(target, simulator)).transitions.toarray().round(6).tolist()
    [[0.4, 0.6], [0.4, 0.6]]
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    return with_rows(
        mdp, entries_of_ratio(mdp, ratio, "ratio") * mdp.transitions.data, own=True
    )


def entries_of_ratio(mdp: FiniteMDP, ratio: Any, name: str) -> Array:
    """(entries,) zeta, a csr (S*A, S) or an object with such ``values``, on the support
    of P; finite and nonnegative.
    """
    zeta = ratio_on(mdp.csr, ratio, name)
    if not 0.0 <= zeta.min() <= zeta.max() < np.inf:
        bad = int(np.flatnonzero(~(np.isfinite(zeta) & (zeta >= 0)))[0])
        where = name_transition(mdp.transitions, bad, mdp.n_actions, mdp.names)
        raise ArgumentError(
            name, f"must be finite and nonnegative; at {where} it is {zeta[bad]}"
        )
    return zeta


def with_rows(mdp: FiniteMDP, rows: Array, *, own: bool = False) -> ReweightedModel:
    """The model with these rows (entries,) in place of P's, zeros kept; copied but
    where they are its ``own``.
    """
    kernel = csr_on_pattern(mdp.transitions, rows, own=own)
    rewards = mdp.rewards
    if mdp.reward_data is not None:
        rewards = freeze(
            row_sums(kernel, kernel.data * mdp.reward_data).reshape(mdp.rewards.shape)
        )
    about = (mdp.initial, mdp.discount, mdp.terminal_state, mdp.layout, mdp.names)
    return ReweightedModel(
        mdp.n_states, mdp.n_actions, kernel, rewards, mdp.reward_data, *about
    )
