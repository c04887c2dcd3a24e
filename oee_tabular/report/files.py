"""Files of reports: checks before any work, and a summary of a written report."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oee_tabular import _checks, _files, _printing, _writing
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError

INDEX = "report.json"  # which lists the other files of a report
NAMES = (INDEX, "table.csv", "values.png", "values.pdf", "values.svg")


@suggest_keywords
def check_output(folder: str | os.PathLike[str], name: str = "output") -> None:
    """Check that a folder can be made and written, before any work is done.

    Nothing is made.

    Parameters
    ----------
    folder : str or path
        The folder in which results are to be written.
    name : str, default "output"
        What the error calls the folder.

    Raises
    ------
    ValueError
        If the folder, or a folder above it, is a file or may not be written.

    See Also
    --------
    check_page : Check that a page can be written.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     check_output(Path(folder) / "new" / "results")  # no error: it could be made
    ...     (Path(folder) / "new").exists()
    False
    """
    path = Path(_files.local(folder, _checks.instance(name, str, "name")))
    nearest = path
    while not os.path.lexists(nearest) and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        kind = "a file" if nearest.is_file() else "no folder"
        raise ArgumentError(
            name, f"must be a folder that can be written; {str(nearest)!r} is {kind}"
        )
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise ArgumentError(
            name,
            f"must be a folder that can be written; {str(nearest)!r} is not writable"
            f" ({error.strerror})",
        ) from None


def check_page(path: str | os.PathLike[str]) -> Path:
    """Check that a page can be written, and return its path.

    The folder of the page must exist, or it must be possible to make it. Nothing is
    made.

    Parameters
    ----------
    path : str or path
        The page, a .html or .htm file.

    Returns
    -------
    Path
        The path of the page.

    Raises
    ------
    ValueError
        If the path has another ending, is a folder, or may not be written.

    See Also
    --------
    check_output : Check that a folder can be made and written.

    Examples
    --------
    >>> check_page("report.html").name
    'report.html'
    >>> check_page("report.pdf")
    Traceback (most recent call last):
    ValueError: path of the report must end in .html or .htm; it is 'report.pdf'
    """
    file = Path(_files.local(path, "path of the report"))
    if file.suffix.lower() not in (".html", ".htm"):
        raise ValueError(
            f"path of the report must end in .html or .htm; it is {str(file)!r}"
        )
    if file.is_dir():
        raise ValueError(
            f"path of the report must be a file; {str(file)!r} is a folder"
        )
    check_output(file.parent, "report's folder")
    return file


class ReportOutput(_writing.Output):
    """Hold the folder of a command's report: asked before the work, written after it.

    Files of the last report are replaced unasked where they still are as it wrote them.
    Files of other names are left alone.
    """

    def __init__(self, path: str | os.PathLike[str], name: str, *, overwrite: bool):
        super().__init__(path, name, overwrite=overwrite)
        check_output(self.path, name)
        known = _known_digests(self.path)
        self.states = self._find_states()
        self.own = {file for file in NAMES if self.states[file] in known.get(file, ())}
        for file in NAMES:
            self.check_file(self.path / file)

    def refuse(self, path: Path) -> None:
        """Raise the ArgumentError for a file that no report wrote, or that changed."""
        raise ArgumentError(
            self.name,
            "must be a folder in which nothing is lost, or be given with --overwrite;"
            f" {str(path)!r} is not as the last oee evaluate of this version wrote it",
        )

    def _find_states(self) -> dict[str, str | None]:
        """Return the digest of each file that is there, None of the others."""
        return {file: _writing.digest_of(self.path / file) for file in NAMES}

    def check_again(self) -> None:
        """Raise an ArgumentError where the folder has changed since it was asked."""
        now = self._find_states()
        changed = [file for file in NAMES if now[file] != self.states[file]]
        if changed and not self.overwrite:
            raise ArgumentError(
                self.name,
                "must be a folder that one command writes at a time, or be given with"
                f" --overwrite; {str(self.path / changed[0])!r} has changed while this"
                " one was at work",
            )


def new_page(
    path: str | os.PathLike[str], name: str, *, overwrite: bool
) -> _writing.Output:
    """Check that a command can write a page, and that nothing there is lost."""
    page = check_page(path)
    output = _writing.Output(page, name, overwrite=overwrite)
    _writing.sweep(page.parent)
    output.check_file(page)
    return output


def _known_digests(folder: Path) -> dict[str, set[str]]:
    """Return the digests of the files that reports in the folder list, by name.

    The index has its own among them, without which an edited one would be lost.
    """
    known = _writing.listed_files(folder, INDEX)
    known[INDEX] = set()
    content = _writing.read_index(folder / INDEX)
    files = content.get("files")
    if isinstance(files, dict):
        content["files"] = {file: files[file] for file in files if file != INDEX}
        bytes_again = _seal(content)
        # the same bytes: as it was written, to the last blank
        if files.get(INDEX) == _writing.sha256(_index_bytes(content)):
            known[INDEX].add(_writing.sha256(bytes_again))
    return known


def _index_bytes(content: Mapping[str, Any]) -> bytes:
    """Return a report's content as the bytes of its JSON file."""
    return (json.dumps(content, indent=2) + "\n").encode()


