"""Values, occupancies, moments and plans of known MDPs against direct and iterative
solvers.

V = (I - gamma P_pi)^-1 r_pi (solve). Inside our clock: ``evaluate_policy`` as it is
called, with the check of the policy, P_pi and r_pi, the solve and the bound on its
error; the peers form P_pi and r_pi, too. ``error`` is the largest
|r + gamma P_pi V - V| over the largest |V|.

T = 200 rewards on grids (horizon): V, J of one corner, and mean and variance of
products of ratios. ``error``: the largest difference to the same sums in long doubles
over the largest value (moments: to ours).

``optimal_policy`` (plan), each peer asked for 1e-6 in the form that it likes best.
``error``: by how much the policy falls short of the optimal values, relative to the
largest of them.
"""

import multiprocessing
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

STEPS = 200
EPSILON = 1e-6
GRAPHS = (  # name, states, discount, whether elimination fills much
    ("ring", 20_000, 0.999, False),
    ("ring", 20_000, 0.9999, False),
    ("ring, 10 a side", 20_000, 0.999, False),
    ("chain", 10_000, 0.9999, False),
    ("queue", 5_000, 0.999, False),
    ("queue", 20_000, 0.9999, False),
    ("layered", 20_000, 0.99, False),
    ("banded", 500, 0.99, False),
    ("small world", 500, 0.999, False),
    ("small world", 5_000, 0.99, True),
    ("small world", 5_000, 0.9999, True),
    ("small world", 20_000, 0.999, True),
)


# ---- V: peers (P_pi, r_pi, discount) -> a call


def quantecon_model(transitions, rewards, discount):
    """``DiscreteDP`` by state-action pairs; rewards are (S, A)."""
    from quantecon.markov import DiscreteDP

    pairs = np.indices(rewards.shape).reshape(2, -1)
    return DiscreteDP(
        rewards.reshape(-1), sparse.csr_matrix(transitions), discount, *pairs
    )


def quantecon(kernel, rewards, discount):
    model = quantecon_model(kernel, rewards[:, None], discount)
    one = np.zeros(len(rewards), dtype=np.int64)
    return lambda: model.evaluate_policy(one)


def splu(kernel, rewards, discount, **options):
    """SuperLU, by default with the order and mode that suit a symmetric pattern."""
    options = options or {
        "permc_spec": "MMD_AT_PLUS_A",
        "options": {"SymmetricMode": True},
    }
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
    return partial(pypardiso.PyPardisoSolver().solve, matrix, rewards)


def lapack(kernel, rewards, discount):
    return lambda: np.linalg.solve(
        np.eye(len(rewards)) - discount * kernel.toarray(), rewards
    )


DIRECT = {
    "quantecon": quantecon,
    "scipy splu, symmetric": splu,
    "MKL PARDISO": pardiso,
    "scipy spsolve": partial(splu, permc_spec="COLAMD"),
}


def form(mdp, policy):
    """P_pi and r_pi in the quickest way that scipy has: rows that are picked, or a
    sparse product.
    """
    n, m = policy.shape
    if policy.max(axis=1).min() == 1.0:
        pairs = np.arange(n) * m + policy.argmax(axis=1)
        return sparse.csr_array(mdp.transitions[pairs]), mdp.rewards.reshape(-1)[pairs]
    mean = sparse.csr_array(
        (policy.reshape(-1), np.arange(n * m), np.arange(n + 1) * m), shape=(n, n * m)
    )
    return sparse.csr_array(mean @ mdp.transitions), np.einsum(
        "sa,sa->s", policy, mdp.rewards
    )


def evaluate(name, mdp, policy=None, *, fills=False, **options):
    """Rows of one V: BiCGSTAB, direct solvers where elimination does not fill
    (``fills``), LAPACK up to 2000 states.
    """
    policy = oee.uniform_policy(mdp) if policy is None else policy
    kernel, rewards = form(mdp, policy)
    solvers = {"scipy bicgstab": bicgstab} | ({} if fills else DIRECT)
    solvers |= {"numpy": lapack} if mdp.n_states <= 2_000 else {}

    def prepare(solver):
        return lambda: solver(*form(mdp, policy), mdp.discount)()

    def miss(x):
        return np.abs(rewards + mdp.discount * (kernel @ x) - x).max() / np.abs(x).max()

    ours = {"ours": lambda: exact.evaluate_policy(mdp, policy).values}
    peers = {peer: partial(prepare, solver) for peer, solver in solvers.items()}
    yield from compare(
        "V", name, ours, peers, miss=miss, repeat=1 + 2_000 // mdp.n_states, **options
    )


