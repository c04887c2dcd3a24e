"""A run of the benchmark: the cells family x size, a seed each repetition, through the lab's runner; ``oee bench``."""

from __future__ import annotations

import math
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._sparse import row_sums
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import UNEXPLAINED
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.estimators.off_environment import NORMAL
from oee_tabular.exact import efficiency_bound, occupancy
from oee_tabular.lab.bench.families import HELD, check_seed
from oee_tabular.lab.bench.families import families as own_families
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.inputs import (
    REFERENCES,
    Source,
    choose_estimators,
    choose_families,
    estimator_of,
    modules_of,
)
from oee_tabular.lab.bench.league import League, league_of
from oee_tabular.lab.registry import Cell, Experiment, Row, RunSettings, Stream
from oee_tabular.lab.run import run_and_write, run_experiment
from oee_tabular.lab.store import Store, alone

SIZES = (0.3, 1.0, 3.0, 10.0, 30.0)
SEEDS = 40
NO_ESTIMATE: Row = {
    "value": math.nan, "error": math.nan, "standard_error": math.nan, "lower": math.nan, "upper": math.nan, "interval": "",
    "seconds": math.nan, "status": "ok",
}  # fmt: skip


def plan(
    estimators: object, *, families: object = None, sizes: Any = SIZES, seeds: int = SEEDS, seed: int = 0
) -> RunSettings:
    """Check the arguments of ``run`` and make every family once: settings of an experiment of the lab's kind."""
    count, first = _checks.positive_integer(seeds, "seeds"), check_seed(seed)
    chosen = choose_estimators(estimators)
    source = choose_families(families, first)
    values = [sizes] if np.isscalar(sizes) else list(sizes)
    numbers = sorted({_checks.number_in(value, "sizes", 0.0, np.inf) for value in values})
    if not numbers or numbers[0] <= 0:
        raise ValueError(
            "sizes must be positive numbers of transitions per stochastic state-action pair, at least one; "
            f"got {_checks.show(sizes)}"
        )
    experiment = Experiment(
        id="bench", title="Estimators on families of environment shift", group="bench",
        axes={"family": source.names, "size": tuple(numbers)}, repetitions=count,
        run=BenchCells({name: name for name in REFERENCES} | chosen, source),
        keys=("family", "size", "estimator"), measures=(), draw=lambda table, summary, figure: None,
    )  # fmt: skip
    asked = {"estimators": list(chosen), "families": source.label}
    return RunSettings(experiment, experiment.axes, count, first, asked, modules_of([*chosen.values(), source.given]))


def run(
    estimators: object = ("oee", "model-based"),
    *,
    families: object = None,
    sizes: object = SIZES,
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
    another pair). Two references are always measured on the same logs: maximum likelihood with the simulator in unobserved
    pairs, and the simulator's value.

    Parameters
    ----------
    estimators : names as in ``oee evaluate --estimators``, "evaluate" (the value and interval that ``oee.evaluate`` prints),
        "module:object", estimators; one or several, or a mapping name -> one of these
    families : None (``families()``), names of its, "module:function", a function of the seed (or without parameters) that
        makes a mapping name -> Family, or such a mapping
    sizes : transitions per stochastic state-action pair (one with more than one next state in the simulator)
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
    settings = plan(estimators, families=families, sizes=sizes, seeds=seeds, seed=seed)
    options: dict[str, Any] = {"jobs": jobs, "dask": dask, "fresh": fresh, "progress": progress}
    if output is None:
        with tempfile.TemporaryDirectory() as folder:
            store = run_experiment(Path(folder), settings, **options).store
    else:
        with alone(Path(output)):
            store = run_experiment(Path(output), settings, **options).store
    return league_of(store.table().drop(columns="repetition"))


@dataclass(frozen=True, eq=False)
class BenchCells:
    """The rows of one cell: a log of a family, every estimator on it."""

    estimators: Mapping[str, Any]
    source: Source

    def __call__(self, cell: Cell, stream: Stream) -> list[Row]:
        """One seed of family x size; the seed of the family is the run's first plus the repetition."""
        seed, name, size = stream.seed + int(cell["repetition"]), str(cell["family"]), float(cell["size"])
        family = self.source.family(name, seed)
        own = Stream(stream.experiment, seed, {"family": name, "size": size})
        problem = family.problem(family.size(size), own.generator(use="log"))
        kind = "held" if name in HELD or self.source.given is not None else "tuned"
        facts = {"seed": seed, "families": kind, **facts_of(family, problem)}
        rows = []
        for key, given in self.estimators.items():
            number = int(own.sequence(use=key).generate_state(1)[0])
            rows.append({**facts, "estimator": key, **NO_ESTIMATE, **measure(key, given, family, problem, number)})
        return rows


