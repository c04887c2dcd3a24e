"""Profile likelihood intervals: J of all models that the log does not reject.

    {J(P') : sum_x n_x KL(phat_x || P'_x) <= c},

c half the chi-square quantile with one degree of freedom, asymptotically of the
confidence asked for [1]; on tables the same as CoinDICE's empirical likelihood [2].
Rows without data, if the policy reaches them, are set to their extreme in the box (the
whole simplex on the simulator's support without one), or, with a factor, to their
extreme near the estimated rows (``Evidence.near``).

An end is stationary where its rows are best for the gradient of J at themselves. P(x)
are the rows that maximise sum x P over the set (``_likelihood``: P_i = phat_i / (1 + e_r
- u_i), u_i = tau x_i / n_r, with tau for the set's limit c and e_r for the row's sum),
G_k = d(s) pi(a | s) (r + gamma V(s')) is the gradient of J at P_k, and the ascent to
the upper end (with -G: to the lower) is

    P_k = P(x_k),   x_{k+1} = x_k + a (G_k - x_k);

where J(P_k) is worse than J(P_{k-1}), a is halved and the step from x_{k-1} is made
again; else a grows by a fifth, up to 1. Rows that are best for x + a (G - x) lie on an
ascent of J from those that are best for x. An iteration is two linear solves, for V and
d, and a pass over the rows.

The same ascent finds the ends of a gain, J(pi) - J(pi_0): both values are J of the same
rows, G is the difference of their gradients, and what the policies share cancels.

J is not concave in the rows, and where the frequencies never lead to a reward it is
flat: ascents are made from several directions, the same each time, and the farthest
ends are taken. No ascent proves that its end is the farthest one. With a horizon rows
without data may be best mixed; these are approached slowly. J may then be farthest
inside the set as well, where no limit holds it: in small problems the ways from end to
end and from the frequencies to each are searched, which lie in the set (it is convex).

Sources: [1] A. Owen, Empirical Likelihood, 2001. [2] B. Dai et al., CoinDICE:
Off-policy confidence interval estimation, NeurIPS 2020.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize_scalar
from scipy.special import gammaincinv

from oee_tabular._progress import Watch
from oee_tabular.exact import Kernel, System, as_readonly, policy_value, solvers
from oee_tabular.inference._likelihood import (
    ROUNDING,
    fill_best_rows,
    fill_gradient,
    fill_steps,
)
from oee_tabular.inference.evidence import Evidence
from oee_tabular.inference.robust import order_by_row
from oee_tabular.inference.vertices import change_rows
from oee_tabular.mdp import optional_horizon_length
from oee_tabular.typing import (
    Array,
    BoolArray,
    IntArray,
)

# states up to which LAPACK takes no longer than sweeps (0.1 ms)
MAX_DENSE_STATES = 128
MAX_DRAWN_DIRECTIONS = 16  # that ascents of small problems begin from
# with no transition missing, 0 of 800 ends needed an ascent from a drawn direction
DRAWS_PER_MISSING_TRANSITION = 4
# transitions of the simulator, times steps of a value, times drawn directions
MAX_DRAW_WORK = 10**6
# of the way from one model to another, at which J is looked at first
SHARES_OF_WAY = np.arange(1, 16) / 16.0
LEAST_FARTHER = 1e-6  # of the distance of the ends: less is no end farther out
# tests/benchmarks/steps_inside.py compares these three: with 5 to 80 steps, promises
# down to 1e-5 and a tenth to ten times the work no end of 574 comes nearer, and none of
# 592 kept aside; with a promise of 1e-2 five of the latter do. Where steps zigzag, an
# end may still be 1e-3 of the width short of the best.
MAX_STEPS_INSIDE = 40
VALUES_OF_STEP_INSIDE = 100  # about: three ways, of some 30 places each
# transitions of the simulator, times steps of a value, times values of steps inside
MAX_INSIDE_WORK = 3 * 10**7
LEAST_PROMISED = 1e-4  # of the distance of the ends: less is looked for no farther
# steps with a horizon that take as long as a value without one
STEPS_PER_INFINITE_VALUE = 15
# of the distance between end and maximum-likelihood value, by which the last iterations
# may move an end
END_TOLERANCE = 3e-8
# the same of a rough end in a small problem: it chooses what is searched thoroughly
ROUGH_TOLERANCE = 1e-4
# the same for each ascent, before the best of them are continued
SCOUT_TOLERANCE = 1e-3
# of that distance: an ascent that is farther behind the best one then is left; of 1368
# ends on 91 families none was lost by more than 1e-7 of the width
CONTENDING_SHARE = 0.02
# of a probability: ascents whose rows differ by less lead to one end
SAME_ROWS = 0.02
# the same of rows at which ascents go on, which have a way before them
SAME_SCOUTS = 1e-3
# of the residual that V and d of the previous rows leave in the equations of new rows:
# what a solve may leave of it in large problems
WARM_SOLVE_TOLERANCE = 1e-3
COLD_SOLVE_TOLERANCE = 1e-9  # the same, where no previous rows are near
MAX_ROUGH_DIRECTIONS = 2  # drawn ones, of a rough search
MAX_CHANGED = 10  # times that the rows of one end are changed
# of the distance from the reference: what a farther end must add
LEAST_TURN = 1e-7
# entries, times steps of a value, times values: what turns of rows may take
MAX_TURN_WORK = 3 * 10**6
MIN_VALUES_OF_ALL = 1000  # that these may be where the rows of every end are changed
MAX_ITERATIONS = 200  # of an ascent; ten are usual
# iterations in a row that move the end by less than a share ``tolerance`` of its
# distance from the reference, after which an ascent ends
MAX_QUIET_ITERATIONS = 4
LIMIT_TOLERANCE = 1e-8  # of the limit: how closely it is met in the end
# of the last iteration's change: how far off J of an iteration may be
VALUE_TOLERANCE = 1e-3
# factor of the step after one that was no worse; a step that doubles is refused every
# other time
STEP_GROWTH = 1.2
MIN_STEP = 1e-3  # smaller steps are taken even where J falls
STILL_CHANGE = 1e-9  # of a probability: a smaller change of all of them is none
TINY = 1e-300


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


class Part(NamedTuple):
    """One policy of the sum whose ends are sought, sum_k sign_k J(pi_k).

    ``weight`` is pi_k(a | s) at each entry.
    """

    sign: float
    weight: Array


@dataclass(frozen=True, eq=False)
class PolicyRows:
    """The rows that a policy reaches in some model, or one of two policies.

    The models are on the simulator's support. Row r of state state[r] has the entries
    indptr[r] .. indptr[r+1]; entry i leads to column[i], pays pay[i], and edge[i] is
    the place of (state, column) among the edges of the graph of states. ``parts`` are
    the policies whose values are summed, by their signs. ``entries`` are the entries of
    the evidence; states are numbered anew; ``n_steps`` is 0 without a horizon. Rewards
    are divided by ``unit``, the largest one, so that floats hold the squares of values.
    """

    entries: Any
    indptr: IntArray
    state: IntArray
    column: IntArray
    parts: tuple[Part, ...]
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
    def from_evidence(
        cls, evidence: Evidence, minus: Array | None = None
    ) -> PolicyRows:
        """Select the rows that the policies reach, and number their states.

        The parts are J of the evidence's policy and, where ``minus`` is given, less J of
        that policy, of shape (S, A).
        """
        model = evidence.model
        reached = evidence.reachable
        signed = [(1.0, evidence.policy)]
        if minus is not None:
            reached = reached | replace(evidence, policy=minus).reachable
            signed.append((-1.0, minus))
        rows = evidence.rows.select(reached)
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
            tuple(
                Part(sign, rows.spread(policy.reshape(-1)[rows.number]))
                for sign, policy in signed
            ),
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

    @cached_property
    def row(self) -> IntArray:
        """Return the row of each entry."""
        return np.repeat(np.arange(len(self.n)), np.diff(self.indptr))

    @cached_property
    def has_data(self) -> BoolArray:
        """Return whether the log has the row of each entry."""
        return np.asarray(self.n[self.row] > 0)

    @cached_property
    def weighted(self) -> Array:
        """Return an array (rows,) above 0 where a gradient is weighted by the time.

        For one policy the time does not matter in rows without data, and r + gamma V
        does not vanish where it is 0. Of two policies it says which one counts.
        """
        return self.n if len(self.parts) == 1 else np.ones_like(self.n)

    @cached_property
    def without_data(self) -> IntArray:
        """Return the entries of rows without data, in the order of the rows."""
        return np.flatnonzero(~self.has_data)

    @cached_property
    def cell(self) -> IntArray:
        """Return the place of each entry in a matrix of states by states."""
        return self.state * len(self.initial) + self.column

    @cached_property
    def identity(self) -> Array:
        """Return the unit matrix of the states."""
        return np.eye(len(self.initial))

    @cached_property
    def row_without_data(self) -> IntArray:
        """Return the row of each entry that is ``without_data``."""
        return self.row[self.without_data]

    @cached_property
    def takes_one(self) -> bool:
        """Return whether each row without data may lead to one next state alone."""
        own = self.without_data
        return bool((self.low[own] <= 0.0).all() and (self.high[own] >= 1.0).all())

    @cached_property
    def work(self) -> tuple[Array, IntArray, Array, Array]:
        """Return arrays for what ``fill_best_rows`` computes of entries and rows."""
        n = len(self.n)
        return (
            np.zeros(len(self.phat)),
            np.zeros(n, dtype=np.int64),
            np.zeros(n),
            np.zeros(n),
        )

    def order(self, x: Array) -> IntArray:
        """Return the entries in the order in which rows without data take them.

        It is empty where each takes the best one alone.
        """
        own = self.without_data
        if self.takes_one:
            return own[:0]
        order = np.arange(len(x))
        order[own] = own[order_by_row(x[own], self.row_without_data)]
        return order

    def sums(self, values: Array) -> Array:
        """Sum the entries of each row."""
        return np.add.reduceat(values, self.indptr[:-1])

    @property
    def may_mix(self) -> bool:
        """Return whether rows without data may be best mixed; J alone is monotone."""
        return self.n_steps > 0 or len(self.parts) > 1

    @property
    def is_sparse(self) -> bool:
        """Return whether V and d are solved for by the solvers of ``exact``."""
        return len(self.initial) > MAX_DENSE_STATES and not self.n_steps


@dataclass(eq=False)
class Ascent:
    """The state of an ascent to the end on the side of ``sign``.

    ``p`` are the rows, found for ``last_x``, ``value`` is J of them, ``divergence``
    their sum of n KL, and ``gradient`` the gradient of J there (negative on the way
    down); ``change`` is the change of J in the last iteration. ``limit`` is c, ``tau`` the
    multiplier that met it last, ``step`` is a, and ``slack`` how far off J of the next
    rows may be. ``x`` is the next
    direction; ``values`` and ``visits`` are V and d of each policy in the rows that
    were evaluated last, and ``slope`` the gradient of J there. ``reference`` is J of the
    frequencies.
    """

    p: Array
    last_x: Array
    gradient: Array
    x: Array
    values: list[Array]
    visits: list[Array]
    slope: Array
    value: float
    limit: float = 0.0
    sign: float = 1.0
    reference: float = 0.0
    step: float = 1.0
    tau: float = 0.0
    change: float = np.inf
    divergence: float = 0.0
    slack: float = 0.0
    n_quiet: int = 0
    n_iterations: int = 0

    def towards(self, sign: float, x: Array) -> Ascent:
        """Return an ascent of its own from here, on a side and along a direction."""
        # V and d are replaced by new arrays, never written into
        return replace(
            self,
            sign=sign,
            x=x.copy(),
            values=self.values.copy(),
            visits=self.visits.copy(),
        )

    def propose(self, rows: PolicyRows) -> tuple[Array, float]:
        """Return the rows P(x) that are best for x, and their sum of n KL.

        P_i = phat_i / (1 + e_r - u_i),   sum n KL = limit.

        The limit is met as closely as the last step was long.
        """
        width = abs(self.value - self.reference) + TINY
        self.slack = VALUE_TOLERANCE * min(self.change, width)
        share = min(max(self.slack / width, LIMIT_TOLERANCE), 1e-3)
        trial, self.tau, reached = best_rows(rows, self.x, self.limit, share, self.tau)
        if rows.may_mix and self.step < 1.0:
            trial = blend(rows, self.step, trial, self.p)
        return trial, reached

    def accept(self, trial: Array, value: float, reached: float, least: float) -> bool:
        """Take the trial rows, or halve the step; return whether that was the last.

        x_{k+1} = x_k + a (G_k - x_k),   a halved where J is worse, else a -> min(1, 1.2
        a).

        ``value`` is J of the trial rows, at which the field ``slope`` is its gradient, and
        ``least`` the share of the distance from the reference by which iterations must
        move the end.
        """
        gain = self.sign * (value - self.value)
        is_first = self.n_iterations == 0
        is_last = self.n_iterations >= MAX_ITERATIONS - 1
        fall = max(2.0 * self.slack, 1e-12 * max(1.0, abs(self.value)))
        is_worse = gain < -fall and self.step >= MIN_STEP and not is_first
        self.n_iterations += 1
        if is_worse:
            self.step *= 0.5
        else:
            # An ascent ends where J has hardly changed for some iterations, or in one in
            # which the rows have not changed either.
            if not is_first:
                self.change = abs(gain)
            enough = least * abs(value - self.reference)
            is_still = abs(gain) <= enough + ROUNDING * abs(self.reference)
            self.n_quiet = self.n_quiet + 1 if is_still else 0
            if is_still and not is_last:
                is_last = self.n_quiet >= MAX_QUIET_ITERATIONS or bool(
                    np.abs(trial - self.p).max() <= STILL_CHANGE
                )
            # drawn directions get the gradient's size, so that the two can be mixed
            if is_first:
                size = max(float(np.abs(self.x).sum()), TINY)
                self.x = self.x * (float(np.abs(self.slope).sum()) / size)
            self.value = value
            self.divergence = reached
            self.step = min(1.0, STEP_GROWTH * self.step)
            self.p = trial
            self.last_x = self.x
            self.gradient = self.sign * self.slope
        self.x = self.last_x + self.step * (self.gradient - self.last_x)
        return is_last


def best_rows(
    rows: PolicyRows, x: Array, limit: float, tolerance: float, tau: float
) -> tuple[Array, float, float]:
    """Return the rows that are best for ``x``, tau, and their sum of n KL.

    The limit is met to a share ``tolerance``; ``tau`` is a guess, or 0.
    """
    p = np.empty(len(x))
    tau, reached = fill_best_rows(
        rows.indptr,
        rows.phat,
        rows.n,
        rows.low,
        rows.high,
        rows.order(x),
        x,
        limit,
        tolerance,
        tau,
        *rows.work,
        p,
    )
    return p, tau, reached


def blend(rows: PolicyRows, share: float, new: Array, p: Array) -> Array:
    """Return new rows; of mass that goes all to one state, only ``share`` moves.

    P_i = share new_i + (1 - share) (mass / mass before) P_i in rows without data, and
    for states that the log never reached.
    """
    is_free = ~rows.has_data | (rows.phat == 0.0)
    mass = rows.sums(np.where(is_free, new, 0.0))
    had = rows.sums(np.where(is_free, p, 0.0))
    kept = np.zeros(len(mass))
    both = (mass > 0.0) & (had > 0.0)
    kept[both] = (1.0 - share) * mass[both] / had[both]
    factor = np.where(kept > 0.0, share, 1.0)
    mixed = factor[rows.row] * new + kept[rows.row] * p
    return np.where(is_free, mixed, new)


def likelihood_ends(
    evidence: Evidence,
    confidence: float,
    watch: Watch | None = None,
    *,
    minus: Array | None = None,
) -> tuple[End, End]:
    """Find the smallest and the largest value in the set.

    With a policy ``minus``, (S, A), they are those of the gain, J of the evidence's
    policy less J of this one, both in the same model. Ascents begin along the gradient
    at the frequencies, along r + gamma V of the simulator, and along drawn directions.
    They end when the ``watch`` says that time is over, half of it for each end.
    """
    watch = Watch(None) if watch is None else watch
    search = Search.begin(evidence, confidence, minus)
    # half of the time for each end
    low = search.find_end(-1.0, watch.part(0.5))
    high = search.find_end(1.0, watch)
    return (
        search.leave_limit(low, high, -1.0, watch),
        search.leave_limit(high, low, 1.0, watch),
    )


@dataclass(frozen=True, eq=False)
class Search:
    """A search for the ends of a value, or of a gain.

    ``base`` is at the frequencies, ``ahead`` is r + gamma V of the simulator, and
    ``drawn`` are the drawn directions, one a line.
    """

    evidence: Evidence
    minus: Array | None
    rows: PolicyRows
    base: Ascent
    ahead: Array
    drawn: Array

    @classmethod
    def begin(
        cls, evidence: Evidence, confidence: float, minus: Array | None = None
    ) -> Search:
        """Begin at the frequencies, for a limit of half of chi-square's quantile."""
        rows = PolicyRows.from_evidence(evidence, minus)
        base = _begin(rows, rows.phat)
        own = _begin(rows, evidence.rows.weights[rows.entries])
        base.limit = float(gammaincinv(0.5, confidence))
        ahead = look_ahead(rows, own.values)
        return cls(evidence, minus, rows, base, ahead, _draw_directions(rows))

    @property
    def is_large(self) -> bool:
        """Return whether an ascent takes so long that only the best one goes on."""
        return len(self.rows.initial) > MAX_DENSE_STATES

    @property
    def _affordable_values(self) -> int:
        """Return how many values turns of rows may take."""
        n_steps = self.rows.n_steps or STEPS_PER_INFINITE_VALUE
        return MAX_TURN_WORK // (len(self.rows.phat) * n_steps)

    def find_end(self, sign: float, watch: Watch, *, is_rough: bool = False) -> End:
        """Find the farthest end of ascents from several directions.

        Each ascent is run until it is known which ones are the farthest; these go on.
        The ends of a gain in a small problem are then changed row by row, unless
        ``is_rough``, which begins from few directions and stops earlier as well.
        """
        drawn = self.drawn[:MAX_ROUGH_DIRECTIONS] if is_rough else self.drawn
        is_final = True
        found = []
        for along in [sign * self.base.slope, sign * self.ahead, *drawn]:
            if watch.is_over:
                is_final = False
                break
            ascent = self.base.towards(sign, along)
            is_final &= _ascend(self.rows, ascent, SCOUT_TOLERANCE, watch)
            found.append(ascent)
        found.sort(key=by(-sign))
        ends: list[Ascent] = []
        tolerance = END_TOLERANCE
        if is_rough and not self.is_large:
            tolerance = ROUGH_TOLERANCE
        begun: list[Array] = []  # the rows from which ascents went on to their ends
        is_changed = self.minus is not None and not self.is_large and not is_rough
        # in the smallest problems all of them are changed
        contending = CONTENDING_SHARE
        if is_changed and self._affordable_values > MIN_VALUES_OF_ALL:
            contending = np.inf
        for ascent in found:
            behind = sign * (found[0].value - ascent.value)
            distance = contending * abs(found[0].value - self.base.value)
            is_known = any(
                float(np.abs(ascent.p - other.p).max()) <= SAME_ROWS for other in ends
            )
            # many directions lead to the same rows, from which there is one way on
            is_known |= any(
                float(np.abs(ascent.p - p).max()) <= SAME_SCOUTS for p in begun
            )
            if ends and (behind > distance or is_known or self.is_large):
                continue
            begun.append(ascent.p)
            is_final &= _ascend(self.rows, ascent, tolerance, watch)
            if np.isinf(contending):
                self._change_rows(ascent, watch)
            ends.append(ascent)
        end = max(ends, key=by(sign), default=self.base)
        if is_changed and ends:
            end = self._turn_rows(end, watch)
        return self._describe(end, sign, is_final=is_final)

    def leave_limit(self, end: End, other: End, sign: float, watch: Watch) -> End:
        """Return an end, or what lies farther out inside the set.

        Without a horizon J of one policy is monotone along each row. With a horizon, and
        as a difference of two, it may be least or largest inside the set, and ascents
        look at rows that meet its limit alone. In small problems the ways between the
        end, the ``other`` end and the frequencies are searched, and then what the
        gradient promises, until the ``watch`` says that time is over.
        """
        rows = self.rows
        evidence = self.evidence
        is_monotone = evidence.horizon is None and self.minus is None
        if is_monotone or self.is_large:
            return end
        models = [end.rows[rows.entries], other.rows[rows.entries]]
        ways = [(models[0], models[1])]
        if not evidence.has_box:  # in a box the frequencies may lie outside the set
            ways += [(rows.phat, model) for model in models]
        distance = abs(other.value - end.value) / rows.unit
        least = LEAST_FARTHER * distance
        best, p = sign * end.value / rows.unit, models[0]
        for start, stop in ways:
            if watch.is_over:
                break
            value, found = self._best_on_way(start, stop, sign)
            if value > best + least:
                best, p = value, found
        best, p = self._move_inside(p, best, sign, distance, watch)
        is_final = end.is_final and not watch.is_over
        if not best > sign * end.value / rows.unit + least:
            return end._replace(is_final=is_final)
        inside = _begin(rows, p).towards(sign, self.base.x)
        inside.limit = self.base.limit
        inside.divergence = _divergence(rows, p)
        inside.change = end.change / rows.unit
        inside.n_iterations = end.iterations
        return self._describe(inside, sign, is_final=is_final)

    def _best_on_way(
        self, start: Array, stop: Array, sign: float
    ) -> tuple[float, Array]:
        """Return the largest sign x J on the way between two models, and its model."""

        def place(share: float) -> Array:
            """Return the model at a share of the way."""
            return (1.0 - share) * start + share * stop

        def evaluate(share: float) -> float:
            """Return J, times the sign, at a share of the way."""
            return sign * _begin(self.rows, place(share)).value

        values = [evaluate(share) for share in SHARES_OF_WAY]
        k = int(np.argmax(values))
        step = SHARES_OF_WAY[0]
        nearest = minimize_scalar(
            lambda share: -evaluate(share),
            bounds=(SHARES_OF_WAY[k] - step, SHARES_OF_WAY[k] + step),
            method="bounded",
            options={"xatol": 1e-6},
        )
        share = float(nearest.x)
        best, share = max((evaluate(share), share), (values[k], SHARES_OF_WAY[k]))
        return best, place(share)

    def _move_inside(
        self, p: Array, value: float, sign: float, distance: float, watch: Watch
    ) -> tuple[float, Array]:
        """Move a model to where the gradient promises no more (Frank and Wolfe).

        Each step goes to the best place on the way to the rows that are best along the
        gradient; the set is convex, so that no step leaves it. Rows without data, which
        no limit binds, and the others also go alone: where some should stay, a step of
        all would be short. ``value`` is sign x J.
        """
        rows = self.rows
        parts = [np.ones(len(p), dtype=bool)]
        if rows.has_data.any() and not rows.has_data.all():
            parts += [~rows.has_data, rows.has_data]
        work = len(p) * (rows.n_steps or STEPS_PER_INFINITE_VALUE)
        affordable = MAX_INSIDE_WORK // (VALUES_OF_STEP_INSIDE * work)
        for _ in range(min(affordable, MAX_STEPS_INSIDE)):
            if watch.is_over:
                break
            along = sign * _begin(rows, p).slope
            best, _, _ = best_rows(rows, along, self.base.limit, LIMIT_TOLERANCE, 0.0)
            if float((along * (best - p)).sum()) <= LEAST_PROMISED * distance:
                break
            found = []
            for part in parts:
                stop = np.where(part, best, p)
                found.append(self._best_on_way(p, stop, sign))
                found.append((sign * _begin(rows, stop).value, stop))
            nearer, moved = max(found, key=lambda each: each[0])
            if nearer <= value + LEAST_FARTHER * distance:
                break
            value, p = nearer, moved
        return value, p

    def _describe(self, end: Ascent, sign: float, *, is_final: bool) -> End:
        """Return the end that an ascent has found, on all entries of the evidence."""
        rows = self.rows
        evidence = self.evidence
        _fill_values(rows, end.p, end, COLD_SOLVE_TOLERANCE)
        best, _, _ = best_rows(rows, sign * end.slope, end.limit, LIMIT_TOLERANCE, 0.0)
        gains = sign * end.slope * (best - end.p)
        promised = np.where(rows.has_data, gains, 0.0).sum()
        whole = evidence.phat.copy()
        whole[rows.entries] = end.p
        model = evidence.with_rows(whole)
        value = policy_value(model, evidence.policy, horizon=evidence.horizon)
        if self.minus is not None:
            value -= policy_value(model, self.minus, horizon=evidence.horizon)
        promised = rows.unit * float(promised)
        return End(
            value,
            whole,
            promised,
            end.n_iterations,
            end.divergence,
            rows.unit * end.change,
            is_final,
        )

    def _turn_rows(self, end: Ascent, watch: Watch) -> Ascent:
        """Look for an end farther out: from directions that turn one row elsewhere.

        Where a row may lead to next states that were never observed, an end is local in
        the choice of one of them, and of the rows that take the set's limit for it.
        Each such next state in turn becomes its row's best one, as much as in the row
        that moves most; what the best of these directions lead to is ascended to its
        end. The work is limited, and half of it is for finding these directions.
        """
        rows = self.rows
        base = self.base
        free = np.flatnonzero((rows.phat == 0.0) | ~rows.has_data)
        starts = rows.indptr[:-1]
        left = self._affordable_values
        self._change_rows(end, watch)
        while left > 0 and len(free):
            x = end.last_x
            largest = np.maximum.reduceat(x, starts)
            spread = largest - np.minimum.reduceat(x, starts)
            boost = largest[rows.row] + max(float(spread.max()), TINY)
            # those first to which the end would move most of all
            merit = end.sign * look_ahead(rows, end.values)
            merit = merit - np.repeat((end.p * merit)[starts], np.diff(rows.indptr))
            order = free[np.argsort(-merit[free], kind="stable")][: left // 2 + 1]
            trials = []
            for i in order:
                if watch.is_over:
                    return end
                turned = x.copy()
                turned[i] = boost[i]
                trial = base.towards(end.sign, turned)
                p, _, _ = best_rows(rows, turned, base.limit, 1e-3, 0.0)
                value = _fill_values(rows, p, trial, WARM_SOLVE_TOLERANCE)
                trials.append((end.sign * value, turned))
            trials.sort(key=lambda trial: -trial[0])
            left -= len(trials)
            best = end
            for _, turned in trials:
                if left <= 0:
                    break
                ascent = base.towards(end.sign, turned)
                _ascend(rows, ascent, SCOUT_TOLERANCE, watch)
                behind = end.sign * (end.value - ascent.value)
                if behind <= CONTENDING_SHARE * abs(end.value - end.reference):
                    _ascend(rows, ascent, END_TOLERANCE, watch)
                    if self._affordable_values > MIN_VALUES_OF_ALL:
                        self._change_rows(ascent, watch)
                    best = max(best, ascent, key=by(end.sign))
                left -= ascent.n_iterations
            gain = end.sign * (best.value - end.value)
            if gain <= LEAST_TURN * abs(end.value - end.reference):
                return max(best, end, key=by(end.sign))
            end = best
        return end

    def _change_rows(self, ascent: Ascent, watch: Watch) -> None:
        """Leave local ends of a gain by changes of single rows, and ascend again."""
        rows = self.rows

        def evaluate(p: Array) -> float:
            """Return the gain at rows p."""
            return _begin(rows, p).value

        for _ in range(MAX_CHANGED):
            here = _begin(rows, ascent.p)
            distance = abs(ascent.value - ascent.reference)
            p, better = change_rows(
                rows, ascent.p, ascent.sign, here.slope, distance, evaluate
            )
            if better == 0.0:
                return
            ascent.p = p
            ascent.value = _fill_values(rows, p, ascent, COLD_SOLVE_TOLERANCE)
            ascent.gradient = ascent.sign * ascent.slope
            # rows without data begin anew where they are
            ascent.last_x = np.where(rows.has_data, ascent.last_x, ascent.gradient)
            ascent.step = 0.5
            ascent.x = ascent.last_x + 0.5 * (ascent.gradient - ascent.last_x)
            ascent.n_iterations = 1
            _ascend(rows, ascent, END_TOLERANCE, watch)


def by(sign: float) -> Callable[[Ascent], float]:
    """Return the order of ascents in which the last one is farthest on a side."""
    return lambda ascent: sign * ascent.value


def _divergence(rows: PolicyRows, p: Array) -> float:
    """Return the sum of n KL(phat || P) over the rows with data."""
    seen = rows.has_data & (rows.phat > 0.0)
    phat = rows.phat[seen]
    return float((rows.n[rows.row[seen]] * phat * np.log(phat / p[seen])).sum())


def _draw_directions(rows: PolicyRows) -> Array:
    """Draw directions for ascents, one a line: r + gamma V of random V.

    In every other direction only the best next state of each row counts. For two
    policies there are half as many more, in which the best next state of each row is
    drawn by itself: the gradient of their gain is 0 where both get the same, and
    leaving such a point may take two rows that go opposite ways.
    """
    is_observed = (rows.phat > 0.0) & rows.has_data
    n_steps = rows.n_steps or STEPS_PER_INFINITE_VALUE
    affordable = max(MAX_DRAW_WORK // (len(rows.phat) * n_steps), 1)
    wanted = DRAWS_PER_MISSING_TRANSITION * int((~is_observed).sum())
    number = min(wanted, affordable, MAX_DRAWN_DIRECTIONS)
    # fixed seeds: the same directions each time
    drawn = np.random.default_rng(5).random((number, len(rows.initial)))[:, rows.column]
    drawn[1::2] = _is_largest(rows, drawn[1::2])
    if len(rows.parts) > 1 and number:
        apart = np.random.default_rng(6).random(((number + 1) // 2, len(rows.phat)))
        drawn = np.vstack([drawn, _is_largest(rows, apart)])
    return drawn


def _is_largest(rows: PolicyRows, directions: Array) -> BoolArray:
    """Return which entries are the largest of their rows, for each direction."""
    largest = np.maximum.reduceat(directions, rows.indptr[:-1], axis=1)
    return np.asarray(directions == largest[:, rows.row])


def _begin(rows: PolicyRows, p: Array) -> Ascent:
    """Begin an ascent at rows p, whose J is the reference."""
    n = len(rows.initial)
    # a uniform d, from which the first solve of a large problem begins
    start = np.zeros(n)
    if rows.is_sparse:
        start = np.full(n, 1.0 / ((1.0 - rows.discount) * n))
    zero = np.zeros(len(p))
    values = [np.zeros(n) for _ in rows.parts]
    visits = [start for _ in rows.parts]
    ascent = Ascent(p, zero, zero, zero, values, visits, zero, 0.0)
    ascent.value = _fill_values(rows, p, ascent, COLD_SOLVE_TOLERANCE)
    ascent.reference = ascent.value
    return ascent


def _ascend(rows: PolicyRows, ascent: Ascent, tolerance: float, watch: Watch) -> bool:
    """Propose rows, evaluate them, and accept or refuse them until the end stays.

    P_k = P(x_k),   x_{k+1} = x_k + a (G_k - x_k),   G_k the gradient of J at P_k.

    ``tolerance`` is the share of the distance from the reference by which iterations
    must move the end. An ascent that was run before goes on. False is returned where
    time was over before the end stays; small problems have the time.
    """
    ascent.n_quiet = 0
    is_large = len(rows.initial) > MAX_DENSE_STATES
    is_last = False
    while not is_last:
        if is_large and watch.is_over:
            return False
        trial, reached = ascent.propose(rows)
        value = _fill_values(rows, trial, ascent, WARM_SOLVE_TOLERANCE)
        is_last = ascent.accept(trial, value, reached, tolerance)
    return True


def value_of_rows(rows: PolicyRows, p: Array) -> float:
    """Return J at rows p."""
    return rows.unit * _begin(rows, p).value


def look_ahead(rows: PolicyRows, values: list[Array]) -> Array:
    """Return r + gamma V(s') of each entry, of a gain sum_k sign_k pi_k (r + gamma V_k)."""
    ahead = np.zeros(len(rows.pay))
    is_gain = len(rows.parts) > 1
    for part, ours in zip(rows.parts, values, strict=True):
        share = part.sign * part.weight if is_gain else part.sign
        ahead += share * (rows.pay + rows.discount * ours[rows.column])
    return ahead


def _fill_values(rows: PolicyRows, p: Array, ascent: Ascent, tolerance: float) -> float:
    """Return sum_k sign_k J(pi_k) at rows p, and fill V, d and the gradient.

    In large problems V and d are corrected from those of the previous rows, until a
    share ``tolerance`` of the residual is left.
    """
    total = 0.0
    slope = np.zeros(len(p))
    for k, (sign, weight) in enumerate(rows.parts):
        if rows.n_steps:
            value, V, d, gradient = _evaluate_steps(rows, weight * p, weight)
        elif rows.is_sparse:
            value, V, d = _solve_near(
                rows, weight * p, ascent.values[k], ascent.visits[k], tolerance
            )
            gradient = centred_gradient(rows, weight, V, d)
        else:
            value, V, d = _solve_dense(rows, weight * p)
            gradient = centred_gradient(rows, weight, V, d)
        ascent.values[k] = V
        ascent.visits[k] = d
        total += sign * value
        slope += sign * gradient
    if rows.n_steps or len(rows.parts) > 1:
        # where the gradient says nothing of a row without data, r + gamma V does
        starts = rows.indptr[:-1]
        largest = np.maximum.reduceat(slope, starts)
        is_flat = (largest == np.minimum.reduceat(slope, starts)) & (rows.n == 0.0)
        slope = np.where(is_flat[rows.row], look_ahead(rows, ascent.values), slope)
    ascent.slope = slope
    return total


def _solve_dense(rows: PolicyRows, shares: Array) -> tuple[float, Array, Array]:
    """Return J, V and d of a policy in a small problem, by LAPACK.

    ``shares`` is pi(a | s) P(s' | s, a) of each entry.
    """
    n = len(rows.initial)
    rewards = np.bincount(rows.state, shares * rows.pay, n).astype(np.float64)
    between = np.bincount(rows.cell, shares, n * n).reshape(n, n)
    matrix = rows.identity - rows.discount * between
    # as numpy's solve does, but both systems by one factorisation
    factors, pivots, _ = lapack.dgetrf(matrix, overwrite_a=True)
    V = lapack.dgetrs(factors, pivots, rewards)[0]
    d = lapack.dgetrs(factors, pivots, rows.initial, trans=1)[0]
    return float((rows.initial * V).sum()), V, d


def _solve_near(
    rows: PolicyRows, shares: Array, V: Array, d: Array, tolerance: float
) -> tuple[float, Array, Array]:
    """Return J, V and d of a policy in a large problem, from V and d of others.

    With what the solve has missed, J = mu V + d missed is correct to second order.
    """
    n = len(rows.initial)
    rewards = np.bincount(rows.state, shares * rows.pay, n).astype(np.float64)
    share = np.bincount(rows.edge, shares)
    kernel = Kernel(rows.edges, rows.columns, as_readonly(share), rows.discount)
    solution = solvers.answer(System(kernel), rewards, V, tolerance)
    value = float(rows.initial @ solution.x + d @ solution.missed)
    transposed = System(kernel, True)
    visits = solvers.answer(transposed, rows.initial, d, tolerance).x
    return value, solution.x, visits


def _evaluate_steps(
    rows: PolicyRows, shares: Array, weight: Array
) -> tuple[float, Array, Array, Array]:
    """Return J, V, d and the gradient of J of a policy with a horizon.

    dJ / dP_i = pi sum_t gamma^t alpha_t (pay_i + gamma V_{t+1}).
    """
    n = len(rows.initial)
    to_go = np.zeros((rows.n_steps + 1, n))
    visits = np.zeros(n)
    worth = np.zeros(len(rows.columns))
    fill_steps(
        rows.edges,
        rows.columns,
        np.bincount(rows.edge, shares, len(worth)),
        np.bincount(rows.state, shares * rows.pay, n).astype(np.float64),
        rows.discount,
        to_go,
        rows.initial.copy(),
        np.zeros(n),
        visits,
        worth,
    )
    V = to_go[0].copy()
    gradient = weight * (visits[rows.state] * rows.pay + worth[rows.edge])
    return float((rows.initial * V).sum()), V, visits, gradient


def centred_gradient(
    rows: PolicyRows, weight: Array, values: Array, visits: Array
) -> Array:
    """Return the gradient of J, centred in each row: the mean does not matter there."""
    gradient = np.empty(len(rows.phat))
    fill_gradient(
        rows.indptr,
        rows.state,
        rows.column,
        weight,
        rows.pay,
        rows.phat,
        rows.weighted,
        rows.discount,
        values,
        visits,
        gradient,
    )
    return gradient
