"""Values, moments and plans of known MDPs against direct and iterative solvers.

V = (I - gamma P_pi)^-1 r_pi (values, regimes, graphs). Inside our clock: ``evaluate_policy`` as it is called, with the check of
the policy, P_pi and r_pi, the solve and the bound on its error. The peers' clock in ``values`` is the solve alone, on what they
like best; in ``regimes`` and ``graphs`` they form P_pi and r_pi, too. ``error`` is the
largest |r + gamma P_pi V - V| over the largest |V|. Memory is what the resident set of a process of its own grew by.

T = 200 rewards on grids (horizon): V, J of one corner, and mean and variance of products of ratios. ``error``: the largest
difference to the same sums in long doubles over the largest value (moments: to ours).

``optimal_policy`` (planning), each peer asked for 1e-6 in the form that it likes best. ``error``: by how much the policy falls
short of the optimal values, relative to the largest of them.
"""

import multiprocessing
import os
import resource
import time
from functools import partial

import mdps
import numpy as np
from scipy import sparse
from scipy.sparse import linalg
from speed import compare, row

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.tasks import gridworld, gridworld_policy

STEPS, EPSILON = 200, 1e-6


# ---- peers: (P_pi, r_pi, discount) -> a call that gives V


def quantecon_model(transitions, rewards, discount):
    """``DiscreteDP`` by state-action pairs; rewards are (S, A)."""
    from quantecon.markov import DiscreteDP

    pairs = np.indices(rewards.shape).reshape(2, -1)
    return DiscreteDP(rewards.reshape(-1), sparse.csr_matrix(transitions), discount, *pairs)


def quantecon(kernel, rewards, discount):
    model, one = quantecon_model(kernel, rewards[:, None], discount), np.zeros(len(rewards), dtype=np.int64)
    return lambda: model.evaluate_policy(one)


def splu(kernel, rewards, discount, **options):
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


def lapack(kernel, rewards, discount):
    return lambda: np.linalg.solve(np.eye(len(rewards)) - discount * kernel.toarray(), rewards)


SPSOLVE, DIRECT = "scipy spsolve", ("quantecon", "scipy splu, symmetric", "MKL PARDISO")
SOLVERS = {
    "quantecon": quantecon, "scipy splu, symmetric": splu, SPSOLVE: partial(splu, permc_spec="COLAMD"),
    "MKL PARDISO": pardiso, "scipy bicgstab": bicgstab, "numpy": lapack,
}  # fmt: skip
ITERATIVE, SPARSE = ("scipy bicgstab",), tuple(SOLVERS)[:-1]


# ---- V


def form(mdp, policy):
    """P_pi and r_pi in the quickest way that scipy has: rows that are picked, or a sparse product."""
    n, m = policy.shape
    if policy.max(axis=1).min() == 1.0:
        pairs = np.arange(n) * m + policy.argmax(axis=1)
        return sparse.csr_array(mdp.transitions[pairs]), mdp.rewards.reshape(-1)[pairs]
    mean = sparse.csr_array((policy.reshape(-1), np.arange(n * m), np.arange(n + 1) * m), shape=(n, n * m))
    return sparse.csr_array(mean @ mdp.transitions), np.einsum("sa,sa->s", policy, mdp.rewards)


