"""LU without pivoting: dense, of a small system; or of one communicating set of states after the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from oee_tabular.exact.solvers import _elimination
from oee_tabular.exact.system import Solve, System


@dataclass(frozen=True)
class DenseLU:
    """O(S^3). Of 64 states in a grid or with dense rows 1.3 to 1.5 times as fast as the best of the others, of fewer more."""

    up_to: int = 64
    name: str = "dense LU"
    direct: bool = True

    def suits(self, system: System) -> bool:
        """Small ones."""
        return len(system.kernel.indptr) - 1 <= self.up_to

    def prepare(self, system: System) -> Solve:
        """Nan for a system whose pivots are not all positive: it is no M-matrix."""
        matrix, regular = _elimination.factorised(system.kernel)
        return partial(_elimination.solve_dense, matrix, regular, system.transpose)


@dataclass(frozen=True)
class ComponentLU:
    """Strongly connected components, each by dense LU after those that it leads to.

    One pass over layered models, whatever the order of their states: 2.8 ms for 20 000 states in levels of 4 (measured with
    tests/benchmarks/values.py), 45 by BiCGSTAB. Where every component is one state there is no gain.
    """

    name: str = "LU by components"
    direct: bool = True

    def suits(self, system: System) -> bool:
        """No more than some states reach each other."""
        return len(system.components[1]) > 0

    def prepare(self, system: System) -> Solve:
        """Nan from the first component on that is no M-matrix."""
        return partial(_elimination.solve_components, system.kernel, *system.components, system.transpose)
