"""Ratios in linear and kernel classes: g = Phi w for two distributions, zeta = 1 + Phi w for a simulator's rows.

For zeta the features are centred in each row, sum_s' P(s' | s, a) phi(s, a, s') = 0, so that rows of zeta * P sum to 1
for every w; the program is

    minimise  sum_s,a (n_sa / n) sum_s' P zeta - (1/n) sum n_sas' log zeta + ridge/2 |w|^2,   lower <= zeta <= upper,

the KL risk of the counts; with ridge = 1/n (the default) the penalty is worth one move: a unit Gaussian prior on w, for a
kernel a Gaussian process of unit amplitude around the simulator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio import interior, statements
from oee_tabular.ratio.arguments import Box, check_box, check_ridge
from oee_tabular.ratio.features import Kernel, cell_features, feature_array, gaussian, kernel_features, warn_of_rank
from oee_tabular.ratio.interior import ProgramSolution
from oee_tabular.ratio.method import Given, Method
from oee_tabular.ratio.result import Held, Influence, Part, TransitionRatio
from oee_tabular.ratio.sgd import Sgd, SgdTrace, descend_linear
from oee_tabular.ratio.statements import LinearProgram

N_CENTERS = 200


def solve_class(program: LinearProgram, solver: str) -> ProgramSolution:
    """The optimum by the interior-point method or by a cvxpy solver, with its gap.

    What the constraints, and g = offset + Phi w, are missed by counts in the gap as it is.
    ValueError where no function of the class meets the constraints, RuntimeError where the method stops before it does.
    """
    if solver == "dual":
        found = interior.solve(program)
    else:
        weights, tie, eta = statements.solve_linear(program, solver=solver)
        g = program.offset + program.features @ weights
        judged = program
        if program.penalty == 0.0:
            judged = replace(program, features=interior.orthonormal(program.features)[0])
        gap, violation = interior.certificate(judged, weights, np.maximum(g, 1e-300), tie, eta)
        found = ProgramSolution(weights, g, tie, eta, gap, violation, 0)
    if not found.violation <= 1e-7:
        miss = interior.nearest_miss(program)
        if miss > -1e-9:
            above, below = ("at least", "at most") if miss > 1e-9 else ("above", "below")
            upper = f" and {below} {program.upper:g}" if np.isfinite(program.upper) else ""
            one = ", with sum q g = 1" if program.normalized else ""
            nearest = f"the nearest misses by {miss:g}" if miss > 1e-9 else "none is at all points"
            raise ValueError(
                f"features must span a function that is {above} {program.lower:g}{upper}{one}; {nearest} "
                "(a constant feature makes one)"
            )
        raise RuntimeError(f"the interior-point method ended {found.violation:.1e} away from the constraints")
    missed = found.violation + float(np.abs(program.offset + program.features @ found.weights - found.ratio).max())
    return replace(found, ratio=np.clip(found.ratio, program.lower, program.upper), gap=found.gap + missed)


def class_features(
    features: object, kernel: str | Kernel | None, coordinates: ArrayLike | None, n_centers: int, n: int
) -> tuple[Array, dict[str, Any]]:
    """(n, d) features of n cells from the user's, or from a kernel on the cells' coordinates."""
    if features is not None:
        for value, name in ((kernel, "kernel"), (coordinates, "coordinates")):
            if value is not None:
                raise ValueError(f"{name} must not be given with features; the two are different classes")
        array = cell_features(features, n)
        return array, {"feature_rank": warn_of_rank(array)}
    if coordinates is None:
        raise ValueError("coordinates must be given with kernel: the points that the entries of p and q stand for")
    points = _checks.float_array(coordinates, "coordinates", ndim=(1, 2))
    _checks.require_finite(points, "coordinates")
    if len(points) != n:
        raise ValueError(f"coordinates must have {n} rows, one for each entry of p; they have {len(points)}")
    chosen = _standard_gaussian(points.reshape(n, -1)) if isinstance(kernel, str) else kernel
    _check_kernel(kernel)
    assert callable(chosen)
    space = kernel_features(points.reshape(n, -1), chosen, n_centers=n_centers)
    return space.matrix, {"kernel_residual": space.residual, "centers": space.pivots}


def _check_kernel(kernel: object) -> None:
    if not callable(kernel):
        _checks.one_of(kernel, "kernel", ("gaussian",))


def _standard_gaussian(points: Array, bandwidth: float = 1.0) -> Kernel:
    """Gaussian in units of each coordinate's standard deviation over the points."""
    size = points.std(axis=0)
    size = np.where(size > 0, size, 1.0)
    base = gaussian(bandwidth)
    return lambda x, c: base(x / size, c / size)


