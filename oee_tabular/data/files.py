"""Logs as files: npz, CSV, parquet and Minari data sets, whole or not at all."""

from __future__ import annotations

import contextlib
import glob
import gzip
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Self, TypeAlias, cast
from urllib.parse import unquote

import numpy as np

from oee_tabular import _checks, _files, _writing
from oee_tabular.data.frames import (
    find_new_folder,
    is_minari,
    minari_columns,
    save_minari,
)
from oee_tabular.data.labels import (
    ColumnsLike,
    Matching,
    check_columns,
    match_labels,
    require_columns,
    warn_left_out,
    warn_read_as,
)
from oee_tabular.data.rules import (
    COLUMNS,
    MOVE,
    NO_NAMES,
    WAY,
    as_objects,
    check_table,
)
from oee_tabular.data.tables import (
    LogFile,
    Piece,
    Table,
    add_folders,
    match_own,
    open_table,
    write_parquet,
)
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp import Name, from_text, to_text
from oee_tabular.typing import Column

# a file, a folder, a pattern, or several
Paths: TypeAlias = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
ENDINGS = (".csv", ".parquet", ".npz", ".csv.gz")
# endings of files that stand beside a log and hold none, and how their names begin
NO_LOGS = (
    ".md .rst .json .yaml .yml .toml .ini .cfg .py .pyc .ipynb .r .jl .m .sh .bat .sql"
    " .html .css .js .tex .bib .pdf .doc .docx .odt .ppt .pptx .png .jpg .jpeg .gif"
    " .svg .eps .mp4 .crc .md5 .sha1 .sha256 .sha512 .sig .asc .lock .swp"
    " .err .pt .pth .onnx .license"
)
NO_LOG_NAMES = (
    "readme",
    "notes",
    "licen",
    "copying",
    "notice",
    "changelog",
    "makefile",
)
MINARI_FILES = ("metadata.json", "main_data.hdf5")
MAX_SHOWN_FILES = 5
# other files than those of logs, above which a folder is not one of a log
MAX_OTHER_FILES = 100_000
Columns = dict[str, Column]
OwnNames: TypeAlias = Mapping[str, tuple[Name, ...] | None]  # by a column's label


class Format:
    """Describe how logs of numbered states stand in files.

    A log of other states overrides what differs. ``columns``: what the files call a
    log's columns, where they have other names.
    """

    kind = "transitions"  # of an npz
    required = MOVE
    endings = (
        ".npz, .csv, .csv.gz, .parquet, or be a Minari folder or id"  # that are read
    )
    writes_minari = True
    has_vectors = False

    def __init__(self, columns: ColumnsLike | None = None) -> None:
        self.columns = check_columns(columns, has_vectors=self.has_vectors)

    def with_columns(self, columns: ColumnsLike | None) -> Self:
        """Return the format of files with other names for a log's columns."""
        return type(self)(columns)

    def match(self, labels: Iterable[str], name: str) -> Matching:
        """Return which labels of the table ``name`` hold which columns of a log."""
        return match_labels(
            labels,
            repr(name),
            self.columns,
            lambda given, taken: self.require(given, name, taken),
            has_vectors=self.has_vectors,
        )

    def to_table(self, columns: Columns) -> Columns:
        """Return the columns of a table, each (n,), names as texts."""
        table = {}
        for name, column in columns.items():
            if column.dtype.hasobject:
                column = np.array([str(item) for item in column], dtype=object)
            table[name] = column
        return table

    def from_table(self, columns: Columns, name: str) -> Columns:
        """Return the columns of a log from those of the table ``name``."""
        return columns

    def read_lists(self, file: LogFile, reported: set[Any]) -> Columns | None:
        """Return the columns of a file whose states are lists; None of another one."""
        return None

    def require(
        self, labels: Iterable[str], name: str, taken: Iterable[str] | None = None
    ) -> None:
        """Raise an ArgumentError where the columns do not make a log of this kind.

        ``taken``: the columns of a log that were found among the labels.
        """
        require_columns(repr(name), self.required, labels, taken=taken)

    def check_episode(self, observations: Column, actions: Column, name: str) -> None:
        """Raise an ArgumentError where a Minari episode does not fit such a log."""
        kinds = observations.dtype.kind + actions.dtype.kind
        if observations.ndim != 1 or not set(kinds) <= {"i", "u"}:
            raise ArgumentError(
                f"{name!r}",
                "must have discrete observations and actions; they have shapes"
                f" {observations.shape} of {observations.dtype} and {actions.shape} of"
                f" {actions.dtype}",
            )


