"""Rust's bus engines (1987): one group of real buses simulates another.

The state is a bus's mileage since its last replacement in bins of 5000 miles, numbered
0 to 89. Each month its engine is kept (action 0) or replaced (action 1). The mileage
then grows by 0, 1 or 2 bins, from where it is or, after a replacement, from 0:

    P(s + k | s, keep) = P(k | s, replace) = theta_k,    k = 0, 1, 2,

where bin 89 takes what is beyond it, and theta_k is the share of the recorded months
of a group of buses. Groups 3 and 4 have theta = (.313, .678, .009) and (.398, .589,
.013). Rewards are minus the month's cost: .002293 for each bin of a kept engine, which
is Rust's estimate for group 4, and 2.55 for a replacement, about a quarter of his. At
that cost it pays to replace within the bins that were recorded.

Wear, months and replacements are real; the costs are a choice. Two things in the months
are not as in the model. Old buses are driven less: those of group 4 stay in their bin
in 30% of the months in bins 20 to 39, and in 59% from bin 60 on. And of 60 recorded
replacements 59 are followed by a month in bin 0. So all recorded months, each pair
counted by itself, give the policy -7.42, and the model of group 4 gives it -7.19.

``bus_engines.csv`` has the counts with their source and licence.

Reference: J. Rust, Optimal replacement of GMC bus engines: an empirical model of Harold
Zurcher, Econometrica 55 (1987), 999-1033.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, deterministic_policy
from oee_tabular.simulate import sample_transitions
from oee_tabular.typing import Array, IntArray, Seed

N_BINS = 90
N_GROUPS = 4
N_INCREMENTS = 3  # of 0, 1 and 2 bins in a month; no bus has more
KEEP, REPLACE = 0, 1
ACTION_NAMES = ("keep", "replace")
OPERATING_COST_PER_BIN = 0.002293  # a month; Rust's Table IX, group 4
REPLACEMENT_COST = 2.55
REPLACED_FROM_BIN = 60  # by the policy of the task
N_BYTES_PER_MONTH = 64.0  # memory while a log is sampled: eight numbers a transition


@checked(shapes={"policy": "S A", "data_policy": "S A", "tie": "E"})
@dataclass(frozen=True, eq=False)
class BusEngines:
    """Hold two groups of Rust's buses as a simulator and its target, with a log.

    Attributes
    ----------
    simulator : FiniteMDP
        The buses with the wear of the simulator's group.
    target : FiniteMDP
        The buses with the wear of the target's group.
    policy : ndarray of shape (S, A)
        The policy in question: it replaces the engine from bin 60 on.
    log : Transitions
        Months of the target's group.
    data_policy : ndarray of shape (S, A)
        How often engines were replaced in the target's group, by bin. One month with
        the group's overall share is added to each bin.
    tie : ndarray of int of shape (E,)
        For each entry of ``simulator.transitions.data`` the number of bins that the
        mileage grows by: the key that ``tie=`` takes where the wear is the same
        everywhere. Entries that lead to the last bin, which takes all beyond it, have
        keys of their own.

    See Also
    --------
    bus_engines : Makes this.

    Examples
    --------
    >>> buses = bus_engines()
    >>> buses.policy.argmax(axis=1).sum(), sorted(set(buses.tie.tolist()))
    (np.int64(30), [0, 1, 2, 3, 4])
    """

    simulator: FiniteMDP
    target: FiniteMDP
    policy: Array
    log: Transitions
    data_policy: Array
    tie: IntArray


@suggest_keywords
def bus_engines(
    n_months: int | None = None,
    *,
    seed: Seed | None = None,
    source: Literal["recorded", "target"] = "recorded",
    simulator_group: int = 3,
    target_group: int = 4,
    discount: float = 0.99,
) -> BusEngines:
    """Make Rust's bus engines: one group's wear as simulator, another's as target.

    Parameters
    ----------
    n_months : int, optional
        Number of months in the log. None means all recorded months of the target's
        group, in the order of their bins.
    seed : int, Generator or other seed, optional
        Anything that ``numpy.random.default_rng`` takes. It must be given with
        ``n_months``.
    source : {'recorded', 'target'}, default 'recorded'
        Where ``n_months`` months come from: they are recorded ones, drawn without
        replacement; or they are sampled from the target, whose state-action pairs are
        drawn as often as they were recorded.
    simulator_group : int, default 3
        The group of buses, 1 to 4, whose wear the simulator has.
    target_group : int, default 4
        The group of buses, 1 to 4, whose wear the target has and whose months are the
        log.
    discount : float, default 0.99
        The discount of a month, in [0, 1].

    Returns
    -------
    BusEngines
        Simulator, target, policy and log.

    Raises
    ------
    ValueError
        If an argument is bad, if there are fewer recorded months, or if months are to
        be drawn without a seed.

    See Also
    --------
    gridworld : The paper's task.

    Notes
    -----
    Groups 1 to 4 have 360, 192, 3312 and 4292 months. Engines were replaced in groups 3
    and 4 alone (27 and 33 times).

    References
    ----------
    .. [1] J. Rust, Optimal replacement of GMC bus engines: an empirical model of Harold
       Zurcher, Econometrica 55 (1987), 999-1033.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> buses = oee.tasks.bus_engines(300, seed=0)
    >>> for mdp in (buses.simulator, buses.target):
    ...     print(round(oee.policy_value(mdp, buses.policy), 2))
    -7.64
    -7.19
    >>> len(buses.log), len(oee.tasks.bus_engines().log)
    (300, 4292)
    """
    _checks.one_of(source, "source", ("recorded", "target"))
    generator = None if seed is None else _checks.generator(seed)
    simulator = bus_model(_group(simulator_group, "simulator_group"), discount=discount)
    group = _group(target_group, "target_group")
    target = bus_model(group, discount=discount)
    return BusEngines(
        simulator,
        target,
        replacement_policy(),
        _log_of(group, target, n_months, generator, source),
        _recorded_policy(group),
        _increments_of_entries(simulator),
    )


def bus_model(group: int = 3, *, discount: float = 0.99) -> FiniteMDP:
    """Make the model of a group's buses from the increments of its recorded months."""
    shares = count_increments(_group(group, "group"))
    shares = shares / shares.sum()
    rate = _checks.number_in(discount, "discount", 0.0, 1.0)
    start = np.arange(N_BINS)[:, None] * [1, 0]  # (S, A): 0 after a replacement
    following = np.minimum(start[:, :, None] + np.arange(N_INCREMENTS), N_BINS - 1)
    weights = np.broadcast_to(shares, following.shape)
    pairs = np.repeat(np.arange(2 * N_BINS), N_INCREMENTS)
    # what leads to the same bin is added up
    transitions = sparse.coo_array(
        (weights.ravel(), (pairs, following.ravel())), shape=(2 * N_BINS, N_BINS)
    ).tocsr()
    costs = np.full((N_BINS, 2), REPLACEMENT_COST)
    costs[:, KEEP] = OPERATING_COST_PER_BIN * np.arange(N_BINS)
    initial = np.eye(1, N_BINS)[0]
    # a cost of 0 is a reward of 0, not of -0.0
    rewards = 0.0 - costs
    return FiniteMDP(
        transitions, rewards, initial, rate, action_names=list(ACTION_NAMES)
    )


