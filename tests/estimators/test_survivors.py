"""What mutation testing showed the other tests of ``estimators`` to leave open: each test is named after what it pins."""

import functools

import numpy as np
import pytest
from helpers import dense
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions, exact
from oee_tabular.estimators import (
    DoublyRobust,
    DualDice,
    Estimate,
    ImportanceSampling,
    Magic,
    Marginalized,
    ModelBased,
    OffEnvironment,
    Oracle,
    Simulator,
)
from oee_tabular.estimators.base import effective_sample_size, mean_and_error
from oee_tabular.estimators.episodes import episode_terms, model_values
from oee_tabular.estimators.limits import expected_rewards, population
from oee_tabular.estimators.magic import simplex_minimum
from oee_tabular.estimators.marginalized import total_discount
from oee_tabular.estimators.names import default_names, named_estimators
from oee_tabular.estimators.rollouts import rollout_horizon, segment_products

POLICY = np.array([[0.3, 0.7], [0.6, 0.4], [0.8, 0.2], [0.5, 0.5]])
BEHAVIOR = np.array([[0.5, 0.5], [0.5, 0.5], [0.4, 0.6], [0.5, 0.5]])
LIKELIHOOD = functools.partial(oee.transition_ratio, prior="none")


def environments(form=3, discount=0.9):
    """Three states that go on, one where it is over; rewards of ``form`` 2 = r(s, a) or 3 = r(s, a, s')."""
    rng = np.random.default_rng(form)
    rows = np.zeros((4, 2, 4))
    rows[:3] = rng.dirichlet(np.full(4, 3.0), (3, 2))
    rows[3, :, 3] = 1.0
    other = rows.copy()
    other[:3] = 0.6 * rows[:3] + 0.4 * rng.dirichlet(np.ones(4), (3, 2))
    rewards = np.zeros((4, 2, 4)[:form])
    rewards[:3] = rng.normal(size=rewards[:3].shape)
    simulator = FiniteMDP(rows, rewards, [0.5, 0.3, 0.2, 0.0], discount)
    return simulator, simulator.with_transitions(other)


def problem_of(form=3, horizon=None, n=30, length=6, **options):
    simulator, target = environments(form)
    log = oee.sample_episodes(target, BEHAVIOR, n, length, seed=1)
    return Problem(simulator, log, horizon=horizon, **options), target


def plain_episodes(log):
    """[(s, a, s', r), ...] of each episode, and whether it is over at its end."""
    starts = log.episode_starts
    return [
        (list(zip(log.state[i:j], log.action[i:j], log.next_state[i:j], log.reward[i:j], strict=True)),
         bool(log.terminated[j - 1] or log.next_state[j - 1] == 3))
        for i, j in zip(starts[:-1], starts[1:], strict=True)
    ]  # fmt: skip


def reweighted_zeta(simulator, target, factor):
    """A TransitionRatio whose rows sum to ``factor``."""
    true = oee.true_ratio(target, simulator)
    return oee.TransitionRatio(true.values * factor, "given", 0.0, true.visited, abs(factor - 1.0), true.counts)


# ---- what an estimate says ---------------------------------------------------------------------------------------

COVERAGE = {"unseen", "coverage", "fallback_share", "effective_sample_size"}
ONE_STEP = {"one_step_value", "one_step_standard_error", "unseen_standard_error", "one_step_distance", "model_value",
            "maximum_likelihood_value", "moved", "standard_error_if_centre_fits", "interval_method"}  # fmt: skip
LINEAR = {"error_bound", "method"}
KEYS = {
    "simulator": LINEAR,
    "oracle": LINEAR | {"largest_weight"},
    "oee": LINEAR | COVERAGE | ONE_STEP | {"gap", "row_sum_error", "largest_weight", "standard_error_of", "strength",
                                           "meaning"},
    "oee-product": {"gap", "standard_error_of", "n_rollouts", "effective_sample_size", "largest_weight", "mean_weight",
                    "row_sum_error"},
    "model-based": LINEAR | COVERAGE | {"standard_error_of", "single_share"},
    "pdis": {"standard_error_of", "n_episodes", "effective_sample_size", "largest_weight", "mean_weight", "truncated_share",
             "truncation_bias_bound", "foreign_starts_share"},
    "dr": COVERAGE | {"standard_error_of", "simulator_value", "gap"},
    "dr-beta": COVERAGE | {"standard_error_of", "simulator_value"},
    "dr-rollouts": {"standard_error_of", "n_rollouts", "gap"},
    "dr-episodes": {"standard_error_of", "n_episodes", "effective_sample_size", "largest_weight", "gap"},
    "magic": {"standard_error_of", "n_episodes", "effective_sample_size", "largest_weight", "share_of_model", "share_of_log",
              "gap"},
    "marginalized": COVERAGE | {"gap", "largest_weight", "mean_weight"},
    "dualdice": {"largest_weight", "largest_nu", "residual"},
}  # fmt: skip
OF = {"oee-product": "rollouts", "dr-rollouts": "rollouts"}


@pytest.mark.parametrize("name", KEYS)
def test_the_words_in_the_diagnostics(name):
    problem, target = problem_of()
    estimate = named_estimators([name], target)[name](problem, POLICY, seed=0)
    assert set(estimate.diagnostics) == KEYS[name]
    assert estimate.status == "ok"
    if name == "oee":
        error = 1.959963984540054 * estimate.standard_error
        assert_allclose(estimate.interval, (estimate.value - error, estimate.value + error), rtol=1e-12)
    else:
        assert estimate.interval is None
    if "standard_error_of" in KEYS[name]:
        assert estimate.diagnostics["standard_error_of"] == OF.get(name, "log")
        assert estimate.standard_error > 0
    else:
        assert estimate.standard_error is None
    if "method" in KEYS[name]:
        assert estimate.diagnostics["method"] == "dense LU"
        assert 0 <= estimate.diagnostics["error_bound"] < 1e-12
    if "n_rollouts" in KEYS[name]:
        assert estimate.diagnostics["n_rollouts"] == 100
    if "n_episodes" in KEYS[name]:
        assert estimate.diagnostics["n_episodes"] == 30
    if "gap" in KEYS[name]:
        assert 0 <= estimate.diagnostics["gap"] < 1e-9


def test_an_estimate_in_one_line():
    assert repr(Estimate(0.12345678)) == "Estimate(0.123457)"
    assert repr(Estimate(2.0, 0.25)) == "Estimate(2 ± 0.25 (standard error))"
    assert repr(Estimate(2.0, 0.25, status="too few")) == "Estimate(2 ± 0.25 (standard error), too few)"


def test_sizes_and_errors_of_small_samples():
    assert effective_sample_size(np.zeros(3)) == 0.0
    assert effective_sample_size(np.array([1.0, 3.0])) == 1.6
    assert mean_and_error(np.array([4.0])) == (4.0, None)
    assert mean_and_error(np.array([1.0, 3.0])) == (2.0, 1.0)


def test_short_names_and_what_they_stand_for():
    _, target = environments()
    expected = {
        "simulator": Simulator(),
        "oee": OffEnvironment(),
        "oee-product": OffEnvironment(evaluation="monte_carlo"),
        "oee-product-sn": OffEnvironment(evaluation="monte_carlo", self_normalized=True),
        "oee-trajectory": OffEnvironment(evaluation="monte_carlo", weighting="trajectory"),
        "ratio-of-ratios": OffEnvironment(ratio="ratio_of_ratios"),
        "model-based": ModelBased(),
        "is": ImportanceSampling(kind="trajectory"),
        "wis": ImportanceSampling(kind="trajectory", self_normalized=True),
        "pdis": ImportanceSampling(),
        "wpdis": ImportanceSampling(self_normalized=True),
        "dr": DoublyRobust(),
        "dr-beta": DoublyRobust(weights="beta"),
        "dr-rollouts": DoublyRobust(data="rollouts"),
        "dr-episodes": DoublyRobust(data="episodes"),
        "wdr": DoublyRobust(data="episodes", self_normalized=True),
        "magic": Magic(),
        "marginalized": Marginalized(),
        "dualdice": DualDice(),
        "oracle": Oracle(target),
        "oracle-product": Oracle(target, evaluation="monte_carlo"),
    }
    assert named_estimators(list(expected), target) == expected
    with pytest.raises(ValueError, match=r"^estimators must be among simulator, oee, .*, dualdice, oracle, oracle-product; "
                                         r"got 'q'$"):  # fmt: skip
        named_estimators(["q"])
    with pytest.raises(ValueError, match=r"^estimators must name at least one; it is empty$"):
        named_estimators([])
    with pytest.raises(ValueError, match=r"^estimator 'oracle-product' needs the target environment"):
        named_estimators(["oracle-product"])


