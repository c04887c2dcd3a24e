"""Continuous simulators by name, ``cartpole:gravity=10``, each with the configuration that logs are evaluated by.

Gymnasium's environments are named by their ids, ``Pendulum-v1:g=9`` (``gymnasium_named``). A task of ours is one
line in ``CONTINUOUS``: its name, and a function that makes a ``ContinuousSimulator`` of the arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from oee_tabular import _checks
from oee_tabular._arguments import parse_spec
from oee_tabular.continuous.cartpole import CartPole, cartpole_policy
from oee_tabular.continuous.gymnasium_named import gymnasium_simulator, is_continuous_id
from oee_tabular.continuous.kinova import KinovaArm, fit_hand, kinova_policy
from oee_tabular.continuous.reacher import Reacher, reacher_policy
from oee_tabular.continuous.simulator import ContinuousSimulator

KINOVA_RUNS = 250  # of Monte Carlo: some thousand commands a second


def cartpole(**parameters: Any) -> ContinuousSimulator:
    """CartPole under a gravity, by the configuration that ``oee reproduce fig2`` uses for every target.

    On cells: (theta, theta') on 32 x 32 vertices, looked at in the log's own places, floor 0.001, zeta from soft counts with
    prior "simulator" and strength 0.01, calibrated by the ratio. The whole state (``form=full``) has 1000 visited cells.
    """
    task = CartPole(**parameters)
    return ContinuousSimulator(
        "cartpole",
        task,
        cartpole_policy(0.0),
        horizon=100,
        floor=1e-3,
        ratio={"prior": "simulator", "strength": 1.0 if task.form == "full" else 0.01},
        policies=tuple(cartpole_policy(delta) for delta in (0.0, 0.3, 0.6, 1.0)),
    )


def reacher(*, tamed: bool = False, **parameters: Any) -> ContinuousSimulator:
    """Reacher with links of a length; ``reward_length`` is the length by which the target's reward finds the fingertip.

    On cells: 3000 at the log's own states; the simulator is the average over lengths times .5, .7, 1, 1.4 and 2 (floor 0.8,
    *not* the plain one); zeta with prior "simulator" and strength 0.1, not calibrated: on figure 3's two targets that did harm.
    """
    _checks.boolean(tamed, "tamed")
    return ContinuousSimulator(
        "reacher",
        Reacher.tamed(**parameters) if tamed else Reacher(**parameters),
        reacher_policy(0.0),
        horizon=25 if tamed else 100,
        floor=0.8,
        ratio={"prior": "simulator", "strength": 0.1},
        calibration="none",
        policies=tuple(reacher_policy(delta) for delta in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)),
        episodes=10_000,
    )


def kinova(*, form: str = "arm", **parameters: Any) -> ContinuousSimulator:
    """A simulated stand-in for the Gen3 that moves its hand to a goal: it is not the robot. MuJoCo is needed.

    Parameters of ``tasks.kinova.KinovaArm``, whose logs have its 27 coordinates; ``form=hand``: logs of the hand's position
    (x, y, z) alone, as a real arm's would be (``tasks.kinova.hand_log`` makes them), against a model of the hand fitted to the
    simulated arm. On cells: defensive (a tenth of the transitions half or one and a half times as far), zeta tied over
    displacements, calibrated by the difference.
    """
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
        episodes=KINOVA_RUNS if form == "arm" else 10_000,
    )


CONTINUOUS: Mapping[str, Callable[..., ContinuousSimulator]] = {
    "cartpole": cartpole,
    "reacher": reacher,
    "kinova": kinova,
}


def is_continuous(spec: str) -> bool:
    """Whether ``spec`` names a continuous task."""
    return spec.partition(":")[0] in CONTINUOUS or is_continuous_id(spec)


def continuous_simulator(spec: str, *, state: str | None = None, actions: object = None) -> ContinuousSimulator:
    """The continuous simulator that ``spec`` names, ``NAME`` or ``NAME:key=value,...``.

    Parameters
    ----------
    spec : a name in ``CONTINUOUS`` or the id of a Gymnasium environment, and parameters of its task
    state, actions : of a Gymnasium environment; see ``gymnasium_simulator``

    Raises
    ------
    ValueError
        An unknown name, arguments that the task does not take, or values that it refuses.

    Examples
    --------
    >>> continuous_simulator("cartpole:gravity=15,noise=0").task.parameters()
    {'gravity': 15, 'noise': 0, 'form': 'angle'}
    """
    name = spec.partition(":")[0]
    if name not in CONTINUOUS:
        if not is_continuous_id(spec):
            raise ValueError(
                f"spec must begin with one of {', '.join(CONTINUOUS)}, or with a Gymnasium id whose states are no numbers; "
                f"got {spec!r}"
            )
        return gymnasium_simulator(spec, state=state, actions=actions)
    for option, given in (("state", state), ("actions", actions)):
        if given is not None:
            raise ValueError(
                f"--task-option {option} must be left out for {name}, which is no Gymnasium environment; it is {given!r}"
            )
    _, keywords = parse_spec(spec)
    make = CONTINUOUS[name]
    try:
        inspect.signature(make).bind(**keywords)
        found = make(**keywords)
    except TypeError as error:
        raise ValueError(f"simulator {spec!r} does not take these arguments: {error}") from None
    return replace(found, name=spec)
