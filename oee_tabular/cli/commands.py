"""What each word after ``oee`` does, and its options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from oee_tabular.cli.inputs import (
    ESTIMATORS_HELP,
    FEATURES_HELP,
    POLICY_HELP,
    SIMULATOR_HELP,
    TIE_HELP,
    described,
    embedded,
    from_files,
    policies_of,
    policy_of,
    problem_of,
    recorded,
    task_of,
    write_array,
)
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

app = typer.Typer(
    help="What return will a policy get in the target, given a simulator and a log of the target?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Simulator = Annotated[str, typer.Argument(help=SIMULATOR_HELP)]
Discount = Annotated[float | None, typer.Option(help="Replaces the simulator's discount.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the file if it exists (a Minari folder: never).")]
Policies = Annotated[
    list[str] | None, typer.Option(help=f"NAME=SPEC or SPEC, repeatable (none: optimal); SPEC: {POLICY_HELP}.")
]
Confidence = Annotated[float, typer.Option(help="Level of the intervals.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same bits.")]
Jobs = Annotated[int, typer.Option(help="Processes on this machine; -1: one a core.")]
Dask = Annotated[str | None, typer.Option(help="Address of a dask scheduler, to run the cells there.")]


@app.command()
def evaluate(
    simulator: Annotated[str | None, typer.Option(help=SIMULATOR_HELP)] = None,
    log: Annotated[
        Path | None,
        typer.Option(help="Log of the target: .npz (a log, or its counts), .csv, .parquet, Minari folder or id."),
    ] = None,
    policy: Policies = None,
    behavior: Annotated[str | None, typer.Option(help="Policy that recorded the log, as for --policy.")] = None,
    target: Annotated[str | None, typer.Option(help="The true target, as for --simulator, to show errors.")] = None,
    horizon: Annotated[
        int | None,
        typer.Option(help="Number of rewards; none: the infinite discounted sum, or a continuous task's own."),
    ] = None,
    discount: Discount = None,
    normalized: Annotated[
        bool | None, typer.Option("--normalized/--raw", help="Multiply values by (1 - discount).", show_default=False)
    ] = None,
    estimators: Annotated[str | None, typer.Option(help=f"Comma-separated: {ESTIMATORS_HELP}.")] = None,
    features: Annotated[Path | None, typer.Option(help=FEATURES_HELP)] = None,
    tie: Annotated[Path | None, typer.Option(help=TIE_HELP)] = None,
    rewards: Annotated[str, typer.Option(help="Rewards that model-based values pay: simulator or log.")] = "simulator",
    action_noise: Annotated[
        float, typer.Option(help="Use simulator.with_action_noise(EPSILON), where it is too deterministic for the log.")
    ] = 0.0,
    confidence: Confidence = 0.95,
    guaranteed: Annotated[
        bool, typer.Option("--guaranteed", help="Give the intervals that hold at any sample size as well.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="Leave likelihood intervals out, most of the time of large problems.")
    ] = False,
    grid: Annotated[str | None, typer.Option(help=GRID_HELP)] = None,
    outside: Annotated[str | None, typer.Option(help=OUTSIDE_HELP)] = None,
    strict: Annotated[bool, typer.Option("--strict", help=STRICT_HELP)] = False,
    calibration: Annotated[str | None, typer.Option(help=CALIBRATION_HELP)] = None,
    floor: Annotated[float | None, typer.Option(help=FLOOR_HELP)] = None,
    simulations: Annotated[int | None, typer.Option(help=EPISODES_HELP)] = None,
    state: Annotated[str | None, typer.Option(help=STATE_HELP)] = None,
    actions: Annotated[str | None, typer.Option(help=ACTIONS_HELP)] = None,
    seed: Seed = 0,
    output: Annotated[Path | None, typer.Option(help="Folder for report.json, table.csv and values.png.")] = None,
    page: Annotated[
        Path | None, typer.Option("--report", help="FILE.html: one self-contained page, for people who did not run it.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of the table.")] = False,
) -> None:
    """Value of policies in the target, from a simulator and a log. Without arguments: the paper's 10 x 10 grid."""
    from oee_tabular.report import check_output, check_page

    if output is not None:
        check_output(output)
    if page is not None:
        check_page(page)
    options: dict[str, Any] = {
        "horizon": horizon,
        "discount": discount,
        "rewards": rewards,
        "action_noise": action_noise,
        "features": features,
        "tie": tie,
    }
    chosen = None if estimators is None else [name.strip() for name in estimators.split(",") if name.strip()]
    settings = settings_of(grid, outside, strict, calibration, floor, simulations)
    continuous = is_continuous(simulator)
    if not continuous:
        refuse_settings(settings | {name: value for name, value in (("state", state), ("actions", actions)) if value})
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
    typer.echo(report.to_json() if json else str(report))
    before = {
        *(() if output is None or not output.exists() else output.iterdir()),
        *([page] if page and page.exists() else ()),
    }
    written = [] if output is None else report.save(output)
    if page is not None:
        report.to_html(page)
        written.append(page)
    if written and not json:
        typer.echo(f"\nWritten: {', '.join(f'{path} (replaced)' if path in before else str(path) for path in written)}")


