"""Rows of a report by Monte Carlo in a task.

They estimate J = E[sum_{t<T} gamma^t r_t] in the simulator, in the simulator corrected
by the log's residuals, or in a linear model of the log. Of the last two the error
counts the rollouts and the log, see ``corrected_value``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular.continuous.correction.linear_model import LinearModel
from oee_tabular.continuous.correction.residual import ResidualSimulator
from oee_tabular.continuous.correction.sentences import describe_flaw
from oee_tabular.continuous.task.base import ContinuousTask, StatePolicy
from oee_tabular.continuous.task.episodes import (
    MonteCarlo,
    compare_returns,
    monte_carlo_value,
    record,
)
from oee_tabular.estimators import (
    Estimate,
)
from oee_tabular.estimators.findings import Finding
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, Seed

# A finding tells of a larger share of transitions that start beyond the log's range.
MAX_BEYOND_SHARE = 0.02
# Where a larger share starts there, the value is a guess, and none is stated.
MAX_GUESSED_SHARE = 0.5
N_WATCHED = 200  # episodes in which states and rewards are watched
QUANTILE = 1.96  # standard errors, of the intervals that estimators set themselves
BEYOND = (
    "{} of the policy's transitions start outside the range of the recorded states. The"
    " correction is a guess there, and no interval counts its error."
)
GUESSED = (
    "{} of the policy's transitions start outside the range of the recorded states,"
    " where the correction is a guess"
)


@dataclass(frozen=True)
class Rollouts:
    """How values are computed by Monte Carlo.

    Attributes
    ----------
    horizon : int
        The number of rewards.
    discount : float
        Gamma, in [0, 1].
    episodes : int
        The number of episodes of each value.
    seed : numpy.random.SeedSequence
        The seed of all values, whatever the policy and the task.
    refits : int
        How many logs are resampled.
    paths : int
        The number of episodes by which each J_b - J is computed.
    """

    horizon: int
    discount: float
    episodes: int
    seed: np.random.SeedSequence
    refits: int = 20
    paths: int = 1000

    def _stream(self, *key: int) -> np.random.SeedSequence:
        """Return the seed of a stream of its own."""
        return np.random.SeedSequence(
            self.seed.entropy, spawn_key=(*self.seed.spawn_key, *key)
        )

    def value(self, task: ContinuousTask, policy: StatePolicy) -> MonteCarlo:
        """Estimate J of the policy in the task."""
        seed = np.random.default_rng(self._stream())
        return monte_carlo_value(
            task, policy, self.episodes, self.horizon, discount=self.discount, seed=seed
        )

    def _sample_returns(
        self, tasks: Sequence[ContinuousTask], policy: StatePolicy, n: int
    ) -> Array:
        """Sample returns (len(tasks), at most n) with common random numbers."""
        n = min(n, self.paths, self.episodes)
        seed = self._stream(1)
        return compare_returns(
            tasks, policy, n, self.horizon, discount=self.discount, seed=seed
        )

    def compare(
        self, tasks: Sequence[ContinuousTask], policies: Sequence[StatePolicy]
    ) -> Array:
        """Sample returns of tasks under policies of their own, with common chance."""
        return compare_returns(
            tasks,
            policies,
            min(self.paths, self.episodes),
            self.horizon,
            discount=self.discount,
            seed=self._stream(4),
        )

    def estimate(
        self,
        learned: ResidualSimulator | LinearModel,
        policy: StatePolicy,
        status: str = "ok",
    ) -> Estimate:
        """Estimate J in a task learned from the log.

        Its error counts the log and the rollouts.

        Parameters
        ----------
        learned : ContinuousTask
            A task whose ``resampled(rng)`` is the same fitted to a bootstrap's log. A
            report begins with the value in a ``ResidualSimulator``, which says how
            often the policy leaves what the log has observed.
        policy : function
            The policy, of the task's states.
        status : str, default 'ok'
            Why the value is not to be relied on, and then has no error; or 'ok'.

        Returns
        -------
        Estimate
            The value.
        """
        mc = self.value(learned, policy)
        facts: dict[str, Any] = {
            "standard_error_of": "rollouts",
            "n_rollouts": mc.n_episodes,
        }
        findings: tuple[Finding, ...] = ()
        if isinstance(learned, ResidualSimulator):
            share = self._share_beyond(learned, policy)
            corrected = [c for c in learned.coordinates if c.kind != "zero"]
            explained = ", ".join(f"{c.name} {c.explained:.3g}" for c in corrected)
            facts |= {"explained": explained, "beyond_log": share}
            if share > MAX_GUESSED_SHARE and status == "ok":
                status = GUESSED.format(f"{share:.0%}")
            elif share > MAX_BEYOND_SHARE:
                findings = (Finding("beyond", share, BEYOND, f"{share:.0%}"),)
        is_ok = status == "ok"
        error: float | None = None
        interval: tuple[float, float] | None = None
        if is_ok:
            of_log = self._error_of_log(learned, policy)
            error = float(np.hypot(of_log, mc.standard_error))
            reach = error * float(stdtrit(self.refits - 1, 0.975))
            interval = mc.value - reach, mc.value + reach
            facts |= {
                "standard_error_of": "log and rollouts",
                "refits": self.refits,
                "standard_error_of_the_log": of_log,
                "interval_method": "refits",
            }
        return Estimate(
            mc.value,
            error,
            interval,
            facts,
            status,
            findings,
            is_normal=is_ok,
            is_headline=is_ok and isinstance(learned, ResidualSimulator),
        )

    def _error_of_log(
        self, learned: ResidualSimulator | LinearModel, policy: StatePolicy
    ) -> float:
        """Return the standard error of a value by the log, from resampled episodes."""
        rngs = map(np.random.default_rng, self._stream(2).spawn(self.refits))
        refitted = [learned.resampled(rng) for rng in rngs]
        returns = self._sample_returns([learned, *refitted], policy, self.paths)
        return float((returns[1:] - returns[0]).mean(axis=1).std(ddof=1))

    def _share_beyond(self, learned: ResidualSimulator, policy: StatePolicy) -> float:
        """Return the share of transitions that start outside the log's range."""
        counts = np.zeros(2)

        def watch(states: Array) -> Array:
            """Count the states beyond the log's, and return probabilities."""
            counts[:] += learned.beyond(states).sum(), len(states)
            return policy(states)

        self._sample_returns([learned], watch, N_WATCHED)
        return float(counts[0] / counts[1])

    def reward_range(
        self, task: ContinuousTask, policy: StatePolicy
    ) -> tuple[float, float]:
        """Return the least and the largest reward of a policy's first episodes."""
        n = min(N_WATCHED, self.paths, self.episodes)
        seed = np.random.default_rng(self._stream(3))
        log = record(task, policy, n_episodes=n, max_steps=self.horizon, seed=seed)
        rewards = np.zeros(1) if log.reward is None else log.reward
        return float(rewards.min()), float(rewards.max())


