"""Compiled loops, which Python itself runs while that is cheaper than to compile them.

numba takes .2 to 6 s for a kernel, once; Python takes some milliseconds for a few thousand numbers. So a kernel that nobody
has compiled before is first run as it is written, with the same bits, and compiled as soon as its arrays are large or that
has taken about a third of what compiling would: the first ``oee evaluate`` of a 10 x 10 grid takes 3 s instead of 18. The
bits are the same because compiled code takes no liberties (no fastmath), and because kernels take logarithms from ``math``,
the C library's, not from numpy, and square by a product. What Python's numbers do otherwise (they refuse to overflow, or to
divide by zero) is left to the compiled kernel, from the arrays as they were.

Where numpy does the same in a tenth of the time, in the same order, a kernel names that function (``python=``), and Python runs
it instead.
"""

from __future__ import annotations

import functools
import os
import threading
import time
import types
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numba
import numpy as np
from numba.core import config, event
from numba.extending import typeof_impl

from oee_tabular import _progress

SMALL = 20_000  # numbers in the arrays of a call: one pass of Python over them takes some milliseconds
WHOLE = 200_000  # the same for a kernel that numpy does
PATIENCE = 1.5e-4  # seconds of Python's for a byte of its code, which takes three times that to compile


class _TooLong(Exception):
    """Python's run of a call, given up."""


REFUSED = (_TooLong, ArithmeticError, ValueError)


class _Run(threading.local):
    """When a thread's run by Python ends, on that thread's own clock."""

    ends = float("inf")


_run = _Run()


def njit(
    *, wraps: bool = False, python: Callable[..., Any] | None = None, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit``, put off; ``wraps``: whether whole numbers of 64 bits overflow on purpose; ``python``: see ``Kernel``."""
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return lambda function: function
    silent = (("over",) if wraps else ()) + (("divide", "invalid") if "error_model" in options else ())
    return lambda function: Kernel(function, numba.njit(**options)(function), silent, python)


class Kernel:
    """A function for numba and for Python.

    Attributes
    ----------
    compiled : by numba, on the first call with such types
    python : what Python runs: the function itself, or one of numpy's with the same bits, which has neither defaults nor closure
    patience : seconds that Python may still take; 0 once the compiled function is there, or is found in numba's cache
    """

    def __init__(
        self, function: Callable[..., Any], compiled: Any, silent: Sequence[str],
        python: Callable[..., Any] | None = None,
    ) -> None:  # fmt: skip
        functools.update_wrapper(self, function)
        self.py_func: Any = function
        self.python: Any = python or function
        self.compiled = compiled
        self.patience: float | None = None
        self._errors = {"all": "raise", "under": "ignore"} | dict.fromkeys(silent, "ignore")

    def __call__(self, *arguments: Any) -> Any:
        """By Python or compiled."""
        if self.patience != 0.0:
            arrays = list(_arrays(arguments))
            if self._is_worth_compiling(arrays):
                self.patience = 0.0
            else:
                try:
                    return self._run(arguments, arrays)
                except REFUSED:
                    self.patience = 0.0
        return self.compiled(*arguments)

    def _is_worth_compiling(self, arrays: Sequence[Any]) -> bool:
        if self.patience is None:
            self.patience = 0.0 if _is_cached(self.compiled) else PATIENCE * _length(self, set())
        most = SMALL if self.python is self.py_func else WHOLE
        return self.patience == 0.0 or sum(array.size for array in arrays) > most

    def _run(self, arguments: Sequence[Any], arrays: Sequence[Any]) -> Any:
        """By Python; the arrays are put back where it gives up."""
        assert self.patience is not None
        before = [(array, array.copy()) for array in arrays if array.flags.writeable]
        start = time.thread_time()
        _run.ends = start + self.patience
        try:
            with np.errstate(**self._errors):  # type: ignore[arg-type]
                return _plain(self.interpreted(*arguments))
        except REFUSED:
            for array, was in before:
                array[...] = was
            raise
        finally:
            _run.ends = float("inf")
            self.patience = max(self.patience - (time.thread_time() - start), 0.0)

    @property
    def others(self) -> dict[str, Kernel]:
        """The kernels that this one calls, by name."""
        return _kernels_in(self.py_func)

    @functools.cached_property
    def interpreted(self) -> Callable[..., Any]:
        """The function, which calls other kernels as Python's."""
        called = {name: other.watched for name, other in _kernels_in(self.python).items()}
        return types.FunctionType(self.python.__code__, self.python.__globals__ | called, self.python.__name__)

    def watched(self, *arguments: Any) -> Any:
        """As another kernel calls it."""
        if time.thread_time() > _run.ends:
            raise _TooLong
        return self.interpreted(*arguments)

    @property
    def targetoptions(self) -> Any:
        """What numba asks a function that a kernel calls."""
        return self.compiled.targetoptions


@njit(cache=True)
def put(source: Any, target: Any) -> None:
    """Copy into the first entries; for kernels, where ``target[:] = source`` brings two seconds of compiling."""
    for i in range(len(source)):
        target[i] = source[i]


def _typed(kernel: Kernel, _: Any) -> Any:
    """In other kernels it is the compiled function."""
    return numba.types.Dispatcher(kernel.compiled)


typeof_impl.register(Kernel)(_typed)


def _kernels_in(function: Any) -> dict[str, Kernel]:
    known = function.__globals__
    return {name: known[name] for name in function.__code__.co_names if isinstance(known.get(name), Kernel)}


def _arrays(arguments: Any) -> Iterator[Any]:
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            yield argument
        elif isinstance(argument, tuple):
            yield from _arrays(argument)


def _plain(found: Any) -> Any:
    """Numbers of Python's, as compiled functions return them."""
    if isinstance(found, np.generic):
        return found.item()
    if isinstance(found, tuple):
        parts = [_plain(part) for part in found]
        return type(found)(*parts) if hasattr(found, "_fields") else tuple(parts)
    return found


def _length(kernel: Kernel, known: set[str]) -> int:
    """Bytes of Python's code, of the kernels that it calls too."""
    known.add(kernel.py_func.__name__)
    called = (other for name, other in kernel.others.items() if name not in known)
    return len(kernel.py_func.__code__.co_code) + sum(_length(other, known) for other in called)


def _is_cached(compiled: Any) -> bool:
    """Whether an earlier process compiled it; numba does not say so in public: where it cannot be asked, no."""
    file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    return os.path.exists(getattr(file, "_index_path", ""))


class _Listener(event.Listener):
    """Adds the seconds of compiling up, for who waits."""

    depth, start = 0, 0.0

    def on_start(self, _: Any) -> None:
        self.depth += 1
        if self.depth == 1:
            self.start = time.perf_counter()

    def on_end(self, _: Any) -> None:
        self.depth -= 1
        if self.depth == 0:
            _progress.waited(time.perf_counter() - self.start)


event.register("numba:compile", _Listener())  # type: ignore[no-untyped-call]
