"""Forked and spawned processes and Python's threads sample what the process that starts them does, to the bit."""

import hashlib
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import oee_tabular as oee

SEEDS = range(2)
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")


def bits(seed):
    """A fingerprint of all that is sampled by compiled loops, and of an estimate."""
    simulator, target = (oee.tasks.gridworld(5, slip) for slip in (0.3, 0.1))
    policy, zeta = oee.uniform_policy(target), oee.true_ratio(target, simulator)
    episodes = oee.sample_episodes(target, policy, 20, 20, seed=seed)
    moves = oee.sample_transitions(target, np.full((25, 4), 0.01), 50, seed=seed)
    returns = oee.sample_returns(simulator, policy, 40, 20, seed=seed, zeta=zeta, record=True)
    estimate = oee.estimators.ModelBased()(oee.Problem(simulator, episodes, horizon=20), policy)
    columns = [column for log in (episodes, moves, returns.log) for column in log.columns().values()]
    parts = [*columns, returns.values, returns.weights, estimate.value]
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def of_a_fork(seed):
    """The fingerprint from a fork of this process."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writer, bits(seed).encode())
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    return os.read(reader, 100).decode()


def of_a_forks_fork(seed):
    """The fingerprint from the fork of a fork, both of which sample."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        bits(seed)
        os.write(writer, of_a_fork(seed).encode())
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    return os.read(reader, 100).decode()


def of_a_fork_during_compilation(seed):
    """The fingerprint from a fork of this process while another of its threads compiles, as far as numba knows."""
    from numba.core.compiler_lock import global_compiler_lock

    inside = threading.Event()

    def compile_something():
        with global_compiler_lock:
            inside.set()
            time.sleep(0.5)

    worker = threading.Thread(target=compile_something)
    worker.start()
    inside.wait(10)
    found = of_a_fork(seed)
    worker.join(10)
    return found


def of_a_pool(method):
    with multiprocessing.get_context(method).Pool(2 if method == "fork" else 1) as pool:
        return pool.map(bits, SEEDS)


def of_threads():
    with ThreadPoolExecutor(8) as pool:
        return list(pool.map(bits, [*SEEDS] * 8))


WAYS = {
    "fork": lambda: of_a_pool("fork"),
    "spawn": lambda: of_a_pool("spawn"),
    "forkserver": lambda: of_a_pool("forkserver"),
    "os.fork": lambda: [of_a_fork(seed) for seed in SEEDS],
    "fork of a fork": lambda: [of_a_forks_fork(seed) for seed in SEEDS],
    "fork during compilation": lambda: [of_a_fork_during_compilation(seed) for seed in SEEDS],
    "8 threads": of_threads,
}


def ran(*ways, layer="default"):
    """What this file says when it is run for some ways: a process of its own, which may be killed or wait for ever."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", __file__, *ways],
        env={**os.environ, "NUMBA_THREADING_LAYER": layer, "NUMBA_NUM_THREADS": "2"},
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    return done.stdout.splitlines() or done.stderr


@needs_fork
def test_forks_have_their_parents_bits():
    """The parent has sampled before, on all its threads."""
    ways = ("os.fork", "fork of a fork", "fork during compilation", "fork")
    assert ran(*ways) == [f"{way}: the same" for way in ways]


def test_new_processes_have_the_same_bits():
    ways = [way for way in ("spawn", "forkserver") if way in multiprocessing.get_all_start_methods()]
    assert ran(*ways) == [f"{way}: the same" for way in ways]


@pytest.mark.parametrize("layer", ["default", "workqueue"])
def test_threads_have_the_same_bits_together(layer):
    """Also where numba's threads take one caller at a time: two at once would end the process."""
    assert ran("8 threads", layer=layer) == ["8 threads: the same"]


if __name__ == "__main__":
    here = [bits(seed) for seed in SEEDS]
    for way in sys.argv[1:]:
        there = WAYS[way]()
        print(f"{way}: {'the same' if there == here * (len(there) // len(SEEDS)) else (here, there)}", flush=True)
