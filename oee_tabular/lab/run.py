"""Runner of experiments: cells through joblib or dask, and the folder that keeps them.

Every cell runs with one BLAS thread, and draws its numbers from its own stream: serial,
processes and cluster give the same bits. Finished cells are written by this process as
they come in, one repetition of all after the other; an interrupted sweep goes on from
there, or is written with as many repetitions as it has (``--seeds``).

A results folder has settings.json, cells.jsonl and the files that are made of them. A
line of cells.jsonl is a finished cell: what it is of (experiment, seed, cell, code),
its rows, and a checksum of both. A folder may come from a stranger. A line whose
checksum, settings or columns do not fit is left out, its cell is computed again, and
the run says so. Links, and whatever else is no plain file, are refused before anything
is written. Results of other code are kept: that code may be run again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import math
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd

from oee_tabular import _files, _writing
from oee_tabular._checks import is_integer, show
from oee_tabular._own_modules import find_own
from oee_tabular._parallel import DEATHS, backend, parallel
from oee_tabular._progress import progress_bar, report_finished
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.experiment import (
    Cell,
    Experiment,
    Row,
    RunSettings,
    Scalar,
    Stream,
)

PACKAGE = Path(__file__).parents[1]
LOCK = _writing.LOCK
SETTINGS = "settings.json"
CELLS = "cells.jsonl"
FILES = (
    SETTINGS,
    CELLS,
    "table.csv",
    "summary.csv",
    "summary.md",
    "figure.svg",
    "figure.png",
    "figure.pdf",
    "cells.csv",
    "league.csv",
    "league.md",
    "league.tex",
    *(
        f"{name}.{kind}"
        for name in ("sizes", "profile", "heat")
        for kind in ("png", "pdf", "svg")
    ),
)
# Errors that reading a damaged file raises: damaged text, lists a thousand deep, and
# values of other types.
DAMAGE = (
    ValueError,
    RecursionError,
    AttributeError,
    KeyError,
    TypeError,
    OverflowError,
)


@functools.cache
def code_version(*modules: str) -> str:
    """Return the package's version and a digest of its files.

    A result depends on them, besides the settings and the libraries. The files of a
    user's ``modules`` count as well, each by itself (not what it imports).
    """
    digest = hashlib.sha256()
    # What results depend on: code, and the data that it ships.
    kinds = (".py", ".csv", ".xml", ".npz")
    for path in sorted(path for path in PACKAGE.rglob("*") if path.suffix in kinds):
        digest.update(path.relative_to(PACKAGE).as_posix().encode())
        digest.update(path.read_bytes())
    for name in modules:
        spec = find_own(name)
        if spec is None or spec.origin is None:
            continue
        if Path(spec.origin).is_file():
            digest.update(Path(spec.origin).read_bytes())
    return f"{importlib.metadata.version('oee-tabular')}+{digest.hexdigest()[:12]}"


@functools.cache
def commit() -> str | None:
    """Return the commit of the git checkout that the package runs from, if it is one.

    git itself is not run. Files may differ from the commit: ``code_version`` has their
    digest.
    """
    with contextlib.suppress(OSError, ValueError):
        folder = PACKAGE.parent / ".git"
        if folder.is_file():  # of a further worktree
            folder = PACKAGE.parent / _after(folder, "gitdir:")
        head = (folder / "HEAD").read_text().strip()
        name = head.removeprefix("ref:").strip()
        if name == head:
            return _as_commit(head)
        shared = folder
        if (folder / "commondir").is_file():
            shared = folder / (folder / "commondir").read_text().strip()
        for place in (folder, shared):
            if (place / name).is_file():
                return _as_commit((place / name).read_text())
        for line in (shared / "packed-refs").read_text().splitlines():
            if line.endswith(f" {name}"):
                return _as_commit(line.split()[0])
    return None


def _after(path: Path, word: str) -> str:
    """Return what a file of one line has after its first word; else a ValueError."""
    text = path.read_text().strip()
    if not text.startswith(word):
        raise ValueError(f"{path} must begin with {word!r}")
    return text.removeprefix(word).strip()


def _as_commit(text: str) -> str | None:
    """Return a commit's digest, or None for any other text."""
    digest = text.strip()
    is_digest = len(digest) in (40, 64) and not set(digest) - set("0123456789abcdef")
    return digest if is_digest else None


