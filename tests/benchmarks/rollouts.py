"""Sampled transitions: seconds for a million of them, on one core. Run through speed.py, or by hand:

    python tests/benchmarks/rollouts.py [--quick]

Episodes of 200 steps under the uniform policy, returns summed. The 10 x 10 and 100 x 100 grids (slip .3), and a random MDP
of 10^6 states, 2 actions and 4 successors of each, whose tables are larger than a second-level cache. Ours counts the steps up
to the goal only; the peers go on there and, but for the first two of JAX, draw s' from the policy's chain instead of (a, s').
``error``: the mean return's distance from the exact value in standard errors, where a program sums returns. Before them
the products of ratios of products.py: seconds for 10 000 rollouts, and those of the former engine.
"""

import argparse
import importlib
import os

if __name__ == "__main__":  # speed.py sets them for a run of its own
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import numpy as np
import products
from common import interleaved, row, rows_of
from numba import njit
from scipy import sparse

import oee_tabular as oee
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import policy_rewards

TASK, HORIZON = "rollouts", 200


def random_mdp(n_states, n_actions=2, n_successors=4):
    """Successors anywhere: no two steps touch the same cache lines."""
    rng = np.random.default_rng(0)
    successors = rng.integers(0, n_states, (n_states * n_actions, n_successors))
    chances = rng.dirichlet(np.ones(n_successors), n_states * n_actions)
    starts = np.arange(0, successors.size + 1, n_successors)
    moves = sparse.csr_array((chances.reshape(-1), successors.reshape(-1), starts), (len(successors), n_states))
    return oee.FiniteMDP(moves, rng.random((n_states, n_actions)), np.eye(1, n_states)[0], 0.99)


def padded(mdp, policy):
    """(S, K) running sums and successors of the policy's chain, rows filled up with the last successor."""
    chain = policy_kernel(mdp, policy)
    lengths, rank = np.diff(chain.indptr), np.arange(chain.nnz)
    state = np.repeat(np.arange(mdp.n_states), lengths)
    rank = rank - chain.indptr[:-1][state]
    sums = np.ones((mdp.n_states, lengths.max()))
    successors = np.repeat(chain.indices[chain.indptr[1:] - 1][:, None], lengths.max(), axis=1)
    sums[state, rank] = np.concatenate(
        [np.cumsum(chain.data[a:b]) for a, b in zip(chain.indptr, chain.indptr[1:], strict=False)]
    )
    successors[state, rank] = chain.indices
    sums[np.arange(mdp.n_states), lengths - 1] = 1.0
    return chain, sums, successors


@njit
def plain_loop(sums, successors, paid, discount, terminal, n, horizon, rng):
    """The loop that anybody writes: a linear scan of running sums, numpy's Generator."""
    returns, steps = np.zeros(n), 0
    for i in range(n):
        state, scale = 0, 1.0
        for _ in range(horizon):
            u, k = rng.random(), 0
            while sums[state, k] <= u:
                k += 1
            returns[i] += scale * paid[state]
            scale *= discount
            state = successors[state, k]
            steps += 1
            if terminal[state]:
                break
    return steps, returns


def ours(mdp, policy, n):
    """Name -> a function that gives (transitions, returns or None)."""
    few = n // 4

    def returns():
        drawn = oee.sample_returns(mdp, policy, n, HORIZON, seed=0)
        return int(drawn.lengths.sum()), drawn.returns

    def episodes():
        return len(oee.sample_episodes(mdp, policy, few, HORIZON, seed=0)), None

    _, sums, successors = padded(mdp, policy)
    numbers = sums, successors, policy_rewards(mdp, policy), mdp.discount, mdp.absorbing()
    return {
        "ours, sample_returns": returns,
        "ours, sample_episodes": episodes,
        "plain numba loop, s' alone": lambda: plain_loop(*numbers, n, HORIZON, np.random.default_rng(0)),
    }


def scalar_random(calls=200_000):
    """Calls of rng.random(): the least that a Python loop costs."""
    draw = np.random.default_rng(0).random

    def loop():
        for _ in range(calls):
            draw()
        return calls, None

    return {"python, rng.random() alone": loop}


def numpy_loops(mdp, sums, successors, paid, n):
    """All trajectories step together: running sums compared, or one sorted list with the state as whole part."""
    flat = (sums + np.arange(mdp.n_states)[:, None]).reshape(-1)
    wide = sums.shape[1]

    def run(follow):
        rng, state, total = np.random.default_rng(0), np.zeros(n, np.int64), np.zeros(n)
        for t in range(HORIZON):
            total += mdp.discount**t * paid[state]
            state = follow(state, rng.random(n))
        return n * HORIZON, total

    def compared(state, u):
        return successors[state, (u[:, None] >= sums[state]).sum(axis=1)]

    def searched(state, u):
        place = np.minimum(np.searchsorted(flat, state + u, side="right"), state * wide + wide - 1)
        return successors.reshape(-1)[place]

    return {"numpy, compared": lambda: run(compared), "numpy, searchsorted": lambda: run(searched)}


