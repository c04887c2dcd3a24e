"""What is being done, for people who wait: nothing for quick work, else lines and bars on stderr (tqdm).

A step is told once the work has taken two seconds, at most one every two. Who waits for the compiler gets one sentence;
the command sets ``tell``.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SECONDS = 2.0  # between two looks at the step that is being done
LONG = 2.0  # seconds of compiling

tell: Callable[[str], object] | None = None
_listeners: list[_Steps] = []


def progress_bar(title: str, items: Any = None, **options: Any) -> Any:
    """A tqdm bar over ``items`` (or of a ``total``), shown after two seconds, on a terminal alone, gone at the end."""
    from tqdm import tqdm  # not tqdm.auto: that warns in Jupyter without ipywidgets

    return tqdm(items, desc=title, **({"disable": None, "delay": SECONDS, "leave": False} | options))


def report_step(step: str) -> None:
    """Say what is being done now; it is told if somebody listens and it is slow."""
    if _listeners:
        _listeners[-1].begin(step)


@contextmanager
def show_steps(*, only_terminal: bool = False) -> Iterator[None]:
    """Steps inside are told on stderr; those who listen already go on (``only_terminal``: nobody else, unless it is one)."""
    if _listeners or (only_terminal and not sys.stderr.isatty()):
        yield
        return
    _listeners.append(_Steps())
    try:
        yield
    finally:
        _listeners.pop().end()


class _Steps:
    """The step that is being done, and a thread that tells it; it starts with the first step."""

    def __init__(self) -> None:
        self.step, self.start = "", 0.0
        self.is_done = threading.Event()
        self.thread: threading.Thread | None = None

    def begin(self, step: str) -> None:
        self.step = step
        if self.thread is None:
            if tell is not None:
                announce_compiling(tell)
            self.start = time.monotonic()
            self.thread = threading.Thread(target=self.watch, daemon=True)
            self.thread.start()

    def end(self) -> None:
        self.is_done.set()
        if self.thread is not None:
            self.thread.join()

    def watch(self) -> None:
        last = ""
        while not self.is_done.wait(SECONDS):
            if self.step != last:
                from tqdm import tqdm  # whose bars stay below the line

                last = self.step
                tqdm.write(f"oee: {time.monotonic() - self.start:.0f} s: {last}", file=sys.stderr)
                sys.stderr.flush()


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
