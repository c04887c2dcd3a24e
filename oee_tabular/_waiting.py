"""What is said to who waits for the compiler; the command sets ``tell``."""

from __future__ import annotations

from collections.abc import Callable

LONG = 2.0  # seconds

tell: Callable[[str], object] | None = None
_taken = 0.0


def waited(seconds: float) -> None:
    """One sentence, once it has taken long."""
    global _taken, tell
    _taken += seconds
    if tell is not None and _taken > LONG:
        tell("compiling (once)")
        tell = None
