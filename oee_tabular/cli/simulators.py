"""Simulators and policies from words and files.

Those that ``tasks.named_task`` knows, and ``MODULE:OBJECT`` or ``MODULE:ENV-ID`` of one's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.tasks import NamedTask


SIMULATOR_HELP = (
    "gridworld:10,slip=0.3 | a Gymnasium id with arguments, FrozenLake-v1:map_name=8x8,success_rate=0.6 | "
    "an .npz of a FiniteMDP | your own, module:Class or module:function,key=value (a FiniteMDP, or a Gymnasium environment "
    "with a table P), module:EnvId-v0 | a continuous task, cartpole:gravity=10, or a Gymnasium id with physics, "
    "Pendulum-v1:g=9 or module:EnvId-v0:key=value"
)
_SAMPLED = (
    "has no table P, so that it can only be sampled: oee export {} --samples-per-pair 100 --output simulator.npz writes it "
    "by its frequencies"
)


def task_of(spec: str, discount: float | None, initial: str | None = None, samples: int | None = None) -> NamedTask:
    """The task that ``spec`` names, with another discount or first state; ``samples`` of each (s, a) where it is stepped."""
    from oee_tabular import _progress
    from oee_tabular.tasks import named_task

    _progress.report_step(f"reading the simulator {spec}")
    if is_own(spec):
        task = _own_task(spec, 0.99 if discount is None else discount, samples)
        task = (
            task if discount is None else replace(task, mdp=task.mdp.with_discount(discount))
        )  # a FiniteMDP's own else
    elif samples is not None:
        task = _task(_environment(spec), spec, 0.99 if discount is None else discount, samples)
    else:
        task = named_task(spec, discount=discount)
    return task if initial is None else replace(task, mdp=task.mdp.with_initial(_state(initial)))


def is_own(spec: str) -> bool:
    """Whether ``spec`` is MODULE:OBJECT or MODULE:ENV-ID: words on both sides of the colon, the first a module's name."""
    from oee_tabular.tasks.arguments import arguments

    module, colon, rest = spec.partition(":")
    if not colon or module == "gridworld" or not all(part.isidentifier() for part in module.split(".")):
        return False
    from oee_tabular.continuous.names import CONTINUOUS

    if module in CONTINUOUS:
        return False
    first = rest.split(",")[0]
    return bool(first) and "=" not in first and isinstance(arguments(first)[0][0], str)


def _environment(spec: str) -> Callable[[], Any]:
    """A function that makes the Gymnasium environment of "Id-v0:key=value"."""
    from oee_tabular.tasks.arguments import arguments
    from oee_tabular.tasks.toy_text import make_environment

    name, _, rest = spec.partition(":")
    return partial(make_environment, name, **arguments(rest)[1])


def _own_task(spec: str, discount: float, samples: int | None) -> NamedTask:
    from oee_tabular.tasks.arguments import arguments
    from oee_tabular.tasks.toy_text import make_environment
    from oee_tabular.testing.command import own_module, own_modules, own_object

    module, _, rest = spec.partition(":")
    (name, *positional), keywords = arguments(rest)
    with own_modules():
        if all(part.isidentifier() for part in name.split(".")):
            found = own_object(f"{module}:{name}", "the simulator", "my_package.mine:MySimulator")
            made = _called(found, spec, positional, keywords) if callable(found) else lambda: found
        else:
            own_module(module)  # which registers the environment
            made = partial(make_environment, name, **keywords)
        return _task(made, spec, discount, samples)


def _called(found: Callable[..., Any], spec: str, positional: list[Any], keywords: dict[str, Any]) -> Callable[[], Any]:
    def made() -> Any:
        try:
            return found(*positional, **keywords)
        except Exception as error:
            raise ValueError(f"simulator {spec!r} cannot be made; it raises {type(error).__name__}: {error}") from error

    return made


