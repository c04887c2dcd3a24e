"""Value iteration and plain BiCGSTAB, for graphs where a few steps lead far.

The rows of K have one sum s. Value iteration goes on until the change is the same in
all states, which is then summed [1, 6.6.3]:

    x_{n+1} = b + gamma K x_n
    x* = x_{n+1} + c / (1 - c) (x_{n+1} - x_n),    c = gamma s.

The transposed sweeps keep the sum of the residual of x, so that they begin with an x of
the right sum: sum(x*) = sum(b) / (1 - c).

BiCGSTAB [2] is given the system from which the eigenvalue 1 - c is taken, M' = M + c
11^T / n:

    M' y = b  ->  x = y + c mean(y) / (1 - c)
    M'^T x = b + c sum(b) / (1 - c) / n

M 1 = (1 - c) 1, so that constants are solved for at once, and the discount does not
matter. 1^T M'^T = 1^T: transposed systems begin with y = b, whose residual has the sum
0. (Residuals begin as the vector that later ones are held against; an eigenvector
there, as an even b is, would end the iteration.) The vector updates and dot products of
a step ride on four passes; the sum of a vector is taken where it is made.

References: [1] Puterman, Markov Decision Processes, 1994. [2] van der Vorst, Bi-CGSTAB,
SIAM J. Sci. Stat. Comput. 13 (1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.exact._system import multiply
from oee_tabular.exact.system import Solve, System

PLAIN_RESIDUAL_FLOOR = 4e-16  # the least residual relative to x
# steps in which the residual is to fall to a tenth: small worlds near discount 1 take
# 100
N_WINDOW_STEPS = 150


@dataclass(frozen=True)
class ValueIteration:
    """Value iteration: some dozen sweeps over a graph that mixes.

    Random MDPs with 5 next states take .6 of the time of plain BiCGSTAB, measured on 10
    000 states with the policies of tests/benchmarks/values.py. It gives up as soon as
    four sweeps leave more than .45 of the spread of the states' changes; from there on
    plain BiCGSTAB is as fast.
    """

    name: str = "value iteration"
    is_direct: bool = False

    def suits(self, system: System) -> bool:
        """Return whether rows have one sum, so that constants stay constant."""
        return system.shared_sum is not None

    def prepare(self, system: System) -> Solve:
        """Return the sweeps; nothing is computed before."""
        return partial(sweep, system.kernel, system.shared_sum, system.transpose)


@njit(cache=True)
def sweep(kernel, mass, transpose, b, relative):
    """Solve by x_{n+1} = b + gamma K x_n, for rows with the sum ``mass``.

    Returns None where four sweeps leave more than .45 of the spread of the change.
    """
    n = len(b)
    carried = kernel.discount * mass
    over = carried / (1.0 - carried)
    # term by term: numpy's own mean differs from the compiled one in the last bit
    mean = 0.0
    for i in range(n):
        mean += b[i]
    mean /= n
    x = b + (over * mean if transpose else 0.0)
    new = np.empty(n)
    # rounding grows with the entries of a row
    allowed = np.inf
    floor = 8e-16 * max(1.0, 0.125 * np.sqrt(len(kernel.indices) / n))
    # a sweep, the range of its changes, and whether they still get closer to each other
    for turn in range(200):
        multiply(kernel.indptr, kernel.indices, kernel.data, transpose, x, new)
        low = np.inf
        high = -np.inf
        largest = 0.0
        for i in range(n):
            value = b[i] + kernel.discount * new[i]
            new[i] = value
            change = value - x[i]
            low = min(low, change)
            high = max(high, change)
            largest = max(largest, abs(value))
        x, new = new, x
        spread = high - low
        shift = 0.0 if transpose else over * (0.5 * (low + high))
        failing = turn % 4 == 0 and not spread <= allowed
        near = max(relative, floor) * max(largest, abs(shift))
        # the spread is small, or rounding keeps it from falling any more
        if spread <= near or (failing and spread <= 64.0 * near):
            return x + shift
        if failing:
            return None
        if turn % 4 == 0:
            allowed = 0.45 * spread
    return None


@dataclass(frozen=True)
class PlainBiCGStab:
    """BiCGSTAB without a preconditioner, for graphs where a few steps lead everywhere.

    An incomplete LU has next to nothing of the inverse of such a graph. Random graphs
    of 10 000 states that value iteration leaves (2 next states; blocks that seldom
    meet) take a third of the time of ``BiCGStab``, near discount 1 down to a hundredth.
    It gives up where the residual does not fall to a tenth in 150 steps.
    """

    window: int = N_WINDOW_STEPS
    least_entries: float = 0.0
    name: str = "BiCGSTAB"
    is_direct: bool = False

    def suits(self, system: System) -> bool:
        """Return whether the graph expands, by a search that ends early."""
        if len(system.kernel.indices) < self.least_entries * system.n_states:
            return False
        return system.expands

    def prepare(self, system: System) -> Solve:
        """Return the iteration; nothing is computed before."""
        return partial(
            solve,
            system.kernel,
            system.kernel.discount * (system.shared_sum or 0.0),
            system.transpose,
            self.window,
        )


@njit(cache=True)
def product(kernel, transpose, constant, p, first, out):
    """Compute out = M p + constant, or M^T p + constant.

    Returns the dot products first . out, p . out and out . out.
    """
    multiply(kernel.indptr, kernel.indices, kernel.data, transpose, p, out)
    with_first = 0.0
    with_p = 0.0
    with_out = 0.0
    for i in range(len(p)):
        value = p[i] + (constant - kernel.discount * out[i])
        out[i] = value
        with_first += first[i] * value
        with_p += p[i] * value
        with_out += value * value
    return with_first, with_p, with_out


@njit(cache=True)
def bicgstab(kernel, transpose, shared, b, relative, window):
    """Solve M' y = b by BiCGSTAB.

    With rho = first . r: alpha = rho / (first . M' p), s = r - alpha M' p, omega = (s .
    M' s) / |M' s|^2, y += alpha p + omega s, r = s - omega M' s, p = r + beta (p -
    omega M' p). It ends when the residual is below ``relative`` times b's, or below the
    floor. Returns None where it does not fall to a tenth in 150 steps.
    """
    n = len(b)
    part = shared / len(b)
    x = np.zeros(n)
    first = b.copy()
    v = np.empty(n)
    w = np.empty(n)
    # transposed systems begin with y = b, all others with y = 0
    if transpose:
        product(kernel, transpose, part * b.sum(), b, first, v)
        x = first
        first = b - v
    r = first.copy()
    p = first.copy()
    sum_p = first.sum()
    rho = 0.0
    goal = 0.0
    largest = 0.0
    largest_x = 0.0
    allowed = np.inf
    steps = 0
    for i in range(n):
        rho += r[i] * r[i]
        goal = max(goal, relative * abs(b[i]))
        largest = max(largest, abs(r[i]))
        largest_x = max(largest_x, abs(x[i]))
    while largest > max(goal, PLAIN_RESIDUAL_FLOOR * largest_x):
        if steps % window == 0:
            if not largest <= allowed:
                return None
            allowed = 0.1 * largest
        steps += 1
        along, _, _ = product(kernel, transpose, part * sum_p, p, first, v)
        if along == 0.0 or not np.isfinite(along):
            break
        alpha = rho / along
        sum_s = 0.0
        first_s = 0.0
        for i in range(n):
            r[i] -= alpha * v[i]  # the half step's residual
            sum_s += r[i]
            first_s += first[i] * r[i]
        # w = M' s, and the step that makes the residual least along it
        first_w, ws, ww = product(kernel, transpose, part * sum_s, r, first, w)
        omega = ws / ww if ww > 0.0 else 0.0
        new = first_s - omega * first_w
        # beta is 0 where there is nowhere to go: y stands, and is refined
        beta = (new / rho) * (alpha / omega) if omega != 0.0 and rho != 0.0 else 0.0
        rho = new
        largest = 0.0
        largest_x = 0.0
        sum_p = 0.0
        for i in range(n):
            x[i] += alpha * p[i] + omega * r[i]
            r[i] -= omega * w[i]
            p[i] = r[i] + beta * (p[i] - omega * v[i])
            sum_p += p[i]
            largest = max(largest, abs(r[i]))
            largest_x = max(largest_x, abs(x[i]))
        if beta == 0.0 or not np.isfinite(beta):
            break
    return x


@njit(cache=True)
def solve(kernel, shared, transpose, window, b, relative):
    """Solve M x = b by ``bicgstab`` and add the constant that was taken out.

    ``shared`` is gamma s, or 0 where rows differ in their sums.
    """
    over = shared / (1.0 - shared)
    if transpose:
        return bicgstab(kernel, True, shared, b + over * b.mean(), relative, window)
    y = bicgstab(kernel, False, shared, b, relative, window)
    return None if y is None else y + over * y.mean()
