"""The commands of values: of policies, which of them is best, what to record next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from oee_tabular.cli.inputs import (
    ESTIMATORS_HELP,
    FEATURES_HELP,
    TIE_HELP,
    box_of,
    embedded,
    from_files,
    given_problem,
    refuse_settings,
    write_array,
)
from oee_tabular.cli.options import (
    INPUT,
    LOG_HELP,
    OUTPUT,
    VALUE,
    Actions,
    Box,
    Calibration,
    Confidence,
    Discount,
    Floor,
    Grid,
    Horizon,
    Impossible,
    Initial,
    Log,
    Noise,
    Outside,
    Overwrite,
    Policies,
    Quick,
    Rewards,
    Seed,
    Simulations,
    SimulatorOption,
    State,
    Strict,
    answer,
    json_option,
    option,
)
from oee_tabular.cli.simulators import POLICY_HELP, SIMULATOR_HELP, policies_of
from oee_tabular.continuous.command import from_states, is_continuous, settings_of


def evaluate(
    simulator: Annotated[str | None, option(INPUT, f"{SIMULATOR_HELP}.", metavar="SIM")] = None,
    log: Annotated[list[str] | None, option(INPUT, LOG_HELP, metavar="FILE")] = None,
    policy: Policies = None,
    behavior: Annotated[
        str | None, option(INPUT, "Policy that recorded the log, as for --policy.", metavar="SPEC")
    ] = None,
    target: Annotated[
        str | None, option(INPUT, "The true target, as for --simulator, to show errors.", metavar="SIM")
    ] = None,
    initial: Initial = None,
    action_noise: Noise = 0.0,
    impossible: Impossible = "refuse",
    features: Annotated[Path | None, option(INPUT, FEATURES_HELP, metavar="FILE")] = None,
    tie: Annotated[Path | None, option(INPUT, TIE_HELP, metavar="FILE")] = None,
    box: Box = None,
    horizon: Horizon = None,
    discount: Discount = None,
    normalized: Annotated[
        bool | None, option(VALUE, "Multiply values by (1 - discount).", "--normalized/--raw", show_default=False)
    ] = None,
    estimators: Annotated[str | None, option(VALUE, f"Comma-separated: {ESTIMATORS_HELP}.", metavar="NAME,...")] = None,
    rewards: Rewards = "simulator",
    confidence: Confidence = 0.95,
    guaranteed: Annotated[
        bool, option(VALUE, "Give the intervals that hold at any sample size as well.", "--guaranteed")
    ] = False,
    quick: Quick = False,
    seed: Seed = 0,
    output: Annotated[
        Path | None, option(OUTPUT, "Folder for report.json, table.csv and values.png.", metavar="FOLDER")
    ] = None,
    page: Annotated[
        Path | None,
        option(OUTPUT, "One self-contained page, for people who did not run it.", "--report", metavar="FILE.html"),
    ] = None,
    title: Annotated[str | None, option(OUTPUT, "Of the page that --report writes.", metavar="TEXT")] = None,
    json: Annotated[bool, json_option("evaluate")] = False,
    grid: Grid = None,
    outside: Outside = None,
    strict: Strict = False,
    calibration: Calibration = None,
    floor: Floor = None,
    simulations: Simulations = None,
    state: State = None,
    actions: Actions = None,
) -> None:
    """Value of policies in the target, from a simulator and a log. Without arguments: the paper's 10 x 10 grid."""
    from oee_tabular.report import check_output, check_page

    if output is not None:
        check_output(output)
    if page is not None:
        check_page(page)
    elif title is not None:
        raise ValueError("--title needs --report FILE.html, whose title it is")
    options: dict[str, object] = {
        "horizon": horizon, "discount": discount, "rewards": rewards, "action_noise": action_noise, "features": features,
        "tie": tie, "initial": initial, "impossible": impossible, "box": box,
    }  # fmt: skip
    chosen = None if estimators is None else [name.strip() for name in estimators.split(",") if name.strip()]
    settings = settings_of(grid, outside, strict, calibration, floor, simulations)
    continuous = is_continuous(simulator)
    if not continuous:
        refuse_settings(
            simulator, settings | {name: value for name, value in (("state", state), ("actions", actions)) if value}
        )
    common = {"estimators": chosen, "confidence": confidence, "seed": seed, "guaranteed": guaranteed, "quick": quick}
    if simulator is None and not log:
        report = embedded(policy, behavior, target, options, normalized, common)
    elif simulator is None or not log:
        given, lacking = ("log", "simulator") if log else ("simulator", "log")
        raise ValueError(f"--{lacking} must be given with --{given} (record a log with: oee sample)")
    elif continuous:
        report = from_states(
            simulator, log, policy, behavior, target, options, bool(normalized), common, settings, state, actions
        )
    else:
        report = from_files(simulator, log, policy, behavior, target, options, bool(normalized), common)
    answer("evaluate", str(report), report.to_dict() if json else {}, json)
    before = {
        *(() if output is None or not output.exists() else output.iterdir()),
        *([page] if page and page.exists() else ()),
    }
    written = [] if output is None else report.save(output)
    if page is not None:
        report.to_html(page, title=title)
        written.append(page)
    if written and not json:
        typer.echo(f"\nWritten: {', '.join(f'{path} (replaced)' if path in before else str(path) for path in written)}")