def fit_cells(
    p: Array,
    q: Array,
    features: Array,
    *,
    box: Box,
    ridge: float,
    normalized: bool,
    solver: str,
    sgd: Sgd | None,
    seed: Seed = None,
) -> tuple[LinearProgram, ProgramSolution, SgdTrace | None]:
    """g = Phi w for distributions p and q on the same cells; the program, its solution and the trace of "sgd"."""
    _refuse_thin_box(box, normalized)
    program = LinearProgram(
        b=q,
        p=p,
        q=q,
        offset=np.zeros(len(p)),
        features=features,
        penalty=ridge,
        lower=box.lower,
        upper=box.upper,
        normalized=normalized,
        ceiling=implied_bound(q, box.lower) if normalized else np.full(len(p), np.inf),
    )
    if sgd is None:
        return program, solve_class(program, solver), None
    best = solve_class(program, "dual")
    weights, trace = descend_linear(program, best, sgd, seed)
    g = np.clip(features @ weights, box.lower, box.upper)
    return program, replace(best, weights=weights, ratio=g, gap=float(trace.excess[-1]) + best.gap), trace


def implied_bound(weights: Array, lower: float) -> Array:
    """The largest g_x that sum weights g = 1 leaves, weights summing to 1 and g >= lower."""
    room = 1.0 - lower * (1.0 - weights)
    return np.divide(room, weights, out=np.full_like(weights, np.inf), where=weights > 0)


def _refuse_thin_box(box: Box, normalized: bool) -> None:
    if not box.lower < box.upper or (normalized and not box.lower < 1.0 < box.upper):
        rule = "lower < 1 < upper" if normalized else "lower < upper"
        raise ValueError(f"the box of a linear class must have {rule}; it is [{box.lower:g}, {box.upper:g}]")


def move_points(simulator: FiniteMDP, coordinates: ArrayLike) -> Array:
    """(entries, 1 + 2c): the action, the coordinates of s, and the displacement, of each of the simulator's moves."""
    places = _checks.float_array(coordinates, "coordinates", ndim=(1, 2))
    _checks.require_finite(places, "coordinates")
    if len(places) != simulator.n_states:
        raise ValueError(f"coordinates must have {simulator.n_states} rows, one a state; they have {len(places)}")
    places = places.reshape(simulator.n_states, -1)
    rows = Rows.of(simulator)
    start = rows.spread(places[rows.state])
    return np.column_stack([rows.spread(rows.action), start, places[rows.arrival] - start])


def _move_kernel(points: Array, bandwidth: float) -> Kernel:
    """1[same action] times a Gaussian in the standardised coordinates and displacements."""
    smooth = _standard_gaussian(points[:, 1:], bandwidth)
    return lambda x, c: (x[:, :1] == c[:, 0]) * smooth(x[:, 1:], c[:, 1:])


