"""Estimators that others publish, on tables: SCOPE-RL's [1] and offline-rl-ope's [2].

``notebooks/peers.md`` is their page. Both install beside numpy 2.4 and work (SCOPE-RL
0.2.1, offline-rl-ope 7.0.0), but they pull in torch (4 GB with its CUDA libraries),
d3rlpy (2.8.0, as 2.8.1 pins gymnasium 1.0.0) and gym, which prints a notice.
offline-rl-ope imports jaxtyping and typeguard below 3, which it does not ask for; the
extra does.

References: [1] H. Kiyohara et al., SCOPE-RL: a Python library for offline reinforcement
learning and off-policy evaluation, 2023. [2] J. Spear, offline-rl-ope,
https://pypi.org/project/offline-rl-ope.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.exact import action_values
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import check_policy
from oee_tabular.typing import Array, PolicyLike, Seed

PEERS: Mapping[str, tuple[str, ...]] = {
    "scope-rl": (
        "TrajectoryWiseImportanceSampling",
        "PerDecisionImportanceSampling",
        "SelfNormalizedTIS",
        "SelfNormalizedPDIS",
        "DoublyRobust",
        "SelfNormalizedDR",
    ),
    "offline-rl-ope": ("VanillaISPDIS", "PDWIS"),
}


def pad_episodes(problem: Problem, policy: Array) -> dict[str, Any]:
    """Pad the episodes of a log to one length, at most ``problem.horizon`` steps.

    The arrays state, action, reward, behavior and alive are (episodes, T). After its
    end an episode repeats its last state, takes action 0 with probability 1 under both
    policies and gets reward 0. ``policy`` (episodes, T, A) is that of the policy at
    each step.
    """
    log = problem.recorded
    starts = log.episode_starts
    probability = log.behavior_probability
    if starts is None or log.timestep is None:
        raise ArgumentError(
            "log",
            "must have episodes for importance sampling; its transitions have none",
        )
    if probability is None:
        raise ArgumentError(
            "log",
            "must have behaviour probabilities for importance sampling; it has none",
        )
    lengths = np.diff(starts)
    steps = int(lengths.max())
    if problem.horizon is not None:
        steps = min(steps, problem.horizon)
    time = np.arange(steps)
    alive = time < lengths[:, None]
    row = starts[:-1, None] + np.minimum(time, lengths[:, None] - 1)
    return {
        "state": np.where(alive, log.state[row], log.next_state[row]),
        "action": np.where(alive, log.action[row], 0),
        "reward": np.where(alive, problem.rewards_of(log)[row], 0.0),
        "behavior": np.where(alive, probability[row], 1.0),
        "policy": np.where(
            alive[:, :, None], policy[log.state[row]], np.eye(policy.shape[1])[0]
        ),
        "alive": alive,
    }


@dataclass(frozen=True)
class Peer:
    """Estimator of another library on the log's episodes, without a standard error.

    Parameters
    ----------
    library : {'scope-rl', 'offline-rl-ope'}
        The library that has the estimator.
    estimator : str
        The name of its class in ``scope_rl.ope.discrete`` or
        ``offline_rl_ope.api.StandardEstimators``.

    Examples
    --------
    >>> Peer("scope-rl", "PDIS")
    Traceback (most recent call last):
    oee_tabular.exceptions.ArgumentError: scope-rl's estimator must be one of
    'TrajectoryWiseImportanceSampling', 'PerDecisionImportanceSampling',
    'SelfNormalizedTIS', 'SelfNormalizedPDIS', 'DoublyRobust', 'SelfNormalizedDR';
    got 'PDIS'
    """

    library: str
    estimator: str

    def __post_init__(self) -> None:
        """Check the names of the library and of the estimator."""
        _checks.one_of(self.library, "library", tuple(PEERS))
        _checks.one_of(
            self.estimator, f"{self.library}'s estimator", PEERS[self.library]
        )

    def load(self) -> Any:
        """Return the estimator as the library makes it.

        Without the library there is an ImportError that names the extra.
        """
        try:
            if self.library == "scope-rl":
                place = importlib.import_module(
                    "scope_rl.ope.discrete.basic_estimators"
                )
            else:
                place = importlib.import_module(
                    "offline_rl_ope.api"
                ).StandardEstimators.IS
            return getattr(place, self.estimator)()
        except ImportError as error:
            raise ImportError(
                f"{self.library}:{self.estimator} needs {self.library}; in a clone: pip"
                f" install '.[{self.library}]'"
            ) from error

    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """Estimate the value of the policy; the seed is not used."""
        pi = check_policy(policy, problem.simulator)
        discount = float(problem.simulator.discount)
        estimator = self.load()
        episodes = pad_episodes(problem, pi)
        if self.library == "scope-rl":
            table = action_values(problem.simulator, pi, horizon=problem.horizon)
            # -inf is the value of an action that cannot be taken
            table = np.where(problem.simulator.available, table, 0.0)
            q = table[episodes["state"]]
            q[~episodes["alive"]] = 0.0
            value = estimator.estimate_policy_value(
                step_per_trajectory=q.shape[1],
                action=episodes["action"].reshape(-1),
                reward=episodes["reward"].reshape(-1),
                pscore=episodes["behavior"].reshape(-1),
                evaluation_policy_action_dist=episodes["policy"].reshape(
                    -1, q.shape[2]
                ),
                state_action_value_prediction=q.reshape(-1, q.shape[2]),
                gamma=discount,
            )
        else:
            torch = importlib.import_module("torch")
            tensor = functools.partial(torch.tensor, dtype=torch.float32)
            taken = np.take_along_axis(
                episodes["policy"], episodes["action"][:, :, None], axis=2
            )[:, :, 0]
            weights = np.cumprod(taken / episodes["behavior"], axis=1)
            columns = [tensor(column).unsqueeze(-1) for column in episodes["reward"]]
            value = estimator.predict(
                rewards=columns,
                states=columns,  # not used by weights
                actions=columns,
                weights=tensor(weights),
                discount=discount,
                is_msk=tensor(np.ones(weights.shape)),
            )
        return Estimate(float(value))
