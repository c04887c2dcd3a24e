"""The commands of studies: the paper's figures, the bench, the laws of estimators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from oee_tabular.cli.inputs import ESTIMATORS_HELP
from oee_tabular.cli.options import INPUT, OUTPUT, VALUE, Dask, Jobs, Seed, answer, json_option, option, say


def reproduce(
    experiments: Annotated[
        list[str] | None, typer.Argument(help="Ids or groups; --list shows them.", metavar="ID...")
    ] = None,
    everything: Annotated[bool, option(INPUT, "Every experiment.", "--all")] = False,
    show: Annotated[bool, option(INPUT, "List the experiments and stop.", "--list")] = False,
    smoke: Annotated[bool, option(INPUT, "A small subset of each sweep, into OUTPUT/smoke.", "--smoke")] = False,
    seeds: Annotated[
        int | None, option(VALUE, "Repetitions of each cell, instead of the experiment's own.", metavar="N")
    ] = None,
    seed: Seed = 0,
    jobs: Jobs = -1,
    dask: Dask = None,
    output: Annotated[
        Path, option(OUTPUT, "Folder for ID/table.csv, summary.md, figure.svg, ... and index.md.", metavar="FOLDER")
    ] = Path("results"),
    fresh: Annotated[bool, option(OUTPUT, "Empty the experiments' folders first.", "--fresh")] = False,
    json: Annotated[bool, json_option("reproduce")] = False,
) -> None:
    """The paper's figures, and more. An interrupted run goes on where it stopped."""
    from oee_tabular.experiments.catalogue import listing
    from oee_tabular.experiments.catalogue import reproduce as run

    lines = _Lines(json)
    if show:
        lines.say(listing())
    else:
        run(experiments or [], everything=everything, smoke=smoke, seeds=seeds, seed=seed, jobs=jobs, dask=dask,
            output=output, fresh=fresh, say=lines.say)  # fmt: skip
    lines.end("reproduce")


def bench(
    estimators: Annotated[
        str,
        option(INPUT, f"Comma-separated: evaluate (as printed), MODULE:OBJECT, {ESTIMATORS_HELP}.", metavar="NAME,..."),
    ] = "oee,model-based",
    sizes: Annotated[
        str | None,
        option(VALUE, "Moves per open row, comma-separated.", metavar="N,...", show_default="0.3,1,3,10,30"),
    ] = None,
    seeds: Annotated[int, option(VALUE, "Logs of each family and size.", metavar="N")] = 40,
    families: Annotated[
        str | None,
        option(
            INPUT, "Names, comma-separated, or MODULE:FUNCTION of your own.", metavar="NAME,...", show_default="all"
        ),
    ] = None,
    seed: Seed = 0,
    jobs: Jobs = -1,
    dask: Dask = None,
    output: Annotated[
        Path,
        option(
            OUTPUT, "Folder for table.csv, cells.csv, league.csv, league.md, profile.png, heat.png.", metavar="FOLDER"
        ),
    ] = Path("results/bench"),
    fresh: Annotated[bool, option(OUTPUT, "Empty the folder first.", "--fresh")] = False,
    json: Annotated[bool, json_option("bench")] = False,
) -> None:
    """Measure estimators on families of environment shift where the truth is exact. An interrupted run goes on."""
    from oee_tabular.bench.run import bench as run

    lines = _Lines(json)
    run(estimators=estimators, sizes=sizes, seeds=seeds, seed=seed, families=families, jobs=jobs, dask=dask, output=output,
        fresh=fresh, say=lines.say)  # fmt: skip
    lines.end("bench")


def check(
    estimator: Annotated[
        str,
        typer.Argument(
            help="MODULE:OBJECT, an estimator, or what makes one without arguments.", metavar="MODULE:OBJECT"
        ),
    ],
    seed: Seed = 0,
    repetitions: Annotated[
        int,
        option(
            VALUE, "Logs of each statistical comparison, at least 3: with more, smaller biases are found.", metavar="N"
        ),
    ] = 8,
    timeout: Annotated[
        float,
        option(VALUE, "Time that each law may take: an estimator that takes longer breaks it.", metavar="SECONDS"),
    ] = 60.0,
    json: Annotated[bool, json_option("check")] = False,
) -> None:
    """Check an estimator of yours against the laws of estimators; exit code 0 if those that it claims hold, else 1.

    It runs in a process of its own. Where the exit code is 0, the last line is "all laws hold".
    """
    from oee_tabular import _progress
    from oee_tabular.testing.command import check as run

    _progress.report_step(f"laws of estimators, on {estimator}")
    verdicts = run(estimator, seed=seed, repetitions=repetitions, timeout=timeout)
    laws = [{"law": v.law, "outcome": v.outcome, "text": v.text, "example": v.example} for v in verdicts.values()]
    record = {"estimator": verdicts.estimator, "passed": verdicts.passed, "seed": seed, "laws": laws}
    answer("check", f"{verdicts}{chr(10) + 'all laws hold' if verdicts.passed else ''}", record, json)
    if not verdicts.passed:
        raise typer.Exit(1)


class _Lines:
    """Lines that are printed as they come, or with ``--json`` at the end."""

    def __init__(self, as_json: bool) -> None:
        self.as_json, self.lines = as_json, list[str]()

    def say(self, text: str) -> None:
        self.lines += text.split("\n")
        if not self.as_json:
            say(text)

    def end(self, command: str) -> None:
        if self.as_json:
            answer(command, "", {"lines": self.lines}, True)
