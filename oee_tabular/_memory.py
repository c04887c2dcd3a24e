"""How much memory there is: asked before it is taken, since a system may grant what it does not have and kill later."""

from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path

LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # of a container


def require(size: float, what: str) -> None:
    """MemoryError, with the sizes, where ``size`` bytes are not to be had."""
    free = available()
    if size > free:
        raise MemoryError(f"{what} needs {words(size)} of memory; {words(free)} are free")


def words(size: float) -> str:
    """A number of bytes in words."""
    return f"{size:.0f} bytes" if size < 2**20 else f"{size / 2**30:.3g} GiB"


def available() -> float:
    """Bytes that a process can still take; infinite where the system does not say."""
    known = [math.inf]
    with contextlib.suppress(OSError, ValueError, IndexError):
        text = Path("/proc/meminfo").read_text()
        known.append(1024.0 * int(text.partition("MemAvailable:")[2].split()[0]))
    with contextlib.suppress(AttributeError, OSError, ValueError):
        known.append(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    for limit in LIMITS:
        with contextlib.suppress(OSError, ValueError):  # "max": none
            known.append(float(int(Path(limit).read_text())))
    return min(known)
