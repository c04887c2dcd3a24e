"""Simulators and policies from words and files: what ``tasks.named_task`` knows, and MODULE:OBJECT or MODULE:ENV-ID."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular._arguments import arguments, named_specs, own_module, own_modules, own_object

if TYPE_CHECKING:
    from oee_tabular._checks import Array
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.tasks import NamedTask


def task_of(
    spec: str, discount: float | None = None, initial: str | None = None, samples: int | None = None
) -> NamedTask:
    """The task that ``spec`` names, with another discount or first state; ``samples`` of each (s, a) where it is stepped."""
    from oee_tabular import _progress
    from oee_tabular.exact import optimal_policy
    from oee_tabular.mdp import FiniteMDP
    from oee_tabular.tasks import NamedTask, named_task

    _progress.report_step(f"reading the simulator {spec}")
    if is_own(spec) or samples is not None:
        with own_modules():
            make = _maker(spec)
            made = make()
            mdp = _as_mdp(made, spec, 0.99 if discount is None else discount, samples)
        if discount is not None and made is mdp:
            mdp = mdp.with_discount(discount)
        task = NamedTask(spec, mdp, lambda: optimal_policy(mdp), None if isinstance(made, FiniteMDP) else make)
    else:
        task = named_task(spec, discount=discount)
    if initial is None:
        return task
    start = int(initial) if initial.strip().lstrip("-").isdigit() else initial  # no name reads as a number
    return replace(task, mdp=task.mdp.with_initial(start))


def is_own(spec: str) -> bool:
    """Whether ``spec`` is MODULE:OBJECT or MODULE:ENV-ID: words on both sides of the colon, the first a module's name."""
    from oee_tabular.tasks.specs import FINITE

    module, colon, rest = spec.partition(":")
    if not colon or module in FINITE or not all(part.isidentifier() for part in module.split(".")):
        return False
    from oee_tabular.continuous.command import CONTINUOUS

    first = rest.split(",")[0]
    return module not in CONTINUOUS and bool(first) and "=" not in first and isinstance(arguments(first)[0][0], str)


def _maker(spec: str) -> Callable[[], Any]:
    """What makes the MDP or environment of "module:Object,key=value", "module:Id-v0,key=value" or "Id-v0:key=value"."""
    from oee_tabular.tasks.toy_text import make_environment

    module, _, rest = spec.partition(":")
    positional, keywords = arguments(rest)
    if not is_own(spec):
        return partial(make_environment, module, **keywords)
    name, *positional = positional
    if not all(part.isidentifier() for part in name.split(".")):
        own_module(module)  # which registers the environment
        return partial(make_environment, name, **keywords)
    made = own_object(f"{module}:{name}", "the simulator", "my_package.mine:MySimulator")

    def make() -> Any:
        try:
            return made(*positional, **keywords) if callable(made) else made
        except Exception as error:
            raise ValueError(f"simulator {spec!r} cannot be made; it raises {type(error).__name__}: {error}") from error

    return make


def _as_mdp(made: Any, spec: str, discount: float, samples: int | None) -> FiniteMDP:
    """A FiniteMDP itself; an environment by its table, or by being stepped."""
    from oee_tabular.continuous.task import ContinuousTask
    from oee_tabular.mdp import FiniteMDP

    if isinstance(made, FiniteMDP):
        return made
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
    if not hasattr(made, "step") or not hasattr(made, "reset"):
        raise ValueError(
            f"simulator {spec!r} must be a FiniteMDP or a Gymnasium environment, or a class or function that makes one; found "
            f"{type(made).__name__}"
        )
    if samples is not None:
        return FiniteMDP.from_env(made, samples_per_pair=samples, seed=0, discount=discount)
    if not hasattr(made.unwrapped, "P"):
        raise ValueError(
            f"simulator {spec!r} has no table P, so that it can only be sampled: oee export {spec} --samples-per-pair 100 "
            "--output simulator.npz writes it by its frequencies"
        )
    return FiniteMDP.from_gymnasium(made, discount)


def policies_of(specs: list[str] | None, task: NamedTask) -> dict[str, Any]:
    """Policies from NAME=SPEC or SPEC; optimal where there are none."""
    return {name: policy_of(spec, task, "--policy") for name, spec in named_specs(specs or ["optimal"]).items()}


def policy_of(spec: str, task: NamedTask, name: str) -> Array:
    """The policy that ``spec`` names, in the MDP of ``task``."""
    from oee_tabular import _progress
    from oee_tabular.data.tables import csv_frame
    from oee_tabular.exact import optimal_policy
    from oee_tabular.mdp import check_policy, mix, uniform_policy
    from oee_tabular.mdp.policies import read_policy_array

    _progress.report_step(f"reading the policy {spec}")
    mdp, suffix = task.mdp, Path(spec).suffix.lower()
    if spec in ("uniform", "optimal"):
        return uniform_policy(mdp) if spec == "uniform" else optimal_policy(mdp)
    if spec == "expert":
        return check_policy(task.expert(), mdp)
    if spec.startswith("mix:"):
        try:
            weight = float(spec.removeprefix("mix:"))
        except ValueError:
            raise ValueError(f"{name} must be like mix:0.5; got {spec!r}") from None
        return mix(check_policy(task.expert(), mdp), uniform_policy(mdp), weight)
    label = f"{name} {spec!r}"
    if suffix == ".csv":
        return check_policy(_policy_by_state(csv_frame(spec), mdp, repr(spec)), mdp, name=label)
    if suffix in (".npy", ".npz"):
        return check_policy(read_policy_array(spec, name), mdp, name=label)
    if is_own(spec):
        with own_modules():
            return check_policy(own_object(spec, name, "my_package.mine:policy"), mdp, name=label)
    close = difflib.get_close_matches(spec.lower(), ["uniform", "optimal", "expert", "mix:0.5"], n=1)
    raise ValueError(
        f"{name} must be uniform, optimal, expert, mix:WEIGHT, MODULE:FUNCTION, or a .npy, .npz or .csv file; got {spec!r}"
        + (f" (did you mean {close[0]!r}?)" if close else "")
    )


def _policy_by_state(frame: Any, mdp: FiniteMDP, name: str) -> dict[Any, Any]:
    """Read a table with the columns state, action (and probability), or state and one for each action."""
    from oee_tabular.mdp.naming import numbers_of

    labels, known = list(frame.columns), {*numbers_of(mdp.action_names or ()), *range(mdp.n_actions)}
    actions = {label: int(label) if label.isdigit() else label for label in labels if label != "state"}
    is_wide = "action" not in labels
    if "state" not in labels or not actions or (is_wide and not known.issuperset(actions.values())) or frame.empty:
        raise ValueError(
            f"{name} must have the columns state and action, with probability or without, or state and one for each action, "
            f"and at least one row; it has {', '.join(labels)} and {len(frame)} rows"
        )
    keys = ["state", "action"] if "probability" in labels else ["state"]
    twice = frame[frame.duplicated(keys)]
    if len(twice):
        place = ", ".join(f"{key} {twice.iloc[0][key]}" for key in keys)
        raise ValueError(f"{name} must have one row for each {' and '.join(keys)}; {place} has two")
    if is_wide:
        frame = frame.rename(columns=actions).melt("state", var_name="action", value_name="probability")
    elif "probability" not in labels:
        return dict(zip(frame["state"], frame["action"], strict=True))
    try:
        numbers = frame["probability"].astype(float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must have numbers as probabilities; {error}") from None
    policy: dict[Any, Any] = {}
    for state, action, number in zip(frame["state"], frame["action"], numbers, strict=True):
        policy.setdefault(state, {})[action] = number
    return policy
