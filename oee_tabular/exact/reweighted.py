"""The simulator reweighted by a ratio: K_zeta(s' | s, a) = zeta(s, a, s') P(s' | s, a).

Its rows need not sum to 1. The exact value of the per-decision product of ratios is
J(K_zeta) (statement 20): a reward r(s, a) at time t carries zeta_1 ... zeta_t, a reward
r(s, a, s') also zeta_{t+1}.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._results import checked
from oee_tabular._sparse import csr_on_pattern, ratio_on, row_sums
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import NAMELESS, CsrArrays, FiniteMDP, Names, name_transition
from oee_tabular.typing import Array, BoolArray, Csr, IntArray, SparseLike


@checked()
@dataclass(frozen=True, eq=False)
class ReweightedModel:
    """Hold the model K_zeta = zeta P with the simulator's rewards (``reweight``).

    Attributes
    ----------
    n_states : int
        Number of states S.
    n_actions : int
        Number of actions A.
    transitions : csr_array of shape (S*A, S)
        zeta * P, nonnegative, in rows s*A + a of any sum.
    rewards : ndarray of shape (S, A)
        Reward of a step: sum_s' zeta P r(s, a, s'), or the simulator's r(s, a).
    reward_data : ndarray of shape (nnz,) or None
        r(s, a, s') aligned with ``transitions.data``, or None where rewards do not
        depend on s'.
    initial : ndarray of shape (S,)
        The simulator's initial distribution.
    discount : float
        The simulator's discount.
    terminal_state : ndarray of int
        The simulator's ``terminal_state``.
    layout : ndarray or None
        The simulator's layout of the states.
    names : Names
        The simulator's names of states and actions.
    mask : ndarray of bool of shape (S, A), or None
        Which actions can be taken in each state; None means all of them.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> ratio = 1.1 * (coin.transitions > 0)
    >>> model = reweight(coin, ratio)
    >>> model.transitions.sum(axis=1).round(6).tolist()
    [1.1, 1.1]
    >>> round(oee.policy_value(model, [[1.0]] * 2), 4)  # of coin: 1
    1.1111
    """

    n_states: int
    n_actions: int
    transitions: Csr
    rewards: Array
    reward_data: Array | None
    initial: Array
    discount: float
    terminal_state: IntArray
    layout: Array | None = None
    names: Names = NAMELESS
    mask: BoolArray | None = None

    @property
    def has_all_actions(self) -> bool:
        """Return whether all actions can be taken in all states."""
        return self.mask is None

    @property
    def available(self) -> BoolArray:
        """Return which actions can be taken in each state, (S, A)."""
        if self.mask is None:
            return np.broadcast_to(np.True_, self.rewards.shape)
        return self.mask

    @property
    def csr(self) -> CsrArrays:
        """Return the arrays of ``transitions``."""
        return CsrArrays.from_matrix(self.transitions)


MODELS = (FiniteMDP, ReweightedModel)
Model: TypeAlias = FiniteMDP | ReweightedModel  # what the functions of ``exact`` read


class HasValues(Protocol):
    """Describe an object whose ``values`` are a matrix, such as a TransitionRatio."""

    @property
    def values(self) -> Any:
        """Return the matrix of values."""


if TYPE_CHECKING:
    # a ratio of transitions: a sparse matrix (S*A, S) or an object that has one
    RatioLike: TypeAlias = SparseLike | HasValues
else:
    RatioLike: TypeAlias = Any


def require_model(value: object, name: str = "mdp") -> None:
    """Raise a ValueError for what is neither a FiniteMDP nor a ReweightedModel."""
    _checks.instance(value, MODELS, name, "FiniteMDP")


def reweight(mdp: FiniteMDP, ratio: RatioLike) -> ReweightedModel:
    """Make the model K_zeta = zeta * P.

    Parameters
    ----------
    mdp : FiniteMDP
        The simulator P.
    ratio : sparse array of shape (S*A, S), or an object with such ``values``
        The ratio zeta on the support of P, nonnegative, row s*A + a. An entry that is
        not stored is 0.

    Returns
    -------
    ReweightedModel
        The model with transitions zeta * P, which ``exact`` evaluates like a FiniteMDP.

    Raises
    ------
    ValueError
        If the ratio has another shape, or is negative or not finite on the support of
        P.

    See Also
    --------
    weighted_return_moments : Moments of the estimator whose mean is J of this model.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> target = oee.FiniteMDP([[[0.4, 0.6]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> model = reweight(simulator, oee.true_ratio(target, simulator))
    >>> model.transitions.toarray().round(6).tolist()
    [[0.4, 0.6], [0.4, 0.6]]
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    rows = entries_of_ratio(mdp, ratio, "ratio") * mdp.transitions.data
    return with_rows(mdp, rows, own=True)


def entries_of_ratio(mdp: FiniteMDP, ratio: Any, name: str) -> Array:
    """Return zeta on the entries of P, of shape (nnz,), finite and nonnegative.

    The ratio is csr of shape (S*A, S) or an object with such ``values``; ``name`` is
    what errors call it.
    """
    zeta = ratio_on(mdp.csr, ratio, name)
    if not 0.0 <= zeta.min() <= zeta.max() < np.inf:
        bad = int(np.flatnonzero(~(np.isfinite(zeta) & (zeta >= 0)))[0])
        where = name_transition(mdp.csr, bad, mdp.n_actions, mdp.names)
        raise ArgumentError(
            name, f"must be finite and nonnegative; at {where} it is {zeta[bad]}"
        )
    return zeta


def with_rows(mdp: FiniteMDP, rows: Array, *, own: bool = False) -> ReweightedModel:
    """Return the model whose transitions are ``rows`` (nnz,) in place of P's entries.

    Zeros are kept. The rows are copied unless the model may ``own`` them.
    """
    kernel = csr_on_pattern(mdp.transitions, rows, own=own)
    rewards = mdp.rewards
    if mdp.reward_data is not None:
        sums = row_sums(kernel, kernel.data * mdp.reward_data)
        rewards = freeze(sums.reshape(mdp.rewards.shape))
    return ReweightedModel(
        n_states=mdp.n_states,
        n_actions=mdp.n_actions,
        transitions=kernel,
        rewards=rewards,
        reward_data=mdp.reward_data,
        initial=mdp.initial,
        discount=mdp.discount,
        terminal_state=mdp.terminal_state,
        layout=mdp.layout,
        names=mdp.names,
        mask=None if mdp.has_all_actions else mdp.available,
    )
