"""The commands of values (of policies, which of them is best, what to record next) and
of studies (figures, bench, laws).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _files, _progress
from oee_tabular._arguments import literal, named_specs
from oee_tabular.cli.inputs import (
    policies_of,
    read_box,
    read_entries,
    read_problem,
    task_of,
    write_array,
)
from oee_tabular.cli.options import Options, answer, say, with_options
from oee_tabular.continuous.command import (
    evaluate_files,
    is_continuous,
    read_grid,
    task_options,
)
from oee_tabular.exceptions import ArgumentError

PLAN_OPTIONS = ("model", "optimistic", "restart", "restart_costs_a_move", "solver")
# which need a simulator whose states are numbered, and a log
OF_FILES = ("features", "tie", "box", "action_noise", "initial", "impossible")


@with_options("""
Input:
--simulator --log --policy
--history=auto STEPS  Last actions in a continuous task's state, 0 to 5 or more; auto: as many as the held-out error asks for.
--fit NAME,...  Parameters of a continuous task that are fitted to the log first, gravity,length; of MuJoCo body_mass.pole.
--behavior SPEC  Policy that recorded the log, as for --policy.
--target SIM  The true target, as for --simulator, to show errors.
--initial --action-noise --impossible
--features FILE  Adds a row oee-features with your own features of transitions: {TRANSITIONS}, a last axis for several.
--tie FILE  Adds the row oee-tied, in which transitions with one integer key share one ratio: {TRANSITIONS}.
--grid CELLS  Adds rows on a finite MDP. 60x60: vertices along each feature; 3000: visited cells; auto: the task's own.
--task-option* NAME=VALUE  Of a continuous task, repeatable; what is left out is the task's own. outside=error|drop|nearest:
    states of the log outside the grid; drop leaves out transitions without support too. strict=true: an error, not a
    warning, for actions of the log that are not in the task's set. calibration=ratio|difference|none. floor=0.001: share of
    other steps in the simulator on the grid (defensive). simulations=50000: Monte Carlo episodes of each policy.
    state=MODULE:GET,SET: functions get(env) and set(env, state) of a Gymnasium environment whose state is not found; its
    attribute state_names names the coordinates (else state_0, ..., in the order of get). actions=9 or -2,0,2: levels of
    each coordinate of a Gymnasium Box of actions, or the commands.
Value:
--box --horizon --discount
--normalized/--raw  Multiply values by (1 - discount).
--estimators NAME,...  Comma-separated: {ESTIMATORS}.
--rewards --confidence
--guaranteed/--quick  Add intervals that are guaranteed at any sample size; or leave likelihood intervals out, which take most
    of the time of large problems.
--seed
Output:
--all  Print the rows that a short report leaves out, too.
--verbose  Print every note, and the columns of diagnostics.
--output FOLDER  Folder for report.json, table.csv and values.png.
--report FILE.html  One self-contained page, for people who did not run it; TITLE=FILE.html gives it a title.
--json  Print JSON instead, with version, answer, unit, discount, horizon, normalized, confidence, interval, seed, facts,
    results, intervals, best, comparison, conclusion, warnings.
