"""Tasks of the experiments: classic control, masses on springs, linear models of a log.

Every parameter of the classic tasks is free. By default a step of them is Gymnasium's
(tests/continuous/test_experiments.py); CartPole has the paper's noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from oee_tabular._checks import freeze
from oee_tabular._parallel import ONE_THREAD
from oee_tabular.continuous import (
    CartPole,
    ContinuousTask,
    ContinuousTransitions,
    DerivedTask,
    Moves,
    StatePolicy,
)
from oee_tabular.typing import Array, BoolArray, IntArray


@dataclass(frozen=True)
class ChangedCartPole(CartPole):
    """CartPole with more that may differ.

    Parameters
    ----------
    pole, force : float
        Factors on the pole's length (its mass stays) and on the pushes.
    joint, cart : float
        Friction of the joint (N m s) and, dry, of the cart (N).
    push : float
        Constant angular acceleration, a wind (rad/s^2).
    gusts : float
        Standard deviation of further noise on the angular velocity.
    """

    pole: float = 1.0
    force: float = 1.0
    joint: float = 0.0
    cart: float = 0.0
    push: float = 0.0
    gusts: float = 0.0

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Make one step."""
        x_dot, angle, speed = states[:, 1:].T
        half = 0.5 * self.pole
        mass = 0.1
        total = 1.0 + mass
        force = self.force * self.actions[actions] - self.cart * np.sign(x_dot)
        sine = np.sin(angle)
        cosine = np.cos(angle)
        pulled = (force + mass * half * speed**2 * sine) / total
        turned = (
            self.gravity * sine - cosine * pulled - self.joint * speed / (mass * half)
        )
        turned = turned / (half * (4.0 / 3.0 - mass * cosine**2 / total)) + self.push
        moved = pulled - mass * half * turned * cosine / total
        following = (
            states
            + 0.02 * np.stack([x_dot, moved, speed, turned], axis=1)
            + self.noise * disturbance
        )
        following[:, 3] += self.gusts * disturbance[:, 3]
        return Moves(following, np.ones(len(states)), self.terminated(following))


class Plain(ContinuousTask):
    """Task without noise, whose discretised coordinates are the state's."""

    n_disturbances = 0


@dataclass(frozen=True)
class Pendulum(Plain):
    """Gymnasium's Pendulum-v1 with torques -2, 0 and 2 N m.

    The state is (angle, speed), not the observation.
    """

    mass: float = 1.0
    length: float = 1.0
    gravity: float = 10.0
    friction: float = 0.0
    torque: float = 1.0
    name: str = field(default="Pendulum", init=False)

    state_names = feature_names = ("angle", "speed")
    actions = freeze(np.array([-2.0, 0.0, 2.0]))
    feature_low = freeze(np.array([-np.pi, -8.0]))
    feature_high = freeze(np.array([np.pi, 8.0]))
    periodic = (True, False)
    terminates = False

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Make one step."""
        angle, speed = states.T
        asked = self.actions[actions]
        pulled = 3.0 * self.gravity / (2.0 * self.length) * np.sin(angle)
        turned = pulled + 3.0 / (self.mass * self.length**2) * (
            self.torque * asked - self.friction * speed
        )
        faster = np.clip(speed + turned * 0.05, -8.0, 8.0)
        upright = (angle + np.pi) % (2.0 * np.pi) - np.pi
        cost = upright**2 + 0.1 * speed**2 + 0.001 * asked**2
        return Moves(
            np.stack([angle + faster * 0.05, faster], axis=1),
            -cost,
            np.zeros(len(states), dtype=np.bool_),
        )

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw any angle and a slow speed."""
        return np.asarray(rng.uniform(-1.0, 1.0, (n, 2)) * np.array([np.pi, 1.0]))


@dataclass(frozen=True)
class MountainCar(Plain):
    """Gymnasium's MountainCar-v0."""

    gravity: float = 0.0025
    force: float = 0.001
    name: str = field(default="MountainCar", init=False)

    state_names = feature_names = ("position", "speed")
    actions = freeze(np.array([-1.0, 0.0, 1.0]))
    feature_low = freeze(np.array([-1.2, -0.07]))
    feature_high = freeze(np.array([0.6, 0.07]))
    periodic = (False, False)
    terminates = True

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Make one step."""
        place, speed = states.T
        faster = np.clip(
            speed
            + self.actions[actions] * self.force
            - np.cos(3.0 * place) * self.gravity,
            -0.07,
            0.07,
        )
        place = np.clip(place + faster, -1.2, 0.6)
        faster = np.where((place == -1.2) & (faster < 0), 0.0, faster)
        following = np.stack([place, faster], axis=1)
        return Moves(following, np.full(len(states), -1.0), self.terminated(following))

    def terminated(self, states: Array) -> BoolArray:
        """Return whether the car is on the hill."""
        return np.asarray((states[:, 0] >= 0.5) & (states[:, 1] >= 0.0))

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw places at rest in the valley."""
        return np.column_stack([rng.uniform(-0.6, -0.4, n), np.zeros(n)])


