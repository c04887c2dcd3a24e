"""Benchmark of estimators of a policy's value where the truth is exact.

``run`` (and ``oee bench``) measures estimators on families of environment shift. Its
cells are the products of families and sizes of the log; a repetition of a cell is
another seed. They go through the lab's runner. Estimators and families are given by
name, as MODULE:OBJECT or as objects. A ``Family`` is a pair of environments;
``families`` has the package's own by name; ``league_of`` makes the ``League`` of a
run's rows.
"""

from __future__ import annotations

import functools
import inspect
import math
import shlex
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._arguments import own_modules, own_object
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import time_limit
from oee_tabular._progress import is_terminal
from oee_tabular._results import conform
from oee_tabular._sparse import row_sums
from oee_tabular.estimators import Estimate, Estimator, ModelBased, Problem, Simulator
from oee_tabular.estimators.estimate import UNEXPLAINED
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.estimators.names import ALIASES, named_estimators
from oee_tabular.estimators.names import names as estimator_names
from oee_tabular.estimators.off_environment import NORMAL
from oee_tabular.exact import efficiency_bound, occupancy
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.adapters import PEERS, Peer
from oee_tabular.lab.bench.families import (
    HELD,
    REAL,
    Families,
    families,
    garnet_worse,
)
from oee_tabular.lab.bench.families_chains import tandem
from oee_tabular.lab.bench.family import Family, check_seed
from oee_tabular.lab.bench.league import (
    ELSE,
    LIKELIHOOD,
    SIMULATOR,
    League,
    check_labels,
    league_files,
    league_of,
)
from oee_tabular.lab.experiment import (
    Cell,
    Experiment,
    Row,
    RunSettings,
    Stream,
    check_cells,
)
from oee_tabular.lab.run import Store, alone, run_and_write, run_experiment
from oee_tabular.testing import own_estimator
from oee_tabular.typing import PolicyLike, SeedNumbers

__all__ = [
    "Families",
    "Family",
    "League",
    "families",
    "garnet_worse",
    "league_of",
    "run",
    "tandem",
]

# An estimator is given by name, or as a callable as in ``oee.testing``.
EstimatorLike: TypeAlias = str | Callable[..., Any]
EstimatorsLike: TypeAlias = (
    EstimatorLike | Sequence[EstimatorLike] | Mapping[str, EstimatorLike]
)
FamiliesLike: TypeAlias = (
    str | Iterable[str] | Mapping[str, Family] | Callable[..., Mapping[str, Family]]
)

SIZES = (0.3, 1.0, 3.0, 10.0, 30.0)
SEEDS = 40
TIMEOUT_SECONDS = 600.0  # seconds of an estimate
REFERENCES: Mapping[str, Estimator] = {
    LIKELIHOOD: ModelBased(fallback="simulator"),
    SIMULATOR: Simulator(),
}


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
        that ``oee.evaluate`` prints), "scope-rl:NAME", "offline-rl-ope:NAME",
        "module:object", or estimators. A mapping gives each of them the name of its
        row.
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
    same
    bits, but for ``seconds`` (process time).

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


def labels_of(chosen: Mapping[str, Any]) -> dict[str, str]:
    """Return what rows of the package's estimators are called by what they do.

    Some differ in nothing but what stands for unrecorded pairs.
    """
    kinds = {
        name: ALIASES.get(given, given)
        for name, given in chosen.items()
        if isinstance(given, str)
    }
    return {
        name: f"{name}, else {ELSE[kind]}"
        for name, kind in kinds.items()
        if kind in ELSE
    }


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


def measure_cell(
    cell: Cell,
    stream: Stream,
    *,
    estimators: Mapping[str, Any],
    source: Any,
    timeout: float,
) -> list[Row]:
    """Measure every estimator on the log of one seed of a family and a size.

    The seed of the family is the run's first seed plus the repetition.
    """
    seed = stream.seed + int(cell["repetition"])
    name = str(cell["family"])
    size = float(cell["size"])
    family = find_family(source, name, seed)
    try:
        number = family.size(size)
    except ArgumentError as error:
        raise ArgumentError("sizes", f"{error.rule}, for the family {name}") from None
    own = Stream(stream.experiment, seed, {"family": name, "size": size})
    problem = family.problem(number, own.generator(use="log"))
    facts = {
        "seed": seed,
        "families": kind_of(name, source),
        **facts_of(family, problem),
    }
    seeds = {key: int(own.sequence(use=key).generate_state(1)[0]) for key in estimators}
    return [
        {
            **facts,
            "estimator": key,
            **measure(key, given, family, problem, seeds[key], timeout),
        }
        for key, given in estimators.items()
    ]


