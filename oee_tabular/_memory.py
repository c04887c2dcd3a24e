"""Memory that this process can still take: the system's, its container's, its limits.

A container or a batch job has a limit (a control group), at which the system kills the
process without a word. A limit of the process (``ulimit -v``) gives errors in places
where no library expects them. Both are asked before large arrays are made.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
from collections.abc import Iterator
from pathlib import Path

ROOT = Path("/")  # where proc and sys are; a test has others
# Where the control groups of memory are: of version 2 alone, beside version 1, and of
# version 1; with the files of a group's limit and of what it uses.
GROUPS = (
    ("sys/fs/cgroup", "0", "memory.max", "memory.current", "inactive_file"),
    ("sys/fs/cgroup/unified", "0", "memory.max", "memory.current", "inactive_file"),
    (
        "sys/fs/cgroup/memory",
        "memory",
        "memory.limit_in_bytes",
        "memory.usage_in_bytes",
        "total_inactive_file",
    ),
)
NO_LIMIT_BYTES = 2**60  # version 1 has a number near 2**63 where there is no limit
ADDRESSES, DATA = 0, 5  # columns of statm, in pages
# of what a control group has left: the system's own tables count as well
GROUP_SHARE = 0.95
MIN_BYTES = 0.4 * 2**30  # for the smallest problem, measured
MIN_ADDRESS_BYTES = (
    1.0 * 2**30
)  # numpy, scipy and numba with two threads each, measured
# what reading a file of numbers may raise, where the system has no such file
UNREADABLE = (OSError, ValueError, IndexError)


def free_memory() -> float:
    """Return how many bytes this process can still take.

    It is infinite where the system does not say.
    """
    sizes = [*_system(), *_groups(), *_limits()]
    return max(0.0, min(sizes, default=math.inf))


def limit_memory() -> None:
    """Let this process run out of memory with an error where its container has a limit.

    At the limit of a control group, the system would kill it without a word.
    """
    left = GROUP_SHARE * min(_groups(), default=math.inf)
    if math.isinf(left):
        return
    with contextlib.suppress(ImportError, *UNREADABLE):
        import resource  # which Windows lacks

        soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
        limit = int(left) + _used_bytes(DATA)
        if soft == resource.RLIM_INFINITY or limit < soft:
            resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def require_room() -> None:
    """Refuse to begin where libraries could not even start.

    Linear algebra and the compiler end or hang the process there, without an error.

    Raises
    ------
    MemoryError
        If a limit of this process or of its container leaves less than they take.
    """
    rooms = [(MIN_BYTES, left, "the container's") for left in _groups()]
    with contextlib.suppress(ImportError, *UNREADABLE):
        import resource  # which Windows lacks

        for least, limit, name in (
            (MIN_ADDRESS_BYTES, resource.RLIMIT_AS, "ulimit -v"),
            (MIN_BYTES, resource.RLIMIT_DATA, "ulimit -d"),
        ):
            soft, _ = resource.getrlimit(limit)
            if soft != resource.RLIM_INFINITY:
                rooms.append((least, float(soft), name))
    for least, room, name in rooms:
        if room < least:
            raise MemoryError(
                f"this needs a limit of {least / 2**30:.3g} GiB or more; it is"
                f" {room / 2**30:.3g} GiB ({name})"
            )


def _system() -> Iterator[float]:
    """Yield what the system has left."""
    with contextlib.suppress(*UNREADABLE):
        text = (ROOT / "proc/meminfo").read_text()
        yield 1024.0 * int(text.partition("MemAvailable:")[2].split()[0])


def _groups() -> Iterator[float]:
    """Yield what is left to each control group that holds this process."""
    for folder, (limit, used, cached) in _limited_groups():
        with contextlib.suppress(*UNREADABLE):
            left = int((folder / limit).read_text()) - int((folder / used).read_text())
            # files that the system keeps in memory while nobody needs it
            statistics = (folder / "memory.stat").read_text().split()
            left += int(statistics[statistics.index(cached) + 1])
            yield float(left)


@functools.cache
def _limited_groups() -> list[tuple[Path, tuple[str, str, str]]]:
    """Find the control groups of this process that have a limit.

    Looked for once, because most processes have none.
    """
    groups = {}
    with contextlib.suppress(*UNREADABLE):
        for line in (ROOT / "proc/self/cgroup").read_text().splitlines():
            number, _, rest = line.partition(":")
            controllers, _, path = rest.partition(":")
            for name in controllers.split(",") if controllers else [number]:
                groups[name] = path
    found = []
    for place, name, *files in GROUPS:
        # inside of a container, its own group may be at the top
        group = Path("/" + groups.get(name, "").strip("/"))
        for parent in (group, *group.parents):
            folder = ROOT / place / str(parent).strip("/")
            # "max", where there is no limit, is a ValueError
            with contextlib.suppress(*UNREADABLE):
                if int((folder / files[0]).read_text()) < NO_LIMIT_BYTES:
                    found.append((folder, (files[0], files[1], files[2])))
    return found


def _limits() -> Iterator[float]:
    """Yield what is left below the limits of this process."""
    with contextlib.suppress(ImportError, *UNREADABLE):
        import resource  # which Windows lacks

        for limit, column in (
            (resource.RLIMIT_AS, ADDRESSES),
            (resource.RLIMIT_DATA, DATA),
        ):
            soft, _ = resource.getrlimit(limit)
            if soft != resource.RLIM_INFINITY:
                yield float(soft - _used_bytes(column))


def _used_bytes(column: int) -> int:
    """Return how much memory this process has, in a column of its statistics."""
    pages = (ROOT / "proc/self/statm").read_text().split()
    return os.sysconf("SC_PAGE_SIZE") * int(pages[column])
