"""V = (I - gamma P_pi)^-1 r_pi of a fixed policy: ours against direct and iterative solvers.

Inside our clock: ``evaluate_policy`` as it is called, with the check of the policy, P_pi and r_pi from the rows, the
solve and the bound on its error. Inside the peers': the solve alone; they are handed P_pi and r_pi in the form they like
best (the policy is stochastic, so that DiscreteDP, mdpsolver and hiive get an MDP of one action; SuperLU, PARDISO and
scipy's bicgstab the matrix I - gamma P_pi itself). ``error`` is the largest |r + gamma P_pi V - V| over the largest |V|.

A peer that is not installed, fails or would take minutes is a row with a note. Memory, from a process for each program,
is what the resident set grew by while V was computed, the MDP (or the peer's input) being there already.
"""

import multiprocessing
import threading
import time

import numpy as np
from common import interleaved, per_call, row, rows_of
from scipy import sparse
from scipy.sparse import linalg

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import policy_rewards
from oee_tabular.tasks.gridworld import gridworld_policy


def quantecon(kernel, rewards, discount):
    """``DiscreteDP.evaluate_policy`` in the sparse form of state-action pairs."""
    from quantecon.markov import DiscreteDP

    states = np.arange(len(rewards))
    ddp = DiscreteDP(rewards, sparse.csr_matrix(kernel), discount, states, np.zeros_like(states))
    return lambda: ddp.evaluate_policy(np.zeros_like(states))


def superlu(kernel, rewards, discount):
    """SuperLU with the order and mode that suit a symmetric pattern."""
    matrix = sparse.csc_array(sparse.eye_array(len(rewards)) - discount * kernel)
    options = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
    return lambda: linalg.splu(matrix, **options).solve(rewards)


def spsolve(kernel, rewards, discount):
    """scipy's default."""
    matrix = sparse.csc_matrix(sparse.eye_array(len(rewards)) - discount * kernel)
    return lambda: linalg.spsolve(matrix, rewards)


def bicgstab(kernel, rewards, discount):
    """scipy's, without a preconditioner; where it says that it failed, so do we."""
    matrix = sparse.csr_array(sparse.eye_array(len(rewards)) - discount * kernel)

    def call():
        x, info = linalg.bicgstab(matrix, rewards, rtol=1e-13, atol=0.0, maxiter=5000)
        if info:
            raise RuntimeError(f"info {info}: not converged")
        return x

    return call


def pardiso(kernel, rewards, discount):
    """MKL PARDISO, all phases each time: ``solve`` keeps the factors only of what ``factorize`` was called with."""
    import pypardiso

    matrix = sparse.csr_matrix(sparse.eye_array(len(rewards)) - discount * kernel)
    solver = pypardiso.PyPardisoSolver()  # once: looking for the library takes a quarter of a second
    return lambda: solver.solve(matrix, rewards)


def mdpsolver(kernel, rewards, discount, algorithm="mpi", update="standard"):
    """mdpsolver with one action."""
    import mdpsolver

    starts = kernel.indptr.tolist()
    model, nothing = mdpsolver.model(), [0.0] * len(rewards)  # it would begin with what it found the last time
    model.mdp(
        discount=discount,
        rewards=[[r] for r in rewards.tolist()],
        tranMatProbs=[[kernel.data[i:j].tolist()] for i, j in zip(starts[:-1], starts[1:], strict=True)],
        tranMatColumns=[[kernel.indices[i:j].tolist()] for i, j in zip(starts[:-1], starts[1:], strict=True)],
    )

    def call():
        model.solve(algorithm=algorithm, update=update, tolerance=1e-9, parallel=False, initValueVector=nothing)
        return np.array(model.getValueVector())

    return call


def hiive(kernel, rewards, discount):
    """mdptoolbox-hiive's policy iteration with one action."""
    from hiive.mdptoolbox.mdp import PolicyIteration

    solver = PolicyIteration((sparse.csr_matrix(kernel),), rewards[:, None], discount, max_iter=1, skip_check=True)
    return lambda: np.asarray(solver._evalPolicyMatrix()[0]).reshape(-1)


