"""Both ratios at once: beta_sas' and beta_sa under marginal consistency, whose quotient has rows that sum to 1.

    minimise  [sum q B - sum p log B + ridge/2 I(B)^2] + [sum r b - sum s log b + ridge/2 I(b)^2]
    subject to  lower <= B, b <= upper,   sum_s' d(s, a, s') B(s, a, s') = d(s, a) b(s, a)  for each (s, a),
                ratio_lower b <= B <= ratio_upper b  where the ratio has a box of its own,

p, s the target's frequencies of (s, a, s') and (s, a); q = d(s, a) P(s' | s, a), r = d(s, a) the simulator's, whose data enter
through d(s, a) alone. The constraint says sum_s' P B / b = 1. Each (s, a) is solved by itself (``_joint``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import PolicyLike
from oee_tabular.ratio import _certificate, _joint, statements
from oee_tabular.ratio.arguments import Box, check_box, check_ridge
from oee_tabular.ratio.method import Method, RatioInput, SimulatorData
from oee_tabular.ratio.quotient import check_simulator_data, simulator_weights
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.statements import JointPoint, JointProgram


@dataclass(frozen=True, eq=False)
class Joint(Method):
    """Both ratios in one program, under sum_s' d(s, a, s') beta(s, a, s') = d(s, a) beta(s, a): rows of zeta * P sum to 1.

    The program is the module's. d(s, a) alone is taken from the simulator's data: P is known.

    Parameters
    ----------
    lower, upper : nu and mu, on each beta (0.01 and 10; ``numpy.inf`` for none)
    ratio_lower, ratio_upper : the box ratio_lower <= beta(s, a, s') / beta(s, a) <= ratio_upper; None: none
    ridge : lambda_n of both, a number or a function of n
    solver : "dual", or a cvxpy solver
    data, behavior_policy : as in ``Quotient``

    Notes
    -----
    Limit: the program's with the simulator's exact occupancy. zeta is 1 for pairs outside the simulator's data.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> Joint(data="exact").fit(log, simulator).values.data.round(1).tolist()
    [0.8, 1.2, 0.8, 1.2]
    """

    lower: float | None = 0.01
    upper: float | None = 10.0
    ratio_lower: float | None = None
    ratio_upper: float | None = None
    ridge: float | Callable[[float], float] = 0.0
    solver: str = "dual"
    data: SimulatorData = field(default=None, repr=False)
    behavior_policy: PolicyLike | None = field(default=None, repr=False)

    USES: ClassVar = frozenset({"simulator_data", "behavior_policy"})

    def __post_init__(self) -> None:
        _checks.instance(self.solver, str, "solver")
        self._refuse_words(self.ridge)
        check_box(self.lower, self.upper, normalized=True)
        self._ratio_box()
        check_simulator_data(self.data)

    def _ratio_box(self) -> Box:
        return check_box(self.ratio_lower, self.ratio_upper, normalized=True, names=("ratio_lower", "ratio_upper"))

    def _exact(self) -> Joint:
        return replace(self, data=None)

    def _fit(self, given: RatioInput) -> TransitionRatio:
        counts, rows = given.observed, given.rows
        box, ratio_box = check_box(self.lower, self.upper, normalized=True), self._ratio_box()
        share = rows.sums(simulator_weights(given, self.data, self.behavior_policy))
        lam = check_ridge(self.ridge, float(counts.sum()))
        p, q = counts / counts.sum(), rows.spread(share / share.sum()) * rows.weights
        # r is d(s, a) to the last bit as the constraint has it: neither ratio can run away alone
        program = JointProgram(p, q, rows.sums(p), rows.sums(q), rows.indptr, *box, *ratio_box, lam)
        lost = (program.s > 0) & (share == 0)
        if lost.any() and not np.isfinite(box.upper) and lam == 0:
            raise ValueError(
                "simulator_data must cover the log's (s, a), or upper be finite: the program is unbounded at "
                f"{int(lost.sum())} of them"
            )
        if self.solver == "dual":
            point = JointPoint(*_joint.solve_all(program))
            gap = float(_certificate.joint_gaps(program, point).sum())
        else:
            point = statements.solve_joint(program, solver=self.solver)
            # cvxpy's sign of an equality's multiplier is not the same for all programs; either gives a bound
            signs = (point, point._replace(theta=-point.theta))
            gap = min(float(_certificate.joint_gaps(program, each).sum()) for each in signs)
        known = rows.spread((share > 0) & (point.pairs > 0))
        zeta = np.where(known, point.moves / np.where(known, rows.spread(point.pairs), 1.0), 1.0)
        details = {
            "lower": box.lower,
            "upper": box.upper,
            "ratio_lower": ratio_box.lower,
            "ratio_upper": ratio_box.upper,
            "moves": point.moves,
            "pairs": point.pairs,
            "pairs_without_simulator_data": int(lost.sum()),
        }
        return given.ratio(zeta, self._name, gap, details)
