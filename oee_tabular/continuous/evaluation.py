"""``evaluate`` for a continuous simulator and a log of continuous states.

The rows stand in the order of what they may be trusted for: the simulator corrected by the log's residuals
(``ResidualSimulator``), the value on cells calibrated, a linear model of the log, importance sampling, the simulator itself by
Monte Carlo and on the cells, and last off-environment evaluation on the grid alone, which has the grid's error. What the cells
cannot take is said, and the other rows stand (``cell_rows``).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._threads import one_thread
from oee_tabular.continuous.actions import as_probabilities
from oee_tabular.continuous.cell_rows import NoCellsError, OnCells, on_cells, reward_bounds
from oee_tabular.continuous.correction import Correction, choose_correction
from oee_tabular.continuous.estimators import MonteCarloValue, Possible, Refitted, Residual, Simulated
from oee_tabular.continuous.linear_model import LinearModel
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.on_rows import on_rows, report_on_rows, table_on_rows
from oee_tabular.continuous.parameters import ParameterFit, fit_parameters, parameters_of
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.sentences import difference, lost, placed, rewards_contradict
from oee_tabular.continuous.simulator import ContinuousSimulator, Settings, as_simulator
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_probabilities, require_log_of
from oee_tabular.estimators import Estimator, ImportanceSampling, OffEnvironment, Problem, Simulator
from oee_tabular.estimators.calibrated import KINDS
from oee_tabular.estimators.names import default_names, named_estimators
from oee_tabular.report.evaluation import evaluate
from oee_tabular.report.results import Report

CALIBRATIONS = (*KINDS, "none")
LINEAR = "linear model of the log"


@one_thread
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
    seed: Any = None,
    facts: Mapping[str, Any] | None = None,
    **options: Any,
) -> Report:
    """Evaluate policies of a continuous task in the target that a log was recorded in.

    Parameters
    ----------
    simulator : ContinuousSimulator, or a ContinuousTask, which needs ``horizon``
    log : ContinuousTransitions of the target
    policies : name -> function of states (n, d) giving probabilities (n, A), or an (S, A) array of probabilities on the cells
    settings : grid, calibration, and what to do with states outside and actions not in the set
    behavior : the policy that recorded the log, where the log lacks its probabilities
    target : the true target, where it is known: adds its own Monte Carlo value
    history : how many last actions are in the state; "auto" chooses 0 to 5 by held-out error, where the state is not Markov
    fit : names of parameters of the simulator that are fitted to the log first (or their ``ParameterFit``)
    estimators : names, as in ``evaluate``; None: as there
    horizon : number of rewards; None: the simulator's
    discount : in [0, 1]
    seed, facts : as in ``evaluate``
    options : ``confidence``, ``normalized``, ``guaranteed``, ``quick`` of ``evaluate``

    Returns
    -------
    Report
        In front the value of the corrected simulator (``choose_correction``) by Monte Carlo, or, where no correction can be
        trusted, the simulator's. Row "oee (residual)" where oee is asked for; with ``settings.grid`` also "oee (calibrated)"
        and, last, "oee on the grid"; "linear model of the log" where ``estimators`` is None; "simulator (continuous)" (Monte
        Carlo) always. ``facts`` has the support diagnostics and the closure error. Where the cells cannot take the log, their
        rows are left out with a sentence.

    Raises
    ------
    ValueError
        A log that does not fit the task; states outside the grid, where ``settings.outside`` is "error".

    Examples
    --------
    >>> from oee_tabular.continuous.names import continuous_simulator
    >>> simulator, target = (continuous_simulator(f"cartpole:gravity={g}") for g in (10, 15))
    >>> log = target.record(target.policy("mix:0.7"), n_transitions=2000, seed=0)
    >>> few = Settings(episodes=2000)
    >>> report = evaluate_continuous(simulator, log, {"expert": simulator.expert}, settings=few, seed=0, estimators=["oee"])
    >>> [row["estimator"] for row in report.records()]
    ['oee (residual)', 'simulator (continuous)']
    """
    given = as_simulator(simulator, horizon) if isinstance(simulator, ContinuousTask) else simulator
    _checks.instance(given, ContinuousSimulator, "simulator", "a ContinuousTask or a ContinuousSimulator")
    _checks.instance(policies, Mapping, "policies", "a mapping from names to policies")
    _checks.instance({} if facts is None else facts, Mapping, "facts")
    if target is not None:
        _checks.instance(target, ContinuousTask, "target", "a ContinuousTask")
    estimators = None if estimators is None else _names(estimators, "estimators")
    fit = fit if fit is None or isinstance(fit, ParameterFit) else _names(fit, "fit")
    chosen = _checks.instance(Settings() if settings is None else settings, Settings, "settings")
    kind = given.calibration if chosen.calibration is None else chosen.calibration
    _checks.one_of(kind, "calibration", CALIBRATIONS)
    steps = given.horizon if horizon is None else _checks.positive_integer(horizon, "horizon")
    require_log_of(given.task, log)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        numbered = _numbered(given, log, chosen, behavior)
        made = None
        if chosen.grid is not None:
            try:
                made = on_cells(given, numbered, chosen, steps, discount, seed)
            except NoCellsError as reason:
                warnings.warn(f"The rows on the grid are left out: {reason}", stacklevel=2)
    told = list(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning)))
    tables, functions = _policies(policies, made, given.task, numbered)
    stream = _checks.seed_sequence(seed, (10**6,))
    episodes = given.episodes if chosen.episodes is None else chosen.episodes
    mc = MonteCarloValue(given.task, functions, steps, episodes, discount, stream)
    problem = on_rows(numbered, given.task.n_actions, steps, discount) if made is None else made.problem
    wanted, left_out = _wanted(problem, estimators, made)
    scale = 1.0 - discount if options.get("normalized") else 1.0
    fitted = fit if fit is None or isinstance(fit, ParameterFit) else _fit(given.task, fit, numbered)
    learned = choose_correction(given.task, numbered, history=history, fit=fitted, seed=seed)
    bounds = _signs(learned.plain) if made is None else reward_bounds(problem, numbered, steps)
    rows = _rows(wanted, made, mc, learned, given.refit_paths, kind, bounds, scale)
    if estimators is None:
        rows = _with_linear(rows, given, numbered, learned, mc, bounds, scale)
    if target is not None:
        rows["target (continuous)"] = Simulated(replace(mc, task=target, found={}))
    said = [*left_out, *told, *filter(None, [rewards_contradict(given.task, numbered)])]
    for text in told:
        warnings.warn(text, stacklevel=3)
    first = tuple(
        filter(
            None,
            (learned.advice, learned.reason, difference(learned.learned if learned.fit is None else learned.plain)),
        )
    )
    if made is None:
        known = {"simulator": f"{given.name}, without cells", "log": repr(log), **dict(facts or {})}
        return report_on_rows(
            problem, tables, rows, tuple(said), first, learned.warning, seed=seed, facts=known, **options
        )
    report = evaluate(problem, tables, estimators=rows, seed=seed, facts=made.facts | dict(facts or {}), **options)
    said.append(lost(made.model, mc, tables, steps))
    uncertainty = replace(
        report.uncertainty,
        next=placed(report.uncertainty.next, made.model),
        distance=(*first, *report.uncertainty.distance),
        caveat=learned.warning,
    )
    every = [placed(text, made.model) for text in (*report.warnings, *said)]
    return replace(report, warnings=tuple(every), uncertainty=uncertainty)


def _numbered(
    simulator: ContinuousSimulator, log: ContinuousTransitions, settings: Settings, behavior: StatePolicy | None
) -> ContinuousTransitions:
    """The log with action numbers, and the behaviour's probabilities where it lacks them."""
    task = simulator.task
    columns = log.columns() | {"action": log.action_numbers(task.actions, strict=settings.strict)}
    if behavior is not None and log.behavior_probability is None:
        probabilities = check_probabilities(behavior, log.state, task.n_actions)
        columns["behavior_probability"] = probabilities[np.arange(len(log)), columns["action"]]
    return ContinuousTransitions(**columns)


