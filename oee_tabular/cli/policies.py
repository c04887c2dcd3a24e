"""Policies from words and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular.tasks.arguments import named_specs

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.tasks import NamedTask

POLICY_HELP = (
    ".npy or .npz of an (S, A) array or of (S,) actions | .csv with columns state, action (and probability), or state and "
    "one for each action | uniform | optimal | expert | mix:0.5 (half expert, half uniform); optimal and expert are the "
    "simulator's; expert is optimal where a task has none of its own; a continuous task has expert, uniform and mix, and "
    "arrays of its cells"
)
_FORMS = "uniform, optimal, expert, mix:WEIGHT, or a .npy, .npz or .csv file"


def policy_of(spec: str, task: NamedTask, name: str) -> Array:
    """The policy that ``spec`` names, in the MDP of ``task``."""
    from oee_tabular import _progress
    from oee_tabular.exact import optimal_policy
    from oee_tabular.mdp import check_policy, mix, uniform_policy
    from oee_tabular.mdp.policies import policy_array

    _progress.doing(f"reading the policy {spec}")
    if spec == "uniform":
        return uniform_policy(task.mdp)
    if spec == "optimal":
        return optimal_policy(task.mdp)
    if spec == "expert":
        return check_policy(task.expert(), task.mdp)
    if spec.startswith("mix:"):
        try:
            weight = float(spec.removeprefix("mix:"))
        except ValueError:
            raise ValueError(f"{name} must be like mix:0.5; got {spec!r}") from None
        return mix(check_policy(task.expert(), task.mdp), uniform_policy(task.mdp), weight)
    suffix = Path(spec).suffix.lower()
    if suffix not in (".npy", ".npz", ".csv"):
        raise ValueError(f"{name} must be {_FORMS}; got {spec!r}{_meant(spec)}")
    read = policy_by_state(spec, task) if suffix == ".csv" else policy_array(spec, name)
    return check_policy(read, task.mdp, name=f"{name} {spec!r}")


def _meant(spec: str) -> str:
    import difflib

    close = difflib.get_close_matches(spec.lower(), ["uniform", "optimal", "expert", "mix:0.5"], n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def policy_by_state(path: str, task: NamedTask) -> dict[Any, Any]:
    """State -> action -> probability of a CSV file, states and actions by name or number.

    Its columns are state and action, a row a state; these and probability, a row an action; or state and one column for each
    action.
    """
    from oee_tabular.data.tables import csv_frame

    frame = csv_frame(path)
    labels = [str(label) for label in frame.columns]
    known = "action" in labels or all(_is_action(label, task.mdp) for label in labels if label != "state")
    if "state" not in labels or len(labels) < 2 or not known or len(frame) == 0:
        raise ValueError(
            f"{path!r} must have the columns state and action, with probability or without, or state and one for each action, "
            f"and at least one row; it has {', '.join(labels)} and {len(frame)} rows"
        )
    table: dict[Any, Any] = {}
    if "action" not in labels:
        for row in frame.to_dict("records"):
            _once(table, row["state"], path)
            table[row["state"]] = {_item(label): _number(row[label], path) for label in labels if label != "state"}
        return table
    used = [label for label in ("state", "action", "probability") if label in labels]
    for state, action, *rest in frame[used].itertuples(index=False, name=None):
        if not rest:
            _once(table, state, path)
        chosen = table.setdefault(state, {})
        if action in chosen:
            raise ValueError(
                f"{path!r} must have every state and action once; state {state}, action {action} is there twice"
            )
        chosen[action] = _number(rest[0], path) if rest else 1.0
    return table


def _once(table: dict[Any, Any], state: Any, path: str) -> None:
    if state in table:
        raise ValueError(f"{path!r} must have a row for each state; state {state} has two")


def _item(label: str) -> int | str:
    """A column's action: a number, or a name."""
    return int(label) if label.isdigit() else label


def _is_action(label: str, mdp: FiniteMDP) -> bool:
    from oee_tabular.mdp.naming import numbers_of

    return label in numbers_of(mdp.action_names or ()) or (label.isdigit() and int(label) < mdp.n_actions)


def _number(value: Any, path: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise ValueError(f"{path!r} must have numbers as probabilities; it has {value!r}") from None


def policies_of(specs: list[str] | None, task: NamedTask) -> dict[str, Any]:
    """Policies from NAME=SPEC or SPEC; optimal where there are none."""
    return {name: policy_of(spec, task, "--policy") for name, spec in named_specs(specs or ["optimal"]).items()}
