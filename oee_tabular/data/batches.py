"""The rows of a log's files in batches: parquet, CSV (RFC 4180) and npz as arrays of what they hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular._checks import Column
from oee_tabular.data.columns import Log
from oee_tabular.data.files import COLUMNS
from oee_tabular.data.parts import FLAGS, NUMBERS, Part, as_parquet, unreadable
from oee_tabular.data.tables import require_module
from oee_tabular.data.transitions import Transitions

BATCH = 2**17  # rows
_BLOCK = 2**23  # bytes of a CSV file


class Batch(NamedTuple):
    """Rows of a file as arrays of what they hold, a column each; ``row``: their numbers in the file, from 0.

    ``missing`` masks the rows without a value, of columns that have such; ``lost``: rows, by number, that are none of the
    table, with what is wrong.
    """

    columns: dict[str, Column]
    missing: dict[str, NDArray[np.bool_]]
    row: NDArray[np.int64]
    lost: list[tuple[int, str]]


def batches(part: Part) -> Iterator[Batch]:
    """The rows of a file, of a log's columns, some 10^5 at a time."""
    read = {".parquet": _parquet_batches, ".csv": _csv_batches, ".npz": _npz_batches}[Path(part.path).suffix.lower()]
    for batch in read(part):
        fixed = {label: np.full(len(batch.row), _plain(value)) for label, value in part.fixed}
        yield batch._replace(columns=batch.columns | fixed)


def _plain(value: str) -> int | str:
    """A folder's value, as a number where it is a whole one."""
    return int(value) if re.fullmatch(r"-?\d{1,18}", value) else value


def _parquet_batches(part: Part) -> Iterator[Batch]:
    first = 0
    with as_parquet(part) as file:
        stream = file.iter_batches(BATCH, columns=[c for c in part.columns if c in COLUMNS], use_threads=False)
        while True:
            try:
                table = next(stream, None)
            except Exception as error:
                raise unreadable(part, error) from None
            if table is None:
                return
            yield _batch(table, np.arange(first, first + table.num_rows), [])
            first += table.num_rows


def _batch(table: Any, row: NDArray[np.int64], lost: list[tuple[int, str]]) -> Batch:
    """A table of Arrow's as arrays; what is not there is masked."""
    import pyarrow as pa

    columns, missing = {}, {}
    for label, column in zip(table.schema.names, table.columns, strict=True):
        if pa.types.is_dictionary(column.type):
            column = column.dictionary_decode()
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
        for block in stream:
            yield _batch(block, table.numbers(first, block.num_rows), table.new())
            first += block.num_rows
        if table.told < len(table.lost):
            nothing = pa.RecordBatch.from_pydict({label: pa.array([], pa.string()) for label in labels})
            yield _batch(nothing, np.zeros(0, dtype=np.int64), table.new())
    except (pa.ArrowException, UnicodeDecodeError, ValueError) as error:
        if typed and "conversion error" in str(error):
            raise _Mistyped from None
        raise unreadable(part, error) from None


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
