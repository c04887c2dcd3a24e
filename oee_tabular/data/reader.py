"""CSV and parquet files of a log, read in pieces: the raw values of some thousand rows at a time, in the order of the file.

pandas reads CSV, in half of the time of DuckDB's reader (10^6 rows of 6 columns: 0.19 s of CPU, 0.34 s), and Python what is
small. DuckDB reads parquet in one thread, so that the same file gives the same bits; it may open that file alone and loads no
extension.
``rules.py`` says which values are those of a log.
"""

from __future__ import annotations

import csv
import gzip
import itertools
import os
import re
import warnings
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._checks import Column, IntArray
from oee_tabular.data.digests import check_digest, quote_text
from oee_tabular.data.labels import MOVE
from oee_tabular.data.rules import (
    HELD,
    KINDS,
    NAMES_HINT,
    check_column,
    check_names,
    count_others,
    holds_names,
    is_missing,
)
from oee_tabular.mdp.naming import is_number_text

N_PARQUET, N_CSV = 2**18, 2**17  # rows of a piece
SMALL = 2**21  # bytes of a CSV file, which Python reads in the time in which pandas is imported
MOST_COLUMNS = 10_000  # of a CSV table, which take 1 s to read


class LogFile(NamedTuple):
    """A file of a log, and the columns that its folders name, ``column=value``."""

    path: str
    fixed: tuple[tuple[str, str], ...] = ()

    @property
    def suffix(self) -> str:
        """.csv, .parquet or .npz; .csv of a compressed one."""
        path = Path(self.path.lower())
        return Path(path.stem).suffix if path.suffix == ".gz" else path.suffix


class Piece(NamedTuple):
    """Rows that follow each other: the raw values by label, and the numbers of the rows in the file."""

    columns: dict[str, Column]
    rows: IntArray


@dataclass
class Table:
    """A file as a table: ``labels``: of all its columns; ``known``: those of a log among them and in ``file.fixed``.

    ``lost``: the lines of a CSV file that have another number of fields than its header, in words, by the number of the row.
    """

    file: LogFile
    labels: list[str]
    is_known: Callable[[str], bool]
    encoding: str = "utf-8"
    texts: frozenset[str] = frozenset()  # columns of a CSV file whose first value is no number
    lost: dict[int, str] = field(default_factory=dict)

    @property
    def is_small(self) -> bool:
        """Whether Python reads a CSV file sooner than pandas is imported."""
        return os.path.getsize(self.file.path) < SMALL

    @property
    def known(self) -> list[str]:
        """The labels of the columns that are read."""
        fixed = (label for label, _ in self.file.fixed)
        return [label for label in dict.fromkeys([*self.labels, *fixed]) if self.is_known(label)]

    def pieces(self) -> Iterator[Piece]:
        """The rows of the file; errors of the libraries in this package's words."""
        read = (
            _read_parquet
            if self.file.suffix == ".parquet"
            else _read_texts
            if self.is_small or self.lost
            else _read_csv
        )
        fixed = {label: float(value) if is_number_text(value) else value for label, value in self.file.fixed}
        lost, rows = list(self.lost), np.arange(0)
        for columns in read(self, [label for label in self.known if label in self.labels]):
            n = len(next(iter(columns.values())))
            rows = (rows[-1] + 1 if len(rows) else 0) + np.arange(n + len(lost))
            rows = rows[~np.isin(rows, lost)][:n]
            yield Piece({label: np.full(n, fixed[label]) for label in self.known if label in fixed} | columns, rows)

    def require_type(self, label: str, raw: Column, *, allow_names: bool) -> None:
        """ValueError where the type of a column is none of a log's."""
        kind, is_csv = KINDS.get(label, "number"), self.file.suffix == ".csv"
        held, hint = str(raw.dtype), ""
        if raw.dtype.hasobject:
            first = next((item for item in raw.tolist() if not is_missing(item)), None)
            held = "texts" if isinstance(first, str) else type(first).__name__
            hint = NAMES_HINT if label in MOVE else ""
            is_allowed = (
                first is None or is_csv or (isinstance(first, str) and allow_names and not is_number_text(first))
            )
            is_allowed |= kind == "flag" and isinstance(first, bool)
        else:
            is_allowed = raw.dtype.kind in "iufU" or (raw.dtype.kind == "b" and (kind == "flag" or is_csv))
        if not is_allowed:
            raise ValueError(f"column {label!r} of {self.file.path!r} must hold {HELD[kind]}; it holds {held}{hint}")


