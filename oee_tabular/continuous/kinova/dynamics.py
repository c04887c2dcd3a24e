"""Where a Gen3's hand is, the joint rates that move it, and what the arm and the model of its hand share as tasks.

A command in {-1, 0, 1}^3 asks for 0.1 m/s along the axes of the base during 0.2 s. Resolved rates turn it into a moving
reference of the joints, and position servos follow that. Where the hand is needs NumPy alone:

    T(q) = prod_k Trans(p_k) Rot_x(r_k) Rot_z(q_k),      dq = J^T (J J^T + lambda^2 I)^-1 (v, 0)

The offsets p_k (m) and r_k (rad) are read from gen3.xml, the file that MuJoCo simulates: there is one set of numbers.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace
from importlib import resources
from typing import Self
from xml.etree import ElementTree

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, freeze
from oee_tabular.continuous.task import ContinuousTask

N_JOINTS = 7
N_ARM_STATES = 27  # position 3, angles, speeds and references 7 each, the last command 3
HOME = np.array([0.0, 0.26179939, np.pi, -2.26892803, 0.0, 0.95993109, 1.57079633])  # rad, the usual resting pose
DAMPING = 0.02  # lambda: keeps joint speeds finite near singular poses


def arm_xml() -> str:
    """The MJCF of the stand-in: published geometry, masses, inertias and limits; assumed armature and servo gains."""
    return resources.files("oee_tabular.continuous.kinova").joinpath("gen3.xml").read_text()


@functools.cache
def _chain() -> tuple[Array, Array]:
    """Offsets (8, 3) in m and turns about x (8,) in rad: seven joints and the end effector."""
    root = ElementTree.fromstring(arm_xml())
    bodies = [body for body in root.iter("body") if "euler" in body.attrib]
    offsets = np.array([[float(x) for x in body.attrib["pos"].split()] for body in bodies])
    turns = np.array([float(body.attrib["euler"].split()[0]) for body in bodies])
    return offsets, turns


def _frames(joints: Array) -> tuple[Array, Array, Array]:
    """Joint origins (n, 7, 3), joint axes (n, 7, 3) and the end effector (n, 3)."""
    offsets, turns = _chain()
    n = len(joints)
    place = np.zeros((n, 3))
    x, y, z = (np.broadcast_to(row, (n, 3)) for row in np.eye(3))
    origins, axes = np.empty((n, N_JOINTS, 3)), np.empty((n, N_JOINTS, 3))
    for k in range(N_JOINTS + 1):
        p, c, s = offsets[k], np.cos(turns[k]), np.sin(turns[k])
        place = place + p[0] * x + p[1] * y + p[2] * z
        y, z = c * y + s * z, c * z - s * y
        if k < N_JOINTS:
            origins[:, k], axes[:, k] = place, z
            c, s = np.cos(joints[:, k, None]), np.sin(joints[:, k, None])
            x, y = c * x + s * y, c * y - s * x
    return origins, axes, place


def end_effector(joints: Array) -> Array:
    """(n, 3) position of the end effector in m, in the frame of the base, at joint angles (n, 7) in rad.

    Examples
    --------
    >>> end_effector(HOME[None]).round(4).tolist()
    [[0.4567, 0.0014, 0.4337]]
    """
    angles = _checks.float_array(joints, "joints")
    if angles.ndim != 2 or angles.shape[1] != N_JOINTS:
        raise ValueError(f"joints must have shape (n, {N_JOINTS}), angles in rad; it has shape {angles.shape}")
    _checks.require_finite(angles, "joints")
    return _frames(angles)[2]


def resolved_rates(joints: Array, velocity: Array) -> Array:
    """(n, 7) joint speeds in rad/s that move the end effector with ``velocity`` (n, 3) m/s and do not turn it.

    Damped least squares on the 6-row Jacobian; O(n).
    """
    origins, axes, place = _frames(joints)
    linear = np.cross(axes, place[:, None, :] - origins)
    jacobian = np.concatenate([linear, axes], axis=2).transpose(0, 2, 1)
    twist = np.concatenate([velocity, np.zeros_like(velocity)], axis=1)[:, :, None]
    square = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING**2 * np.eye(6)
    rates = jacobian.transpose(0, 2, 1) @ np.linalg.solve(square, twist)
    return np.asarray(rates[:, :, 0])


SPEED = 0.1  # m/s along each axis
PERIOD = 0.2  # s between commands
STEP = SPEED * PERIOD  # m: how far a command should move the hand
COMMANDS = freeze(np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))))
CENTER = freeze(end_effector(HOME[None])[0])
DEAD_BAND = 0.75 * STEP  # m: an arm that moves up to 1.5 times as far as asked does not hunt about its goal
GOALS = freeze(CENTER + np.array([  # m: whole steps from home, about 0.23 m, each in another direction
    [0.16, 0.18, 0.08], [0.14, -0.18, 0.06], [-0.12, 0.18, 0.12], [-0.10, -0.16, -0.12], [0.18, 0.06, -0.14],
]))  # fmt: skip
REACH = np.array([0.24, 0.24, 0.20])  # m on either side of home: what the finite MDP covers


def goal_number(goal: object) -> int:
    """``goal`` as a row number of GOALS."""
    if isinstance(goal, bool) or not isinstance(goal, int | np.integer) or not 0 <= goal < len(GOALS):
        raise ValueError(f"goal must be in 0..{len(GOALS) - 1}, a row of GOALS; it is {_checks.show(goal)}")
    return int(goal)


class HandTask(ContinuousTask):
    """What the arm and the model of its hand share: 27 commands, the position (x, y, z) as the feature, and the cost of it."""

    actions = COMMANDS
    feature_names = ("x", "y", "z")
    feature_low = freeze(CENTER - REACH)
    feature_high = freeze(CENTER + REACH)
    periodic = (False,) * 3
    terminates = False
    is_translation_invariant = True
    default_cells = tuple((2 * np.round(REACH / STEP) + 1).astype(int).tolist())  # vertices a command's step apart
    goal: int

    def features(self, states: Array) -> Array:
        """The measured position: the first three coordinates."""
        return np.ascontiguousarray(states[:, :3])

    def towards(self, goal: int) -> Self:
        """The same with another goal."""
        return replace(self, goal=goal)  # type: ignore[type-var]

    def costs(self, states: Array) -> Array:
        """(n,) r(x) = -|x - goal| in m."""
        return np.asarray(-np.linalg.norm(states[:, :3] - GOALS[self.goal], axis=1))

    def reward_terms(self, states: Array) -> Array:
        """(n, 1) the costs."""
        return self.costs(states)[:, None]

    def reward_of(self, before: Array, actions: IntArray, after: Array) -> Array:
        """The cost of the state before the transition."""
        return before[:, 0]