def jax_scans(mdp, policy, sums, successors, paid, n):
    """lax.scan over the steps of all trajectories: s' by running sums of the chain, with the state's expected reward."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp

    def chain(dtype):
        cumulative, table = jnp.asarray(sums[:, :-1], dtype), jnp.asarray(successors, jnp.int32)
        reward = jnp.asarray(paid)

        def follow(key, state):
            u = jax.random.uniform(key, (n,), dtype)
            return table[state, (u[:, None] >= cumulative[state]).sum(axis=1)], reward[state]

        return follow

    def program(follow):
        def step(carry, key):
            state, total, scale = carry
            state, pay = follow(key, state)
            return (state, total + scale * pay, scale * mdp.discount), None

        @jax.jit
        def run(key):
            begin = jnp.zeros(n, jnp.int32), jnp.zeros(n), jnp.asarray(1.0)
            return jax.lax.scan(step, begin, jax.random.split(key, HORIZON))[0][1]

        return lambda: (n * HORIZON, np.asarray(run(jax.random.key(0))))

    return {
        "jax scan, s' alone": program(chain(jnp.float64)),
        "jax scan, s' alone, 32-bit words": program(chain(jnp.float32)),
    }


def quantecon_chain(chain, n):
    """MarkovChain.simulate of the policy's chain, dense too where that is small."""
    from quantecon import MarkovChain

    chain = sparse.csr_matrix(chain)

    def program(matrix):
        model = MarkovChain(matrix)

        def run():
            model.simulate(ts_length=HORIZON + 1, init=np.zeros(n, dtype=np.int64), random_state=0)
            return n * HORIZON, None

        return run

    found = {"quantecon simulate": program(chain)}
    if chain.shape[0] <= 1000:
        found["quantecon simulate, dense"] = program(chain.toarray())
    return found


def gymnasium_loop(mdp, sums, successors, paid, steps=5000):
    """A gymnasium.Env that looks up the same table, one step at a time."""
    import gymnasium

    class Table(gymnasium.Env):
        observation_space = gymnasium.spaces.Discrete(mdp.n_states)
        action_space = gymnasium.spaces.Discrete(mdp.n_actions)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.state = 0
            return self.state, {}

        def step(self, action):
            pay = paid[self.state]
            self.state = int(
                successors[self.state, np.searchsorted(sums[self.state], self.np_random.random(), "right")]
            )
            return self.state, pay, False, False, {}

    env = gymnasium.wrappers.TimeLimit(Table(), HORIZON)

    def loop():
        env.reset(seed=0)
        actions = np.random.default_rng(0)
        for _ in range(steps):
            if env.step(int(actions.integers(mdp.n_actions)))[3]:
                env.reset()
        return steps, None

    return {"gymnasium loop": loop}


def envpool_steps(steps=500, n=64):
    """Its own FrozenLake 8 x 8 (it takes no other tables), 64 environments in one thread."""
    envpool = importlib.import_module("envpool")
    env = envpool.make("FrozenLake8x8-v1", env_type="gymnasium", num_envs=n, num_threads=1)
    actions = np.random.default_rng(0).integers(0, 4, (steps, n)).astype(np.int32)

    def loop():
        env.reset()
        for line in actions:
            env.step(line)
        return steps * n, None

    return {"envpool, FrozenLake": loop}


def case(name, mdp, quick, *, loops=True):
    """Rows of one MDP: a group of programs at a time, each for as many transitions as it can do in a while."""
    policy = oee.uniform_policy(mdp)
    chain, sums, successors = padded(mdp, policy)
    paid, value = policy_rewards(mdp, policy), oee.policy_value(mdp, policy, horizon=HORIZON)
    n, few = (2000, 500) if quick else (20_000, 2000)
    groups = {
        "ours": lambda: ours(mdp, policy, n),
        "numpy": lambda: numpy_loops(mdp, sums, successors, paid, few),
        "jax": lambda: jax_scans(mdp, policy, sums, successors, paid, n),
        "quantecon": lambda: quantecon_chain(chain, n),
    }
    if loops:
        groups["python"] = scalar_random
        groups["gymnasium"] = lambda: gymnasium_loop(mdp, sums, successors, paid)
        groups["envpool"] = envpool_steps
    calls = {}
    for group, make in groups.items():
        try:
            calls |= make()
        except ImportError as error:
            yield row(TASK, name, group, np.nan, note=f"not installed: {error}"[:120])

    def miss(result):
        returns = result[1]
        return np.nan if returns is None else abs(returns.mean() - value) / returns.std() * np.sqrt(len(returns))

    for program, found in interleaved(calls, seconds=0.3 if quick else 1.0).items():
        transitions = 1 if isinstance(found[1], Exception) else found[1][0]
        yield from rows_of(TASK, name, {program: found}, miss, scale=transitions / 1e6)


def rows(*, quick):
    """All cases; ``quick``: fewer episodes, and no large MDP."""
    yield from products.rows(quick=quick)
    for size in (10, 30, 100):
        name = f"a million transitions, grid {size} x {size}"
        yield from case(name, oee.tasks.gridworld(size, 0.3), quick, loops=size == 10)
    if not quick:
        yield from case("a million transitions, random MDP of a million states", random_mdp(10**6), quick, loops=False)


def main():
    """Print nanoseconds a transition, of products milliseconds in all, and multiples of ours."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer episodes, no large MDP")
    base = {}
    for found in rows(quick=parser.parse_args().quick):
        own = base.setdefault(found["case"], found["seconds"])
        unit = "ms" if found["case"].startswith("products") else "ns"
        print(
            f"{found['case']} | {found['program']}: {found['seconds'] * 1e3:.2f} {unit}, "
            f"{found['seconds'] / own:.3g} times ours, "
            f"error {found['error']:.2g} {found['note']}",
            flush=True,
        )


if __name__ == "__main__":
    main()
