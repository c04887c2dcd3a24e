"""Experiments of ``oee reproduce``: the paper's figures and more.

``values`` and ``zeta`` hold those of the paper's grid and of toy text, ``sureness``
those of intervals and plans; ``cartpole``, ``reacher`` and ``kinova`` (a simulated
stand-in) those of the robots, ``changes`` what nobody tuned for; ``catalogue`` has all
by id. Here is what notebooks call.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.experiment import RunSettings, Stream
from oee_tabular.lab.experiments.common import published

__all__ = ["load_saved_table", "published", "table"]


def load_saved_table(name: str, table: str = "table") -> pd.DataFrame:
    """Load the saved table of an experiment that a notebook shows.

    Parameters
    ----------
    name : str
        The experiment's id; in a clone, any in ``notebooks/results``.
    table : {'table', 'summary'}, default 'table'
        Every seed, or their means. Without a clone there are "table" of fig2, fig3 and
        networks, and "summary" of fig3 and table1.

    Returns
    -------
    DataFrame
        The rows of the saved file.

    Raises
    ------
    ValueError
        If no such table is installed.

    Examples
    --------
    >>> load_saved_table("networks").n.unique().tolist()
    [1000, 3162, 10000, 31623, 100000, 316228]
    """
    file = Path(__file__)
    # A wheel has the tables beside this file, a clone in its notebooks.
    folders = file.parent / "saved", file.parents[3] / "notebooks" / "results"
    paths = [folder / name / f"{table}.csv" for folder in folders]
    for path in paths:
        if path.is_file():
            return pd.read_csv(path)
    raise ValueError(
        f"name and table must be those of a saved table; there is no {paths[0]} and no"
        f" {paths[1]}"
    )


def table(
    name: str, *, repetitions: int = 1, seed: int = 0, **axes: object
) -> pd.DataFrame:
    """Compute some cells of an experiment here and now.

    The rows are those that ``oee reproduce`` gives for them.

    Parameters
    ----------
    name : str
        The experiment's id, as ``oee reproduce --list`` has it.
    repetitions : int, default 1
        Number of logs of each cell, numbered from 0.
    seed : int, default 0
        The seed of all random numbers.
    **axes
        Settings by name, a value or several of each. An axis that is not named has all
        its values.

    Returns
    -------
    DataFrame
        A row for each row of each cell, with the cell's settings first.

    Raises
    ------
    ValueError
        If an id or an axis is not there.

    Examples
    --------
    >>> table("estimands", delta=0.5).quantity.tolist()[:2]
    ['true, r(s_t+1)', "OEE's, r(s_t)"]
    """
    from oee_tabular.lab.experiments.catalogue import choose

    (experiment,) = choose([name])
    chosen = dict(experiment.axes)
    for axis, given in axes.items():
        if axis not in chosen:
            raise ArgumentError(
                "axes", f"must be among {', '.join(chosen)}; got {axis!r}"
            )
        # 1000.0 is the same cell as 1000: the axis's own value names its stream.
        own = {value: value for value in chosen[axis]}
        chosen[axis] = tuple(
            own.get(x, x) for x in np.atleast_1d(np.asarray(given)).tolist()
        )
    cells = RunSettings(
        experiment, chosen, _checks.positive_integer(repetitions, "repetitions"), seed
    ).cells()
    rows = [
        (cell, row)
        for cell in cells
        for row in experiment.run(cell, Stream(name, seed, cell))
    ]
    return pd.DataFrame([{**cell, **row} for cell, row in rows])