def solve(most):
    """Grids, random graphs, dense rows, and graphs of narrow bands near discount 1."""
    for side, discount in (
        (8, 0.99),
        (40, 0.99),
        (100, 0.99),
        (300, 0.99),
        (300, 0.9999),
        (1000, 0.99),
    ):
        if side**2 <= most:
            grid = gridworld(side, 0.3, discount=discount)
            yield from evaluate(
                f"grid {side}, {discount}", grid, gridworld_policy(side, 0.5)
            )
    for n, discount in (
        (4, 0.99),
        (64, 0.99),
        (200, 0.99),
        (1_000, 0.99),
        (10_000, 0.99),
        (10_000, 0.99999),
    ):
        if n <= most:
            mdp = mdps.garnet(n, entries=min(n, 5), discount=discount)
            one = mdps.fixed_policy(mdp)
            yield from evaluate(
                f"random {n}, one action, {discount}", mdp, one, fills=n > 200
            )
            yield from evaluate(f"random {n}, {discount}", mdp, fills=n > 200)
    for n in (64, 100, 500, 2_000):
        yield from evaluate(f"dense {n}", mdps.dense(n), fills=True)
    for name, n, discount, fills in GRAPHS:
        if n <= most:
            yield from evaluate(
                f"{name} {n}, {discount}",
                mdps.graph(name, n, discount, actions=2),
                fills=fills,
            )


def memory(most):
    """Seconds, and what the resident set of a process of its own grew by, of one V on
    large grids.
    """
    for n, program in (
        *((1000, program) for program in ("ours", *DIRECT)),
        (3000, "ours"),
    ):
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            try:
                seconds, size = pool.apply(measure_memory, (n, program))
                note = f"{size:.2f} GB"
            except Exception as error:
                seconds = np.nan
                note = f"{type(error).__name__}: {error}"[:120]
        yield row("V", f"grid {n}, memory", program, seconds, note=note)


