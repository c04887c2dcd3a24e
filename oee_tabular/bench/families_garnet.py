"""Garnets: random MDPs, of which the simulator gets the probabilities wrong in several ways."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import row_of_entry
from oee_tabular.bench.family import Family
from oee_tabular.bench.making import Recorded, along_value, pair, scaled, spread, tilted
from oee_tabular.mdp import FiniteMDP

ACTIONS, SUCCESSORS = 3, 5
Change = Callable[[FiniteMDP, np.random.Generator], sparse.csr_array]


def garnet(generator: np.random.Generator, n_states: int = 40) -> FiniteMDP:
    """Each (s, a) leads to five random states with uniform Dirichlet probabilities; r(s, a) is normal."""
    rows = n_states * ACTIONS
    to = np.argsort(generator.random((rows, n_states)), axis=1)[:, :SUCCESSORS]
    data = generator.dirichlet(np.ones(SUCCESSORS), rows)
    index = np.repeat(np.arange(rows), SUCCESSORS)
    transitions = sparse.csr_array((data.reshape(-1), (index, to.reshape(-1))), shape=(rows, n_states))
    rewards = generator.normal(size=(n_states, ACTIONS))
    return FiniteMDP(transitions, rewards, spread(n_states, range(n_states)), 0.95)


def changed(change: Change, about: str, *, recorded: Recorded = "half") -> Callable[[np.random.Generator], Family]:
    """What makes the family of a Garnet of 40 states and its ``change``."""

    def make(generator: np.random.Generator) -> Family:
        simulator = garnet(generator)
        return pair(simulator, change(simulator, generator), about, recorded=recorded)

    return make


def with_data(simulator: FiniteMDP, data: Array) -> sparse.csr_array:
    """The simulator's support with other probabilities, scaled."""
    matrix = simulator.transitions
    return scaled(sparse.csr_array((data, matrix.indices, matrix.indptr), matrix.shape))


def dirichlet(strength: float) -> Change:
    """Every row is drawn anew from Dirichlet(strength * row)."""
    return lambda simulator, generator: with_data(
        simulator, generator.gamma(strength * simulator.transitions.data) + np.finfo(float).tiny
    )


def replaced(simulator: FiniteMDP, generator: np.random.Generator) -> sparse.csr_array:
    """A twentieth of the rows is drawn anew from the uniform Dirichlet distribution."""
    matrix = simulator.transitions
    rows = generator.permutation(matrix.shape[0])[: matrix.shape[0] // 20]
    new = generator.exponential(size=matrix.nnz)
    return with_data(simulator, np.where(np.isin(row_of_entry(matrix), rows), new, matrix.data))


def along(exponent: float, *, action: int | None = None) -> Change:
    """P exp(exponent z(V)), in the rows of all actions or of one."""

    def change(simulator: FiniteMDP, _: np.random.Generator) -> sparse.csr_array:
        mine = action is None or row_of_entry(simulator.transitions) % ACTIONS == action
        return tilted(simulator, exponent * along_value(simulator) * mine)

    return change


def tempered(simulator: FiniteMDP, _: np.random.Generator) -> sparse.csr_array:
    """P^.7, scaled."""
    return with_data(simulator, simulator.transitions.data**0.7)


def same(simulator: FiniteMDP, _: np.random.Generator) -> sparse.csr_array:
    """No change."""
    return simulator.transitions


def worse(n_states: int) -> Callable[[np.random.Generator], Family]:
    """What makes a Garnet of that size, a little worse everywhere along V."""

    def make(generator: np.random.Generator) -> Family:
        simulator = garnet(generator, n_states)
        about = "Every move is a little worse than simulated, along V."
        return pair(simulator, along(-0.25)(simulator, generator), about)

    return make


def garnet_worse(n_states: int = 40, seed: int = 0) -> Family:
    """A Garnet that is a little worse everywhere along V: P exp(-.25 z(V)), as ``garnet_worse``, of any size.

    Parameters
    ----------
    n_states : int of at least 5
    seed : int from 0; the Garnet is another one for each

    Examples
    --------
    >>> family = garnet_worse(10)
    >>> family.open_rows, family.truth < 20
    (30, True)
    """
    if _checks.positive_integer(n_states, "n_states") < SUCCESSORS:
        raise ValueError(f"n_states must be at least {SUCCESSORS}; it is {n_states}")
    return worse(n_states)(np.random.default_rng([seed, n_states]))
