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

from oee_tabular import _checks, _files, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError


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
    while not nearest.exists() and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        raise ArgumentError(
            name, f"must be a folder that can be written; {str(nearest)!r} is a file"
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
    file = Path(_files.local(path))
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


def plain(value: object) -> Any:
    """Convert a value to what JSON holds.

    NumPy's numbers become Python's; nan and infinities become None.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def summary(path: Path) -> str:
    """Summarise a report.json file in a few lines."""
    try:
        report = json.loads(_files.read_text(path))
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
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
        raise ArgumentError(
            f"{str(path)!r}", f"must be a report that oee evaluate wrote; {error}"
        ) from None
    return "\n".join(lines)
