"""The rows of a report, in the order of what they may be trusted for.

A row (``ReportRow``) has a name and a function of a policy, which estimates
J = E[sum_{t<T} gamma^t r_t]. ``choose_rows`` says which rows a report has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

from oee_tabular.continuous.correction.choice import Correction
from oee_tabular.continuous.correction.linear_model import LinearModel
from oee_tabular.continuous.correction.residual import ResidualSimulator
from oee_tabular.continuous.correction.sentences import describe_flaw
from oee_tabular.continuous.evaluation.command_levels import (
    Rounding,
    include_rounding,
)
from oee_tabular.continuous.evaluation.prepare import Prepared
from oee_tabular.continuous.evaluation.rollouts import (
    Rollouts,
    refuse_impossible,
)
from oee_tabular.continuous.evaluation.sampling import sampling_rows
from oee_tabular.continuous.task.base import ContinuousTask, StatePolicy
from oee_tabular.continuous.task.episodes import MonteCarlo
from oee_tabular.estimators import Estimate, Estimator, ImportanceSampling
from oee_tabular.mdp import possible_sums

SIMULATOR = "simulator (continuous)"
LINEAR = "linear model of the log"
RESIDUAL = "oee (residual)"
TARGET = "target (continuous)"


@dataclass(frozen=True)
class ReportRow:
    """A row of a report.

    Attributes
    ----------
    name : str
        What it is called in the table.
    estimate : function
        Gives the ``Estimate`` of a policy's value.
    is_trusted : bool
        Whether its value may be relied on. Where no correction can be trusted, none of
        the rows of corrected simulators may.
    """

    name: str
    estimate: Callable[[StatePolicy], Estimate]
    is_trusted: bool = True


@dataclass(frozen=True)
class Rows:
    """The rows of a report, in three groups.

    On cells the calibrated row stands behind the first group, and the rows of finite
    estimators between the last two.

    Attributes
    ----------
    first : list of ReportRow
        The corrected simulators, behind the simulator where none can be trusted.
    others : list of ReportRow
        The linear model, importance sampling, the simulator.
    target : list of ReportRow
        The true target, where it is known.
    has_oee : bool
        Whether the off-environment estimator is asked for.
    simulate : function
        Gives the simulator's own value of a policy, a ``MonteCarlo``, computed once.
    """

    first: list[ReportRow]
    others: list[ReportRow]
    target: list[ReportRow]
    has_oee: bool
    simulate: Callable[[StatePolicy], MonteCarlo]

    def every(self) -> dict[str, ReportRow]:
        """Return all rows by name; a name that comes twice stands where it is first."""
        rows: dict[str, ReportRow] = {}
        for row in (*self.first, *self.others, *self.target):
            rows.setdefault(row.name, row)
        return rows


def choose_rows(
    prepared: Prepared,
    correction: Correction,
    rollouts: Rollouts,
    sampling: Mapping[str, Estimator],
    *,
    wants_oee: bool,
    wants_linear: bool,
    target: ContinuousTask | None,
    scale: float,
    roundings: Mapping[StatePolicy, Rounding],
) -> Rows:
    """Return the rows of a report.

    Parameters
    ----------
    prepared : Prepared
        The simulator and the log.
    correction : Correction
        The simulator corrected by the log.
    rollouts : Rollouts
        How values are computed. All rows share its streams, so that they differ by
        their tasks and not by chance.
    sampling : mapping from str to ImportanceSampling
        The estimators on the log's own episodes.
    wants_oee : bool
        Whether the rows of the corrected simulators are asked for.
    wants_linear : bool
        Whether the row of the linear model is.
    target : ContinuousTask or None
        The true target.
    scale : float
        By what values are multiplied in sentences.
    roundings : mapping from function to Rounding
        What giving commands by the task's actions does to the value of policies.

    Returns
    -------
    Rows
        The rows.
    """
    task = prepared.simulator.task
    simulate = cache(partial(rollouts.value, task))

    @cache
    def bounds(policy: StatePolicy) -> tuple[float, float]:
        """Return what the rewards of the log and of the simulator can sum to.

        The simulator's are those of its steps from the log's rows, and of the policy.
        """
        known = correction.plain.rewards
        own = rollouts.reward_range(task, policy)
        return possible_sums(
            min(known[0], own[0]),
            max(known[1], own[1]),
            rollouts.horizon,
            rollouts.discount,
            ends=bool(task.terminates or prepared.log.terminated.any()),
        )

    def learned_row(
        learned: ResidualSimulator | LinearModel, status: str, policy: StatePolicy
    ) -> Estimate:
        """Estimate a value in a learned task, and refuse an impossible one."""
        of_states = policy
        if learned is correction.learned:
            of_states = correction.policy(policy)
        estimate = rollouts.estimate(learned, of_states, status)
        estimate = include_rounding(estimate, roundings.get(policy))
        return refuse_impossible(estimate, *bounds(policy), rollouts.horizon, scale)

    def simulated_row(policy: StatePolicy) -> Estimate:
        """Estimate a value in the simulator itself."""
        return _describe_simulated(
            simulate(policy), is_headline=not correction.is_trusted
        )

    @cache
    def corrected_row(policy: StatePolicy) -> Estimate:
        """Estimate a value in the corrected simulator."""
        return learned_row(correction.learned, correction.status, policy)

    of_simulator = ReportRow(SIMULATOR, simulated_row)
    plain_status = describe_flaw(correction.plain)
    first: list[ReportRow] = []
    if not correction.is_trusted:
        first.append(of_simulator)
    if wants_oee:
        plain = partial(learned_row, correction.plain, plain_status)
        first.append(ReportRow(correction.name, corrected_row, correction.is_trusted))
        if correction.name != RESIDUAL:
            first.append(ReportRow(RESIDUAL, plain, plain_status == "ok"))
    others: list[ReportRow] = []
    if wants_linear:
        linear = partial(learned_row, LinearModel(task, prepared.log), plain_status)
        others.append(ReportRow(LINEAR, linear, plain_status == "ok"))
    by_weights = sampling_rows(
        sampling, prepared.log, task.n_actions, rollouts.horizon, rollouts.discount
    )
    others += [ReportRow(*named) for named in by_weights.items()]
    others.append(of_simulator)
    of_target = []
    if target is not None:
        of_target.append(
            ReportRow(TARGET, partial(_estimate_in_target, rollouts, target))
        )
    return Rows(first, others, of_target, wants_oee, simulate)


def split_sampling(
    wanted: Mapping[str, Estimator],
) -> tuple[dict[str, Estimator], dict[str, Estimator]]:
    """Return the estimators on the log's own episodes, and the others."""
    sampling: dict[str, Estimator] = {}
    finite: dict[str, Estimator] = {}
    for name, estimator in wanted.items():
        chosen = sampling if isinstance(estimator, ImportanceSampling) else finite
        chosen[name] = estimator
    return sampling, finite


def _estimate_in_target(
    rollouts: Rollouts, target: ContinuousTask, policy: StatePolicy
) -> Estimate:
    """Estimate a value in the true target, by Monte Carlo."""
    return _describe_simulated(rollouts.value(target, policy), is_from_log=True)


def _describe_simulated(
    mc: MonteCarlo, *, is_headline: bool = False, is_from_log: bool = False
) -> Estimate:
    """Return a value in the simulator (or the target) itself as an ``Estimate``.

    It is no estimate from the log. The target's is not the simulator's either, so it
    counts as one from a log. ``is_headline`` is for where no correction can be trusted;
    the rollouts' noise is no interval to speak of then.
    """
    error = None if is_headline else mc.standard_error
    facts = {"standard_error_of": "rollouts", "n_rollouts": mc.n_episodes}
    return Estimate(
        mc.value,
        error,
        diagnostics=facts,
        is_headline=is_headline,
        is_from_log=is_from_log,
    )
