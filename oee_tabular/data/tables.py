"""CSV and parquet files of a log, read in pieces of raw values.

A piece has some thousand rows, in the order of the file. pandas reads CSV, in half of
the time of DuckDB's reader (10^6 rows of 6 columns: 0.17 s of CPU, 0.29 s), and Python
what is small or odd. Both give the same values and errors: pandas is given only lines
of which it makes what Python makes, and a field of a log spans no lines.

DuckDB reads parquet in one thread, so that the same file gives the same bits; it may
open that file alone and loads no extension. Parquet of our own has a digest of all its
other bytes, which no page of parquet has, in its metadata. ``rules.py`` says which
values are those of a log.
"""

from __future__ import annotations

import base64
import csv
import errno
import gzip
import hashlib
import io
import itertools
import os
import re
import struct
import unicodedata
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular.data.aliases import find_field
from oee_tabular.data.labels import Matching
from oee_tabular.data.rules import (
    HEADER_RULE,
    KEY,
    KINDS,
    MISSING_WORDS,
    MOVE,
    as_objects,
    check_column,
    find_headers,
    is_absent,
    parse_episode,
    parse_flag,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import is_number_text, to_plain
from oee_tabular.typing import Column, IntArray

# rows of a piece
N_PARQUET_ROWS = 2**18
N_CSV_ROWS = 2**17
# The size of a CSV file that Python reads in the time in which pandas is imported.
MAX_SMALL_BYTES = 2**21
MAX_COLUMNS = 10_000  # of a CSV table, which take 1 s to read
MAX_LINE_CHARACTERS = 2**24  # of a CSV file, which is read no further
# which processors keep near; of 2**20 the reading takes 1.2 times as long
BLOCK_BYTES = 2**18
MAX_BLANK_LINES = 10_000_000  # in a row, of a CSV file, which is read no further
MAX_LINES_ABOVE = 5  # above a header, that are looked at where there is none
WINDOW_BYTES = 2**16  # half of csv's longest field
# bytes that tell nothing of the number of fields
OTHER_BYTES = bytes(set(range(256)) - set(b',\n\r"\0'))
NULL_FOLDER = "__HIVE_DEFAULT_PARTITION__"  # of a value that is missing, as Hive has it
PARQUET = "read_parquet($path, hive_partitioning = false, union_by_name = false)"
DIGEST_KEY = b"oee_tabular_digest"
DIGEST_MARK = b"oee_tabular_sha256:"
# what is left of them where a few bytes are damaged
DIGEST_REMNANTS = (b"oee_tabular", b"lar_digest", b"lar_sha256:")
EMPTY_DIGEST = b"0" * 64
TAIL_BYTES = 2**20  # bytes at the end of a file, in which parquet keeps its metadata


EMPTY_RULE = (
    "must have a header; the file is empty (beside other files of a log it may be left"
    " out)"
)


class LogFile(NamedTuple):
    """Hold a log's file, and the columns that its folders name, ``column=value``."""

    path: str
    fixed: tuple[tuple[str, str], ...] = ()

    @property
    def suffix(self) -> str:
        """Return .csv, .parquet or .npz; .csv of a compressed one."""
        name = Path(self.path.lower()).name.removesuffix(".gz")
        # of a hidden file as well, whose whole name is the ending
        return "".join(name.rpartition(".")[1:]) if "." in name else ""


class Piece(NamedTuple):
    """Hold adjacent rows: raw values by label, and the rows' numbers in the file.

    ``lost``: the lines of a CSV file that hold no transition, as they have another
    number of fields than its header, by the number of the row: the place and the broken
    rule in words.
    """

    columns: dict[str, Column]
    rows: IntArray
    lost: Mapping[int, tuple[str, str]]


def no_text(label: str, row: int) -> Any:
    """Return None, the text of a field in a file that holds values, not texts."""
    return None


@dataclass
class Table:
    """Hold a log's rows: all ``labels``, and the ``pieces`` of ``known`` columns.

    ``known`` are a log's columns, which ``matching`` finds among the labels.
    ``find_text`` returns a field, by a log's column and the number of its row, as the
    file writes it, or None. ``n_rows``: their number, where the file says it.
    """

    labels: list[str]
    known: list[str]
    pieces: Iterable[Piece]
    matching: Matching
    find_text: Callable[[str, int], Any] = no_text
    n_rows: int | None = None


def open_table(file: LogFile, form: Any) -> Table:
    """Return the table in a file, its header read.

    Raises an ArgumentError that names the file where it has no log of this
    ``files.Format``.
    """
    is_parquet = file.suffix == ".parquet"
    name = _files.local(file.path)
    if is_parquet and os.path.isfile(name) and not os.path.getsize(name):
        raise ArgumentError(f"{file.path!r}", EMPTY_RULE)
    if is_parquet:
        check_digest(file.path)
    header = read_parquet_header(file.path) if is_parquet else None
    labels = _plain_labels(header.stored) if header else read_labels(file.path)
    if not labels:
        raise ArgumentError(f"{file.path!r}", EMPTY_RULE)
    if not is_parquet and len(labels) > MAX_COLUMNS:
        raise ArgumentError(
            f"{file.path!r}",
            f"must have at most {MAX_COLUMNS} columns; it has {len(labels)} (keep"
            " those that a log has)",
        )
    folders = [label for label in dict(file.fixed) if label not in labels]
    try:
        matching = form.match([*labels, *folders], file.path)
    except ArgumentError as error:
        number = None if is_parquet else _find_header(file, form, folders)
        if number is None:
            raise
        raise ArgumentError(
            error.argument,
            f"{error.rule} (line {number} looks like the header: leave the lines above"
            " it out of the file)",
        ) from None
    # a folder that is no column of a log is none of its file's
    left = tuple(label for label in matching.left_out if label in labels)
    matching = matching._replace(left_out=left)
    renamed = matching.rename(labels)
    to_read = matching.to_read()
    if header is not None:
        if any("" in group for group in matching.taken.values()):
            raise ArgumentError(
                f"{file.path!r}",
                "must have a name for each column that is read; it has one whose name"
                " is empty (rename it)",
            )
        for label in _plain_labels(header.durations):
            if label in labels and renamed[labels.index(label)] in to_read:
                raise ArgumentError(
                    f"{file.path!r}",
                    f"must hold numbers or names; {_checks.show(label)} holds durations"
                    " (write seconds: frame[label].dt.total_seconds(); or their"
                    " numbers: .astype('int64'))",
                )
    own = [label for label in to_read if label in renamed]

    def pieces() -> Iterator[Piece]:
        """Yield the pieces of the file with the columns that its folders name."""
        parts = (
            _read_csv(file.path, renamed, own)
            if header is None
            else _read_parquet(file.path, header, renamed, own)
        )
        for piece in parts:
            found = _lose_headers(file.path, piece, labels)
            found = add_folders(file, matching, found)
            yield found._replace(columns=matching.join(found.columns))

    def find_text(label: str, row: int) -> Any:
        """Return a field as a CSV file writes it."""
        if is_parquet or label not in renamed:
            return None
        fields = _find_line(_files.local(file.path), row)[1]
        k = renamed.index(label)
        return fields[k] if k < len(fields) else None

    n_rows = header.n_rows if header else None
    return Table(labels, list(matching.taken), pieces(), matching, find_text, n_rows)


def _find_header(file: LogFile, form: Any, folders: list[str]) -> int | None:
    """Return the number of one of the next lines if it is a log's header, else None."""
    path = _files.local(file.path)
    lines = itertools.islice(
        _csv_lines(path, _csv_header(path)[2]), 1, MAX_LINES_ABOVE + 1
    )
    with suppress(ArgumentError):
        for line in lines:
            with suppress(ArgumentError):
                form.match([*_plain_labels(line.fields), *folders], file.path)
                return line.number
    return None


def match_own(file: LogFile, labels: Iterable[str]) -> Matching:
    """Return the matching of a log's own labels, with those of the file's folders."""
    folders = [label for label, _ in file.fixed if label in KINDS]
    return Matching({label: (label,) for label in [*labels, *folders]})


def add_folders(file: LogFile, matching: Matching, piece: Piece) -> Piece:
    """Return a piece with the columns that the folders of its file name.

    Raises an ArgumentError where the file's own column of that name says otherwise, or
    another folder.
    """
    columns: dict[str, Column] = {}
    to_read = matching.to_read()
    for name, text in file.fixed:
        (label,) = matching.rename([name])
        if label not in to_read:
            # another label of a column that is read is no second opinion either
            label = name if name in KINDS else find_field(name, has_vectors=False) or ""
            if label not in to_read:
                continue
        value = _parse_folder(label, text)
        known = piece.columns.get(label, columns.get(label))
        if known is None:
            columns[label] = np.full(len(piece.rows), value)
            if isinstance(value, str | None):
                columns[label] = as_objects([value] * len(piece.rows))
            continue
        row = _find_other(label, known, text)
        if row is not None:
            raise ArgumentError(
                f"{file.path!r}: {label}[{piece.rows[row]}]",
                f"must be what the folder '{name}={text}' says; it is"
                f" {_checks.show(to_plain(known[row]))} (rename the folder, or"
                " give the file itself)",
            )
    return piece._replace(columns=columns | piece.columns)


def _parse_folder(label: str, text: str) -> Any:
    """Return the value that a folder's name gives to a column."""
    if text == NULL_FOLDER:
        return None
    kind = KINDS.get(label, "numbers")
    if kind == "booleans":
        flag = parse_flag(text)
        return text if flag is None else flag
    if label == "episode":
        episode = parse_episode(text)
        return text if episode is None else episode
    if not is_number_text(text) or is_absent(text):
        return text
    return int(text) if text.isdecimal() and int(text) < 2**63 else float(text)


def _find_other(label: str, raw: Column, text: str) -> int | None:
    """Return the first row of a column whose value is not that of its folder."""
    names = () if label in MOVE else None
    folder = as_objects([None if text == NULL_FOLDER else text])
    values, fault = check_column(raw, label, names=names)
    value, no_value = check_column(folder, label, names=names)
    is_none = no_value is not None or (label == "reward" and np.isnan(value[0]))
    if is_none:
        is_other = np.array([not is_absent(item) for item in raw.tolist()])
    else:
        is_other = np.asarray(values != value[0], dtype=np.bool_)
    if fault is not None:
        is_other[fault.rows] = False  # which are reported as such
    rows = np.flatnonzero(is_other)
    return int(rows[0]) if rows.size else None


def _lose_headers(path: str, piece: Piece, labels: list[str]) -> Piece:
    """Drop the rows of a piece that repeat the header, and note them as lost."""
    found = find_headers(piece.columns, labels)
    if not found.size:
        return piece
    lost = dict(piece.lost)
    for row in piece.rows[found].tolist():
        place = f"row {row}"
        if not path.lower().endswith(".parquet"):
            place += f" (line {_find_line(_files.local(path), row)[0]})"
        lost[row] = (place, HEADER_RULE)
    is_kept = np.ones(len(piece.rows), dtype=np.bool_)
    is_kept[found] = False
    columns = {label: column[is_kept] for label, column in piece.columns.items()}
    return Piece(columns, piece.rows[is_kept], dict(sorted(lost.items())))


def read_labels(path: str) -> list[str]:
    """Return the labels of a table's columns; ArgumentError for another file."""
    if not path.lower().endswith(".parquet"):
        return _csv_header(path)[0]
    return _plain_labels(read_parquet_header(path).stored)


def _plain_labels(labels: Iterable[str]) -> list[str]:
    """Return labels in Unicode's composed form: é as one character, not two."""
    return [unicodedata.normalize("NFC", label) for label in labels]


# ---- parquet


@contextmanager
def open_duckdb(path: str) -> Iterator[Callable[[str], Any]]:
    """Open a connection that reads this file alone, and give ``run(query)``.

    ``$path`` is the file in a query.
    """
    import duckdb

    name = os.path.abspath(_files.local(path))  # "://" cannot stand in it
    _files.require_regular(name)
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


class ParquetHeader(NamedTuple):
    """Hold what a parquet file says of itself.

    ``stored``: the names of its columns as they stand. ``durations``: those that
    Arrow's schema calls so, where parquet has integers without their unit.
    """

    stored: list[str]
    durations: list[str]
    n_rows: int


def read_parquet_header(path: str) -> ParquetHeader:
    """Return the header of a parquet file, with its top-level columns.

    parquet lists a tree in depth-first order.
    """
    with open_duckdb(path) as run:
        schema = run("SELECT name, num_children FROM parquet_schema($path)").fetchall()
        arrow = run(
            "SELECT value FROM parquet_kv_metadata($path)"
            " WHERE key = 'ARROW:schema'::BLOB LIMIT 1"
        ).fetchone()
        n_rows = int(run(f"SELECT count(*) FROM {PARQUET}").fetchone()[0])
    labels = []
    n_inside = 0
    for name, children in schema[1:]:
        if n_inside == 0:
            labels.append(name)
        n_inside += (children or 0) - (n_inside > 0)
    durations: list[str] = []
    if arrow is not None:
        # of another form it may be another program's
        with suppress(ValueError, IndexError, struct.error):
            durations = _durations_of(base64.b64decode(bytes(arrow[0])))
    return ParquetHeader(labels, durations, n_rows)


# where fields stand in the tables of Arrow's Message.fbs and Schema.fbs: the first at
# 4, the next one at 6, and so on
_MESSAGE_HEADER, _SCHEMA_FIELDS, _FIELD_NAME, _FIELD_TYPE = 8, 6, 4, 8
_DURATION = 18  # among the types of Schema.fbs


def _durations_of(message: bytes) -> list[str]:
    """Return the names of the durations in an Arrow schema [1], a flatbuffer [2].

    [1] Apache Arrow, columnar format, 1.4. [2] FlatBuffers, binary format.
    """

    def at(kind: str, place: int) -> int:
        """Return the number at a place of the message."""
        return int(struct.unpack_from(f"<{kind}", message, place)[0])

    def field(table: int, number: int) -> int:
        """Return the place of a field of a table, 0 where it has its default."""
        offsets = table - at("i", table)
        is_there = number < at("H", offsets)
        shift = at("H", offsets + number) if is_there else 0
        return table + shift if shift else 0

    def follow(place: int) -> int:
        """Return the place that the offset at a place leads to."""
        return place + at("I", place)

    # a mark of four bytes and the length stand before the message
    message = message[8:] if message[:4] == b"\xff" * 4 else message[4:]
    schema = follow(field(follow(0), _MESSAGE_HEADER))
    fields = follow(field(schema, _SCHEMA_FIELDS))
    names = []
    for k in range(min(at("I", fields), len(message) // 4)):
        column = follow(fields + 4 + 4 * k)
        kind = field(column, _FIELD_TYPE)
        if kind and message[kind] == _DURATION:
            text = follow(field(column, _FIELD_NAME))
            start = text + 4
            names.append(message[start : start + at("I", text)].decode())
    return names


def sum_groups(
    path: str, names: Mapping[str, str], ends: Sequence[str] = (), n_ends: int = 0
) -> tuple[dict[str, Column], list[dict[str, Column]]] | None:
    """Return the columns of ``sum_rows`` of a parquet file, summed by DuckDB.

    ``names``: the file's label of each column of a log. Truncated transitions are
    apart; of other columns there are least, largest and number in each. It takes half
    of the time of the pieces. Beside the sums are the columns ``ends`` of the first and
    the last ``n_ends`` rows. None where DuckDB cannot compute them, which a look at the
    values will explain.
    """
    import duckdb

    key = [label for label in (*KEY, "truncated") if label in names]
    others = [label for label in names if label not in key]
    parts = [*key, "count(*) AS count"]
    if "reward" in names:
        parts.append("coalesce(sum(reward), 0) AS reward_sum")
    for label in others:
        parts += [f"{how}({label}) AS {label}_{how}" for how in ("min", "max", "count")]
    selected = ", ".join(parts)
    renamed = ", ".join(
        f"{quote_label(own)} AS {label}" for label, own in names.items()
    )
    source = f"(SELECT {renamed} FROM {PARQUET})"
    query = f"SELECT {selected} FROM {source} GROUP BY {', '.join(key)}"
    with open_duckdb(path) as run:
        try:
            groups = run(query).fetchnumpy()
        except (duckdb.ConversionException, duckdb.BinderException):
            return None
        n_rows = int(groups["count"].sum())
        spans = [(0, n_rows)]
        if 2 * n_ends < n_rows:
            spans = [(0, n_ends), (n_rows - n_ends, n_rows)]
        chosen = ", ".join(
            f"{quote_label(names[label])} AS {label}"
            for label in ends
            if label in names
        )
        found = [
            run(
                f"SELECT {chosen} FROM {PARQUET} LIMIT {stop - start} OFFSET {start}"
            ).fetchnumpy()
            for start, stop in (spans if n_ends else ())
        ]
    return (
        {label: fill_missing(column) for label, column in groups.items()},
        [
            {label: fill_missing(column) for label, column in part.items()}
            for part in found
        ],
    )


def _read_parquet(
    path: str, header: ParquetHeader, labels: list[str], chosen: list[str]
) -> Iterator[Piece]:
    """Yield the pieces of a parquet file, whose columns are called ``labels``."""
    stored = header.stored
    columns = ", ".join(quote_label(stored[labels.index(label)]) for label in chosen)
    source = PARQUET.replace(")", ", file_row_number = true)")
    which = "WHERE file_row_number >= {start} AND file_row_number < {stop}"
    if any(label.lower() == "file_row_number" for label in stored):
        # DuckDB's own column cannot stand beside it; this way reads rows twice
        source = PARQUET
        which = "LIMIT {size} OFFSET {start}"
    n_rows = header.n_rows
    with open_duckdb(path) as run:
        for start in range(0, n_rows, N_PARQUET_ROWS):
            stop = min(start + N_PARQUET_ROWS, n_rows)
            some = which.format(start=start, stop=stop, size=stop - start)
            found = run(f"SELECT {columns} FROM {source} {some}").fetchnumpy()
            values = [fill_missing(column) for column in found.values()]
            piece = dict(zip(chosen, values, strict=True))
            yield Piece(piece, np.arange(start, stop), {})


def fill_missing(column: Any) -> Column:
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
    with _files.open_regular(path) as handle:
        n_before = max(os.fstat(handle.fileno()).st_size - TAIL_BYTES, 0)
        handle.seek(n_before)
        start, mark, rest = handle.read().rpartition(DIGEST_MARK)
        if not mark:  # another program's, or a file of ours whose mark is damaged
            is_ours = any(remnant in rest for remnant in DIGEST_REMNANTS)
            return b"", DIGEST_KEY if is_ours else b"", -1
        digest = hashlib.sha256()
        handle.seek(0)
        for k in range(0, n_before, TAIL_BYTES):
            digest.update(handle.read(min(TAIL_BYTES, n_before - k)))
        digest.update(start + mark + EMPTY_DIGEST + rest[64:])
    return rest[:64], digest.hexdigest().encode(), n_before + len(start + mark)


def quote_text(text: str) -> str:
    """Return a text quoted for SQL."""
    return "'" + text.replace("'", "''") + "'"


def quote_label(label: str) -> str:
    """Return the name of a column quoted for SQL."""
    return '"' + label.replace('"', '""') + '"'


# ---- CSV


@contextmanager
def open_csv(path: str, encoding: str | None = None) -> Iterator[Any]:
    """Open a file, or what is compressed in it, as bytes or as text of an encoding."""
    with ExitStack() as stack:
        handle: Any = stack.enter_context(_files.open_regular(path))
        if path.lower().endswith(".gz"):
            handle = stack.enter_context(gzip.GzipFile(fileobj=handle))
        if encoding is not None:
            handle = io.TextIOWrapper(handle, encoding=encoding, newline="")
            stack.enter_context(handle)
        yield handle


@contextmanager
def _csv_errors(path: str) -> Iterator[None]:
    """Turn errors of reading into an ArgumentError that names the file."""
    try:
        yield
    except ArgumentError:
        raise
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
        # pandas has no class of its own for what its parser cannot allocate
        if str(error).endswith("out of memory"):
            raise MemoryError(f"{path!r} has more rows than memory holds") from None
        raise ArgumentError(
            f"{path!r}", f"must be a CSV table with a header; {error}"
        ) from None


class Line(NamedTuple):
    """Hold the fields of a CSV line, or the rule that the line breaks."""

    number: int
    fields: list[str]
    problem: str = ""


def _csv_header(path: str) -> tuple[list[str], list[str], str]:
    """Return the labels, the first values and the encoding of a CSV file."""
    with _csv_errors(path):
        with open_csv(path) as handle:
            start = handle.read(4)
        mark = start[:3]
        if mark[:2] == b"\xfe\xff":
            raise ValueError(
                "it is UTF-16 of the order that few programs write (save it as UTF-8)"
            )
        # a letter of a label takes two bytes there, or four
        is_wide = mark[:2] != b"\xff\xfe" or start[2:] == b"\0\0"
        if b"\0" in start and is_wide:
            raise ValueError(
                "it is UTF-32, or UTF-16 without a byte order mark (save it as UTF-8)"
            )
    encoding = "utf-8"
    if mark[:2] == b"\xff\xfe":
        encoding = "utf-16"
    elif mark == b"\xef\xbb\xbf":
        encoding = "utf-8-sig"
    lines = _csv_lines(path, encoding)
    header = next(lines, Line(1, []))
    if header.problem:
        raise ArgumentError(f"{path!r}: line {header.number}", header.problem)
    return _plain_labels(header.fields), next(lines, header).fields, encoding


def _csv_lines(path: str, encoding: str) -> Iterator[Line]:
    """Yield each line that is not empty."""
    wrong: dict[int, str] = {}
    number = 0
    last = 0  # the last line that is not blank
    with _csv_errors(path), open_csv(path, encoding) as handle:
        reader = csv.reader(_lines_of_whole_fields(handle, wrong), strict=True)
        try:
            for number, fields in enumerate(reader, 1):
                if number in wrong:
                    last = number
                    yield Line(number, [], wrong.pop(number))
                elif fields:
                    last = number
                    yield Line(number, fields)
                elif number - last > MAX_BLANK_LINES:
                    raise ValueError(
                        f"from line {last + 1} on, more than {MAX_BLANK_LINES} lines in"
                        " a row are blank (leave them out)"
                    )
        except csv.Error as error:
            raise ValueError(f"of line {number + 1}, {error}") from None


def _lines_of_whole_fields(handle: Any, wrong: dict[int, str]) -> Iterator[str]:
    """Yield the lines of a text; those with an open quote are blank, and ``wrong``."""
    number = 0
    while text := handle.readline(MAX_LINE_CHARACTERS + 1):
        number += 1
        if len(text) > MAX_LINE_CHARACTERS:
            raise ValueError(
                f"line {number} has more than {MAX_LINE_CHARACTERS} characters"
            )
        if '"' in text and not _has_whole_fields(text):
            wrong[number] = (
                "must close each quote in its own line, before a comma or the line's"
                f" end; it is {_checks.show(text.rstrip()[:100])} (a quote inside of"
                ' quotes is written "", and no field has a line break)'
            )
            text = "\n"
        yield text


def _has_whole_fields(text: str) -> bool:
    """Return whether all quotes of a line close in it, at the end of a field."""
    try:
        return len(list(csv.reader([text], strict=True))) == 1
    except csv.Error:
        return False


def _read_csv(path: str, labels: list[str], chosen: list[str]) -> Iterator[Piece]:
    """Yield the values that pandas makes of the fields; names stay texts.

    Of a small file, and from an odd line on, they are the fields, read by Python.
    """
    _, first, encoding = _csv_header(path)
    n_read = 0
    if not _is_small(path):
        with _csv_errors(path), open_csv(path, encoding) as text:
            is_plain = encoding != "utf-16"
            blocks = _Blocks(text.buffer if is_plain else _Recoded(text), len(labels))
            if encoding == "utf-8-sig":
                text.buffer.read(3)
            for piece in _read_blocks(blocks, labels, chosen, first):
                n_read += len(piece.rows)
                yield piece
        if not blocks.is_odd:
            return
    yield from _read_lines(path, labels, chosen, encoding, n_read)


def _is_small(path: str) -> bool:
    """Return whether a file, unpacked, is as small as Python reads quickly."""
    if not path.lower().endswith(".gz"):
        return os.path.getsize(path) < MAX_SMALL_BYTES
    with _csv_errors(path), open_csv(path) as handle:
        return len(handle.read(MAX_SMALL_BYTES)) < MAX_SMALL_BYTES


class _Recoded:
    """Read a text as bytes in UTF-8."""

    def __init__(self, text: Any) -> None:
        self.text = text

    def read(self, size: int) -> bytes:
        """Return about the given number of bytes."""
        data: bytes = self.text.read(size).encode()
        return data

    def readline(self, size: int) -> bytes:
        """Return the rest of the line, at most the given number of characters."""
        data: bytes = self.text.readline(size).encode()
        return data


class _Blocks:
    """Read whole lines of n fields each for pandas, up to the first odd line.

    A line is odd where pandas might make something else of it than Python does: by its
    number of fields, a quote that spans lines, or a null character. ``is_odd`` says
    whether there was one.
    """

    mode = "r"  # pandas takes bytes as they are, without a text wrapper

    def __init__(self, handle: Any, n: int) -> None:
        self.handle = handle
        self.n = n
        self.is_odd = False
        self.block = b""

    def __iter__(self) -> Iterator[bytes]:
        return iter(self.read, b"")

    def read(self, size: int = -1) -> bytes:
        """Return the next block of lines; empty at the end."""
        block, self.block = self.block, b""
        return block if block or not self.has_next() else self.read()

    def has_next(self) -> bool:
        """Read the next block, and say whether there is one that is not odd."""
        if self.is_odd or self.block:
            return bool(self.block)
        block: bytes = self.handle.read(BLOCK_BYTES)
        if block and not block.endswith(b"\n"):
            rest: bytes = self.handle.readline(MAX_LINE_CHARACTERS)
            # a line that is not whole here is Python's
            self.is_odd = len(rest) == MAX_LINE_CHARACTERS
            block += rest
        self.is_odd |= bool(block) and not _is_regular(block, self.n)
        self.block = b"" if self.is_odd else block
        return bool(self.block)


def _is_regular(block: bytes, n: int) -> bool:
    """Return whether each line has n fields, none of which spans lines.

    It counts commas, and reads the fields only where that does not tell.
    """
    if not block.isascii():
        block.decode()  # an error where it is no UTF-8
    if len(block) > WINDOW_BYTES and not block.strip(b"\r\n"):
        return False  # blank lines, of which Python refuses very many
    for start in range(0, len(block) - WINDOW_BYTES, WINDOW_BYTES):
        if block.find(b"\n", start, start + WINDOW_BYTES) < 0:
            return False  # a line that Python may refuse
    whole = block if block.endswith(b"\n") else block + b"\n"
    marks = whole.translate(None, OTHER_BYTES)
    for end in (b"\n", b"\r\n"):
        line = b"," * (n - 1) + end
        if marks == line * (len(marks) // len(line)):
            return True
    if b"\0" in block:
        return False
    reader = csv.reader(io.StringIO(block.decode(), newline=""), strict=True)
    try:
        for number, fields in enumerate(reader, 1):
            if len(fields) not in (0, n) or reader.line_num != number:
                return False
    except csv.Error:
        return False
    return True


def _read_blocks(
    blocks: _Blocks, labels: list[str], chosen: list[str], first: list[str]
) -> Iterator[Piece]:
    """Yield what pandas makes of blocks of lines.

    It ends where a column looks like flags that is none, which is odd.
    """
    places = {label: str(labels.index(label)) for label in chosen}
    types: dict[str, Any] = {}
    if "episode" in places:
        types[places["episode"]] = object  # "7" and "007" differ
    for label in MOVE:
        number = labels.index(label) if label in places else len(first)
        if number < len(first) and not is_number_text(first[number] or "0"):
            types[places[label]] = str
    words = {form(word) for word in MISSING_WORDS for form in (str.lower, str.upper)}
    words |= {"NaN", "-NaN", "Null", "None", "<Na>", "\\N"}
    absent = {
        k: list(words) if KINDS.get(label, "numbers") == "numbers" else [""]
        for label, k in places.items()
    }
    options = {
        "names": [str(k) for k in range(len(labels))],
        "usecols": list(places.values()),
        "header": 0,
        "dtype": types,
        "encoding": "utf-8",
        "chunksize": N_CSV_ROWS,
        "keep_default_na": False,
        "na_values": absent,
        "low_memory": False,
    }
    if not blocks.has_next():
        return
    for frame in _call_pandas(blocks, **options):
        columns = {}
        for label, place in places.items():
            is_text = frame[place].dtype == "str"
            column = frame[place].to_numpy(object if is_text else None)
            if column.dtype.kind == "b" and KINDS.get(label) != "booleans":
                blocks.is_odd = True  # its texts are lost
                return
            columns[label] = column
        if "episode" in columns:
            columns["episode"] = _parse_runs(columns["episode"])
        yield Piece(columns, frame.index.to_numpy(), {})


def _parse_runs(texts: Column) -> Column:
    """Return texts as integers where all are integers, each run of equal ones once."""
    is_first = np.ones(len(texts), dtype=np.bool_)
    is_first[1:] = texts[1:] != texts[:-1]
    starts = np.flatnonzero(is_first)
    lengths = np.diff(starts, append=len(texts))
    words = texts[starts].tolist()
    try:
        # most ids are integers as Python writes them, which needs no look at each
        numbers = list(map(int, words))
        if list(map(str, numbers)) == words:
            return np.repeat(np.array(numbers, dtype=np.int64), lengths)
    except (TypeError, ValueError, OverflowError):
        pass  # missing, a text, or beyond 64 bits
    found = [parse_episode(word) for word in words]
    if not all(type(item) is int for item in found):
        return texts
    return np.repeat(np.array(found, dtype=np.int64), lengths)


def _read_lines(
    path: str, labels: list[str], chosen: list[str], encoding: str, start: int
) -> Iterator[Piece]:
    """Yield the fields of the lines from row ``start`` on as texts."""
    n = len(labels)
    places = {label: labels.index(label) for label in chosen}
    every = enumerate(itertools.islice(_csv_lines(path, encoding), 1, None))
    lines = itertools.islice(every, start, None)
    while some := list(itertools.islice(lines, N_CSV_ROWS)):
        good = [(row, line.fields) for row, line in some if len(line.fields) == n]
        lost = {
            row: (
                f"row {row} (line {line.number})",
                line.problem
                or f"must have {n} fields, as the header has; it has {len(line.fields)}",
            )
            for row, line in some
            if len(line.fields) != n
        }
        columns = {
            label: np.array([fields[k] or None for _, fields in good], object)
            for label, k in places.items()
        }
        yield Piece(columns, np.array([row for row, _ in good], dtype=np.int64), lost)


def _find_line(path: str, row: int) -> Line:
    """Return the line of a row."""
    lines = _csv_lines(path, _csv_header(path)[2])
    return next(itertools.islice(lines, row + 1, None), Line(0, []))


def describe_row(path: str, row: int) -> str:
    """Return the place of a row of a CSV file in words, ``row 3 (line 5)``."""
    return f"row {row} (line {_find_line(_files.local(path), row).number})"


def csv_frame(path: str, *, has_flags: bool = True) -> Any:
    """Read a CSV file with a header as a DataFrame, its numbers to the last bit.

    Names are texts as they are written, and an empty field is missing. ``has_flags``:
    whether true and false are flags, not names. Raises an ArgumentError for another
    file, and for a line that has other fields.
    """
    labels, _, encoding = _csv_header(path)
    named = [label for label in labels if label]
    if len(labels) > MAX_COLUMNS or len(set(named)) < len(named):
        raise ArgumentError(
            f"{path!r}",
            f"must have at most {MAX_COLUMNS} columns that differ; it has"
            f" {_checks.show(', '.join(labels)[:100])}",
        )
    for row, line in enumerate(itertools.islice(_csv_lines(path, encoding), 1, None)):
        problem = line.problem
        if not problem and len(line.fields) != len(labels):
            problem = (
                f"must have {len(labels)} fields, as the header has; it has"
                f" {len(line.fields)}"
            )
        if not problem and line.fields == labels:
            problem = HEADER_RULE
        if problem:
            raise ArgumentError(f"{path!r}: row {row} (line {line.number})", problem)
    with _csv_errors(path), open_csv(path) as handle:
        frame = _call_pandas(
            handle, encoding=encoding, keep_default_na=False, na_values=[""]
        )
    flags = [label for label in frame if frame[label].dtype.kind == "b"]
    if flags and not has_flags:
        with _csv_errors(path), open_csv(path) as handle:
            texts = _call_pandas(handle, encoding=encoding, dtype=str)
        frame[flags] = texts[flags]
    # a label that is empty has the name that pandas gives it
    frame.columns = [
        label or own for label, own in zip(labels, frame.columns, strict=True)
    ]
    texts = [label for label in frame if frame[label].dtype.kind not in "biuf"]
    return frame.assign(
        **{label: frame[label].map(to_plain, na_action="ignore") for label in texts}
    )


def _call_pandas(handle: Any, **options: Any) -> Any:
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
