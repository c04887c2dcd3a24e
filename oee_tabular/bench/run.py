"""A run of the benchmark: the cells family x size, a seed each repetition, through the experiments' runner and store."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.bench.given import REFERENCES, Source, chosen_estimators, modules_of, source_of
from oee_tabular.bench.league import League, league_of
from oee_tabular.bench.measured import Cells
from oee_tabular.experiments.output import table_of
from oee_tabular.experiments.registry import Experiment, Settings
from oee_tabular.experiments.run import Sweep, run_experiment
from oee_tabular.experiments.store import Store, alone

SIZES = (0.3, 1.0, 3.0, 10.0, 30.0)
SEEDS = 40


@dataclass(frozen=True, eq=False)
class Plan:
    """What a run is to do: an experiment of the registry's kind and its settings."""

    experiment: Experiment
    settings: Settings
    source: Source


def plan(estimators: Any, *, families: Any = None, sizes: Any = SIZES, seeds: int = SEEDS, seed: int = 0) -> Plan:
    """Check the arguments of ``run`` and make every family once."""
    count = _checks.positive_integer(seeds, "seeds")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed must be an integer from 0; got {seed!r}")
    chosen = chosen_estimators(estimators)
    source = source_of(families, int(seed))
    experiment = Experiment(
        id="bench",
        title="Estimators on families of environment shift",
        axes={"family": source.names, "size": _sizes(sizes)},
        run=Cells({name: name for name in REFERENCES} | chosen, source),
        keys=("family", "size", "estimator"),
        measures=("error",),
        draw=lambda table, summary, figure: None,
        repetitions=count,
        group="bench",
    )
    asked = {"estimators": list(chosen), "families": source.label}
    modules = tuple(sorted({*modules_of(chosen), *modules_of({"families": source.given})}))
    return Plan(experiment, Settings("bench", experiment.axes, count, int(seed), asked, modules), source)


def run(
    estimators: Any = ("oee", "model-based"),
    *,
    families: Any = None,
    sizes: Any = SIZES,
    seeds: int = SEEDS,
    seed: int = 0,
    jobs: int = 1,
    dask: str | None = None,
    output: Any = None,
    fresh: bool = False,
    progress: bool = False,
) -> League:
    """Measure estimators on families of environment shift where the truth is exact.

    Each cell is a family and a size of its logs; each seed of a cell another log (and, where a family has random parts,
    another pair). Two references are always measured on the same logs: maximum likelihood with the simulator in unseen rows,
    and the simulator's value.

    Parameters
    ----------
    estimators : names as in ``oee evaluate --estimators``, "evaluate" (the value and interval that ``oee.evaluate`` prints),
        "module:object", estimators; one or several, or a mapping name -> one of these
    families : None (``families()``), names of its, "module:function", a function of the seed (or without parameters) that
        makes a mapping name -> Family, or such a mapping
    sizes : moves per open row (an (s, a) with more than one next state in the simulator); n = round(size * open rows)
    seeds : logs of each cell
    seed : the first one, from 0; a seed's rows are the same in any run
    jobs : processes on this machine; -1: one a core
    dask : address of a dask scheduler; the cells go there instead
    output : folder that keeps finished cells: an interrupted run goes on; None: nothing is kept
    fresh : empty the folder first
    progress : whether a bar is shown

    Returns
    -------
    League
        ``table`` (a row for each family, size, seed and estimator), ``cells`` (over the seeds), ``league`` (over the cells).

    Raises
    ------
    ValueError
        Bad arguments; a family that cannot be made. What an estimator raises is a row with its reason.

    Notes
    -----
    Cost: families x sizes x seeds x the estimators' time. The same bits in every mode, but for ``seconds`` (process time).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> found = oee.bench.run("oee", families=["machine", "queue25"], sizes=[3], seeds=4)
    >>> found.league["estimator"].tolist(), len(found.table)
    (['maximum-likelihood', 'simulator', 'oee'], 24)
    """
    _checks.boolean(fresh, "fresh")
    _checks.boolean(progress, "progress")
    planned = plan(estimators, families=families, sizes=sizes, seeds=seeds, seed=seed)
    options: dict[str, Any] = {"jobs": jobs, "dask": dask, "fresh": fresh, "progress": progress}
    if output is not None:
        with alone(Path(output)):
            return carry_out(planned, Path(output), **options)[0]
    with tempfile.TemporaryDirectory() as folder:
        return carry_out(planned, Path(folder), **options)[0]


def carry_out(planned: Plan, folder: Path, **options: Any) -> tuple[League, Sweep]:
    """Compute what the folder does not have yet; the league of all."""
    sweep = run_experiment(planned.experiment, folder, planned.settings, **options)
    table = table_of(Store(folder, planned.settings)).drop(columns="repetition")
    return league_of(table), sweep


def _sizes(sizes: Any) -> tuple[float, ...]:
    """Positive numbers, each once, the smallest first."""
    values = [sizes] if np.isscalar(sizes) else list(sizes)
    found = sorted({_checks.number_in(value, "sizes", 0.0, np.inf) for value in values})
    if not found or found[0] <= 0:
        raise ValueError(f"sizes must be positive numbers of moves per open row, at least one; got {sizes!r}")
    return tuple(found)
