"""Reading and writing of files: complete or not at all, local, and never pickles."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import math
import os
import re
import stat
import tempfile
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _writing
from oee_tabular._writing import Output, Part
from oee_tabular.exceptions import ArgumentError

KIND = "oee_tabular_kind"
DIGEST = "oee_tabular_digest"
KINDS = {
    "finite_mdp": "FiniteMDP",
    "transitions": "log of numbered states (Transitions)",
    "transition_counts": "counted log (TransitionCounts)",
    "continuous_transitions": "log of continuous states (ContinuousTransitions)",
}
# a spreadsheet reads a cell that begins with one of these as a formula
FORMULA = re.compile(r"[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
LONGEST_PATH = 1000  # characters; systems allow 255 to 4096, and errors repeat it
MAX_HEADER_BYTES = 10_000  # of an npy, as numpy reads
MAX_TEXT_BYTES = 2**28  # of a file that is read as one text
_ZIP = (
    b"PK\x03\x04",
    b"PK\x05\x06",
)  # the first bytes of a zip file, and of an empty one


def local(path: str | os.PathLike[str], argument: str = "path") -> str:
    """Return a path as text; refuse an address of another machine.

    Nothing is opened. ``argument`` is the name that errors begin with.
    """
    given: Any = path
    if not isinstance(given, str | os.PathLike):
        hint = ""
        if hasattr(given, "read"):
            hint = " (an open file is none: give the name of a file)"
        raise ArgumentError(
            argument, f"must be a path of a file; got {type(path).__name__}{hint}"
        )
    name = os.fspath(path)
    if not isinstance(name, str) or "\0" in name or not name:
        raise ArgumentError(
            argument,
            "must be text, not empty and without a null character; got"
            f" {_checks.show(name)}",
        )
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        raise ArgumentError(
            argument,
            f"must be text that a file's name can hold; got {_checks.show(name)}",
        ) from None
    if len(name) > LONGEST_PATH:
        raise ArgumentError(
            argument,
            f"must have at most {LONGEST_PATH} characters; it has {len(name)}:"
            f" {_checks.show(name)}",
        )
    if name == "-":
        raise ArgumentError(
            argument,
            "must be a file; '-', standard input or output, is none (--json prints what"
            " a command found)",
        )
    # one slash, because pathlib makes one of two
    is_address = re.match(r"(?!minari:)[A-Za-z][A-Za-z0-9+.-]+:/", name) is not None
    if is_address and not os.path.exists(name):
        raise ArgumentError(
            argument,
            f"must be a file of this machine; {name!r} is an address, and nothing is"
            " fetched",
        )
    return name


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raise an error unless a path leads to a regular file.

    Opening a named pipe waits for its writer, and a device has no end. A link counts
    as what it leads to. What is not there, or is a folder, is an OSError as ever.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISREG(mode):
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "must be a file; it is a folder", path)
    kind = "a device"
    if stat.S_ISFIFO(mode):
        kind = "a pipe"
    elif stat.S_ISSOCK(mode):
        kind = "a socket"
    raise ArgumentError(
        f"{os.fspath(path)!r}",
        f"must be a regular file; it is {kind} (write what comes out of it to a file"
        " first)",
    )


def open_regular(path: str | os.PathLike[str]) -> IO[bytes]:
    """Open a user's regular file to read its bytes; all others are an error."""
    local(path)
    require_regular(path)
    # should a pipe have taken the file's place, this does not wait for its writer
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    number = os.open(path, flags)
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise ArgumentError(f"{os.fspath(path)!r}", "must stay a regular file")
    return os.fdopen(number, "rb")


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a user's regular file, in UTF-8.

    A file that no text of this package is as large as is an ArgumentError.
    """
    with open_regular(path) as handle:
        data = handle.read(MAX_TEXT_BYTES + 1)
    if len(data) > MAX_TEXT_BYTES:
        raise ArgumentError(
            f"{os.fspath(path)!r}", f"must have at most {MAX_TEXT_BYTES} bytes"
        )
    return data.decode()


def new_file(
    path: str | os.PathLike[str],
    name: str,
    *,
    overwrite: bool,
    endings: tuple[str, ...] = (),
) -> Output:
    """Check that a command can write a file, and that nothing there is lost.

    Parameters
    ----------
    path : str or path-like
        The file.
    name : str
        The option that gave it, with which errors begin.
    overwrite : bool
        Whether a regular file that is there is replaced.
    endings : tuple of str
        The endings that the file may have; without any, all.

    Returns
    -------
    Output
        What lets the file be written: ``with output.writing(): save(path)``.

    Raises
    ------
    ArgumentError
        If something else is there, or a file and ``overwrite`` is False.
    OSError
        If no file can be written there.
    """
    require_ending(local(path, name), endings, name)
    folder = Path(path).parent
    output = Output(path, name, overwrite=overwrite)
    _writing.sweep(folder)
    output.check_file(Path(path))
    _writing.require_folder(folder)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _writing.cannot_write(error, path) from None
    return output


def has_ending(path: str | os.PathLike[str], endings: tuple[str, ...]) -> bool:
    """Say whether the name of a file ends so, in small or capital letters."""
    return Path(path).name.lower().endswith(endings)


def require_ending(
    path: str | os.PathLike[str], endings: tuple[str, ...], name: str = "path"
) -> None:
    """Raise an ArgumentError where a file has none of the endings, if there are any."""
    if endings and not has_ending(path, endings):
        raise ArgumentError(
            name, f"must end in {' or '.join(endings)}; it is {os.fspath(path)!r}"
        )


@contextmanager
def whole_file(
    path: str | os.PathLike[str], suffixes: tuple[str, ...] = ()
) -> Iterator[IO[bytes]]:
    """Open a binary file that appears under its name only once it is complete.

    The bytes go to a part in the same folder, are flushed to disk and moved to ``path``
    in one step. An error on the way leaves the old file in place, and names ``path``. A
    link stays a link: the file that it leads to is replaced. Inside
    ``Output.writing()`` the command's rules hold instead.
    """
    require_ending(local(path), suffixes)
    part = Part(os.fspath(path))
    with part as handle, part.errors():
        yield handle
        part.sync()
        part.place()


def write_all(
    folder: Path, contents: Mapping[str, bytes], *, remove: Iterable[str] = ()
) -> None:
    """Write every file of ``contents`` into ``folder``, or none of them.

    Old files stay until all new ones are ready. The new ones get their names in the
    order in which they are given. Then those to ``remove`` are removed.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with ExitStack() as stack:
            parts = []
            for name, data in contents.items():
                part = Part(os.fspath(folder / name))
                handle = stack.enter_context(part)
                with part.errors():
                    handle.write(data)
                # a full disk is an error here, before the first file has its name
                part.sync()
                parts.append(part)
            _writing.place_all(parts)
    except BaseException:
        with contextlib.suppress(OSError):
            for path in made:
                path.rmdir()  # where nothing was written
        raise
    for name in remove:
        with contextlib.suppress(OSError):
            (folder / name).unlink()


