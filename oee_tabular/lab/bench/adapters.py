"""Estimators that others publish, on tables: SCOPE-RL's [1] and offline-rl-ope's [2].

Both take episodes of one length, so that ragged ones are padded: after its end an episode stays, is paid nothing, and weighs
what it weighed. Both estimate from the log alone; SCOPE-RL's doubly robust ones are given Q of the simulator. What learns
weights or values with networks (its marginal estimators, d3rlpy's fitted Q) is not adapted: it is made for large states, slow.

Both install beside numpy 2.4 and work (SCOPE-RL 0.2.1, offline-rl-ope 7.0.0), but they pull in torch (4 GB with its CUDA
libraries), d3rlpy (2.8.0, as 2.8.1 pins gymnasium 1.0.0) and gym, which prints a notice. offline-rl-ope imports jaxtyping and
typeguard below 3, which it does not ask for; the extra does. Their importance sampling is ours to rounding ("is", "pdis",
"wis", "wpdis"): the tests compare them.

    in a clone: pip install '.[scope-rl]'         oee bench --estimators oee_tabular.lab.bench.adapters:ScopeRL
    in a clone: pip install '.[offline-rl-ope]'   oee bench --estimators oee_tabular.lab.bench.adapters:OfflineRLOPE

References: [1] H. Kiyohara et al., SCOPE-RL: a Python library for offline reinforcement learning and off-policy evaluation,
2023. [2] J. Spear, offline-rl-ope, https://pypi.org/project/offline-rl-ope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, PolicyLike, Seed
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.exact import action_values
from oee_tabular.mdp import check_policy

SCOPE = (
    "TrajectoryWiseImportanceSampling", "PerDecisionImportanceSampling", "SelfNormalizedTIS", "SelfNormalizedPDIS",
    "DoublyRobust", "SelfNormalizedDR",
)  # fmt: skip
OFFLINE = ("VanillaISPDIS", "PDWIS")


@dataclass(frozen=True, eq=False)
class Padded:
    """Episodes of one length, (episodes, T): what both libraries read."""

    state: IntArray
    action: IntArray
    reward: Array
    behavior: Array
    policy: Array
    alive: BoolArray


def padded(problem: Problem, policy: Array) -> Padded:
    """The log's episodes, at most ``problem.horizon`` steps of each; ``policy`` (episodes, T, A) at each step.

    After its end an episode repeats its last state, takes action 0 with probability 1 under both policies and is paid 0.
    """
    log = problem.recorded
    starts, probability = log.episode_starts, log.behavior_probability
    if starts is None or log.timestep is None:
        raise ValueError("log must have episodes for importance sampling; it is a bag of moves")
    if probability is None:
        raise ValueError("log must have behaviour probabilities for importance sampling; it has none")
    lengths = np.diff(starts)
    steps = int(lengths.max()) if problem.horizon is None else min(int(lengths.max()), problem.horizon)
    time = np.arange(steps)
    alive = time < lengths[:, None]
    row = starts[:-1, None] + np.minimum(time, lengths[:, None] - 1)
    first = np.zeros(policy.shape[1])
    first[0] = 1.0
    return Padded(
        np.where(alive, log.state[row], log.next_state[row]),
        np.where(alive, log.action[row], 0),
        np.where(alive, problem.rewards_of(log)[row], 0.0),
        np.where(alive, probability[row], 1.0),
        np.where(alive[:, :, None], policy[log.state[row]], first),
        alive,
    )


@dataclass(frozen=True)
class ScopeRL:
    """An estimator of SCOPE-RL on the log's episodes.

    Parameters
    ----------
    estimator : the name of its class in ``scope_rl.ope.discrete``

    Examples
    --------
    >>> ScopeRL("PDIS")
    Traceback (most recent call last):
    ValueError: estimator must be one of 'TrajectoryWiseImportanceSampling', 'PerDecisionImportanceSampling',
    'SelfNormalizedTIS', 'SelfNormalizedPDIS', 'DoublyRobust', 'SelfNormalizedDR'; got 'PDIS'
    """

    estimator: str = "SelfNormalizedPDIS"

    def __post_init__(self) -> None:
        _checks.one_of(self.estimator, "estimator", SCOPE)

    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """Its ``estimate_policy_value``; it gives no standard error."""
        try:
            from scope_rl.ope.discrete import basic_estimators
        except ImportError as error:
            raise ImportError("ScopeRL needs scope-rl; in a clone: pip install '.[scope-rl]'") from error
        pi = check_policy(policy, problem.simulator)
        episodes = padded(problem, pi)
        q = action_values(problem.simulator, pi, horizon=problem.horizon)[episodes.state]
        q[~episodes.alive] = 0.0
        value = getattr(basic_estimators, self.estimator)().estimate_policy_value(
            step_per_trajectory=episodes.action.shape[1],
            action=episodes.action.reshape(-1),
            reward=episodes.reward.reshape(-1),
            pscore=episodes.behavior.reshape(-1),
            evaluation_policy_action_dist=episodes.policy.reshape(-1, pi.shape[1]),
            state_action_value_prediction=q.reshape(-1, pi.shape[1]),
            gamma=float(problem.simulator.discount),
        )
        return Estimate(float(value))


@dataclass(frozen=True)
class OfflineRLOPE:
    """An estimator of offline-rl-ope on the log's episodes, with weights per decision.

    Parameters
    ----------
    estimator : the name of its class in ``offline_rl_ope.api.StandardEstimators``

    Examples
    --------
    >>> OfflineRLOPE()
    OfflineRLOPE(estimator='PDWIS')
    """

    estimator: str = "PDWIS"

    def __post_init__(self) -> None:
        _checks.one_of(self.estimator, "estimator", OFFLINE)

    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """Its ``predict``; it gives no standard error."""
        try:
            import torch
            from offline_rl_ope.api import StandardEstimators
        except ImportError as error:
            extra = "in a clone: pip install '.[offline-rl-ope]'"
            raise ImportError(f"OfflineRLOPE needs offline-rl-ope and typeguard below 3: {extra}") from error
        episodes = padded(problem, check_policy(policy, problem.simulator))
        taken = np.take_along_axis(episodes.policy, episodes.action[:, :, None], axis=2)[:, :, 0]
        weights = np.cumprod(taken / episodes.behavior, axis=1)
        columns = [torch.tensor(column, dtype=torch.float32).unsqueeze(-1) for column in episodes.reward]
        value = getattr(StandardEstimators.IS, self.estimator)().predict(
            rewards=columns,
            states=columns,  # not used by weights
            actions=columns,
            weights=torch.tensor(weights, dtype=torch.float32),
            discount=float(problem.simulator.discount),
            is_msk=torch.ones(weights.shape, dtype=torch.float32),
        )
        return Estimate(float(value))
