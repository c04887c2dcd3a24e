"""One command at a time in a folder: a lock of the system's, which ends with the process that holds it, however it dies."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

NAME = ".lock"


@contextlib.contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Hold ``folder``, made where it is not there; ValueError where another command does, or ``.lock`` is a link."""
    from filelock import FileLock, Timeout

    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    if path.is_symlink() or (path.exists() and not path.is_file()):  # of a link that comes later filelock opens none
        raise ValueError(f"{str(path)!r} must be a plain file; it is a link or something else: remove it")
    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        holder = path.read_text(errors="replace")[:20].strip() if path.is_file() else ""
        raise ValueError(
            f"{folder} must be used by one command at a time; another{f' (process {holder})' if holder else ''} is at "
            "work in it: wait for it, or name another folder with --output"
        ) from None
    except OSError as error:
        raise OSError(error.errno, f"cannot be written ({error.strerror})", str(path)) from None
    try:
        path.write_text(f"{os.getpid()}\n")
        yield
    finally:
        with contextlib.suppress(OSError):  # Windows removes no open file
            path.unlink()
        lock.release()
        with contextlib.suppress(OSError):
            for path in made:
                path.rmdir()  # where nothing was written
