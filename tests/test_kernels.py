"""Kernels that Python runs while that is cheaper: the same bits, whole arrays where it gives up, compiled where it is long."""

import gc
import threading
from collections import namedtuple

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import _kernels, _progress
from oee_tabular._kernels import Kernel, njit
from oee_tabular.exact.solvers._value_iteration import sweeps
from oee_tabular.exact.system import policy_system

Pair = namedtuple("Pair", "one two")


@njit()
def squared(x):
    return x * x


@njit()
def summed(pair, out):
    total = 0.0
    for i in range(len(pair.one)):
        out[i] += squared(pair.one[i])
        total += out[i] / pair.two[i]
    return total, len(out)


def meanwhile():
    """A long run in another thread."""
    patient = Kernel(lambda: None, None, ())
    patient.patience = 60.0
    other = threading.Thread(target=patient)
    other.start()
    other.join()


def interrupted(x):
    meanwhile()
    return squared(x)


def compiled(kernel):
    return bool(kernel.compiled.signatures)


@pytest.fixture(autouse=True)
def _anew():
    for kernel in (squared, summed):
        kernel.patience = None


@pytest.mark.parametrize("horizon", [None, 20])
def test_python_and_numba_have_the_same_bits(monkeypatch, horizon):
    """A report of everything that ``oee evaluate`` shows; a kernel with numpy's logarithm, or its sums, would fail."""
    simulator, target = oee.tasks.gridworld(5, 0.3), oee.tasks.gridworld(5, 0.1)
    policy = oee.mix(oee.tasks.gridworld_expert(5), oee.uniform_policy(simulator), 0.7)
    found, used = {}, set()
    for kernel in (known for known in gc.get_objects() if type(known) is Kernel):
        kernel.patience = None  # other tests may have had it compiled: then nobody asks whether that is worth it
    for by_python in (True, False):

        def is_worth_compiling(kernel, arrays, by_python=by_python):
            used.add(kernel)
            kernel.patience = 60.0
            return not by_python

        monkeypatch.setattr(Kernel, "_is_worth_compiling", is_worth_compiling)
        log = oee.sample_episodes(target, policy, 30, 20, seed=0)
        problem = oee.Problem(simulator, log, horizon=horizon)
        estimators = ["simulator", "oee", "oee-product", "model-based", "wpdis"]
        found[by_python] = oee.evaluate(problem, policy, estimators=estimators, seed=0).to_json()
        for kernel in used:
            kernel.patience = None
    assert found[True] == found[False]
    assert len(used) > 15


def test_so_have_the_transposed_sweeps_of_occupancies():
    """From a right side whose mean is not a round number; with numpy's mean 58 of 60 such ones differed."""
    rng = np.random.default_rng(0)
    entries = (np.full(1500, 0.2), (np.repeat(np.arange(300), 5), rng.integers(300, size=1500)))
    mdp = oee.FiniteMDP(sparse.csr_array(entries, shape=(300, 300)), np.zeros(300), 0, 0.9)
    system = policy_system(mdp, np.ones((300, 1)))
    for _ in range(5):
        given = (system.kernel, system.largest, True, rng.uniform(size=300), 1e-4)
        assert_array_equal(sweeps.interpreted(*given), sweeps.compiled(*given))


def test_small_calls_are_pythons_and_large_ones_compiled():
    """Numbers, not numpy's, come back from either."""
    summed.compiled = type(summed.compiled)(summed.py_func)
    for n, by_numba in ((3, False), (_kernels.SMALL, True)):
        out = np.zeros(n)
        total, length = summed(Pair(np.full(n, 2.0), np.ones(n)), out)
        assert (total, length, type(total), type(length)) == (4.0 * n, n, float, int)
        assert_array_equal(out, 4.0)
        assert compiled(summed) is by_numba


def test_what_python_gives_up_is_done_by_numba_from_the_arrays_as_they_were(monkeypatch):
    """By the clock, in an inner kernel; and at a division by zero, which both refuse."""
    out = np.ones(3)
    monkeypatch.setattr(_kernels, "PATIENCE", 1e-12)
    assert summed(Pair(np.full(3, 2.0), np.ones(3)), out) == (15.0, 3)
    assert_array_equal(out, 5.0)
    monkeypatch.undo()
    summed.patience = None
    with pytest.raises(ZeroDivisionError):
        summed(Pair(np.full(3, 2.0), np.array([1.0, 1.0, 0.0])), out)
    assert summed.patience == 0.0
    assert_array_equal(out, 9.0)  # once, by numba: Python's were put back


def test_a_thread_ends_its_own_run():
    """Another thread begins a long run in the midst of one that has no time left."""
    hasty = Kernel(interrupted, lambda x: "compiled", ())
    for patience, found in ((1e-12, "compiled"), (60.0, 4.0)):
        hasty.patience = patience
        assert hasty(2.0) == found


def test_a_kernel_may_last_as_long_as_its_code_and_that_of_what_it_calls():
    assert _kernels._length(summed, set()) == sum(len(f.py_func.__code__.co_code) for f in (summed, squared))


def test_who_waits_is_told_once(monkeypatch):
    told = []
    monkeypatch.setattr(_progress, "_compiling", 0.0)
    monkeypatch.setattr(_progress, "tell", told.append)
    for seconds in (1.5, 0.4, 0.2, 5.0):
        _progress.waited(seconds)
    assert told == ["compiling (once)"]
