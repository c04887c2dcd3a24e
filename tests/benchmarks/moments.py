"""Cost of exact moments in value recursions of the same MDP. Run by hand: python tests/benchmarks/moments.py.

10 x 10 grid, T = 200, one process, CPU time, medians, kernels warm. A value recursion is T products of the policy's (S, S)
kernel with V (scipy, as ``policy_value(horizon=T)`` does them), and the same loop compiled.
"""

import time

import numpy as np
from numba import njit

import oee_tabular as oee
from oee_tabular.exact.values import policy_kernel, policy_rewards


def clock(call, repeat=31):
    """Median CPU seconds of a call, from batches long enough to be timed."""
    call()
    times = []
    for _ in range(repeat):
        start = time.process_time()
        for _ in range(5):
            call()
        times.append((time.process_time() - start) / 5)
    return float(np.median(times))


@njit
def recursion(indptr, indices, data, rewards, gamma, steps):
    """T backups of V."""
    value, new = np.zeros(len(rewards)), np.zeros(len(rewards))
    for _ in range(steps):
        for s in range(len(rewards)):
            total = 0.0
            for x in range(indptr[s], indptr[s + 1]):
                total += data[x] * value[indices[x]]
            new[s] = rewards[s] + gamma * total
        value, new = new, value
    return value


def table(size=10, steps=200):
    """Print what each moment costs."""
    simulator, target = oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)
    policy, zeta = oee.uniform_policy(simulator), oee.true_ratio(target, simulator)
    kernel, rewards = policy_kernel(simulator, policy), policy_rewards(simulator, policy)
    parts = (kernel.indptr, kernel.indices, kernel.data, rewards, simulator.discount, steps)
    compiled = clock(lambda: recursion(*parts))
    called = clock(lambda: oee.policy_value(simulator, policy, horizon=steps))
    print(f"value recursion: compiled {compiled * 1e3:.3f} ms, policy_value {called * 1e3:.3f} ms")
    print("| moments | ms | compiled recursions | policy_value calls |")
    print("|---|---|---|---|")
    for kind in ("per_decision", "trajectory"):
        for options in ({}, {"self_normalized": True}, {"sources": True}):
            cost = clock(
                lambda kind=kind, options=options: oee.weighted_return_moments(
                    simulator, zeta, policy, kind=kind, horizon=steps, **options
                )
            )
            name = f"{kind} {' '.join(options)}".strip()
            print(f"| {name} | {cost * 1e3:.2f} | {cost / compiled:.0f} | {cost / called:.1f} |")


if __name__ == "__main__":
    table()
