"""Evaluation of policies by a continuous simulator and a log of continuous states.

The rows (``rows``) are functions of a policy, in the order of what they may be trusted
for (``evaluate_continuous``); where a grid is asked for, a finite problem joins them
(``rows.OnCells``). What the cells cannot take is said, and the other rows stand.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks, _progress
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import conform
from oee_tabular.continuous.correction.choice import choose_correction
from oee_tabular.continuous.correction.linear_model import LinearModel
from oee_tabular.continuous.correction.parameters import (
    ParameterFit,
    fit_parameters,
    parameters_of,
)
from oee_tabular.continuous.correction.residual import ResidualSimulator
from oee_tabular.continuous.correction.sentences import (
    describe_flaw,
    difference,
)
from oee_tabular.continuous.evaluation.on_cells import OnCells
from oee_tabular.continuous.evaluation.policies import (
    CommandPolicy,
    as_probabilities,
)
from oee_tabular.continuous.evaluation.rollouts import (
    Rollouts,
    Row,
    refuse_impossible,
)
from oee_tabular.continuous.evaluation.sampling import sampling_rows
from oee_tabular.continuous.evaluation.simulator import (
    ContinuousSimulator,
    Settings,
    as_simulator,
)
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
    check_probabilities,
    require_log_of,
)
from oee_tabular.continuous.task.episodes import MonteCarlo
from oee_tabular.estimators import (
    Estimate,
    Estimator,
    ImportanceSampling,
    OffEnvironment,
    Problem,
    Simulator,
)
from oee_tabular.estimators.calibrated import KINDS
from oee_tabular.estimators.names import named_estimators
from oee_tabular.estimators.rewards import is_rounded
from oee_tabular.exceptions import (
    ArgumentError,
    DiscretizationWarning,
    NoCellsError,
)
from oee_tabular.report import (
    Report,
    Result,
    Uncertainty,
    choose_interval,
    evaluate,
    group_findings,
    number_notes,
)
from oee_tabular.typing import Array, IntArrayLike, RealArrayLike, SeedNumbers

CALIBRATIONS = (*KINDS, "none")
SIMULATOR = "simulator (continuous)"
LINEAR = "linear model of the log"
# A policy's commands are compared with those that are played in so many of the log's
# states.
MAX_POLICY_STATES = 1000


@suggest_keywords
@one_thread
@_progress.show_steps(only_terminal=True)
def evaluate_continuous(
    simulator: ContinuousSimulator | ContinuousTask,
    log: ContinuousTransitions,
    policies: Mapping[str, StatePolicy | Array],
    *,
    settings: Settings | None = None,
    behavior: StatePolicy | None = None,
    target: ContinuousTask | None = None,
    history: int | Literal["auto"] = "auto",
    fit: Sequence[str] | ParameterFit | None = None,
    estimators: Sequence[str] | None = None,
    horizon: int | None = None,
    discount: float = 0.99,
    confidence: float = 0.95,
    seed: SeedNumbers = None,
    normalized: bool = False,
    facts: Mapping[str, Any] | None = None,
    guaranteed: bool = False,
    quick: bool = False,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
    tie: IntArrayLike | None = None,
    features: RealArrayLike | None = None,
) -> Report:
    """Evaluate policies of a continuous task in the target that a log was recorded in.

    Parameters
    ----------
    simulator : ContinuousSimulator or ContinuousTask
        The simulator. A ContinuousTask needs ``horizon``.
    log : ContinuousTransitions
        A log of the target.
    policies : mapping from str to function or array
        Policies by name: functions of states (n, d) giving probabilities (n, A), or (S,
        A) arrays of probabilities on the cells.
    settings : Settings, optional
        The grid, the calibration, and the treatment of states outside the grid and of
        actions that the task does not have. None means ``Settings()``.
    behavior : function, optional
        The policy that recorded the log, where the log lacks its probabilities.
    target : ContinuousTask, optional
        The true target, where it is known: adds its own Monte Carlo value.
    history : int or 'auto', default 'auto'
        How many last actions are in the state; 'auto' chooses 0 to 5 by held-out error,
        where the state is not Markov.
    fit : sequence of str or ParameterFit, optional
        The names of parameters of the simulator that are fitted to the log first, or
        their fit.
    estimators : sequence of str, optional
        Names, as in ``evaluate``. None means oee, a linear model of the log, importance
        sampling where the log has probabilities, and on cells the simulator and the
        model-based baseline.
    horizon : int, optional
        The number of rewards; None means the simulator's.
    discount : float, default 0.99
        Gamma, in [0, 1].
    confidence : float, default 0.95
        The level of the intervals, in (0, 1).
    seed : int or sequence of int, optional
        The seed of all random numbers. The same seed gives the same report. None draws
        a new seed.
    normalized : bool, default False
        Whether the report multiplies values by (1 - discount).
    facts : mapping, optional
        More to keep in the report's ``facts``.
    guaranteed : bool, default False
        Whether to compute also the intervals that cover at any sample size. They need
        ``settings.grid``.
    quick : bool, default False
        Whether likelihood intervals, which take most of the time on cells, are left
        out.
    lower_ratio : float, optional
        A lower bound of the target's transition probabilities over the simulator's, on
        cells, as in ``interval``. It narrows likelihood and guaranteed intervals.
    upper_ratio : float, optional
        An upper bound of them.
    tie : array_like of int, optional
        A key of each transition on cells, as in ``transition_ratio``; adds the row
        oee-tied.
    features : array_like, optional
        Features of each transition on cells, as in ``transition_ratio``; adds the row
        oee-features.

    Returns
    -------
    Report
        Estimates with their intervals, in the order policy, estimator.

    Raises
    ------
    ValueError
        If the log does not fit the task, or states lie outside the grid and
        ``settings.outside`` is "error".

    Warns
    -----
    DiscretizationWarning
        If the rows on the grid are left out.

    See Also
    --------
    evaluate : The same for finite problems.
    corrected_value : The value of one policy in a corrected simulator.

    Notes
    -----
    The report states first the Monte Carlo value of the corrected simulator
    (``choose_correction``), or the simulator's value if no correction can be trusted.
    Its rows are:

    - "simulator (continuous)": always, by Monte Carlo.
    - "oee (residual)": if "oee" is among the estimators.
    - "linear model of the log": if ``estimators`` is None.
    - "oee (calibrated)" and "oee on the grid": if ``settings.grid`` is given as well.
      The latter has the error of the grid.

    ``facts`` has the support diagnostics and the closure error. If the cells do not fit
    the log, their rows are left out and a warning says why.

    Examples
    --------
    >>> from oee_tabular.continuous.command import continuous_simulator
    >>> simulator, target = (
    ...     continuous_simulator(f"cartpole:gravity={g}") for g in (10, 15)
    ... )
    >>> log = target.record(target.policy("mix:0.7"), n_transitions=2000, seed=0)
    >>> few = Settings(episodes=2000)
    >>> report = evaluate_continuous(
    ...     simulator,
    ...     log,
    ...     {"expert": simulator.expert},
    ...     settings=few,
    ...     seed=0,
    ...     estimators=["oee"],
    ... )
    >>> [row["estimator"] for row in report.records()]
    ['oee (residual)', 'simulator (continuous)']
    """
    chosen = _checks.instance(
        Settings() if settings is None else settings, Settings, "settings"
    )
    if isinstance(simulator, ContinuousTask):
        simulator = as_simulator(simulator, horizon)
    _checks.instance(
        simulator,
        ContinuousSimulator,
        "simulator",
        "ContinuousTask or a ContinuousSimulator",
    )
    if not _checks.instance(
        policies, Mapping, "policies", "mapping from names to policies"
    ):
        raise ArgumentError("policies", "must hold at least one; it is empty")
    _checks.boolean(normalized, "normalized")
    _checks.boolean(guaranteed, "guaranteed")
    _checks.boolean(quick, "quick")
    own_facts = dict(
        conform({} if facts is None else facts, "facts", Mapping[str, Any])
    )
    _checks.instance(
        simulator.task if target is None else target, ContinuousTask, "target"
    )
    names = None if estimators is None else _names(estimators, "estimators")
    if fit is not None and not isinstance(fit, ParameterFit):
        fit = _names(fit, "fit")
    kind = simulator.calibration if chosen.calibration is None else chosen.calibration
    _checks.one_of(kind, "calibration", CALIBRATIONS)
    steps = simulator.horizon
    if horizon is not None:
        steps = _checks.positive_integer(horizon, "horizon")
    require_log_of(simulator.task, log)
    cells = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        columns = log.columns() | {
            "action": log.action_numbers(simulator.task.actions, strict=chosen.strict)
        }
        if behavior is not None and log.behavior_probability is None:
            probabilities = check_probabilities(
                behavior, log.state, simulator.task.n_actions
            )
            columns["behavior_probability"] = probabilities[
                np.arange(len(log)), columns["action"]
            ]
        numbered = ContinuousTransitions(**columns)
        if chosen.grid is not None:
            try:
                cells = OnCells(simulator, numbered, chosen, steps, discount, seed)
            except NoCellsError as reason:
                _checks.warn(
                    f"The rows on the grid are left out: {reason}",
                    DiscretizationWarning,
                )
    of_user = [w for w in caught if issubclass(w.category, UserWarning)]
    categories = {str(w.message): w.category for w in of_user}
    messages = list(categories)
    for message, category in categories.items():
        _checks.warn(message, category)
    tables: dict[str, Array] = {}
    functions: dict[str, StatePolicy] = {}
    for name, policy in policies.items():
        if callable(policy):
            rounded = as_probabilities(policy, simulator.task.actions)
            functions[name] = rounded
            rounding = _describe_rounding(name, rounded, log.state[:MAX_POLICY_STATES])
            if rounding:
                messages.append(rounding)
        elif cells is None:
            raise ArgumentError(
                f"policy {name!r}",
                "must be a function of states: there are no cells to be an array on",
            )
        if cells is not None:
            given = functions.get(name, policy)
            tables[name] = cells.model.policy(given, f"policy {name!r}")
            functions.setdefault(name, cells.model.policy_function(tables[name]))
    if fit is not None and not isinstance(fit, ParameterFit):
        fit = fit_parameters(*parameters_of(simulator.task, fit), numbered)
    correction = choose_correction(
        simulator.task, numbered, history=history, fit=fit, seed=seed
    )
    episodes = simulator.episodes if chosen.episodes is None else chosen.episodes
    # all rows share one stream, so that they differ by their tasks and not by chance
    stream = _checks.seed_sequence(seed, (10**6,))
    rollouts = Rollouts(
        steps, discount, episodes, stream, simulator.refits, simulator.refit_paths
    )
    simulate = cache(partial(rollouts.value, simulator.task))
    scale = 1.0 - discount if normalized else 1.0
    low, high = correction.plain.rewards
    bounds = 0.0 if low >= 0.0 else -np.inf, 0.0 if high <= 0.0 else np.inf

    def learned_row(
        learned: ResidualSimulator | LinearModel, status: str, policy: StatePolicy
    ) -> Estimate:
        """Estimate a value in a learned task, and refuse one of an impossible sign.

        The sign must be possible with the rewards of the log, and of the simulator's
        own steps from there.
        """
        estimate = rollouts.estimate(learned, policy, status)
        return refuse_impossible(estimate, *bounds, steps, scale)

    def simulated_row(policy: StatePolicy) -> Estimate:
        """Estimate a value in the simulator itself."""
        return _describe_simulated(
            simulate(policy), is_headline=not correction.is_trusted
        )

    def corrected_row(policy: StatePolicy) -> Estimate:
        """Estimate a value in the corrected simulator."""
        own = correction.policy(policy)
        return learned_row(correction.learned, correction.status, own)

    wanted, left_out = _choose_estimators(names, numbered, has_cells=cells is not None)
    wants_oee = OffEnvironment() in wanted.values()
    plain_status = describe_flaw(correction.plain)
    # rows in front, in the order of what they may be trusted for
    rows: dict[str, Row] = {}
    if not correction.is_trusted:
        rows[SIMULATOR] = simulated_row
    if wants_oee:
        rows[correction.name] = corrected_row
        rows["oee (residual)"] = partial(learned_row, correction.plain, plain_status)
    sampling = {
        name: e for name, e in wanted.items() if isinstance(e, ImportanceSampling)
    }
    others: dict[str, Row] = {}
    if names is None:
        linear = LinearModel(simulator.task, numbered)
        others[LINEAR] = partial(learned_row, linear, plain_status)
    n_actions = simulator.task.n_actions
    others |= sampling_rows(sampling, numbered, n_actions, steps, discount)
    others[SIMULATOR] = simulated_row
    last: dict[str, Row] = {}
    if target is not None:

        def target_row(policy: StatePolicy) -> Estimate:
            """Estimate a value in the true target."""
            return _describe_simulated(rollouts.value(target, policy))

        last["target (continuous)"] = target_row
    # fitted parameters leave little to tell: the difference is that of what was given
    compared = correction.learned
    if correction.fit is not None and not correction.steps:
        compared = correction.plain
    advice = correction.advice(is_auto=isinstance(history, str))
    sentences = (advice, correction.reason, difference(compared))
    first = tuple(sentence for sentence in sentences if sentence)
    caveat = ""
    if not correction.is_trusted:
        caveat = f"No correction can be trusted, because {correction.status}."
    messages = [*left_out, *messages]
    about_rewards = _describe_rewards(simulator.task, numbered)
    if about_rewards:
        messages.append(about_rewards)
    if cells is None:
        _require_no_premises(
            lower_ratio=lower_ratio, upper_ratio=upper_ratio, tie=tie, features=features
        )
        about = {
            "simulator": f"{simulator.name}, without cells",
            "log": repr(log),
            **own_facts,
        }
        report = _report_rows(
            functions,
            rows | others | last,
            steps,
            discount,
            about,
            seed=seed,
            confidence=confidence,
            normalized=normalized,
            guaranteed=guaranteed,
            quick=quick,
        )
        uncertainty = Uncertainty(distance=first, caveat=caveat)
        every_message = (*report.warnings, *messages)
        return replace(report, warnings=every_message, uncertainty=uncertainty)
    # policies by their tables on the cells, which are all that finite estimators take
    known = {table.tobytes(): functions[name] for name, table in tables.items()}

    def simulate_table(table: Array) -> MonteCarlo:
        """Estimate the value of a policy's table on the cells, in the simulator."""
        return simulate(known[np.asarray(table).tobytes()])

    def evaluate_row(
        row: Row, problem: Problem, table: Array, *, seed: SeedNumbers = None
    ) -> Estimate:
        """Evaluate a row for a policy that is given by its table on the cells."""
        return row(known[np.asarray(table).tobytes()])

    def on_tables(rows: Mapping[str, Row]) -> dict[str, Estimator]:
        """Return rows as estimators of policies on the cells."""
        return {name: partial(evaluate_row, row) for name, row in rows.items()}

    every = on_tables(rows)
    if wants_oee and kind != "none":
        every["oee (calibrated)"] = cells.calibrated(simulate_table, kind, scale)
    finite = {name: e for name, e in wanted.items() if name not in sampling}
    every |= on_tables(others) | cells.others(finite) | on_tables(last)
    report = evaluate(
        cells.problem,
        tables,
        estimators=every,
        confidence=confidence,
        seed=seed,
        normalized=normalized,
        facts=cells.facts | own_facts,
        guaranteed=guaranteed,
        quick=quick,
        lower_ratio=lower_ratio,
        upper_ratio=upper_ratio,
        tie=tie,
        features=features,
    )
    messages.append(cells.describe_loss(simulate_table, tables))
    uncertainty = replace(
        report.uncertainty,
        next=cells.add_features(report.uncertainty.next),
        distance=(*first, *report.uncertainty.distance),
        caveat=caveat,
    )
    texts = tuple(map(cells.add_features, (*report.warnings, *messages)))
    return replace(report, warnings=texts, uncertainty=uncertainty)


