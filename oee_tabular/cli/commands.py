"""What each word after ``oee`` does, and its options: values of policies, logs and files. Studies are in ``cli.studies``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from oee_tabular.cli import studies
from oee_tabular.cli.answers import answer
from oee_tabular.cli.app import Grouped, app
from oee_tabular.cli.inputs import (
    ESTIMATORS_HELP,
    FEATURES_HELP,
    TIE_HELP,
    embedded,
    from_files,
    given_problem,
    recorded,
    write_array,
)
from oee_tabular.cli.options import (
    CONTINUOUS,
    INPUT,
    LOG_HELP,
    OUTPUT,
    VALUE,
    Confidence,
    Dask,
    Discount,
    Horizon,
    Impossible,
    Initial,
    Jobs,
    Log,
    Noise,
    Overwrite,
    Policies,
    Quick,
    Rewards,
    Seed,
    Simulator,
    SimulatorOption,
    json_option,
    option,
)
from oee_tabular.cli.policies import POLICY_HELP, policies_of, policy_of
from oee_tabular.cli.simulators import SIMULATOR_HELP, task_of
from oee_tabular.continuous.command import (
    ACTIONS_HELP,
    CALIBRATION_HELP,
    EPISODES_HELP,
    FLOOR_HELP,
    GRID_HELP,
    OUTSIDE_HELP,
    STATE_HELP,
    STRICT_HELP,
    from_states,
    is_continuous,
    recorded_states,
    refuse_settings,
    settings_of,
)

__all__ = ["app"]


@app.command(cls=Grouped, short_help="Value of policies in the target, with intervals.")
def evaluate(
    simulator: Annotated[str | None, option(INPUT, f"{SIMULATOR_HELP}.", metavar="SIM")] = None,
    log: Annotated[Path | None, option(INPUT, LOG_HELP, metavar="FILE")] = None,
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
    grid: Annotated[str | None, option(CONTINUOUS, GRID_HELP, metavar="NxM")] = None,
    outside: Annotated[str | None, option(CONTINUOUS, OUTSIDE_HELP, metavar="WORD")] = None,
    strict: Annotated[bool, option(CONTINUOUS, STRICT_HELP, "--strict")] = False,
    calibration: Annotated[str | None, option(CONTINUOUS, CALIBRATION_HELP, metavar="WORD")] = None,
    floor: Annotated[float | None, option(CONTINUOUS, FLOOR_HELP, metavar="SHARE")] = None,
    simulations: Annotated[int | None, option(CONTINUOUS, EPISODES_HELP, metavar="N")] = None,
    state: Annotated[str | None, option(CONTINUOUS, STATE_HELP, metavar="MODULE:GET,SET")] = None,
    actions: Annotated[str | None, option(CONTINUOUS, ACTIONS_HELP, metavar="LEVELS")] = None,
) -> None:
    """Value of policies in the target, from a simulator and a log. Without arguments: the paper's 10 x 10 grid."""
    from oee_tabular.report import check_output, check_page

    if output is not None:
        check_output(output)
    if page is not None:
        check_page(page)
    elif title is not None:
        raise ValueError("--title needs --report FILE.html, whose title it is")
    options: dict[str, Any] = {
        "horizon": horizon, "discount": discount, "rewards": rewards, "action_noise": action_noise, "features": features,
        "tie": tie, "initial": initial, "impossible": impossible,
    }  # fmt: skip
    chosen = None if estimators is None else [name.strip() for name in estimators.split(",") if name.strip()]
    settings = settings_of(grid, outside, strict, calibration, floor, simulations)
    continuous = is_continuous(simulator)
    if not continuous:
        _refuse_settings(
            simulator, settings | {name: value for name, value in (("state", state), ("actions", actions)) if value}
        )
    common = {"estimators": chosen, "confidence": confidence, "seed": seed, "guaranteed": guaranteed, "quick": quick}
    if simulator is None and log is None:
        report = embedded(policy, behavior, target, options, normalized, common)
    elif simulator is None or log is None:
        given, lacking = ("simulator", "log") if log is None else ("log", "simulator")
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


