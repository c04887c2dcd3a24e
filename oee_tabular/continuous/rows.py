"""The rows of a continuous task's report: functions of a policy that give an ``Estimate`` of J = E[sum_{t<T} gamma^t r_t].

Three are Monte Carlo in a task (``Rollouts``): the simulator, the simulator corrected by the log's residuals, a linear model of
the log; of the last two the error counts the rollouts and the log, see ``corrected_value``. The fourth is importance sampling
on the log's own episodes, with the policy's probabilities in the log's own states: every row of the log is a state of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse
from scipy.special import stdtrit

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._threads import one_thread
from oee_tabular.continuous.correction import describe_flaw
from oee_tabular.continuous.episodes import MonteCarlo, compare_returns, monte_carlo_value
from oee_tabular.continuous.history import consecutive
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_probabilities
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Estimator, Problem
from oee_tabular.estimators.findings import Finding
from oee_tabular.mdp import FiniteMDP

MAX_BEYOND = 0.02  # share of a policy's transitions beyond the log's range: more is said
QUANTILE = 1.96  # of the intervals that estimators set themselves
BEYOND = (
    "{} of the policy's transitions start outside the range of the recorded states. The correction is a guess there, and no "
    "interval counts its error."
)

Row: TypeAlias = Callable[[StatePolicy], Estimate]


@dataclass(frozen=True)
class Rollouts:
    """How values are computed by Monte Carlo.

    Attributes
    ----------
    horizon, discount : of the value
    episodes : of each value
    seed : of all of them, whatever the policy and the task
    refits, paths : how many logs are resampled, and the episodes by which J_b - J is computed
    """

    horizon: int
    discount: float
    episodes: int
    seed: np.random.SeedSequence
    refits: int = 20
    paths: int = 1000

    def _stream(self, *key: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed.entropy, spawn_key=(*self.seed.spawn_key, *key))

    @one_thread
    def value(self, task: ContinuousTask, policy: StatePolicy) -> MonteCarlo:
        """J of the policy in the task."""
        seed = np.random.default_rng(self._stream())
        return monte_carlo_value(task, policy, self.episodes, self.horizon, discount=self.discount, seed=seed)

    def _returns(self, tasks: Sequence[ContinuousTask], policy: StatePolicy, n: int) -> Array:
        n, seed = min(n, self.paths, self.episodes), self._stream(1)
        return compare_returns(tasks, policy, n, self.horizon, discount=self.discount, seed=seed)

    @one_thread
    def estimate(self, learned: Any, policy: StatePolicy, status: str = "ok") -> Estimate:
        """J in a task learned from the log, with the error of the log and of the rollouts.

        Parameters
        ----------
        learned : ContinuousTask whose ``resampled(rng)`` is the same fitted to a bootstrap's log; a report begins with the
            value in a ``ResidualSimulator``, which says how often the policy leaves what the log has seen
        policy : of the task's states
        status : why the value is not to be relied on, and then has no error; "ok"
        """
        mc = self.value(learned, policy)
        facts = _count_rollouts(mc)
        error: float | None = None
        interval: tuple[float, float] | None = None
        findings: tuple[Finding, ...] = ()
        if status == "ok":
            rngs = map(np.random.default_rng, self._stream(2).spawn(self.refits))
            returns = self._returns([learned, *map(learned.resampled, rngs)], policy, self.paths)
            of_log = float((returns[1:] - returns[0]).mean(axis=1).std(ddof=1))
            error = float(np.hypot(of_log, mc.standard_error))
            reach = error * float(stdtrit(self.refits - 1, 0.975))
            interval = mc.value - reach, mc.value + reach
            facts |= {
                "standard_error_of": "log and rollouts", "refits": self.refits, "standard_error_of_the_log": of_log,
                "interval_method": "refits",
            }  # fmt: skip
        is_corrected = isinstance(learned, ResidualSimulator)
        if is_corrected:
            share = self._share_beyond(learned, policy)
            explained = ", ".join(f"{c.name} {c.explained:.3g}" for c in learned.coordinates if c.kind != "zero")
            facts |= {"explained": explained, "beyond_log": share}
            findings = (Finding("beyond", share, BEYOND, f"{share:.0%}"),) * (share > MAX_BEYOND)
        is_first = is_corrected and status == "ok"
        return Estimate(
            mc.value, error, interval, facts, status, findings, is_normal=status == "ok", is_headline=is_first
        )

    def _share_beyond(self, learned: ResidualSimulator, policy: StatePolicy) -> float:
        """Share of the policy's transitions that begin beyond what the log has seen."""
        counts = np.zeros(2)

        def watch(states: Array) -> Array:
            counts[:] += learned.beyond(states).sum(), len(states)
            return policy(states)

        self._returns([learned], watch, 200)
        return float(counts[0] / counts[1])


def _count_rollouts(mc: MonteCarlo) -> dict[str, Any]:
    return {"standard_error_of": "rollouts", "n_rollouts": mc.n_episodes}


def describe_simulated(mc: MonteCarlo, *, is_headline: bool = False) -> Estimate:
    """A value in the simulator (or the target) itself: no estimate from the log.

    ``is_headline`` where no correction can be trusted; the rollouts' noise is no interval to speak of then.
    """
    error, facts = None if is_headline else mc.standard_error, _count_rollouts(mc)
    return Estimate(mc.value, error, diagnostics=facts, is_headline=is_headline, is_from_log=not is_headline)