""")
def evaluate(options: Options) -> None:
    """Estimate the value of policies in the target.

    It takes a simulator and a log of the target; without arguments, it evaluates the
    paper's 10 x 10 grid.
    """
    if options.output is not None:
        oee.report.check_output(options.output)
    title, _, name = (options.report or "").rpartition("=")
    page = Path(name) if name else None
    if options.report is not None:
        oee.report.check_page(page or Path(options.report))
    report = _evaluate(options)
    answer(
        report.to_text(all=options.all, verbose=options.verbose),
        report.to_dict() if options.json else {},
        options.json,
    )
    old = [*options.output.glob("*")] if options.output else []
    old += [page] if page and page.exists() else []
    new = report.save(options.output) if options.output else []
    if page:
        report.to_html(page, title=title or None)
        new.append(page)
    if new and not options.json:
        typer.echo(
            "\nWritten:"
            f" {', '.join(f'{path} (replaced)' if path in old else str(path) for path in new)}"
        )


def refuse(options: Options, names: tuple[str, ...], rule: str) -> None:
    """Raise a ValueError for the first of these options that has another value than its
    default.
    """
    for name in names:
        value = getattr(options, name)
        if value not in (None, 0.0, "refuse", "simulator"):
            raise ValueError(f"--{name.replace('_', '-')} {rule.format(value)}")


def _evaluate(options: Options) -> Any:
    """Make the report of the problem that the options describe: of files, of a
    continuous task, or the paper's.
    """
    simulator = options.simulator
    log = options.log
    discount = options.discount
    settings = task_options(options.task_option)
    grid = read_grid(options.grid)
    wants = {
        "--task-option": settings,
        "--grid": grid is not None,
        "--fit": options.fit,
    }
    wants["--history"] = options.history != "auto"
    if any(wants.values()) and not is_continuous(simulator):
        if simulator is not None:
            task_of(simulator)  # which may not be there at all
        given = next(name for name, value in wants.items() if value)
        raise ValueError(
            f"{given} needs a continuous task (--simulator cartpole:gravity=10)"
        )
    names = (
        None
        if options.estimators is None
        else [part.strip() for part in options.estimators.split(",")]
    )
    common: dict[str, Any] = {"confidence": options.confidence, "seed": options.seed}
    common |= {
        "guaranteed": options.guaranteed is True,
        "quick": options.guaranteed is False,
    }
    common |= {
        "estimators": None if names is None else [*filter(None, names)],
        "normalized": bool(options.normalized),
    }
    if simulator is None and not log:
        refuse(
            options, ("behavior", "target", *OF_FILES), "needs --simulator and --log"
        )
        default = oee.tasks.embedded_default(
            seed=options.seed, discount=0.99 if discount is None else discount
        )
        problem = oee.Problem(
            default.simulator,
            default.log,
            horizon=default.horizon if options.horizon is None else options.horizon,
            rewards=options.rewards,
            episodes=default.episodes,
            behavior_policy=default.behavior_policy,
        )
        policies: Any = default.policies
        if options.policy is not None:
            policies = policies_of(
                options.policy, task_of("gridworld:10,slip=0.3", discount)
            )
        common["normalized"] = options.normalized is not False
        return oee.evaluate(problem, policies, target=default.target, **common)
    if simulator is None or not log:
        there, lacking = ("log", "simulator") if log else ("simulator", "log")
        raise ArgumentError(
            f"--{lacking}",
            f"must be given with --{there} (record a log with: oee sample)",
        )
    if is_continuous(simulator):
        common |= {
            "fit": options.fit and options.fit.split(","),
            "history": literal(options.history, "--history"),
        }
        rule = (
            "must be left out for a continuous task, whose states have no numbers; it"
            " is {}"
        )
        refuse(options, ("rewards", *OF_FILES), rule)
        return evaluate_files(
            simulator,
            log,
            options.policy,
            options.behavior,
            options.target,
            settings,
            grid=grid,
            horizon=options.horizon,
            discount=0.99 if discount is None else discount,
            **common,
        )
    task, problem = read_problem(options)
    known, facts = _read_known(options, task)
    target = None
    if options.target is not None:
        target = task_of(options.target, task.mdp.discount, options.initial).mdp
    return oee.evaluate(
        problem,
        policies_of(options.policy, task),
        facts=facts,
        target=target,
        **known,
        **common,
    )


def _read_known(options: Options, task: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read what is known of the target (box, features, tie), and collect what the
    report tells of its inputs.
    """
    from oee_tabular.report.page import date_of

    specs = named_specs(options.policy or ["optimal"])
    noise = options.action_noise
    facts = {
        "simulator_name": options.simulator,
        "log_name": ", ".join(options.log),
        "log_files": options.log,
        "action_noise": noise,
        "policy_names": specs,
        "date": date_of([options.simulator, *options.log, *specs.values()]),
    }
    others = {
        name: getattr(options, name) for name in ("initial", "impossible", "discount")
    }
    facts |= {
        name: value for name, value in others.items() if value not in (None, "refuse")
    }
    if noise:
        facts["simulator"] = (
            f"{options.simulator} with action noise {noise:g}: {task.mdp!r}"
        )
    known: dict[str, Any] = read_box(options.box)
    for name, path in (("features", options.features), ("tie", options.tie)):
        if path is not None:
            known[name], content = read_entries(path, name, task.mdp)
            facts[name] = f"{path} ({content})"
    return known, facts