def _require_no_premises(**premises: object) -> None:
    """Raise a ValueError for what is known of the target but needs cells."""
    lower = premises["lower_ratio"]
    if lower is not None:
        _checks.number_in(lower, "lower_ratio", 0.0, 1.0)
    upper = premises["upper_ratio"]
    if upper is not None:
        _checks.number_in(upper, "upper_ratio", 1.0, np.inf, infinite=True)
    for name, value in premises.items():
        if value is not None:
            raise ArgumentError(
                name,
                "must be left out without cells: it is about the transitions of a finite"
                " simulator",
            )


def _describe_simulated(mc: MonteCarlo, *, is_headline: bool = False) -> Estimate:
    """Return a value in the simulator (or the target) itself as an ``Estimate``.

    It is no estimate from the log. ``is_headline`` is for where no correction can be
    trusted; the rollouts' noise is no interval to speak of then.
    """
    error = None if is_headline else mc.standard_error
    facts = {"standard_error_of": "rollouts", "n_rollouts": mc.n_episodes}
    return Estimate(
        mc.value,
        error,
        diagnostics=facts,
        is_headline=is_headline,
        is_from_log=not is_headline,
    )


def _describe_rounding(name: str, policy: CommandPolicy, states: Array) -> str:
    """Describe how far the task's commands are from those of a policy.

    Returns "" where they are the same.
    """
    distance, beyond = policy.rounding(states)
    if distance == beyond == 0.0:
        return ""
    cut = ""
    if beyond > 0.0:
        cut = f" {beyond:.0%} of them lie beyond the range of these and are cut to it."
    return (
        f"The commands of “{name}” are rounded to the task's {len(policy.actions)}"
        f" commands, by {distance:.2g} (root mean square in the log's states).{cut}"
    )