def is_minari_target(form: Format, name: str) -> bool:
    """Return whether a log of this form is written to ``name`` as a Minari data set."""
    is_bare = Path(name).suffix == "" and not _files.has_ending(name, ENDINGS)
    return form.writes_minari and (name.startswith("minari:") or is_bare)


def new_log_file(
    form: Format, path: str | os.PathLike[str], name: str, *, overwrite: bool
) -> _writing.Output:
    """Check that a command can write a log of this form, before it is recorded.

    ``_files.new_file`` has the arguments; a Minari data set is never overwritten.
    """
    if is_minari_target(form, _files.local(path, name)):
        find_new_folder(os.fspath(path), name)
        return _writing.Output(path, name, overwrite=False)
    _require_ending(form, os.fspath(path), name)
    return _files.new_file(path, name, overwrite=overwrite)


def _require_ending(form: Format, path: str, name: str) -> None:
    """Raise an ArgumentError where no log of this form is written to such a file."""
    if not _files.has_ending(path, ENDINGS):
        endings = ".npz, .csv, .csv.gz, .parquet"
        if form.writes_minari:
            endings += ", or be a new Minari folder or id"
        raise ArgumentError(name, f"must end in {endings}; it is {path!r}")


def save(log: Any, form: Format, path: str | os.PathLike[str]) -> None:
    """Write ``log`` in the format that the path's ending names."""
    name = _files.local(path)
    if is_minari_target(form, name):
        save_minari(log, name)
        return
    _require_ending(form, name, "path")
    if _files.has_ending(name, (".npz",)):
        columns = log.columns()
        for label, column in columns.items():
            if column.dtype.hasobject:
                columns[label] = to_text(column)
        _files.save_npz(name, form.kind, columns)
    elif _files.has_ending(name, (".parquet",)):
        with _files.whole_file(name) as handle, _writing.waiting_interrupts():
            write_parquet(handle.name, form.to_table(log.columns()))
    else:
        import pandas as pd

        table = form.to_table(log.columns())
        _require_lines(table)
        frame = pd.DataFrame(table)
        with _files.whole_file(name) as handle, contextlib.ExitStack() as stack:
            target = handle
            if _files.has_ending(name, (".gz",)):
                # without name and time, the same log gives the same bytes
                packed = gzip.GzipFile("", "wb", fileobj=handle, mtime=0)
                target = cast("IO[bytes]", stack.enter_context(packed))
            frame.to_csv(target, index=False)


def _require_lines(table: Columns) -> None:
    """Raise an ArgumentError for a name with a line break, which no CSV is read with."""
    for label, column in table.items():
        if not column.dtype.hasobject:
            continue
        texts = {text: row for row, text in reversed(list(enumerate(column.tolist())))}
        for text, row in texts.items():
            if "\n" in text or "\r" in text:
                raise ArgumentError(
                    f"{label}[{row}]",
                    "must have no line break, to be saved as CSV; it is"
                    f" {_checks.show(text)} (save it as .npz or .parquet)",
                )


def load(
    form: Format, file: LogFile, reported: set[Any], names: OwnNames = NO_NAMES
) -> Columns:
    """Read the columns of a log in the format of the path's ending.

    Warns of labels of other projects and of unknown ones that are not ``reported``.
    ``names``: by a log's columns, the simulator's, where it is known.
    """
    name = _files.local(file.path)
    if os.path.exists(name) and not os.path.isdir(name):
        _files.require_regular(name)
    if file.suffix == ".npz":
        if form.columns:
            raise ArgumentError(
                "columns",
                f"must be left out for {name!r}: an npz has a log's own labels",
            )
        columns = _load_npz(form, file, name)
    elif file.suffix in (".csv", ".parquet"):
        columns = form.read_lists(file, reported) or _load_table(
            form, file, name, reported, names
        )
    elif is_minari(name):
        columns = minari_columns(name, form.check_episode, form.columns, reported)
    else:
        raise ArgumentError(
            "path",
            f"must end in {form.endings}; it is {name!r}{_suggest_format(name)}",
        )
    return {column: columns[column] for column in COLUMNS if column in columns}


