"""Compiled kernels: numba's ``njit`` with a cache that never stands in the way.

numba keeps compiled code beside the package's files, or else in the user's cache
folder, and loads it from there as pickles. Where neither can be written (a read-only
image, a process without a home), numba raises an error. Here a temporary folder is
used that belongs to the user alone; without one, code is compiled at each start.

Where numba cannot be imported, kernels are the Python functions that they are written
as: right, and some hundred times slower.
"""

from __future__ import annotations

import contextlib
import functools
import os
import stat
import tempfile
from collections.abc import Callable
from typing import Any

from oee_tabular import _checks
from oee_tabular.exceptions import CostWarning

# numba makes its names at run time
config: Any = None
CPUDispatcher: Any = object
_run: Any = None
with contextlib.suppress(ImportError):
    import numba
    from numba.core.registry import CPUDispatcher
    from numba.misc.appdirs import AppDirs

    config = numba.config
    _run = CPUDispatcher.__call__


def njit(*, cache: bool, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a decorator like ``numba.njit``, which works without a folder to cache in.

    Parameters
    ----------
    cache : bool
        Whether compiled code is kept in files.
    **options : Any
        Other options of ``numba.njit``.

    Returns
    -------
    callable
        The decorator.
    """

    def compile_on_call(function: Callable[..., Any]) -> Any:
        """Return the kernel, which is compiled when it is first called."""
        if config is None:
            _warn_of_python()
            return function
        kernel = numba.njit(**options)(function)
        # with NUMBA_DISABLE_JIT, it is the function
        if isinstance(kernel, CPUDispatcher):
            kernel.__class__ = _Kernel
            if cache:
                _enable_cache(kernel)
        return kernel

    return compile_on_call


def n_threads() -> int:
    """Return how many threads compiled code may use at once."""
    return 1 if config is None else int(config.NUMBA_NUM_THREADS)


class _Kernel(CPUDispatcher):  # type: ignore[misc]
    """A kernel that passes on what a signal raises, such as Ctrl-C.

    A signal that comes while compiled code runs is handled as it returns. Python makes
    a SystemError of the handler's KeyboardInterrupt or TimeoutError, and that would
    pass for a failed estimate.
    """

    def __call__(self, *args: Any) -> Any:
        """Run the compiled code."""
        try:
            return _run(self, *args)
        except SystemError as error:
            cause: BaseException | None = error
            while isinstance(cause, SystemError):
                cause = cause.__cause__
            if cause is None:
                raise
            raise cause from None


def _enable_cache(kernel: Any) -> None:
    """Let a kernel keep its code where numba keeps it, else in a temporary folder."""
    folder = os.path.dirname(os.path.abspath(kernel.py_func.__code__.co_filename))
    if config.CACHE_DIR or _is_writable(folder) or _has_user_folder():
        with contextlib.suppress(RuntimeError):
            kernel.enable_caching()
            _tolerate_errors(kernel._cache)
            return
    temporary = temporary_cache()
    if temporary is not None:
        before = config.CACHE_DIR
        config.CACHE_DIR = temporary
        try:
            kernel.enable_caching()
            _tolerate_errors(kernel._cache)
            return
        except RuntimeError:
            pass
        finally:
            config.CACHE_DIR = before
    _warn_once()


def _is_writable(folder: str) -> bool:
    """Return whether numba can write beside the files of a folder."""
    inside = os.path.join(folder, "__pycache__")
    return os.access(inside if os.path.isdir(inside) else folder, os.W_OK)


def _has_user_folder() -> bool:
    """Return whether numba knows the user's cache folder.

    Without a home, its path is relative: code would be loaded from the current folder.
    """
    return os.path.isabs(AppDirs("numba", False).user_cache_dir)  # type: ignore[no-untyped-call]


@functools.cache
def temporary_cache() -> str | None:
    """Make a folder for compiled code that nobody else can write into.

    Returns
    -------
    str or None
        Its path; None if there is none that is certain to be the user's own.
    """
    if not hasattr(os, "geteuid"):  # Windows, where every user has a folder
        return None
    try:
        parent = tempfile.gettempdir()
        # without temporary folders, Python names the current one
        if os.path.samefile(parent, os.curdir):
            return None
        path = os.path.join(parent, f"oee-tabular-{os.geteuid()}")
        with contextlib.suppress(FileExistsError):
            os.mkdir(path, 0o700)
        found = os.lstat(path)
    except OSError:
        return None
    is_own = (
        stat.S_ISDIR(found.st_mode)
        and found.st_uid == os.geteuid()
        and not found.st_mode & 0o077
    )
    return path if is_own else None


@functools.cache
def _warn_of_python() -> None:
    """Warn that loops run in Python."""
    _checks.warn(
        "numba cannot be imported, so loops run in Python, some hundred times slower"
        " (pip install numba)",
        CostWarning,
    )


@functools.cache
def _warn_once() -> None:
    """Warn that code is not kept."""
    _checks.warn(
        "compiled code cannot be kept, so each start compiles it again (name a folder"
        " that can be written in NUMBA_CACHE_DIR)",
        CostWarning,
    )


def _tolerate_errors(cache: Any) -> None:
    """Let a cache that is damaged, or on a full disk, count as empty."""
    load = cache.load_overload
    save = cache.save_overload

    def load_if_whole(*args: Any) -> Any:
        """Return what the cache holds, or None."""
        try:
            return load(*args)
        except Exception:  # pickles may raise anything
            with contextlib.suppress(Exception):
                cache.flush()
            return None

    def save_if_possible(*args: Any) -> None:
        """Keep compiled code if it can be written."""
        with contextlib.suppress(OSError):
            save(*args)

    cache.load_overload = load_if_whole
    cache.save_overload = save_if_possible
