"""The changes: for each a simulator, a target, a log's size and the policies to be valued."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oee_tabular._checks import Array, IntArray, Seed
from oee_tabular.continuous import kinova
from oee_tabular.continuous.cartpole import CartPole, cartpole_policy
from oee_tabular.continuous.episodes import compare_returns, record
from oee_tabular.continuous.history import HistoryTask
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.reacher import reacher_policy
from oee_tabular.continuous.task import ContinuousTask, Moves, StatePolicy
from oee_tabular.lab.robots.cartpole_estimates import DELTAS as CARTPOLE_DELTAS
from oee_tabular.lab.robots.changes import classic
from oee_tabular.lab.robots.kinova import arm_of, towards
from oee_tabular.lab.robots.reacher import DELTAS as REACHER_DELTAS
from oee_tabular.lab.robots.reacher import Even

DISCOUNT = 0.99


@dataclass(frozen=True)
class Change:
    """One change of one task.

    Attributes
    ----------
    task : its name
    simulator, target : the target's states may have more coordinates after the simulator's; the log has the simulator's
    policy : share of random actions -> policy
    sizes : moves of a log
    deltas : shares of random actions of the policies valued
    horizon, episodes : of a value
    scale : of values and errors
    grid : vertices for the rows on a grid; empty: no such rows
    behavior : share of random actions of the policy that recorded the log
    """

    task: str
    simulator: ContinuousTask
    target: ContinuousTask
    policy: Callable[[float], StatePolicy]
    sizes: tuple[int, ...] = (20_000,)
    deltas: tuple[float, ...] = (0.1, 0.5)
    horizon: int = 200
    episodes: int = 4000
    scale: float = 1.0
    grid: tuple[int, ...] = ()
    behavior: float = 0.3

    def acting(self, delta: float) -> StatePolicy:
        """The policy, of states that may have more coordinates."""
        policy, d = self.policy(delta), self.simulator.n_state
        return lambda states: policy(states[:, :d])

    def log(self, n: int, seed: Seed) -> ContinuousTransitions:
        """n moves of the target, by the simulator's coordinates."""
        found = record(self.target, self.acting(self.behavior), n_transitions=n, max_steps=self.horizon, seed=seed)
        d, columns = self.simulator.n_state, found.columns()
        return ContinuousTransitions(**(columns | {k: columns[k][:, :d] for k in ("state", "next_state")}))

    def returns(self, task: ContinuousTask, delta: float) -> Array:
        """(episodes,) returns; tasks that are alike go alike."""
        seed = np.random.SeedSequence(11, spawn_key=(round(100 * delta),))
        policy = self.acting(delta)
        found = compare_returns([task], policy, self.episodes, self.horizon, discount=DISCOUNT, seed=seed)
        return np.asarray(self.scale * found[0])


@dataclass(frozen=True)
class Arm(Change):
    """The Kinova stand-in: values are means over the five goals, logs are of 10 runs to each."""

    def log(self, n: int, seed: Seed) -> ContinuousTransitions:
        """n moves, 25 a run."""
        runs = n // (len(kinova.GOALS) * kinova.HORIZON)
        return kinova.record_goals(self.target, n_runs=runs, delta=self.behavior, seed=seed)  # type: ignore[arg-type]

    def returns(self, task: ContinuousTask, delta: float) -> Array:
        """(episodes,) means over the goals."""
        found = []
        for goal in range(len(kinova.GOALS)):
            seed = np.random.SeedSequence(11, spawn_key=(round(100 * delta), goal))
            aim, policy = towards(task, goal), kinova.kinova_policy(goal, delta)
            found += [*compare_returns([aim], policy, self.episodes, self.horizon, discount=DISCOUNT, seed=seed)]
        return np.asarray(np.mean(found, axis=0))