def test_the_default_estimators_and_what_is_left_out():
    simulator, target = environments()
    log = oee.sample_episodes(target, BEHAVIOR, 5, 6, seed=1)
    bare = Transitions(**{k: v for k, v in log.columns().items() if k != "behavior_probability"})
    basic = ["simulator", "oee", "model-based"]
    assert default_names(Problem(simulator, log)) == ([*basic, "pdis", "wpdis"], [])
    assert default_names(Problem(simulator, bare, behavior_policy=BEHAVIOR)) == ([*basic, "pdis", "wpdis"], [])
    unknown = "Importance sampling is left out: the behaviour policy is not known."
    assert default_names(Problem(simulator, bare)) == (basic, [unknown])
    bag = log.draw(5, seed=0)
    assert default_names(Problem(simulator, bag)) == (
        basic,
        ["Importance sampling is left out: the log has no episodes."],
    )
    assert default_names(Problem(simulator, bag, episodes=log)) == ([*basic, "pdis", "wpdis"], [])


# ---- problems ----------------------------------------------------------------------------------------------------


def test_contradictions_of_the_log():
    """Rewards: rows, moves and the worst example; behaviour: rows whose probability is not the policy's."""
    simulator = FiniteMDP(np.full((2, 2, 2), 0.5), np.array([[1.0, 2.0], [3.0, 4.0]]), [1, 0], 0.9)
    log = Transitions(
        [0, 0, 1, 0], [0, 0, 1, 1], [0, 0, 1, 1], [1.5, 1.5, 9.0, 2.0], behavior_probability=[0.5, 0.4, 0.5, 0.5]
    )
    problem = Problem(simulator, log, behavior_policy=np.full((2, 2), 0.5))
    assert str(problem.reward_conflict) == (
        "the log's rewards contradict the simulator's in 3 of 4 transitions (2 different moves; "
        "s=1, a=1 -> s'=1 pays 9 in the log, 4 in the simulator)"
    )
    assert problem.behavior_conflict == 1
    assert Problem(simulator, log).behavior_conflict == 0
    whole = Transitions([0, 1], [0, 1], [1, 0], episode=[0, 0], behavior_probability=[0.5, 0.2])
    drawn = Problem(simulator, log, behavior_policy=np.full((2, 2), 0.25) * 2, episodes=whole)
    assert drawn.behavior_conflict == 1
    assert Problem(simulator, whole).reward_conflict is None
    assert_array_equal(problem.rewards_of(log), log.reward)
    assert_array_equal(problem.rewards_of(whole), [1.0, 4.0])
    near = Transitions([0], [0], [0], [1.0 + 5e-7])
    assert Problem(simulator, near).reward_conflict is None
    assert Problem(simulator, Transitions([0], [0], [0], [1.00001])).reward_conflict.rows == 1


def test_log_rewards_for_rewards_of_state_and_action():
    """The mean of the log's pay where a move was seen, r(s, a) elsewhere; rows s*A + a."""
    simulator = FiniteMDP(np.full((2, 2, 2), 0.5), np.array([[1.0, 3.0], [4.0, 6.0]]), [1, 0], 0.9)
    log = Transitions([0, 0, 0, 0], [1, 1, 1, 0], [0, 0, 0, 0], [5.0, 7.0, 9.0, 2.0])
    problem = Problem(simulator, log, rewards="log")
    assert_allclose(problem.model.transition_rewards.toarray(), [[2.0, 1.0], [7.0, 3.0], [4.0, 4.0], [6.0, 6.0]])
    assert Problem(simulator, log).model is simulator


def test_each_log_of_a_problem_is_checked_by_its_name():
    simulator, target = environments()
    log = oee.sample_episodes(target, BEHAVIOR, 5, 6, seed=1)
    far = Transitions([4], [0], [0])
    for name in ("log", "episodes", "simulator_data"):
        arguments = {"log": log} | {name: far}
        with pytest.raises(
            ValueError, match=rf"^{name}\.state\[0\] must be in 0\.\.3, the simulator's; it is 4 \(1 such rows"
        ):
            Problem(simulator, **arguments)
        with pytest.raises(ValueError, match=rf"^{name}\.next_state\[0\] must be in 0\.\.3"):
            Problem(simulator, **({"log": log} | {name: Transitions([0], [0], [4])}))
    with pytest.raises(ValueError, match=r"^episodes must be Transitions; got int$"):
        Problem(simulator, log, episodes=3)
    with pytest.raises(ValueError, match=r"^log must be Transitions; got NoneType$"):
        Problem(simulator, None)
    with pytest.raises(ValueError, match=r"^horizon must be a positive integer; it is 0$"):
        Problem(simulator, log, horizon=0)


def test_each_log_of_a_problem_is_led_to_where_termination_leads():
    """A terminated move into state 0 ends in state 1; a log without one is kept as it is."""
    rows = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    simulator = FiniteMDP(rows, [1.0, 0.0], [1, 0], 0.9, terminal_state=[1, 1])
    ended, going = Transitions([0], [0], [0], terminated=[True]), Transitions([0], [0], [0])
    problem = Problem(simulator, ended, simulator_data=ended, episodes=ended)
    for log in (problem.log, problem.episodes, problem.simulator_data):
        assert log.next_state.tolist() == [1]
        assert log.terminated.tolist() == [True]
    problem = Problem(simulator, going, simulator_data=going, episodes=going)
    assert problem.log is problem.episodes is problem.simulator_data is going
    assert Problem(simulator, going, simulator_data="exact").simulator_data == "exact"
    assert_array_equal(problem.counts.toarray(), [[1, 0], [0, 0]])


# ---- limits: every argument is checked, by every estimator --------------------------------------------------------

SIMULATOR, TARGET = environments()
EVERY = [
    Simulator(), OffEnvironment(), OffEnvironment(evaluation="monte_carlo"), ModelBased(), ModelBased("simulator"),
    ImportanceSampling(), DoublyRobust(), DoublyRobust(data="rollouts"), DoublyRobust(data="episodes"), Magic(),
    Marginalized(), DualDice(),
]  # fmt: skip
FULL = np.full((4, 2), 1 / 8)
ARGUMENTS = {
    "simulator": ({"simulator": 3}, r"^simulator must be a FiniteMDP; got int$"),
    "target": ({"target": 3}, r"^target must be a FiniteMDP; got int$"),
    "policy": ({"policy": POLICY * 2}, r"^policy\[0\] must sum to 1"),
    "data": ({"data_distribution": FULL * 2}, r"^data_distribution must sum to 1"),
    "behaviour": ({"behavior_policy": BEHAVIOR * 2}, r"^behavior_policy\[0\] must sum to 1"),
    "horizon": ({"horizon": 0}, r"^horizon must be a positive integer; it is 0$"),
    "size": ({"target": FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 0.9)},
             r"^target and simulator must have the same states and actions; .* shapes \(1, 1\) and \(8, 4\)$"),
}  # fmt: skip


