"""Monte Carlo evaluation by products of ratios: seconds for 10 000 rollouts, and the former engine's on the same problem.

The former engine wrote the episodes down (``sample_episodes``), found each move's ratio and multiplied step by step; it
stands below as it was. The 10 x 10 grid (slip .3 simulated, .28 real), the uniform policy, T = 10, 50 and 200. ``error``:
distance from ``weighted_return_moments`` in exact standard errors. Called by rollouts.py.
"""

import numpy as np
from common import interleaved, rows_of

import oee_tabular as oee
from oee_tabular._sparse import find
from oee_tabular.estimators import DoublyRobust, OffEnvironment
from oee_tabular.estimators.rollouts import normalize_by_step, segment_products

N = 10_000


def former(model, ratio, policy, horizon, *, self_normalized=False):
    """``product_estimate`` per decision by logs."""
    log = oee.sample_episodes(model, policy, N, horizon, seed=0)
    position, _ = find(model.transitions, log.state * model.n_actions + log.action, log.next_state)
    starts = log.episode_starts
    after = segment_products(ratio.on(model)[position], starts)
    weight, kept, by_move = after, after[starts[1:] - 1], model.transition_rewards is not None
    if not by_move:
        weight = np.ones(len(after))
        inner = np.ones(len(after), dtype=np.bool_)
        inner[starts[:-1]] = False
        weight[inner] = after[np.flatnonzero(inner) - 1]
        kept = np.where(np.diff(starts) < horizon, kept, weight[starts[1:] - 1])
    reward = model.discount ** log.timestep.astype(np.float64) * log.reward
    if self_normalized:
        return normalize_by_step(reward, weight, starts, kept)[0]
    return np.add.reduceat(weight * reward, starts[:-1]).mean()


def case(horizon):
    """Rows of one horizon."""
    simulator, target = (oee.tasks.gridworld(10, slip) for slip in (0.3, 0.28))
    policy, zeta = oee.uniform_policy(simulator), oee.true_ratio(target, simulator)
    problem = oee.Problem(simulator, oee.Transitions([0], [0], [1]), horizon=horizon)

    def ours(estimator):
        return lambda: estimator(problem, policy, seed=0).value

    product = {"ratio": zeta, "evaluation": "monte_carlo", "n_rollouts": N}
    calls = {
        "ours": ours(OffEnvironment(**product)),
        "ours, trajectory": ours(OffEnvironment(**product, weighting="trajectory")),
        "ours, self-normalised": ours(OffEnvironment(**product, self_normalized=True)),
        "ours, doubly robust": ours(DoublyRobust(data="rollouts", ratio=zeta, n_rollouts=N)),
        "the former engine": lambda: former(simulator, zeta, policy, horizon),
        "the former engine, self-normalised": lambda: former(simulator, zeta, policy, horizon, self_normalized=True),
    }
    known = oee.weighted_return_moments(simulator, zeta, policy, horizon=horizon)

    def miss(value):
        return abs(value - known.mean) / known.standard_deviation * np.sqrt(N)

    yield from rows_of("rollouts", f"products of ratios, {N} rollouts, T = {horizon}", interleaved(calls), miss)


def rows(*, quick):
    """All cases; ``quick``: one."""
    for horizon in (50,) if quick else (10, 50, 200):
        yield from case(horizon)
