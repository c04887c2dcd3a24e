"""``Problem(counts=...)``: counts of the target's moves that stand in for the log's."""

import functools
import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators import ImportanceSampling, ModelBased, OffEnvironment

SIMULATOR, TARGET = (oee.tasks.gridworld(3, slip=slip) for slip in (0.3, 0.1))
UNIFORM = oee.uniform_policy(SIMULATOR)
EXPERT = oee.tasks.gridworld_expert(3)
LOG = oee.sample_episodes(TARGET, UNIFORM, 30, horizon=20, seed=0)
MORE = oee.sample_episodes(TARGET, UNIFORM, 300, horizon=20, seed=1)
COUNTS = LOG.counts(9, 4)
SOFT = 0.25 * MORE.counts(9, 4)


@pytest.mark.parametrize(
    "estimator", [OffEnvironment(), ModelBased(), ImportanceSampling(), OffEnvironment(evaluation="monte_carlo")]
)
def test_the_log_s_own_counts_change_nothing(estimator):
    plain = estimator(oee.Problem(SIMULATOR, LOG, 20), EXPERT, seed=0)
    given = estimator(oee.Problem(SIMULATOR, LOG, 20, counts=COUNTS), EXPERT, seed=0)
    assert plain.value == given.value
    assert plain.standard_error == given.standard_error


def test_who_uses_them():
    """Those that count do; importance sampling has the log."""
    problem = oee.Problem(SIMULATOR, LOG, 20, counts=SOFT)
    default = functools.partial(oee.transition_ratio, values_of=EXPERT, horizon=20)
    fixed = functools.partial(oee.transition_ratio, prior="simulator", strength=2.0)
    for estimator, fit in ((OffEnvironment(), default), (OffEnvironment(fixed), fixed)):
        value = oee.policy_value(fit(SOFT, SIMULATOR).target_model(SIMULATOR), EXPERT, horizon=20)
        assert_allclose(estimator(problem, EXPERT).diagnostics["model_value"], value, rtol=1e-12)
    other = oee.Problem(SIMULATOR, MORE, 20)
    assert_allclose(ModelBased()(problem, EXPERT).value, ModelBased()(other, EXPERT).value, rtol=1e-12)
    plain = oee.Problem(SIMULATOR, LOG, 20)
    assert ImportanceSampling()(problem, EXPERT).value == ImportanceSampling()(plain, EXPERT).value
    assert problem.observed is problem.counts
    assert plain.observed is plain.log


def test_copies_keep_what_was_given_and_no_more():
    given, plain = oee.Problem(SIMULATOR, LOG, counts=SOFT), oee.Problem(SIMULATOR, LOG)
    assert_allclose(replace(given, horizon=5).counts.sum(), SOFT.sum())
    assert_allclose(replace(given, counts=COUNTS).counts.sum(), len(LOG))
    assert replace(plain, log=MORE).counts.sum() == len(MORE)
    assert_allclose(pickle.loads(pickle.dumps(given)).counts.toarray(), SOFT.toarray())


def test_they_are_copied_and_read_only():
    matrix = sparse.coo_array(SOFT, copy=True)
    problem = oee.Problem(SIMULATOR, LOG, counts=matrix)
    matrix.data[:] = 0.0
    assert problem.counts.sum() == SOFT.sum()
    with pytest.raises(ValueError, match="read-only"):
        problem.counts.data[0] = 1.0


def test_a_report_leaves_out_what_needs_whole_moves():
    report = oee.evaluate(oee.Problem(SIMULATOR, LOG, 20, counts=SOFT), EXPERT, estimators=["oee"], seed=0)
    assert report.sureness.intervals == {}
    assert "likelihood intervals, which need whole and independent moves, are left out" in str(report)


def spoiled(value):
    matrix = sparse.csr_array(SOFT, copy=True)
    matrix.data[0] = value
    return matrix


def outside():
    matrix = sparse.lil_array(SOFT.shape)
    matrix[0, 8] = 0.5
    return sparse.csr_array(matrix)


BAD = {
    "an array": (lambda: SOFT.toarray(), r"counts must be sparse, of shape \(36, 9\); got ndarray"),
    "shape": (
        lambda: SOFT[:4],
        r"counts must have shape \(36, 9\) \(row s\*A \+ a, column s'\); they have shape \(4, 9\)",
    ),
    "complex": (lambda: SOFT * 1j, r"counts must be real numbers; they are complex128"),
    "negative": (lambda: spoiled(-0.5), r"counts must be finite and nonnegative; at s=0, a=0 -> s'=0 there is -0.5"),
    "nan": (lambda: spoiled(np.nan), r"counts must be finite and nonnegative; at s=0, a=0 -> s'=0 there is nan"),
    "infinite": (lambda: spoiled(np.inf), r"counts must be finite and nonnegative; .* there is inf"),
    "none": (lambda: 0 * SOFT, r"counts must have at least one move; all are 0"),
    "no support": (outside, r"counts must stay where the simulator has probability: .* s=0, a=0 -> s'=8 \(0.5\)"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_calls(case):
    make, text = BAD[case]
    with pytest.raises(ValueError, match=text):
        oee.Problem(SIMULATOR, LOG, counts=make())
    with pytest.raises(ValueError, match="guaranteed must be False where counts are given"):
        oee.evaluate(oee.Problem(SIMULATOR, LOG, 20, counts=SOFT), EXPERT, estimators=["oee"], guaranteed=True)