@pytest.mark.parametrize("name", ARGUMENTS)
@pytest.mark.parametrize("estimator", EVERY, ids=repr)
def test_bad_arguments_of_limits(estimator, name):
    changed, text = ARGUMENTS[name]
    if isinstance(estimator, DualDice) and name == "horizon":
        return  # it has none
    arguments = {"simulator": SIMULATOR, "target": TARGET, "policy": POLICY} | changed
    with pytest.raises(ValueError, match=text):
        estimator.limit(**arguments)


def test_populations():
    """Uniform data where none are given; the support; counts; models; zeta on the support."""
    people = population(SIMULATOR, TARGET, POLICY)
    assert_array_equal(people.distribution, FULL)
    assert people.support.all()
    assert people.behavior is None
    share = FULL.copy()
    share[1], share[0] = 0.0, 0.25
    part = population(SIMULATOR, TARGET, POLICY, data_distribution=share, behavior_policy=BEHAVIOR, horizon=3)
    assert_array_equal(part.support, share.reshape(-1) > 0)
    assert_array_equal(part.behavior, BEHAVIOR)
    assert part.horizon == 3
    counts = part.counts().toarray().reshape(4, 2, 4)
    assert_allclose(counts, 1e12 * share[:, :, None] * dense(TARGET)[0])
    mixed = part.model(SIMULATOR.transitions)
    keep = share[:, :, None] > 0
    assert_allclose(dense(mixed)[0], np.where(keep, dense(TARGET)[0], dense(SIMULATOR)[0]))
    assert_allclose(part.value(mixed), oee.policy_value(mixed, POLICY, horizon=3))
    zeta = oee.ratio.Conditional(prior="simulator").limit(part).toarray().reshape(4, 2, 4)
    true = oee.true_ratio(TARGET, SIMULATOR).values.toarray().reshape(4, 2, 4)
    assert_allclose(zeta, np.where(keep, true, 1.0 * (dense(SIMULATOR)[0] > 0)))
    assert_allclose(
        expected_rewards(SIMULATOR, TARGET.transitions),
        (dense(TARGET)[0] * dense(SIMULATOR)[1]).sum(axis=2).reshape(-1),
    )
    flat = environments(2)[0]
    assert_array_equal(expected_rewards(flat, TARGET.transitions), flat.rewards.reshape(-1))


@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("form", [2, 3])
def test_limits_where_the_data_miss_a_row(form, horizon):
    """The fallbacks of the model: the row stays where it is and pays r(s, a, s), else r(s, a); or moves as the simulator."""
    simulator, target = environments(form)
    share = FULL.copy()
    share[1, 0], share[1, 1] = 0.0, 0.25
    rows, options = dense(target)[0].copy(), {"data_distribution": share, "horizon": horizon}
    pay = expected_rewards(simulator, target.transitions).reshape(4, 2).copy()
    own = simulator.transition_rewards
    pay[1, 0] = simulator.rewards[1, 0] if own is None else own[[2]].toarray()[0, 1]
    rows[1, 0] = np.eye(4)[1]
    stay = FiniteMDP(rows, pay, simulator.initial, simulator.discount)
    limit = ModelBased().limit(simulator, target, POLICY, **options)
    assert_allclose(limit, oee.policy_value(stay, POLICY, horizon=horizon), rtol=1e-12)
    rows[1, 0] = dense(simulator)[0][1, 0]
    moves = oee.policy_value(simulator.with_transitions(rows), POLICY, horizon=horizon)
    assert_allclose(ModelBased("simulator").limit(simulator, target, POLICY, **options), moves, rtol=1e-12)
    if horizon is None:
        assert_allclose(DualDice().limit(simulator, target, POLICY, data_distribution=share), moves, rtol=1e-12)
    assert_allclose(
        Simulator().limit(simulator, target, POLICY, **options), oee.policy_value(simulator, POLICY, horizon=horizon)
    )


def test_the_oracle_s_limit_is_its_own_target_s():
    simulator, target = environments()
    zeta = oee.true_ratio(target, simulator)
    assert_allclose(Oracle(target).limit(simulator, simulator, POLICY), oee.policy_value(target, POLICY))
    assert_allclose(
        Oracle(target).limit(simulator, simulator, POLICY, horizon=3), oee.policy_value(target, POLICY, horizon=3)
    )
    oracle = Oracle(target, "monte_carlo", "trajectory", self_normalized=True)
    expected = oee.weighted_return_moments(simulator, zeta, POLICY, kind="trajectory", self_normalized=True, horizon=3)
    assert_allclose(oracle.limit(simulator, simulator, POLICY, horizon=3), expected.mean, rtol=1e-10)


def test_limits_of_importance_sampling_without_the_finished():
    """gamma^t E[rho r_t] / E[rho 1{going at t}], term by term."""
    simulator, target = environments(2)
    transitions, alive = dense(target)[0], np.array([1.0, 1, 1, 0])
    found, reached = 0.0, target.initial
    for t in range(5):
        paid = reached @ (POLICY * target.rewards).sum(axis=1)
        found += 0.9**t * paid / (reached @ alive)
        reached = np.einsum("s,sa,sat->t", reached, POLICY, transitions)
    estimator = ImportanceSampling(self_normalized=True, ragged="zero")
    limit = estimator.limit(simulator, target, POLICY, behavior_policy=BEHAVIOR, horizon=5)
    assert_allclose(limit, found, rtol=1e-12)
    guessed = ImportanceSampling(self_normalized=True, ragged="zero", behavior="estimated")
    assert_allclose(guessed.limit(simulator, target, POLICY, behavior_policy=BEHAVIOR, horizon=5), found, rtol=1e-12)
    assert_allclose(estimator.limit(simulator, target, POLICY, horizon=5), found, rtol=1e-12)  # any policy with support
    lacking = BEHAVIOR.copy()
    lacking[1] = [1.0, 0.0]  # what it never does is lost: weights there are 0
    kept = POLICY * (lacking > 0)
    found, reached = 0.0, target.initial
    for t in range(5):
        found += 0.9**t * (reached @ (kept * target.rewards).sum(axis=1)) / (reached @ (alive * kept.sum(axis=1)))
        reached = np.einsum("s,sa,sat->t", reached, np.where(alive[:, None] > 0, kept, POLICY), transitions)
    assert_allclose(estimator.limit(simulator, target, POLICY, behavior_policy=lacking, horizon=5), found, rtol=1e-12)
    for options in ({"kind": "trajectory"}, {"ragged": "pad"}):
        other = ImportanceSampling(**({"self_normalized": True, "ragged": "zero"} | options))
        limit = other.limit(simulator, target, POLICY, behavior_policy=BEHAVIOR, horizon=5)
        assert_allclose(limit, oee.policy_value(target, POLICY, horizon=5), rtol=1e-12)


def test_the_limit_on_episodes_without_support_is_what_the_model_makes_of_the_rest():
    """D = V + sum over the actions that are taken of pi (r + gamma P' D' - Q), backwards."""
    simulator, target = environments(2)
    lacking = BEHAVIOR.copy()
    lacking[1] = [1.0, 0.0]
    kept = np.where(lacking > 0, POLICY, 0.0)
    ahead = np.zeros(4)
    for left in range(1, 5):
        v, q = (f(simulator, POLICY, horizon=left) for f in (oee.state_values, oee.action_values))
        ahead = v + (kept * (target.rewards + 0.9 * dense(target)[0] @ ahead - q)).sum(axis=1)
    options = {"behavior_policy": lacking, "horizon": 4}
    estimator = DoublyRobust(data="episodes", ratio=oee.true_ratio(simulator, simulator))
    assert_allclose(estimator.limit(simulator, target, POLICY, **options), target.initial @ ahead, rtol=1e-10)
    truth = oee.policy_value(target, POLICY, horizon=4)
    assert abs(target.initial @ ahead - truth) > 1e-3
    assert_allclose(estimator.limit(simulator, target, POLICY, horizon=4), truth)


# ---- importance sampling -----------------------------------------------------------------------------------------


