"""A family of environment shift: a simulator, a target that differs from it, a policy, and how the target is recorded.

Below it what families are made of: models from lists of moves, policies, changes of rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy import sparse, stats

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._sparse import row_of_entry, row_sums
from oee_tabular.data import Transitions
from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy, optimal_policy, policy_value
from oee_tabular.mdp import FiniteMDP, check_policy, mix, uniform_policy
from oee_tabular.mdp.horizons import optional_horizon_length
from oee_tabular.ratio import refuse_unsupported
from oee_tabular.ratio.support import require_pair
from oee_tabular.simulate import sample_episodes


@dataclass(frozen=True, eq=False)
class Family:
    """A pair of environments whose truth is exact.

    Parameters
    ----------
    simulator, target : FiniteMDP
        Of the same states, actions, rewards, initial distribution and discount; the target stays in the simulator's support.
    policy : (S, A), whose value in the target is asked
    data_policy : (S, A), which records the target
    about : one sentence: what the simulator has wrong
    horizon : number of rewards of the value; None: the infinite discounted sum
    length : steps after which a recorded episode is cut

    Raises
    ------
    ValueError
        Another shape; another discount, initial distribution or reward; a target that leaves the simulator's support (the
        moves are named).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> family = oee.bench.families()["corridor30"]
    >>> family
    Family(Steps slip more often than simulated. 30 states, 2 actions, 58 open rows; discount 0.98, infinite horizon)
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
        require_pair(self.target, self.simulator)
        refuse_unsupported(self.target.transitions, self.simulator, what="target")
        _require_same(self.target, self.simulator)
        for name in ("policy", "data_policy"):
            object.__setattr__(self, name, check_policy(getattr(self, name), self.simulator, name=name))
        if not isinstance(self.about, str) or not self.about.strip():
            raise ValueError(
                f"about must be a sentence that says what the simulator has wrong; got {_checks.show(self.about)}"
            )
        object.__setattr__(self, "horizon", optional_horizon_length(self.horizon, self.simulator))
        object.__setattr__(self, "length", _checks.positive_integer(self.length, "length"))

    def __repr__(self) -> str:
        where = self.simulator
        horizon = "infinite horizon" if self.horizon is None else f"{self.horizon} rewards"
        return (
            f"Family({self.about.strip()} {where.n_states} states, {where.n_actions} actions, {self.open_rows} open rows; "
            f"discount {where.discount:g}, {horizon})"
        )

    @cached_property
    def truth(self) -> float:
        """J of the policy in the target, exactly."""
        return policy_value(self.target, self.policy, horizon=self.horizon)

    @cached_property
    def open_rows(self) -> int:
        """How many (s, a) have more than one next state in the simulator: the unit of a log's size."""
        return int((np.diff(self.simulator.transitions.indptr) > 1).sum())

    @cached_property
    def identical(self) -> bool:
        """Whether the target is the simulator."""
        here, there = self.simulator.transitions, self.target.transitions
        return np.array_equal(here.indices, there.indices) and np.array_equal(here.data, there.data)

    @cached_property
    def moves_per_state_action(self) -> Array:
        """(S, A): how many moves from (s, a) an episode records on average, exactly."""
        running = self.target.with_discount(1.0)
        visits = self.length * occupancy(running, self.data_policy, horizon=self.length)
        over = self.target.absorbing()  # an episode ends on arrival; one that starts there has one step
        visits[over] = self.target.initial[over][:, None] * self.data_policy[over]
        return np.asarray(visits)

    @cached_property
    def data_distribution(self) -> Array:
        """(S, A): the share of each (s, a) among the moves that the episodes record, exactly."""
        return np.asarray(self.moves_per_state_action / self.moves_per_state_action.sum())

    def size(self, per_row: float) -> int:
        """The number of moves of a log with ``per_row`` moves per open row, at least 1."""
        return max(1, round(_checks.number_in(per_row, "per_row", 0.0, np.inf) * self.open_rows))

    def log(self, n: int, seed: Seed) -> Transitions:
        """Exactly ``n`` moves of the data policy in the target: episodes, each cut at ``length``, the last where n is full.

        Parameters
        ----------
        n : positive int
        seed : anything that ``numpy.random.default_rng`` takes
        """
        size = _checks.positive_integer(n, "n")
        generator = _checks.generator(seed)
        episodes = 1 + math.ceil(1.2 * size / self.moves_per_state_action.sum())
        while True:
            whole = sample_episodes(self.target, self.data_policy, episodes, self.length, seed=generator)
            if len(whole) >= size:
                columns = {name: column for name, column in whole.columns().items() if name != "truncated"}
                return Transitions(**{name: column[:size] for name, column in columns.items()})
            episodes *= 2

    def problem(self, n: int, seed: Seed) -> Problem:
        """The problem of ``log(n, seed)``."""
        return Problem(self.simulator, self.log(n, seed), horizon=self.horizon, behavior_policy=self.data_policy)


def _require_same(target: FiniteMDP, simulator: FiniteMDP) -> None:
    """Nothing but the dynamics differs: the rest is known to whoever estimates."""
    if target.discount != simulator.discount:
        raise ValueError(
            f"target must have the simulator's discount, {simulator.discount:g}; it has {target.discount:g}"
        )
    if not np.array_equal(target.initial, simulator.initial):
        s = int(np.flatnonzero(target.initial != simulator.initial)[0])
        raise ValueError(
            f"target must have the simulator's initial distribution; initial[{s}] is {target.initial[s]:g} there, "
            f"{simulator.initial[s]:g} in the simulator"
        )
    paid = simulator.with_transitions(target.transitions).rewards
    bad = np.argwhere(~(np.abs(paid - target.rewards) <= 1e-9 * max(1.0, float(np.abs(paid).max()))))
    if len(bad):
        s, a = (int(i) for i in bad[0])
        raise ValueError(
            f"target must pay the simulator's rewards (simulator.with_transitions makes such a target); at "
            f"{simulator.names.pair(s, a)} it pays {target.rewards[s, a]:g} on average, with the simulator's rewards "
            f"{paid[s, a]:g} ({len(bad)} such state-action pairs in all)"
        )


