"""``evaluate`` for a continuous simulator and a log of continuous states.

The simulator is discretised at the log's own places, with the small defensive share of its configuration; the log becomes
numbered moves and soft counts on the same cells; zeta is fitted to the soft counts. Beside the raw value stands the
calibrated one (``estimators.calibrate``), and beside the simulator on the cells the simulator itself, by Monte Carlo. Before
all of them stands the simulator corrected by the log's residuals (``ResidualSimulator``), which needs no cells.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization import Discretization, require_log_of
from oee_tabular.continuous.estimators import Calibrated, MonteCarloValue, Plain, Residual, Simulated, Supported
from oee_tabular.continuous.history import HistoryTask
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.simulator import ContinuousSimulator
from oee_tabular.continuous.support import within_support
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_probabilities
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimator, OffEnvironment, Problem, Simulator
from oee_tabular.estimators.calibrated import KINDS
from oee_tabular.estimators.names import default_names, named_estimators
from oee_tabular.exact import policy_value
from oee_tabular.mdp import check_policy
from oee_tabular.ratio import transition_ratio, uncovered_share
from oee_tabular.report.evaluation import evaluate
from oee_tabular.report.report import Report

LEFT_OUT = 0.01  # share of the log's moves without support that the rows on the cells may leave out
CALIBRATIONS = (*KINDS, "none")


@dataclass(frozen=True)
class Settings:
    """How a continuous log is evaluated; what is None is the simulator's own.

    Attributes
    ----------
    grid : vertices along each feature
    outside : "error" | "nearest" | "drop", for states outside the grid
    strict : an error, not a warning, for actions that are not in the task's set
    calibration : "ratio" | "difference" | "none"
    floor : defensive share, in [0, 1]
    episodes : of Monte Carlo, for each policy in the continuous simulator

    Examples
    --------
    >>> Settings(grid=(60, 60)).outside
    'error'
    """

    grid: tuple[int, ...] | None = None
    outside: str = "error"
    strict: bool = False
    calibration: str | None = None
    floor: float | None = None
    episodes: int | None = None


@one_thread
def evaluate_continuous(
    simulator: ContinuousSimulator,
    log: ContinuousTransitions,
    policies: Mapping[str, StatePolicy | Array],
    *,
    settings: Settings | None = None,
    behavior: StatePolicy | None = None,
    target: ContinuousTask | None = None,
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
    simulator : ContinuousSimulator
    log : ContinuousTransitions of the target
    policies : name -> function of states (n, d) giving probabilities (n, A), or an (S, A) array of probabilities on the cells
    settings : grid, calibration, and what to do with states outside and actions not in the set
    behavior : the policy that recorded the log, where the log lacks its probabilities
    target : the true target, where it is known: adds its own Monte Carlo value
    estimators : names, as in ``evaluate``; None: as there
    horizon : number of rewards; None: the simulator's
    discount : in [0, 1]
    seed, facts : as in ``evaluate``
    options : ``confidence``, ``normalized``, ``guaranteed``, ``quick`` of ``evaluate``

    Returns
    -------
    Report
        Rows "oee (residual)" (of the corrected simulator, by Monte Carlo; where oee is asked for), "simulator (continuous)"
        (Monte Carlo), "oee" (raw) and "oee (calibrated)" among the others; ``facts`` has the
        support diagnostics and the closure error.

    Raises
    ------
    ValueError
        A log that does not fit the task; states outside the grid; more than a hundredth of the moves without support.

    Examples
    --------
    >>> from oee_tabular.continuous.names import continuous_simulator
    >>> simulator, target = (continuous_simulator(f"cartpole:gravity={g}") for g in (10, 15))
    >>> log = target.record(target.policy("mix:0.7"), n_transitions=2000, seed=0)
    >>> few = Settings(episodes=2000)
    >>> report = evaluate_continuous(simulator, log, {"expert": simulator.expert}, settings=few, seed=0, estimators=["oee"])
    >>> [row["estimator"] for row in report.records()]
    ['oee (residual)', 'simulator (continuous)', 'oee', 'oee (calibrated)']
    """
    chosen = Settings() if settings is None else settings
    kind = simulator.calibration if chosen.calibration is None else chosen.calibration
    _checks.one_of(kind, "calibration", CALIBRATIONS)
    steps = simulator.horizon if horizon is None else _checks.positive_integer(horizon, "horizon")
    require_log_of(simulator.task, log)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        made = _made(simulator, log, chosen, behavior, steps, discount, seed)
    told = list(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, UserWarning)))
    tables = {name: as_table(policy, made.model, name) for name, policy in policies.items()}
    functions = {tables[name].tobytes(): as_function(policy, made.model) for name, policy in policies.items()}
    stream = _checks.seed_sequence(seed, (10**6,))
    episodes = simulator.episodes if chosen.episodes is None else chosen.episodes
    mc = MonteCarloValue(simulator.task, functions, steps, episodes, discount, stream)
    rows = _rows(made, mc, kind, estimators)
    if target is not None:
        there = MonteCarloValue(target, functions, steps, episodes, discount, stream)
        rows["target (continuous)"] = Simulated(there)
    told.append(_lost(made.plain, mc, tables, steps))
    report = evaluate(made.problem, tables, estimators=rows, seed=seed, facts=made.facts | dict(facts or {}), **options)
    for text in told[:-1]:
        warnings.warn(text, stacklevel=3)
    said = [_placed(text, made.model) for text in report.warnings]
    sure = replace(
        report.sureness,
        next=_placed(report.sureness.next, made.model),
        distance=(_difference(made.corrected), *report.sureness.distance),
    )
    said += [_placed(text, made.model) for text in told]
    return replace(report, warnings=tuple(said), sureness=sure)