@suggest_keywords
@one_thread
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
    """Estimate J in the corrected simulator by Monte Carlo, with error and interval.

    J = E[sum_{t<T} gamma^t r_t]; its standard error counts the rollouts and the log,

        se^2 = se_MC^2 + Var_b (J_b - J),

    J_b of the correction fitted to resampled episodes, by common random numbers.

    Parameters
    ----------
    corrected : ResidualSimulator
        The corrected simulator.
    policy : function
        The policy: of states (n, d) it gives probabilities (n, A).
    n_episodes : int
        The number of episodes of the value.
    horizon : int
        T, the number of rewards.
    discount : float, default 0.99
        Gamma, in [0, 1].
    refits : int, default 20
        How many logs are resampled, at least 2.
    paths : int, default 1000
        The number of episodes by which each J_b - J is computed.
    seed : int, Generator or SeedSequence, optional
        The source of random numbers. The same seed gives the same bits.

    Returns
    -------
    Estimate
        The value with its standard error and 95% interval. Its ``status`` is not "ok",
        and there is no interval, where the log's columns seem to be in other units,
        where history explains what the correction leaves over (the state is not
        Markov), and where more than half of the policy's transitions start outside the
        range of the log's states.

    Raises
    ------
    ValueError
        If a number is out of its range.

    See Also
    --------
    monte_carlo_value : The value in a task, without the error of a log.

    Notes
    -----
    Costs (n_episodes + (refits + 1) paths) horizon steps of the corrected simulator.
    The interval is that of Student's t. It covers the variation between logs, not a
    change that no smooth correction fits.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=2000,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    >>> found = corrected_value(
    ...     corrected, cartpole_policy(0.6), 1000, 100, refits=5, paths=200, seed=0
    ... )
    >>> found.status, bool(found.interval[0] < found.value < found.interval[1])
    ('ok', True)
    """
    _checks.instance(corrected, ResidualSimulator, "corrected")
    _checks.function(policy, "policy")
    steps = _checks.positive_integer(horizon, "horizon")
    episodes = _checks.positive_integer(n_episodes, "n_episodes")
    n_refits = _checks.positive_integer(refits, "refits")
    n_paths = _checks.positive_integer(paths, "paths")
    if n_refits < 2:
        raise ArgumentError(
            "refits", f"must be at least 2, for a variance; got {refits}"
        )
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    stream = _checks.seed_sequence(seed, ())
    rollouts = Rollouts(steps, gamma, episodes, stream, n_refits, n_paths)
    return rollouts.estimate(corrected, policy, describe_flaw(corrected))