def open_table(file: LogFile, is_known: Callable[[str], bool], *, drop: bool = False) -> Table:
    """The table in a file, its header read; ``drop``: whether to leave out lines of other lengths.

    Raises ValueError that names the file, for what is no table, or has a known column twice.
    """
    if file.suffix == ".parquet":
        check_digest(file.path)
        table = Table(file, _parquet_labels(file.path), is_known)
    else:
        labels, first, encoding = _csv_header(_files.local(file.path))
        if len(labels) > MOST_COLUMNS:
            raise ValueError(
                f"{file.path!r} must have at most {MOST_COLUMNS} columns; it has {len(labels)} (keep those that a log has)"
            )
        texts = frozenset(
            label for label, value in zip(labels, first, strict=False) if not is_number_text(value or "0")
        )
        table = Table(file, labels, is_known, encoding, texts)
        if table.is_small or _may_have_odd_lines(table):
            table.lost = _find_odd_lines(table)
        if table.lost and not drop:
            row, words = next(iter(table.lost.items()))
            raise ValueError(f"{file.path!r}: row {row} {words}")
    first_of: dict[str, str] = {}
    for label in table.labels:  # also for who does not tell capitals, as DuckDB does not
        lower = label.lower()
        if is_known(lower) and lower in first_of:
            twice = f"{label!r} twice" if first_of[lower] == label else f"{first_of[lower]!r} and {label!r}"
            raise ValueError(f"{file.path!r} must have columns that differ; it has {twice}")
        first_of.setdefault(lower, label)
    return table


def read_labels(path: str) -> list[str]:
    """The labels of a table's columns; ValueError for another file."""
    if path.lower().endswith(".parquet"):
        return _parquet_labels(path)
    return _csv_header(_files.local(path))[0]


def read_columns(
    file: LogFile, is_known: Callable[[str], bool], require: Callable[[Sequence[str]], None]
) -> tuple[dict[str, Column], list[str]]:
    """The known columns of a file, whole, and all its labels; ValueError for the first value that is none of a log's.

    ``require`` raises where the labels are those of no log. Names stay texts.
    """
    table = open_table(file, is_known)
    require(list(dict.fromkeys([*table.labels, *table.known])))
    if file.suffix == ".parquet":
        with open_duckdb(file.path) as run:
            n_rows = run("SELECT count(*) FROM read_parquet($path)").fetchone()[0]
        _checks.require_memory(n_rows * len(table.known), repr(file.path))
    pieces = list(table.pieces())
    columns = {}
    for label in table.known:
        raw = np.concatenate([piece.columns[label] for piece in pieces]) if pieces else np.zeros(0)
        table.require_type(label, raw, allow_names=label in (*MOVE, "episode"))
        holds_texts = raw.dtype.hasobject and label in (*MOVE, "episode") and holds_names(raw)
        columns[label], fault = check_names(raw, label) if holds_texts else check_column(label, raw)
        if fault is not None:
            raise ValueError(f"{file.path!r}: {fault.describe()}{count_others(fault)}")
    return columns, table.labels


# ---- parquet


@contextmanager
def open_duckdb(path: str) -> Iterator[Callable[[str], Any]]:
    """``run(query)`` in which ``$path`` is the file."""
    import duckdb

    name = os.path.abspath(_files.local(path))  # "://" cannot stand in it
    pattern = re.sub(r"([*?\[])", r"[\1]", name)  # a name is no pattern
    settings: dict[str, Any] = {
        "threads": 1, "preserve_insertion_order": True, "autoinstall_known_extensions": False,
        "autoload_known_extensions": False, "temp_directory": "",
    }  # fmt: skip
    try:
        with duckdb.connect(":memory:", config=settings) as connection:
            connection.execute(f"SET allowed_paths = [{quote_text(name)}, {quote_text(pattern)}]")
            connection.execute("SET enable_progress_bar = false")
            connection.execute("SET enable_external_access = false")
            connection.execute("SET lock_configuration = true")
            yield lambda query: connection.execute(query, {"path": pattern} if "$path" in query else {})
    except duckdb.OutOfMemoryException:
        raise MemoryError(f"{path!r} has more rows than memory holds") from None
    except duckdb.Error as error:
        text = _checks.escape_controls(str(error).splitlines()[0])
        raise ValueError(f"{path!r} must be a parquet table; it is not, or is damaged ({text:.200})") from None


