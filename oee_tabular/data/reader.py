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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._checks import Column, IntArray
from oee_tabular.data.digests import check_digest, quote_text
from oee_tabular.data.labels import MOVE
from oee_tabular.data.rules import HELD, KINDS, NAMES_HINT, Fault, check_column, count_others, is_missing
from oee_tabular.data.sums import KEY
from oee_tabular.mdp.naming import Name, is_number_text

N_PARQUET, N_CSV = 2**18, 2**17  # rows of a piece
SMALL = 2**21  # bytes of a CSV file, which Python reads in the time in which pandas is imported
MOST_COLUMNS = 10_000  # of a CSV table, which take 1 s to read
OTHERS = bytes(set(range(256)) - set(b',\n"\0'))  # bytes that tell nothing of the number of fields


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
    """Rows that follow each other: the raw values by label, and the numbers of the rows in the file.

    ``lost``: the lines of a CSV file that have another number of fields than its header, in words, by the number of the row.
    """

    columns: dict[str, Column]
    rows: IntArray
    lost: Mapping[int, str]


@dataclass
class Table:
    """A file as a table: ``labels``: of all its columns; ``known``: those of a log among them and in ``file.fixed``."""

    file: LogFile
    labels: list[str]
    is_known: Callable[[str], bool]
    read: Callable[[Table, list[str]], Iterator[Piece]]
    encoding: str = "utf-8"
    texts: frozenset[str] = frozenset()  # columns of a CSV file whose first value is no number

    @property
    def known(self) -> list[str]:
        """The labels of the columns that are read."""
        fixed = (label for label, _ in self.file.fixed)
        return [label for label in dict.fromkeys([*self.labels, *fixed]) if self.is_known(label)]

    def pieces(self) -> Iterator[Piece]:
        """The rows of the file; errors of the libraries in this package's words."""
        fixed = {label: float(value) if is_number_text(value) else value for label, value in self.file.fixed}
        for piece in self.read(self, [label for label in self.known if label in self.labels]):
            folders = {label: np.full(len(piece.rows), fixed[label]) for label in self.known if label in fixed}
            yield piece._replace(columns=folders | piece.columns)

    def check(
        self, raw: Column, label: str, *, high: int = 2**63, names: tuple[Name, ...] | None = None
    ) -> tuple[Column, Fault | None]:
        """The values of a column and what is wrong with them; ValueError where its type is none of a log's."""
        names = () if label == "episode" else names  # an episode may be called by any text
        if self.file.suffix == ".csv":
            return check_column(raw, label, high=high, names=names)
        kind = KINDS.get(label, "number")
        held, hint = str(raw.dtype), ""
        if raw.dtype.hasobject:
            first = next((item for item in raw.tolist() if not is_missing(item)), None)
            held = "texts" if isinstance(first, str) else type(first).__name__
            hint = NAMES_HINT if label in MOVE else ""
            is_name = names is not None and isinstance(first, str) and not is_number_text(first)
            is_allowed = first is None or is_name or (kind == "flag" and isinstance(first, bool))
        else:
            is_allowed = raw.dtype.kind in ("biufU" if kind == "flag" else "iufU")
        if not is_allowed:
            raise ValueError(f"column {label!r} of {self.file.path!r} must hold {HELD[kind]}; it holds {held}{hint}")
        return check_column(raw, label, high=high, names=names)


