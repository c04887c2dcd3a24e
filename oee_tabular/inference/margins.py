"""What an interval owes to moves that were dropped, and to a simulator that was made of samples itself.

Dropped moves led anywhere. Of the moves from (s, a) the target makes a share q_sa that the simulator rules out:

    P(. | s, a) = (1 - q_sa) P'(. | s, a) + q_sa U_sa,     P' on the simulator's support, U_sa any distribution at all.

The log has the share's counts; where it led is not believed. J is a ratio of two functions linear in each U_sa, so its extremes
have every U_sa at one state, u_sa = argmax (argmin) r + gamma V (with a horizon J is a polynomial; there, too, one state is
taken). Given these, the dropped moves of (s, a) are counts of moves to u_sa, and an end of the interval is that of these
counts: q and P' vary together in one likelihood set. u is improved at the end's own V until it stays: of small MDPs one in
some tens has places that are further out still, by a hundredth or two of the width. A move whose reward the simulator does not
define pays the most (the least) that it pays for any.

A simulator's own sampling (``FiniteMDP.from_env``, ``from_log``), to first order at the maximum-likelihood model: D_sa the
discounted time in (s, a), m samples of the simulator, n of the log (with a horizon the last sum goes over steps too, V having
those that are left):

    variance        Var_mu(V) / m_starts + sum_x,s' (D_x p_xs')^2 Var(mean reward of the move)
    what may lie beyond the sampled support, each way
                    sum_x D_x q_x |extreme of r + gamma V - E_p (r + gamma V)|,   q_x = f_x / (m_x + n_x)

q_x is Good and Turing's estimate of the probability of moves never met, f_x how many were met once [1]; 1 in a row without any
sample, which was filled in. Such moves may lead anywhere.

Source: [1] I. Good, The population frequencies of species and the estimation of population parameters, Biometrika 40, 1953.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, canonical, row_of_entry
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, occupancy, policy_value, state_values
from oee_tabular.exact.system import policy_kernel
from oee_tabular.inference.evidence import Evidence, evidence_of
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.arrays import csr_from_entries
from oee_tabular.mdp.horizons import horizon_length, total_discount

ROUNDS = 20  # of improving u; it stays after two or three
ALLOWED = 0.5  # probability of the stray moves in the model whose support the counts need; no value depends on it


class End(Protocol):
    """What an end of an interval has."""

    @property
    def value(self) -> float:
        """J."""

    @property
    def rows(self) -> Array:
        """The probabilities of the model that has it."""


Found = TypeVar("Found", bound=End)


def stray_end(problem: Problem, evidence: Evidence, sign: float, end: Callable[[Evidence], Found]) -> Found:
    """The end (sign 1: upper) that ``end`` finds where the dropped moves led to where J is most extreme.

    Cost: two or three times that of ``end``; with a horizon T also (rows with dropped moves) x S x T.
    """
    rows = np.flatnonzero(problem.dropped)
    model = evidence.with_rows(evidence.phat)
    best: Found | None = None
    tried: IntArray | None = None
    for _ in range(ROUNDS):
        chosen = _places(problem, model, evidence.policy, rows, sign)
        if tried is not None and np.array_equal(chosen, tried):
            break
        tried = chosen
        led = _led(problem, evidence.policy, rows, chosen, sign)
        found = end(led)
        if best is not None and sign * (found.value - best.value) <= 0.0:
            break
        best, model = found, led.with_rows(found.rows)
    assert best is not None
    return best


def stray_share(problem: Problem, evidence: Evidence) -> float:
    """The share of the policy's discounted time whose moves may have been of those that were dropped: sum d_sa q_sa."""
    if not problem.dropped.any():
        return 0.0
    time = occupancy(evidence.with_rows(evidence.phat), evidence.policy, horizon=evidence.horizon).reshape(-1)
    return float(time @ (problem.dropped / np.maximum(problem.dropped + evidence.n, 1.0)))


class _Fixed(NamedTuple):
    value: float
    rows: Array


def stray_swing(problem: Problem, evidence: Evidence) -> tuple[float, float]:
    """By how much J of the frequencies may fall and rise with where the dropped moves led; 0, 0 where none was dropped."""
    if not problem.dropped.any():
        return 0.0, 0.0

    def fixed(found: Evidence) -> _Fixed:
        value = policy_value(found.with_rows(found.phat), found.policy, horizon=found.horizon)
        return _Fixed(value, found.phat)

    middle = fixed(evidence).value
    if evidence.horizon is None:
        low, high = (stray_end(problem, evidence, sign, fixed).value for sign in (-1.0, 1.0))
    else:
        low, high = (_step_by_step(problem, evidence, evidence.horizon, sign) for sign in (-1.0, 1.0))
    return max(middle - low, 0.0), max(high - middle, 0.0)


