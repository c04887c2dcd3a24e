"""The interval from the recorded transitions alone: what it is, what it covers, and
where people read it.
"""

import csv
import json

import numpy as np
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee


def chain(recorded):
    """From 0 to 1 (pays 1) or 2; from 2, which may be unrecorded, to 1 or to the end 3."""
    rows = np.array(
        [[[0, 0.5, 0.5, 0]], [[0, 0, 0, 1.0]], [[0, 0.5, 0, 0.5]], [[0, 0, 0, 1.0]]]
    )
    simulator = oee.FiniteMDP(rows, np.array([0.0, 1.0, 0.0, 0.0]), 0, 0.9)
    moves = [(0, 1)] * 12 + [(0, 2)] * 8 + [(2, 1)] * recorded + [(2, 3)] * recorded
    state, following = np.array(moves).T
    return oee.Problem(
        simulator, oee.Transitions(state, np.zeros(len(state), int), following)
    ), np.ones((4, 1))


def test_pairs_never_recorded_are_as_the_default_estimates_them():
    """V(0) = .9 p + .81 (1 - p) q: the log bounds p, nothing bounds q but the
    simulator.
    """
    problem, policy = chain(0)
    found = oee.interval(problem, policy, confidence=0.9, unrecorded=np.inf)
    estimate = oee.estimators.OffEnvironment()(problem, policy)
    half = stats.norm.ppf(0.95) * estimate.standard_error
    assert_allclose(
        found.sampling, [estimate.value - half, estimate.value + half], rtol=1e-12
    )
    assert found.diagnostics["sampling_method"] == "value ± quantile x standard error"
    grid = np.linspace(1e-6, 1 - 1e-6, 400_001)
    limit = stats.chi2.ppf(0.9, 1) / 2
    inside = grid[
        20 * (0.6 * np.log(0.6 / grid) + 0.4 * np.log(0.4 / (1 - grid))) <= limit
    ]
    ends = np.array([inside.min(), inside.max()])
    assert_allclose(
        [found.lower, found.upper],
        [0.9 * ends[0], 0.9 * ends[1] + 0.81 * (1 - ends[1])],
        rtol=1e-4,
    )
    assert "if unrecorded pairs behave as estimated" in found._repr_html_()


def test_where_all_is_recorded_both_are_one():
    problem, policy = chain(5)
    found = oee.interval(problem, policy)
    assert found.sampling == (found.lower, found.upper)
    for method in ("delta", "robust"):
        assert oee.interval(problem, policy, method=method).sampling is None


def unrecorded(seed, n_next=30):
    """60 states with many successors each, a third of which were never recorded."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((60, 1, 60))
    for s in range(60):
        rows[s, 0, rng.choice(60, n_next, replace=False)] = rng.dirichlet(
            np.ones(n_next)
        )
    simulator = oee.FiniteMDP(rows, rng.normal(size=60), 0, 0.9)
    other = rows * np.exp(0.3 * rng.normal(size=rows.shape))
    target = simulator.with_transitions(other / other.sum(axis=2, keepdims=True))
    share = np.zeros((60, 1))
    share[:40] = 1 / 40
    return simulator, target, oee.sample_transitions(target, share, 800, seed=seed)


def test_the_report_gives_both_and_says_what_each_assumes(tmp_path):
    simulator, _, log = unrecorded(0)
    problem = oee.Problem(simulator, log)
    policy = np.ones((60, 1))
    found = oee.interval(problem, policy)
    assert found.lower < found.sampling[0] < found.sampling[1] < found.upper
    lower, upper = found.worst_case
    assert lower < found.lower < found.upper < upper
    report = oee.evaluate(problem, policy, seed=0, normalized=True)
    row = report.table.set_index("estimator").loc["oee"]
    for columns, ends in (
        (["sampling_lower", "sampling_upper"], found.sampling),
        (["worst_case_lower", "worst_case_upper"], found.worst_case),
        (["lower", "upper"], (found.lower, found.upper)),
    ):
        assert_allclose(row[columns].astype(float), 0.1 * np.array(ends), rtol=1e-9)
    assert np.isnan(report.table.set_index("estimator").sampling_lower["model-based"])
    share = f"{100 * (1 - row['coverage']):.1f}% of its time in them"
    said = f"pairs were never recorded, and the policy spends {share}. "
    assert said in report.headline
    assert "If they are as estimated, it is " in report.headline
    assert "; if they can be anything, " in report.headline
    report.save(tmp_path)
    kept = next(
        r
        for r in csv.DictReader((tmp_path / "table.csv").read_text().splitlines())
        if r["estimator"] == "oee"
    )
    results = json.loads((tmp_path / "report.json").read_text())
    told = next(r for r in results["results"] if r["estimator"] == "oee")
    assert (
        float(kept["sampling_upper"])
        == told["sampling_upper"]
        == results["intervals"][0]["sampling_upper"]
    )
    page = report.to_html()
    assert "sampling interval" in page
    assert "worst case interval" in page
    assert "they are as estimated, it is " in page


def test_it_stays_in_the_box():
    rows = np.array([[[0, 0.5, 0.5]]] * 2 + [[[0, 0, 1.0]]])
    simulator = oee.FiniteMDP(rows, np.array([0.0, 1.0, 0.0]), 0, 0.9)
    log = oee.Transitions([1] * 400, [0] * 400, [1] * 396 + [2] * 4)
    problem = oee.Problem(simulator, log)
    policy = np.ones((3, 1))
    narrow = oee.interval(problem, policy, lower_ratio=0.01, upper_ratio=2.0)
    assert narrow.lower <= narrow.sampling[0] <= narrow.sampling[1] <= narrow.upper
