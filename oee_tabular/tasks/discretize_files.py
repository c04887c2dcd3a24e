"""Discretizations as npz files: the rows of the MDP, where the states lie, and what they were made from.

A file is one of a FiniteMDP with more in it: ``FiniteMDP.load`` reads the MDP alone.
"""

from __future__ import annotations

import json
import os
from importlib.metadata import version
from typing import Any, TypeVar

import numpy as np

from oee_tabular import _files
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.finite_mdp import KIND
from oee_tabular.tasks.continuous import ContinuousTask
from oee_tabular.tasks.discretize import Cells, Discretization, task_metadata
from oee_tabular.tasks.discretize_cells import VoronoiCells
from oee_tabular.tasks.discretize_geometry import Grid

Found = TypeVar("Found", bound=Discretization)


def save(found: Discretization, path: str | os.PathLike[str]) -> None:
    """One npz of plain arrays, whole or not at all."""
    mdp = found.mdp
    arrays: dict[str, Any] = {
        "metadata": np.array(json.dumps(found.metadata | {"version": version("oee-tabular")})),
        "points": found.points,
        "point_cell": found.point_cell,
    }
    _files.save_npz(path, KIND, mdp.arrays() | arrays | found.cells.arrays())


def load(kind: type[Found], path: str | os.PathLike[str], task: ContinuousTask) -> Found:
    """What ``save`` wrote; ValueError where ``task`` is another one."""
    arrays = _files.load_npz(path, KIND)
    if "metadata" not in arrays:
        raise ValueError(
            f"{str(path)!r} must hold a Discretization; it holds a FiniteMDP without the states it was made of"
        )
    metadata = json.loads(str(arrays["metadata"]))
    for name, asked in task_metadata(task).items():
        if metadata.get(name) != asked:
            raise ValueError(f"task must have the {name} of {str(path)!r}, {metadata.get(name)}; it has {asked}")
    cells: Cells = Grid.from_arrays(arrays) if "grid_low" in arrays else VoronoiCells.from_arrays(arrays)
    return kind(FiniteMDP.load(path), task, cells, arrays["points"], arrays["point_cell"], metadata)
