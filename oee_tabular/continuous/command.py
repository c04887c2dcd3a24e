"""The command for continuous tasks: their options, policies and logs from specifications and files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular._arguments import literal, named_specs

if TYPE_CHECKING:
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.simulator import ContinuousSimulator
    from oee_tabular.continuous.task import StatePolicy
    from oee_tabular.report import Report

TASK_OPTIONS = ("outside", "strict", "calibration", "floor", "simulations", "state", "actions")


def is_continuous(spec: str | None) -> bool:
    """Whether ``spec`` names a continuous task."""
    from oee_tabular.tasks.specs import is_numbered

    if spec is None or is_numbered(spec):
        return False
    from oee_tabular.continuous import names

    return names.is_continuous(spec)


def task_options(given: list[str] | None, known: Sequence[str] = TASK_OPTIONS) -> dict[str, Any]:
    """The values of ``--task-option NAME=VALUE`` by name; what is not given is the task's own."""
    from oee_tabular import _checks

    options: dict[str, Any] = dict(named_specs(given or [], "--task-option", known))
    for name in {"strict", "floor", "simulations", "actions"} & set(options):
        options[name] = literal(options[name], f"--task-option {name}")
    if "strict" in options:
        _checks.boolean(options["strict"], "--task-option strict")
    if "simulations" in options:
        _checks.positive_integer(options["simulations"], "--task-option simulations")
    actions = options.get("actions", 1)
    if isinstance(actions, bool) or not isinstance(actions, int | list | tuple):
        raise ValueError(
            "--task-option actions must be a number of levels (9), levels (-2,0,2) or commands ([[-1,0],[1,0]]); "
            f"got {actions!r}"
        )
    return options


def read_grid(text: str | None) -> tuple[int, ...] | int | str | None:
    """Where ``--grid`` puts the states: 60x60 vertices, 3000 visited cells, or "auto", the task's own."""
    try:
        if text is None or text == "auto":
            return text
        return int(text) if text.isdigit() else tuple(int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"--grid must be like 32x32, 3000 or auto; got {text!r}") from None


def evaluate_files(
    spec: str,
    log: list[str],
    policy: list[str] | None,
    behavior: str | None,
    target: str | None,
    options: dict[str, Any],
    grid: tuple[int, ...] | int | str | None = None,
    **common: Any,
) -> Report:
    """The report on a continuous simulator, a log of continuous states and policies.

    ``options``: by ``task_options``; ``grid``: by ``read_grid``; ``common``: what ``evaluate_continuous`` takes.
    """
    from oee_tabular.continuous.evaluation import evaluate_continuous
    from oee_tabular.continuous.gymnasium_named import is_continuous_id
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.names import continuous_simulator
    from oee_tabular.continuous.simulator import Settings, commands_of

    recorded = ContinuousTransitions.load(log)
    state, actions = options.get("state"), options.get("actions")
    is_registered = is_continuous_id(spec)
    if actions is None and is_registered:
        actions = commands_of(recorded)
    simulator = continuous_simulator(spec, state=state, actions=actions)
    if simulator.task.actions.ndim == 2 and recorded.action.ndim == 1 and actions is None and is_registered:
        raise ValueError(
            f"--task-option actions must be given for {simulator.task.name}, whose actions are commands: the log has their "
            "numbers alone"
        )
    if target is not None and not is_continuous(target):
        raise ValueError(f"--target must be a continuous task as the simulator is; got {target!r}")
    settings = {name: value for name, value in options.items() if name not in ("state", "actions", "simulations")}
    return evaluate_continuous(
        simulator,
        recorded,
        _policies(policy, simulator, grid is not None),
        settings=Settings(grid=grid, **settings, episodes=options.get("simulations")),
        behavior=None if behavior is None else _find_policy(behavior, simulator, "--behavior"),
        target=None if target is None else continuous_simulator(target, state=state, actions=actions).task,
        facts={"simulator_name": spec, "log_name": ", ".join(log)},
        **common,
    )


def record_log(spec: str, policy: str, options: dict[str, Any], **limits: Any) -> ContinuousTransitions:
    """A log of the continuous task that ``spec`` names; actions that are commands are written as such."""
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.names import continuous_simulator

    simulator = continuous_simulator(spec, **options)
    log = simulator.record(_find_policy(policy, simulator, "policy"), **limits)
    if simulator.task.actions.ndim == 1:
        return log
    return ContinuousTransitions(**(log.columns() | {"action": simulator.task.actions[log.action]}))


def _policies(specs: list[str] | None, simulator: ContinuousSimulator, has_grid: bool) -> dict[str, Any]:
    """Policies from NAME=SPEC or SPEC, the expert where there are none; with a grid an array is one of its cells."""
    from oee_tabular.mdp.policies import read_policy_array

    if specs is None and simulator.expert is None:
        raise ValueError(
            f"--policy must be given for {simulator.task.name}, which has no expert: uniform or MODULE:FUNCTION"
        )
    found: dict[str, Any] = {}
    for label, source in named_specs(specs or ["expert"]).items():
        is_array = has_grid and Path(source).suffix.lower() in (".npy", ".npz")
        found[label] = (
            read_policy_array(source, "--policy") if is_array else _find_policy(source, simulator, "--policy")
        )
    return found


def _find_policy(spec: str, simulator: ContinuousSimulator, name: str) -> StatePolicy:
    """A policy of states; an array's cells are those of the default grid."""
    if Path(spec).suffix.lower() not in (".npy", ".npz"):
        return simulator.policy(spec, name)
    from oee_tabular.continuous.discretization import DEFAULT_VERTICES
    from oee_tabular.mdp.policies import read_policy_array

    if len(simulator.task.feature_names) > max(DEFAULT_VERTICES):
        raise ValueError(
            f"{name} must be uniform, expert, mix:WEIGHT or MODULE:FUNCTION for {simulator.task.name}, whose cells are made of "
            f"the log; got {spec!r}"
        )
    model = simulator.discretize()
    return model.policy_function(model.policy(read_policy_array(spec, name), f"policy {spec!r}"))
