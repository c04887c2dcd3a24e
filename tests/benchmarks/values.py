"""V = (I - gamma P_pi)^-1 r_pi of a fixed policy, ours against direct and iterative solvers; tasks values, regimes,
graphs.

Inside our clock: ``evaluate_policy`` as it is called, with the check of the policy, P_pi and r_pi, the solve and the
bound on its error. The peers' clock in ``values`` is the solve alone, on what they like best; in ``regimes`` and
``graphs`` they form P_pi and r_pi, too (but for the lists that mdpsolver takes). ``error`` is the largest |r + gamma
P_pi V - V| over the largest |V|. Memory, from a process for each program, is what the resident set grew by while V was
computed.
"""

import multiprocessing
import resource
from functools import partial

import mdps
import numpy as np
from common import cpu, interleaved, per_call, row, rows_of
from scipy import sparse
from scipy.sparse import linalg

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import policy_rewards
from oee_tabular.tasks import gridworld, gridworld_policy


def form(mdp, policy):
    """P_pi and r_pi in the quickest way that scipy has: rows that are picked, or a sparse product."""
    n, m = policy.shape
    if policy.max(axis=1).min() == 1.0:
        pairs = np.arange(n) * m + policy.argmax(axis=1)
        return sparse.csr_array(mdp.transitions[pairs]), mdp.rewards.reshape(-1)[pairs]
    mean = sparse.csr_array((policy.reshape(-1), np.arange(n * m), np.arange(n + 1) * m), shape=(n, n * m))
    return sparse.csr_array(mean @ mdp.transitions), np.einsum("sa,sa->s", policy, mdp.rewards)


def quantecon(kernel, rewards, discount):
    """``DiscreteDP.evaluate_policy`` of an MDP of one action."""
    from quantecon.markov import DiscreteDP

    states = np.arange(len(rewards))
    ddp = DiscreteDP(rewards, sparse.csr_matrix(kernel), discount, states, np.zeros_like(states))
    return lambda: ddp.evaluate_policy(np.zeros_like(states))


def scipy_direct(kernel, rewards, discount, **options):
    """SuperLU, by default with the order and mode that suit a symmetric pattern."""
    options = options or {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
    matrix = sparse.csc_array(sparse.eye_array(len(rewards)) - discount * kernel)
    return lambda: linalg.splu(matrix, **options).solve(rewards)


def bicgstab(kernel, rewards, discount):
    """scipy's, without a preconditioner; where it says that it failed, so do we."""
    matrix = sparse.csr_array(sparse.eye_array(len(rewards)) - discount * kernel)

    def call():
        x, info = linalg.bicgstab(matrix, rewards, rtol=1e-12, atol=0.0, maxiter=5000)
        if info:
            raise RuntimeError(f"info {info}: not converged")
        return x

    return call


def pardiso(kernel, rewards, discount):
    """MKL PARDISO, all phases each time."""
    import pypardiso

    matrix = sparse.csr_matrix(sparse.eye_array(len(rewards)) - discount * kernel)
    solver = pypardiso.PyPardisoSolver()  # once: looking for the library takes a quarter of a second
    return lambda: solver.solve(matrix, rewards)


def mdpsolver(kernel, rewards, discount):
    """mdpsolver's modified policy iteration with one action."""
    import mdpsolver

    starts, model = kernel.indptr.tolist(), mdpsolver.model()
    parts = list(zip(starts[:-1], starts[1:], strict=True))
    model.mdp(
        discount=discount, rewards=[[r] for r in rewards.tolist()],
        tranMatProbs=[[kernel.data[i:j].tolist()] for i, j in parts],
        tranMatColumns=[[kernel.indices[i:j].tolist()] for i, j in parts],
    )  # fmt: skip

    def call():
        zeros = [0.0] * len(rewards)  # it would begin with what it found the last time
        model.solve(algorithm="mpi", tolerance=1e-9, parallel=False, initValueVector=zeros)
        return np.array(model.getValueVector())

    return call


def lapack(kernel, rewards, discount):
    """numpy's dense solver."""
    return lambda: np.linalg.solve(np.eye(len(rewards)) - discount * kernel.toarray(), rewards)


SPSOLVE, DIRECT = "scipy spsolve", ("quantecon", "scipy splu, symmetric", "MKL PARDISO")
PEERS = {
    "quantecon": quantecon, "scipy splu, symmetric": scipy_direct, SPSOLVE: partial(scipy_direct, permc_spec="COLAMD"),
    "MKL PARDISO": pardiso, "scipy bicgstab": bicgstab, "mdpsolver": mdpsolver, "numpy": lapack,
}  # fmt: skip
ITERATIVE = ("scipy bicgstab", "mdpsolver")
SPARSE = tuple(name for name in PEERS if name != "numpy")


def against(case, mdp, policy, peers=SPARSE, *, ready=True, seconds=1.0):
    """Rows of one evaluation; ``ready``: whether the peers' clock leaves out P_pi and r_pi."""
    calls = {"ours": lambda: exact.evaluate_policy(mdp, policy).values}
    kernel, rewards = policy_kernel(mdp, policy), policy_rewards(mdp, policy)
    for name in peers:
        try:
            solve = PEERS[name](kernel, rewards, mdp.discount)
        except Exception as error:
            yield row("V", case, name, np.nan, note=f"{type(error).__name__}: {error}"[:120])
            continue
        if ready:
            calls[name] = solve
        elif name == "mdpsolver":
            calls[name] = lambda solve=solve: (form(mdp, policy), solve())[1]
        else:
            calls[name] = lambda name=name: PEERS[name](*form(mdp, policy), mdp.discount)()

    def miss(x):
        return np.abs(rewards + mdp.discount * (kernel @ x) - x).max() / np.abs(x).max()

    repeat = 1 + 2_000 // mdp.n_states  # what takes less than a millisecond is not timed with cold caches
    timed = interleaved({name: per_call(call, repeat) for name, call in calls.items()}, seconds=seconds)
    yield from rows_of("V", case, timed, miss, repeat)


def grow(n, program):
    """CPU seconds and bytes of one evaluation on the n x n grid, in a process of its own."""
    mdp, policy = gridworld(n, 0.3), gridworld_policy(n, 0.5)
    exact.evaluate_policy(gridworld(40, 0.3), gridworld_policy(40, 0.5))
    call = lambda: exact.evaluate_policy(mdp, policy).values  # noqa: E731
    if program != "ours":
        call = PEERS[program](policy_kernel(mdp, policy), policy_rewards(mdp, policy), mdp.discount)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return cpu(call)[1], 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)