def _describe_rewards(task: ContinuousTask, log: ContinuousTransitions) -> str:
    """Describe where the log's rewards are not the task's r(s, a, s').

    Returns "" where they are, or where either is unknown.
    """
    known = task.reward_between(log.state, log.action, log.next_state)
    if log.reward is None or known is None:
        return ""
    distance = np.abs(log.reward - known)
    bad = np.flatnonzero(distance > 1e-6 * float(np.abs(known).max()))
    if bad.size == 0:
        return ""
    k = int(distance.argmax())
    verb = "are rounded from" if is_rounded(log.reward, known) else "contradict"
    return (
        f"The log's rewards {verb} the simulator's r(s, a, s') in {bad.size} of"
        f" {len(log)} transitions. The reward of row {k} is {log.reward[k]:.9g} in the"
        f" log and {known[k]:.9g} in the simulator. The simulator's rewards are used"
    )


def _names(names: object, argument: str) -> list[str]:
    """Return a collection of names as a list that is not empty."""
    checked = [
        _checks.instance(name, str, argument, "names")
        for name in _checks.collection(names, argument, "names")
    ]
    if not checked:
        raise ArgumentError(argument, "must hold at least one name; it is empty")
    return checked


def _choose_estimators(
    names: list[str] | None, log: ContinuousTransitions, *, has_cells: bool
) -> tuple[dict[str, Estimator], list[str]]:
    """Return estimators by name, and sentences on those that are left out.

    Those of finite problems need cells.
    """
    if names is None:
        needed = (log.reward, log.episode, log.behavior_probability)
        names = ["oee"]
        if has_cells:
            names += ["simulator", "model-based"]
        if all(column is not None for column in needed):
            names += ["pdis", "wpdis"]
    estimators = named_estimators(names)
    kinds = (ImportanceSampling, Simulator)
    gone = [
        name
        for name, e in estimators.items()
        if not (has_cells or isinstance(e, kinds) or e == OffEnvironment())
    ]
    kept = {name: e for name, e in estimators.items() if name not in gone}
    if not gone:
        return kept, []
    verb = "is" if len(gone) == 1 else "are"
    return kept, [f"{', '.join(gone)} {verb} left out: they need cells."]