PEERS = {
    "quantecon DiscreteDP": quantecon, "scipy splu (MMD_AT_PLUS_A, symmetric)": superlu, "scipy spsolve": spsolve,
    "MKL PARDISO": pardiso, "scipy bicgstab": bicgstab, "mdpsolver": mdpsolver, "mdptoolbox-hiive": hiive,
}  # fmt: skip
TOO_SLOW = {  # states from which a peer is left out, and what it was once seen to do
    "mdptoolbox-hiive": (2_000, "dense: 38 s at 10 000 states"),
    "mdpsolver": (50_000, "57 s at 1e6 states"),
    "scipy spsolve": (200_000, "as quantecon, which calls it"),
    "scipy bicgstab": (200_000, "did not converge: off by 5e4"),
}


def against(case, mdp, policy, peers=PEERS, seconds=1.0):
    """Rows of one evaluation."""
    kernel, rewards = policy_kernel(mdp, policy), policy_rewards(mdp, policy)
    calls = {"ours": lambda: exact.evaluate_policy(mdp, policy).values}
    for name, prepare in PEERS.items():
        if name not in peers:
            continue
        limit, seen = TOO_SLOW.get(name, (np.inf, ""))
        if mdp.n_states >= limit:
            yield row("V", case, name, np.nan, note=f"left out: {seen}")
            continue
        try:
            calls[name] = prepare(kernel, rewards, mdp.discount)
        except Exception as error:
            yield row("V", case, name, np.nan, note=f"{type(error).__name__}: {error}"[:120])

    def miss(x):
        return np.abs(rewards + mdp.discount * (kernel @ x) - x).max() / np.abs(x).max()

    repeat = 10 if mdp.n_states < 5_000 else 1  # what takes less than a millisecond is not timed with cold caches
    calls = {name: per_call(call, repeat) for name, call in calls.items()}
    yield from rows_of("V", case, interleaved(calls, seconds=seconds), miss, repeat)


def expander(n, entries=10, actions=4):
    """A random sparse MDP: a direct solver fills its matrix."""
    rng = np.random.default_rng(0)
    columns = rng.integers(0, n, n * actions * entries)
    chances = rng.dirichlet(np.ones(entries), size=n * actions).reshape(-1)
    rows = np.arange(0, len(columns) + 1, entries)
    matrix = sparse.csr_array((chances, columns, rows), shape=(n * actions, n))
    return oee.FiniteMDP(matrix, rng.normal(size=(n, actions)), np.full(n, 1 / n), 0.99)


def layered(n, size=4, actions=2, entries=3, reach=50):
    """Levels of 4 states that communicate, each leading up to 50 levels on; states numbered at random."""
    rng = np.random.default_rng(0)
    level = np.repeat(np.arange(n), actions * entries) // size
    ahead = (level + rng.integers(0, reach, len(level))) * size + rng.integers(0, size, len(level))
    new = rng.permutation(n)
    columns = new[np.minimum(ahead, n - 1)].reshape(n, -1)[np.argsort(new)].reshape(-1)
    chances = rng.dirichlet(np.ones(entries), size=n * actions).reshape(-1)
    rows = np.arange(0, len(columns) + 1, entries)
    matrix = sparse.csr_array((chances, columns, rows), shape=(n * actions, n))
    return oee.FiniteMDP(matrix, rng.normal(size=(n, actions)), np.full(n, 1 / n), 0.99)


