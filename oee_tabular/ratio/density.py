"""The ratio of two distributions by the dual of the KL divergence (eq. 3.6 and 3.7).

Reference ([1] is that of ``oee_tabular.ratio``): [2] T. Kanamori, S. Hido and M.
Sugiyama, A least-squares approach to direct importance estimation, JMLR 10, 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio import dual, statements
from oee_tabular.ratio.dual import Box, check_box, check_ridge, check_weights
from oee_tabular.ratio.functions import (
    FunctionClass,
    Kernel,
    Linear,
    Table,
    check_functions,
    class_features,
)
from oee_tabular.ratio.linear import fit_cells
from oee_tabular.ratio.sgd import Sgd, SgdTrace, descend
from oee_tabular.typing import Array, RealArrayLike, Seed

# The largest gap, in nats, of a fit that is called "optimal".
OPTIMAL_GAP_NATS = 1e-8
# The default class of functions.
TABLE = Table()
# Keywords of the first edition, and what is written in place of each.
RENAMED = {
    "features": "functions=Linear(features)",
    "kernel": "functions=Kernel(coordinates, kernel)",
    "coordinates": "functions=Kernel(coordinates)",
    "n_centers": "functions=Kernel(coordinates, n_centers=...)",
    "step_size": "solver=Sgd(step_size)",
    "batch_size": "solver=Sgd(batch_size=...)",
    "n_iterations": "solver=Sgd(n_iterations=...)",
}


@checked(shapes={"ratio": "n"})
@dataclass(frozen=True)
class RatioFit:
    """A fitted ratio and its certificate.

    Attributes
    ----------
    ratio : ndarray of shape (n,)
        The fitted ratio, beta = dP/dQ.
    objective : float
        Value of the program at ``ratio``, p and q scaled to sum to 1.
    dual_bound : float
        A lower bound on the program's optimum, from the multiplier.
    gap : float
        objective - dual_bound >= 0, absolute, in nats, computed without cancellation.
    normalizer : float
        Multiplier of sum q g = 1 (0 if it does not bind or is not imposed).
    divergence : float
        The dual estimate of KL(p || q), sum p log g - sum q g + 1, in nats.
    n_undetermined : int
        Number of entries with p = q = 0, which the data do not determine.
    p_total : float
        Sum of the given p, before it was scaled to 1.
    q_total : float
        Sum of the given q, before it was scaled to 1.
    status : str
        "optimal", or "inaccurate: the gap is ..." if the gap exceeds 1e-8 (a box within
        rounding of 1, features of many scales).
    trace : SgdTrace or None
        The iterations of Algorithm 1; None with another solver.
    weights : ndarray of shape (d,) or None
        The parameters w of a linear or kernel class, g = Phi w; None for tables.
    details : dict
        For a class: the features' rank, or the kernel's centres and the part of its
        Gram matrix that they leave.
    enclosure : tuple of two ndarrays of shape (n,)
        Lower and upper ends with the exact minimiser between them, entry by entry: from
        the bracket of the multiplier with "dual", else the box.

    Examples
    --------
    >>> fit = density_ratio([3, 1], [2, 2], upper=1.2)
    >>> fit.ratio.round(6).tolist(), fit.gap < 1e-12, fit.status
    ([1.2, 0.8], True, 'optimal')
    """

    ratio: Array
    objective: float
    dual_bound: float
    gap: float
    normalizer: float
    divergence: float
    n_undetermined: int
    p_total: float
    q_total: float
    status: str
    trace: SgdTrace | None = None
    weights: Array | None = None
    details: dict[str, Any] = field(default_factory=dict)
    enclosure: tuple[Array, Array] = field(
        default=(np.empty(0), np.empty(0)), repr=False
    )

    def __str__(self) -> str:
        """Return one sentence about the fit."""
        low = self.ratio.min() if len(self.ratio) else np.nan
        high = self.ratio.max() if len(self.ratio) else np.nan
        return (
            f"ratio p / q of {len(self.ratio)} cells, without unit, from {low:.4g} to"
            f" {high:.4g}; KL(p || q) about {self.divergence:.4g} nats; gap"
            f" {self.gap:.1e} nats; {self.status}"
        )

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        rows: list[tuple[str, object]] = [
            ("cells", len(self.ratio)),
            ("undetermined cells", self.n_undetermined),
            ("gap (nats)", f"{self.gap:.1e}"),
            ("KL(p || q), dual estimate (nats)", f"{self.divergence:.6g}"),
            ("status", self.status),
        ]
        return _printing.facts(
            "RatioFit: p / q, both scaled to sum to 1, without unit", rows
        )


@suggest_keywords(renamed=RENAMED)
@one_thread
def density_ratio(
    p: RealArrayLike,
    q: RealArrayLike,
    *,
    lower: float | None = None,
    upper: float | None = None,
    ridge: float | Callable[[float], float] = 0.0,
    toward: float | None = None,
    normalized: bool = True,
    loss: Literal["kl", "chi2"] = "kl",
    functions: FunctionClass = TABLE,
    solver: str | Sgd = "dual",
    seed: Seed = None,
) -> RatioFit:
    """Estimate the ratio p/q as the solution of a convex program.

    minimise  sum q g - sum p log g + (ridge/2) I(g)^2  over  lower <= g <= upper,  and
    sum q g = 1 if normalized,

    eq. 3.7, the negative of eq. 3.6. I(g)^2 = sum g^2, the paper's, where
    ``toward`` is None, else sum q (g - toward)^2.

    Parameters
    ----------
    p : array-like of shape (n,)
        Nonnegative counts or probabilities; scaled to sum to 1 (``p_total`` is the
        original sum).
    q : array-like of shape (n,)
        Nonnegative counts or probabilities of the same entries; scaled to sum to 1
        (``q_total`` is the original sum).
    lower : float, optional
        The paper's nu. None means 0.
    upper : float, optional
        The paper's mu. None means no bound.
    ridge : float or callable, default 0.0
        Nonnegative strength of the penalty, or a function of n (the sum of p).
    toward : float, optional
        The number that the ridge pulls g to. None means the paper's penalty sum g^2.
    normalized : bool, default True
        Whether sum q g = 1 is imposed.
    loss : {'kl', 'chi2'}, default 'kl'
        'kl' is the paper's; 'chi2' is least squares (LSIF [2]), sum q g^2 / 2 - sum p g
        in place of the first two terms.
    functions : Table, Linear or Kernel, default Table()
        The class of functions g. ``Table()``: one parameter an entry.
        ``Linear(features)``: g = Phi w, with ridge/2 times the squared length of w.
        ``Kernel(coordinates)``: expansions of a kernel, with ridge/2 times the squared
        norm.
    solver : str or Sgd, default 'dual'
        'dual' (structured, exact; for classes Clarabel), the name of a cvxpy solver
        ('CLARABEL', 'SCS'), or ``Sgd(...)``: the paper's Algorithm 1, for what training
        adds to the error (tables, normalized=False, a box with 0 < lower and finite
        upper). 'sgd' is ``Sgd()``.
    seed : int, Generator or None, optional
        Seed of the draws of ``Sgd``.

    Returns
    -------
    RatioFit
        Without box, ridge and normalisation exactly p/q. Entries with p = q = 0 are no
        part of the program; they get ``toward`` (1 where it is None), clipped to the
        box.

    Raises
    ------
    ValueError
        If q = 0 < p with neither an upper bound nor a ridge towards 0 (the program is
        unbounded; the entries are named), if lower > upper, if the box excludes the
        normalisation, if weights are negative or all zero, if the solver is not
        installed, or if features are of another length or span no function in the box.
    RuntimeError
        If the cvxpy solver stopped short of "optimal", or if a class has no minimum.

    See Also
    --------
    transition_ratio : The ratio of transition probabilities from a log.
    check_assumptions : The paper's assumptions for p, q and a box.

    Notes
    -----
    Cost: O(n) times a few Newton steps with 'dual'; with features, solved by Clarabel,
    about forty steps of O(n d^2).

    Examples
    --------
    >>> fit = density_ratio([3, 1], [2, 2])
    >>> fit.ratio.tolist(), fit.gap
    ([1.5, 0.5], 0.0)
    """
    _checks.instance(solver, (str, Sgd), "solver", "name or Sgd(...)")
    method = Sgd() if solver == "sgd" else solver
    _checks.boolean(normalized, "normalized")
    _checks.generator(seed)  # used by some solvers, checked with all
    p_weights, q_weights = check_weights(p, q)
    n = len(p_weights)
    p_total = float(p_weights.sum())
    q_total = float(q_weights.sum())
    _checks.one_of(loss, "loss", ("kl", "chi2"))
    box = check_box(lower, upper, normalized=normalized)
    strength = check_ridge(ridge, p_total)
    center = 0.0 if toward is None else _checks.number_in(toward, "toward", 0.0, np.inf)
    check_functions(functions)
    # Entries with p = q = 0 are left out, except of a class, which has a value there.
    known: Any = slice(None)
    if isinstance(functions, Table):
        has_weight = (p_weights > 0) | (q_weights > 0)
        known = known if has_weight.all() else has_weight
    else:
        _check_class(toward, loss, method)
    ps = p_weights[known] / p_total
    qs = q_weights[known] / q_total
    curvature = np.full(len(ps), strength) if toward is None else strength * qs
    program = dual.Coordinates(
        ps, qs, curvature, np.full(len(ps), center), squares=loss == "chi2"
    )
    if isinstance(functions, Table):
        _refuse_unbounded(np.arange(n)[known], program, box)
        found = _solve_table(program, box, normalized, method, seed)
    else:
        # The ridge of a class is on its parameters.
        program = program._replace(curvature=np.zeros(n))
        found = _solve_class(program, box, normalized, functions, strength, method)
    g = found.ratio
    if not (np.isfinite(g).all() and np.isfinite([found.gap, found.penalty]).all()):
        raise ValueError(
            "the program must have numbers that double precision holds; ridge"
            f" {strength:g} towards {center:g} in the box [{box.lower:g},"
            f" {box.upper:g}] does not give a finite ratio"
        )
    elsewhere = 1.0 if toward is None else center
    ratio = np.full(n, min(max(elsewhere, box.lower), box.upper))
    below = ratio.copy()
    above = ratio.copy()
    risk = program.risk(g)
    ratio[known] = g
    below[known] = found.below
    above[known] = found.above
    status = f"inaccurate: the gap is {found.gap:.1e}"
    if found.gap <= OPTIMAL_GAP_NATS:
        status = "optimal"
    return RatioFit(
        ratio=_checks.freeze(ratio),
        objective=risk + found.penalty,
        dual_bound=risk + found.penalty - found.gap,
        gap=found.gap,
        normalizer=found.multiplier,
        # Least squares estimate no KL divergence.
        divergence=float("nan") if program.squares else 1.0 - risk,
        n_undetermined=n - len(ps),
        p_total=p_total,
        q_total=q_total,
        status=status,
        trace=found.trace,
        weights=found.weights,
        details=found.details,
        enclosure=(below, above),
    )


class _Solution(NamedTuple):
    """A solved program: g, the multiplier of sum q g = 1, the gap and the penalty.

    The exact minimiser is between ``below`` and ``above``.
    """

    ratio: Array
    multiplier: float
    gap: float
    penalty: float
    below: Array | float
    above: Array | float
    details: dict[str, Any]
    trace: SgdTrace | None = None
    weights: Array | None = None


def _solve_table(
    program: dual.Coordinates,
    box: Box,
    normalized: bool,
    method: str | Sgd,
    seed: Seed,
) -> _Solution:
    """Solve the program of a table by its dual, by cvxpy or by Algorithm 1."""
    whole = np.array([0, len(program.p)])
    # m is the multiplier of sum q g = 1, plus 1.
    m = 1.0
    below: Array | float = box.lower
    above: Array | float = box.upper
    trace = None
    if isinstance(method, Sgd):
        _check_sgd(box, normalized, program.squares)
        g, trace = descend(program, *box, method, seed)
    elif method != "dual":
        g, multiplier = statements.solve_rows(
            program, *box, whole if normalized else None, solver=method
        )
        m += float(multiplier.sum())
    elif normalized:
        solution = dual.solve_rows(program, *box, whole)
        g = solution.ratio
        m = float(solution.m[0])
        below = solution.below
        above = solution.above
    else:
        g = dual.solve_free(program, *box)
        below = g
        above = g
    multiplier_plus_one = np.array([m]) if normalized else None
    gap = float(dual.row_gaps(program, g, multiplier_plus_one, *box, whole)[0])
    with np.errstate(over="ignore", invalid="ignore"):
        penalty = program.penalty(g)
    return _Solution(g, m - 1.0, gap, penalty, below, above, {}, trace)


def _solve_class(
    program: dual.Coordinates,
    box: Box,
    normalized: bool,
    functions: Linear | Kernel,
    ridge: float,
    method: str | Sgd,
) -> _Solution:
    """Solve the program over a linear or kernel class."""
    matrix, details = class_features(functions, len(program.p))
    w, g, eta, gap = fit_cells(
        program.p, program.q, matrix, box, ridge, normalized, str(method)
    )
    penalty = 0.5 * ridge * float(w @ w)
    return _Solution(g, eta, gap, penalty, *box, details, weights=w)


def _check_class(toward: float | None, loss: str, method: str | Sgd) -> None:
    """Raise an error for an option that linear and kernel classes cannot have."""
    for name, value, default in (("toward", toward, None), ("loss", loss, "kl")):
        if value != default:
            raise ArgumentError(
                name,
                "must be left out with functions=Linear(...) or Kernel(...), whose"
                f" program is the KL risk + ridge/2 |w|^2; got {_checks.show(value)}",
            )
    if isinstance(method, Sgd):
        raise ArgumentError(
            "solver",
            "Sgd(...) must be left out with functions=Linear(...) or Kernel(...):"
            " Algorithm 1 is for tables",
        )


def _refuse_unbounded(index: Any, program: dual.Coordinates, box: Box) -> None:
    """Raise an error where q = 0 < p and neither a bound nor a ridge keeps g finite."""
    bad = np.flatnonzero((program.q == 0) & (program.p > 0) & (program.curvature == 0))
    if bad.size and not np.isfinite(box.upper):
        named = ", ".join(str(int(i)) for i in index[bad[:5]])
        raise ArgumentError(
            "q",
            f"must be positive where p is: the program is unbounded at the {bad.size}"
            f" entries with q = 0 < p (the first: {named}); give a finite upper bound,"
            " or more data behind q",
        )


def _check_sgd(box: Box, normalized: bool, squares: bool) -> None:
    """Raise an error for what Algorithm 1 cannot solve.

    It minimises the KL risk alone, in a box that keeps its gradients bounded.
    """
    if normalized or squares:
        raise ArgumentError(
            "solver",
            'Sgd(...) must have normalized=False and loss="kl": Algorithm 1 knows no'
            " other program",
        )
    if not (box.lower > 0.0 and np.isfinite(box.upper)):
        raise ArgumentError(
            "solver",
            "Sgd(...) must have 0 < lower and a finite upper; the box is"
            f" [{box.lower:g}, {box.upper:g}]",
        )