def facts_of(family: Family, problem: Problem) -> Row:
    """What is known exactly about a log: truth, the share of the policy's time that it covers, efficiency bound / n."""
    n, horizon = len(problem.log), family.horizon
    is_endless = horizon is None and family.target.discount == 1.0
    time = occupancy(family.target, family.policy, horizon=family.length if is_endless else horizon)
    time = np.where(family.target.absorbing()[:, None], 0.0, time)
    observed = row_sums(problem.counts).reshape(time.shape) > 0
    bound = math.inf
    if not is_endless:
        bound = efficiency_bound(family.target, family.policy, family.data_distribution, horizon=horizon)
    return {
        "n": n,
        "open_rows": family.open_rows,
        "identical": family.identical,
        "truth": family.truth,
        "covered": float(time[observed].sum() / time.sum()) if time.sum() > 0 else 1.0,
        "bound": bound / n if math.isfinite(bound) else math.nan,
    }


def measure(name: str, given: object, family: Family, problem: Problem, seed: int) -> Row:
    """What one estimator gives on one log: value, error, interval, seconds, status; what it raises is its status."""
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = as_estimator(estimator_of(name, given, family))(problem, family.policy, seed=seed)
        seconds = time.process_time() - start
        value = float(estimate.value)
        if not math.isfinite(value):
            known = estimate.status not in ("ok", UNEXPLAINED)
            return {"seconds": seconds, "status": estimate.status if known else f"the value is {value}"}
        lower, upper, method = _interval_of(estimate, value)
    except Exception as error:
        return {"status": f"{type(error).__name__}: {error}"}
    deviation = math.nan if estimate.standard_error is None else float(estimate.standard_error)
    return {"value": value, "error": value - family.truth, "standard_error": deviation, "lower": lower, "upper": upper,
            "interval": method, "seconds": seconds, "status": estimate.status}  # fmt: skip


def _interval_of(estimate: Estimate, value: float) -> tuple[float, float, str]:
    """The interval that is reported, else value +- 1.96 standard errors, else none."""
    if estimate.interval is not None:
        lower, upper = (float(end) for end in estimate.interval)
        return lower, upper, str(estimate.diagnostics.get("interval_method", "reported"))
    error = estimate.standard_error
    if error is None or not np.isfinite(error):
        return math.nan, math.nan, ""
    return value - NORMAL * error, value + NORMAL * error, "value +- 1.96 standard errors"


def bench(
    *,
    estimators: str,
    sizes: str | None,
    seeds: int,
    seed: int,
    families: str | None,
    jobs: int,
    dask: str | None,
    output: Path,
    fresh: bool,
    say: Callable[[str], None],
) -> None:
    """One run; bad arguments, families that cannot be made and folders with other settings are refused before it begins."""
    if seeds < 1:
        raise ValueError(f"--seeds must be at least 1; got {seeds}")
    _files.local(output)
    names = [name.strip() for name in estimators.split(",") if name.strip()]
    try:
        numbers = SIZES if sizes is None else [float(part) for part in sizes.split(",") if part.strip()]
    except ValueError:
        raise ValueError(
            f"--sizes must be numbers with commas between them, 0.3,1,3; got {_checks.show(sizes)}"
        ) from None
    settings = plan(names, families=families, sizes=numbers, seeds=seeds, seed=seed)
    if not fresh:
        Store(output, settings)
    command = f"oee bench --estimators {estimators}" + "".join(
        f" --{name} {value}"
        for name, value, default in (
            ("sizes", sizes, None), ("seeds", seeds, SEEDS), ("seed", seed, 0), ("families", families, None)
        )
        if value != default
    )  # fmt: skip

    def write(store: Store) -> None:
        cells, league = settings.experiment.run, league_of(store.table().drop(columns="repetition"))
        assert isinstance(cells, BenchCells)
        league.save(output, about={x: cells.source.family(x, seed).about for x in cells.source.names}, command=command)
        say(f"{league}\n")

    run_and_write(output, settings, write, say=say, jobs=jobs, dask=dask, fresh=fresh, progress=sys.stderr.isatty())
    if families is None:
        for sentence in own_families(seed).left_out.values():
            say(sentence)
