"""The same bits for any number of BLAS threads, which split long sums: as if there were
one.
"""

import hashlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from helpers import GIVE_UP_SECONDS
from structures import small_world
from threadpoolctl import threadpool_info

import oee_tabular as oee

SIZE = 101  # 10 201 states: OpenBLAS leaves vectors of up to 10 000 to one thread


def digest(*parts):
    """A fingerprint of the bits of arrays and numbers."""
    found = hashlib.sha256()
    for part in parts:
        found.update(np.ascontiguousarray(part, dtype=np.float64).tobytes())
    return found.hexdigest()[:12]


def fingerprints():
    """{call: bits} of calls with long sums or dense matrices."""
    rng = np.random.default_rng(0)
    n = SIZE * SIZE
    initial = rng.dirichlet(np.ones(n))
    simulator, target = (
        oee.FiniteMDP(grid.transitions, grid.transition_rewards, initial, grid.discount)
        for grid in (oee.tasks.gridworld(SIZE, slip) for slip in (0.3, 0.1))
    )
    policy = oee.uniform_policy(simulator)
    zeta = oee.true_ratio(target, simulator)
    uniform = np.full((n, 4), 0.25 / n)
    log = oee.sample_transitions(target, uniform, 30_000, seed=1)
    problem = oee.Problem(simulator, log)
    found = {}
    for name, moments in (
        ("return", oee.return_moments(simulator, policy)),
        ("product", oee.weighted_return_moments(simulator, zeta, policy, horizon=5)),
        (
            "trajectory",
            oee.weighted_return_moments(
                simulator, zeta, policy, horizon=5, kind="trajectory"
            ),
        ),
        (
            "self-normalised",
            oee.weighted_return_moments(
                simulator, zeta, policy, horizon=5, self_normalized=True
            ),
        ),
        (
            "doubly robust",
            oee.doubly_robust_moments(simulator, zeta, policy, horizon=5),
        ),
    ):
        found[name] = digest(moments.mean, moments.variance, moments.bias)
    found["value"] = digest(
        oee.policy_value(simulator, policy),
        oee.policy_value(simulator, policy, horizon=5),
    )
    # an elimination leaves a dense system of some hundred states
    kernel = small_world(3000, 0.1)
    world = oee.FiniteMDP(kernel, np.arange(3000.0), np.full(3000, 1 / 3000), 0.999)
    found["far links"] = digest(oee.state_values(world, np.ones((3000, 1))))
    for options in ({}, {"prior": "tilt"}, {"method": "joint", "seed": 0}):
        found[f"ratio {options}"] = digest(
            oee.transition_ratio(log, simulator, **options).values.data
        )
    for estimator in (oee.estimators.OffEnvironment(), oee.estimators.Marginalized()):
        estimate = estimator(problem, policy, seed=0)
        found[type(estimator).__name__] = digest(
            estimate.value, estimate.standard_error or 0.0
        )
    return found


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="BLAS has one thread on one core")
def test_one_thread_and_two_give_the_same_bits():
    """Two processes at once, which differ in the environment alone."""
    running = [
        subprocess.Popen(
            [sys.executable, __file__],
            env={
                **os.environ,
                "OPENBLAS_NUM_THREADS": threads,
                "MKL_NUM_THREADS": threads,
                "OMP_NUM_THREADS": threads,
            },
            stdout=subprocess.PIPE,
            text=True,
        )
        for threads in ("1", "2")
    ]
    one, two = (
        json.loads(process.communicate(timeout=GIVE_UP_SECONDS)[0])
        for process in running
    )
    assert one["threads"] == 1
    assert two["threads"] == 2
    assert one["bits"] == two["bits"]


def blas_threads():
    return {
        library["num_threads"]
        for library in threadpool_info()
        if library["user_api"] == "blas"
    }


def test_warnings_name_the_callers_line():
    """Through the wrapper, whose file would be in all of them."""
    simulator = oee.tasks.gridworld(4, 0.3)
    target = oee.tasks.gridworld(4, 0.1)
    log = oee.sample_transitions(target, np.full((16, 4), 1 / 64), 300, seed=0)
    twice = np.arange(simulator.transitions.nnz)[:, None] * [1.0, 2.0]
    for call in (
        lambda: oee.transition_ratio(log, simulator, features=twice),
        lambda: oee.transition_ratio(log, simulator, method="linear", features=twice),
        lambda: oee.density_ratio(
            [0.5, 0.3, 0.2],
            [0.3, 0.3, 0.4],
            functions=oee.ratio.Linear(np.ones((3, 2))),
        ),
    ):
        with pytest.warns(UserWarning, match="linearly independent") as caught:
            call()
        assert [warning.filename for warning in caught] == [__file__]


if __name__ == "__main__":
    print(json.dumps({"threads": max(blas_threads()), "bits": fingerprints()}))
