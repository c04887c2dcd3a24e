"""Estimators through occupancy ratios: no product of ratios along a path."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import linalg, sparse

from oee_tabular import _checks
from oee_tabular._sparse import align, row_sums
from oee_tabular.estimators.base import (
    OF_COUNTS,
    Estimate,
    RatioEstimator,
    RatioOption,
    TabularEstimator,
    coverage,
    learnable_shares,
)
from oee_tabular.estimators.model_based import ModelBased
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.rewards import mean_rewards
from oee_tabular.exact import Model, occupancy, reweight
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import solve_policy_system
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import total_discount
from oee_tabular.ratio import density_ratio
from oee_tabular.ratio.dual import check_box
from oee_tabular.ratio.method import Population
from oee_tabular.typing import Array, IntArray

# of the saddle point's matrix, its columns scaled: above it no digit of theta is sure
MAX_CONDITION = 1e12
RANK_TOLERANCE = 1e-10  # of a unit column's part that others do not span


@dataclass(frozen=True, eq=False)
class Marginalized(RatioEstimator):
    """The paper's follow-up [1]: J = E_log[beta w r] / (1 - gamma), with two ratios of
    occupancies.

    beta = d_sim / d_log, by ``density_ratio``, and w = d_target / d_sim: the occupancy
    in zeta * P over the simulator's, or with ``features`` the published saddle point in
    the class w = phi theta,

        A = E_log[beta phi (gamma phi'_pi - phi)^T],    A^T theta = -(1 - gamma) E phi_0,

    with phi'_pi the mean of phi(s', a') under the policy, and phi_0 that at the start.

    Parameters
    ----------
    ratio : as in ``OffEnvironment``: the source of zeta; not with ``features``, which
        need none
    lower, upper : lower <= beta <= upper where the log has pairs (None: no bound; beta
        is then exact there)
    features : phi(s, a), an array of shape (S, A), (S, A, d) or (S*A, d), or a function
        of (s, a) arrays
        Without a horizon only. They are 0 after the end of an episode; those that are 0
        in every recorded pair are left out.

    Notes
    -----
    Unrecorded pairs have reward 0. One-hot features give maximum likelihood on the
    recorded
    pairs. Limit: exact; with ``features`` that of the class, which depends on how pairs
    are recorded unless the class contains d_target / d_sim. Source: [1] P. Katdare, N.
    Jiang and K. Driggs-Campbell, Marginalized importance sampling for off-environment
    policy evaluation, CoRL 2023.

    Raises
    ------
    ValueError
        When called: features of another shape, all constant, or linearly dependent (the
        columns are named);
        a horizon, or discount 1, with features.

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
    features: Any = field(default=None, repr=False)

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
        """Exact given the log and zeta; ``generator`` is for ratios that sample the
        simulator.
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
            shift = self._solve_class(simulator, policy, problem.counts / total, beta)
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
        """Words of ``testing.CLAIMS``. Unrecorded pairs have reward 0: rewards cannot
        be shifted.
        """
        if self.features is not None:
            return frozenset({"scale", "infinite"})
        known = self.model_claims - {"shift"}
        boxed = self.lower is not None or self.upper is not None
        return known - {"consistent", "padding", "after_end"} if boxed else known

    def limit_of(self, population: Population) -> float:
        """sum over the data's support of clipped beta * w * d_log * r, w as zeta * P or
        the class have it.
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
        # the target's transitions pay what the simulator's do
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
        """Beta on (S*A,), 0 where the log has nothing, and its gap."""
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
        # the fit scales both to distributions: its ratio is beta / inside, and so is
        # its box
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
        transitions: sparse.csr_array,
        beta: Array,
    ) -> Array:
        """w = phi theta on (S*A,); ``transitions`` (S*A, S) are the log's shares, which
        sum to 1.
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
    """(S*A,) the policy's occupancy in the model over the simulator's; 0 where the
    simulator has none.
    """
    here, there = (
        occupancy(m, policy, horizon=horizon).reshape(-1) for m in (simulator, model)
    )
    return np.divide(there, here, out=np.zeros_like(there), where=here > 0)


def _pair_features(features: object, simulator: FiniteMDP) -> tuple[Array, IntArray]:
    """phi (S*A, d), 0 where the episode is over, and the numbers of the columns that
    are not 0 then.
    """
    shape = (simulator.n_states, simulator.n_actions)
    size = shape[0] * shape[1]
    array = (
        features(*np.divmod(np.arange(size), shape[1]))
        if callable(features)
        else features
    )
    array = _checks.float_array(array, "features")
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
    """A ValueError that names columns of which one is a combination of the others."""
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
    """Tabular DualDICE [1] for a shift of the environment; the simulator's occupancy is
    its base distribution.

    nu minimises 1/2 E_{d_sim}[(nu - gamma P^pi nu)^2] - (1 - gamma) E_{mu_0 pi}[nu], P
    the log's frequencies
    (the simulator's rows where it has none); w = nu - gamma P^pi nu = d_target / d_sim,
    and
    J = E_{d_sim}[w r] / (1 - gamma).

    Notes
    -----
    Without a horizon only. Identical to the model-based value with
    ``fallback="simulator"``. Source: [1]
    O. Nachum et al., DualDICE: behavior-agnostic estimation of discounted stationary
    distribution corrections, NeurIPS 2019.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged infinite")
    >>> problem, same = pair.problem(1000, seed=0), ModelBased(fallback="simulator")
    >>> abs(DualDice()(problem, pair.policy).value - same(problem, pair.policy).value) < 1e-9
    True
    """

    claims = OF_COUNTS | {"consistent", "shift", "infinite"}

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Exact given the log.

        With B = I - gamma P^pi on pairs the normal equations are B^T D B nu = (1 -
        gamma) mu_0 pi: first
        y = D w from B^T y, then nu from B nu = w.
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
        """J of the target's rows where the data are, the simulator's elsewhere."""
        return population.value(population.model(population.simulator.transitions))
