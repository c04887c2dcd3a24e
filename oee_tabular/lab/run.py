"""Sweeps: the cells of an experiment through joblib, on this machine or on a dask cluster.

Every cell runs with one BLAS thread wherever it runs, and draws its numbers from its own stream: serial,
processes and cluster give the same bits. Finished cells are written by this process as they come in, one repetition of all
after the other; an interrupted sweep goes on from there, or is written with as many repetitions as it has (``--seeds``).
"""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from oee_tabular._progress import progress_bar
from oee_tabular._workers import backend, parallel
from oee_tabular.lab.registry import Cell, Experiment, Row, RunSettings, Stream
from oee_tabular.lab.store import Store, alone, code_version

ATTEMPTS = 3  # of a cell whose worker died


@dataclass(frozen=True)
class Sweep:
    """What a run did: its results, the cells computed now and those taken from the cache."""

    store: Store
    computed: int
    cached: int

    def __str__(self) -> str:
        stale, damaged = self.store.stale, self.store.damaged
        return (
            f"{self.store.folder}: {self.computed} cells computed"
            + (f", {self.cached} from the cache" if self.cached else "")
            + (f", {stale} of another version of the code left aside" if stale else "")
            + (f"; lines of cells.jsonl that did not fit and are left out: {damaged}" if damaged else "")
        )


def run_and_write(
    folder: Path,
    settings: RunSettings,
    write: Callable[[Store], object],
    *,
    say: Callable[[str], object],
    **options: Any,
) -> None:
    """What both commands do in a folder that is theirs alone: compute, write the files, say what was done.

    Parameters
    ----------
    write : makes the files of a finished store
    say : is told the sweep and its seconds
    options : as in ``run_experiment``
    """
    start = time.perf_counter()
    with alone(folder):
        sweep = run_experiment(folder, settings, **options)
        write(sweep.store)
    say(f"{sweep} ({time.perf_counter() - start:.0f} s)")


def run_experiment(
    folder: Path,
    settings: RunSettings,
    *,
    jobs: int = 1,
    dask: str | None = None,
    fresh: bool = False,
    progress: bool = False,
) -> Sweep:
    """Compute the cells that are not in the folder yet.

    Parameters
    ----------
    jobs : processes on this machine, no more than cells are left; -1: one a core
    dask : address of a dask scheduler; the cells go there instead
    fresh : empty the folder first

    Raises
    ------
    ValueError
        Results of other settings in the folder; jobs = 0.
    OSError
        No scheduler at the address (within ten seconds, before anything is written).
    RuntimeError
        A worker with another version of the package, or with several threads; workers that died three times in a row.
    """
    if isinstance(jobs, bool) or not isinstance(jobs, int | np.integer) or jobs == 0 or jobs < -1:
        raise ValueError(f"jobs must be a positive number, or -1 for one a core; got {jobs!r}")
    require_modules(settings.experiment)
    with backend(jobs, dask) as cluster:
        if cluster is not None:
            _check_workers(cluster)
        elif settings.modules:  # workers of an earlier run may stand in another folder, with modules of the same names
            joblib.externals.loky.get_reusable_executor().shutdown(wait=True)
        store = Store(folder, settings, fresh=fresh)
        store.open()
        todo, total = store.missing(), len(settings.cells())
        with progress_bar(
            settings.experiment.id, total=total, initial=total - len(todo), unit="cell", delay=0.0,
            disable=not progress, leave=True,
        ) as bar:  # fmt: skip
            _compute(store, todo, partial(parallel, jobs=jobs, dask=dask), bar)
    return Sweep(store, len(todo), total - len(todo))


def require_modules(experiment: Experiment) -> None:
    """ImportError that names the extra where an experiment's modules are missing."""
    import importlib.util

    missing = [name for name in experiment.requires if importlib.util.find_spec(name) is None]
    if missing:
        raise ImportError(
            f"{experiment.id} needs {', '.join(missing)}, which is not installed: "
            f"in a clone: pip install '.[{experiment.extra or missing[0]}]'"
        )


def _compute(store: Store, todo: list[Cell], start: Callable[..., Any], bar: Any) -> None:
    settings, left, attempt = store.settings, dict(enumerate(todo)), 0
    own = settings.experiment.run, settings.experiment.id, settings.seed, settings.modules, store.code
    while True:
        before = len(left)
        tasks = [joblib.delayed(_run_cell)(number, cell, *own) for number, cell in left.items()]
        try:
            with _without_interrupts():
                results = start(len(left), return_as="generator_unordered")(tasks)
            for number, rows in results:
                store.add(left.pop(number), rows)
                bar.update()
            return
        except Exception as error:
            if not _is_death(error):
                raise
            attempt = 1 if len(left) < before else attempt + 1
            if attempt == ATTEMPTS:
                first = "; ".join(str(dict(cell)) for cell in list(left.values())[:3])
                raise RuntimeError(
                    f"a worker was killed {ATTEMPTS} times in a row without a finished cell; unfinished: {first}"
                ) from error


def _run_cell(
    number: int, cell: Cell, run: Callable[[Cell, Stream], list[Row]], name: str, seed: int, modules: Any, code: str
) -> tuple[int, list[Row]]:
    """The rows of one cell, with one thread; refused where the package is another version than the one that asks."""
    from threadpoolctl import threadpool_limits

    _refuse_other_code("a worker", code_version(*modules), code)
    with threadpool_limits(limits=1):
        rows = run(cell, Stream(name, seed, cell))
    return number, [
        {key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()} for row in rows
    ]


def _refuse_other_code(worker: str, found: object, asked: str) -> None:
    if found != asked:
        raise RuntimeError(
            f"{worker} must have this version of oee_tabular, {asked}; it has {found} (install the same there)"
        )


def _check_workers(client: Any) -> None:
    """Every worker that is there now has this code; those that come later are checked by their first cell."""
    for address, threads in client.nthreads().items():
        if threads > 1:
            raise RuntimeError(
                f"dask workers must have one thread each; {address} has {threads} (dask worker ADDRESS --nthreads 1)"
            )
    for address, version in client.run(code_version, on_error="return").items():
        _refuse_other_code(f"the worker at {address}", version, code_version())


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Processes that are started here are not interrupted by Ctrl-C: this one is, and ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _is_death(error: Exception) -> bool:
    """Whether a worker was killed, rather than the cell's own code failing."""
    from concurrent.futures.process import BrokenProcessPool

    return isinstance(error, BrokenProcessPool) or type(error).__name__ in ("TerminatedWorkerError", "KilledWorker")
