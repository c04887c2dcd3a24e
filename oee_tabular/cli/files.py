"""Commands of files: record and count logs, write policies and simulators."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
import typer

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _files
from oee_tabular._checks import positive_integer
from oee_tabular._progress import is_terminal
from oee_tabular.cli.inputs import (
    describe_default_discount,
    has_default_discount,
    policy_of,
    read_columns,
    task_of,
    tell_default_discount,
)
from oee_tabular.cli.options import (
    INPUT,
    OUTPUT,
    ActionNoiseOption,
    ColumnOption,
    DaskOption,
    DiscountOption,
    InitialOption,
    JobsOption,
    JsonOption,
    OptionalSimulatorOption,
    OverwriteOption,
    SeedOption,
    SimulatorArgument,
    TableColumnOption,
    print_result,
    remark,
)
from oee_tabular.cli.simulators import (
    describe_ends,
    describe_table,
    is_table,
    load_samples,
    read_simulator,
)
from oee_tabular.continuous import is_continuous, record_log, task_options
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array

MAX_STEPS = 1000  # of an episode, where nothing else limits it


def sample(
    *,
    environment: SimulatorArgument,
    policy: Annotated[
        str,
        typer.Option(
            "--policy",
            metavar="SPEC",
            help="Policy that records the log.",
            rich_help_panel=INPUT,
        ),
    ] = "uniform",
    transitions: Annotated[
        int | None,
        typer.Option(
            "--transitions",
            metavar="N",
            help="Number of transitions to record.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            "--episodes",
            metavar="N",
            help="Number of episodes to record.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    horizon: Annotated[
        int | None,
        typer.Option(
            "--horizon",
            metavar="T",
            help="Longest episode; without it, 1000 steps or the task's own limit.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    initial: InitialOption = None,
    task_option: Annotated[
        list[str] | None,
        typer.Option(
            "--task-option",
            metavar="NAME=VALUE",
            help=(
                "Setting of a Gymnasium environment with continuous states,"
                " repeatable: state or actions."
            ),
            rich_help_panel=INPUT,
        ),
    ] = None,
    discount: DiscountOption = None,
    seed: SeedOption = 0,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            metavar="FILE",
            help="The log: .npz, .csv, .csv.gz, .parquet, or a new Minari folder.",
            rich_help_panel=OUTPUT,
        ),
    ],
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Record a log.

    A Gymnasium environment is stepped through its own step(); a continuous task gives
    continuous states. States and actions are written by name where the simulator has
    names; a Minari folder has numbers.
    """
    if (transitions is None) == (episodes is None):
        raise ValueError("one of --transitions and --episodes must be given")
    numbers = {
        "--transitions": transitions,
        "--episodes": episodes,
        "--horizon": horizon,
    }
    for option, number in numbers.items():
        if number is not None:
            positive_integer(number, option)
    from oee_tabular.data.files import new_log_file

    has_vectors = is_continuous(environment)
    kind = oee.ContinuousTransitions if has_vectors else oee.Transitions
    file = new_log_file(kind.FILES, output, "--output", overwrite=overwrite)
    settings = task_options(task_option, ("state", "actions"))
    log: Any
    if has_vectors:
        for option, value in (("--initial", initial), ("--discount", discount)):
            if value is not None:
                raise ArgumentError(
                    option,
                    "must be left out for a continuous task, whose log depends on"
                    f" neither; it is {value}",
                )
        log = record_log(
            environment,
            policy,
            settings,
            max_steps=horizon,
            n_transitions=transitions,
            n_episodes=episodes,
            seed=seed,
        )
        text = repr(log)
    else:
        task = task_of(environment, discount, initial)
        if settings:
            raise ValueError(
                "--task-option needs a continuous task (oee sample"
                f" cartpole:gravity=10); {environment!r} is none"
            )
        log = _record(
            task,
            policy_of(policy, task, "policy"),
            n_transitions=transitions,
            n_episodes=episodes,
            max_steps=horizon or MAX_STEPS,
            seed=seed,
            # reset() of an environment takes no first state
            is_stepped=task.environment is not None and initial is None,
        )
        # a Minari data set, which is a folder, holds numbers
        if output.suffix:
            log = oee.Transitions(
                **log.columns(),
                state_names=task.mdp.state_names,
                action_names=task.mdp.action_names,
            )
        text = log.describe()
    with file.writing():
        log.save(output)
    record = {
        "file": str(output),
        "transitions": len(log),
        "episodes": log.n_episodes,
    }
    print_result(f"{output}: {text}", record, as_json)