def _policies(
    policies: Mapping[str, StatePolicy | Array], made: OnCells | None, task: ContinuousTask, log: ContinuousTransitions
) -> tuple[dict[str, Array], dict[bytes, StatePolicy]]:
    """Name -> table on the cells (without cells: on the log's rows), and table -> function of states."""
    tables: dict[str, Array] = {}
    functions: dict[bytes, StatePolicy] = {}
    for name, given in policies.items():
        policy = as_probabilities(given, task.actions) if callable(given) else given
        if made is not None:
            table = made.model.policy(policy, f"policy {name!r}")
            tables[name], function = table, policy if callable(policy) else made.model.policy_function(table)
        elif callable(policy):
            tables[name], function = table_on_rows(policy, log, task.n_actions), policy
        else:
            raise ValueError(f"policy {name!r} must be a function of states: there are no cells to be an array on")
        functions[tables[name].tobytes()] = function
    return tables, functions


def _names(given: object, argument: str) -> list[str]:
    """Names, at least one."""
    names = [_checks.instance(name, str, argument, "names") for name in _checks.collection(given, argument, "names")]
    if not names:
        raise ValueError(f"{argument} must hold at least one name; it is empty")
    return names


def _fit(task: ContinuousTask, names: Sequence[str], log: ContinuousTransitions) -> ParameterFit:
    return fit_parameters(*parameters_of(task, names), log)


