"""What the limits of all estimators need: the model that data of a given support can tell, and exact zetas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray
from oee_tabular._sparse import align, on_pattern, row_of_entry, row_sums
from oee_tabular.exact import Model, policy_value
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import optional_steps
from oee_tabular.ratio import TransitionRatio
from oee_tabular.ratio.support import refuse_unsupported, require_pair

_MANY = 1e12  # moves: a limit's stand-in for infinitely many, where a fit is asked for one


@dataclass(frozen=True, eq=False)
class Population:
    """A pair and the data that an estimator would have infinitely many of.

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


def population(
    simulator: FiniteMDP,
    target: FiniteMDP,
    policy: Any,
    *,
    data_distribution: Any = None,
    behavior_policy: Any = None,
    horizon: int | None = None,
) -> Population:
    """The arguments of every ``limit``, checked: shapes, and the target inside the simulator's support."""
    require_pair(target, simulator)
    shape = (simulator.n_states, simulator.n_actions)
    full = np.full(shape, 1.0 / (shape[0] * shape[1]))
    share = full if data_distribution is None else _checks.distribution(data_distribution, "data_distribution", shape)
    support = share.reshape(-1) > 0
    seen = sparse.csr_array(sparse.diags_array(support.astype(np.float64), format="csr") @ target.transitions)
    refuse_unsupported(seen, simulator, what="target")
    behavior = None
    if behavior_policy is not None:
        behavior = check_policy(behavior_policy, simulator, name="behavior_policy")
    steps = optional_steps(horizon, simulator)
    return Population(simulator, target, check_policy(policy, simulator), share, support, behavior, steps)


def limit_ratio(people: Population, fitted: TransitionRatio) -> sparse.csr_array:
    """``fitted`` with the exact P_target / P_simulator on the rows that have data."""
    matrix = people.simulator.transitions
    inside, _ = align(people.target.transitions, matrix)
    seen = people.support[row_of_entry(matrix)]
    safe = np.where(matrix.data > 0, matrix.data, 1.0)
    return on_pattern(matrix, np.where(seen, inside / safe, fitted.on(people.simulator)))


def expected_rewards(simulator: FiniteMDP, transitions: sparse.csr_array) -> Array:
    """(S*A,) expected rewards under other dynamics, paid as the simulator pays."""
    if simulator.reward_data is None:
        return simulator.rewards.reshape(-1)
    moves, _ = align(transitions, simulator.transitions)
    return row_sums(simulator.transitions, moves * simulator.reward_data)


class ExactLimit:
    """An estimator with an exact population limit: subclasses say what it is of a ``Population``."""

    def limit(
        self,
        simulator: FiniteMDP,
        target: FiniteMDP,
        policy: Any,
        *,
        data_distribution: Any = None,
        behavior_policy: Any = None,
        horizon: int | None = None,
    ) -> float:
        """The exact population limit, bias included, of a policy's estimated value.

        Parameters
        ----------
        simulator, target : FiniteMDP, the target inside the simulator's support where there are data
        policy : (S, A)
        data_distribution : (S, A) how rows of the target are recorded; matters through its support alone but for the
            quotient of two ratios; None: everywhere, evenly
        behavior_policy : (S, A) of the log's episodes; None: one with support
        horizon : positive int or None
        """
        return self.limit_of(
            population(
                simulator,
                target,
                policy,
                data_distribution=data_distribution,
                behavior_policy=behavior_policy,
                horizon=horizon,
            )
        )

    def limit_of(self, people: Population) -> float:
        """The limit in a checked population."""
        raise NotImplementedError
