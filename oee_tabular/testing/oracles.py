"""An estimator over many logs, beside its exact limit and the efficiency bound."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.estimators.rollouts import rollout_horizon
from oee_tabular.exact import (
    efficiency_bound,
    policy_value,
    trajectory_efficiency_bound,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy, optional_horizon_length
from oee_tabular.ratio.support import require_pair
from oee_tabular.simulate import sample_episodes, sample_transitions
from oee_tabular.testing.cases import pair_shares
from oee_tabular.testing.subject import name_of
from oee_tabular.typing import Array, PolicyLike, RealArrayLike


@checked(shapes={"values": "r"}, counts=("n", "failures"))
@dataclass(frozen=True, eq=False)
class OracleComparison:
    """Hold what repetitions of an estimator gave, beside what is exact.

    It prints as a table.

    Attributes
    ----------
    estimator : str
        Name of the estimator.
    truth : float
        J_target, the exact value of the policy in the target.
    limit : float or None
        The estimator's own exact limit.
    bound : float
        The efficiency bound: n times the least asymptotic variance; inf where the data
        leave something out.
    n : int
        Size of each log.
    unit : str
        What n counts, "episodes" or "transitions".
    values : ndarray of shape (R,)
        Values of the repetitions whose status is "ok".
    failures : int
        Number of the other repetitions.
    reasons : str
        Status of the first of them.

    Examples
    --------
    >>> found = OracleComparison(
    ...     "mine",
    ...     1.0,
    ...     None,
    ...     4.0,
    ...     100,
    ...     "episodes",
    ...     values=np.array([0.8, 1.0, 1.2, 1.4]),
    ... )
    >>> # 100 * variance / 4
    >>> (
    ...     round(found.bias, 4),
    ...     round(found.variance, 4),
    ...     round(found.inefficiency, 4),
    ... )
    (0.1, 0.0667, 1.6667)
    """

    estimator: str
    truth: float
    limit: float | None
    bound: float
    n: int
    unit: str
    values: Array = field(repr=False)
    failures: int = 0
    reasons: str = ""

    @property
    def bias(self) -> float:
        """Return the mean error over the repetitions."""
        return float(self.values.mean()) - self.truth if len(self.values) else math.nan

    @property
    def bias_error(self) -> float:
        """Return the standard error of ``bias``."""
        return math.sqrt(self.variance / max(len(self.values), 1))

    @property
    def variance(self) -> float:
        """Return the variance over the repetitions."""
        return float(self.values.var(ddof=1)) if len(self.values) > 1 else math.nan

    @property
    def variance_error(self) -> float:
        """Return the standard error of ``variance``.

        It is sqrt((m4 - (R - 3) / (R - 1) s^4) / R) with m4 the fourth central moment.
        """
        n = len(self.values)
        if n < 4:
            return math.nan
        fourth = float(np.mean((self.values - self.values.mean()) ** 4))
        return math.sqrt(max(fourth - (n - 3) / (n - 1) * self.variance**2, 0.0) / n)

    @property
    def rmse(self) -> float:
        """Return the root of the mean squared error."""
        if not len(self.values):
            return math.nan
        return float(np.sqrt(np.mean((self.values - self.truth) ** 2)))

    @property
    def rmse_error(self) -> float:
        """Return the standard error of ``rmse`` by the delta method."""
        n = len(self.values)
        if n < 2 or self.rmse == 0.0:
            return math.nan if n < 2 else 0.0
        return float(
            np.std((self.values - self.truth) ** 2, ddof=1)
            / np.sqrt(n)
            / (2.0 * self.rmse)
        )

    @property
    def inefficiency(self) -> float:
        """Return n * variance / bound, which tends to 1 for an efficient estimator.

        It is nan where the bound is 0 or infinite. With ``behavior_policy`` the bound
        is for time-indexed dynamics and starts that are estimated, too: an estimator
        that knows the dynamics to be stationary can be below it.
        """
        if not 0.0 < self.bound < math.inf:
            return math.nan
        return self.n * self.variance / self.bound

    @property
    def inefficiency_error(self) -> float:
        """Return the standard error of ``inefficiency``."""
        if not 0.0 < self.bound < math.inf:
            return math.nan
        return self.n * self.variance_error / self.bound

    def __str__(self) -> str:
        lines = [f"{self.estimator}: {len(self.values)} logs of {self.n} {self.unit}"]
        rows: list[tuple[str, float | None, float | None]] = [
            ("J_target", self.truth, None),
            ("limit", self.limit, None),
            ("bias", self.bias, self.bias_error),
            ("variance", self.variance, self.variance_error),
            ("root-mean-square error", self.rmse, self.rmse_error),
            ("efficiency bound (n * variance)", self.bound, None),
            ("n * variance / bound", self.inefficiency, self.inefficiency_error),
        ]
        for name, value, error in rows:
            shown = "" if error is None else f" ± {error:.2g}"
            lines += [] if value is None else [f"  {name:32}{value:11.5g}{shown}"]
        if self.failures:
            lines.append(
                f"  without a value: {self.failures} more logs ({self.reasons})"
            )
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return _printing.text(self, f"Values: {_printing.SUM}; variances in its square")


@suggest_keywords
def compare_with_oracle(
    estimator: Any,
    pair: tuple[FiniteMDP, FiniteMDP],
    policy: PolicyLike,
    *,
    n: int,
    behavior_policy: PolicyLike | None = None,
    data_distribution: RealArrayLike | None = None,
    repetitions: int = 200,
    seed: int = 0,
    horizon: int | None = None,
) -> OracleComparison:
    """Run an estimator on independent logs and put it beside what is exact.

    Parameters
    ----------
    estimator : callable or estimator
        What ``check_estimator`` takes, with a ``limit`` if it has one.
    pair : tuple of two FiniteMDP
        The simulator and the target.
    policy : PolicyLike
        The policy to evaluate.
    n : int
        Size of each log, in episodes or transitions.
    behavior_policy : PolicyLike, optional
        The policy that records: logs are ``n`` episodes of it, to the horizon (without
        one until discount^t < 1e-12).
    data_distribution : RealArrayLike of shape (S, A), optional
        Shares of the state-action pairs: logs are ``n`` independent transitions drawn
        from it. Exactly one of the two must be given.
    repetitions : int, default 200
        Number of logs, at least 2.
    seed : int, default 0
        Repetition k has the log of SeedSequence(seed, spawn_key=(k,)), and the
        estimator seed k.
    horizon : int, optional
        Number of rewards of the value; None means the infinite sum.

    Returns
    -------
    OracleComparison
        Bias, variance and root-mean-square error with their Monte Carlo standard
        errors, J_target, the estimator's limit, and the bound.

    Raises
    ------
    ValueError
        If an argument is wrong; and whatever the estimator raises.

    See Also
    --------
    check_estimator : Laws instead of numbers.

    Notes
    -----
    For episodes the bound is ``trajectory_efficiency_bound``, which includes the chance
    of the first state and takes time as part of the state, so that an estimator that
    knows the initial distribution or pools the steps may be below it. For transitions
    it is ``efficiency_bound``.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = (
    ...     oee.tasks.gridworld(3, 0.3, discount=0.9),
    ...     oee.tasks.gridworld(3, 0.1, discount=0.9),
    ... )
    >>> even = np.full((9, 4), 1 / 36)
    >>> found = compare_with_oracle(
    ...     oee.estimators.ModelBased(),
    ...     pair,
    ...     oee.uniform_policy(pair[0]),
    ...     n=2000,
    ...     data_distribution=even,
    ...     repetitions=20,
    ... )
    >>> abs(found.bias) < 4 * found.bias_error + 0.01, 0.3 < found.inefficiency < 2.0
    (True, True)
    """
    both = _checks.collection(pair, "pair", "(simulator, target)")
    if len(both) != 2:
        raise ArgumentError(
            "pair", f"must be (simulator, target); it holds {len(both)}"
        )
    simulator, target = both
    require_pair(target, simulator)
    own = as_estimator(estimator)
    pi = check_policy(policy, simulator)
    size = _checks.positive_integer(n, "n")
    times = _checks.positive_integer(repetitions, "repetitions")
    if times < 2:
        raise ArgumentError("repetitions", f"must be at least 2; it is {times}")
    _checks.require_memory(4.0 * times, "repetitions", times)
    if (behavior_policy is None) == (data_distribution is None):
        raise ValueError("one of behavior_policy and data_distribution must be given")
    source = _make_source(
        simulator, target, pi, size, behavior_policy, data_distribution, horizon
    )
    values = []
    statuses = []
    for k in range(times):
        log = source.draw(seed=_checks.seed_sequence(seed, (k,)))
        problem = Problem(
            simulator, log, horizon=horizon, behavior_policy=source.behavior
        )
        estimate = own(problem, pi.copy(), seed=k)
        if estimate.status == "ok":
            values.append(float(estimate.value))
        else:
            statuses.append(estimate.status)
    limit = getattr(own.function, "limit", None)
    if limit is not None:
        limit = float(limit(simulator, target, pi, horizon=horizon, **source.data))
    return OracleComparison(
        estimator=name_of(own.function),
        truth=policy_value(target, pi, horizon=horizon),
        limit=limit,
        bound=source.bound,
        n=size,
        unit="transitions" if source.behavior is None else "episodes",
        values=np.array(values),
        failures=len(statuses),
        reasons=statuses[0] if statuses else "",
    )


class _Source(NamedTuple):
    """Hold how logs are drawn, and what is exact about them."""

    draw: Callable[..., Transitions]
    bound: float
    behavior: Array | None
    data: dict[str, Array]


def _make_source(
    simulator: FiniteMDP,
    target: FiniteMDP,
    policy: Array,
    n: int,
    behavior_policy: PolicyLike | None,
    data_distribution: RealArrayLike | None,
    horizon: int | None,
) -> _Source:
    """Return how logs of size ``n`` are drawn: as transitions, or as episodes."""
    if behavior_policy is None:
        share = _checks.distribution(
            data_distribution,
            "data_distribution",
            (simulator.n_states, simulator.n_actions),
        )
        return _Source(
            partial(sample_transitions, target, share, n),
            efficiency_bound(target, policy, share, horizon=horizon),
            None,
            {"data_distribution": share},
        )
    behavior = check_policy(behavior_policy, simulator, name="behavior_policy")
    steps = rollout_horizon(target.discount, optional_horizon_length(horizon, target))
    try:
        bound = trajectory_efficiency_bound(target, behavior, policy, horizon=steps)
    except ValueError:
        if not np.any((policy > 0) & (behavior == 0)):
            raise
        # the behaviour policy never takes an action that the policy takes
        bound = math.inf
    return _Source(
        partial(sample_episodes, target, behavior, n, steps),
        bound,
        behavior,
        {
            "data_distribution": pair_shares(target, behavior, steps),
            "behavior_policy": behavior,
        },
    )