def _record(
    task: oee.tasks.NamedTask,
    policy: Array,
    *,
    n_transitions: int | None,
    n_episodes: int | None,
    max_steps: int,
    seed: int,
    is_stepped: bool,
) -> Any:
    """Record a log of numbered states, from the environment or from its FiniteMDP."""
    from oee_tabular.simulate import episodes_holding

    if is_stepped and task.environment is not None:
        environment = task.environment()
        log = oee.record_episodes(
            environment,
            policy,
            max_steps=max_steps,
            n_transitions=n_transitions,
            n_episodes=n_episodes,
            seed=seed,
        )
        environment.close()
        return log
    if n_episodes is not None:
        return oee.sample_episodes(task.mdp, policy, n_episodes, max_steps, seed=seed)
    assert n_transitions is not None  # one of the two is given
    episodes = episodes_holding(task.mdp, policy, n_transitions, max_steps, seed=seed)
    return episodes.first(n_transitions)


def policy(
    *,
    simulator: SimulatorArgument,
    spec: Annotated[
        str,
        typer.Argument(metavar="SPEC", help="The policy.", rich_help_panel=INPUT),
    ],
    discount: DiscountOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            metavar="FILE",
            help="The policy: .npy, an array of shape (S, A), or .csv, a table with"
            " names.",
            rich_help_panel=OUTPUT,
        ),
    ],
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a policy of a simulator to a file."""
    from oee_tabular.cli.policies import ENDINGS, write_pairs

    file = _files.new_file(output, "--output", overwrite=overwrite, endings=ENDINGS)
    task = task_of(simulator, discount)
    table = policy_of(spec, task, "policy")
    tell_default_discount(simulator, discount, task)
    n_states, n_actions = table.shape
    text = f"{output}: policy of {n_states} states and {n_actions} actions"
    with file.writing():
        write_pairs(output, table, task.mdp)
    record = {"file": str(output), "states": n_states, "actions": n_actions}
    print_result(text, record, as_json)


def export(
    *,
    simulator: SimulatorArgument,
    column: TableColumnOption = None,
    initial: InitialOption = None,
    action_noise: ActionNoiseOption = 0.0,
    samples_per_pair: Annotated[
        int | None,
        typer.Option(
            "--samples-per-pair",
            metavar="N",
            help="Number of samples of each state-action pair of a stepped"
            " environment.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    discount: DiscountOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            metavar="FILE",
            help="The FiniteMDP as .npz, or as .umb for PRISM and Storm.",
            rich_help_panel=OUTPUT,
        ),
    ],
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a simulator to a file.

    A continuous task is written as its finite MDP, with the cells and what they were
    made from. A table (.csv) with the columns state, action, next_state, probability
    and reward is written as it is. Where it has a column terminated as well, nothing
    more is earned after a transition in which that is true. One of samples (.csv,
    .parquet), without probability, is written by its frequencies.
    """
    endings = oee.tasks.MDP_ENDINGS
    file = _files.new_file(output, "--output", overwrite=overwrite, endings=endings)
    discretization: Any = None
    task = None
    if is_table(simulator):
        if samples_per_pair is not None:
            raise ArgumentError(
                "--samples-per-pair",
                "must be left out for a table, whose samples are taken already; it is"
                f" {samples_per_pair}",
            )
        columns = read_columns(column, [simulator])
        mdp = read_simulator(simulator, columns, initial, discount)
    else:
        if column:
            raise ArgumentError(
                "--column",
                f"must be left out for {simulator!r}, which is no table",
            )
        task = task_of(simulator, discount, initial, samples_per_pair)
        mdp, discretization = task.mdp, task.discretization
    mdp = mdp.with_action_noise(action_noise) if action_noise else mdp
    saved: Any = mdp
    is_plain = bool(action_noise) or initial is not None or output.suffix != ".npz"
    if discretization is not None and not is_plain:
        saved = discretization
    with file.writing():
        saved.save(output)
    record = {
        "file": str(output),
        "discount": mdp.discount,
        "states": mdp.n_states,
        "actions": mdp.n_actions,
        "transitions": mdp.transitions.nnz,
    }
    text = f"{output}: {saved!r}"
    if is_table(simulator):
        text += f"\n{describe_ends(mdp)}"
    if has_default_discount(simulator, discount, task):
        default = describe_default_discount(mdp.discount)
        if as_json:
            remark(default)
        text += f"\n{default}"
    print_result(text, record, as_json)


