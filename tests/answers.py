"""The right answers to the exercises of notebooks 00 and 06 to 10, by the package: the checks are held to them."""

import numpy as np

import oee_tabular as oee
from oee_tabular import estimators, exact, inference, testing
from oee_tabular.tasks import CartPole, GridInterpolation, kinova


def sure_arrival():
    lake = oee.tasks.toy_text("FrozenLake-v1", map_name="8x8", success_rate=1.0, discount=0.99)
    return oee.policy_value(lake, oee.optimal_policy(lake))


def distance_of_one():
    simulator, target = oee.tasks.gridworld(10, 0.3), oee.tasks.gridworld(10, 0.1)
    return np.abs(oee.true_ratio(target, simulator).values[[44 * 4]].data - 1).mean()


def falls_with_the_fortieth():
    chain = np.zeros((41, 1, 41))
    chain[np.arange(40), 0, np.arange(40) + 1] = chain[40, 0, 40] = 1.0
    mdp = oee.FiniteMDP(chain, np.r_[np.ones(40), 0.0], np.eye(41)[0], 0.99)
    return oee.policy_value(mdp, oee.uniform_policy(mdp), horizon=100, normalized=True)


def theorem_2():
    sides = inference.value_bound_counterexample(2, 1.0, 0.1, 0.9)
    return sides.left, sides.right


def choice(probabilities, worth=1.0):
    """A state for each of ``probabilities``, from where one gets there to what is worth ``worth`` of that state, else to 0."""
    k = len(probabilities)
    P, r = np.zeros((k + 2, 1, k + 2)), np.zeros((k + 2, 1, k + 2))
    P[:k, 0, k], P[:k, 0, k + 1] = probabilities, 1 - np.asarray(probabilities)
    P[k, 0, k] = P[k + 1, 0, k + 1] = 1.0
    r[:k, 0, k] = worth
    return oee.FiniteMDP(P, r, np.r_[np.full(k, 1 / k), 0.0, 0.0], 0.5)


def ends_in_the_box():
    mdp = choice([0.7])
    elsewhere = oee.Transitions([1], [0], [1])  # a move of another row: the first has none
    found = oee.interval(oee.Problem(mdp, elsewhere), np.ones((3, 1)), lower_ratio=0.25, upper_ratio=1.6)
    return found.lower, found.upper


def two_rows():
    mdp = choice([0.5, 0.5], worth=[1.0, 2.0])
    plan = oee.plan_data_collection(mdp, np.ones((4, 1)), n=300, model=mdp, optimistic=False)
    return 300 * plan.distribution[:2, 0]


def moves_for_a_twentieth():
    row, column = np.divmod(np.arange(25), 5)
    target = oee.tasks.gridworld(5, 0.1, discount=0.95).with_rewards((row + column - 8) / 8)
    uniform = np.full((25, 4), 1 / 100)
    return oee.efficiency_bound(target, oee.tasks.gridworld_policy(5, 0.5), uniform) / 0.05**2


def corners():
    grid = GridInterpolation((3, 3), closure_episodes=0).build(CartPole()).cells
    low, step = grid.vertices()[0], grid.spacing
    return np.sort(grid.weights(np.array([low + step * [0.25, 0.5]])).data)[::-1]


def moves_a_row():
    small = GridInterpolation((4,) * 4, closure_episodes=0).build(CartPole(form="full")).mdp
    rows = (small.n_states - 1) * small.n_actions  # of 4^4 vertices; "fallen" is not one
    return [80_000 / (rows * (k / 4) ** 4) for k in (10, 32)]


def calibrated():
    found = estimators.calibrate(estimators.Estimate(0.45), discretised=0.50, continuous=0.51)
    return found.diagnostics["calibrated_value"]


def largest_of_five():
    lengths = np.eye(5)  # the worst case: a step of each length ends elsewhere
    simulated = 0.9 * lengths[2] + 0.1 * lengths.mean(axis=0)
    rows = [np.vstack([np.tile(row, (1, 1)), np.eye(5)[1:]]).reshape(5, 1, 5) for row in (lengths[0], simulated)]
    target, simulator = (oee.FiniteMDP(P, np.zeros(5), np.eye(5)[0], 0.9) for P in rows)
    return oee.true_ratio(target, simulator).values.data.max()


