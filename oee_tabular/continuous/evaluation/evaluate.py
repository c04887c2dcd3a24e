"""Evaluation of policies by a continuous simulator and a log of continuous states.

``evaluate_continuous`` checks what it is given, then takes four steps: ``prepare`` the
log and the policies, ``choose_correction``, ``choose_rows``, and assemble the report.
What the cells cannot take is said, and the other rows stand.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from oee_tabular import _checks, _progress
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import conform
from oee_tabular.continuous.correction.choice import Correction, choose_correction
from oee_tabular.continuous.correction.parameters import (
    ParameterFit,
    fit_parameters,
    parameters_of,
)
from oee_tabular.continuous.correction.sentences import (
    difference,
)
from oee_tabular.continuous.evaluation.assemble import (
    Layout,
    Premises,
    Sentences,
    assemble_on_cells,
    assemble_rows,
)
from oee_tabular.continuous.evaluation.command_levels import (
    MAX_REFINEMENTS,
    MOST,
    Rounding,
    describe_rounding,
    has_only,
    make_finer_often,
    measure_roundings,
)
from oee_tabular.continuous.evaluation.prepare import Prepared, prepare
from oee_tabular.continuous.evaluation.rollouts import (
    Rollouts,
)
from oee_tabular.continuous.evaluation.rows import Rows, choose_rows, split_sampling
from oee_tabular.continuous.evaluation.simulator import (
    Calibration,
    ContinuousSimulator,
    Settings,
    as_simulator,
)
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
)
from oee_tabular.estimators import (
    Estimator,
    ImportanceSampling,
    OffEnvironment,
    Simulator,
)
from oee_tabular.estimators.calibrated import KINDS
from oee_tabular.estimators.names import named_estimators
from oee_tabular.exceptions import (
    ArgumentError,
)
from oee_tabular.report import (
    Report,
)
from oee_tabular.typing import Array, IntArrayLike, RealArrayLike, SeedNumbers

CALIBRATIONS = (*KINDS, "none")


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
    (``choose_correction``). It says that the log cannot say the value, and why, if no
    correction can be trusted, or if most of the policy's transitions start outside the
    range of the log's states. No value or interval goes beyond what the rewards (the
    log's, and the simulator's for this policy) can sum to within the horizon.

    Its rows are:

    - "simulator (continuous)": always, by Monte Carlo.
    - "oee (residual)": if "oee" is among the estimators. Where fitted parameters or
      last actions are taken, a row like "oee (parameters, residual)" or "oee
      (residual, last 2 actions)" stands before it.
    - "oee (calibrated)" and "oee on the grid": if "oee" is among the estimators and
      ``settings.grid`` is given. The former is left out with calibration "none"; the
      latter has the error of the grid.
    - "linear model of the log": if ``estimators`` is None.
    - "pdis", "wpdis" and, on cells, finite estimators: if they are asked for, and by
      default where the behaviour policy is known.
    - "target (continuous)": if ``target`` is given.

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
    _checks.boolean(normalized, "normalized")
    request = _check_request(
        simulator,
        settings,
        behavior=behavior,
        target=target,
        history=history,
        fit=fit,
        estimators=estimators,
        horizon=horizon,
        discount=discount,
        seed=seed,
        scale=1.0 - discount if normalized else 1.0,
    )
    if not _checks.instance(
        policies, Mapping, "policies", "mapping from names to policies"
    ):
        raise ArgumentError("policies", "must hold at least one; it is empty")
    layout = Layout(
        confidence,
        normalized,
        _checks.boolean(guaranteed, "guaranteed"),
        _checks.boolean(quick, "quick"),
        request.calibration,
        conform({} if facts is None else facts, "facts", Mapping[str, Any]),
    )
    premises = Premises(lower_ratio, upper_ratio, tie, features)
    return _compute_refined(request, log, policies).report(premises, layout)


@dataclass(frozen=True, eq=False)
class _Request:
    """What is asked for, checked."""

    simulator: ContinuousSimulator
    settings: Settings
    behavior: StatePolicy | None
    target: ContinuousTask | None
    history: int | Literal["auto"]
    fit: Sequence[str] | ParameterFit | None
    names: list[str] | None
    calibration: Calibration
    horizon: int
    discount: float
    seed: SeedNumbers
    scale: float


def _check_request(
    simulator: ContinuousSimulator | ContinuousTask,
    settings: Settings | None,
    *,
    horizon: int | None,
    target: ContinuousTask | None,
    estimators: Sequence[str] | None,
    fit: Sequence[str] | ParameterFit | None,
    **given: Any,
) -> _Request:
    """Check what is asked for."""
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
    if target is not None:
        _checks.instance(target, ContinuousTask, "target")
    if fit is not None and not isinstance(fit, ParameterFit):
        fit = _names(fit, "fit")
    kind = simulator.calibration if chosen.calibration is None else chosen.calibration
    _checks.one_of(kind, "calibration", CALIBRATIONS)
    steps = simulator.horizon
    if horizon is not None:
        steps = _checks.positive_integer(horizon, "horizon")
    return _Request(
        simulator,
        chosen,
        target=target,
        fit=fit,
        names=None if estimators is None else _names(estimators, "estimators"),
        calibration=kind,
        horizon=steps,
        **given,
    )


def _compute_refined(
    request: _Request,
    log: ContinuousTransitions,
    policies: Mapping[str, StatePolicy | Array],
) -> _Found:
    """Take the steps before the report, again with finer actions while it helps."""
    found = _compute(request, log, policies)
    said: list[str] = []
    for _ in range(MAX_REFINEMENTS):
        finer = found.refine()
        if finer is None:
            break
        said += found.describe_refinement(len(finer.simulator.task.actions))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # said before
            found = _compute(finer, log, policies)
    return replace(found, refinements=said)


def _compute(
    request: _Request,
    log: ContinuousTransitions,
    policies: Mapping[str, StatePolicy | Array],
) -> _Found:
    """Take the steps before the report: prepare, correct, choose the rows."""
    simulator = request.simulator
    prepared = prepare(
        simulator,
        log,
        policies,
        request.settings,
        behavior=request.behavior,
        horizon=request.horizon,
        discount=request.discount,
        seed=request.seed,
    )
    fit = request.fit
    if fit is not None and not isinstance(fit, ParameterFit):
        fit = fit_parameters(*parameters_of(simulator.task, fit), prepared.log)
    correction = choose_correction(
        simulator.task,
        prepared.commanded_log,
        history=request.history,
        fit=fit,
        seed=request.seed,
    )
    wanted, left_out = _choose_estimators(
        request.names, prepared.log, has_cells=prepared.cells is not None
    )
    sampling, finite = split_sampling(wanted)
    rollouts = Rollouts(
        request.horizon,
        request.discount,
        prepared.episodes,
        _checks.seed_sequence(request.seed, (10**6,)),
        simulator.refits,
        simulator.refit_paths,
    )
    roundings, finer = measure_roundings(
        simulator.task, prepared.log, prepared.policies, rollouts
    )
    rows = choose_rows(
        prepared,
        correction,
        rollouts,
        sampling,
        wants_oee=OffEnvironment() in wanted.values(),
        wants_linear=request.names is None,
        target=request.target,
        scale=request.scale,
        roundings=roundings,
    )
    return _Found(
        request, prepared, correction, rows, finite, left_out, [], roundings, finer
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """What a report is made of."""

    request: _Request
    prepared: Prepared
    correction: Correction
    rows: Rows
    finite: Mapping[str, Estimator]
    left_out: list[str]
    refinements: list[str]
    roundings: Mapping[StatePolicy, Rounding]
    finer: ContinuousTask | None

    def report(self, premises: Premises, layout: Layout) -> Report:
        """Assemble the report."""
        messages = (
            *self.left_out,
            *self.prepared.messages,
            *self.refinements,
            *self.describe_roundings(),
        )
        is_auto = isinstance(self.request.history, str)
        sentences = describe_whole(self.correction, messages, is_auto=is_auto)
        cells = self.prepared.cells
        if cells is None:
            return assemble_rows(self.prepared, self.rows, sentences, premises, layout)
        return assemble_on_cells(
            self.prepared, cells, self.rows, self.finite, sentences, premises, layout
        )

    def refine(self) -> _Request | None:
        """Return the request with finer actions, if a value needs them and all can.

        What is given by the numbers of the actions cannot, nor can a log that has only
        these actions: what the target does under others was never recorded.
        """
        request, prepared = self.request, self.prepared
        by_number = (
            prepared.cells,
            request.behavior,
            prepared.log.behavior_probability,
            request.fit if isinstance(request.fit, ParameterFit) else None,
        )
        if (
            self.finer is None
            or any(each is not None for each in by_number)
            or len(self.roundings) < len(prepared.policies)
            or has_only(prepared.given_log, request.simulator.task.actions)
        ):
            return None
        n_times = max((self._excess(name) for name in self._coarse()), default=0)
        if n_times == 0:
            return None
        task = make_finer_often(request.simulator.task, prepared.log, n_times)
        target = request.target
        if target is not None:
            target = make_finer_often(target, prepared.log, n_times)
            if len(target.actions) != len(task.actions):
                return None
        simulator = replace(request.simulator, task=task, expert=None)
        return replace(request, simulator=simulator, target=target)

    def _excess(self, name: str) -> int:
        """Return how often the levels must be doubled for a policy."""
        estimate = self.rows.first[0].estimate(self.prepared.policies[name])
        if estimate.interval is None:
            return 0
        lower, upper = estimate.interval
        rounding = self._rounding(name)
        own = upper - lower - MOST * abs(rounding.error)
        return rounding.count_refinements(own / 2.0)

    def _coarse(self) -> list[str]:
        """Return the policies whose rounding is too large for the value in front."""
        if not self.rows.has_oee or not self.correction.is_trusted:
            return []
        row = self.rows.first[0]
        return [
            name
            for name, policy in self.prepared.policies.items()
            if "rounding_error" in row.estimate(policy).diagnostics
        ]

    def describe_refinement(self, n_actions: int) -> list[str]:
        """Say for which policies finer actions are taken."""
        return [
            f"{self._rounding(name).describe(name, self.request.scale)}. That is more"
            f" than a tenth of its interval, so {n_actions} actions are taken."
            for name in self._coarse()
        ]

    def _rounding(self, name: str) -> Rounding:
        """Return what rounding does to a policy's value."""
        return self.roundings[self.prepared.policies[name]]

    def describe_roundings(self) -> list[str]:
        """Say what rounding does to each policy."""
        coarse = self._coarse()
        found = []
        for name, policy in self.prepared.policies.items():
            text = describe_rounding(
                name,
                policy,
                self.prepared.given_log,
                self.roundings,
                self.request.scale,
                is_counted=name in coarse,
            )
            if text:
                found.append(text)
        return found


def describe_whole(
    correction: Correction, messages: tuple[str, ...], *, is_auto: bool
) -> Sentences:
    """Return what is said of a correction, and the other messages."""
    # fitted parameters leave little to tell: the difference is that of what was given
    compared = correction.learned
    if correction.fit is not None and not correction.steps:
        compared = correction.plain
    reason, shown = correction.doubt
    found = [f"{shown} {correction.advice(is_auto=is_auto)}".strip()]
    doubt = ""
    if correction.is_trusted:
        found.append(correction.reason)
    else:
        doubt = (
            f"{reason}, so neither a corrected simulator nor a model of the log can be"
            " trusted"
        )
    found.append(difference(compared))
    distance = tuple(sentence for sentence in found if sentence)
    return Sentences(distance, doubt, messages)


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