def _suggest_format(name: str) -> str:
    """Return how pandas writes a table of another format as CSV, in words."""
    lower = name.lower()
    if lower.endswith((".xlsx", ".xls", ".ods")):
        reader = "read_excel(path)"
    elif lower.endswith((".feather", ".arrow")):
        reader = "read_feather(path)"
    elif lower.endswith((".tsv", ".tab")):
        reader = "read_csv(path, sep='\\t')"
    elif lower.endswith((".txt", ".dat", ".bak")):  # by any separator
        reader = "read_csv(path, sep=None, engine='python')"
    elif lower.endswith((".zip", ".bz2", ".xz", ".zst")):
        reader = "read_csv(path)"
    else:
        return ""
    return f" (pandas.{reader}.to_csv('log.csv', index=False) writes what is read)"


def _load_npz(form: Format, file: LogFile, name: str) -> Columns:
    """Read the columns of a log from an npz file, and of its folders."""
    columns = _read_npz(form, name)
    if not file.fixed:
        return columns
    with _files.parts_of(name, "a log"):
        rows = np.arange(len(columns["state"]))
    matching = match_own(file, columns)
    whole = add_folders(file, matching, Piece(columns, rows, {})).columns
    return columns | check_table(
        {label: column for label, column in whole.items() if label not in columns},
        repr(name),
    )


def _read_npz(form: Format, name: str) -> Columns:
    """Read the columns of a log from an npz file."""
    columns = _files.load_npz(name, form.kind)
    columns.pop(_files.KIND)
    unknown = [label for label in columns if label not in COLUMNS]
    if unknown:
        raise ArgumentError(
            f"{name!r}",
            f"must hold the columns of a log alone; it has {_checks.show(unknown[0])}",
        )
    form.require(columns, name)
    with _files.parts_of(name, "a log"):
        for label, array in columns.items():
            if array.dtype.kind == "U":
                columns[label] = as_objects(from_text(array, label))
    return columns


def _load_table(
    form: Format, file: LogFile, name: str, reported: set[Any], names: OwnNames
) -> Columns:
    """Read the columns of a log from a CSV or parquet file."""
    table = open_table(file, form)
    values = check_table(
        _read_whole(file, table),
        repr(name),
        names=names,
        find_text=table.find_text,
        way=WAY,
    )
    columns = form.from_table(values, name)
    found = table.matching
    renamed = [pair for pair in found.renamed if pair not in reported]
    unknown = [label for label in found.left_out if label not in reported]
    reported.update(renamed, unknown)
    warn_read_as(repr(name), renamed)
    warn_left_out(repr(name), unknown)
    return columns


def _read_whole(file: LogFile, table: Table) -> Columns:
    """Read all raw columns of a table.

    Raises a ValueError for a line that has another number of fields than its header.
    """
    if table.n_rows is not None:
        n_values = table.n_rows * len(table.known)
        _checks.require_memory(n_values, repr(file.path))
    pieces = []
    n_values = 0
    for piece in table.pieces:
        pieces.append(piece)
        # The pieces are put together and then checked. Libraries crash where memory is
        # over, so it is asked for before the next one is read.
        n_values += sum(column.size for column in piece.columns.values())
        _checks.require_memory(2.0 * n_values, repr(file.path))
    for piece in pieces:
        for place, rule in piece.lost.values():
            raise ArgumentError(f"{file.path!r}: {place}", rule)
    if not pieces:
        return {label: np.zeros(0) for label in table.known}
    columns = {}
    for label in table.known:
        columns[label] = np.concatenate([piece.columns[label] for piece in pieces])
    return columns


def find_log_files(path: Paths, *, warns: bool = False) -> list[LogFile]:
    """Find the files that a path, a folder, a pattern or a list of them names.

    They are in the order of their names, in which numbers count as such: part.2 is
    before part.10. Files and folders that begin with a dot or an underscore are left
    out, as writers of folders mean them; folders ``column=value`` name a column [1]. A
    folder without any is a Minari data set. ``warns``: whether a warning names the
    files of a folder that may hold a part of the log and are left out, and subfolders
    whose files are read beside the folder's own.

    [1] Apache Hive.
    """
    if isinstance(path, str | os.PathLike) or hasattr(path, "read"):
        given: Any = [path]
    elif hasattr(path, "columns"):
        raise ArgumentError(
            "path",
            f"must be the path of a file; it is a {type(path).__name__}, which"
            " from_frame reads",
        )
    else:
        given = _checks.collection(path, "path", "paths of files")
    names = [_files.local(one) for one in given]
    # asked before the files, of which a list may name a million
    _refuse_again(names)
    some = [file for name in names for file in _files_at(name)]
    if not some:
        raise ArgumentError("path", "must name files; it is an empty list")
    _refuse_again([file.path for file in some])
    _refuse_links_to_one_file(some)
    if warns:
        for name in names:
            _warn_of_folder(Path(name), some)
    return some


