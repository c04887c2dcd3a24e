"""The ratio of two distributions by the dual of the KL divergence (eq. 3.6 and 3.7).

Reference ([1] is that of ``oee_tabular.ratio``): [2] T. Kanamori, S. Hido and M.
Sugiyama, A least-squares approach to direct importance estimation, JMLR 10, 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio import dual, statements
from oee_tabular.ratio.dual import Box, check_box, check_ridge, check_weights
from oee_tabular.ratio.features import KernelLike, class_features
from oee_tabular.ratio.linear import N_CENTERS, fit_cells
from oee_tabular.ratio.sgd import Sgd, SgdTrace, descend
from oee_tabular.typing import Array, RealArrayLike, Seed

# The largest gap, in nats, of a fit that is called "optimal".
OPTIMAL_GAP_NATS = 1e-8


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
        "optimal", or "inaccurate" if the gap exceeds 1e-8 (a box within rounding of 1,
        features of many scales).
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


@suggest_keywords
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
    solver: str | Sgd = "dual",
    features: RealArrayLike | None = None,
    kernel: KernelLike | None = None,
    coordinates: RealArrayLike | None = None,
    n_centers: int = N_CENTERS,
    step_size: float = 0.1,
    batch_size: int = 64,
    n_iterations: int = 10_000,
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
    solver : str or Sgd, default 'dual'
        'dual' (structured, exact; for classes Clarabel), the name of a cvxpy solver
        ('CLARABEL', 'SCS'), 'sgd' or ``Sgd(...)``: the paper's Algorithm 1, for what
        training adds to the error (normalized=False, a box with 0 < lower and finite
        upper).
    features : array-like of shape (n,) or (n, d), optional
        Features of the class g = Phi w, for which the ridge is ridge/2 times the
        squared length of w; within lower <= g <= upper. None means a table: one
        parameter an entry.
    kernel : 'gaussian' or callable, optional
        The kernel whose expansions over the entries are the class; the ridge is that of
        the squared RKHS norm. 'gaussian' is in standard deviations of the coordinates;
        a function takes (m, c) and (k, c) points and returns an (m, k) array.
    coordinates : array-like of shape (n,) or (n, c), optional
        The points that the entries stand for, with a kernel.
    n_centers : int, default 200
        Number of points beyond which the kernel is replaced by its pivoted Cholesky
        approximation.
    step_size : float, default 0.1
        Step size of solver 'sgd'.
    batch_size : int, default 64
        Number of draws from each side at an iteration of 'sgd'.
    n_iterations : int, default 10000
        Number of iterations of 'sgd'.
    seed : int, Generator or None, optional
        Seed of the draws of 'sgd'.

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
    about forty steps of O(n d^2). Collinear features are solved, with a warning and
    their rank.

    Examples
    --------
    >>> fit = density_ratio([3, 1], [2, 2])
    >>> fit.ratio.tolist(), fit.gap
    ([1.5, 0.5], 0.0)
    """
    _checks.instance(solver, (str, Sgd), "solver", "name or Sgd(...)")
    sgd = solver if isinstance(solver, Sgd) else None
    if solver == "sgd":
        sgd = Sgd(step_size, batch_size, n_iterations)
    _checks.boolean(normalized, "normalized")
    weights = check_weights(p, q)
    n = len(weights[0])
    totals = (float(weights[0].sum()), float(weights[1].sum()))
    _checks.one_of(loss, "loss", ("kl", "chi2"))
    box = check_box(lower, upper, normalized=normalized)
    strength = check_ridge(ridge, totals[0])
    in_class = features is not None or kernel is not None
    if in_class and (toward is not None or loss != "kl"):
        raise ValueError(
            "toward and loss must be left out with features or kernel: their program is"
            " the KL risk + |w|^2"
        )
    if in_class and sgd is not None:
        raise ArgumentError(
            "solver",
            '"sgd" must be left out with features or kernel: Algorithm 1 is for tables',
        )
    if coordinates is not None and not in_class:
        raise ArgumentError("coordinates", "must be given with a kernel; none is given")
    center = 0.0 if toward is None else _checks.number_in(toward, "toward", 0.0, np.inf)
    # Entries with p = q = 0 are left out, except of a class, which has a value there.
    known: Any = (weights[0] > 0) | (weights[1] > 0)
    if in_class or known.all():
        known = slice(None)
    ps = weights[0][known] / totals[0]
    qs = weights[1][known] / totals[1]
    if toward is not None:
        curvature = strength * qs
    else:
        # The ridge of a class is on its parameters.
        curvature = np.full(len(ps), 0.0 if in_class else strength)
    program = dual.Coordinates(
        ps, qs, curvature, np.full(len(ps), center), squares=loss == "chi2"
    )
    m = 1.0
    ends: tuple[Any, Any] = box
    rest: dict[str, Any] = {}
    if in_class:
        _checks.positive_integer(n_centers, "n_centers")
        matrix, rest["details"] = class_features(
            features, kernel, coordinates, n_centers, n
        )
        w, g, eta, gap = fit_cells(
            ps, qs, matrix, box, strength, normalized, str(solver)
        )
        m = 1.0 + eta
        rest["weights"] = w
        penalty = 0.5 * strength * float(w @ w)
    else:
        _refuse_unbounded(np.arange(n)[known], program, box)
        whole = np.array([0, len(ps)])
        if sgd is not None:
            _check_sgd(box, normalized, loss)
            g, rest["trace"] = descend(program, *box, sgd, seed)
        elif solver != "dual":
            g, multiplier = statements.solve_rows(
                program, *box, whole if normalized else None, solver=str(solver)
            )
            m += float(multiplier.sum())
        elif normalized:
            g, multipliers, _, *enclosure = dual.solve_rows(program, *box, whole)
            m = float(multipliers[0])
            ends = (enclosure[0], enclosure[1])
        else:
            g = dual.solve_free(program, *box)
            ends = (g, g)
        multiplier_plus_one = np.array([m]) if normalized else None
        gap = float(dual.row_gaps(program, g, multiplier_plus_one, *box, whole)[0])
        with np.errstate(over="ignore", invalid="ignore"):
            penalty = program.penalty(g)
    if not (np.isfinite(g).all() and np.isfinite([gap, penalty]).all()):
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
    below[known] = ends[0]
    above[known] = ends[1]
    status = f"inaccurate: the gap is {gap:.1e}"
    if gap <= OPTIMAL_GAP_NATS:
        status = "optimal"
    return RatioFit(
        ratio=_checks.freeze(ratio),
        objective=risk + penalty,
        dual_bound=risk + penalty - gap,
        gap=gap,
        normalizer=m - 1.0,
        # Least squares estimate no KL divergence.
        divergence=float("nan") if program.squares else 1.0 - risk,
        n_undetermined=n - len(ps),
        p_total=totals[0],
        q_total=totals[1],
        status=status,
        enclosure=(below, above),
        **rest,
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


def _check_sgd(box: Box, normalized: bool, loss: str) -> None:
    """Raise an error for what Algorithm 1 cannot solve.

    It minimises the KL risk alone, in a box that keeps its gradients bounded.
    """
    if normalized or loss != "kl":
        raise ArgumentError(
            "solver",
            '"sgd" must have normalized=False and loss="kl": Algorithm 1 knows no other'
            " program",
        )
    if not (box.lower > 0.0 and np.isfinite(box.upper)):
        raise ArgumentError(
            "solver",
            '"sgd" must have 0 < lower and a finite upper; the box is'
            f" [{box.lower:g}, {box.upper:g}]",
        )
