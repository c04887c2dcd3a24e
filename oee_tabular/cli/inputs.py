"""What the command's words mean: a log, a problem, and what is known of the target, from specifications and files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular._arguments import literal
from oee_tabular.cli.options import Options
from oee_tabular.cli.simulators import policy_of, task_of

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.estimators import Problem
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.tasks import NamedTask


def refuse(options: Options, names: Iterable[str], rule: str) -> None:
    """Raise a ValueError for the first of these options that has another value than its default."""
    for name in names:
        value = getattr(options, name)
        if value not in (None, 0.0, "refuse", "simulator"):
            raise ValueError(f"--{name.replace('_', '-')} {rule.format(value)}")


def write_array(path: Path, array: Array) -> None:
    """A .npy file, which appears whole or not at all."""
    import io

    import numpy as np

    from oee_tabular import _files

    content = io.BytesIO()  # written to a file itself, an array loses the system's words for a full disk
    np.save(content, array, allow_pickle=False)
    with _files.whole_file(path, (".npy",)) as handle:
        handle.write(content.getbuffer())


def read_problem(options: Options) -> tuple[NamedTask, Problem]:
    """Read the simulator, and the problem with the log's files."""
    from oee_tabular import _progress
    from oee_tabular.data import Transitions, read_log
    from oee_tabular.estimators import Problem

    log, noise, impossible = options.log, options.action_noise, options.impossible
    task = task_of(options.simulator, options.discount, options.initial)
    if noise:
        task = replace(task, mdp=task.mdp.with_action_noise(noise))
    model = task.mdp
    epsilon: Any = literal(impossible[6:], "--impossible") if impossible.startswith("allow=") else None
    is_share = isinstance(epsilon, float) and 0.0 < epsilon < 1.0
    if not is_share and impossible not in ("refuse", "drop"):
        raise ValueError(
            f"--impossible must be refuse, drop, or allow=EPS with 0 < EPS < 1, allow=0.01; got {impossible!r}"
        )
    _progress.report_step(f"reading the log {', '.join(log)}")
    recorded = read_log(log[0] if len(log) == 1 else log, model)
    if is_share:
        is_log = isinstance(recorded, Transitions)
        model = model.with_support_of(recorded if is_log else recorded.counts(model.n_states, model.n_actions), epsilon)
        impossible = "refuse"
    more: dict[str, Any] = {"rewards": options.rewards} if hasattr(options, "rewards") else {}
    if getattr(options, "behavior", None) is not None:
        more["behavior_policy"] = policy_of(options.behavior, task, "--behavior")
    return task, Problem(model, recorded, horizon=options.horizon, impossible=impossible, **more)


def read_box(text: str | None) -> dict[str, float | None]:
    """The bounds of --box LOWER,UPPER, either left out."""
    if text is None:
        return {}
    try:
        lower, upper = (float(part) if part.strip() else None for part in text.split(","))
    except ValueError:
        lower = upper = float("nan")
    if not (0.0 if lower is None else lower) <= 1.0 <= (1.0 if upper is None else upper) or (lower or 0.0) < 0.0:
        raise ValueError(
            f"--box must be LOWER,UPPER, bounds on P_target / P with 0 <= LOWER <= 1 <= UPPER, as 0.5,2; got {text!r}"
        )
    return {"lower_ratio": lower, "upper_ratio": upper}


def read_entries(path: Path, name: str, simulator: FiniteMDP) -> tuple[Any, str]:
    """Features, or keys of a tie, on ``simulator.transitions.data``, and what they are.

    A .csv has a transition a row: columns state, action, next_state (numbers, or the simulator's names), and one for each
    feature, 0 in transitions that are not in the file, or one of keys. A .npy holds (entries,) or (S, A, S), features with a
    last axis more; what a dense one has where P is 0 is not looked at.
    """
    from oee_tabular import _files
    from oee_tabular.data.rules import MOVE
    from oee_tabular.data.tables import csv_frame
    from oee_tabular.mdp.rows import Rows
    from oee_tabular.ratio.features import feature_array
    from oee_tabular.ratio.ties import tie_keys

    is_table, file = path.suffix.lower() == ".csv", repr(str(path))
    if not is_table and path.suffix.lower() != ".npy":
        raise ValueError(f"--{name} must be a .npy or .csv file; got {file}")
    arrays: Any = {"array": csv_frame(str(path))} if is_table else _files.read_npz(path)
    if "array" not in arrays:
        raise ValueError(f"{file} must hold one array, as numpy.save writes it; it holds {', '.join(arrays)}")
    given = arrays["array"]
    try:
        if name == "tie":
            keys = tie_keys(given, Rows.of(simulator), simulator)
            return keys, f"{keys.max() + 1} keys"
        values = feature_array(given, simulator)
    except ValueError as error:
        raise ValueError(f"--{name} {file}: {error}") from error
    if is_table:
        return values, ", ".join(label for label in given if label not in MOVE)
    return values, ", ".join(f"feature {k}" for k in range(values.shape[1]))