def refuse_links(
    folder: Path, names: Iterable[str] = (*FILES, LOCK), *, are_folders: bool = False
) -> None:
    """Raise ValueError where a file that a run writes is a link or no plain file.

    It could lead out of the folder. With ``are_folders`` the names must be folders.
    """
    if os.path.lexists(folder) and not folder.is_dir():
        kind = "a file" if folder.is_file() else "none"
        raise ArgumentError(f"{folder}", f"must be a folder; it is {kind}")
    for path in (folder / name for name in names):
        is_right = path.is_dir() if are_folders else path.is_file()
        if path.is_symlink() or (path.exists() and not is_right):
            rule = "a folder" if are_folders else "a plain file"
            raise ArgumentError(
                f"{str(path)!r}",
                f"must be {rule}; it is a link or something else: remove it",
            )


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold ``folder``, which is made where it is missing.

    ValueError says that another command holds it, or that a file in it is a link. The
    lock is the system's: it ends with the process that holds it, however it dies.
    """
    refuse_links(folder)
    remedy = "wait for it, or name another folder with --output"
    with _writing.alone_in(folder, remedy):
        yield


class Store:
    """Finished cells of a results folder.

    Parameters
    ----------
    folder : Path
        The results folder; it need not exist.
    settings : RunSettings
        What the folder's results must be made from.
    fresh : bool, default False
        Whether the folder is emptied first.
    code : str, optional
        The version of the code, as ``code_version`` returns it.
    overwrite : bool, default True
        Whether files are replaced that no run wrote here, or that have changed since.

    Attributes
    ----------
    stale : int
        Number of lines of other code, which are kept.
    damaged : int
        Number of lines that do not fit, which are left out.
    computed, cached : int
        Numbers of cells that a run computed, and that it took from here.

    Raises
    ------
    ValueError
        If the folder holds results of other settings (the difference is named), unless
        ``fresh`` is given. More repetitions are no other settings, nor are fewer where
        the sweep was interrupted: finished cells are kept. If a file would be lost,
        unless ``overwrite`` is True.
    """

    def __init__(
        self,
        folder: Path,
        settings: RunSettings,
        *,
        fresh: bool = False,
        code: str | None = None,
        overwrite: bool = True,
    ):
        """Read the finished cells of the folder."""
        self.folder = folder
        self.settings = settings
        self.code = code_version(*settings.modules) if code is None else code
        self.overwrite = overwrite
        refuse_links(folder)
        if fresh and folder.exists():
            self._empty()
        if (folder / SETTINGS).is_file():
            self._compare()
        self._own_files()
        self._done: dict[str, list[Row]] = {}
        self.computed = self.cached = 0
        self._others: list[str] = []
        self.damaged = 0
        if (folder / CELLS).is_file():
            for line in (folder / CELLS).read_bytes().splitlines():
                self._read(line)
        self.stale = len(self._others)

    def __str__(self) -> str:
        """Return how many cells were computed, taken from here and left out."""
        text = f"{self.folder}: {self.computed} cells computed"
        if self.cached:
            text += f", {self.cached} from the cache"
        if self.stale:
            text += f", {self.stale} of another version of the code left aside"
        if self.damaged:
            text += (
                f"; lines of {CELLS} that did not fit and are left out: {self.damaged}"
            )
        return text

    def _empty(self) -> None:
        """Remove the results; ValueError where other files are in the folder."""
        present = [path for path in self.folder.iterdir() if path.name != LOCK]
        if present and not (self.folder / SETTINGS).is_file():
            raise ArgumentError(
                f"{self.folder}",
                f"must be a results folder to be emptied; it has no {SETTINGS}",
            )
        others = sorted(
            path.name
            for path in present
            if path.name not in FILES and not _writing.PART.fullmatch(path.name)
        )
        if others:
            raise ArgumentError(
                f"{self.folder}",
                "must hold results only to be emptied; it holds"
                f" {', '.join(others[:3])}",
            )
        if present:
            _read_settings(self.folder / SETTINGS)
        for path in present:
            path.unlink()

    def _own_files(self) -> dict[str, str]:
        """Return the digests of the files that are as a run wrote them here, by name.

        Raises an ArgumentError for the first other one that would be lost.
        """
        listed = _writing.listed_files(self.folder, SETTINGS)
        own = {}
        for name in FILES[1:]:
            path = self.folder / name
            if not path.exists() or (
                name == CELLS and (self.folder / SETTINGS).exists()
            ):
                continue  # the lines of finished cells have checksums of their own
            digest = _writing.digest_of(path)
            if digest is not None and digest in listed.get(name, ()):
                own[name] = digest
            elif not self.overwrite:
                raise ArgumentError(
                    f"{str(path)!r}",
                    "must be as the last run of this version wrote it; it is not"
                    " (--overwrite replaces it; --output names another folder)",
                )
        return own

    def _settings_bytes(self, files: Mapping[str, str]) -> bytes:
        """Return settings.json: what made the files, and their digests by name."""
        made_by = {"version": self.code}
        if (checked_out := commit()) is not None:
            made_by["commit"] = checked_out
        content = self.settings.as_dict() | {
            "made_by": made_by,
            "files": dict(sorted(files.items())),
        }
        return (json.dumps(content, indent=1) + "\n").encode()

    def _compare(self) -> None:
        """Raise ValueError with the difference where the folder has other settings."""
        there = _read_settings(self.folder / SETTINGS)
        asked = _flatten(self.settings.as_dict())
        names = [
            name for name in {**there, **asked} if there.get(name) != asked.get(name)
        ]
        if not names:
            return
        if names == ["repetitions"]:
            # More seeds are added; fewer are taken of a sweep that was interrupted.
            is_written = any((self.folder / name).exists() for name in FILES[2:])
            if not is_written or there["repetitions"] < asked["repetitions"]:
                return
        parts = [
            f"{name} {show(there.get(name))} there, {show(asked.get(name))} asked"
            for name in names
        ]
        raise ValueError(
            f"{self.folder} holds results of other settings: {'; '.join(parts)}"
            " (--fresh empties it; --output names another folder)"
        )

    def _read(self, line: bytes) -> None:
        """Read one line of cells.jsonl and keep it, or count it as damaged."""
        try:
            content = json.loads(line)["content"]
            cell = content["of"]["cell"]
            rows = content["rows"]
            code = content["code"]
            is_signed = line + b"\n" == self._line(cell, rows, code).encode()
            is_whole = is_signed and self._fits(cell, rows)
        except DAMAGE:
            is_whole = False
        if not is_whole:
            self.damaged += 1
        elif code == self.code:
            self._done[_name(cell)] = rows
        else:
            self._others.append(line.decode() + "\n")

    def _fits(self, cell: Cell, rows: list[Row]) -> bool:
        """Return whether a cell is one of the axes and its rows are as they must be.

        Rows hold plain values, every key, and numbers as measures.
        """
        experiment = self.settings.experiment
        axes = self.settings.axes
        is_cell = {*cell} == {*axes, "repetition"} and all(
            cell[name] in values for name, values in axes.items()
        )
        if not is_cell or not isinstance(cell["repetition"], int):
            return False
        if not rows or not isinstance(rows, list):
            return False
        for row in rows:
            numbers = [row[name] for name in experiment.measures if name in row]
            # The first measure must be in every row, and finite.
            first = [row[name] for name in experiment.measures[:1]]
            are_plain = all(isinstance(value, Scalar | None) for value in row.values())
            are_numbers = all(isinstance(value, float | int) for value in numbers)
            if not are_plain or not are_numbers or not all(map(math.isfinite, first)):
                return False
            if not {*experiment.keys} <= {*cell, *row}:
                return False
        return True

    def open(self) -> None:
        """Make the folder and write what it will hold.

        Lines that did not fit leave cells.jsonl.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        settings = self._settings_bytes(self._own_files())
        own = [
            self._line(json.loads(name), rows, self.code)
            for name, rows in self._done.items()
        ]
        lines = [*self._others, *own]
        _files.write_all(
            self.folder, {SETTINGS: settings, CELLS: "".join(lines).encode()}
        )

    def _line(self, cell: Cell, rows: list[Row], code: str) -> str:
        """Return the line of cells.jsonl of a finished cell."""
        settings = self.settings
        own = {
            "experiment": settings.experiment.id,
            "seed": settings.seed,
            "asked": dict(settings.asked),
        }
        content = {"of": own | {"cell": dict(cell)}, "code": code, "rows": rows}
        digest = hashlib.sha256(
            json.dumps(content, sort_keys=True).encode()
        ).hexdigest()
        return json.dumps({"content": content, "sha256": digest}) + "\n"

    def missing(self) -> list[Cell]:
        """Return the cells that are still to be computed.

        One repetition of all comes after the other.
        """
        left = [cell for cell in self.settings.cells() if _name(cell) not in self._done]
        return sorted(left, key=lambda cell: cell["repetition"])

    def add(self, cell: Cell, rows: list[Row]) -> None:
        """Keep a finished cell, written before this returns."""
        line = self._line(cell, rows, self.code)
        path = self.folder / CELLS
        try:
            with open(
                path,
                "a",
                opener=lambda name, flags: os.open(
                    name, flags | _writing.NO_LINK, 0o666
                ),
            ) as handle:
                handle.write(line)
        except OSError as error:
            raise OSError(
                error.errno, f"cannot be written ({error.strerror})", str(path)
            ) from None
        self._done[_name(cell)] = json.loads(line)["content"]["rows"]

    def save(self, contents: Mapping[str, bytes]) -> None:
        """Write files by name, all or none; settings.json lists their digests."""
        refuse_links(self.folder)
        files = self._own_files()
        files |= {name: _writing.sha256(data) for name, data in contents.items()}
        settings = self._settings_bytes(files)
        _files.write_all(self.folder, {**contents, SETTINGS: settings})

    def table(self) -> pd.DataFrame:
        """Return all rows in the order of the cells, each with its settings first."""
        missing = len(self.missing())
        cells = self.settings.cells()
        if missing:
            raise ValueError(
                f"{self.folder} lacks {missing} of {len(cells)} cells; run the"
                " experiment again"
            )
        return pd.DataFrame(
            [{**cell, **row} for cell in cells for row in self._done[_name(cell)]]
        )