def evaluate(name, mdp, policy, peers=SPARSE, *, ready=True, **options):
    """Rows of one V; ``ready``: whether the peers' clock leaves out P_pi and r_pi."""
    kernel, rewards = form(mdp, policy)

    def prepare(peer):
        if ready:
            return SOLVERS[peer](kernel, rewards, mdp.discount)
        return lambda: SOLVERS[peer](*form(mdp, policy), mdp.discount)()

    def miss(x):
        return np.abs(rewards + mdp.discount * (kernel @ x) - x).max() / np.abs(x).max()

    ours, peers = (
        {"ours": lambda: exact.evaluate_policy(mdp, policy).values},
        {peer: partial(prepare, peer) for peer in peers},
    )
    yield from compare("V", name, ours, peers, miss=miss, repeat=1 + 2_000 // mdp.n_states, **options)


def measure_memory(n, program):
    """CPU seconds and GB of one evaluation on the n x n grid, in a process of its own."""
    exact.evaluate_policy(gridworld(40, 0.3), gridworld_policy(40, 0.5))  # compiles
    mdp, policy = gridworld(n, 0.3), gridworld_policy(n, 0.5)
    call = partial(exact.evaluate_policy, mdp, policy)
    if program != "ours":
        call = SOLVERS[program](*form(mdp, policy), mdp.discount)
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    call()
    return time.process_time() - start, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**20


def values(*, quick):
    """Large problems, and their memory; the peers get ready matrices."""
    grid, random = gridworld(300, 0.3, discount=0.9999), mdps.garnet(1_000 if quick else 10_000, entries=10)
    yield from evaluate("grid 300, discount .9999", grid, gridworld_policy(300, 0.5))
    yield from evaluate(f"random MDP of {random.n_states} states", random, oee.uniform_policy(random), ITERATIVE)
    if not quick:
        yield from evaluate("random MDP once", random, oee.uniform_policy(random), (SPSOLVE,), seconds=0.0)  # a minute
        yield from evaluate("grid 1000, delta 0.5", gridworld(1000, 0.3), gridworld_policy(1000, 0.5), DIRECT)
        for n, program in (*((1000, program) for program in ("ours", *DIRECT)), (3000, "ours")):
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                seconds, size = pool.apply(measure_memory, (n, program))
            yield row("V", f"grid {n}, memory", program, seconds, note=f"{size:.2f} GB")


def regimes(*, quick):
    """Graphs that mix, dense rows, many actions, grids, lattices, a few states; P_pi is formed inside every clock."""
    n, dense_of = 1_000 if quick else 10_000, ("numpy", *ITERATIVE)
    cases = [
        (f"random {n}, deterministic", mdps.garnet(n), mdps.fixed_policy, ITERATIVE),
        (f"random {n}, deterministic, .99999", mdps.garnet(n, discount=0.99999), mdps.fixed_policy, ITERATIVE),
        (f"random {n}, uniform", mdps.garnet(n), oee.uniform_policy, ITERATIVE),
        (f"random {n}, 2 next states", mdps.garnet(n, entries=2), mdps.fixed_policy, ITERATIVE),
        (f"random {n // 5}, 100 actions, uniform", mdps.garnet(n // 5, actions=100), oee.uniform_policy, ITERATIVE),
        (f"dense {n // 5}, deterministic", mdps.dense(n // 5), mdps.fixed_policy, dense_of),
        (f"dense {n // 5}, uniform", mdps.dense(n // 5), oee.uniform_policy, dense_of),
        ("lattice", mdps.lattice(8 if quick else 20), oee.uniform_policy, ITERATIVE),
        *(
            (f"random {k}, uniform", mdps.garnet(k, entries=min(5, k)), oee.uniform_policy, SOLVERS)
            for k in (4, 64, 200)
        ),
        ("dense 64, uniform", mdps.dense(64), oee.uniform_policy, SOLVERS),
    ]
    for name, mdp, policy, peers in cases:
        yield from evaluate(name, mdp, policy(mdp), peers, ready=False)
    for side, discount in ((8, 0.99), (40, 0.99)) if quick else ((8, 0.99), (40, 0.99), (100, 0.99999), (300, 0.99)):
        grid = gridworld(side, 0.3, discount=discount)
        yield from evaluate(f"grid {side}, {discount}", grid, gridworld_policy(side, 0.9), ready=False)


def graphs(*, quick):
    """One action: every graph near discount 1, in three sizes."""
    for name in mdps.GRAPHS:
        for n in (500,) if quick else (500, 5_000, 20_000):
            fills = name == "small world" and n > 500
            peers = ("scipy bicgstab",) if fills else ("scipy splu, symmetric", SPSOLVE, "scipy bicgstab")
            peers += ("numpy",) if n == 500 else ()
            for discount in (0.99, 0.999, 0.9999):
                mdp = mdps.graph(name, n, discount)
                yield from evaluate(f"{name} {n}, {discount}", mdp, np.ones((n, 1)), peers, ready=False, seconds=0.2)


# ---- T = 200 rewards


def scipy_sweeps(kernel, rewards, discount):
    """In place, with 32-bit indices."""

    def call():
        value = np.zeros(len(rewards), kernel.dtype)
        for _ in range(STEPS):
            value = kernel @ value
            value *= discount
            value += rewards
        return value

    return call


def quantecon_sweeps(kernel, rewards, discount):
    from quantecon.markov import backward_induction

    model = quantecon_model(kernel, rewards[:, None], discount)
    return lambda: backward_induction(model, STEPS)[0][0]


def jax_sweeps(kernel, rewards, discount):
    """A jitted scan of segment sums, in double precision."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax
    from jax import numpy as jnp

    jax.config.update("jax_enable_x64", True)
    n, reward = len(rewards), jnp.asarray(rewards)
    parts = np.repeat(np.arange(n), np.diff(kernel.indptr)), kernel.indices, discount * kernel.data
    states, columns, data = map(jnp.asarray, parts)

    @jax.jit
    def sweeps():
        def step(value, _):
            return reward + jax.ops.segment_sum(data * value[columns], states, n, indices_are_sorted=True), None

        return jax.lax.scan(step, jnp.zeros(n), length=STEPS)[0]

    return lambda: np.asarray(sweeps().block_until_ready())


SWEEPS = {"scipy": scipy_sweeps, "quantecon": quantecon_sweeps, "jax": jax_sweeps}


def horizon(*, quick):
    """V and J, then moments, smallest grid first."""
    for size in (10, 40) if quick else (10, 40, 100, 300, 1000):
        yield from evaluate_horizon(size, seconds=0.5 if size < 1000 else 4.0)
    for size in (10, 40) if quick else (10, 40, 100, 300, 500):
        yield from moments(size)


def evaluate_horizon(size, seconds):
    """Rows of V and of J on a grid."""
    grid, policy = gridworld(size, 0.3), gridworld_policy(size, 0.0)
    (kernel, rewards), discount, name = form(grid, policy), grid.discount, f"grid {size}"
    truth = scipy_sweeps(kernel.astype(np.longdouble), rewards, np.longdouble(discount))().astype(float)
    peers = {name: partial(make, kernel, rewards, discount) for name, make in SWEEPS.items()}
    ours = {"ours": lambda: exact.state_values(grid, policy, horizon=STEPS)}
    formed = {"scipy, with its matrices": lambda: lambda: scipy_sweeps(*form(grid, policy), discount)()}
    miss = lambda v: np.abs(v - truth).max() / np.abs(truth).max()  # noqa: E731
    yield from compare("V, T = 200", name, ours, peers | formed, miss=miss, seconds=seconds)
    ours = {"ours": lambda: oee.policy_value(grid, policy, horizon=STEPS)}
    miss = lambda j: np.abs(j - truth)[..., 0].max() / abs(truth[0])  # noqa: E731
    yield from compare("J, T = 200", name, ours, peers, miss=miss, seconds=seconds)


def moments(size):
    """Mean and variance of products of ratios, P' of slip .1.

    scipy's recursion: m = E[w r] + gamma K1 m and q = E[w^2 r^2] + 2 gamma E[w^2 r m] + gamma^2 K2 q, three sparse products a
    step, and q - m^2 at the end. On the smallest grid V of as many rewards stands beside the moments.
    """
    grid, policy = gridworld(size, 0.3), gridworld_policy(size, 0.0)
    zeta = oee.true_ratio(gridworld(size, 0.1), grid)
    w, r, gamma, n = zeta.values.data, grid.reward_data, grid.discount, grid.n_states
    mean = sparse.csr_array((policy.reshape(-1), np.arange(4 * n), 4 * np.arange(n + 1)))

    def merge(factor):
        """The mean over actions of factor * P, its indices in 32 bits."""
        weighted = (factor * grid.transitions.data, grid.transitions.indices, grid.transitions.indptr)
        merged = mean @ sparse.csr_array(weighted, shape=grid.transitions.shape)
        merged.indices, merged.indptr = merged.indices.astype(np.int32), merged.indptr.astype(np.int32)
        return merged

    def make_matrices():
        both = sparse.csr_array(sparse.vstack([merge(gamma * w), merge(2 * gamma * w**2 * r)]))
        means = [merge(factor) @ np.ones(n) for factor in (w * r, w**2 * r**2)]
        return both, merge(gamma**2 * w**2), np.concatenate(means)

    def variance(both, second, means):
        first, square = np.zeros(n), np.zeros(n)
        for _ in range(STEPS):
            step = both @ first
            step += means
            square = second @ square
            square += step[n:]
            first = step[:n]
        return (square - first**2)[0]

    def moments_of(**options):
        return lambda: oee.weighted_return_moments(grid, zeta, policy, horizon=STEPS, **options).variance

    ready, known = make_matrices(), moments_of()()
    peers = {"scipy": lambda: partial(variance, *ready)}
    peers["scipy, with its matrices"] = lambda: lambda: variance(*make_matrices())
    miss = lambda v: abs(v / known - 1.0)  # noqa: E731
    yield from compare("moments, T = 200", f"grid {size}", {"ours": moments_of()}, peers, miss=miss, seconds=0.5)
    if size == 10:
        value = partial(oee.state_values, grid, policy, horizon=STEPS)
        kinds = {"per decision": {}, "self-normalised": {"self_normalized": True}, "trajectory": {"kind": "trajectory"}}
        peers = {kind: lambda options=options: moments_of(**options) for kind, options in kinds.items()}
        yield from compare("moments, T = 200", "grid 10, beside V", {"ours": value}, peers)


# ---- plans


def plan_mdpsolver(mdp, update):
    """Modified policy iteration; the model is made once, each call begins with values of 0."""
    import mdpsolver

    (n, m), starts, model = mdp.rewards.shape, mdp.transitions.indptr.tolist(), mdpsolver.model()
    parts = list(zip(starts[:-1], starts[1:], strict=True))
    chances, columns = ([x[i:j].tolist() for i, j in parts] for x in (mdp.transitions.data, mdp.transitions.indices))
    model.mdp(
        discount=mdp.discount, rewards=mdp.rewards.tolist(),
        tranMatProbs=[chances[k : k + m] for k in range(0, n * m, m)],
        tranMatColumns=[columns[k : k + m] for k in range(0, n * m, m)],
    )  # fmt: skip
    options = {"algorithm": "mpi", "update": update, "tolerance": EPSILON, "parallel": False}
    return lambda: (model.solve(**options, initValueVector=[0.0] * n), np.array(model.getPolicy()))[1]


def plan_quantecon(mdp, method):
    model = quantecon_model(mdp.transitions, mdp.rewards, mdp.discount)
    return lambda: model.solve(method=method, epsilon=EPSILON, max_iter=100_000).sigma


JACOBI = {"mdpsolver": (plan_mdpsolver, "standard"), "quantecon": (plan_quantecon, "modified_policy_iteration")}
MODIFIED = JACOBI | {f"mdpsolver {update}": (plan_mdpsolver, update) for update in ("gs", "sor")}
QUANTECON = "quantecon policy_iteration"
PLANNERS = MODIFIED | {f"quantecon {name}": (plan_quantecon, name) for name in ("policy_iteration", "value_iteration")}


def plan(name, mdp, peers):
    """Rows of one MDP."""
    best = oee.state_values(mdp, oee.optimal_policy(mdp))

    def miss(actions):
        return (best - oee.state_values(mdp, np.eye(mdp.n_actions)[actions])).max() / np.abs(best).max()

    ours = {"ours": lambda: oee.optimal_policy(mdp).argmax(axis=1)}
    peers = {peer: partial(prepare, mdp, option) for peer, (prepare, option) in peers.items()}
    yield from compare("planning", name, ours, peers, miss=miss, repeat=1 + 200 // mdp.n_states)


def planning(*, quick):
    """Graphs that mix, where sweeps in place take a hundred times as long; grids, a lattice, a queue, a ring, layers."""
    yield from plan("random 100, .99", mdps.garnet(100), PLANNERS)
    yield from plan("grid 20, slip .3", gridworld(20, 0.3), MODIFIED)
    for n, discount in ((1_000, 0.99),) if quick else ((1_000, 0.99), (1_000, 0.9), (10_000, 0.99), (10_000, 0.99999)):
        yield from plan(f"random {n}, {discount}", mdps.garnet(n, discount=discount), JACOBI)
    if quick:
        return
    yield from plan("random 2000, 50 actions", mdps.garnet(2_000, actions=50), JACOBI)
    yield from plan("random 10000, 2 next states", mdps.garnet(10_000, entries=2), JACOBI)
    yield from plan("dense 500", mdps.dense(500, actions=4), JACOBI)
    for n, discount in ((8, 0.99), (40, 0.99), (100, 0.99), (100, 0.999)):
        grid = gridworld(n, 0.3, discount=discount)
        yield from plan(f"grid {n}, slip .3, {discount}", grid, MODIFIED if n <= 40 else JACOBI)
    yield from plan("lattice 3375", mdps.lattice(15), MODIFIED)


def plan_graphs(*, quick):
    """Graphs of two actions on which policy iteration is ahead, or solvers that sweep."""
    for name, n, discount in (
        (("queue", 200, 0.999),)
        if quick
        else (("queue", 2_000, 0.999), ("ring", 5_000, 0.999), ("layered", 20_000, 0.99))
    ):
        yield from plan(
            f"{name} {n}, {discount}",
            mdps.graph(name, n, discount, actions=2),
            JACOBI | {QUANTECON: PLANNERS[QUANTECON]},
        )
