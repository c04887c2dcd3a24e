"""The rows of a continuous task's report: functions of a policy that give an ``Estimate`` of J = E[sum_{t<T} gamma^t r_t].

Three are Monte Carlo in a task: the simulator, the simulator corrected by the log's residuals, a linear model of the log. Where
the task is learned from the log, the error of the value counts the rollouts and the log,

    se^2 = se_MC^2 + Var_b (J_b - J),    J_b of the task learned from resampled episodes,

J_b and J by common random numbers, and the interval is that of Student's t. The fourth is importance sampling on the log's own
episodes, with the policy's probabilities in the log's own states: every row of the log is a state of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse
from scipy.special import stdtrit

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._threads import one_thread
from oee_tabular.continuous.episodes import MonteCarlo, compare_returns, monte_carlo_value
from oee_tabular.continuous.history import consecutive
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.sentences import flaw
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

    def stream(self, *key: int) -> np.random.SeedSequence:
        """Random numbers of their own."""
        return np.random.SeedSequence(self.seed.entropy, spawn_key=(*self.seed.spawn_key, *key))

    def value(self, task: ContinuousTask, policy: StatePolicy) -> MonteCarlo:
        """J of the policy in the task."""
        seed = np.random.default_rng(self.stream())
        return monte_carlo_value(task, policy, self.episodes, self.horizon, discount=self.discount, seed=seed)

    def compare(self, tasks: Sequence[ContinuousTask], policy: StatePolicy) -> Array:
        """(len(tasks), paths) returns by common random numbers."""
        paths, seed = min(self.paths, self.episodes), self.stream(1)
        return compare_returns(tasks, policy, paths, self.horizon, discount=self.discount, seed=seed)


@dataclass(frozen=True, eq=False)
class SimulatorRow:
    """J in the simulator (or the target) itself.

    Attributes
    ----------
    is_headline : where no correction can be trusted; the rollouts' noise is no interval to speak of then
    """

    task: ContinuousTask
    rollouts: Rollouts
    is_headline: bool = False
    _known: dict[int, MonteCarlo] = field(default_factory=dict)

    def value(self, policy: StatePolicy) -> MonteCarlo:
        """Computed once for each policy."""
        if id(policy) not in self._known:
            self._known[id(policy)] = self.rollouts.value(self.task, policy)
        return self._known[id(policy)]

    @one_thread
    def __call__(self, policy: StatePolicy) -> Estimate:
        """No estimate from the log, but where it stands in front."""
        mc = self.value(policy)
        is_first = self.is_headline
        error = None if is_first else mc.standard_error
        return Estimate(mc.value, error, diagnostics=_facts(mc), is_headline=is_first, is_from_log=not is_first)


@dataclass(frozen=True, eq=False)
class LearnedRow:
    """J in a task learned from the log, as a linear model is, with an error by refits on resampled episodes.

    Attributes
    ----------
    learned : ContinuousTask whose ``resampled(rng)`` is the same fitted to a bootstrap's log
    status : why the value is not to be relied on, and then has no error; "ok"
    """

    learned: Any
    rollouts: Rollouts
    status: str = "ok"

    @one_thread
    def __call__(self, policy: StatePolicy) -> Estimate:
        """The value with the error of the log and of the rollouts."""
        mc, refits = self.rollouts.value(self.learned, policy), self.rollouts.refits
        if self.status != "ok":
            return Estimate(mc.value, None, None, _facts(mc), status=self.status)
        rngs = map(np.random.default_rng, self.rollouts.stream(2).spawn(refits))
        returns = self.rollouts.compare([self.learned, *map(self.learned.resampled, rngs)], policy)
        of_log = float((returns[1:] - returns[0]).mean(axis=1).std(ddof=1))
        error = float(np.hypot(of_log, mc.standard_error))
        reach = error * float(stdtrit(refits - 1, 0.975))
        facts = _facts(mc) | {
            "standard_error_of": "log and rollouts", "refits": refits, "standard_error_of_the_log": of_log,
            "interval_method": "refits",
        }  # fmt: skip
        return Estimate(mc.value, error, (mc.value - reach, mc.value + reach), facts, is_normal=True)


@dataclass(frozen=True, eq=False)
class ResidualRow(LearnedRow):
    """J in the simulator corrected by the log's residuals; it says how often the policy leaves what the log has seen."""

    learned: ResidualSimulator

    def __call__(self, policy: StatePolicy) -> Estimate:
        """The value, in front of all others where the correction can be trusted."""
        found, share = super().__call__(policy), self._share_beyond(policy)
        told = ", ".join(f"{c.name} {c.explained:.3g}" for c in self.learned.coordinates if c.kind != "zero")
        findings = (Finding("beyond", share, BEYOND, f"{share:.0%}"),) if share > MAX_BEYOND else ()
        facts = found.diagnostics | {"explained": told, "beyond_log": share}
        return replace(found, diagnostics=facts, findings=findings, is_headline=self.status == "ok")

    def _share_beyond(self, policy: StatePolicy) -> float:
        """Share of the policy's transitions that begin beyond what the log has seen."""
        counted = np.zeros(2)

        def watch(states: Array) -> Array:
            counted[:] += self.learned.beyond(states).sum(), len(states)
            return policy(states)

        replace(self.rollouts, paths=min(200, self.rollouts.paths)).compare([self.learned], watch)
        return float(counted[0] / counted[1])


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
    return ResidualRow(corrected, rollouts, flaw(corrected))(policy)


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
    paid = np.zeros(n + 1) if log.reward is None else np.append(log.reward, 0.0)
    mdp = FiniteMDP(kernel, paid, np.full(n + 1, 1.0 / (n + 1)), discount)
    columns: dict[str, Any] = log.columns() | {"state": np.arange(n), "next_state": following[:n]}
    columns["truncated"] = ~np.isin(np.arange(n), before) & ~log.terminated
    if log.reward is None:  # there is nothing to average
        columns |= {"episode": None, "timestep": None}
    problem = Problem(mdp, Transitions(**columns), horizon=horizon)

    def row(estimator: Estimator) -> Row:
        def weigh(policy: StatePolicy) -> Estimate:
            table = check_probabilities(policy, log.state, n_actions)
            return estimator(problem, np.vstack([table, np.full(n_actions, 1.0 / n_actions)]))

        return weigh

    return {name: row(estimator) for name, estimator in wanted.items()}


def _facts(mc: MonteCarlo) -> dict[str, Any]:
    return {"standard_error_of": "rollouts", "n_rollouts": mc.n_episodes}