def text_bytes(text: str) -> bytes:
    r"""Encode text for a file as UTF-8.

    Half of a surrogate pair, which has no code, is written as Python escapes it.

    >>> text_bytes("é \ud800")
    b'\xc3\xa9 \\ud800'
    """
    return text.encode("utf-8", "backslashreplace")


def csv_bytes(frame: Any, **options: Any) -> bytes:
    """Write a DataFrame as CSV in which no text is a formula.

    A text that a spreadsheet would read as a formula begins with an apostrophe [1].

    [1] OWASP, CSV Injection.
    """
    defused = frame.map(_defuse)
    defused.columns = [_defuse(label) for label in frame.columns]
    text: str = defused.to_csv(index=False, **options)
    return text_bytes(text)


def _defuse(value: object) -> Any:
    """Put an apostrophe before a text that a spreadsheet would read as a formula."""
    if not isinstance(value, str):
        return value
    # to_csv does not quote a bare carriage return, which ends the line
    text = "\n".join(value.splitlines()) if "\r" in value else value
    return f"'{text}" if FORMULA.match(text) else text


def digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Compute a digest of the names, types, shapes and bytes of arrays in any order."""
    whole = hashlib.blake2b(digest_size=16)
    for name, array in sorted(arrays.items()):
        values: Any = np.ascontiguousarray(array)
        content = hashlib.blake2b(values, digest_size=16).hexdigest()
        whole.update(repr((name, array.dtype.str, array.shape, content)).encode())
    return whole.hexdigest()


def save_npz(
    path: str | os.PathLike[str], kind: str, arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write an npz of plain arrays with their kind of object and their digest.

    A zip file protects the contents of its members, but not their names: a damaged file
    may
    lack some of them, which the digest shows. Arrays of objects are an ArgumentError.
    """
    for name, array in arrays.items():
        # numpy 2.0 would write it as a pickle, and has no switch against that
        if array.dtype.hasobject:
            raise ArgumentError(
                name, "must be numbers or text; it is an array of objects"
            )
    with whole_file(path, (".npz",)) as handle:
        stored = {KIND: np.array(kind), **arrays}
        stored[DIGEST] = np.array(digest(stored))
        # this writes what np.savez_compressed writes; some releases of numpy leave the
        # archive open where a disk is full
        with zipfile.ZipFile(handle, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in stored.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)


def load_npz(
    path: str | os.PathLike[str], kind: str, *, hint: str = ""
) -> dict[str, NDArray[Any]]:
    """Read the arrays of an npz that holds a ``kind``.

    The error for a file of another kind says what it holds, and ends with ``hint``.
    """
    arrays = read_npz(path)
    stored = npz_kind(arrays)
    if stored != kind:
        holds = (
            f"a {KINDS.get(stored, stored)}"
            if stored
            else f"the arrays {_checks.show(', '.join(arrays))}"
        )
        raise ArgumentError(
            f"{os.fspath(path)!r}",
            f"must hold a {KINDS[kind]}; it holds"
            f" {holds}{(f' ({hint})' if hint else '')}",
        )
    return arrays


