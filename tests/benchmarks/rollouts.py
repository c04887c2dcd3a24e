"""Sampled transitions, seconds for a million of them, and products of ratios, seconds for 10 000 rollouts; on one core.

Episodes of 200 steps under the uniform policy, returns summed, on grids (slip .3) and a random MDP of 10^6 states. Ours
counts the steps up to the goal only; the peers go on there, and draw s' from the policy's chain instead of (a, s').
``error``: the mean return's distance from the exact value in standard errors, where a program sums returns. Products:
10 x 10 grid, slip .3 simulated, .28 real; ``error`` is the distance from ``weighted_return_moments`` in exact standard
errors.
"""

import mdps
import numpy as np
from common import interleaved, row, rows_of
from numba import njit

import oee_tabular as oee
from oee_tabular.estimators import DoublyRobust, OffEnvironment
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import policy_rewards

TASK, HORIZON, N_PRODUCTS = "rollouts", 200, 10_000


def fill_rows(mdp, policy):
    """(S, K) running sums and successors of the policy's chain, rows filled up with the last successor."""
    chain = policy_kernel(mdp, policy)
    lengths = np.diff(chain.indptr)
    place = np.minimum(np.arange(lengths.max()), lengths[:, None] - 1) + chain.indptr[:-1, None]
    sums = np.cumsum(np.where(np.arange(lengths.max()) < lengths[:, None], chain.data[place], 0.0), axis=1)
    sums[np.arange(lengths.max()) >= lengths[:, None] - 1] = 1.0
    return chain, sums, chain.indices[place]


@njit
def plain_loop(sums, successors, rewards, discount, terminal, n, horizon, rng):
    """The loop that anybody writes: a linear scan of running sums, numpy's Generator."""
    returns, steps = np.zeros(n), 0
    for i in range(n):
        state, scale = 0, 1.0
        for _ in range(horizon):
            u, k = rng.random(), 0
            while sums[state, k] <= u:
                k += 1
            returns[i] += scale * rewards[state]
            scale *= discount
            state = successors[state, k]
            steps += 1
            if terminal[state]:
                break
    return steps, returns


def ours(mdp, policy, n, sums, successors, rewards):
    """Name -> a function that gives (transitions, returns or None)."""
    numbers = sums, successors, rewards, mdp.discount, mdp.absorbing()

    def returns():
        drawn = oee.sample_returns(mdp, policy, n, HORIZON, seed=0)
        return int(drawn.lengths.sum()), drawn.returns

    return {
        "ours, sample_returns": returns,
        "ours, sample_episodes": lambda: (len(oee.sample_episodes(mdp, policy, n // 4, HORIZON, seed=0)), None),
        "plain numba loop, s' alone": lambda: plain_loop(*numbers, n, HORIZON, np.random.default_rng(0)),
    }


def numpy_loop(mdp, n, sums, successors, rewards):
    """All trajectories step together, running sums compared."""

    def run():
        rng, state, total = np.random.default_rng(0), np.zeros(n, np.int64), np.zeros(n)
        for t in range(HORIZON):
            total += mdp.discount**t * rewards[state]
            state = successors[state, (rng.random(n)[:, None] >= sums[state]).sum(axis=1)]
        return n * HORIZON, total

    return {"numpy": run}


def jax_scan(mdp, n, sums, successors, rewards):
    """lax.scan over the steps of all trajectories: s' by running sums of the chain."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    cumulative, table, reward = jnp.asarray(sums[:, :-1]), jnp.asarray(successors, jnp.int32), jnp.asarray(rewards)

    def step(carry, key):
        state, total, scale = carry
        u = jax.random.uniform(key, (n,), jnp.float64)
        new = table[state, (u[:, None] >= cumulative[state]).sum(axis=1)]
        return (new, total + scale * reward[state], scale * mdp.discount), None

    @jax.jit
    def run(key):
        begin = jnp.zeros(n, jnp.int32), jnp.zeros(n), jnp.asarray(1.0)
        return jax.lax.scan(step, begin, jax.random.split(key, HORIZON))[0][1]

    return {"jax scan, s' alone": lambda: (n * HORIZON, np.asarray(run(jax.random.key(0))))}


def quantecon_chain(chain, n):
    """MarkovChain.simulate of the policy's chain."""
    from quantecon import MarkovChain
    from scipy import sparse

    model, first = MarkovChain(sparse.csr_matrix(chain)), np.zeros(n, dtype=np.int64)

    def run():
        model.simulate(ts_length=HORIZON + 1, init=first, random_state=0)
        return n * HORIZON, None

    return {"quantecon simulate": run}


def sampled(name, mdp, quick):
    """Rows of one MDP: a program at a time, each for as many transitions as it can do in a while."""
    policy, n = oee.uniform_policy(mdp), 2000 if quick else 20_000
    chain, *tables = fill_rows(mdp, policy)
    tables.append(policy_rewards(mdp, policy))
    value, calls = oee.policy_value(mdp, policy, horizon=HORIZON), ours(mdp, policy, n, *tables)
    for peer, make in (
        ("numpy", lambda: numpy_loop(mdp, n // 10, *tables)),
        ("jax", lambda: jax_scan(mdp, n, *tables)),
        ("quantecon", lambda: quantecon_chain(chain, n)),
    ):
        try:
            calls |= make()
        except ImportError as error:
            yield row(TASK, name, peer, np.nan, note=f"not installed: {error}"[:120])

    def miss(result):
        returns = result[1]
        return np.nan if returns is None else abs(returns.mean() - value) / returns.std() * np.sqrt(len(returns))

    for program, timed in interleaved(calls, seconds=0.3 if quick else 1.0).items():
        transitions = 1 if isinstance(timed[1], Exception) else timed[1][0]
        yield from rows_of(TASK, name, {program: timed}, miss, scale=transitions / 1e6)


def products(horizon):
    """Rows of Monte Carlo evaluation by products of ratios."""
    simulator, target = (oee.tasks.gridworld(10, slip) for slip in (0.3, 0.28))
    policy, zeta = oee.uniform_policy(simulator), oee.true_ratio(target, simulator)
    problem = oee.Problem(simulator, oee.Transitions([0], [0], [1]), horizon=horizon)
    options = {"ratio": zeta, "evaluation": "monte_carlo", "n_rollouts": N_PRODUCTS}
    estimators = {
        "ours": OffEnvironment(**options),
        "ours, trajectory": OffEnvironment(**options, weighting="trajectory"),
        "ours, self-normalised": OffEnvironment(**options, self_normalized=True),
        "ours, doubly robust": DoublyRobust(data="rollouts", ratio=zeta, n_rollouts=N_PRODUCTS),
    }
    calls = {name: lambda own=own: own(problem, policy, seed=0).value for name, own in estimators.items()}
    known = oee.weighted_return_moments(simulator, zeta, policy, horizon=horizon)

    def miss(value):
        return abs(value - known.mean) / known.standard_deviation * np.sqrt(N_PRODUCTS)

    yield from rows_of(TASK, f"products of ratios, T = {horizon}", interleaved(calls), miss)


def rows(*, quick):
    """All cases; ``quick``: fewer episodes, and no large MDP."""
    for horizon in (50,) if quick else (10, 50, 200):
        yield from products(horizon)
    for size in (10, 30, 100):
        yield from sampled(f"grid {size} x {size}", oee.tasks.gridworld(size, 0.3), quick)
    if not quick:
        yield from sampled("random MDP of a million states", mdps.garnet(10**6, actions=2, entries=4), quick)
