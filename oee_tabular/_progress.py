"""What is being done, for people who wait: nothing for quick work, else lines and bars
on stderr (tqdm).

A step is told once the work has taken two seconds, at most one every two. Who waits for
the compiler gets one sentence; the command sets ``tell``.
"""

from __future__ import annotations

import functools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SECONDS = 2.0  # between two looks at the step that is being done
LONG = 2.0  # seconds of compiling

tell: Callable[[str], object] | None = None
_step: str | None = None  # what is being done; None: nobody listens


def progress_bar(title: str, items: Any = None, **options: Any) -> Any:
    """A tqdm bar over ``items`` (or of a ``total``), shown after two seconds, on a
    terminal alone, gone at the end.
    """
    from tqdm import tqdm  # not tqdm.auto: that warns in Jupyter without ipywidgets

    return tqdm(
        items,
        desc=title,
        **({"disable": None, "delay": SECONDS, "leave": False} | options),
    )


def report_step(step: str) -> None:
    """Say what is being done now; it is told if somebody listens and it is slow."""
    global _step
    if _step is not None:
        _step = step
        if tell is not None:
            announce_compiling(tell)


@contextmanager
def show_steps(*, only_terminal: bool = False) -> Iterator[None]:
    """Steps inside are told on stderr; those who listen already go on
    (``only_terminal``: nobody else, unless it is one).
    """
    global _step
    if _step is not None or (only_terminal and not sys.stderr.isatty()):
        yield
        return
    _step = ""
    is_done = threading.Event()
    thread = threading.Thread(target=_tell_steps, args=(is_done,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_done.set()
        thread.join()
        _step = None


def _tell_steps(is_done: threading.Event) -> None:
    start = time.monotonic()
    last = ""
    while not is_done.wait(SECONDS):
        if _step and _step != last:
            from tqdm import tqdm  # whose bars stay below the line

            last = _step
            tqdm.write(
                f"oee: {time.monotonic() - start:.0f} s: {last}", file=sys.stderr
            )
            sys.stderr.flush()


@functools.cache
def announce_compiling(tell: Callable[[str], object]) -> None:
    """One sentence to ``tell``, once numba has compiled for two seconds."""
    from numba.core import event

    class Listener(event.TimingListener):
        is_told = False

        def on_end(self, happening: Any) -> None:
            super().on_end(happening)  # type: ignore[no-untyped-call]
            if self.done and self.duration > LONG and not self.is_told:
                self.is_told = True
                tell("compiling (once)")

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]