def measure_memory(n, program):
    """CPU seconds and GB of one evaluation on the n x n grid."""
    exact.evaluate_policy(gridworld(40, 0.3), gridworld_policy(40, 0.5))  # compiles
    mdp = gridworld(n, 0.3)
    policy = gridworld_policy(n, 0.5)
    call = partial(exact.evaluate_policy, mdp, policy)
    if program != "ours":
        call = DIRECT[program](*form(mdp, policy), mdp.discount)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    call()
    return (
        time.process_time() - start,
        (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**20,
    )


def occupy(most):
    """Discounted shares of the states, d = (1 - gamma) (I - gamma P^T)^-1 p_0."""
    for name, n, make in (
        ("grid 100", 100**2, lambda: gridworld(100, 0.3)),
        ("grid 300", 300**2, lambda: gridworld(300, 0.3)),
        (
            "ring 20000, .999",
            20_000,
            lambda: mdps.graph("ring", 20_000, 0.999, actions=2),
        ),
    ):
        if n > most:
            continue
        mdp = make()
        policy = oee.uniform_policy(mdp)

        def matrix(mdp=mdp, policy=policy):
            kernel, _ = form(mdp, policy)
            return sparse.csc_array(
                (sparse.eye_array(mdp.n_states) - mdp.discount * kernel).T
            )

        peers = {
            "SuperLU": lambda a=matrix, m=mdp: (
                lambda: linalg.splu(a()).solve((1 - m.discount) * m.initial)
            ),
            "bicgstab": lambda a=matrix, m=mdp: (
                lambda: linalg.bicgstab(a(), (1 - m.discount) * m.initial, rtol=1e-12)[
                    0
                ]
            ),
        }
        yield from compare(
            "occupancy",
            name,
            {"ours": partial(oee.occupancy, mdp, policy)},
            peers,
            repeat=3,
        )


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


def horizon(most):
    """V and J, then moments, smallest grid first."""
    for size in (10, 40, 100, 300, 1000):
        if size**2 <= most:
            yield from evaluate_horizon(size)
    for size in (10, 40, 100, 300, 500):
        if size**2 <= most:
            yield from moments(size)


def evaluate_horizon(size):
    """Rows of V and of J on a grid."""
    grid = gridworld(size, 0.3)
    policy = gridworld_policy(size, 0.0)
    (kernel, rewards) = form(grid, policy)
    discount = grid.discount
    name = f"grid {size}"
    truth = scipy_sweeps(
        kernel.astype(np.longdouble), rewards, np.longdouble(discount)
    )().astype(float)
    peers = {
        "scipy": partial(scipy_sweeps, kernel, rewards, discount),
        "quantecon": partial(quantecon_sweeps, kernel, rewards, discount),
        "scipy, with its matrices": lambda: (
            lambda: scipy_sweeps(*form(grid, policy), discount)()
        ),
    }
    ours = {"ours": lambda: exact.state_values(grid, policy, horizon=STEPS)}
    miss = lambda v: np.abs(v - truth).max() / np.abs(truth).max()  # noqa: E731
    yield from compare("V, T = 200", name, ours, peers, miss=miss)
    ours = {"ours": lambda: oee.policy_value(grid, policy, horizon=STEPS)}
    miss = lambda j: np.abs(j - truth)[..., 0].max() / abs(truth[0])  # noqa: E731
    yield from compare("J, T = 200", name, ours, peers, miss=miss)


def moments(size):
    """Mean and variance of products of ratios, P' of slip .1.

    scipy's recursion: m = E[w r] + gamma K1 m and q = E[w^2 r^2] + 2 gamma E[w^2 r m] +
    gamma^2 K2 q, three sparse products a step, and q - m^2 at the end. On the smallest
    grid V of as many rewards stands beside the moments.
    """
    grid = gridworld(size, 0.3)
    policy = gridworld_policy(size, 0.0)
    zeta = oee.true_ratio(gridworld(size, 0.1), grid)
    w = zeta.values.data
    r = grid.reward_data
    gamma = grid.discount
    n = grid.n_states
    mean = sparse.csr_array(
        (policy.reshape(-1), np.arange(4 * n), 4 * np.arange(n + 1))
    )

    def merge(factor):
        """The mean over actions of factor * P, its indices in 32 bits."""
        weighted = (
            factor * grid.transitions.data,
            grid.transitions.indices,
            grid.transitions.indptr,
        )
        merged = mean @ sparse.csr_array(weighted, shape=grid.transitions.shape)
        merged.indices, merged.indptr = (
            merged.indices.astype(np.int32),
            merged.indptr.astype(np.int32),
        )
        return merged

    def make_matrices():
        both = sparse.csr_array(
            sparse.vstack([merge(gamma * w), merge(2 * gamma * w**2 * r)])
        )
        means = [merge(factor) @ np.ones(n) for factor in (w * r, w**2 * r**2)]
        return both, merge(gamma**2 * w**2), np.concatenate(means)

    def variance(both, second, means):
        first = np.zeros(n)
        square = np.zeros(n)
        for _ in range(STEPS):
            step = both @ first
            step += means
            square = second @ square
            square += step[n:]
            first = step[:n]
        return (square - first**2)[0]

    def moments_of(**options):
        return lambda: (
            oee.weighted_return_moments(
                grid, zeta, policy, horizon=STEPS, **options
            ).variance
        )

    ready = make_matrices()
    known = moments_of()()
    peers = {"scipy": lambda: partial(variance, *ready)}
    peers["scipy, with its matrices"] = lambda: lambda: variance(*make_matrices())
    miss = lambda v: abs(v / known - 1.0)  # noqa: E731
    yield from compare(
        "moments, T = 200", f"grid {size}", {"ours": moments_of()}, peers, miss=miss
    )
    if size == 10:
        value = partial(oee.state_values, grid, policy, horizon=STEPS)
        kinds = {
            "per decision": {},
            "self-normalised": {"self_normalized": True},
            "trajectory": {"kind": "trajectory"},
        }
        peers = {
            kind: lambda options=options: moments_of(**options)
            for kind, options in kinds.items()
        }
        yield from compare(
            "moments, T = 200", "grid 10, beside V", {"ours": value}, peers
        )


# ---- plans


def plan_mdpsolver(mdp, update):
    """Modified policy iteration; the model is made once, each call begins with values
    of 0.
    """
    import mdpsolver

    (n, m) = mdp.rewards.shape
    starts = mdp.transitions.indptr.tolist()
    model = mdpsolver.model()
    parts = list(zip(starts[:-1], starts[1:], strict=True))
    chances, columns = (
        [x[i:j].tolist() for i, j in parts]
        for x in (mdp.transitions.data, mdp.transitions.indices)
    )
    model.mdp(
        discount=mdp.discount,
        rewards=mdp.rewards.tolist(),
        tranMatProbs=[chances[k : k + m] for k in range(0, n * m, m)],
        tranMatColumns=[columns[k : k + m] for k in range(0, n * m, m)],
    )
    options = {
        "algorithm": "mpi",
        "update": update,
        "tolerance": EPSILON,
        "parallel": False,
    }
    return lambda: (
        model.solve(**options, initValueVector=[0.0] * n),
        np.array(model.getPolicy()),
    )[1]


def plan_quantecon(mdp, method):
    model = quantecon_model(mdp.transitions, mdp.rewards, mdp.discount)
    return lambda: model.solve(method=method, epsilon=EPSILON, max_iter=100_000).sigma


JACOBI = {
    "mdpsolver": (plan_mdpsolver, "standard"),
    "quantecon": (plan_quantecon, "modified_policy_iteration"),
}
SWEEPS = JACOBI | {
    f"mdpsolver {update}": (plan_mdpsolver, update) for update in ("gs", "sor")
}
# 85 s on a grid of 20
PLANNERS = SWEEPS | {"quantecon policy_iteration": (plan_quantecon, "policy_iteration")}


def plan(most):
    """Graphs that mix, where sweeps in place take a hundred times as long; grids, a
    queue, a ring, layers.
    """
    for n, options, discount in (
        (100, {}, 0.99),
        (1_000, {}, 0.99),
        (1_000, {}, 0.9),
        (10_000, {}, 0.99),
        (10_000, {}, 0.99999),
        (2_000, {"actions": 50}, 0.99),
        (10_000, {"entries": 2}, 0.99),
    ):
        if n <= most:
            words = "".join(f", {value} {name}" for name, value in options.items())
            yield from compare_plans(
                f"random {n}{words}, {discount}",
                mdps.garnet(n, discount=discount, **options),
                JACOBI,
            )
    yield from compare_plans("dense 500", mdps.dense(500, actions=4), JACOBI)
    for side, discount in (
        (8, 0.99),
        (20, 0.99),
        (40, 0.99),
        (100, 0.99),
        (100, 0.999),
    ):
        if side**2 <= most:
            mdp = gridworld(side, 0.3, discount=discount)
            yield from compare_plans(f"grid {side}, slip .3, {discount}", mdp, SWEEPS)
    for name, n, discount in (
        ("queue", 2_000, 0.999),
        ("ring", 5_000, 0.999),
        ("layered", 20_000, 0.99),
    ):
        if n <= most:
            yield from compare_plans(
                f"{name} {n}, {discount}", mdps.graph(name, n, discount, actions=2)
            )


def compare_plans(name, mdp, peers=PLANNERS):
    """Rows of one MDP."""
    best = oee.state_values(mdp, oee.optimal_policy(mdp))

    def miss(actions):
        return (
            best - oee.state_values(mdp, np.eye(mdp.n_actions)[actions])
        ).max() / np.abs(best).max()

    ours = {"ours": lambda: oee.optimal_policy(mdp).argmax(axis=1)}
    peers = {
        peer: partial(prepare, mdp, option) for peer, (prepare, option) in peers.items()
    }
    yield from compare(
        "planning", name, ours, peers, miss=miss, repeat=1 + 200 // mdp.n_states
    )