@dataclass(frozen=True)
class _Made:
    model: Discretization
    plain: Discretization
    problem: Problem
    support: dict[str, float]
    zeta: Any
    facts: dict[str, Any]
    corrected: ResidualSimulator
    with_history: ResidualSimulator | None


def _made(
    simulator: ContinuousSimulator,
    log: ContinuousTransitions,
    settings: Settings,
    behavior: StatePolicy | None,
    horizon: int,
    discount: float,
    seed: Any,
) -> _Made:
    """Everything that does not depend on the policies."""
    task = simulator.task
    columns = log.columns() | {"action": log.action_numbers(task.actions, strict=settings.strict)}
    if behavior is not None and log.behavior_probability is None:
        probabilities = check_probabilities(behavior, log.state, task.n_actions)
        columns["behavior_probability"] = probabilities[np.arange(len(log)), columns["action"]]
    numbered = ContinuousTransitions(**columns)
    floor = simulator.floor if settings.floor is None else _checks.number_in(settings.floor, "floor", 0.0, 1.0)
    model = simulator.build(grid=settings.grid, at=numbered, floor=floor, discount=discount)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a grid that is too coarse was warned about
        plain = (
            model if floor == 0.0 else simulator.build(grid=settings.grid, at=numbered, floor=0.0, discount=discount)
        )
    counts = simulator.counts(model, numbered, outside=settings.outside)
    encoded = model.encode_log(numbered, seed=_checks.seed_sequence(seed, (10**6 + 1,)), outside=settings.outside)
    bag, episodes = encoded, None
    if task.reward_between(log.state[:1], columns["action"][:1], log.next_state[:1]) is not None:
        # rewards differ within a cell: no contradiction of the simulator's mean
        episodes = encoded if encoded.episode is not None else None
        bag = Transitions(**{name: column for name, column in encoded.columns().items() if name != "reward"})
    share = uncovered_share(counts, model.mdp)
    if 0.0 < share <= LEFT_OUT:
        kept, _ = within_support(counts, model)
        warnings.warn(_left_out(counts, kept, share, model), stacklevel=2)
        counts = kept
    if share > LEFT_OUT:
        raise ValueError(
            f"log must stay where the simulator has probability: {share:.2g} of its moves have none on "
            f"{model.cells.extent()}, with a defensive share of {floor:g}. No ratio exists there. Ways out: "
            f"{'' if floor > 0.0 else 'a defensive share (--floor 0.001), '}a coarser grid (--grid), process noise, or a "
            "mixture of simulator parameters (tasks.defensive_mixture)"
        )
    problem = Problem(model.mdp, bag, horizon=horizon, counts=counts, episodes=episodes)
    zeta = transition_ratio(counts, model.mdp, **simulator.ratio_options(model))
    largest = float(zeta.values.data.max())
    support = {
        "uncovered_mass": uncovered_share(counts, plain.mdp),
        "largest_zeta": largest,
        "d_inf": float(np.log(largest)),
    }
    facts: dict[str, Any] = {
        "simulator": _described(simulator, model, floor, support),
        "log": f"{len(log)} transitions of {log.n_state}-dimensional states; encoded: {encoded.describe()}",
        "grid": model.cells.extent(),
        "floor": floor,
        "ratio": ({} if simulator.tie is None else {"tie": "displacements"}) | dict(simulator.ratio),
        "rows_left_out": len(log) - len(encoded),
        "moves_left_out": share,
        **support,
    }
    closure = model.diagnostics.get("closure")
    if closure is not None:
        facts["closure_error"] = float(closure.error)
    corrected = ResidualSimulator(task, numbered, seed=seed)
    with_history = None
    if any(coordinate.hidden for coordinate in corrected.coordinates):
        whole = HistoryTask(task)
        with_history = ResidualSimulator(whole, whole.log(numbered), seed=seed)
    return _Made(model, plain, problem, support, zeta, facts, corrected, with_history)