def sampled_value(episodes, ratios, multiplicity, gamma, horizon, *, pad, kind):
    """The self-normalised value of episodes that count as often as ``multiplicity`` says, in the plainest way."""
    longest = max(min(len(steps), horizon) for steps, _ in episodes)
    products = [np.cumprod(r[:horizon]) for r in ratios]
    if kind == "trajectory":
        weights = np.array([p[-1] for p in products]) * multiplicity
        returns = [sum(gamma**t * step[3] for t, step in enumerate(steps[:horizon])) for steps, _ in episodes]
        return weights @ np.array(returns) / weights.sum()
    value = 0.0
    for t in range(longest):
        above = below = 0.0
        for k, (steps, _) in enumerate(episodes):
            if t < len(products[k]):
                above += multiplicity[k] * products[k][t] * steps[t][3]
                below += multiplicity[k] * products[k][t]
            elif pad:
                below += multiplicity[k] * products[k][-1]
        value += gamma**t * above / below
    return value


@pytest.mark.parametrize("horizon", [None, 3])
@pytest.mark.parametrize(("kind", "ragged"), [("per_decision", "pad"), ("per_decision", "zero"), ("trajectory", "pad")])
def test_the_error_of_self_normalised_values_is_the_derivative_in_each_episode(kind, ragged, horizon):
    """Values and infinitesimal jackknife, by central differences in how often each episode counts."""
    problem, _ = problem_of(2, horizon=horizon, n=12)
    episodes = plain_episodes(problem.log)
    ratios = [[POLICY[s, a] / BEHAVIOR[s, a] for s, a, _, _ in steps] for steps, _ in episodes]
    n, step = len(episodes), 1e-5
    value = functools.partial(
        sampled_value, episodes, ratios, gamma=0.9, horizon=horizon or 99, pad=ragged == "pad", kind=kind
    )
    influence = np.array(
        [n * (value(np.ones(n) + step * unit) - value(np.ones(n) - step * unit)) / (2 * step) for unit in np.eye(n)]
    )
    found = ImportanceSampling(kind, self_normalized=True, ragged=ragged)(problem, POLICY)
    assert_allclose(found.value, value(np.ones(n)), rtol=1e-12)
    assert_allclose(found.standard_error, influence.std(ddof=1) / np.sqrt(n), rtol=1e-6)
    last = np.array([np.prod(r[: horizon or 99]) for r in ratios])
    facts = found.diagnostics
    assert_allclose(facts["mean_weight"], last.mean())
    assert_allclose(facts["effective_sample_size"], last.sum() ** 2 / (last**2).sum())
    every = np.concatenate([np.cumprod(r[: horizon or 99]) for r in ratios])
    assert_allclose(facts["largest_weight"], last.max() if kind == "trajectory" else every.max())
    cut = np.array([not over and len(steps) < (horizon or 99) for steps, over in episodes])
    assert_allclose(facts["truncated_share"], cut.mean())
    if horizon is None:
        assert 0 < cut.sum() < n
        sizes = np.array([len(steps) for steps, _ in episodes])
        largest = max(np.abs(problem.log.reward).max(), np.abs(problem.simulator.rewards).max())
        bound = (last * largest * 0.9**sizes / 0.1)[cut].sum()
        assert_allclose(facts["truncation_bias_bound"], bound / last.sum(), rtol=1e-12)
        plain = ImportanceSampling(kind)(problem, POLICY).diagnostics["truncation_bias_bound"]
        assert_allclose(plain, bound / n, rtol=1e-12)


def test_the_truncation_bound_with_a_horizon_or_without_a_discount():
    """Cut after 2 of 5 steps at 0.5: 3 * (1/4 + 1/8 + 1/16); at discount 1: 3 * 3."""
    rows = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])
    mdp = FiniteMDP(rows, np.array([1.0, -3.0]), [1, 0], 0.5)
    log = Transitions([0, 1], [0, 0], [1, 0], [1.0, -3.0], episode=[0, 0], behavior_probability=[1.0, 1.0])
    for model, bound in ((mdp, 3 * (1 / 4 + 1 / 8 + 1 / 16)), (mdp.with_discount(1.0), 9.0)):
        facts = ImportanceSampling()(Problem(model, log, horizon=5), np.ones((2, 1))).diagnostics
        assert_allclose(facts["truncation_bias_bound"], bound)
        assert facts["truncated_share"] == 1.0
    facts = ImportanceSampling()(Problem(mdp, log, horizon=2), np.ones((2, 1))).diagnostics
    assert (facts["truncated_share"], facts["truncation_bias_bound"]) == (0.0, 0.0)
    assert facts["foreign_starts_share"] == 0.0
    away = Transitions([1, 0], [0, 0], [0, 1], [1.0, 1.0], episode=[0, 1], behavior_probability=[1.0, 1.0])
    assert (
        ImportanceSampling()(Problem(mdp, away, horizon=1), np.ones((2, 1))).diagnostics["foreign_starts_share"] == 0.5
    )


def test_one_deciding_episode_has_no_error():
    """Two episodes, one of weight 0: the self-normalised value is the other's return, without a standard error."""
    mdp = FiniteMDP(np.full((1, 2, 1), 1.0), np.array([[2.0, 5.0]]), [1.0], 0.9)
    log = Transitions([0, 0], [0, 1], [0, 0], [2.0, 5.0], episode=[0, 1], behavior_probability=[0.5, 0.5])
    only = np.array([[1.0, 0.0]])
    found = ImportanceSampling(self_normalized=True)(Problem(mdp, log, horizon=1), only)
    assert (found.value, found.standard_error, found.status) == (2.0, None, "ok")
    plain = ImportanceSampling()(Problem(mdp, log, horizon=1), only)
    assert (plain.value, plain.standard_error) == (2.0, 2.0)
    both = ImportanceSampling(self_normalized=True)(Problem(mdp, log, horizon=1), np.array([[0.5, 0.5]]))
    assert both.standard_error is not None


def test_without_any_weight_no_bias_is_bounded_and_no_part_is_known():
    """Self-normalised, all weights 0: no value, a bound of 0, and doubly robust parts that are nan."""
    simulator, target = environments(2)
    log = oee.sample_episodes(target, np.tile([1.0, 0.0], (4, 1)), 5, 2, seed=0)
    never = np.tile([0.0, 1.0], (4, 1))
    problem = Problem(simulator, log)
    for kind in ("trajectory", "per_decision"):
        found = ImportanceSampling(kind, self_normalized=True)(problem, never)
        assert np.isnan(found.value)
        assert found.standard_error is None
        assert found.diagnostics["truncated_share"] > 0
        assert found.diagnostics["truncation_bias_bound"] == 0.0
        assert found.status == (
            "the weight of every whole episode is 0: none of the log is one that the policy could have made"
        )
    terms = episode_terms(problem, never, simulator, self_normalized=True)
    assert np.isnan(terms.total)
    assert terms.error is None
    assert_array_equal(terms.values, np.full(5, np.nan))
    assert_array_equal(terms.partial, np.full((5, 3), np.nan))
    assert_array_equal(terms.last, np.zeros(5))
    plain = episode_terms(problem, never, simulator, self_normalized=False)
    assert np.isfinite(plain.total)
    for estimator in (DoublyRobust(data="episodes", self_normalized=True), Magic()):
        found = estimator(problem, never)
        assert np.isnan(found.value)
        assert "weight" in found.status
        assert "is 0" in found.status


def test_frequencies_stand_in_for_the_behaviour_policy():
    mdp = FiniteMDP(np.full((1, 2, 1), 1.0), np.array([[2.0, 5.0]]), [1.0], 0.9)
    log = Transitions([0, 0, 0, 0], [0, 1, 0, 0], [0] * 4, [2.0, 5.0, 2.0, 2.0], episode=[0, 1, 2, 3])
    found = ImportanceSampling(behavior="estimated")(Problem(mdp, log, horizon=1), np.array([[0.5, 0.5]]))
    assert_allclose(found.value, (3 * 2.0 * 0.5 / 0.75 + 5.0 * 0.5 / 0.25) / 4)
    with pytest.raises(ValueError, match=r"^importance sampling needs whole episodes: give the log its episode column, or "
                                         r"Problem\(episodes=\.\.\.\)$"):  # fmt: skip
        ImportanceSampling().ratios(Problem(mdp, Transitions([0], [0], [0])), np.array([[0.5, 0.5]]))