Moves = Iterable[tuple[Any, Any]]  # (probability, next state)
Recorded = Literal["uniform", "half", "policy"]
RECORDED_BY: dict[str, float] = {"uniform": 0.0, "half": 0.5, "policy": 0.9}  # the policy's share; the rest is uniform


def pair(
    simulator: FiniteMDP,
    target: FiniteMDP | object,
    about: str,
    *,
    optimal: float = 0.9,
    recorded: Recorded | float = "half",
    length: int = 200,
    policy: Array | None = None,
    horizon: int | None = None,
) -> Family:
    """A family whose policy is the simulator's optimum, ``optimal`` of it, the rest uniform; ``recorded`` by a share of it.

    Parameters
    ----------
    simulator : FiniteMDP
    target : FiniteMDP, or its transitions (then with the simulator's rewards)
    about, length, policy, horizon : as in ``Family``; a policy is used instead of the optimum
    optimal : the share of the optimum in the policy
    recorded : "uniform", "half" of the policy, "policy" (90% of it), or another share of it; the rest uniform
    """
    if not isinstance(target, FiniteMDP):
        target = simulator.with_transitions(target)
    uniform = uniform_policy(simulator)
    pi = mix(optimal_policy(simulator), uniform, optimal) if policy is None else policy
    share = RECORDED_BY[recorded] if isinstance(recorded, str) else recorded
    return Family(simulator, target, pi, mix(pi, uniform, share), about, horizon=horizon, length=horizon or length)


def shifted(
    moves: Callable[..., Moves],
    shape: tuple[int, int],
    pay: object,
    discount: float,
    believed: Sequence[Any],
    real: Sequence[Any],
    about: str,
    *,
    start: object = None,
    **options: Any,
) -> Family:
    """A family of two models of the same ``moves``, with the parameters that the simulator believes and with the real ones.

    Parameters
    ----------
    moves, shape, pay, discount, start : as in ``model``; about, options : as in ``pair``
    """
    simulator, target = (model(moves, shape, pay, discount, how, start=start) for how in (believed, real))
    return pair(simulator, target, about, **options)


def shift(*arguments: Any, **options: Any) -> Callable[[Callable[..., Moves]], Callable[[], Family]]:
    """Make of a function of moves what makes its family; the arguments are the further ones of ``shifted``."""

    def decorate(moves: Callable[..., Moves]) -> Callable[[], Family]:
        return lambda: shifted(moves, *arguments, **options)

    return decorate


def model(
    moves: Callable[..., Moves],
    shape: tuple[int, int],
    pay: object,
    discount: float,
    how: Sequence[Any],
    *,
    start: object,
) -> FiniteMDP:
    """The MDP of moves with the parameters ``how``.

    Parameters
    ----------
    moves : (s, a, *how) -> (probability, next state), one after the other; equal next states are added up; none: terminal
    shape : (S, A)
    pay : rewards as of ``FiniteMDP``, or a function of the arrays s, a, s'
    start : states in which episodes begin, evenly; None: all
    """
    n_states, n_actions = shape
    entries = [
        (s * n_actions + a, to, probability)
        for s in range(n_states)
        for a in range(n_actions)
        for probability, to in list(moves(s, a, *how)) or [(1.0, s)]
        if probability > 0
    ]
    rows, columns, data = (np.array(column) for column in zip(*entries, strict=True))
    matrix = sparse.csr_array((data, (rows, columns)), shape=(n_states * n_actions, n_states))
    matrix.sum_duplicates()
    transitions = scaled(matrix)
    rewards = paid_on(transitions, pay, n_actions) if callable(pay) else pay
    return FiniteMDP(transitions, rewards, spread(n_states, range(n_states) if start is None else start), discount)


def paid_on(transitions: sparse.csr_array, paid: Callable[[Any, Any, Any], Any], n_actions: int) -> sparse.csr_array:
    """r(s, a, s') on the moves of ``transitions``; ``paid`` takes and gives arrays."""
    state, action = np.divmod(row_of_entry(transitions), n_actions)
    rewards = np.asarray(paid(state, action, transitions.indices.astype(np.int64)), dtype=np.float64)
    return sparse.csr_array((rewards, transitions.indices, transitions.indptr), transitions.shape)


def scaled(matrix: sparse.csr_array) -> sparse.csr_array:
    """Rows that sum to 1."""
    return sparse.csr_array(
        (matrix.data / row_sums(matrix)[row_of_entry(matrix)], matrix.indices, matrix.indptr), matrix.shape
    )


def poisson(mean: float, largest: int) -> Array:
    """Pr(N = 0), ..., Pr(N = largest), the last one Pr(N >= largest)."""
    found = np.empty(largest + 1)
    found[:largest] = stats.poisson.pmf(np.arange(largest), mean)
    found[largest] = stats.poisson.sf(largest - 1, mean)
    return found


def binomial(n: int, probability: float) -> Array:
    """Pr(N = 0), ..., Pr(N = n)."""
    return np.array([math.comb(n, k) * probability**k * (1.0 - probability) ** (n - k) for k in range(n + 1)])


def spread(n_states: int, states: Any) -> Array:
    """The uniform distribution over these states, (S,)."""
    found = np.zeros(n_states)
    found[states] = 1.0
    return np.asarray(found / found.sum())
