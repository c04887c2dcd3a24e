"""One thread of BLAS inside, whoever is within at the same time, and after a fork."""

import math
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from helpers import GIVE_UP_SECONDS
from test_threads import blas_threads
from threadpoolctl import threadpool_limits

import oee_tabular as oee
from oee_tabular._parallel import dot, one_thread


def test_one_thread_inside_and_as_many_as_before_afterwards():
    """Also after an error, when calls are within calls, and when Python threads leave
    in the order in which they came.
    """
    assert oee.transition_ratio.__name__ == "transition_ratio"
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        assert one_thread(one_thread(blas_threads))() == {1}
        assert blas_threads() == before
        with pytest.raises(ZeroDivisionError):
            one_thread(lambda: 1 / 0)()
        assert blas_threads() == before
        first = threading.Event()
        second = threading.Event()
        seen = []

        @one_thread
        def early():
            first.set()
            second.wait()

        @one_thread
        def late():
            first.wait()
            second.set()
            workers[0].join()
            seen.append(blas_threads())

        workers = [threading.Thread(target=early), threading.Thread(target=late)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        assert seen == [{1}]
        assert blas_threads() == before


FORKS = """
import os, threading
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits
from oee_tabular._parallel import one_thread

def threads():
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

inside, leave = threading.Event(), threading.Event()

@one_thread
def stay():
    inside.set()
    leave.wait(20)

with threadpool_limits(2, user_api="blas"):
    before = threads()
    worker = threading.Thread(target=stay)
    worker.start()
    inside.wait()
    child = os.fork()
    if child == 0:
        os._exit(0 if (threads(), one_thread(threads)(), threads()) == (before, {1}, before) else 1)
    leave.set()
    worker.join()
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_is_not_held_by_threads_that_it_has_not():
    """Forked while another thread is inside: the child gets its threads back, and can
    go inside itself.
    """
    subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", FORKS],
        check=True,
        timeout=GIVE_UP_SECONDS,
    )


def test_dot_is_the_sum():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, 20_001))
    assert abs(dot(x, y) - math.fsum(x * y)) < 1e-13 * np.abs(x * y).sum()
