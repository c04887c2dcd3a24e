"""T = 200 steps of the n x n gridworld (slip .3, uniform policy): V of all states, J from one corner, mean and variance.

Inside our clock: the public call, with the check of the policy and all that it makes of the rows; "ours, sweeps alone" is the
recursion on what was made before. So are the peers', on matrices in the form that they like best; "scipy, with its matrices"
makes them in the call. ``error``: the largest difference to the same sums in long doubles (moments: to the centred form), over
the largest value.

Moments are of the product of ratios, P' of slip .1. scipy's recursion: m = E[w r] + gamma K1 m and q = E[w^2 r^2] +
2 gamma E[w^2 r m] + gamma^2 K2 q, three sparse products a step, and q - m^2 at the end.
"""

import numpy as np
from common import interleaved, rows_of
from scipy import sparse

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.exact import _moments, finite, recursions
from oee_tabular.exact.system import as_readonly, policy_kernel, policy_system
from oee_tabular.exact.values import policy_rewards
from oee_tabular.exact.walks import walk_of

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


def averaged(mdp, policy):
    """(S, S A): products with it are means over the policy's actions."""
    pairs = mdp.n_states * mdp.n_actions
    return sparse.csr_array((policy.reshape(-1), np.arange(pairs), np.arange(0, pairs + 1, mdp.n_actions)))


def scipy_from_mdp(mdp, policy):
    """The same, with P_pi and r_pi made in the call."""
    mean = averaged(mdp, policy)
    kernel = mean @ mdp.transitions
    kernel.indices, kernel.indptr = kernel.indices.astype(np.int32), kernel.indptr.astype(np.int32)
    return scipy_sweeps(kernel, mean @ mdp.rewards.reshape(-1), mdp.discount)()


def numpy_sweeps(kernel, rewards, discount):
    """Dense."""
    dense = discount * kernel.toarray()

    def call():
        value = np.zeros(len(rewards))
        for _ in range(STEPS):
            value = rewards + dense @ value
        return value

    return call


def quantecon(kernel, rewards, discount):
    """``backward_induction`` of a DiscreteDP with one action."""
    from quantecon.markov import DiscreteDP, backward_induction

    states = np.arange(len(rewards))
    ddp = DiscreteDP(rewards, sparse.csr_matrix(kernel), discount, states, np.zeros_like(states))
    return lambda: backward_induction(ddp, STEPS)[0][0]


def hiive(kernel, rewards, discount):
    """mdptoolbox's FiniteHorizon with one action."""
    from hiive.mdptoolbox.mdp import FiniteHorizon

    def call():
        problem = FiniteHorizon([sparse.csr_matrix(kernel)], rewards[:, None], discount, STEPS, skip_check=True)
        problem.run()
        return np.asarray(problem.V[:, 0])

    return call


def jax(kernel, rewards, discount):
    """A jitted scan of segment sums, in double precision."""
    import jax
    from jax import numpy as jnp

    jax.config.update("jax_enable_x64", True)
    n = len(rewards)
    states, columns, data = (jnp.asarray(x) for x in (np.repeat(np.arange(n), np.diff(kernel.indptr)),
                                                     kernel.indices, discount * kernel.data))  # fmt: skip
    paid = jnp.asarray(rewards)

    @jax.jit
    def sweeps():
        def step(value, _):
            moved = jax.ops.segment_sum(data * value[columns], states, n, indices_are_sorted=True)
            return paid + moved, None

        return jax.lax.scan(step, jnp.zeros(n), length=STEPS)[0]

    return lambda: np.asarray(sweeps().block_until_ready())


def made(makers, *arguments):
    """{name: call} of the peers; one that is not there is a call that says so."""
    found = {}
    for name, maker in makers.items():
        try:
            found[name] = maker(*arguments)
        except Exception as error:

            def absent(error=error):
                raise error

            found[name] = absent
    return found


def values(size):
    """Rows of V and of J."""
    grid = oee.tasks.gridworld(size, 0.3)
    policy = oee.uniform_policy(grid)
    kernel, rewards, discount = policy_kernel(grid, policy), policy_rewards(grid, policy), grid.discount
    rows = policy_system(grid, policy).kernel
    makers = {"scipy": scipy_sweeps, "quantecon": quantecon, "jax": jax}
    if size <= 10:
        makers["numpy, dense"] = numpy_sweeps
    if size <= 100:
        makers["mdptoolbox"] = hiive
    peers = made(makers, kernel, rewards, discount)
    truth = scipy_sweeps(kernel.astype(np.longdouble), rewards, np.longdouble(discount))().astype(float)
    seconds = 0.5 if size < 1000 else 4.0
    calls = {
        "ours": lambda: exact.state_values(grid, policy, horizon=STEPS),
        "ours, sweeps alone": lambda: finite.sweep(rows, rewards, STEPS, np.zeros((2, len(rewards)))),
        "scipy, with its matrices": lambda: scipy_from_mdp(grid, policy),
    }
    scale = np.abs(truth).max()
    timed = interleaved({**calls, **peers}, seconds)
    yield from rows_of("V, T = 200", f"grid {size}", timed, lambda v: np.abs(v - truth).max() / scale)
    calls = {
        "ours": lambda: oee.policy_value(grid, policy, horizon=STEPS),
        "ours, without the check": lambda: finite.values_by_horizon(grid, policy, STEPS, is_each=False)[-1],
        "ours, all J_t": lambda: exact.policy_values_by_horizon(grid, policy, horizon=STEPS)[-1],
        "ours, occupancy": lambda: (
            (exact.occupancy(grid, policy, horizon=STEPS) * grid.rewards).sum() * (1 - 0.99**STEPS) / (1 - 0.99)
        ),
    }
    peers = {name: (lambda call=call: grid.initial @ call()) for name, call in peers.items() if name != "mdptoolbox"}
    timed = interleaved({**calls, **peers}, seconds)
    value = grid.initial @ truth
    yield from rows_of("J, T = 200", f"grid {size}", timed, lambda j: abs(j - value) / abs(value))


