"""Doubly robust estimators: a model's value, and the log's residuals on top of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._sparse import align, row_of_entry, row_sums
from oee_tabular._threads import one_thread
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import (
    OF_COUNTS,
    Estimate,
    ExactLimit,
    catch_divergence,
    error_or_none,
    mean_and_error,
)
from oee_tabular.estimators.episodes import EpisodeTerms, episode_limit, model_values
from oee_tabular.estimators.model_based import delta_error
from oee_tabular.estimators.off_environment import OffEnvironment, RatioOption, coverage, ratio_claims
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.estimators.rollouts import rollout_horizon
from oee_tabular.exact import Model, policy_value, reweight, transition_gradient
from oee_tabular.exact.efficiency import require_action_support
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import horizon_length
from oee_tabular.ratio import TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.simulate.sampler import Drawn, draw


@dataclass(frozen=True)
class DoublyRobust(ExactLimit):
    """A value that is right if either of its two parts is.

    Parameters
    ----------
    data : "transitions" | "rollouts" | "episodes"
        transitions: J_sim + 1/(1 - gamma) E_log[w (r + gamma V_sim(s') - Q_sim(s, a))], "the simulator, and the occupancy-
        weighted sim-to-real residual"; exact given the log, for any horizon (time sums inside).
        rollouts: on rollouts of the simulator, D_t = r_t + gamma [m_t + zeta_{t+1} (D_{t+1} - V_sim(s_{t+1}))], with
        m_t = sum_s' zeta P V_sim: the paper's product with a control variate.
        episodes: on the log's episodes (policy importance sampling), D_t = V(s_t) + rho_t [r_t + gamma D_{t+1} -
        Q(s_t, a_t)], V and Q of the model zeta * P; an episode that was truncated goes on as V.
    weights : "occupancy" | "beta", for transitions
        w = d / d_log with d the occupancy in zeta * P, or only the simulator's: then the error is of second order in the
        mismatch of the two environments, and no zeta is fitted
    ratio : as in ``OffEnvironment``: where zeta is from
    self_normalized : for episodes: the weights of each step divided by their sum (weighted doubly robust [2])
    n_rollouts : for rollouts

    Notes
    -----
    Limits: ``limit``. On transitions with a zeta from the log the standard error is that of J(zeta * P): where zeta * P are the
    log's frequencies the value is J there, since d is as uncertain as the residual. Under a zeta that is given, or with
    "beta", d is known, and the error is the residual's. Sources:
    [1] N. Jiang and L. Li, Doubly robust off-policy value evaluation, ICML 2016. [2] P. Thomas and E. Brunskill, Data-efficient
    off-policy policy evaluation, ICML 2016.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> estimate = DoublyRobust()(pair.problem(1000, seed=0), pair.policy)
    >>> round(estimate.diagnostics["simulator_value"], 1), round(estimate.value, 1), round(estimate.standard_error, 1)
    (8.0, 10.2, 0.2)
    """

    data: Literal["transitions", "rollouts", "episodes"] = "transitions"
    weights: Literal["occupancy", "beta"] = "occupancy"
    ratio: RatioOption = "conditional"
    self_normalized: bool = False
    n_rollouts: int = 100

    def __post_init__(self) -> None:
        _checks.one_of(self.data, "data", ("transitions", "rollouts", "episodes"))
        _checks.one_of(self.weights, "weights", ("occupancy", "beta"))
        _checks.boolean(self.self_normalized, "self_normalized")
        if self.self_normalized and self.data != "episodes":
            raise ValueError(f"self_normalized must be False with data {self.data!r}: it is for episodes")
        _checks.positive_integer(self.n_rollouts, "n_rollouts")
        OffEnvironment(ratio=self.ratio)  # or an error

    @one_thread
    @catch_divergence
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """``seed`` is for rollouts and for ratios that sample the simulator."""
        pi = require_policy(problem, policy)
        generator = _checks.generator(seed)
        if self.data == "transitions":
            return self._correct_by_transitions(problem, pi, generator)
        zeta = OffEnvironment(ratio=self.ratio).fit(problem, pi, generator)
        if self.data == "rollouts":
            return self._average_rollouts(problem, pi, zeta, generator)
        terms = EpisodeTerms.from_problem(
            problem, pi, reweight(problem.model, zeta), self_normalized=self.self_normalized
        )
        return terms.estimate(zeta, terms.total, terms.error)

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        known = ratio_claims(self.ratio)
        if self.data == "transitions":  # with "beta" no zeta is fitted
            return known | {"shift"} if self.weights == "occupancy" else OF_COUNTS | {"identical", "shift"}
        if self.data == "rollouts":
            return known | {"random"}
        if self.self_normalized:
            return known - {"after_end"} | {"consistent"}
        return known | ({"consistent", "unbiased"} if isinstance(self.ratio, TransitionRatio) else {"consistent"})

    def _correct_by_transitions(self, problem: Problem, policy: Array, generator: np.random.Generator) -> Estimate:
        """J_sim + sum over recorded pairs of visits(s, a) sum_s' (frequency - P) (r + gamma V_sim)."""
        model, horizon = problem.model, problem.horizon
        where: Model = model
        base = policy_value(model, policy, horizon=horizon)
        diagnostics: dict[str, object] = {"standard_error_of": "log", "simulator_value": base}
        if self.weights == "occupancy":
            zeta = OffEnvironment(ratio=self.ratio).fit(problem, policy, generator)
            where = reweight(model, zeta)
            diagnostics["gap"] = zeta.gap
        gradient = transition_gradient(where, policy, horizon=horizon, values_of=model)
        observed, _ = align(problem.counts, model.transitions)
        total = row_sums(model.transitions, observed)
        counts = total[row_of_entry(model.transitions)]
        recorded = counts > 0
        frequency = np.divide(observed, counts, out=np.zeros_like(observed), where=recorded)
        change = float(gradient[recorded] @ (frequency - model.transitions.data)[recorded])
        if self.weights == "occupancy" and not isinstance(self.ratio, TransitionRatio):
            gradient = transition_gradient(where, policy, horizon=horizon)
        noise = delta_error(model.transitions, frequency, total, gradient)
        error = error_or_none(noise, gradient, model.transitions.indptr)
        time = coverage(problem, where, policy, total.reshape(model.n_states, -1))
        return Estimate(
            base + change,
            error,
            diagnostics=diagnostics | time,
            findings=(
                *findings.unseen_time(time["fallback_share"], bare=error is not None, judged=True),
                *findings.no_variation(error),
                *(findings.gap(zeta.gap) if self.weights == "occupancy" else ()),
            ),
            measured=time["coverage"],
        )

    def _average_rollouts(
        self, problem: Problem, policy: Array, zeta: TransitionRatio, generator: np.random.Generator
    ) -> Estimate:
        model = problem.model
        zeta.on(model)  # or an error
        steps = rollout_horizon(model.discount, problem.horizon)
        n_steps = horizon_length(steps, model)
        drawn = draw(model, policy, self.n_rollouts, n_steps, seed=generator, zeta=zeta, record=True, name="n_rollouts")
        values, _ = model_values(model, policy, problem.horizon, steps)
        value, error = mean_and_error(_rollout_values(model, drawn, values))
        return Estimate(
            value,
            error,
            diagnostics={"standard_error_of": "rollouts", "n_rollouts": self.n_rollouts, "gap": zeta.gap},
            findings=(*findings.no_variation(error), *findings.gap(zeta.gap)),
        )

    def limit_of(self, population: Population) -> float:
        """The exact population limit.

        transitions: J_sim + sum_x visits(x) sum_s' (P_target - P_sim) (r + gamma V_sim), x where the data are, visits in the
        limit of zeta * P or in the simulator; rollouts: J of the limit of zeta * P; episodes: J_target where the behaviour
        policy takes every action of the policy (None: it does), else what the model makes of the rest (self-normalised:
        an error that names an action).
        """
        simulator, target, policy, horizon = (
            population.simulator, population.target, population.policy, population.horizon,
        )  # fmt: skip
        limit_model = OffEnvironment(ratio=self.ratio).limit_model(population)
        if self.data == "rollouts":
            return population.value(limit_model)
        if self.data == "episodes":
            if self.self_normalized and population.behavior is not None:
                require_action_support(target, population.behavior, policy, horizon)
            return episode_limit(population, limit_model)
        where: Model = limit_model if self.weights == "occupancy" else simulator
        gradient = transition_gradient(where, policy, horizon=horizon, values_of=simulator)
        inside, _ = align(target.transitions, simulator.transitions)
        recorded = population.support[row_of_entry(simulator.transitions)]
        change = float(gradient[recorded] @ (inside - simulator.transitions.data)[recorded])
        return policy_value(simulator, policy, horizon=horizon) + change


def _rollout_values(model: FiniteMDP, drawn: Drawn, values: Array) -> Array:
    """D_0 of each rollout, backward in time: D = m + zeta (gamma D' - gamma V(s')), m = sum_s' zeta P (r + gamma V(s')).

    ``values`` (T + 1, S) are V; those after the last step change no mean.
    """
    matrix, by_transition = model.transitions, model.reward_data is not None
    kernel, rows = drawn.ratio * matrix.data, row_of_entry(matrix)
    pay = row_sums(matrix, kernel * model.reward_data) if by_transition else model.rewards.reshape(-1)
    ahead, previous = np.zeros(len(drawn.lengths)), None
    constant = values[0] if values.strides[0] == 0 else None
    for t in range(int(drawn.lengths.max()) - 1, -1, -1):
        following = values[t + 1] if constant is None else constant
        if following is not previous:
            going = model.discount * following
            known, previous = pay + row_sums(matrix, kernel * going[matrix.indices]), following
        alive = np.flatnonzero(drawn.lengths > t)
        entry = drawn.path[drawn.starts[alive] + t]
        change = model.discount * ahead[alive] - going[matrix.indices[entry]]
        ahead[alive] = known[rows[entry]] + drawn.ratio[entry] * change
    return ahead