@dataclass(frozen=True, eq=False)
class InClass(Method):
    """zeta = 1 + Phi w, all rows sharing w: the module's program. Rows of zeta * P sum to 1.

    Parameters
    ----------
    features : an array aligned with ``simulator.transitions.data``, one of shape (S, A, S) or (S, A, S, d), a function of
        (s, a, s'), or a data frame (columns state, action, next_state, by number or name, and one a feature); or instead of it
    kernel : "gaussian" (moves of one action are alike as the coordinates of s and the displacements to s' are), or a function
        of (m, 1 + 2c) and (k, 1 + 2c) points (action, coordinates of s, displacement) giving an (m, k) array
    coordinates : (S,) or (S, c), where each state is; with a kernel
    bandwidth : of the Gaussian, in standard deviations
    n_centers : moves beyond which the kernel is replaced by its pivoted Cholesky approximation, whose error is in ``details``
    lower, upper : bounds on zeta; None: 0 and no bound
    ridge : ridge/2 * |w|^2 in the risk per move; None: 1 / n, worth one move
    solver : "dual", or a cvxpy solver

    Notes
    -----
    Limit: the member of the class nearest to the target in KL risk. Cost: about fifteen steps of O(nnz d^2).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> InClass(features=lambda s, a, following: following).fit(log, simulator).values.data.round(2).tolist()
    [0.81, 1.19, 0.81, 1.19]
    """

    features: Any = field(default=None, repr=False)
    kernel: str | Kernel | None = None
    coordinates: Any = field(default=None, repr=False)
    bandwidth: float = 1.0
    n_centers: int = N_CENTERS
    lower: float | None = None
    upper: float | None = None
    ridge: float | Callable[[float], float] | None = None
    solver: str = "dual"

    def __post_init__(self) -> None:
        _checks.instance(self.solver, str, "solver")
        if isinstance(self.ridge, str):
            raise ValueError(
                f"ridge must be a number or a function of n with method {self._name!r}; got {_checks.show(self.ridge)}"
            )
        if self.kernel is None:
            if self.features is None:
                raise ValueError('features must be given with method "linear"')
            if self.coordinates is not None:
                raise ValueError("coordinates must be given with a kernel; none is given")
        else:
            if self.features is not None:
                raise ValueError("features must be left out with a kernel: the two are different classes")
            _check_kernel(self.kernel)
            if self.coordinates is None:
                raise ValueError('coordinates must be given with method "kernel": (S,) or (S, c), where each state is')
        _checks.positive_integer(self.n_centers, "n_centers")
        _refuse_thin_box(check_box(self.lower, self.upper, normalized=True), True)

    @property
    def _name(self) -> str:
        return "linear" if self.kernel is None else "kernel"

    def _fit(self, given: Given) -> TransitionRatio:
        observed, simulator, rows = given.observed, given.simulator, given.rows
        box, q = check_box(self.lower, self.upper, normalized=True), rows.weights
        details: dict[str, object] = {}
        if self.kernel is None:
            phi = rows.center(feature_array(self.features, simulator))
            details["feature_rank"] = warn_of_rank(phi, where=" within rows")
        else:
            points = move_points(simulator, self.coordinates)
            chosen = _move_kernel(points, self.bandwidth) if isinstance(self.kernel, str) else self.kernel
            space = kernel_features(points, chosen, n_centers=self.n_centers, center=rows.center)
            phi = space.matrix
            details |= {"kernel_residual": space.residual, "centers": points[space.pivots]}
        n = float(observed.sum())
        lam = 1.0 / n if self.ridge is None else check_ridge(self.ridge, n)
        mass = rows.spread(rows.sums(observed) / n) * q
        program = LinearProgram(
            b=mass,
            p=observed / n,
            q=mass,
            offset=np.ones(len(mass)),
            features=phi,
            penalty=lam,
            lower=box.lower,
            upper=box.upper,
            normalized=False,
            ceiling=implied_bound(q, box.lower),
        )
        found = solve_class(program, self.solver)
        zeta = found.ratio
        safe = np.maximum(zeta, 1e-12)
        details |= {"weights": found.weights, "ridge": lam, "lower": box.lower, "upper": box.upper}
        information = (phi * (observed / safe**2)[:, None]).T @ phi + n * lam * np.eye(phi.shape[1])
        part = Part(self._name, 1.0, 0.0, Held(zeta * q, phi / safe[:, None]), rows, information, gap=found.gap)
        influence = Influence(rows, observed, zeta, q / safe, np.zeros(len(rows)), (part,))
        return given.ratio(zeta, self._name, found.gap, details, influence)
