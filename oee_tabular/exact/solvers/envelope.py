"""LU within the envelope of a breadth-first order: rings, chains, queues, layers, whatever the order of their states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from oee_tabular._checks import Array
from oee_tabular.exact.solvers import _envelope
from oee_tabular.exact.solvers.lapack import answer_nan
from oee_tabular.exact.system import Solve, System


@dataclass(frozen=True)
class EnvelopeLU:
    """O(S w^2) for an envelope of w entries a state, without pivoting: an M-matrix needs none.

    Both the order along the rows and the one along the rows and back are tried: the first suits graphs in which all states
    lead back to one, the second layers. A search ends as soon as it is wider than ``WIDEST`` entries a state; up to there this
    is .8 to 6 times as fast as SuperLU (benchmarks/graphs.py). ``is_narrow``: only up to 10 entries a state, or twice those
    of K, where it is 2 to 6 times as fast; between that and ``WIDEST`` lie grids of up
    to 60 x 60, which BiCGSTAB solves in few steps, and random bands.
    """

    is_narrow: bool = False
    name: str = "LU in a band"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """Graphs that a breadth-first search walks through in narrow fronts."""
        if system.envelope is None:
            return False
        n_filled, n_entries = system.envelope[-1][-1], len(system.kernel.indices)
        return not self.is_narrow or bool(n_filled <= max(10 * system.n_states, 2 * n_entries))

    def prepare(self, system: System) -> Solve:
        """Nan where a pivot is not positive: then M is no M-matrix."""
        assert system.envelope is not None
        factors, is_regular = _envelope.factorise(system.kernel, *system.envelope)
        return partial(substitute, factors, system.transpose) if is_regular else answer_nan


def substitute(factors: object, transpose: bool, b: Array, relative: float) -> Array:
    """Forward and back."""
    x: Array = _envelope.solve(factors, transpose, b)
    return x
