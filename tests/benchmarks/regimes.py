"""V of a fixed policy in every regime: graphs that mix, dense rows, many actions, grids, lattices, layers, a few states.

All clocks, ours and the peers', start with the same MDP and policy: P_pi, r_pi and I - gamma P_pi are formed inside, by each
peer in the quickest way that scipy has. The lists that mdpsolver takes of P_pi are made outside of its clock.
``error`` is the largest |r + gamma P_pi V - V| over the largest |V|.
"""

import numpy as np
import values
from common import interleaved, per_call, row, rows_of
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import policy_rewards
from oee_tabular.tasks.gridworld import gridworld_policy


def kernel_of(mdp, policy):
    """P_pi and r_pi: rows that are picked, a mean over dense rows, or a sparse product."""
    n, m = policy.shape
    if policy.max() == 1.0 == policy.max(axis=1).min():
        taken = np.arange(n) * m + policy.argmax(axis=1)
        return sparse.csr_array(mdp.transitions[taken]), mdp.rewards.reshape(-1)[taken]
    averaging = sparse.csr_array((policy.reshape(-1), np.arange(n * m), np.arange(n + 1) * m), shape=(n, n * m))
    return sparse.csr_array(averaging @ mdp.transitions), np.einsum("sa,sa->s", policy, mdp.rewards)


def matrix_of(mdp, policy):
    """I - gamma P_pi, and r_pi."""
    kernel, rewards = kernel_of(mdp, policy)
    return sparse.eye_array(len(rewards), format="csr") - mdp.discount * kernel, rewards


def bicgstab(mdp, policy):
    """scipy's, without a preconditioner; where it says that it failed, so do we."""
    matrix, rewards = matrix_of(mdp, policy)
    x, info = sparse_linalg.bicgstab(matrix, rewards, rtol=1e-12, atol=0.0, maxiter=5000)
    if info:
        raise RuntimeError(f"info {info}: not converged")
    return x


def spsolve(mdp, policy):
    """scipy's default, which QuantEcon's ``evaluate_policy`` calls."""
    matrix, rewards = matrix_of(mdp, policy)
    return sparse_linalg.spsolve(sparse.csc_matrix(matrix), rewards)


def superlu(mdp, policy):
    """SuperLU with the order and mode that suit a symmetric pattern."""
    matrix, rewards = matrix_of(mdp, policy)
    options = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
    return sparse_linalg.splu(sparse.csc_array(matrix), **options).solve(rewards)


def lapack(mdp, policy):
    """numpy's dense solver."""
    matrix, rewards = matrix_of(mdp, policy)
    return np.linalg.solve(matrix.toarray(), rewards)


def dense_lapack(mdp, policy):
    """numpy and LAPACK from a dense P[s, a, s'] that stands outside of the clock."""
    p = mdp.transitions.toarray().reshape(*mdp.rewards.shape, mdp.n_states)
    actions = policy.argmax(axis=1) if policy.max(axis=1).min() == 1.0 else None
    states = np.arange(len(policy))

    def call():
        kernel = np.matmul(policy[:, None], p)[:, 0] if actions is None else p[states, actions]
        matrix, rewards = np.eye(len(policy)) - mdp.discount * kernel, (policy * mdp.rewards).sum(axis=1)
        return linalg.solve(matrix, rewards, check_finite=False, overwrite_a=True)

    return call


def quantecon(mdp, policy):
    """``DiscreteDP.evaluate_policy`` of a deterministic policy; of another one of the MDP that has it for its one action."""
    from quantecon.markov import DiscreteDP

    n, m = policy.shape
    if policy.max(axis=1).min() == 1.0:
        states, actions = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
        rows = sparse.csr_matrix(mdp.transitions)
        ddp, taken = DiscreteDP(mdp.rewards.reshape(-1), rows, mdp.discount, states, actions), policy.argmax(axis=1)
        return lambda: ddp.evaluate_policy(taken)
    nothing = np.zeros(n, dtype=int)

    def call():
        kernel, rewards = kernel_of(mdp, policy)
        return DiscreteDP(rewards, sparse.csr_matrix(kernel), mdp.discount, np.arange(n), nothing).evaluate_policy(
            nothing
        )

    return call