def _name(cell: Cell) -> str:
    """Return the name of a cell: its settings as JSON."""
    return json.dumps(dict(cell), sort_keys=True)


def _read_settings(path: Path) -> dict[str, Any]:
    """Read the settings of a results folder, or raise ValueError."""
    with contextlib.suppress(*DAMAGE):
        settings = json.loads(_files.read_text(path))
        if isinstance(settings["experiment"], str) and isinstance(
            settings["repetitions"], int
        ):
            return _flatten(settings)
    raise ArgumentError(
        f"{path}",
        "must be the settings of a results folder; it is not (--output names another"
        " folder)",
    )


def _flatten(settings: dict[str, Any]) -> dict[str, Any]:
    """Return settings as one mapping: own settings, then axes, then what was asked."""
    own = {name: settings.get(name) for name in ("experiment", "repetitions", "seed")}
    return (
        own
        | dict(sorted(settings.get("axes", {}).items()))
        | dict(sorted(settings.get("asked", {}).items()))
    )


# ---- the runner

MAX_ATTEMPTS = 3  # of a cell whose worker died


def run_and_write(
    folder: Path,
    settings: RunSettings,
    write: Callable[[Store], object],
    *,
    say: Callable[[str], object],
    jobs: int = 1,
    dask: str | None = None,
    fresh: bool = False,
    overwrite: bool = True,
    progress: bool = False,
) -> None:
    """Compute the cells of a folder that is this command's alone, and write its files.

    Both commands use it; it says what was done.
    """
    start = time.perf_counter()
    with alone(folder):
        store = run_experiment(
            folder,
            settings,
            jobs=jobs,
            dask=dask,
            fresh=fresh,
            overwrite=overwrite,
            progress=progress,
        )
        write(store)
    say(f"{store} ({time.perf_counter() - start:.0f} s)")


