"""How many levels the commands of a policy are given by, and what that does to values.

A task has finitely many actions. A command between them is shared out among its
neighbours so that its mean is kept (``CommandPolicy``), which adds a variance that
grows with the square of the spacing h. So the value of L levels a coordinate is

    J_L = J + c h^2 + o(h^2),

and with one more level between each two, of half the spacing, J_{2L-1} = J + c h^2 / 4.
The difference d = J_{2L-1} - J_L is measured in the simulator, by common random
numbers, and J is about J_L + 4/3 d (Richardson's extrapolation). Levels are fine enough
where |4/3 d| is below a tenth of the interval's half width. Else the evaluation takes
the finer levels, if the simulator steps them, and what is left over is put into the
interval.

A single command x h above a level has the variance x (1 - x) h^2, and between the finer
levels at most half of it. So the error is at most 2 d, which is what the
interval includes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from oee_tabular import _progress
from oee_tabular.continuous.evaluation.policies import CommandPolicy
from oee_tabular.continuous.evaluation.rollouts import Rollouts
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import ContinuousTask, StatePolicy
from oee_tabular.estimators import Estimate
from oee_tabular.typing import Array, IntArray

# times the finer levels' difference d: the error of the coarser levels
RICHARDSON = 4.0 / 3.0
# times this error: its bound 2 d
MOST = 2.0 / RICHARDSON
# of the interval's half width, above which levels are too coarse
MAX_SHARE = 0.1
# standard errors, below which a difference may be chance
N_ERRORS = 2.0
MAX_FINER_COMMANDS = 1000
# rounds in which levels are made finer and everything is computed again
MAX_REFINEMENTS = 2
# share of a log's rows that took one of the actions: above it, the log has too few others
MAX_ON_LEVELS = 0.5
# of the log's states, in which a policy's commands are compared with the actions
MAX_POLICY_STATES = 1000
# rows of the log, in whose states the finer task is held against the task
N_HELD_ROWS = 200


@dataclass(frozen=True)
class Rounding:
    """What giving a policy's commands by a task's actions does to its value.

    Attributes
    ----------
    n_actions : int
        The number of actions.
    error : float
        By how much the value without rounding is larger, in the simulator.
    standard_error : float
        The standard error of ``error``.
    """

    n_actions: int
    error: float
    standard_error: float

    @property
    def is_seen(self) -> bool:
        """Return whether the error is surely not 0."""
        return abs(self.error) > N_ERRORS * self.standard_error

    def is_too_large(self, half_width: float) -> bool:
        """Return whether the error is seen, and above a tenth of the half width."""
        return self.is_seen and abs(self.error) > MAX_SHARE * half_width

    def count_refinements(self, half_width: float) -> int:
        """Return how often the spacing must be halved, by the law of its square."""
        ratio = abs(self.error) / (MAX_SHARE * half_width)
        return max(1, math.ceil(math.log(ratio, 4.0))) if ratio > 1.0 else 0

    def describe(self, name: str, scale: float) -> str:
        """Describe the error; ``scale`` multiplies values."""
        return (
            f"Rounding the commands of “{name}” to the task's {self.n_actions} actions"
            f" changes its value in the simulator by about {-self.error * scale:.2g}"
            f" (standard error {self.standard_error * scale:.1g})"
        )


def make_finer(
    task: ContinuousTask, log: ContinuousTransitions
) -> tuple[ContinuousTask, IntArray] | None:
    """Return the task with a level between each two, and where its old actions are.

    None if its actions are no grid of commands, if the finer ones were very many, or if
    the task does not step the old ones as before. ``log`` has the actions' numbers.
    """
    actions = task.actions
    if actions.ndim == 1:
        return None
    levels = [np.unique(column) for column in actions.T]
    if len(actions) == 1 or np.prod([len(x) for x in levels]) != len(actions):
        return None
    finer_levels = [
        np.sort(np.concatenate([each, (each[1:] + each[:-1]) / 2.0])) for each in levels
    ]
    if np.prod([float(len(each)) for each in finer_levels]) > MAX_FINER_COMMANDS:
        return None
    finer = np.array(list(itertools.product(*finer_levels)))
    is_same = (finer[None] == actions[:, None]).all(axis=2)
    if not is_same.any(axis=1).all():
        return None
    places: IntArray = is_same.argmax(axis=1)
    other = task.with_actions(finer)
    if not _steps_alike(task, other, places, log):
        return None
    return other, places


def has_only(log: ContinuousTransitions, actions: Array) -> bool:
    """Return whether more than half of a log's rows took one of ``actions``.

    It is so where either is given by numbers.
    """
    if log.action.ndim == 1 or actions.ndim == 1:
        return True
    rows = np.unique(np.linspace(0, len(log) - 1, MAX_POLICY_STATES).astype(np.int64))
    is_one = (log.action[rows, None] == actions[None]).all(axis=2).any(axis=1)
    return float(is_one.mean()) > MAX_ON_LEVELS


def make_finer_often(
    task: ContinuousTask, log: ContinuousTransitions, n_times: int
) -> ContinuousTask:
    """Return the task with finer actions, as often as possible up to a limit."""
    for _ in range(n_times):
        found = make_finer(task, log)
        if found is None:
            break
        task, places = found
        log = ContinuousTransitions(**log.columns() | {"action": places[log.action]})
    return task


def _steps_alike(
    task: ContinuousTask,
    finer: ContinuousTask,
    places: IntArray,
    log: ContinuousTransitions,
) -> bool:
    """Return whether a finer task steps the old actions as the task does.

    ``moves`` of a task may read its actions from elsewhere than ``self.actions``.
    """
    rows = np.unique(np.linspace(0, len(log) - 1, N_HELD_ROWS).astype(np.int64))
    states = log.state[rows]
    old = np.asarray(log.action[rows], dtype=np.int64)
    xi = np.random.default_rng(0).standard_normal((len(rows), task.n_disturbances))
    new = np.arange(len(rows)) % len(finer.actions)
    try:
        ours = task.moves(states, old, xi)
        theirs = finer.moves(states, places[old], xi)
        between = finer.moves(states, new, xi)
    except Exception:  # a user's task may raise anything for actions it does not know
        return False
    return bool(
        np.array_equal(ours.next_state, theirs.next_state)
        and np.array_equal(ours.reward, theirs.reward)
        and np.isfinite(between.next_state).all()
    )


def measure_rounding(
    finer: ContinuousTask, places: IntArray, policy: CommandPolicy, rollouts: Rollouts
) -> Rounding:
    """Measure what rounding to a task's actions does, by the finer task.

    ``places`` are those actions among the finer ones.
    """
    direct = CommandPolicy(policy.policy, finer.actions)

    def rounded(states: Array) -> Array:
        """Give the coarse policy's probabilities of the finer actions."""
        found = np.zeros((len(states), len(finer.actions)))
        found[:, places] = policy(states)
        return found

    returns = rollouts.compare([finer, finer], [rounded, direct])
    difference = returns[1] - returns[0]
    n = len(difference)
    return Rounding(
        len(places),
        RICHARDSON * float(difference.mean()),
        RICHARDSON * float(difference.std(ddof=1) / np.sqrt(n)) if n > 1 else np.inf,
    )