def scipy_moments(mdp, zeta, policy):
    """What the recursion of three products needs: K1, (K1; 2 gamma E[w^2 r .]) in one matrix, K2, and the two pays."""
    n, discount = mdp.n_states, mdp.discount
    share = np.repeat(policy.reshape(-1), np.diff(mdp.transitions.indptr)) * mdp.transitions.data
    averaging = sparse.csr_array(
        (np.ones(policy.size), np.arange(policy.size), np.arange(n + 1) * mdp.n_actions), shape=(n, policy.size)
    )
    w, r = zeta.values.data, mdp.reward_data

    def merged(data):
        found = averaging @ sparse.csr_array((share * data, mdp.transitions.indices, mdp.transitions.indptr))
        found.indices, found.indptr = found.indices.astype(np.int32), found.indptr.astype(np.int32)
        return found

    first, cross, second = merged(discount * w), merged(2 * discount * w**2 * r), merged(discount**2 * w**2)
    pays = [merged(data) @ np.ones(n) for data in (w * r, w**2 * r**2)]
    return sparse.csr_array(sparse.vstack([first, cross])), second, np.concatenate(pays)


def scipy_recursion(both, second, pays):
    """Mean and variance by state."""
    n = second.shape[0]
    mean, square = np.zeros(n), np.zeros(n)
    for _ in range(STEPS):
        step = both @ mean
        step += pays
        square = second @ square
        square += step[n:]
        mean = step[:n]
    return mean, square - mean**2


def moments(size):
    """Rows of the mean and variance of the product estimator."""
    grid, target = oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)
    policy, zeta = oee.uniform_policy(grid), oee.true_ratio(target, grid)
    walk = walk_of(grid, policy, ratio=zeta)
    discounts, nothing = np.full(STEPS, grid.discount), as_readonly(np.zeros((1, grid.n_states)))
    made_before = scipy_moments(grid, zeta, policy)
    variance = _moments.backward(walk, discounts, nothing, False, False)[0][4]
    calls = {
        "ours": lambda: oee.weighted_return_moments(grid, zeta, policy, horizon=STEPS).variance,
        "ours, zeta checked before": lambda: recursions.per_decision_moments(walk, discounts, sources=False).variance,
        "ours, the centred form": lambda: _moments.backward(walk, discounts, nothing, False, False)[0][4, 0],
        "scipy": lambda: scipy_recursion(*made_before)[1][0],
        "scipy, with its matrices": lambda: scipy_recursion(*scipy_moments(grid, zeta, policy))[1][0],
    }
    timed = interleaved(calls, 0.5 if size < 1000 else 4.0)
    yield from rows_of("moments, T = 200", f"grid {size}", timed, lambda v: abs(v / variance[0] - 1.0))


def kinds(size=10):
    """Rows of all kinds of moments, beside the compiled recursion of V, which they may be measured by."""
    grid, target = oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)
    policy, zeta = oee.uniform_policy(grid), oee.true_ratio(target, grid)
    kernel, pay = policy_system(grid, policy).kernel, policy_rewards(grid, policy)
    calls = {"a recursion of V": lambda: finite.sweep(kernel, pay, STEPS, np.zeros((2, len(pay))))}
    for kind in ("per_decision", "trajectory"):
        for options in ({}, {"self_normalized": True}, {"sources": True}):
            calls[f"ours, {kind} {' '.join(options)}".strip()] = lambda kind=kind, options=options: (
                oee.weighted_return_moments(grid, zeta, policy, kind=kind, horizon=STEPS, **options)
            )
    yield from rows_of("kinds of moments, T = 200", f"grid {size}", interleaved(calls, 0.5))


def rows(*, quick=False):
    """Every case, smallest first."""
    for size in (10, 40) if quick else (10, 40, 100, 300, 1000):
        yield from values(size)
    for size in (10, 40) if quick else (10, 40, 100, 300, 500):
        yield from moments(size)
    yield from kinds()


if __name__ == "__main__":
    import sys

    for found in rows(quick="--quick" in sys.argv):
        print("{task} | {case} | {program} | {seconds:.3g} s | {error:.1g} | {note}".format(**found), flush=True)
