"""Ratios in a class that is linear in its parameters, g = offset + Phi w: a primal-dual interior-point method, certified.

    minimise  sum_x b g - p log g  +  penalty/2 |w|^2   over w, g = offset + Phi w, lower <= g <= upper,
    and sum q g = 1 where the program is normalised.

With g and w apart, tied by g = offset + Phi w with multiplier v, the dual function at any v and eta is

    D(v, eta) = sum_x min_[lower, upper] {(b + v + eta q) g - p log g} - v . offset - |Phi^T v|^2 / (2 penalty) - eta,

each term in closed form: a lower bound on the optimum whatever v and eta are (without penalty v is first projected onto
Phi^T v = 0). The gap that is reported is the primal value at a feasible w less this. The method is a primal-dual
interior-point method from an infeasible start, with a line search on the conditions' residual [1, section 11.7] and
Mehrotra's choice of the centring [2]; a step costs O(n d^2). The slope of -p log g is a multiplier of its own, z with
z g = p, as those of the bounds are with z (g - lower) = 0: what is left of the conditions is linear, and a g that falls by
decades does not hold the steps up.

References: [1] S. Boyd and L. Vandenberghe, Convex Optimization, 2004. [2] S. Mehrotra, On the implementation of a primal-dual
interior point method, SIAM J. Optimization 2, 1992.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.ratio.statements import LinearProgram

ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class ProgramSolution:
    """w and g = offset + Phi w, the multipliers v and eta, the gap, and how far g is from the constraints."""

    weights: Array
    ratio: Array
    tie: Array
    eta: float
    gap: float
    violation: float
    iterations: int


def objective(program: LinearProgram, weights: Array, g: Array) -> float:
    """The value that is minimised."""
    seen = program.p > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = float(program.p[seen] @ np.log(g[seen]))
    return float(program.b @ g) - logs + 0.5 * program.penalty * float(weights @ weights)


def certificate(program: LinearProgram, weights: Array, g: Array, tie: Array, eta: float) -> tuple[float, float]:
    """(gap, violation) of w and g = offset + Phi w, the gap as a sum of terms that are none of them negative.

    primal - D = sum_x [l(g) - min l] + penalty/2 |w - Phi^T v / penalty|^2 - eta (sum q g - 1), with l(g) = (b + v + eta q) g -
    p log g.
    """
    if program.penalty == 0.0:
        tie = _project(program.features, tie)
        loss = 0.0
    else:
        rest = weights - program.features.T @ tie / program.penalty
        loss = 0.5 * program.penalty * float(rest @ rest)
    slope = program.b + tie + eta * program.q
    p, seen = program.p, program.p > 0
    upper = np.minimum(program.upper, program.ceiling)
    y = np.where(slope > 0, program.lower, upper)
    inside = np.divide(p, slope, out=np.full_like(slope, np.inf), where=slope > 0)
    y = np.where(seen, np.clip(inside, program.lower, upper), y)
    y = np.where(~seen & (slope == 0), g, y)
    if not np.all(np.isfinite(y)):
        return np.inf, 0.0
    step = g - y
    at_bound = (y <= program.lower) | (y >= upper)
    slope = np.where(at_bound | ~seen, slope - np.divide(p, y, out=np.zeros_like(p), where=seen), 0.0)
    u = np.divide(step, y, out=np.zeros_like(step), where=seen)
    with np.errstate(divide="ignore"):
        curve = np.where(np.abs(u) < 1e-5, u * u * (0.5 - u / 3.0 + u * u / 4.0), u - np.log1p(u))
    off = float(program.q @ g) - 1.0 if program.normalized else 0.0
    violation = max(0.0, float((program.lower - g).max()), float((g - program.upper).max()))
    return float((slope * step).sum() + (p * curve).sum()) + loss + abs(eta * off), max(abs(off), violation)


def _project(features: Array, tie: Array) -> Array:
    """``tie`` less what the (orthonormal) features see of it, twice for rounding's sake."""
    for _ in range(2):
        tie = tie - features @ (features.T @ tie)
    return tie


def nearest_miss(program: LinearProgram) -> float:
    """How far the class stays from the constraints at best (largest miss of a bound, sum q g = 1 held); inf: nowhere.

    Below 0 where it has room within the bounds, which an interior-point method needs.

    A linear program: minimise t over lower - t <= offset + Phi w <= upper + t.
    """
    n, d = program.features.shape
    ones = np.ones((n, 1))
    rows, limits = [np.hstack([-program.features, -ones])], [program.offset - program.lower]
    if np.isfinite(program.upper):
        rows.append(np.hstack([program.features, -ones]))
        limits.append(program.upper - program.offset)
    equality = np.append(program.features.T @ program.q, 0.0)[None, :] if program.normalized else None
    from scipy.optimize import linprog  # a tenth of a second

    found = linprog(
        np.append(np.zeros(d), 1.0),
        A_ub=np.vstack(rows),
        b_ub=np.concatenate(limits),
        A_eq=equality,
        b_eq=[1.0 - float(program.q @ program.offset)] if program.normalized else None,
        bounds=[(None, None)] * d + [(-1.0, None)],
    )
    return float(found.x[-1]) if found.status == 0 else np.inf


