"""The files of a log that is larger than memory, and their rows in batches.

Sources: Apache Parquet; Apache Hive's folders ``column=value``; RFC 4180 for CSV.
"""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _files
from oee_tabular.data.columns import Log
from oee_tabular.data.files import COLUMNS, TABLES, Format
from oee_tabular.data.tables import csv_header, require_columns, require_module, warn_left_out
from oee_tabular.data.transitions import Transitions

ENDINGS = (*TABLES, ".npz")
BATCH = 2**17  # rows
_BLOCK = 2**23  # bytes of a CSV file
_ENDS = 2**20  # bytes at either end of a file by which it is known again
FLAGS = ("terminated", "truncated")
NUMBERS = ("reward", "behavior_probability")


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


class Batch(NamedTuple):
    """Rows of a file as arrays of what they hold, a column each; ``row``: their numbers in the file, from 0.

    ``missing`` masks the rows without a value, of columns that have such; ``lost``: rows, by number, that are none of the
    table, with what is wrong.
    """

    columns: dict[str, NDArray[Any]]
    missing: dict[str, NDArray[np.bool_]]
    row: NDArray[np.int64]
    lost: list[tuple[int, str]]


def found(path: Any) -> list[Part]:
    """The files that a path, a folder, a pattern or a list of them names, in the order of their names.

    Files and folders that begin with a dot or an underscore are left out, as writers of folders mean them.
    """
    given = [path] if isinstance(path, str | os.PathLike) else list(_checks.collection(path, "path", "paths of files"))
    parts: list[Part] = []
    for one in given:
        name = _files.local(one)
        place = Path(name)
        if place.is_dir():
            inside = [file for file in sorted(place.rglob("*")) if _meant(file.relative_to(place)) and file.is_file()]
            parts += [Part(str(file), str(file), (), _fixed(file.relative_to(place))) for file in inside]
            if not inside:
                raise ValueError(f"path must hold files in {', '.join(ENDINGS)}; the folder {name!r} has none")
        elif place.is_file():
            _require_ending(name)
            parts.append(Part(name, name))
        elif glob.has_magic(name):
            some = [file for file in sorted(glob.glob(name, recursive=True)) if Path(file).is_file()]
            if not some:
                raise FileNotFoundError(2, "no such file", name)
            for file in some:
                _require_ending(file)
            parts += [Part(file, file, (), _fixed(Path(file))) for file in some]
        else:
            raise FileNotFoundError(2, "no such file", name)
    again = {part.path for k, part in enumerate(parts) if part.path in {other.path for other in parts[:k]}}
    if again or not parts:
        raise ValueError(
            f"path must name each file once; {sorted(again)[0]!r} is named twice" if again else "path must name files"
        )
    return _of_one_schema([_with_header(part) for part in parts])


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


def _with_header(part: Part) -> Part:
    """With the names of the file's columns; errors name the file and the column."""
    suffix = Path(part.path).suffix.lower()
    if suffix == ".parquet":
        with _as_parquet(part) as file:
            schema = file.schema_arrow
        labels = [str(label) for label in schema.names]
        for label in COLUMNS:
            if label in labels:
                _require_kind(part, label, schema.field(labels.index(label)).type)
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
    require_columns(part.name, Format.required, [*labels, *(label for label, _ in fixed)])
    return Part(part.path, part.name, tuple(labels), fixed)


def _require_kind(part: Part, label: str, kind: Any) -> None:
    import pyarrow as pa

    fits = pa.types.is_integer(kind) or pa.types.is_floating(kind) or (label in FLAGS and pa.types.is_boolean(kind))
    if not fits:
        rule = "booleans" if label in FLAGS else "numbers" if label in NUMBERS else "integers"
        raise ValueError(f"column {label!r} of {part.name!r} must hold {rule}; it holds {kind}")


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


def batches(part: Part) -> Iterator[Batch]:
    """The rows of a file, of a log's columns, some 10^5 at a time."""
    read = {".parquet": _parquet_batches, ".csv": _csv_batches, ".npz": _npz_batches}[Path(part.path).suffix.lower()]
    for batch in read(part):
        fixed = {label: np.full(len(batch.row), _plain(value)) for label, value in part.fixed}
        yield batch._replace(columns=batch.columns | fixed)


def _plain(value: str) -> int | str:
    """A folder's value, as a number where it is a whole one."""
    return int(value) if re.fullmatch(r"-?\d{1,18}", value) else value


class _as_parquet:
    """An open parquet file; whatever pyarrow makes of bytes that are not parquet's is a ValueError that names the file."""

    def __init__(self, part: Part) -> None:
        require_module("pyarrow", "parquet")
        self.part = part

    def __enter__(self) -> Any:
        from pyarrow import parquet

        self.handle = open(self.part.path, "rb")
        try:
            return parquet.ParquetFile(self.handle)
        except Exception as error:
            self.handle.close()
            raise _unreadable(self.part, error) from None

    def __exit__(self, *_: object) -> None:
        self.handle.close()


def _unreadable(part: Part, error: Exception) -> Exception:
    if isinstance(error, MemoryError):
        return error
    kind = Path(part.path).suffix.lower().removeprefix(".")
    return ValueError(f"{part.name!r} must be a {kind} table; {str(error) or type(error).__name__:.300}")


