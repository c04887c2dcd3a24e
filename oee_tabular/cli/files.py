"""The commands of files: record a log, count it, write a policy or a simulator, say what a file holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from oee_tabular import _files
from oee_tabular.cli.inputs import write_array
from oee_tabular.cli.options import answer, with_options
from oee_tabular.cli.simulators import policy_of, task_of
from oee_tabular.continuous.command import is_continuous, record_log, task_options


@with_options("""
Input:
environment SIM  {SIMULATOR}.
--policy SPEC  {POLICY}.
--transitions N  How many transitions to record.
--episodes N  How many episodes to record.
--horizon T  Longest episode; none: 1000, or Gymnasium's or the continuous task's own limit.
--task-option NAME=VALUE  Of a Gymnasium environment with continuous states, repeatable. state=MODULE:GET,SET: functions
    get(env) and set(env, state), where its state is not found. actions=9 or -2,0,2: levels of each coordinate of a Box of
    actions, or the commands.
Output:
--output FILE  The log: .npz, .csv, .parquet, or a new Minari folder.
--json  Print JSON instead, with version, file, transitions, episodes.
""")
def sample(
    environment: str,
    output: Path,
    policy: str = "uniform",
    transitions: int | None = None,
    episodes: int | None = None,
    horizon: int | None = None,
    discount: float | None = None,
    initial: str | None = None,
    task_option: list[str] | None = None,
    overwrite: bool = False,
    seed: int = 0,
    json: bool = False,
) -> None:
    """Record a log.

    A Gymnasium environment is stepped through its own step(); a continuous task gives continuous states. States and actions
    stand there by name where the simulator has names; a Minari folder has numbers.
    """
    from oee_tabular._checks import positive_integer
    from oee_tabular.data import Transitions
    from oee_tabular.simulate import sample_episodes
    from oee_tabular.simulate.logs import episodes_holding
    from oee_tabular.tasks import record_episodes

    if (transitions is None) == (episodes is None):
        raise ValueError("one of --transitions and --episodes must be given")
    for name, number in (("--transitions", transitions), ("--episodes", episodes), ("--horizon", horizon)):
        if number is not None:
            positive_integer(number, name)
    _files.new_file(output, "--output", overwrite=overwrite)
    options = task_options(task_option, ("state", "actions"))
    limits: Any = {"n_transitions": transitions, "n_episodes": episodes, "max_steps": horizon, "seed": seed}
    log: Any
    if is_continuous(environment):
        log = record_log(environment, policy, options, **limits)
        text = repr(log)
    else:
        task = task_of(environment, discount, initial)
        if options:
            raise ValueError("--task-option needs a continuous task (--simulator cartpole:gravity=10)")
        pi, mdp, steps, wanted = policy_of(policy, task, "policy"), task.mdp, horizon or 1000, transitions or 0
        if task.environment is not None and initial is None:  # which reset() does not take
            env = task.environment()
            log = record_episodes(env, pi, **limits | {"max_steps": steps})
            env.close()
        elif episodes is not None:
            log = sample_episodes(mdp, pi, episodes, steps, seed=seed)
        else:
            log = episodes_holding(mdp, pi, wanted, steps, seed=seed).first(wanted)
        if output.suffix != "":  # a Minari data set holds numbers
            log = Transitions(**log.columns(), state_names=mdp.state_names, action_names=mdp.action_names)
        text = log.describe()
    log.save(output)
    record = {"file": str(output), "transitions": len(log), "episodes": log.n_episodes}
    answer(f"{output}: {text}", record, json)


@with_options("""
Input:
simulator SIM  {SIMULATOR}.
spec SPEC  {POLICY}.
Output:
--output FILE  The policy: .npy, an (S, A) array.
--json  Print JSON instead, with version, file, states, actions.
""")
def policy(simulator: str, spec: str, output: Path, discount: float | None = None, json: bool = False) -> None:
    """Write a policy of a simulator to a file."""
    pi = policy_of(spec, task_of(simulator, discount), "policy")
    name = _name_of(output)
    write_array(output, pi)
    n_states, n_actions = pi.shape
    record = {"file": str(output), "states": n_states, "actions": n_actions}
    answer(f"{name}: policy of {n_states} states and {n_actions} actions", record, json)


@with_options("""
Input:
simulator SIM  {SIMULATOR}.
--samples-per-pair N  Step an environment until each state-action pair that it met has so many samples; its frequencies.
Output:
--output FILE  The FiniteMDP: .npz.
--json  Print JSON instead, with version, file, states, actions, transitions, discount.
""")
def export(
    simulator: str,
    output: Path,
    discount: float | None = None,
    initial: str | None = None,
    action_noise: float = 0.0,
    samples_per_pair: int | None = None,
    json: bool = False,
) -> None:
    """Write a simulator to a file.

    Of a continuous task it is the finite MDP, with the cells and what they were made from.
    """
    task = task_of(simulator, discount, initial, samples_per_pair)
    mdp = task.mdp.with_action_noise(action_noise) if action_noise else task.mdp
    saved = mdp if action_noise or initial is not None or task.discretization is None else task.discretization
    name = _name_of(output)
    saved.save(output)
    sizes = {"states": mdp.n_states, "actions": mdp.n_actions, "transitions": mdp.transitions.nnz}
    answer(f"{name}: {saved!r}", {"file": str(output), "discount": mdp.discount} | sizes, json)


@with_options("""
Input:
log FILE...  Files (.parquet, .csv, .npz), folders of them, or patterns, of one log.
--simulator SIM  Whose states and actions there are, by number or name; others are bad rows. As in evaluate.
--bad-rows refuse|drop  Rows that are none of a log: refuse the first, or drop and count them.
--kept-moves N  Transitions of whole episodes to keep for importance sampling, drawn uniformly.
Output:
--output FILE  The counts: .npz, for --log of evaluate and plan.
--json  Print JSON instead, with version, file, moves, dropped.
""")
def counts(
    log: list[str],
    output: Path,
    simulator: str | None = None,
    bad_rows: str = "refuse",
    kept_moves: int = 200_000,
    jobs: int = 1,
    dask: str | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Count the transitions of a log of any size.

    The file appears when all are counted.
    """
    import sys

    from oee_tabular.data import Transitions

    _files.new_file(output, "--output", overwrite=overwrite)
    found = Transitions.open(
        log, simulator=None if simulator is None else task_of(simulator).mdp, bad_rows=bad_rows, kept_moves=kept_moves,
        output=output, jobs=jobs, dask=dask, progress=sys.stderr.isatty(),
    )  # fmt: skip
    reasons = found.recording.reasons
    text = "\n".join([f"{output}: {found.describe()}", *(f"dropped: {reason}" for reason in reasons)])
    answer(text, {"file": str(output), "moves": found.summary()["transitions"], "dropped": reasons}, json)


