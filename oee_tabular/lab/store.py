"""A results folder: settings.json, cells.jsonl (finished cells), and the files that are made of them.

A finished cell is one line of cells.jsonl, written and flushed when it is finished: what it is of (experiment, seed, cell,
code), its rows, and a checksum of both. A folder may come from a stranger. A line whose checksum, settings or columns do not
fit is left out, its cell is computed again, and the run says so. Links, and whatever else is no plain file, are refused before
anything is written. Results of other code are kept for the day when that code is run again.
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
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from oee_tabular import _checks, _files
from oee_tabular._arguments import own_modules
from oee_tabular.lab.registry import Cell, Row, RunSettings, Scalar

PACKAGE = Path(__file__).parents[1]
LOCK, SETTINGS, CELLS = ".lock", "settings.json", "cells.jsonl"
SOURCES = (".py", ".csv", ".xml", ".npz")
FILES = (
    SETTINGS, CELLS, "table.csv", "summary.csv", "summary.md", "figure.svg", "figure.png",
    "cells.csv", "league.csv", "league.md", "league.tex", "sizes.png", "profile.png", "heat.png",
)  # fmt: skip
JSON_ERRORS = (ValueError, RecursionError)  # of damaged text, and of lists a thousand deep


@functools.cache
def code_version(*modules: str) -> str:
    """The package's version and a digest of its files: what a result depends on, besides the settings and the libraries.

    The files of a user's ``modules`` count as well, each by itself (not what it imports).
    """
    digest = hashlib.sha256()
    for path in sorted(path for path in PACKAGE.rglob("*") if path.suffix in SOURCES):
        digest.update(path.relative_to(PACKAGE).as_posix().encode())
        digest.update(path.read_bytes())
    with own_modules():
        for spec in map(importlib.util.find_spec, modules):
            if spec is not None and spec.origin is not None and Path(spec.origin).is_file():
                digest.update(Path(spec.origin).read_bytes())
    return f"{importlib.metadata.version('oee-tabular')}+{digest.hexdigest()[:12]}"


def refuse_links(folder: Path, names: Iterable[str] = (*FILES, LOCK), *, are_folders: bool = False) -> None:
    """ValueError where what a run writes is a link, or no plain file (no folder): it could lead out of the folder."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} must be a folder; it is a file")
    for path in (folder / name for name in names):
        is_right = path.is_dir() if are_folders else path.is_file()
        if path.is_symlink() or (path.exists() and not is_right):
            what = "folder" if are_folders else "plain file"
            raise ValueError(f"{str(path)!r} must be a {what}; it is a link or something else: remove it")


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold ``folder``, made where it is not there; ValueError where another command does, or a file in it is a link.

    The lock is the system's: it ends with the process that holds it, however it dies.
    """
    from filelock import FileLock, Timeout

    refuse_links(folder)
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    lock = FileLock(path, timeout=0)  # which opens no link
    try:
        lock.acquire()
    except Timeout:
        holder = path.read_text(errors="replace")[:20].strip() if path.is_file() else ""
        raise ValueError(
            f"{folder} must be used by one command at a time; another{f' (process {holder})' if holder else ''} is at "
            "work in it: wait for it, or name another folder with --output"
        ) from None
    except OSError as error:
        raise OSError(error.errno, f"cannot be written ({error.strerror})", str(path)) from None
    try:
        path.write_text(f"{os.getpid()}\n")
        yield
    finally:
        with contextlib.suppress(OSError):  # Windows removes no open file
            path.unlink()
        lock.release()
        with contextlib.suppress(OSError):
            for path in new:
                path.rmdir()  # where nothing was written


class Store:
    """The finished cells of a results folder.

    Attributes
    ----------
    stale : lines of other code, which are kept; damaged : lines that do not fit, which are left out
    computed, cached : cells that a run computed, and that it took from here

    Raises
    ------
    ValueError
        The folder holds results of other settings (the difference is named), unless ``fresh``, which empties it first.
        More repetitions are no other settings, nor are fewer where the sweep was interrupted: finished cells are kept.
    """

    def __init__(self, folder: Path, settings: RunSettings, *, fresh: bool = False, code: str | None = None):
        self.folder, self.settings = folder, settings
        self.code = code_version(*settings.modules) if code is None else code
        refuse_links(folder)
        if fresh and folder.exists():
            self._empty()
        if (folder / SETTINGS).is_file():
            self._compare()
        self._done: dict[str, list[Row]] = {}
        self.computed = self.cached = 0
        self._others: list[str] = []
        self.damaged = 0
        if (folder / CELLS).is_file():
            for line in (folder / CELLS).read_bytes().splitlines():
                self._read(line)
        self.stale = len(self._others)

    def __str__(self) -> str:
        return (
            f"{self.folder}: {self.computed} cells computed"
            + (f", {self.cached} from the cache" if self.cached else "")
            + (f", {self.stale} of another version of the code left aside" if self.stale else "")
            + (f"; lines of cells.jsonl that did not fit and are left out: {self.damaged}" if self.damaged else "")
        )

    def _empty(self) -> None:
        present = [path for path in self.folder.iterdir() if path.name != LOCK]
        if present and not (self.folder / SETTINGS).is_file():
            raise ValueError(f"{self.folder} must be a results folder to be emptied; it has no {SETTINGS}")
        others = sorted(path.name for path in present if path.name not in FILES and path.suffix != ".part")
        if others:
            raise ValueError(f"{self.folder} must hold results only to be emptied; it holds {', '.join(others[:3])}")
        for path in present:
            path.unlink()

    def _compare(self) -> None:
        """ValueError where the folder has other settings, with the difference."""
        there, asked = _read_settings(self.folder / SETTINGS), _flatten(self.settings.as_dict())
        names = [name for name in {**there, **asked} if there.get(name) != asked.get(name)]
        is_written = any((self.folder / name).exists() for name in FILES[2:])
        if not names or (names == ["repetitions"] and (not is_written or there[names[0]] < asked[names[0]])):
            return
        parts = [
            f"{name} {_checks.show(there.get(name))} there, {_checks.show(asked.get(name))} asked" for name in names
        ]
        raise ValueError(
            f"{self.folder} holds results of other settings: {'; '.join(parts)} (--fresh empties it; --output names "
            "another folder)"
        )

    def _read(self, line: bytes) -> None:
        """One line of cells.jsonl: a finished cell, one of other code, or damaged."""
        try:
            content = json.loads(line)["content"]
            cell, rows, code = content["of"]["cell"], content["rows"], content["code"]
            if line + b"\n" != self._line(cell, rows, code).encode():
                raise ValueError("it is not what was written here")
            self._require_columns(cell, rows)
        except (*JSON_ERRORS, AttributeError, KeyError, TypeError, OverflowError):
            self.damaged += 1
            return
        if code == self.code:
            self._done[_name(cell)] = rows
        else:
            self._others.append(line.decode() + "\n")

    def _require_columns(self, cell: Cell, rows: list[Row]) -> None:
        """ValueError where rows are not those that the experiment's cells have: its keys, numbers as its measures."""
        experiment, axes = self.settings.experiment, self.settings.axes
        is_cell = {*cell} == {*axes, "repetition"} and all(cell[name] in values for name, values in axes.items())
        if not is_cell or not isinstance(cell["repetition"], int) or not rows or not isinstance(rows, list):
            raise ValueError("a cell of the axes has rows")
        for row in rows:
            numbers = [row[name] for name in experiment.measures if name in row]
            first = [row[name] for name in experiment.measures[:1]]  # in every row, and finite
            if (
                not all(isinstance(value, Scalar | None) for value in row.values())
                or not {*experiment.keys} <= {*cell, *row}
                or not all(isinstance(value, float | int) for value in numbers)
                or not all(map(math.isfinite, first))
            ):
                raise ValueError("a row holds plain values, every key, and numbers as measures")

    def open(self) -> None:
        """Make the folder and say what it will hold; what did not fit leaves cells.jsonl."""
        self.folder.mkdir(parents=True, exist_ok=True)
        settings = json.dumps(self.settings.as_dict(), indent=1) + "\n"
        lines = [*self._others, *(self._line(json.loads(name), rows, self.code) for name, rows in self._done.items())]
        _files.write_all(self.folder, {SETTINGS: settings.encode(), CELLS: "".join(lines).encode()})

    def _line(self, cell: Cell, rows: list[Row], code: str) -> str:
        settings = self.settings
        own = {"experiment": settings.experiment.id, "seed": settings.seed, "asked": dict(settings.asked)}
        content = {"of": own | {"cell": dict(cell)}, "code": code, "rows": rows}
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
        return json.dumps({"content": content, "sha256": digest}) + "\n"

    def missing(self) -> list[Cell]:
        """The cells that are still to be computed, one repetition of all after the other."""
        left = [cell for cell in self.settings.cells() if _name(cell) not in self._done]
        return sorted(left, key=lambda cell: cell["repetition"])

    def add(self, cell: Cell, rows: list[Row]) -> None:
        """Keep a finished cell, written before this returns."""
        line = self._line(cell, rows, self.code)
        path = self.folder / CELLS
        try:
            with open(path, "a", opener=_open_plain) as handle:
                handle.write(line)
        except OSError as error:
            raise OSError(error.errno, f"cannot be written ({error.strerror})", str(path)) from None
        self._done[_name(cell)] = json.loads(line)["content"]["rows"]

    def table(self) -> pd.DataFrame:
        """All rows, in the order of the cells, each with its cell's settings first."""
        missing, cells = len(self.missing()), self.settings.cells()
        if missing:
            raise ValueError(f"{self.folder} lacks {missing} of {len(cells)} cells; run the experiment again")
        return pd.DataFrame([{**cell, **row} for cell in cells for row in self._done[_name(cell)]])


def _open_plain(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def _name(cell: Cell) -> str:
    return json.dumps(dict(cell), sort_keys=True)


def _read_settings(path: Path) -> dict[str, Any]:
    """The settings of a results folder by name; ValueError where the file has none."""
    try:
        settings = json.loads(path.read_bytes())
        if isinstance(settings["experiment"], str) and isinstance(settings["repetitions"], int):
            return _flatten(settings)
    except (*JSON_ERRORS, AttributeError, KeyError, TypeError):
        pass
    raise ValueError(f"{path} must be the settings of a results folder; it is not (--output names another folder)")


def _flatten(settings: dict[str, Any]) -> dict[str, Any]:
    own = {name: settings.get(name) for name in ("experiment", "repetitions", "seed")}
    return own | dict(sorted(settings.get("axes", {}).items())) | dict(sorted(settings.get("asked", {}).items()))