@contextmanager
def parts_of(path: str | os.PathLike[str], what: str) -> Iterator[None]:
    """Let errors in what is made of a file's arrays name the file."""
    try:
        yield
    except KeyError as error:
        raise ArgumentError(
            f"{os.fspath(path)!r}",
            f"must hold every part of {what}; {error} is missing",
        ) from None
    except ArgumentError as error:
        place = f"{os.fspath(path)!r}: {error.argument}"
        raise ArgumentError(place, error.rule) from None
    except (IndexError, OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"{os.fspath(path)!r}: {error}") from None


def read_npz(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read every array of an npz or npy file; refuse pickles and changed files of ours.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    dict of str to ndarray
        The arrays by name; that of an npy file is called "array".

    Raises
    ------
    ValueError
        If it is no such file, or a file of ours that was damaged or edited.
    FileNotFoundError
        If there is no file.
    MemoryError
        If the arrays do not fit into memory; the text says how much they need.
    """
    name = local(path)
    with open_regular(name) as handle, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a broken header may be strange Python
        try:
            if handle.read(4) in _ZIP:
                arrays = _read_members(handle, name)
            else:
                handle.seek(0)
                size = os.fstat(handle.fileno()).st_size
                needed = _check_npy_header(handle, size)
                _checks.require_memory(needed, repr(name), size=1)
                handle.seek(0)
                arrays = {"array": np.lib.format.read_array(handle, allow_pickle=False)}
        except Exception as error:
            # zipfile, zlib, ast and numpy raise many classes on bytes that are not
            # theirs
            if isinstance(error, MemoryError) and repr(name) in str(error):
                raise
            words = _checks.escape_controls(str(error) or type(error).__name__)
            raise ArgumentError(
                f"{name!r}", f"must be an npz or npy file of plain arrays; {words:.300}"
            ) from None
    saved = arrays.pop(DIGEST, None)
    if (KIND in arrays or saved is not None) and str(saved) != digest(arrays):
        raise ArgumentError(
            f"{name!r}",
            "must hold the arrays that were saved in it; it is damaged, or was edited",
        )
    return arrays


def read_array(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read the array of an npy file; an ArgumentError names what another file holds."""
    arrays = read_npz(path)
    if "array" not in arrays:
        raise ArgumentError(
            repr(os.fspath(path)),
            "must hold one array, as numpy.save writes it; it holds"
            f" {', '.join(arrays)}",
        )
    return arrays["array"]


def _read_members(handle: IO[bytes], name: str) -> dict[str, NDArray[Any]]:
    """Read the arrays of an npz, each of which has the size that its header tells.

    Sizes are compared before anything is unpacked.
    """
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(handle) as archive:
        members = archive.infolist()
        total = sum(member.file_size for member in members)
        for member in members:
            with archive.open(member) as file:
                needed = _check_npy_header(file, member.file_size)
            if needed != member.file_size:
                raise ValueError(
                    f"{member.filename!r} has {member.file_size} bytes, where its"
                    f" header needs {needed}"
                )
        _checks.require_memory(total, repr(name), size=1)
        for member in members:
            label = member.filename.removesuffix(".npy")
            if label in arrays:
                raise ValueError(f"it holds {label!r} twice")
            with archive.open(member) as file:
                arrays[label] = np.lib.format.read_array(file, allow_pickle=False)
                file.read(1)  # the end of the file, where zipfile compares the CRC
    return arrays


def _check_npy_header(file: IO[bytes], size: int) -> int:
    """Return how many bytes an npy takes by its header; raise a ValueError for others.

    ``size``: how many there are.
    """
    version = np.lib.format.read_magic(file)
    length = int.from_bytes(file.read(2 if version == (1, 0) else 4), "little")
    if length > MAX_HEADER_BYTES:
        raise ValueError(f"its header has {length} bytes")
    start = file.tell()
    file.seek(0)
    np.lib.format.read_magic(file)
    read: Any = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read = np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file, max_header_size=MAX_HEADER_BYTES)
    if dtype.hasobject:
        raise ValueError("it holds an array of objects, which would be a pickle")
    needed: int = start + length + math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or needed > size:
        raise ValueError(f"it has {size} bytes, where its header needs {needed}")
    return needed


def npz_kind(arrays: Mapping[str, NDArray[Any]]) -> str | None:
    """Return the kind that ``save_npz`` wrote with the arrays, None for other files."""
    return str(arrays[KIND]) if KIND in arrays else None


def kind_of(path: str | os.PathLike[str]) -> str | None:
    """Return the kind that ``save_npz`` wrote into a file, None for other files.

    Only this one array is read.
    """
    name = local(path)
    if Path(name).suffix.lower() != ".npz" or not os.path.isfile(name):
        return None
    # whoever reads all of the file reports what is wrong with it
    with (
        contextlib.suppress(Exception),
        open_regular(name) as handle,
        zipfile.ZipFile(handle) as archive,
        archive.open(f"{KIND}.npy") as file,
    ):
        size = archive.getinfo(f"{KIND}.npy").file_size
        if size <= MAX_HEADER_BYTES and _check_npy_header(file, size) == size:
            file.seek(0)
            return str(np.lib.format.read_array(file, allow_pickle=False))
    return None