class Delayed(HistoryTask):
    """The task does what was asked for a step ago."""

    step = ContinuousTask.step

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One step; at first as asked."""
        last = states[:, self.task.n_state :]
        done = np.where(last.any(axis=1), last.argmax(axis=1), actions)
        moved = super().moves(states, done, disturbance)
        moved.next_state[:, self.task.n_state :] = np.eye(self.n_actions)[actions]
        return moved


def _cartpole(**changes: Any) -> Change:
    return replace(_CARTPOLE, target=classic.ChangedCartPole(**({"gravity": 10.0} | changes)))


def _noisy(**changes: object) -> Change:
    return replace(_cartpole(**changes), episodes=10_000)  # other noise is not the truth's: more of it is left


_CARTPOLE = Change(
    "CartPole", CartPole(10.0), CartPole(10.0), cartpole_policy, sizes=(3000, 80_000), deltas=CARTPOLE_DELTAS,
    horizon=100, episodes=4000, scale=1.0 - DISCOUNT, grid=(32, 32),
)  # fmt: skip
_PENDULUM = Change("Pendulum", classic.Pendulum(), classic.Pendulum(), classic.swinging, grid=(41, 41))
_CAR = Change("MountainCar", classic.MountainCar(), classic.MountainCar(), classic.rocking, grid=(40, 40))
_ACROBOT = Change("Acrobot", classic.Acrobot(), classic.Acrobot(), classic.pumping, horizon=500)
_CHAIN = Change("Chain", classic.Chain(), classic.Chain(), classic.braking, sizes=(20_000, 150_000), horizon=100)


def _reacher(length: float) -> Change:
    return Change(
        "Reacher", Even(0.1, length), Even(length), reacher_policy, sizes=(150_000,), deltas=REACHER_DELTAS,
        horizon=100, episodes=1000, behavior=0.5,
    )  # fmt: skip


def _arm(name: str) -> Change:
    return Arm(
        "Kinova", arm_of("simulator"), arm_of(name), functools.partial(kinova.kinova_policy, 0), sizes=(1250,),
        deltas=(0.0, 0.3), horizon=kinova.HORIZON, episodes=100,
    )  # fmt: skip


CASES: dict[str, Change] = {
    "CartPole, gravity 7.5": _cartpole(gravity=7.5),
    "CartPole, gravity 12.5": _cartpole(gravity=12.5),
    "CartPole, gravity 15": _cartpole(gravity=15.0),
    "CartPole, gravity 11.3": _cartpole(gravity=11.3),
    "CartPole, pole x 1.3": _cartpole(pole=1.3),
    "CartPole, force x 0.8": _cartpole(force=0.8),
    "CartPole, friction": _cartpole(joint=2e-4, cart=0.05),
    "CartPole, wind": _cartpole(push=0.5),
    "CartPole, unchanged": _cartpole(),
    "CartPole, noise 0.03": _noisy(gusts=0.03),
    "CartPole, all at once": _noisy(gravity=11.3, pole=1.3, force=0.8, joint=2e-4, cart=0.05, gusts=0.03),
    "CartPole, delay": replace(_CARTPOLE, target=Delayed(CartPole(10.0))),
    "Pendulum, mass, gravity": replace(_PENDULUM, target=classic.Pendulum(mass=1.2, gravity=11.0)),
    "Pendulum, length": replace(_PENDULUM, target=classic.Pendulum(length=1.15)),
    "Pendulum, friction, torque": replace(_PENDULUM, target=classic.Pendulum(friction=0.1, torque=0.8)),
    "MountainCar, gravity, force": replace(_CAR, target=classic.MountainCar(0.0027, 0.0009)),
    "MountainCar, force x 1.2": replace(_CAR, target=classic.MountainCar(force=0.0012)),
    "Acrobot, mass, length": replace(_ACROBOT, target=classic.Acrobot(mass_2=1.3, length_1=1.15)),
    "Acrobot, torque x 0.7": replace(_ACROBOT, target=classic.Acrobot(torque=0.7)),
    "Reacher, short": _reacher(0.05),
    "Reacher, 1.7 times": _reacher(0.17),
    "Reacher, long": _reacher(0.2),
    "Kinova, velocity x 1.4": _arm("velocity x 1.4"),
    "Kinova, six causes": _arm("everything"),
    "Chain, mass, springs": replace(_CHAIN, target=classic.Chain(mass=1.3, stiffness=1.4)),
    "Chain, all at once": replace(_CHAIN, target=classic.Chain(1.2, 1.6, 0.3, 0.3, 0.7, 0.03)),
}
