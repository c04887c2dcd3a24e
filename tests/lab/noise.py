"""Small experiment whose cells are hard to get right by accident."""

import numpy as np

from oee_tabular.lab.experiment import Experiment
from oee_tabular.lab.experiments.catalogue import save
from oee_tabular.lab.run import run_experiment


def noise(cell, stream):
    """Numbers that need BLAS, and are hard to print."""
    matrix = stream.generator().normal(size=(60, 60))
    value = float(np.linalg.inv(matrix @ matrix.T + np.eye(60)).sum())
    return [
        {"name": name, "value": value * factor}
        for name, factor in (("one", 1.0), ("third", 1 / 3))
    ]


def experiment(run=noise, **options):
    def draw(table, summary, figure):
        figure.subplots().plot(summary["value_mean"])

    plain = {
        "id": "noise",
        "title": "Noise | and more",
        "axes": {"n": (1, 2, 3)},
        "keys": ("n", "name"),
        "measures": ("value",),
        "repetitions": 2,
    }
    return Experiment(run=run, draw=draw, **(plain | options))


def bytes_of(folder, settings, **options):
    """Return the files of a run."""
    save(run_experiment(folder, settings, **options))
    return {
        name: (folder / name).read_bytes()
        for name in ("table.csv", "summary.csv", "summary.md", "figure.svg")
    }
