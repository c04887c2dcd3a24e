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
from oee_tabular.exact import _finite
from oee_tabular.exact.solvers._value_iteration import sweeps
from oee_tabular.exact.system import Kernel as KernelOfRows
from oee_tabular.exact.system import policy_system
from oee_tabular.inference import _profile
from oee_tabular.simulate import _rollout

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


def by_numpy(x):
    return squared(x.sum())


@njit(python=by_numpy)
def square_of_sum(x):
    total = 0.0
    for i in range(len(x)):
        total += x[i]
    return total * total


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
    for kernel in (squared, summed, square_of_sum):
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


def running(weights, axis=None):
    weights[weights < 0.3] = 0.0
    weights[..., 0] += 0.1
    return np.cumsum(weights / weights.sum(axis=axis, keepdims=True), axis=axis)


@pytest.mark.parametrize("share_over", [0.0, 0.02])
def test_so_have_episodes_that_python_walks(share_over):
    """More of them, and longer ones, than numbers are drawn at once for; rows of 1 to 5 entries, zeros among them."""
    rng = np.random.default_rng(1)
    n, n_actions, key = 40, 3, np.uint64(2**63 + 5)
    indptr = np.concatenate([[0], np.cumsum(rng.integers(1, 6, n * n_actions))])
    cumulative = np.concatenate([running(rng.random(k)) for k in np.diff(indptr)])
    indices, over = rng.integers(0, n, indptr[-1]), rng.random(n) < share_over
    tables = running(rng.random(n)), running(rng.random((n, n_actions)), 1), indptr, indices, cumulative
    for horizon in (1, 64, 65, 150):
        given = (key, 70, horizon, *tables, over)
        lengths = _rollout.episode_lengths.compiled(*given)
        assert_array_equal(_rollout.episode_lengths.interpreted(*given), lengths)
        given = (key, np.concatenate([[0], np.cumsum(lengths)]), *tables)
        assert_array_equal(_rollout.episodes.interpreted(*given), _rollout.episodes.compiled(*given))
    given = (key, 5000, running(rng.random(n * n_actions)), indptr, cumulative)
    assert_array_equal(_rollout.transitions.interpreted(*given), _rollout.transitions.compiled(*given))


@pytest.mark.parametrize("paid_by_entry", [False, True])
def test_so_have_finite_sweeps_by_numpy(paid_by_entry):
    """Rows without entries, actions without weight; a part of the rows leaves the others alone."""
    rng = np.random.default_rng(2)
    n, n_actions, steps = 30, 3, 12
    rows = sparse.random_array((n * n_actions, n), density=0.3, rng=rng, format="csr")
    policy = rng.random((n, n_actions)) * (rng.random((n, n_actions)) < 0.6)
    sums = sparse.csr_array(np.einsum("sa,sat->st", policy, rows.toarray().reshape(n, n_actions, n)))
    kernel, back = (policy_kernel(matrix, rate) for matrix, rate in ((sums, 0.97), (sums.T.tocsr(), 1.0)))
    rewards, initial = rng.normal(size=n), rng.random(n) * (rng.random(n) < 0.3)
    pay = rng.normal(size=rows.nnz if paid_by_entry else 0)
    found = []
    for function in (_finite.gradient_flows.interpreted, _finite.gradient_flows.compiled):
        to_go, total = np.zeros((steps + 1, n)), np.full(rows.nnz, 0.1)
        function(kernel, rewards, to_go, back, initial, (rows.indptr, rows.indices, rows.data), policy, pay, total)
        found.append((to_go, total))
    for one, other in zip(*found, strict=True):
        assert_array_equal(one, other)
    ends = [np.full(n, 7.0), np.full(n, 7.0)]
    for function, out in zip((_finite.backup.interpreted, _finite.backup.compiled), ends, strict=True):
        function(kernel, rewards, rewards, out, np.uint64(3), np.uint64(20))
    assert_array_equal(*ends)
    assert_array_equal(ends[0][[0, 2, 20]], 7.0)


def test_so_have_moments_of_rows():
    """Several entries of a row are the largest: the first counts. Rows without entries are left to the compiled loop."""
    rng = np.random.default_rng(3)
    sizes = rng.integers(1, 9, 200)
    indptr = np.concatenate([[0], np.cumsum(sizes)])
    phat, v = rng.random(indptr[-1]), np.round(rng.normal(size=indptr[-1]), 1) / 3.0
    found = []
    for function in (_profile.moments_of_rows.interpreted, _profile.moments_of_rows.compiled):
        mean, spread, best = np.empty(200), np.empty(200), np.empty(200, np.int64)
        found.append((function(indptr, phat, v, mean, best, spread), mean, spread, best))
    for one, other in zip(*found, strict=True):
        assert_array_equal(one, other)
    _profile.moments_of_rows.patience = 60.0
    parts = np.empty(3), np.empty(3, np.int64), np.empty(3)
    _profile.moments_of_rows(np.array([0, 2, 2, 3]), phat[:3], v[:3], *parts)
    assert parts[2][1] == -np.inf
    assert_array_equal(parts[0], [phat[0] * v[0] + phat[1] * v[1], 0.0, phat[2] * v[2]])


def policy_kernel(matrix, rate):
    return KernelOfRows(matrix.indptr.astype(np.uint32), matrix.indices.astype(np.uint32), matrix.data, rate)


def test_what_numpy_does_may_be_larger_and_is_watched_too(monkeypatch):
    square_of_sum.compiled = type(square_of_sum.compiled)(square_of_sum.py_func)
    for n, by_numba in ((_kernels.SMALL + 1, False), (_kernels.WHOLE + 1, True)):
        assert square_of_sum(np.ones(n)) == n * n
        assert compiled(square_of_sum) is by_numba
    square_of_sum.patience = None
    monkeypatch.setattr(_kernels, "PATIENCE", 1e-12)
    square_of_sum.compiled = type(square_of_sum.compiled)(square_of_sum.py_func)
    assert square_of_sum(np.ones(2)) == 4.0
    assert compiled(square_of_sum)  # numpy's run was given up in the kernel that it calls


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
