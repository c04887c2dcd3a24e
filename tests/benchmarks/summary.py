"""Values, occupancies, estimates and reports where users wait or a peer is ahead."""

from functools import partial

import mdps
import numpy as np
from scipy import sparse
from scipy.sparse import linalg
from speed import compare
from values import ITERATIVE, SPSOLVE, evaluate, form

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment
from oee_tabular.tasks import gridworld, gridworld_policy

LU = ("scipy splu, symmetric", SPSOLVE)


def solve(*, quick):
    """V; the peers form P_pi and I - gamma P_pi within their time."""
    graph, uniform = mdps.graph, oee.uniform_policy
    for side in (40,) if quick else (40, 100, 300):
        yield from evaluate(f"grid {side}, .99", gridworld(side, 0.3), gridworld_policy(side, 0.5), LU, ready=False)
    n = 1_000 if quick else 10_000
    for discount in (0.99, 0.99999):
        mdp = mdps.garnet(n, discount=discount)
        yield from evaluate(f"random {n}, one action, {discount}", mdp, mdps.fixed_policy(mdp), ITERATIVE, ready=False)
    yield from evaluate(f"random {n}, .99", mdps.garnet(n), uniform(mdps.garnet(n)), ITERATIVE, ready=False)
    for size in (100,) if quick else (100, 500, 2_000):
        yield from evaluate(f"dense {size}", mdps.dense(size), uniform(mdps.dense(size)), ("numpy",), ready=False)
    cases = [("ring", 20_000, 0.999), ("ring", 20_000, 0.9999), ("ring, 10 a side", 20_000, 0.999)]
    cases += [("chain", 10_000, 0.9999), ("queue", 5_000, 0.999), ("queue", 20_000, 0.9999)]
    for name, size, discount in cases:
        mdp = graph(name, size // 10 if quick else size, discount, actions=2)
        yield from evaluate(f"{name} {mdp.n_states}, {discount}", mdp, uniform(mdp), LU, ready=False)
    for size, discount in ((500, 0.999),) if quick else ((500, 0.999), (5_000, 0.9999), (20_000, 0.999)):
        mdp = graph("small world", size, discount)
        yield from evaluate(f"small world {size}, {discount}", mdp, uniform(mdp), ITERATIVE, ready=False)


def occupy(*, quick):
    """Discounted shares of the states, d = (1 - gamma) (I - gamma P^T)^-1 p_0."""
    for name, mdp in {
        "grid 100": gridworld(30 if quick else 100, 0.3),
        "grid 300": gridworld(40 if quick else 300, 0.3),
        "ring 20000, .999": mdps.graph("ring", 2_000 if quick else 20_000, 0.999, actions=2),
    }.items():
        policy = oee.uniform_policy(mdp)

        def matrix(mdp=mdp, policy=policy):
            kernel, _ = form(mdp, policy)
            return sparse.csc_array((sparse.eye_array(mdp.n_states) - mdp.discount * kernel).T)

        peers = {
            "SuperLU": lambda a=matrix, m=mdp: lambda: linalg.splu(a()).solve((1 - m.discount) * m.initial),
            "bicgstab": lambda a=matrix, m=mdp: lambda: linalg.bicgstab(a(), (1 - m.discount) * m.initial, rtol=1e-12)[0],
        }  # fmt: skip
        yield from compare("occupancy", name, {"ours": partial(oee.occupancy, mdp, policy)}, peers, repeat=3)


def small_estimates(*, quick):
    """The default estimate of MDPs of 4 and 30 states from 200 transitions, beside maximum likelihood in numpy."""
    for n in (4, 30):
        simulator, target = mdps.garnet(n, entries=4), mdps.garnet(n, entries=4, seed=0)
        policy, log = oee.uniform_policy(simulator), mdps.draw_log(target, 200)
        prior, m = simulator.transitions.toarray(), simulator.n_actions

        def likelihood(log=log, n=n, m=m, prior=prior, simulator=simulator):
            counts = np.bincount((log.state * m + log.action) * n + log.next_state, minlength=n * m * n).reshape(-1, n)
            sums = counts.sum(axis=1, keepdims=True)
            model = np.where(sums > 0, counts / np.maximum(sums, 1), prior).reshape(n, m, n).mean(axis=1)
            return simulator.initial @ np.linalg.solve(np.eye(n) - 0.99 * model, simulator.rewards.mean(axis=1))

        call = partial(OffEnvironment(), oee.Problem(simulator, log), policy)
        peers = {"numpy, maximum likelihood": lambda call=likelihood: call}
        yield from compare("OffEnvironment", f"{n} states", {"ours": call}, peers, repeat=5)


def reports(*, quick):
    """A report of several policies, quick and with intervals, and the page of one."""
    n = 500 if quick else 2_500
    simulator = mdps.garnet(n)
    problem, best = oee.Problem(simulator, mdps.draw_log(simulator, 10 * n)), oee.optimal_policy(simulator)
    mixed = {f"policy {k}": oee.mix(best, oee.uniform_policy(simulator), k / 20) for k in range(1, 21)}
    some = {name: mixed[name] for name in list(mixed)[:5]}
    evaluation = oee.evaluate(problem, mixed["policy 1"], seed=0, quick=True)
    calls = {
        "20 policies, quick": partial(oee.evaluate, problem, mixed, seed=0, quick=True),
        "5 policies": partial(oee.evaluate, problem, some, seed=0),
        "page": evaluation.to_html,
    }
    for name, call in calls.items():
        yield from compare("reports", f"{name}, {n} states", {"ours": call})
