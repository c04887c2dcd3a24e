"""Physical parameters of a simulator, fitted by least squares on one-step errors.

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
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular.continuous.log.numbering import number_actions
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    find_periods,
    shortest,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, IntArray

# rows by which parameters are fitted; slow tasks step one state at a time
MAX_ROWS = 20_000
MAX_SLOW_ROWS = 2000
# share of a parameter's size: no standard error is less, because of rounding
MIN_RELATIVE_ERROR = 1e-9
RELATIVE_STEP = 1e-5  # of the derivatives in p, in units of a parameter's size
# share of the curvature's largest eigenvalue: the log does not determine a direction
# with less
MIN_RELATIVE_CURVATURE = 1e-9
N_SCALES = 3  # fits: the scale of the errors falls as the fit improves
MIN_ERROR_SCALE = 1e-7  # displacements' deviations: less is rounding


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

    def __post_init__(self) -> None:
        for name in ("standard_error", "start"):
            given = getattr(self, name)
            for key in self.parameters:
                if key not in given:
                    raise ArgumentError(
                        name,
                        f"must have a number of every parameter; {_checks.show(key)} is"
                        " missing",
                    )

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
    names, x0 = _read_start(start)
    ends = _read_bounds(bounds, names, x0)
    errors = OneStepErrors(_make_task(task_of, names, x0), log)

    def task_at(x: Array) -> ContinuousTask:
        """Return the task with these parameters."""
        return _call_task_of(task_of, _by_name(names, x))

    def scaled_errors(x: Array) -> Array:
        """Return the errors in units of the displacements' deviations, as a vector."""
        return errors.scaled(task_at(x))

    size = np.where(x0 != 0, np.abs(x0), 1.0)
    x, c, active = _least_squares(scaled_errors, x0, ends, size)
    sandwich = _sandwich(
        _jacobian(scaled_errors, x, size), scaled_errors(x), c, errors.n_used
    )
    error = np.maximum(sandwich, MIN_RELATIVE_ERROR * size)
    task = task_at(x)
    at_bounds = tuple(name for name, k in zip(names, active, strict=True) if k)
    return ParameterFit(
        task,
        _by_name(names, x),
        _by_name(names, error),
        errors.of(task, 1),
        _by_name(names, x0),
        at_bounds,
    )


class OneStepErrors:
    """The one-step errors of tasks on the rows of a log.

    Parameters
    ----------
    first : ContinuousTask
        A task with the states and the actions of all of them.
    log : ContinuousTransitions
        The log.

    Attributes
    ----------
    n_used : int
        The number of rows by which parameters are fitted.
    """

    def __init__(self, first: ContinuousTask, log: ContinuousTransitions) -> None:
        self._log = log
        self._actions = number_actions(first, log)
        self._periods = find_periods(first, log.next_state)
        most = MAX_ROWS if first.steps_at_once else MAX_SLOW_ROWS
        self._step = -(-len(log) // most)
        moved = shortest(log.next_state - log.state, self._periods).std(axis=0)
        self._unit = np.where(moved > 0, moved, 1.0)
        self.n_used = len(log.state[:: self._step])

    def of(self, task: ContinuousTask, step: int) -> Array:
        """Return the errors of a task in every ``step``-th row of the log."""
        states = self._log.state[::step]
        own = task.noiseless_step(states, self._actions[::step]).next_state
        return shortest(self._log.next_state[::step] - own, self._periods)

    def scaled(self, task: ContinuousTask) -> Array:
        """Return those of the used rows, in the displacements' deviations, flat."""
        return (self.of(task, self._step) / self._unit).ravel()


def _read_start(start: Mapping[str, float]) -> tuple[list[str], Array]:
    """Return the names of the parameters and the numbers to begin with."""
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
    numbers = [
        _checks.number_in(start[name], f"start[{name!r}]", -np.inf, np.inf)
        for name in names
    ]
    return names, np.array(numbers)


def _read_bounds(
    bounds: Mapping[str, tuple[float, float]] | None, names: list[str], x0: Array
) -> tuple[Array, Array]:
    """Return the lower and the upper bounds; without, a parameter keeps its sign."""
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
    return low, high


def _by_name(names: list[str], x: Array) -> dict[str, float]:
    """Return parameters as a mapping from their names."""
    return dict(zip(names, x.tolist(), strict=True))


def _call_task_of(
    task_of: Callable[..., ContinuousTask], given: Mapping[str, float]
) -> ContinuousTask:
    """Return the task of some parameters by the user's function."""
    call = f"task_of({', '.join(f'{name}=...' for name in given)})"
    return _checks.call_function(task_of, "task_of", call, **given)


def _make_task(
    task_of: Callable[..., ContinuousTask], names: list[str], x0: Array
) -> ContinuousTask:
    """Return the task to begin with; names that it does not take are an error."""
    given = _by_name(names, x0)
    try:
        inspect.signature(task_of).bind(**given)
    except TypeError as refusal:
        raise ArgumentError(
            "start", f"must name parameters that task_of takes: {refusal}"
        ) from refusal
    except ValueError:  # it does not tell its parameters
        pass
    made = _call_task_of(task_of, given)
    return _checks.instance(made, ContinuousTask, "task_of(**start)")


def _least_squares(
    errors: Callable[[Array], Array],
    x0: Array,
    ends: tuple[Array, Array],
    size: Array,
) -> tuple[Array, float, IntArray]:
    """Return the fit, the scale c of its errors, and which bounds it lies at."""
    options: dict[str, Any] = {
        "loss": "soft_l1",
        "x_scale": size,
        "diff_step": RELATIVE_STEP,
        "max_nfev": 50,
    }
    x = x0
    for _ in range(N_SCALES):
        left = np.abs(errors(x))
        median = float(np.median(left[left > 0])) if (left > 0).any() else 0.0
        c = max(median, MIN_ERROR_SCALE)
        result = least_squares(errors, x, bounds=ends, f_scale=c, **options)
        x = result.x
    return x, c, result.active_mask


def _jacobian(errors: Callable[[Array], Array], x: Array, size: Array) -> Array:
    """Return the derivatives of the errors (n, p), by central differences."""
    steps = np.diag(RELATIVE_STEP * size)
    columns = [(errors(x + h) - errors(x - h)) / (2.0 * h.sum()) for h in steps]
    return np.stack(columns, axis=1)


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