def _report_rows(
    policies: Mapping[str, StatePolicy],
    rows: Mapping[str, Row],
    horizon: int,
    discount: float,
    facts: Mapping[str, Any],
    *,
    seed: SeedNumbers = None,
    confidence: float = 0.95,
    normalized: bool = False,
    guaranteed: bool = False,
    quick: bool = False,
) -> Report:
    """Return the report of rows without a finite problem.

    Each row stands beside its own interval.
    """
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if _checks.boolean(guaranteed, "guaranteed"):
        raise ArgumentError(
            "guaranteed",
            "must be False without cells: guaranteed intervals need a finite simulator",
        )
    if _checks.boolean(normalized, "normalized") and discount == 1.0:
        raise ArgumentError(
            "normalized",
            "must be False at discount 1: the factor (1 - discount) would be 0",
        )
    _checks.boolean(quick, "quick")
    scale = 1.0 - discount if normalized else 1.0
    results = []
    for name, policy in policies.items():
        for label, row in rows.items():
            _progress.report_step(f"{label} of “{name}”")
            estimate = choose_interval(row(policy), None, level, scale)
            results.append(Result(name, label, estimate))
            _progress.report_finished(f"{label} of “{name}”: {estimate}")
    texts, notes = number_notes(results, group_findings(results))
    return Report(
        tuple(results),
        {},
        texts,
        notes,
        level,
        normalized,
        discount,
        horizon,
        seed,
        facts,
    )
