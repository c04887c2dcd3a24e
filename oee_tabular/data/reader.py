"""CSV and parquet files of a log, read by DuckDB: one table of checked values for all that is made of a file.

Each column of a file becomes an expression in SQL whose value is that of the log's column, and NULL where the file's value
is none of it. Whoever reads the table asks ``Table.describe`` for the words to a row that has such a NULL.

DuckDB reads one file in one thread, in the order of its rows: the same file gives the same bits. It may open that file alone,
loads no extension, and sees no column of a CSV file by its name.
"""

from __future__ import annotations

import csv
import gzip
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._checks import Column
from oee_tabular.data.digests import check_digest, quote_text
from oee_tabular.data.labels import MOVE
from oee_tabular.data.values import (
    HELD,
    INTEGER_TYPES,
    KINDS,
    NAMES_HINT,
    RULES,
    has_kind,
    is_number,
    show_value,
    sql_value,
)

Result = TypeVar("Result")

MOST_COLUMNS = 10_000  # of a CSV table, which DuckDB reads in 1 s; of 10^5 it would be 8 s


class LogFile(NamedTuple):
    """A file of a log, and the columns that its folders name, ``column=value``."""

    path: str
    fixed: tuple[tuple[str, str], ...] = ()

    @property
    def suffix(self) -> str:
        """.csv, .parquet or .npz; .csv of a compressed one."""
        path = Path(self.path.lower())
        return Path(path.stem).suffix if path.suffix == ".gz" else path.suffix


class NotPlain(Exception):
    """A CSV file that was read as numbers has something else: it is to be read as texts."""


@dataclass
class Table:
    """A file as DuckDB sees it: ``columns``: label -> (type, expression, kind), ``labels``: all that the file has.

    ``is_plain``: a CSV file whose numbers DuckDB makes itself, in half of the time; whatever is odd raises ``NotPlain``.
    """

    connection: Any
    file: LogFile
    source: str
    row: str
    parameters: dict[str, Any]
    columns: dict[str, tuple[str, str, str]]
    labels: list[str]
    is_plain: bool = False
    lost: list[tuple[int, str]] = field(default_factory=list)  # rows of other lengths, by their number, in words

    @property
    def rows(self) -> str:
        """The SQL of the checked values, in the order of the file, with ``row``, their number."""
        values = [f"{sql_value(*column)} AS {_quoted(label)}" for label, column in self.columns.items()]
        return f"(SELECT {self.row} AS row, {', '.join(values)} FROM {self.source})"

    def fetch(self, query: str, **parameters: Any) -> dict[str, Any]:
        """The columns of a query's result; errors in this package's words."""
        return self._run(query, parameters).fetchnumpy()  # type: ignore[no-any-return]

    def value(self, label: str, row: int) -> Any:
        """What the file has in a row of a column."""
        if self.is_plain:
            raise NotPlain
        raw = f"(SELECT {self.row} AS row, {self.columns[label][1]} AS raw FROM {self.source})"
        result = self._run(f"SELECT raw FROM {raw} WHERE row = $wanted LIMIT 1", {"wanted": row}).fetchone()
        return None if result is None else result[0]

    def file_row(self, row: int) -> int:
        """The number in the file of a row of the table, which lacks the lost ones."""
        for lost, _ in self.lost:
            row += lost <= row
        return row

    def describe(self, label: str, row: int, rule: str = "", hint: str = "") -> str:
        """The place, the rule that a value breaks, and the value; ``rule``: of a value of the column's kind."""
        raw, kind = self.value(label, row), self.columns[label][2]
        place = f"{label}[{self.file_row(row)}]"
        if raw is None or (isinstance(raw, float) and math.isnan(raw)):
            return f"{place} must have a value; it has none"
        if not rule or not has_kind(raw, kind):
            rule = RULES.get(kind, "must be a value")
            if kind == "number" and isinstance(raw, str) and re.fullmatch(r"\s*-?\d+,\d+\s*", raw):
                hint = " (write a decimal point, not a comma)"
        return f"{place} {rule}; it is {show_value(raw)}{hint}"

    def _run(self, query: str, parameters: Mapping[str, Any]) -> Any:
        import duckdb

        used = {name: value for name, value in (self.parameters | dict(parameters)).items() if f"${name}" in query}
        try:
            return self.connection.execute(query, used)
        except duckdb.OutOfMemoryException:
            raise MemoryError(f"{self.file.path!r} has more different transitions than memory holds") from None
        except duckdb.Error as error:
            if self.is_plain:
                raise NotPlain from None
            raise ValueError(_words(self, error)) from None


