"""Files of reports: whether they can be written, asked before the work is done, and
what one says.
"""

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
from oee_tabular.exceptions import ArgumentError


def check_output(folder: str | os.PathLike[str], name: str = "output") -> None:
    """``folder`` can be made and written; a ValueError before any work is done
    otherwise.

    Parameters
    ----------
    folder : str or path; nothing is made
    name : what the error calls it

    Raises
    ------
    ValueError
        It, or a folder above it, is a file, or may not be written.

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
    """``path`` as a Path of a page that can be written, in a folder that exists or can
    be made.

    Parameters
    ----------
    path : str or path of a .html or .htm file

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        Another ending, a folder, or a place that may not be written.

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
    """Without numpy's types, infinities and nan (None): what JSON holds."""
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
    """What a report.json says, in a few lines."""
    try:
        report = json.loads(path.read_text())
        lines = [f"Report of {report['unit']}"]
        lines += [
            f"{key.capitalize()}: {report['facts'][key]}"
            for key in ("simulator", "log")
        ]
        for row in report["results"]:
            lower = row["lower"]
            upper = row["upper"]
            ends = (
                ""
                if None in (lower, upper)
                else f"  {_printing.interval(lower, upper)} ({row['interval_method']})"
            )
            lines.append(f"{row['policy']}  {row['estimator']}  {row['value']}{ends}")
    except (KeyError, TypeError, ValueError) as error:
        raise ArgumentError(
            f"{str(path)!r}", f"must be a report that oee evaluate wrote; {error}"
        ) from None
    return "\n".join(lines)
