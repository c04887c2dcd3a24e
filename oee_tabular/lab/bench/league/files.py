"""Files of a league: tables, page, LaTeX and pictures, as bytes."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING

from oee_tabular import _files
from oee_tabular.lab.bench.league.pictures import KINDS, PICTURES
from oee_tabular.lab.experiment import draw_bytes
from oee_tabular.plots import draw_or_warn

if TYPE_CHECKING:
    from oee_tabular.lab.bench.league.league import League


def league_files(
    league: League,
    about: Mapping[str, str] | None = None,
    command: str = "",
    labels: Mapping[str, str] | None = None,
) -> dict[str, bytes]:
    """Return the bytes of the files that ``League.save`` writes, by name."""
    shown = league.with_labels({} if labels is None else labels)
    contents = {
        "table.csv": _files.csv_bytes(league.table),
        "cells.csv": _files.csv_bytes(
            league.cells.assign(size=league.cells["size"].map(_write_size)),
            float_format="%.6g",
        ),
        "league.csv": _files.csv_bytes(league.league, float_format="%.6g"),
        "league.md": _files.text_bytes(shown.page(about or {}, command)),
        "league.tex": _files.text_bytes(shown.to_latex()),
    }
    for name in PICTURES:
        draw = functools.partial(
            draw_bytes, getattr(shown, name), salt="bench", kinds=KINDS
        )
        pictures = draw_or_warn(f"{name}.png", draw)
        contents |= {f"{name}.{kind}": data for kind, data in (pictures or {}).items()}
    return contents


def _write_size(size: float) -> str:
    """Write a size with six digits, or with all where these are not enough.

    The table's rows are matched to cells by it.
    """
    short = f"{size:.6g}"
    return short if float(short) == size else repr(float(size))
