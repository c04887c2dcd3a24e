"""Modules of the current folder: those that a user names, and what they import.

A user names a module as MODULE:OBJECT. It may lie in the folder that the command is
started in, and so may what its own code imports. Nobody else looks there: libraries try
to import modules that may be missing (``try: import rich``), and a file of such a name
beside a log must not run.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

from oee_tabular._isolation import safe_path, set_safe_path

# modules that import for somebody else, who is looked for behind them
_GO_BETWEENS = (
    "_frozen_importlib",
    "_frozen_importlib_external",
    "importlib",
    "oee_tabular._isolation",
    "gymnasium.envs.registration",  # whose ids may name a module
)

FLAGS = "_args_from_interpreter_flags"  # what Python calls those of a new process

# names of modules, without what is in them
_named: set[str] = set()  # by the user
_found: dict[str, str] = {}  # a user's own, and the folder that it was found in
_handed_over: dict[str, str] = {}  # the same of the process that started this one


class _Finder:
    """A finder of the modules of one folder, for those who may import them."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def find_spec(
        self, name: str, path: Any = None, target: Any = None
    ) -> ModuleSpec | None:
        """Find a module for a user's own code, or one that the user has named."""
        # a part of a package is found by the package's path
        if path is not None or not self._may_import(_find_importer(), name):
            return None
        spec = PathFinder.find_spec(name, [self.folder])
        if spec is not None and spec.loader is None:  # a folder without __init__.py
            spec = PathFinder.find_spec(name, [self.folder, *sys.path])
            if spec is None or not _is_inside(spec, self.folder):
                return None
        if spec is not None:
            _found[name] = self.folder
            _prepare_processes()
        return spec

    def _may_import(self, importer: str, name: str) -> bool:
        """Return whether a module may import one of this folder."""
        if name in _named and importer == __name__:
            return True
        is_own = _found.get(importer.partition(".")[0]) == self.folder
        # whoever unpickles an object of it imports one that was handed over
        return is_own or _handed_over.get(name) == self.folder


def _find_importer() -> str:
    """Return the name of the module whose code imports now."""
    frame: Any = sys._getframe(2)
    while frame is not None:
        name = str(frame.f_globals.get("__name__", ""))
        if not (name in _GO_BETWEENS or name.startswith("importlib.")):
            return name
        frame = frame.f_back
    return ""


def _is_inside(spec: ModuleSpec, folder: str) -> bool:
    """Return whether all parts of a package without __init__.py are in a folder."""
    parts = spec.submodule_search_locations
    return (
        spec.loader is None
        and parts is not None
        and all(os.path.dirname(part) == folder for part in parts)
    )


def _add_finder(folder: str) -> _Finder:
    """Let a folder's modules be found where Python itself searches its path."""
    for other in sys.meta_path:
        if isinstance(other, _Finder) and other.folder == folder:
            return other
    finder = _Finder(folder)
    index = len(sys.meta_path)
    if PathFinder in sys.meta_path:
        index = sys.meta_path.index(PathFinder)
    sys.meta_path.insert(index, finder)
    return finder


@contextmanager
def own_modules() -> Iterator[None]:
    """Let a user's code find modules of the current folder.

    The finder stays where it has found any, because functions may import when called.
    """
    try:
        folder = os.getcwd()
    except OSError:  # it was removed
        yield
        return
    finder = _add_finder(folder)
    try:
        yield
    finally:
        if folder not in _found.values() and finder in sys.meta_path:
            sys.meta_path.remove(finder)


@functools.cache
def _prepare_processes() -> None:
    """Let processes of multiprocessing and joblib find what this one has found.

    Python itself would put the current folder on their path.
    """
    # imported here because few commands need it
    import multiprocessing.util
    from multiprocessing.process import BaseProcess

    flags: Any = multiprocessing.util
    kind: Any = BaseProcess
    start, list_flags = kind.start, getattr(flags, FLAGS, list)

    def start_safely(process: BaseProcess) -> None:
        """Start a process without the folder on its path, and with the finders."""
        attributes = dict(vars(process))
        vars(process).clear()
        with safe_path() as before:
            # unpickled before the rest, which may be of these modules
            vars(process)["own_modules"] = _Handover(dict(_found), before)
            vars(process).update(attributes)
            start(process)

    kind.start = start_safely
    setattr(flags, FLAGS, lambda: [*list_flags(), "-P"])


class _Handover:
    """What a new process needs to find a user's modules, and does when it reads this.

    Parameters
    ----------
    found : dict
        The modules that were found, and their folders.
    before : str or None
        The user's own value of ``_isolation.SAFE_PATH``.
    """

    def __init__(self, found: dict[str, str], before: str | None) -> None:
        self.arguments = (found, before)

    def __reduce__(self) -> tuple[Any, ...]:
        return _take_over, self.arguments


def _take_over(found: dict[str, str], before: str | None) -> None:
    """Find a user's modules in a new process, whose environment is the user's again."""
    set_safe_path(before)
    _handed_over.update(found)
    for folder in set(found.values()):
        _add_finder(folder)


def import_own(name: str) -> ModuleType:
    """Import a module that the user has named, from the current folder if there."""
    _named.add(name.partition(".")[0])
    with own_modules():
        return importlib.import_module(name)


def import_own_environment(module_name: str, identifier: str) -> None:
    """Import a module that registers an environment, and the one that holds it.

    An environment may be registered by the name of another module of the folder.
    """
    import_own(module_name)
    registration = sys.modules.get("gymnasium.envs.registration")
    specs: Any = getattr(registration, "registry", {})
    entry = getattr(specs.get(identifier), "entry_point", None)
    if module_name.partition(".")[0] in _found and isinstance(entry, str):
        import_own(entry.partition(":")[0])


def find_own(name: str) -> ModuleSpec | None:
    """Find a module that the user has named, without importing it."""
    _named.add(name.partition(".")[0])
    with own_modules():
        return importlib.util.find_spec(name)
