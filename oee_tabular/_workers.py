"""Work in several processes: on this machine through joblib, or on a dask cluster by its scheduler's address."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

CONNECT = 5.0  # seconds to wait for a dask scheduler
WATCH = 0.5  # seconds between two looks of a worker at its parent


@contextlib.contextmanager
def client(address: str, seconds: float = CONNECT) -> Iterator[Any]:
    """A client of the scheduler at ``address``; an OSError where none answers within ``seconds``."""
    try:
        from distributed import Client
    except ImportError as error:
        raise ImportError("--dask needs dask.distributed; in a clone: pip install '.[dask]'") from error
    try:
        connect: Any = Client
        scheduler = connect(address, timeout=seconds, set_as_default=True)
    except Exception as error:  # what is not a scheduler may answer anything
        raise OSError(f"no dask scheduler answers at {address!r}: {error}") from None
    with scheduler:
        yield scheduler


def local_processes() -> Any:
    """The configuration of joblib for processes of this machine, one thread each, that end with this one however it dies."""
    import joblib

    return joblib.parallel_config("loky", inner_max_num_threads=1, initializer=end_with_parent, initargs=(os.getpid(),))


def end_with_parent(parent: int) -> None:
    """In a worker: a thread that ends it once ``parent`` is gone, which a SIGKILL leaves no time to say."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    if os.name == "posix":  # elsewhere getppid names a parent that is gone
        threading.Thread(target=watch, daemon=True).start()


def each(
    function: Callable[..., Any], calls: Iterable[tuple[object, ...]], number: int, *, jobs: int, dask: str | None
) -> Iterator[Any]:
    """``function(*call)`` of each of the ``number`` calls, in their order; an error is raised in its place."""
    if dask is None and (jobs == 1 or number < 2):
        for call in calls:
            yield function(*call)
        return
    import joblib

    with contextlib.ExitStack() as stack:
        if dask is not None:
            cluster = stack.enter_context(client(dask))
            if not cluster.scheduler_info()["workers"]:
                raise RuntimeError(
                    "the dask scheduler has no workers; start one with: dask worker ADDRESS --nthreads 1"
                )
            stack.enter_context(joblib.parallel_config("dask", pure=False))
        else:
            stack.enter_context(local_processes())
        most = -1 if dask is not None or jobs == -1 else min(jobs, number)
        parallel = joblib.Parallel(n_jobs=most, return_as="generator", batch_size=1)
        yield from parallel(joblib.delayed(function)(*call) for call in calls)