def _task(make: Callable[[], Any], spec: str, discount: float, samples: int | None) -> NamedTask:
    """Of what ``make`` makes: a FiniteMDP, or an environment, by its table or by being stepped."""
    from oee_tabular.exact import optimal_policy
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.tasks import NamedTask

    made = make()
    if isinstance(made, FiniteMDP):
        return NamedTask(spec, made, lambda: optimal_policy(made))
    _refuse_vectors(made, spec)
    if not hasattr(made, "step") or not hasattr(made, "reset"):
        raise ValueError(
            f"simulator {spec!r} must be a FiniteMDP or a Gymnasium environment, or a class or function that makes one; found "
            f"{type(made).__name__}"
        )
    if samples is not None:
        mdp = FiniteMDP.from_env(made, samples_per_pair=samples, seed=0, discount=discount)
    elif not hasattr(made.unwrapped, "P"):
        raise ValueError(f"simulator {spec!r} {_SAMPLED.format(spec)}")
    else:
        mdp = FiniteMDP.from_gymnasium(made, discount)
    return NamedTask(spec, mdp, lambda: optimal_policy(mdp), make)


def _refuse_vectors(made: object, spec: str) -> None:
    """An error with the way that takes it, where states are vectors."""
    from oee_tabular.continuous.task import ContinuousTask

    if isinstance(made, ContinuousTask):
        raise ValueError(
            f"simulator {spec!r} is a ContinuousTask, which Python takes: "
            "tasks.evaluate_continuous(task, log, policies, horizon=...); a command takes a registered MODULE:EnvId-v0"
        )
    space = getattr(made, "observation_space", None)
    if space is not None and not hasattr(space, "n") and getattr(space, "shape", None):
        raise ValueError(
            f"simulator {spec!r} has states that are vectors: register the environment (gymnasium.register) and name it by "
            f"its id, {spec.partition(':')[0]}:EnvId-v0"
        )


def _state(text: str) -> int | str:
    """--initial: a number, or a name, which never reads as one."""
    return int(text) if text.strip().lstrip("-").isdigit() else text


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
    from oee_tabular.data.reader import csv_frame
    from oee_tabular.exact import optimal_policy
    from oee_tabular.mdp import check_policy, mix, uniform_policy
    from oee_tabular.mdp.policies import read_policy_array

    _progress.report_step(f"reading the policy {spec}")
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
        return check_policy(_policy_by_state(csv_frame(spec), task.mdp, repr(spec)), task.mdp, name=f"{name} {spec!r}")
    return check_policy(read_policy_array(spec, name), task.mdp, name=f"{name} {spec!r}")


def _policy_by_state(frame: Any, mdp: FiniteMDP, name: str) -> dict[Any, Any]:
    """The mapping of a table with the columns state, action (and probability), or state and one for each action."""
    from oee_tabular.mdp.naming import numbers_of

    labels, known = list(frame.columns), numbers_of(mdp.action_names or ())
    actions = {label: int(label) if label.isdigit() else label for label in labels if label != "state"}
    is_wide = all(action in known or action in range(mdp.n_actions) for action in actions.values())
    if "state" not in labels or not actions or not ("action" in labels or is_wide) or len(frame) == 0:
        raise ValueError(
            f"{name} must have the columns state and action, with probability or without, or state and one for each action, "
            f"and at least one row; it has {', '.join(labels)} and {len(frame)} rows"
        )
    policy: dict[Any, Any] = {}
    for row in frame.to_dict("records"):
        state = row["state"]
        if "action" in labels and "probability" in labels:
            choice = policy.setdefault(state, {})
            if row["action"] in choice:
                raise ValueError(
                    f"{name} must have each state's action once; state {state}, action {row['action']} is there twice"
                )
            choice[row["action"]] = _number(row["probability"], name)
        elif state in policy:
            raise ValueError(f"{name} must have a row for each state; state {state} has two")
        elif "action" in labels:
            policy[state] = row["action"]
        else:
            policy[state] = {action: _number(row[label], name) for label, action in actions.items()}
    return policy


def _number(value: Any, name: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must have numbers as probabilities; it has {value!r}") from None


def _meant(spec: str) -> str:
    import difflib

    close = difflib.get_close_matches(spec.lower(), ["uniform", "optimal", "expert", "mix:0.5"], n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def policies_of(specs: list[str] | None, task: NamedTask) -> dict[str, Any]:
    """Policies from NAME=SPEC or SPEC; optimal where there are none."""
    from oee_tabular.tasks.arguments import named_specs

    return {name: policy_of(spec, task, "--policy") for name, spec in named_specs(specs or ["optimal"]).items()}
