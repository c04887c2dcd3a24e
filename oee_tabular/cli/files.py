"""The commands of files: record a log, count it, write a policy or a simulator, say
what a file holds.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import oee_tabular as oee  # whose rooms are imported on use
from oee_tabular import _files
from oee_tabular._checks import positive_integer
from oee_tabular.cli.inputs import describe_new, policy_of, task_of, write_array
from oee_tabular.cli.options import Options, answer, with_options
from oee_tabular.continuous.command import is_continuous, record_log, task_options


@with_options("""
Input:
environment! SIM  {SIMULATOR}.
--policy=uniform SPEC  {POLICY}.
--transitions N  How many transitions to record.
--episodes N  How many episodes to record.
--horizon T  Longest episode; none: 1000, or Gymnasium's or the continuous task's own limit.
--initial
--task-option* NAME=VALUE  Of a Gymnasium environment with continuous states, repeatable. state=MODULE:GET,SET: functions
    get(env) and set(env, state), where its state is not found. actions=9 or -2,0,2: levels of each coordinate of a Box of
    actions, or the commands.
Value:
--discount --seed
Output:
--output! FILE  The log: .npz, .csv, .parquet, or a new Minari folder.
--overwrite
--json  Print JSON instead, with version, file, transitions, episodes.
""")
def sample(options: Options) -> None:
    """Record a log.

    A Gymnasium environment is stepped through its own step(); a continuous task gives
    continuous states. States and actions stand there by name where the simulator has
    names; a Minari folder has numbers.
    """
    if (options.transitions is None) == (options.episodes is None):
        raise ValueError("one of --transitions and --episodes must be given")
    for name in ("transitions", "episodes", "horizon"):
        if getattr(options, name) is not None:
            positive_integer(getattr(options, name), f"--{name}")
    _files.new_file(options.output, "--output", overwrite=options.overwrite)
    settings = task_options(options.task_option, ("state", "actions"))
    limits = {
        "n_transitions": options.transitions,
        "n_episodes": options.episodes,
        "seed": options.seed,
    }
    if is_continuous(options.environment):
        log = record_log(
            options.environment,
            options.policy,
            settings,
            max_steps=options.horizon,
            **limits,
        )
        text = repr(log)
    else:
        log = _record(options, settings, limits)
        text = log.describe()
    log.save(options.output)
    record = {
        "file": str(options.output),
        "transitions": len(log),
        "episodes": log.n_episodes,
    }
    answer(f"{options.output}: {text}", record, options.json)


def _record(options: Options, settings: object, limits: dict[str, Any]) -> Any:
    """Record a log of numbered states, with their names where the file can hold them."""
    from oee_tabular.simulate.sampler import episodes_holding

    task = task_of(options.environment, options.discount, options.initial)
    if settings:
        raise ValueError(
            "--task-option needs a continuous task (--simulator cartpole:gravity=10)"
        )
    policy = policy_of(options.policy, task, "policy")
    mdp = task.mdp
    steps = options.horizon or 1000
    # which reset() does not take
    if task.environment is not None and options.initial is None:
        environment = task.environment()
        log = oee.record_episodes(environment, policy, max_steps=steps, **limits)
        environment.close()
    elif options.episodes is not None:
        log = oee.sample_episodes(
            mdp, policy, options.episodes, steps, seed=options.seed
        )
    else:
        n = options.transitions
        log = episodes_holding(mdp, policy, n, steps, seed=options.seed).first(n)
    if options.output.suffix == "":  # a Minari data set holds numbers
        return log
    return oee.Transitions(
        **log.columns(), state_names=mdp.state_names, action_names=mdp.action_names
    )


@with_options("""
Input:
simulator! SIM  {SIMULATOR}.
spec! SPEC  {POLICY}.
Value:
--discount
Output:
--output! FILE  The policy: .npy, an (S, A) array.
--json  Print JSON instead, with version, file, states, actions.
""")
def policy(options: Options) -> None:
    """Write a policy of a simulator to a file."""
    table = policy_of(
        options.spec, task_of(options.simulator, options.discount), "policy"
    )
    n_states, n_actions = table.shape
    text = (
        f"{describe_new(options.output)}: policy of {n_states} states and {n_actions}"
        " actions"
    )
    write_array(options.output, table)
    answer(
        text,
        {"file": str(options.output), "states": n_states, "actions": n_actions},
        options.json,
    )


@with_options("""
Input:
simulator! SIM  {SIMULATOR}.
--initial --action-noise
--samples-per-pair N  Step an environment until each state-action pair that it met has so many samples; its frequencies.
Value:
--discount
Output:
--output! FILE  The FiniteMDP: .npz.
--json  Print JSON instead, with version, file, states, actions, transitions, discount.
""")
def export(options: Options) -> None:
    """Write a simulator to a file.

    Of a continuous task it is the finite MDP, with the cells and what they were made
    from.
    """
    noise = options.action_noise
    initial = options.initial
    output = options.output
    task = task_of(
        options.simulator, options.discount, initial, options.samples_per_pair
    )
    mdp = task.mdp.with_action_noise(noise) if noise else task.mdp
    saved = (
        mdp
        if noise or initial is not None or task.discretization is None
        else task.discretization
    )
    text = f"{describe_new(output)}: {saved!r}"
    saved.save(output)
    sizes = {
        "states": mdp.n_states,
        "actions": mdp.n_actions,
        "transitions": mdp.transitions.nnz,
    }
    answer(text, {"file": str(output), "discount": mdp.discount} | sizes, options.json)


@with_options("""
Input:
log*! FILE...  Files (.parquet, .csv, .npz), folders of them, or patterns, of one log.
--simulator SIM  Whose states and actions there are, by number or name; others are bad rows. As in evaluate.
--bad-rows=refuse refuse|drop  Rows that are none of a log: refuse the first, or drop and count them.
--kept-moves=200000 N  Transitions of whole episodes to keep for importance sampling, drawn uniformly.
Value:
--jobs --dask
Output:
--output! FILE  The counts: .npz, for --log of evaluate and plan.
--overwrite
--json  Print JSON instead, with version, file, moves, dropped.
""")
def counts(options: Options) -> None:
    """Count the transitions of a log of any size.

    The file appears when all are counted.
    """
    _files.new_file(options.output, "--output", overwrite=options.overwrite)
    asked = {
        name: getattr(options, name)
        for name in ("bad_rows", "kept_moves", "output", "jobs", "dask")
    }
    simulator = None if options.simulator is None else task_of(options.simulator).mdp
    counted = oee.Transitions.open(
        options.log, simulator=simulator, progress=sys.stderr.isatty(), **asked
    )
    reasons = counted.recording.reasons
    text = "\n".join(
        [
            f"{options.output}: {counted.describe()}",
            *(f"dropped: {reason}" for reason in reasons),
        ]
    )
    record = {
        "file": str(options.output),
        "moves": counted.summary()["transitions"],
        "dropped": reasons,
    }
    answer(text, record, options.json)


@with_options("""
Input:
file*! FILE...  A FiniteMDP, a log (several files, a pattern or a folder too), a policy or a report.
Output:
--json  Print JSON instead, with version, file, kind, text.
""")
def info(options: Options) -> None:
    """Describe the contents of a file."""
    kind, text = describe_files(options.file)
    answer(
        text,
        {"file": ", ".join(options.file), "kind": kind, "text": text.split("\n")},
        options.json,
    )


def describe_files(files: list[str]) -> tuple[str, str]:
    """Say what kind of thing a file, a data set or the files of a log hold, and what it
    is in words.
    """
    from oee_tabular.continuous.log import holds_states

    file = files[0]
    path = Path(_files.local(files[0]))
    if (path / "report.json").is_file():
        path = path / "report.json"
    if path.suffix.lower() == ".json":
        from oee_tabular.report.files import summary

        return "report", summary(path)
    is_pattern = not path.exists() and bool(set("*?[") & set(file))
    has_parts = path.is_dir() and any(
        part.suffix in (".csv", ".parquet", ".npz") for part in path.iterdir()
    )
    is_single = len(files) == 1 and not is_pattern and not has_parts
    if is_single and holds_states(file):
        return "continuous_transitions", _describe_states(
            oee.ContinuousTransitions.load(file)
        )
    if not is_single or path.suffix.lower() not in (".npz", ".npy"):
        return "transitions", repr(oee.Transitions.load(files))
    arrays = _files.read_npz(file)
    kind = _files.npz_kind(arrays)
    if kind == "transitions":
        return kind, repr(oee.Transitions.load(file))
    if kind == "transition_counts":
        counted = oee.TransitionCounts.load(file)
        return kind, "\n".join(
            [
                repr(counted),
                *(f"dropped: {reason}" for reason in counted.recording.reasons),
            ]
        )
    if kind == "finite_mdp":
        return kind, _describe_mdp(oee.FiniteMDP.load(file), file, arrays)
    return "arrays", "\n".join(
        _describe_array(name, array) for name, array in arrays.items()
    )


def _describe_states(log: Any) -> str:
    lines = [repr(log)]
    for name in ("state", "next_state"):
        columns = enumerate(getattr(log, name).T)
        lines.append(
            f"{name}:"
            f" {', '.join(f'_{k} {column.min():.4g} to {column.max():.4g}' for k, column in columns)}"
        )
    return "\n".join(
        lines
        + ["with behaviour probabilities"] * (log.behavior_probability is not None)
    )


def _describe_mdp(mdp: Any, file: str, arrays: dict[str, Any]) -> str:
    n_over = int(mdp.absorbing().sum())
    text = (
        f"{mdp!r}\nexpected rewards r(s, a) {mdp.rewards.min():g} to"
        f" {mdp.rewards.max():g}, "
    )
    text += f"{n_over} state{'s' * (n_over != 1)} in which an episode is over"
    if "metadata" in arrays:
        with _files.parts_of(file, "a Discretization"):
            facts = dict(json.loads(str(arrays["metadata"])))
        text += "\nmade from a continuous task: " + ", ".join(
            f"{name} {value}" for name, value in facts.items()
        )
    return text


def _describe_array(name: str, array: Any) -> str:
    is_policy = (
        array.ndim == 2
        and array.dtype.kind == "f"
        and bool((abs(array.sum(axis=1) - 1) < 1e-8).all())
    )
    what = (
        f"policy of {array.shape[0]} states and {array.shape[1]} actions"
        if is_policy
        else "array"
    )
    return f"{what} ({name!r}): {array.dtype} of shape {array.shape}"
