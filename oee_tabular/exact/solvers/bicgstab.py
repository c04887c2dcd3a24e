"""BiCGSTAB: plain where a graph expands, else with a modified incomplete LU, on what an independent set of states leaves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from oee_tabular.exact.solvers import _bicgstab, _graph, _plain_bicgstab, _reduction
from oee_tabular.exact.system import Solve, System

# where a direct solver can follow: grids of up to 60 x 60 take 6 to 16 at .99 and up to 39 at .9999, random bands 60 to 500
FEW_STEPS = 45


@dataclass(frozen=True)
class BiCGStab:
    """For every sparse system: a few dozen sweeps, in memory of a few vectors.

    ``is_reduced`` : whether an independent set of states is eliminated before, exactly, where what is left has at most 2.5
    times as many entries. On grids of 300 x 300 that is 1.9 to 4.5 times as fast for policies that get somewhere
    (a random walk: 1 to 1.7), at 100 x 100 1.2 to 1.9 times.
    ``is_plain`` : without a preconditioner, constants taken out where rows have one sum; for graphs where a few steps lead
    everywhere, of whose inverse an incomplete LU has next to nothing. Random graphs of 10 000 states that value iteration
    leaves (2 next states; blocks that seldom meet) take a third of the time, near discount 1 down to a hundredth. It gives up
    where the residual does not fall to a tenth in 40 steps.
    """

    is_reduced: bool = True
    is_plain: bool = False
    name: str = "BiCGSTAB"
    is_direct: bool = False

    def suits(self, system: System) -> bool:
        """All systems; plain, by a breadth-first search that ends early."""
        return not self.is_plain or bool(_graph.expands(system.kernel))

    def prepare(self, system: System) -> Solve:
        """The reduced system and its factors."""
        kernel, transpose = system.kernel, system.transpose
        if self.is_plain:
            carried = kernel.discount * system.mass
            even = system.largest - system.smallest <= 1e-8 and carried < 1.0 - 1e-9
            return partial(_plain_bicgstab.solve, kernel, carried if even else 0.0, transpose)
        # weight 1 keeps row sums, which counts near discount 1; a little below it the iteration is steadier in a drift
        weight = 1.0 - min(0.1, max(0.001, 0.15 * np.sqrt(1.0 - kernel.discount)))
        steps = FEW_STEPS if system.envelope is not None else _bicgstab.STEPS
        order, place = system.order
        if self.is_reduced:
            mark, inverse, room = _reduction.independent(kernel, order)
            if room <= 2.5 * len(kernel.indices):
                rest, reduction = _reduction.eliminate(kernel, order, mark, inverse, room)
                natural = np.arange(len(reduction.states), dtype=np.uint32)
                factors = _bicgstab.factorise(rest, transpose, weight, natural, natural)
                return partial(_reduction.solve, kernel, reduction, factors, transpose, steps)
        return partial(_bicgstab.solve, _bicgstab.factorise(kernel, transpose, weight, order, place), steps)
