"""Programs as data, for the structured solvers and for cvxpy alike."""

from __future__ import annotations

from dataclasses import dataclass

from scipy import sparse

from oee_tabular._checks import Array, IntArray


@dataclass(frozen=True, eq=False)
class JointProgram:
    """The joint program of ``ratio.joint``: p, q, bend are (entries,), s, r, stiffness (rows,); rows by ``indptr``.

    ``least`` and ``most`` bound the ratio beta_sas' / beta_sa (0 and inf: free).
    """

    p: Array
    q: Array
    bend: Array
    s: Array
    r: Array
    stiffness: Array
    lower: float
    upper: float
    indptr: IntArray
    least: float = 0.0
    most: float = float("inf")


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """The program of ``ratio.interior`` over g = offset + features w.

    b, p, q, offset are (n,), features (n, d); ``penalty`` is that of |w|^2 / 2; ``normalized`` says whether sum q g = 1 is
    imposed. ``ceiling`` is an upper bound on every feasible g that the constraints imply, for the certificate's sake.
    """

    b: Array
    p: Array
    q: Array
    offset: Array
    features: Array
    penalty: float
    lower: float
    upper: float
    normalized: bool
    ceiling: Array


@dataclass(frozen=True, eq=False)
class TiltProgram:
    """The tilt's program: counts (entries,), log of the simulator's rows, features (entries, d), rows by ``indptr``.

    ``penalty``: the positive definite matrix M of the term theta' M theta / 2 (None: the identity).
    """

    counts: Array
    log_weights: Array
    features: Array | sparse.csr_array
    indptr: IntArray
    penalty: sparse.csc_array | None = None
