"""The paper's Algorithm 1 on tables: stochastic gradient descent on the KL risk, to see what its training adds to the error.

At each iteration N points are drawn from p and N from q, and

    g <- clip(g - step (count_q / N - count_p / (N g) + ridge term), lower, upper),

one parameter an entry; for a linear class g = Phi w the step is Phi^T of the same, and w is projected onto
{lower <= Phi w <= upper}. Its trace is measured against the exact optimum of the same program.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio import dual, interior
from oee_tabular.ratio._sgd import project
from oee_tabular.ratio.statements import LinearProgram


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


def descend(program: dual.Coordinates, lower: float, upper: float, options: Sgd, seed: Any) -> tuple[Array, SgdTrace]:
    """g after all iterations, from g = 1, and about fifty points of its trace.

    ``program`` is that of ``dual.kl_coordinates``; 0 < lower, upper finite.
    """
    best = dual.solve_free(program, lower, upper)
    optimum = dual.objective(best, program)
    draws = _Draws(program.p, program.q, options.batch_size, seed)
    g = np.full(len(program.p), min(max(1.0, lower), upper))
    trace = _Trace(options.n_iterations)
    for iteration in range(1, options.n_iterations + 1):
        from_p, from_q = draws.next()
        slope = from_q - from_p / g + program.curvature * (g - program.center)
        g = np.clip(g - options.step_size * slope, lower, upper)
        if trace.due(iteration):
            trace.add(dual.objective(g, program) - optimum, np.abs(g - best).mean())
    return g, trace.finished()


def descend_linear(
    program: LinearProgram, best: interior.LinearSolution, options: Sgd, seed: Any
) -> tuple[Array, SgdTrace]:
    """w after all iterations, from the projection of the w whose Phi w is nearest to 1; ``best`` is the exact optimum."""
    phi = np.ascontiguousarray(program.features)
    lengths = (phi**2).sum(axis=1)
    optimum = interior.objective(program, best.weights, best.ratio)
    draws = _Draws(program.p, program.q, options.batch_size, seed)
    w: Array = np.array(np.linalg.lstsq(phi, np.ones(len(phi)))[0], dtype=np.float64)
    project(w, phi, lengths, program.lower, program.upper)
    trace = _Trace(options.n_iterations)
    for iteration in range(1, options.n_iterations + 1):
        from_p, from_q = draws.next()
        g = np.clip(phi @ w, program.lower, program.upper)
        w -= options.step_size * (phi.T @ (from_q - from_p / g) + program.penalty * w)
        project(w, phi, lengths, program.lower, program.upper)
        if trace.due(iteration):
            g = np.clip(phi @ w, program.lower, program.upper)
            trace.add(interior.objective(program, w, g) - optimum, np.abs(g - best.ratio).mean())
    return w, trace.finished()


class _Draws:
    """Shares of the entries in batches drawn from p and from q."""

    def __init__(self, p: Array, q: Array, batch_size: int, seed: Any) -> None:
        self._generator = _checks.generator(seed)
        self._sums = [np.cumsum(weights) for weights in (p, q)]
        self._size, self._n = batch_size, len(p)

    def next(self) -> tuple[Array, Array]:
        drawn = [np.searchsorted(s, self._generator.random(self._size) * s[-1], side="right") for s in self._sums]
        shares = [np.bincount(np.minimum(d, self._n - 1), minlength=self._n) / self._size for d in drawn]
        return shares[0], shares[1]


class _Trace:
    """About fifty points, evenly spaced in the logarithm of the iteration."""

    def __init__(self, n_iterations: int) -> None:
        self._points = np.unique(np.round(np.geomspace(1, n_iterations, 50)).astype(np.int64))
        self._excess: list[float] = []
        self._error: list[float] = []

    def due(self, iteration: int) -> bool:
        return bool(iteration == self._points[len(self._excess)])

    def add(self, excess: float, error: float) -> None:
        self._excess.append(float(excess))
        self._error.append(float(error))

    def finished(self) -> SgdTrace:
        return SgdTrace(self._points, np.array(self._excess), np.array(self._error))
