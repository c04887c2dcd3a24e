"""Threads and processes, whose number does not change a bit.

BLAS splits long sums among its threads, and their order decides the last digits:
``one_thread``. Work in several processes goes through joblib on this machine, or to a
dask cluster by its scheduler's address.
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

from oee_tabular.typing import Array

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def dot(x: Array, y: Array) -> float:
    """sum x y, pairwise; for long vectors that are not worth ``one_thread``."""
    return float(np.add.reduce(x * y))


class _OneThread:
    """BLAS with one thread while anybody is inside, and then as before; Python threads
    may come and go in any order.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.n_inside = 0
        self.libraries: list[Any] | None = None
        self.before: list[int] = []
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._reset)

    def _reset(self) -> None:
        """A forked process has none of the threads that were inside, nor one that would
        open the lock.
        """
        self.lock = threading.Lock()
        if self.n_inside:
            self.n_inside = 0
            self._set(self.before)

    def __enter__(self) -> None:
        with self.lock:
            if self.n_inside == 0:
                if self.libraries is None:
                    import scipy.linalg  # noqa: F401  a BLAS of its own, which must be loaded first
                    from threadpoolctl import ThreadpoolController

                    self.libraries = (
                        ThreadpoolController().select(user_api="blas").lib_controllers
                    )
                self.before = [library.num_threads or 1 for library in self.libraries]
                self._set([1] * len(self.before))
            self.n_inside += 1

    def __exit__(self, *error: object) -> None:
        with self.lock:
            if self.n_inside == 1:
                self._set(self.before)
            self.n_inside = max(self.n_inside - 1, 0)

    def _set(self, numbers: list[int]) -> None:
        for library, number in zip(self.libraries or [], numbers, strict=True):
            # threadpoolctl 3.6 lets only one Python thread set OpenBLAS's number, lest
            # they fight; ours take turns
            getattr(library, "_real_set_num_threads", library.set_num_threads)(number)


ONE_THREAD = _OneThread()


def one_thread(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """The function, with one BLAS thread while it runs (five microseconds more)."""

    @functools.wraps(function)
    def alone(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        with ONE_THREAD:
            return function(*args, **kwargs)

    return alone


CONNECT = 5.0  # seconds to wait for a dask scheduler
WATCH = 0.5  # seconds between two looks of a worker at its parent


@contextlib.contextmanager
def backend(jobs: int, dask: str | None) -> Iterator[Any]:
    """Inside, ``parallel`` starts processes here, which end with this one however it
    dies, or asks the cluster at ``dask``.

    Gives the cluster's client, or None. OSError where no scheduler answers,
    RuntimeError where it has no workers.
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
        with joblib.parallel_config(
            "loky",
            inner_max_num_threads=1,
            initializer=end_with_parent,
            initargs=(os.getpid(),),
        ):
            yield None


def _connect(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise ImportError(
            "--dask needs dask.distributed; in a clone: pip install '.[dask]'"
        ) from error
    try:
        return Client(address, timeout=CONNECT, set_as_default=True)  # type: ignore[no-untyped-call]
    except Exception as error:  # what is not a scheduler may answer anything
        raise OSError(f"no dask scheduler answers at {address!r}: {error}") from None


def end_with_parent(parent: int, *, with_group: bool = False) -> None:
    """In a worker: a thread that ends it, or its group, once ``parent`` is gone, which
    a SIGKILL leaves no time to say.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        if with_group:
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    if os.name == "posix":  # elsewhere getppid names a parent that is gone
        threading.Thread(target=watch, daemon=True).start()


def parallel(number: int, jobs: int, dask: str | None, **options: Any) -> Any:
    """A ``joblib.Parallel`` for so many calls, in no more processes; ``jobs`` -1: one a
    core.

    A single call is made in a process of its own too, unless ``jobs`` is 1: it may be
    one that ends its process.
    """
    import joblib

    most = joblib.cpu_count() if jobs == -1 else jobs
    return joblib.Parallel(
        n_jobs=-1 if dask else min(most, max(number, 2)), batch_size=1, **options
    )


def each(
    function: Callable[..., Any],
    calls: Iterable[tuple[object, ...]],
    number: int,
    *,
    jobs: int,
    dask: str | None,
) -> Iterator[Any]:
    """``function(*call)`` of each of the ``number`` calls, in their order; an error is
    raised in its place.
    """
    if dask is None and (jobs == 1 or number < 2):
        yield from (function(*call) for call in calls)
        return
    import joblib

    with backend(jobs, dask):
        tasks = (joblib.delayed(function)(*call) for call in calls)
        yield from parallel(number, jobs, dask, return_as="generator")(tasks)


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """TimeoutError after so many seconds; none outside of a process's main thread and
    on Windows, which have no alarm.
    """
    if (
        not hasattr(signal, "setitimer")
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return

    def stop(*_: object) -> None:
        raise TimeoutError(f"no answer within {seconds:g} s (--timeout gives it more)")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
