"""Doubly robust estimators: a model's value, and the log's residuals on top of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

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
    identified,
    mean_and_error,
    without_divergence,
)
from oee_tabular.estimators.episodes import episode_estimate, episode_limit, episode_terms
from oee_tabular.estimators.model_based import delta_error
from oee_tabular.estimators.off_environment import OffEnvironment, RatioOption, coverage, of_ratio
from oee_tabular.estimators.problem import Problem, checked_policy
from oee_tabular.estimators.rollouts import rollout_horizon
from oee_tabular.exact import (
    Model,
    evaluate_policy,
    policy_value,
    reweight,
    state_values,
    transition_gradient,
)
from oee_tabular.exact.efficiency import require_action_support
from oee_tabular.exact.finite import values_to_go
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import horizon_length
from oee_tabular.ratio import TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.simulate.sampler import Drawn, draw

DATA = ("transitions", "rollouts", "episodes")
WEIGHTS = ("occupancy", "beta")


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
    Limits: ``limit``. Sources: [1] N. Jiang and L. Li, Doubly robust off-policy value evaluation, ICML 2016. [2] P. Thomas and
    E. Brunskill, Data-efficient off-policy policy evaluation, ICML 2016.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> estimate = DoublyRobust()(pair.problem(1000, seed=0), pair.policy)
    >>> round(estimate.diagnostics["simulator_value"], 2), round(estimate.value, 2), round(estimate.standard_error, 2)
    (7.97, 10.19, 0.14)
    """

    data: Literal["transitions", "rollouts", "episodes"] = "transitions"
    weights: Literal["occupancy", "beta"] = "occupancy"
    ratio: RatioOption = "conditional"
    self_normalized: bool = False
    n_rollouts: int = 100

    def __post_init__(self) -> None:
        _checks.one_of(self.data, "data", DATA)
        _checks.one_of(self.weights, "weights", WEIGHTS)
        _checks.boolean(self.self_normalized, "self_normalized")
        if self.self_normalized and self.data != "episodes":
            raise ValueError(f"self_normalized must be False with data {self.data!r}: it is for episodes")
        _checks.positive_integer(self.n_rollouts, "n_rollouts")
        OffEnvironment(ratio=self.ratio)  # or an error

    @one_thread
    @without_divergence
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """``seed`` is for rollouts and for ratios that sample the simulator."""
        pi = checked_policy(problem, policy)
        generator = _checks.generator(seed)
        if self.data == "transitions":
            return self._on_transitions(problem, pi, generator)
        zeta = OffEnvironment(ratio=self.ratio).fit(problem, pi, generator)
        if self.data == "rollouts":
            return self._on_rollouts(problem, pi, zeta, generator)
        found = episode_terms(problem, pi, reweight(problem.model, zeta), self_normalized=self.self_normalized)
        return episode_estimate(found, zeta, found.total, found.error)

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        known = of_ratio(self.ratio)
        if self.data == "transitions":  # with "beta" no zeta is fitted
            return known | {"shift"} if self.weights == "occupancy" else OF_COUNTS | {"identical", "shift"}
        if self.data == "rollouts":
            return known | {"random"}
        if self.self_normalized:
            return known - {"after_end"} | {"consistent"}
        return known | ({"consistent", "unbiased"} if isinstance(self.ratio, TransitionRatio) else {"consistent"})

    def _on_transitions(self, problem: Problem, policy: Array, generator: np.random.Generator) -> Estimate:
        model = problem.model
        base = evaluate_policy(model, policy, horizon=problem.horizon)
        where: Model = model
        diagnostics: dict[str, object] = {"standard_error_of": "log", "simulator_value": base.value}
        unsolved: tuple[findings.Finding, ...] = ()
        if self.weights == "occupancy":
            zeta = OffEnvironment(ratio=self.ratio).fit(problem, policy, generator)
            where = reweight(model, zeta)
            diagnostics["gap"] = zeta.gap
            unsolved = findings.gap(zeta.gap)
        gradient = transition_gradient(where, policy, horizon=problem.horizon, values_of=model)
        observed, _ = align(problem.counts, model.transitions)
        total = row_sums(model.transitions, observed)
        rows = row_of_entry(model.transitions)
        seen = total[rows] > 0
        frequency = np.divide(observed, total[rows], out=np.zeros_like(observed), where=seen)
        change = float(gradient[seen] @ (frequency - model.transitions.data)[seen])
        error = delta_error(model.transitions, frequency, total, gradient)
        time = coverage(problem, where, policy, total.reshape(model.n_states, -1))
        told = identified(error, gradient, model.transitions.indptr)
        unseen = findings.unseen_time(time.get("fallback_share", 0.0), bare=told is not None, judged=True)
        return Estimate(
            base.value + change,
            told,
            diagnostics=diagnostics | time,
            findings=(*unseen, *findings.varied(told), *unsolved),
            measured=time.get("coverage", 1.0),
        )

    def _on_rollouts(self, problem: Problem, policy: Array, zeta: Any, generator: np.random.Generator) -> Estimate:
        model = problem.model
        zeta.on(model)  # or an error
        steps = rollout_horizon(model.discount, problem.horizon)
        n_steps = horizon_length(steps, model)
        drawn = draw(model, policy, self.n_rollouts, n_steps, seed=generator, zeta=zeta, record=True, name="n_rollouts")
        values = _rollout_values(model, drawn, _to_go(model, policy, problem.horizon, steps))
        value, error = mean_and_error(values)
        return Estimate(
            value,
            error,
            diagnostics={"standard_error_of": "rollouts", "n_rollouts": self.n_rollouts, "gap": zeta.gap},
            findings=(*findings.varied(error), *findings.gap(zeta.gap)),
        )

    def limit_of(self, people: Population) -> float:
        """The exact population limit.

        transitions: J_sim + sum_x visits(x) sum_s' (P_target - P_sim) (r + gamma V_sim), x where the data are, visits in the
        limit of zeta * P or in the simulator; rollouts: J of the limit of zeta * P; episodes: J_target where the behaviour
        policy takes every action of the policy (None: it does), else what the model makes of the rest (self-normalised:
        an error that names an action).
        """
        limit_model = OffEnvironment(ratio=self.ratio).limit_model(people)
        if self.data == "rollouts":
            return people.value(limit_model)
        if self.data == "episodes":
            if self.self_normalized and people.behavior is not None:
                require_action_support(people.target, people.behavior, people.policy, people.horizon)
            return episode_limit(people, limit_model)
        where: Model = limit_model if self.weights == "occupancy" else people.simulator
        gradient = transition_gradient(where, people.policy, horizon=people.horizon, values_of=people.simulator)
        inside, _ = align(people.target.transitions, people.simulator.transitions)
        seen = people.support[row_of_entry(people.simulator.transitions)]
        change = float(gradient[seen] @ (inside - people.simulator.transitions.data)[seen])
        return policy_value(people.simulator, people.policy, horizon=people.horizon) + change


