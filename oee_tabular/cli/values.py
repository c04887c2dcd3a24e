"""The commands of values: of policies, which of them is best, what to record next."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from oee_tabular._arguments import literal, named_specs
from oee_tabular.cli.inputs import read_box, read_entries, read_problem, refuse, write_array
from oee_tabular.cli.options import answer, with_options
from oee_tabular.cli.simulators import policies_of, task_of
from oee_tabular.continuous.command import evaluate_files, is_continuous, task_options

PLAN_OPTIONS = ("model", "optimistic", "restart", "restart_costs_a_move", "solver")


@with_options("""
Input:
--behavior SPEC  Policy that recorded the log, as for --policy.
--target SIM  The true target, as for --simulator, to show errors.
--features FILE  Your own features of transitions, as a row oee-features: {TRANSITIONS}, with a last axis for several.
--tie FILE  Integer keys, transitions with one key share one ratio, as a row oee-tied: {TRANSITIONS}.
--task-option NAME=VALUE  Of a continuous task, repeatable; what is left out is the task's own. grid=60x60: vertices along
    each feature, or none. outside=error|drop|nearest: states of the log outside the grid; drop leaves out transitions
    without support too. strict=true: an error, not a warning, for actions of the log that are not in the task's set.
    calibration=ratio|difference|none. floor=0.001: share of other steps in the simulator (defensive). simulations=50000:
    Monte Carlo episodes of each policy. state=MODULE:GET,SET: functions get(env) and set(env, state) of a Gymnasium
    environment whose state is not found. actions=9 or -2,0,2: levels of each coordinate of a Gymnasium Box of actions, or
    the commands.
Value:
--normalized/--raw  Multiply values by (1 - discount).
--estimators NAME,...  Comma-separated: {ESTIMATORS}.
--guaranteed  Give the intervals that hold at any sample size as well.
Output:
--all  Print the rows that a short report leaves out, too.
--verbose  Print every note, and the columns of diagnostics.
--output FOLDER  Folder for report.json, table.csv and values.png.
--report FILE.html  One self-contained page, for people who did not run it.
--title TEXT  Page title (with --report).
--json  Print JSON instead, with version, answer, unit, discount, horizon, normalized, confidence, interval, seed, facts,
    results, intervals, best, comparison, conclusion, warnings.
""")
def evaluate(
    simulator: str | None = None,
    log: list[str] | None = None,
    policy: list[str] | None = None,
    behavior: str | None = None,
    target: str | None = None,
    initial: str | None = None,
    action_noise: float = 0.0,
    impossible: str = "refuse",
    features: Path | None = None,
    tie: Path | None = None,
    task_option: list[str] | None = None,
    box: str | None = None,
    horizon: int | None = None,
    discount: float | None = None,
    normalized: bool | None = None,
    estimators: str | None = None,
    rewards: str = "simulator",
    confidence: float = 0.95,
    guaranteed: bool = False,
    quick: bool = False,
    seed: int = 0,
    all_: bool = False,
    verbose: bool = False,
    output: Path | None = None,
    report: Path | None = None,
    title: str | None = None,
    json: bool = False,
) -> None:
    """Estimate the value of policies in the target.

    It takes a simulator and a log of the target; without arguments, it evaluates the paper's 10 x 10 grid.
    """
    from oee_tabular.report import check_output, check_page
    from oee_tabular.report import evaluate as evaluate_problem
    from oee_tabular.report.page import date_of

    if output is not None:
        check_output(output)
    if report is not None:
        check_page(report)
    elif title is not None:
        raise ValueError("--title needs --report FILE.html, whose title it is")
    common: dict[str, Any] = {
        "estimators": None if estimators is None else [name for part in estimators.split(",") if (name := part.strip())],
        "confidence": confidence, "seed": seed, "guaranteed": guaranteed, "quick": quick,
    }  # fmt: skip
    options = task_options(task_option)
    changes: dict[str, Any] = {"action_noise": action_noise, "initial": initial, "impossible": impossible}
    known = {"features": features, "tie": tie, "box": box} | changes
    if options and not is_continuous(simulator):
        if simulator is not None:
            task_of(simulator)  # which may not be there at all
        raise ValueError("--task-option needs a continuous task (--simulator cartpole:gravity=10)")
    if simulator is None and not log:
        from oee_tabular.experiments import embedded_default

        refuse({"behavior": behavior, "target": target} | known, "needs --simulator and --log")
        given: dict[str, Any] = {"horizon": horizon, "discount": discount, "rewards": rewards}
        default = embedded_default(seed=seed, **{name: value for name, value in given.items() if value is not None})
        policies: Any = default.policies
        if policy is not None:
            policies = policies_of(policy, task_of("gridworld:10,slip=0.3", discount))
        found = evaluate_problem(
            default.problem, policies, target=default.target, normalized=normalized is not False, **common
        )
    elif simulator is None or not log:
        there, lacking = ("log", "simulator") if log else ("simulator", "log")
        raise ValueError(f"--{lacking} must be given with --{there} (record a log with: oee sample)")
    elif is_continuous(simulator):
        rule = "must be left out for a continuous task, whose states have no numbers; it is {}"
        refuse({"rewards": rewards} | known, rule)
        found = evaluate_files(
            simulator, log, policy, behavior, target, options, horizon=horizon,
            discount=0.99 if discount is None else discount, normalized=bool(normalized), **common,
        )  # fmt: skip
    else:
        task, problem = read_problem(
            simulator, log, behavior=behavior, horizon=horizon, discount=discount, rewards=rewards, **changes
        )
        assumed: dict[str, Any] = read_box(box)
        facts: dict[str, Any] = {}
        for name, path in (("features", features), ("tie", tie)):
            if path is not None:
                assumed[name], content = read_entries(path, name, task.mdp)
                facts[name] = f"{path} ({content})"
        specs = named_specs(policy or ["optimal"])
        facts |= {
            "simulator_name": simulator, "log_name": ", ".join(log), "log_files": log, "action_noise": action_noise,
            "policy_names": specs, "date": date_of([simulator, *log, *specs.values()]),
        }  # fmt: skip
        others = {"initial": initial, "impossible": impossible, "discount": discount}
        facts |= {name: value for name, value in others.items() if value not in (None, "refuse")}
        if action_noise:
            facts["simulator"] = f"{simulator} with action noise {action_noise:g}: {task.mdp!r}"
        found = evaluate_problem(
            problem, policies_of(policy, task), normalized=bool(normalized), facts=facts,
            target=None if target is None else task_of(target, task.mdp.discount, initial).mdp, **assumed, **common,
        )  # fmt: skip
    answer(found.to_text(all=all_, verbose=verbose), found.to_dict() if json else {}, json)
    before = set(output.iterdir()) if output and output.exists() else set()
    before |= {report} if report and report.exists() else set()
    written = [] if output is None else found.save(output)
    if report is not None:
        found.to_html(report, title=title)
        written.append(report)
    if written and not json:
        typer.echo(f"\nWritten: {', '.join(f'{path} (replaced)' if path in before else str(path) for path in written)}")


@with_options("""
Input:
--policy NAME=SPEC  NAME=SPEC or SPEC, two or more; SPEC: {POLICY}.
Output:
--json  Print JSON instead, with version, confidence, best (null where the log cannot say), sentence, policies (best first),
    differences (from the best), warnings.