def open_table(file: LogFile, is_known: Callable[[str], bool]) -> Table:
    """The table in a file, its header read; ValueError that names it for what is none, or has a known column twice."""
    if file.suffix == ".parquet":
        check_digest(file.path)
        table = Table(file, _parquet_labels(file.path), is_known, _read_parquet)
    else:
        labels, first, encoding = _csv_header(_files.local(file.path))
        if len(labels) > MOST_COLUMNS:
            raise ValueError(
                f"{file.path!r} must have at most {MOST_COLUMNS} columns; it has {len(labels)} (keep those that a log has)"
            )
        values = zip(labels, first, strict=False)
        texts = frozenset(label for label, value in values if not is_number_text(value or "0"))
        table = Table(file, labels, is_known, _read_lines, encoding, texts)
        if os.path.getsize(file.path) >= SMALL and not _has_odd_lines(table):
            table.read = _read_csv
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
    for words in (words for piece in pieces for words in piece.lost.values()):
        raise ValueError(f"{file.path!r}: {words}")
    columns = {}
    for label in table.known:
        raw = np.concatenate([piece.columns[label] for piece in pieces]) if pieces else np.zeros(0)
        columns[label], fault = table.check(raw, label, names=() if label in MOVE else None)
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

    key = [label for label in labels if label in KEY]
    parts = [*key, "count(*) AS count"]
    for label in (label for label in labels if label not in KEY):
        parts += [f"{how}({label}) AS {label}_{how}" for how in ("min", "max", "count")]
    parts += ["sum(reward) AS reward_sum"] * ("reward" in labels)
    parts += ["sum(truncated::INTEGER) AS truncated_sum"] * ("truncated" in labels)
    if not set(labels) <= set(table.labels):
        return None
    with open_duckdb(table.file.path) as run:
        try:
            groups = run(f"SELECT {', '.join(parts)} FROM read_parquet($path) GROUP BY {', '.join(key)}").fetchnumpy()
        except (duckdb.ConversionException, duckdb.BinderException):
            return None
    return {label: fill_missing(column) for label, column in groups.items()}


def _read_parquet(table: Table, labels: list[str]) -> Iterator[Piece]:
    columns = ", ".join('"' + label.replace('"', '""') + '"' for label in labels)
    source = "read_parquet($path, file_row_number = true, hive_partitioning = false, union_by_name = false)"
    with open_duckdb(table.file.path) as run:
        n_rows = run("SELECT count(*) FROM read_parquet($path)").fetchone()[0]
        for start in range(0, n_rows, N_PARQUET):
            stop = min(start + N_PARQUET, n_rows)
            which = f"file_row_number >= {start} AND file_row_number < {stop}"
            piece = run(f"SELECT {columns} FROM {source} WHERE {which}").fetchnumpy()
            yield Piece({label: fill_missing(column) for label, column in piece.items()}, np.arange(start, stop), {})


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


def _has_odd_lines(table: Table) -> bool:
    """Whether a line has another number of fields than the header: by its commas alone, where there are no quotes."""
    n = len(table.labels)
    line = b"," * (n - 1) + b"\n"
    with _csv_errors(table.file.path), _open_csv(table.file.path) as handle:
        while block := handle.read(2**20) + handle.readline():
            marks = (block if block.endswith(b"\n") else block + b"\n").translate(None, OTHERS)
            if marks != line * (len(marks) // len(line)):
                return any(len(fields) != n for _, fields in _csv_lines(table))
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


def _read_lines(table: Table, labels: list[str]) -> Iterator[Piece]:
    """The fields of the lines as texts."""
    n = len(table.labels)
    places = {label: table.labels.index(label) for label in labels}
    lines = enumerate(_csv_lines(table))
    while some := list(itertools.islice(lines, N_CSV)):
        good = [(row, fields) for row, (_, fields) in some if len(fields) == n]
        lost = {
            row: f"row {row} (line {line}) must have {n} fields, as the header has; it has {len(fields)}"
            for row, (line, fields) in some
            if len(fields) != n
        }
        columns = {label: np.array([fields[k] or None for _, fields in good], object) for label, k in places.items()}
        yield Piece(columns, np.array([row for row, _ in good], dtype=np.int64), lost)


def _read_csv(table: Table, labels: list[str]) -> Iterator[Piece]:
    """The values that pandas makes of the fields; names stay texts."""
    with _csv_errors(table.file.path), _open_csv(table.file.path) as handle:
        places = {label: table.labels.index(label) for label in labels}
        texts = {k: str for label, k in places.items() if label in table.texts and label in (*MOVE, "episode")}
        options = {"names": range(len(table.labels)), "header": 0, "dtype": texts, "encoding": table.encoding}
        for frame in read_csv(handle, chunksize=N_CSV, keep_default_na=False, na_values=[""], **options):
            series = {label: frame[k] for label, k in places.items()}
            columns = {label: one.to_numpy(object if one.dtype == "str" else None) for label, one in series.items()}
            yield Piece(columns, frame.index.to_numpy(), {})


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