@app.command()
def sample(
    environment: Simulator,
    output: Annotated[Path, typer.Option(help="The log: .npz, .csv, .parquet, or a new Minari folder.")],
    policy: Annotated[str, typer.Option(help=POLICY_HELP)] = "uniform",
    transitions: Annotated[int | None, typer.Option(help="How many transitions to record.")] = None,
    episodes: Annotated[int | None, typer.Option(help="How many episodes to record.")] = None,
    horizon: Annotated[
        int | None, typer.Option(help="Longest episode; none: 1000, or Gymnasium's or the continuous task's own limit.")
    ] = None,
    discount: Discount = None,
    state: Annotated[str | None, typer.Option(help=STATE_HELP)] = None,
    actions: Annotated[str | None, typer.Option(help=ACTIONS_HELP)] = None,
    overwrite: Overwrite = False,
    seed: Seed = 0,
) -> None:
    """Record a log. A Gymnasium environment is stepped through its own step(); a continuous task gives continuous states."""
    if (transitions is None) == (episodes is None):
        raise ValueError("one of --transitions and --episodes must be given")
    from oee_tabular import _files

    _files.new_file(output, "--output", overwrite=overwrite)
    if is_continuous(environment):
        states = recorded_states(environment, policy, transitions, episodes, horizon, seed, state, actions)
        states.save(output)
        typer.echo(f"{output}: {states!r}")
        return
    refuse_settings({name: value for name, value in (("state", state), ("actions", actions)) if value})
    log = recorded(environment, policy, transitions, episodes, horizon, discount, seed)
    log.save(output)
    typer.echo(f"{output}: {log.describe()}")


@app.command()
def policy(
    simulator: Simulator,
    spec: Annotated[str, typer.Argument(help=POLICY_HELP)],
    output: Annotated[Path, typer.Option(help="The policy: .npy, an (S, A) array.")],
    discount: Discount = None,
) -> None:
    """Write a policy of a simulator to a file."""
    pi = policy_of(spec, task_of(simulator, discount), "policy")
    there = output.exists()
    write_array(output, pi)
    typer.echo(f"{output}{' (replaced)' * there}: policy of {pi.shape[0]} states and {pi.shape[1]} actions")


@app.command()
def export(
    simulator: Simulator,
    output: Annotated[Path, typer.Option(help="The FiniteMDP: .npz.")],
    discount: Discount = None,
    action_noise: Annotated[float, typer.Option(help="As in evaluate.")] = 0.0,
) -> None:
    """Write a simulator to an .npz file; of a continuous task its finite MDP, with the cells and what they were made from."""
    task = task_of(simulator, discount)
    mdp = task.mdp.with_action_noise(action_noise) if action_noise else task.mdp
    saved = task.discretization if task.discretization is not None and not action_noise else mdp
    there = output.exists()
    saved.save(output)
    typer.echo(f"{output}{' (replaced)' * there}: {saved!r}")


@app.command()
def counts(
    log: Annotated[
        list[str], typer.Argument(help="Files (.parquet, .csv, .npz), folders of them, or patterns, of one log.")
    ],
    output: Annotated[Path, typer.Option(help="The counts: .npz, for --log of evaluate and plan.")],
    simulator: Annotated[
        str | None, typer.Option(help="Whose states and actions there are; others are bad rows. As in evaluate.")
    ] = None,
    bad_rows: Annotated[
        str, typer.Option(help="Rows that are none of a log: refuse the first, or drop and count them.")
    ] = "refuse",
    kept_moves: Annotated[
        int, typer.Option(help="Moves of whole episodes to keep for importance sampling, drawn uniformly.")
    ] = 200_000,
    jobs: Jobs = 1,
    dask: Dask = None,
    overwrite: Overwrite = False,
) -> None:
    """Count the moves of a log of any size. A count that was stopped goes on where it was."""
    import sys

    from oee_tabular import _files
    from oee_tabular.data import Transitions

    _files.new_file(output, "--output", overwrite=overwrite)
    mdp = None if simulator is None else task_of(simulator, None).mdp
    limits = {} if mdp is None else {"n_states": mdp.n_states, "n_actions": mdp.n_actions}
    found = Transitions.open(
        log, **limits, bad_rows=bad_rows, kept_moves=kept_moves, output=output, jobs=jobs, dask=dask,
        progress=sys.stderr.isatty(),
    )  # fmt: skip
    typer.echo(f"{output}: {found.describe()}")
    for reason in found.recording.reasons:
        typer.echo(f"dropped: {reason}")


@app.command()
def info(file: Annotated[str, typer.Argument(help="A FiniteMDP, a log, a policy or a report.")]) -> None:
    """Say what a file holds."""
    typer.echo(described(file))


