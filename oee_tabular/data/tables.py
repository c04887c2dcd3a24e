"""CSV and parquet files of a log, read in pieces of raw values.

A piece has some thousand rows, in the order of the file. pandas reads CSV, in half of
the time of DuckDB's reader (10^6 rows of 6 columns: 0.17 s of CPU, 0.29 s), and Python
what is small. DuckDB reads parquet in one thread, so that the same file gives the same
bits; it may open that file alone and loads no extension. Parquet of our own has a
digest of all its other bytes, which no page of parquet has, in its metadata.
``rules.py`` says which values are those of a log.
"""

from __future__ import annotations

import csv
import errno
import gzip
import hashlib
import itertools
import os
import re
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular.data.rules import KEY, MOVE
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.naming import is_number_text
from oee_tabular.typing import Column, IntArray

# rows of a piece
N_PARQUET_ROWS = 2**18
N_CSV_ROWS = 2**17
# The size of a CSV file that Python reads in the time in which pandas is imported.
MAX_SMALL_BYTES = 2**21
MAX_COLUMNS = 10_000  # of a CSV table, which take 1 s to read
# bytes that tell nothing of the number of fields
OTHER_BYTES = bytes(set(range(256)) - set(b',\n"\0'))
DIGEST_KEY = b"oee_tabular_digest"
DIGEST_MARK = b"oee_tabular_sha256:"
EMPTY_DIGEST = b"0" * 64
TAIL_BYTES = 2**20  # bytes at the end of a file, in which parquet keeps its metadata


class LogFile(NamedTuple):
    """Hold a log's file, and the columns that its folders name, ``column=value``."""

    path: str
    fixed: tuple[tuple[str, str], ...] = ()

    @property
    def suffix(self) -> str:
        """Return .csv, .parquet or .npz; .csv of a compressed one."""
        path = Path(self.path.lower())
        return Path(path.stem).suffix if path.suffix == ".gz" else path.suffix


class Piece(NamedTuple):
    """Hold adjacent rows: raw values by label, and the rows' numbers in the file.

    ``lost``: the lines of a CSV file that have another number of fields than its
    header, by the number of the row: the place and the broken rule in words.
    """

    columns: dict[str, Column]
    rows: IntArray
    lost: Mapping[int, tuple[str, str]]


@dataclass
class Table:
    """Hold a log's rows: all ``labels``, and the ``pieces`` of ``known`` columns.

    ``known`` are the labels of a log's columns.
    """

    labels: list[str]
    known: list[str]
    pieces: Iterable[Piece]


def open_table(file: LogFile, form: Any) -> Table:
    """Return the table in a file, its header read.

    Raises an ArgumentError that names the file where it has no log of this
    ``files.Format``.
    """
    is_parquet = file.suffix == ".parquet"
    if is_parquet:
        check_digest(file.path)
    labels = read_labels(file.path)
    if not is_parquet and len(labels) > MAX_COLUMNS:
        raise ArgumentError(
            f"{file.path!r}",
            f"must have at most {MAX_COLUMNS} columns; it has {len(labels)} (keep"
            " those that a log has)",
        )
    _require_distinct_labels(file.path, labels, form)
    fixed: dict[str, Any] = dict(file.fixed)
    for label, value in file.fixed:
        if is_number_text(value):
            fixed[label] = float(value)
    every = list(dict.fromkeys([*labels, *fixed]))
    form.require(every, file.path)
    known = [label for label in every if form.is_known(label)]
    read = _read_parquet if is_parquet else _read_csv
    own = [label for label in known if label in labels]

    def pieces() -> Iterator[Piece]:
        """Yield the pieces of the file with the columns that its folders name."""
        for piece in read(file.path, labels, own):
            folders = {
                label: np.full(len(piece.rows), fixed[label])
                for label in known
                if label in fixed
            }
            yield piece._replace(columns=folders | piece.columns)

    return Table(labels, known, pieces())


def _require_distinct_labels(path: str, labels: list[str], form: Any) -> None:
    """Raise an ArgumentError where a known column stands twice, in capitals or not.

    DuckDB does not tell capitals.
    """
    first_of: dict[str, str] = {}
    for label in labels:
        lower = label.lower()
        if form.is_known(lower) and lower in first_of:
            first = first_of[lower]
            twice = f"{first!r} and {label!r}"
            if first == label:
                twice = f"{label!r} twice"
            raise ArgumentError(
                f"{path!r}", f"must have columns that differ; it has {twice}"
            )
        first_of.setdefault(lower, label)


