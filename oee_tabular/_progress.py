"""Progress of slow work, as lines and bars (tqdm) on stderr.

Quick work prints nothing. A step is printed once the work has taken two seconds, at
most one every two seconds. The command sets ``tell``, by which a user who waits for the
compiler gets one sentence.
"""

from __future__ import annotations

import functools
import io
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

SECONDS = 2.0  # between two looks at the step that is being done
SECONDS_OF_COMPILING = 4.0  # after which the user is told how far it is

tell: Callable[[str], object] | None = None
_step: str | None = None  # what is being done; None means that nobody listens
finished: list[str] = []  # lines on what is done, for a user who interrupts the work


class Watch:
    """A limit in time for work that can stop early; None is no limit."""

    def __init__(self, seconds: float | None) -> None:
        """Begin to measure the time."""
        self.end = math.inf if seconds is None else time.monotonic() + seconds

    @property
    def is_over(self) -> bool:
        """Return whether the time is over."""
        return time.monotonic() >= self.end

    @property
    def left(self) -> float | None:
        """Return the seconds that are left; None without a limit."""
        if math.isinf(self.end):
            return None
        return max(self.end - time.monotonic(), 1e-9)

    def part(self, share: float) -> Watch:
        """Return a watch for a share of the time that is left."""
        return Watch(None if self.left is None else share * self.left)


def progress_bar(title: str, items: Any = None, **options: Any) -> Any:
    """Make a tqdm bar over ``items``, or of a ``total``.

    It appears after two seconds, only on a terminal, and is removed at the end.
    """
    from tqdm import tqdm  # not tqdm.auto: that warns in Jupyter without ipywidgets

    # None disables the bar unless stderr is a terminal
    defaults: dict[str, Any] = {"disable": None, "delay": SECONDS, "leave": False}
    chosen = defaults | options
    if chosen["disable"] is None:
        chosen["disable"] = not is_terminal(sys.stderr)
    if not chosen["disable"] and not can_show():
        chosen["disable"] = True
    if chosen["disable"]:  # tqdm asks its stream even then
        chosen["file"] = io.StringIO()
    return tqdm(items, desc=title, **chosen)


def is_terminal(stream: Any) -> bool:
    """Return whether a stream is a terminal.

    A service has None in place of a stream; that of a notebook may lack the method. A
    stream that cannot say is none.
    """
    try:
        return bool(stream.isatty())
    except Exception:  # missing, closed, gone; a user's object may raise anything
        return False


def can_show() -> bool:
    """Return whether a bar can be shown on stderr, a terminal or a file.

    The streams are asked for all that tqdm asks them for, which also flushes stdout.
    """
    try:
        if sys.stderr is None or getattr(sys.stderr, "closed", False):
            return False
        _ = getattr(sys.stderr, "encoding", None)
        sys.stderr.write("")
        for stream in (sys.stderr, sys.stdout):
            getattr(stream, "flush", bool)()
    except Exception:  # a user's object may raise anything
        return False
    return True


def report_step(step: str) -> None:
    """Set what is being done now; it is printed if somebody listens and it is slow."""
    global _step
    if _step is not None:
        _step = step
        if tell is not None:
            announce_compiling(tell)


class Pace:
    """Steps of about equal length, told with an estimate of the time that is left."""

    def __init__(self, n_steps: int) -> None:
        self._n_steps = n_steps
        self._n_done = 0
        self._started = time.monotonic()

    def report(self, step: str) -> None:
        """Report the next step."""
        left = ""
        if self._n_done:
            each = (time.monotonic() - self._started) / self._n_done
            seconds = each * (self._n_steps - self._n_done)
            left = f", about {seconds:.0f} s left"
        self._n_done += 1
        report_step(f"{step} ({self._n_done} of {self._n_steps}{left})")


def report_finished(line: str) -> None:
    """Keep a line on what is finished; an interrupted command prints these lines."""
    if _step is not None:
        finished.append(line)


@contextmanager
def show_steps(*, only_terminal: bool = False) -> Iterator[None]:
    """Print the steps inside on stderr.

    Inside another ``show_steps`` nothing changes. With ``only_terminal``, nothing is
    printed unless stderr is a terminal.
    """
    global _step
    if _step is not None or (only_terminal and not is_terminal(sys.stderr)):
        yield
        return
    _step = ""
    finished.clear()
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
    """Print each new step, until the work is done."""
    start = time.monotonic()
    last = ""
    while not is_done.wait(SECONDS):
        if _step and _step != last and sys.stderr is not None:
            from tqdm import tqdm  # whose bars stay below the line

            last = _step
            # a stream that is gone must not end the work
            with suppress(Exception):
                tqdm.write(
                    f"oee: {time.monotonic() - start:.0f} s: {last}", file=sys.stderr
                )
                sys.stderr.flush()


@functools.cache
def announce_compiling(tell: Callable[[str], object]) -> None:
    """Send a sentence to ``tell`` when numba begins to compile, and others on its way."""
    try:
        from numba.core import event
    except ImportError:
        return

    class Listener(event.Listener):
        """A listener that counts what was compiled."""

        number = 0
        last = 0.0

        def on_start(self, happening: Any) -> None:
            """Say what begins, once."""
            if not self.last:
                self.last = time.monotonic()
                tell("compiling (about 10 s in all, once on this machine)")

        def on_end(self, happening: Any) -> None:
            """Say how far it is, every few seconds."""
            self.number += 1
            if time.monotonic() - self.last > SECONDS_OF_COMPILING:
                self.last = time.monotonic()
                tell(f"compiling: {self.number} functions so far")

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]
