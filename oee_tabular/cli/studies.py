"""The commands of studies: the paper's figures, the bench, the laws of estimators."""

from __future__ import annotations

from pathlib import Path

import typer

from oee_tabular.cli.options import answer, say, with_options


@with_options("""
Input:
experiments ID...  Ids or groups; --list shows them.
--all  Every experiment.
--list  List the experiments and stop.
--smoke  A small subset of each sweep, into OUTPUT/smoke.
Value:
--seeds N  Repetitions of each cell, instead of the experiment's own.
Output:
--output FOLDER  Folder for ID/table.csv, summary.md, figure.svg, ... and index.md.
--fresh  Empty the experiments' folders first.
--json  Print JSON instead, with version, lines.
""")
def reproduce(
    experiments: list[str] | None = None,
    all_: bool = False,
    list_: bool = False,
    smoke: bool = False,
    seeds: int | None = None,
    seed: int = 0,
    jobs: int = -1,
    dask: str | None = None,
    output: Path = Path("results"),
    fresh: bool = False,
    json: bool = False,
) -> None:
    """Reproduce the paper's figures, and more.

    An interrupted run goes on where it stopped.
    """
    from oee_tabular.experiments import catalogue

    lines: list[str] = []
    tell = lines.append if json else say
    if list_:
        tell(catalogue.listing())
    else:
        catalogue.reproduce(
            experiments or [], everything=all_, smoke=smoke, seeds=seeds, seed=seed, jobs=jobs, dask=dask,
            output=output, fresh=fresh, say=tell,
        )  # fmt: skip
    if json:
        answer("", {"lines": "\n".join(lines).split("\n")}, json)


@with_options("""
Input:
--estimators NAME,...  Comma-separated: evaluate (as printed), MODULE:OBJECT, {ESTIMATORS}.
--families NAME,...  Comma-separated, or MODULE:FUNCTION of your own (none: all).
Value:
--sizes N,...  Transitions of each stochastic state-action pair, comma-separated (none: 0.3,1,3,10,30).
--seeds N  Logs of each family and size.
Output:
--output FOLDER  Folder for table.csv, cells.csv, league.csv, league.md, profile.png, heat.png.
--fresh  Empty the folder first.
--json  Print JSON instead, with version, lines.
""")
def bench(
    estimators: str = "oee,model-based",
    sizes: str | None = None,
    seeds: int = 40,
    families: str | None = None,
    seed: int = 0,
    jobs: int = -1,
    dask: str | None = None,
    output: Path = Path("results/bench"),
    fresh: bool = False,
    json: bool = False,
) -> None:
    """Measure estimators where the truth is exact.

    They are measured on families of environment shift. An interrupted run goes on where it stopped.
    """
    from oee_tabular.bench.run import bench as run

    lines: list[str] = []
    tell = lines.append if json else say
    run(
        estimators=estimators, sizes=sizes, seeds=seeds, seed=seed, families=families, jobs=jobs, dask=dask,
        output=output, fresh=fresh, say=tell,
    )  # fmt: skip
    if json:
        answer("", {"lines": "\n".join(lines).split("\n")}, json)


@with_options("""
Input:
estimator MODULE:OBJECT  An estimator, or what makes one without arguments.
Value:
--repetitions N  Logs of each statistical comparison, at least 3: with more, smaller biases are found.
--timeout SECONDS  Time that each law may take: an estimator that takes longer breaks it.
Output:
--json  Print JSON instead, with version, estimator, passed, seed, laws.
""")
def check(estimator: str, seed: int = 0, repetitions: int = 8, timeout: float = 60.0, json: bool = False) -> None:
    """Check an estimator of yours against the laws.

    It runs in a process of its own. The exit code is 0 if the laws that it claims hold, else 1. Where it is 0, the last line is
    "all laws hold".
    """
    from oee_tabular import _progress
    from oee_tabular.testing import command

    _progress.report_step(f"laws of estimators, on {estimator}")
    verdicts = command.check(estimator, seed=seed, repetitions=repetitions, timeout=timeout)
    laws = [{"law": v.law, "outcome": v.outcome, "text": v.text, "example": v.example} for v in verdicts.values()]
    record = {"estimator": verdicts.estimator, "passed": verdicts.passed, "seed": seed, "laws": laws}
    answer(f"{verdicts}\nall laws hold" if verdicts.passed else str(verdicts), record, json)
    if not verdicts.passed:
        raise typer.Exit(1)