def _parquet_labels(path: str) -> list[str]:
    """The names of the columns, without those inside of others: parquet lists a tree in depth-first order."""
    with open_duckdb(path) as run:
        schema = run("SELECT name, num_children FROM parquet_schema($path)").fetchall()
    labels, n_inside = [], 0
    for name, children in schema[1:]:
        if n_inside == 0:
            labels.append(name)
        n_inside += (children or 0) - (n_inside > 0)
    return labels


def sum_groups(table: Table, labels: Sequence[str]) -> dict[str, Column] | None:
    """The different (s, a, s', ended) of a parquet file and, of the other columns, number, least, largest and sum in each.

    None where DuckDB cannot sum them, which a look at their values will explain.
    """
    import duckdb

    key = [label for label in labels if label in (*MOVE, "terminated")]
    parts = [*key, "count(*) AS n"]
    for label in labels:
        if label not in key:
            parts += [
                f"min({label}) AS least_{label}",
                f"max({label}) AS largest_{label}",
                f"count({label}) AS n_{label}",
            ]
    parts += ["sum(reward) AS total_reward"] * ("reward" in labels)
    parts += ["sum(truncated::INTEGER) AS total_truncated"] * ("truncated" in labels)
    if not set(labels) <= set(table.labels):
        return None
    with open_duckdb(table.file.path) as run:
        try:
            groups = run(f"SELECT {', '.join(parts)} FROM read_parquet($path) GROUP BY {', '.join(key)}").fetchnumpy()
        except (duckdb.ConversionException, duckdb.BinderException):
            return None
    return {label: fill_missing(column) for label, column in groups.items()}


def _read_parquet(table: Table, labels: list[str]) -> Iterator[dict[str, Column]]:
    columns = ", ".join('"' + label.replace('"', '""') + '"' for label in labels)
    source = "read_parquet($path, file_row_number = true, hive_partitioning = false, union_by_name = false)"
    with open_duckdb(table.file.path) as run:
        for start in range(0, run("SELECT count(*) FROM read_parquet($path)").fetchone()[0], N_PARQUET):
            rows = f"file_row_number >= {start} AND file_row_number < {start + N_PARQUET}"
            piece = run(f"SELECT {columns} FROM {source} WHERE {rows}").fetchnumpy()
            yield {label: fill_missing(column) for label, column in piece.items()}


def fill_missing(column: Any) -> Column:
    """A column of DuckDB's: nan, or None among objects, where a value is missing."""
    if not np.ma.is_masked(column):
        return np.asarray(np.ma.getdata(column))
    is_number = column.dtype.kind in "iuf"
    return np.asarray(column.astype(np.float64 if is_number else object).filled(np.nan if is_number else None))


# ---- CSV


def _open_csv(path: str, encoding: str | None = None) -> Any:
    """A file, or what is compressed in it: bytes, or text of an encoding."""
    opener: Any = gzip.open if path.lower().endswith(".gz") else open
    return opener(path, "rb") if encoding is None else opener(path, "rt", encoding=encoding, newline="")


@contextmanager
def _csv_errors(path: str) -> Iterator[None]:
    """ValueError that names the file, of whatever cannot be read."""
    try:
        yield
    except UnicodeDecodeError:
        raise ValueError(f"{path!r} must be a CSV table with a header, in UTF-8; it is not") from None
    except (csv.Error, EOFError, gzip.BadGzipFile, zlib.error, ValueError, OverflowError, Warning) as error:
        raise ValueError(f"{path!r} must be a CSV table with a header; {error}") from None


