"""The policy whose worst value in a box is the largest, by robust policy iteration.

    V*(s) = max_a min_{P in U(s, a)} sum_s' P(s') (r(s, a, s') + gamma V*(s')),
    U(s, a) = {P : nu P_sim <= P <= mu P_sim, sum P = 1}.

Outside, a policy takes a better action wherever there is one; inside, the worst rows
for its values, then the values of these rows, until they settle (``robust``). Each
policy is at least as good as the one before in every state, so that the iteration ends
[1]. A deterministic policy attains the maximum, since each pair has a set of its own
[2].

*Certificate.* The worst rows P* for the values V of the policy are a model of the box,
and in it no policy is worth more than V by more than what it may gain at each step,

    epsilon = max_{s, a} [r(s, a) + gamma sum_s' P*(s' | s, a) V(s')] - V(s),

summed over time: epsilon / (1 - gamma). Over a horizon it is the sum of the steps' own
epsilons. At discount 1 it is epsilon max h for any h >= 0 with

    epsilon [P* h](s, a) - epsilon h(s) <= V(s) - [r + P* V](s, a)     for each (s, a),

because V + epsilon h then falls on average under every policy that ends in each model.
The longest expected time to an end by actions that are as good as the policy's own is
such an h, if it is finite.

Sources: [1] A. Hoffman and R. Karp, On nonterminating stochastic games, Management
Science 12, 1966. [2] G. Iyengar, Robust dynamic programming, Mathematics of Operations
Research 30, 2005.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from oee_tabular import _checks, _printing, _progress
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import dot, one_thread
from oee_tabular._results import checked
from oee_tabular.exact import (
    Model,
    optimal_policy,
    policy_system,
    reached_states,
    recurrent_states,
    values_or_zeros,
)
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.inference.evidence import Evidence, evidence_of
from oee_tabular.inference.robust import (
    extreme_value,
    require_end,
    settle_values,
    solve_rows,
)
from oee_tabular.mdp import FiniteMDP, optional_horizon_length, uniform_policy
from oee_tabular.typing import Array, BoolArray, IntArray

# of the largest value or reward: an action is better where it is by more
ACTION_TOLERANCE = 1e-11
MAX_ROUNDS = 1000  # of policies, and of longest times; fewer than ten are usual


@checked()
@dataclass(frozen=True, eq=False)
class RobustPolicy:
    """The policy with the largest worst value in a box, and how sure that is.

    Attributes
    ----------
    policy : ndarray of shape (S, A) or (T, S, A)
        The probabilities of the actions, 0 or 1; with a horizon T one policy for each
        step. Of equally good actions it has the first, but at discount 1 one that ends.
    value : float
        Its worst value, the lower end of its ``value_range`` in the box; a discounted
        sum, not normalised.
    gap : float
        The certificate: no policy has a worst value above ``value + gap``. It is
        rounding, and inf where there is no certificate (at discount 1, where an action
        that is as good as the policy's own may never end).

    See Also
    --------
    robust_policy : Compute such a policy.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> print(oee.robust_policy(oee.tasks.gridworld(4, slip=0.3), 0.5, 2.0))
    policy with the largest worst value: -12.78 at worst; discounted sum of rewards, not normalised
    """

    policy: Array
    value: float
    gap: float

    def __post_init__(self) -> None:
        if self.policy.ndim not in (2, 3):
            raise ArgumentError(
                "policy",
                "must have shape (states, actions) or (steps, states, actions); it has"
                f" {self.policy.shape}",
            )

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        sure = ""
        # by more than the last digits that are printed
        if not self.gap <= 1e-6 * max(abs(self.value), 1e-300):
            sure = f", at most {self.gap:.2g} below the best"
            if np.isinf(self.gap):
                sure = ", without a certificate that it is the best"
        return (
            f"policy with the largest worst value: {self.value:.4g} at worst{sure};"
            f" {_printing.SUM}"
        )

    def _repr_html_(self) -> str:
        rows = [
            ("worst value in the box", f"{self.value:.6g}"),
            ("at most below the best", f"{self.gap:.2g}"),
            ("policy", f"array of shape {self.policy.shape}"),
        ]
        return _printing.facts(
            f"Policy with the largest worst value: {_printing.SUM}", rows
        )


@suggest_keywords
@one_thread
def robust_policy(
    simulator: FiniteMDP,
    lower_ratio: float | None,
    upper_ratio: float | None,
    *,
    horizon: int | None = None,
) -> RobustPolicy:
    """Compute the policy whose worst value in a box around the simulator is largest.

    The box is Assumption V.1, nu P <= P' <= mu P, for each state-action pair by itself:
    the policy maximises the lower end of ``value_range``. It is *no safe improvement*
    over a policy that runs: it prepares for the worst model of the box, and what it
    gives up for that in the real one is often more than what it saves.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator, with transition probabilities P.
    lower_ratio : float or None
        Lower bound nu in [0, 1]; 0 or None sets no lower bound.
    upper_ratio : float or None
        Upper bound mu in [1, inf]; inf or None sets no upper bound.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.

    Returns
    -------
    RobustPolicy
        The policy, its worst value, and by how much another may have a larger one.

    Raises
    ------
    ValueError
        If an argument is out of its range, or if the discount is 1, there is no
        horizon, and no policy ends in every model of the box, or one of those that the
        iteration meets does not.

    See Also
    --------
    value_range : Compute the range of values of a given policy in the box.
    oee_tabular.optimal_policy : Compute the policy that is best in the simulator.

    Notes
    -----
    Robust policy iteration: the worst rows of each pair for the policy's values, the
    values in these rows, then a better action where there is one by more than 1e-11 of
    the largest value. With a horizon it is backward induction, and the target may
    change from step to step. At discount 1 without a horizon the best is that of the
    policies that end in every model. Cost: some ten to thirty policy evaluations, and
    O(nnz log nnz) each.

    Examples
    --------
    A bold action pays 2 and fails at times; the cautious one pays 1. Where failures
    may be twice as frequent as the simulator says, caution is better:

    >>> import oee_tabular as oee
    >>> rows = [[[1.0, 0.0], [0.9, 0.1]], [[0.0, 1.0]] * 2]
    >>> simulator = oee.FiniteMDP(rows, [[1.0, 2.0], [0.0, 0.0]], [1, 0], 0.9)
    >>> oee.optimal_policy(simulator).argmax(axis=1).tolist()
    [1, 0]
    >>> found = robust_policy(simulator, 0.5, 2.0)
    >>> found.policy.argmax(axis=1).tolist(), round(found.value, 9), found.gap < 1e-9
    ([0, 0], 10.0, True)
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    steps = optional_horizon_length(
        _checks.optional_horizon(horizon), simulator, kept=float(simulator.rewards.size)
    )
    every = uniform_policy(simulator)
    evidence = evidence_of(simulator, every, steps, None, lower_ratio, upper_ratio)
    with _progress.show_steps(only_terminal=True):
        return _find_policy(evidence, steps)


def _find_policy(evidence: Evidence, steps: int | None) -> RobustPolicy:
    """Find the policy whose worst value is the largest."""
    simulator = evidence.model
    if steps is not None:
        return _induce_backward(evidence, steps)
    if simulator.discount < 1.0:
        found = _improve(replace(evidence, policy=optimal_policy(simulator)))
        excess = max(float(found.excess.max()), 0.0)
        best = dot(simulator.initial, found.values) + excess / (1 - simulator.discount)
    else:
        found, best = _improve_to_an_end(evidence)
    free = np.full(len(evidence.n), np.inf)
    value = extreme_value(replace(evidence, policy=found.policy), free, -1.0).bound
    return RobustPolicy(found.policy, value, max(best - value, 0.0))


class Backup(NamedTuple):
    """Hold one step of the robust Bellman equation.

    ``least`` (S, A) are certified lower bounds of min P (r + gamma V), and ``attained``
    (S, A) upper bounds: what a model of the box gives, and its rounding.
    """

    least: Array
    attained: Array

    @property
    def tolerance(self) -> float:
        """Return the difference up to which two actions count as equally good."""
        return ACTION_TOLERANCE * float(np.abs(self.least).max())


class Found(NamedTuple):
    """Hold a policy that no action improves by more than the tolerance.

    ``values`` (S,) are its own in the worst rows ``p`` (entries,), and ``excess``
    (S, A) is at most by how much one step of each action is better.
    """

    policy: Array
    values: Array
    excess: Array
    p: Array


def _back_up(evidence: Evidence, values: Array, p: Array) -> Backup:
    """Take one step of the robust Bellman equation; ``p`` gets the worst rows."""
    model = evidence.model
    rows = evidence.rows
    ahead = evidence.transition_rewards + model.discount * values[rows.arrival]
    free = np.full(len(evidence.n), np.inf)
    bound, _ = solve_rows(evidence, free, -ahead, np.zeros(len(free)), p)
    shape = model.rewards.shape
    n_roundings = int(np.diff(rows.indptr).max()) + 4
    rounding = n_roundings * np.finfo(float).eps * float(np.abs(ahead).max())
    least = -bound.reshape(shape)
    attained = rows.sums(p * ahead).reshape(shape) + rounding
    if not model.available.all():
        # an action that cannot be taken is worse than any other, by a finite number,
        # for policies multiply it by 0
        below = -1.0 - 3.0 * float(np.abs(attained).max() + np.abs(values).max())
        least = np.where(model.available, least, below)
        attained = np.where(model.available, attained, below)
    return Backup(least, attained)


def _settle(evidence: Evidence, p: Array, left_out: BoolArray) -> tuple[Array, Backup]:
    """Compute the policy's worst values (S,), and one step from them.

    Only the rows that the policy takes are solved until the values settle, which is
    most of the time.
    """
    policy = evidence.policy
    taken = evidence.rows.select(policy.reshape(-1) > 0.0)
    entries = taken.entries
    own = replace(
        evidence,
        rows=taken,
        phat=evidence.phat[entries],
        n=evidence.n[taken.number],
        low=evidence.low[entries],
        high=evidence.high[entries],
    )
    rewards = evidence.transition_rewards[entries]
    least = np.zeros(policy.shape)

    def back_up(values: Array) -> Array:
        """Return (S,) the least mean of r + gamma V, and write the rows into ``p``."""
        worst = p[entries]
        ahead = rewards + evidence.model.discount * values[taken.arrival]
        free = np.full(len(own.n), np.inf)
        bound, _ = solve_rows(own, free, -ahead, np.zeros(len(free)), worst)
        p[entries] = worst
        least.reshape(-1)[taken.number] = -bound
        return np.asarray((policy * least).sum(axis=1))

    values, *_ = settle_values(evidence, p, -1.0, left_out, back_up)
    return values, _back_up(evidence, values, p)


def _improve(evidence: Evidence, left_out: BoolArray | None = None) -> Found:
    """Improve the evidence's deterministic policy until no action is better.

    States that are ``left_out`` keep the value 0. At discount 1 every policy met must
    end in every model of the box.
    """
    model = evidence.model
    if left_out is None:
        left_out = np.zeros(model.n_states, dtype=np.bool_)
    choices: Array = np.eye(model.n_actions)
    p = evidence.phat.copy()
    earlier: set[bytes] = set()
    while True:
        actions = evidence.policy.argmax(axis=1)
        earlier.add(actions.tobytes())
        _progress.report_step(f"the worst case of policy {len(earlier)}")
        if model.discount == 1.0:
            require_end(evidence)
        values, step = _settle(evidence, p, left_out)
        best = step.least.max(axis=1)
        own = (evidence.policy * step.least).sum(axis=1)
        first = (step.least >= (best - step.tolerance)[:, None]).argmax(axis=1)
        is_better = (best > own + step.tolerance) & ~left_out
        improved = np.where(is_better, first, actions)
        if improved.tobytes() in earlier:
            break
        evidence = replace(evidence, policy=choices[improved])
    # of equals the first; at discount 1 an equal action may never end, so the one that
    # was evaluated stays
    if model.discount < 1.0 and (first != actions).any():
        evidence = replace(evidence, policy=choices[first])
        values, step = _settle(evidence, p, left_out)
    return Found(evidence.policy, values, step.attained - values[:, None], p)


def _improve_to_an_end(evidence: Evidence) -> tuple[Found, float]:
    """Find the best of the policies that end in every model, at discount 1.

    It also returns a bound on the worst value of any of them. The uniform policy ends
    in every model if any policy does; the first one that is improved takes, among
    actions that are equally good for it, those that surely come nearer to an end.
    """
    simulator = evidence.model
    require_end(evidence)
    is_met = reached_states(simulator, evidence.policy)
    mean_rewards = (evidence.policy * simulator.rewards).sum(axis=1)
    is_end = recurrent_states(
        policy_system(simulator, evidence.policy * is_met[:, None]),
        np.where(is_met, mean_rewards, 0.0),
        simulator.names,
    )
    is_end |= ~is_met
    # values are needed in every state that any policy may come to
    everywhere = replace(evidence, model=simulator.with_initial(is_met / is_met.sum()))
    _, step = _settle(everywhere, evidence.phat.copy(), ~is_met)
    best = step.least.max(axis=1, keepdims=True)
    actions = _find_ending_actions(
        everywhere, step.least >= best - step.tolerance, is_end
    )
    choices: Array = np.eye(simulator.n_actions)
    found = _improve(replace(everywhere, policy=choices[actions]), ~is_met)
    beyond = _bound_by_times(everywhere, found, is_end)
    return found, dot(simulator.initial, found.values) + beyond


def _find_ending_actions(
    evidence: Evidence, allowed: BoolArray, is_end: BoolArray
) -> IntArray:
    """Choose an allowed action in each state, one that ends in every model if it can.

    State after state is added from which an allowed action must lead, with some
    probability in every model, to those that are there; the ends are there first.
    """
    rows = evidence.rows
    actions: IntArray = allowed.argmax(axis=1)
    is_done = is_end.copy()
    while True:
        is_away = ~is_done[rows.arrival]
        least = rows.sums(np.where(is_away, 0.0, evidence.low))
        room = rows.sums(np.where(is_away, evidence.high, 0.0))
        must_lead = (least > 0.0) | (room < 1.0 - _checks.SUM_TOLERANCE)
        leading = allowed & must_lead.reshape(allowed.shape) & ~is_done[:, None]
        is_new = leading.any(axis=1)
        if not is_new.any():
            return actions
        actions[is_new] = leading.argmax(axis=1)[is_new]
        is_done |= is_new


def _bound_by_times(evidence: Evidence, found: Found, is_end: BoolArray) -> float:
    """Bound by how much a policy that ends can be better than the one found.

    The bound is epsilon max h, h (S,) the longest expected time to an end by the
    policy's actions and those that are worse by less than what h adds; inf if that time
    is infinite.
    """
    simulator = evidence.model
    rows = evidence.rows
    excess = np.where(is_end[:, None], -np.inf, found.excess)
    epsilon = float(excess.max(initial=0.0))
    moving = np.broadcast_to(~is_end[:, None], excess.shape).astype(np.float64)
    clock: Model = replace(
        evidence.with_rows(found.p), rewards=moving, reward_data=None
    )
    choices: Array = np.eye(simulator.n_actions)
    actions = found.policy.argmax(axis=1)
    for _ in range(MAX_ROUNDS):
        try:
            times = values_or_zeros(clock, choices[actions])
        except DivergentKernelError:
            return np.inf
        ahead = rows.sums(found.p * times[rows.arrival]).reshape(excess.shape)
        # where V + epsilon h does not fall, up to rounding of h
        rounding = ACTION_TOLERANCE * float(times.max())
        is_longer = epsilon * (ahead - times[:, None] - rounding) > -excess
        if not is_longer.any():
            return epsilon * float(times.max())
        longest = np.where(is_longer, ahead, -np.inf).argmax(axis=1)
        actions = np.where(is_longer.any(axis=1), longest, actions)
    return np.inf


def _induce_backward(evidence: Evidence, steps: int) -> RobustPolicy:
    """Find the best action of each step, from the last one back."""
    model = evidence.model
    choices: Array = np.eye(model.n_actions)
    policy = np.empty((steps, *model.rewards.shape))
    values = np.zeros(model.n_states)
    p = evidence.phat.copy()
    gap = 0.0
    for t in range(steps - 1, -1, -1):
        _progress.report_step(f"step {t} of {steps}, from the last one back")
        step = _back_up(evidence, values, p)
        policy[t] = choices[step.least.argmax(axis=1)]
        values = step.least.max(axis=1)
        excess = float((step.attained.max(axis=1) - values).max())
        gap = max(excess, 0.0) + model.discount * gap
    return RobustPolicy(policy, dot(model.initial, values), gap)
