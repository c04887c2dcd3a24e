"""Candidates for deployment: optimal policies of models, some only where recorded.

Of the model zeta P, the simulator corrected by the log (the default estimator's), these
are its optimum and the best of the policies that keep what runs now in all pairs that
were recorded fewer than k times. Such a policy shares with the running one what the log
does not know, and it cancels in the gain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy import sparse

from oee_tabular import _progress
from oee_tabular._sparse import row_sums
from oee_tabular.estimators import Problem
from oee_tabular.estimators.off_environment import estimate_with_rows
from oee_tabular.exact import optimal_policy, with_rows
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.evidence import gather
from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import Array, BoolArray

CORRECTED = "corrected"
RECORDED = (1, 3, 10)  # transitions that a pair must have in the variants
SIMULATOR = "simulator"
LOG = "log"
RUNNING = "running"
# states times actions times steps, above which the optimum is that without a horizon
MAX_STEPS_WORK = 10**7


def recorded_name(least: int) -> str:
    """Return the name of the variant for pairs recorded at least so often."""
    return f"{CORRECTED}, recorded {least}+"


BUILT_IN = (CORRECTED, *map(recorded_name, RECORDED), SIMULATOR, LOG)


def propose(
    problem: Problem, running: Array, own: Mapping[str, Array], *, has_log: bool
) -> Iterator[tuple[str, Array]]:
    """Make the candidates by name, one after another; equal ones are left out.

    ``problem`` is the one that chooses, ``has_log`` whether the optimum of its log's
    own model is a candidate too: it must be certified by another log.
    """
    known: set[bytes] = set()
    for name, policy in own.items():
        known.add(policy.tobytes())
        yield name, policy
    for name, policy in propose_optima(problem, running, has_log=has_log):
        if policy.tobytes() not in known:
            known.add(policy.tobytes())
            yield name, policy


def require_other_names(own: Mapping[str, Array]) -> None:
    """Refuse names that the package gives itself."""
    for name in own:
        if name in (*BUILT_IN, RUNNING):
            raise ArgumentError(
                "candidates",
                f"must have names of their own; {name!r} is that of a policy which is"
                " there already (rename it)",
            )


def propose_optima(
    problem: Problem, running: Array, *, has_log: bool = False
) -> Iterator[tuple[str, Array]]:
    """Make the optimal policies of the models, and their variants."""
    horizon = problem.horizon
    _progress.report_step("the optimal policy of the corrected simulator")
    _, rows = estimate_with_rows(problem, running)
    corrected = problem.model.with_transitions(
        with_rows(problem.model, rows).transitions
    )
    yield CORRECTED, find_optimum(corrected, horizon)
    counts = row_sums(problem.counts).reshape(running.shape)
    for least in RECORDED:
        yield (
            recorded_name(least),
            find_optimum_where(corrected, horizon, running, counts >= least),
        )
    _progress.report_step("the optimal policy of the simulator")
    yield SIMULATOR, find_optimum(problem.model, horizon)
    if has_log:
        evidence = gather(problem, running)
        fitted = problem.model.with_transitions(evidence.fitted.transitions)
        yield LOG, find_optimum(fitted, horizon)


def find_optimum(model: FiniteMDP, horizon: int | None) -> Array:
    """Return an optimal policy (S, A); with a horizon that of the first step."""
    work = (horizon or 0) * model.n_states * model.n_actions
    if horizon is None or (model.discount < 1.0 and work > MAX_STEPS_WORK):
        return optimal_policy(model)
    return np.asarray(optimal_policy(model, horizon=horizon)[0])


def find_optimum_where(
    model: FiniteMDP, horizon: int | None, running: Array, may_change: BoolArray
) -> Array:
    """Return the best policy that keeps the running one's probabilities elsewhere.

    ``may_change`` (S, A) says which pairs may get another probability: those of a state
    share what the running policy gives them, and the best one takes it all. This is the
    optimum of a model whose actions are such policies of each state,

        c(a) = sum of pi_0(b | s) 1_b over pairs b that are kept + (the rest of 1) 1_a,

    or pi_0 itself where a is kept.
    """
    n_states, n_actions = running.shape
    kept = np.where(may_change, 0.0, running)
    rest = 1.0 - kept.sum(axis=1)
    choices = np.repeat(kept[:, None, :], n_actions, axis=1)
    own = np.arange(n_actions)
    choices[:, own, own] += rest[:, None]
    choices = np.where(may_change[:, :, None], choices, running[:, None, :])
    state = np.repeat(np.arange(n_states), n_actions)
    mixing = sparse.csr_array(
        (
            choices.reshape(-1),
            (
                np.repeat(np.arange(n_states * n_actions), n_actions),
                (state[:, None] * n_actions + own).reshape(-1),
            ),
        ),
        shape=(n_states * n_actions, n_states * n_actions),
    )
    mixed = FiniteMDP(
        sparse.csr_array(mixing @ model.transitions),
        (mixing @ model.rewards.reshape(-1)).reshape(n_states, n_actions),
        model.initial,
        model.discount,
    )
    chosen = find_optimum(mixed, horizon)
    return np.asarray(np.einsum("sa,sab->sb", chosen, choices))
