"""Newton's method for the tilt's risk, and MacKay's rule for its strengths.

f and its parts are those of ``shrinkage.ridge``. f'' is an arrow: its blocks are
diag(L_0) + sum_a G_a, beside it G_a, and G_a + diag(L_a), L (blocks, d) the penalty,
with one block where no action has parameters of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular.shrinkage._ridge import Columns, sum_covariances, tilt_rows
from oee_tabular.typing import Array, IntArray

# The largest number of steps of Newton's method.
MAX_STEPS = 50
# The tolerances of f, as shares of it: of the rounds before the last (strengths need no
# more), and of the last, which ends where only rounding is left.
ROUND_TOLERANCE = 1e-5
LAST_TOLERANCE = 1e-24
# The least share of the decrease that a step promises, for it to be taken; below the
# shortest length, as a share of Newton's step, no step is.
LEAST_DECREASE = 1e-4
SHORTEST_LENGTH = 1e-12
# The strength of a group that has practically no effect.
LARGEST_STRENGTH = 1e6
# The number of parameters, all of them 0, that the prior of a strength is worth.
HYPERPRIOR = 0.25


class Risk(NamedTuple):
    """The weighted counts: ``mass`` w n of a row, ``pulled`` sum w n_x phi_x (A, d)."""

    mass: Array
    pulled: Array


class Arrow(NamedTuple):
    """The inverted arrow f''.

    ``inverse``, (G_a + L_a)^-1, and ``gain``, (G_a + L_a)^-1 G_a, are (A, d, d), with
    no matrix where actions have no parameters of their own; ``shared`` is the inverse
    of the Schur complement, (d, d).
    """

    inverse: Array
    gain: Array
    shared: Array

    def solve(self, b: Array) -> Array:
        """Solve f'' x = b, both (blocks, d).

        x_0 = S^-1 (b_0 - sum_a G_a (G_a + L_a)^-1 b_a), x_a = (G_a + L_a)^-1 (b_a - G_a
        x_0), S the Schur complement.
        """
        own = b[1:, :, None]
        x = np.empty(b.shape)
        right = b[0] - (self.gain.transpose(0, 2, 1) @ own).sum(axis=0)[:, 0]
        x[0] = self.shared @ right
        x[1:] = (self.inverse @ own)[:, :, 0] - self.gain @ x[0]
        return x

    def diagonal(self) -> Array:
        """Compute the diagonal of f''^-1, (blocks, d)."""
        of_actions = np.diagonal(self.inverse, axis1=1, axis2=2)
        of_actions = of_actions + ((self.gain @ self.shared) * self.gain).sum(axis=2)
        return np.concatenate([np.diagonal(self.shared)[None], of_actions])


def invert_arrow(covariances: Array, penalty: Array) -> Arrow:
    """Invert f'' of covariances G (A, d, d) and the penalty L (blocks, d).

    The complement is L_0 + sum_a G_a - G_a (G_a + L_a)^-1 G_a = L_0 + sum_a G_a (G_a +
    L_a)^-1 L_a, which does not cancel.
    """
    own = penalty[1:]
    inverse = covariances[:0]
    gain = covariances[:0]
    complement = covariances
    if len(own):
        blocks = covariances.copy()
        blocks.reshape(len(own), -1)[:, :: penalty.shape[1] + 1] += own
        inverse = np.asarray(np.linalg.inv(blocks), dtype=np.float64)
        gain = inverse @ covariances
        complement = own[:, :, None] * gain
    whole = complement.sum(axis=0)
    left = np.diag(penalty[0]) + 0.5 * (whole + whole.T)
    return Arrow(inverse, gain, np.linalg.inv(left))


def differentiate(
    columns: Columns, model: Array, risk: Risk, theta: Array, penalty: Array
) -> tuple[Array, Array]:
    """Compute f' (blocks, d) and G (A, d, d) where the tilt's rows are ``model``.

    f' = L theta + sum_rows w n E[phi] - sum_x w n_x phi_x.
    """
    means, covariances = sum_covariances(columns, model, risk.mass, len(risk.pulled))
    change = means - risk.pulled
    gradient = penalty * theta[: len(penalty)]
    gradient[0] += change.sum(axis=0)
    gradient[1:] += change[: len(penalty) - 1]
    return gradient, covariances


def penalized_risk(
    columns: Columns, risk: Risk, theta: Array, penalty: Array
) -> tuple[float, Array]:
    """Compute f and the tilt's rows, f as in the docstring of ``prior.ridge``."""
    model, log_normalizer = tilt_rows(columns, theta)
    free = theta[: len(penalty)]
    value = np.vdot(risk.mass, log_normalizer)
    value -= np.vdot(risk.pulled, theta[0] + theta[1:])
    value += 0.5 * np.vdot(penalty * free, free)
    return float(value), model