def refuse_impossible(
    estimate: Estimate, lowest: float, highest: float, horizon: int, scale: float = 1.0
) -> Estimate:
    """Return the estimate without a value that no sum of the rewards can have.

    The status then says so in a sentence. A value that is beyond the bounds by at most
    1.96 standard errors is put on the bound, and the interval to quote ends there,
    unless it reaches over all that is possible. ``scale`` multiplies values in the
    sentence.
    """
    estimate = replace(estimate, bounds=(lowest, highest))
    value = estimate.value
    shown, low, high = (x * scale for x in (value, lowest, highest))
    possible = f"a sum of {horizon} rewards is between {low:.4g} and {high:.4g}"
    if not np.isfinite(value):
        return _without_value(
            estimate,
            f"{shown:.4g} is no finite number: the states grow without end",
            value,
        )
    bounds = [abs(bound) for bound in (lowest, highest) if np.isfinite(bound)]
    rounding = 1e-9 * max(bounds, default=0.0)
    nearest = float(np.clip(value, lowest, highest))
    if abs(nearest - value) <= rounding:
        return estimate
    if abs(nearest - value) <= QUANTILE * (estimate.standard_error or 0.0):
        if not _covers(estimate.interval, lowest, highest):
            return replace(estimate, value=nearest)
        return _without_value(
            estimate,
            f"{shown:.4g} is a guess: its interval reaches over all that is possible"
            f" ({possible})",
            value,
        )
    return _without_value(estimate, f"{shown:.4g} is impossible: {possible}", value)


def _covers(
    interval: tuple[float, float] | None, lowest: float, highest: float
) -> bool:
    """Return whether an interval reaches over two bounds."""
    if interval is None or lowest == highest:
        return False
    return interval[0] <= lowest and interval[1] >= highest


def _without_value(estimate: Estimate, text: str, value: float) -> Estimate:
    """Return the estimate without its value; the status says why."""
    facts = estimate.diagnostics | {"refused_value": value}
    return replace(
        estimate,
        value=float("nan"),
        standard_error=None,
        interval=None,
        status=text,
        findings=(),
        diagnostics=facts,
    )
