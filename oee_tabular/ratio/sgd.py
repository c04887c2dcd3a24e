"""The paper's Algorithm 1 on tables: stochastic gradient descent on the KL risk.

It shows what training adds to the error of a ratio. At each iteration N points are
drawn from p and N from q, and

    g <- clip(g - step (count_q / N - count_p / (N g) + ridge term), lower, upper),

one parameter an entry. Its trace is measured against the exact optimum of the same
program.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.ratio import dual
from oee_tabular.typing import Array, IntArray, Seed


@suggest_keywords
@dataclass(frozen=True)
class Sgd:
    """Settings of Algorithm 1 on tables.

    Parameters
    ----------
    step_size : float, default 0.1
        Step size eta > 0.
    batch_size : int, default 64
        Number N of draws from each side at an iteration.
    n_iterations : int, default 10000
        Number of iterations; all of them are done.

    See Also
    --------
    Network : Algorithm 1 on a multilayer perceptron.

    Examples
    --------
    >>> from oee_tabular.ratio import Sgd, density_ratio
    >>> fit = density_ratio(
    ...     [3, 1],
    ...     [2, 2],
    ...     lower=0.1,
    ...     upper=9.0,
    ...     normalized=False,
    ...     solver=Sgd(0.01),
    ...     seed=0,
    ... )
    >>> fit.ratio.round(1).tolist(), bool(fit.trace.excess[-1] < 0.01)
    ([1.5, 0.5], True)
    """

    step_size: float = 0.1
    batch_size: int = 64
    n_iterations: int = 10_000

    def __post_init__(self) -> None:
        """Check the settings of training."""
        _checks.number_in(self.step_size, "step_size", 0.0, np.inf, open_ends=True)
        _checks.positive_integer(self.batch_size, "batch_size")
        _checks.positive_integer(self.n_iterations, "n_iterations")


@checked(shapes={"iteration": "n", "excess": "n", "error": "n"})
@dataclass(frozen=True, eq=False)
class SgdTrace:
    """The course of an optimisation, at a few iterations.

    Attributes
    ----------
    iteration : ndarray of int
        Number of steps made, one entry for each checked iteration.
    excess : ndarray
        The program's value less its optimum, in nats.
    error : ndarray
        The mean absolute difference of g from the optimum's.

    Examples
    --------
    >>> trace = SgdTrace(np.array([1, 10]), np.array([0.1, 0.01]), np.array([0.3, 0.1]))
    >>> float(trace.excess[-1])
    0.01
    """

    iteration: IntArray
    excess: Array
    error: Array


def descend(
    program: dual.Coordinates, lower: float, upper: float, options: Sgd, seed: Seed
) -> tuple[Array, SgdTrace]:
    """Run Algorithm 1 from g = 1; return the last g and the trace.

    The trace has about fifty iterations, evenly spaced in their logarithm. ``program``
    is that of the KL risk; 0 < lower, and upper is finite.
    """
    best = dual.solve_free(program, lower, upper)
    optimum = dual.objective(best, program)
    generator = _checks.generator(seed)
    sums = np.cumsum(program.p), np.cumsum(program.q)
    checks = np.unique(
        np.round(np.geomspace(1, options.n_iterations, 50)).astype(np.int64)
    )
    trace: list[tuple[float, float]] = []
    g = np.full(len(program.p), min(max(1.0, lower), upper))
    for iteration in range(1, options.n_iterations + 1):
        from_p, from_q = (
            _draw_shares(each, options.batch_size, generator) for each in sums
        )
        slope = from_q - from_p / g + program.curvature * (g - program.center)
        g = np.clip(g - options.step_size * slope, lower, upper)
        if iteration == checks[len(trace)]:
            trace.append(
                (dual.objective(g, program) - optimum, float(np.abs(g - best).mean()))
            )
    excess, error = np.array(trace).T
    return g, SgdTrace(checks, excess, error)


def _draw_shares(sums: Array, size: int, generator: np.random.Generator) -> Array:
    """Return the share of each entry in a batch, drawn from cumulated weights."""
    drawn = np.searchsorted(sums, generator.random(size) * sums[-1], side="right")
    return np.bincount(np.minimum(drawn, len(sums) - 1), minlength=len(sums)) / size
