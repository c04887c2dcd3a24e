"""The paper's zeta: the quotient of two density ratios, (s, a, s') over (s, a)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import row_of_entry, row_sums
from oee_tabular.data import Transitions
from oee_tabular.exact import occupancy
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.ratio.density import density_ratio
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.simulate import sample_episodes

SimulatorData: TypeAlias = Transitions | str | None
_LONGEST_EPISODE = 1000  # the paper's episodes, where the log does not say how long its own were


@dataclass(frozen=True, eq=False)
class Quotient:
    """zeta on the simulator's entries, the larger of the two gaps, and how it came about."""

    zeta: Array
    gap: float
    details: dict[str, Any]


def estimated_behavior(observed: Array, simulator: FiniteMDP) -> Array:
    """(S, A): the share of each action in the counts of its state; uniform in states without counts."""
    pairs = row_sums(simulator.transitions, observed).reshape(simulator.n_states, simulator.n_actions)
    total = pairs.sum(axis=1, keepdims=True)
    uniform = np.full_like(pairs, 1.0 / simulator.n_actions)
    return np.where(total > 0, pairs / np.where(total > 0, total, 1.0), uniform)


def fit_quotient(
    observed: Array,
    log: Transitions | None,
    simulator: FiniteMDP,
    simulator_data: SimulatorData,
    *,
    behavior_policy: Any,
    seed: Any,
    lower: float | None,
    upper: float | None,
    ridge: float | Callable[[Any], Any],
    toward: float | None,
    solver: str,
    discount: float | None = None,
) -> Quotient:
    """beta_sas' / beta_sa, each from ``density_ratio`` with sum beta q = 1.

    Where a move was seen on neither side, 0/0, zeta is 1.
    """
    behavior = estimated_behavior(observed, simulator)
    if behavior_policy is not None:
        behavior = check_policy(behavior_policy, simulator, name="behavior_policy")
    expected = simulator_weights(observed, log, simulator, simulator_data, behavior, seed, discount)
    pattern = simulator.transitions
    options: dict[str, Any] = {"lower": lower, "upper": upper, "ridge": ridge, "toward": toward, "solver": solver}
    moves = density_ratio(observed, expected, **options)
    pairs = density_ratio(row_sums(pattern, observed), row_sums(pattern, expected), **options)
    below = pairs.ratio[row_of_entry(pattern)]
    undetermined = ((observed == 0) & (expected == 0)) | (below == 0)
    zeta = np.where(undetermined, 1.0, moves.ratio / np.where(below > 0, below, 1.0))
    details = {
        "lower": lower,
        "upper": upper,
        "undetermined_moves": int(undetermined.sum()),
        "share_at_the_box": float(np.mean((moves.ratio <= (lower or 0.0)) | (moves.ratio >= (upper or np.inf)))),
        "moves_only_in_log": int(((observed > 0) & (expected == 0)).sum()),
        "divergence_moves": moves.divergence,
        "divergence_pairs": pairs.divergence,
    }
    return Quotient(zeta, max(moves.gap, pairs.gap), details)


def check_simulator_data(value: object) -> None:
    """Transitions, "exact" or None."""
    if not (value is None or isinstance(value, Transitions) or (isinstance(value, str) and value == "exact")):
        raise ValueError(f"simulator_data must be Transitions, 'exact' or None; got {value!r}")


def simulator_weights(
    observed: Array,
    log: Transitions | None,
    simulator: FiniteMDP,
    simulator_data: SimulatorData,
    behavior: Array,
    seed: Any,
    discount: float | None = None,
) -> Array:
    """Counts or probabilities of the simulator's moves, on its entries; weighted by discount^t where one is given."""
    check_simulator_data(simulator_data)
    steps = _LONGEST_EPISODE
    if log is not None and log.timestep is not None:
        steps = int(log.timestep.max()) + 1
    if isinstance(simulator_data, Transitions):
        counts = simulator_data.counts(simulator.n_states, simulator.n_actions, discount=discount)
        return aligned_counts(counts, simulator)
    if simulator_data is not None:
        weighted = simulator.with_discount(1.0 if discount is None else discount)
        share = occupancy(weighted, behavior, horizon=steps, of="transition")
        over = simulator.absorbing()[row_of_entry(simulator.transitions) // simulator.n_actions]
        return np.where(over, 0.0, share.data) if not over.all() else share.data  # logs stop where an episode is over
    n = max(round(float(observed.sum())), 1) if log is None else len(log)
    generator = _checks.generator(seed)
    episodes = max(1, -(-n // steps))
    while True:  # episodes end early, so more of them may be needed; each try is a fresh sample
        sample = sample_episodes(simulator, behavior, episodes, steps, seed=generator)
        if len(sample) >= n:
            break
        episodes = int(np.ceil(1.2 * episodes * n / len(sample))) + 1
    drawn = sample.draw(n, seed=generator)
    return aligned_counts(drawn.counts(simulator.n_states, simulator.n_actions, discount=discount), simulator)
