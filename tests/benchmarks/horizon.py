"""T = 200 steps of the n x n gridworld (slip .3, uniform policy): V of all states, J from one corner, mean and variance.

Inside our clock: the public call, with the check of the policy and all that it makes of the rows; "ours, sweeps alone" is the
recursion on what was made before. So are the peers'; "scipy, with its matrices" makes them in the call. ``error``: the largest
difference to the same sums in long doubles, over the largest value (moments: to ours).

Moments are of the product of ratios, P' of slip .1. scipy's recursion: m = E[w r] + gamma K1 m and q = E[w^2 r^2] +
2 gamma E[w^2 r m] + gamma^2 K2 q, three sparse products a step, and q - m^2 at the end.
"""

import numpy as np
from common import interleaved, rows_of
from scipy import sparse

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.exact import finite
from oee_tabular.exact.system import policy_kernel, policy_system
from oee_tabular.exact.values import policy_rewards

STEPS = 200


def scipy_sweeps(kernel, rewards, discount):
    """In place, with 32-bit indices."""

    def call():
        value = np.zeros(len(rewards))
        for _ in range(STEPS):
            value = kernel @ value
            value *= discount
            value += rewards
        return value

    return call


def scipy_from_mdp(mdp, policy):
    """The same, with P_pi and r_pi made in the call."""
    pairs = mdp.n_states * mdp.n_actions
    mean = sparse.csr_array((policy.reshape(-1), np.arange(pairs), np.arange(0, pairs + 1, mdp.n_actions)))
    kernel = mean @ mdp.transitions
    kernel.indices, kernel.indptr = kernel.indices.astype(np.int32), kernel.indptr.astype(np.int32)
    return scipy_sweeps(kernel, mean @ mdp.rewards.reshape(-1), mdp.discount)()


def quantecon(kernel, rewards, discount):
    """``backward_induction`` of a DiscreteDP with one action."""
    from quantecon.markov import DiscreteDP, backward_induction

    states = np.arange(len(rewards))
    ddp = DiscreteDP(rewards, sparse.csr_matrix(kernel), discount, states, np.zeros_like(states))
    return lambda: backward_induction(ddp, STEPS)[0][0]


def jax(kernel, rewards, discount):
    """A jitted scan of segment sums, in double precision."""
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


def sweep(rows, rewards):
    """Ours, on what was made before."""
    out = np.zeros((2, len(rewards)))
    finite.sweep(rows, rewards, STEPS, out)
    return out[0]


def values(size):
    """Rows of V and of J."""
    grid = oee.tasks.gridworld(size, 0.3)
    policy, discount = oee.uniform_policy(grid), grid.discount
    kernel, rewards = policy_kernel(grid, policy), policy_rewards(grid, policy)
    rows = policy_system(grid, policy).kernel
    peers = {}
    for name, maker in {"scipy": scipy_sweeps, "quantecon": quantecon, "jax": jax}.items():
        try:
            peers[name] = maker(kernel, rewards, discount)
        except ImportError:
            continue
    truth = scipy_sweeps(kernel.astype(np.longdouble), rewards, np.longdouble(discount))().astype(float)
    seconds, scale, value = 0.5 if size < 1000 else 4.0, np.abs(truth).max(), grid.initial @ truth
    calls = {
        "ours": lambda: exact.state_values(grid, policy, horizon=STEPS),
        "ours, sweeps alone": lambda: sweep(rows, rewards),
        "scipy, with its matrices": lambda: scipy_from_mdp(grid, policy),
    }
    timed = interleaved({**calls, **peers}, seconds)
    yield from rows_of("V, T = 200", f"grid {size}", timed, lambda v: np.abs(v - truth).max() / scale)
    calls = {
        "ours": lambda: oee.policy_value(grid, policy, horizon=STEPS),
        "ours, without the check": lambda: finite.values_by_horizon(grid, policy, STEPS, is_each=False)[-1],
    }
    peers = {name: lambda call=call: grid.initial @ call() for name, call in peers.items()}
    timed = interleaved({**calls, **peers}, seconds)
    yield from rows_of("J, T = 200", f"grid {size}", timed, lambda j: abs(j - value) / abs(value))


def scipy_matrices(mdp, zeta, policy):
    """What the recursion of three products needs: (K1; 2 gamma E[w^2 r .]) in one matrix, K2, and the two means of rewards."""
    n, discount = mdp.n_states, mdp.discount
    share = np.repeat(policy.reshape(-1), np.diff(mdp.transitions.indptr)) * mdp.transitions.data
    mean = sparse.csr_array((np.ones(policy.size), np.arange(policy.size), np.arange(n + 1) * mdp.n_actions))
    w, r = zeta.values.data, mdp.reward_data

    def merge(data):
        merged = mean @ sparse.csr_array((share * data, mdp.transitions.indices, mdp.transitions.indptr))
        merged.indices, merged.indptr = merged.indices.astype(np.int32), merged.indptr.astype(np.int32)
        return merged

    first, cross, second = merge(discount * w), merge(2 * discount * w**2 * r), merge(discount**2 * w**2)
    rewards = [merge(data) @ np.ones(n) for data in (w * r, w**2 * r**2)]
    return sparse.csr_array(sparse.vstack([first, cross])), second, np.concatenate(rewards)


def scipy_variance(both, second, rewards):
    """The variance from the first state."""
    n = second.shape[0]
    mean, square = np.zeros(n), np.zeros(n)
    for _ in range(STEPS):
        step = both @ mean
        step += rewards
        square = second @ square
        square += step[n:]
        mean = step[:n]
    return (square - mean**2)[0]


def moments(size):
    """Rows of the mean and variance of the product estimator."""
    grid, target = oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)
    policy, zeta = oee.uniform_policy(grid), oee.true_ratio(target, grid)
    ready = scipy_matrices(grid, zeta, policy)
    calls = {
        "ours": lambda: oee.weighted_return_moments(grid, zeta, policy, horizon=STEPS).variance,
        "scipy": lambda: scipy_variance(*ready),
        "scipy, with its matrices": lambda: scipy_variance(*scipy_matrices(grid, zeta, policy)),
    }
    known = calls["ours"]()
    timed = interleaved(calls, 0.5 if size < 1000 else 4.0)
    yield from rows_of("moments, T = 200", f"grid {size}", timed, lambda v: abs(v / known - 1.0))


def rows(*, quick):
    """Every case, smallest first."""
    for size in (10, 40) if quick else (10, 40, 100, 300, 1000):
        yield from values(size)
    for size in (10, 40) if quick else (10, 40, 100, 300, 500):
        yield from moments(size)
