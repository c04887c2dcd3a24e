"""Continuous simulators by name, and their options, policies and logs from commands.

A task of ours is one line in ``CONTINUOUS``: its name, ``cartpole:gravity=10``, and a
function that makes a ``ContinuousSimulator`` of the arguments, with the configuration
that logs are evaluated by. Gymnasium's environments are named by their ids,
``Pendulum-v1:g=9`` (``gymnasium_named``). What is slow to import is imported where it
is used: every command imports this module.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._arguments import literal, named_specs, parse_spec
from oee_tabular.exceptions import ArgumentError

if TYPE_CHECKING:
    from oee_tabular.continuous.evaluation.simulator import (
        ContinuousSimulator,
        GridLike,
    )
    from oee_tabular.continuous.log.transitions import ContinuousTransitions
    from oee_tabular.continuous.task.base import StatePolicy
    from oee_tabular.report import Report
    from oee_tabular.typing import RealArrayLike

# Up to so many different commands of a log are the actions of a Gymnasium environment.
MAX_COMMANDS = 100
N_KINOVA_RUNS = 250  # of Monte Carlo: some thousand commands a second
TASK_OPTIONS = (
    "outside",
    "strict",
    "calibration",
    "floor",
    "simulations",
    "state",
    "actions",
)


def cartpole(**parameters: Any) -> ContinuousSimulator:
    """Make the simulator of CartPole under a gravity.

    Its configuration is that which ``oee reproduce fig2`` uses
    for every target.
    On cells: (theta, theta') on 32 x 32 vertices, looked at in the log's own places,
    floor 0.001, zeta from soft counts with prior "simulator" and strength 0.01,
    calibrated by the ratio. The whole state (``form=full``) has 1000 visited cells.
    """
    from oee_tabular.continuous.evaluation.simulator import ContinuousSimulator
    from oee_tabular.continuous.task.cartpole import CartPole, cartpole_policy

    task = CartPole(**parameters)
    strength = 1.0 if task.form == "full" else 0.01
    return ContinuousSimulator(
        "cartpole",
        task,
        cartpole_policy(0.0),
        horizon=100,
        floor=1e-3,
        ratio={"prior": "simulator", "strength": strength},
        policies=tuple(cartpole_policy(delta) for delta in (0.0, 0.3, 0.6, 1.0)),
    )


def reacher(*, tamed: bool = False, **parameters: Any) -> ContinuousSimulator:
    """Make the simulator of Reacher with links of a length.

    ``reward_length`` is the length by which the
    target's reward finds the fingertip.
    On cells: 3000 at the log's own states; the simulator is the average over lengths
    times .5, .7, 1, 1.4 and 2 (floor 0.8, *not* the plain one); zeta with prior
    "simulator" and strength 0.1, not calibrated: on figure 3's two targets that did
    harm.
    """
    from oee_tabular.continuous.evaluation.simulator import ContinuousSimulator
    from oee_tabular.continuous.task.reacher import Reacher, reacher_policy

    make = Reacher.tamed if _checks.boolean(tamed, "tamed") else Reacher
    return ContinuousSimulator(
        "reacher",
        make(**parameters),
        reacher_policy(0.0),
        horizon=25 if tamed else 100,
        floor=0.8,
        ratio={"prior": "simulator", "strength": 0.1},
        calibration="none",
        episodes=10_000,
        policies=tuple(
            reacher_policy(delta) for delta in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
        ),
    )


def kinova(
    *, form: Literal["arm", "hand"] = "arm", **parameters: Any
) -> ContinuousSimulator:
    """Make the simulated stand-in for the Gen3 that moves its hand to a goal.

    It is not the robot. MuJoCo is needed. Parameters are those of
    ``tasks.KinovaArm``, whose logs have its 27 coordinates; ``form=hand``: logs
    of the hand's position (x, y, z) alone, as a real arm's would be
    (``tasks.hand_log`` makes them), against a model of the hand fitted to the
    simulated arm. On cells: defensive (a tenth of the transitions half or one and a
    half times as far), zeta tied over displacements, calibrated by the difference.
    """
    from oee_tabular.continuous.evaluation.simulator import ContinuousSimulator
    from oee_tabular.continuous.task.gen3 import kinova_policy
    from oee_tabular.continuous.task.kinova import KinovaArm, fit_hand

    _checks.one_of(form, "form", ("arm", "hand"))
    arm = KinovaArm(**parameters)
    return ContinuousSimulator(
        "kinova",
        fit_hand(arm) if form == "hand" else arm,
        kinova_policy(arm.goal),
        horizon=25,
        floor=0.1,
        ratio={"strength": 3.0},
        calibration="difference",
        episodes=N_KINOVA_RUNS if form == "arm" else 10_000,
    )


CONTINUOUS: Mapping[str, Callable[..., ContinuousSimulator]] = {
    "cartpole": cartpole,
    "reacher": reacher,
    "kinova": kinova,
}


def is_continuous(spec: str | None) -> bool:
    """Return whether ``spec`` names a continuous task."""
    name = (spec or "").partition(":")[0]
    if spec is None or name == "gridworld" or Path(spec).suffix.lower() == ".npz":
        return False
    if name in CONTINUOUS:
        return True
    from oee_tabular.continuous.task.gymnasium_named import is_continuous_id

    return is_continuous_id(spec)


def continuous_simulator(
    spec: str, *, state: str | None = None, actions: RealArrayLike | None = None
) -> ContinuousSimulator:
    """Make the continuous simulator that ``spec`` names.

    Parameters
    ----------
    spec : str
        ``NAME`` or ``NAME:key=value,...``: a name in ``CONTINUOUS`` or the id of a
        Gymnasium environment, and parameters of its task.
    state : str, optional
        How a Gymnasium environment's state is read and set; see
        ``gymnasium_simulator``.
    actions : int, list or array_like, optional
        The actions of a Gymnasium environment; see ``gymnasium_simulator``.

    Returns
    -------
    ContinuousSimulator
        The simulator.

    Raises
    ------
    ValueError
        If the name is unknown, or the task does not take these arguments or refuses
        their values.

    Examples
    --------
    >>> continuous_simulator("cartpole:gravity=15,noise=0").task.parameters()
    {'gravity': 15, 'noise': 0, 'form': 'angle'}
    """
    name = spec.partition(":")[0]
    if name not in CONTINUOUS:
        from oee_tabular.continuous.task.gymnasium_named import gymnasium_simulator

        if not is_continuous(spec):
            raise ArgumentError(
                "spec",
                f"must begin with one of {', '.join(CONTINUOUS)}, or with a Gymnasium"
                f" id whose states are no numbers; got {spec!r}",
            )
        return gymnasium_simulator(spec, state=state, actions=actions)
    for option, given in (("state", state), ("actions", actions)):
        if given is not None:
            raise ArgumentError(
                f"--task-option {option}",
                f"must be left out for {name}, which is no Gymnasium environment; it is"
                f" {given!r}",
            )
    _, keywords = parse_spec(spec)
    make = CONTINUOUS[name]
    try:
        inspect.signature(make).bind(**keywords)
        found = make(**keywords)
    except TypeError as error:
        raise ValueError(
            f"simulator {spec!r} does not take these arguments: {error}"
        ) from None
    return replace(found, name=spec)


def task_options(
    given: list[str] | None, known: Sequence[str] = TASK_OPTIONS
) -> dict[str, Any]:
    """Read the values of ``--task-option NAME=VALUE`` by name.

    What is not given is the task's own.
    """
    options: dict[str, Any] = dict(named_specs(given or [], "--task-option", known))
    for name in {"strict", "floor", "simulations", "actions"} & set(options):
        options[name] = literal(options[name], f"--task-option {name}")
    if "strict" in options:
        _checks.boolean(options["strict"], "--task-option strict")
    if "simulations" in options:
        _checks.positive_integer(options["simulations"], "--task-option simulations")
    actions = options.get("actions", 1)
    if isinstance(actions, bool) or not isinstance(actions, int | list | tuple):
        raise ArgumentError(
            "--task-option actions",
            "must be a number of levels (9), levels (-2,0,2) or commands"
            f" ([[-1,0],[1,0]]); got {actions!r}",
        )
    return options


def read_grid(text: str | None) -> GridLike | None:
    """Read where ``--grid`` puts the states.

    It is 60x60 vertices, 3000 visited cells, or "auto", the task's own.
    """
    if text is None:
        return None
    if text == "auto":
        return "auto"
    try:
        if text.isdigit():
            return int(text)
        return tuple(int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ArgumentError(
            "--grid", f"must be like 32x32, 3000 or auto; got {text!r}"
        ) from None


def evaluate_files(
    spec: str,
    log: list[str],
    policy: list[str] | None,
    behavior: str | None,
    target: str | None,
    options: dict[str, Any],
    grid: GridLike | None = None,
    columns: Mapping[str, Any] | None = None,
    **common: Any,
) -> Report:
    """Evaluate policies by a continuous simulator and a log of continuous states.

    ``options`` are made by ``task_options``, ``grid`` by ``read_grid``; ``columns`` is
    what the log's files call its columns; ``common`` is what ``evaluate_continuous``
    takes.
    """
    from oee_tabular.continuous.evaluation.evaluate import evaluate_continuous
    from oee_tabular.continuous.evaluation.simulator import Settings
    from oee_tabular.continuous.log.transitions import ContinuousTransitions

    recorded = ContinuousTransitions.load(log, columns=columns)
    state = options.get("state")
    actions = options.get("actions")
    if actions is None and _is_gymnasium(spec):
        actions = _commands_of(recorded)
    simulator = continuous_simulator(spec, state=state, actions=actions)
    if actions is None and _is_gymnasium(spec):
        _require_commands(recorded, simulator)
    if target is not None and not is_continuous(target):
        raise ArgumentError(
            "--target", f"must be a continuous task as the simulator is; got {target!r}"
        )
    policies = _find_policies(policy, simulator, has_cells=grid is not None)
    other = ("state", "actions", "simulations")
    settings = {name: value for name, value in options.items() if name not in other}
    behavior_policy = None
    if behavior is not None:
        behavior_policy = _find_policy(behavior, simulator, "--behavior")
    target_task = None
    if target is not None:
        target_task = continuous_simulator(target, state=state, actions=actions).task
    return evaluate_continuous(
        simulator,
        recorded,
        policies,
        settings=Settings(grid=grid, episodes=options.get("simulations"), **settings),
        behavior=behavior_policy,
        target=target_task,
        facts={"simulator_name": spec, "log_name": ", ".join(log)},
        **common,
    )


def _is_gymnasium(spec: str) -> bool:
    """Return whether a simulator is none of ours, but Gymnasium's."""
    return spec.partition(":")[0] not in CONTINUOUS


def _commands_of(log: ContinuousTransitions) -> list[Any] | None:
    """Return the different commands of a log, which are then the task's actions.

    Returns None where the log has numbers of actions, or too many commands.
    """
    if log.action.ndim == 1:
        return None
    commands = np.unique(log.action, axis=0)
    return commands.tolist() if len(commands) <= MAX_COMMANDS else None


def _require_commands(
    log: ContinuousTransitions, simulator: ContinuousSimulator
) -> None:
    """Refuse a log of numbers for a task whose actions are commands."""
    if simulator.task.actions.ndim == 2 and log.action.ndim == 1:
        raise ArgumentError(
            "--task-option actions",
            f"must be given for {simulator.task.name}, whose actions are commands: the"
            " log has their numbers alone",
        )


def _find_policies(
    given: list[str] | None, simulator: ContinuousSimulator, *, has_cells: bool
) -> dict[str, Any]:
    """Return the policies of ``--policy`` by name; without it, the expert.

    On cells a file's probabilities are those of the cells.
    """
    from oee_tabular.mdp import read_policy_array

    if given is None and simulator.expert is None:
        raise ArgumentError(
            "--policy",
            f"must be given for {simulator.task.name}, which has no expert: uniform or"
            " MODULE:FUNCTION",
        )
    policies: dict[str, Any] = {}
    for label, source in named_specs(given or ["expert"]).items():
        if has_cells and _is_array_file(source):
            policies[label] = read_policy_array(source, name="--policy")
        else:
            policies[label] = _find_policy(source, simulator, "--policy")
    return policies


def record_log(
    spec: str, policy: str, options: dict[str, Any], **limits: Any
) -> ContinuousTransitions:
    """Record a log of the continuous task that ``spec`` names.

    Actions that are commands are written as such.
    """
    from oee_tabular.continuous.log.transitions import ContinuousTransitions

    simulator = continuous_simulator(spec, **options)
    log = simulator.record(_find_policy(policy, simulator, "policy"), **limits)
    if simulator.task.actions.ndim == 1:
        return log
    commands = {"action": simulator.task.actions[log.action]}
    return ContinuousTransitions(**(log.columns() | commands))


def _is_array_file(source: str) -> bool:
    """Return whether a policy's specification is a file of probabilities."""
    return Path(source).suffix.lower() in (".npy", ".npz")


def _find_policy(spec: str, simulator: ContinuousSimulator, name: str) -> StatePolicy:
    """Return the policy of states that ``spec`` names.

    An array's cells are those of the default grid.
    """
    if not _is_array_file(spec):
        return simulator.policy(spec, name)
    from oee_tabular.continuous.discretization.build import DEFAULT_VERTICES
    from oee_tabular.mdp import read_policy_array

    if len(simulator.task.feature_names) > max(DEFAULT_VERTICES):
        raise ArgumentError(
            name,
            "must be uniform, expert, mix:WEIGHT or MODULE:FUNCTION for"
            f" {simulator.task.name}, whose cells are made of the log; got {spec!r}",
        )
    model = simulator.discretize()
    return model.policy_function(
        model.policy(read_policy_array(spec, name), f"policy {spec!r}")
    )
