"""Problems: logs that contradict the simulator, their rewards, their checks, and where
termination leads.
"""

import functools

import numpy as np
import pytest
from helpers import Dense, table_of
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions
from oee_tabular.estimators import (
    DoublyRobust,
    ImportanceSampling,
    Marginalized,
    ModelBased,
    OffEnvironment,
    Simulator,
)


def test_contradictions_of_the_log():
    """Rewards: rows, moves and the worst example; behaviour: rows whose probability is
    not the policy's.
    """
    simulator = FiniteMDP(
        np.full((2, 2, 2), 0.5), np.array([[1.0, 2.0], [3.0, 4.0]]), [1, 0], 0.9
    )
    log = Transitions(
        [0, 0, 1, 0],
        [0, 0, 1, 1],
        [0, 0, 1, 1],
        [1.5, 1.5, 9.0, 2.0],
        behavior_probability=[0.5, 0.4, 0.5, 0.5],
    )
    problem = Problem(simulator, log, behavior_policy=np.full((2, 2), 0.5))
    assert (
        str(problem.reward_conflict)
        == "the log's rewards contradict the simulator's in 3 of 4 transitions (2"
        " distinct; the reward of s=1, a=1 -> s'=1 is 9 in the log, 4 in the"
        " simulator)"
    )
    assert problem.behavior_conflict == 1
    assert Problem(simulator, log).behavior_conflict == 0
    whole = Transitions(
        [0, 1], [0, 1], [1, 0], episode=[0, 0], behavior_probability=[0.5, 0.2]
    )
    drawn = Problem(
        simulator, log, behavior_policy=np.full((2, 2), 0.25) * 2, episodes=whole
    )
    assert drawn.behavior_conflict == 1
    assert Problem(simulator, whole).reward_conflict is None
    assert_array_equal(problem.rewards_of(log), log.reward)
    assert_array_equal(problem.rewards_of(whole), [1.0, 4.0])
    near = Transitions([0], [0], [0], [1.0 + 5e-7])
    assert Problem(simulator, near).reward_conflict is None
    assert (
        Problem(simulator, Transitions([0], [0], [0], [1.00001])).reward_conflict.rows
        == 1
    )


def test_log_rewards_for_rewards_of_state_and_action():
    """The mean of the log's pay where a move was seen, r(s, a) elsewhere; rows s*A + a."""
    simulator = FiniteMDP(
        np.full((2, 2, 2), 0.5), np.array([[1.0, 3.0], [4.0, 6.0]]), [1, 0], 0.9
    )
    log = Transitions([0, 0, 0, 0], [1, 1, 1, 0], [0, 0, 0, 0], [5.0, 7.0, 9.0, 2.0])
    problem = Problem(simulator, log, rewards="log")
    assert_allclose(
        problem.model.transition_rewards.toarray(),
        [[2.0, 1.0], [7.0, 3.0], [4.0, 4.0], [6.0, 6.0]],
    )
    assert Problem(simulator, log).model is simulator


def test_each_log_of_a_problem_is_led_to_where_termination_leads():
    """A terminated move into state 0 ends in state 1; a log without one is kept as it
    is.
    """
    rows = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    simulator = FiniteMDP(rows, [1.0, 0.0], [1, 0], 0.9, terminal_state=[1, 1])
    ended = Transitions([0], [0], [0], terminated=[True])
    going = Transitions([0], [0], [0])
    problem = Problem(simulator, ended, simulator_data=ended, episodes=ended)
    for log in (problem.log, problem.episodes, problem.simulator_data):
        assert log.next_state.tolist() == [1]
        assert log.terminated.tolist() == [True]
    problem = Problem(simulator, going, simulator_data=going, episodes=going)
    assert problem.log is problem.episodes is problem.simulator_data is going
    assert Problem(simulator, going, simulator_data="exact").simulator_data == "exact"
    assert_array_equal(problem.counts.toarray(), [[1, 0], [0, 0]])