def moves_a_command():
    return len(kinova.record_goals(kinova.ideal_hand(1.0), n_runs=10, seed=0)) / len(kinova.COMMANDS)


def one_and_two_boxes():
    simulator = kinova.kinova_model(kinova.ideal_hand(1.0), defensive=0.1)
    target = kinova.kinova_model(kinova.ideal_hand(1.4))
    places = simulator.cells.vertices()
    home = int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))
    (command,) = np.flatnonzero((kinova.COMMANDS == [1.0, 0.0, 0.0]).all(axis=1))
    rows = [model.mdp.transitions[[home * 27 + command]].toarray().ravel() for model in (target, simulator)]
    moved = np.rint((places - places[home])[:, 0] / simulator.cells.spacing[0]).astype(int)
    ratio = [rows[0][: len(moved)][moved == k].sum() / rows[1][: len(moved)][moved == k].sum() for k in (1, 2)]
    return ratio


def survival():
    chain = testing.case("survival")
    drops = estimators.ImportanceSampling(kind="per_decision", self_normalized=True, ragged="zero")
    limit = drops.limit(chain.simulator, chain.target, chain.policy, behavior_policy=chain.behavior, horizon=3)
    return oee.policy_value(chain.target, chain.policy, horizon=3), limit


def logs_that_show_it():
    return next(k for k in range(1, 1000) if 4 * 0.1 / np.sqrt(k) <= 0.02 + 1e-12)


def leaving():
    stays, leaves = ([[[1.0, 0.0]], [[0.0, 1.0]]], [[[0.99, 0.01]], [[0.0, 1.0]]])
    target, simulator = (oee.FiniteMDP(P, [1.0, 0.0], [1.0, 0.0], 0.9) for P in (stays, leaves))
    change = abs(target.transitions - simulator.transitions).sum(axis=1).max() / 2
    values = [exact.policy_value(mdp, oee.uniform_policy(mdp)) for mdp in (target, simulator)]
    return values[0] - values[1], 2 * change / (1 - 0.9)


# check -> (the right answer, answers that readers are likely to give instead, a word of the hint)
CASES = {
    "check_00_a": (sure_arrival, [1.0, 0.99**14, 14, 0.99], "7 moves down"),
    "check_06_a": (distance_of_one, [0.0, 16 / 21, 0.2857, 1.0], "four distances"),
    "check_06_b": (falls_with_the_fortieth, [0.634, 0.4, 40, 0.669, 33.1], "40 rewards"),
    "check_06_c": (theorem_2, [[0.01, 0.0716], [0.0961, 0.0358], [0.31, 0.0716], 0.0961], "both errors"),
    "check_07_a": (ends_in_the_box, [[0.175, 1.12], [0.175, 1.0], [0.925, 0.52], [0.52]], "add up to 1"),
    "check_07_b": (two_rows, [[60, 240], [150, 150], [200, 100], [75, 225]], "1 to 2"),
    "check_07_c": (moves_for_a_twentieth, [5652, 11_304, 1130, 56.5], "variance is bound / n"),
    "check_08_a": (corners, [[0.25] * 4, [0.5, 0.25, 0.125, 0.125], [0.125, 0.125, 0.375, 0.375]], "the product"),
    "check_08_b": (moves_a_row, [[8.0, 0.076], [4.0, 39.1], [4.0, 0.0], 4.0], "2 * 32^4"),
    "check_08_c": (calibrated, [0.45, 0.46, 0.441, 0.51], "same factor"),
    "check_09_a": (largest_of_five, [5, 10, 1000, 0.02], "0.1 / 5"),
    "check_09_b": (moves_a_command, [50, 1250, 9.26, 41.7], "different commands"),
    "check_09_c": (one_and_two_boxes, [[0.6, 0.4], [0.67, 16], [0.63, 8.0], 1.4], "shared by two"),
    "check_10_a": (survival, [[2.71, 2.0269], [2.19, 2.71], [2.0269, 3.0], 2.0269], "drops out"),
    "check_10_b": (logs_that_show_it, [25, 100, 20, 5], "standard error"),
    "check_10_c": (leaving, [[0.2, 0.8257], [0.8257, 0.1], [0.0826, 0.2], 0.8257], "allows"),
}
