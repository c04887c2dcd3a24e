"""The commands of files: record a log, count it, write a policy or a simulator, say what a file holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from oee_tabular import _files
from oee_tabular.cli.inputs import recorded, refuse_settings, write_array
from oee_tabular.cli.options import (
    INPUT,
    OUTPUT,
    Actions,
    Dask,
    Discount,
    Initial,
    Jobs,
    Noise,
    Overwrite,
    Seed,
    Simulator,
    State,
    answer,
    json_option,
    option,
)
from oee_tabular.cli.simulators import POLICY_HELP, policy_of, task_of
from oee_tabular.continuous.command import is_continuous, recorded_states

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.continuous.log import ContinuousTransitions


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
    state: State = None,
    actions: Actions = None,
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
        refuse_settings(environment, {name: value for name, value in (("state", state), ("actions", actions)) if value})
        by_name = output.suffix != ""  # a Minari data set holds numbers
        log = recorded(environment, policy, transitions, episodes, horizon, discount, initial, seed, by_name=by_name)
        log.save(output)
        size, number, text = len(log), log.n_episodes, f"{output}: {log.describe()}"
    answer("sample", text, {"file": str(output), "transitions": size, "episodes": number}, json)


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
    """Count the transitions of a log of any size. The file appears when all are counted."""
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


def info(
    file: Annotated[
        list[str],
        typer.Argument(help="A FiniteMDP, a log (several files, a pattern or a folder too), a policy or a report."),
    ],
    json: Annotated[bool, json_option("info")] = False,
) -> None:
    """Say what a file holds."""
    from oee_tabular.data import Transitions

    kind, text = ("transitions", repr(Transitions.load(file))) if _are_logs(file) else described(file[0])
    answer("info", text, {"file": ", ".join(file), "kind": kind, "text": text.split("\n")}, json)


def _are_logs(files: list[str]) -> bool:
    """Whether these are several files of one log: by name, by a pattern, or in a folder."""
    path = Path(files[0])
    is_pattern = not path.exists() and any(mark in files[0] for mark in "*?[")
    in_folder = path.is_dir() and any(file.suffix in (".csv", ".parquet", ".npz") for file in path.iterdir())
    return len(files) > 1 or is_pattern or (in_folder and not (path / "report.json").is_file())


def described(file: str) -> tuple[str, str]:
    """What kind of thing a file or data set holds, and what it is in words."""
    from oee_tabular.continuous.log import ContinuousTransitions, holds_states
    from oee_tabular.data import TransitionCounts, Transitions

    path = Path(_files.local(file))
    if path.is_dir() and (path / "report.json").is_file():
        path = path / "report.json"
    if path.suffix.lower() == ".json":
        from oee_tabular.report.files import summary

        return "report", summary(path)
    if holds_states(file):
        return "continuous_transitions", _states(ContinuousTransitions.load(file))
    if path.suffix.lower() not in (".npz", ".npy"):
        return "transitions", repr(Transitions.load(file))
    arrays = _files.read_npz(file)
    kind = _files.npz_kind(arrays)
    if kind == "finite_mdp":
        return kind, _mdp(file, arrays)
    if kind == "transitions":
        return kind, repr(Transitions.load(file))
    if kind == "transition_counts":
        counted = TransitionCounts.load(file)
        return kind, "\n".join([repr(counted), *(f"dropped: {reason}" for reason in counted.recording.reasons)])
    return "arrays", "\n".join(_array(name, array) for name, array in arrays.items())


def _states(log: ContinuousTransitions) -> str:
    lines = [repr(log)]
    for name in ("state", "next_state"):
        values: Array = getattr(log, name)
        ranges = zip(values.min(axis=0), values.max(axis=0), strict=True)
        lines.append(f"{name}: " + ", ".join(f"_{k} {low:.4g} to {high:.4g}" for k, (low, high) in enumerate(ranges)))
    if log.behavior_probability is not None:
        lines.append("with behaviour probabilities")
    return "\n".join(lines)


def _mdp(file: str, arrays: dict[str, Any]) -> str:
    import json

    from oee_tabular.mdp import FiniteMDP

    mdp = FiniteMDP.load(file)
    over = int(mdp.absorbing().sum())
    text = f"{mdp!r}\nexpected rewards r(s, a) {mdp.rewards.min():g} to {mdp.rewards.max():g}, "
    text += f"{over} state{'s' * (over != 1)} in which an episode is over"
    if "metadata" in arrays:
        with _files.parts_of(file, "a Discretization"):
            facts = dict(json.loads(str(arrays["metadata"])))
        text += "\nmade from a continuous task: " + ", ".join(f"{name} {value}" for name, value in facts.items())
    return text


def _array(name: str, array: Any) -> str:
    policy_like = array.ndim == 2 and array.dtype.kind == "f" and bool((abs(array.sum(axis=1) - 1) < 1e-8).all())
    what = f"policy of {array.shape[0]} states and {array.shape[1]} actions" if policy_like else "array"
    return f"{what} ({name!r}): {array.dtype} of shape {array.shape}"