def _step_by_step(problem: Problem, evidence: Evidence, horizon: int, sign: float) -> float:
    """J of the frequencies where dropped moves lead to the extreme of each step: beyond that of any places that stay."""
    model, policy, gamma = evidence.with_rows(evidence.phat), evidence.policy, evidence.model.discount
    rows, values = np.flatnonzero(problem.dropped), np.zeros(len(evidence.policy))
    share = (problem.dropped / np.maximum(problem.dropped + evidence.n, 1.0))[rows]
    for _ in range(horizon_length(horizon, model)):
        worth = model.rewards.reshape(-1) + gamma * (model.transitions @ values)
        _, led = _extremes(problem.model, rows, gamma * values[None, :], np.ones(len(rows)), sign)
        worth[rows] = (1.0 - share) * worth[rows] + share * led
        values = (policy * worth.reshape(policy.shape)).sum(axis=1)
    return float(evidence.model.initial @ values)


def _places(problem: Problem, model: ReweightedModel, policy: Array, rows: IntArray, sign: float) -> IntArray:
    """Of each of the rows, the state to go to that is worth most, sign * (r + gamma V)."""
    ahead, weight = _ahead(model, policy, rows // problem.model.n_actions, problem.horizon)
    return _extremes(problem.model, rows, ahead, weight, sign)[0]


def _extremes(simulator: FiniteMDP, rows: IntArray, ahead: Array, weight: Array, sign: float) -> tuple[IntArray, Array]:
    """Of each of the rows the state with the most (sign -1: least) weight * pay + ahead, and how much that is."""
    table = simulator.transition_rewards
    if table is None:
        places = np.array(np.broadcast_to((sign * ahead).argmax(axis=1), len(rows)))
        reached = ahead[np.arange(len(rows)) if len(ahead) > 1 else 0, places]
        return places, weight * simulator.rewards.reshape(-1)[rows] + reached
    every = _extreme_pay(simulator, sign)
    places, worth = np.empty(len(rows), dtype=np.int64), np.empty(len(rows))
    for k, row in enumerate(rows):  # one at a time: (rows, S) tables of pay would not fit
        entries = slice(table.indptr[row], table.indptr[row + 1])
        pay = np.full(simulator.n_states, every)
        pay[table.indices[entries]] = table.data[entries]
        total = weight[k] * pay + ahead[k if len(ahead) > 1 else 0]
        places[k] = np.argmax(sign * total)
        worth[k] = total[places[k]]
    return places, worth


def _ahead(model: ReweightedModel, policy: Array, states: IntArray, horizon: int | None) -> tuple[Array, Array]:
    """gamma V, (1, S), and weights 1 of the pay; with a horizon sums over the time in each state, (rows, S), sum_t of
    gamma^t d_t(s) gamma V_{t+1}, and the weights sum_t gamma^t d_t(s).

    A state never reached has those of its first step.
    """
    gamma = model.discount
    if horizon is None:
        return gamma * state_values(model, policy)[None, :], np.ones(len(states))
    n_states = len(policy)
    pay = (policy * model.rewards).sum(axis=1)
    mixed = policy_kernel(model, policy)
    steps = horizon_length(horizon, model)
    _checks.require_memory(float(steps * n_states + len(states) * (steps + n_states)), "horizon", horizon)
    values = np.zeros((steps, n_states))  # after step t
    for t in range(steps - 2, -1, -1):
        values[t] = pay + gamma * (mixed @ values[t + 1])
    there = np.zeros((len(states), steps))
    law = np.array(model.initial)
    for t in range(steps):
        there[:, t] = law[states] * gamma**t
        law = law @ mixed
    there[there.sum(axis=1) == 0.0, 0] = 1.0
    return gamma * (there @ values), there.sum(axis=1)


def _extreme_pay(simulator: FiniteMDP, sign: float) -> float:
    assert simulator.reward_data is not None
    return float(sign * (sign * simulator.reward_data).max())


def _led(problem: Problem, policy: Array, rows: IntArray, to: IntArray, sign: float) -> Evidence:
    """The evidence of a log whose dropped moves of each row led to a state, in a model where they can."""
    model = problem.model
    shape = model.transitions.shape
    share = np.zeros(shape[0])
    share[rows] = ALLOWED
    kept = model.transitions.copy()
    kept.data = kept.data * (1.0 - share)[row_of_entry(kept)]
    transitions = canonical(kept + csr_from_entries(rows, to, share[rows], shape), drop_zeros=True)
    rewards: object = model.rewards
    if model.transition_rewards is not None:
        own, defined = align(model.transition_rewards, transitions)
        data = np.where(defined, own, _extreme_pay(model, sign))
        rewards = csr_from_entries(row_of_entry(transitions), transitions.indices, data, shape)
    other = FiniteMDP(transitions, rewards, model.initial, model.discount, terminal_state=model.terminal_state)
    counts = canonical(problem.counts + csr_from_entries(rows, to, problem.dropped[rows], shape), drop_zeros=True)
    return evidence_of(other, counts, problem.horizon, policy)


class Margin(NamedTuple):
    """J of the frequencies, the variance that the sampling adds, what unmet moves may take and add, their share of the time."""

    value: float
    variance: float
    down: float
    up: float
    unmet_share: float

    def widened(self, end: float, sign: float, z: float) -> float:
        """An end of an interval for a simulator that is known, as that for the sampled one."""
        half = float(np.hypot(max(sign * (end - self.value), 0.0), z * np.sqrt(self.variance)))
        return self.value + sign * (half + (self.up if sign > 0 else self.down))


def sampling_margin(problem: Problem, evidence: Evidence) -> Margin | None:
    """None where the simulator is known."""
    sampling = problem.simulator.sampling
    if sampling is None:
        return None
    model, policy, horizon = evidence.model, evidence.policy, evidence.horizon
    fitted = evidence.with_rows(evidence.phat)
    values = state_values(fitted, policy, horizon=horizon)
    time = occupancy(fitted, policy, horizon=horizon).reshape(-1) * total_discount(model.discount, horizon)
    unmet = _unmet(evidence, sampling.pairs)
    start = max(float(model.initial @ values**2) - float(model.initial @ values) ** 2, 0.0) / sampling.starts
    error = 0.0
    if sampling.reward_error is not None:
        each, _ = align(sampling.reward_error, model.transitions)
        error = float((time[evidence.rows] * evidence.phat) ** 2 @ each)
    down, up = (
        (float(time @ (unmet * _beyond(evidence, values, sign))) for sign in (-1.0, 1.0))
        if horizon is None
        else _beyond_by_step(evidence, fitted, unmet, horizon)
    )
    share = float(time @ unmet) / total_discount(model.discount, horizon)
    return Margin(policy_value(fitted, policy, horizon=horizon), start + error, down, up, share)


def _beyond_by_step(evidence: Evidence, fitted: ReweightedModel, unmet: Array, horizon: int) -> tuple[float, float]:
    """What may lie beyond, down and up, each step's with the V of the steps that are left."""
    policy, gamma = evidence.policy, fitted.discount
    values, beyond = np.zeros(len(policy)), np.zeros((len(policy), 2))
    for _ in range(horizon_length(horizon, fitted)):
        each = np.column_stack([unmet * _beyond(evidence, values, sign) for sign in (-1.0, 1.0)])
        ahead = (each + gamma * (fitted.transitions @ beyond)).reshape(*policy.shape, 2)
        beyond = np.einsum("sa,sak->sk", policy, ahead)
        worth = fitted.rewards + gamma * (fitted.transitions @ values).reshape(policy.shape)
        values = (policy * worth).sum(axis=1)
    down, up = evidence.model.initial @ beyond
    return float(down), float(up)


def _unmet(evidence: Evidence, pairs: Array) -> Array:
    """(S*A,) q of each row."""
    known = ~np.isfinite(pairs)
    simulator = evidence.model.transitions.data * np.where(known, 0.0, pairs)[evidence.rows]
    number = np.rint(simulator) + np.where(evidence.n > 0, evidence.n, 0.0)[evidence.rows] * evidence.phat
    once = np.bincount(evidence.rows, np.abs(number - 1.0) < 0.5, len(pairs))
    total = np.where(known, 1.0, pairs) + evidence.n
    return np.where(known, 0.0, np.where(total > 0, np.minimum(once / np.maximum(total, 1.0), 1.0), 1.0))


def _beyond(evidence: Evidence, values: Array, sign: float) -> Array:
    """(S*A,) by how much the best (sign 1) or worst r + gamma V of any move differs from the row's own mean."""
    model, gamma = evidence.model, evidence.model.discount
    extreme = gamma * sign * float((sign * values).max())
    ahead = gamma * np.bincount(evidence.rows, evidence.phat * values[model.transitions.indices], len(evidence.n))
    if model.reward_data is None:
        return np.asarray(np.maximum(sign * (extreme - ahead), 0.0))
    paid = np.bincount(evidence.rows, evidence.phat * model.reward_data, len(evidence.n))
    extreme += sign * float((sign * model.reward_data).max())
    return np.asarray(np.maximum(sign * (extreme - ahead - paid), 0.0))