def kind_of(name: str, source: object) -> str:
    """Return how the league marks a family: tuned, held or real.

    Families of a user's own count as held.
    """
    if source is not None or name in HELD:
        return "held"
    return "real" if name in REAL else "tuned"


def facts_of(family: Family, problem: Problem) -> Row:
    """Compute what is known exactly about a log.

    These are the truth, the share of the policy's time that the log covers, the
    efficiency bound / n, and how far the policy is from the recorded one.
    """
    n = len(problem.log)
    horizon = family.horizon
    # Without a discount and a horizon the occupancy may be infinite. An episode's is
    # finite.
    is_endless = horizon is None and family.target.discount == 1.0
    steps = family.length if is_endless else horizon
    time = occupancy(family.target, family.policy, horizon=steps)
    time = np.where(family.target.absorbing()[:, None], 0.0, time)
    observed = row_sums(problem.counts).reshape(time.shape) > 0
    covered = 1.0
    distance = 0.0
    if time.sum() > 0:
        covered = float(time[observed].sum() / time.sum())
        shares = time / time.sum()
        distance = 1.0 - float(np.minimum(shares, family.data_distribution).sum())
    bound = math.inf
    if not is_endless:
        bound = efficiency_bound(
            family.target, family.policy, family.data_distribution, horizon=horizon
        )
    return {
        "n": n,
        "open_rows": family.open_rows,
        "identical": family.identical,
        "truth": family.truth,
        "covered": covered,
        "distance": distance,
        "bound": bound / n if math.isfinite(bound) else math.nan,
    }


def measure(
    name: str,
    given: object,
    family: Family,
    problem: Problem,
    seed: int,
    timeout: float,
) -> Row:
    """Measure what one estimator gives on one log.

    The row has its value, error, interval, seconds and status; an exception is its
    status. The interval is the reported one, else value +- 1.96 standard errors, else
    none.
    """
    row: Row = dict.fromkeys(
        ("value", "error", "standard_error", "lower", "upper", "interval", "seconds"),
        math.nan,
    )
    row |= {"interval": "", "status": "ok"}
    start = time.process_time()
    try:
        with warnings.catch_warnings(), time_limit(timeout):
            warnings.simplefilter("ignore")
            estimate = as_estimator(estimator_of(name, given, family))(
                problem, family.policy, seed=seed
            )
        seconds = time.process_time() - start
        value = float(estimate.value)
        if not math.isfinite(value):
            reason = estimate.status
            if reason in ("ok", UNEXPLAINED):
                reason = f"the value is {value}"
            return row | {"seconds": seconds, "status": reason}
        error = math.nan
        if estimate.standard_error is not None:
            error = float(estimate.standard_error)
        lower = value - NORMAL * error
        upper = value + NORMAL * error
        method = "value +- 1.96 standard errors"
        if estimate.interval is not None:
            lower, upper = (float(end) for end in estimate.interval)
            method = str(estimate.diagnostics.get("interval_method", "reported"))
        elif not math.isfinite(error):
            lower = math.nan
            upper = math.nan
            method = ""
    except Exception as failure:
        return row | {"status": f"{type(failure).__name__}: {failure}"}
    return row | {
        "value": value,
        "error": value - family.truth,
        "standard_error": error,
        "lower": lower,
        "upper": upper,
        "interval": method,
        "seconds": seconds,
        "status": estimate.status,
    }


def split(text: str) -> list[str]:
    """Return the words between commas."""
    return [word.strip() for word in text.split(",") if word.strip()]


# ---- estimators