def read_labels(path: str) -> list[str]:
    """Return the labels of a table's columns; ArgumentError for another file."""
    if path.lower().endswith(".parquet"):
        return _parquet_labels(path)
    return _csv_header(_files.local(path))[0]


# ---- parquet


@contextmanager
def open_duckdb(path: str) -> Iterator[Callable[[str], Any]]:
    """Open a connection that reads this file alone, and give ``run(query)``.

    ``$path`` is the file in a query.
    """
    import duckdb

    name = os.path.abspath(_files.local(path))  # "://" cannot stand in it
    pattern = re.sub(r"([*?\[])", r"[\1]", name)  # a name is no pattern
    settings: dict[str, Any] = {
        "threads": 1,
        "preserve_insertion_order": True,
        "autoinstall_known_extensions": False,
        "autoload_known_extensions": False,
        "temp_directory": "",
    }
    try:
        with duckdb.connect(":memory:", config=settings) as connection:
            allowed = f"[{quote_text(name)}, {quote_text(pattern)}]"
            connection.execute(f"SET allowed_paths = {allowed}")
            connection.execute("SET enable_progress_bar = false")
            connection.execute("SET enable_external_access = false")
            connection.execute("SET lock_configuration = true")

            def run(query: str) -> Any:
                """Run a query in which ``$path`` is the file."""
                parameters = {"path": pattern} if "$path" in query else {}
                return connection.execute(query, parameters)

            yield run
    except duckdb.OutOfMemoryException:
        raise MemoryError(f"{path!r} has more rows than memory holds") from None
    except duckdb.Error as error:
        text = _checks.escape_controls(str(error).splitlines()[0])
        raise ArgumentError(
            f"{path!r}",
            f"must be a parquet table; it is not, or is damaged ({text:.200})",
        ) from None


def _parquet_labels(path: str) -> list[str]:
    """Return the names of the columns, without those inside of others.

    parquet lists a tree in depth-first order.
    """
    with open_duckdb(path) as run:
        schema = run("SELECT name, num_children FROM parquet_schema($path)").fetchall()
    labels = []
    n_inside = 0
    for name, children in schema[1:]:
        if n_inside == 0:
            labels.append(name)
        n_inside += (children or 0) - (n_inside > 0)
    return labels


def count_parquet_rows(path: str) -> int:
    """Return the number of rows of a parquet file."""
    with open_duckdb(path) as run:
        return int(run("SELECT count(*) FROM read_parquet($path)").fetchone()[0])


def sum_groups(path: str, labels: Sequence[str]) -> dict[str, Column] | None:
    """Return the columns of ``sum_rows`` of a parquet file, summed by DuckDB.

    Truncated transitions are apart; of other columns there are least, largest and
    number in each. It takes half of the time of the pieces. None where DuckDB cannot
    compute them, which a look at the values will explain.
    """
    import duckdb

    key = [label for label in (*KEY, "truncated") if label in labels]
    others = [label for label in labels if label not in key]
    parts = [*key, "count(*) AS count"]
    if "reward" in labels:
        parts.append("coalesce(sum(reward), 0) AS reward_sum")
    for label in others:
        parts += [f"{how}({label}) AS {label}_{how}" for how in ("min", "max", "count")]
    selected = ", ".join(parts)
    query = f"SELECT {selected} FROM read_parquet($path) GROUP BY {', '.join(key)}"
    with open_duckdb(path) as run:
        try:
            groups = run(query).fetchnumpy()
        except (duckdb.ConversionException, duckdb.BinderException):
            return None
    return {label: _fill_missing(column) for label, column in groups.items()}


def _read_parquet(path: str, labels: list[str], chosen: list[str]) -> Iterator[Piece]:
    """Yield the pieces of a parquet file."""
    columns = ", ".join('"' + label.replace('"', '""') + '"' for label in chosen)
    source = (
        "read_parquet($path, file_row_number = true, hive_partitioning = false,"
        " union_by_name = false)"
    )
    n_rows = count_parquet_rows(path)
    with open_duckdb(path) as run:
        for start in range(0, n_rows, N_PARQUET_ROWS):
            stop = min(start + N_PARQUET_ROWS, n_rows)
            which = f"file_row_number >= {start} AND file_row_number < {stop}"
            piece = run(f"SELECT {columns} FROM {source} WHERE {which}").fetchnumpy()
            values = {label: _fill_missing(column) for label, column in piece.items()}
            yield Piece(values, np.arange(start, stop), {})