@app.command(cls=Grouped, short_help="Which of several policies is worth most, or that the log cannot say.")
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
    quick: Quick = False,
    json: Annotated[bool, json_option("compare")] = False,
) -> None:
    """Which policy is worth most in the target: differences with their intervals, P(best), or that the log cannot say."""
    from oee_tabular.report import contest
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
    found = contest(problem, policies_of(policy, task), confidence=confidence, quick=quick)
    warnings = [str(finding) for finding in problem.findings]
    text = "\n".join([str(found), *(["", "Read before use:"] if warnings else []), *(f"  {text}" for text in warnings)])
    answer("compare", text, found.to_dict() | {"warnings": warnings}, json)


@app.command(cls=Grouped, short_help="What to record next.")
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
    _progress.doing(f"plan for {transitions} transitions")
    sampling: Any = "free" if free else "behavior"
    found = plan_data_collection(problem, policies, n=transitions, sampling=sampling, confidence=confidence)
    if output is not None:
        write_array(output, found.distribution if free else found.behavior_policy)
    text = str(found)
    if output is not None:
        text += f"\n{output}: {'shares of the moves, (S, A), that sum to 1' if free else 'policy to record with'}"
    answer("plan", text, found.to_dict() | {"file": None if output is None else str(output)}, json)


@app.command(cls=Grouped, short_help="Record a log.")
def sample(
    environment: Simulator,
    output: Annotated[Path, option(OUTPUT, "The log: .npz, .csv, .parquet, or a new Minari folder.", metavar="FILE")],
    policy: Annotated[str, option(INPUT, f"{POLICY_HELP}.", metavar="SPEC")] = "uniform",
    transitions: Annotated[int | None, option(INPUT, "How many transitions to record.", metavar="N")] = None,
    episodes: Annotated[int | None, option(INPUT, "How many episodes to record.", metavar="N")] = None,
    horizon: Annotated[
        int | None,
        option(INPUT, "Longest episode; none: 1000, or Gymnasium's or the continuous task's own limit.", metavar="T"),
    ] = None,
    discount: Discount = None,
    initial: Initial = None,
    state: Annotated[str | None, option(CONTINUOUS, STATE_HELP, metavar="MODULE:GET,SET")] = None,
    actions: Annotated[str | None, option(CONTINUOUS, ACTIONS_HELP, metavar="LEVELS")] = None,
    overwrite: Overwrite = False,
    seed: Seed = 0,
    json: Annotated[bool, json_option("sample")] = False,
) -> None:
    """Record a log. A Gymnasium environment is stepped through its own step(); a continuous task gives continuous states.

    States and actions stand there by name where the simulator has names; a Minari folder has numbers.
    """
    if (transitions is None) == (episodes is None):
        raise ValueError("one of --transitions and --episodes must be given")
    from oee_tabular import _files

    _files.new_file(output, "--output", overwrite=overwrite)
    if is_continuous(environment):
        states = recorded_states(environment, policy, transitions, episodes, horizon, seed, state, actions)
        states.save(output)
        size, number, text = len(states), states.n_episodes, f"{output}: {states!r}"
    else:
        _refuse_settings(
            environment, {name: value for name, value in (("state", state), ("actions", actions)) if value}
        )
        by_name = output.suffix != ""  # a Minari data set holds numbers
        log = recorded(environment, policy, transitions, episodes, horizon, discount, initial, seed, by_name=by_name)
        log.save(output)
        size, number, text = len(log), log.n_episodes, f"{output}: {log.describe()}"
    answer("sample", text, {"file": str(output), "transitions": size, "episodes": number}, json)


@app.command(cls=Grouped, short_help="Write a policy of a simulator to a file.")
def policy(
    simulator: Simulator,
    spec: Annotated[str, typer.Argument(help=f"{POLICY_HELP}.", metavar="SPEC")],
    output: Annotated[Path, option(OUTPUT, "The policy: .npy, an (S, A) array.", metavar="FILE")],
    discount: Discount = None,
    json: Annotated[bool, json_option("policy")] = False,
) -> None:
    """Write a policy of a simulator to a file."""
    pi = policy_of(spec, task_of(simulator, discount), "policy")
    there = output.exists()
    write_array(output, pi)
    text = f"{output}{' (replaced)' * there}: policy of {pi.shape[0]} states and {pi.shape[1]} actions"
    answer("policy", text, {"file": str(output), "states": pi.shape[0], "actions": pi.shape[1]}, json)


