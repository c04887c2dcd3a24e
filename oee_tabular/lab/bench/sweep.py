"""Run of the benchmark in Python: its plan, and the league of its rows."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import conform
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.cell import measure_cell
from oee_tabular.lab.bench.estimators import (
    REFERENCES,
    EstimatorsLike,
    choose_estimators,
)
from oee_tabular.lab.bench.family import check_seed
from oee_tabular.lab.bench.league import League, labels_of, league_of
from oee_tabular.lab.bench.sources import FamiliesLike, choose_families, modules_of
from oee_tabular.lab.experiment import Experiment, RunSettings, check_cells
from oee_tabular.lab.run import alone, run_experiment

SIZES = (0.3, 1.0, 3.0, 10.0, 30.0)
SEEDS = 40
TIMEOUT_SECONDS = 600.0  # seconds of an estimate


@suggest_keywords
def run(
    estimators: EstimatorsLike = ("oee", "model-based"),
    *,
    families: FamiliesLike | None = None,
    sizes: float | Iterable[float] = SIZES,
    seeds: int = SEEDS,
    seed: int = 0,
    timeout: float = TIMEOUT_SECONDS,
    jobs: int = 1,
    dask: str | None = None,
    output: str | PathLike[str] | None = None,
    fresh: bool = False,
    progress: bool = False,
) -> League:
    """Measure estimators on families of environment shift where the truth is exact.

    Each cell is a family and a size of its logs. Each seed of a cell gives another log
    (and, where a family has random parts, another pair of environments). Two references
    are always measured on the same logs: maximum likelihood with the simulator in
    unobserved pairs, and the simulator's value.

    Parameters
    ----------
    estimators : str, callable, sequence of these, or mapping of str to these
        Names as in ``oee evaluate --estimators``, "evaluate" (the value and interval
        that ``oee.evaluate`` prints), "module:object", or estimators. A mapping gives
        each of them the name of its row.
    families : str, sequence of str, mapping or callable, optional
        Names among ``families()``, "module:function", a mapping name -> Family, or a
        function of the seed (or without parameters) that makes such a mapping. None
        means all of ``families()``.
    sizes : float or iterable of float, optional
        Transitions per stochastic state-action pair (one with more than one next state
        in the simulator).
    seeds : int, default 40
        Number of logs of each cell.
    seed : int, default 0
        The first seed, from 0. The rows of a seed are the same in any run.
    timeout : float, default 600.0
        Seconds that an estimate may take. One that takes longer is a row with that
        reason (not on Windows, nor on dask).
    jobs : int, default 1
        Number of processes on this machine; -1 means one a core.
    dask : str, optional
        Address of a dask scheduler; the cells go there instead.
    output : str or path, optional
        Folder that keeps finished cells, so that an interrupted run goes on. None keeps
        nothing.
    fresh : bool, default False
        Whether the folder is emptied first.
    progress : bool, default False
        Whether a progress bar is shown.

    Returns
    -------
    League
        Its ``table`` has a row for each seed, ``cells`` is taken over the seeds and
        ``league`` over the cells.

    Raises
    ------
    ValueError
        If an argument is bad or a family cannot be made. What an estimator raises is a
        row with its reason.

    See Also
    --------
    league_of : The league of rows that were computed before.
    families : The families by name.

    Notes
    -----
    The cost is families x sizes x seeds x the estimators' time. Every mode gives the
    same bits, but for ``seconds`` (process time).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> found = oee.bench.run(
    ...     "oee", families=["machine", "queue25"], sizes=[3], seeds=4
    ... )
    >>> found.league["estimator"].tolist(), len(found.table)
    (['maximum-likelihood', 'simulator', 'oee'], 24)
    """
    _checks.boolean(fresh, "fresh")
    _checks.boolean(progress, "progress")
    settings = plan(
        estimators,
        families=families,
        sizes=sizes,
        seeds=seeds,
        seed=seed,
        timeout=timeout,
    )
    conform(output, "output", str | PathLike | None)
    place: AbstractContextManager[str | PathLike[str]]
    if output is None:
        place = tempfile.TemporaryDirectory()
    else:
        place = nullcontext(output)
    with place as folder, alone(Path(folder)):
        store = run_experiment(
            Path(folder), settings, jobs=jobs, dask=dask, fresh=fresh, progress=progress
        )
    return league_of(store.table().drop(columns="repetition")).with_labels(
        labels_of(choose_estimators(estimators))
    )


def plan(
    estimators: EstimatorsLike,
    *,
    families: FamiliesLike | None = None,
    sizes: float | Iterable[float] = SIZES,
    seeds: int = SEEDS,
    seed: int = 0,
    timeout: float = TIMEOUT_SECONDS,
) -> RunSettings:
    """Check the arguments of ``run`` and return them as settings of an experiment.

    Every family is made once, so that a bad one is reported before the run begins.
    """
    count = _checks.positive_integer(seeds, "seeds")
    first = check_seed(seed)
    check_cells({}, count, "seeds")
    limit = _checks.number_in(timeout, "timeout", 0.0, 1e6, open_ends=True)
    chosen = choose_estimators(estimators)
    source, names = choose_families(families, first)
    values = (sizes,)
    if not np.isscalar(sizes):
        values = _checks.collection(sizes, "sizes", "numbers")
    numbers = sorted(
        {
            _checks.number_in(value, "sizes", 0.0, np.inf, open_ends=True)
            for value in values
        }
    )
    if not numbers:
        raise ArgumentError("sizes", "must name at least one; it is empty")
    experiment = Experiment(
        id="bench",
        title="Estimators on families of environment shift",
        group="bench",
        axes={"family": names, "size": tuple(numbers)},
        repetitions=count,
        run=functools.partial(
            measure_cell,
            estimators={name: name for name in REFERENCES} | chosen,
            source=source,
            timeout=limit,
        ),
        keys=("family", "size", "estimator"),
        measures=(),
        draw=lambda table, summary, figure: None,
    )
    label = "given"
    if source is None:
        label = "the package's"
    elif isinstance(source, str):
        label = source
    asked: dict[str, Any] = {"estimators": list(chosen), "families": label}
    # The default timeout is not among the settings.
    if limit != TIMEOUT_SECONDS:
        asked["timeout"] = limit
    return RunSettings(
        experiment,
        experiment.axes,
        count,
        first,
        asked,
        modules_of([*chosen.values(), source]),
    )
