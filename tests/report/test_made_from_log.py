"""A policy that was made from the same log is told from others, and a finding says what that does to its value."""

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.report.evaluation import is_best_in_log

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3, discount=0.9), oee.tasks.gridworld(4, 0.1, discount=0.9)
LOG = oee.sample_transitions(TARGET, np.full((16, 4), 1 / 64), 300, seed=0)
PROBLEM = oee.Problem(SIMULATOR, LOG)


def best_in_log():
    """Optimal under the log's frequencies, the simulator's rows where there are none."""
    counts = LOG.counts(16, 4).toarray()
    n = counts.sum(axis=1, keepdims=True)
    rows = np.where(n > 0, counts / np.maximum(n, 1), SIMULATOR.transitions.toarray())
    return oee.optimal_policy(SIMULATOR.with_transitions(rows.reshape(16, 4, 16)))


@pytest.mark.parametrize("names", [["oee"], ["simulator", "oee", "model-based"]])
def test_it_is_said_of_the_policy_that_was_made_from_the_log(names):
    policies = {
        "chosen": best_in_log(),
        "optimal": oee.optimal_policy(SIMULATOR),
        "other": oee.uniform_policy(SIMULATOR),
    }
    report = oee.evaluate(PROBLEM, policies, estimators=names)
    told = [text for text in report.warnings if "made from this log" in text]
    assert len(told) == 1
    assert "chosen" in told[0]
    assert "optimal)" not in told[0].split(":")[0]
    k = report.warnings.index(told[0]) + 1
    rows = [row for row in report.records() if k in row["notes"]]
    assert {row["policy"] for row in rows} == {"chosen"}
    assert "simulator" not in {row["estimator"] for row in rows}


def test_it_is_not_said_without_a_reason():
    assert is_best_in_log(PROBLEM, best_in_log())
    assert not is_best_in_log(PROBLEM, oee.optimal_policy(SIMULATOR))
    assert not is_best_in_log(PROBLEM, oee.uniform_policy(SIMULATOR))
    same = oee.Problem(SIMULATOR, 1e6 * SIMULATOR.transitions)  # the log's own model is the simulator
    assert not is_best_in_log(same, oee.optimal_policy(SIMULATOR))