@with_options("""
Input:
--simulator! --log!
--policy*! NAME=SPEC  NAME=SPEC or SPEC, two or more; SPEC: {POLICY}.
--initial --action-noise --impossible
Value:
--box --horizon --discount --rewards --confidence --quick
Output:
--json  Print JSON instead, with version, confidence, best (null where the log cannot say), sentence, policies (best first),
    differences (from the best), warnings.
""")
def compare(options: Options) -> None:
    """Say which of several policies is worth most.

    It prints differences with their intervals and P(best), or says that the log cannot
    tell.
    """
    from oee_tabular.report.tables import render_comparison

    if is_continuous(options.simulator):
        raise ArgumentError(
            "--simulator",
            f"must have numbered states to compare policies; {options.simulator!r} is"
            " continuous: oee evaluate",
        )
    if len(named_specs(options.policy)) < 2:
        raise ArgumentError(
            "--policy",
            "must be given twice or more, for there is nothing to compare; there is"
            f" {options.policy[0]!r}",
        )
    known = read_box(options.box)
    task, problem = read_problem(options)
    policies = policies_of(options.policy, task)
    report = oee.report.contest(
        problem, policies, confidence=options.confidence, quick=options.quick, **known
    )
    warnings = [str(finding) for finding in problem.findings]
    text = "\n".join(
        [render_comparison(report), *([""] if warnings else []), *warnings]
    )
    rows = report.comparison()
    differences = [
        {
            "policy": row["policy"],
            "than": rows[0]["policy"],
            "difference": -row["less_by"],
            "lower": None if row["less_by_upper"] is None else -row["less_by_upper"],
            "upper": None if row["less_by_lower"] is None else -row["less_by_lower"],
        }
        for row in rows[1:]
    ]
    record = {
        "confidence": report.confidence,
        "best": report.best,
        "sentence": report.headline,
        "policies": rows,
    }
    answer(
        text, record | {"differences": differences, "warnings": warnings}, options.json
    )


@with_options("""
Input:
--simulator! --log!
--transitions! N  How many more transitions to record.
--policy --initial --action-noise --impossible
--free  Any state-action pair can be set up and recorded, not only episodes.
--plan-option* NAME=VALUE  Of plan_data_collection, repeatable: model=estimate|simulator, optimistic=true|false,
    restart=0.01, restart_costs_a_move=true|false, solver=auto|frank_wolfe|CLARABEL.
Value:
--box --horizon --discount --confidence
Output:
--output FILE  The behaviour policy to record with (--free: each state-action pair's share): .npy.
--overwrite
--json  Print JSON instead, with version, sampling, n, confidence, status, gap, policies, most, advice, next, file.
""")
def plan(options: Options) -> None:
    """Plan what to record next.

    It prints a behaviour policy, and the width of each value's interval before and
    after.
    """
    output = options.output
    free = options.free
    if output is not None:
        _files.new_file(output, "--output", overwrite=options.overwrite)
    settings = named_specs(options.plan_option or [], "--plan-option", PLAN_OPTIONS)
    asked = {name: literal(text) for name, text in settings.items()} | read_box(
        options.box
    )
    task, problem = read_problem(options)
    policies = policies_of(options.policy, task)
    _progress.report_step(f"plan for {options.transitions} transitions")
    made = oee.plan_data_collection(
        problem,
        policies,
        n=options.transitions,
        sampling="free" if free else "behavior",
        confidence=options.confidence,
        **asked,
    )
    text = str(made)
    record = made.to_dict() | {"file": None if output is None else str(output)}
    if output is not None:
        write_array(output, made.distribution if free else made.behavior_policy)
        text += (
            f"\n{output}:"
            f" {'shares of the pairs, (S, A), that sum to 1' if free else 'policy to record with'}"
        )
    answer(text, record, options.json)


# ---- studies


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
    chosen = options.experiments or []
    if options.list:
        _tell(lambda say: say(catalogue.listing()), options.json)
    else:
        _tell(
            lambda say: catalogue.reproduce(
                chosen, everything=options.all, say=say, **asked
            ),
            options.json,
        )


def _tell(run: Callable[[Callable[[str], None]], None], as_json: bool) -> None:
    """Run what says lines as it goes on, or says them in one JSON object at the end."""
    lines: list[str] = []
    run(lines.append if as_json else say)
    if as_json:
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

    They are measured on families of environment shift. An interrupted run goes on where
    it stopped.
    """
    from oee_tabular.lab.bench import bench as run

    asked = {name: value for name, value in vars(options).items() if name != "json"}
    _tell(lambda say: run(**asked, say=say), options.json)


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

    It runs in a process of its own. The exit code is 0 if the laws that it claims hold,
    else 1. Where it is 0, the last line is "all laws hold", or names the default laws
    that the estimator does not claim.
    """
    from oee_tabular.testing.conformance import check_module

    asked = {
        name: getattr(options, name) for name in ("seed", "repetitions", "timeout")
    }
    _progress.report_step(f"laws of estimators, on {options.estimator}")
    verdicts = check_module(options.estimator, **asked)
    laws = [
        {"law": v.law, "outcome": v.outcome, "text": v.text, "example": v.example}
        for v in verdicts.values()
    ]
    record = {
        "estimator": verdicts.estimator,
        "passed": verdicts.passed,
        "seed": options.seed,
        "laws": laws,
    }
    last = f"\n{verdicts.conclusion}" if verdicts.passed else ""
    answer(f"{verdicts}{last}", record, options.json)
    if not verdicts.passed:
        raise typer.Exit(1)