def _left_out(counts: Any, kept: Any, share: float, model: Discretization) -> str:
    """How many moves have no support, and where most of them begin."""
    lost = row_sums(counts) - row_sums(kept)
    state = int(lost.argmax()) // model.task.n_actions
    return (
        f"{share:.2g} of the log's moves have no probability in the simulator on {model.cells.extent()}; the rows on the cells "
        f"leave them out. Most of them begin at state {state}"
    )


def _difference(corrected: ResidualSimulator) -> str:
    """Does the target differ, in which coordinate; is the state all that decides: the log's residuals against the simulator."""
    changed = [c for c in corrected.coordinates if c.differs]
    hidden = [c for c in corrected.coordinates if c.hidden]
    if not changed:
        return (
            "The target's steps do not differ from the simulator's, as far as the log tells: its residuals s' - f(s, a) are "
            "those of the simulator's own scatter."
        )
    told = "; ".join(
        f"{c.name} (residuals {c.residual_scatter:.2g}, the simulator's own scatter {c.simulator_scatter:.2g}, "
        f"{max(c.explained, 0.0):.1%} of their mean square explained by the correction)"
        for c in changed
    )
    said = f"The target's steps differ from the simulator's in {told}."
    if hidden:
        names = ", ".join(f"{c.told_by_history:.0%} in {c.name}" for c in hidden)
        said += f" Hidden state: the action and the residual before explain {names} of what the correction leaves over."
    return said


def _described(
    simulator: ContinuousSimulator, model: Discretization, floor: float, support: Mapping[str, float]
) -> str:
    places = ", looked at in the log's own places" if simulator.at_log else ""
    text = f"{simulator.name} on {model.cells.extent()}{places}: {model.mdp!r}"
    if floor > 0:
        text += f"; defensive: with probability {floor:g} {simulator.defence} (plain: without)"
    closure = model.diagnostics.get("closure")
    if closure is not None:
        text += f"; closure error of the uniform policy {closure.error:+.1%} (+-{closure.standard_error:.1%})"
    return text + (
        f"; uncovered mass {support['uncovered_mass']:.2g}, largest zeta {support['largest_zeta']:.3g} "
        f"(D_inf {support['d_inf']:.2g} nats)"
    )


