"""What limits are taken over: a pair of environments and how data of the target are recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray
from oee_tabular._sparse import on_pattern, row_of_entry
from oee_tabular.exact import Model, policy_value
from oee_tabular.mdp import FiniteMDP

_MANY = 1e12  # moves: a limit's stand-in for infinitely many, where a fit is asked for one


@dataclass(frozen=True, eq=False)
class Population:
    """A pair and the data that an estimator, or a method of ratios, would have infinitely many of.

    ``distribution`` (S, A) is how rows of the target are drawn, uniform where the caller gives none; ``support`` (S*A,) its
    support, or all rows.
    """

    simulator: FiniteMDP
    target: FiniteMDP
    policy: Array
    distribution: Array
    support: BoolArray
    behavior: Array | None
    horizon: int | None

    def counts(self) -> sparse.csr_array:
        """Expected counts of very many moves, csr (S*A, S)."""
        matrix = self.target.transitions
        weight = (_MANY * self.distribution.reshape(-1))[row_of_entry(matrix)]
        return on_pattern(matrix, weight * matrix.data)

    def model(self, fallback: sparse.csr_array) -> FiniteMDP:
        """The target's rows where the data have them, ``fallback``'s elsewhere; paying what the simulator pays."""
        keep, rest = (
            sparse.diags_array(mask.astype(np.float64), format="csr") for mask in (self.support, ~self.support)
        )
        rows = sparse.csr_array(keep @ self.target.transitions + rest @ fallback)
        return self.simulator.with_transitions(rows)

    def value(self, model: Model) -> float:
        """J of the policy in ``model``."""
        return policy_value(model, self.policy, horizon=self.horizon)
