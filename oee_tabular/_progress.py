"""What is being done, for people who wait: a line on stderr once the work has taken two seconds, at most one every two.

Who waits for the compiler gets one sentence; the command sets ``tell``.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SECONDS = 2.0
LONG = 2.0  # seconds of compiling

tell: Callable[[str], object] | None = None


def announce_compiling(tell: Callable[[str], object]) -> None:
    """One sentence to ``tell``, once numba has compiled for two seconds."""
    from numba.core import event

    class Listener(event.Listener):
        depth, start, seconds = 0, 0.0, 0.0

        def on_start(self, _: object) -> None:
            self.depth += 1
            if self.depth == 1:
                self.start = time.perf_counter()

        def on_end(self, _: object) -> None:
            self.depth -= 1
            if self.depth == 0:
                before, self.seconds = self.seconds, self.seconds + time.perf_counter() - self.start
                if before <= LONG < self.seconds:
                    tell("compiling (once)")

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]


class _Steps:
    """The step that is being done, and a thread that tells it; it starts with the first step."""

    def __init__(self) -> None:
        self.step, self._told = "", ""
        self._over = threading.Event()
        self._begun = 0.0
        self._thread: threading.Thread | None = None

    def begin(self, step: str) -> None:
        self.step = step
        if self._thread is None:
            if tell is not None:
                announce_compiling(tell)
            self._begun = time.monotonic()
            self._thread = threading.Thread(target=self._tell, daemon=True)
            self._thread.start()

    def end(self) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def _tell(self) -> None:
        while not self._over.wait(SECONDS):
            if self.step != self._told:
                self._told = self.step
                print(f"oee: {time.monotonic() - self._begun:.0f} s: {self.step}", file=sys.stderr, flush=True)


_open: list[_Steps] = []


def doing(step: str) -> None:
    """Say what is being done now; it is told if somebody listens and it is slow."""
    if _open:
        _open[-1].begin(step)


@contextmanager
def told(*, only_terminal: bool = False) -> Iterator[None]:
    """Steps inside are told on stderr; those who listen already go on (``only_terminal``: nobody else, unless it is one)."""
    if _open or (only_terminal and not sys.stderr.isatty()):
        yield
        return
    steps = _Steps()
    _open.append(steps)
    try:
        yield
    finally:
        _open.remove(steps)
        steps.end()