def mdpsolver(mdp, policy, algorithm, update):
    """mdpsolver with one action: P_pi is formed within the clock, the lists that it takes are made outside."""
    solve = values.mdpsolver(*kernel_of(mdp, policy), mdp.discount, algorithm, update)

    def call():
        kernel_of(mdp, policy)
        return solve()

    return call


SCIPY = {"scipy bicgstab": bicgstab, "scipy spsolve": spsolve, "scipy splu (symmetric)": superlu}
UPDATES = ("standard", "gs", "sor")


def contestants(mdp, policy, direct, dense):
    """Name -> call, or the error in place of it."""
    calls = {"ours": lambda: exact.evaluate_policy(mdp, policy).values}
    for name, solve in SCIPY.items():
        if direct or name == "scipy bicgstab":
            calls[name] = lambda solve=solve: solve(mdp, policy)
    prepared = {f"mdpsolver {update}": (mdpsolver, mdp, policy, "mpi", update) for update in UPDATES}
    if direct:
        prepared["quantecon DiscreteDP"] = quantecon, mdp, policy
    if dense:
        calls["numpy"] = lambda: lapack(mdp, policy)
        prepared["numpy, P dense"] = dense_lapack, mdp, policy
    for name, (prepare, *arguments) in prepared.items():
        try:
            calls[name] = prepare(*arguments)
        except ImportError as error:
            calls[name] = error
    return calls


def against(case, mdp, policy, *, direct=True, dense=False, without=(), seconds=1.0):
    """Rows of one evaluation."""
    calls = {name: call for name, call in contestants(mdp, policy, direct, dense).items() if name not in without}
    yield from (row("V", case, name, np.nan, note=str(call)) for name, call in calls.items() if not callable(call))
    kernel, rewards = policy_kernel(mdp, policy), policy_rewards(mdp, policy)
    repeat = 1 + 2_000 // mdp.n_states
    timed = interleaved({n: per_call(c, repeat) for n, c in calls.items() if callable(c)}, seconds=seconds)

    def miss(x):
        return np.abs(rewards + mdp.discount * (kernel @ x) - x).max() / np.abs(x).max()

    yield from rows_of("V", case, timed, miss, repeat)


def garnet(n, actions=4, entries=5, discount=0.99, seed=0):
    """Each action leads to ``entries`` states that are drawn."""
    rng = np.random.default_rng(seed)
    chances = rng.dirichlet(np.ones(entries), size=n * actions).reshape(-1)
    starts = np.arange(0, n * actions * entries + 1, entries)
    matrix = sparse.csr_array((chances, rng.integers(0, n, len(chances)), starts), shape=(n * actions, n))
    matrix.sum_duplicates()
    return oee.FiniteMDP(matrix, rng.normal(size=(n, actions)), np.full(n, 1 / n), discount)


def dense_mdp(n, actions=2, discount=0.99):
    """Every state leads to all."""
    rng = np.random.default_rng(1)
    rows = rng.random((n * actions, n))
    rows /= rows.sum(axis=1, keepdims=True)
    return oee.FiniteMDP(sparse.csr_array(rows), rng.normal(size=(n, actions)), np.full(n, 1 / n), discount)


