"""The right answers to the exercises of the notebooks, by the package: the checks are
held to them.
"""

import math

import gymnasium
import numpy as np
from helpers import rows_of
from scipy import sparse
from scipy.optimize import brentq

import oee_tabular as oee
from oee_tabular import estimators, exact, inference, testing
from oee_tabular.continuous import kinova
from oee_tabular.shrinkage.strength import score
from oee_tabular.tasks import CartPole, discretize

ROW = np.array([0.7, 0.1, 0.1, 0.1])


def sure_arrival():
    lake = oee.tasks.toy_text(
        "FrozenLake-v1", map_name="8x8", success_rate=1.0, discount=0.99
    )
    return oee.policy_value(lake, oee.optimal_policy(lake))


def slow_motor():
    transitions = np.array([[[0.5, 0.5], [0.9, 0.1]], [[0.1, 0.9], [0.1, 0.9]]])
    motor = oee.FiniteMDP(
        transitions, np.array([[2.0, 1.0], [0.0, 0.0]]), [1.0, 0.0], 0.9
    )
    return oee.policy_value(motor, [[0.0, 1.0], [0.0, 1.0]])


def horizon_for_the_rest():
    return next(t for t in range(1, 2000) if 0.99**t / 0.01 <= 0.5)


def episodes_for_a_tenth():
    floor = oee.tasks.gridworld(10, slip=0.1)
    variance = oee.return_moments(
        floor, oee.tasks.gridworld_policy(10, 0.5), horizon=200
    ).variance
    return int(np.ceil(variance / 0.1**2))


def residual_of_speed():
    """By Gymnasium's own steps."""
    speeds = []
    for mass, gravity in ((1.2, 11.0), (1.0, 10.0)):
        env = gymnasium.make("Pendulum-v1", g=gravity).unwrapped
        env.reset(seed=0)
        env.m = mass
        env.state = np.array([np.pi / 2, 0.0])
        env.step(np.array([2.0]))
        speeds.append(env.state[1])
    return speeds[0] - speeds[1]


def months_a_bin():
    shares = oee.tasks.bus_engines().target.transitions[[0]].toarray()[0, :3]
    return 1 / (shares @ [0, 1, 2])


def best_bin():
    """By the value of each policy, not by planning."""
    target = oee.tasks.bus_engines().target
    values = [
        oee.policy_value(target, (np.arange(90) >= k).astype(int)) for k in range(90)
    ]
    return int(np.argmax(values))


def growth_for_half():
    """The log of 1000 months, and its months four times."""
    buses = oee.tasks.bus_engines(1000, seed=0, source="target")
    once = buses.log
    four = oee.Transitions(
        *(np.tile(column, 4) for column in (once.state, once.action, once.next_state))
    )
    wide, narrow = (
        oee.interval(
            oee.Problem(buses.simulator, log), buses.policy, tie=buses.tie
        ).width
        for log in (once, four)
    )
    return round((wide / narrow) ** 2)


def boxed_pair():
    return oee.density_ratio([0.8, 0.2], [0.5, 0.5], upper=1.2).ratio


def gap_of_ones():
    p = [0.10, 0.20, 0.20, 0.10, 0.25, 0.15]
    q = [0.30, 0.25, 0.20, 0.10, 0.10, 0.05]
    return 1.0 - oee.density_ratio(p, q, lower=0.5, upper=2.0).objective


def samples_for_a_tenth():
    return next(
        n for n in range(1000, 10_000) if np.sqrt(2 * (0.95 / 0.05) / n) <= 0.1 + 1e-12
    )


def grids(simulated=0.3, real=0.1):
    simulator = oee.tasks.gridworld(10, simulated)
    target = oee.tasks.gridworld(10, real)
    return simulator, oee.true_ratio(target, simulator)


def corner():
    _, zeta = grids()
    return zeta.values[90 * 4, 90]


def largest_slip():
    slips = np.arange(0.01, 0.9, 0.01)
    return max(e for e in slips if grids(e)[1].values.data.max() <= 1.2 + 1e-9)