def orthonormal(features: Array) -> tuple[Array, Array]:
    """An orthonormal basis Q of the features' span, and B with features @ (B c) = Q c, B c the smallest such w."""
    left, values, right = np.linalg.svd(features, full_matrices=False)
    kept = values > 1e-10 * values.max(initial=0.0)
    return left[:, kept], right[kept].T / values[kept]


def solve(program: LinearProgram, *, tolerance: float = 1e-14) -> ProgramSolution:
    """The optimum, to a gap of ``tolerance`` times max(1, |objective|) or where rounding stops it.

    Needs lower < upper, and lower < 1 < upper where the program is normalised. Without penalty the features are first
    reduced to an orthonormal basis of their span, and the smallest w is given.
    """
    if program.penalty > 0.0:
        return _iterate(program, tolerance)
    basis, back = orthonormal(program.features)
    found = _iterate(replace(program, features=basis), tolerance)
    return replace(found, weights=back @ found.weights, tie=_project(basis, found.tie))


@dataclass(eq=False)
class _Point:
    """An iterate: w, g, its distances to the bounds and 0 (sides, n), and multipliers: of g = offset + Phi w, those, the sum.

    The distances have digits of their own: near a bound the difference g - lower has few.
    """

    w: Array
    g: Array
    room: Array
    tie: Array
    z: Array
    eta: float

    def moved(self, step: _Point, length: float) -> _Point:
        return _Point(*(getattr(self, f.name) + length * getattr(step, f.name) for f in fields(self)))

    @property
    def complementarity(self) -> float:
        """The sum of multiplier times distance over all bounds."""
        return float((self.z * self.room)[:-1].sum())


class _Linearised:
    """The optimality conditions at a point, factored for Newton steps."""

    def __init__(self, program: LinearProgram, point: _Point) -> None:
        self.program, self.point = program, point
        phi, q, g = program.features, program.q, point.g
        self.side = np.ones((len(point.z), 1))
        self.side[1:-1] = -1.0  # of the upper bound, where there is one
        self.r_g = program.b + point.eta * q - (self.side * point.z).sum(axis=0) + point.tie
        self.r_w = program.penalty * point.w - phi.T @ point.tie
        self.r_tie = g - program.offset - phi @ point.w
        self.r_one = float(q @ g) - 1.0 if program.normalized else 0.0
        self.diagonal = (point.z / point.room).sum(axis=0)

    @cached_property
    def system(self) -> _Bordered:
        """The factored matrix of Newton's steps."""
        program = self.program
        phi = program.features
        border = phi.T @ program.q if program.normalized else np.zeros(phi.shape[1])
        return _Bordered(phi, self.diagonal, program.penalty, border, program.normalized)

    def missed(self, aim: float) -> Array:
        """Multiplier times distance, less what it is to be: p for the distance to 0, ``aim`` for those to the bounds."""
        found = self.point.z * self.point.room
        found[:-1] -= aim
        found[-1] -= self.program.p
        return found

    def distance(self, aim: float) -> float:
        """The Euclidean norm of the conditions' residuals."""
        total = float(self.r_g @ self.r_g + self.r_w @ self.r_w + self.r_tie @ self.r_tie) + self.r_one**2
        return float(np.sqrt(total + (self.missed(aim) ** 2).sum()))

    def step(self, aim: float) -> _Point:
        """Newton's step."""
        phi, q, z, room = self.program.features, self.program.q, self.point.z, self.point.room
        r_z = self.missed(aim)
        rest = self.r_g + (self.side * r_z / room).sum(axis=0)
        right = -self.r_w - phi.T @ (rest - self.diagonal * self.r_tie)
        w, eta = self.system.solve(right, -self.r_one + float(q @ self.r_tie))
        g = phi @ w - self.r_tie
        tie = -rest - self.diagonal * g - eta * q
        return _Point(w, g, self.side * g, tie, (-r_z - z * self.side * g) / room, eta)

    def longest(self, step: _Point) -> float:
        """The longest length that leaves every distance and multiplier nonnegative."""
        found, point = np.inf, self.point
        for value, change in ((point.room, step.room), (point.z, step.z)):
            falling = change < 0
            found = min(found, float((-value[falling] / change[falling]).min(initial=np.inf)))
        return found