def _refuse_again(paths: Sequence[str]) -> None:
    """Raise an ArgumentError where a path is given twice."""
    numbers = Counter(paths)
    again = sorted(str(name) for name, number in numbers.items() if number > 1)
    if again:
        raise ArgumentError(
            "path",
            f"must name each file once; {_checks.show(again[0])} is named twice",
        )


def _refuse_links_to_one_file(files: Sequence[LogFile]) -> None:
    """Raise an ArgumentError where two paths lead to one file, which would count twice.

    They are other spellings of its path, links, and folders that a link leads back to.
    """
    known: dict[tuple[int, int], str] = {}
    for file in files if len(files) > 1 else ():
        try:
            found = os.stat(file.path)
        except OSError:
            continue  # an error where it is read
        first = known.setdefault((found.st_dev, found.st_ino), file.path)
        if first != file.path:
            raise ArgumentError(
                "path",
                f"must name each file once; {file.path!r} is the file {first!r} again",
            )


def _warn_of_folder(place: Path, files: Sequence[LogFile]) -> None:
    """Warn of files of a folder that are left out, and of subfolders that are read."""
    if not place.is_dir():
        return
    ways = sorted(
        (way.relative_to(place) for way in place.rglob("*") if not way.is_dir()),
        key=_order,
    )
    read = [way for way in ways if _is_data_file(way)]
    if not read:
        return  # a Minari data set
    left = [str(way) for way in ways if _may_be_log(way)]
    noun = "file" if len(read) + len(left) == 1 else "files"
    if left:
        _checks.warn(
            f"read {len(read)} of {len(read) + len(left)} {noun} in {str(place)!r}; left"
            f" out: {_list_files(left)} (write them as .csv or .parquet to read them)",
            DataWarning,
        )
    inside = [way for way in read if len(way.parts) > 1]
    if len(inside) < len(read):
        folders = dict.fromkeys(str(way.parent) for way in inside)
        plain = [folder for folder in folders if "=" not in folder]
        if plain:
            number = sum(str(way.parent) in plain for way in inside)
            _checks.warn(
                f"{number} of the {len(read)} {noun} read in {str(place)!r} stand in its"
                f" subfolders: {_list_files(plain)} (give a pattern,"
                f" {str(place / '*.csv')!r}, to read the folder's own alone)",
                DataWarning,
            )


def _list_files(names: Sequence[str]) -> str:
    """Return the first of some names of files, in words."""
    shown = [_checks.show(name) for name in names[:MAX_SHOWN_FILES]]
    if len(names) > MAX_SHOWN_FILES:
        shown.append(f"and {len(names) - MAX_SHOWN_FILES} more")
    return ", ".join(shown)


def warn_of_empty_files(paths: Sequence[str], n_files: int) -> None:
    """Warn of files that have a header and no rows."""
    if paths:
        verb = "has" if len(paths) == 1 else "have"
        _checks.warn(
            f"{len(paths)} of {n_files} files {verb} a header and no rows:"
            f" {_list_files(paths)}",
            DataWarning,
        )


def _may_be_log(path: Path) -> bool:
    """Return whether a file that is not read may hold a part of a log."""
    name = path.name.lower()
    return not (
        _is_hidden(path)
        or _is_data_file(path)
        or name.startswith(NO_LOG_NAMES)
        or name.endswith(tuple(NO_LOGS.split()))
        or name in ("thumbs.db", "desktop.ini")
    )


def _files_at(name: str) -> list[LogFile]:
    """Find the files of a folder or a pattern, or the one of this name."""
    place = Path(name)
    if place.is_dir():
        return _files_in(place, Path(), name)
    if place.exists() or not glob.has_magic(name):
        return [LogFile(name)]
    names = glob.glob(name, recursive=True)
    if not names and place.parent.is_dir():
        # of p[1]/*.csv, the folder that is called so
        pattern = os.path.join(glob.escape(str(place.parent)), place.name)
        names = glob.glob(pattern, recursive=True)
    paths = sorted(map(Path, names), key=_order)
    # a link that leads nowhere, or a pipe, is an error where it is read
    matching = [path for path in paths if not path.is_dir()]
    if matching and "**" not in name:
        for folder in set(paths) - set(matching):
            inner = _walk(folder, str(folder))
            if any(_is_data_file(way.relative_to(folder)) for way in inner):
                raise ArgumentError(
                    "path",
                    f"must match files or folders, not both; {name!r} matches the file"
                    f" {str(matching[0])!r} and the folder {str(folder)!r}, which holds"
                    " files of a log as well (give both as a list)",
                )
    if matching:
        return [LogFile(str(file), _parse_folders(file)) for file in matching]
    inside = [file for path in paths for file in _files_in(path, path, name)]
    if not inside:
        raise FileNotFoundError(2, "no file matches the pattern", name)
    return inside


