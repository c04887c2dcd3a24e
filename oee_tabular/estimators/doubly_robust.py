"""Doubly robust estimators: a model's value, and the log's residuals on top of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, row_of_entry, row_sums
from oee_tabular.estimators.base import OF_COUNTS
from oee_tabular.estimators.errors import (
    ROUNDING,
    delta_error,
    effective_sample_size,
    error_or_none,
    mean_and_error,
)
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.importance_sampling import Episodes
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.ratio_based import RatioEstimator, RatioOption
from oee_tabular.estimators.recorded_time import coverage, learnable_shares
from oee_tabular.estimators.rollouts import rollout_horizon, weight_status
from oee_tabular.exact import (
    Model,
    policy_value,
    require_action_support,
    reweight,
    time_in_pairs,
    transition_gradient,
    values_or_zeros,
    values_to_go,
    walk_of,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, horizon_length
from oee_tabular.ratio import TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.simulate import Drawn, draw
from oee_tabular.typing import Array, IntArray


@suggest_keywords
@dataclass(frozen=True)
class DoublyRobust(RatioEstimator):
    """The doubly robust estimator, which is consistent if either of its parts is.

    Parameters
    ----------
    data : {'transitions', 'rollouts', 'episodes'}, default 'transitions'
        The form of the estimator: the simulator's value and the log's weighted
        residuals; rollouts of the simulator with a control variate; or the log's
        episodes with a control variate (see Notes).
    weights : {'occupancy', 'beta'}, default 'occupancy'
        For "transitions": the weights w = d / d_log, with d the policy's occupancy in
        zeta * P, or in the simulator. With the latter no zeta is fitted, and the error
        is of second order in the mismatch of the two environments.
    ratio : str, Method, TransitionRatio or callable, default 'conditional'
        The source of zeta, as in ``OffEnvironment``.
    self_normalized : bool, default False
        For "episodes": whether the weights of each step are divided by their sum
        (weighted doubly robust [2]_).
    n_rollouts : int, default 100
        For "rollouts": the number of simulated episodes.

    See Also
    --------
    Magic : A blend of weighted doubly robust and the model.
    OffEnvironment : The value of zeta * P itself.

    Notes
    -----
    With "transitions" the estimate is exact given the log, for any horizon (time sums
    inside)::

        J_sim + 1/(1 - gamma) E_log[w (r + gamma V_sim(s') - Q_sim(s, a))]

    With "rollouts" it is the mean over rollouts of the simulator of D_0, the paper's
    product with a control variate, where m_t = sum_s' zeta P V_sim::

        D_t = r_t + gamma [m_t + zeta_{t+1} (D_{t+1} - V_sim(s_{t+1}))]

    With "episodes" it is the mean over the log's episodes of D_0, with V and Q of
    zeta * P [1]_; a truncated episode continues with V::

        D_t = V(s_t) + rho_t [r_t + gamma D_{t+1} - Q(s_t, a_t)]

    On transitions with a zeta from the log the standard error is that of J(zeta * P),
    since d is as uncertain as the residual. Under a zeta that is given, or with "beta",
    d is known, and the error is the residual's.

    References
    ----------
    .. [1] Jiang and Li, Doubly robust off-policy value evaluation, ICML 2016.
    .. [2] Thomas and Brunskill, Data-efficient off-policy policy evaluation,
       ICML 2016.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> estimate = DoublyRobust()(pair.problem(1000, seed=0), pair.policy)
    >>> (
    ...     round(estimate.diagnostics["simulator_value"], 1),
    ...     round(estimate.value, 1),
    ...     round(estimate.standard_error, 1),
    ... )
    (8.0, 10.2, 0.2)
    """

    data: Literal["transitions", "rollouts", "episodes"] = "transitions"
    weights: Literal["occupancy", "beta"] = "occupancy"
    ratio: RatioOption = "conditional"
    self_normalized: bool = False
    n_rollouts: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        _checks.one_of(self.data, "data", ("transitions", "rollouts", "episodes"))
        _checks.one_of(self.weights, "weights", ("occupancy", "beta"))
        _checks.boolean(self.self_normalized, "self_normalized")
        if self.self_normalized and self.data != "episodes":
            raise ArgumentError(
                "self_normalized",
                f"must be False with data {self.data!r}: it is for episodes",
            )
        _checks.positive_integer(self.n_rollouts, "n_rollouts")

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Compute the estimate in the form that ``data`` names.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            The source of rollouts, and of simulated data for zeta.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        needs_zeta = self.data != "transitions" or self.weights == "occupancy"
        zeta = self.fit(problem, policy, generator) if needs_zeta else None
        if zeta is None or self.data == "transitions":
            return self._correct_by_transitions(problem, policy, zeta)
        if self.data == "rollouts":
            return self._average_rollouts(problem, policy, zeta, generator)
        terms = EpisodeTerms.from_problem(
            problem, policy, zeta, self_normalized=self.self_normalized
        )
        _, error = mean_and_error(len(terms.partial) * terms.partial[:, -1])
        return terms.estimate(zeta, terms.total, error)

    @property
    def claims(self) -> frozenset[str]:
        """Return what the estimator claims, in words of ``testing.CLAIMS``."""
        known = self.model_claims
        if self.data == "rollouts":
            return known | {"random"}
        if self.data == "transitions":
            if self.weights == "beta":  # no zeta is fitted
                return OF_COUNTS | {"identical", "shift"}
            return known | {"shift"}
        if self.self_normalized:
            return known - {"after_end"} | {"consistent"}
        if isinstance(self.ratio, TransitionRatio):
            return known | {"consistent", "unbiased"}
        return known | {"consistent"}

    def _correct_by_transitions(
        self, problem: Problem, policy: Array, zeta: TransitionRatio | None
    ) -> Estimate:
        """Correct the simulator's value by the residuals of the recorded pairs.

        The estimate is J_sim + sum over recorded pairs of d(s, a) sum_s' (f - P) (r +
        gamma V_sim), with d the discounted time in the pair and f the log's
        frequencies.
        """
        simulator = problem.model
        horizon = problem.horizon
        model: Model = simulator if zeta is None else reweight(simulator, zeta)
        base = policy_value(simulator, policy, horizon=horizon)
        gradient = transition_gradient(
            model, policy, horizon=horizon, values_of=simulator
        )
        observed, _ = align(problem.counts, simulator.transitions)
        total = row_sums(simulator.transitions, observed)
        counts = total[row_of_entry(simulator.transitions)]
        recorded = counts > 0
        frequency = np.divide(
            observed, counts, out=np.zeros_like(observed), where=recorded
        )
        change = float(
            gradient[recorded] @ (frequency - simulator.transitions.data)[recorded]
        )
        if zeta is not None and not isinstance(self.ratio, TransitionRatio):
            gradient = transition_gradient(model, policy, horizon=horizon)
        noise = delta_error(simulator.transitions, frequency, total, gradient)
        error = error_or_none(noise, gradient, simulator.transitions.indptr)
        about = {} if zeta is None else {"gap": zeta.gap}
        shares = learnable_shares(problem, time_in_pairs(model, policy, horizon))
        time = coverage(problem, shares, total.reshape(shares.shape))
        return Estimate(
            base + change,
            error,
            diagnostics={
                "standard_error_of": "log",
                "simulator_value": base,
                **about,
                **time,
            },
            measured=time["coverage"],
        )

    def _average_rollouts(
        self,
        problem: Problem,
        policy: Array,
        zeta: TransitionRatio,
        generator: np.random.Generator,
    ) -> Estimate:
        """Average rollouts of the simulator, with the control variate."""
        model = problem.model
        steps = rollout_horizon(model.discount, problem.horizon)
        n_steps = horizon_length(steps, model)
        drawn = draw(
            model,
            policy,
            self.n_rollouts,
            n_steps,
            seed=generator,
            zeta=zeta,
            record=True,
            name="n_rollouts",
        )
        values, _ = _model_values(model, policy, problem.horizon, steps)
        value, error = mean_and_error(_rollout_values(model, drawn, values))
        return Estimate(
            value,
            error,
            diagnostics={
                "standard_error_of": "rollouts",
                "n_rollouts": self.n_rollouts,
                "gap": zeta.gap,
            },
        )

    def limit_of(self, population: Population) -> float:
        """Compute the exact population limit.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.

        Notes
        -----
        transitions: J_sim + sum over pairs with data of d(s, a) sum_s' (P_target -
        P_sim) (r + gamma V_sim), with d the discounted time in the pair. rollouts: J of
        the limit of zeta * P. episodes: J_target where the behaviour policy takes every
        action of the policy, as it does by default; else the model stands for the rest
        (self-normalised: an error).
        """
        simulator = population.simulator
        target = population.target
        policy = population.policy
        horizon = population.horizon
        if self.data == "rollouts":
            return population.value(self.limit_model(population))
        if self.data == "episodes":
            if self.self_normalized and population.behavior is not None:
                require_action_support(target, population.behavior, policy, horizon)
            return _episode_limit(population, self.limit_model(population))
        where: Model = (
            simulator if self.weights == "beta" else self.limit_model(population)
        )
        gradient = transition_gradient(
            where, policy, horizon=horizon, values_of=simulator
        )
        inside, _ = align(target.transitions, simulator.transitions)
        recorded = population.support[row_of_entry(simulator.transitions)]
        change = float(
            gradient[recorded] @ (inside - simulator.transitions.data)[recorded]
        )
        return population.value(simulator) + change


@suggest_keywords
@dataclass(frozen=True)
class Magic(RatioEstimator):
    """MAGIC: a blend of weighted doubly robust and the model, on the log's episodes.

    The name stands for model and guided importance sampling combining [1]_.

    Parameters
    ----------
    ratio : str, Method, TransitionRatio or callable, default 'conditional'
        The source of zeta, as in ``OffEnvironment``; the model is zeta * P.
    n_lengths : int, default 25
        The number of lengths j that are blended, spread evenly from 0 to T.
    n_bootstrap : int, default 200
        The number of resamples of the episodes.

    See Also
    --------
    DoublyRobust : The doubly robust estimator alone.

    Notes
    -----
    The part g_j uses weighted doubly robust for the first j steps and the model after
    them (j = 0: the model alone). The weights x on the simplex minimise x^T (Omega + b
    b^T) x. Omega is the covariance of the g_j over episodes, and b_j the distance of
    g_j from the central half of the bootstrap distribution of g_T; the weights are
    normalised again on each resample, and a resample without any weight at some step is
    left out.

    The limit is that of weighted doubly robust. The standard error treats the model as
    known, and is too small if most of the weight is on it.

    References
    ----------
    .. [1] Thomas and Brunskill, Data-efficient off-policy policy evaluation for
       reinforcement learning, ICML 2016.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> estimate = Magic()(pair.problem(1000, seed=0), pair.policy, seed=0)
    >>> round(estimate.value, 1), round(estimate.diagnostics["share_of_model"], 1)
    (10.1, 1.0)
    """

    ratio: RatioOption = "conditional"
    n_lengths: int = 25
    n_bootstrap: int = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        _checks.positive_integer(self.n_lengths, "n_lengths")
        _checks.positive_integer(self.n_bootstrap, "n_bootstrap")

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Compute the blend.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            The source of resamples, and of simulated data for zeta.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        zeta = self.fit(problem, policy, generator)
        terms = EpisodeTerms.from_problem(problem, policy, zeta, self_normalized=True)
        n, columns = terms.partial.shape
        if n < 2:
            return Estimate(float("nan"), status="the blend needs at least 2 episodes")
        if np.isnan(terms.total):
            return Estimate(terms.total, status=weight_status(terms.total))
        lengths = np.linspace(0, columns - 1, min(self.n_lengths, columns))
        lengths = np.unique(np.round(lengths).astype(int))
        parts = terms.partial[:, lengths]
        totals = parts.sum(axis=0)
        covariance = n / (n - 1.0) * (parts - totals / n).T @ (parts - totals / n)
        draws = generator.integers(0, n, size=(self.n_bootstrap, n))
        low, high = np.nanquantile(terms.resample(draws), [0.25, 0.75])
        bias = np.maximum(np.maximum(totals - high, low - totals), 0.0)
        weights = _minimize_on_simplex(covariance + np.outer(bias, bias))
        spread = float(np.sqrt(max(weights @ covariance @ weights, 0.0)))
        error = spread if spread > ROUNDING * float(np.abs(n * parts).max()) else None
        return terms.estimate(
            zeta, float(weights @ totals), error, share_of_model=float(weights[0])
        )

    @property
    def claims(self) -> frozenset[str]:
        """Return what the estimator claims, in words of ``testing.CLAIMS``."""
        return self.model_claims - {"after_end"} | {"consistent", "random"}

    def limit_of(self, population: Population) -> float:
        """Compute the limit, which is that of weighted doubly robust.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.
        """
        return DoublyRobust(
            data="episodes", ratio=self.ratio, self_normalized=True
        ).limit_of(population)


@dataclass(frozen=True, eq=False)
class EpisodeTerms:
    """The terms of the doubly robust estimator on n episodes of at most T steps.

    V and Q of zeta * P are the control variates. The value is the sum over steps t and
    episodes i of share_ti gain_ti, where share_ti is the weight over n, or over the sum
    of the weights at t.

    Attributes
    ----------
    weights : ndarray of shape (T + 1, n)
        The products rho_0 ... rho_{t-1}; an episode that has ended keeps its weight.
    gains : ndarray of shape (T + 1, n)
        What each weight multiplies.
    partial : ndarray of shape (n, T + 1)
        The parts of each episode where the log is used for j = 0..T steps and the
        model's value after them.
    """

    weights: Array
    gains: Array
    partial: Array

    @classmethod
    def from_problem(
        cls,
        problem: Problem,
        policy: Array,
        zeta: TransitionRatio,
        *,
        self_normalized: bool,
    ) -> EpisodeTerms:
        """Compute the terms, which are nan where the weights to divide by are all 0."""
        episodes = Episodes.from_problem(problem)
        model = reweight(problem.model, zeta)
        lengths = episodes.lengths
        n = len(lengths)
        steps = int(lengths.max())
        first = episodes.log.state[episodes.rows[episodes.starts[:-1]]]
        v, q = _model_values(model, policy, problem.horizon, steps, first)
        t = np.arange(steps)[:, None]
        place = episodes.starts[:-1] + np.minimum(t, lengths - 1)
        weights = np.vstack([np.ones((1, n)), episodes.weights(problem, policy)[place]])
        with np.errstate(invalid="ignore"):
            divisor = weights.sum(axis=1, keepdims=True) if self_normalized else n
            shares = weights / divisor

        factor = np.where(t < lengths, model.discount ** t.astype(np.float64), 0.0)
        rewards = problem.rewards_of(episodes.log)
        value, residual = _values_and_residuals(episodes, place, rewards, v, q)
        value *= factor  # its weight is W_t
        residual *= factor  # its weight is W_{t+1}
        used = np.minimum(np.arange(steps + 1)[:, None], lengths)
        rest = _values_of_the_rest(episodes, used, v, model.discount)

        gains = np.zeros((steps + 1, n))
        gains[1:] = residual
        gains[:-1] += value
        gains[lengths, np.arange(n)] += rest[-1]
        partial = np.take_along_axis(shares, used, axis=0) * rest
        partial[1:] += np.cumsum(shares[1:] * residual + shares[:-1] * value, axis=0)
        return cls(
            weights, gains, np.where(np.isfinite(shares).all(), partial, np.nan).T
        )

    @property
    def total(self) -> float:
        """Return the value of the sum."""
        return float(self.partial[:, -1].sum())

    def resample(self, draws: IntArray) -> Array:
        """Compute the self-normalised value of each resample of the episodes.

        Row b of ``draws`` (B, n) has the numbers of resample b's episodes; the weights
        are normalised on each. A value is nan where at some step all weights of the
        resample are 0.
        """
        n = len(self.partial)
        products = self.weights * self.gains
        totals = np.empty(len(draws))
        for b, episodes in enumerate(draws):
            number = np.bincount(episodes, minlength=n)
            with np.errstate(invalid="ignore"):
                totals[b] = float(((products @ number) / (self.weights @ number)).sum())
        return totals

    def estimate(
        self, zeta: TransitionRatio, value: float, error: float | None, **more: float
    ) -> Estimate:
        """Return the estimate with its diagnostics, to which ``more`` is added."""
        last = self.weights[-1]
        n = len(self.partial)
        effective = effective_sample_size(last)
        return Estimate(
            value,
            error,
            diagnostics={
                "standard_error_of": "log",
                "n_episodes": n,
                "effective_sample_size": effective,
                "largest_weight": float(last.max()),
                "gap": zeta.gap,
                **more,
            },
            status=weight_status(value),
            is_from_episodes=True,
        )


def _values_and_residuals(
    episodes: Episodes, place: IntArray, rewards: Array, v: Array, q: Array
) -> tuple[Array, Array]:
    """Look up V, and the reward minus Q, at each step of each episode, (T, n).

    ``place`` (T, n) is that of each step in the episodes' rows; ``rewards`` are those
    of the log's rows.
    """
    t = np.arange(len(place))[:, None]
    rows = episodes.rows[place]
    state = episodes.log.state[rows]
    action = episodes.log.action[rows]
    return v[t, state], rewards[rows] - q[t, state, action]


def _values_of_the_rest(
    episodes: Episodes, used: IntArray, v: Array, gamma: float
) -> Array:
    """Compute the model's discounted value of what follows the first ``used`` steps.

    ``used`` and the result are (T + 1, n): a column for each episode. The value is 0
    where the episode has ended then.
    """
    log = episodes.log
    first = episodes.rows[episodes.starts[:-1]]
    before = first + np.maximum(used, 1) - 1
    arrival = np.where(used == 0, log.state[first], log.next_state[before])
    has_ended = (used == episodes.lengths) & episodes.is_over
    return np.where(has_ended, 0.0, gamma**used * v[used, arrival])


def _model_values(
    model: Model,
    policy: Array,
    horizon: int | None,
    steps: int,
    first: IntArray | None = None,
) -> tuple[Array, Array]:
    """Compute V (steps + 1, S) and Q (steps, S, A) of the model at each step.

    ``first`` are states where episodes begin besides those of the model.
    """
    if horizon is None:
        starts = model.initial > 0.0
        if first is not None:
            starts[first] = True
        v = following = values_or_zeros(model, policy, starts)[None]
    else:
        v = values_to_go(model, policy, horizon)[: steps + 1]
        following = v[1:]
    ahead = np.asarray(model.transitions @ following.T).T
    q = model.rewards + model.discount * ahead.reshape(-1, *model.rewards.shape)
    return np.broadcast_to(v, (steps + 1, *v.shape[1:])), np.broadcast_to(
        q, (steps, *q.shape[1:])
    )


def _episode_limit(population: Population, model: Model) -> float:
    """Compute the mean of D_0, which is J_target where the behaviour has support."""
    if population.behavior is None:
        return population.value(population.target)
    target = population.target
    steps = rollout_horizon(target.discount, population.horizon)
    v, q = _model_values(model, population.policy, population.horizon, steps)
    walk = walk_of(target, population.behavior, policy=population.policy)
    reached = walk.weights_by_state(steps, power=1)[:-1, 0]
    gains = v[:-1] + walk.sum_actions(
        walk.act * walk.u * (target.rewards - q).reshape(steps, -1)
    )
    return float(
        target.discount ** np.arange(steps, dtype=np.float64)
        @ (reached * gains).sum(axis=1)
    )


def _rollout_values(model: FiniteMDP, drawn: Drawn, values: Array) -> Array:
    """Compute D_0 of each rollout by the backward recursion.

    It is D = m + zeta gamma (D' - V(s')) with m = sum_s' zeta P (r + gamma V(s')).
    ``values`` (T + 1, S) are V; those after the last step change no mean.
    """
    matrix = model.transitions
    rows = row_of_entry(model.transitions)
    kernel = drawn.ratio * matrix.data
    pay = model.rewards.reshape(-1)
    if model.reward_data is not None:
        pay = row_sums(matrix, kernel * model.reward_data)
    last = int(drawn.lengths.max()) - 1
    is_constant = values.strides[0] == 0
    ahead = np.zeros(len(drawn.lengths))
    for t in range(last, -1, -1):
        if t == last or not is_constant:
            going = model.discount * values[t + 1]
            known = pay + row_sums(matrix, kernel * going[matrix.indices])
        alive = np.flatnonzero(drawn.lengths > t)
        entry = drawn.path[drawn.starts[alive] + t]
        change = model.discount * ahead[alive] - going[matrix.indices[entry]]
        ahead[alive] = known[rows[entry]] + drawn.ratio[entry] * change
    return ahead


def _minimize_on_simplex(matrix: Array) -> Array:
    """Minimise x^T A x over the simplex, with A positive semidefinite.

    It is solved by nonnegative least squares: the minimiser of y^T A y + (sum y - 1)^2
    over y >= 0 is a multiple of the solution.
    """
    values, vectors = np.linalg.eigh(matrix)
    scale = max(float(values.max()), 1e-300)
    root = (np.sqrt(np.maximum(values, 0.0) / scale) * vectors).T
    stacked = np.vstack([root, np.ones(len(matrix))])
    from scipy.optimize import nnls  # its import takes a tenth of a second

    y, _ = nnls(stacked, np.append(np.zeros(len(root)), 1.0), maxiter=100 * len(matrix))
    return np.asarray(y / y.sum())