def _parquet_batches(part: Part) -> Iterator[Batch]:
    first = 0
    with _as_parquet(part) as file:
        stream = file.iter_batches(BATCH, columns=[c for c in part.columns if c in COLUMNS], use_threads=False)
        while True:
            try:
                table = next(stream, None)
            except Exception as error:
                raise _unreadable(part, error) from None
            if table is None:
                return
            yield _batch(table, np.arange(first, first + table.num_rows), [])
            first += table.num_rows


def _batch(table: Any, row: NDArray[np.int64], lost: list[tuple[int, str]]) -> Batch:
    """A table of Arrow's as arrays; what is not there is masked."""
    import pyarrow as pa

    columns, missing = {}, {}
    for label, column in zip(table.schema.names, table.columns, strict=True):
        if column.null_count:
            missing[str(label)] = column.is_null().to_numpy(zero_copy_only=False)
            column = column.fill_null(False if pa.types.is_boolean(column.type) else pa.scalar(0).cast(column.type))
        columns[str(label)] = column.to_numpy(zero_copy_only=False)
    return Batch(columns, missing, row, lost)


@dataclass
class _Table:
    """A CSV file's rows that are none of its table, and how many there were before."""

    lost: list[tuple[int, str]] = field(default_factory=list)
    told: int = 0

    def heed(self, row: Any) -> str:
        """Of pyarrow: a row with more or fewer fields than the header; the header is its row 1."""
        self.lost.append(
            (row.number - 2, f"must have {row.expected_columns} fields, as the header has; it has {row.actual_columns}")
        )
        return "skip"

    def numbers(self, first: int, n: int) -> NDArray[np.int64]:
        """Of the n accepted rows from the ``first`` on, their numbers in the file."""
        at = np.array([row for row, _ in self.lost], dtype=np.int64)
        accepted = np.arange(first, first + n)
        return accepted + np.searchsorted(at - np.arange(len(at)), accepted, side="right")

    def new(self) -> list[tuple[int, str]]:
        """Those that were not told yet."""
        self.told, before = len(self.lost), self.told
        return self.lost[before:]


def _csv_batches(part: Part) -> Iterator[Batch]:
    """Columns of the types that a log has; from the first batch with other values on, as text."""
    done, told = 0, set()
    try:
        for batch in _typed_csv(part, typed=True):
            done += len(batch.row)
            told |= {row for row, _ in batch.lost}
            yield batch
    except _Mistyped:
        seen, lost = 0, []
        for batch in _typed_csv(part, typed=False):
            left = slice(max(done - seen, 0), None)
            seen += len(batch.row)
            lost += [one for one in batch.lost if one[0] not in told]
            if seen > done:
                columns = {label: column[left] for label, column in batch.columns.items()}
                missing = {label: mask[left] for label, mask in batch.missing.items()}
                yield Batch(columns, missing, batch.row[left], lost)
                lost = []


class _Mistyped(Exception):
    """A value is not of its column's type."""


def _typed_csv(part: Part, *, typed: bool) -> Iterator[Batch]:
    require_module("pyarrow", "parquet")
    import pyarrow as pa
    from pyarrow import csv

    table, labels = _Table(), [label for label in part.columns if label in COLUMNS]
    kinds = {label: pa.bool_() for label in FLAGS} | {label: pa.float64() for label in NUMBERS}
    first = 0
    try:
        stream = csv.open_csv(
            part.path,
            read_options=csv.ReadOptions(use_threads=False, block_size=_BLOCK),
            parse_options=csv.ParseOptions(invalid_row_handler=table.heed),
            convert_options=csv.ConvertOptions(
                include_columns=labels,
                column_types={label: kinds.get(label, pa.int64()) if typed else pa.string() for label in labels},
                null_values=[""],
                strings_can_be_null=True,
                true_values=["true", "True", "TRUE", "1", "1.0"],
                false_values=["false", "False", "FALSE", "0", "0.0"],
            ),
        )
        while (block := _next(stream)) is not None:
            yield _batch(block, table.numbers(first, block.num_rows), table.new())
            first += block.num_rows
        if table.told < len(table.lost):
            yield _batch(block_of(labels), np.zeros(0, dtype=np.int64), table.new())
    except (pa.ArrowException, UnicodeDecodeError, ValueError) as error:
        if typed and "conversion error" in str(error):
            raise _Mistyped from None
        raise _unreadable(part, error) from None


def _next(stream: Any) -> Any:
    try:
        return stream.read_next_batch()
    except StopIteration:
        return None


def block_of(labels: Sequence[str]) -> Any:
    """A table of no rows."""
    import pyarrow as pa

    return pa.RecordBatch.from_pydict({label: pa.array([], pa.string()) for label in labels})


def _npz_batches(part: Part) -> Iterator[Batch]:
    log: Log = Transitions.load(part.path)
    columns = log.columns()
    for first in range(0, len(log), BATCH):
        rows = slice(first, first + BATCH)
        yield Batch(
            {label: column[rows] for label, column in columns.items() if label in part.columns},
            {},
            np.arange(first, min(first + BATCH, len(log))),
            [],
        )


def plain_name(part: Part, parts: Sequence[Part]) -> str:
    """A part's path below what all have in common: the same wherever a folder stands."""
    common = os.path.commonpath([os.path.dirname(os.path.abspath(one.path)) for one in parts])
    return re.sub(r"[\\/]+", "/", os.path.relpath(os.path.abspath(part.path), common))