def counts(
    *,
    log: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE...",
            help="Files (.parquet, .csv, .csv.gz, .npz), folders or patterns of one"
            " log.",
            rich_help_panel=INPUT,
        ),
    ],
    column: ColumnOption = None,
    simulator: OptionalSimulatorOption = None,
    bad_rows: Annotated[
        str,
        typer.Option(
            "--bad-rows",
            metavar="refuse|drop",
            help="Rows that are no transitions: refuse the first, or drop and count.",
            rich_help_panel=INPUT,
        ),
    ] = "refuse",
    kept_moves: Annotated[
        int,
        typer.Option(
            "--kept-moves",
            metavar="N",
            help="Transitions of whole random episodes to keep for importance"
            " sampling.",
            rich_help_panel=INPUT,
        ),
    ] = 200_000,
    jobs: JobsOption = 1,
    dask: DaskOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            metavar="FILE",
            help="The counts as .npz, for `--log` of evaluate and plan.",
            rich_help_panel=OUTPUT,
        ),
    ],
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Count the transitions of a log of any size.

    The file appears when all are counted. States and actions that the simulator does
    not have are bad rows.
    """
    file = _files.new_file(output, "--output", overwrite=overwrite, endings=(".npz",))
    _require_another_file(output, log)
    mdp = None if simulator is None else task_of(simulator).mdp
    asked: dict[str, Any] = {"bad_rows": bad_rows, "kept_moves": kept_moves}
    asked["columns"] = read_columns(column, log)
    counted = oee.Transitions.open(
        log,
        simulator=mdp,
        jobs=jobs,
        dask=dask,
        progress=is_terminal(sys.stderr),
        **asked,
    )
    with file.writing():
        counted.save(output)
    reasons = counted.recording.reasons
    lines = [f"{output}: {counted.describe()}"]
    lines += [f"invalid: {reason}" for reason in reasons]
    record = {
        "file": str(output),
        "moves": counted.summary()["transitions"],
        "dropped": reasons if counted.recording.dropped else (),
        "invalid": reasons,
    }
    print_result("\n".join(lines), record, as_json)


def info(
    *,
    file: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE...",
            help="A FiniteMDP or its table, a log (or its files), a policy, trials or a"
            " report.",
            rich_help_panel=INPUT,
        ),
    ],
    column: TableColumnOption = None,
    as_json: JsonOption = False,
) -> None:
    """Describe the contents of a file.

    Of a log with other labels it says which of them it reads as which column. Columns
    of a log are state, action, next_state, reward, terminated, truncated, episode,
    timestep and behavior_probability.
    """
    kind, text = describe_files(file, read_columns(column, file))
    record = {"file": ", ".join(file), "kind": kind, "text": text.split("\n")}
    print_result(text, record, as_json)


def describe_files(
    files: list[str], columns: Mapping[str, Any] | None = None
) -> tuple[str, str]:
    """Return in words what kind of thing a file, a data set or a log's files hold.

    Parameters
    ----------
    files : list of str
        One file, data set, folder or pattern, or the files of one log.
    columns : mapping, optional
        What the files of a log call its columns.

    Returns
    -------
    kind : str
        "finite_mdp", "simulator_table", "transitions", "transition_counts",
        "continuous_transitions", "policy", "report", "trials" or "arrays".
    text : str
        What it holds, in one or more lines.
    """
    from oee_tabular.continuous import holds_states
    from oee_tabular.data import holds_trials
    from oee_tabular.data.files import find_log_files

    file = files[0]
    path = Path(_files.local(files[0]))
    if (path / "report.json").is_file():
        path = path / "report.json"
    if len(files) == 1 and holds_trials(file):
        if not columns:
            return "trials", _describe_trials(oee.Trials.load(file))
        # of a log, --column names labels that are there
        if not _name_labels(file, columns):
            _refuse_columns(file, "holds trials")
    if path.suffix.lower() == ".umb":
        if columns:
            _refuse_columns(file, "is a FiniteMDP")
        mdp = oee.FiniteMDP.load(file)
        return "finite_mdp", _describe_mdp(mdp, file, {})
    if path.suffix.lower() == ".json":
        from oee_tabular.report import summary

        if columns:
            _refuse_columns(str(path), "is a report")
        return "report", summary(path)
    is_pattern = not path.exists() and bool(set("*?[") & set(file))
    first, has_parts = file, False
    if path.is_dir() and len(files) == 1:
        first = find_log_files(file)[0].path
        has_parts = Path(first) != path
    is_single = len(files) == 1 and not is_pattern and not has_parts
    if not is_pattern and holds_states(first, columns):
        given = file if len(files) == 1 else files
        states = oee.ContinuousTransitions.load(given, columns=columns)
        text = _describe_states(states)
        return "continuous_transitions", text + _describe_labels(states, files, columns)
    if is_single and path.suffix.lower() in (".csv", ".gz", ".parquet"):
        table = describe_table(file, columns or {})
        if table is not None:
            return "simulator_table", table
    if is_single and path.suffix.lower() == ".csv":
        from oee_tabular.cli.policies import describe_policy, require_commas

        require_commas(file)
        policy = describe_policy(file)
        if policy is not None and not columns:
            return "policy", policy
        if policy is not None and "next_state" not in (columns or {}):
            _refuse_columns(file, "holds a policy")
    if not is_single or path.suffix.lower() not in (".npz", ".npy"):
        log = load_samples(files, columns or {})
        return "transitions", repr(log) + _describe_labels(log, files, columns)
    if columns:
        _refuse_columns(file, "is no table")
    return _describe_arrays(file)


def _name_labels(file: str, columns: Mapping[str, Any]) -> bool:
    """Say whether a table has a label that is given for a column."""
    from oee_tabular.data.tables import read_labels

    if Path(file).suffix.lower() != ".csv":
        return False
    given = [label for one in columns.values() for label in np.atleast_1d(one)]
    return bool(set(given) & set(read_labels(file)))


def _refuse_columns(file: str, is_what: str) -> NoReturn:
    """Raise an ArgumentError for --column beside a file that is no log."""
    raise ArgumentError(
        "columns",
        f"must be left out for {file!r}, which {is_what}; it names the columns of a"
        " log",
    )


def _describe_arrays(file: str) -> tuple[str, str]:
    """Return what kind of thing a file of arrays holds, and say what."""
    arrays = _files.read_npz(file)
    kind = _files.npz_kind(arrays)
    if kind == "transitions":
        return kind, repr(oee.Transitions.load(file))
    if kind == "transition_counts":
        counted = oee.TransitionCounts.load(file)
        reasons = [f"invalid: {reason}" for reason in counted.recording.reasons]
        return kind, "\n".join([repr(counted), *reasons])
    if kind == "finite_mdp":
        return kind, _describe_mdp(oee.FiniteMDP.load(file), file, arrays)
    lines = [_describe_array(name, array) for name, array in arrays.items()]
    return "arrays", "\n".join(lines)


def _describe_labels(
    log: Any, files: list[str], columns: Mapping[str, Any] | None
) -> str:
    """Return lines with the number of files, and labels that are not the log's own.

    The labels are those of the first file.
    """
    from oee_tabular._checks import show
    from oee_tabular.continuous import find_lists
    from oee_tabular.data.files import find_log_files
    from oee_tabular.data.tables import read_labels

    found_files = find_log_files(files)
    number = f"\nfiles: {len(found_files)}" if len(found_files) > 1 else ""
    first = found_files[0]
    if first.suffix not in (".csv", ".parquet"):
        return number
    labels = [*read_labels(first.path), *(label for label, _ in first.fixed)]
    with_lists = None
    if first.suffix == ".parquet":
        with_lists = find_lists(first.path, columns or {})
    if with_lists is not None:
        found = with_lists[0]
    else:
        found = log.FILES.with_columns(columns).match(
            list(dict.fromkeys(labels)), first.path
        )
    words = [
        f"{column} is {', '.join(map(show, group))}"
        for column, group in found.taken.items()
        if group != (column,)
    ]
    return number + (f"\ncolumns: {'; '.join(words)}" if words else "")


def _describe_trials(trials: Any) -> str:
    """Describe trials, all of them and those of each policy."""
    lines = [repr(trials)]
    if len(trials.names) > 1:
        lines += [f"{name}: {trials.of(name)!r}" for name in trials.names]
    return "\n".join(lines)


def _describe_states(log: Any) -> str:
    """Describe a log of continuous states by the range of each coordinate."""
    lines = [repr(log)]
    for name in ("state", "next_state"):
        ranges = [
            f"_{k} {column.min():.4g} to {column.max():.4g}"
            for k, column in enumerate(getattr(log, name).T)
        ]
        lines.append(f"{name}: {', '.join(ranges)}")
    if log.behavior_probability is not None:
        lines.append("with behaviour probabilities")
    return "\n".join(lines)


def _describe_mdp(mdp: Any, file: str, arrays: dict[str, Any]) -> str:
    """Describe a FiniteMDP, and the continuous task that it was made from, if any."""
    n_terminal = int(mdp.absorbing().sum())
    states = "state" if n_terminal == 1 else "states"
    text = (
        f"{mdp!r}\nexpected rewards r(s, a) {mdp.rewards.min():g} to"
        f" {mdp.rewards.max():g}, {n_terminal} {states} in which an episode is over"
    )
    if "metadata" in arrays:
        with _files.parts_of(file, "a Discretization"):
            facts = dict(json.loads(str(arrays["metadata"])))
        words = ", ".join(f"{name} {value}" for name, value in facts.items())
        text += f"\nmade from a continuous task: {words}"
    return text


def _describe_array(name: str, array: Any) -> str:
    """Describe an array of a file by its type and shape; say if it is a policy."""
    has_policy_shape = array.ndim == 2 and array.dtype.kind == "f"
    if has_policy_shape and bool((abs(array.sum(axis=1) - 1) < 1e-8).all()):
        n_states, n_actions = array.shape
        what = f"policy of {n_states} states and {n_actions} actions"
    else:
        what = "array"
    return f"{what} ({name!r}): {array.dtype} of shape {array.shape}"


def _require_another_file(output: Path, log: list[str]) -> None:
    """Raise an ArgumentError where the counts would replace the log they are made of."""
    for file in log:
        if output.exists() and os.path.exists(file) and output.samefile(file):
            raise ArgumentError(
                "--output",
                f"must be another file than the log, which it would replace; it is"
                f" {str(output)!r}",
            )
