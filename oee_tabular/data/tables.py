"""Tables in CSV and parquet files: the columns that are known, and words for what is no such table."""

from __future__ import annotations

import csv
import difflib
import importlib.util
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._checks import Column

WIDE = 1000  # columns from which on only the known ones are read: pandas then overlooks a row with more fields than the header
NAMED = 10  # of the columns that are left out
PLAIN = 2**20  # bytes that numpy reads about as quickly as pandas is imported
WORDS = ({"True", "False"}, {"0", "1"})
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}


def require_module(module: str, extra: str) -> None:
    """ImportError that names the extra where a module is missing."""
    if importlib.util.find_spec(module) is None:
        raise ImportError(f"{module} is not installed; in a clone: pip install '.[{extra}]'")


def plain_csv(path: str, types: Mapping[str, str]) -> dict[str, Column] | None:
    """The columns of a small CSV file that has some of ``types`` alone: finite numbers, and flags, which "U6" stands for.

    By numpy, which saves a quarter of a second of importing pandas; None for all other files, which pandas reads.
    """
    name = _files.local(path)
    if os.path.getsize(name) > PLAIN:
        return None
    try:
        labels = csv_header(name)
        if not labels or len({*labels} & types.keys()) < len(labels):
            return None
        with open(name, encoding="utf-8-sig") as handle, warnings.catch_warnings():
            warnings.simplefilter("error")  # no rows; a whole number by way of a fraction
            next(line for line in handle if line.strip())
            dtype = [(label, types[label]) for label in labels]
            table = np.loadtxt(handle, dtype, delimiter=",", comments=None, ndmin=1)
    except (ValueError, csv.Error, Warning):
        return None
    columns = {label: np.ascontiguousarray(table[label]) for label in labels}
    return columns if all(map(_is_plain, columns.values())) else None


def _is_plain(column: Column) -> bool:
    if column.dtype.kind == "U":
        return any({*column.tolist()} <= words for words in WORDS)
    return bool(np.isfinite(column).all())


def csv_frame(path: str, known: Callable[[str], bool] | None = None) -> Any:
    """A CSV file as a DataFrame, of its ``known`` columns where it is wide; ValueError for what is no table with a header."""
    import pandas as pd

    name = _files.local(path)
    options: dict[str, Any] = {}
    try:
        labels = csv_header(name)
        if known is not None and len(labels) > WIDE:
            options["usecols"] = list(dict.fromkeys(filter(known, labels))) or labels[:1]
        with open(name, "rb") as handle, warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # more fields than the header names
            warnings.simplefilter(
                "ignore", pd.errors.DtypeWarning
            )  # a column of numbers and words: refused by its reader
            frame = pd.read_csv(handle, index_col=False, **options, **_exact_floats(pd.__version__))
    except (pd.errors.ParserWarning, csv.Error, ValueError, OverflowError) as error:
        raise ValueError(f"{name!r} must be a CSV table with a header; {error}") from None
    frame.attrs["labels"] = labels if options else [str(label) for label in frame.columns]
    return frame


def csv_header(path: str) -> list[str]:
    """The first line's labels that is not empty."""
    with open(_files.local(path), encoding="utf-8-sig", newline="") as handle:
        return next((row for row in csv.reader(handle) if row), [])


def parquet_header(path: str) -> list[str]:
    """The names of a parquet table's columns; ValueError for another file."""
    return _parquet(path, lambda file: [str(name) for name in file.schema_arrow.names])  # type: ignore[no-any-return]


def parquet_frame(path: str, known: Callable[[str], bool]) -> Any:
    """The ``known`` columns of a parquet file as a DataFrame; ValueError for another file."""

    def frame_of(file: Any) -> Any:
        labels = [str(name) for name in file.schema_arrow.names]
        asked = [label for label in labels if known(label)]
        again = sorted({label for label in asked if labels.count(label) > 1})
        if again:
            raise ValueError(f"its columns must differ; it has {again[0]!r} twice")
        _checks.require_memory(file.metadata.num_rows * len(asked), repr(path))
        frame = file.read(columns=asked).to_pandas(ignore_metadata=True)
        frame.attrs["labels"] = labels
        return frame

    return _parquet(path, frame_of)


def _parquet(path: str, take: Callable[[Any], Any]) -> Any:
    require_module("pyarrow", "parquet")
    from pyarrow import parquet

    name = _files.local(path)
    with open(name, "rb") as handle:
        try:
            return take(parquet.ParquetFile(handle))
        except MemoryError:
            raise
        except Exception as error:  # whatever pyarrow makes of bytes that are not parquet's
            raise ValueError(f"{name!r} must be a parquet table; {str(error) or type(error).__name__:.300}") from None


def require_columns(name: str, required: Sequence[str], labels: Iterable[str], *, way: str = "") -> None:
    """ValueError where a required column is missing, with the separator or the spelling that was probably meant.

    ``way``: what else helps, where that is not seen.
    """
    found = list(labels)
    if set(required) <= set(found):
        return
    shown = f"{', '.join(found):.300}" or "none"
    hint = meant(required, found) or f" (rename the columns that hold them{way})" * (len(found) >= len(required))
    raise ValueError(f"{name} must have the columns {', '.join(required)}; it has {shown}{hint}")


def meant(required: Sequence[str], found: Sequence[str]) -> str:
    """What is to be changed: the separator, or how a label is written; empty where that is not seen."""
    for mark, word in SEPARATORS.items():
        if any(mark in label and set(_plain(label.split(mark))) & set(required) for label in found[:1]):
            return f": its fields must be separated by commas; they are by {word}"
    written = {
        label: column
        for label, column in zip(found, _plain(found), strict=True)
        if column in required and column not in found
    }
    return "".join(f"; write {column} for {label!r}" for label, column in written.items())


def _plain(labels: Iterable[str]) -> list[str]:
    """Labels in lower case, with one underscore for what parts their words."""
    return ["_".join(label.strip(" \t\"'\ufeff").lower().replace("-", " ").split()) for label in labels]


def warn_left_out(name: str, unknown: Sequence[str], known: Sequence[str], *, level: int) -> None:
    """Name the columns that are not read, the first of many, each with the known one that it resembles."""
    if not unknown:
        return
    named = [_with_nearest(label, known) for label in unknown[:NAMED]]
    if len(unknown) > NAMED:
        named.append(f"and {len(unknown) - NAMED} more")
    warnings.warn(
        f"columns of {name!r} that a log does not know are left out: {', '.join(named)}", stacklevel=level + 1
    )


def _with_nearest(column: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(column[:80], known, n=1, cutoff=0.8)
    return f"{column:.80} (did you mean {near[0]}?)" if near else f"{column:.80}"


def _exact_floats(version: str) -> dict[str, Any]:
    """The option with which pandas reads back every bit; it is deprecated from 3.1 on, where that is the default."""
    major, minor = (int(part) for part in version.split(".")[:2])
    return {} if (major, minor) >= (3, 1) else {"float_precision": "round_trip"}