def _csv_header(path: str) -> tuple[list[str], list[str], str]:
    """The labels, the first values and the encoding."""
    with _csv_errors(path):
        with _open_csv(path) as handle:
            mark = handle.read(3)
        if mark[:2] == b"\xfe\xff":
            raise ValueError("it is UTF-16 of the order that few programs write (save it as UTF-8)")
        encoding = "utf-16" if mark[:2] == b"\xff\xfe" else "utf-8-sig" if mark == b"\xef\xbb\xbf" else "utf-8"
        with _open_csv(path, encoding) as handle:
            lines = (line for line in csv.reader(handle) if line)
            return next(lines, []), next(lines, []), encoding


def _may_have_odd_lines(table: Table) -> bool:
    """Whether a file has quotes or empty lines, or a line with another number of commas than its header."""
    n = len(table.labels) - 1
    with _csv_errors(table.file.path), _open_csv(table.file.path) as handle:
        while block := handle.read(2**20):
            block += handle.readline()
            codes = np.frombuffer(block, dtype=np.uint8)
            ends, commas = np.flatnonzero(codes == ord("\n")), np.flatnonzero(codes == ord(","))
            if block[-1] != ord("\n"):
                ends = np.append(ends, len(block))
            if n < 1 or b'"' in block or b"\0" in block or len(commas) != n * len(ends):
                return True
            places = commas.reshape(len(ends), n)
            if (places[:, -1] > ends).any() or (places[1:, 0] < ends[:-1]).any():
                return True
    return False


def _csv_lines(table: Table) -> Iterator[tuple[int, list[str]]]:
    """The fields of each line below the header that is not empty, and the number of its line."""
    with _csv_errors(table.file.path), _open_csv(table.file.path, table.encoding) as handle:
        reader = csv.reader(handle)
        is_header, line = True, 1
        for fields in reader:
            if fields and not is_header:
                yield line, fields
            is_header, line = is_header and not fields, reader.line_num + 1


def _find_odd_lines(table: Table) -> dict[int, str]:
    """The rows that have another number of fields than the header, in words."""
    n = len(table.labels)
    return {
        row: f"(line {line}) must have {n} fields, as the header has; it has {len(fields)}"
        for row, (line, fields) in enumerate(_csv_lines(table))
        if len(fields) != n
    }


def _read_texts(table: Table, labels: list[str]) -> Iterator[dict[str, Column]]:
    """The rows that have as many fields as the header, as texts."""
    places = [table.labels.index(label) for label in labels]
    lines = (fields for row, (_, fields) in enumerate(_csv_lines(table)) if row not in table.lost)
    while rows := [[fields[k] or None for k in places] for fields in itertools.islice(lines, N_CSV)]:
        yield {
            label: np.array(column, dtype=object) for label, column in zip(labels, zip(*rows, strict=True), strict=True)
        }


def _read_csv(table: Table, labels: list[str]) -> Iterator[dict[str, Column]]:
    with _csv_errors(table.file.path), _open_csv(table.file.path) as handle:
        places = {label: table.labels.index(label) for label in labels}
        texts = {k: str for label, k in places.items() if label in table.texts and label in (*MOVE, "episode")}
        options = {"names": range(len(table.labels)), "header": 0, "dtype": texts, "encoding": table.encoding}
        for frame in read_csv(handle, chunksize=N_CSV, keep_default_na=False, na_values=[""], **options):
            series = {label: frame[k] for label, k in places.items()}
            yield {
                label: column.to_numpy(object if column.dtype == "str" else None) for label, column in series.items()
            }


def csv_frame(path: str) -> Any:
    """A CSV file with a header as a DataFrame, its numbers to the last bit; ValueError for another file."""
    name = _files.local(path)
    encoding = _csv_header(name)[2]
    with _csv_errors(name), _open_csv(name) as handle:
        return read_csv(handle, encoding=encoding)


def read_csv(handle: IO[bytes], **options: Any) -> Any:
    """What pandas makes of a CSV file, numbers to the last bit; ValueError where it has more fields than its header names."""
    import pandas as pd

    if tuple(int(part) for part in pd.__version__.split(".")[:2]) < (3, 1):  # later ones need no option
        options["float_precision"] = "round_trip"
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        warnings.simplefilter("ignore", pd.errors.DtypeWarning)
        return pd.read_csv(handle, index_col=False, **options)
