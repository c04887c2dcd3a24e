"""Loops that threads share, where processes fork and where numba's threads take one caller at a time.

GNU's OpenMP, which numba's threads come from on Linux, kills a forked process that enters it once its parent has; there the
loop is compiled without threads and runs by itself. Workqueue, numba's own layer, where there is no other, ends a process
whose Python threads enter it together: there they take turns. The bits are the same in all of them.
"""

from __future__ import annotations

import functools
import os
import threading
import types
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numba
from numba.core import config
from numba.core.compiler_lock import global_compiler_lock
from numba.np.ufunc.parallel import threading_layer

from oee_tabular._forks import forked
from oee_tabular._kernels import Kernel

_turns = threading.Lock()


def threads_share(function: Callable[..., Any], python: Callable[..., Any] | None = None) -> Callable[..., Any]:
    """A kernel, its ``prange`` shared among threads once it is compiled; in a forked process, one thread does all of it.

    ``python``: what Python runs instead while it is not (``_kernels.Kernel``).

    Costs a microsecond a call, and in the first call of a forked process the seconds of another compilation (which is cached).
    """
    shared = numba.njit(cache=True, parallel=True)(function)
    alone = numba.njit(cache=True)(_another(function))

    @functools.wraps(function)
    def run(*arguments: object) -> Any:
        if forked():
            return alone(*arguments)
        with _turns if _one_caller() else nullcontext():
            return shared(*arguments)

    run._cache = getattr(shared, "_cache", None)  # type: ignore[attr-defined]
    return run if config.DISABLE_JIT else Kernel(function, run, ["over"], python)  # type: ignore[attr-defined]


def _another(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function under another name: numba's cache tells compilations of one name apart by their types alone."""
    assert isinstance(function, types.FunctionType)
    copy = types.FunctionType(function.__code__, function.__globals__, f"{function.__name__}_alone")
    copy.__qualname__ = f"{function.__qualname__}_alone"
    return copy


@functools.cache
def _one_caller() -> bool:
    """Whether numba's threads take one caller at a time."""
    numba.get_num_threads()  # starts them: what they are is known from then on
    return bool(threading_layer() == "workqueue")  # type: ignore[no-untyped-call]


if hasattr(os, "register_at_fork"):
    # no other thread compiles while the process is copied: it would hold numba's lock in the copy, for ever
    _release = global_compiler_lock.release
    os.register_at_fork(before=global_compiler_lock.acquire, after_in_parent=_release, after_in_child=_release)
