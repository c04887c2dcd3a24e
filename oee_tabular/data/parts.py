"""The files of a log that is larger than memory: which they are, their columns, and by what they are known again.

Sources: Apache Parquet; Apache Hive's folders ``column=value``.
"""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from oee_tabular import _checks, _files
from oee_tabular.data.files import COLUMNS, MOVE, TABLES, Format
from oee_tabular.data.tables import csv_header, require_columns, require_module, warn_left_out

Paths: TypeAlias = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]  # a file, a folder, a pattern, or several
ENDINGS = (*TABLES, ".npz")
_ENDS = 2**20  # bytes at either end of a file by which it is known again
_READ = 2**20  # bytes of a column that are read at once; without a buffer pyarrow holds all that it has read
FLAGS = ("terminated", "truncated")
NUMBERS = ("reward", "behavior_probability")
NAMES = " (names take a simulator that has them: simulator=, --simulator)"


@dataclass(frozen=True)
class Part:
    """A file: its path, how errors call it, its columns, and those that folders name, ``column=value``."""

    path: str
    name: str
    columns: tuple[str, ...] = ()
    fixed: tuple[tuple[str, str], ...] = ()

    @property
    def known(self) -> frozenset[str]:
        """A log's columns that it has, its own or its folders'."""
        return frozenset((*self.columns, *(label for label, _ in self.fixed))) & frozenset(COLUMNS)


def found(path: Paths, named: Collection[str] = ()) -> list[Part]:
    """The files that a path, a folder, a pattern or a list of them names, in the order of their names.

    ``named``: columns that may hold texts, names.
    Files and folders that begin with a dot or an underscore are left out, as writers of folders mean them.
    """
    given = [path] if isinstance(path, str | os.PathLike) else list(_checks.collection(path, "path", "paths of files"))
    parts = [part for one in given for part in _parts_at(_files.local(one))]
    again = {part.path for k, part in enumerate(parts) if part.path in {other.path for other in parts[:k]}}
    if again or not parts:
        raise ValueError(
            f"path must name each file once; {sorted(again)[0]!r} is named twice" if again else "path must name files"
        )
    return _of_one_schema([_with_header(part, named) for part in parts])


def _parts_at(name: str) -> list[Part]:
    """The files of a folder, a file, or those that a pattern names."""
    place = Path(name)
    if place.is_dir():
        inside = [file for file in sorted(place.rglob("*")) if _meant(file.relative_to(place)) and file.is_file()]
        if not inside:
            raise ValueError(f"path must hold files in {', '.join(ENDINGS)}; the folder {name!r} has none")
        return [Part(str(file), str(file), (), _fixed(file.relative_to(place))) for file in inside]
    if place.is_file():
        _require_ending(name)
        return [Part(name, name)]
    some = [file for file in sorted(glob.glob(name, recursive=True)) if Path(file).is_file()]
    if not glob.has_magic(name) or not some:
        raise FileNotFoundError(2, "no such file", name)
    for file in some:
        _require_ending(file)
    return [Part(file, file, (), _fixed(Path(file))) for file in some]


def _require_ending(name: str) -> None:
    if Path(name).suffix.lower() not in ENDINGS:
        raise ValueError(f"path must end in {', '.join(ENDINGS)}, or be a folder; it is {name!r}")


def _meant(path: Path) -> bool:
    hidden = any(step.startswith((".", "_")) for step in path.parts)
    return not hidden and path.suffix.lower() in ENDINGS


def _fixed(path: Path) -> tuple[tuple[str, str], ...]:
    """Columns that folders name, as Hive does."""
    steps = (step.partition("=") for step in path.parts[:-1])
    return tuple((label, value) for label, equals, value in steps if equals and label in COLUMNS)


