"""Sweeps: the cells of an experiment through joblib, on this machine or on a dask cluster.

Every cell runs with one BLAS thread wherever it runs, and draws its numbers from its own stream: serial,
processes and cluster give the same bits. Finished cells are written by this process as they come in, one repetition of all
after the other; an interrupted sweep goes on from there, or is written with as many repetitions as it has (``--seeds``).
"""

from __future__ import annotations

import contextlib
import importlib.util
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from oee_tabular._progress import progress_bar
from oee_tabular._workers import backend, parallel
from oee_tabular.lab.registry import Cell, Experiment, Row, RunSettings, Stream
from oee_tabular.lab.store import Store, alone, code_version

ATTEMPTS = 3  # of a cell whose worker died
DEATHS = ("BrokenProcessPool", "TerminatedWorkerError", "KilledWorker")  # of a worker, in loky and dask


def run_and_write(
    folder: Path,
    settings: RunSettings,
    write: Callable[[Store], object],
    *,
    say: Callable[[str], object],
    **options: Any,
) -> None:
    """What both commands do in a folder that is theirs alone: compute, write the files, say what was done."""
    start = time.perf_counter()
    with alone(folder):
        store = run_experiment(folder, settings, **options)
        write(store)
    say(f"{store} ({time.perf_counter() - start:.0f} s)")


def run_experiment(
    folder: Path,
    settings: RunSettings,
    *,
    jobs: int = 1,
    dask: str | None = None,
    fresh: bool = False,
    progress: bool = False,
) -> Store:
    """Compute the cells that are not in the folder yet.

    ``jobs``: processes on this machine, no more than cells are left; -1: one a core. ``dask``: address of a scheduler, where
    the cells go instead. ``fresh``: empty the folder first. Nothing is written before the workers are there and have this code.
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
            _compute(store, dict(enumerate(todo)), jobs, dask, bar)
    store.computed, store.cached = len(todo), total - len(todo)
    return store


def require_modules(experiment: Experiment) -> None:
    """ImportError that names the extra where an experiment's modules are missing."""
    missing = [name for name in experiment.requires if importlib.util.find_spec(name) is None]
    if missing:
        raise ImportError(
            f"{experiment.id} needs {', '.join(missing)}, which is not installed: "
            f"in a clone: pip install '.[{experiment.extra or missing[0]}]'"
        )


def _compute(store: Store, left: dict[int, Cell], jobs: int, dask: str | None, bar: Any) -> None:
    """Compute and keep the cells; those of a worker that was killed are tried again."""
    settings, experiment, attempt = store.settings, store.settings.experiment, 0
    while left:
        before = len(left)
        tasks = [
            joblib.delayed(_run_cell)(
                number, experiment.run, Stream(experiment.id, settings.seed, cell), settings.modules, store.code
            )
            for number, cell in left.items()
        ]
        try:
            with _hold_interrupts():
                results = parallel(before, jobs, dask, return_as="generator_unordered")(tasks)
            for number, rows in results:
                store.add(left.pop(number), rows)
                bar.update()
        except Exception as error:
            if type(error).__name__ not in DEATHS:
                raise
            attempt = 1 if len(left) < before else attempt + 1
            if attempt == ATTEMPTS:
                first = "; ".join(str(dict(cell)) for cell in list(left.values())[:3])
                raise RuntimeError(
                    f"a worker was killed {ATTEMPTS} times in a row without a finished cell; unfinished: {first}"
                ) from error


def _run_cell(
    number: int, run: Callable[[Cell, Stream], list[Row]], stream: Stream, modules: tuple[str, ...], code: str
) -> tuple[int, list[Row]]:
    """The rows of one cell, with one thread; refused where the package is another version than the one that asks."""
    from threadpoolctl import threadpool_limits

    _refuse_other_code("a worker", code_version(*modules), code)
    with threadpool_limits(limits=1):
        rows = run(stream.cell, stream)
    return number, [
        {key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()} for row in rows
    ]


def _check_workers(client: Any) -> None:
    """Every worker that is there now has this code; those that come later are checked by their first cell."""
    for address, threads in client.nthreads().items():
        if threads > 1:
            raise RuntimeError(
                f"dask workers must have one thread each; {address} has {threads} (dask worker ADDRESS --nthreads 1)"
            )
    for address, version in client.run(code_version, on_error="return").items():
        _refuse_other_code(f"the worker at {address}", version, code_version())


def _refuse_other_code(worker: str, found: object, asked: str) -> None:
    if found != asked:
        raise RuntimeError(
            f"{worker} must have this version of oee_tabular, {asked}; it has {found} (install the same there)"
        )


@contextlib.contextmanager
def _hold_interrupts() -> Iterator[None]:
    """Processes that are started here are not interrupted by Ctrl-C: this one is, and ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