def mass_after_200():
    mdp = oee.FiniteMDP(
        np.full((4, 1, 4), [0.7, 0.1, 0.1, 0.1]), np.zeros(4), [1.0, 0.0, 0.0, 0.0], 0.9
    )
    zeta = mdp.transitions.copy()
    zeta.data = np.where(zeta.indices == 0, 1.3, 0.4)
    return exact.weight_moments(mdp, zeta, oee.uniform_policy(mdp), horizon=200)[0][-1]


def one_move(simulated, real):
    """E[W_1^2] from a cell without walls."""
    simulator, zeta = grids(simulated, real)
    start = np.zeros(100)
    start[44] = 1.0
    inside = oee.FiniteMDP(
        simulator.transitions, simulator.transition_rewards, start, 0.99
    )
    return exact.weight_moments(inside, zeta, oee.uniform_policy(inside), horizon=1)[1][
        1
    ]


def paths_for_one():
    simulator, zeta = grids()
    return oee.weighted_return_moments(
        simulator, zeta, oee.tasks.gridworld_policy(10, 0.5), horizon=100
    ).variance


def one_row():
    """One state with a row of four next states, which are all absorbing."""
    rows = np.zeros((5, 1, 5))
    rows[0, 0, 1:] = ROW
    rows[1:, 0, 1:] = np.eye(4)
    return oee.FiniteMDP(rows, np.zeros(5), np.eye(5)[0], 0.9)


def shrunk_ratio():
    counts = sparse.csr_array(([9.0, 1.0], ([0, 0], [1, 2])), shape=(5, 5))
    return oee.transition_ratio(
        counts, one_row(), prior="simulator", strength=30.0
    ).values.toarray()[0, 1]


def tilt_to(slip):
    def excess(theta):
        tilted = ROW ** (1 + theta)
        return tilted[0] / tilted.sum() - (1 - slip)

    return brentq(excess, -5, 5, xtol=1e-12)


def evidence_gained():
    observed = np.array([2.0, 0.0])
    prior = np.array([0.5, 0.5])
    rows = rows_of(prior, [0, 2])
    certain = 2 * math.log(0.5)
    np.testing.assert_allclose(score(1e9, observed, prior, rows), certain, atol=1e-8)
    return score(1.0, observed, prior, rows) - certain


def distance_of_one():
    simulator = oee.tasks.gridworld(10, 0.3)
    target = oee.tasks.gridworld(10, 0.1)
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
    """A state for each of ``probabilities``, from where one gets there to what is worth
    ``worth`` of that state, else to 0.
    """
    k = len(probabilities)
    P = np.zeros((k + 2, 1, k + 2))
    r = np.zeros((k + 2, 1, k + 2))
    P[:k, 0, k] = probabilities
    P[:k, 0, k + 1] = 1 - np.asarray(probabilities)
    P[k, 0, k] = P[k + 1, 0, k + 1] = 1.0
    r[:k, 0, k] = worth
    return oee.FiniteMDP(P, r, np.r_[np.full(k, 1 / k), 0.0, 0.0], 0.5)


def ends_in_the_box():
    mdp = choice([0.7])
    # a move of another row: the first has none
    elsewhere = oee.Transitions([1], [0], [1])
    found = oee.interval(
        oee.Problem(mdp, elsewhere), np.ones((3, 1)), lower_ratio=0.25, upper_ratio=1.6
    )
    return found.lower, found.upper


def two_rows():
    mdp = choice([0.5, 0.5], worth=[1.0, 2.0])
    plan = oee.plan_data_collection(
        mdp, np.ones((4, 1)), n=300, model=mdp, optimistic=False
    )
    return 300 * plan.distribution[:2, 0]


def moves_for_a_twentieth():
    row, column = np.divmod(np.arange(25), 5)
    target = oee.tasks.gridworld(5, 0.1, discount=0.95).with_rewards(
        (row + column - 8) / 8
    )
    uniform = np.full((25, 4), 1 / 100)
    return (
        oee.efficiency_bound(target, oee.tasks.gridworld_policy(5, 0.5), uniform)
        / 0.05**2
    )