def replacement_policy() -> Array:
    """Make the policy that replaces the engine from bin 60 on."""
    is_replaced = np.arange(N_BINS) >= REPLACED_FROM_BIN
    return deterministic_policy(np.where(is_replaced, REPLACE, KEEP), 2)


def count_increments(group: int) -> IntArray:
    """Count a group's months in which the mileage grew by 0, 1 and 2 bins."""
    bins, replaced, following, months = _months_of(group)
    increments = following - np.where(replaced == REPLACE, 0, bins)
    counts = np.zeros(N_INCREMENTS, dtype=np.int64)
    np.add.at(counts, increments, months)
    return counts


@functools.cache
def _counted_months() -> IntArray:
    """Read the shipped counts: group, bin, replaced, next bin and months of a row."""
    text = Path(__file__).with_name("bus_engines.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = [line.split(",") for line in lines[1:]]
    return np.array(rows, dtype=np.int64)


def _months_of(group: int) -> IntArray:
    """Return bin, replaced, next bin and months of a group, an array (4, rows)."""
    rows = _counted_months()
    return np.asarray(rows[rows[:, 0] == group, 1:].T)


def _group(value: int, name: str) -> int:
    """Check the number of a group of buses."""
    number = _checks.positive_integer(value, name)
    if number > N_GROUPS:
        raise ArgumentError(
            name, f"must be one of the groups 1 to {N_GROUPS}; it is {number}"
        )
    return number


def _pair_months(group: int) -> Array:
    """Return how many months of a group began with each pair, (S, A)."""
    bins, replaced, _, months = _months_of(group)
    counts = np.zeros((N_BINS, 2))
    np.add.at(counts, (bins, replaced), months)
    return counts


def _log_of(
    group: int,
    target: FiniteMDP,
    n_months: int | None,
    generator: np.random.Generator | None,
    source: str,
) -> Transitions:
    """Return recorded months, all or some of them, or sampled ones."""
    bins, replaced, following, months = _months_of(group)
    n_recorded = int(months.sum())
    if n_months is None:
        if source == "target":
            raise ArgumentError(
                "n_months",
                "must be given where months are sampled from the target; it is None"
                " (source='recorded' has all recorded months)",
            )
        number = n_recorded
    else:
        number = _checks.positive_integer(n_months, "n_months")
        _checks.require_memory(N_BYTES_PER_MONTH * number, "n_months", number)
        if generator is None:
            raise ArgumentError(
                "seed",
                f"must be given where {number} months are drawn; it is None (seed=0)",
            )
    if source == "target":
        counts = _pair_months(group)
        return sample_transitions(target, counts / counts.sum(), number, seed=generator)
    if number > n_recorded:
        raise ArgumentError(
            "n_months",
            f"must be at most {n_recorded}, the recorded months of group {group}; it is"
            f" {number} (source='target' samples any number)",
        )
    row = np.repeat(np.arange(len(months)), months)
    log = Transitions(bins[row], replaced[row], following[row])
    if n_months is None:
        return log
    return log.draw(number, seed=generator)


def _recorded_policy(group: int) -> Array:
    """Return the shares of months in which engines were replaced, by bin.

    A month with the group's overall share is added to each bin, so that bins without
    months have that share.
    """
    counts = _pair_months(group)
    overall = counts.sum(axis=0) / counts.sum()
    return np.asarray((counts + overall) / (counts.sum(axis=1, keepdims=True) + 1.0))


def _increments_of_entries(simulator: FiniteMDP) -> IntArray:
    """Return the key of each entry: its increment, or one of the last bins' own."""
    matrix = simulator.transitions
    pair = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    start = np.where(pair % 2 == REPLACE, 0, pair // 2)
    increments = np.asarray(matrix.indices - start, dtype=np.int64)
    # from bin 88 one or two more lead to the last bin, from the last one any number
    is_capped = (matrix.indices == N_BINS - 1) & (start > N_BINS - N_INCREMENTS)
    return np.where(is_capped, N_INCREMENTS + start - (N_BINS - 2), increments)
