"""All experiments by id; ``oee reproduce``: choose, run, write."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from oee_tabular import _files
from oee_tabular.lab import output as out
from oee_tabular.lab.bench.ranking import RANKING
from oee_tabular.lab.experiments.programs import LAMBDA, MISSPECIFIED, NORMALISATION, RATE, RENYI
from oee_tabular.lab.experiments.sureness import COLLECTION, COVERAGE, COVERAGE_LAKE, EFFICIENCY
from oee_tabular.lab.experiments.toy_text import CLIFF_WALKING, FROZEN_LAKE, TAXI
from oee_tabular.lab.experiments.values import DATA_POLICY, ESTIMANDS, FIGURE_1BCD, HORIZON_EXPERIMENT
from oee_tabular.lab.experiments.zeta import FIGURE_1A, NETWORKS
from oee_tabular.lab.registry import Experiment, Registry
from oee_tabular.lab.robots.cartpole import CARTPOLE_CHOICE, CARTPOLE_DATA, FIGURE_2, RESOLUTION
from oee_tabular.lab.robots.changes.coverage import RESIDUAL_COVERAGE
from oee_tabular.lab.robots.changes.experiment import CHANGES
from oee_tabular.lab.robots.kinova import TABLE_1
from oee_tabular.lab.robots.reacher import FIGURE_3
from oee_tabular.lab.run import require_modules, run_and_write
from oee_tabular.lab.store import Store, refuse_links

EXPERIMENTS = Registry(
    [
        FIGURE_1A, FIGURE_1BCD, ESTIMANDS, HORIZON_EXPERIMENT, DATA_POLICY, RATE, RENYI, MISSPECIFIED, NORMALISATION, LAMBDA,
        FROZEN_LAKE, TAXI, CLIFF_WALKING, COVERAGE, COVERAGE_LAKE, EFFICIENCY, COLLECTION, NETWORKS, RANKING,
        FIGURE_2, RESOLUTION, CARTPOLE_DATA, CARTPOLE_CHOICE, FIGURE_3, TABLE_1, CHANGES,
        RESIDUAL_COVERAGE,
    ]
)  # fmt: skip


def listing() -> str:
    """Ids, cells of the full sweep, and titles, by group."""
    lines, group = [], ""
    for experiment in EXPERIMENTS:
        if experiment.group != group:
            group = experiment.group
            lines.append(f"{group}:")
        cells = len(experiment.settings().cells())
        lines.append(f"  {experiment.id:<14} {cells:>5} cells  {experiment.title}")
    return "\n".join(lines)


def reproduce(
    names: Sequence[str],
    *,
    everything: bool,
    smoke: bool,
    seeds: int | None,
    seed: int,
    jobs: int,
    dask: str | None,
    output: Path,
    fresh: bool,
    say: Callable[[str], None],
) -> None:
    """Run the experiments one after the other; the folder's index is written last.

    An experiment whose extra is not installed is left out with a sentence, and an error where nothing else was asked for.
    Folders with other settings are refused before anything runs.
    """
    if seeds is not None and seeds < 1:
        raise ValueError(f"--seeds must be at least 1; got {seeds}")
    _files.local(output)
    chosen: list[Experiment] = []
    missing: list[ImportError] = []
    for experiment in EXPERIMENTS.choose(names, everything=everything):
        try:
            require_modules(experiment)
            chosen.append(experiment)
        except ImportError as error:
            missing.append(error)
    if missing and not chosen:
        raise missing[0]
    folder = output / "smoke" if smoke else output
    refuse_links(output, ["smoke", *(f"smoke/{e.id}" if smoke else e.id for e in chosen)], are_folders=True)
    every = [experiment.settings(smoke=smoke, repetitions=seeds, seed=seed) for experiment in chosen]
    if not fresh:
        for settings in every:
            Store(folder / settings.experiment.id, settings)
    for settings in every:
        run_and_write(
            folder / settings.experiment.id, settings, out.write, say=say,
            jobs=jobs, dask=dask, fresh=fresh, progress=sys.stderr.isatty(),
        )  # fmt: skip
    say(f"Index: {out.index(folder, EXPERIMENTS)}")
    for reason in missing:
        say(f"Left out: {reason}")