# ---- ``Problem(counts=...)``: counts of the target's moves that stand in for the log's
SIMULATOR, TARGET = (oee.tasks.gridworld(3, slip=slip) for slip in (0.3, 0.1))
UNIFORM = oee.uniform_policy(SIMULATOR)
EXPERT = oee.tasks.gridworld_expert(3)
LOG = oee.sample_episodes(TARGET, UNIFORM, 30, horizon=20, seed=0)
MORE = oee.sample_episodes(TARGET, UNIFORM, 300, horizon=20, seed=1)
COUNTS = LOG.counts(9, 4)
SOFT = 0.25 * MORE.counts(9, 4)


@pytest.mark.parametrize(
    "estimator",
    [
        OffEnvironment(),
        ModelBased(),
        ImportanceSampling(),
        OffEnvironment(evaluation="monte_carlo"),
    ],
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
        value = oee.policy_value(
            fit(SOFT, SIMULATOR).target_model(SIMULATOR), EXPERT, horizon=20
        )
        assert_allclose(
            estimator(problem, EXPERT).diagnostics["model_value"], value, rtol=1e-12
        )
    other = oee.Problem(SIMULATOR, MORE, 20)
    assert_allclose(
        ModelBased()(problem, EXPERT).value,
        ModelBased()(other, EXPERT).value,
        rtol=1e-12,
    )
    plain = oee.Problem(SIMULATOR, LOG, 20)
    assert (
        ImportanceSampling()(problem, EXPERT).value
        == ImportanceSampling()(plain, EXPERT).value
    )
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
    for problem in (
        oee.Problem(SIMULATOR, LOG, 20, counts=SOFT),
        oee.Problem(SIMULATOR, SOFT, 20),
    ):
        assert problem.soft
        report = oee.evaluate(problem, EXPERT, estimators=["oee"], seed=0)
        assert report.uncertainty.intervals == {}
        assert (
            "likelihood intervals need whole and independent transitions"
            in " ".join(str(report).split())
        )


# ---- whole counts, without a log
WHOLE = oee.Problem(SIMULATOR, COUNTS, 20)
PLAIN = oee.Problem(SIMULATOR, LOG, 20)


@pytest.mark.parametrize("method", ["likelihood", "delta", "robust", "bootstrap"])
def test_whole_counts_give_the_log_s_intervals(method):
    """A bag of counts may be of episodes: the robust radius is theirs."""
    ends = [
        oee.interval(problem, EXPERT, method=method, seed=0)
        for problem in (WHOLE, PLAIN)
    ]
    assert ends[0].lower == ends[1].lower
    assert ends[0].upper == ends[1].upper


def test_what_needs_episodes_says_so():
    report = oee.evaluate(WHOLE, EXPERT, seed=0)
    assert (
        "Importance sampling is left out: the log has no episodes." in report.warnings
    )


# ---- counts with rewards, terminations and a sample of episodes
def counted(log, sample=None):
    """Rows of a log as TransitionCounts, one a row: equal moves stand twice."""
    moves = log.moves()
    return oee.TransitionCounts(
        log.state,
        log.action,
        log.next_state,
        moves.number,
        log.terminated,
        moves.reward_sum,
        moves.reward_min,
        moves.reward_max,
        sample=sample,
    )


def paid(change):
    columns = LOG.columns()
    columns["reward"] = columns["reward"] + change(np.arange(len(LOG)))
    return oee.Transitions(**columns)


def test_counts_show_rewards_that_contradict():
    log = paid(lambda k: np.where(k == 7, 0.5, 0.0))
    plain = oee.Problem(SIMULATOR, log, 20)
    problem = oee.Problem(SIMULATOR, counted(log), 20)
    assert str(problem.reward_conflict) == str(plain.reward_conflict)
    assert oee.Problem(SIMULATOR, counted(LOG), 20).reward_conflict is None
    assert oee.Problem(SIMULATOR, COUNTS, 20).reward_conflict is None
    one = oee.TransitionCounts([0], [0], [0], [9], [0], [4.0], [-1.0], [3.0])
    zero = oee.FiniteMDP(
        SIMULATOR.transitions, np.zeros((9, 4)), SIMULATOR.initial, 0.9
    )
    conflict = oee.Problem(zero, one).reward_conflict
    assert str(conflict).startswith(
        "the log's rewards contradict the simulator's in up to 9 of 9 transitions (1"
        " distinct"
    )
    assert "is 3 in the log, 0 in the simulator" in str(conflict)


@pytest.mark.parametrize(
    "estimator", [ModelBased(), OffEnvironment(), oee.estimators.Marginalized()]
)
@pytest.mark.parametrize("rewards", ["log", "simulator"])
def test_rewards_of_counts_are_the_log_s(estimator, rewards):
    log = paid(lambda k: np.sin(k))
    ours, plain = (
        oee.Problem(SIMULATOR, given, 20, rewards=rewards)
        for given in (counted(log), log)
    )
    assert_allclose(
        estimator(ours, EXPERT).value, estimator(plain, EXPERT).value, rtol=1e-12
    )


def test_importance_sampling_sees_the_sample_beside_the_counts():
    problem = oee.Problem(SIMULATOR, counted(MORE, sample=LOG), 20)
    plain = oee.Problem(SIMULATOR, LOG, 20)
    assert (
        ImportanceSampling()(problem, EXPERT).value
        == ImportanceSampling()(plain, EXPERT).value
    )
    assert problem.recorded is problem.log.sample
    assert (
        oee.Problem(SIMULATOR, counted(MORE, sample=LOG), 20, episodes=MORE).recorded
        is not LOG
    )


def test_terminated_transitions_of_counts_are_led_to_the_terminal_state():
    mdp = oee.FiniteMDP.from_gymnasium(
        __import__("gymnasium").make("CliffWalking-v1"), discount=0.9
    )
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 20, 200, seed=2)
    assert log.terminated.any()
    ours = oee.Problem(mdp, counted(log, sample=log))
    plain = oee.Problem(mdp, log)
    assert abs(ours.counts - plain.counts).sum() == 0
    assert np.array_equal(ours.log.sample.next_state, plain.log.next_state)


