"""Programs as data, for the structured solvers and for cvxpy alike."""

from __future__ import annotations

from dataclasses import dataclass

from oee_tabular._checks import Array, IntArray


@dataclass(frozen=True, eq=False)
class JointProgram:
    """The joint program of ``ratio.joint``: p, q, bend are (entries,), s, r, stiffness (rows,); rows by ``indptr``."""

    p: Array
    q: Array
    bend: Array
    s: Array
    r: Array
    stiffness: Array
    lower: float
    upper: float
    indptr: IntArray