def corrected_value(
    corrected: ResidualSimulator,
    policy: StatePolicy,
    n_episodes: int,
    horizon: int,
    *,
    discount: float = 0.99,
    refits: int = 20,
    paths: int = 1000,
    seed: Seed = None,
) -> Estimate:
    """J = E[sum_{t<T} gamma^t r_t] in the corrected simulator by Monte Carlo, its standard error and 95% interval.

        se^2 = se_MC^2 + Var_b (J_b - J),   J_b of the correction fitted to resampled episodes; by common random numbers

    Parameters
    ----------
    corrected : ResidualSimulator
    policy : function of states (n, d) giving probabilities (n, A)
    n_episodes : of the value
    horizon : T, the number of rewards
    discount : gamma, in [0, 1]
    refits, paths : how many logs are resampled, at least 2, and the episodes by which J_b - J is computed
    seed : the same seed gives the same bits

    Returns
    -------
    Estimate
        ``status`` is not "ok", and there is no interval, where history explains what the correction leaves over: the state is
        not Markov then.

    Notes
    -----
    (n_episodes + (refits + 1) paths) horizon steps of the corrected simulator. The interval is that of Student's t. It covers
    the variation between logs, not a change that no smooth correction fits.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=2000, max_steps=100, seed=0)
    >>> corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    >>> found = corrected_value(corrected, cartpole_policy(0.6), 1000, 100, refits=5, paths=200, seed=0)
    >>> found.status, bool(found.interval[0] < found.value < found.interval[1])
    ('ok', True)
    """
    _checks.instance(corrected, ResidualSimulator, "corrected")
    _checks.function(policy, "policy")
    steps = _checks.positive_integer(horizon, "horizon")
    episodes, n_refits = _checks.positive_integer(n_episodes, "n_episodes"), _checks.positive_integer(refits, "refits")
    if n_refits < 2:
        raise ValueError(f"refits must be at least 2, for a variance; got {refits}")
    each, gamma = _checks.positive_integer(paths, "paths"), _checks.number_in(discount, "discount", 0.0, 1.0)
    rollouts = Rollouts(steps, gamma, episodes, _checks.seed_sequence(seed, ()), n_refits, each)
    return rollouts.estimate(corrected, policy, describe_flaw(corrected))


def refuse_impossible(estimate: Estimate, lowest: float, highest: float, horizon: int, scale: float = 1.0) -> Estimate:
    """Without a value that lies beyond the least and the most that the rewards can sum to, and with a sentence.

    A value that is beyond by at most 1.96 standard errors is put on the bound; ``scale`` multiplies values in the sentence.
    """
    value = estimate.value
    room = 1e-9 * max([1.0, *(abs(bound) for bound in (lowest, highest) if np.isfinite(bound))])
    nearest = float(np.clip(value, lowest, highest))
    if not np.isfinite(value) or abs(nearest - value) <= room:
        return estimate
    if abs(nearest - value) <= QUANTILE * (estimate.standard_error or 0.0):
        return replace(estimate, value=nearest)
    shown, low, high = (x * scale for x in (value, lowest, highest))
    text = f"{shown:.4g} is impossible: a sum of {horizon} rewards is between {low:.4g} and {high:.4g}"
    facts = estimate.diagnostics | {"refused_value": value}
    return replace(
        estimate, value=float("nan"), standard_error=None, interval=None, status=text, findings=(), diagnostics=facts
    )


def sampling_rows(
    wanted: Mapping[str, Estimator], log: ContinuousTransitions, n_actions: int, horizon: int, discount: float
) -> dict[str, Row]:
    """Importance sampling by name, on the episodes of a log whose actions are numbers.

    Row i of the log is state i; whatever is done there, the row that follows in its episode comes, or the end, state n. What
    follows a truncated episode is not known; it is not the end.
    """
    if not wanted:
        return {}
    n = len(log)
    before, after = consecutive(log)
    following = np.append(np.where(log.terminated, n, 0), n)
    following[before] = after
    entries = np.ones((n + 1) * n_actions), np.repeat(following, n_actions), np.arange((n + 1) * n_actions + 1)
    kernel = sparse.csr_array(entries, shape=((n + 1) * n_actions, n + 1))
    rewards = np.zeros(n + 1) if log.reward is None else np.append(log.reward, 0.0)
    mdp = FiniteMDP(kernel, rewards, np.full(n + 1, 1.0 / (n + 1)), discount)
    columns: dict[str, Any] = log.columns() | {"state": np.arange(n), "next_state": following[:n]}
    columns["truncated"] = ~np.isin(np.arange(n), before) & ~log.terminated
    if log.reward is None:  # there is nothing to average
        columns |= {"episode": None, "timestep": None}
    problem = Problem(mdp, Transitions(**columns), horizon=horizon)

    def weigh(estimator: Estimator, policy: StatePolicy) -> Estimate:
        table = check_probabilities(policy, log.state, n_actions)
        return estimator(problem, np.vstack([table, np.full(n_actions, 1.0 / n_actions)]))

    return {name: partial(weigh, estimator) for name, estimator in wanted.items()}
