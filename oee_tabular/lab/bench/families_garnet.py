"""Garnets: random MDPs, of which the simulator gets the probabilities wrong in several ways."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import row_of_entry
from oee_tabular.exact import optimal_policy, state_values
from oee_tabular.lab.bench.family import Family, Recorded, pair, scaled, spread
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy

ACTIONS, SUCCESSORS = 3, 5
Change = Callable[[FiniteMDP, np.random.Generator], Array]  # new weights of the simulator's moves, row by row


def garnet(generator: np.random.Generator, n_states: int = 40) -> FiniteMDP:
    """Each (s, a) leads to five random states with uniform Dirichlet probabilities; r(s, a) is normal."""
    rows = n_states * ACTIONS
    to = np.argsort(generator.random((rows, n_states)), axis=1)[:, :SUCCESSORS]
    data = generator.dirichlet(np.ones(SUCCESSORS), rows)
    index = np.repeat(np.arange(rows), SUCCESSORS)
    transitions = sparse.csr_array((data.reshape(-1), (index, to.reshape(-1))), shape=(rows, n_states))
    rewards = generator.normal(size=(n_states, ACTIONS))
    return FiniteMDP(transitions, rewards, spread(n_states, range(n_states)), 0.95)


def changed(
    change: Change, about: str, *, n_states: int = 40, recorded: Recorded = "half"
) -> Callable[[np.random.Generator], Family]:
    """What makes the family of a Garnet and its ``change``."""

    def make(generator: np.random.Generator) -> Family:
        simulator = garnet(generator, n_states)
        matrix = simulator.transitions
        weights = sparse.csr_array((change(simulator, generator), matrix.indices, matrix.indptr), matrix.shape)
        return pair(simulator, scaled(weights), about, recorded=recorded)

    return make


def dirichlet(strength: float) -> Change:
    """Every row is drawn anew from Dirichlet(strength * row)."""
    return lambda simulator, generator: generator.gamma(strength * simulator.transitions.data) + np.finfo(float).tiny


def replaced(simulator: FiniteMDP, generator: np.random.Generator) -> Array:
    """A twentieth of the rows is drawn anew from the uniform Dirichlet distribution."""
    matrix = simulator.transitions
    rows = generator.permutation(matrix.shape[0])[: matrix.shape[0] // 20]
    new = generator.exponential(size=matrix.nnz)
    return np.asarray(np.where(np.isin(row_of_entry(matrix), rows), new, matrix.data))


def along(exponent: float, *, action: int | None = None) -> Change:
    """P exp(exponent z(V)), V of the family's policy, standardised, in the rows of all actions or of one."""

    def change(simulator: FiniteMDP, _: np.random.Generator) -> Array:
        matrix = simulator.transitions
        mine = action is None or row_of_entry(matrix) % ACTIONS == action
        values = state_values(simulator, mix(optimal_policy(simulator), uniform_policy(simulator), 0.9))
        z = ((values - values.mean()) / values.std())[matrix.indices]
        return np.asarray(matrix.data * np.exp(exponent * z * mine))

    return change


def tempered(simulator: FiniteMDP, _: np.random.Generator) -> Array:
    """P^.7."""
    return np.asarray(simulator.transitions.data**0.7)


def identical(generator: np.random.Generator) -> Family:
    """No change."""
    simulator = garnet(generator)
    return pair(simulator, simulator.transitions, "The simulator of the random MDP is right.")


def worse(n_states: int) -> Callable[[np.random.Generator], Family]:
    """What makes a Garnet of that size, a little worse everywhere along V."""
    return changed(along(-0.25), "Every move is a little worse than simulated, along V.", n_states=n_states)


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