def _wanted(
    problem: Problem, names: Sequence[str] | None, made: OnCells | None
) -> tuple[dict[str, Estimator], list[str]]:
    """The estimators by name; those of finite problems only where there are cells."""
    chosen, left_out = default_names(problem) if names is None else (list(names), [])
    found = named_estimators(chosen)
    if made is not None:
        return found, left_out
    kept: dict[str, Estimator] = {
        name: e for name, e in found.items() if isinstance(e, OffEnvironment | ImportanceSampling | Simulator)
    }
    if names is not None and (gone := [name for name in found if name not in kept]):
        left_out = [*left_out, f"{', '.join(gone)} {'is' if len(gone) == 1 else 'are'} left out: they need cells."]
    return kept, left_out


def _rows(
    wanted: Mapping[str, Estimator],
    made: OnCells | None,
    mc: MonteCarloValue,
    learned: Correction,
    paths: int,
    kind: str,
    bounds: tuple[float, float],
    scale: float,
) -> dict[str, Estimator]:
    """The estimators by the names of their rows, in the order of what they may be trusted for."""
    rows: dict[str, Estimator] = {}
    if not learned.is_trusted:
        rows["simulator (continuous)"] = Simulated(mc, is_headline=True)
    if any(estimator == OffEnvironment() for estimator in wanted.values()):
        rows |= {
            name: Possible(row, *_signs(learned.plain), scale)
            for name, row in _residual_rows(learned, mc, paths).items()
        }
    calibrated, rest = ({}, {}) if made is None else made.rows(wanted, mc, kind, scale)
    rows |= {name: Possible(row, *bounds, scale) for name, row in calibrated.items()}
    rows |= {name: estimator for name, estimator in wanted.items() if isinstance(estimator, ImportanceSampling)}
    rows.setdefault("simulator (continuous)", Simulated(mc))
    return rows | {name: estimator for name, estimator in rest.items() if name not in rows}


def _with_linear(
    rows: dict[str, Estimator],
    simulator: ContinuousSimulator,
    log: ContinuousTransitions,
    learned: Correction,
    mc: MonteCarloValue,
    bounds: tuple[float, float],
    scale: float,
) -> dict[str, Estimator]:
    """With the linear model of the log, which takes the state to be Markov, before importance sampling and the simulator."""
    model = LinearModel(simulator.task, log)
    row = Refitted(replace(mc, task=model, found={}), model, paths=simulator.refit_paths, status=learned.plain_status)
    ahead = [name for name in rows if name.startswith("oee (") or not learned.is_trusted]
    first = {name: rows[name] for name in ahead}
    return first | {LINEAR: Possible(row, *bounds, scale)} | {name: rows[name] for name in rows if name not in ahead}


def _signs(corrected: ResidualSimulator) -> tuple[float, float]:
    """Bounds of a value where rewards have one sign, in the log and of the simulator's own steps from there."""
    low, high = corrected.paid
    return (0.0 if low >= 0.0 else -np.inf), (0.0 if high <= 0.0 else np.inf)


def _residual_rows(learned: Correction, mc: MonteCarloValue, paths: int) -> dict[str, Estimator]:
    """The chosen correction, and the simulator's own without history where that is another."""
    rows: dict[str, Estimator] = {}
    if learned.learned is not learned.plain:
        functions = dict(mc.functions)
        if learned.steps:
            functions = {key: learned.whole.policy(function) for key, function in functions.items()}
        value = replace(mc, task=learned.learned, functions=functions, found={})
        rows[learned.name] = Residual(value, learned.learned, paths=paths, status=learned.status)
    value = replace(mc, task=learned.plain, found={})
    return rows | {"oee (residual)": Residual(value, learned.plain, paths=paths, status=learned.plain_status)}