def measure_roundings(
    task: ContinuousTask,
    log: ContinuousTransitions,
    policies: Mapping[str, StatePolicy],
    rollouts: Rollouts,
) -> tuple[dict[StatePolicy, Rounding], ContinuousTask | None]:
    """Measure rounding for each policy that gives commands, and return the finer task.

    None where the task has no finer one.
    """
    given = [
        policy
        for policy in policies.values()
        if isinstance(policy, CommandPolicy) and policy.gives_commands(log.state[:1])
    ]
    found = make_finer(task, log) if given else None
    if found is None:
        return {}, None
    finer, places = found
    _progress.report_step("what rounding of commands does to the values")
    measured: dict[StatePolicy, Rounding] = {
        policy: measure_rounding(finer, places, policy, rollouts) for policy in given
    }
    return measured, finer


def include_rounding(estimate: Estimate, rounding: Rounding | None) -> Estimate:
    """Put the error of rounding into an estimate's interval, where it is too large."""
    if estimate.interval is None or rounding is None:
        return estimate
    lower, upper = estimate.interval
    if not rounding.is_too_large((upper - lower) / 2.0):
        return estimate
    most = MOST * rounding.error
    lower += min(most, 0.0)
    upper += max(most, 0.0)
    facts = estimate.diagnostics | {"rounding_error": rounding.error}
    return replace(estimate, interval=(lower, upper), diagnostics=facts)


def describe_rounding(
    name: str,
    policy: StatePolicy,
    log: ContinuousTransitions,
    roundings: Mapping[StatePolicy, Rounding],
    scale: float,
    *,
    is_counted: bool = False,
) -> str:
    """Describe what rounding a policy's commands does; "" where none is rounded.

    That is a difference in value where it was measured, else a distance of commands.
    With ``is_counted`` the intervals have that difference in them; what is cut off
    commands beyond the actions' range cannot be measured, and is in no interval.
    """
    if not isinstance(policy, CommandPolicy):
        return ""
    rounding = roundings.get(policy)
    distance, cut = _describe_distance(name, policy, log.state[:MAX_POLICY_STATES])
    if rounding is None or not distance:
        return distance + cut
    counted = " The intervals include this change." if is_counted else ""
    return f"{rounding.describe(name, scale)}.{counted}{cut}"


def _describe_distance(
    name: str, policy: CommandPolicy, states: Array
) -> tuple[str, str]:
    """Describe how far the task's commands are from a policy's, and how many are cut.

    Returns "" twice where they are the same.
    """
    distance, beyond = policy.rounding(states)
    if distance == beyond == 0.0:
        return "", ""
    cut = ""
    if beyond > 0.0:
        cut = (
            f" {beyond:.0%} of the policy's commands lie beyond the range of the task's"
            " and are cut to it."
        )
    text = (
        f"The commands of “{name}” are rounded to the task's {len(policy.actions)}"
        f" commands, by {distance:.2g} (root mean square in the log's states)."
    )
    return text, cut