def test_rows_left_out_have_a_warning():
    told = oee.data.counts.Recording(
        True, 300, 2, 20, 3, 1, 2, 4, ("a.csv: state[3] must be an integer; it is x",)
    )
    log = oee.TransitionCounts([0], [0], [0], [7], recording=told, sample=LOG)
    texts = [finding.text for finding in oee.Problem(SIMULATOR, log).findings]
    assert texts == [
        (
            "4 invalid rows of the log (36.36% of all rows) were not counted, since"
            " their state or action cannot be read. Values and intervals are as if they"
            " were like the others: a.csv: state[3] must be an integer; it is x."
        ),
        (
            "Importance sampling uses a sample of 30 of the log's 300 episodes. The"
            " other estimators use every transition."
        ),
    ]


# ---- what the log paid: values, gradients and errors under rewards="log", by a dense
# model of its own
def paid_case(form):
    rng = np.random.default_rng(3)
    P = rng.dirichlet(np.ones(3), size=(3, 2))
    simulator = oee.FiniteMDP(
        P, rng.normal(size=(3, 2, 3)[: len(form)]), [0.5, 0.25, 0.25], 0.8
    )
    target = simulator.with_transitions(rng.dirichlet(np.ones(3), size=(3, 2)))
    drawn = oee.sample_transitions(
        target, np.array([[0.3, 0.1], [0.3, 0.1], [0.2, 0.0]]), 40, seed=0
    )
    pay = rng.normal(size=40)
    log = oee.Transitions(drawn.state, drawn.action, drawn.next_state, pay)
    base = Dense(simulator)
    n = table_of(log, (3, 2))
    total = np.zeros((3, 2, 3))
    np.add.at(total, (log.state, log.action, log.next_state), pay)
    own = base.like(base.P)
    own.r = np.where(n > 0, total / np.maximum(n, 1), base.r)
    return simulator, log, rng.dirichlet([1.0, 1.0], size=3), own, n


