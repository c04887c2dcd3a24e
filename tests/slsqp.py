"""Random problems, and the ends of likelihood intervals by SLSQP."""

from dataclasses import replace

import numpy as np
from helpers import random_mdp, random_policy
from scipy import stats
from scipy.optimize import minimize

import oee_tabular as oee
from oee_tabular.exact import transition_gradient

LIMIT = stats.chi2.ppf(0.95, 1) / 2


def problem_of(rng, horizon=None, n=None):
    simulator = random_mdp(rng, n_states=int(rng.integers(3, 9)), n_actions=2)
    policy = random_policy(rng, simulator)
    shape = policy.shape
    n = int(rng.integers(5, 200)) if n is None else n
    log = oee.sample_transitions(
        simulator, np.full(shape, 1 / policy.size), n, seed=int(rng.integers(99))
    )
    return oee.Problem(simulator, log, horizon=horizon), policy


def best_of_slsqp(evidence, sign, n_starts, rng, minus=None):
    """The end by SLSQP over all free probabilities."""
    spread = evidence.rows.spread
    policies = [(1.0, evidence.policy)]
    reached = evidence.reachable
    if minus is not None:
        policies.append((-1.0, minus))
        reached = reached | replace(evidence, policy=minus).reachable
    horizon = evidence.horizon
    free = np.flatnonzero(spread(reached & evidence.is_stochastic))
    pair = spread(np.arange(len(evidence.n)))[free]
    n = spread(evidence.n)[free]
    phat = evidence.phat[free]
    base = evidence.phat.copy()
    held = np.flatnonzero((n > 0) & (phat > 0))
    weight = (n * phat)[held]
    sums = (pair == np.unique(pair)[:, None]) * 1.0

    def left(x):
        return LIMIT + weight @ np.log(np.maximum(x[held], 1e-300) / phat[held])

    def left_gradient(x):
        return np.bincount(held, weight / np.maximum(x[held], 1e-300), len(x))

    def loss(x):
        total = sums.T @ (sums @ x)
        base[free] = p = x / total
        model = evidence.with_rows(base)
        value = 0.0
        gradient = np.zeros(len(free))
        for side, policy in policies:
            value += side * oee.policy_value(model, policy, horizon=horizon)
            slope = transition_gradient(model, policy, horizon=horizon)
            gradient += side * slope[free]
        gradient = (gradient - sums.T @ (sums @ (p * gradient))) / total
        return -sign * value, -sign * gradient

    best = -np.inf
    bounds = [(1e-10 if k in set(held) else 0.0, 1.0) for k in range(len(free))]
    for _ in range(n_starts):
        aim = rng.exponential(size=len(free)) ** 3
        aim = np.where(
            n > 0,
            0.9 * phat + 0.1 * aim / (sums.T @ (sums @ aim)),
            aim / (sums.T @ (sums @ aim)),
        )
        rules = [
            {"type": "eq", "fun": lambda x: sums @ x - 1, "jac": lambda x: sums},
            {"type": "ineq", "fun": left, "jac": left_gradient},
        ]
        options = {"maxiter": 500, "ftol": 1e-13}
        answer = minimize(
            loss,
            aim,
            jac=True,
            method="SLSQP",
            bounds=bounds,
            constraints=rules,
            options=options,
        ).x
        answer = np.clip(answer, 0.0, 1.0) / (
            sums.T @ (sums @ np.clip(answer, 0.0, 1.0))
        )
        if left(answer) >= -1e-7:
            best = max(best, -loss(answer)[0])
    return sign * best
