"""What the limits of all estimators need: the model that data of a given support can tell, and exact zetas."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike
from oee_tabular._sparse import align, row_sums
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import optional_steps
from oee_tabular.ratio.method import Population
from oee_tabular.ratio.support import refuse_unsupported, require_pair

# what an estimator claims (testing.CLAIMS) that reads the log's counts alone
OF_COUNTS = frozenset({"relabelling", "scale", "padding", "after_end"})


def population(
    simulator: FiniteMDP,
    target: FiniteMDP,
    policy: PolicyLike,
    *,
    data_distribution: ArrayLike | None = None,
    behavior_policy: PolicyLike | None = None,
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
        policy: PolicyLike,
        *,
        data_distribution: ArrayLike | None = None,
        behavior_policy: PolicyLike | None = None,
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
