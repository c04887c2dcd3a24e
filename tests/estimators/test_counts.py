"""``Problem(counts=...)``: counts of the target's moves that stand in for the log's."""

import functools

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


def test_a_file_of_counts_is_a_log_like_any_other(tmp_path):
    path = tmp_path / "counts.npz"
    oee.TransitionCounts.of(COUNTS, 4).save(path)
    assert_allclose(oee.Problem(SIMULATOR, path).counts.toarray(), COUNTS.toarray())
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(ValueError, match=r"counts\.npz"):
        oee.Problem(SIMULATOR, str(path))


def test_they_are_copied_and_read_only():
    matrix = sparse.coo_array(SOFT, copy=True)
    problem = oee.Problem(SIMULATOR, LOG, counts=matrix)
    matrix.data[:] = 0.0
    assert problem.counts.sum() == SOFT.sum()
    with pytest.raises(ValueError, match="read-only"):
        problem.counts.data[0] = 1.0


def test_a_report_leaves_out_what_needs_whole_transitions():
    for problem in (oee.Problem(SIMULATOR, LOG, 20, counts=SOFT), oee.Problem(SIMULATOR, SOFT, 20)):
        assert problem.soft
        report = oee.evaluate(problem, EXPERT, estimators=["oee"], seed=0)
        assert report.uncertainty.intervals == {}
        assert "likelihood intervals need whole and independent transitions" in " ".join(str(report).split())


# ---- whole counts, without a log


WHOLE = oee.Problem(SIMULATOR, COUNTS, 20)
PLAIN = oee.Problem(SIMULATOR, LOG, 20)


@pytest.mark.parametrize("method", ["likelihood", "delta", "robust", "bootstrap"])
def test_whole_counts_give_the_log_s_intervals(method):
    """A bag of counts may be of episodes: the robust radius is theirs."""
    ends = [oee.interval(problem, EXPERT, method=method, seed=0) for problem in (WHOLE, PLAIN)]
    assert ends[0].lower == ends[1].lower
    assert ends[0].upper == ends[1].upper


def test_what_needs_episodes_says_so():
    report = oee.evaluate(WHOLE, EXPERT, seed=0)
    assert "Importance sampling is left out: the log has no episodes." in report.warnings


# ---- counts with rewards, terminations and a sample of episodes


def counted(log, sample=None):
    """Rows of a log as TransitionCounts, one a row: equal moves stand twice."""
    moves = log.moves()
    return oee.TransitionCounts(
        log.state, log.action, log.next_state, moves.number, log.terminated, moves.reward_sum, moves.reward_min,
        moves.reward_max, sample=sample,
    )  # fmt: skip


def paid(change):
    columns = LOG.columns()
    columns["reward"] = columns["reward"] + change(np.arange(len(LOG)))
    return oee.Transitions(**columns)


def test_counts_show_rewards_that_contradict():
    log = paid(lambda k: np.where(k == 7, 0.5, 0.0))
    plain, problem = oee.Problem(SIMULATOR, log, 20), oee.Problem(SIMULATOR, counted(log), 20)
    assert str(problem.reward_conflict) == str(plain.reward_conflict)
    assert oee.Problem(SIMULATOR, counted(LOG), 20).reward_conflict is None
    assert oee.Problem(SIMULATOR, COUNTS, 20).reward_conflict is None
    one = oee.TransitionCounts([0], [0], [0], [9], [0], [4.0], [-1.0], [3.0])
    zero = oee.FiniteMDP(SIMULATOR.transitions, np.zeros((9, 4)), SIMULATOR.initial, 0.9)
    conflict = oee.Problem(zero, one).reward_conflict
    assert str(conflict).startswith(
        "the log's rewards contradict the simulator's in up to 9 of 9 transitions (1 distinct"
    )
    assert "is 3 in the log, 0 in the simulator" in str(conflict)


@pytest.mark.parametrize("estimator", [ModelBased(), OffEnvironment(), oee.estimators.Marginalized()])
@pytest.mark.parametrize("rewards", ["log", "simulator"])
def test_rewards_of_counts_are_the_log_s(estimator, rewards):
    log = paid(lambda k: np.sin(k))
    ours, plain = (oee.Problem(SIMULATOR, given, 20, rewards=rewards) for given in (counted(log), log))
    assert_allclose(estimator(ours, EXPERT).value, estimator(plain, EXPERT).value, rtol=1e-12)


def test_importance_sampling_sees_the_sample_beside_the_counts():
    problem, plain = oee.Problem(SIMULATOR, counted(MORE, sample=LOG), 20), oee.Problem(SIMULATOR, LOG, 20)
    assert ImportanceSampling()(problem, EXPERT).value == ImportanceSampling()(plain, EXPERT).value
    assert problem.recorded is problem.log.sample
    assert oee.Problem(SIMULATOR, counted(MORE, sample=LOG), 20, episodes=MORE).recorded is not LOG


def test_terminated_transitions_of_counts_are_led_to_the_terminal_state():
    mdp = oee.FiniteMDP.from_gymnasium(__import__("gymnasium").make("CliffWalking-v1"), discount=0.9)
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 20, 200, seed=2)
    assert log.terminated.any()
    ours, plain = oee.Problem(mdp, counted(log, sample=log)), oee.Problem(mdp, log)
    assert abs(ours.counts - plain.counts).sum() == 0
    assert np.array_equal(ours.log.sample.next_state, plain.log.next_state)


def test_rows_left_out_have_a_warning():
    told = oee.data.counts.Recording(True, 300, 2, 20, 3, 1, 2, 4, ("a.csv: state[3] must be an integer; it is x",))
    log = oee.TransitionCounts([0], [0], [0], [7], recording=told, sample=LOG)
    texts = [finding.text for finding in oee.Problem(SIMULATOR, log).findings]
    assert texts == [
        "4 invalid rows of the log were not counted: a.csv: state[3] must be an integer; it is x.",
        "Importance sampling uses a sample of 30 of the log's 300 episodes. The other estimators use every transition.",
    ]