@dataclass(frozen=True)
class Acrobot(Plain):
    """Gymnasium's Acrobot-v1, with one step of Runge and Kutta of 0.2 s.

    Centres of mass are in the middle of the links.
    """

    mass_1: float = 1.0
    mass_2: float = 1.0
    length_1: float = 1.0
    torque: float = 1.0
    name: str = field(default="Acrobot", init=False)

    state_names = feature_names = ("angle_1", "angle_2", "speed_1", "speed_2")
    actions = freeze(np.array([-1.0, 0.0, 1.0]))
    feature_low = freeze(-np.array([np.pi, np.pi, 4.0 * np.pi, 9.0 * np.pi]))
    feature_high = freeze(np.array([np.pi, np.pi, 4.0 * np.pi, 9.0 * np.pi]))
    periodic = (True, True, False, False)
    terminates = True

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Make one step."""
        torque = self.torque * self.actions[actions]
        dt = 0.2
        k1 = self._rates(states, torque)
        k2 = self._rates(states + dt / 2.0 * k1, torque)
        k3 = self._rates(states + dt / 2.0 * k2, torque)
        k4 = self._rates(states + dt * k3, torque)
        following = states + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        following[:, :2] = (following[:, :2] + np.pi) % (2.0 * np.pi) - np.pi
        following = np.clip(following, self.feature_low, self.feature_high)
        over = self.terminated(following)
        return Moves(following, np.where(over, 0.0, -1.0), over)

    def _rates(self, states: Array, torque: Array) -> Array:
        """Compute the time derivatives of angles and velocities."""
        first, second, speed_1, speed_2 = states.T
        m1 = self.mass_1
        m2 = self.mass_2
        l1 = self.length_1
        c1 = 0.5 * self.length_1
        c2 = 0.5
        g = 9.8
        sine = np.sin(second)
        cosine = np.cos(second)
        d1 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2.0 * l1 * c2 * cosine) + 2.0
        d2 = m2 * (c2**2 + l1 * c2 * cosine) + 1.0
        phi2 = m2 * c2 * g * np.sin(first + second)
        phi1 = -m2 * l1 * c2 * sine * (speed_2**2 + 2.0 * speed_2 * speed_1)
        phi1 = phi1 + (m1 * c1 + m2 * l1) * g * np.sin(first) + phi2
        faster_2 = torque + d2 / d1 * phi1 - m2 * l1 * c2 * speed_1**2 * sine - phi2
        faster_2 = faster_2 / (m2 * c2**2 + 1.0 - d2**2 / d1)
        return np.stack(
            [speed_1, speed_2, -(d2 * faster_2 + phi1) / d1, faster_2], axis=1
        )

    def terminated(self, states: Array) -> BoolArray:
        """Return whether the tip is a link above the joint."""
        return np.asarray(
            -np.cos(states[:, 0]) - np.cos(states[:, 0] + states[:, 1]) > 1.0
        )

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw states that hang almost at rest."""
        return rng.uniform(-0.1, 0.1, (n, 4))


