"""The results saved in notebooks/results, and whether today's code makes them.

``python tests/saved_results.py [ID ...]`` draws the figures of the saved tables again,
without sampling anything.
"""

import sys
from pathlib import Path

import pandas as pd
from kernels.files import write_all

RESULTS = Path(__file__).parents[1] / "notebooks" / "results"


def saved(name):
    """Every seed of an experiment's full sweep."""
    return pd.read_csv(RESULTS / name / "table.csv")


def assert_saved(name, cell, table):
    """The rows computed for a cell are those of the saved table: a table that older
    code made fails.
    """
    rows = saved(name)
    for setting, value in cell.items():
        rows = rows[rows[setting] == value]
    rows = rows.dropna(axis=1, how="all").reset_index(drop=True)
    made = table.dropna(axis=1, how="all").reset_index(drop=True)
    pd.testing.assert_frame_equal(made, rows, rtol=1e-5, atol=1e-9, check_dtype=False)


def redraw(names):
    """The figures and pages of the saved tables; all of them without names."""
    from oee_tabular.lab.experiment import files_of
    from oee_tabular.lab.experiments.catalogue import choose, write_index

    for experiment in choose(names, everything=not names):
        made = files_of(experiment.settings(), saved(experiment.id))
        write_all(
            RESULTS / experiment.id,
            {name: made[name] for name in made if name != "table.csv"},
        )
    write_index(RESULTS)


if __name__ == "__main__":
    redraw(sys.argv[1:])