def use_table(use: Callable[[Table], Result], file: LogFile, is_known: Callable[[str], bool], **options: Any) -> Result:
    """``use(table)`` of a file, whose CSV is read as numbers first, and as texts where something in it is none."""
    try:
        with open_table(file, is_known, is_plain=True, **options) as table:
            return use(table)
    except NotPlain:
        with open_table(file, is_known, **options) as table:
            return use(table)


@contextmanager
def open_table(
    file: LogFile,
    is_known: Callable[[str], bool],
    *,
    named: Sequence[str] = (),
    drop: bool = False,
    columns: Mapping[str, Column] | None = None,
    is_plain: bool = False,
) -> Iterator[Table]:
    """The table of a file's known columns.

    Parameters
    ----------
    named : columns that may hold names: they are texts where the first value is no number
    drop : whether to leave rows out that have another number of fields than the header (they are in ``lost``)
    columns : of a log that is in memory, in place of the file's

    Raises
    ------
    ValueError
        Names the file, for what is no table, has a column twice or of another type.
    """
    import duckdb

    path = os.path.abspath(_files.local(file.path))  # "://" cannot stand in it
    pattern = re.sub(r"([*?\[])", r"[\1]", path)  # a name is no pattern
    settings: dict[str, Any] = {
        "threads": 1, "preserve_insertion_order": True, "autoinstall_known_extensions": False,
        "autoload_known_extensions": False, "temp_directory": "",
    }  # fmt: skip
    with duckdb.connect(":memory:", config=settings) as connection:
        connection.execute(f"SET allowed_paths = [{quote_text(path)}, {quote_text(pattern)}]")
        connection.execute("SET enable_external_access = false")
        connection.execute("SET lock_configuration = true")
        fixed = {f"fixed_{k}": value for k, (_, value) in enumerate(file.fixed)}
        table = Table(connection, file, "", "row_number() OVER () - 1", {"path": pattern} | fixed, {}, [])
        if columns is not None:
            found = _memory_columns(table, columns)
        else:
            is_csv = file.suffix != ".parquet"
            found = _csv_columns(table, is_known, is_plain) if is_csv else _parquet_columns(table)
        _refuse_twice(table, is_known)
        found = {label: column for label, column in found.items() if is_known(label)}
        for k, (label, _) in enumerate(file.fixed):
            found.setdefault(label, ("VARCHAR", f"$fixed_{k}::VARCHAR"))
        if drop and columns is None and file.suffix == ".csv" and not table.is_plain:
            _find_lost_rows(table)
        for label, (kind, raw) in found.items():
            table.columns[label] = (kind, raw, _kind(table, label, kind, raw, label in named or label == "episode"))
        yield table


def _memory_columns(table: Table, columns: Mapping[str, Column]) -> dict[str, tuple[str, str]]:
    import pandas as pd

    table.connection.register("log_in_memory", pd.DataFrame(dict(columns)))
    table.source, table.labels = "log_in_memory", list(columns)
    return {label: (kind, _quoted(label)) for label, kind in _types(table)}


def _parquet_columns(table: Table) -> dict[str, tuple[str, str]]:
    check_digest(table.file.path)
    table.source = "read_parquet($path, file_row_number = true, hive_partitioning = false, union_by_name = false)"
    table.row = "file_row_number"
    schema = table._run("SELECT name, num_children FROM parquet_schema($path)", {}).fetchall()
    table.labels = _top_level(schema)
    types = _types(table)[: len(table.labels)]
    return {label: (kind, _quoted(name)) for label, (name, kind) in zip(table.labels, types, strict=True)}


def _types(table: Table) -> list[tuple[str, str]]:
    return [(name, kind) for name, kind, *_ in table._run(f"DESCRIBE SELECT * FROM {table.source}", {}).fetchall()]


def _top_level(schema: list[tuple[str, int | None]]) -> list[str]:
    """The names of the columns, without those inside of others: parquet lists a tree in depth-first order."""
    labels, open_children = [], [(schema[0][1] or 0) if schema else 0]
    for name, children in schema[1:]:
        if len(open_children) == 1:
            labels.append(name)
        open_children[-1] -= 1
        if children:
            open_children.append(children)
        while len(open_children) > 1 and open_children[-1] == 0:
            open_children.pop()
    return labels


