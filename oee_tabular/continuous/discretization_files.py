"""Discretizations as npz files: the rows of the MDP, where the states lie, and what they were made from.

A file is one of a FiniteMDP with more in it: ``FiniteMDP.load`` reads the MDP alone.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, TypeVar

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.grid import Cells, Grid, Places, VoronoiCells
from oee_tabular.continuous.task import ContinuousTask, task_metadata
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.finite_mdp import KIND

Found = TypeVar("Found", bound=Places)


def save(found: Places, mdp: FiniteMDP, metadata: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """One npz of plain arrays, whole or not at all."""
    arrays: dict[str, object] = {
        "metadata": np.array(json.dumps(metadata | {"version": version("oee-tabular")})),
        "points": found.points,
        "point_cell": found.point_cell,
    }
    _files.save_npz(path, KIND, mdp.arrays() | arrays | found.cells.arrays())


def load(kind: Callable[..., Found], path: str | os.PathLike[str], task: ContinuousTask) -> Found:
    """What ``save`` wrote; ValueError where ``task`` is another one."""
    arrays = _files.load_npz(path, KIND)
    if "metadata" not in arrays:
        raise ValueError(
            f"{str(path)!r} must hold a Discretization; it holds a FiniteMDP without the states it was made of"
        )
    with _files.parts_of(path, "a Discretization"):
        metadata = dict(json.loads(str(arrays["metadata"])))
    for name, asked in task_metadata(task).items():
        if metadata.get(name) != asked:
            raise ValueError(f"task must have the {name} of {str(path)!r}, {metadata.get(name)}; it has {asked}")
    mdp = FiniteMDP.load(path)
    with _files.parts_of(path, "a Discretization"):
        cells: Cells = Grid.from_arrays(arrays) if "grid_low" in arrays else VoronoiCells.from_arrays(arrays)
        wide = cells.arrays()["grid_low" if "grid_low" in arrays else "cell_scale"].size
        if wide != len(task.feature_names) or cells.n_cells > mdp.n_states:
            raise ValueError(
                f"cells must be at most {mdp.n_states}, of {len(task.feature_names)} features; "
                f"they are {cells.n_cells} of {wide}"
            )
        points, point_cell = _points(arrays, task, cells.n_cells)
    return kind(mdp, task, cells, points, point_cell, metadata)


def _points(arrays: dict[str, Any], task: ContinuousTask, n_cells: int) -> tuple[Array, IntArray]:
    """States that the MDP was made of, and the cell of each."""
    points, cell = _checks.float_array(arrays["points"], "points", ndim=2), arrays["point_cell"]
    _checks.require_finite(points, "points")
    if cell.dtype.kind not in "iu" or cell.shape != points.shape[:1] or points.shape[1] != task.n_state:
        raise ValueError(
            f"points must have shape (n, {task.n_state}) and point_cell n integers; they have {points.shape} and {cell.shape}"
        )
    if cell.size and not 0 <= cell.min() <= cell.max() < n_cells:
        raise ValueError(f"point_cell must be in 0..{n_cells - 1}; it is {cell.min()} to {cell.max()}")
    return points, cell.astype(np.int64)