def _with_header(part: Part, named: Collection[str]) -> Part:
    """With the names of the file's columns; errors name the file and the column."""
    suffix = Path(part.path).suffix.lower()
    if suffix == ".parquet":
        with as_parquet(part) as file:
            schema = file.schema_arrow
        labels = [str(label) for label in schema.names]
        for label in COLUMNS:
            if label in labels:
                _require_kind(part, label, schema.field(labels.index(label)).type, label in named)
    elif suffix == ".csv":
        try:
            labels = csv_header(part.path)
        except (UnicodeDecodeError, ValueError) as error:
            raise ValueError(f"{part.name!r} must be a CSV table with a header; {error}") from None
    else:
        labels = [label for label in _files.load_npz(part.path, Format.kind) if label != _files.KIND]
    again = sorted({label for label in labels if label in COLUMNS and labels.count(label) > 1})
    if again:
        raise ValueError(f"{part.name!r} must have columns that differ; it has {again[0]!r} twice")
    fixed = tuple((label, value) for label, value in part.fixed if label not in labels)
    require_columns(repr(part.name), Format.required, [*labels, *(label for label, _ in fixed)], way=Format.way)
    return Part(part.path, part.name, tuple(labels), fixed)


def _require_kind(part: Part, label: str, kind: object, named: bool) -> None:
    import pyarrow as pa

    held = getattr(kind, "value_type", kind)  # of a column that is written as a dictionary
    texts = pa.types.is_string(held) or pa.types.is_large_string(held)
    worded = label in MOVE and texts
    if (worded and named) or (label == "episode" and texts):
        return
    fits = pa.types.is_integer(kind) or pa.types.is_floating(kind) or (label in FLAGS and pa.types.is_boolean(kind))
    if not fits:
        rule = "booleans" if label in FLAGS else "numbers" if label in NUMBERS else "integers"
        hint = NAMES * worded
        raise ValueError(f"column {label!r} of {part.name!r} must hold {rule}; it holds {kind}{hint}")


def _of_one_schema(parts: list[Part]) -> list[Part]:
    """All have the same of a log's columns."""
    first = parts[0]
    for part in parts[1:]:
        differ = sorted(first.known ^ part.known)
        if differ:
            has, lacks = (first, part) if differ[0] in first.known else (part, first)
            raise ValueError(
                f"all files must have the same columns; {has.name!r} has {differ[0]!r}, and {lacks.name!r} does not"
            )
    unknown = [label for label in first.columns if label not in COLUMNS]
    warn_left_out(first.name, unknown, COLUMNS, level=4)
    return parts


def fingerprint(part: Part) -> str:
    """By what a file is known again: its size, and a digest of its first and last MiB."""
    size = os.path.getsize(part.path)
    digest = hashlib.sha256(str(size).encode())
    with open(part.path, "rb") as handle:
        digest.update(handle.read(_ENDS))
        handle.seek(max(size - _ENDS, 0))
        digest.update(handle.read(_ENDS))
    return digest.hexdigest()


class as_parquet:
    """An open parquet file; whatever pyarrow makes of bytes that are not parquet's is a ValueError that names the file."""

    def __init__(self, part: Part) -> None:
        require_module("pyarrow", "parquet")
        self.part = part

    def __enter__(self) -> Any:
        from pyarrow import parquet

        self.handle = open(self.part.path, "rb")
        try:
            return parquet.ParquetFile(self.handle, pre_buffer=False, buffer_size=_READ)
        except Exception as error:
            self.handle.close()
            raise unreadable(self.part, error) from None

    def __exit__(self, *_: object) -> None:
        self.handle.close()


def unreadable(part: Part, error: Exception) -> Exception:
    """What is raised for an error of pyarrow's: it names the file."""
    if isinstance(error, MemoryError):
        return error
    kind = Path(part.path).suffix.lower().removeprefix(".")
    return ValueError(f"{part.name!r} must be a {kind} table; {str(error) or type(error).__name__:.300}")


def plain_name(part: Part, parts: Sequence[Part]) -> str:
    """A part's path below what all have in common: the same wherever a folder stands."""
    common = os.path.commonpath([os.path.dirname(os.path.abspath(one.path)) for one in parts])
    return re.sub(r"[\\/]+", "/", os.path.relpath(os.path.abspath(part.path), common))