@with_options("""
Input:
file FILE...  A FiniteMDP, a log (several files, a pattern or a folder too), a policy or a report.
Output:
--json  Print JSON instead, with version, file, kind, text.
""")
def info(file: list[str], json: bool = False) -> None:
    """Say what a file holds."""
    from oee_tabular.data import Transitions

    path = Path(file[0])
    is_pattern = not path.exists() and any(mark in file[0] for mark in "*?[")
    has_parts = path.is_dir() and any(part.suffix in (".csv", ".parquet", ".npz") for part in path.iterdir())
    if len(file) > 1 or is_pattern or (has_parts and not (path / "report.json").is_file()):
        kind, text = "transitions", repr(Transitions.load(file))
    else:
        kind, text = described(file[0])
    answer(text, {"file": ", ".join(file), "kind": kind, "text": text.split("\n")}, json)


def described(file: str) -> tuple[str, str]:
    """What kind of thing a file or data set holds, and what it is in words."""
    import json

    from oee_tabular.continuous.log import ContinuousTransitions, holds_states
    from oee_tabular.data import TransitionCounts, Transitions
    from oee_tabular.mdp import FiniteMDP

    path = Path(_files.local(file))
    if path.is_dir() and (path / "report.json").is_file():
        path = path / "report.json"
    if path.suffix.lower() == ".json":
        from oee_tabular.report.files import summary

        return "report", summary(path)
    if holds_states(file):
        states = ContinuousTransitions.load(file)
        lines = [repr(states)]
        for name in ("state", "next_state"):
            values = getattr(states, name)
            ranges = [f"_{k} {column.min():.4g} to {column.max():.4g}" for k, column in enumerate(values.T)]
            lines.append(f"{name}: {', '.join(ranges)}")
        has_probabilities = states.behavior_probability is not None
        return "continuous_transitions", "\n".join(lines + ["with behaviour probabilities"] * has_probabilities)
    if path.suffix.lower() not in (".npz", ".npy"):
        return "transitions", repr(Transitions.load(file))
    arrays = _files.read_npz(file)
    kind = _files.npz_kind(arrays)
    if kind == "transitions":
        return kind, repr(Transitions.load(file))
    if kind == "transition_counts":
        counted = TransitionCounts.load(file)
        return kind, "\n".join([repr(counted), *(f"dropped: {reason}" for reason in counted.recording.reasons)])
    if kind == "finite_mdp":
        mdp = FiniteMDP.load(file)
        over = int(mdp.absorbing().sum())
        text = f"{mdp!r}\nexpected rewards r(s, a) {mdp.rewards.min():g} to {mdp.rewards.max():g}, "
        text += f"{over} state{'s' * (over != 1)} in which an episode is over"
        if "metadata" in arrays:
            with _files.parts_of(file, "a Discretization"):
                facts = dict(json.loads(str(arrays["metadata"])))
            text += "\nmade from a continuous task: " + ", ".join(f"{name} {value}" for name, value in facts.items())
        return kind, text
    return "arrays", "\n".join(_describe_array(name, array) for name, array in arrays.items())


def _describe_array(name: str, array: Any) -> str:
    is_policy = array.ndim == 2 and array.dtype.kind == "f" and bool((abs(array.sum(axis=1) - 1) < 1e-8).all())
    what = f"policy of {array.shape[0]} states and {array.shape[1]} actions" if is_policy else "array"
    return f"{what} ({name!r}): {array.dtype} of shape {array.shape}"


def _name_of(output: Path) -> str:
    """The file's name, and whether something stands there that will be replaced."""
    return f"{output}{' (replaced)' if output.exists() else ''}"
