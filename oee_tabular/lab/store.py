"""A results folder: settings.json, cells.jsonl (the cache), table.csv, summary.csv, summary.md, figure.svg, figure.png.

A finished cell is one line of cells.jsonl, written and flushed when it is finished: its key (a digest of the cell, the seed and
the code) and its rows. A line that a killed process left half written is dropped. What was made by other code is
computed again, and stays in the cache for the day when that code is run again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from oee_tabular import _files
from oee_tabular._arguments import own_modules
from oee_tabular.lab.registry import Cell, Row, Settings

PACKAGE = Path(__file__).parents[1]
LOCK = ".lock"
SOURCES = (".py", ".csv", ".xml", ".npz")
FILES = (
    "settings.json", "cells.jsonl", "table.csv", "summary.csv", "summary.md", "figure.svg", "figure.png",
    "cells.csv", "league.csv", "league.md", "shown.json", "profile.png", "heat.png",
)  # fmt: skip


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
        for found in map(importlib.util.find_spec, modules):
            if found is not None and found.origin is not None and Path(found.origin).is_file():
                digest.update(Path(found.origin).read_bytes())
    return f"{importlib.metadata.version('oee-tabular')}+{digest.hexdigest()[:12]}"


def cell_key(settings: Settings, cell: Cell, code: str) -> str:
    """The name of a cell's result."""
    asked = [dict(settings.asked)] if settings.asked else []
    text = json.dumps([settings.experiment, settings.seed, dict(cell), code, *asked], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def _settings_in(path: Path) -> dict[str, Any]:
    """The settings of a results folder; ValueError where the file is not one."""
    try:
        found = json.loads(path.read_text())
    except ValueError:
        found = None
    if not isinstance(found, dict) or "experiment" not in found:
        raise ValueError(f"{path} must be the settings of a results folder; it is not (--output names another folder)")
    return found


def _named(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings by name: what the folder is of, its axes, what else was asked."""
    own = {name: settings.get(name) for name in ("experiment", "repetitions", "seed")}
    return own | dict(sorted(settings.get("axes", {}).items())) | dict(sorted(settings.get("asked", {}).items()))


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold ``folder``, made where it is not there; ValueError where another command does, or ``.lock`` is a link.

    The lock is the system's: it ends with the process that holds it, however it dies.
    """
    from filelock import FileLock, Timeout

    _require_folder(folder)
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    if path.is_symlink() or (path.exists() and not path.is_file()):  # of a link that comes later filelock opens none
        raise ValueError(f"{str(path)!r} must be a plain file; it is a link or something else: remove it")
    lock = FileLock(path, timeout=0)
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
            for path in made:
                path.rmdir()  # where nothing was written


def _require_folder(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} must be a folder; it is a file")


class Store:
    """The results folder of one experiment.

    Raises
    ------
    ValueError
        The folder holds results of other settings (the difference is named), unless ``fresh``, which empties it first.
        More repetitions are no other settings, nor are fewer where the sweep was interrupted: finished cells are kept.
    """

    def __init__(self, folder: Path, settings: Settings, *, fresh: bool = False, code: str | None = None):
        self.folder, self.settings = folder, settings
        self.code = code_version(*settings.modules) if code is None else code
        self._file = folder / "settings.json"
        self._cells = folder / "cells.jsonl"
        _require_folder(folder)
        if fresh and folder.exists():
            present = [path for path in folder.iterdir() if path.name != LOCK]
            if present and not self._file.is_file():
                raise ValueError(f"{folder} must be a results folder to be emptied; it has no settings.json")
            others = sorted(path.name for path in present if path.name not in FILES and path.suffix != ".part")
            if others:
                raise ValueError(f"{folder} must hold results only to be emptied; it holds {', '.join(others[:3])}")
            for path in present:
                path.unlink()
        if self._file.is_file():
            self._compare(_settings_in(self._file))
        self._done, self._others = self._read()
        self.stale = len(self._others)

    def _compare(self, found: dict[str, Any]) -> None:
        if found == self.settings.as_dict():
            return
        there, asked = _named(found), _named(self.settings.as_dict())
        names = [name for name in {**there, **asked} if there.get(name) != asked.get(name)]
        if names == ["repetitions"] and (self._unwritten() or there["repetitions"] < asked["repetitions"]):
            return
        parts = [f"{name} {there.get(name)} there, {asked.get(name)} asked" for name in names]
        raise ValueError(
            f"{self.folder} holds results of other settings: {'; '.join(parts)} (--fresh empties it; --output names "
            "another folder)"
        )

    def _unwritten(self) -> bool:
        """Whether nothing was made of the cells yet."""
        return not any((self.folder / name).is_file() for name in FILES[2:])

    def _read(self) -> tuple[dict[str, list[Row]], list[str]]:
        """What is finished, and the lines of other code."""
        done: dict[str, list[Row]] = {}
        others = []
        if self._cells.is_file():
            for line in self._cells.read_text(errors="replace").splitlines():
                try:
                    entry = json.loads(line)
                except json.JSONDecodeError:
                    continue  # half written
                if not isinstance(entry, dict) or not {"key", "code", "rows"} <= entry.keys():
                    continue
                if entry["code"] == self.code:
                    done[entry["key"]] = entry["rows"]
                else:
                    others.append(line + "\n")
        return done, others

    def open(self) -> None:
        """Make the folder and say what it will hold; a cache with lines of other code, or half a line, is written anew."""
        self.folder.mkdir(parents=True, exist_ok=True)
        lines = "".join([*self._others, *(self._line(key, rows) for key, rows in self._done.items())])
        settings = json.dumps(self.settings.as_dict(), indent=1) + "\n"
        _files.write_all(self.folder, {self._file.name: settings.encode(), self._cells.name: lines.encode()})

    def _line(self, key: str, rows: list[Row]) -> str:
        return json.dumps({"key": key, "code": self.code, "rows": rows}) + "\n"

    def missing(self) -> list[Cell]:
        """The cells that are still to be computed, one repetition of all after the other."""
        left = [cell for cell in self.settings.cells() if cell_key(self.settings, cell, self.code) not in self._done]
        return sorted(left, key=lambda cell: cell["repetition"])

    def add(self, cell: Cell, rows: list[Row]) -> None:
        """Keep a finished cell, written before this returns."""
        key = cell_key(self.settings, cell, self.code)
        line = self._line(key, rows)
        try:
            with self._cells.open("a") as handle:
                handle.write(line)
                handle.flush()
        except OSError as error:
            raise OSError(error.errno, f"cannot be written ({error.strerror})", str(self._cells)) from None
        self._done[key] = json.loads(line)["rows"]

    def rows(self) -> list[Row]:
        """All rows, in the order of the cells, each with its cell's settings first."""
        missing = len(self.missing())
        if missing:
            raise ValueError(
                f"{self.folder} lacks {missing} of {len(self.settings.cells())} cells; run the experiment again"
            )
        found = []
        for cell in self.settings.cells():
            for row in self._done[cell_key(self.settings, cell, self.code)]:
                found.append({**cell, **row})
        return found
