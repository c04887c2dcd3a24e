"""Experiments as data: an id, settings, a function from one cell of the settings to rows, a figure.

The cells are the product of the axes and the repetitions. ``run(cell, stream)`` returns the rows of one cell; all its random
numbers come from ``stream``, which knows the cell and the seed alone. A cell's rows are therefore the same bits in any process,
in any order, in the full sweep and in its smoke subset. Tables and figures read the rows only.
"""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Scalar = float | int | str | bool
Cell = Mapping[str, Scalar]
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
        unknown = [name for name in names if name not in self.cell]
        if unknown:
            raise ValueError(f"names must be settings of the cell, {', '.join(self.cell)}; got {unknown[0]!r}")
        settings = {k: v for k, v in self.cell.items() if k != "repetition" and (not names or k in names)}
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
    smoke : name -> values, a subset of each axis named; smoke_repetitions
    run : (cell, stream) -> rows; the cell's own settings are added to each row
    keys : columns that tell the points of the summary apart; measures : numbers that are averaged over the repetitions, the
        first being what the experiment is about
    draw : (table, summary, figure) -> None
    finding : table -> what its rows show, in their own numbers, a line: the figure's title; "": none
    caption : what the figure shows, in which units; "": the docstring of ``run``
    paper : summary -> the paper's number for each of its rows (nan: none published)
    group : "gridworld" | "gymnasium" | "sureness" | "continuous"
    requires : modules that the cells import and that an installation may lack; extra : what installs them, where it is not
        called as the module is
    """

    id: str
    title: str
    axes: Mapping[str, tuple[Scalar, ...]]
    run: Callable[[Cell, Stream], list[Row]]
    keys: tuple[str, ...]
    measures: tuple[str, ...]
    draw: Callable[[pd.DataFrame, pd.DataFrame, Figure], None]
    finding: Callable[[pd.DataFrame], str] = lambda table: ""
    caption: str = ""
    repetitions: int = 10
    smoke: Mapping[str, tuple[Scalar, ...]] = field(default_factory=dict)
    smoke_repetitions: int = 2
    paper: Callable[[pd.DataFrame], Any] | None = None
    group: str = "gridworld"
    requires: tuple[str, ...] = ()
    extra: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "caption", self.caption or " ".join((self.run.__doc__ or "").split()))
        for name, values in self.smoke.items():
            missing = [value for value in values if value not in self.axes.get(name, ())]
            if missing:
                raise ValueError(f"smoke[{name!r}] must be a subset of the axis; it has {missing}")

    def settings(self, *, smoke: bool = False, repetitions: int | None = None, seed: int = 0) -> RunSettings:
        """The full sweep, or its smoke subset."""
        axes = {name: tuple(self.smoke.get(name, values) if smoke else values) for name, values in self.axes.items()}
        count = self.smoke_repetitions if smoke else self.repetitions
        if repetitions is not None:
            count = min(repetitions, count) if smoke else repetitions
        return RunSettings(self, axes, count, seed)

    def table(self, *, repetitions: int = 1, seed: int = 0, **axes: object) -> pd.DataFrame:
        """The rows of a few cells, computed here and now: axes by name, a value or several; the others in full."""
        import pandas as pd

        unknown = sorted(set(axes) - set(self.axes))
        if unknown:
            raise ValueError(f"axes must be among {', '.join(self.axes)}; got {unknown[0]!r}")
        chosen = dict(self.axes)
        for name, values in axes.items():
            chosen[name] = tuple(_own_value(x, self.axes[name]) for x in np.atleast_1d(np.asarray(values, object)))
        cells = RunSettings(self, chosen, repetitions, seed).cells()
        return pd.DataFrame([{**cell, **row} for cell in cells for row in self.run(cell, Stream(self.id, seed, cell))])


def _own_value(value: Any, values: tuple[Scalar, ...]) -> Scalar:
    """The axis's own value where it has an equal one, so that 1000.0 names the same cell as 1000; a plain scalar else."""
    plain: Scalar = value.item() if isinstance(value, np.generic) else value
    return next((own for own in values if own == plain), plain)


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

    def __post_init__(self) -> None:
        if self.repetitions < 1:
            raise ValueError(f"repetitions must be at least 1; got {self.repetitions}")

    def cells(self) -> list[Cell]:
        """Every cell, in the order of the table."""
        names = [*self.axes, "repetition"]
        values = [*self.axes.values(), tuple(range(self.repetitions))]
        return [dict(zip(names, point, strict=True)) for point in itertools.product(*values)]

    def as_dict(self) -> dict[str, Any]:
        """For a JSON file."""
        axes = {name: list(values) for name, values in self.axes.items()}
        own = {"experiment": self.experiment.id, "axes": axes, "repetitions": self.repetitions, "seed": self.seed}
        return own | ({"asked": dict(self.asked)} if self.asked else {})


class Registry:
    """The experiments by id."""

    def __init__(self, experiments: Iterable[Experiment] = ()):
        self._experiments: dict[str, Experiment] = {}
        for experiment in experiments:
            if experiment.id in self._experiments:
                raise ValueError(f"experiment ids must differ; {experiment.id!r} is there twice")
            self._experiments[experiment.id] = experiment

    def __iter__(self) -> Iterator[Experiment]:
        return iter(self._experiments.values())

    def __getitem__(self, name: str) -> Experiment:
        if name not in self._experiments:
            near = difflib.get_close_matches(name, self._experiments, n=3, cutoff=0.4)
            hint = f"; nearest: {', '.join(near)}" if near else ""
            raise ValueError(f"experiment must be one of {', '.join(self._experiments)}; got {name!r}{hint}")
        return self._experiments[name]

    def choose(self, names: Iterable[str], *, everything: bool = False) -> list[Experiment]:
        """The experiments of these ids, or of these groups, each once."""
        members = [[own.id for own in self if own.group == name] or [name] for name in names]
        wanted = list(dict.fromkeys(itertools.chain(*members)))
        if everything and wanted:
            raise ValueError(f"--all must be given without ids; got {', '.join(wanted)}")
        if not everything and not wanted:
            raise ValueError(
                f"one experiment or more must be given, or --all; there are {', '.join(self._experiments)}"
            )
        return list(self) if everything else [self[name] for name in wanted]