# ---- products of ratios on rollouts ------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("weighting", ["per_decision", "trajectory"])
@pytest.mark.parametrize("horizon", [None, 4])
def test_a_product_is_the_mean_over_its_rollouts(form, weighting, horizon):
    """The same rollouts, gone through move by move; and what is said of their weights."""
    problem, target = problem_of(form, horizon=horizon)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.1)
    steps = horizon or rollout_horizon(0.9, None)
    log = oee.sample_returns(simulator, POLICY, 40, steps, seed=np.random.default_rng(5), record=True).log
    table = zeta.values.toarray().reshape(4, 2, 4)
    totals, lasts, every = [], [], []
    for moves, _ in plain_episodes(log):
        ratios = np.array([table[s, a, j] for s, a, j, _ in moves])
        after = np.cumprod(ratios)
        weights = after if form == 3 else np.concatenate([[1.0], after[:-1]])
        last = after[-1] if form == 3 or len(moves) < steps else weights[-1]
        if weighting == "trajectory":
            weights = np.full(len(moves), last)
        totals.append(sum(0.9**t * weights[t] * r for t, (_, _, _, r) in enumerate(moves)))
        lasts.append(last)
        every.append(weights.max())
    estimator = OffEnvironment(zeta, "monte_carlo", weighting, n_rollouts=40)
    found = estimator(problem, POLICY, seed=5)
    assert_allclose(found.value, np.mean(totals), rtol=1e-10)
    assert_allclose(found.standard_error, np.std(totals, ddof=1) / np.sqrt(40), rtol=1e-10)
    facts, lasts = found.diagnostics, np.array(lasts)
    assert facts["n_rollouts"] == 40
    assert_allclose(facts["effective_sample_size"], lasts.sum() ** 2 / (lasts**2).sum())
    assert_allclose(facts["largest_weight"], np.max(every))
    assert_allclose(facts["mean_weight"], lasts.mean())
    assert_allclose(facts["row_sum_error"], 0.1)
    oracle = Oracle(target, "monte_carlo", weighting, n_rollouts=40)(problem, POLICY, seed=np.random.default_rng(5))
    true = OffEnvironment(oee.true_ratio(target, simulator), "monte_carlo", weighting, n_rollouts=40)(
        problem, POLICY, seed=5
    )
    assert (oracle.value, oracle.standard_error) == (true.value, true.standard_error)
    normalised = Oracle(target, "monte_carlo", weighting, self_normalized=True, n_rollouts=40)(problem, POLICY, seed=5)
    assert normalised.value != oracle.value


def test_products_within_episodes():
    found = segment_products(np.array([2.0, 3.0, 0.0, 5.0, 7.0, 4.0]), np.array([0, 2, 5, 6]))
    assert_array_equal(found, [2, 6, 0, 0, 0, 4])


# ---- doubly robust -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("weights", ["occupancy", "beta"])
def test_doubly_robust_on_transitions_row_by_row(form, horizon, weights):
    """J_sim + sum_x visits(x) (frequencies - P) (r + gamma V), its error, and the log's coverage."""
    problem, target = problem_of(form, horizon=horizon, n=8)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.0)
    where = exact.reweight(simulator, zeta) if weights == "occupancy" else simulator
    gradient = exact.transition_gradient(where, POLICY, horizon=horizon, values_of=simulator)
    table = np.zeros((8, 4))
    stored = simulator.transitions.tocoo()
    table[stored.coords] = gradient
    counts = problem.counts.toarray()
    n = counts.sum(axis=1)
    value, variance = oee.policy_value(simulator, POLICY, horizon=horizon), 0.0
    for x in np.flatnonzero(n):
        frequency = counts[x] / n[x]
        value += (frequency - simulator.transitions.toarray()[x]) @ table[x]
        variance += frequency @ (table[x] - frequency @ table[x]) ** 2 / n[x]
    found = DoublyRobust(ratio=zeta, weights=weights)(problem, POLICY)
    assert (n == 0).any()
    assert_allclose(found.value, value, rtol=1e-10)
    assert_allclose(found.standard_error, np.sqrt(variance), rtol=1e-10)
    facts = found.diagnostics
    assert_allclose(facts["simulator_value"], oee.policy_value(simulator, POLICY, horizon=horizon))
    time = oee.occupancy(where, POLICY, horizon=horizon).copy()
    time[3] = 0.0  # it is over there: nothing to learn
    seen = n.reshape(4, 2) > 0
    share = time[seen].sum() / time.sum()
    assert_allclose((facts["coverage"], facts["fallback_share"]), (share, 1 - share), atol=1e-12)
    size = time[seen].sum() ** 2 / (time[seen] ** 2 / n.reshape(4, 2)[seen]).sum()
    assert_allclose(facts["effective_sample_size"], size)
    missed = sorted(((-time[s, a], s, a) for s, a in np.argwhere(~seen) if time[s, a] > 0))[:3]
    assert facts["unseen"] == "; ".join(f"s={s}, a={a}" for _, s, a in missed)


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
def test_doubly_robust_on_rollouts_move_by_move(form, horizon):
    """D_t = m_t + zeta (r + gamma D_t+1 - (r + gamma V)) of each rollout, backwards."""
    problem, target = problem_of(form, horizon=horizon)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.1)
    steps = horizon or rollout_horizon(0.9, None)
    log = oee.sample_returns(simulator, POLICY, 25, steps, seed=np.random.default_rng(7), record=True).log
    table = zeta.values.toarray().reshape(4, 2, 4)
    transitions, rewards = dense(simulator)
    values = [
        np.zeros(4) if t >= steps else oee.state_values(simulator, POLICY, horizon=horizon and horizon - t)
        for t in range(steps + 1)
    ]
    found = []
    for moves, _ in plain_episodes(log):
        ahead = 0.0
        for t in range(len(moves) - 1, -1, -1):
            s, a, j, r = moves[t]
            u = values[t + 1] if t + 1 < steps else np.zeros(4)
            known = (table[s, a] * transitions[s, a]) @ (0.9 * u + (rewards[s, a] if form == 3 else 0.0))
            ahead = known + (0.0 if form == 3 else r) + table[s, a, j] * 0.9 * (ahead - u[j])
        found.append(ahead)
    estimate = DoublyRobust(data="rollouts", ratio=zeta, n_rollouts=25)(problem, POLICY, seed=7)
    assert_allclose(estimate.value, np.mean(found), rtol=1e-9)
    assert_allclose(estimate.standard_error, np.std(found, ddof=1) / 5, rtol=1e-9)
    assert estimate.diagnostics == {"standard_error_of": "rollouts", "n_rollouts": 25, "gap": 0.0}