def memory(n, programs):
    """Rows with the memory in their notes."""
    for program in programs:
        try:
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                seconds, size = pool.apply(grow, (n, program))
            yield row("V", f"grid {n}, memory", program, seconds, note=f"{size / 2**30:.2f} GB")
        except Exception as error:
            yield row("V", f"grid {n}, memory", program, np.nan, note=f"{type(error).__name__}: {error}"[:120])


def rows(*, quick):
    """Grids, a random MDP and layers; the peers get ready matrices."""
    for n, discount in ((40, 0.99),) if quick else ((40, 0.99), (100, 0.99), (300, 0.99), (300, 0.9999)):
        for delta in (0.1, 0.5, 0.9):
            peers = SPARSE if n < 100 else (*DIRECT, SPSOLVE, "scipy bicgstab")
            case = f"grid {n}, delta {delta:g}, discount {discount:g}"
            yield from against(case, gridworld(n, 0.3, discount=discount), gridworld_policy(n, delta), peers)
    random = mdps.garnet(1_000 if quick else 10_000, entries=10)
    yield from against(f"random MDP of {random.n_states} states", random, oee.uniform_policy(random), ITERATIVE)
    if not quick:
        yield from against("random MDP once", random, oee.uniform_policy(random), (SPSOLVE,), seconds=0.0)  # a minute
        yield from against("grid 1000, delta 0.5", gridworld(1000, 0.3), gridworld_policy(1000, 0.5), DIRECT)
        yield from memory(1000, ("ours", *DIRECT))
        yield from memory(3000, ("ours",))


def regimes(*, quick):
    """Graphs that mix, dense rows, many actions, grids, lattices, a few states; P_pi is formed inside every clock."""
    n = 1_000 if quick else 10_000
    dense_of = ("numpy", *ITERATIVE)
    cases = [
        (f"random {n}, deterministic", mdps.garnet(n), "fixed", ITERATIVE),
        (f"random {n}, deterministic, .99999", mdps.garnet(n, discount=0.99999), "fixed", ITERATIVE),
        (f"random {n}, uniform", mdps.garnet(n), "uniform", ITERATIVE),
        (f"random {n}, 2 next states", mdps.garnet(n, entries=2), "fixed", ITERATIVE),
        (f"random {n // 5}, 100 actions, uniform", mdps.garnet(n // 5, actions=100), "uniform", ITERATIVE),
        (f"dense {n // 5}, deterministic", mdps.dense(n // 5), "fixed", dense_of),
        (f"dense {n // 5}, uniform", mdps.dense(n // 5), "uniform", dense_of),
        ("lattice", mdps.lattice(8 if quick else 20), "uniform", ITERATIVE),
        *((f"random {k}, uniform", mdps.garnet(k, entries=min(5, k)), "uniform", tuple(PEERS)) for k in (4, 64, 200)),
        ("dense 64, uniform", mdps.dense(64), "uniform", tuple(PEERS)),
    ]
    for case, mdp, policy, peers in cases:
        pi = mdps.fixed(mdp) if policy == "fixed" else oee.uniform_policy(mdp)
        yield from against(case, mdp, pi, peers, ready=False)
    for side, discount in ((8, 0.99), (40, 0.99)) if quick else ((8, 0.99), (40, 0.99), (100, 0.99999), (300, 0.99)):
        grid = gridworld(side, 0.3, discount=discount)
        yield from against(f"grid {side}, {discount}", grid, gridworld_policy(side, 0.9), SPARSE[:5], ready=False)


def graphs(*, quick):
    """One action: every graph near discount 1, in three sizes."""
    for name in mdps.GRAPHS:
        for n in (500,) if quick else (500, 5_000, 20_000):
            for discount in (0.99, 0.999, 0.9999):
                mdp = mdps.graph(name, n, discount)
                fills = name in ("random graph", "small world") and n > 500
                peers = ("scipy bicgstab",) if fills else ("scipy splu, symmetric", SPSOLVE, "scipy bicgstab")
                peers += ("numpy",) if n == 500 else ()
                case = f"{name} {n}, {discount}"
                yield from against(case, mdp, np.ones((n, 1)), peers, ready=False, seconds=0.2)
