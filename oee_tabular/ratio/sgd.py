"""The paper's Algorithm 1 on tables: stochastic gradient descent on the KL risk, to see what its training adds to the error.

At each iteration N points are drawn from p and N from q, and

    g <- clip(g - step (count_q / N - count_p / (N g) + ridge term), lower, upper),

one parameter an entry. Its trace is measured against the exact optimum of the same program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, Seed
from oee_tabular.ratio import dual


@dataclass(frozen=True)
class Sgd:
    """Algorithm 1's settings, on tables.

    Parameters
    ----------
    step_size : eta > 0
    batch_size : N, draws from each side at an iteration
    n_iterations : all of them are done

    Examples
    --------
    >>> from oee_tabular.ratio import Sgd, density_ratio
    >>> fit = density_ratio([3, 1], [2, 2], lower=0.1, upper=9.0, normalized=False, solver=Sgd(0.01), seed=0)
    >>> fit.ratio.round(1).tolist(), bool(fit.trace.excess[-1] < 0.01)
    ([1.5, 0.5], True)
    """

    step_size: float = 0.1
    batch_size: int = 64
    n_iterations: int = 10_000

    def __post_init__(self) -> None:
        _checks.number_in(self.step_size, "step_size", 0.0, np.inf, open_ends=True)
        _checks.positive_integer(self.batch_size, "batch_size")
        _checks.positive_integer(self.n_iterations, "n_iterations")


@dataclass(frozen=True, eq=False)
class SgdTrace:
    """The way to the optimum, at a few iterations.

    Attributes
    ----------
    iteration : how many steps had been made
    excess : the program's value less its optimum (nats)
    error : the mean |g - g*|

    Examples
    --------
    >>> trace = SgdTrace(np.array([1, 10]), np.array([0.1, 0.01]), np.array([0.3, 0.1]))
    >>> float(trace.excess[-1])
    0.01
    """

    iteration: IntArray
    excess: Array
    error: Array


def descend(program: dual.Coordinates, lower: float, upper: float, options: Sgd, seed: Seed) -> tuple[Array, SgdTrace]:
    """g after all iterations, from g = 1, and about fifty points of its trace.

    ``program`` is that of ``dual.kl_coordinates``; 0 < lower, upper finite.
    """
    best = dual.solve_free(program, lower, upper)
    optimum = dual.objective(best, program)

    def step(g: Array, from_p: Array, from_q: Array) -> Array:
        slope = from_q - from_p / g + program.curvature * (g - program.center)
        return np.clip(g - options.step_size * slope, lower, upper)

    def measure(g: Array) -> tuple[float, float]:
        return dual.objective(g, program) - optimum, float(np.abs(g - best).mean())

    start = np.full(len(program.p), min(max(1.0, lower), upper))
    return _trained(start, step, measure, _Draws(program.p, program.q, options.batch_size, seed), options.n_iterations)


def _trained(
    parameters: Array,
    step: Callable[..., Array],
    measure: Callable[[Array], tuple[float, float]],
    draws: _Draws,
    n: int,
) -> tuple[Array, SgdTrace]:
    """The parameters after n steps, and (excess, error) at about fifty of them, even in the logarithm of the iteration."""
    points = np.unique(np.round(np.geomspace(1, n, 50)).astype(np.int64))
    seen: list[tuple[float, float]] = []
    for iteration in range(1, n + 1):
        parameters = step(parameters, *draws.next())
        if iteration == points[len(seen)]:
            seen.append(measure(parameters))
    excess, error = np.array(seen).T
    return parameters, SgdTrace(points, excess, error)


class _Draws:
    """Shares of the entries in batches drawn from p and from q."""

    def __init__(self, p: Array, q: Array, batch_size: int, seed: Seed) -> None:
        self._generator = _checks.generator(seed)
        self._sums = [np.cumsum(weights) for weights in (p, q)]
        self._size, self._n = batch_size, len(p)

    def next(self) -> tuple[Array, Array]:
        drawn = [np.searchsorted(s, self._generator.random(self._size) * s[-1], side="right") for s in self._sums]
        shares = [np.bincount(np.minimum(d, self._n - 1), minlength=self._n) / self._size for d in drawn]
        return shares[0], shares[1]
