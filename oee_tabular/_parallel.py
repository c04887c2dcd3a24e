"""Threads and processes, whose number does not change any digit of a result.

BLAS splits long sums among its threads, and the order of the parts decides the last
digits; ``one_thread`` prevents it. Work in several processes goes through joblib on
this machine, or to a dask cluster by its scheduler's address.
"""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, ParamSpec, TypeVar

import numpy as np

from oee_tabular import _checks
from oee_tabular._isolation import begin_worker, safe_children
from oee_tabular._memory import free_memory
from oee_tabular.typing import Array

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

# names of the errors by which loky and dask report a dead worker
DEATHS = ("BrokenProcessPool", "TerminatedWorkerError", "KilledWorker")
BYTES_PER_WORKER = 0.25 * 2**30  # of libraries alone, measured
CONNECT = 5.0  # seconds to wait for a dask scheduler
WATCH = 0.5  # seconds between two looks of a worker at its parent


def dot(x: Array, y: Array) -> float:
    """Compute sum x y by pairwise summation, whose digits depend on no thread.

    It is for long vectors for which ``one_thread`` is not worth its cost.
    """
    return float(np.add.reduce(x * y))


class _OneThread:
    """A context in which BLAS has one thread, and after it as many as before.

    Python threads may enter and leave in any order.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.n_inside = 0
        self.libraries: list[Any] | None = None
        self.before: list[int] = []
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._reset)

    def _reset(self) -> None:
        """Forget the threads that were inside, since a forked process has none of them.

        The lock is new, because no thread is left that would open the old one.
        """
        self.lock = threading.Lock()
        if self.n_inside:
            self.n_inside = 0
            self._set(self.before)

    def __enter__(self) -> None:
        with self.lock:
            if self.n_inside == 0:
                if self.libraries is None:
                    self.libraries = _find_blas()
                self.before = [library.num_threads or 1 for library in self.libraries]
                self._set([1 for _ in self.before])
            self.n_inside += 1

    def __exit__(self, *error: object) -> None:
        with self.lock:
            is_last = self.n_inside == 1
            # before the number is set: what a signal raises in between leaves one
            # thread, never several that the next call would take for one
            self.n_inside = max(self.n_inside - 1, 0)
            if is_last:
                self._set(self.before)

    def _set(self, numbers: list[int]) -> None:
        """Set the number of threads of each library."""
        for library, number in zip(self.libraries or [], numbers, strict=True):
            # threadpoolctl 3.6 lets only one Python thread set the number of OpenBLAS;
            # here the lock makes threads take turns
            getattr(library, "_real_set_num_threads", library.set_num_threads)(number)


def _find_blas() -> list[Any]:
    """Find the BLAS libraries that are loaded."""
    import scipy.linalg  # noqa: F401  it has a BLAS of its own, which must be loaded
    from threadpoolctl import ThreadpoolController

    libraries: list[Any] = (
        ThreadpoolController().select(user_api="blas").lib_controllers
    )
    return libraries


ONE_THREAD = _OneThread()


def one_thread(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Let a function run with one BLAS thread, which takes five microseconds more."""

    @functools.wraps(function)
    def alone(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        # no docstring: it has the function's own
        with ONE_THREAD:
            return function(*args, **kwargs)

    return alone


@contextlib.contextmanager
def backend(jobs: int, dask: str | None) -> Iterator[Any]:
    """Set where ``parallel`` runs: in processes here, or on the cluster at ``dask``.

    Processes here end with this one, however it ends.

    Parameters
    ----------
    jobs : int
        Number of processes; with 1 none is started.
    dask : str, optional
        Address of a dask scheduler, which is used in place of processes here.

    Yields
    ------
    Client or None
        The cluster's client, if there is a cluster.

    Raises
    ------
    OSError
        If no scheduler answers.
    RuntimeError
        If the scheduler has no workers.
    """
    import joblib

    if dask is not None:
        with _connect(dask) as cluster, joblib.parallel_config("dask", pure=False):
            if not cluster.scheduler_info()["workers"]:
                raise RuntimeError(
                    "the dask scheduler has no workers; start one with: dask worker"
                    " ADDRESS --nthreads 1"
                )
            yield cluster
    elif jobs == 1:
        yield None
    else:
        with (
            safe_children() as inherited,
            joblib.parallel_config(
                "loky",
                inner_max_num_threads=1,
                initializer=_begin_worker,
                initargs=(os.getpid(), *inherited()),
            ),
        ):
            yield None


def _connect(address: str) -> Any:
    """Connect to a dask scheduler."""
    _checks.instance(address, str, "dask", "text, a scheduler's address")
    try:
        from distributed import Client
    except ImportError as error:
        raise ImportError(
            "--dask needs dask.distributed; in a clone: pip install '.[dask]'"
        ) from error
    try:
        return Client(address, timeout=CONNECT, set_as_default=True)  # type: ignore[no-untyped-call]
    except Exception as error:  # another server may answer anything
        raise OSError(
            f"no dask scheduler answers at {_checks.show(address)}: {error!s:.200}"
        ) from None


def _begin_worker(parent: int, is_command: bool, safe_path: str | None) -> None:
    """Prepare a process of joblib's."""
    begin_worker(is_command, safe_path)
    end_with_parent(parent)


def end_with_parent(parent: int, *, with_group: bool = False) -> None:
    """Start a thread in a worker that ends it, or its group, once ``parent`` is gone.

    A parent that ends by SIGKILL has no time to end its workers.
    """

    def watch() -> None:
        """Wait for the parent's end."""
        while os.getppid() == parent:
            time.sleep(WATCH)
        if with_group:
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    # on other systems, getppid still names a parent that is gone
    if os.name == "posix":
        threading.Thread(target=watch, daemon=True).start()


def parallel(number: int, jobs: int, dask: str | None, **options: Any) -> Any:
    """Make a ``joblib.Parallel`` for this many calls, in at most as many processes.

    With ``jobs`` -1 there is one process for each core. A single call is made in a
    process
    of its own too, unless ``jobs`` is 1, because the call may end its process.
    """
    import joblib

    most = joblib.cpu_count() if jobs == -1 else jobs
    n_jobs = -1 if dask else min(most, max(number, 2))
    if n_jobs > 1:
        fitting = int(free_memory() / BYTES_PER_WORKER)
        if jobs == -1:
            n_jobs = min(n_jobs, max(fitting, 1))
        elif fitting < n_jobs:
            raise MemoryError(
                f"{n_jobs} processes need {n_jobs * BYTES_PER_WORKER / 2**30:.3g} GiB"
                f" of memory or more; {free_memory() / 2**30:.3g} GiB are free (--jobs"
                f" {max(fitting, 1)})"
            )
    return joblib.Parallel(n_jobs=n_jobs, batch_size=1, **options)


def each(
    function: Callable[..., Any],
    calls: Iterable[tuple[object, ...]],
    number: int,
    *,
    jobs: int,
    dask: str | None,
) -> Iterator[Any]:
    """Yield ``function(*call)`` of each of the ``number`` calls, in their order.

    The error of a call is raised in place of its result.
    """
    if dask is None and (jobs == 1 or number < 2):
        yield from (function(*call) for call in calls)
        return
    import joblib

    try:
        with backend(jobs, dask):
            # a path may be relative to the folder of the caller; a cluster has its own
            folder = os.getcwd() if dask is None else None
            call_there = joblib.delayed(_call_in)
            tasks = (call_there(folder, function, *call) for call in calls)
            yield from parallel(number, jobs, dask, return_as="generator")(tasks)
    except Exception as error:
        if type(error).__name__ not in DEATHS:
            raise
        raise RuntimeError(
            "a worker process was killed, perhaps for lack of memory (fewer jobs need"
            " less)"
        ) from error


def _call_in(folder: str | None, function: Callable[..., Any], *call: object) -> Any:
    """Call a function in a folder: a worker that is used again is in another one."""
    if folder is not None:
        os.chdir(folder)
    return function(*call)


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise a TimeoutError inside after this many seconds.

    There is no limit on Windows, which has no alarm, and outside of the main thread of
    a
    process.
    """
    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return

    def stop(*_: object) -> None:
        """Raise the error; this handles the alarm."""
        raise TimeoutError(f"no answer within {seconds:g} s (--timeout gives it more)")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
