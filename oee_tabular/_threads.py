"""The same bits for any number of threads: BLAS splits long sums among its threads, and their order decides the last digits."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numpy as np

from oee_tabular._checks import Array

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def dot(x: Array, y: Array) -> float:
    """sum x y, pairwise; for long vectors that are not worth ``one_thread``."""
    return float(np.add.reduce(x * y))


class _OneThread:
    """BLAS with one thread while anybody is inside, and then as before; Python threads may come and go in any order."""

    def __init__(self) -> None:
        self.lock, self.n_inside = threading.Lock(), 0
        self.libraries: list[Any] | None = None
        self.before: list[int] = []
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._reset)

    def _reset(self) -> None:
        """A forked process has none of the threads that were inside, nor one that would open the lock."""
        self.lock = threading.Lock()
        if self.n_inside:
            self.n_inside = 0
            self._set(self.before)

    def __enter__(self) -> None:
        with self.lock:
            if self.n_inside == 0:
                if self.libraries is None:
                    import scipy.linalg  # noqa: F401  a BLAS of its own, which must be loaded first
                    from threadpoolctl import ThreadpoolController

                    self.libraries = ThreadpoolController().select(user_api="blas").lib_controllers
                self.before = [library.num_threads or 1 for library in self.libraries]
                self._set([1] * len(self.before))
            self.n_inside += 1

    def __exit__(self, *error: object) -> None:
        with self.lock:
            if self.n_inside == 1:
                self._set(self.before)
            self.n_inside = max(self.n_inside - 1, 0)

    def _set(self, numbers: list[int]) -> None:
        for library, number in zip(self.libraries or [], numbers, strict=True):
            # threadpoolctl 3.6 lets only one Python thread set OpenBLAS's number, lest they fight; ours take turns
            getattr(library, "_real_set_num_threads", library.set_num_threads)(number)


ONE_THREAD = _OneThread()


def one_thread(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """The function, with one BLAS thread while it runs (five microseconds more)."""

    @functools.wraps(function)
    def alone(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        with ONE_THREAD:
            return function(*args, **kwargs)

    return alone
