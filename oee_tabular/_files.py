"""Files are written whole or not at all; npz files are never pickles."""

from __future__ import annotations

import os
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

KIND = "oee_tabular_kind"


@contextmanager
def whole_file(path: str | os.PathLike[str], suffixes: tuple[str, ...] = ()) -> Iterator[IO[bytes]]:
    """A binary file to write, which appears under its name only once it is complete.

    The bytes go to a temporary file in the same folder, are flushed to disk and moved over ``path`` in one step; an
    error on the way leaves what stood there before.
    """
    target = Path(path)
    if suffixes and target.suffix.lower() not in suffixes:
        raise ValueError(f"path must end in {' or '.join(suffixes)}; it is {str(target)!r}")
    if not target.parent.is_dir():
        raise FileNotFoundError(2, "no such folder", str(target.parent))
    temporary = target.with_name(f".{target.name}.{uuid.uuid4().hex}.part")
    try:
        try:
            temporary.touch(exist_ok=False)
        except OSError as error:
            raise OSError(error.errno, f"cannot be written ({error.strerror})", str(target)) from None
        with open(temporary, "wb") as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_all(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write every file of ``contents`` into ``folder``, or none of them; what they replace stays until all are ready."""
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    staged: list[tuple[Path, Path]] = []
    try:
        for name, data in contents.items():
            temporary = folder / f".{name}.{uuid.uuid4().hex}.part"
            staged.append((temporary, folder / name))
            temporary.write_bytes(data)
        for temporary, target in staged:
            os.replace(temporary, target)
    except BaseException:
        for temporary, _ in staged:
            temporary.unlink(missing_ok=True)
        if made:
            folder.rmdir()
        raise


def save_npz(path: str | os.PathLike[str], kind: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """An npz of plain arrays, marked with the kind of object that they make; ValueError for arrays of objects."""
    for name, array in arrays.items():
        if array.dtype.hasobject:  # it would be a pickle, which numpy 2.0 cannot be told not to write
            raise ValueError(f"{name} must be numbers or text; it is an array of objects")
    with whole_file(path, (".npz",)) as handle:
        np.savez_compressed(handle, **{KIND: np.array(kind), **arrays})  # type: ignore[arg-type]


def load_npz(path: str | os.PathLike[str], kind: str, *, hint: str = "") -> dict[str, NDArray[Any]]:
    """The arrays of an npz that holds a ``kind``; a ValueError that says what it holds otherwise."""
    arrays = read_npz(path)
    found = npz_kind(arrays)
    if found != kind:
        raise ValueError(
            f"{str(path)!r} must hold a {kind}; it holds {found or 'the arrays ' + ', '.join(arrays)}"
            f"{f' ({hint})' if hint else ''}"
        )
    return arrays


def read_npz(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Every array of an npz or npy file (the npy's under the name "array"); pickles are refused."""
    try:
        with open(path, "rb") as handle:
            loaded = np.load(handle, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                return {"array": loaded}
            with loaded:
                return {name: loaded[name] for name in loaded.files}
    except (zipfile.BadZipFile, ValueError, EOFError) as error:
        raise ValueError(f"{str(path)!r} must be an npz or npy file of plain arrays; {error}") from None


def npz_kind(arrays: Mapping[str, NDArray[Any]]) -> str | None:
    """What ``save_npz`` said the arrays are, None for other files."""
    return str(arrays[KIND]) if KIND in arrays else None


def render(write: Callable[[IO[bytes]], object]) -> bytes:
    """What ``write`` puts into a binary file, as bytes."""
    import io

    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()
