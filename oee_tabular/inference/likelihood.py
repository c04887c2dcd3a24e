"""Profile likelihood intervals: J of all models that the log does not reject.

    {J(P') : sum_x n_x KL(phat_x || P'_x) <= c},

c half the chi-square quantile with one degree of freedom, asymptotically of the
confidence asked for [1]; on tables the same as CoinDICE's empirical likelihood [2].
Rows without data, if the policy reaches them, are set to their extreme in the box (the
whole simplex on the simulator's support without one), or, with a factor, to their
extreme near the estimated rows (``Evidence.near``).

An end is stationary where its rows are best for the gradient of J at themselves. P(x)
are the rows that maximise sum x P over the set (``_likelihood``: P_i = phat_i / (1 + e
- u_i)), G_k = d(s) pi(a | s) (r + gamma V(s')) is the gradient of J at P_k, and the
ascent to the upper end (with -G: to the lower) is

    P_k = P(x_k),   x_{k+1} = x_k + a (G_k - x_k);

where J(P_k) is worse than J(P_{k-1}), a is halved and the step from x_{k-1} is made
again; else a grows by a fifth, up to 1. Rows that are best for x + a (G - x) lie on an
ascent of J from those that are best for x. An iteration is two linear solves, for V and
d, and a pass over the rows.

J is not concave in the rows, and where the frequencies never lead to a reward it is
flat: ascents are made from several directions, the same each time, and the farthest
ends are taken. No ascent proves that its end is the farthest one. With a horizon rows
without data may be best mixed; these are approached slowly.

Where rows share parameters, by a tie or by features phi, the target is assumed to be
P_theta proportional to P exp(theta . phi) in each row, phi the indicators of the keys
under a tie. f(theta) is the negative log-likelihood of the counts with a unit Gaussian
penalty on standardised directions (``ratio.prior.ridge``), theta_hat its minimiser, and
the interval holds J(P_theta) over {theta : f(theta) - f(theta_hat) <= c}. An end is
found by linearising J (Frank and Wolfe). With g the gradient of J at theta_k,
theta_{k+1} lies between theta_k and the maximiser of s g . theta over the set, s = 1 or
-1, as far as J grows. The set is convex, so that the maximiser is argmin f(theta) - c'
s g . theta for the one c' > 0 that puts it on the boundary: a bracketed root in c',
each value by Newton's method. At the fixed point g and f' are parallel, the first-order
condition of an end. Pairs that were never recorded follow from theta; where the tie or
the features are wrong the interval need not cover, however many transitions there are.

Sources: [1] A. Owen, Empirical Likelihood, 2001. [2] B. Dai et al., CoinDICE:
Off-policy confidence interval estimation, NeurIPS 2020.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincinv

from oee_tabular._progress import Watch
from oee_tabular.estimators import Problem
from oee_tabular.exact import policy_value, solvers, transition_gradient
from oee_tabular.exact.reweighted import with_rows
from oee_tabular.exact.system import Kernel, System, as_readonly
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference import _likelihood as kernels
from oee_tabular.inference.evidence import Evidence
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import optional_horizon_length
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.features import feature_array
from oee_tabular.ratio.prior._ridge import sum_columns
from oee_tabular.ratio.prior.directions import Directions, own_directions
from oee_tabular.ratio.prior.newton import Risk, minimise, penalized_risk
from oee_tabular.ratio.prior.ridge import fit_ridge
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.ratio.ties import tie_keys
from oee_tabular.typing import (
    Array,
    BoolArray,
    FrameLike,
    IntArray,
    IntArrayLike,
    RealArrayLike,
)

# a key for each transition of the simulator: an array, a data frame, or a function of
# (state, action, next_state) arrays
TieLike: TypeAlias = IntArrayLike | FrameLike | Callable[..., object]
# features of each transition, in the same forms
FeaturesLike: TypeAlias = RealArrayLike | FrameLike | Callable[..., object]

# states up to which LAPACK takes no longer than sweeps (0.1 ms)
MAX_DENSE_STATES = 128
MAX_DRAWN_DIRECTIONS = 16  # that ascents of small problems begin from
# with no transition missing, 0 of 800 ends needed an ascent from a drawn direction
DRAWS_PER_MISSING_TRANSITION = 4
# transitions of the simulator, times steps of a value, times drawn directions
MAX_DRAW_WORK = 10**6
# steps with a horizon that take as long as a value without one
STEPS_PER_INFINITE_VALUE = 15
# of the distance between end and maximum-likelihood value, by which the last iterations
# may move an end
END_TOLERANCE = 3e-8
# the same for each ascent of a large problem, before the best of them is continued
SCOUT_TOLERANCE = 1e-3
# of the residual that V and d of the previous rows leave in the equations of new rows:
# what a solve may leave of it in large problems
WARM_SOLVE_TOLERANCE = 1e-3
COLD_SOLVE_TOLERANCE = 1e-9  # the same, where no previous rows are near


class End(NamedTuple):
    """An end of the interval, and the model that has it.

    ``rows`` are the probabilities of this model, ``divergence`` their sum of n KL (c
    where the set binds), and ``change`` the change of J in the last iteration.
    ``promised`` is the most that rows of the set have beyond the end to first order,
    max G (P'' - P'); it is 0 at a stationary point. ``is_final`` is False where time was
    over before the end was found; it is then an inner bound.
    """

    value: float
    rows: Array
    promised: float
    iterations: int
    divergence: float
    change: float
    is_final: bool


class PolicyRows(NamedTuple):
    """The rows that the policy reaches in some model, in the form that kernels read.

    The models are on the simulator's support. ``entries`` are the entries of the
    evidence; states are numbered anew; ``n_steps`` is 0 without a horizon. Rewards are
    divided by ``unit``, the largest one, so that floats hold the squares of values.
    """

    entries: Any
    indptr: IntArray
    state: IntArray
    column: IntArray
    weight: Array
    pay: Array
    phat: Array
    n: Array
    low: Array
    high: Array
    initial: Array
    edges: Any
    columns: Any
    edge: IntArray
    discount: float
    n_steps: int
    unit: float

    @classmethod
    def from_evidence(cls, evidence: Evidence) -> PolicyRows:
        """Select the rows that the policy reaches, and number their states."""
        model = evidence.model
        rows = evidence.rows.select(evidence.reachable)
        states, place = np.unique(rows.state, return_inverse=True)
        n = len(states)
        number = np.zeros(model.n_states, dtype=np.int64)
        number[states] = np.arange(n)
        state = rows.spread(place)
        column = number[rows.arrival]
        unit = float(np.abs(evidence.transition_rewards).max()) or 1.0
        edges, edge = np.unique(state * n + column, return_inverse=True)
        return cls(
            rows.entries,
            rows.indptr,
            state,
            column,
            rows.spread(evidence.policy.reshape(-1)[rows.number]),
            evidence.transition_rewards[rows.entries] / unit,
            evidence.phat[rows.entries],
            evidence.n[rows.number],
            evidence.low[rows.entries],
            evidence.high[rows.entries],
            model.initial[states],
            as_readonly(np.searchsorted(edges, np.arange(n + 1) * n).astype(np.uint32)),
            as_readonly((edges % n).astype(np.uint32)),
            edge,
            model.discount,
            optional_horizon_length(evidence.horizon, model, kept=model.n_states) or 0,
            unit,
        )

    @property
    def has_data(self) -> BoolArray:
        """Return whether the log has the row of each entry."""
        return np.repeat(self.n > 0, np.diff(self.indptr))

    @property
    def is_sparse(self) -> bool:
        """Return whether V and d are solved for by the solvers of ``exact``."""
        return len(self.initial) > MAX_DENSE_STATES and not self.n_steps


class Ascent(NamedTuple):
    """The state of an ascent, as kernels read and write it.

    ``p`` are the rows, found for ``last_x``, and ``gradient`` is the gradient of J
    there (negative on the way down). ``x`` is the next direction, ``trial`` its rows,
    with their V (``values``), d (``visits``) and gradient of J (``slope``).
    """

    numbers: Any
    p: Array
    last_x: Array
    gradient: Array
    x: Array
    trial: Array
    values: Array
    visits: Array
    slope: Array


def likelihood_ends(
    evidence: Evidence, confidence: float, watch: Watch | None = None
) -> tuple[End, End]:
    """Find the smallest and the largest value in the set.

    Ascents begin along the gradient at the frequencies, along r + gamma V of the
    simulator, and along drawn directions. They end when the ``watch`` says that time is
    over, half of it for each end.
    """
    watch = Watch(None) if watch is None else watch
    rows = PolicyRows.from_evidence(evidence)
    base = _begin(rows, rows.phat)
    own = _begin(rows, evidence.rows.weights[rows.entries])
    # half of chi-square's quantile
    base.numbers["limit"] = float(gammaincinv(0.5, confidence))
    drawn = _draw_directions(rows)
    ahead = rows.pay + rows.discount * own.values[rows.column]
    low, high = (
        _find_end(
            rows, evidence, base, [sign * base.slope, sign * ahead, *drawn], sign, part
        )
        for sign, part in ((-1.0, watch.part(0.5)), (1.0, watch))
    )
    return low, high


def _find_end(
    rows: PolicyRows,
    evidence: Evidence,
    base: Ascent,
    directions: list[Array],
    sign: float,
    watch: Watch,
) -> End:
    """Find the farthest end of ascents from several directions."""
    is_large = len(rows.initial) > MAX_DENSE_STATES
    end = base
    is_final = True
    for x in directions:
        if watch.is_over:
            is_final = False
            break
        ascent = Ascent(*(part.copy() for part in base))
        ascent.x[:] = x
        ascent.numbers["sign"] = sign
        tolerance = SCOUT_TOLERANCE if is_large else END_TOLERANCE
        is_final &= _ascend(rows, ascent, tolerance, watch)
        gain = sign * (ascent.numbers["value"] - end.numbers["value"])
        if end is base or gain > 0.0:
            end = ascent
    if is_large and end is not base:
        is_final &= _ascend(rows, end, END_TOLERANCE, watch)
    _fill_values(rows, end.p, end, COLD_SOLVE_TOLERANCE)
    end.trial[:] = end.p
    numbers = end.numbers[0]
    kernels.best_rows(
        rows,
        sign * end.slope,
        1.0,
        numbers["limit"],
        kernels.LIMIT_TOLERANCE,
        0.0,
        end.trial,
    )
    gain = sign * end.slope * (end.trial - end.p)
    promised = np.where(rows.has_data, gain, 0.0).sum()
    whole = evidence.phat.copy()
    whole[rows.entries] = end.p
    value = policy_value(
        evidence.with_rows(whole), evidence.policy, horizon=evidence.horizon
    )
    promised = rows.unit * float(promised)
    change = rows.unit * float(numbers["change"])
    return End(
        value,
        whole,
        promised,
        int(numbers["iterations"]),
        float(numbers["divergence"]),
        change,
        is_final,
    )


def _draw_directions(rows: PolicyRows) -> Array:
    """Draw directions for ascents, one a line: r + gamma V of random V.

    In every other direction only the best next state of each row counts.
    """
    lengths = np.diff(rows.indptr)
    is_observed = (rows.phat > 0.0) & rows.has_data
    n_steps = rows.n_steps or STEPS_PER_INFINITE_VALUE
    affordable = max(MAX_DRAW_WORK // (len(rows.phat) * n_steps), 1)
    wanted = DRAWS_PER_MISSING_TRANSITION * int((~is_observed).sum())
    number = min(wanted, affordable, MAX_DRAWN_DIRECTIONS)
    # a fixed seed: the same directions each time
    drawn = np.random.default_rng(5).random((number, len(rows.initial)))[:, rows.column]
    largest = np.repeat(
        np.maximum.reduceat(drawn, rows.indptr[:-1], axis=1), lengths, axis=1
    )
    drawn[1::2] = (drawn == largest)[1::2]
    return drawn


def _begin(rows: PolicyRows, p: Array) -> Ascent:
    """Begin an ascent at rows p, whose J is the reference."""
    n = len(rows.initial)
    k = len(p)
    # a uniform d, from which the first solve of a large problem begins
    start = np.zeros(n)
    if rows.is_sparse:
        start = np.full(n, 1.0 / ((1.0 - rows.discount) * n))
    last_x, gradient, x, trial, slope = np.zeros((5, k))
    ascent = Ascent(
        np.zeros(1, dtype=kernels.NUMBERS),
        p,
        last_x,
        gradient,
        x,
        trial,
        np.zeros(n),
        start,
        slope,
    )
    value = _fill_values(rows, p, ascent, COLD_SOLVE_TOLERANCE)
    ascent.numbers["value"] = value
    ascent.numbers["reference"] = value
    ascent.numbers["step"] = 1.0
    ascent.numbers["change"] = np.inf
    return ascent


def _ascend(rows: PolicyRows, ascent: Ascent, tolerance: float, watch: Watch) -> bool:
    """Run or continue an ascent, until iterations hardly move its end.

    ``tolerance`` is the share of the distance from the reference by which they may.
    False is returned where time was over before that.
    """
    ascent.numbers["settled"] = tolerance
    ascent.numbers["quiet"] = 0.0
    if len(rows.initial) <= MAX_DENSE_STATES:
        kernels.ascend(rows, ascent)
        return True
    is_last = False
    while not is_last:
        if watch.is_over:
            return False
        kernels.propose(rows, ascent)
        value = _fill_values(rows, ascent.trial, ascent, WARM_SOLVE_TOLERANCE)
        is_last = kernels.accept(ascent, value)
    return True


def value_of_rows(rows: PolicyRows, p: Array) -> float:
    """Return J at rows p."""
    return rows.unit * float(_begin(rows, p).numbers["value"][0])


def _fill_values(rows: PolicyRows, p: Array, ascent: Ascent, tolerance: float) -> float:
    """Return J at rows p, and fill V, d and the gradient of J of the ascent.

    In large problems V and d are corrected from those of the previous rows, until a
    share ``tolerance`` of the residual is left. J = mu V + d residual is then far more
    precise.
    """
    values = ascent.values
    visits = ascent.visits
    if not rows.is_sparse:
        return float(kernels.fill_values(rows, p, values, visits, ascent.slope))
    weights = rows.weight * p
    share = np.bincount(rows.edge, weights)
    rewards = np.bincount(rows.state, weights * rows.pay).astype(np.float64)
    system = Kernel(rows.edges, rows.columns, as_readonly(share), rows.discount)
    solution = solvers.answer(System(system), rewards, values, tolerance)
    # the residual, weighted by d, corrects J to second order
    value = rows.initial @ solution.x + visits @ solution.missed
    values[:] = solution.x
    transposed = System(system, True)
    visits[:] = solvers.answer(transposed, rows.initial, visits, tolerance).x
    kernels.fill_gradient(rows, values, visits, ascent.slope)
    return float(value)


MAX_LINEARISATIONS = 200
# of the distance between end and estimate, by which the last linearisation may still
# have moved an end
LINEARISATION_TOLERANCE = 1e-7
# of log c': beyond it rounding is all that the set has to give
MAX_LOG_FORCE = 60.0
MIN_STEP = 1e-3  # of the way to the maximiser of the linearisation


def shared_directions(
    simulator: FiniteMDP, tie: TieLike | None, features: FeaturesLike | None
) -> Directions:
    """Check a tie or features, and return the directions that they allow.

    Both are as in ``transition_ratio``.
    """
    if tie is not None and features is not None:
        raise ValueError(
            "tie and features must not be given together: they are two different models"
        )
    rows = Rows.of(simulator)
    if tie is not None:
        return own_directions(simulator, keys=tie_keys(tie, rows, simulator))
    array = feature_array(features, simulator)
    spread = np.abs(rows.center(array)).max(axis=0)
    size = np.maximum(np.abs(array).max(axis=0), 1e-300)
    constant = np.flatnonzero(spread <= 1e-12 * size)
    if constant.size:
        raise ArgumentError(
            "features",
            "must differ between the next states of some state-action pair; feature"
            f" {constant[0]} is constant in every one",
        )
    return own_directions(simulator, array)


def shared_ends(
    problem: Problem, policy: Array, directions: Directions, level: float
) -> tuple[float, float, float]:
    """Find both ends, and J at theta_hat, where rows share parameters."""
    rows = Rows.of(problem.simulator)
    horizon = problem.horizon
    counts = aligned_counts(problem.counts, problem.simulator)
    visited = rows.select((rows.sums(counts) > 0) & (np.diff(rows.indptr) > 1))
    if not len(visited):
        raise ArgumentError(
            "log",
            "must have a transition of a state-action pair with more than one next"
            " state; it has none",
        )
    observed = counts[visited.entries]
    columns = directions.columns(visited)
    fit = fit_ridge(directions, visited, observed, None, by_evidence=False)
    mass = visited.sums(observed)
    pulled = sum_columns(columns, observed, visited.n_actions)
    action = np.zeros((len(fit.theta), 1))
    action[0] = 1.0  # no parameters of an action alone
    least = penalized_risk(columns, Risk(mass, pulled), fit.theta, fit.penalty)[0]
    limit = least + float(gammaincinv(0.5, level))  # half of chi-square's quantile

    def value(theta: Array) -> float:
        """Return J of the model with parameters theta."""
        target = with_rows(problem.model, replace(fit, theta=theta).at(rows))
        return policy_value(target, policy, horizon=horizon)

    def gradient(theta: Array) -> Array:
        """Return the gradient of J in theta."""
        tilt = replace(fit, theta=theta)
        target = with_rows(problem.model, tilt.at(rows))
        slope = transition_gradient(target, policy, horizon=horizon)
        pull = tilt.pull(rows, slope * target.transitions.data)
        return np.asarray(action * pull.sum(axis=0))

    def minimise_against(force: Array) -> Array:
        """Return argmin f(theta) - force . theta."""
        statistics = Risk(mass, pulled + force[:-1])
        theta, *_ = minimise(columns, statistics, fit.theta, fit.penalty, 1e-22)
        return np.asarray(action * theta)

    def maximise_on_boundary(force: Array) -> Array:
        """Return argmax force . theta where f is at most the limit."""
        force = force / np.abs(force).max()

        def excess(log_c: float) -> float:
            """Return by how much f exceeds the limit at the minimiser for c'."""
            theta = minimise_against(np.exp(log_c) * force)
            risk = penalized_risk(columns, Risk(mass, pulled), theta, fit.penalty)[0]
            return float(risk - limit)

        low = high = 0.0
        while excess(high) < 0 and high < MAX_LOG_FORCE:
            low = high
            high = high + 2.0
        while excess(low) > 0 and low > -MAX_LOG_FORCE:
            high = low
            low = low - 2.0
        if excess(low) < 0.0 < excess(high):
            low = brentq(excess, low, high, xtol=1e-10)
        return minimise_against(np.exp(low) * force)

    middle = value(fit.theta)

    def find_end(sign: float) -> float:
        """Return the farthest J in the direction ``sign``."""
        theta = fit.theta
        end = middle
        for _ in range(MAX_LINEARISATIONS):
            force = sign * gradient(theta)
            if not np.abs(force).max() > 0:
                break
            step = maximise_on_boundary(force) - theta
            length = 1.0
            last = end
            # the set is convex: what lies between two members is one
            while length > MIN_STEP:
                end = value(theta + length * step)
                if not sign * end <= sign * last:
                    break
                length *= 0.5
            tolerance = LINEARISATION_TOLERANCE * abs(end - middle)
            if sign * (end - last) <= tolerance:
                return sign * max(sign * end, sign * last)
            theta = theta + length * step
        return end

    return find_end(-1.0), find_end(1.0), middle
