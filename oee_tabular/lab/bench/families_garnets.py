"""Garnets: random MDPs, of which the simulator gets the probabilities wrong somehow."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import csr_on_pattern, row_of_entry
from oee_tabular.exact import optimal_policy, state_values
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.family import Family, check_seed
from oee_tabular.lab.bench.laws import scale_rows
from oee_tabular.lab.bench.shift import Maker, pair
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy


def garnet(
    about: str,
    change: Callable[..., Any] | None = None,
    n_states: int = 40,
    recorded: float = 0.5,
) -> Maker:
    """Return a maker of Garnets, random MDPs of three actions.

    Each state-action pair leads to five random states with uniform Dirichlet
    probabilities, and r(s, a) is normal.

    Parameters
    ----------
    about : str
        One sentence that says what the simulator has wrong.
    change : callable, optional
        (p, row, z, rng) -> the target's weights of the simulator's transitions, which
        have the probabilities p; row is that of (s, a), z the next state's standardised
        value under the family's policy. None means no change.
    n_states : int, default 40
        Number of states.
    recorded : float, default 0.5
        The share of the policy in what records the target; the rest is uniform.
    """

    def make(rng: np.random.Generator) -> Family:
        """Draw a Garnet and the family of its change."""
        rows = 3 * n_states
        to = np.argsort(rng.random((rows, n_states)), axis=1)[:, :5]
        entries = (
            rng.dirichlet(np.ones(5), rows).ravel(),
            (np.repeat(np.arange(rows), 5), to.ravel()),
        )
        transitions = sparse.csr_array(entries, (rows, n_states))
        rewards = rng.normal(size=(n_states, 3))
        simulator = FiniteMDP(
            transitions, rewards, np.full(n_states, 1 / n_states), 0.95
        )
        target = simulator.transitions
        if change is not None:
            values = state_values(
                simulator,
                mix(optimal_policy(simulator), uniform_policy(simulator), 0.9),
            )
            z = ((values - values.mean()) / values.std())[target.indices]
            weights = change(target.data, row_of_entry(target), z, rng)
            target = scale_rows(csr_on_pattern(target, weights))
        return pair(about, simulator, target, recorded=recorded)

    return make


def make_worse(n_states: int = 40) -> Maker:
    """Return a maker of a Garnet that is a little worse everywhere along V."""
    about = "Each transition is a little worse than simulated, along V."
    return garnet(about, lambda p, row, z, rng: p * np.exp(-0.25 * z), n_states)


@suggest_keywords
def garnet_worse(n_states: int = 40, seed: int = 0) -> Family:
    """Make a Garnet whose target is a little worse everywhere along V.

    It is the family ``garnet_worse`` in any size.

    Parameters
    ----------
    n_states : int, default 40
        Number of states, at least 5.
    seed : int, default 0
        Seed from 0 that chooses the Garnet.

    Returns
    -------
    Family
        The random MDP and a target with probabilities proportional to P exp(-.25 z(V)),
        where z(V) is the standardised value of the next state.

    Raises
    ------
    ValueError
        If there are fewer than 5 states, or the seed is no integer from 0.

    See Also
    --------
    families : The families of the package by name.

    Examples
    --------
    >>> family = garnet_worse(10)
    >>> family.open_rows, family.truth < 20
    (30, True)
    """
    if _checks.positive_integer(n_states, "n_states") < 5:
        raise ArgumentError("n_states", f"must be at least 5; it is {n_states}")
    # a table of probabilities, and its copies
    _checks.require_memory(10.0 * float(n_states) ** 2, "n_states", n_states)
    return make_worse(n_states)(np.random.default_rng([check_seed(seed), n_states]))


GARNETS: dict[str, Maker] = {
    "garnet_dirichlet100": garnet(
        "Every row is a little off, at random.",
        lambda p, row, z, rng: rng.gamma(100.0 * p) + np.finfo(float).tiny,
    ),
    "garnet_dirichlet10": garnet(
        "Every row is far off, at random.",
        lambda p, row, z, rng: rng.gamma(10.0 * p) + np.finfo(float).tiny,
        recorded=0.0,
    ),
    "garnet_replaced": garnet(
        "A twentieth of the rows is wrong.",
        lambda p, row, z, rng: np.where(
            np.isin(row, rng.permutation(120)[:6]), rng.exponential(size=p.size), p
        ),
        recorded=0.9,
    ),
    "garnet_worse": make_worse(),
    "garnet_better": garnet(
        "Each transition is a little better than simulated, along V.",
        lambda p, row, z, rng: p * np.exp(0.25 * z),
        recorded=0.0,
    ),
    "garnet_one_action": garnet(
        "The transitions of one action are worse.",
        lambda p, row, z, rng: p * np.exp(-0.5 * z * (row % 3 == 0)),
    ),
    "garnet_tempered": garnet(
        "Moves are noisier than simulated.", lambda p, row, z, rng: p**0.7, recorded=0.9
    ),
    "garnet_identical": garnet("The simulator of the random MDP is right."),
}
LARGE_GARNETS = {f"garnet_worse{n}": make_worse(n) for n in (10, 20, 80, 160)}
