"""Files are written whole or not at all, and read from this machine only; npz files are
never pickles.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import tempfile
import uuid
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError

KIND = "oee_tabular_kind"
DIGEST = "oee_tabular_digest"
KINDS = {
    "finite_mdp": "FiniteMDP",
    "transitions": "log of numbered states (Transitions)",
    "transition_counts": "counted log (TransitionCounts)",
    "continuous_transitions": "log of continuous states (ContinuousTransitions)",
}
# a spreadsheet takes a cell that begins with one of these for a formula
FORMULA = re.compile(r"[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]")
LONGEST_PATH = 1000  # characters; systems allow 255 to 4096, and errors repeat it
_ZIP = (b"PK\x03\x04", b"PK\x05\x06")


def local(path: str | os.PathLike[str], argument: str = "path") -> str:
    """``path`` as text; ValueError for an address of another machine, which is never
    opened (``argument``: its name).
    """
    if not isinstance(path, str | os.PathLike):
        raise ArgumentError(
            argument, f"must be a path of a file; got {type(path).__name__}"
        )
    name = os.fspath(path)
    if not isinstance(name, str) or "\0" in name or not name:
        raise ArgumentError(
            argument,
            "must be text, not empty and without a null character; got"
            f" {_checks.show(name)}",
        )
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
    if re.match(r"(?!minari:)[A-Za-z][A-Za-z0-9+.-]+:/", name) and not os.path.exists(
        name
    ):  # pathlib makes one slash of two
        raise ArgumentError(
            argument,
            f"must be a file of this machine; {name!r} is an address, and nothing is"
            " fetched",
        )
    return name


def new_file(path: str | os.PathLike[str], name: str, *, overwrite: bool) -> None:
    """ValueError where something stands at ``path`` that may not be lost; OSError where
    no file can be written there.
    """
    local(path)
    if not overwrite and os.path.lexists(path):
        raise ArgumentError(
            name,
            f"must be a new file, or be given with --overwrite; {os.fspath(path)!r}"
            " exists already",
        )
    folder = Path(os.path.realpath(path)).parent
    # else whoever writes it makes the folder, or says that there is none
    if Path(path).suffix and folder.is_dir():
        try:
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise OSError(
                error.errno, f"cannot be written ({error.strerror})", os.fspath(path)
            ) from None


@contextmanager
def whole_file(
    path: str | os.PathLike[str], suffixes: tuple[str, ...] = ()
) -> Iterator[IO[bytes]]:
    """A binary file to write, which appears under its name only once it is complete.

    The bytes go to a temporary file in the same folder, are flushed to disk and moved
    over ``path`` in one step; an error on the way leaves what stood there before, and
    names ``path``. A link stays one: the file that it leads to is replaced.
    """
    if suffixes and Path(local(path)).suffix.lower() not in suffixes:
        raise ArgumentError(
            "path", f"must end in {' or '.join(suffixes)}; it is {os.fspath(path)!r}"
        )
    target = Path(os.path.realpath(local(path)))
    if target.is_dir():
        raise IsADirectoryError(
            errno.EISDIR, "must be a file; it is a folder", os.fspath(path)
        )
    if target.is_symlink() or (target.exists() and not target.is_file()):
        raise OSError(
            errno.EINVAL,
            "must be a file; it is something else (a loop of links, a device)",
            os.fspath(path),
        )
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "no such folder", str(target.parent))
    temporary = target.with_name(f".{target.name:.80}.{uuid.uuid4().hex}.part")
    try:
        with open(temporary, "xb") as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, target)
    except OSError as error:
        if error.errno is None or error.filename not in (
            None,
            str(temporary),
            temporary,
        ):
            raise
        raise OSError(
            error.errno, f"cannot be written ({error.strerror})", os.fspath(path)
        ) from None
    finally:
        # a read-only disk says so of what is not there, too
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_all(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write every file of ``contents`` into ``folder``, or none of them; what they
    replace stays until all are ready.
    """
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with ExitStack() as stack:
            for name, data in contents.items():
                handle = stack.enter_context(whole_file(folder / name))
                handle.write(data)
                handle.flush()
                # a disk is full here, before the first file has its name
                os.fsync(handle.fileno())
    except BaseException:
        if made:
            folder.rmdir()
        raise


