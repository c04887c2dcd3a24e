"""Files that appear whole or not at all, and what a command may replace.

The bytes of a file go to a part, ``.NAME.UUID.part`` in the same folder, which gets the
file's name in one step. The process that writes a part holds a lock on it, which ends
with the process: whoever writes into the folder next removes the parts that nobody
holds.

What stands at a path already is asked in one place. In Python, ``save`` replaces a file
as numpy's does, also the one that a link leads to. A command has an ``Output``: a file
that is there is an error before the work, unless ``--overwrite`` was given, and a new
one is created exclusively. A command follows no link to a file.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import signal
import stat
import threading
import time
import uuid
from collections.abc import Callable, Collection, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any

from oee_tabular.exceptions import ArgumentError

_flock: Callable[[int, int], object] | None = None
LOCK_FLAGS = 0
with contextlib.suppress(ImportError):  # Windows has no such module
    import fcntl

    _flock = fcntl.flock
    LOCK_FLAGS = fcntl.LOCK_EX | fcntl.LOCK_NB

PART = re.compile(
    r"\..*\.[0-9a-f]{12}4[0-9a-f]{3}[89ab][0-9a-f]{15}\.part", re.DOTALL
)  # with a random uuid, which no other program's files have
NAME_CHARS = 40  # of a file's name in that of its part: systems allow 255 bytes
ABANDONED_DAYS = 1.0  # age of a part that is removed where there are no locks
FEW = 1000  # names in a folder that are looked through before every file
LOCK = ".lock"
LOCK_SECONDS = 10.0  # to wait for another process that writes into a folder
MAX_INDEX_BYTES = 2**28
NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # a flag that Windows lacks
# errors by which file systems say that they have no hard links
NO_HARD_LINKS = (errno.EPERM, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
BUSY = (errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK)

# folder -> how many files may still be written before it is looked through again
_waits: dict[str, int] = {}
_output: ContextVar[Output | None] = ContextVar("output", default=None)


# ---- what stands there already


def special_kind(path: str | os.PathLike[str]) -> str | None:
    """Return in words what stands at a path other than a regular file, or None.

    A link is no regular file, whatever it leads to.
    """
    try:
        mode = os.lstat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    if stat.S_ISLNK(mode):
        return f"a link, to {os.readlink(path)!r}"
    if stat.S_ISDIR(mode):
        return "a folder"
    return None if stat.S_ISREG(mode) else "a device, a pipe or a socket"


class Output:
    """What a command is to write: asked before the work, and written after it.

    Parameters
    ----------
    path : path-like
        The file, or the folder.
    name : str
        The option that gave it, with which errors begin.
    overwrite : bool
        Whether ``--overwrite`` was given.
    """

    def __init__(self, path: str | os.PathLike[str], name: str, *, overwrite: bool):
        self.path = Path(path)
        self.name = name
        self.overwrite = overwrite
        # names of files in a folder that are replaced unasked
        self.own: Collection[str] = ()

    def check_file(self, path: Path) -> None:
        """Raise an ArgumentError unless this file may be written."""
        kind = special_kind(path)
        if kind is not None:
            raise ArgumentError(
                self.name,
                f"must be a regular file, or a new one; {str(path)!r} is {kind} (remove"
                " it, or name another file)",
            )
        if os.path.lexists(path) and not self.may_replace(path):
            self.refuse(path)

    def may_replace(self, path: Path) -> bool:
        """Say whether a regular file may be replaced."""
        return self.overwrite or path.name in self.own

    def refuse(self, path: Path) -> None:
        """Raise the ArgumentError for a file that is there already."""
        raise ArgumentError(
            self.name,
            f"must be a new file, or be given with --overwrite; {str(path)!r} exists"
            " already",
        )

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Let whatever writes files inside keep to what was asked."""
        token = _output.set(self)
        try:
            yield
        finally:
            _output.reset(token)


def current_output() -> Output | None:
    """Return what a command writes just now; None in Python."""
    return _output.get()


# ---- parts of files


