"""One command at a time in a folder: a lock of the system's, which ends with the process that holds it, however it dies."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from pathlib import Path

NAME = ".lock"
HELD = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


@contextlib.contextmanager
def only_one(folder: Path) -> Iterator[None]:
    """Hold ``folder``, which is made if it is not there; ValueError where another command does.

    On a file system without locks nothing is held.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    handle = _held(path)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # Windows removes no open file
            path.unlink()
        os.close(handle)
        with contextlib.suppress(OSError):
            for path in made:
                path.rmdir()  # where nothing was written


def _held(path: Path) -> int:
    """The locked file; it is looked at again since who held it before removes it."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _lock(handle)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.stat(path), os.fstat(handle)):
                    os.truncate(handle, 0)
                    os.write(handle, f"{os.getpid()}\n".encode())
                    return handle
            os.close(handle)
        except OSError as error:
            held = os.read(handle, 20).decode(errors="replace").strip() if error.errno in HELD else ""
            os.close(handle)
            if error.errno not in HELD:
                raise OSError(error.errno, f"cannot be written ({error.strerror})", str(path)) from None
            who = f" (process {held})" if held else ""
            raise ValueError(
                f"{path.parent} must be used by one command at a time; another{who} is at work in it: wait for it, or name "
                "another folder with --output"
            ) from None


if sys.platform == "win32":
    import msvcrt

    def _lock(handle: int) -> None:
        os.lseek(handle, 1 << 20, os.SEEK_SET)  # a byte that nobody writes: locked ones cannot be read
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        os.lseek(handle, 0, os.SEEK_SET)

else:
    import fcntl

    def _lock(handle: int) -> None:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                raise