def run_experiment(
    folder: Path,
    settings: RunSettings,
    *,
    jobs: int = 1,
    dask: str | None = None,
    fresh: bool = False,
    overwrite: bool = True,
    progress: bool = False,
) -> Store:
    """Compute the cells that are not in the folder yet.

    ``jobs``: processes on this machine, no more than cells are left; -1: one a core.
    ``dask``: address of a scheduler, where the cells go instead. ``fresh``: empty the
    folder first. ``overwrite``: replace files that no run wrote. Nothing is written
    before the workers are there and have this code.
    """
    if not is_integer(jobs) or jobs == 0 or jobs < -1:
        raise ArgumentError(
            "jobs",
            f"must be a positive number, or -1 for one a core; got {show(jobs)}",
        )
    require_modules(settings.experiment)
    with backend(jobs, dask) as cluster:
        if cluster is not None:
            _check_workers(cluster)
        elif settings.modules:
            # Workers of an earlier run may stand in another folder, with modules of the
            # same names.
            joblib.externals.loky.get_reusable_executor().shutdown(wait=True)
        store = Store(folder, settings, fresh=fresh, overwrite=overwrite)
        store.open()
        todo = store.missing()
        total = len(settings.cells())
        with progress_bar(
            settings.experiment.id,
            total=total,
            initial=total - len(todo),
            unit="cell",
            delay=0.0,
            disable=not progress,
            leave=True,
        ) as bar:
            try:
                _compute(store, dict(enumerate(todo)), jobs, dask, bar)
            except KeyboardInterrupt:
                kept = total - len(store.missing())
                report_finished(
                    f"{folder}: {kept} of {total} cells are finished and kept; the same"
                    " command goes on from there"
                )
                raise
    store.computed = len(todo)
    store.cached = total - len(todo)
    return store


