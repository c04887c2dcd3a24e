"""The simulator reweighted by a ratio: K_zeta(s' | s, a) = zeta(s, a, s') P(s' | s, a).

Its rows need not sum to 1. The exact value of the per-decision product of ratios is J(K_zeta) (theory: population limits):
a reward r(s, a) at time t carries zeta_1 ... zeta_t, a reward r(s, a, s') also zeta_{t+1}.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, canonical, on_pattern, row_sums
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.finite_mdp import name_move


class Model(Protocol):
    """What the functions of ``exact`` read: a FiniteMDP, or a ReweightedModel with rows of any sum."""

    @property
    def n_states(self) -> int:
        """S."""

    @property
    def n_actions(self) -> int:
        """A."""

    @property
    def transitions(self) -> sparse.csr_array:
        """(S*A, S) nonnegative."""

    @property
    def rewards(self) -> Array:
        """(S, A) expected reward of a step."""

    @property
    def reward_data(self) -> Array | None:
        """r(s, a, s') aligned with transitions.data, or None."""

    @property
    def initial(self) -> Array:
        """(S,)."""

    @property
    def discount(self) -> float:
        """In [0, 1]."""

    @property
    def terminal_state(self) -> IntArray:
        """(S0,)."""


@dataclass(frozen=True, eq=False)
class ReweightedModel:
    """K_zeta with the simulator's rewards, initial distribution and discount; made by ``reweight``."""

    n_states: int
    n_actions: int
    transitions: sparse.csr_array
    rewards: Array
    reward_data: Array | None
    initial: Array
    discount: float
    terminal_state: IntArray


def require_model(value: object) -> None:
    """A ValueError for what is neither a FiniteMDP nor a ReweightedModel."""
    if not isinstance(value, FiniteMDP | ReweightedModel):
        raise ValueError(f"mdp must be a FiniteMDP; got {type(value).__name__}")


def reweight(mdp: FiniteMDP, ratio: Any) -> ReweightedModel:
    """The model K_zeta = zeta * P.

    Parameters
    ----------
    mdp : FiniteMDP
        The simulator P.
    ratio : csr of shape (S*A, S), or any object with such a matrix as ``values``
        zeta on the support of P; nonnegative. An entry that is not stored is 0.
    """
    values = getattr(ratio, "values", ratio)
    if not sparse.issparse(values) or values.shape != mdp.transitions.shape:
        found = getattr(values, "shape", type(values).__name__)
        raise ValueError(f"ratio must be sparse of shape {mdp.transitions.shape}, row s*A + a; got {found}")
    zeta, _ = align(canonical(values, drop_zeros=False), mdp.transitions)
    bad = np.flatnonzero(~(np.isfinite(zeta) & (zeta >= 0)))
    if bad.size:
        where = name_move(mdp.transitions, int(bad[0]), mdp.n_actions)
        raise ValueError(f"ratio must be finite and nonnegative; at {where} it is {zeta[bad[0]]}")
    kernel = on_pattern(mdp.transitions, zeta * mdp.transitions.data)
    rewards = mdp.rewards
    if mdp.reward_data is not None:
        rewards = row_sums(kernel, kernel.data * mdp.reward_data).reshape(mdp.rewards.shape)
    return ReweightedModel(
        mdp.n_states,
        mdp.n_actions,
        kernel,
        rewards,
        mdp.reward_data,
        mdp.initial,
        mdp.discount,
        mdp.terminal_state,
    )