def compare(
    simulator: SimulatorOption,
    log: Log,
    policy: Annotated[
        list[str], option(INPUT, f"NAME=SPEC or SPEC, two or more; SPEC: {POLICY_HELP}.", metavar="NAME=SPEC")
    ],
    initial: Initial = None,
    action_noise: Noise = 0.0,
    impossible: Impossible = "refuse",
    horizon: Horizon = None,
    discount: Discount = None,
    rewards: Rewards = "simulator",
    confidence: Confidence = 0.95,
    box: Box = None,
    quick: Quick = False,
    json: Annotated[bool, json_option("compare")] = False,
) -> None:
    """Which policy is worth most in the target: differences with their intervals, P(best), or that the log cannot say."""
    from oee_tabular.report import contest
    from oee_tabular.report.terminal import render_comparison
    from oee_tabular.tasks.arguments import named_specs

    if is_continuous(simulator):
        raise ValueError(
            f"--simulator must have numbered states to compare policies; {simulator!r} is continuous: oee evaluate"
        )
    if len(named_specs(policy)) < 2:
        raise ValueError(
            f"--policy must be given twice or more, for there is nothing to compare; there is {policy[0]!r}"
        )
    options = {
        "horizon": horizon, "discount": discount, "rewards": rewards, "action_noise": action_noise, "initial": initial,
        "impossible": impossible,
    }  # fmt: skip
    task, problem = given_problem(simulator, log, None, options)
    found = contest(problem, policies_of(policy, task), confidence=confidence, quick=quick, **box_of(box))
    warnings = [str(finding) for finding in problem.findings]
    text = "\n".join([render_comparison(found), *([""] if warnings else []), *warnings])
    rows = found.comparison()
    record = {
        "confidence": found.confidence, "best": found.best, "sentence": found.headline, "policies": rows,
        "differences": [
            {"policy": row["policy"], "than": rows[0]["policy"], "difference": -row["less_by"],
             "lower": -row["less_by_upper"], "upper": -row["less_by_lower"]}
            for row in rows[1:]
        ],
        "warnings": warnings,
    }  # fmt: skip
    answer("compare", text, record, json)


def plan(
    simulator: SimulatorOption,
    log: Log,
    transitions: Annotated[int, option(INPUT, "How many more transitions to record.", metavar="N")],
    policy: Policies = None,
    initial: Initial = None,
    action_noise: Noise = 0.0,
    impossible: Impossible = "refuse",
    free: Annotated[bool, option(INPUT, "Any (s, a) can be set up and recorded, not only episodes.", "--free")] = False,
    horizon: Horizon = None,
    discount: Discount = None,
    confidence: Confidence = 0.95,
    output: Annotated[
        Path | None,
        option(
            OUTPUT,
            "The behaviour policy to record with (--free: each (s, a)'s share): .npy.",
            metavar="FILE",
        ),
    ] = None,
    overwrite: Overwrite = False,
    json: Annotated[bool, json_option("plan")] = False,
) -> None:
    """What to record next: a behaviour policy, and the width of each value's interval before and after."""
    from oee_tabular import _files, _progress
    from oee_tabular.design import plan_data_collection

    if output is not None:
        _files.new_file(output, "--output", overwrite=overwrite)
    options = {
        "horizon": horizon, "discount": discount, "rewards": "simulator", "action_noise": action_noise, "initial": initial,
        "impossible": impossible,
    }  # fmt: skip
    task, problem = given_problem(simulator, log, None, options)
    policies = policies_of(policy, task)
    _progress.report_step(f"plan for {transitions} transitions")
    sampling: Any = "free" if free else "behavior"
    found = plan_data_collection(problem, policies, n=transitions, sampling=sampling, confidence=confidence)
    if output is not None:
        write_array(output, found.distribution if free else found.behavior_policy)
    text = str(found)
    if output is not None:
        text += f"\n{output}: {'shares of the moves, (S, A), that sum to 1' if free else 'policy to record with'}"
    answer("plan", text, found.to_dict() | {"file": None if output is None else str(output)}, json)