def _to_go(model: FiniteMDP, policy: Array, horizon: int | None, steps: int) -> list[Array]:
    """What V is after each of T steps: nothing after the last; of the infinite sum the same before."""
    if horizon is None:
        return [state_values(model, policy)] * (steps - 1) + [np.zeros(model.n_states)]
    return list(values_to_go(model, policy, steps)[1:])


def _rollout_values(model: FiniteMDP, drawn: Drawn, values: list[Array]) -> Array:
    """D_0 of each rollout, backward in time."""
    from oee_tabular.estimators._episodes import control_variates

    zeta, lengths, starts, path = drawn.ratio, drawn.lengths, drawn.starts, drawn.path
    longest = np.argsort(-lengths, kind="stable")
    begin, alive = starts[longest], np.searchsorted(-lengths[longest], -np.arange(len(values)), side="left")
    rows, columns = row_of_entry(model.transitions), model.transitions.indices
    kernel, by_move = zeta * model.transitions.data, model.reward_data is not None
    pay = row_sums(model.transitions, kernel * model.reward_data) if by_move else model.rewards.reshape(-1)
    ahead, last = np.zeros(len(lengths)), int(lengths.max())
    for t in range(last - 1, -1, -1):
        if t == last - 1 or values[t] is not values[t + 1]:
            going = model.discount * values[t]
            known = pay + row_sums(model.transitions, kernel * going[columns])
        places = begin[: alive[t]] + t
        control_variates(places, path, columns, rows, zeta, known, going, model.discount, ahead)
    return ahead