def choose_estimators(given: Any) -> dict[str, Any]:
    """Return name -> name or estimator of what ``run`` takes, each looked up once.

    Raises ValueError for what is no estimator.
    """
    if isinstance(given, str):
        given = split(given)
    elif not isinstance(given, Mapping | Sequence):
        given = [given]
    named: Iterable[tuple[Any, Any]]
    if isinstance(given, Mapping):
        named = given.items()
    else:
        named = [(None, item) for item in given]
    chosen: dict[str, Any] = {}
    for key, item in named:
        if not isinstance(item, str) and not callable(item):
            raise ArgumentError(
                "estimators",
                f"must be names, MODULE:OBJECT or callables; got {_checks.show(item)}",
            )
        name = item
        if key is not None:
            name = str(key)
        elif not isinstance(item, str):
            name = str(getattr(item, "__name__", type(item).__name__))
        while key is None and name in chosen and not isinstance(item, str):
            name += "'"
        if name in chosen:
            raise ArgumentError(
                "estimators", f"must have different names; {name!r} is there twice"
            )
        if name in REFERENCES and item != name:
            raise ArgumentError(
                "estimators",
                f"must not be called {name!r}, which is a reference;"
                f" {_checks.show(item)} is",
            )
        # An oracle needs the family's target; references need no look-up.
        special = (*REFERENCES, *estimator_names(needs_target=True))
        if isinstance(item, str) and item not in special:
            look_up_estimator(item)
        chosen[name] = item
    if not chosen:
        raise ArgumentError("estimators", "must name at least one; it is empty")
    return chosen


def estimator_of(name: str, given: Any, family: Family) -> Any:
    """Return the estimator of a name on a family.

    An oracle is told the family's target.
    """
    if name in REFERENCES or not isinstance(given, str):
        return REFERENCES.get(name, given)
    if given in estimator_names(needs_target=True):
        return named_estimators([given], family.target)[given]
    return look_up_estimator(given)


@functools.lru_cache(maxsize=64)
def look_up_estimator(spec: str) -> Any:
    """Return the estimator of a name, of PEER:NAME or of MODULE:OBJECT."""
    module, _, name = spec.partition(":")
    if module in PEERS:
        peer = Peer(module, name)
        peer.load()  # a missing library is said at once
        return peer
    if name:
        with own_modules():
            return own_estimator(spec)
    if spec == "evaluate":
        return evaluate_as_printed
    (estimator,) = named_estimators([spec]).values()
    return estimator


def evaluate_as_printed(
    problem: Problem, policy: PolicyLike, *, seed: SeedNumbers = None
) -> Estimate:
    """Return the value of ``oee`` and the interval that ``oee.evaluate`` prints."""
    from oee_tabular.report import evaluate

    report = evaluate(
        problem, {"policy": policy}, estimators=["oee"], confidence=0.95, seed=seed
    )
    return report.results[0].estimate


# ---- families


def choose_families(given: Any, seed: int) -> tuple[Any, tuple[str, ...]]:
    """Return the source of what a user gave, and the names of its families.

    Every family of the first seed is made, so that a bad one is reported at once.

    Raises
    ------
    ValueError
        If a name is unknown, what is given is no mapping of families, or a family
        cannot be made (its name and why).
    """
    if isinstance(given, str) and ":" not in given:
        given = split(given)
    if given is None:
        names = tuple(families(seed))
    elif isinstance(given, str | Mapping) or not isinstance(given, Iterable):
        names = tuple(families_at(given, seed))
    else:  # names of the package's families
        names = tuple(dict.fromkeys(conform(tuple(given), "families", tuple[str, ...])))
        given = None
    if not names:
        raise ArgumentError("families", "must name at least one; it is empty")
    for name in names:
        find_family(given, name, seed)
    return given, names


def find_family(source: Any, name: str, seed: int) -> Family:
    """Return one family of a source at a seed.

    Raises ValueError where it is missing, is no Family or cannot be made.
    """
    every = families_at(source, seed)
    if name not in every:
        if isinstance(every, Families):
            raise ArgumentError("families", every.missing(name))
        raise ArgumentError(
            "families",
            f"must have {name!r} at every seed; at seed {seed} it is missing",
        )
    family = every[name]
    if not isinstance(family, Family):
        raise ValueError(
            f"family {name!r} must be a Family; it is a {type(family).__name__}"
        )
    return family