@dataclass(frozen=True)
class Chain(Plain):
    """Four masses between two walls, on springs that harden, with eight coordinates.

    The first mass is pushed. k (u + hardness u^3) is a spring's force at the extension
    u; a step is 0.1 s, twice 0.05 s by semi-implicit Euler.
    """

    mass: float = 1.0
    stiffness: float = 2.0
    hardness: float = 1.0
    friction: float = 0.1
    force: float = 1.0
    noise: float = 0.01
    name: str = field(default="Chain", init=False)

    state_names = feature_names = tuple(
        f"{what}_{k}" for what in ("place", "speed") for k in range(1, 5)
    )
    actions = freeze(np.array([-1.0, 0.0, 1.0]))
    n_disturbances = 4
    feature_low = freeze(np.full(8, -2.0))
    feature_high = freeze(np.full(8, 2.0))
    periodic = (False,) * 8
    terminates = False

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Make one step."""
        place = states[:, :4]
        speed = states[:, 4:]
        for _ in range(2):
            stretched = np.diff(place, axis=1, prepend=0.0, append=0.0)
            tension = self.stiffness * (stretched + self.hardness * stretched**3)
            pulled = np.diff(tension, axis=1) - self.friction * speed
            pulled[:, 0] += self.force * self.actions[actions]
            speed = speed + 0.05 * pulled / self.mass
            place = place + 0.05 * speed
        speed = speed + self.noise * disturbance
        following = np.column_stack([place, speed])
        return Moves(
            following,
            self.reward_between(states, actions, following),
            np.zeros(len(states), dtype=np.bool_),
        )

    def reward_between(
        self, states: Array, actions: IntArray, next_states: Array
    ) -> Array:
        """Return minus the mean square of the places."""
        return np.asarray(-(next_states[:, :4] ** 2).mean(axis=1))

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw displaced masses at rest."""
        return np.column_stack([rng.uniform(-1.0, 1.0, (n, 4)), np.zeros((n, 4))])


class LinearGaussian(DerivedTask):
    """Linear-Gaussian model of a log in some coordinates, by least squares.

    s' = s + A s + B u + c + N(0, Sigma); rewards, ends and beginnings are the task's.
    There is one model of all actions u, where ``LinearModel`` has one of each. The
    coordinates that are left out stay as they are.
    """

    def __init__(
        self,
        task: ContinuousTask,
        log: ContinuousTransitions,
        coordinates: slice = slice(None),
    ) -> None:
        """Fit the model to a log."""
        super().__init__(task, f"linear-Gaussian model of a log of {task.name}")
        self._at = coordinates
        design = self._inputs(log.state, log.action_numbers(task.actions))
        change = (log.next_state - log.state)[:, coordinates]
        self.n_disturbances = change.shape[1]
        with ONE_THREAD:
            self.coefficients = np.linalg.lstsq(design, change)[0]
            rest = change - design @ self.coefficients
            self.root = np.linalg.cholesky(
                rest.T @ rest / len(rest) + 1e-12 * np.eye(self.n_disturbances)
            )

    def _inputs(self, states: Array, actions: IntArray) -> Array:
        """Return the regressors of states and actions."""
        return np.column_stack(
            [np.ones(len(states)), states[:, self._at], self.actions[actions]]
        )

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Make one step of the model."""
        following = np.array(states)
        following[:, self._at] += (
            self._inputs(states, actions) @ self.coefficients
            + disturbance @ self.root.T
        )
        moved = self.task.moves(
            states, actions, np.zeros((len(states), self.task.n_disturbances))
        )
        paid = self.task.reward_between(states, actions, following)
        reward = moved.reward if paid is None else paid
        return replace(
            moved,
            next_state=following,
            reward=reward,
            terminated=self.task.terminated(following),
        )


def noisy(wanted: IntArray, delta: float) -> Array:
    """Return the probabilities (n, 3) of a policy that acts at random at times.

    The action wanted is 0, 1 or 2; a share delta of the actions is random.
    """
    return np.asarray(np.eye(3)[wanted] * (1.0 - delta) + delta / 3.0)


def swinging(delta: float) -> StatePolicy:
    """Return a policy of Pendulum: swing by energy, then balance."""

    def policy(states: Array) -> Array:
        """Return the probabilities of the actions."""
        angle = (states[:, 0] + np.pi) % (2.0 * np.pi) - np.pi
        speed = states[:, 1]
        energy = speed**2 / 6.0 + 5.0 * (np.cos(angle) - 1.0)
        up = np.where(energy < 0.0, 1.0, -1.0) * np.sign(speed)
        wanted = np.where(np.abs(angle) < 0.6, -8.0 * angle - 2.0 * speed, up)
        return noisy(np.clip(np.round(wanted), -1.0, 1.0).astype(np.int64) + 1, delta)

    return policy


def rocking(delta: float) -> StatePolicy:
    """Return a policy of MountainCar: push the way that it moves."""
    return lambda states: noisy(np.where(states[:, 1] >= 0.0, 2, 0), delta)


def pumping(delta: float) -> StatePolicy:
    """Return a policy of Acrobot: push the way that the second link turns."""
    return lambda states: noisy(np.where(states[:, 3] >= 0.0, 2, 0), delta)


def braking(delta: float) -> StatePolicy:
    """Return a policy of Chain: push against the first mass's speed."""
    return lambda states: noisy(np.where(states[:, 4] >= 0.0, 0, 2), delta)