def _rows(made: _Made, mc: MonteCarloValue, kind: str, names: Sequence[str] | None) -> dict[str, Estimator]:
    """The estimators by the names of their rows."""
    wanted = named_estimators(default_names(made.problem)[0] if names is None else list(names))
    rows: dict[str, Estimator] = {}
    if OffEnvironment() in wanted.values():
        rows |= _residual_rows(made, mc)
    rows["simulator (continuous)"] = Simulated(mc)
    for name, estimator in wanted.items():
        if estimator != OffEnvironment():
            rows[name] = estimator
            if isinstance(estimator, Simulator) and made.plain is not made.model:
                rows["simulator (plain)"] = Plain(made.plain.mdp)
            continue
        raw = Supported(OffEnvironment(made.zeta), made.support)
        rows[name] = raw
        if kind != "none":
            rows["oee (calibrated)"] = Calibrated(raw, mc, kind)
    return rows


def _residual_rows(made: _Made, mc: MonteCarloValue) -> dict[str, Estimator]:
    """The corrected simulator; before it, where the state is not Markov, the one with the last action in its state."""
    rows: dict[str, Estimator] = {}
    if made.with_history is not None:
        whole = HistoryTask(made.corrected.task)
        functions = {key: whole.policy(function) for key, function in mc.functions.items()}
        value = replace(mc, task=made.with_history, functions=functions, found={})
        rows["oee (residual, last action)"] = Residual(value, made.with_history)
    return rows | {"oee (residual)": Residual(replace(mc, task=made.corrected, found={}), made.corrected)}


def _lost(plain: Discretization, mc: MonteCarloValue, tables: Mapping[str, Array], horizon: int) -> str:
    """What the cells make of the simulator's own values, which no interval covers."""
    lost = []
    for name, table in tables.items():
        there = mc(table)
        lost.append(
            f"{policy_value(plain.mdp, table, horizon=horizon) - there.value:+.3g} of {there.value:.3g} ({name})"
        )
    return (
        "standard errors and intervals are of the log alone; what the cells lose is not in them. Of the simulator's own value "
        f"they make {', '.join(lost)}, and another environment's may suffer more"
    )


def as_table(policy: StatePolicy | Array, model: Discretization, name: str) -> Array:
    """(S, A) a policy on the cells; an array may leave out the state that is over."""
    if callable(policy):
        return check_policy(model.policy(policy), model.mdp, name=f"policy {name!r}")
    table = _checks.float_array(policy, f"policy {name!r}", ndim=(2,))
    if model.over is not None and table.shape == (model.cells.n_cells, model.task.n_actions):
        table = np.concatenate([table, np.full((1, model.task.n_actions), 1.0 / model.task.n_actions)])
    return check_policy(table, model.mdp, name=f"policy {name!r}")


def as_function(policy: StatePolicy | Array, model: Discretization) -> StatePolicy:
    """A policy of states: of an array, the mean over the cells that a state is shared out to."""
    if callable(policy):
        return policy
    table = np.asarray(policy, dtype=np.float64)[: model.cells.n_cells]

    def interpolated(states: Array) -> Array:
        found = model.cells.weights(model.task.features(states)) @ table
        return np.asarray(found / found.sum(axis=1, keepdims=True))

    return interpolated


def _placed(text: str, model: Discretization) -> str:
    """A warning with the features of the states that it numbers."""
    n, names = model.cells.n_cells, model.task.feature_names

    def place(match: re.Match[str]) -> str:
        number = int(match[1])
        points = model.points[model.point_cell == number] if number < n else model.points[:0]
        if len(points) == 0:
            return match[0]
        at = model.task.features(points).mean(axis=0)
        return f"{match[0]} ({', '.join(f'{name}={value:.3g}' for name, value in zip(names, at, strict=True))})"

    return re.sub(r"\bstate (\d+)", place, text)
