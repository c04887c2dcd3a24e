"""The command for continuous tasks: their options, policies and logs from specifications and files."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.simulator import ContinuousSimulator
    from oee_tabular.continuous.task import StatePolicy
    from oee_tabular.report import Report


def is_continuous(spec: str | None) -> bool:
    """Whether ``spec`` names a continuous task."""
    from oee_tabular.tasks.specs import is_numbered

    if spec is None or is_numbered(spec):
        return False
    from oee_tabular.continuous import names

    return names.is_continuous(spec)


def actions_of(text: str | None) -> Any:
    """The option --actions: a number of levels, levels or commands, as ``actions.action_set`` takes them."""
    if text is None:
        return None
    try:
        found = ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        found = None
    if isinstance(found, int) and not isinstance(found, bool):
        return found
    if not isinstance(found, list | tuple):
        raise ValueError(
            f"--actions must be a number of levels (9), levels (-2,0,2) or commands ([[-1,0],[1,0]]); got {text!r}"
        )
    return list(found)


def settings_of(
    grid: str | None,
    outside: str | None,
    strict: bool,
    calibration: str | None,
    floor: float | None,
    episodes: int | None,
) -> dict[str, Any]:
    """The options that were given, by the names of ``Settings``."""
    shape: tuple[int, ...] | None = None
    if grid == "none":
        shape = ()
    elif grid is not None:
        try:
            shape = tuple(int(part) for part in grid.lower().split("x"))
        except ValueError:
            raise ValueError(f"--grid must be like 32x32, or none; got {grid!r}") from None
    given = {"grid": shape, "outside": outside, "strict": strict or None, "calibration": calibration, "floor": floor,
             "episodes": episodes}  # fmt: skip
    return {name: value for name, value in given.items() if value is not None}


def from_states(
    spec: str,
    log: list[str],
    policy: list[str] | None,
    behavior: str | None,
    target: str | None,
    options: dict[str, Any],
    normalized: bool,
    common: dict[str, Any],
    settings: dict[str, Any],
    state: str | None = None,
    actions: str | None = None,
) -> Report:
    """The report on a continuous simulator, a log of continuous states and policies."""
    from oee_tabular.continuous.actions import commands_of
    from oee_tabular.continuous.evaluation import evaluate_continuous
    from oee_tabular.continuous.gymnasium_named import is_continuous_id
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.names import continuous_simulator
    from oee_tabular.continuous.simulator import Settings

    plains = {"rewards": "simulator", "action_noise": 0.0, "impossible": "refuse", "initial": None, "box": None}
    for name, plain in plains.items():
        if options[name] != plain:
            raise ValueError(
                f"--{name.replace('_', '-')} must be left out for a continuous task; it is {options[name]}"
            )
    for name in ("features", "tie"):
        if options[name] is not None:
            raise ValueError(
                f"--{name} must be left out for a continuous task, whose moves are not between numbered states; "
                f"it is {str(options[name])!r}"
            )
    recorded = ContinuousTransitions.load(log)
    given = actions_of(actions)
    if given is None and is_continuous_id(spec):
        given = commands_of(recorded)
    simulator = continuous_simulator(spec, state=state, actions=given)
    if simulator.task.actions.ndim == 2 and recorded.action.ndim == 1 and given is None and is_continuous_id(spec):
        raise ValueError(
            f"--actions must be given for {simulator.task.name}, whose actions are commands: the log has their numbers alone"
        )
    if target is not None and not is_continuous(target):
        raise ValueError(f"--target must be a continuous task as the simulator is; got {target!r}")
    return evaluate_continuous(
        simulator,
        recorded,
        _policies(policy, simulator),
        settings=Settings(**settings),
        behavior=None if behavior is None else _named(behavior, simulator, "--behavior"),
        target=None if target is None else continuous_simulator(target, state=state, actions=given).task,
        horizon=options["horizon"],
        discount=0.99 if options["discount"] is None else options["discount"],
        normalized=normalized,
        facts={"simulator_name": spec, "log_name": ", ".join(log)},
        **common,
    )


def recorded_states(
    spec: str,
    policy: str,
    transitions: int | None,
    episodes: int | None,
    horizon: int | None,
    seed: int,
    state: str | None = None,
    actions: str | None = None,
) -> ContinuousTransitions:
    """A log of the continuous task that ``spec`` names; actions that are commands are written as such."""
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.names import continuous_simulator

    simulator = continuous_simulator(spec, state=state, actions=actions_of(actions))
    log = simulator.record(
        _named(policy, simulator, "policy"),
        n_transitions=transitions,
        n_episodes=episodes,
        max_steps=horizon,
        seed=seed,
    )
    if simulator.task.actions.ndim == 1:
        return log
    return ContinuousTransitions(**(log.columns() | {"action": simulator.task.actions[log.action]}))


def _policies(specs: list[str] | None, simulator: ContinuousSimulator) -> dict[str, Any]:
    """Policies from NAME=SPEC or SPEC; the expert where there are none."""
    from oee_tabular.mdp.policies import read_policy_array
    from oee_tabular.tasks.arguments import named_specs

    if specs is None and simulator.expert is None:
        raise ValueError(
            f"--policy must be given for {simulator.task.name}, which has no expert: uniform or MODULE:FUNCTION"
        )
    found: dict[str, object] = {}
    for label, source in named_specs(specs or ["expert"]).items():
        is_file = Path(source).suffix.lower() in (".npy", ".npz")
        if is_file:
            _refuse_arrays(source, simulator, "--policy")
        found[label] = read_policy_array(source, "--policy") if is_file else _named(source, simulator, "--policy")
    return found


def _named(spec: str, simulator: ContinuousSimulator, name: str) -> StatePolicy:
    """A policy of states; an array's cells are those of the default grid."""
    if Path(spec).suffix.lower() not in (".npy", ".npz"):
        return simulator.policy(spec, name)
    _refuse_arrays(spec, simulator, name)
    from oee_tabular.continuous.on_cells import as_function, as_table
    from oee_tabular.mdp.policies import read_policy_array

    model = simulator.build()
    return as_function(as_table(read_policy_array(spec, name), model, spec), model)


def _refuse_arrays(spec: str, simulator: ContinuousSimulator, name: str) -> None:
    if simulator.cells_of_log:
        raise ValueError(
            f"{name} must be uniform, expert or mix:WEIGHT for {simulator.task.name}, whose cells are made of the log; "
            f"got {spec!r}"
        )