def require_modules(experiment: Experiment) -> None:
    """Raise ImportError that names the extra where modules are missing."""
    missing = [
        name for name in experiment.requires if importlib.util.find_spec(name) is None
    ]
    if missing:
        raise ImportError(
            f"{experiment.id} needs {', '.join(missing)}, which is not installed: "
            f"in a clone: pip install '.[{experiment.extra or missing[0]}]'"
        )


def _compute(
    store: Store, left: dict[int, Cell], jobs: int, dask: str | None, bar: Any
) -> None:
    """Compute and keep the cells; those of a killed worker are tried again."""
    settings = store.settings
    own = store.settings.experiment
    attempt = 0
    run = joblib.delayed(_run_cell)
    while left:
        before = len(left)
        streams = {
            number: Stream(own.id, settings.seed, cell) for number, cell in left.items()
        }
        tasks = [
            run(number, own.run, stream, settings.modules, store.code)
            for number, stream in streams.items()
        ]
        try:
            with _hold_interrupts():
                results = parallel(before, jobs, dask, return_as="generator_unordered")(
                    tasks
                )
            for number, rows in results:
                store.add(left.pop(number), rows)
                bar.update()
        except Exception as error:
            if type(error).__name__ not in DEATHS:
                raise
            attempt = 1 if len(left) < before else attempt + 1
            if attempt == MAX_ATTEMPTS:
                first = "; ".join(str(dict(cell)) for cell in list(left.values())[:3])
                raise RuntimeError(
                    f"a worker was killed {MAX_ATTEMPTS} times in a row without a"
                    f" finished cell; unfinished: {first}"
                ) from error


def _run_cell(
    number: int,
    run: Callable[[Cell, Stream], list[Row]],
    stream: Stream,
    modules: tuple[str, ...],
    code: str,
) -> tuple[int, list[Row]]:
    """Compute the rows of one cell with one thread.

    It is refused where the package is another version than the one that asks.
    """
    from threadpoolctl import threadpool_limits

    _refuse_other_code("a worker", code_version(*modules), code)
    with threadpool_limits(limits=1):
        rows = run(stream.cell, stream)
    return number, [
        {key: plain_value(value) for key, value in row.items()} for row in rows
    ]


def plain_value(value: Any) -> Any:
    """Return a number of numpy's as Python's own, which JSON can hold."""
    return value.item() if isinstance(value, np.generic) else value


def _check_workers(client: Any) -> None:
    """Check that every worker that is there now has this code.

    Those that come later are checked by their first cell.
    """
    for address, threads in client.nthreads().items():
        if threads > 1:
            raise RuntimeError(
                f"dask workers must have one thread each; {address} has {threads} (dask"
                " worker ADDRESS --nthreads 1)"
            )
    for address, version in client.run(code_version, on_error="return").items():
        _refuse_other_code(f"the worker at {address}", version, code_version())


def _refuse_other_code(worker: str, found: object, asked: str) -> None:
    """Raise RuntimeError where a worker has another version of the package."""
    if found != asked:
        raise RuntimeError(
            f"{worker} must have this version of oee_tabular, {asked}; it has {found}"
            " (install the same there)"
        )


@contextlib.contextmanager
def _hold_interrupts() -> Iterator[None]:
    """Start processes that Ctrl-C does not interrupt.

    This process is interrupted, and ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
