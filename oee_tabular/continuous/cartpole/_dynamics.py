"""The cart and the pole: Euler steps of Gymnasium's CartPole, operation for operation, for many states at once.

Every product, quotient and sum stands in the order of Gymnasium's own ``step``, so that the results agree to the last bit.
"""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def steps(states, pushes, shifts, gravity, x_limit, angle_limit):
    """One step of 0.02 s from each row (x, x', theta, theta'): the next states, and which of them are over.

    ``pushes`` are forces in newton; ``shifts`` (n, 4) are added to the next state before it is judged.
    """
    masspole, length, tau = 0.1, 0.5, 0.02
    total_mass = 0.1 + 1.0
    polemass_length = masspole * length
    following = np.empty_like(states)
    over = np.empty(len(states), dtype=np.bool_)
    for i in range(len(states)):
        x, x_dot, theta, theta_dot = states[i, 0], states[i, 1], states[i, 2], states[i, 3]
        cosine, sine = math.cos(theta), math.sin(theta)
        temp = (pushes[i] + polemass_length * (theta_dot * theta_dot) * sine) / total_mass
        theta_acc = (gravity * sine - cosine * temp) / (
            length * (4.0 / 3.0 - masspole * (cosine * cosine) / total_mass)
        )
        x_acc = temp - polemass_length * theta_acc * cosine / total_mass
        x = x + tau * x_dot + shifts[i, 0]
        x_dot = x_dot + tau * x_acc + shifts[i, 1]
        theta = theta + tau * theta_dot + shifts[i, 2]
        theta_dot = theta_dot + tau * theta_acc + shifts[i, 3]
        following[i, 0], following[i, 1], following[i, 2], following[i, 3] = x, x_dot, theta, theta_dot
        over[i] = x < -x_limit or x > x_limit or theta < -angle_limit or theta > angle_limit
    return following, over