def _fill_missing(column: Any) -> Column:
    """Return a column of DuckDB's with nan or None for missing values."""
    if not np.ma.is_masked(column):
        return np.asarray(np.ma.getdata(column))
    is_number = column.dtype.kind in "iuf"
    values = np.ma.getdata(column).astype(np.float64 if is_number else object)
    # filled(None) would write "?"
    values[np.ma.getmaskarray(column)] = np.nan if is_number else None
    return np.asarray(values)


# ---- parquet of our own


def write_parquet(path: str, columns: Mapping[str, Column]) -> None:
    """Write a table, with a digest of all its other bytes in its metadata."""
    import duckdb
    import pandas as pd

    target = quote_text(os.path.abspath(path))
    mark = (DIGEST_MARK + EMPTY_DIGEST).decode()
    metadata = f"{{{DIGEST_KEY.decode()}: '{mark}'}}"
    settings: dict[str, Any] = {"threads": 1, "autoload_known_extensions": False}
    with duckdb.connect(":memory:", config=settings) as connection:
        connection.register("log_in_memory", pd.DataFrame(dict(columns)))
        try:
            connection.execute(
                f"COPY log_in_memory TO {target} (FORMAT parquet, USE_TMP_FILE false,"
                f" KV_METADATA {metadata})"
            )
        except duckdb.IOException as error:  # a full disk, as the system's own error
            code = re.search(r'errno"?:"?(\d+)', str(error))
            number = int(code[1]) if code else errno.EIO
            raise OSError(number, os.strerror(number)) from None
    _, digest, place = _read_digest(path)
    with open(path, "r+b") as handle:
        handle.seek(place)
        handle.write(digest)


def check_digest(path: str) -> None:
    """Raise an ArgumentError where a parquet file of this package has changed."""
    stored, digest, _ = _read_digest(path)
    if stored != digest:
        raise ArgumentError(
            f"{path!r}",
            "must be as it was saved: its digest is not that of its bytes. It is"
            " damaged, or another program wrote it anew (then make a log of its frame"
            " and save that: Transitions.from_frame(frame).save(path))",
        )


def _read_digest(path: str) -> tuple[bytes, bytes, int]:
    """Return the digest in a file, that of its bytes, and the place of the digest.

    It is SHA-256 of the file with zeros where the digest stands. Of other programs'
    files both are empty.
    """
    with open(path, "rb") as handle:
        n_before = max(os.fstat(handle.fileno()).st_size - TAIL_BYTES, 0)
        handle.seek(n_before)
        start, mark, rest = handle.read().rpartition(DIGEST_MARK)
        if not mark:  # another program's, or a file of ours whose mark is damaged
            return b"", DIGEST_KEY if DIGEST_KEY in rest else b"", -1
        digest = hashlib.sha256()
        handle.seek(0)
        for k in range(0, n_before, TAIL_BYTES):
            digest.update(handle.read(min(TAIL_BYTES, n_before - k)))
        digest.update(start + mark + EMPTY_DIGEST + rest[64:])
    return rest[:64], digest.hexdigest().encode(), n_before + len(start + mark)


def quote_text(text: str) -> str:
    """Return text as SQL has it."""
    return "'" + text.replace("'", "''") + "'"


# ---- CSV


def _open_csv(path: str, encoding: str | None = None) -> Any:
    """Open a file, or what is compressed in it, as bytes or as text of an encoding."""
    opener: Any = gzip.open if path.lower().endswith(".gz") else open
    if encoding is None:
        return opener(path, "rb")
    return opener(path, "rt", encoding=encoding, newline="")


@contextmanager
def _csv_errors(path: str) -> Iterator[None]:
    """Turn whatever cannot be read into an ArgumentError that names the file."""
    try:
        yield
    except UnicodeDecodeError:
        raise ArgumentError(
            f"{path!r}", "must be a CSV table with a header, in UTF-8; it is not"
        ) from None
    except (
        csv.Error,
        EOFError,
        gzip.BadGzipFile,
        zlib.error,
        ValueError,
        OverflowError,
        Warning,
    ) as error:
        raise ArgumentError(
            f"{path!r}", f"must be a CSV table with a header; {error}"
        ) from None