def csv_bytes(frame: Any, **options: Any) -> bytes:
    """A DataFrame as CSV, in which a text that a spreadsheet would take for a formula
    begins with an apostrophe [1].

    [1] OWASP, CSV Injection.
    """
    defused = frame.map(_defuse)
    defused.columns = [_defuse(label) for label in frame.columns]
    text: str = defused.to_csv(index=False, **options)
    return text.encode()


def _defuse(value: object) -> Any:
    if not isinstance(value, str):
        return value
    # a bare one ends the line, and is not quoted
    text = "\n".join(value.splitlines()) if "\r" in value else value
    return f"'{text}" if FORMULA.match(text) else text


def digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """A digest over the names, types, shapes and bytes of arrays, whatever their order."""
    whole = hashlib.blake2b(digest_size=16)
    for name, array in sorted(arrays.items()):
        values: Any = np.ascontiguousarray(array)
        content = hashlib.blake2b(values, digest_size=16).hexdigest()
        whole.update(repr((name, array.dtype.str, array.shape, content)).encode())
    return whole.hexdigest()


def save_npz(
    path: str | os.PathLike[str], kind: str, arrays: Mapping[str, NDArray[Any]]
) -> None:
    """An npz of plain arrays with their kind of object and their digest; ValueError for
    arrays of objects.

    A zip file protects what its members hold, not their names: one that is damaged may
    lack some of them.
    """
    for name, array in arrays.items():
        # it would be a pickle, which numpy 2.0 cannot be told not to write
        if array.dtype.hasobject:
            raise ArgumentError(
                name, "must be numbers or text; it is an array of objects"
            )
    with whole_file(path, (".npz",)) as handle:
        stored = {KIND: np.array(kind), **arrays}
        stored[DIGEST] = np.array(digest(stored))
        # what np.savez_compressed writes; where a disk is full, some of its releases
        # leave their archive open
        with zipfile.ZipFile(handle, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in stored.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)


def load_npz(
    path: str | os.PathLike[str], kind: str, *, hint: str = ""
) -> dict[str, NDArray[Any]]:
    """The arrays of an npz that holds a ``kind``; a ValueError that says what it holds
    otherwise.
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
    """Errors in what is made of the arrays of a file name the file."""
    try:
        yield
    except KeyError as error:
        raise ArgumentError(
            f"{os.fspath(path)!r}",
            f"must hold every part of {what}; {error} is missing",
        ) from None
    except (IndexError, OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"{os.fspath(path)!r}: {error}") from None


def read_npz(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Every array of an npz or npy file (the npy's under the name "array"). No pickles,
    and no changed file of ours.

    Raises ValueError for what is no such file, FileNotFoundError, and MemoryError
    ("needs 14.9 GiB") where it does not fit.
    """
    name = local(path)
    with open(name, "rb") as handle, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a broken header may be strange Python
        try:
            is_zip = handle.read(4) in _ZIP
            members = zipfile.ZipFile(handle).infolist() if is_zip else []
            size = (
                sum(member.file_size for member in members)
                if is_zip
                else os.fstat(handle.fileno()).st_size
            )
            _checks.require_memory(size, repr(name), size=1)
            handle.seek(0)
            loaded = np.load(handle, allow_pickle=False)
            arrays = dict(loaded) if is_zip else {"array": loaded}
            if not all(isinstance(array, np.ndarray) for array in arrays.values()):
                raise ValueError("a member is no array")
        except Exception as error:
            # whatever zipfile, zlib, ast and numpy make of bytes that are not theirs
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


def npz_kind(arrays: Mapping[str, NDArray[Any]]) -> str | None:
    """What ``save_npz`` said the arrays are, None for other files."""
    return str(arrays[KIND]) if KIND in arrays else None


def kind_of(path: str | os.PathLike[str]) -> str | None:
    """What ``save_npz`` said that a file holds; None for other files. Reads that one
    name.
    """
    name = local(path)
    if Path(name).suffix.lower() != ".npz" or not os.path.isfile(name):
        return None
    with contextlib.suppress(Exception), open(name, "rb") as handle:
        return str(np.load(handle, allow_pickle=False)[KIND])
    return None  # what is wrong with it is said by who reads all of it
