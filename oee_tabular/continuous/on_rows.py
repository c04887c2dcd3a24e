"""Reports without cells: the log's own rows are the states, on which importance sampling is exact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular.continuous.history import consecutive
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import StatePolicy, check_probabilities
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimator, Problem
from oee_tabular.mdp import FiniteMDP
from oee_tabular.report.evaluation import group_findings, number_notes
from oee_tabular.report.results import Report, Result
from oee_tabular.report.uncertainty import Uncertainty, choose_interval


def on_rows(log: ContinuousTransitions, n_actions: int, horizon: int, discount: float) -> Problem:
    """Row i of the log (whose actions are numbers) is state i; whatever is done there, the row that follows comes, or the end.

    Only what looks at the log's episodes alone may be asked of it: policies are known there by their probabilities in the log's
    own states, and no simulator is in it.
    """
    n = len(log)
    before, after = consecutive(log)
    following = np.full(n + 1, n)
    following[before] = after
    entries = np.ones((n + 1) * n_actions), np.repeat(following, n_actions), np.arange((n + 1) * n_actions + 1)
    first = np.ones(n + 1)
    first[after], first[n] = 0.0, 0.0
    paid = np.zeros(n) if log.reward is None else log.reward
    rewards = np.repeat(np.append(paid, 0.0)[:, None], n_actions, axis=1)
    mdp = FiniteMDP(
        sparse.csr_array(entries, shape=((n + 1) * n_actions, n + 1)), rewards, first / first.sum(), discount
    )
    columns: dict[str, Any] = log.columns() | {"state": np.arange(n), "next_state": following[:n]}
    ended = following[:n] == n
    columns |= {"terminated": np.asarray(log.terminated), "truncated": ended & ~np.asarray(log.terminated)}
    if log.reward is None:  # there is nothing to average
        columns |= {"episode": None, "timestep": None}
    return Problem(mdp, Transitions(**columns), horizon=horizon)


def table_on_rows(policy: StatePolicy, log: ContinuousTransitions, n_actions: int) -> Array:
    """(n + 1, A) a policy in the log's own states, and anything at the end."""
    found = check_probabilities(policy, log.state, n_actions)
    return np.concatenate([found, np.full((1, n_actions), 1.0 / n_actions)])


def report_on_rows(
    problem: Problem,
    tables: Mapping[str, Array],
    rows: Mapping[str, Estimator],
    said: tuple[str, ...],
    first: tuple[str, ...],
    caveat: str,
    *,
    seed: Seed,
    facts: Mapping[str, object],
    confidence: float = 0.95,
    normalized: bool = False,
    guaranteed: bool = False,
    quick: bool = False,
) -> Report:
    """The report of rows by name, each beside its own interval; ``first`` are sentences about the
    target, ``caveat`` what is said before the value.
    """
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    discount = problem.simulator.discount
    if _checks.boolean(guaranteed, "guaranteed"):
        raise ValueError("guaranteed must be False without cells: guaranteed intervals need a finite simulator")
    if _checks.boolean(normalized, "normalized") and discount == 1.0:
        raise ValueError("normalized must be False at discount 1: the factor (1 - discount) would be 0")
    _checks.boolean(quick, "quick")
    scale = 1.0 - discount if normalized else 1.0
    results = []
    for i, (policy, table) in enumerate(tables.items()):
        for j, (name, estimator) in enumerate(rows.items()):
            estimate = estimator(problem, table, seed=_checks.seed_sequence(seed, (i, j)))
            results.append(Result(policy, name, choose_interval(estimate, None, level, scale)))
    told = group_findings(results)
    warnings, notes = number_notes(results, [*told, *((sentence, []) for sentence in said)])
    uncertainty = Uncertainty(distance=first, caveat=caveat)
    return Report(tuple(results), {}, warnings, notes, level, normalized, discount, problem.horizon, seed, facts,
                  uncertainty)  # fmt: skip
