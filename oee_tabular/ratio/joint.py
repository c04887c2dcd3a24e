"""Both ratios at once: beta_sas' and beta_sa under marginal consistency, whose quotient has rows that sum to 1.

    minimise  [sum q B - sum p log B + ridge/2 I(B)^2] + [sum r b - sum s log b + ridge/2 I(b)^2]
    subject to  lower <= B, b <= upper,   sum_s' d(s, a, s') B(s, a, s') = d(s, a) b(s, a)  for each (s, a),
                nu b <= B <= mu b  where the ratio has a box (nu, mu) of its own,

p, s the target's frequencies of (s, a, s') and (s, a); q = d(s, a) P(s' | s, a), r = d(s, a) the simulator's. Since
d(s, a, s') = d(s, a) P, the constraint says sum_s' P B / b = 1. It decouples into one root for each (s, a). The data of the
simulator enter through d(s, a) alone: P is known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio import statements
from oee_tabular.ratio.box import Box, check_box, check_ridge
from oee_tabular.ratio.method import Given, Method, SimulatorData
from oee_tabular.ratio.population import Population
from oee_tabular.ratio.program_types import JointProgram
from oee_tabular.ratio.quotient import check_simulator_data, refuse_words, simulator_weights
from oee_tabular.ratio.result import TransitionRatio, make_result
from oee_tabular.ratio.segments import segment_sums, spread


@dataclass(frozen=True, eq=False)
class JointSolution:
    """beta_sas', beta_sa, the multiplier and the duality gap of each (s, a), the program's value."""

    moves: Array
    pairs: Array
    multiplier: Array
    gap: Array
    objective: float


def joint_program(
    observed: Array, share: Array, probability: Array, indptr: IntArray, *, lower: float, upper: float, ridge: float,
    least: float = 0.0, most: float = np.inf,
) -> JointProgram:  # fmt: skip
    """From counts on the simulator's entries, d(s, a) ``share`` (rows,) and P; the paper's ridge, towards 0."""
    p = observed / observed.sum()
    q = spread(share, indptr) * probability
    return JointProgram(
        p=p,
        q=q,
        bend=np.full(len(p), ridge),
        s=segment_sums(p, indptr),
        r=segment_sums(q, indptr),  # d(s, a), to the last bit what the constraint has: neither ratio can run away alone
        stiffness=np.full(len(share), ridge),
        lower=lower,
        upper=upper,
        indptr=indptr,
        least=least,
        most=most,
    )


def solve_joint(program: JointProgram) -> JointSolution:
    """The structured solver; every (s, a) by a bracketed root. Cost O(entries) times about sixty bisections."""
    from oee_tabular.ratio import _joint as joint
    from oee_tabular.ratio import _ratio_box as ratio_box

    big = segment_sums(program.q, program.indptr)  # D = sum_s' d, the simulator's d(s, a) up to rounding
    if program.least > 0.0 or program.most < np.inf:
        box = (program.lower, program.upper, program.least, program.most)
        moves, pairs, theta, push, press, _ = ratio_box.solve_all_boxed(
            program.p, program.q, program.bend, program.s, program.r, program.stiffness, big, box, program.indptr
        )
    else:
        push, press = np.zeros(len(program.p)), np.zeros(len(program.p))
        moves, pairs, theta, _ = joint.solve_all(
            program.p, program.q, program.bend, program.q, program.s, program.r, program.stiffness, big,
            program.lower, program.upper, program.indptr,
        )  # fmt: skip
    gap = joint_gaps(program, moves, pairs, theta, push, press)
    return JointSolution(moves, pairs, theta, gap, joint_objective(program, moves, pairs))


def joint_objective(program: JointProgram, moves: Array, pairs: Array) -> float:
    """The value that is minimised."""
    seen, visited = program.p > 0, program.s > 0
    value = program.q @ moves - program.p[seen] @ np.log(moves[seen]) + 0.5 * program.bend @ moves**2
    value += program.r @ pairs - program.s[visited] @ np.log(pairs[visited]) + 0.5 * program.stiffness @ pairs**2
    return float(value)


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
    Limit: that of the program with the simulator's exact occupancy. zeta is 1 where the simulator's data have no (s, a).

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
    behavior_policy: Any = field(default=None, repr=False)

    HEEDS: ClassVar = frozenset({"simulator_data", "behavior_policy"})

    @property
    def _name(self) -> str:
        return "joint"

    def __post_init__(self) -> None:
        _checks.instance(self.solver, str, "solver")
        refuse_words(self.ridge, self._name)
        check_box(self.lower, self.upper, normalized=True)
        self._ratio_box()
        check_simulator_data(self.data)

    def _ratio_box(self) -> Box:
        return check_box(self.ratio_lower, self.ratio_upper, normalized=True, names=("ratio_lower", "ratio_upper"))

    def limit(self, population: Population) -> TransitionRatio | sparse.csr_array:
        """The program's ratio with exact rates on both sides."""
        return super(Joint, replace(self, data=None)).limit(population)

    def _fit(self, given: Given) -> TransitionRatio:
        observed, simulator = given.observed, given.simulator
        indptr: IntArray = simulator.transitions.indptr.astype(np.int64)
        box = check_box(self.lower, self.upper, normalized=True)
        weights = simulator_weights(given, self.data, self.behavior_policy)
        share = segment_sums(weights, indptr)
        ratio_box = self._ratio_box()
        strength = check_ridge(self.ridge, float(observed.sum()))
        program = joint_program(
            observed,
            share / share.sum(),
            simulator.transitions.data / spread(segment_sums(simulator.transitions.data, indptr), indptr),
            indptr,
            lower=box.lower,
            upper=box.upper,
            ridge=strength,
            least=ratio_box.lower,
            most=ratio_box.upper,
        )
        lost = (program.s > 0) & (share == 0)
        if lost.any() and not np.isfinite(box.upper) and strength == 0:
            raise ValueError(
                "simulator_data must cover the log's (s, a), or upper be finite: the program is unbounded at "
                f"{int(lost.sum())} of them"
            )
        if self.solver == "dual":
            solution = solve_joint(program)
            moves, pairs, gap = solution.moves, solution.pairs, float(solution.gap.sum())
        else:
            point = statements.solve_joint(program, solver=self.solver)
            moves, pairs = point.moves, point.pairs
            # cvxpy's sign of an equality's multiplier is not the same for all programs; either gives a bound
            gap = min(
                float(joint_gaps(program, moves, pairs, sign * point.theta, point.push, point.press).sum())
                for sign in (1.0, -1.0)
            )
        if not np.isfinite(gap):
            raise ValueError(
                "lower, upper, ratio_lower, ratio_upper and ridge must make a program that double precision holds; they are "
                f"{box.lower:g}, {box.upper:g}, {ratio_box.lower:g}, {ratio_box.upper:g}, {strength:g}"
            )
        known = spread((share > 0) & (pairs > 0), indptr)
        zeta = np.where(known, moves / np.where(known, spread(pairs, indptr), 1.0), 1.0)
        details = {
            "lower": box.lower,
            "upper": box.upper,
            "ratio_lower": ratio_box.lower,
            "ratio_upper": ratio_box.upper,
            "moves": moves,
            "pairs": pairs,
            "pairs_without_simulator_data": int(lost.sum()),
        }
        return make_result(simulator, zeta, self._name, gap, observed, details)


def joint_gaps(program: JointProgram, moves: Array, pairs: Array, theta: Array, push: Array, press: Array) -> Array:
    """(rows,) duality gaps of any ``moves`` and ``pairs``, at any multipliers ``theta`` (rows,), ``push``, ``press`` >= 0.

    ``push`` and ``press`` (entries,) are those of nu b <= B <= mu b. From the program as stated, by code that no solver uses.
    """
    from oee_tabular.ratio import certificate

    box = (program.lower, program.upper, program.least, program.most)
    numbers = (program.p, program.q, program.bend, program.s, program.r, program.stiffness)
    return np.asarray(certificate.joint_gaps(*numbers, box, program.indptr, moves, pairs, theta, push, press))