@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("self_normalized", [False, True])
def test_doubly_robust_on_episodes_step_by_step(horizon, self_normalized):
    """V(s_0) + sum_t gamma^t [share_t+1 (r_t - Q) + share_t V ...] with the model's rest, and all its partial sums."""
    problem, target = problem_of(3, horizon=horizon, n=15, length=5)
    model = exact.reweight(problem.simulator, reweighted_zeta(problem.simulator, target, 1.0))
    episodes = plain_episodes(problem.log)
    n, steps = len(episodes), min(max(len(moves) for moves, _ in episodes), horizon or 99)
    v, q = model_values(model, POLICY, horizon, steps)
    for t in range(steps):
        left = horizon and horizon - t
        assert_allclose(v[t], oee.state_values(model, POLICY, horizon=left), rtol=1e-10)
        assert_allclose(q[t], oee.action_values(model, POLICY, horizon=left), rtol=1e-10)
    assert_array_equal(v[steps], np.zeros(4)) if horizon == steps else None
    products = np.ones((n, steps + 1))
    for k, (moves, _) in enumerate(episodes):
        for t in range(steps):
            inside = t < len(moves)
            products[k, t + 1] = products[k, t] * (POLICY[moves[t][:2]] / BEHAVIOR[moves[t][:2]] if inside else 1.0)
    shares = products / products.sum(axis=0) if self_normalized else products / n
    partial = np.zeros((n, steps + 1))
    for k, (moves, over) in enumerate(episodes):
        for j in range(steps + 1):
            used = min(j, len(moves))
            total = sum(
                0.9**t * (shares[k, t + 1] * (r - q[t][s, a]) + shares[k, t] * v[t][s])
                for t, (s, a, _, r) in enumerate(moves[:used])
            )
            state = moves[0][0] if used == 0 else moves[used - 1][2]
            gone = used == len(moves) and over
            if not gone and (horizon is None or used < horizon):
                total += 0.9**used * shares[k, used] * v[used][state]
            partial[k, j] = total
    found = episode_terms(problem, POLICY, model, self_normalized=self_normalized)
    assert_allclose(found.partial, partial, rtol=1e-9, atol=1e-12)
    assert_allclose(found.total, partial[:, -1].sum(), rtol=1e-9)
    assert_allclose(found.values, n * partial[:, -1], rtol=1e-9, atol=1e-12)
    ends = np.array([products[k, min(steps, len(moves))] for k, (moves, _) in enumerate(episodes)])
    assert_allclose(found.last, ends, rtol=1e-12)
    mean = partial[:, -1].sum() / n
    error = np.sqrt(n / (n - 1) * ((partial[:, -1] - mean) ** 2).sum())
    assert_allclose(found.error, error, rtol=1e-9)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    estimate = DoublyRobust(data="episodes", ratio=zeta, self_normalized=self_normalized)(problem, POLICY)
    assert_allclose((estimate.value, estimate.standard_error), (found.total, error), rtol=1e-9)
    assert_allclose(estimate.diagnostics["effective_sample_size"], ends.sum() ** 2 / (ends**2).sum())
    assert_allclose(estimate.diagnostics["largest_weight"], ends.max())


def test_magic_weighs_the_distance_of_a_wrong_model():
    """The simulator for a model, far from the log: its bias is its distance from the bootstrap's central half."""
    rows = np.array([[[0.9, 0.1]], [[0.1, 0.9]]])
    simulator = FiniteMDP(rows, np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), [1, 0], 0.9)
    target = simulator.with_transitions(np.array([[[0.55, 0.45]], [[0.3, 0.7]]]))
    log = oee.sample_episodes(target, np.ones((2, 1)), 12, 4, seed=2)
    problem, zeta = Problem(simulator, log, horizon=4), oee.true_ratio(simulator, simulator)
    parts = episode_terms(problem, np.ones((2, 1)), simulator, self_normalized=True).partial[:, [0, -1]]
    totals, n = parts.sum(axis=0), 12
    draws = np.random.default_rng(5).integers(0, n, size=(30, n))
    low, high = np.quantile(parts[:, 1][draws].sum(axis=1), [0.25, 0.75])
    bias = np.array([max(low - totals[0], totals[0] - high, 0.0), max(low - totals[1], totals[1] - high, 0.0)])
    assert bias[0] > 0.1
    matrix = n / (n - 1) * (parts - totals / n).T @ (parts - totals / n) + np.outer(bias, bias)
    share = np.linalg.solve(matrix, np.ones(2))
    share = np.clip(share / share.sum(), 0, 1)
    found = Magic(ratio=zeta, n_lengths=2, n_bootstrap=30)(problem, np.ones((2, 1)), seed=5)
    assert 0.0 < share[0] < 1.0
    assert_allclose(found.value, share @ totals, rtol=1e-6)


def resampled(problem, draws, zeta):
    """Weighted doubly robust of logs in which the drawn episodes stand, each as often as it was drawn."""
    log, found = problem.log, []
    starts, columns = log.episode_starts, log.columns()
    for draw in draws:
        rows = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in draw])
        parts = {name: column[rows] for name, column in columns.items()}
        parts["episode"] = np.repeat(np.arange(len(draw)), [starts[i + 1] - starts[i] for i in draw])
        again = Problem(problem.simulator, Transitions(**parts), horizon=problem.horizon, behavior_policy=BEHAVIOR)
        found.append(DoublyRobust(data="episodes", ratio=zeta, self_normalized=True)(again, POLICY).value)
    return np.array(found)


def test_magic_normalises_the_weights_of_each_resample():
    """Thomas and Brunskill's bootstrap: g_T of the resample itself, not sums of the log's own shares."""
    problem, target = problem_of(3, horizon=4, n=15)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    terms = episode_terms(problem, POLICY, exact.reweight(problem.simulator, zeta), self_normalized=True)
    draws = np.random.default_rng(3).integers(0, 15, size=(20, 15))
    expected = resampled(problem, draws, zeta)
    assert_allclose(terms.resampled(draws), expected, rtol=1e-10)
    assert_allclose(terms.resampled(np.arange(15)[None]), terms.total, rtol=1e-12)
    assert np.abs(terms.partial[:, -1][draws].sum(axis=1) - expected).max() > 0.01  # the two differ


def test_magic_between_the_model_and_the_log():
    """Two lengths: the weights minimise variance plus squared distance from the central half, checked on a grid."""
    problem, target = problem_of(3, horizon=4, n=15)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    found = Magic(ratio=zeta, n_lengths=2, n_bootstrap=50)(problem, POLICY, seed=3)
    parts = episode_terms(problem, POLICY, exact.reweight(problem.simulator, zeta), self_normalized=True).partial[
        :, [0, -1]
    ]
    totals, n = parts.sum(axis=0), 15
    covariance = n / (n - 1) * (parts - totals / n).T @ (parts - totals / n)
    draws = np.random.default_rng(3).integers(0, n, size=(50, n))
    low, high = np.quantile(resampled(problem, draws, zeta), [0.25, 0.75])
    bias = np.maximum(np.maximum(totals - high, low - totals), 0)
    matrix = covariance + np.outer(bias, bias)
    x = np.linspace(0, 1, 20_001)
    costs = matrix[0, 0] * x**2 + 2 * matrix[0, 1] * x * (1 - x) + matrix[1, 1] * (1 - x) ** 2
    best = np.array([x[costs.argmin()], 1 - x[costs.argmin()]])
    assert_allclose([found.diagnostics["share_of_model"], found.diagnostics["share_of_log"]], best, atol=1e-4)
    assert_allclose(found.value, best @ totals, atol=1e-3)
    assert_allclose(found.standard_error, np.sqrt(best @ covariance @ best), rtol=1e-2)
    alone = Magic(ratio=zeta, n_lengths=1)(problem, POLICY, seed=3)
    starts = problem.log.episode_starts
    begun = oee.state_values(target, POLICY, horizon=4)[problem.log.state[starts[:-1]]]
    assert_allclose(alone.value, begun.mean(), rtol=1e-12)  # the model, from where the log's episodes start
    first = Transitions(**{k: c[: starts[1]] for k, c in problem.log.columns().items()})
    single = Magic(ratio=zeta)(Problem(problem.simulator, first, horizon=4), POLICY)
    assert np.isnan(single.value)
    assert single.status == "the blend needs at least 2 episodes"
    assert_allclose(simplex_minimum(np.diag([1.0, 3.0])), [0.75, 0.25])
    assert_allclose(simplex_minimum(np.zeros((2, 2))).sum(), 1.0)


# ---- marginalised ------------------------------------------------------------------------------------------------