def _csv_columns(table: Table, is_known: Callable[[str], bool], is_plain: bool) -> dict[str, tuple[str, str]]:
    skipped, labels, encoding = _csv_header(table.file.path)
    table.is_plain = is_plain and encoding == "utf-8" and _has_plain_numbers(table.file.path)
    if len(labels) > MOST_COLUMNS:
        raise ValueError(
            f"{table.file.path!r} must have at most {MOST_COLUMNS} columns; it has {len(labels)} (keep those that a log has)"
        )
    table.labels = labels
    table.parameters |= {
        "encoding": encoding, "skipped": skipped, "packed": "gzip" if table.file.path.lower().endswith(".gz") else "none",
    }  # fmt: skip
    types = [_csv_type(label, is_number=table.is_plain and is_known(label)) for label in labels]
    table.source = _csv_source(types, is_strict=True)
    return {label: (held, f"c{k}") for k, (label, held) in enumerate(zip(labels, types, strict=True))}


def _csv_type(label: str, *, is_number: bool) -> str:
    """What DuckDB is to make of a field: of episodes, which may be large integers, and of flags it makes too much."""
    return "DOUBLE" if is_number and label != "episode" and KINDS.get(label, "number") != "flag" else "VARCHAR"


def _has_plain_numbers(path: str) -> bool:
    """Whether no line of a file but its first has an underscore, which DuckDB would overlook in a number."""
    if path.lower().endswith(".gz"):
        return False
    with open(path, "rb") as handle:
        handle.readline()
        return not any(b"_" in block for block in iter(lambda: handle.read(2**20), b""))


def _csv_source(types: Sequence[str], *, is_strict: bool) -> str:
    names = ", ".join(f"c{k}: '{held}'" for k, held in enumerate(types))
    lenient = "" if is_strict else ", ignore_errors = true, store_rejects = true"
    return (
        f"read_csv($path, auto_detect = false, header = true, delim = ',', quote = '\"', escape = '\"', nullstr = '', "
        f"skip = $skipped, compression = $packed, encoding = $encoding, columns = {{{names}}}{lenient})"
    )


def csv_labels(path: str) -> list[str]:
    """The labels of a CSV file's header: its first line that is not empty."""
    return _csv_header(_files.local(path))[1]


def _csv_header(name: str) -> tuple[int, list[str], str]:
    """How many empty lines stand before the header, its labels, and the encoding."""
    opened: Any = gzip.open if name.lower().endswith(".gz") else open
    try:
        with opened(name, "rb") as handle:
            mark = handle.read(2)
        if mark == b"\xfe\xff":
            raise ValueError("it is UTF-16 of the order that few programs write (save it as UTF-8)")
        encoding = "utf-16" if mark == b"\xff\xfe" else "utf-8"
        with opened(name, "rt", encoding="utf-16" if encoding == "utf-16" else "utf-8-sig", newline="") as handle:
            reader = csv.reader(handle)
            for skipped, row in enumerate(reader):
                if row:
                    return skipped, row, encoding
    except UnicodeDecodeError:
        raise ValueError(f"{name!r} must be a CSV table with a header, in UTF-8; its header is not") from None
    except (csv.Error, EOFError, ValueError, gzip.BadGzipFile) as error:
        raise ValueError(f"{name!r} must be a CSV table with a header; {error}") from None
    return 0, [], "utf-8"


def parquet_labels(path: str) -> list[str]:
    """The names of a parquet table's columns; ValueError for another file."""
    with open_table(LogFile(path), lambda label: False) as table:
        return table.labels


def _find_lost_rows(table: Table) -> None:
    """Read once for the rows that have another number of fields than the header, and leave them out from then on."""
    table.source = _csv_source(["VARCHAR"] * len(table.labels), is_strict=False)
    table.fetch(f"SELECT count(c0) AS n FROM {table.source}")
    rejected = table._run("SELECT line, error_message FROM reject_errors ORDER BY line", {}).fetchall()
    first = table.parameters["skipped"] + 2  # line of the first row
    lost = {int(line): message for line, message in reversed(rejected)}
    table.lost = [(line - first, _fields(message)) for line, message in sorted(lost.items())]


