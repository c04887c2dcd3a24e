"""What the command keeps away: modules and settings of the folder it is started in.

Python, numba, matplotlib and the helpers of joblib and multiprocessing look into the
current folder for modules or settings. A folder of logs from somebody else must not
decide what the command runs. What a user names as MODULE:OBJECT is imported from the
current folder by ``_own_modules``.
"""

from __future__ import annotations

import functools
import importlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# module -> the file of settings that it looks for in the current folder while it is
# imported
SETTINGS = {"numba.core.config": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
EPOCH = "SOURCE_DATE_EPOCH"  # the variable with the date of reproducible files
BACKEND = "MPLBACKEND"  # which matplotlib reads while it is imported
SAFE_PATH = "PYTHONSAFEPATH"  # lets Python leave the current folder out of its path


class _Finder:
    """A finder that lets the modules of ``SETTINGS`` find no file of settings."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        """Return another finder's spec, of a loader that hides the file."""
        if name not in SETTINGS:
            return None
        for finder in sys.meta_path:
            if not isinstance(finder, _Finder):
                spec = finder.find_spec(name, path, target)
                if spec is not None and spec.loader is not None:
                    loader: Any = spec.loader
                    loader.exec_module = functools.partial(_execute, loader.exec_module)
                    return spec
        return None


def _execute(execute: Callable[[Any], object], module: Any) -> None:
    """Execute a module for which its file of settings does not exist."""
    hidden = SETTINGS[module.__name__]
    exists = os.path.exists

    def exists_elsewhere(path: Any) -> bool:
        """Return whether a path exists that is not the hidden file."""
        return path != hidden and exists(path)

    os.path.exists = exists_elsewhere
    try:
        with _backend_of_files():
            execute(module)
    finally:
        os.path.exists = exists
    if module.__name__ == "numba.core.config":
        # numba looks again at each compilation, where it must find no file
        module._config_fname = os.devnull


@contextmanager
def _backend_of_files() -> Iterator[None]:
    """Let matplotlib draw into files while it is imported, whatever else is set.

    A window is never opened, and the variable may hold what is no backend.
    """
    before = os.environ.get(BACKEND)
    os.environ[BACKEND] = "Agg"
    try:
        yield
    finally:
        _set_variable(BACKEND, before)


def ignore_settings() -> None:
    """Let this process ignore settings of the current folder from now on."""
    if os.environ.get(EPOCH) == "":  # which libraries read as a number
        del os.environ[EPOCH]
    if not is_isolated():
        sys.meta_path.insert(0, _Finder())


def is_isolated() -> bool:
    """Return whether this process ignores settings of the current folder."""
    return any(isinstance(finder, _Finder) for finder in sys.meta_path)


@contextmanager
def safe_children() -> Iterator[Callable[[], tuple[bool, str | None]]]:
    """Let Python processes that start inside import nothing of the current folder.

    Yields
    ------
    callable
        What ``begin_worker`` takes in such a process.
    """
    with safe_path() as before, _streams_that_flush():
        yield lambda: (is_isolated(), before)


@contextmanager
def safe_path() -> Iterator[str | None]:
    """Leave the current folder out of the path of Python processes that start inside.

    Yields
    ------
    str or None
        What the variable was before, for ``set_safe_path`` in such a process.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield before
    finally:
        set_safe_path(before)


@contextmanager
def _streams_that_flush() -> Iterator[None]:
    """Replace standard streams that joblib cannot flush, such as None in a service."""
    with open(os.devnull, "w") as nowhere:
        replaced = {
            name: stream
            for name in ("stdout", "stderr")
            if not _can_flush(stream := getattr(sys, name))
        }
        for name in replaced:
            setattr(sys, name, nowhere)
        try:
            yield
        finally:
            for name, stream in replaced.items():
                if getattr(sys, name) is nowhere:
                    setattr(sys, name, stream)


def _can_flush(stream: Any) -> bool:
    """Return whether a stream can be flushed now."""
    try:
        stream.flush()
    except (AttributeError, OSError, ValueError):  # None, gone, closed
        return False
    return True


def set_safe_path(value: str | None) -> None:
    """Set the variable of the environment, or remove it."""
    _set_variable(SAFE_PATH, value)


def _set_variable(name: str, value: str | None) -> None:
    """Set a variable of the environment, or remove it."""
    if value is None:
        os.environ.pop(name, None)
    else:
        os.environ[name] = value


def begin_worker(is_command: bool, safe_path: str | None) -> None:
    """Isolate a new process like the one that started it.

    What a user's own code starts there has the user's environment again.
    """
    set_safe_path(safe_path)
    if is_command:
        ignore_settings()


def call_in_worker(
    inherited: tuple[bool, str | None], module: str, name: str, *args: Any
) -> None:
    """Call a function of a module that is imported once the process is isolated."""
    begin_worker(*inherited)
    getattr(importlib.import_module(module), name)(*args)
