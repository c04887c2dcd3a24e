"""A run of the benchmark: the cells family x size, a seed each repetition, through the experiments' runner; ``oee bench``."""

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
from oee_tabular.lab.bench.families import checked_seed
from oee_tabular.lab.bench.families import families as own_families
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.given import REFERENCES, Source, chosen_estimators, estimator_of, modules_of, source_of
from oee_tabular.lab.bench.league import League, league_of
from oee_tabular.lab.output import table_of
from oee_tabular.lab.registry import Cell, Experiment, Row, Settings, Stream
from oee_tabular.lab.run import Sweep, run_experiment
from oee_tabular.lab.store import Store, alone

SIZES = (0.3, 1.0, 3.0, 10.0, 30.0)
SEEDS = 40


@dataclass(frozen=True, eq=False)
class Plan:
    """What a run is to do: an experiment of the registry's kind and its settings."""

    experiment: Experiment
    settings: Settings
    source: Source


def plan(
    estimators: object, *, families: object = None, sizes: object = SIZES, seeds: int = SEEDS, seed: int = 0
) -> Plan:
    """Check the arguments of ``run`` and make every family once."""
    count, first = _checks.positive_integer(seeds, "seeds"), checked_seed(seed)
    chosen = chosen_estimators(estimators)
    source = source_of(families, first)
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
    return Plan(experiment, Settings("bench", experiment.axes, count, first, asked, modules), source)


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
        raise ValueError(
            f"sizes must be positive numbers of moves per open row, at least one; got {_checks.show(sizes)}"
        )
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Cells:
    """The rows of one cell: a log of a family, every estimator on it."""

    estimators: Mapping[str, Any]
    source: Source

    def __call__(self, cell: Cell, stream: Stream) -> list[Row]:
        """One seed of family x size; the seed of the family is the run's first plus the repetition."""
        seed, name, size = stream.seed + int(cell["repetition"]), str(cell["family"]), float(cell["size"])
        family = self.source.family(name, seed)
        own = Stream(stream.experiment, seed, {"family": name, "size": size})
        problem = family.problem(family.size(size), own.generator(use="log"))
        facts = {"seed": seed, **facts_of(family, problem)}
        return [
            facts | measure(key, given, family, problem, int(own.sequence(use=key).generate_state(1)[0]))
            for key, given in self.estimators.items()
        ]


def facts_of(family: Family, problem: Problem) -> Row:
    """What is known exactly about a log: truth, the share of the policy's time that it covers, efficiency bound / n."""
    n, horizon = len(problem.log), family.horizon
    endless = horizon is None and family.target.discount == 1.0
    time = occupancy(family.target, family.policy, horizon=family.length if endless else horizon)
    time = np.where(family.target.absorbing()[:, None], 0.0, time)
    seen = row_sums(problem.counts).reshape(time.shape) > 0
    bound = np.inf
    if not endless:
        bound = efficiency_bound(family.target, family.policy, family.data_distribution, horizon=horizon)
    return {
        "n": n,
        "open_rows": family.open_rows,
        "identical": family.identical,
        "truth": family.truth,
        "covered": float(time[seen].sum() / time.sum()) if time.sum() > 0 else 1.0,
        "bound": bound / n if np.isfinite(bound) else float("nan"),
    }


def measure(name: str, given: object, family: Family, problem: Problem, seed: int) -> Row:
    """The row of one estimator on one log: value, error, interval, seconds, status; what it raises is its status."""
    row: Row = {"estimator": name, "value": math.nan, "error": math.nan, "lower": math.nan, "upper": math.nan,
                "interval": "", "seconds": math.nan, "status": "ok"}  # fmt: skip
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            estimate = as_estimator(estimator_of(name, given, family))(problem, family.policy, seed=seed)
        seconds = time.process_time() - start
        return row | {"seconds": seconds} | _read(estimate, family.truth)
    except Exception as error:
        return row | {"status": f"{type(error).__name__}: {error}"}


def _read(estimate: object, truth: float) -> Row:
    """What an estimate says; a value that is no finite number is none."""
    if not isinstance(estimate, Estimate):
        raise TypeError(f"an estimator must return an Estimate; it returned {type(estimate).__name__}")
    value = float(estimate.value)
    if not math.isfinite(value):
        return {"status": estimate.status if estimate.status not in ("ok", UNEXPLAINED) else f"the value is {value}"}
    lower, upper, method = _interval(estimate, value)
    return {"value": value, "error": value - truth, "lower": lower, "upper": upper, "interval": method,
            "status": estimate.status}  # fmt: skip


def _interval(estimate: Estimate, value: float) -> tuple[float, float, str]:
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
    planned = plan(
        _names(estimators), families=families, sizes=SIZES if sizes is None else _numbers(sizes), seeds=seeds, seed=seed
    )
    if not fresh:
        Store(output, planned.settings)
    start = time.perf_counter()
    with alone(output):
        found, sweep = carry_out(planned, output, jobs=jobs, dask=dask, fresh=fresh, progress=sys.stderr.isatty())
        about = {name: planned.source.family(name, seed).about for name in planned.source.names}
        found.save(output, about=about, command=_command(planned, estimators, sizes, families))
    say(str(found))
    say(f"\n{sweep} ({time.perf_counter() - start:.0f} s)")
    if families is None:
        for sentence in own_families(seed).left_out.values():
            say(sentence)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise ValueError(
            f"--sizes must be numbers with commas between them, 0.3,1,3; got {_checks.show(text)}"
        ) from None


def _command(planned: Plan, estimators: str, sizes: str | None, families: str | None) -> str:
    """What makes the same folder again."""
    words = ["oee bench", f"--estimators {estimators}"]
    words += [] if sizes is None else [f"--sizes {sizes}"]
    words += [f"--seeds {planned.settings.repetitions}"] if planned.settings.repetitions != SEEDS else []
    words += [f"--seed {planned.settings.seed}"] if planned.settings.seed else []
    return " ".join([*words, *([] if families is None else [f"--families {families}"])])
