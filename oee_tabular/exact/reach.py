"""The states that a policy reaches from the start, which alone decide J.

Elsewhere the infinite sum need not exist: at discount 1 the policy may stay for ever
among states with rewards, and a kernel zeta P may grow. So an infinite sum is solved
for in all states; where that diverges, in the states that the policy reaches on the
support of the model (a superset of those that it reaches with its probabilities, and
the same for every zeta); where that diverges too, in those that it reaches with
probabilities above 0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oee_tabular._sparse import repeat_rows, row_of_entry
from oee_tabular.exact.reweighted import Model
from oee_tabular.exceptions import DivergentKernelError
from oee_tabular.typing import Array, BoolArray

T = TypeVar("T")


def reached_states(
    model: Model,
    policy: Array,
    *,
    on_support: bool = True,
    starts: BoolArray | None = None,
) -> BoolArray:
    """Find the states (S,) that a stationary policy reaches from the start.

    ``on_support`` counts transitions that are stored, also those of probability 0.
    Without ``starts`` (S,) the start is where episodes of the model begin.
    """
    matrix = model.csr
    is_taken = repeat_rows(matrix, policy.reshape(-1) > 0.0)
    if not on_support:
        is_taken &= matrix.data > 0.0
    size = model.n_states
    first = np.flatnonzero(model.initial > 0.0 if starts is None else starts)
    tail = row_of_entry(matrix)[is_taken] // model.n_actions
    # a node of its own leads to every start
    tail = np.append(tail, np.full(len(first), size))
    head = np.append(matrix.indices[is_taken], first)
    graph = sparse.csr_array(
        (np.ones(len(tail)), (tail, head)), shape=(size + 1, size + 1)
    )
    is_reached = np.zeros(size + 1, dtype=np.bool_)
    order = csgraph.breadth_first_order(graph, size, return_predecessors=False)
    is_reached[order] = True
    return is_reached[:size]


def solve_where_reached(
    solve: Callable[[Array], T],
    model: Model,
    policy: Array,
    *,
    only_on_support: bool = False,
    starts: BoolArray | None = None,
) -> tuple[T, BoolArray | None]:
    """Solve with the policy, or where that diverges with what of it is reached.

    ``solve`` takes a policy whose rows are 0 in the states that count as left out. The
    result is the solution and the states (S,) that were reached, None for all. The last
    DivergentKernelError is raised where there is no solution.
    """
    try:
        return solve(policy), None
    except DivergentKernelError as error:
        divergence = error
    for on_support in (True,) if only_on_support else (True, False):
        reached = reached_states(model, policy, on_support=on_support, starts=starts)
        if reached.all():
            continue
        try:
            return solve(np.where(reached[:, None], policy, 0.0)), reached
        except DivergentKernelError as error:
            divergence = error
    raise divergence
