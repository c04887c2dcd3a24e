"""Forked and spawned processes and Python's threads sample what the process that starts
them does, to the bit.
"""

import hashlib
import multiprocessing
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers import GIVE_UP_SECONDS

import oee_tabular as oee

SEEDS = range(2)


def fingerprint(seed):
    """A digest of all that is sampled by compiled loops, and of an estimate."""
    simulator, target = (oee.tasks.gridworld(5, slip) for slip in (0.3, 0.1))
    policy = oee.uniform_policy(target)
    zeta = oee.true_ratio(target, simulator)
    episodes = oee.sample_episodes(target, policy, 20, 20, seed=seed)
    transitions = oee.sample_transitions(target, np.full((25, 4), 0.01), 50, seed=seed)
    returns = oee.sample_returns(
        simulator, policy, 40, 20, seed=seed, zeta=zeta, record=True
    )
    # enough for a pool of threads
    many = oee.sample_returns(simulator, policy, 60_000, 20, seed=seed, zeta=zeta)
    estimate = oee.estimators.ModelBased()(
        oee.Problem(simulator, episodes, horizon=20), policy
    )
    columns = [
        column
        for log in (episodes, transitions, returns.log)
        for column in log.columns().values()
    ]
    parts = [*columns, returns.values, returns.weights, many.values, estimate.value]
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    ).hexdigest()


def of_forks_fork(seed):
    """The fingerprint from a fork of a fork, all of which sample."""
    reader, writer = os.pipe()
    if (child := os.fork()) == 0:
        fingerprint(seed)
        if (grandchild := os.fork()) == 0:
            os.write(writer, fingerprint(seed).encode())
            os._exit(0)
        os._exit(os.waitstatus_to_exitcode(os.waitpid(grandchild, 0)[1]))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    return os.read(reader, 100).decode()


def of_way(way):
    """The fingerprints of both seeds by a pool of processes, by forks of forks, or by
    eight threads at once.
    """
    if way == "fork of a fork":
        return [of_forks_fork(seed) for seed in SEEDS]
    if way == "8 threads":
        with ThreadPoolExecutor(8) as pool:
            return list(pool.map(fingerprint, [*SEEDS] * 4))
    with multiprocessing.get_context(way).Pool(2 if way == "fork" else 1) as pool:
        return pool.map(fingerprint, SEEDS)


WAYS = [
    *multiprocessing.get_all_start_methods(),
    *(["fork of a fork"] if hasattr(os, "fork") else []),
    "8 threads",
]


@pytest.mark.parametrize("way", WAYS)
def test_the_bits_are_the_same(way):
    """In a process of its own, which has sampled before, on threads too; it may be
    killed or wait for ever.
    """
    command = [sys.executable, "-W", "ignore", __file__, way]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=GIVE_UP_SECONDS, check=False
    )
    assert done.stdout == "the same\n", done.stderr


if __name__ == "__main__":
    here = [fingerprint(seed) for seed in SEEDS]
    there = of_way(sys.argv[1])
    print(
        "the same" if there == here * (len(there) // len(SEEDS)) else (here, there),
        flush=True,
    )
