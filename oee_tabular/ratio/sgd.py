"""The paper's Algorithm 1 on tables: stochastic gradient descent on the KL risk, to see what its training adds to the error.

At each iteration N points are drawn from p and N from q, and

    g <- clip(g - step (count_q / N - count_p / (N g) + ridge term), lower, upper),

one parameter an entry. Its trace is measured against the exact optimum of the same program.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio import dual


@dataclass(frozen=True)
class SgdOptions:
    """step_size > 0, batch_size N, n_iterations, and the seed of the draws."""

    step_size: float = 0.1
    batch_size: int = 64
    n_iterations: int = 10_000
    seed: Any = None

    def __post_init__(self) -> None:
        _checks.number_in(self.step_size, "step_size", 0.0, np.inf, open_ends=True)
        _checks.positive_integer(self.batch_size, "batch_size")
        _checks.positive_integer(self.n_iterations, "n_iterations")


@dataclass(frozen=True, eq=False)
class SgdTrace:
    """After ``iteration`` steps: ``excess``, the program's value less its optimum, and ``error``, the mean |g - g*|."""

    iteration: IntArray
    excess: Array
    error: Array


def descend(program: dual.Coordinates, lower: float, upper: float, options: SgdOptions) -> tuple[Array, SgdTrace]:
    """g after all iterations, from g = 1, and about fifty points of its trace.

    ``program`` is that of ``dual.kl_coordinates``; 0 < lower, upper finite.
    """
    generator = _checks.generator(options.seed)
    best = dual.solve_free(program, lower, upper)
    optimum = dual.objective(best, program)
    sums = [np.cumsum(weights) for weights in (program.p, program.q)]
    n, size = len(program.p), options.batch_size
    g = np.full(n, min(max(1.0, lower), upper))
    points = np.unique(np.round(np.geomspace(1, options.n_iterations, 50)).astype(np.int64))
    excess: list[float] = []
    error: list[float] = []
    for iteration in range(1, options.n_iterations + 1):
        drawn = [np.searchsorted(s, generator.random(size) * s[-1], side="right") for s in sums]
        from_p, from_q = (np.bincount(np.minimum(d, n - 1), minlength=n) / size for d in drawn)
        slope = from_q - from_p / g + program.curvature * (g - program.center)
        g = np.clip(g - options.step_size * slope, lower, upper)
        if iteration == points[len(excess)]:
            excess.append(dual.objective(g, program) - optimum)
            error.append(float(np.abs(g - best).mean()))
    return g, SgdTrace(points, np.array(excess), np.array(error))