def _fields(message: str) -> str:
    """What is wrong with a line of CSV, from what DuckDB says of it."""
    numbers = re.search(r"Expected Number of Columns: (\d+) Found: (\d+)", message)
    if numbers:
        expected, found = int(numbers[1]), int(numbers[2])
        more = " or more" if found > expected else ""
        return f"must have {expected} fields, as the header has; it has {found}{more}"
    if "unicode" in message or "utf-8" in message:
        return "must be UTF-8; it is not"
    if "quote" in message:
        return "must close its quotes; it does not"
    return "must be a line of CSV; it is not"


def _words(table: Table, error: Exception) -> str:
    """DuckDB's error in this package's words: the file, the line, what is wrong."""
    text, name = str(error), table.file.path
    if table.file.suffix == ".csv":
        line = re.search(r"Line: (\d+)", text)
        if line:
            row = int(line[1]) - table.parameters["skipped"] - 2
            return f"{name!r}: row {row} (line {line[1]}) {_fields(text)}"
        return f"{name!r} must be a CSV table with a header, whose lines all end alike; it is not, or is damaged"
    return f"{name!r} must be a parquet table; it is not, or is damaged ({text.splitlines()[0]:.200})"


def _refuse_twice(table: Table, is_known: Callable[[str], bool]) -> None:
    """A known column stands once, also for who does not tell capitals (DuckDB does not)."""
    first: dict[str, str] = {}
    for label in table.labels:
        lower = label.lower()
        if is_known(lower) and lower in first:
            twice = f"it has {label!r} twice" if first[lower] == label else f"it has {first[lower]!r} and {label!r}"
            raise ValueError(f"{table.file.path!r} must have columns that differ; {twice}")
        first.setdefault(lower, label)


def _kind(table: Table, label: str, held: str, raw: str, may_be_text: bool) -> str:
    """integer, number, flag or text; ValueError for a column of a type that is none of it."""
    kind = KINDS.get(label, "number")
    if held == "VARCHAR" and may_be_text:
        first = table._run(f"SELECT {raw} FROM {table.source} WHERE {raw} IS NOT NULL LIMIT 1", {}).fetchone()
        if first is not None and not is_number(first[0]):
            return "text"
    is_numeric = re.fullmatch(f"{INTEGER_TYPES}|FLOAT|DOUBLE|U?HUGEINT|DECIMAL.*", held)
    is_text = held == "VARCHAR" and (table.file.suffix == ".csv" or table.source == "log_in_memory")
    is_fixed = raw.startswith("$")
    if not (is_numeric or is_text or is_fixed or (kind == "flag" and held == "BOOLEAN")):
        hint = NAMES_HINT if held == "VARCHAR" and label in MOVE else ""
        raise ValueError(
            f"column {label!r} of {table.file.path!r} must hold {HELD[kind]}; it holds {held.replace('VARCHAR', 'texts')}{hint}"
        )
    return kind


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def read_columns(
    file: LogFile, is_known: Callable[[str], bool], required: Callable[[Sequence[str]], None]
) -> tuple[dict[str, Column], list[str]]:
    """The known columns of a file, whole, and all its labels; a reward that is missing is nan.

    ``required`` raises where the labels are those of no log.
    """

    def read(table: Table) -> tuple[dict[str, Column], list[str]]:
        required([*table.labels, *(label for label, _ in file.fixed)])
        if file.suffix == ".parquet":
            rows = int(table.fetch(f"SELECT count(*) AS n FROM {table.source}")["n"][0])
            _checks.require_memory(rows * len(table.columns), repr(file.path))
        names = ", ".join(map(_quoted, table.columns))
        columns = table.fetch(f"SELECT {names} FROM {table.rows}")
        return {label: _whole_column(table, label, column) for label, column in columns.items()}, table.labels

    return use_table(read, file, is_known, named=MOVE)


def _whole_column(table: Table, label: str, column: Any) -> Column:
    """A column with a value in every row, but for rewards; ValueError for the first row without one."""
    absent = np.ma.getmaskarray(column)
    values = np.ma.getdata(column)
    if label == "reward":
        values = np.where(absent, np.nan, values)
        absent = np.isinf(values)
    elif values.dtype.kind == "f":
        absent = absent | ~np.isfinite(values)
    rows = np.flatnonzero(absent)
    if rows.size:
        more = f" ({rows.size} such rows in all)" if rows.size > 1 else ""
        raise ValueError(f"{table.file.path!r}: {table.describe(label, int(rows[0]))}{more}")
    return np.asarray(values)
