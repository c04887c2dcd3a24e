"""Assignment 2: the true ratio of two environments, its support, and the log's."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import transition_ratio
from oee_tabular.ratio import true_ratio as ratio_of
from oee_tabular.testing.assignments.drawing import draw_counts, draw_rows
from oee_tabular.testing.assignments.judging import Arguments, Mistake, Task
from oee_tabular.typing import Array


def _as_mdp(P: Array) -> FiniteMDP:
    n = P.shape[0]
    return FiniteMDP(P, np.zeros(P.shape[:2]), np.full(n, 1 / n), 0.9)


def _draw_pair(rng: np.random.Generator, is_hard: bool) -> Arguments:
    n_states, n_actions = int(rng.integers(3, 5)), 2
    shape = (n_states, n_actions, n_states)
    simulator = draw_rows(rng, shape, has_zeros=is_hard)
    target = draw_rows(rng, shape, has_zeros=False) * (simulator > 0)
    target *= (rng.random(shape) < 0.8) | (
        simulator == simulator.max(-1, keepdims=True)
    )
    target /= target.sum(axis=-1, keepdims=True)
    return {"target": target, "simulator": simulator}


def _draw_supports(rng: np.random.Generator, is_hard: bool) -> Arguments:
    """Draw a pair with one support inside of the other, equal ones, or neither."""
    pair = _draw_pair(rng, True)
    target, simulator = pair["target"], pair["simulator"]
    simulator_is_full, target_is_full, is_equal, is_outside = rng.integers(
        5
    ) == np.arange(4)
    if simulator_is_full:
        simulator = draw_rows(rng, simulator.shape, has_zeros=False)
    if target_is_full:
        target = draw_rows(rng, target.shape, has_zeros=False)
    if is_equal:
        target = simulator**2
        target /= target.sum(axis=-1, keepdims=True)
    if target_is_full or is_outside:
        # a transition of the target that the simulator never makes
        s, t = int(rng.integers(len(target))), int(target[0, -1].argmax())
        simulator[s, -1] = np.where(np.arange(len(target)) == t, 0.0, 1.0)
        simulator[s, -1] /= simulator[s, -1].sum()
        share = 1e-9 if is_hard else 0.3
        target[s, -1] = (1.0 - share) * simulator[s, -1]
        target[s, -1, t] = share
    return {"target": target, "simulator": simulator}


def _has_support(target: Array, simulator: Array) -> bool:
    try:
        ratio_of(_as_mdp(target), _as_mdp(simulator))
    except ValueError:  # it names the transition
        return False
    return True


def _true_ratio(target: Array, simulator: Array) -> Array:
    found = ratio_of(_as_mdp(target), _as_mdp(simulator)).values
    return np.asarray(found.toarray()).reshape(target.shape)


def _draw_counts(rng: np.random.Generator, is_hard: bool) -> Arguments:
    pair = _draw_pair(rng, is_hard)
    n_states, n_actions, _ = pair["target"].shape
    n = rng.integers(1 if is_hard else 3, 12, size=(n_states, n_actions))
    if is_hard:
        n[0, 0] = 1
        n[rng.integers(n_states), rng.integers(n_actions)] = 0
    counts = draw_counts(rng, n, pair["target"])
    return {"counts": counts, "simulator": pair["simulator"]}


def _ratio_from_counts(counts: Array, simulator: Array) -> Array:
    mdp = _as_mdp(simulator)
    log = counts.reshape(-1, counts.shape[-1])
    found = transition_ratio(sparse.csr_array(log), mdp, prior="none").values
    return np.asarray(found.toarray()).reshape(counts.shape)


SUPPORT = Task(
    name="2_support",
    call="has_support(target, simulator)",
    draw=_draw_supports,
    solve=_has_support,
    hint="the answer is False if there is a transition with target > 0 and simulator"
    " == 0, and True else.",
    mistakes=(
        Mistake(
            lambda target, simulator: bool(np.all((simulator > 0) <= (target > 0))),
            "the other way round: the simulator may do more than the target, and not"
            " less.",
        ),
        Mistake(
            lambda target, simulator: bool(np.all((simulator > 0) == (target > 0))),
            "the supports need not be equal: the simulator may do more.",
        ),
        Mistake(
            lambda target, simulator: bool(np.all(simulator > 0)),
            "a transition that neither of the two makes is no fault.",
        ),
        Mistake(
            lambda target, simulator: bool(np.all((simulator > 0) | (target < 1e-6))),
            "a small probability is a probability; compare with 0.",
        ),
        Mistake(
            lambda target, simulator: True,
            "it is True for a target that leaves the simulator's support.",
        ),
        Mistake(
            lambda target, simulator: False,
            "it is False for a target that stays in the simulator's support.",
        ),
    ),
)

RATIO = Task(
    name="2_ratio",
    call="true_ratio(target, simulator)",
    draw=_draw_pair,
    solve=_true_ratio,
    hint="zeta[s, a, t] = target[s, a, t] / simulator[s, a, t], and 0 where the simulator"
    " has 0.",
    mistakes=(
        Mistake(
            lambda target, simulator: simulator / target,
            "the ratio is target over simulator: it weights simulated transitions.",
        ),
        Mistake(
            lambda target, simulator: target / simulator,
            "0 / 0 is nan; where the simulator never goes, write 0.",
        ),
        Mistake(
            lambda target, simulator: np.nan_to_num(target / simulator, nan=1.0),
            "where the simulator never goes, write 0, and not 1.",
        ),
        Mistake(
            lambda target, simulator: target - simulator,
            "this is the difference; the ratio is a quotient.",
        ),
        Mistake(
            lambda target, simulator: np.log(target / simulator),
            "this is the logarithm of the ratio.",
        ),
        Mistake(
            lambda target, simulator: np.clip(target / simulator, 0.0, 1.0),
            "a ratio may be above 1, where the target goes more often.",
        ),
        Mistake(
            lambda target, simulator: (
                lambda z: z / np.nansum(z, axis=-1, keepdims=True)
            )(target / simulator),
            "the ratio itself need not sum to 1. What sums to 1 is simulator * ratio.",
        ),
        Mistake(
            lambda target, simulator: target / (simulator + 1e-3),
            "a number added to the denominator changes every ratio; treat zeros apart.",
        ),
        Mistake(
            lambda target, simulator: np.nan_to_num(
                target / simulator.mean(axis=1, keepdims=True)
            ),
            "each action has a row of its own; do not average over actions.",
        ),
    ),
)


def _pseudo_counts(counts: Array, simulator: Array) -> Array:
    more = counts + (simulator > 0)
    return np.asarray(np.nan_to_num(more / more.sum(-1, keepdims=True) / simulator))


FROM_COUNTS = Task(
    name="2_counts",
    call="ratio_from_counts(counts, simulator)",
    draw=_draw_counts,
    solve=_ratio_from_counts,
    hint="the frequencies of a row, counts / (sum of the row's counts), take the place"
    " of the target; a row without counts keeps the simulator, ratio 1.",
    tolerance=1e-6,
    mistakes=(
        Mistake(
            lambda counts, simulator: (
                counts / counts.sum(axis=-1, keepdims=True) / simulator
            ),
            "0 / 0 is nan, in a row without counts, whose ratio stays 1, and where the"
            " simulator never goes, where it is 0.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(counts / simulator),
            "counts are no probabilities; divide each row by its sum.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(counts / counts.sum() / simulator),
            "divide each row by its own sum, and not by the sum of all counts.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                counts / counts.sum(axis=-1, keepdims=True) / simulator
            ),
            "a row without counts says nothing; its ratio stays 1 on the support.",
        ),
        Mistake(
            lambda counts, simulator: np.where(
                simulator > 0,
                counts / counts.sum(axis=-1, keepdims=True) / simulator,
                0.0,
            ),
            "a row without counts says nothing; its ratio stays 1 on the support.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                counts / counts.sum(axis=-1, keepdims=True)
            ),
            "these are the frequencies; divide them by the simulator's probabilities.",
        ),
        Mistake(
            _pseudo_counts,
            "one more count each is a prior. Here the frequencies are asked for.",
        ),
        Mistake(
            lambda counts, simulator: np.nan_to_num(
                counts / counts.sum(axis=0, keepdims=True) / simulator
            ),
            "the sum is over the next state, the last axis.",
        ),
    ),
)

TASKS = (SUPPORT, RATIO, FROM_COUNTS)
