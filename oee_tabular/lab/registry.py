"""Experiments as data: an id, settings, a function from one cell of the settings to rows, a figure.

The cells are the product of the axes and the repetitions. ``run(cell, stream)`` returns the rows of one cell; all its random
numbers come from ``stream``, which knows the cell and the seed alone. A cell's rows are therefore the same bits in any process,
in any order, in the full sweep and in its smoke subset. Tables and figures read the rows only.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

Scalar = float | int | str | bool
Cell = Mapping[str, Any]  # name -> Scalar
Row = dict[str, Any]


@dataclass(frozen=True)
class Stream:
    """The random numbers of a cell: ``numpy.random.SeedSequence(seed, spawn_key=(words, repetition))``.

    The words are a digest of the experiment's id, of the settings named (all of the cell's by default; cells that name the
    same ones share their random numbers) and of what they are for (``use``): numbers for different uses are independent.
    """

    experiment: str
    seed: int
    cell: Cell

    def sequence(self, *names: str, use: str = "") -> np.random.SeedSequence:
        """The seed sequence of the named settings of the cell; of all without names."""
        settings = {name: self.cell[name] for name in names or self.cell if name != "repetition"}
        text = json.dumps([self.experiment, settings, *([use] if use else [])], sort_keys=True)
        words = np.frombuffer(hashlib.sha256(text.encode()).digest()[:16], dtype=">u4")
        key = (*(int(word) for word in words), int(self.cell.get("repetition", 0)))
        return np.random.SeedSequence(self.seed, spawn_key=key)

    def generator(self, *names: str, use: str = "") -> np.random.Generator:
        """A new generator of ``sequence(*names, use=use)``; the same call gives the same numbers again."""
        return np.random.default_rng(self.sequence(*names, use=use))


@dataclass(frozen=True, eq=False)
class Experiment:
    """One figure or table.

    Attributes
    ----------
    id, title : as in ``oee reproduce ID``; the title is that of the summary
    axes : name -> values; repetitions : seeds of each cell of the axes
    smoke : name -> values of a smoke run, of one seed; the first of an axis that is not named
    run : (cell, stream) -> rows; the cell's own settings are added to each row. Its docstring is the caption
    keys : columns that tell the points of the summary apart; measures : numbers that are averaged over the repetitions, the
        first being what the experiment is about
    draw : (table, summary, figure) -> None
    finding : table -> what its rows show, in their own numbers, a line: the figure's title
    paper : summary -> the paper's number for each of its rows (nan: none published)
    group : "gridworld" | "gymnasium" | "sureness" | "continuous" | "bench"
    requires : modules that the cells import and that an installation may lack; extra : what installs them, where it is not
        called as the module is
    """

    id: str
    title: str
    axes: Mapping[str, tuple[Scalar, ...]]
    run: Callable[[Cell, Stream], list[Row]]
    keys: tuple[str, ...]
    measures: tuple[str, ...]
    draw: Callable[[pd.DataFrame, pd.DataFrame, Any], None]
    finding: Callable[[pd.DataFrame], str] = lambda table: ""
    repetitions: int = 10
    smoke: Mapping[str, tuple[Scalar, ...]] = field(default_factory=dict)
    paper: Callable[[pd.DataFrame], Any] | None = None
    group: str = "gridworld"
    requires: tuple[str, ...] = ()
    extra: str = ""

    @property
    def caption(self) -> str:
        """What the figure shows, in which units."""
        return " ".join((self.run.__doc__ or "").split())

    def settings(self, *, smoke: bool = False, repetitions: int | None = None, seed: int = 0) -> RunSettings:
        """The full sweep, or its smoke subset; ``repetitions`` instead of the experiment's own."""
        first = {name: values[:1] for name, values in self.axes.items()}
        axes = {**self.axes, **first, **self.smoke} if smoke else self.axes
        return RunSettings(self, axes, repetitions or (1 if smoke else self.repetitions), seed)


def experiment(title: str, *, draw: Any, **options: Any) -> Callable[[Callable[[Cell, Stream], list[Row]]], Experiment]:
    """Make the function below an experiment of its name; without ``finding``, that of ``draw``, which is ``Panels``."""
    options = {"finding": getattr(draw, "find", None), **options}
    return lambda run: Experiment(id=run.__name__, title=title, run=run, draw=draw, **options)


@dataclass(frozen=True, eq=False)
class RunSettings:
    """What a results folder is made from.

    ``asked`` are settings that are no axes (JSON's types): results of others are not taken for these. ``modules`` are a
    user's modules that the cells run: their files are part of the code.
    """

    experiment: Experiment
    axes: Mapping[str, tuple[Scalar, ...]]
    repetitions: int
    seed: int
    asked: Mapping[str, Any] = field(default_factory=dict)
    modules: tuple[str, ...] = ()

    def cells(self) -> list[Cell]:
        """Every cell, in the order of the table."""
        axes = {**self.axes, "repetition": range(self.repetitions)}
        return [dict(zip(axes, point, strict=True)) for point in itertools.product(*axes.values())]

    def as_dict(self) -> dict[str, Any]:
        """For a JSON file."""
        axes = {name: list(values) for name, values in self.axes.items()}
        own = {"experiment": self.experiment.id, "axes": axes, "repetitions": self.repetitions, "seed": self.seed}
        return own | ({"asked": dict(self.asked)} if self.asked else {})