class Part:
    """A file that is being written, in the folder where it belongs.

    Parameters
    ----------
    path : str
        Where it belongs.

    Attributes
    ----------
    target : Path
        The file that it becomes: in Python, what a link leads to.
    handle : binary file
        The part, open.

    Raises
    ------
    OSError
        If no file can be written there.
    ArgumentError
        If a command may not replace what stands there.
    """

    def __init__(self, path: str):
        self.path = path
        self.output = _output.get()
        if self.output is None:
            self.target = Path(os.path.realpath(path))
        else:
            self.target = Path(os.path.realpath(Path(path).parent)) / Path(path).name
        self.is_placed = False
        with self.errors():
            self._check()
            sweep(self.target.parent)
            self.handle, self.place_of_part = _make_part(self.target)

    def _check(self) -> None:
        """Raise an error where the file cannot be written."""
        target = self.target
        if self.output is not None:
            self.output.check_file(Path(self.path))
        if target.is_dir():
            raise IsADirectoryError(
                errno.EISDIR, "must be a file; it is a folder", self.path
            )
        if target.is_symlink() or (target.exists() and not target.is_file()):
            raise OSError(
                errno.EINVAL,
                f"must be a file; it is {_kind_of(target)} (write to a file instead)",
                self.path,
            )
        require_folder(target.parent)

    def __enter__(self) -> IO[bytes]:
        return self.handle

    def __exit__(self, *error: object) -> None:
        # a read-only disk refuses even if there is no such file
        with contextlib.suppress(OSError):
            self.handle.close()
        if not self.is_placed:
            with contextlib.suppress(OSError):
                self.place_of_part.unlink()

    def sync(self) -> None:
        """Write all that is left to the disk; a full one is an error here."""
        with self.errors():
            self.handle.flush()
            os.fsync(self.handle.fileno())

    def place(self) -> None:
        """Give the part its name, in one step."""
        if _flock is None:  # Windows moves no open file
            self.handle.close()
        with self.errors():
            if self.output is not None:
                self.output.check_file(Path(self.path))
            if self.output is None or self.output.may_replace(self.target):
                os.replace(self.place_of_part, self.target)
            else:
                try:
                    _name_anew(self.place_of_part, self.target)
                except FileExistsError:
                    self.output.refuse(Path(self.path))
        self.is_placed = True

    @contextlib.contextmanager
    def errors(self) -> Iterator[None]:
        """Let the system's errors name the file instead of its part."""
        try:
            yield
        except OSError as error:
            own = (None, getattr(self, "place_of_part", None))
            named = error.filename if error.filename is None else Path(error.filename)
            if error.errno is None or (named not in own and not _is_part(named)):
                raise
            raise cannot_write(error, self.path) from None


def _kind_of(path: Path) -> str:
    """Name what stands at a path that is no file and no folder."""
    if path.is_symlink():  # of a path without links
        return "a loop of links"
    if path.is_fifo():
        return "a named pipe"
    if path.is_socket():
        return "a socket"
    return "a device"


def require_folder(folder: Path) -> None:
    """Raise a FileNotFoundError unless there is such a folder."""
    if not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder", str(folder))


def cannot_write(error: OSError, path: str | os.PathLike[str]) -> OSError:
    """Return the error that a file cannot be written, for the reason of another."""
    number = error.errno
    if number == errno.ENOENT:  # in a folder that takes no files, as /proc
        number = errno.EACCES
    return OSError(number, f"cannot be written ({error.strerror})", os.fspath(path))


def _is_part(path: object) -> bool:
    """Say whether a path has the name of a part."""
    return isinstance(path, Path) and PART.fullmatch(path.name) is not None


def part_name(name: str) -> str:
    """Return a new name for a part of the file, or of the folder, ``name``."""
    return f".{name[:NAME_CHARS]}.{uuid.uuid4().hex}.part"


def _make_part(target: Path) -> tuple[IO[bytes], Path]:
    """Make a part that this process holds until it is closed."""
    while True:
        path = target.with_name(part_name(target.name))
        handle = open(path, "xb")  # noqa: SIM115  Part closes it
        # another process may take it for an abandoned one before it is locked
        if _lock(handle.fileno()) is not False and _is_at(handle.fileno(), path):
            return handle, path
        handle.close()


