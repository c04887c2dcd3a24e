"""A planar arm of two links without gravity: semi-implicit Euler steps for many states at once.

With A, B, H of the links' masses, c = cos q2 and w12 = w1 + w2,

    M(q) = [[A + B + 2 H c + armature,  B + H c], [B + H c,  B + armature]],
    (M + h damping I) (w' - w) = h (tau + H sin q2 (2 w1 w2 + w2^2, -w1^2) - damping w + drag),   q' = q + h w'.

Joint damping is taken implicitly, as MuJoCo's Euler integrator does. Drag is Bullet's: force -k m v (1 + |v|) at each centre of
mass, torque -k I w (1 + |w|). At the elbow's stop the elbow is stopped, by an impulse in that joint alone.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit


class Arm(NamedTuple):
    """What an arm is made of: the body of the upper link, of the lower link, and of the tip that the lower link carries."""

    bodies: Any  # (3, 3) mass, distance of the centre of mass from the link's joint, moment of inertia about it
    length: float
    armature: float
    damping: float
    drag: float
    stop: float


@njit(cache=True)
def steps(states, torques, arm, h, n):
    """N steps of h seconds from each row (q1, q2, w1, w2) under torques (rows, 2) held all the while."""
    bodies, length, armature, damping, drag, stop = arm
    near = bodies[0, 2] + bodies[0, 0] * bodies[0, 1] ** 2 + (bodies[1, 0] + bodies[2, 0]) * length**2
    far, cross = 0.0, 0.0
    for b in range(1, 3):
        far += bodies[b, 2] + bodies[b, 0] * bodies[b, 1] ** 2
        cross += length * bodies[b, 0] * bodies[b, 1]
    following = np.empty_like(states)
    for i in range(len(states)):
        q1, q2, w1, w2 = states[i, 0], states[i, 1], states[i, 2], states[i, 3]
        for _ in range(n):
            c, s = math.cos(q2), math.sin(q2)
            m12 = far + cross * c
            m11 = near + far + 2.0 * cross * c + armature
            m22 = far + armature
            f1 = torques[i, 0] + cross * s * (2.0 * w1 * w2 + w2 * w2) - damping * w1
            f2 = torques[i, 1] - cross * s * w1 * w1 - damping * w2
            if drag > 0.0:
                w12 = w1 + w2
                speed = abs(bodies[0, 1] * w1)
                f1 -= drag * bodies[0, 0] * bodies[0, 1] ** 2 * w1 * (1.0 + speed)
                f1 -= drag * bodies[0, 2] * w1 * (1.0 + abs(w1))
                for b in range(1, 3):
                    r = bodies[b, 1]
                    u, v = length * w1, r * w12  # the centre's velocity along the normals of the two links
                    speed = math.sqrt(max(u * u + v * v + 2.0 * u * v * c, 0.0))
                    k = drag * bodies[b, 0] * (1.0 + speed)
                    lower = k * r * (v + u * c)
                    turn = drag * bodies[b, 2] * w12 * (1.0 + abs(w12))
                    f1 -= k * length * (u + v * c) + lower + turn
                    f2 -= lower + turn
            a11, a22 = m11 + h * damping, m22 + h * damping
            det = a11 * a22 - m12 * m12
            w1 = w1 + h * (a22 * f1 - m12 * f2) / det
            w2 = w2 + h * (a11 * f2 - m12 * f1) / det
            q1 = q1 + h * w1
            q2 = q2 + h * w2
            if abs(q2) > stop:
                q2 = math.copysign(stop, q2)
                if w2 * q2 > 0.0:
                    w1 = w1 + m12 / m11 * w2
                    w2 = 0.0
        following[i, 0], following[i, 1], following[i, 2], following[i, 3] = q1, q2, w1, w2
    return following
