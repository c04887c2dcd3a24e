"""The correction that a log supports: of a simulator's parameters, steps and history.

The measure is the held-out one-step error of f + g, mean square over every row of the
log in units of the displacement's variance, summed over coordinates
(``Coordinate.unexplained``). Fitted parameters come first where it is no larger with
them. Actions enter the state where earlier ones explain residuals, and as many as bring
the error within a hundredth of a step of the least. Where something hidden remains, no
correction of a Markov state can be trusted.

A simulator's physical parameters are fitted by least squares on the one-step errors of
a log (``fit_parameters``),

    p* = argmin_p sum_{i, k} rho((s'_ik - f_k(s_i, a_i; p)) / scale_k),
    rho(r) = 2 c^2 (sqrt(1 + (r / c)^2) - 1)

rho is quadratic up to c, the median error, and linear beyond: rows that the structure
does not explain (contacts, actions that were not carried out) pull little. Where the
simulator has the target's structure, a few hundred transitions determine p; where it
has not, p is biased, and a ``ResidualSimulator`` of the fitted task corrects what is
left.
"""

from __future__ import annotations

import copy
import dataclasses
import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.optimize import least_squares

from oee_tabular import _checks, _progress
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular.continuous.history import (
    MAX_LAG,
    HistoryTask,
    check_n_actions,
    hidden_state,
)
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import (
    ContinuousTask,
    StatePolicy,
    find_periods,
    require_log_of,
    shortest,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, Seed

# rows by which parameters are fitted; slow tasks step one state at a time
MAX_ROWS = 20_000
MAX_SLOW_ROWS = 2000
# share of a parameter's size: no standard error is less, because of rounding
MIN_RELATIVE_ERROR = 1e-9
RELATIVE_STEP = 1e-5  # of the derivatives in p, in units of a parameter's size
# share of the curvature's largest eigenvalue: the log does not determine a direction
# with less
MIN_RELATIVE_CURVATURE = 1e-9
MIN_ERROR_SCALE = 1e-7  # displacements' deviations: less is rounding
MIN_GAIN = 0.01  # of a step's own deviation: a history that brings less is not kept
# share of the hidden part that may be left with a history, for its value to be trusted
MAX_HIDDEN_LEFT = 0.2
MAX_ERROR_RATIO = 1.05  # of the errors with and without fitted parameters
UNITS = "the log's columns seem to be in another unit than the simulator's: "


@checked()
@dataclass(frozen=True, eq=False)
class ParameterFit:
    """A simulator's parameters, fitted to a log.

    Attributes
    ----------
    task : ContinuousTask
        The task with the fitted parameters.
    parameters : mapping from str to float
        The fitted parameters by name, in the task's units.
    standard_error : mapping from str to float
        Their standard errors; infinite where the log does not determine a parameter.
    residual : ndarray of shape (n, d)
        s' - f(s, a) of the fitted task in each row of the log.
    start : mapping from str to float
        The numbers from which the fit began.
    at_bounds : tuple of str
        The names of the parameters that ended at a bound.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole
    >>> fit = ParameterFit(
    ...     CartPole(15.0),
    ...     {"gravity": 15.0},
    ...     {"gravity": 0.004},
    ...     np.zeros((300, 4)),
    ...     {"gravity": 10.0},
    ... )
    >>> fit.describe()
    'Least squares gives gravity 15 (standard error 0.004; the simulator has 10).'
    """

    task: ContinuousTask
    parameters: Mapping[str, float]
    standard_error: Mapping[str, float]
    residual: Array
    start: Mapping[str, float]
    at_bounds: tuple[str, ...] = ()

    def describe(self) -> str:
        """Describe each parameter with its standard error.

        Returns
        -------
        str
            Sentences, which also say which parameters stand at a bound or are not
            determined.
        """
        values = ", ".join(
            f"{name} {value:.4g} (standard error {self.standard_error[name]:.2g}; the"
            f" simulator has {self.start[name]:.4g})"
            for name, value in self.parameters.items()
        )
        text = f"Least squares gives {values}."
        if self.at_bounds:
            text += f" The fit stopped at a bound of {', '.join(self.at_bounds)}."
        errors = self.standard_error.items()
        unknown = [name for name, error in errors if not np.isfinite(error)]
        if unknown:
            text += f" The log does not determine {', '.join(unknown)}."
        return text


@suggest_keywords
@one_thread
def fit_parameters(
    task_of: Callable[..., ContinuousTask],
    start: Mapping[str, float],
    log: ContinuousTransitions,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> ParameterFit:
    """Fit named physical parameters by robust least squares on one-step errors.

    Parameters
    ----------
    task_of : function
        A function of the parameters, by name, that makes the ContinuousTask with them.
    start : mapping from str to float
        The numbers from which the search begins, the simulator's own.
    log : ContinuousTransitions
        A log of the target.
    bounds : mapping from str to (float, float), optional
        The lower and the upper bound of parameters by name. A parameter without bounds
        keeps the sign with which it starts.

    Returns
    -------
    ParameterFit
        The fit. Standard errors are sandwich estimates: of the best parameters p*,
        valid where the structure is wrong, too.

    Raises
    ------
    ValueError
        If a start is no number or beyond its bounds, bounds have other names, or the
        log has other states.

    See Also
    --------
    ResidualSimulator : Correct what the parameters do not explain.

    Notes
    -----
    Costs some ten steps of each of 20 000 rows for each parameter.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=300,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> fit = fit_parameters(lambda gravity: CartPole(gravity), {"gravity": 10.0}, log)
    >>> abs(fit.parameters["gravity"] - 15.0) < 4 * fit.standard_error["gravity"] < 0.1
    True
    """
    _checks.function(task_of, "task_of")
    if not isinstance(start, Mapping) or not start:
        raise ArgumentError(
            "start",
            f"must map names of parameters to numbers; got {_checks.show(start)}",
        )
    names = list(start)
    for name in names:
        if not isinstance(name, str):
            raise ArgumentError(
                "start", f"must have texts as names of parameters; one is {name!r}"
            )
    x0 = np.array(
        [
            _checks.number_in(start[name], f"start[{name!r}]", -np.inf, np.inf)
            for name in names
        ]
    )
    low = np.where(x0 > 0, 0.0, -np.inf)
    high = np.where(x0 < 0, 0.0, np.inf)
    if bounds is not None and not isinstance(bounds, Mapping):
        raise ArgumentError(
            "bounds",
            "must map names of parameters to (lower, upper); got"
            f" {_checks.show(bounds)}",
        )
    for name, ends in (bounds or {}).items():
        if name not in names:
            raise ArgumentError(
                "bounds",
                f"must be of parameters in start ({', '.join(names)}); got {name!r}",
            )
        k = names.index(name)
        pair = _checks.float_array(ends, f"bounds[{name!r}]", ndim=1)
        if pair.shape != (2,) or np.isnan(pair).any():
            raise ArgumentError(
                f"bounds[{name!r}]",
                f"must be two numbers, lower and upper; it is {_checks.show(ends)}",
            )
        low[k], high[k] = pair
        if not low[k] <= x0[k] <= high[k] or low[k] == high[k]:
            raise ArgumentError(
                f"start[{name!r}]",
                f"must be in its bounds, {low[k]:g} to {high[k]:g}; it is {x0[k]:g}",
            )

    def by_name(x: Array) -> dict[str, float]:
        """Return the parameters as a mapping from their names."""
        return dict(zip(names, x.tolist(), strict=True))

    try:
        made = task_of(**by_name(x0))
    except TypeError as refusal:
        if "keyword argument" not in str(refusal):  # it is of what task_of does inside
            raise
        raise ArgumentError(
            "start", f"must name parameters that task_of takes: {refusal}"
        ) from refusal
    first = _checks.instance(made, ContinuousTask, "task_of(**start)")
    require_log_of(first, log)
    actions = log.action_numbers(first.actions)
    periods = find_periods(first, log.next_state)
    step = -(-len(log) // (MAX_ROWS if first.steps_at_once else MAX_SLOW_ROWS))
    moved = shortest(log.next_state - log.state, periods).std(axis=0)

    def errors(task: ContinuousTask, step: int) -> Array:
        """Return the one-step errors of a task in every ``step``-th row of the log."""
        own = task.noiseless_step(log.state[::step], actions[::step]).next_state
        return shortest(log.next_state[::step] - own, periods)

    def scaled_errors(x: Array) -> Array:
        """Return the errors in units of the displacements' deviations, as a vector."""
        left = errors(task_of(**by_name(x)), step)
        return (left / np.where(moved > 0, moved, 1.0)).ravel()

    x = x0
    size = np.where(x0 != 0, np.abs(x0), 1.0)
    options: dict[str, Any] = {
        "loss": "soft_l1",
        "x_scale": size,
        "diff_step": RELATIVE_STEP,
        "max_nfev": 50,
    }
    for _ in range(3):  # the scale of the errors falls as the fit improves
        left = np.abs(scaled_errors(x))
        median = float(np.median(left[left > 0])) if (left > 0).any() else 0.0
        c = max(median, MIN_ERROR_SCALE)
        result = least_squares(
            scaled_errors, x, bounds=(low, high), f_scale=c, **options
        )
        x = result.x
    steps = np.diag(RELATIVE_STEP * size)
    jacobian = np.stack(
        [
            (scaled_errors(x + h) - scaled_errors(x - h)) / (2.0 * h.sum())
            for h in steps
        ],
        axis=1,
    )
    n_rows = len(log.state[::step])
    sandwich = _sandwich(jacobian, scaled_errors(x), c, n_rows)
    error = np.maximum(sandwich, MIN_RELATIVE_ERROR * size)
    task = task_of(**by_name(x))
    at_bounds = tuple(
        name for name, mask in zip(names, result.active_mask, strict=True) if mask
    )
    return ParameterFit(
        task, by_name(x), by_name(error), errors(task, 1), by_name(x0), at_bounds
    )


def _sandwich(jacobian: Array, residual: Array, c: float, n_rows: int) -> Array:
    """Compute standard errors (p,), diag(H^-1 (sum_i g_i g_i') H^-1)^(1/2).

    g_i is the gradient of row i. The error is inf where H is singular.
    """
    size = np.sqrt((jacobian**2).sum(axis=0))
    scale = np.where(size > 0, size, 1.0)
    unit = jacobian / scale
    weight = (1.0 + (residual / c) ** 2) ** -0.5
    # weight^3 is rho''
    values, vectors = np.linalg.eigh(unit.T @ (unit * (weight**3)[:, None]))
    is_flat = values <= MIN_RELATIVE_CURVATURE * values[-1]
    inverse = (vectors[:, ~is_flat] / values[~is_flat]) @ vectors[:, ~is_flat].T
    weighted = unit * (weight * residual)[:, None]
    gradients = weighted.reshape(n_rows, -1, len(size)).sum(axis=1)
    error = np.sqrt(((gradients @ inverse) ** 2).sum(axis=0)) / scale
    # a parameter with a part in a flat direction is not determined
    is_undetermined = (np.abs(vectors[:, is_flat]) > 1e-3).any(axis=1)
    return np.where((size == 0) | is_undetermined, np.inf, error)


def parameters_of(
    task: ContinuousTask, names: Sequence[str]
) -> tuple[Callable[..., ContinuousTask], dict[str, float]]:
    """Return ``task_of`` and ``start`` of parameters by name, for ``fit_parameters``.

    Parameters are the fields of a task's class, or a Gymnasium environment's physics. A
    name that is no number of the task's is a ValueError, which tells the nearest name.
    """
    family: Any = getattr(task, "family", None)
    if family is not None:
        known = family.known()
    else:
        public = [name for name in _attributes(task) if not name.startswith("_")]
        values = {name: getattr(task, name) for name in public}
        known = {
            name: float(x)
            for name, x in values.items()
            if isinstance(x, int | float) and not isinstance(x, bool)
        }
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise ArgumentError(
                "fit",
                f"must name parameters of {task.name} ({', '.join(known) or 'none'});"
                f" got {name!r}{hint}",
            )

    def change(**values: float) -> Any:
        """Return a copy of the task with these parameters."""
        again: Any = copy.copy(task)
        if dataclasses.is_dataclass(again):
            return dataclasses.replace(again, **values)  # type: ignore[type-var]
        vars(again).update(values)
        return again

    return change if family is None else family, {name: known[name] for name in names}


def _attributes(task: Any) -> list[str]:
    """Return the names of a task's attributes, of a dataclass its parameters' names."""
    if dataclasses.is_dataclass(task):
        return [f.name for f in dataclasses.fields(task) if f.init]
    return list(vars(task))


def describe_flaw(learned: ResidualSimulator) -> str:
    """Describe why a corrected simulator cannot be trusted, or return "ok".

    The columns may be in other units, or history may explain the residuals.
    """
    if learned.units:
        return f"{UNITS}{learned.units}"
    effect = hidden_state(learned)
    return (
        "the next state depends on more than the state and the action (hidden state):"
        f" {effect}"
        if effect
        else "ok"
    )


def difference(corrected: ResidualSimulator) -> str:
    """Describe in which coordinates the target's steps differ from the simulator's."""
    changes = ", ".join(
        f"{c.name} (residuals {c.residual_scatter:.2g}, simulator's scatter"
        f" {c.simulator_scatter:.2g}, {max(c.explained, 0.0):.1%} explained)"
        for c in corrected.coordinates
        if c.differs
    )
    if not changes:
        return (
            "The log shows no difference between the target's steps and the"
            " simulator's. Its residuals s' - f(s, a) are as large as the simulator's"
            " own scatter."
        )
    text = f"The target's steps differ from the simulator's in {changes}."
    if corrected.units:
        return f"{UNITS.capitalize()}{corrected.units}. {text}"
    text += (
        " Explained is the share of the residuals' mean square that the correction"
        " removes."
    )
    return text + odd_row(corrected)


def odd_row(corrected: ResidualSimulator) -> str:
    """Describe the row that makes most of the unexplained residual of a coordinate.

    It may be an error. Returns "" where no row alone does so.
    """
    for k, c in enumerate(corrected.coordinates):
        squares = corrected.left_over[:, k] ** 2
        row = int(squares.argmax())
        total = float(squares.sum())
        if squares[row] > 0.5 * total and c.left_over**2 > 0.01 * c.residual_scatter**2:
            return (
                f" Row {row} of the log alone makes {squares[row] / total:.0%} of the"
                f" unexplained residual in {c.name} (by"
                f" {corrected.left_over[row, k]:.3g}). If it is an error, leave it out,"
                " because every value depends on it."
            )
    return ""


@dataclass(frozen=True, eq=False)
class Correction:
    """A simulator corrected by a log, and what was compared.

    Attributes
    ----------
    learned : ResidualSimulator
        The corrected simulator, of a ``HistoryTask`` where ``steps`` is positive.
    steps : int
        The number of last actions in its state.
    fit : ParameterFit or None
        The fit of the parameters, where it was taken.
    plain : ResidualSimulator
        The correction of the simulator as it was given, without history.
    reason : str
        Sentences on what was taken and why.
    """

    learned: ResidualSimulator
    steps: int
    fit: ParameterFit | None
    plain: ResidualSimulator
    reason: str

    @cached_property
    def is_trusted(self) -> bool:
        """Return whether at most a fifth of what is hidden is left."""
        return (
            not self.learned.units
            and self.learned.hidden_part <= MAX_HIDDEN_LEFT * self.plain.hidden_part
        )

    @property
    def name(self) -> str:
        """Return the name of its row in a report."""
        parts = ["residual"]
        if self.fit is not None:
            parts.insert(0, "parameters")
        if self.steps > 0:
            parts.append(f"last {describe_count(self.steps)}")
        return f"oee ({', '.join(parts)})"

    @property
    def status(self) -> str:
        """Return "ok", or why the corrected simulator's value cannot be trusted."""
        return "ok" if self.is_trusted else describe_flaw(self.learned)

    def policy(self, policy: StatePolicy) -> StatePolicy:
        """Return a policy of the simulator's states as one of the corrected states."""
        if isinstance(self.learned.task, HistoryTask) and self.steps:
            return self.learned.task.policy(policy)
        return policy

    def advice(self, *, is_auto: bool) -> str:
        """Advise what to do where history matters and no correction can be trusted.

        Returns "" elsewhere.
        """
        if self.is_trusted or self.learned.units:
            return ""
        if not is_auto:
            return "Use history auto, which tries up to five last actions in the state."
        text = f"Keeping the last actions in the state, up to {MAX_LAG}, does not help."
        if self.steps:
            share = self.learned.hidden_part / self.plain.hidden_part
            text = (
                f"With the last {self.steps} actions in the state, {share:.0%} of that"
                " effect is left."
            )
        return (
            f"{text} Sensor noise, a slow actuator, or a quantity that is not recorded"
            " may be the cause. Filter the states, or record what is missing. Until"
            " then read the simulator's value, which has no interval."
        )


def choose_correction(
    task: ContinuousTask,
    log: ContinuousTransitions,
    *,
    history: int | Literal["auto"] = "auto",
    fit: ParameterFit | None = None,
    seed: Seed = None,
) -> Correction:
    """Correct the simulator by the log in the way that has the least held-out error.

    Parameters
    ----------
    task : ContinuousTask
        The simulator.
    log : ContinuousTransitions
        A log of the target.
    history : int or 'auto', default 'auto'
        The number of last actions in the state; 'auto' chooses among 0 to 5.
    fit : ParameterFit, optional
        A fit of the simulator's parameters, which is compared with none.
    seed : int, Generator or SeedSequence, optional
        The source of random numbers, as in ``ResidualSimulator``.

    Returns
    -------
    Correction
        The correction.
    """
    is_auto = isinstance(history, str) and history == "auto"
    given: Any = history
    if not is_auto:
        history = check_n_actions(given, "history")
    _progress.report_step("correction of the simulator by the log")
    plain = ResidualSimulator(task, log, seed=seed)

    def correct(base: ResidualSimulator, fit: ParameterFit | None) -> Correction:
        """Correct ``base`` with as much history as is asked for."""
        learned, steps = _add_history(base, log, history, seed)
        return Correction(
            learned, steps, fit, plain, describe_history(base, learned, steps, is_auto)
        )

    chosen = correct(plain, None)
    if fit is None:
        return chosen
    fitted = ResidualSimulator(fit.task, log, seed=seed)
    both = correct(fitted, fit)
    errors = [each.learned.held_out_error for each in (both, chosen)]
    is_taken = errors[0] <= MAX_ERROR_RATIO * errors[1]
    words = ("fitted", "no larger") if is_taken else ("given", "smaller")
    text = (
        f"{fit.describe()} The value in front corrects the residuals of the {words[0]}"
        f" simulator, because its held-out one-step error is {words[1]}"
        f" ({errors[0] ** 0.5:.2g} of a step's standard deviation with fitted"
        f" parameters, {errors[1] ** 0.5:.2g} without)."
    )
    if hidden_state(fitted):
        text += (
            " The fit ignores history, which matters here. Do not read its numbers as"
            " physics."
        )
    chosen = both if is_taken else chosen
    return replace(chosen, reason=f"{text} {chosen.reason}".strip())


def _add_history(
    plain: ResidualSimulator,
    log: ContinuousTransitions,
    history: int | Literal["auto"],
    seed: Seed,
) -> tuple[ResidualSimulator, int]:
    """Return the correction with the best, or the given, number of last actions."""

    def learn(steps: int) -> ResidualSimulator:
        """Correct the task with ``steps`` last actions in its state."""
        actions = "action" if steps == 1 else "actions"
        _progress.report_step(f"correction with {steps} earlier {actions} in the state")
        whole = HistoryTask(plain.task, steps)
        return ResidualSimulator(whole, whole.log(log), seed=seed)

    if history != "auto":
        return learn(history) if history else plain, history
    hidden = [c.history for c in plain.coordinates if c.hidden]
    if not hidden or plain.units:
        return plain, 0
    first = max(hidden, key=lambda effect: effect.lag_r_squared)
    tried = {0: plain}
    for steps in range(first.lag if first.of == "action" else 1, MAX_LAG + 1):
        tried[steps] = learn(steps)
        *before, last = (each.held_out_error**0.5 for each in tried.values())
        if min(before) - last < MIN_GAIN / 3.0:
            break
    least = min(each.held_out_error for each in tried.values()) ** 0.5
    most = least + MIN_GAIN
    return next(
        (each, k) for k, each in tried.items() if each.held_out_error**0.5 <= most
    )


def describe_count(steps: int) -> str:
    """Return how many actions there are, in words after "last"."""
    return "action" if steps == 1 else f"{steps} actions"


def describe_history(
    plain: ResidualSimulator, learned: ResidualSimulator, steps: int, is_auto: bool
) -> str:
    """Describe how many last actions are in the state and why; "" where none are."""
    if not steps:
        return ""
    text = f"The value in front has the last {describe_count(steps)} in the state"
    if not is_auto:
        return f"{text}." if describe_flaw(learned) == "ok" else ""
    before, after = (f"{each.held_out_error**0.5:.2g}" for each in (plain, learned))
    text += (
        f", because {hidden_state(plain)}. The held-out one-step error falls from"
        f" {before} to {after} of a step's standard deviation."
    )
    if steps == MAX_LAG:
        text += f" At most {MAX_LAG} are tried; history {MAX_LAG + 3} keeps more."
    return text
