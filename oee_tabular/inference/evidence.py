"""Evidence: the log's frequencies of each pair, and the bounds of the box."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oee_tabular import _checks
from oee_tabular._sparse import align
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, largest_reward, occupancy, with_rows
from oee_tabular.mdp import FiniteMDP, Rows, check_policy, possible_sums
from oee_tabular.typing import Array, BoolArray, Csr, IntArray, PolicyLike

# values may be 1e14 times as large at usual discounts, and their squares must be floats
MAX_REWARD = 1e140
REWARD_ERRORS = 4.0  # of a sampled mean reward: the true one is hardly farther off
N_ROWS_SHOWN = 5  # of the rows that an error names
MAX_HALVINGS = 80  # of an interval of log factors, to the last digit


@dataclass(frozen=True, eq=False)
class Evidence:
    """A problem as sets of distributions on the entries of the simulator's transitions.

    ``phat`` (entries,) are the log's frequencies, and the simulator's probabilities in
    rows without data. ``n`` (S*A,) are the counts of the rows, ``low`` and ``high``
    (entries,) the box lower_ratio * P and upper_ratio * P (at most 1).
    """

    model: FiniteMDP
    policy: Array
    horizon: int | None
    rows: Rows
    phat: Array
    n: Array
    low: Array
    high: Array
    has_box: bool

    @cached_property
    def is_stochastic(self) -> BoolArray:
        """Return whether each row (S*A,) has more than one next state."""
        return np.diff(self.rows.indptr) > 1

    @cached_property
    def transition_rewards(self) -> Array:
        """Return the reward r(s, a, s') of each entry."""
        data = self.model.reward_data
        if data is None:
            return self.rows.spread(self.model.rewards.reshape(-1))
        return data

    @cached_property
    def reachable(self) -> BoolArray:
        """Return whether the policy can reach each row (S*A,) in some model.

        The models are all on the simulator's support.
        """
        return reachable_rows(self)

    @cached_property
    def fitted(self) -> ReweightedModel:
        """Return the maximum-likelihood model."""
        return self.with_rows(self.phat)

    @cached_property
    def time_share(self) -> Array:
        """Return the share (S*A,) of the policy's time in each pair, as fitted."""
        time = occupancy(self.fitted, self.policy, horizon=self.horizon)
        return time.reshape(-1)

    def with_rows(self, probabilities: Array) -> ReweightedModel:
        """Return the model with other probabilities on its entries, zeros kept."""
        return with_rows(self.model, probabilities)

    def near(self, estimated: Array, factor: float) -> Evidence:
        """Return the set of models near estimated rows, as robust evaluation reads it.

        Q are the estimated rows (of ``estimated``, one number an entry). In a row with
        data P' is Q. In a row without, it is between Q / factor and factor * Q and
        within the box, as near to Q as the box allows. Q takes the place of ``phat``.
        """
        rows = self.rows
        never = rows.spread(self.n) == 0
        centre = estimated / rows.spread(rows.sums(estimated))
        if self.has_box:
            boxed = _scale_into(rows, centre, self.low, self.high)
            centre = np.where(never, boxed, centre)
        low = np.maximum(self.low, centre / factor)
        high = np.minimum(self.high, centre * factor)
        return replace(
            self,
            phat=centre,
            low=np.where(never, low, centre),
            high=np.where(never, high, centre),
        )


def gather(
    problem: Problem,
    policy: PolicyLike,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
) -> Evidence:
    """Collect counts and box, checked: 0 <= lower_ratio <= 1 <= upper_ratio."""
    pi = check_policy(policy, problem.model)
    counts = problem.counts
    return evidence_of(
        problem.model, pi, problem.horizon, counts, lower_ratio, upper_ratio
    )


def evidence_of(
    model: FiniteMDP,
    policy: Array,
    horizon: int | None,
    counts: Csr | None,
    lower_ratio: float | None,
    upper_ratio: float | None,
) -> Evidence:
    """Collect the evidence of a model, a checked policy, and counts or None."""
    nu, mu = check_ratios(lower_ratio, upper_ratio)
    rows = Rows.of(model)
    observed = np.zeros(len(rows.weights))
    if counts is not None:
        observed = align(counts, model.transitions)[0]
    n = rows.sums(observed)
    phat = np.where(rows.spread(n) > 0, rows.frequencies(observed), rows.weights)
    # inf * 0 would be nan
    high = np.ones(len(phat))
    if np.isfinite(mu):
        high = np.minimum(mu * rows.weights, 1.0)
    has_box = lower_ratio is not None or upper_ratio is not None
    return Evidence(
        model, policy, horizon, rows, phat, n, nu * rows.weights, high, has_box
    )


def check_ratios(
    lower_ratio: float | None, upper_ratio: float | None
) -> tuple[float, float]:
    """Return the ends of the box as floats, 0 and infinity where none is given."""
    nu = 0.0
    if lower_ratio is not None:
        nu = _checks.number_in(lower_ratio, "lower_ratio", 0.0, 1.0)
    mu = np.inf
    if upper_ratio is not None:
        mu = _checks.number_in(upper_ratio, "upper_ratio", 1.0, np.inf, infinite=True)
    return nu, mu


def _scale_into(rows: Rows, p: Array, low: Array, high: Array) -> Array:
    """Multiply each row by the factor with which it sums to 1 when clipped to a box.

    Rows that are in the box stay as they are. The sum grows with the factor, which is
    found by halving an interval of its logarithm.
    """
    is_outside = rows.sums(((p < low) | (p > high)).astype(float)) > 0
    if not is_outside.any():
        return p
    least = np.full(len(rows.number), -60.0)
    most = np.full(len(rows.number), 60.0)
    for _ in range(MAX_HALVINGS):
        middle = 0.5 * (least + most)
        scaled = np.clip(p * np.exp(rows.spread(middle)), low, high)
        is_short = rows.sums(scaled) < 1.0
        least = np.where(is_short, middle, least)
        most = np.where(is_short, most, middle)
    scaled = np.clip(p * np.exp(rows.spread(0.5 * (least + most))), low, high)
    return np.where(rows.spread(is_outside), scaled, p)


def require_squares(model: FiniteMDP) -> None:
    """Refuse rewards so large that floats cannot hold the squares of values.

    What multiplies two values would be nan.
    """
    largest = largest_reward(model)
    if largest > MAX_REWARD:
        raise ValueError(
            f"the simulator's rewards must be at most {MAX_REWARD:g}, so that"
            f" floats hold the squares of values; they reach {largest:g}: give them in"
            " a larger unit"
        )


def unrecorded_share(evidence: Evidence) -> float:
    """Return the share of the policy's time in stochastic rows without data."""
    never = (evidence.n == 0) & evidence.is_stochastic
    return float(evidence.time_share[never].sum())


def possible_values(
    problem: Problem, evidence: Evidence, z: float
) -> tuple[float, float]:
    """Return between which ends J lies, whatever the target's transitions are.

    The rewards of the pairs that the policy can take, at their least and at their most
    in every step, are summed with their weights gamma^t. Where every payment ends the
    episode, there is one at most: a probability of success is in [0, 1]. Where the
    simulator is known from samples, a step may lead where none did, and the rewards are
    those of all pairs, each with ``REWARD_ERRORS`` standard errors of its mean, or z if
    that is more, and all rewards of the log. The ends are infinite where endless rewards
    have no discount.
    """
    model = evidence.model
    if model.sampling is not None:
        return _possible_by_samples(problem, evidence, max(z, REWARD_ERRORS))
    taken = evidence.rows.spread((evidence.policy > 0).reshape(-1))
    if not taken.any():
        return -np.inf, np.inf
    rewards = evidence.transition_rewards[taken]
    lowest, highest = float(rewards.min()), float(rewards.max())
    once = (-np.inf, np.inf)
    if _is_paid_once(evidence, taken):
        once = (min(lowest, 0.0), max(highest, 0.0))
    if evidence.horizon is None and model.discount == 1.0:
        return once
    least, most = possible_sums(
        lowest, highest, evidence.horizon, model.discount, ends=False
    )
    return max(least, once[0]), min(most, once[1])


def _possible_by_samples(
    problem: Problem, evidence: Evidence, n_errors: float
) -> tuple[float, float]:
    """Return between which ends J lies by the rewards that were sampled or logged.

    An episode may be over, so that a step may pay nothing. The log's rewards are those
    of its rows, of which some may be left out elsewhere.
    """
    simulator = problem.simulator
    sampling = simulator.sampling
    assert sampling is not None
    if evidence.horizon is None and simulator.discount == 1.0:
        return -np.inf, np.inf
    means = replace(evidence, model=simulator).transition_rewards
    beside = np.zeros(len(means))
    if sampling.reward_error is not None:
        variance, _ = align(sampling.reward_error, simulator.transitions)
        beside = n_errors * np.sqrt(variance)
    log = problem.log
    logged = [evidence.transition_rewards, [0.0]]
    if isinstance(log, Transitions):
        logged.append([] if log.reward is None else log.reward)
    elif log.reward_min is not None and log.reward_max is not None:
        logged += [log.reward_min, log.reward_max]
    rewards = np.concatenate([means - beside, means + beside, *logged])
    return possible_sums(
        float(np.nanmin(rewards)),
        float(np.nanmax(rewards)),
        evidence.horizon,
        simulator.discount,
        ends=False,
    )


def _is_paid_once(evidence: Evidence, taken: BoolArray) -> bool:
    """Return whether every entry that pays leads to where nothing is paid any more.

    Of the entries that the policy takes, those of such a state lead back to it and pay
    nothing, in every model on the simulator's support.
    """
    state, _, following = (each[taken] for each in evidence.rows.transitions)
    pays = evidence.transition_rewards[taken] != 0.0
    goes_on = np.zeros(evidence.model.n_states, dtype=np.bool_)
    goes_on[state[pays | (following != state)]] = True
    return not goes_on[following[pays]].any()


def reachable_rows(evidence: Evidence, steps: int | None = None) -> BoolArray:
    """Find the rows (S*A,) that the policy can reach, or reach within some steps."""
    taken = evidence.policy > 0
    size = evidence.model.n_states
    state, _, following = evidence.rows.select(taken.reshape(-1)).transitions
    # a node of its own leads to every start
    starts = np.flatnonzero(evidence.model.initial > 0)
    tail = np.append(state, np.full(len(starts), size))
    head = np.append(following, starts)
    graph = sparse.csr_array(
        (np.ones(len(tail)), (tail, head)), shape=(size + 1, size + 1)
    )
    is_reached = np.zeros(size + 1, dtype=np.bool_)
    if steps is None or steps >= size:
        order = csgraph.breadth_first_order(graph, size, return_predecessors=False)
        is_reached[order] = True
    else:
        distances = csgraph.dijkstra(
            graph, indices=[size], unweighted=True, limit=steps
        )
        is_reached = np.isfinite(distances[0])
    return np.asarray((is_reached[:size, None] & taken).reshape(-1))


def describe_rows(evidence: Evidence, rows: IntArray) -> str:
    """Name the first of some rows as state-action pairs, with their counts."""
    n_actions = evidence.model.n_actions
    names = evidence.model.names
    named = ", ".join(
        f"({names.pair(*divmod(int(r), n_actions))}, n={evidence.n[r]:g})"
        for r in rows[:N_ROWS_SHOWN]
    )
    if len(rows) > N_ROWS_SHOWN:
        named += f" and {len(rows) - N_ROWS_SHOWN} more"
    return named