def _name_anew(part: Path, target: Path) -> None:
    """Give a part a name that no file has; FileExistsError if one has."""
    try:
        os.link(part, target)
    except OSError as error:
        if error.errno not in NO_HARD_LINKS:
            raise
        # the name is taken first, since moving would replace
        os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        os.replace(part, target)
    else:
        # a part that stays is removed by whoever writes here next
        with contextlib.suppress(OSError):
            part.unlink()


# ---- parts that killed processes left


def sweep(folder: Path) -> None:
    """Remove the parts in a folder that no process holds.

    One file in a thousand pays for a long folder, so that many files are saved into it
    in linear time.
    """
    key = str(folder)
    waits = _waits.pop(key, 0)
    if waits:
        _waits[key] = waits - 1
        return
    try:
        names = os.listdir(folder)
    except OSError:
        return
    if len(names) > FEW:
        _waits[key] = len(names) // FEW
    for name in names:
        if PART.fullmatch(name):
            with contextlib.suppress(OSError):
                _remove_abandoned(folder / name)


def _remove_abandoned(path: Path) -> None:
    """Remove a part, a file or a folder, unless a process holds it."""
    about = os.lstat(path)
    is_folder = stat.S_ISDIR(about.st_mode)
    if not is_folder and not stat.S_ISREG(about.st_mode):
        return
    flags = os.O_RDONLY | NO_LINK | getattr(os, "O_NONBLOCK", 0)
    held = None if _flock is None else os.open(path, flags)
    try:
        is_free = None if held is None else _lock(held) and _is_at(held, path)
        if is_free is None:
            is_free = time.time() - about.st_mtime > ABANDONED_DAYS * 86400.0
        if is_free and is_folder:
            shutil.rmtree(path, ignore_errors=True)
        elif is_free:
            path.unlink()
    finally:
        if held is not None:
            os.close(held)


def _lock(descriptor: int) -> bool | None:
    """Lock an open file until it is closed.

    False if another process has it; None where the file system has no locks.
    """
    if _flock is None:
        return None
    try:
        _flock(descriptor, LOCK_FLAGS)
    except OSError as error:
        return False if error.errno in BUSY else None
    return True


def _is_at(descriptor: int, path: Path) -> bool:
    """Say whether an open file is the one that stands at a path."""
    try:
        there = os.lstat(path)
    except OSError:
        return False
    return os.path.samestat(os.fstat(descriptor), there)


@contextlib.contextmanager
def folder_part(folder: Path, name: str) -> Iterator[Path]:
    """Make a folder inside ``folder`` for the parts of the new folder ``name``.

    It is gone afterwards, with all that is still in it.
    """
    sweep(folder)
    path = folder / part_name(name)
    path.mkdir()
    held = None
    try:
        if _flock is not None:
            held = os.open(path, os.O_RDONLY)
            _lock(held)
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
        if held is not None:
            os.close(held)


@contextlib.contextmanager
def waiting_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait until the end.

    A library in C++ may abort the process where it comes in the middle of a file.
    """
    is_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT)
    if not is_main or before is None:  # None: not set by Python
        yield
        return
    came = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


# ---- folders of several files


@contextlib.contextmanager
def alone_in(folder: Path, remedy: str, *, seconds: float = 0.0) -> Iterator[None]:
    """Hold ``folder``, which is made where it is missing.

    An ArgumentError says that another process holds it for longer than ``seconds``. The
    lock is the system's: it ends with the process that holds it, however it dies.
    """
    # .03 s, for which reading does not wait
    from filelock import FileLock, Timeout

    new = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    _require_own_lock(path)
    lock = FileLock(path, timeout=seconds)  # which opens no link
    try:
        lock.acquire()
    except Timeout:
        holder = ""
        with contextlib.suppress(OSError):
            holder = _read_lock(path)
        process = f" (process {holder})" if holder.isdigit() else ""
        raise ArgumentError(
            f"{folder}",
            f"must be used by one command at a time; another{process} is at work in it:"
            f" {remedy}",
        ) from None
    except OSError as error:
        raise cannot_write(error, path) from None
    try:
        # the number is a help for people; on a full disk there is none
        with contextlib.suppress(OSError):
            _write_number(path)
        yield
    finally:
        with contextlib.suppress(OSError):  # Windows removes no open file
            path.unlink()
        lock.release()
        with contextlib.suppress(OSError):
            for path in new:
                path.rmdir()  # where nothing was written


def _read_lock(path: Path) -> str:
    """Return the first line of a lock's file: the number of a process, or nothing."""
    with open(
        path, "rb", opener=lambda name, flags: os.open(name, flags | NO_LINK)
    ) as handle:
        return handle.read(20).decode("ascii", "replace").partition("\n")[0]


