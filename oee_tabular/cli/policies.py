"""Policies from words and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.tasks import NamedTask

POLICY_HELP = (
    ".npy or .npz of an (S, A) array or of (S,) actions | .csv with columns state, action (and probability), or state and "
    "one for each action | MODULE:FUNCTION of a state | uniform | optimal | expert | mix:0.5 (half expert, half uniform); "
    "optimal and expert are the simulator's; expert is optimal where a task has none of its own; a continuous task has "
    "expert, uniform and mix, arrays of its cells, and MODULE:FUNCTION of its states"
)
_FORMS = "uniform, optimal, expert, mix:WEIGHT, MODULE:FUNCTION, or a .npy, .npz or .csv file"


def policy_of(spec: str, task: NamedTask, name: str) -> Array:
    """The policy that ``spec`` names, in the MDP of ``task``."""
    from oee_tabular import _progress
    from oee_tabular.cli.simulators import is_own
    from oee_tabular.data.tables import csv_frame
    from oee_tabular.exact import optimal_policy
    from oee_tabular.mdp import check_policy, mix, uniform_policy
    from oee_tabular.mdp.policies import policy_array
    from oee_tabular.mdp.policy_forms import by_state

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
    if suffix not in (".npy", ".npz", ".csv") and is_own(spec):
        from oee_tabular.testing.command import own_modules, own_object

        with own_modules():
            return check_policy(own_object(spec, name, "my_package.mine:policy"), task.mdp, name=f"{name} {spec!r}")
    if suffix not in (".npy", ".npz", ".csv"):
        raise ValueError(f"{name} must be {_FORMS}; got {spec!r}{_meant(spec)}")
    if suffix == ".csv":
        return check_policy(by_state(csv_frame(spec), task.mdp, repr(spec)), task.mdp, name=f"{name} {spec!r}")
    return check_policy(policy_array(spec, name), task.mdp, name=f"{name} {spec!r}")


def _meant(spec: str) -> str:
    import difflib

    close = difflib.get_close_matches(spec.lower(), ["uniform", "optimal", "expert", "mix:0.5"], n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def policies_of(specs: list[str] | None, task: NamedTask) -> dict[str, Any]:
    """Policies from NAME=SPEC or SPEC; optimal where there are none."""
    from oee_tabular.tasks.arguments import named_specs

    return {name: policy_of(spec, task, "--policy") for name, spec in named_specs(specs or ["optimal"]).items()}