def test_sums_of_discounts():
    assert_allclose(total_discount(0.5, None), 2.0)
    assert_allclose(total_discount(0.5, 3), 1.75)
    assert total_discount(1.0, 3) == 3.0


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
def test_marginalised_values_row_by_row(form, horizon):
    """sum_x d_target(x) rbar(x) over the rows of the log, rbar its mean pay: beta cancels where there is no box."""
    problem, target = problem_of(form, horizon=horizon, n=8)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.0)
    there, here = (oee.occupancy(m, POLICY, horizon=horizon).reshape(-1) for m in (target, simulator))
    rows = problem.log.state * 2 + problem.log.action
    n = np.bincount(rows, minlength=8)
    paid = np.bincount(rows, problem.log.reward, minlength=8) / np.maximum(n, 1)
    mass = 10.0 if horizon is None else (1 - 0.9**4) / 0.1
    found = Marginalized(ratio=zeta)(problem, POLICY)
    seen, share = n > 0, n / n.sum()
    assert_allclose(found.value, mass * (there * paid)[seen].sum(), rtol=1e-9)
    weights = np.where(seen, there / np.maximum(share, 1e-300), 0.0)
    assert_allclose(found.diagnostics["largest_weight"], weights.max(), rtol=1e-9)
    assert_allclose(found.diagnostics["mean_weight"], share @ weights, rtol=1e-9)
    boxed = Marginalized(ratio=zeta, lower=0.8, upper=1.2)(problem, POLICY)
    beta = np.clip(
        here[seen] / share[seen], 0.8, 1.2
    )  # not the fit's own: that is beta / (the time where the log has rows)
    expected = mass * (share[seen] * beta * there[seen] / np.maximum(here[seen], 1e-300) * paid[seen]).sum()
    assert_allclose(boxed.value, expected, rtol=1e-9)
    limit = Marginalized(ratio=zeta).limit(simulator, target, POLICY, data_distribution=FULL, horizon=horizon)
    assert_allclose(limit, oee.policy_value(target, POLICY, horizon=horizon), rtol=1e-9)


def test_dualdice_against_dense_equations():
    """nu from B^T D B nu = (1 - gamma) mu_0 pi; w = B nu."""
    problem, _ = problem_of(2, n=60)
    simulator = problem.simulator
    model = ModelBased("simulator").model(problem)
    ahead = np.einsum("xt,tb->xtb", model.transitions.toarray(), POLICY).reshape(8, 8)
    b = np.eye(8) - 0.9 * ahead
    base = np.diag(oee.occupancy(simulator, POLICY).reshape(-1))
    nu = np.linalg.solve(b.T @ base @ b, 0.1 * (simulator.initial[:, None] * POLICY).reshape(-1))
    found = DualDice()(problem, POLICY)
    assert_allclose(found.diagnostics["largest_nu"], np.abs(nu).max(), rtol=1e-6)
    assert_allclose(found.diagnostics["largest_weight"], (b @ nu).max(), rtol=1e-6)
    assert found.diagnostics["residual"] < 1e-12
    assert_allclose(found.value, oee.policy_value(model, POLICY), rtol=1e-9)
    endless = Problem(simulator.with_discount(1.0), problem.log)
    with pytest.raises(ValueError, match=r"^discount must be below 1 for DualDICE; it is 1$"):
        DualDice()(endless, POLICY)


# ---- models and off-environment evaluation -----------------------------------------------------------------------


def test_models_of_the_log_pay_what_the_simulator_pays():
    """r(s, a, s') on the moves seen and on staying, which "stay" makes up; the row's mean where staying has no reward."""
    simulator, _ = environments(3)
    problem = Problem(simulator, Transitions([0, 0, 1], [0, 0, 1], [1, 2, 1]))
    own = dense(simulator)[1]
    stay = ModelBased().model(problem)
    rows, pay = dense(stay)
    assert_allclose(rows[0, 0], [0, 0.5, 0.5, 0])
    assert_allclose(rows[1, 0], [0, 1, 0, 0])
    assert_allclose(pay[0, 0, 1:3], own[0, 0, 1:3])
    assert_allclose(pay[1, 0, 1], own[1, 0, 1])
    assert_allclose(pay[1, 1, 1], own[1, 1, 1])
    rows, undefined = dense(simulator)[0], own.copy()
    rows[1, 0], undefined[1, 0, 1] = [0.5, 0.0, 0.5, 0.0], np.nan
    without = FiniteMDP(rows, undefined, simulator.initial, simulator.discount)
    moved = ModelBased().model(Problem(without, Transitions([0, 0, 1], [0, 0, 1], [1, 2, 1])))
    assert_allclose(dense(moved)[1][1, 0, 1], without.rewards[1, 0])
    other = ModelBased("simulator").model(problem)
    assert_allclose(dense(other)[0][1, 0], dense(simulator)[0][1, 0])
    assert_allclose(dense(other)[1][1, 0], own[1, 0])
    assert_array_equal(other.terminal_state, simulator.terminal_state)
    assert_array_equal(other.initial, simulator.initial)
    assert other.discount == simulator.discount


def test_models_keep_states_that_nothing_enters_and_where_termination_leads():
    rows = np.array([[[0.5, 0.5]], [[0.5, 0.5]]])
    pay = np.arange(4.0).reshape(2, 1, 2)
    simulator = FiniteMDP(rows, pay, [0, 1], 0.9, terminal_state=[1, 1])
    problem = Problem(simulator, Transitions([1, 0], [0, 0], [0, 0]))
    for fallback in ("stay", "simulator"):
        model = ModelBased(fallback).model(problem)
        assert_array_equal(model.terminal_state, [1, 1])
        assert_allclose(oee.state_values(model, np.ones((2, 1))), [0.0, 2.0], atol=1e-12)
    once = ModelBased()(Problem(simulator, Transitions([1, 0, 0], [0, 0, 0], [0, 0, 1])), np.ones((2, 1)))
    assert once.standard_error > 0  # of state 0 alone: a row seen once shows no spread


def test_the_three_largest_gaps_of_the_log_are_named():
    """By the policy's time in zeta * P, the absorbing state left out."""
    simulator, _ = environments(3)
    problem = Problem(simulator, Transitions([0, 1], [0, 1], [1, 2]))
    facts = OffEnvironment(ratio=oee.true_ratio(simulator, simulator))(problem, POLICY).diagnostics
    assert facts["coverage"] == 1.0  # the true ratio knows all rows
    facts = ModelBased("simulator")(problem, POLICY).diagnostics
    time = oee.occupancy(ModelBased("simulator").model(problem), POLICY)
    missed = sorted((-time[s, a], s, a) for s in range(3) for a in range(2) if (s, a) not in {(0, 0), (1, 1)})
    assert facts["unseen"] == "; ".join(f"s={s}, a={a}" for _, s, a in missed[:3])


def test_nothing_to_learn_is_full_coverage():
    """The policy is over at once: its time is all where nothing can be learned."""
    mdp = FiniteMDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [1.0, 0.0], [0, 1], 0.9)
    facts = OffEnvironment()(Problem(mdp, Transitions([0], [0], [1])), np.ones((2, 1))).diagnostics
    assert (facts["coverage"], facts["fallback_share"], facts["effective_sample_size"]) == (1.0, 0.0, 0.0)
    assert facts["unseen"] == ""