def families_at(source: Any, seed: int) -> Mapping[str, Family]:
    """Return the families of one seed.

    Those that are given by name are made once a process.
    """
    if source is None or isinstance(source, str):
        return _named_families(source, seed)
    if not isinstance(source, Mapping):
        _checks.function(source, "families")
        source = source(seed) if inspect.signature(source).parameters else source()
    if not isinstance(source, Mapping) or not all(
        isinstance(name, str) for name in source
    ):
        raise ArgumentError(
            "families",
            f"must make a mapping name -> Family; they make a {type(source).__name__}",
        )
    return source


@functools.lru_cache(maxsize=128)
def _named_families(spec: str | None, seed: int) -> Mapping[str, Family]:
    """Return the package's families, or those of MODULE:OBJECT, at a seed."""
    if spec is None:
        return families(seed, large=True)
    with own_modules():
        return families_at(
            own_object(spec, "families", "my_package.mine:families"), seed
        )


def modules_of(objects: Sequence[object]) -> tuple[str, ...]:
    """Return the modules that hold a user's own objects.

    Their files are part of what the results depend on.
    """
    modules = set()
    for item in objects:
        name = str(getattr(item, "__module__", "") or type(item).__module__)
        if isinstance(item, str):
            module, colon, _ = item.partition(":")
            name = module if colon and module not in PEERS else ""
        if name.split(".")[0] not in ("", "oee_tabular", "__main__", "builtins"):
            modules.add(name)
    return tuple(sorted(modules))


# ---- the command


def read_labels(labels: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Return name -> text of NAME=TEXT, whose names must be among ``names``."""
    texts: dict[str, str] = {}
    for label in labels:
        name, equals, text = (part.strip() for part in label.partition("="))
        if not equals:
            raise ArgumentError(
                "--label",
                f"must be NAME=TEXT, such as oee='OEE (ours)'; got {_checks.show(label)}",
            )
        if name in texts:
            raise ArgumentError(
                "--label", f"must be given once for each name; {name!r} is there twice"
            )
        texts[name] = text
    return check_labels(texts, names, "--label")


def bench(
    *,
    estimators: str,
    sizes: str | None,
    seeds: int,
    seed: int,
    families: str | None,
    timeout: float,
    output: Path,
    say: Callable[[str], None],
    jobs: int = 1,
    dask: str | None = None,
    fresh: bool = False,
    overwrite: bool = True,
    labels: Sequence[str] = (),
) -> None:
    """Do one run of ``oee bench`` and write its files.

    Bad arguments, families that cannot be made and folders with other settings are
    refused before it begins.
    """
    _files.local(output)
    try:
        numbers = SIZES if sizes is None else [float(word) for word in split(sizes)]
    except ValueError:
        raise ArgumentError(
            "--sizes",
            "must be numbers with commas between them, 0.3,1,3; got"
            f" {_checks.show(sizes)}",
        ) from None
    settings = plan(
        estimators,
        families=families,
        sizes=numbers,
        seeds=seeds,
        seed=seed,
        timeout=timeout,
    )
    names = [*REFERENCES, *map(str, settings.asked["estimators"])]
    texts = read_labels(labels, list(dict.fromkeys(names)))
    source = families if families is not None and ":" in families else None
    given = {
        "sizes": (sizes, None),
        "seeds": (seeds, SEEDS),
        "seed": (seed, 0),
        "families": (families, None),
        "timeout": (timeout, TIMEOUT_SECONDS),
    }
    words = [
        f" --{name} {value}"
        for name, (value, default) in given.items()
        if value != default
    ]
    words += [f" --label {shlex.quote(label)}" for label in labels]

    def write(store: Store) -> None:
        """Write the league of the finished cells and print it."""
        league = league_of(store.table().drop(columns="repetition")).with_labels(
            labels_of({name: name for name in names}) | texts
        )
        about = {
            name: find_family(source, name, seed).about
            for name in map(str, settings.axes["family"])
        }
        command = f"oee bench --estimators {estimators}{''.join(words)}"
        store.save(league_files(league, about, command))
        say(f"{league}\n")

    run_and_write(
        output,
        settings,
        write,
        say=say,
        jobs=jobs,
        dask=dask,
        fresh=fresh,
        overwrite=overwrite,
        progress=is_terminal(sys.stderr),
    )
    own = families_at(None, seed)
    if families is None and isinstance(own, Families):
        for sentence in own.left_out.values():
            say(sentence)