def corners():
    grid = discretize(CartPole(), cells=(3, 3), closure_episodes=0).cells
    low = grid.vertices()[0]
    step = grid.spacing
    return np.sort(grid.weights(np.array([low + step * [0.25, 0.5]])).data)[::-1]


def moves_a_row():
    small = discretize(CartPole(form="full"), cells=(4,) * 4, closure_episodes=0).mdp
    # of 4^4 vertices; "fallen" is not one
    rows = (small.n_states - 1) * small.n_actions
    return [80_000 / (rows * (k / 4) ** 4) for k in (10, 32)]


def calibrated():
    found = estimators.calibrate(
        estimators.Estimate(0.45), discretised=0.50, continuous=0.51
    )
    return found.diagnostics["calibrated_value"]


def largest_of_five():
    lengths = np.eye(5)  # the worst case: a step of each length ends elsewhere
    simulated = 0.9 * lengths[2] + 0.1 * lengths.mean(axis=0)
    rows = [
        np.vstack([np.tile(row, (1, 1)), np.eye(5)[1:]]).reshape(5, 1, 5)
        for row in (lengths[0], simulated)
    ]
    target, simulator = (oee.FiniteMDP(P, np.zeros(5), np.eye(5)[0], 0.9) for P in rows)
    return oee.true_ratio(target, simulator).values.data.max()


def moves_a_command():
    return len(kinova.record_goals(kinova.ideal_hand(1.0), n_runs=10, seed=0)) / len(
        kinova.COMMANDS
    )


def one_and_two_boxes():
    simulator = discretize(kinova.ideal_hand(1.0), floor=0.1, closure_episodes=0)
    target = discretize(kinova.ideal_hand(1.4), closure_episodes=0)
    places = simulator.cells.vertices()
    home = int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))
    (command,) = np.flatnonzero((kinova.COMMANDS == [1.0, 0.0, 0.0]).all(axis=1))
    rows = [
        model.mdp.transitions[[home * 27 + command]].toarray().ravel()
        for model in (target, simulator)
    ]
    moved = np.rint((places - places[home])[:, 0] / simulator.cells.spacing[0]).astype(
        int
    )
    ratio = [
        rows[0][: len(moved)][moved == k].sum()
        / rows[1][: len(moved)][moved == k].sum()
        for k in (1, 2)
    ]
    return ratio


def survival():
    chain = testing.case("survival")
    drops = estimators.ImportanceSampling(
        kind="per_decision", self_normalized=True, ragged="zero"
    )
    limit = drops.limit(
        chain.simulator,
        chain.target,
        chain.policy,
        behavior_policy=chain.behavior,
        horizon=3,
    )
    return oee.policy_value(chain.target, chain.policy, horizon=3), limit


def logs_that_show_it():
    return next(k for k in range(1, 1000) if 4 * 0.1 / np.sqrt(k) <= 0.02 + 1e-12)


def leaving():
    stays = [[[1.0, 0.0]], [[0.0, 1.0]]]
    leaves = [[[0.99, 0.01]], [[0.0, 1.0]]]
    target, simulator = (
        oee.FiniteMDP(P, [1.0, 0.0], [1.0, 0.0], 0.9) for P in (stays, leaves)
    )
    change = abs(target.transitions - simulator.transitions).sum(axis=1).max() / 2
    values = [
        exact.policy_value(mdp, oee.uniform_policy(mdp)) for mdp in (target, simulator)
    ]
    return values[0] - values[1], 2 * change / (1 - 0.9)