def _seal(content: Mapping[str, Any]) -> bytes:
    """Return the bytes of an index with a digest of all else that it holds."""
    own = _writing.sha256(_index_bytes(content))
    return _index_bytes({**content, "files": {**content["files"], INDEX: own}})


def write_report(
    folder: Path, record: Mapping[str, Any], contents: Mapping[str, bytes]
) -> list[Path]:
    """Write a report's files and the index that lists their digests: all, or none.

    Files of an earlier report that are not written any more are removed, unless they
    have changed.
    """
    digests = {name: _writing.sha256(data) for name, data in contents.items()}
    index = _seal({**record, "files": digests})
    remedy = "wait for it, or name another folder"
    with _writing.alone_in(folder, remedy, seconds=_writing.LOCK_SECONDS):
        output = _writing.current_output()
        if isinstance(output, ReportOutput):
            output.check_again()
        known = _known_digests(folder)
        old = [
            file
            for file in NAMES[1:]
            if file not in contents
            and _writing.digest_of(folder / file) in known.get(file, ())
        ]
        _files.write_all(folder, {**contents, INDEX: index}, remove=old)
    return [folder / name for name in (INDEX, *contents)]


def plain(value: object) -> Any:
    """Convert a value to what JSON holds.

    NumPy's numbers and arrays become Python's; nan and infinities become None. What
    JSON does not hold becomes a text.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return _checks.show(value)


def summary(path: Path) -> str:
    """Summarise a report.json file in a few lines."""
    _files.require_regular(path)
    report = _read_object(path)
    try:
        lines = [f"Report of {report['unit']}"]
        lines += [
            f"{key.capitalize()}: {report['facts'][key]}"
            for key in ("simulator", "log")
        ]
        for row in report["results"]:
            lower = row["lower"]
            upper = row["upper"]
            ends = ""
            if lower is not None and upper is not None:
                shown = _printing.interval(lower, upper)
                ends = f"  {shown} ({row['interval_method']})"
            lines.append(f"{row['policy']}  {row['estimator']}  {row['value']}{ends}")
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ArgumentError(
            repr(str(path)),
            f"{JSON_RULE}; its parts {', '.join(PARTS)} are not those of a report"
            " (write it again: oee evaluate --output FOLDER)",
        ) from None
    return "\n".join(lines)


PARTS = ("unit", "facts", "results")  # of a report
JSON_RULE = (
    "must be a report that oee evaluate wrote, or outcomes of episodes as LeRobot's"
    " eval_info.json has them"
)


def _read_object(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file with the parts of a report.

    Raises an ArgumentError for another file, with what it holds in words.
    """
    name = repr(str(path))
    try:
        text = _files.read_text(path)
        found = json.loads(text)
    except ArgumentError:
        raise
    except json.JSONDecodeError as error:
        line = text.split("\n")[error.lineno - 1]
        place = f"line {error.lineno}, column {error.colno}"
        holds = f"it is no JSON in {place}, {_checks.show(line)}"
        if not text.strip():
            holds = "it is empty"
        raise ArgumentError(name, f"{JSON_RULE}; {holds}") from None
    except UnicodeDecodeError:
        raise ArgumentError(name, f"{JSON_RULE}; it is no text in UTF-8") from None
    except (RecursionError, ValueError):
        problem = "its parts are nested too deep, or its numbers too long"
        raise ArgumentError(name, f"{JSON_RULE}; {problem}") from None
    if not isinstance(found, dict):
        kind = "a list" if isinstance(found, list) else "one value"
        raise ArgumentError(
            name, f"{JSON_RULE}; it holds {kind}, {_checks.show(found)}"
        )
    lacking = [part for part in PARTS if part not in found]
    if lacking:
        keys = _checks.escape_controls(", ".join(found)[:100])
        holds = f"it has {keys}" if found else "it is empty, {}"
        raise ArgumentError(
            name, f"{JSON_RULE}; {holds}, and lacks {', '.join(lacking)}"
        )
    return found
