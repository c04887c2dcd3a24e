"""``optimal_policy`` against mdpsolver, QuantEcon and MDPToolbox, each asked for 1e-6 in the form that it likes best.

``error`` is by how much the policy falls short of the optimal values, relative to the largest of them.
"""

import importlib

import mdps
import numpy as np
from common import interleaved, per_call, row, rows_of
from scipy import sparse

import oee_tabular as oee

EPSILON = 1e-6


def mdpsolver(mdp, update):
    """Modified policy iteration; the model is made once, each call begins with values of 0."""
    import mdpsolver

    (n, m), starts = mdp.rewards.shape, mdp.transitions.indptr.tolist()
    parts = list(zip(starts[:-1], starts[1:], strict=True))
    chances, ahead = ([x[i:j].tolist() for i, j in parts] for x in (mdp.transitions.data, mdp.transitions.indices))
    model, zeros = mdpsolver.model(), [0.0] * n
    model.mdp(
        discount=mdp.discount, rewards=mdp.rewards.tolist(),
        tranMatProbs=[chances[s * m : s * m + m] for s in range(n)],
        tranMatColumns=[ahead[s * m : s * m + m] for s in range(n)],
    )  # fmt: skip

    def call():
        model.solve(algorithm="mpi", update=update, tolerance=EPSILON, parallel=False, initValueVector=zeros)
        return np.array(model.getPolicy())

    return call


def quantecon(mdp, method):
    """Sparse, by state-action pairs."""
    from quantecon.markov import DiscreteDP

    pairs = np.repeat(np.arange(mdp.n_states), mdp.n_actions), np.tile(np.arange(mdp.n_actions), mdp.n_states)
    ddp = DiscreteDP(mdp.rewards.reshape(-1), sparse.csr_matrix(mdp.transitions), mdp.discount, *pairs)
    return lambda: ddp.solve(method=method, epsilon=EPSILON, max_iter=100_000).sigma


def toolbox(mdp, module):
    """MDPToolbox, or the fork of it, with a sparse matrix an action."""
    solver = importlib.import_module(module).PolicyIterationModified
    rows = [sparse.csr_matrix(mdp.transitions[a :: mdp.n_actions]) for a in range(mdp.n_actions)]

    def call():
        run = solver(rows, mdp.rewards, mdp.discount, epsilon=EPSILON)
        run.run()
        return np.array(run.policy)

    return call


JACOBI = {"mdpsolver": (mdpsolver, "standard"), "quantecon": (quantecon, "modified_policy_iteration")}
MODIFIED = JACOBI | {f"mdpsolver {update}": (mdpsolver, update) for update in ("gs", "sor")}
PEERS = MODIFIED | {f"quantecon {name}": (quantecon, name) for name in ("policy_iteration", "value_iteration")}
PEERS |= {name: (toolbox, name) for name in ("mdptoolbox.mdp", "hiive.mdptoolbox.mdp")}


def against(case, mdp, peers):
    """Rows of one MDP."""
    calls = {"ours": lambda: oee.optimal_policy(mdp).argmax(axis=1)}
    for name, (prepare, option) in peers.items():
        try:
            calls[name] = prepare(mdp, option)
        except ImportError as error:
            yield row("planning", case, name, np.nan, note=str(error))
    repeat = 1 + 200 // mdp.n_states
    timed = interleaved({name: per_call(call, repeat) for name, call in calls.items()})
    best = oee.state_values(mdp, oee.optimal_policy(mdp))

    def miss(actions):
        return (best - oee.state_values(mdp, np.eye(mdp.n_actions)[actions])).max() / np.abs(best).max()

    yield from rows_of("planning", case, timed, miss, repeat)


def rows(*, quick):
    """Graphs that mix, where sweeps in place take a hundred times as long; grids, a lattice, a queue, a ring, layers."""
    yield from against("random 100, .99", mdps.garnet(100), PEERS)
    yield from against("grid 20, slip .3", oee.tasks.gridworld(20, 0.3), MODIFIED)
    for n, discount in ((1_000, 0.99),) if quick else ((1_000, 0.99), (1_000, 0.9), (10_000, 0.99), (10_000, 0.99999)):
        yield from against(f"random {n}, {discount}", mdps.garnet(n, discount=discount), JACOBI)
    if not quick:
        yield from against("random 2000, 50 actions", mdps.garnet(2_000, actions=50), JACOBI)
        yield from against("random 10000, 2 next states", mdps.garnet(10_000, entries=2), JACOBI)
        yield from against("dense 500", mdps.dense(500, actions=4), JACOBI)
        for n, discount in ((8, 0.99), (40, 0.99), (100, 0.99), (100, 0.999)):
            grid = oee.tasks.gridworld(n, 0.3, discount=discount)
            yield from against(f"grid {n}, slip .3, {discount}", grid, MODIFIED if n <= 40 else JACOBI)
        yield from against("lattice 3375", mdps.lattice(15), MODIFIED)
        for name, n in (("queue", 2_000), ("ring", 5_000), ("layered", 20_000)):
            yield from against(f"{name} {n}", mdps.graph(name, n, 0.99), JACOBI)