def lattice(side, discount=0.99, slip=0.2):
    """A torus in three dimensions: six moves, which slip to a neighbour that is drawn."""
    states = np.arange(side**3).reshape(side, side, side)
    ahead = np.stack([np.roll(states, step, axis).reshape(-1) for axis in range(3) for step in (1, -1)], axis=1)
    chances = slip / 6 + (1 - slip) * np.eye(6)
    n = side**3
    columns, data = np.repeat(ahead[:, None], 6, axis=1).reshape(-1), np.tile(chances, (n, 1, 1)).reshape(-1)
    matrix = sparse.csr_array((data, columns, np.arange(0, 36 * n + 1, 6)), shape=(6 * n, n))
    rewards = np.random.default_rng(0).normal(size=(n, 6))
    return oee.FiniteMDP(matrix, rewards, np.full(n, 1 / n), discount)


def fixed(mdp, seed=3):
    """A deterministic policy that is drawn."""
    actions = np.random.default_rng(seed).integers(0, mdp.n_actions, mdp.n_states)
    return np.eye(mdp.n_actions)[actions]


def random_graphs(*, quick):
    """Graphs that mix."""
    for n, discount in ((1_000, 0.99), (10_000, 0.99), (10_000, 0.99999), (100_000, 0.99)):
        if not quick or n == 1_000:
            mdp = garnet(n, discount=discount)
            without = ("mdpsolver gs", "mdpsolver sor") if discount > 0.999 else ()
            yield f"random {n}, deterministic, {discount}", mdp, fixed(mdp), {"direct": False, "without": without}
    n = 1_000 if quick else 10_000
    mdp = garnet(n)
    yield f"random {n}, uniform, .99", mdp, oee.uniform_policy(mdp), {"direct": False}
    mdp = garnet(n, entries=2)
    yield f"random {n}, 2 next states, deterministic, .99", mdp, fixed(mdp), {"direct": False}
    mdp = garnet(n // 5, actions=100)
    yield f"random {n // 5}, 100 actions, uniform, .99", mdp, oee.uniform_policy(mdp), {"direct": False}
    yield f"random {n // 5}, 100 actions, deterministic, .99", mdp, fixed(mdp), {"direct": False}


def dense_rows(*, quick):
    """Rows that lead to all states."""
    for discount in (0.99, 0.99999):
        n = 200 if quick else 2_000
        mdp = dense_mdp(n, discount=discount)
        for name, policy in (("deterministic", fixed(mdp)), ("uniform", oee.uniform_policy(mdp))):
            options = {"direct": False, "dense": True, "without": ("mdpsolver gs", "mdpsolver sor")}
            yield f"dense {n}, {name}, {discount}", mdp, policy, options


def near_neighbours(*, quick):
    """Grids, a lattice."""
    for n, discount in ((40, 0.99),) if quick else ((40, 0.99), (100, 0.99), (100, 0.99999), (300, 0.99)):
        mdp = oee.tasks.gridworld(n, 0.3, discount=discount)
        without = () if n == 40 else ("mdpsolver gs", "mdpsolver sor", "mdpsolver standard")
        for delta in (0.1, 0.9):
            yield f"grid {n}, delta {delta}, {discount}", mdp, gridworld_policy(n, delta), {"without": without}
    mdp = lattice(8 if quick else 20)
    yield f"lattice {mdp.n_states}, uniform, .99", mdp, oee.uniform_policy(mdp), {"direct": False}


def few_states(*, quick):
    """Where a microsecond of ceremony counts."""
    del quick
    grid = oee.tasks.gridworld(8, 0.3)
    yield "grid of 64 states, delta .5", grid, gridworld_policy(8, 0.5), {"dense": True}
    for n in (4, 64, 200):
        mdp = garnet(n, entries=min(5, n))
        yield f"random {n}, uniform", mdp, oee.uniform_policy(mdp), {"dense": True}
    mdp = dense_mdp(64)
    yield "dense 64, uniform", mdp, oee.uniform_policy(mdp), {"dense": True}


def rows(*, quick):
    """The table's rows."""
    for family in (random_graphs, dense_rows, near_neighbours, few_states):
        for case, mdp, policy, options in family(quick=quick):
            yield from against(case, mdp, policy, **options)