def _files_in(place: Path, named: Path, name: str) -> list[LogFile]:
    """Find the files in a folder; ``named`` is the part of its path that names columns.

    Raises an ArgumentError, which calls the folder ``name``, where it has none.
    """
    files = sorted(_walk(place, name), key=_order)
    if not files:
        raise ArgumentError(
            "path",
            f"must hold files in {', '.join(ENDINGS)}; the folder {name!r} has none",
        )
    ways = [file.relative_to(place) for file in files]
    found = [
        LogFile(str(place / way), _parse_folders(named / way))
        for way in ways
        if _is_data_file(way)
    ]
    if found:
        return found
    left = [str(way) for way in ways if _may_be_log(way)]
    if left and not any(way.name in MINARI_FILES for way in ways):
        raise ArgumentError(
            "path",
            f"must hold files in {', '.join(ENDINGS)}; the folder {name!r} has"
            f" {_list_files(left)} (write them as .csv or .parquet)",
        )
    return [LogFile(str(place))]


def _walk(place: Path, name: str) -> Iterator[Path]:
    """Yield the files in a folder and below it, in no order; links are not followed.

    Raises an ArgumentError for a folder that cannot be read, whose part of the log
    would be lost without a word, and for one of very many other files.
    """

    def refuse(error: OSError) -> None:
        """Name the folder that cannot be read, unless none of it would be."""
        folder = Path(os.fsdecode(error.filename or place))
        if not _is_hidden(folder.relative_to(place)):
            raise ArgumentError(
                "path",
                f"must name a folder that can be read; {str(folder)!r} cannot"
                f" ({error.strerror})",
            )

    n_others = 0
    for folder, _, names in os.walk(place, onerror=refuse):
        for each in names:
            n_others += not each.lower().endswith(ENDINGS)
            if n_others > MAX_OTHER_FILES:
                raise ArgumentError(
                    "path",
                    f"must be the folder of a log; {name!r} has more than"
                    f" {MAX_OTHER_FILES} other files (name the folder inside it)",
                )
            yield Path(folder, each)


def _is_hidden(path: Path) -> bool:
    """Return whether a name of a path is one that writers of folders leave out."""
    return any(step.startswith((".", "_")) for step in path.parts)


def _order(path: Path) -> list[list[tuple[int, str]]]:
    """Return a key that sorts paths by their names, and numbers in them by size."""
    return [
        [
            (int(part), part) if part.isdecimal() else (-1, part)
            for part in re.split(r"(\d+)", step)
        ]
        for step in path.parts
    ]


def _is_data_file(path: Path) -> bool:
    """Return whether a file has the ending of a log and is not hidden."""
    return not _is_hidden(path) and path.name.lower().endswith(ENDINGS)


def _parse_folders(path: Path) -> tuple[tuple[str, str], ...]:
    """Return the labels and texts that folders name, as Hive writes them."""
    steps = (step.partition("=") for step in path.parts[:-1])
    try:
        found = [
            (unquote(label, errors="strict"), unquote(text, errors="strict"))
            for label, equals, text in steps
            if equals
        ]
    except UnicodeDecodeError:
        # in other letters, two values would be read as one
        raise ArgumentError(
            f"{str(path)!r}",
            "must have folders whose %XX are UTF-8 (rename them)",
        ) from None
    texts: dict[str, str] = {}
    for label, text in found:
        if texts.setdefault(label, text) != text:
            raise ArgumentError(
                f"{str(path)!r}",
                f"must have folders that say one thing of each column; {label!r} is"
                f" {texts[label]!r} and {text!r} (rename one of them, or give the file"
                " itself)",
            )
    return tuple(found)


def plain_name(file: LogFile, files: Sequence[LogFile]) -> str:
    """Return a file's path below the folder that all files have in common.

    It is the same wherever that folder stands.
    """
    folders = [os.path.dirname(os.path.abspath(one.path)) for one in files]
    common = os.path.commonpath(folders)
    return re.sub(r"[\\/]+", "/", os.path.relpath(os.path.abspath(file.path), common))
