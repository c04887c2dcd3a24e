"""Estimators through occupancy ratios: no product of ratios along a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._sparse import row_sums
from oee_tabular._threads import one_thread
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import OF_COUNTS, Estimate, ExactLimit, expected_rewards, without_divergence
from oee_tabular.estimators.model_based import ModelBased
from oee_tabular.estimators.off_environment import OffEnvironment, RatioOption, coverage, of_ratio
from oee_tabular.estimators.problem import Problem, checked_policy
from oee_tabular.estimators.rewards import simulator_rewards
from oee_tabular.exact import Model, occupancy, reweight
from oee_tabular.exact.linear import solve_policy_system
from oee_tabular.exact.system import policy_kernel
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import total_discount
from oee_tabular.ratio import density_ratio
from oee_tabular.ratio.arguments import check_box
from oee_tabular.ratio.method import Population


@dataclass(frozen=True)
class Marginalized(ExactLimit):
    """The paper's follow-up [1]: J = E_log[beta w r] / (1 - gamma), with two ratios of occupancies.

    beta = d_sim / d_log, by ``density_ratio`` (direct supervision: the simulator's occupancy against the log's rows), and
    w = d_target / d_sim, here the exact tabular solution: the occupancy in zeta * P over the simulator's.

    Parameters
    ----------
    ratio : as in ``OffEnvironment``: where zeta is from
    lower, upper : lower <= beta <= upper where the log has rows (None: no bound; then beta is exact there)

    Notes
    -----
    Rows that the log never visited pay nothing: their share of the policy's time is in the diagnostics. Source: [1] P. Katdare,
    N. Jiang and K. Driggs-Campbell, Marginalized importance sampling for off-environment policy evaluation, CoRL 2023.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> estimate = Marginalized()(pair.problem(1000, seed=0), pair.policy)
    >>> round(estimate.value, 2), round(estimate.diagnostics["largest_weight"], 2)
    (10.15, 0.87)
    """

    ratio: RatioOption = "conditional"
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        OffEnvironment(ratio=self.ratio)  # or an error
        check_box(self.lower, self.upper, normalized=False)

    @one_thread
    @without_divergence
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """Exact given the log and zeta; ``seed`` is for ratios that sample the simulator."""
        pi = checked_policy(problem, policy)
        zeta = OffEnvironment(ratio=self.ratio).fit(problem, pi, _checks.generator(seed))
        model = reweight(problem.model, zeta)
        counts = row_sums(problem.counts)
        pay = _rewards_of_rows(problem)
        value, weights, gap = self._value(model, problem.simulator, pi, problem.horizon, counts, pay)
        share = counts / counts.sum()
        worst, seen = max(gap, zeta.gap), coverage(problem, model, pi, counts.reshape(model.n_states, -1))
        return Estimate(
            value,
            diagnostics={
                "gap": worst,
                "largest_weight": float(weights.max()),
                "mean_weight": float(share @ weights),
                **seen,
            },
            findings=(*findings.unseen_time(seen.get("fallback_share", 0.0)), *findings.gap(worst)),
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``: rows that the log never visited pay nothing, so that rewards cannot be shifted."""
        known = of_ratio(self.ratio) - {"shift"}
        boxed = self.lower is not None or self.upper is not None
        return known - {"consistent", "padding", "after_end"} if boxed else known

    def _value(
        self, model: Model, simulator: FiniteMDP, policy: Array, horizon: int | None, counts: Array, pay: Array
    ) -> tuple[float, Array, float]:
        """J, the weights beta w on (S*A,), and beta's gap."""
        share = counts / counts.sum()
        here = occupancy(simulator, policy, horizon=horizon).reshape(-1)
        there = occupancy(model, policy, horizon=horizon).reshape(-1)
        seen = share > 0
        beta, gap = np.zeros_like(share), 0.0
        inside = float(here[seen].sum())
        if inside > 0:  # the fit scales both to distributions: its ratio is beta / inside, and so is its box
            box = check_box(self.lower, self.upper, normalized=False)
            fit = density_ratio(
                here[seen], share[seen], lower=box.lower / inside, upper=box.upper / inside, normalized=False
            )
            beta[seen], gap = fit.ratio * inside, fit.gap
        shift = np.divide(there, here, out=np.zeros_like(there), where=here > 0)
        weights = beta * shift
        return total_discount(model.discount, horizon) * float(share @ (weights * pay)), weights, gap

    def limit_of(self, people: Population) -> float:
        """sum over the data's support of (box-clipped beta) * w * d_log * r, w in the limit of zeta * P."""
        model = OffEnvironment(ratio=self.ratio).limit_model(people)
        pay = expected_rewards(people.simulator, people.target.transitions)
        share = people.distribution.reshape(-1)
        return self._value(model, people.simulator, people.policy, people.horizon, share, pay)[0]