@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("form", ["sa", "sat"])
def test_values_use_the_log_s_rewards(form, horizon):
    simulator, log, policy, own, n = paid_case(form)
    problem = oee.Problem(simulator, log, horizon=horizon, rewards="log")
    # its own
    assert_allclose(
        Simulator()(problem, policy).value,
        Dense(simulator).J(policy, horizon),
        rtol=1e-9,
    )
    total = n.sum(axis=2, keepdims=True)
    frequency = n / np.maximum(total, 1)
    likeliest = own.like(np.where(total > 0, frequency, own.P))
    found = ModelBased(fallback="simulator")(problem, policy)
    assert_allclose(found.value, likeliest.J(policy, horizon), rtol=1e-9)
    slope = likeliest.slope(policy, horizon)
    seen = total[:, :, 0] > 0
    spread = (likeliest.P * slope**2).sum(axis=2) - (likeliest.P * slope).sum(
        axis=2
    ) ** 2
    assert_allclose(
        found.standard_error,
        np.sqrt((spread[seen] / total[:, :, 0][seen]).sum()),
        rtol=1e-7,
    )
    fit = oee.transition_ratio(log, simulator, prior="simulator", strength=5.0)
    model = own.like(fit.values.toarray().reshape(3, 2, 3) * own.P)
    told = OffEnvironment(ratio=fit)(problem, policy).diagnostics
    assert_allclose(told["model_value"], model.J(policy, horizon), rtol=1e-9)
    assert_allclose(
        told["maximum_likelihood_value"], likeliest.J(policy, horizon), rtol=1e-9
    )
    step = (model.slope(policy, horizon) * (likeliest.P - model.P))[seen].sum()
    assert_allclose(told["one_step_value"], model.J(policy, horizon) + step, rtol=1e-9)


def test_doubly_robust_and_marginalised_values_of_the_log_s_rewards():
    simulator, log, policy, own, n = paid_case("sat")
    problem = oee.Problem(simulator, log, rewards="log")
    total = n.sum(axis=2, keepdims=True)
    frequency = n / np.maximum(total, 1)
    fit = oee.transition_ratio(log, simulator, prior="simulator", strength=5.0)
    model = own.like(fit.values.toarray().reshape(3, 2, 3) * own.P)
    seen = total[:, :, 0] > 0
    ahead = own.r + own.g * own.values(policy)
    change = (model.visits(policy)[:, :, None] * (frequency - own.P) * ahead)[
        seen
    ].sum()
    assert_allclose(
        DoublyRobust(ratio=fit)(problem, policy).value,
        own.J(policy) + change,
        rtol=1e-9,
    )
    pay = np.array(log.reward)
    share = (
        model.visits(policy)[log.state, log.action] / total[log.state, log.action, 0]
    )
    here = own.visits(policy)
    assert_allclose(
        Marginalized(ratio=fit)(problem, policy).value, (share * pay).sum(), rtol=1e-7
    )
    assert here.min() > 0


@pytest.mark.parametrize(
    ("head", "bad", "rule"),
    [
        ("state,action,next_state", "9,0,0", "must be in 0..2"),
        ("state,action,next_state,terminated", "0,0,1,true", "must be False"),
    ],
)
def test_a_fault_of_a_log_in_two_files_has_its_file_and_line(tmp_path, head, bad, rule):
    good = "0,0,1" + ",false" * (head.count(",") - 2)
    for k, last in enumerate([good, bad]):
        (tmp_path / f"part-{k}.csv").write_text(f"{head}\n{good}\n{last}\n")
    log = oee.Transitions.load(tmp_path)
    simulator = oee.FiniteMDP(np.eye(3)[[[1], [0], [2]]], np.ones(3), 0, 0.9)
    with pytest.raises(ValueError, match=r"\[3\] \(row 1 .*part-1.csv.*" + rule):
        oee.Problem(simulator, log)


@pytest.mark.parametrize("path", ["", "x" * 10**6, "a\0b", "-", "https://a/b.csv"])
@pytest.mark.parametrize("name", ["log", "episodes"])
def test_a_path_that_is_none_is_named_by_its_argument(path, name):
    simulator = oee.FiniteMDP(np.eye(3)[[[1], [0], [2]]], np.ones(3), 0, 0.9)
    given = {"log": Transitions([0], [0], [1]), name: path}
    with pytest.raises(ValueError, match=rf"^{name}\b"):
        Problem(simulator, **given)