def _require_own_lock(path: Path) -> None:
    """Raise an ArgumentError where a file of somebody else has the lock's name."""
    kind = special_kind(path)
    if kind is None:
        with contextlib.suppress(FileNotFoundError):
            holder = _read_lock(path)
            if os.lstat(path).st_nlink > 1:
                kind = "a file with a second name"
            elif holder and not holder.isdigit():
                kind = "another file"
    if kind is not None:
        raise ArgumentError(
            f"{str(path)!r}",
            "must be a plain file, the lock of a command, with the number of its"
            f" process; it is {kind}: remove it",
        )


def _write_number(path: Path) -> None:
    """Write the process's number into the lock, but into no other file."""
    descriptor = os.open(path, os.O_RDWR | NO_LINK)
    try:
        about = os.fstat(descriptor)
        old = os.read(descriptor, 20).strip()
        is_own = stat.S_ISREG(about.st_mode) and about.st_nlink == 1
        if is_own and (not old or old.isdigit()):
            os.ftruncate(descriptor, 0)
            os.lseek(descriptor, 0, os.SEEK_SET)
            os.write(descriptor, f"{os.getpid()}\n".encode())
    finally:
        os.close(descriptor)


def sha256(data: bytes) -> str:
    """Return the digest of a file's bytes, as an index lists it."""
    return hashlib.sha256(data).hexdigest()


def listed_files(folder: Path, index: str) -> dict[str, set[str]]:
    """Return the digests of the files that a folder's index lists, by name.

    The index is a JSON file with the field ``files``. A command that was killed while
    its files got their names leaves the part of the new index, which counts as well.
    """
    parts = []
    with contextlib.suppress(OSError):
        parts = [
            name
            for name in os.listdir(folder)
            if PART.fullmatch(name) and name.startswith(f".{index}.")
        ]
    found: dict[str, set[str]] = {}
    for name in (index, *parts):
        content = read_index(folder / name)
        files = content.get("files")
        for file, digest in files.items() if isinstance(files, dict) else ():
            if isinstance(digest, str):
                found.setdefault(file, set()).add(digest)
    return found


def read_index(path: Path) -> dict[str, Any]:
    """Read a JSON file of one object; an empty one for whatever is none."""
    with contextlib.suppress(OSError, ValueError, RecursionError):
        if special_kind(path) is None and path.stat().st_size <= MAX_INDEX_BYTES:
            content = json.loads(path.read_bytes())
            if isinstance(content, dict):
                return content
    return {}


def digest_of(path: Path) -> str | None:
    """Return the digest of a regular file; None for whatever is none."""
    if special_kind(path) is not None:
        return None
    try:
        with open(path, "rb") as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError:
        return None


def _is_waiting(part: Part) -> bool:
    """Say whether a part still has its own name."""
    return os.path.lexists(part.place_of_part)


def place_all(parts: list[Part]) -> None:
    """Give all parts their names, one after the other.

    Where the first cannot have its name, none gets one. What comes later, Ctrl-C among
    it, does not leave the files of two runs: the others still get theirs.
    """
    for k, part in enumerate(parts):
        try:
            part.place()
        except BaseException:
            if not all(map(_is_waiting, parts)):
                for left in parts[k:]:
                    with contextlib.suppress(OSError, ValueError):
                        left.place()
            raise
