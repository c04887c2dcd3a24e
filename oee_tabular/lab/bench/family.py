"""Family of environment shift: a simulator and a target that differs from it.

A family also has a policy, and says how the target is recorded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy, policy_value
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy, optional_horizon_length
from oee_tabular.ratio import refuse_unsupported
from oee_tabular.ratio.support import require_pair
from oee_tabular.simulate import sample_episodes
from oee_tabular.typing import Array, Seed

COLUMNS_OF_LOG = 8  # numbers of 8 bytes for each transition of a log


@suggest_keywords
@checked(
    shapes={"policy": "S A", "data_policy": "S A"},
    positive=("horizon", "length"),
)
@dataclass(frozen=True, eq=False)
class Family:
    """Pair of environments in which the true value of a policy is exact.

    The families of the package have at least nine stochastic state-action pairs
    (``open_rows``).

    Parameters
    ----------
    simulator : FiniteMDP
        The model that estimators are given.
    target : FiniteMDP
        The environment that is recorded. It has the simulator's states, actions,
        rewards, initial distribution and discount, and stays in its support.
    policy : ndarray of shape (S, A)
        The policy whose value in the target is asked.
    data_policy : ndarray of shape (S, A)
        The policy that records the target.
    about : str
        One sentence that says what the simulator has wrong.
    horizon : int, optional
        Number of rewards of the value. None means the infinite discounted sum.
    length : int, default 200
        Number of steps after which a recorded episode is cut.

    Raises
    ------
    ValueError
        If a shape, the discount, the initial distribution or a reward differs, or the
        target leaves the simulator's support (the transitions are named).

    See Also
    --------
    families : The families of the package by name.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> family = oee.bench.families()["corridor30"]
    >>> family
    Family(Steps slip more often than simulated. 30 states, 2 actions, 58 stochastic pairs; discount 0.98, infinite horizon)
    >>> round(family.truth, 2), family.open_rows, family.identical
    (-28.68, 58, False)
    >>> log = family.log(100, seed=0)
    >>> len(log), log.behavior_probability is not None
    (100, True)
    """

    simulator: FiniteMDP
    target: FiniteMDP
    policy: Array
    data_policy: Array
    about: str
    horizon: int | None = None
    length: int = 200

    def __post_init__(self) -> None:
        """Check the pair, both policies and the settings."""
        require_pair(self.target, self.simulator)
        refuse_unsupported(self.target.transitions, self.simulator, what="target")
        _require_same(self.target, self.simulator)
        for name in ("policy", "data_policy"):
            object.__setattr__(
                self, name, check_policy(getattr(self, name), self.simulator, name=name)
            )
        if not isinstance(self.about, str) or not self.about.strip():
            raise ArgumentError(
                "about",
                "must be a sentence that says what the simulator has wrong; got"
                f" {_checks.show(self.about)}",
            )
        object.__setattr__(
            self, "horizon", optional_horizon_length(self.horizon, self.simulator)
        )
        object.__setattr__(
            self, "length", _checks.positive_integer(self.length, "length")
        )

    def __repr__(self) -> str:
        """Return what the simulator has wrong, and the sizes of the models."""
        where = self.simulator
        horizon = (
            "infinite horizon" if self.horizon is None else f"{self.horizon} rewards"
        )
        return (
            f"Family({self.about.strip()} {where.n_states} states, {where.n_actions}"
            f" actions, {self.open_rows} stochastic pairs; discount {where.discount:g},"
            f" {horizon})"
        )

    @cached_property
    def truth(self) -> float:
        """Return the exact value of the policy in the target.

        Returns
        -------
        float
            The expected discounted sum of rewards, or of the first ``horizon`` rewards.
        """
        return policy_value(self.target, self.policy, horizon=self.horizon)

    @cached_property
    def open_rows(self) -> int:
        """Return the number of state-action pairs that are stochastic in the simulator.

        Returns
        -------
        int
            How many have more than one next state. The size of a log is told in this
            unit.
        """
        return int((np.diff(self.simulator.transitions.indptr) > 1).sum())

    @cached_property
    def identical(self) -> bool:
        """Return whether the target is the simulator.

        Returns
        -------
        bool
            True if both have the same transition probabilities, to the bit.
        """
        here = self.simulator.transitions
        there = self.target.transitions
        return np.array_equal(here.indices, there.indices) and np.array_equal(
            here.data, there.data
        )

    @cached_property
    def moves_per_state_action(self) -> Array:
        """Return how many transitions from each pair an episode records on average.

        Returns
        -------
        ndarray of shape (S, A)
            The exact expected numbers of transitions; they sum to the mean length of an
            episode.
        """
        running = self.target.with_discount(1.0)
        visits = self.length * occupancy(running, self.data_policy, horizon=self.length)
        # An episode ends on arrival in a terminal state; one that starts there has one
        # step.
        ends = self.target.absorbing()
        visits[ends] = self.target.initial[ends][:, None] * self.data_policy[ends]
        return np.asarray(visits)

    @cached_property
    def data_distribution(self) -> Array:
        """Return the share of each state-action pair among the recorded transitions.

        Returns
        -------
        ndarray of shape (S, A)
            The exact shares; they sum to 1.
        """
        return np.asarray(
            self.moves_per_state_action / self.moves_per_state_action.sum()
        )

    def size(self, per_row: float) -> int:
        """Return the number of transitions of a log of a relative size.

        Parameters
        ----------
        per_row : float
            Number of transitions per stochastic state-action pair.

        Returns
        -------
        int
            The rounded number of transitions, at least 1.

        Raises
        ------
        ValueError
            If it is negative, or the log would have more than 2**53 transitions.
        """
        number = _checks.number_in(per_row, "per_row", 0.0, np.inf)
        size = number * self.open_rows
        if size > 2.0**53:
            raise ArgumentError(
                "per_row",
                f"must be at most {2.0**53 / self.open_rows:g}; it is {number:g}",
            )
        return max(1, round(size))

    def log(self, n: int, seed: Seed) -> Transitions:
        """Record exactly ``n`` transitions of the data policy in the target.

        The log consists of episodes, each cut at ``length`` steps, the last one where
        the log is full.

        Parameters
        ----------
        n : int
            Number of transitions, at least 1.
        seed : int, Generator or other seed
            Anything that ``numpy.random.default_rng`` takes.

        Returns
        -------
        Transitions
            The log, with episodes, time steps and behaviour probabilities.
        """
        size = _checks.positive_integer(n, "n")
        _checks.require_memory(COLUMNS_OF_LOG * size, "n", size)
        generator = _checks.generator(seed)
        episodes = 1 + math.ceil(1.2 * size / self.moves_per_state_action.sum())
        while True:
            whole = sample_episodes(
                self.target, self.data_policy, episodes, self.length, seed=generator
            )
            if len(whole) >= size:
                columns = {
                    name: column[:size]
                    for name, column in whole.columns().items()
                    if name != "truncated"
                }
                return Transitions(**columns)
            episodes *= 2

    def problem(self, n: int, seed: Seed) -> Problem:
        """Return the problem that estimators are given with a new log.

        Parameters
        ----------
        n : int
            Number of transitions, at least 1.
        seed : int, Generator or other seed
            Anything that ``numpy.random.default_rng`` takes.

        Returns
        -------
        Problem
            The simulator with ``log(n, seed)``, the horizon and the data policy.
        """
        return Problem(
            self.simulator,
            self.log(n, seed),
            horizon=self.horizon,
            behavior_policy=self.data_policy,
        )


def _require_same(target: FiniteMDP, simulator: FiniteMDP) -> None:
    """Check that only the dynamics differ; estimators know the rest."""
    if target.discount != simulator.discount:
        raise ArgumentError(
            "target",
            f"must have the simulator's discount, {simulator.discount:g}; it has"
            f" {target.discount:g}",
        )
    if not np.array_equal(target.initial, simulator.initial):
        s = int(np.flatnonzero(target.initial != simulator.initial)[0])
        raise ArgumentError(
            "target",
            f"must have the simulator's initial distribution; initial[{s}] is"
            f" {target.initial[s]:g} there, {simulator.initial[s]:g} in the simulator",
        )
    paid = simulator.with_transitions(target.transitions).rewards
    tolerance = 1e-9 * float(np.abs(paid).max())
    bad = np.argwhere(~(np.abs(paid - target.rewards) <= tolerance))
    if len(bad):
        s, a = (int(i) for i in bad[0])
        raise ArgumentError(
            "target",
            "must pay the simulator's rewards (simulator.with_transitions makes such a"
            f" target); at {simulator.names.pair(s, a)} it pays"
            f" {target.rewards[s, a]:g} on average, with the simulator's rewards"
            f" {paid[s, a]:g} ({len(bad)} such state-action pairs in all)",
        )


def check_seed(seed: Any) -> int:
    """Return a seed that is an integer from 0, or raise ValueError."""
    if not _checks.is_integer(seed) or seed < 0:
        raise ArgumentError(
            "seed", f"must be an integer from 0; got {_checks.show(seed)}"
        )
    return int(seed)