def tiny():
    """4 states: ours from the rows of the transitions, numpy from a dense P[s, a, s']."""
    rng = np.random.default_rng(1)
    p, r, policy = rng.dirichlet(np.ones(4), (4, 3)), rng.normal(size=(4, 3)), rng.dirichlet(np.ones(3), 4)
    mdp, eye = oee.FiniteMDP(p, r, np.full(4, 0.25), 0.99), np.eye(4)
    calls = {
        "ours, evaluate_policy with its checks": lambda: exact.evaluate_policy(mdp, policy).values,
        "numpy": lambda: np.linalg.solve(
            eye - 0.99 * np.einsum("sa,sat->st", policy, p), np.einsum("sa,sa->s", policy, r)
        ),
    }
    truth = exact.evaluate_policy(mdp, policy).values
    many = {name: per_call(call, 200) for name, call in calls.items()}
    yield from rows_of("V", "4 states", interleaved(many), lambda x: np.abs(x - truth).max() / np.abs(truth).max(), 200)


def measured(n, program):
    """Seconds, bytes and relative residual of one evaluation on the n x n grid, in a process of its own."""
    import psutil

    warm = oee.tasks.gridworld(40, 0.3)
    exact.evaluate_policy(warm, gridworld_policy(40, 0.5))
    mdp, policy = oee.tasks.gridworld(n, 0.3), gridworld_policy(n, 0.5)
    if program == "ours":
        call = lambda: exact.evaluate_policy(mdp, policy).values  # noqa: E731
    else:
        kernel, rewards = policy_kernel(mdp, policy), policy_rewards(mdp, policy)
        call = PEERS[program](kernel, rewards, mdp.discount)
    process, peak, over = psutil.Process(), [0], threading.Event()
    before = process.memory_info().rss

    def watch():
        while not over.wait(0.005):
            peak[0] = max(peak[0], process.memory_info().rss)

    thread = threading.Thread(target=watch)
    thread.start()
    start = time.process_time()
    x = call()
    seconds = time.process_time() - start
    over.set()
    thread.join()
    kernel, rewards = policy_kernel(mdp, policy), policy_rewards(mdp, policy)
    return seconds, peak[0] - before, np.abs(rewards + 0.99 * (kernel @ x) - x).max() / np.abs(x).max()


def memory(n, programs):
    """Rows with the memory in their notes."""
    case = f"grid {n}, delta .5, discount .99, memory"
    for program in programs:
        try:
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                seconds, size, error = pool.apply(measured, (n, program))
            yield row("V", case, program, seconds, error, f"{size / 2**30:.2f} GB")
        except Exception as error:
            yield row("V", case, program, np.nan, note=f"{type(error).__name__}: {error}"[:120])


def rows(*, quick):
    """The table's rows."""
    yield from tiny()
    for n, discount in ((40, 0.99),) if quick else ((40, 0.99), (100, 0.99), (300, 0.99), (300, 0.9999)):
        mdp = oee.tasks.gridworld(n, 0.3, discount=discount)
        for delta in (0.1, 0.5, 0.9):
            case = f"grid {n}, delta {delta:g}, discount {discount:g}"
            yield from against(case, mdp, gridworld_policy(n, delta))
    random = expander(1_000 if quick else 10_000)
    case = f"random sparse MDP of {random.n_states} states"
    yield from against(case, random, oee.uniform_policy(random), peers=("scipy bicgstab", "mdpsolver"))
    kernel, pay = policy_kernel(random, oee.uniform_policy(random)), policy_rewards(random, oee.uniform_policy(random))
    start = time.process_time()  # once: it takes a minute
    x = spsolve(kernel, pay, random.discount)()
    taken, error = time.process_time() - start, np.abs(pay + random.discount * (kernel @ x) - x).max() / np.abs(x).max()
    yield row("V", case, "scipy spsolve", taken, error)
    clock = layered(2_000 if quick else 20_000)
    yield from against(f"layered MDP of {clock.n_states} states", clock, oee.uniform_policy(clock))
    if quick:
        return
    direct = ("quantecon DiscreteDP", "scipy splu (MMD_AT_PLUS_A, symmetric)", "MKL PARDISO")
    mdp = oee.tasks.gridworld(1000, 0.3)
    yield from against("grid 1000, delta 0.5, discount 0.99", mdp, gridworld_policy(1000, 0.5), peers=direct)
    del mdp
    yield from memory(1000, ("ours", *direct))
    yield from memory(3000, ("ours",))