def _csv_header(path: str) -> tuple[list[str], list[str], str]:
    """Return the labels, the first values and the encoding of a CSV file."""
    with _csv_errors(path):
        with _open_csv(path) as handle:
            mark = handle.read(3)
        if mark[:2] == b"\xfe\xff":
            raise ValueError(
                "it is UTF-16 of the order that few programs write (save it as UTF-8)"
            )
    encoding = "utf-8"
    if mark[:2] == b"\xff\xfe":
        encoding = "utf-16"
    elif mark == b"\xef\xbb\xbf":
        encoding = "utf-8-sig"
    lines = (fields for _, fields in _csv_lines(path, encoding))
    return next(lines, []), next(lines, []), encoding


def _csv_lines(path: str, encoding: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of each line that is not empty, and its fields."""
    with _csv_errors(path), _open_csv(path, encoding) as handle:
        reader = csv.reader(handle)
        line = 1
        for fields in reader:
            if fields:
                yield line, fields
            line = reader.line_num + 1


def _read_csv(path: str, labels: list[str], chosen: list[str]) -> Iterator[Piece]:
    """Yield the values that pandas makes of the fields; names stay texts.

    Of a small or an odd file they are the fields, read by Python.
    """
    _, first, encoding = _csv_header(path)
    if os.path.getsize(path) < MAX_SMALL_BYTES or _has_odd_lines(
        path, len(labels), encoding
    ):
        yield from _read_lines(path, labels, chosen, encoding)
        return
    places = {label: labels.index(label) for label in chosen}
    names = {places[label] for label in (*MOVE, "episode") if label in places}
    texts = {
        k: str
        for k, value in enumerate(first)
        if k in names and not is_number_text(value or "0")
    }
    options = {
        "names": range(len(labels)),
        "header": 0,
        "dtype": texts,
        "encoding": encoding,
        "chunksize": N_CSV_ROWS,
        "keep_default_na": False,
        "na_values": [""],
    }
    with _csv_errors(path), _open_csv(path) as handle:
        for frame in _call_pandas(handle, **options):
            series = {label: frame[k] for label, k in places.items()}
            columns = {
                label: one.to_numpy(object if one.dtype == "str" else None)
                for label, one in series.items()
            }
            yield Piece(columns, frame.index.to_numpy(), {})


def _has_odd_lines(path: str, n: int, encoding: str) -> bool:
    """Say whether a line has another number of fields than n.

    It counts commas, and reads the fields only where that does not tell.
    """
    line = b"," * (n - 1) + b"\n"
    with _csv_errors(path), _open_csv(path) as handle:
        while block := handle.read(2**20) + handle.readline():
            whole = block if block.endswith(b"\n") else block + b"\n"
            marks = whole.translate(None, OTHER_BYTES)
            if marks != line * (len(marks) // len(line)):
                return any(len(fields) != n for _, fields in _csv_lines(path, encoding))
    return False


def _read_lines(
    path: str, labels: list[str], chosen: list[str], encoding: str
) -> Iterator[Piece]:
    """Yield the fields of the lines as texts."""
    n = len(labels)
    places = {label: labels.index(label) for label in chosen}
    lines = enumerate(itertools.islice(_csv_lines(path, encoding), 1, None))
    while some := list(itertools.islice(lines, N_CSV_ROWS)):
        good = [(row, fields) for row, (_, fields) in some if len(fields) == n]
        lost = {
            row: (
                f"row {row} (line {line})",
                f"must have {n} fields, as the header has; it has {len(fields)}",
            )
            for row, (line, fields) in some
            if len(fields) != n
        }
        columns = {
            label: np.array([fields[k] or None for _, fields in good], object)
            for label, k in places.items()
        }
        yield Piece(columns, np.array([row for row, _ in good], dtype=np.int64), lost)


def csv_frame(path: str) -> Any:
    """Read a CSV file with a header as a DataFrame, its numbers to the last bit.

    Raises an ArgumentError for another file.
    """
    name = _files.local(path)
    encoding = _csv_header(name)[2]
    with _csv_errors(name), _open_csv(name) as handle:
        return _call_pandas(handle, encoding=encoding)


def _call_pandas(handle: IO[bytes], **options: Any) -> Any:
    """Return what pandas makes of a CSV file, numbers to the last bit.

    Raises a ValueError where a line has more fields than the header names.
    """
    import pandas as pd

    # later ones need no option
    if tuple(int(part) for part in pd.__version__.split(".")[:2]) < (3, 1):
        options["float_precision"] = "round_trip"
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        warnings.simplefilter("ignore", pd.errors.DtypeWarning)
        return pd.read_csv(handle, index_col=False, **options)
