"""Calls on MDPs of few states beside plain numpy without checks of arguments but row sums and ``isfinite``.

    python tests/benchmarks/small_calls.py [states] [rounds]

Each line: microseconds of this thread's CPU of numpy and of ours, and their ratio; medians over rounds in turns.
"""

import sys
import time

import numpy as np

import oee_tabular as oee


def problem(n_states, n_actions=2, seed=0):
    """P (S, A, S), r (S, A), mu_0, pi, gamma."""
    rng = np.random.default_rng(seed)
    transitions = rng.random((n_states, n_actions, n_states))
    transitions /= transitions.sum(axis=2, keepdims=True)
    first = np.full(n_states, 1.0 / n_states)
    return transitions, rng.random((n_states, n_actions)), first, np.full((n_states, n_actions), 1.0 / n_actions), 0.9


def check(transitions):
    """Row sums and ``isfinite``."""
    if not np.isfinite(transitions).all() or np.abs(transitions.sum(axis=2) - 1.0).max() > 1e-8:
        raise ValueError


def value(transitions, rewards, first, policy, discount):
    """mu_0 (I - gamma P_pi)^-1 r_pi."""
    check(transitions)
    kernel = np.einsum("sa,sat->st", policy, transitions)
    return first @ np.linalg.solve(np.eye(len(first)) - discount * kernel, (policy * rewards).sum(axis=1))


def occupancy(transitions, rewards, first, policy, discount):
    """d(s, a) = (1 - gamma) mu_0 (I - gamma P_pi)^-1 pi."""
    check(transitions)
    kernel = np.einsum("sa,sat->st", policy, transitions)
    states = np.linalg.solve(np.eye(len(first)) - discount * kernel.T, (1.0 - discount) * first)
    return states[:, None] * policy


def cases(n_states):
    """Name -> (numpy, ours)."""
    transitions, rewards, first, policy, discount = given = problem(n_states)
    mdp = oee.FiniteMDP(transitions, rewards, first, discount)

    def build():
        return oee.FiniteMDP(transitions, rewards, first, discount)

    return {
        "FiniteMDP": (lambda: check(transitions), build),
        "FiniteMDP + policy_value": (lambda: value(*given), lambda: oee.policy_value(build(), policy)),
        "policy_value": (lambda: value(*given), lambda: oee.policy_value(mdp, policy)),
        "state_values": (lambda: value(*given), lambda: oee.state_values(mdp, policy)),
        "action_values": (lambda: value(*given), lambda: oee.action_values(mdp, policy)),
        "occupancy": (lambda: occupancy(*given), lambda: oee.occupancy(mdp, policy)),
    }


def time_calls(calls, rounds, seconds=0.02):
    """Median microseconds of a call of each, in turns."""
    number = []
    for call in calls:
        call()
        start = time.thread_time()
        call()
        number.append(max(1, int(seconds / max(time.thread_time() - start, 1e-6))))
    taken = [[] for _ in calls]
    for _ in range(rounds):
        for call, repeat, times in zip(calls, number, taken, strict=True):
            start = time.thread_time()
            for _ in range(repeat):
                call()
            times.append(1e6 * (time.thread_time() - start) / repeat)
    return [float(np.median(times)) for times in taken]


if __name__ == "__main__":
    size = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    rounds = int(sys.argv[2]) if len(sys.argv) > 2 else 15
    for name, calls in cases(size).items():
        numpy_time, own_time = time_calls(calls, rounds)
        print(f"{name:26} numpy {numpy_time:8.1f} us  ours {own_time:8.1f} us  ratio {own_time / numpy_time:5.1f}")
