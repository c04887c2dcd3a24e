"""Whether a policy was chosen by the log that it is evaluated on.

Whoever looks for a good policy in the log's own frequencies finds one that their noise
favours (the winner's curse): an interval from the same log then misses the value much
more often than it says. Such a policy is known by its actions. They are the best in the
log's model, everywhere or wherever the policy differs from the one that recorded, and
they are not the best in the simulator, nor in the corrected simulator, whose few
directions leave the noise little to choose from.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from oee_tabular._sparse import row_sums
from oee_tabular.estimators import Problem
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exact import (
    Model,
    action_values,
    back_up_pairs,
    largest_reward,
    reached_states,
    with_rows,
)
from oee_tabular.exceptions import DivergentKernelError
from oee_tabular.inference.evidence import gather
from oee_tabular.typing import Array, BoolArray

# of the largest action value or reward: a smaller loss is rounding
OPTIMALITY_TOLERANCE = 1e-9
# two probabilities of an action that differ by less are the same
SAME_PROBABILITY = 1e-9
# with which a policy that differs from the recording one in some states would have the
# log's best action in all of them by chance; above it the agreement says nothing
MAX_CHANCE = 0.05


def is_best_in_log(problem: Problem, policy: Array) -> bool:
    """Return whether a policy is optimal in the log's model, and in no other model.

    The log's model has the log's frequencies, and the simulator's rows in unrecorded
    state-action pairs; the others are the simulator and the corrected simulator. A
    policy also counts as optimal that is so where it differs from the behaviour policy
    (the problem's, or the log's frequencies), in more states than by chance. Optimality
    is without a horizon; at discount 1 also that of the first of T steps.
    """
    in_log = _Optimality(gather(problem, policy).fitted, policy, problem.horizon)
    agreeing = [
        is_free
        for is_free in _actions_to_judge(problem, policy)
        if in_log.is_best(is_free)
    ]
    if agreeing:
        in_simulator = _Optimality(problem.model, policy, problem.horizon)
        agreeing = [x for x in agreeing if not in_simulator.is_best(x)]
    if agreeing:
        # it costs most, and few policies come so far
        _, rows = estimate_with_rows(problem, policy)
        corrected = _Optimality(with_rows(problem.model, rows), policy, problem.horizon)
        agreeing = [x for x in agreeing if not corrected.is_best(x)]
    return bool(agreeing)


def _actions_to_judge(problem: Problem, policy: Array) -> Iterator[BoolArray]:
    """Yield which actions (S, A) a policy may be judged by.

    First all actions. Then, for each behaviour policy that is known, those whose
    probability the policy changes, in the states where it changes some; not where a
    policy would agree with the log in all of them by chance.
    """
    yield np.ones(policy.shape, dtype=np.bool_)
    reached = reached_states(problem.model, policy)
    for behavior in _behavior_policies(problem, policy):
        is_changed = (np.abs(policy - behavior) > SAME_PROBABILITY) & reached[:, None]
        choices = is_changed.sum(axis=1)
        log_chance = -np.log(choices[choices > 0]).sum()
        is_all = (is_changed | ~reached[:, None]).all()
        if log_chance <= np.log(MAX_CHANCE) and not is_all:
            yield is_changed


def _behavior_policies(problem: Problem, policy: Array) -> Iterator[Array]:
    """Yield the behaviour policy that is given, and the one that the log shows.

    In states that were never recorded the latter is the policy itself.
    """
    if problem.behavior_policy is not None:
        yield problem.behavior_policy
    counts = row_sums(problem.counts).reshape(policy.shape)
    visits = counts.sum(axis=1, keepdims=True)
    yield np.where(visits > 0, counts / np.maximum(visits, 1e-300), policy)


class _Optimality:
    """Hold the values of a policy's actions in a model, and where it comes to."""

    def __init__(self, model: Model, policy: Array, horizon: int | None) -> None:
        self.policy = policy
        self.reached = reached_states(model, policy, on_support=False)
        self.values = _values_of_actions(model, policy, horizon)
        self.largest_reward = largest_reward(model)

    def is_best(self, is_free: BoolArray) -> bool:
        """Return whether no free action (S, A) beats those that the policy takes.

        That is in each state that it reaches and that has a free action. What the
        policy does by other actions does not count.
        """
        judged = is_free.any(axis=1) & self.reached
        if not judged.any():
            return False
        taken = np.where(is_free, self.policy, 0.0)[judged]
        for values in self.values:
            best = np.where(is_free, values, -np.inf).max(axis=1)[judged, None]
            loss = (taken * (best - values[judged])).sum(axis=1)
            largest = max(self.largest_reward, float(np.abs(values).max()))
            if loss.max() <= OPTIMALITY_TOLERANCE * largest:
                return True
        return False


def _values_of_actions(model: Model, policy: Array, horizon: int | None) -> list[Array]:
    """Compute Q (S, A) of the policy and, at discount 1, of the first of T best steps.

    Without the first where the policy never ends at discount 1.
    """
    found = []
    with suppress(DivergentKernelError):
        found.append(action_values(model, policy))
    if model.discount == 1.0 and horizon is not None:
        pairs = back_up_pairs(model, np.zeros(model.n_states))
        for _ in range(horizon - 1):
            pairs = back_up_pairs(model, pairs.max(axis=1))
        found.append(pairs)
    return found
