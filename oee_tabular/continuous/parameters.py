"""A simulator's physical parameters by least squares on the one-step errors of a log: ``fit_parameters``.

    p* = argmin_p sum_{i, k} rho((s'_ik - f_k(s_i, a_i; p)) / scale_k),    rho(r) = 2 c^2 (sqrt(1 + (r / c)^2) - 1)

rho is quadratic up to c, the median error, and linear beyond: rows that the structure does not explain (contacts, actions that
were not carried out) pull little. Where the simulator has the target's structure, a few hundred transitions determine p; where
it has not, p is biased, and a ``ResidualSimulator`` of the fitted task corrects what is left.
"""

from __future__ import annotations

import copy
import dataclasses
import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._threads import one_thread
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, find_periods, require_log_of, shortest

MAX_ROWS, MAX_SLOW_ROWS = 20_000, 2000  # by which parameters are fitted; slow: of tasks that step one by one
ROUNDING = 1e-9  # relative: no standard error is less
DIFFERENCE = 1e-5  # relative step of the derivatives in p
FLAT = 1e-9  # eigenvalues of the curvature, relative to the largest: the log does not determine such a direction
FLOOR = 1e-7  # of the errors' scale, in displacements: rounding


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """A simulator's parameters, fitted to a log.

    Attributes
    ----------
    task : ContinuousTask with the fitted parameters
    parameters, standard_error : name -> number; the standard error is infinite where the log does not determine a parameter
    residual : (n, d) s' - f(s, a) of the fitted task
    start : name -> the number that the fit began from
    at_bounds : names of the parameters that ended at a bound

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole
    >>> fit = ParameterFit(CartPole(15.0), {"gravity": 15.0}, {"gravity": 0.004}, np.zeros((300, 4)), {"gravity": 10.0})
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
        """Each parameter with its standard error, and which of them stand at a bound or are not determined."""
        values = ", ".join(
            f"{name} {value:.4g} (standard error {self.standard_error[name]:.2g}; the simulator has {self.start[name]:.4g})"
            for name, value in self.parameters.items()
        )
        text = f"Least squares gives {values}."
        if self.at_bounds:
            text += f" The fit stopped at a bound of {', '.join(self.at_bounds)}."
        if unknown := [name for name, error in self.standard_error.items() if not np.isfinite(error)]:
            text += f" The log does not determine {', '.join(unknown)}."
        return text


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
    task_of : function of the parameters, by name, that makes the ContinuousTask with them
    start : name -> number from which the search begins, the simulator's own
    log : ContinuousTransitions of the target
    bounds : name -> (lower, upper); none: a parameter keeps the sign that it starts with

    Returns
    -------
    ParameterFit
        Standard errors are sandwich estimates: of the best parameters p*, valid where the structure is wrong, too.

    Raises
    ------
    ValueError
        A start that is no number or beyond its bounds; bounds of other names; a log of other states.

    Notes
    -----
    Some ten steps of each of 20 000 rows for each parameter.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=300, max_steps=100, seed=0)
    >>> fit = fit_parameters(lambda gravity: CartPole(gravity), {"gravity": 10.0}, log)
    >>> abs(fit.parameters["gravity"] - 15.0) < 4 * fit.standard_error["gravity"] < 0.1
    True
    """
    _checks.function(task_of, "task_of")
    if not isinstance(start, Mapping) or not start:
        raise ValueError(f"start must map names of parameters to numbers; got {_checks.show(start)}")
    names = list(start)
    x0 = np.array([_checks.number_in(start[name], f"start[{name!r}]", -np.inf, np.inf) for name in names])
    limits = _limits(names, x0, {} if bounds is None else bounds)

    def by_name(x: Array) -> dict[str, float]:
        return dict(zip(names, x.tolist(), strict=True))

    first = _checks.instance(task_of(**by_name(x0)), ContinuousTask, "task_of(**start)")
    require_log_of(first, log)
    actions, periods = log.action_numbers(first.actions), find_periods(first, log.next_state)
    step = -(-len(log) // (MAX_ROWS if first.steps_at_once else MAX_SLOW_ROWS))
    moved = shortest(log.next_state - log.state, periods).std(axis=0)

    def errors(task: ContinuousTask, step: int) -> Array:
        own = task.noiseless_step(log.state[::step], actions[::step]).next_state
        return shortest(log.next_state[::step] - own, periods)

    def scaled_errors(x: Array) -> Array:
        return (errors(task_of(**by_name(x)), step) / np.where(moved > 0, moved, 1.0)).ravel()

    x, size = x0, np.where(x0 != 0, np.abs(x0), 1.0)
    for _ in range(3):  # the scale of the errors falls as the fit improves
        left = np.abs(scaled_errors(x))
        c = max(float(np.median(left[left > 0])) if (left > 0).any() else 0.0, FLOOR)
        result = least_squares(
            scaled_errors, x, bounds=limits, loss="soft_l1", f_scale=c, x_scale=size, diff_step=DIFFERENCE, max_nfev=50
        )
        x = result.x
    steps = np.diag(DIFFERENCE * size)
    jacobian = np.stack([(scaled_errors(x + h) - scaled_errors(x - h)) / (2.0 * h.sum()) for h in steps], axis=1)
    error = np.maximum(_sandwich(jacobian, scaled_errors(x), c, len(log.state[::step])), ROUNDING * size)
    task = task_of(**by_name(x))
    at_bounds = tuple(name for name, mask in zip(names, result.active_mask, strict=True) if mask)
    return ParameterFit(task, by_name(x), by_name(error), errors(task, 1), by_name(x0), at_bounds)


def _limits(names: list[str], x0: Array, bounds: Mapping[str, tuple[float, float]]) -> tuple[Array, Array]:
    low, high = np.where(x0 > 0, 0.0, -np.inf), np.where(x0 < 0, 0.0, np.inf)
    for name, ends in bounds.items():
        if name not in names:
            raise ValueError(f"bounds must be of parameters in start ({', '.join(names)}); got {name!r}")
        k = names.index(name)
        low[k], high[k] = ends
        if not low[k] <= x0[k] <= high[k] or low[k] == high[k]:
            raise ValueError(f"start[{name!r}] must be in its bounds, {low[k]:g} to {high[k]:g}; it is {x0[k]:g}")
    return low, high


def _sandwich(jacobian: Array, residual: Array, c: float, n_rows: int) -> Array:
    """(p,) standard errors, diag(H^-1 (sum_i g_i g_i') H^-1)^(1/2), g_i the gradient of row i; inf where H is singular."""
    size = np.sqrt((jacobian**2).sum(axis=0))
    scale = np.where(size > 0, size, 1.0)
    unit, weight = jacobian / scale, (1.0 + (residual / c) ** 2) ** -0.5
    values, vectors = np.linalg.eigh(unit.T @ (unit * (weight**3)[:, None]))  # weight^3 is rho''
    is_flat = values <= FLAT * values[-1]
    inverse = (vectors[:, ~is_flat] / values[~is_flat]) @ vectors[:, ~is_flat].T
    gradients = (unit * (weight * residual)[:, None]).reshape(n_rows, -1, len(size)).sum(axis=1)
    error = np.sqrt(((gradients @ inverse) ** 2).sum(axis=0)) / scale
    return np.where((size == 0) | (np.abs(vectors[:, is_flat]) > 1e-3).any(axis=1), np.inf, error)


def parameters_of(task: ContinuousTask, names: Sequence[str]) -> tuple[Callable[..., ContinuousTask], dict[str, float]]:
    """``task_of`` and ``start`` of parameters by name: fields of a task's class, or a Gymnasium environment's physics.

    Raises
    ------
    ValueError
        A name that is no number of the task's; the nearest is named.
    """
    family: Any = getattr(task, "family", None)
    known = _numbers_of(task) if family is None else family.known()
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            raise ValueError(
                f"fit must name parameters of {task.name} ({', '.join(known) or 'none'}); got {name!r}{hint}"
            )

    def change(**values: float) -> Any:
        again: Any = copy.copy(task)
        if dataclasses.is_dataclass(again):
            return dataclasses.replace(again, **values)  # type: ignore[type-var]
        vars(again).update(values)
        return again

    return change if family is None else family, {name: known[name] for name in names}


def _numbers_of(task: Any) -> dict[str, float]:
    """The attributes of a task that are numbers which a copy of it can have otherwise."""
    names = [f.name for f in dataclasses.fields(task) if f.init] if dataclasses.is_dataclass(task) else vars(task)
    values = {name: getattr(task, name) for name in names if not name.startswith("_")}
    return {name: float(x) for name, x in values.items() if isinstance(x, int | float) and not isinstance(x, bool)}
