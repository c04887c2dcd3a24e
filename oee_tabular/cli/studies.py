"""The commands of studies: the paper's figures, the bench, the laws of estimators."""

from __future__ import annotations

import typer

from oee_tabular.cli.options import Options, answer, say, with_options


@with_options("""
Input:
experiments* ID...  Ids or groups; --list shows them.
--all  Every experiment.
--list  List the experiments and stop.
--smoke  A small subset of each sweep, into OUTPUT/smoke.
Value:
--seeds N  Repetitions of each cell, instead of the experiment's own.
--seed --jobs=-1 --dask
Output:
--output=results FOLDER  Folder for ID/table.csv, summary.md, figure.svg, ... and index.md.
--fresh  Empty the experiments' folders first.
--json  Print JSON instead, with version, lines.
""")
def reproduce(options: Options) -> None:
    """Reproduce the paper's figures, and more.

    An interrupted run goes on where it stopped.
    """
    from oee_tabular.lab.experiments import catalogue

    names = ("smoke", "seeds", "seed", "jobs", "dask", "output", "fresh")
    asked = {name: getattr(options, name) for name in names}
    lines: list[str] = []
    tell = lines.append if options.json else say
    if options.list:
        tell(catalogue.listing())
    else:
        catalogue.reproduce(options.experiments or [], everything=options.all, say=tell, **asked)
    if options.json:
        answer("", {"lines": "\n".join(lines).split("\n")}, True)


@with_options("""
Input:
--estimators=oee,model-based NAME,...  Comma-separated: evaluate (as printed), MODULE:OBJECT, scope-rl:NAME,
  offline-rl-ope:NAME, {ESTIMATORS}.
--families NAME,...  Comma-separated, or MODULE:FUNCTION of your own (none: all).
Value:
--sizes N,...  Transitions of each stochastic state-action pair, comma-separated (none: 0.3,1,3,10,30).
--seeds=40 N  Logs of each family and size.
--timeout=600 SECONDS  Time that an estimate may take: one that takes longer is a row with that reason.
--seed --jobs=-1 --dask
Output:
--output=results/bench FOLDER  Folder for table.csv, cells.csv, league.csv, league.md, league.tex, profile.png, ...
--fresh  Empty the folder first.
--json  Print JSON instead, with version, lines.
""")
def bench(options: Options) -> None:
    """Measure estimators where the truth is exact.

    They are measured on families of environment shift. An interrupted run goes on where it stopped.
    """
    from oee_tabular.lab.bench import bench as run

    asked = {name: value for name, value in vars(options).items() if name != "json"}
    lines: list[str] = []
    run(**asked, say=lines.append if options.json else say)
    if options.json:
        answer("", {"lines": "\n".join(lines).split("\n")}, True)


@with_options("""
Input:
estimator! MODULE:OBJECT  An estimator, or what makes one without arguments.
Value:
--seed
--repetitions=8 N  Logs of each statistical comparison, at least 3: with more, smaller biases are found.
--timeout=60 SECONDS  Time that each law may take: an estimator that takes longer breaks it.
Output:
--json  Print JSON instead, with version, estimator, passed, seed, laws.
""")
def check(options: Options) -> None:
    """Check an estimator of yours against the laws.

    It runs in a process of its own. The exit code is 0 if the laws that it claims hold, else 1. Where it is 0, the last line is
    "all laws hold", or names the default laws that the estimator does not claim.
    """
    from oee_tabular import _progress
    from oee_tabular.testing import command

    asked = {name: getattr(options, name) for name in ("seed", "repetitions", "timeout")}
    _progress.report_step(f"laws of estimators, on {options.estimator}")
    verdicts = command.check(options.estimator, **asked)
    laws = [{"law": v.law, "outcome": v.outcome, "text": v.text, "example": v.example} for v in verdicts.values()]
    record = {"estimator": verdicts.estimator, "passed": verdicts.passed, "seed": options.seed, "laws": laws}
    last = f"\n{verdicts.conclusion}" if verdicts.passed else ""
    answer(f"{verdicts}{last}", record, options.json)
    if not verdicts.passed:
        raise typer.Exit(1)