def minimise(
    columns: Columns, risk: Risk, theta: Array, penalty: Array, tolerance: float
) -> tuple[Array, Array, float]:
    """Minimise f by Newton's method with backtracking: theta <- theta - t f''^-1 f'.

    It ends when a step gains less than ``tolerance`` of f or only rounding is left.
    Returns theta, G, and the bound sum f'^2 / (2 L) on f less its minimum.
    """
    value, model = penalized_risk(columns, risk, theta, penalty)
    last = np.inf
    mass = float(risk.mass.sum())
    gap = 0.0
    covariances = np.zeros(0)
    for _ in range(MAX_STEPS):
        gradient, covariances = differentiate(columns, model, risk, theta, penalty)
        step = invert_arrow(covariances, penalty).solve(gradient)
        decrement = float(np.vdot(gradient, step))
        gap = 0.5 * float(np.vdot(gradient, gradient / penalty))
        size = max(1.0, abs(value), mass)
        is_rounding = 1e-12 * size > decrement > 0.25 * last
        if not decrement > tolerance * size or is_rounding:
            break
        last = decrement
        # rounding may hide a decrease of f that is this small
        slack = 1e-13 * size if decrement < 1e-9 * size else 0.0
        # the step is halved until f decreases enough
        length = 2.0
        trial = np.inf
        moved = theta
        while (
            trial > value - LEAST_DECREASE * length * decrement + slack
            and length > SHORTEST_LENGTH
        ):
            length *= 0.5
            moved = theta.copy()
            moved[: len(step)] -= length * step
            trial, model = penalized_risk(columns, risk, moved, penalty)
        if length <= SHORTEST_LENGTH:
            break
        theta = moved
        value = trial
    return theta, covariances, gap


def update_strengths(
    theta: Array,
    arrow: Arrow,
    penalty: Array,
    scale: Array,
    group: IntArray,
    n_groups: int,
) -> Array:
    """Compute MacKay's lambda of each group of columns, (2, groups).

    lambda_g = [c + sum_j (1 - L_j (f''^-1)_jj)] / sum_j (s_j theta_j)^2, for all
    actions and for each action alone.
    """
    told = 1.0 - penalty * arrow.diagonal()
    squares = (scale * theta[: len(penalty)]) ** 2
    known = np.full((2, n_groups), HYPERPRIOR)
    size = np.zeros((2, n_groups))
    for side, blocks in enumerate((slice(0, 1), slice(1, None))):
        known[side] += np.bincount(group, told[blocks].sum(axis=0), n_groups)
        size[side] += np.bincount(group, squares[blocks].sum(axis=0), n_groups)
    return np.clip(known / np.maximum(size, 1e-300), 1.0, LARGEST_STRENGTH)


def spread_strengths(strengths: Array, scale: Array, group: IntArray) -> Array:
    """Compute the penalty L = lambda s^2 of each column, (blocks, d)."""
    side = np.minimum(np.arange(len(scale)), 1)
    return np.asarray(strengths[side][:, group] * scale**2)


def fit_tilt(
    columns: Columns,
    risk: Risk,
    theta: Array,
    strengths: Array,
    scale: Array,
    group: IntArray,
    n_rounds: int,
) -> tuple[Array, Array, Array, float]:
    """Fit theta and the strengths by ``n_rounds`` of MacKay's rule.

    Each round minimises f and then updates the strengths. Returns theta, the strengths,
    G, and the bound on f less its minimum.
    """
    for _ in range(n_rounds):
        penalty = spread_strengths(strengths, scale, group)
        theta, covariances, _ = minimise(columns, risk, theta, penalty, ROUND_TOLERANCE)
        strengths = update_strengths(
            theta,
            invert_arrow(covariances, penalty),
            penalty,
            scale,
            group,
            strengths.shape[1],
        )
    penalty = spread_strengths(strengths, scale, group)
    theta, covariances, gap = minimise(columns, risk, theta, penalty, LAST_TOLERANCE)
    return theta, strengths, covariances, gap
