"""``optimal_policy`` against mdpsolver, QuantEcon and MDPToolbox: every algorithm and update that they have.

Each program is handed the MDP in the form that it likes best, outside of its clock; the peers, whose own default is 1e-3, are
asked for 1e-6, and MDPToolbox's two value iterations stop by its own bound. ``error`` is by how much the policy falls short of
the optimal values, relative to the largest of them. Policy iteration is left out where its dense or direct solver would take
minutes.
"""

import numpy as np
from common import interleaved, per_call, row, rows_of
from regimes import dense_mdp, garnet, lattice
from scipy import sparse

import oee_tabular as oee

EPSILON = 1e-6


def with_mdpsolver(mdp, algorithm, update):
    """The model is made once; each call begins with values of 0."""
    import mdpsolver

    (n, m), starts = mdp.rewards.shape, mdp.transitions.indptr.tolist()
    pairs = list(zip(starts[:-1], starts[1:], strict=True))
    chances = [mdp.transitions.data[i:j].tolist() for i, j in pairs]
    ahead = [mdp.transitions.indices[i:j].tolist() for i, j in pairs]
    model, nothing = mdpsolver.model(), [0.0] * n
    model.mdp(
        discount=mdp.discount,
        rewards=mdp.rewards.tolist(),
        tranMatProbs=[chances[s * m : s * m + m] for s in range(n)],
        tranMatColumns=[ahead[s * m : s * m + m] for s in range(n)],
    )

    def call():
        model.solve(algorithm=algorithm, update=update, tolerance=EPSILON, parallel=False, initValueVector=nothing)
        return np.array(model.getPolicy())

    return call


def with_quantecon(mdp, method):
    """Sparse, by state-action pairs."""
    from quantecon.markov import DiscreteDP

    n, m = mdp.rewards.shape
    pairs = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
    ddp = DiscreteDP(mdp.rewards.reshape(-1), sparse.csr_matrix(mdp.transitions), mdp.discount, *pairs)
    return lambda: ddp.solve(method=method, epsilon=EPSILON, max_iter=100_000).sigma


def with_toolbox(mdp, module, name):
    """MDPToolbox, or the fork of it, with a sparse matrix an action."""
    import importlib

    toolbox = importlib.import_module(module)
    rows = [sparse.csr_matrix(mdp.transitions[a :: mdp.n_actions]) for a in range(mdp.n_actions)]
    options = {} if name == "PolicyIteration" else {"epsilon": EPSILON}
    options |= {"skip_check": True} if module.startswith("hiive") else {}

    def call():
        solver = getattr(toolbox, name)(rows, mdp.rewards, mdp.discount, **options)
        solver.run()
        return np.array(solver.policy)

    return call


PEERS = {f"mdpsolver {algorithm} {update}": (with_mdpsolver, algorithm, update)
         for algorithm in ("mpi", "vi", "pi") for update in ("standard", "gs", "sor")}  # fmt: skip
PEERS |= {f"quantecon {method}": (with_quantecon, method)
          for method in ("modified_policy_iteration", "policy_iteration", "value_iteration")}  # fmt: skip
PEERS |= {f"{module.partition('.')[0]} {name}": (with_toolbox, module, name)
          for module in ("mdptoolbox.mdp", "hiive.mdptoolbox.mdp")
          for name in ("PolicyIterationModified", "ValueIteration", "PolicyIteration")}  # fmt: skip
JACOBI = ("mdpsolver mpi standard", "quantecon modified_policy_iteration")
MODIFIED = (*JACOBI, "mdpsolver mpi gs", "mdpsolver mpi sor")


def against(case, mdp, *, only=tuple(PEERS), seconds=1.0):
    """Rows of one MDP."""
    calls = {"ours": lambda: oee.optimal_policy(mdp).argmax(axis=1)}
    for name, (prepare, *arguments) in PEERS.items():
        if name in only:
            try:
                calls[name] = prepare(mdp, *arguments)
            except ImportError as error:
                yield row("planning", case, name, np.nan, note=str(error))
    repeat = 1 + 200 // mdp.n_states
    timed = interleaved({n: per_call(call, repeat) for n, call in calls.items()}, seconds=seconds)
    best = oee.state_values(mdp, oee.optimal_policy(mdp))

    def miss(actions):
        return (best - oee.state_values(mdp, np.eye(mdp.n_actions)[actions])).max() / np.abs(best).max()

    yield from rows_of("planning", case, timed, miss, repeat)


def random_mdps(*, quick):
    """Graphs that mix; Gauss and Seidel's sweeps know no shift and take a hundred times as long there."""
    yield "random 100, .99", garnet(100), {}
    for n, discount in ((1_000, 0.99), (1_000, 0.9), (10_000, 0.99), (10_000, 0.99999)):
        if not quick or n == 1_000:
            yield f"random {n}, {discount}", garnet(n, discount=discount), {"only": JACOBI}
    if not quick:
        yield "random 2000, 50 actions, .99", garnet(2_000, actions=50), {"only": JACOBI}
        yield "random 10000, 2 next states, .99", garnet(10_000, entries=2), {"only": JACOBI}
        yield "dense 500, .99", dense_mdp(500, actions=4), {"only": JACOBI}


def near_neighbours(*, quick):
    """Grids, a lattice; the other algorithms take seconds, QuantEcon's policy iteration goes round among equal actions."""
    for n, discount in ((8, 0.99), (20, 0.99), (40, 0.99), (100, 0.99), (100, 0.999)):
        if not quick or n == 20:
            options = {"only": MODIFIED if n <= 40 else JACOBI}
            yield f"grid {n}, slip .3, {discount}", oee.tasks.gridworld(n, 0.3, discount=discount), options
    if not quick:
        mdp = lattice(15)
        yield f"lattice {mdp.n_states}, .99", mdp, {"only": MODIFIED}


def rows(*, quick):
    """The table's rows."""
    for family in (random_mdps, near_neighbours):
        for case, mdp, options in family(quick=quick):
            yield from against(case, mdp, **options)