# exercise -> (the right answer, answers that readers are likely to give instead, a word
# of the hint)
CASES = {
    "00_a": (sure_arrival, [1.0, 0.99**14, 14, 0.99], "7 steps down"),
    "01_a": (slow_motor, [5.9375, 10.0, 0.67857], "V(1)"),
    "01_b": (horizon_for_the_rest, [527, 529, 69, 527.2], "left out"),
    "01_c": (episodes_for_a_tenth, [2782, 279, 278.2, 1668], "variance"),
    "02_a": (boxed_pair, [[1.6, 0.4], [1.2, 0.4], [0.8, 1.2], [1.2], 1.2], "bound"),
    "02_b": (gap_of_ones, [0.0, 1.0, 0.789, 0.2394], "risk"),
    "02_c": (samples_for_a_tenth, [1900, 380, 38, 7600], "twice"),
    "03_a": (corner, [9 / 7, 1 / 3, 0.9333, 0.8571], "two directions"),
    "03_b": (largest_slip, [0.0833, 0.0, 0.1, 0.3], "grows"),
    "03_c": (mass_after_200, [1.03, 206, 7.0, 3.0], "sum"),
    "04_a": (
        lambda: one_move(0.3, 0.1),
        [1.0, 1.1571, 0.1905, 1.4444],
        "four directions",
    ),
    "04_b": (lambda: one_move(0.1, 0.3), [1.1905, 0.4444, 1.0], "exchanged"),
    "04_c": (paths_for_one, [624, 6.6e6, 63, 3890], "horizons[7]"),
    "05_a": (
        shrunk_ratio,
        [0.75, 9 / 7, 1.2, 0, -1.071, math.nan, math.inf],
        "30 pretended transitions",
    ),
    "05_b": (lambda: tilt_to(0.1), [1.694, 0.9, 0.68, -0.435], "the target's are 27"),
    "05_c": (
        evidence_gained,
        [1.5, 0.585, 0.176, -0.405],
        "second transition has probability",
    ),
    "05_d": (lambda: tilt_to(0.5), [0.435, 0.565, 0.694, -0.45], "theta is negative"),
    "05_e": (lambda: False, [0, 1], "two equal values of P"),
    "06_a": (distance_of_one, [0.0, 16 / 21, 0.2857, 1.0], "four distances"),
    "06_b": (falls_with_the_fortieth, [0.634, 0.4, 40, 0.669, 33.1], "40 rewards"),
    "06_c": (
        theorem_2,
        [[0.01, 0.0716], [0.0961, 0.0358], [0.31, 0.0716], 0.0961],
        "both errors",
    ),
    "07_a": (
        ends_in_the_box,
        [[0.175, 1.12], [0.175, 1.0], [0.925, 0.52], [0.52]],
        "add up to 1",
    ),
    "07_b": (two_rows, [[60, 240], [150, 150], [200, 100], [75, 225]], "1 to 2"),
    "07_c": (
        moves_for_a_twentieth,
        [5652, 11_304, 1130, 56.5],
        "variance is bound / n",
    ),
    "08_a": (
        corners,
        [[0.25] * 4, [0.5, 0.25, 0.125, 0.125], [0.125, 0.125, 0.375, 0.375]],
        "the product",
    ),
    "08_b": (moves_a_row, [[8.0, 0.076], [4.0, 39.1], [4.0, 0.0], 4.0], "2 * 32^4"),
    "08_c": (calibrated, [0.45, 0.46, 0.441, 0.51], "same factor"),
    "09_a": (largest_of_five, [5, 10, 1000, 0.02], "0.1 / 5"),
    "09_b": (moves_a_command, [50, 1250, 9.26, 41.7], "different commands"),
    "09_c": (
        one_and_two_boxes,
        [[0.6, 0.4], [0.67, 16], [0.63, 8.0], 1.4],
        "shared by two",
    ),
    "10_a": (
        survival,
        [[2.71, 2.0269], [2.19, 2.71], [2.0269, 3.0], 2.0269],
        "drops out",
    ),
    "10_b": (logs_that_show_it, [25, 100, 20, 5], "standard error"),
    "10_c": (leaving, [[0.2, 0.8257], [0.8257, 0.1], [0.0826, 0.2], 0.8257], "allows"),
    "11_a": (residual_of_speed, [0.075, 0.125, 0.5, -0.05], "takes a part"),
    "12_a": (months_a_bin, [0.614, 98, 0.398, 2.51], "mean increment"),
    "12_b": (growth_for_half, [2, 16, 0.25, 0.5], "square root"),
    "12_c": (best_bin, [43, 60, 40, 90], "each bin"),
}