@pytest.mark.parametrize("estimator", [
    OffEnvironment("ratio_of_ratios"), Marginalized("ratio_of_ratios"), Magic("ratio_of_ratios"),
    DoublyRobust(ratio="ratio_of_ratios"), DoublyRobust(data="rollouts", ratio="ratio_of_ratios"),
    DoublyRobust(data="episodes", ratio="ratio_of_ratios"), OffEnvironment(evaluation="monte_carlo"),
], ids=repr)  # fmt: skip
def test_the_seed_decides_what_is_sampled(estimator):
    problem, _ = problem_of(3, horizon=4, n=60)
    first, again, other = (estimator(problem, POLICY, seed=seed).value for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.parametrize("horizon", [None, 4])
def test_the_model_s_standard_error_row_by_row(horizon):
    problem, _ = problem_of(3, horizon=horizon, n=8)
    model = ModelBased().model(problem)
    gradient = exact.transition_gradient(model, POLICY, horizon=horizon)
    table = np.zeros((8, 4))
    table[model.transitions.tocoo().coords] = gradient
    n, variance = problem.counts.toarray().sum(axis=1), 0.0
    for x in np.flatnonzero(n):
        p = model.transitions.toarray()[x]
        variance += p @ (table[x] - p @ table[x]) ** 2 / n[x]
    assert_allclose(ModelBased()(problem, POLICY).standard_error, np.sqrt(variance), rtol=1e-10)


def test_without_a_horizon_at_discount_one():
    """Values where the policy is absorbed, without a standard error or coverage; a status where it is not."""
    simulator, target = environments(2, discount=1.0)
    problem = Problem(simulator, oee.sample_episodes(target, BEHAVIOR, 30, 50, seed=0))
    for estimator in (OffEnvironment(), ModelBased("simulator")):
        found = estimator(problem, POLICY)
        assert np.isfinite(found.value)
        assert found.standard_error is None
        assert "coverage" not in found.diagnostics
    assert OffEnvironment()(problem, POLICY).diagnostics["standard_error_of"] is None
    rows = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])
    ring = FiniteMDP(rows, [1.0, 1.0], [1, 0], 1.0)
    forever = Problem(ring, Transitions([0, 1], [0, 0], [1, 0]))
    for estimator in (Simulator(), Oracle(ring), OffEnvironment(), ModelBased()):
        found = estimator(forever, np.ones((2, 1)))
        assert np.isnan(found.value)
        assert found.standard_error is None
        assert set(found.diagnostics) == (
            {"gap", "row_sum_error", "largest_weight"} if estimator == OffEnvironment() else set()
        )
        assert "horizon must be given: at discount 1" in found.status


@pytest.mark.parametrize("horizon", [None, 4])
def test_off_environment_and_its_ratio(horizon):
    """The largest weight, the rows' error, strength and meaning; an unnormalised zeta has a value and nothing more."""
    problem, target = problem_of(3, horizon=horizon)
    zeta = oee.transition_ratio(problem.log, problem.simulator, values_of=POLICY, horizon=horizon)
    found = OffEnvironment()(problem, POLICY)
    facts = found.diagnostics
    assert_allclose(facts["largest_weight"], zeta.values.data.max())
    assert facts["row_sum_error"] == zeta.row_sum_error
    assert (facts["strength"], facts["meaning"]) == (zeta.details["strength"], zeta.details["meaning"])
    model = exact.reweight(problem.simulator, zeta)
    gradient = exact.transition_gradient(model, POLICY, horizon=horizon)
    assert_allclose(facts["standard_error_if_centre_fits"], zeta.log_standard_error(gradient), rtol=1e-12)
    step = zeta.one_step(gradient)
    assert_allclose(found.standard_error, np.hypot(step.standard_error, step.unseen), rtol=1e-12)
    assert_allclose(facts["model_value"], oee.policy_value(model, POLICY, horizon=horizon), rtol=1e-12)
    assert_allclose(facts["one_step_value"], facts["model_value"] + step.change, rtol=1e-12)
    assert_allclose(facts["one_step_standard_error"], np.hypot(step.standard_error, step.unseen), rtol=1e-12)
    assert_allclose(facts["unseen_standard_error"], step.unseen, rtol=1e-12)
    loose = OffEnvironment(reweighted_zeta(problem.simulator, target, 1.01))(problem, POLICY)
    assert set(loose.diagnostics) == {"gap", "row_sum_error", "largest_weight", "error_bound", "method"}
    assert loose.standard_error is None
    true = oee.true_ratio(target, problem.simulator)
    assert_allclose(Oracle(target)(problem, POLICY).diagnostics["largest_weight"], true.values.data.max())


def test_ratios_by_name_get_what_the_problem_knows():
    """The behaviour policy, the simulator's data and the seed reach ``transition_ratio``."""
    simulator, target = environments(3)
    log = oee.sample_episodes(target, BEHAVIOR, 200, 6, seed=1)
    for method in ("ratio_of_ratios", "joint"):
        for options in ({}, {"behavior_policy": BEHAVIOR}, {"simulator_data": "exact", "behavior_policy": BEHAVIOR}):
            problem = Problem(simulator, log, **options)
            zeta = oee.transition_ratio(log, simulator, method=method, seed=np.random.default_rng(4), **options)
            found = OffEnvironment(method).fit(problem, POLICY, np.random.default_rng(4))
            assert_allclose(found.values.toarray(), zeta.values.toarray(), rtol=1e-12)
    people = population(simulator, target, POLICY, behavior_policy=BEHAVIOR)
    expected = oee.transition_ratio(
        people.counts(), simulator, method="joint", simulator_data="exact", behavior_policy=BEHAVIOR
    )
    limit = OffEnvironment("joint").limit(simulator, target, POLICY, behavior_policy=BEHAVIOR)
    assert_allclose(limit, oee.policy_value(exact.reweight(simulator, expected), POLICY), rtol=1e-9)


WRONG = {
    "oracle: target": (lambda: Oracle(3), r"^target must be a FiniteMDP; got int$"),
    "oracle: evaluation": (
        lambda: Oracle(TARGET, "mc"),
        r"^evaluation must be one of 'exact', 'monte_carlo'; got 'mc'$",
    ),
    "oracle: weighting": (
        lambda: Oracle(TARGET, weighting="step"),
        r"^weighting must be one of 'per_decision', 'trajectory'; got 'step'$",
    ),
    "oracle: rollouts": (lambda: Oracle(TARGET, n_rollouts=0), r"^n_rollouts must be a positive integer; it is 0$"),
    "oee: evaluation": (
        lambda: OffEnvironment(evaluation="mc"),
        r"^evaluation must be one of 'exact', 'monte_carlo'; got 'mc'$",
    ),
    "oee: ratio": (
        lambda: OffEnvironment(ratio="q"),
        r"^ratio must be one of 'conditional', 'ratio_of_ratios', 'joint'; got 'q'$",
    ),
    "importance sampling: kind": (
        lambda: ImportanceSampling("q"),
        r"^kind must be one of 'trajectory', 'per_decision'; got",
    ),
    "importance sampling: ragged": (
        lambda: ImportanceSampling(ragged="q"),
        r"^ragged must be one of 'pad', 'zero'; got 'q'$",
    ),
    "importance sampling: behaviour": (
        lambda: ImportanceSampling(behavior="q"),
        r"^behavior must be one of 'recorded', 'estimated'; got 'q'$",
    ),
    "model: fallback": (lambda: ModelBased("q"), r"^fallback must be one of 'stay', 'simulator'; got 'q'$"),
    "doubly robust: data": (
        lambda: DoublyRobust(data="q"),
        r"^data must be one of 'transitions', 'rollouts', 'episodes'; got 'q'$",
    ),
    "doubly robust: weights": (
        lambda: DoublyRobust(weights="q"),
        r"^weights must be one of 'occupancy', 'beta'; got 'q'$",
    ),
    "doubly robust: ratio": (lambda: DoublyRobust(ratio="q"), r"^ratio must be one of"),
    "doubly robust: rollouts": (
        lambda: DoublyRobust(n_rollouts=0),
        r"^n_rollouts must be a positive integer; it is 0$",
    ),
    "magic: ratio": (lambda: Magic(ratio="q"), r"^ratio must be one of"),
    "magic: lengths": (lambda: Magic(n_lengths=0), r"^n_lengths must be a positive integer; it is 0$"),
    "magic: bootstrap": (lambda: Magic(n_bootstrap=0), r"^n_bootstrap must be a positive integer; it is 0$"),
    "a seed": (
        lambda: OffEnvironment()(problem_of()[0], POLICY, seed="q"),
        r"^seed must be what numpy.random.default_rng",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_options_name_their_argument(name):
    call, text = WRONG[name]
    with pytest.raises(ValueError, match=text):
        call()
