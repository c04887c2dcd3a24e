"""Discretizations as npz files: the rows of the MDP, where the states lie, and what they were made from."""

from __future__ import annotations

import json
import os
from importlib.metadata import version
from typing import Any, TypeVar

import numpy as np
from scipy import sparse

from oee_tabular import _files
from oee_tabular.mdp import FiniteMDP
from oee_tabular.tasks.continuous import ContinuousTask
from oee_tabular.tasks.discretize import Cells, Discretization, task_metadata
from oee_tabular.tasks.discretize_cells import VoronoiCells
from oee_tabular.tasks.discretize_geometry import Grid

KIND = "discretization"
Found = TypeVar("Found", bound=Discretization)


def save(found: Discretization, path: str | os.PathLike[str]) -> None:
    """One npz of plain arrays, whole or not at all."""
    mdp = found.mdp
    arrays: dict[str, Any] = {
        "metadata": np.array(json.dumps(found.metadata | {"version": version("oee-tabular")})),
        "points": found.points,
        "point_cell": found.point_cell,
        "initial": mdp.initial,
        "discount": np.array(mdp.discount),
        "rewards": mdp.rewards,
    }
    for part in ("data", "indices", "indptr"):
        arrays[f"transitions_{part}"] = getattr(mdp.transitions, part)
    if mdp.reward_data is not None:
        arrays["reward_data"] = mdp.reward_data
    _files.save_npz(path, KIND, arrays | found.cells.arrays())


def load(kind: type[Found], path: str | os.PathLike[str], task: ContinuousTask) -> Found:
    """What ``save`` wrote; ValueError where ``task`` is another one."""
    arrays = _files.load_npz(path, KIND)
    metadata = json.loads(str(arrays["metadata"]))
    for name, asked in task_metadata(task).items():
        if metadata.get(name) != asked:
            raise ValueError(f"task must have the {name} of {str(path)!r}, {metadata.get(name)}; it has {asked}")
    cells: Cells = Grid.from_arrays(arrays) if "grid_low" in arrays else VoronoiCells.from_arrays(arrays)
    n_states = len(arrays["initial"])
    parts = tuple(arrays[f"transitions_{part}"] for part in ("data", "indices", "indptr"))
    shape = (n_states * task.n_actions, n_states)
    rewards = arrays["rewards"]
    if "reward_data" in arrays:
        rewards = sparse.csr_array((arrays["reward_data"], *parts[1:]), shape=shape)
    mdp = FiniteMDP(sparse.csr_array(parts, shape=shape), rewards, arrays["initial"], float(arrays["discount"]))
    return kind(mdp, task, cells, arrays["points"], arrays["point_cell"], metadata)