def _rewards_of_rows(problem: Problem) -> Array:
    """(S*A,) mean reward of the log's moves in each row (0 where there are none)."""
    log, n_actions = problem.log, problem.simulator.n_actions
    rows = log.state * n_actions + log.action
    size = problem.simulator.n_states * n_actions
    moves = log.moves()
    if moves.reward_sum is None or moves.reward_count is None:
        total, count = simulator_rewards(problem.simulator, log) * moves.number, moves.number
    else:
        total, count = moves.reward_sum, moves.reward_count
        unpaid = np.bincount(rows, weights=count, minlength=size)[rows] == 0  # rewards are missing: the simulator's
        total = np.where(unpaid, simulator_rewards(problem.simulator, log) * moves.number, total)
        count = np.where(unpaid, moves.number, count)
    paid = np.bincount(rows, weights=total, minlength=size)
    number = np.bincount(rows, weights=count, minlength=size)
    return np.divide(paid, number, out=np.zeros(size), where=number > 0)


@dataclass(frozen=True)
class DualDice(ExactLimit):
    """Tabular DualDICE [1] for a shift of the environment, with the simulator's occupancy as its base distribution.

    nu minimises 1/2 E_{d_sim}[(nu - gamma P^pi nu)^2] - (1 - gamma) E_{mu_0 pi}[nu], P the log's frequencies (the simulator's
    rows where it has none); w = nu - gamma P^pi nu = d_target / d_sim, and J = E_{d_sim}[w r] / (1 - gamma).

    Notes
    -----
    Without a horizon only. Identical to the model-based value with ``fallback="simulator"``: both are the maximum-likelihood
    model's. ``diagnostics`` has the largest |nu| and w. Source: [1] O. Nachum et al., DualDICE: behavior-agnostic estimation of
    discounted stationary distribution corrections, NeurIPS 2019.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged infinite")
    >>> problem, same = pair.problem(1000, seed=0), ModelBased(fallback="simulator")
    >>> abs(DualDice()(problem, pair.policy).value - same(problem, pair.policy).value) < 1e-9
    True
    """

    @one_thread
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """Exact given the log; ``seed`` is not used."""
        pi = checked_policy(problem, policy)
        if problem.horizon is not None:
            raise ValueError(
                f"horizon must be None for DualDICE, whose occupancies are of the infinite sum; it is {problem.horizon}"
            )
        model = ModelBased(fallback="simulator").model(problem)
        value, nu, weights, missed = _dual_dice(model, problem.simulator, pi)
        return Estimate(
            value,
            diagnostics={
                "largest_weight": float(weights.max()),
                "largest_nu": float(np.abs(nu).max()),
                "residual": missed,
            },
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        return OF_COUNTS | {"consistent", "shift", "infinite"}

    def limit_of(self, people: Population) -> float:
        """J of the target's rows where the data are, the simulator's elsewhere."""
        return people.value(people.model(people.simulator.transitions))


def _dual_dice(model: FiniteMDP, simulator: FiniteMDP, policy: Array) -> tuple[float, Array, Array, float]:
    """J, nu (S, A), w (S, A), and the largest residual of the normal equations.

    With B = I - gamma P^pi on (s, a) they are B^T D B nu = (1 - gamma) mu_0 pi: first y = D w from B^T y, then nu from
    B nu = w.
    """
    gamma = model.discount
    if gamma == 1.0:
        raise ValueError("discount must be below 1 for DualDICE; it is 1")
    base = occupancy(simulator, policy)
    kernel = policy_kernel(model, policy)
    states = solve_policy_system(kernel, (1.0 - gamma) * model.initial, gamma, transpose=True).x
    weights = np.divide(states[:, None] * policy, base, out=np.zeros_like(base), where=base > 0)
    nu_states = solve_policy_system(kernel, (policy * weights).sum(axis=1), gamma).x
    nu = weights + gamma * (model.transitions @ nu_states).reshape(weights.shape)
    residual = nu - gamma * (model.transitions @ (policy * nu).sum(axis=1)).reshape(nu.shape) - weights
    value = float((base * weights * model.rewards).sum()) / (1.0 - gamma)
    return value, nu, weights, float(np.abs(residual).max())
