"""Estimators by ratios of occupancies, without products of ratios along a path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias, cast

import numpy as np
from scipy import linalg, sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, row_sums
from oee_tabular.estimators.base import OF_COUNTS, TabularEstimator
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.model_based import ModelBased
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.ratio_based import RatioEstimator, RatioOption
from oee_tabular.estimators.recorded_time import coverage, learnable_shares
from oee_tabular.estimators.rewards import mean_rewards
from oee_tabular.exact import (
    Model,
    occupancy,
    policy_kernel,
    reweight,
    solve_policy_system,
    time_in_pairs,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, total_discount
from oee_tabular.ratio import density_ratio
from oee_tabular.ratio.dual import check_box
from oee_tabular.ratio.method import Population
from oee_tabular.typing import Array, Csr, IntArray, RealArrayLike

# condition of the saddle point's matrix, its columns scaled, above which no digit of
# theta is certain
MAX_CONDITION = 1e12
# length of the part of a unit column that the others do not span, below which the
# column is a combination of them
RANK_TOLERANCE = 1e-10
# how errors say that the function is called
FEATURES_CALL = "features(state, action), of two arrays of integers"
FeaturesLike: TypeAlias = RealArrayLike | Callable[[IntArray, IntArray], RealArrayLike]


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Marginalized(RatioEstimator):
    """Marginalized importance sampling, the paper's follow-up [1]_.

    The log's rewards are weighted by two ratios of occupancies: J is
    E_log[beta w r] / (1 - gamma), with beta = d_sim / d_log and w = d_target / d_sim.

    Parameters
    ----------
    ratio : str, Method, TransitionRatio or callable, default 'conditional'
        The source of zeta, as in ``OffEnvironment``. It is left out with ``features``,
        which need no zeta.
    lower : float, optional
        A lower bound of beta where the log has pairs. Without bounds beta is exact.
    upper : float, optional
        An upper bound of beta where the log has pairs.
    features : array_like or callable, optional
        The features phi(s, a) of the class w = phi theta: an array of shape (S, A),
        (S, A, d) or (S*A, d), or a function of (s, a) arrays that returns one. They
        need a problem without a horizon, count as 0 after the end of an episode, and
        are left out where they are 0 in every recorded pair. None takes w from zeta.

    Raises
    ------
    ValueError
        When called, if features have another shape, are all constant, or are linearly
        dependent (the columns are named); with features also if the problem has a
        horizon or the discount is 1.

    See Also
    --------
    DualDice : The ratio of occupancies from a quadratic program.

    Notes
    -----
    beta is fitted by ``density_ratio``. w is the occupancy in zeta * P over the
    simulator's, or with ``features`` the published saddle point::

        A = E_log[beta phi (gamma phi'_pi - phi)^T],    A^T theta = -(1 - gamma) E phi_0

    with phi'_pi the mean of phi(s', a') under the policy, and phi_0 that at the start.

    Unrecorded pairs have reward 0. One-hot features give maximum likelihood on the
    recorded pairs. The value converges to J of the target, with ``features`` to that of
    the class, which depends on how pairs are recorded unless the class contains
    d_target / d_sim.

    References
    ----------
    .. [1] Katdare, Jiang and Driggs-Campbell, Marginalized importance sampling
       for off-environment policy evaluation, CoRL 2023.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> estimate = Marginalized()(pair.problem(1000, seed=0), pair.policy)
    >>> round(estimate.value, 1), round(estimate.diagnostics["largest_weight"], 1)
    (10.2, 0.9)
    """

    ratio: RatioOption = "conditional"
    lower: float | None = None
    upper: float | None = None
    features: FeaturesLike | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_box(self.lower, self.upper, normalized=False)
        if self.features is not None and not (
            isinstance(self.ratio, str) and self.ratio == "conditional"
        ):
            raise ArgumentError(
                "ratio", "must be left out with features, which need no zeta"
            )

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Weigh the log's rewards by both ratios.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            The source of simulated data, for ratios that need them.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        simulator = problem.simulator
        horizon = problem.horizon
        total = problem.counts.sum()
        share = row_sums(problem.counts) / total
        beta, gap = self._fit_beta(simulator, policy, horizon, share)
        model: Model = problem.model
        if self.features is None:
            zeta = self.fit(problem, policy, generator)
            model = reweight(problem.model, zeta)
            gap = max(gap, zeta.gap)
            shift = _occupancy_ratio(model, simulator, policy, horizon)
        else:
            transitions = cast("Csr", problem.counts / total)
            shift = self._solve_class(simulator, policy, transitions, beta)
        weights = beta * shift
        shares = learnable_shares(problem, time_in_pairs(model, policy, horizon))
        time = coverage(problem, shares, row_sums(problem.counts).reshape(policy.shape))
        return Estimate(
            total_discount(model.discount, horizon)
            * float(share @ (weights * mean_rewards(problem))),
            diagnostics={
                "gap": gap,
                "largest_weight": float(weights.max()),
                "mean_weight": float(share @ weights),
                **time,
            },
        )

    @property
    def claims(self) -> frozenset[str]:
        """Return what the estimator claims, in words of ``testing.CLAIMS``.

        The value does not shift with the rewards, since unrecorded pairs have reward 0.
        """
        if self.features is not None:
            return frozenset({"scale", "infinite"})
        known = self.model_claims - {"shift"}
        if self.lower is None and self.upper is None:
            return known
        return known - {"consistent", "padding", "after_end"}

    def limit_of(self, population: Population) -> float:
        """Compute the sum of d_log beta w r over the data's support.

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
        beta is clipped to its bounds; w is that of zeta * P, or of the class.
        """
        simulator = population.simulator
        policy = population.policy
        horizon = population.horizon
        share = population.distribution.reshape(-1)
        target = population.target.transitions
        beta, _ = self._fit_beta(simulator, policy, horizon, share)
        if self.features is None:
            shift = _occupancy_ratio(
                self.limit_model(population), simulator, policy, horizon
            )
        else:
            transitions = sparse.csr_array(sparse.diags_array(share) @ target)
            shift = self._solve_class(simulator, policy, transitions, beta)
        rewards = simulator.rewards.reshape(-1)
        # the target's transitions have the simulator's rewards
        if simulator.reward_data is not None:
            probability, _ = align(target, simulator.transitions)
            rewards = row_sums(
                simulator.transitions, probability * simulator.reward_data
            )
        return total_discount(simulator.discount, horizon) * float(
            share @ (beta * shift * rewards)
        )

    def _fit_beta(
        self, simulator: FiniteMDP, policy: Array, horizon: int | None, share: Array
    ) -> tuple[Array, float]:
        """Fit beta (S*A,), which is 0 in unrecorded pairs; return it and its gap."""
        if self.features is not None and horizon is not None:
            raise ArgumentError(
                "horizon",
                f"must be None with features, for the infinite sum; it is {horizon}",
            )
        if self.features is not None and simulator.discount == 1.0:
            raise ArgumentError("discount", "must be below 1 with features; it is 1")
        time = occupancy(simulator, policy, horizon=horizon).reshape(-1)
        recorded = share > 0
        beta = np.zeros_like(share)
        gap = 0.0
        inside = float(time[recorded].sum())
        # ``density_ratio`` scales both to distributions: its ratio is beta / inside,
        # and its box has to be divided likewise
        if inside > 0:
            box = check_box(self.lower, self.upper, normalized=False)
            fit = density_ratio(
                time[recorded],
                share[recorded],
                lower=box.lower / inside,
                upper=box.upper / inside,
                normalized=False,
            )
            beta[recorded] = fit.ratio * inside
            gap = fit.gap
        return beta, gap

    def _solve_class(
        self,
        simulator: FiniteMDP,
        policy: Array,
        transitions: Csr,
        beta: Array,
    ) -> Array:
        """Solve the saddle point for w = phi theta, of shape (S*A,).

        ``transitions`` (S*A, S) are the log's shares of transitions, which sum to 1.
        """
        gamma = simulator.discount
        shape = (simulator.n_states, simulator.n_actions)
        phi, names = _pair_features(self.features, simulator)
        share = row_sums(transitions)
        shared = share * beta > 0
        used = np.flatnonzero((phi[shared] != 0.0).any(axis=0))
        if used.size == 0:
            return np.zeros(len(phi))
        phi = phi[:, used]
        _refuse_dependent(
            phi[shared], names[used], " in the pairs that the log and the policy share"
        )
        by_state = np.einsum("sa,sad->sd", policy, phi.reshape(*shape, -1))
        ahead = gamma * (transitions @ by_state) - share[:, None] * phi
        matrix = phi.T @ (beta[:, None] * ahead)
        scale = np.sqrt(np.einsum("xd,x,xd->d", phi, share * beta, phi))
        matrix = matrix / np.outer(scale, scale)
        start = simulator.initial @ by_state / scale
        if np.linalg.cond(matrix) > MAX_CONDITION:
            raise ArgumentError(
                "features",
                "must make the saddle point's matrix A regular; its condition exceeds"
                f" {MAX_CONDITION:g}",
            )
        theta = np.linalg.solve(matrix.T, -(1.0 - gamma) * start)
        return np.asarray(phi @ (theta / scale))


def _occupancy_ratio(
    model: Model, simulator: FiniteMDP, policy: Array, horizon: int | None
) -> Array:
    """Compute the policy's occupancy in the model over the simulator's, (S*A,).

    It is 0 where the simulator's occupancy is 0.
    """
    here = occupancy(simulator, policy, horizon=horizon).reshape(-1)
    there = occupancy(model, policy, horizon=horizon).reshape(-1)
    return np.divide(there, here, out=np.zeros_like(there), where=here > 0)


def _pair_features(features: object, simulator: FiniteMDP) -> tuple[Array, IntArray]:
    """Check features, and return phi (S*A, d) and the numbers of its columns.

    phi is 0 in absorbing states; columns that are 0 elsewhere are left out.
    """
    shape = (simulator.n_states, simulator.n_actions)
    size = shape[0] * shape[1]
    if callable(features):
        pairs = np.divmod(np.arange(size), shape[1])
        features = _checks.call_function(features, "features", FEATURES_CALL, *pairs)
    array = _checks.float_array(features, "features")
    is_table = array.shape[:2] == shape and array.ndim in (2, 3)
    if array.size == 0 or not (
        is_table or (array.ndim in (1, 2) and len(array) == size)
    ):
        raise ArgumentError(
            "features",
            f"must have shape {shape} (+ d), or {size} rows, one for each state-action"
            f" pair; they have shape {array.shape}",
        )
    _checks.require_finite(array, "features")
    given = array.reshape(size, -1)
    going = np.repeat(~simulator.absorbing(), shape[1])
    empty = np.flatnonzero((given == 0.0).all(axis=0))
    if empty.size:
        raise ArgumentError(
            "features",
            f"must not be 0 in every state-action pair; column {empty[0]} is",
        )
    if (np.ptp(given[going], axis=0) == 0.0).all():
        raise ArgumentError(
            "features",
            "must differ between state-action pairs; every column is constant",
        )
    phi = given * going[:, None]
    columns = np.flatnonzero((phi != 0.0).any(axis=0))
    _refuse_dependent(phi[np.ix_(going, columns)], columns)
    return phi[:, columns], columns


def _refuse_dependent(phi: Array, names: IntArray, where: str = "") -> None:
    """Raise a ValueError that names columns of which one combines the others."""
    lengths = np.sqrt((phi**2).sum(axis=0))
    scaled = phi / np.where(lengths > 0, lengths, 1.0)
    triangle, order = linalg.qr(scaled, mode="r", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    rank = int((sizes > RANK_TOLERANCE).sum())
    if rank == phi.shape[1]:
        return
    parts = linalg.solve_triangular(triangle[:rank, :rank], triangle[:rank, rank])
    columns = np.sort(
        np.append(order[:rank][np.abs(parts) > RANK_TOLERANCE], order[rank])
    )
    constant = [
        f" (column {names[c]} is constant)" for c in columns if np.ptp(phi[:, c]) == 0.0
    ]
    raise ValueError(
        f"features must be linearly independent{where}; columns"
        f" {', '.join(map(str, names[columns]))} are not" + "".join(constant)
    )


@dataclass(frozen=True)
class DualDice(TabularEstimator):
    """Tabular DualDICE [1]_ for a shift of the environment.

    Its base distribution is the policy's occupancy in the simulator.

    Raises
    ------
    ValueError
        When called, if the problem has a horizon or the discount is 1.

    See Also
    --------
    Marginalized : The same ratio of occupancies from zeta, or in a class of features.

    Notes
    -----
    nu minimises a quadratic, where P are the log's frequencies (the simulator's rows
    where the log has none), and w is the ratio of occupancies d_target / d_sim::

        1/2 E_{d_sim}[(nu - gamma P^pi nu)^2] - (1 - gamma) E_{mu_0 pi}[nu]
        w = nu - gamma P^pi nu,    J = E_{d_sim}[w r] / (1 - gamma)

    The value is identical to that of ``ModelBased(fallback="simulator")``.

    References
    ----------
    .. [1] Nachum et al., DualDICE: behavior-agnostic estimation of discounted
       stationary distribution corrections, NeurIPS 2019.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged infinite")
    >>> problem, same = pair.problem(1000, seed=0), ModelBased(fallback="simulator")
    >>> abs(
    ...     DualDice()(problem, pair.policy).value - same(problem, pair.policy).value
    ... ) < 1e-9
    True
    """

    claims = OF_COUNTS | {"consistent", "shift", "infinite"}

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Solve the quadratic program exactly.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            Not used: the estimate is exact given the log.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.

        Notes
        -----
        With B = I - gamma P^pi on pairs, and D the diagonal of d_sim, the normal
        equations are B^T D B nu = (1 - gamma) mu_0 pi: first y = D w from B^T y, then
        nu from B nu = w.
        """
        if problem.horizon is not None:
            raise ArgumentError(
                "horizon",
                "must be None for DualDICE, whose occupancies are of the infinite sum;"
                f" it is {problem.horizon}",
            )
        model = ModelBased(fallback="simulator").model(problem)
        gamma = model.discount
        kernel = policy_kernel(model, policy)
        if gamma == 1.0:
            raise ArgumentError("discount", "must be below 1 for DualDICE; it is 1")
        base = occupancy(problem.simulator, policy)
        states = solve_policy_system(
            kernel, (1.0 - gamma) * model.initial, gamma, transpose=True
        ).x
        weights = np.divide(
            states[:, None] * policy, base, out=np.zeros_like(base), where=base > 0
        )
        nu_states = solve_policy_system(kernel, (policy * weights).sum(axis=1), gamma).x
        nu = weights + gamma * (model.transitions @ nu_states).reshape(weights.shape)
        residual = (
            nu
            - gamma * (model.transitions @ (policy * nu).sum(axis=1)).reshape(nu.shape)
            - weights
        )
        return Estimate(
            float((base * weights * model.rewards).sum()) / (1.0 - gamma),
            diagnostics={
                "largest_weight": float(weights.max()),
                "residual": float(np.abs(residual).max()),
            },
        )

    def limit_of(self, population: Population) -> float:
        """Compute J of the target's rows where the data are, else the simulator's.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.
        """
        return population.value(population.model(population.simulator.transitions))
