"""Simulators by name, as on the command line.

For example ``gridworld:10,slip=0.3``, ``bus_engines``, ``FrozenLake-v1:map_name=8x8``,
``file.npz`` or ``file.umb``.
Continuous ones, ``cartpole:gravity=10``, are in ``oee_tabular.continuous.command``,
which is imported where one may be named.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from oee_tabular import _checks
from oee_tabular._arguments import arguments, parse_spec
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.mdp import FiniteMDP
from oee_tabular.tasks.buses import bus_model, replacement_policy
from oee_tabular.tasks.gridworld import gridworld, gridworld_expert
from oee_tabular.tasks.recycling_robot import recycling_robot
from oee_tabular.tasks.toy_text import environment_exists, make_environment, toy_text
from oee_tabular.typing import Array

if TYPE_CHECKING:
    from oee_tabular.continuous import ContinuousSimulator, Discretization
else:  # for ``typing.get_type_hints``: the room of continuous tasks is loaded on use
    Discretization: TypeAlias = Any
    ContinuousSimulator: TypeAlias = Any

# tasks of numbered states that ``named_task`` knows, beside Gymnasium's
MDP_ENDINGS = (".npz", ".umb")  # of files that FiniteMDP.load reads
FINITE = ("gridworld", "recycling_robot", "bus_engines")


@checked()
@dataclass(frozen=True)
class NamedTask:
    """Hold a simulator that was named, with what belongs to it.

    Attributes
    ----------
    name : str
        The name as it was given.
    mdp : FiniteMDP
        The simulator.
    expert : callable
        A function without arguments that returns a policy (S, A): a task's own expert,
        else the optimal policy.
    environment : callable or None
        A function without arguments that makes the Gymnasium environment; None for
        tasks that are not Gymnasium's.
    grid : int or None
        Size of a square gridworld of ours, else None.
    continuous : ContinuousSimulator or None
        The continuous simulator; None for tasks whose states are numbered.
    discretization : Discretization or None
        The continuous simulator on cells by its default configuration; its ``mdp`` is
        this one.

    Examples
    --------
    >>> task = named_task("gridworld:3,slip=0.3")
    >>> task.grid, task.expert().argmax(axis=1).tolist()
    (3, [0, 0, 0, 0, 0, 0, 2, 2, 2])
    """

    name: str
    mdp: FiniteMDP
    expert: Callable[[], Array]
    environment: Callable[[], Any] | None = None
    grid: int | None = None
    continuous: ContinuousSimulator | None = None
    discretization: Discretization | None = None


@suggest_keywords
def named_task(spec: str, *, discount: float | None = None) -> NamedTask:
    """Make the task that ``spec`` names.

    Parameters
    ----------
    spec : str
        ``NAME``, ``NAME:value`` or ``NAME:value,key=value,...``, where NAME is a task
        of ours ("gridworld"; "recycling_robot"; "bus_engines", Rust's buses of group 3,
        or of another group; "cartpole" on its default grid), a Gymnasium id with a
        toy-text table, or of a continuous environment (``Pendulum-v1:g=9``, on its
        grid); or the path of a file that ``FiniteMDP.load`` reads. Values are Python
        literals or words.
    discount : float, optional
        The discount, in [0, 1]. None means the task's own.

    Returns
    -------
    NamedTask
        The simulator with its expert and, for a task of Gymnasium's, its environment.

    Raises
    ------
    ValueError
        If the name is unknown (with the nearest ids), the task does not take the
        arguments, or the file has no MDP.

    See Also
    --------
    gridworld : The gridworld by its arguments.
    toy_text : A toy-text environment by its arguments.

    Examples
    --------
    >>> named_task("gridworld:10,slip=0.3").mdp
    FiniteMDP(100 states, 4 actions, 1576 transitions, rewards r(s, a, s'), discount 0.99)
    >>> named_task("FrozenLake-v1:is_slippery=False", discount=0.9).mdp
    FiniteMDP(16 states, 4 actions, 64 transitions, rewards r(s, a, s'), discount 0.9)
    """
    name, _, rest = _checks.instance(spec, str, "spec").partition(":")
    given = {} if discount is None else {"discount": discount}
    if Path(spec).suffix.lower() in MDP_ENDINGS:
        mdp = FiniteMDP.load(spec)
        if discount is not None:
            mdp = mdp.with_discount(discount)
        return NamedTask(spec, mdp, partial(_plan, mdp))
    if name == "gridworld":
        return _gridworld_task(spec, rest, given)
    if name == "recycling_robot":
        bound = _bind(recycling_robot, spec, rest, given, "recycling_robot:beta=0.6")
        mdp = recycling_robot(*bound.args, **bound.kwargs)
        return NamedTask(spec, mdp, partial(_plan, mdp))
    if name == "bus_engines":
        return _bus_engines_task(spec, rest, given)
    # imported here because the core loads without continuous tasks
    command = importlib.import_module("oee_tabular.continuous.command")
    if command.is_continuous(spec):
        simulator = command.continuous_simulator(spec)
        return _continuous_task(spec, simulator, {"discount": 0.99} | given)
    environment_exists(name, (*FINITE, *command.CONTINUOUS))
    _, keywords = parse_spec(spec)
    mdp = toy_text(name, **(keywords | given))
    # the discount is the model's; the environment has none
    keywords.pop("discount", None)
    environment = partial(make_environment, name, **keywords)
    return NamedTask(spec, mdp, partial(_plan, mdp), environment)


def _gridworld_task(spec: str, rest: str, given: dict[str, float]) -> NamedTask:
    """Make the gridworld that ``rest``, the part of ``spec`` after its name, names."""
    bound = _bind(gridworld, spec, rest, given, "gridworld:10,slip=0.3")
    size = bound.arguments["size"]
    mdp = gridworld(*bound.args, **bound.kwargs)
    return NamedTask(spec, mdp, partial(gridworld_expert, size), grid=size)


def _bus_engines_task(spec: str, rest: str, given: dict[str, float]) -> NamedTask:
    """Make the model of the group of buses that ``rest`` names, group 3 by default."""
    bound = _bind(bus_model, spec, rest, given, "bus_engines:group=4")
    return NamedTask(spec, bus_model(*bound.args, **bound.kwargs), replacement_policy)


def _bind(
    make: Callable[..., FiniteMDP],
    spec: str,
    rest: str,
    given: dict[str, float],
    example: str,
) -> inspect.BoundArguments:
    """Return the arguments of a task that ``rest``, the end of ``spec``, gives."""
    positional, keywords = arguments(rest)
    try:
        return inspect.signature(make).bind(*positional, **(keywords | given))
    except TypeError as error:
        raise ValueError(
            f"simulator {spec!r} must be like {example!r}; {error}"
        ) from None


def _continuous_task(
    spec: str, simulator: ContinuousSimulator, options: dict[str, Any]
) -> NamedTask:
    """Make a continuous task on the cells of its default configuration."""
    model = simulator.discretize(**options)

    def expert() -> Array:
        """Return the task's own expert on the cells."""
        return model.policy(simulator.policy("expert"))

    return NamedTask(
        spec, model.mdp, expert, continuous=simulator, discretization=model
    )


def _plan(mdp: FiniteMDP) -> Array:
    """Return the optimal policy; what it compiles with is imported only here."""
    from oee_tabular.exact import optimal_policy

    return optimal_policy(mdp)