@app.command(cls=Grouped, short_help="Write a simulator to a file.")
def export(
    simulator: Simulator,
    output: Annotated[Path, option(OUTPUT, "The FiniteMDP: .npz.", metavar="FILE")],
    discount: Discount = None,
    initial: Initial = None,
    action_noise: Noise = 0.0,
    samples_per_pair: Annotated[
        int | None,
        option(
            INPUT,
            "Step an environment until each (s, a) that it met has so many samples; its frequencies.",
            metavar="N",
        ),
    ] = None,
    json: Annotated[bool, json_option("export")] = False,
) -> None:
    """Write a simulator to an .npz file; of a continuous task its finite MDP, with the cells and what they were made from."""
    task = task_of(simulator, discount, initial, samples_per_pair)
    mdp = task.mdp.with_action_noise(action_noise) if action_noise else task.mdp
    own = task.discretization is not None and not action_noise and initial is None
    saved = task.discretization if own else mdp
    there = output.exists()
    saved.save(output)
    facts = {
        "states": mdp.n_states,
        "actions": mdp.n_actions,
        "transitions": mdp.transitions.nnz,
        "discount": mdp.discount,
    }
    answer("export", f"{output}{' (replaced)' * there}: {saved!r}", {"file": str(output)} | facts, json)


@app.command(cls=Grouped, short_help="Count the moves of a log of any size.")
def counts(
    log: Annotated[
        list[str],
        typer.Argument(
            help="Files (.parquet, .csv, .npz), folders of them, or patterns, of one log.", metavar="FILE..."
        ),
    ],
    output: Annotated[Path, option(OUTPUT, "The counts: .npz, for --log of evaluate and plan.", metavar="FILE")],
    simulator: Annotated[
        str | None,
        option(
            INPUT,
            "Whose states and actions there are, by number or name; others are bad rows. As in evaluate.",
            metavar="SIM",
        ),
    ] = None,
    bad_rows: Annotated[
        str,
        option(INPUT, "Rows that are none of a log: refuse the first, or drop and count them.", metavar="refuse|drop"),
    ] = "refuse",
    kept_moves: Annotated[
        int, option(INPUT, "Moves of whole episodes to keep for importance sampling, drawn uniformly.", metavar="N")
    ] = 200_000,
    jobs: Jobs = 1,
    dask: Dask = None,
    overwrite: Overwrite = False,
    json: Annotated[bool, json_option("counts")] = False,
) -> None:
    """Count the moves of a log of any size. A count that was stopped goes on where it was."""
    import sys

    from oee_tabular import _files
    from oee_tabular.data import Transitions

    _files.new_file(output, "--output", overwrite=overwrite)
    mdp = None if simulator is None else task_of(simulator, None).mdp
    found = Transitions.open(
        log, simulator=mdp, bad_rows=bad_rows, kept_moves=kept_moves, output=output, jobs=jobs, dask=dask,
        progress=sys.stderr.isatty(),
    )  # fmt: skip
    reasons = found.recording.reasons
    text = "\n".join([f"{output}: {found.describe()}", *(f"dropped: {reason}" for reason in reasons)])
    answer("counts", text, {"file": str(output), "moves": found.summary()["transitions"], "dropped": reasons}, json)


@app.command(cls=Grouped, short_help="Say what a file holds.")
def info(
    file: Annotated[str, typer.Argument(help="A FiniteMDP, a log, a policy or a report.", metavar="FILE")],
    json: Annotated[bool, json_option("info")] = False,
) -> None:
    """Say what a file holds."""
    from oee_tabular.cli.described import described

    kind, text = described(file)
    answer("info", text, {"file": file, "kind": kind, "text": text.split("\n")}, json)


for study in (studies.reproduce, studies.bench, studies.check):
    app.command(cls=Grouped, short_help=studies.SHORT[study.__name__])(study)


def _refuse_settings(simulator: str | None, settings: dict[str, Any]) -> None:
    """Options of continuous tasks are refused; before that, a simulator that is not there."""
    if settings and simulator is not None:
        task_of(simulator, None)
    refuse_settings(settings)


def _version(asked: bool) -> None:
    if asked:
        from oee_tabular import __version__

        typer.echo(f"oee {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Evaluate policies in a target environment, given a simulator and a log."""