def _start(program: LinearProgram) -> _Point:
    """g = 1 or the middle of the box, and multipliers of the size of p and b."""
    n, low, high = len(program.p), program.lower, program.upper
    start = 1.0 if low < 1.0 < high else (0.5 * (low + high) if np.isfinite(high) else low + 1.0)
    g = np.full(n, start)
    room = np.array([g - low, high - g, g] if np.isfinite(high) else [g - low, g])
    fill = (float(program.p.sum()) + float(np.abs(program.b).sum())) / (2.0 * n)
    w = np.asarray(np.linalg.lstsq(program.features, g - program.offset)[0])
    return _Point(w, g, room, np.zeros(n), np.vstack([fill / room[:-1], program.p / g]), 0.0)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def _iterate(program: LinearProgram, tolerance: float) -> ProgramSolution:
    """Differs from [2] in a line search on the residual's norm [1], and in ending at the certificate, not at the residual.

    Where the class has no room within the bounds, the points reach one (0 / 0), and the search ends.
    """
    point = _start(program)
    best = ProgramSolution(point.w, point.g, point.tie, 0.0, np.inf, np.inf, 0)
    stalled, mark, local = 0, np.full(2, np.inf), _Linearised(program, point)
    for iteration in range(1, ITERATIONS + 1):
        total = point.complementarity
        if not np.isfinite(local.diagonal).all():
            break
        forward = local.step(0.0)
        after = point.moved(forward, min(1.0, local.longest(forward))).complementarity
        aim = max(min(max(after / total, 0.0), 1.0) ** 3, 0.02) * total / point.z[:-1].size
        step = local.step(aim)
        length = min(1.0, 0.99 * local.longest(step))
        before = local.distance(aim)
        for _ in range(40):
            trial = _Linearised(program, point.moved(step, length))
            if trial.distance(aim) <= (1.0 - 0.01 * length) * before or before < 1e-15:
                break
            length *= 0.5
        point, local = trial.point, trial
        found = _measure(program, local, iteration)
        if found is None:
            continue
        feasible = found.violation <= 1e-12
        better = found.gap < best.gap if feasible and best.violation <= 1e-12 else found.violation < best.violation
        best = found if better else best
        reached = np.array([best.gap if best.violation <= 1e-12 else np.inf, local.distance(0.0)])
        progress = reached < 0.7 * mark  # of the gap or of the conditions
        stalled, mark = 0 if progress.any() else stalled + 1, np.where(progress, reached, mark)
        size = max(1.0, abs(objective(program, best.weights, best.ratio)))
        if (best.violation <= 1e-12 and best.gap <= tolerance * size) or stalled >= 15:
            break
    return best


def _measure(program: LinearProgram, local: _Linearised, iteration: int) -> ProgramSolution | None:
    """The point that w gives, certified with its v, or with the one that its gradient and the bounds' multipliers suggest."""
    point = local.point
    g = program.offset + program.features @ point.w
    if not (g > 0).all():
        return None
    suggested = program.p / g - program.b - point.eta * program.q + (local.side * point.z)[:-1].sum(axis=0)
    found = [(*certificate(program, point.w, g, tie, point.eta), tie) for tie in (point.tie, suggested)]
    gap, violation, tie = min(found, key=lambda item: item[0])
    return ProgramSolution(point.w, g, tie, point.eta, gap, violation, iteration)


class _Bordered:
    """[[Phi^T D Phi + penalty I, a], [a^T, 0]], factored once."""

    def __init__(self, phi: Array, diagonal: Array, penalty: float, border: Array, bordered: bool) -> None:
        matrix = (phi * diagonal[:, None]).T @ phi
        matrix[np.diag_indices(len(border))] += penalty
        scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        self._scale = scale
        values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
        self._inverse = np.where(values > 1e-15 * values.max(initial=0.0), 1.0 / np.maximum(values, 1e-300), 0.0)
        self._vectors, self._border, self._bordered = vectors, border, bordered
        self._bent = self._once(border)

    def _once(self, right: Array) -> Array:
        x = self._scale * (self._vectors @ (self._inverse * (self._vectors.T @ (self._scale * right))))
        return np.asarray(x)

    def solve(self, right: Array, last: float) -> tuple[Array, float]:
        """(x, eta)."""
        x, curvature = self._once(right), float(self._border @ self._bent)
        eta = (float(self._border @ x) - last) / curvature if self._bordered and curvature > 0 else 0.0
        return x - eta * self._bent, eta
