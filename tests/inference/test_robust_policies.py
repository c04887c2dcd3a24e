"""The policy with the largest worst value: by value iteration, by enumeration, by
Storm, its certificate, and what is refused.
"""

import itertools

import numpy as np
import pytest
from helpers import dense, random_mdp, random_policy, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose

import oee_tabular as oee

BOXES = [(0.0, 1.5), (0.3, 3.0), (0.8, 1.2), (0.5, np.inf), (0.0, np.inf), (1.0, 1.0)]
few = settings(max_examples=40, deadline=None)


def worst_rows(P, ahead, nu, mu):
    """(S, A) min p . ahead over nu P <= p <= min(mu P, 1): what is left after nu P goes
    to the smallest first.
    """
    low = nu * P
    high = np.where(P > 0, np.minimum(np.where(P > 0, mu, 1.0) * P, 1.0), 0.0)
    order = np.argsort(ahead, axis=2, kind="stable")
    room = np.take_along_axis(high - low, order, axis=2)
    before = np.cumsum(room, axis=2) - room
    rest = (1.0 - low.sum(axis=2))[:, :, None]
    added = np.clip(rest - before, 0.0, room)
    ordered = np.take_along_axis(ahead, order, axis=2)
    return (low * ahead).sum(axis=2) + (added * ordered).sum(axis=2)


def iterate_values(mdp, nu, mu, horizon=None):
    """V* (S,) of the robust Bellman equation, by value iteration."""
    P, r = dense(mdp)
    values = np.zeros(len(P))
    steps = horizon
    if steps is None:
        # the last change is below 1e-13 of the values
        steps = (
            1 if mdp.discount == 0 else int(np.log(1e-14) / np.log(mdp.discount)) + 2
        )
    for _ in range(steps):
        values = worst_rows(P, r + mdp.discount * values, nu, mu).max(axis=1)
    return values


def lower_end(mdp, policy, nu, mu, horizon=None):
    return oee.value_range(mdp, policy, nu, mu, horizon=horizon).lower


def every_policy(mdp):
    """All deterministic policies."""
    for actions in itertools.product(range(mdp.n_actions), repeat=mdp.n_states):
        yield np.eye(mdp.n_actions)[list(actions)]


@given(rngs)
@few
def test_it_is_the_fixed_point_of_the_robust_bellman_equation(rng):
    """To its certificate; the value is the lower end of the policy's range."""
    mdp = random_mdp(rng)
    nu, mu = BOXES[rng.integers(len(BOXES))]
    found = oee.robust_policy(mdp, nu, mu)
    best = float(mdp.initial @ iterate_values(mdp, nu, mu))
    size = max(1.0, abs(best)) / (1.0 - mdp.discount)
    assert 0.0 <= found.gap <= 1e-9 * size
    assert found.value - 1e-12 * size <= best <= found.value + found.gap + 1e-12 * size
    assert found.value == lower_end(mdp, found.policy, nu, mu)
    # a policy, and a deterministic one
    assert set(np.unique(found.policy)) <= {0.0, 1.0}
    assert_allclose(found.policy.sum(axis=1), 1.0)


@given(rngs)
@few
def test_with_a_horizon_it_is_backward_induction(rng):
    mdp = random_mdp(rng, discount=float(rng.choice([0.0, 0.7, 1.0])))
    nu, mu = BOXES[rng.integers(len(BOXES))]
    steps = int(rng.integers(1, 8))
    found = oee.robust_policy(mdp, nu, mu, horizon=steps)
    best = float(mdp.initial @ iterate_values(mdp, nu, mu, steps))
    assert found.policy.shape == (steps, mdp.n_states, mdp.n_actions)
    assert 0.0 <= found.gap <= 1e-12 * max(1.0, abs(best)) * steps * 10
    assert_allclose(found.value, best, rtol=1e-12, atol=1e-12)
    assert found.value == lower_end(mdp, found.policy, nu, mu, steps)