@app.command()
def plan(
    simulator: Annotated[str, typer.Option(help=SIMULATOR_HELP)],
    log: Annotated[Path, typer.Option(help="Log of the target so far, as in evaluate.")],
    transitions: Annotated[int, typer.Option(help="How many more transitions to record.")],
    policy: Policies = None,
    output: Annotated[
        Path | None, typer.Option(help="The behaviour policy to record with (--free: each (s, a)'s share): .npy.")
    ] = None,
    free: Annotated[
        bool, typer.Option("--free", help="Any (s, a) can be set up and recorded, not only episodes.")
    ] = False,
    horizon: Annotated[int | None, typer.Option(help="As in evaluate.")] = None,
    discount: Discount = None,
    confidence: Confidence = 0.95,
    overwrite: Overwrite = False,
) -> None:
    """What to record next: a behaviour policy, and the width of each value's interval before and after."""
    from oee_tabular import _files
    from oee_tabular.design import plan_data_collection

    if output is not None:
        _files.new_file(output, "--output", overwrite=overwrite)
    task = task_of(simulator, discount)
    problem = problem_of(task, log, horizon=horizon, behavior=None, rewards="simulator")
    found = plan_data_collection(
        problem,
        policies_of(policy, task),
        n=transitions,
        sampling="free" if free else "behavior",
        confidence=confidence,
    )
    typer.echo(str(found))
    if output is not None:
        write_array(output, found.distribution if free else found.behavior_policy)
        typer.echo(f"{output}: {'shares of the moves, (S, A), that sum to 1' if free else 'policy to record with'}")


@app.command()
def reproduce(
    experiments: Annotated[list[str] | None, typer.Argument(help="Ids or groups; --list shows them.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Every experiment.")] = False,
    show: Annotated[bool, typer.Option("--list", help="List the experiments and stop.")] = False,
    smoke: Annotated[bool, typer.Option("--smoke", help="A small subset of each sweep, into OUTPUT/smoke.")] = False,
    seeds: Annotated[
        int | None, typer.Option(help="Repetitions of each cell, instead of the experiment's own.")
    ] = None,
    seed: Seed = 0,
    jobs: Jobs = -1,
    dask: Dask = None,
    output: Annotated[
        Path, typer.Option(help="Folder for ID/table.csv, summary.md, figure.svg, ... and index.md.")
    ] = Path("results"),
    fresh: Annotated[bool, typer.Option("--fresh", help="Empty the experiments' folders first.")] = False,
) -> None:
    """The paper's figures, and more. An interrupted run goes on where it stopped."""
    from oee_tabular.experiments.command import listing
    from oee_tabular.experiments.command import reproduce as run

    if show:
        typer.echo(listing())
        return
    run(experiments or [], everything=everything, smoke=smoke, seeds=seeds, seed=seed, jobs=jobs, dask=dask, output=output,
        fresh=fresh, say=typer.echo)  # fmt: skip


@app.command()
def bench(
    estimators: Annotated[
        str, typer.Option(help=f"Comma-separated: evaluate (as printed), MODULE:OBJECT, {ESTIMATORS_HELP}.")
    ] = "oee,model-based",
    sizes: Annotated[
        str | None, typer.Option(help="Moves per open row, comma-separated.", show_default="0.3,1,3,10,30")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Logs of each family and size.")] = 40,
    families: Annotated[
        str | None, typer.Option(help="Names, comma-separated, or MODULE:FUNCTION of your own.", show_default="all")
    ] = None,
    seed: Seed = 0,
    jobs: Jobs = -1,
    dask: Dask = None,
    output: Annotated[
        Path, typer.Option(help="Folder for table.csv, cells.csv, league.csv, league.md, profile.png, heat.png.")
    ] = Path("results/bench"),
    fresh: Annotated[bool, typer.Option("--fresh", help="Empty the folder first.")] = False,
) -> None:
    """Measure estimators on families of environment shift where the truth is exact. An interrupted run goes on."""
    from oee_tabular.bench.command import bench as run

    run(estimators=estimators, sizes=sizes, seeds=seeds, seed=seed, families=families, jobs=jobs, dask=dask, output=output,
        fresh=fresh, say=typer.echo)  # fmt: skip


@app.command()
def check(
    estimator: Annotated[str, typer.Argument(help="MODULE:OBJECT, an estimator, or what makes one without arguments.")],
    seed: Seed = 0,
    repetitions: Annotated[
        int, typer.Option(help="Logs of each statistical comparison, at least 3: with more, smaller biases are found.")
    ] = 8,
    timeout: Annotated[
        float, typer.Option(help="Seconds that each law may take: an estimator that takes longer breaks it.")
    ] = 60.0,
) -> None:
    """Check an estimator of yours against the laws of estimators; exit code 0 if those that it claims hold, else 1.

    It runs in a process of its own. Where the exit code is 0, the last line is "all laws hold".
    """
    from oee_tabular.testing.command import check as run

    verdicts = run(estimator, seed=seed, repetitions=repetitions, timeout=timeout)
    typer.echo(str(verdicts))
    if not verdicts.passed:
        raise typer.Exit(1)
    typer.echo("all laws hold")


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
