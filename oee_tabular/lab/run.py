"""Sweeps: the cells of an experiment through joblib, on this machine or on a dask cluster.

Every cell runs with one BLAS thread and one numba thread wherever it runs, and draws its numbers from its own stream: serial,
processes and cluster give the same bits. Finished cells are written by this process as they come in, one repetition of all
after the other; an interrupted sweep goes on from there, or is written with as many repetitions as it has (``--seeds``).
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from oee_tabular._progress import progress_bar
from oee_tabular._workers import backend, parallel
from oee_tabular.lab.registry import Cell, Experiment, Row, Settings, Stream
from oee_tabular.lab.store import Store, code_version

ATTEMPTS = 3  # of a cell whose worker died


@dataclass(frozen=True)
class Sweep:
    """What a run did: the folder, cells computed now, taken from the cache, and left out as made by other code."""

    folder: Path
    computed: int
    cached: int
    stale: int

    def __str__(self) -> str:
        cached = f", {self.cached} from the cache" if self.cached else ""
        stale = f", {self.stale} of another version of the code left aside" if self.stale else ""
        return f"{self.folder}: {self.computed} cells computed{cached}{stale}"


def run_cell(run: Callable[[Cell, Stream], list[Row]], settings: Settings, cell: Cell, code: str) -> list[Row]:
    """The rows of one cell, with one thread; refused where the package is another version than the one that asks."""
    from threadpoolctl import threadpool_limits

    refuse_other_code(code_version(*settings.modules), code)
    with threadpool_limits(limits=1):
        return [_plain(row) for row in run(cell, Stream(settings.experiment, settings.seed, cell))]


def _plain(row: Row) -> Row:
    return {name: value.item() if isinstance(value, np.generic) else value for name, value in row.items()}


def refuse_other_code(here: str, asked: str) -> None:
    """RuntimeError where a worker's package is not the one that started the sweep."""
    if here != asked:
        raise RuntimeError(
            f"a worker must have this version of oee_tabular, {asked}; it has {here} (install the same there)"
        )


def _task(arguments: tuple[Any, ...]) -> tuple[int, list[Row]]:
    number, *rest = arguments
    return number, run_cell(*rest)


def require_modules(experiment: Experiment) -> None:
    """ImportError that names the extra where an experiment's modules are missing."""
    import importlib.util

    missing = [name for name in experiment.requires if importlib.util.find_spec(name) is None]
    if missing:
        extra = ", ".join(missing)
        raise ImportError(
            f"{experiment.id} needs {extra}, which is not installed: "
            f"in a clone: pip install '.[{experiment.extra or missing[0]}]'"
        )


def run_experiment(
    experiment: Experiment,
    folder: Path,
    settings: Settings,
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
    require_modules(experiment)
    with backend(jobs, dask) as cluster:
        if cluster is not None:
            _check_workers(cluster)
        store = Store(folder, settings, fresh=fresh)
        store.open()
        todo = store.missing()
        total = len(settings.cells())
        bar = progress_bar(
            experiment.id,
            total=total,
            initial=total - len(todo),
            unit="cell",
            delay=0.0,
            disable=not progress,
            leave=True,
        )
        try:
            _compute(experiment, settings, store, todo, partial(parallel, jobs=jobs, dask=dask), bar)
        finally:
            bar.close()
    return Sweep(folder, len(todo), total - len(todo), store.stale)


def _compute(
    experiment: Experiment, settings: Settings, store: Store, todo: list[Cell], start: Callable[..., Any], bar: Any
) -> None:
    left, attempt = dict(enumerate(todo)), 0
    while True:
        before = len(left)
        tasks = (joblib.delayed(_task)((k, experiment.run, settings, cell, store.code)) for k, cell in left.items())
        try:
            with _deaf():
                results = start(len(left), return_as="generator_unordered")(list(tasks))
            for number, rows in results:
                store.add(left.pop(number), rows)
                bar.update()
            return
        except Exception as error:
            if not _died(error):
                raise
            attempt = 1 if len(left) < before else attempt + 1
            if attempt == ATTEMPTS:
                first = "; ".join(str(dict(cell)) for cell in list(left.values())[:3])
                raise RuntimeError(
                    f"a worker was killed {ATTEMPTS} times in a row without a finished cell; unfinished: {first}"
                ) from error


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Processes that are started here are not interrupted by Ctrl-C: this one is, and ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _died(error: Exception) -> bool:
    """Whether a worker was killed, rather than the cell's own code failing."""
    from concurrent.futures.process import BrokenProcessPool

    return isinstance(error, BrokenProcessPool) or type(error).__name__ in ("TerminatedWorkerError", "KilledWorker")


def _check_workers(client: Any) -> None:
    """Every worker that is there now has this code; those that come later are checked by their first cell."""
    versions = client.run(code_version, on_error="return")
    several = {address: n for address, n in client.nthreads().items() if n > 1}
    if several:
        address, n = next(iter(several.items()))
        raise RuntimeError(
            f"dask workers must have one thread each; {address} has {n} (dask worker ADDRESS --nthreads 1)"
        )
    for address, found in versions.items():
        if isinstance(found, BaseException):
            raise RuntimeError(f"the worker at {address} cannot import oee_tabular: {found}")
        refuse_other_code(found, code_version())