@pytest.mark.parametrize("discount", [0.0, 0.6, 0.95])
def test_no_policy_has_a_larger_lower_end(discount):
    """By enumeration of the deterministic ones, and some that are not."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        mdp = random_mdp(rng, n_states=3, n_actions=3, discount=discount)
        nu, mu = BOXES[seed % len(BOXES)]
        found = oee.robust_policy(mdp, nu, mu)
        others = [random_policy(rng, mdp) for _ in range(5)]
        ends = [lower_end(mdp, pi, nu, mu) for pi in (*every_policy(mdp), *others)]
        assert max(ends[:27]) == pytest.approx(found.value, abs=1e-9)
        assert max(ends) <= found.value + found.gap + 1e-10


def ending(rng, discount=1.0):
    """Each action of each state ends, at some time, in every model of a box with a
    positive lower bound: all pay less than 0.
    """
    size = int(rng.integers(2, 5))
    P = rng.dirichlet(np.ones(size), size=(size, 2))
    P[rng.uniform(size=P.shape) < 0.3] = 0.0
    P[:, :, -1] += 0.1
    P[-1] = np.eye(size)[-1]
    P /= P.sum(axis=2, keepdims=True)
    pay = -rng.integers(1, 6, (size, 2)).astype(float)
    pay[-1] = 0.0
    start = np.append(rng.dirichlet(np.ones(size - 1)), 0.0)
    return oee.FiniteMDP(P, pay, start, discount)


@given(rngs)
@few
def test_at_discount_1_it_is_the_limit_and_the_best_by_enumeration(rng):
    mdp = ending(rng)
    nu, mu = [(0.3, 3.0), (0.5, 1.5), (0.9, np.inf)][rng.integers(3)]
    found = oee.robust_policy(mdp, nu, mu)
    ends = [lower_end(mdp, pi, nu, mu) for pi in every_policy(mdp)]
    scale = abs(found.value)
    assert 0.0 <= found.gap <= 1e-9 * scale
    assert max(ends) == pytest.approx(found.value, rel=1e-10)
    near = oee.robust_policy(mdp.with_discount(1.0 - 1e-7), nu, mu)
    assert near.value == pytest.approx(found.value, rel=1e-4)
    assert found.value == lower_end(mdp, found.policy, nu, mu)


def test_at_discount_1_a_policy_may_be_able_to_stay_for_ever():
    """Bumping into a wall costs 1 a step and never ends: it is no better, and no reason
    to refuse the model.
    """
    for pay in ("next", "current"):
        grid = oee.tasks.gridworld(4, 0.3, pay=pay).with_discount(1.0)
        found = oee.robust_policy(grid, 0.5, 2.0)
        assert found.gap < 1e-9 * abs(found.value)
        expert = lower_end(grid, oee.tasks.gridworld_expert(4), 0.5, 2.0)
        assert expert <= found.value + 1e-9
        near = oee.robust_policy(grid.with_discount(1.0 - 1e-9), 0.5, 2.0)
        assert near.value == pytest.approx(found.value, rel=1e-6)


def corridor(stay_pay):
    """Two rooms and an end that pays 1 on entering; action 0 stays, 1 goes on."""
    P = np.zeros((3, 2, 3))
    P[0, 0, 0] = P[1, 0, 1] = 1.0
    P[0, 1] = [0.5, 0.5, 0.0]
    P[1, 1] = [0.0, 0.5, 0.5]
    P[2, :, 2] = 1.0
    pay = np.zeros((3, 2, 3))
    pay[1, 1, 2] = 1.0
    pay[0, 0, 0] = pay[1, 0, 1] = stay_pay
    return oee.FiniteMDP(P, pay, 0, 1.0)


def test_the_gap_of_a_horizon_is_a_discounted_sum():
    """Of the same rounding in each step, so that late steps hardly add to it."""
    alone = oee.FiniteMDP(np.ones((1, 2, 1)), [[1.0, 0.5]], 0, 0.5)
    gaps = [oee.robust_policy(alone, 0.5, 2.0, horizon=t).gap for t in (10, 1000)]
    assert 0.0 < gaps[0] <= gaps[1] < 1.5 * gaps[0]


def test_of_equal_actions_at_discount_1_it_takes_one_that_ends():
    """Staying costs nothing, and every policy that ends gets 1."""
    found = oee.robust_policy(corridor(0.0), 0.5, 2.0)
    assert found.policy[:2].argmax(axis=1).tolist() == [1, 1]
    assert found.value == pytest.approx(1.0)
    # staying is as good as going in the values, and has no time to an end
    assert found.gap == np.inf
    assert "without a certificate" in str(found)
    costly = oee.robust_policy(corridor(-0.1), 0.5, 2.0)
    assert costly.policy[:2].argmax(axis=1).tolist() == [1, 1]
    assert costly.gap < 1e-9
    assert "certificate" not in str(costly)


def test_what_may_not_stay_for_sure_leads_to_an_end():
    """To and fro between two rooms pays 1 and -1, as much as to leave them; without a
    lower bound nothing must lead out, but at most 3/4 of a step stays inside.
    """
    P = np.zeros((3, 2, 3))
    P[0, 0, 1] = P[1, 0, 0] = P[2, :, 2] = 1.0
    P[0, 1] = [0.5, 0.0, 0.5]
    P[1, 1] = [0.0, 0.5, 0.5]
    pay = np.zeros((3, 2, 3))
    pay[0, 0, 1], pay[1, 0, 0] = 1.0, -1.0
    pay[0, 1, 2], pay[1, 1, 2] = 2.0, 1.0
    found = oee.robust_policy(oee.FiniteMDP(P, pay, 0, 1.0), 0.0, 1.5)
    assert found.policy[:2].argmax(axis=1).tolist() == [1, 1]
    assert found.value == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("mdp", "box", "text"),
    [
        # to stay pays: there is no largest value
        (corridor(0.1), (0.5, 2.0), r"horizon must be given.* s=0 has reward 0\.1"),
        # the worst model never goes on
        (corridor(-1.0), (0.0, 2.0), "horizon must be given.* may stay for ever"),
    ],
)
def test_what_has_no_value_at_discount_1_is_refused(mdp, box, text):
    with pytest.raises(ValueError, match=text):
        oee.robust_policy(mdp, *box)
    oee.robust_policy(mdp, *box, horizon=3)


def test_states_that_no_policy_reaches_do_not_matter_at_discount_1():
    P = np.zeros((3, 1, 3))
    P[0, 0, 1] = P[1, 0, 1] = P[2, 0, 2] = 1.0
    mdp = oee.FiniteMDP(P, [-2.0, 0.0, -1.0], 0, 1.0)
    found = oee.robust_policy(mdp, 0.5, 2.0)
    assert (found.value, found.policy.shape) == (-2.0, (3, 1))
    assert found.gap < 1e-12


@pytest.mark.parametrize("horizon", [None, 4])
def test_a_box_of_the_simulator_alone_gives_the_optimal_policy(horizon):
    for seed in range(8):
        mdp = random_mdp(np.random.default_rng(seed), discount=0.9)
        best = oee.optimal_policy(mdp, horizon=horizon)
        found = oee.robust_policy(mdp, 1.0, 1.0, horizon=horizon)
        value = oee.policy_value(mdp, best, horizon=horizon)
        assert found.value == pytest.approx(value, abs=1e-10)
        if horizon is None:
            assert (found.policy == best).all()


@given(rngs)
@few
def test_it_falls_as_the_box_grows_and_moves_with_the_rewards(rng):
    mdp = random_mdp(rng, discount=0.9)
    nested = [(1.0, 1.0), (0.9, 1.2), (0.5, 1.2), (0.5, 3.0), (0.0, 3.0), (None, None)]
    values = [oee.robust_policy(mdp, *box).value for box in nested]
    assert (np.diff(values) <= 1e-9).all()
    P, r = dense(mdp)
    moved = oee.FiniteMDP(P, 3.0 * r - 2.0, mdp.initial, mdp.discount)
    found = oee.robust_policy(moved, 0.5, 3.0).value
    assert found == pytest.approx(3.0 * values[3] - 20.0, abs=1e-8)


def test_it_is_no_safe_improvement():
    """Where it is prepared for what does not happen, the policy that runs is better."""
    found = oee.robust_policy(BOLD, 0.5, 3.0)
    runs = oee.optimal_policy(BOLD)
    assert oee.policy_value(BOLD, found.policy) < oee.policy_value(BOLD, runs)


# a bold action pays 2 and fails at times, a cautious one pays 1
BOLD = oee.FiniteMDP(
    [[[1.0, 0.0], [0.9, 0.1]], [[0.0, 1.0]] * 2], [[1.0, 2.0], [0.0, 0.0]], 0, 0.9
)


def test_what_it_prints():
    found = oee.robust_policy(BOLD, 0.5, 2.0)
    assert str(found) == repr(found)
    assert str(found) == (
        "policy with the largest worst value: 10 at worst; discounted sum of rewards,"
        " not normalised"
    )
    assert "worst value in the box" in found._repr_html_()
    made = oee.RobustPolicy(found.policy, 10.0, 0.5)
    assert ", at most 0.5 below the best;" in str(made)


# ---- Storm's synthesis in interval models, where it is installed (stormpy >= 2)
STORM_FAMILIES = (
    "inventory20",
    "queue25",
    "machine",
    "forest12",
    "river_swim",
    "garnet_dirichlet10",
    "ageing_asset",
    "gambler",
)


def interval_model(mdp, nu, mu, path):
    """Write an MDP and its box in Storm's DRN; return what was added to each reward.

    An outcome (s, a, s') is a state that pays its reward, goes on to s' with the
    discount, and ends otherwise. Rewards are raised to at least 0.
    """
    P, r = dense(mdp)
    support = np.argwhere(P > 0)
    added = -float(r[P > 0].min())
    size = mdp.n_states
    end = size + len(support)
    place = {tuple(x): size + k for k, x in enumerate(support.tolist())}
    lines = ["@type: MDP", "@parameters", "", "@reward_models", "pay"]
    choices = size * mdp.n_actions + len(support) + 2
    lines += ["@nr_states", str(end + 2), "@nr_choices", str(choices), "@model"]

    def certain(p):
        return f"[{p:.17g}, {p:.17g}]"

    for s in range(size):
        lines.append(f"state {s} [0]")
        for a in range(mdp.n_actions):
            lines.append(f"\taction {a}")
            for t in np.flatnonzero(P[s, a] > 0):
                low, high = nu * P[s, a, t], min(mu * P[s, a, t], 1.0)
                lines.append(f"\t\t{place[s, a, t]} : [{low:.17g}, {high:.17g}]")
    for (s, a, t), k in place.items():
        paid = r[s, a, t] + added
        lines += [f"state {k} [{paid:.17g}]", "\taction 0"]
        lines += [f"\t\t{t} : {certain(mdp.discount)}"]
        lines += [f"\t\t{end} : {certain(1.0 - mdp.discount)}"]
    lines += [f"state {end} [0] over", "\taction 0", f"\t\t{end} : [1, 1]"]
    lines += [f"state {end + 1} [0] init", "\taction 0"]
    lines += [
        f"\t\t{s} : {certain(mdp.initial[s])}" for s in np.flatnonzero(mdp.initial)
    ]
    path.write_text("\n".join(lines) + "\n")
    return added


@pytest.mark.parametrize("name", STORM_FAMILIES)
def test_it_is_what_storm_finds(name, tmp_path):
    stormpy = pytest.importorskip("stormpy")
    simulator = oee.bench.families()[name].simulator
    nu, mu = 0.5, 2.0
    added = interval_model(simulator, nu, mu, tmp_path / "model.drn")
    build = stormpy.build_model_from_drn[stormpy.Interval]
    model = build(str(tmp_path / "model.drn"))
    asked = stormpy.parse_property('R{"pay"}max=? [F "over"]')
    environment = stormpy.environments.sound()
    # of a change in one sweep, and relative; its default stops near 1e-4
    environment.solver().min_max().precision = stormpy.Rational("1e-13")
    result = stormpy.model_checking(
        model,
        asked,
        uncertainty_resolution_mode=stormpy.UncertaintyResolutionMode.ROBUST,
        environment=environment,
    )
    storm = result.get_value(model.initial_states[0]) - added / (1 - simulator.discount)
    found = oee.robust_policy(simulator, nu, mu)
    assert_allclose(found.value, storm, rtol=1e-7)