""")
def compare(
    simulator: str,
    log: list[str],
    policy: list[str],
    initial: str | None = None,
    action_noise: float = 0.0,
    impossible: str = "refuse",
    box: str | None = None,
    horizon: int | None = None,
    discount: float | None = None,
    rewards: str = "simulator",
    confidence: float = 0.95,
    quick: bool = False,
    json: bool = False,
) -> None:
    """Say which of several policies is worth most.

    It prints differences with their intervals and P(best), or says that the log cannot tell.
    """
    from oee_tabular.report import contest
    from oee_tabular.report.terminal import render_comparison

    if is_continuous(simulator):
        raise ValueError(
            f"--simulator must have numbered states to compare policies; {simulator!r} is continuous: oee evaluate"
        )
    if len(named_specs(policy)) < 2:
        raise ValueError(
            f"--policy must be given twice or more, for there is nothing to compare; there is {policy[0]!r}"
        )
    known = read_box(box)
    task, problem = read_problem(
        simulator, log, initial=initial, action_noise=action_noise, impossible=impossible, horizon=horizon,
        discount=discount, rewards=rewards,
    )  # fmt: skip
    found = contest(problem, policies_of(policy, task), confidence=confidence, quick=quick, **known)
    warnings = [str(finding) for finding in problem.findings]
    text = "\n".join([render_comparison(found), *([""] if warnings else []), *warnings])
    rows = found.comparison()
    differences = [
        {"policy": row["policy"], "than": rows[0]["policy"], "difference": -row["less_by"],
         "lower": None if row["less_by_upper"] is None else -row["less_by_upper"],
         "upper": None if row["less_by_lower"] is None else -row["less_by_lower"]}
        for row in rows[1:]
    ]  # fmt: skip
    record = {"confidence": found.confidence, "best": found.best, "sentence": found.headline, "policies": rows}
    answer(text, record | {"differences": differences, "warnings": warnings}, json)


@with_options("""
Input:
--transitions N  How many more transitions to record.
--free  Any state-action pair can be set up and recorded, not only episodes.
--plan-option NAME=VALUE  Of plan_data_collection, repeatable: model=estimate|simulator, optimistic=true|false,
    restart=0.01, restart_costs_a_move=true|false, solver=auto|frank_wolfe|CLARABEL.
Output:
--output FILE  The behaviour policy to record with (--free: each state-action pair's share): .npy.
--json  Print JSON instead, with version, sampling, n, confidence, status, gap, policies, most, advice, next, file.
""")
def plan(
    simulator: str,
    log: list[str],
    transitions: int,
    policy: list[str] | None = None,
    initial: str | None = None,
    action_noise: float = 0.0,
    impossible: str = "refuse",
    free: bool = False,
    plan_option: list[str] | None = None,
    box: str | None = None,
    horizon: int | None = None,
    discount: float | None = None,
    confidence: float = 0.95,
    output: Path | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Plan what to record next.

    It prints a behaviour policy, and the width of each value's interval before and after.
    """
    from oee_tabular import _files, _progress
    from oee_tabular.design import plan_data_collection

    if output is not None:
        _files.new_file(output, "--output", overwrite=overwrite)
    options = {
        name: literal(text) for name, text in named_specs(plan_option or [], "--plan-option", PLAN_OPTIONS).items()
    }
    options |= read_box(box)
    task, problem = read_problem(
        simulator, log, initial=initial, action_noise=action_noise, impossible=impossible, horizon=horizon,
        discount=discount,
    )  # fmt: skip
    policies = policies_of(policy, task)
    _progress.report_step(f"plan for {transitions} transitions")
    found = plan_data_collection(
        problem, policies, n=transitions, sampling="free" if free else "behavior", confidence=confidence, **options
    )
    text, record = str(found), found.to_dict() | {"file": None if output is None else str(output)}
    if output is not None:
        write_array(output, found.distribution if free else found.behavior_policy)
        text += f"\n{output}: {'shares of the pairs, (S, A), that sum to 1' if free else 'policy to record with'}"
    answer(text, record, json)
