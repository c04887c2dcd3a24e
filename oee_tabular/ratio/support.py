"""The support of a ratio: transitions with simulator probability 0, and the paper's
assumptions checked on a given pair.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import align, canonical, check_csr, find, row_of_entry
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.arrays import name_transition
from oee_tabular.ratio.dual import check_distributions
from oee_tabular.typing import Array

LEAST_PROBABILITY = 1e-300  # of a smaller one a ratio overflows
LARGEST_COUNT = 2.0**53  # beyond it a float does not tell n from n + 1


def refuse_unsupported(
    moves: sparse.csr_array, simulator: FiniteMDP, *, what: str = "log"
) -> None:
    """Raise a ValueError if ``moves`` leave the simulator's support.

    Parameters
    ----------
    moves : csr (S*A, S), counts or probabilities
    simulator : FiniteMDP
    what : the name of the transitions in the error

    Raises
    ------
    ValueError
        Names the most frequent of these transitions, their number, and what to do.

    Notes
    -----
    Cost: O(nnz log nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = oee.tasks.gridworld(2, slip=0.0), oee.tasks.gridworld(2, slip=0.1)
    >>> refuse_unsupported(target.transitions, simulator, what="target")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ValueError: target must stay in the simulator's support: the simulator gives probability 0 to 24 of its transitions...
    """
    moves, possible = _possible(moves, simulator)
    bad = np.flatnonzero((moves.data > 0) & ~possible)
    if bad.size == 0:
        return
    heaviest = bad[np.argsort(-moves.data[bad], kind="stable")][:4]
    names = [
        name_transition(moves, int(k), simulator.n_actions, simulator.names)
        for k in heaviest
    ]
    named = "; ".join(
        f"{name} ({moves.data[k]:g})" for name, k in zip(names, heaviest, strict=True)
    )
    share = moves.data[bad].sum()
    faint = (
        f"0 or below {LEAST_PROBABILITY:g}"
        if align(simulator.transitions, moves)[0][bad].any()
        else "0"
    )
    raise ValueError(
        f"{what} must stay in the simulator's support: the simulator gives probability"
        f" {faint} to {bad.size} of its transitions ({share:g} of {moves.data.sum():g}"
        f" with repetitions): {named}{', ...' * (bad.size > 4)}. "
        + _suggest_remedies(moves, bad, simulator)
    )


def _suggest_remedies(moves: sparse.csr_array, bad: Any, simulator: FiniteMDP) -> str:
    """Say what would give these transitions probability."""
    n_actions = simulator.n_actions
    rows = row_of_entry(moves)
    to = moves.indices.astype(np.int64)
    start, action = np.divmod(rows, n_actions)
    if (
        min(start.min(), to.min()) >= 1
        and find(simulator.transitions, rows - n_actions, to - 1)[1].all()
    ):
        return (
            "With 1 subtracted from every state all transitions are possible: states"
            " are numbered from 0"
        )
    # whether any action of the state leads there
    someone = np.zeros(len(rows), dtype=np.bool_)
    for a in range(n_actions):
        someone |= find(simulator.transitions, start * n_actions + a, to)[1]
    ways = [
        (
            "simulator.with_support_of(log, epsilon) (--impossible allow=0.01) gives"
            " each of them some probability"
        ),
        (
            'Problem(..., impossible="drop") (--impossible drop) leaves them out, and'
            " intervals let them lead anywhere"
        ),
        (
            "use a mixture of simulator parameters, or states that distinguish such"
            " transitions"
        ),
    ]
    if someone[bad].all():
        return _number(
            [
                "simulator.with_action_noise(epsilon) (--action-noise) makes them possible",
                *ways,
            ]
        )
    k = int(bad[~someone[bad]][np.argmax(moves.data[bad[~someone[bad]]])])
    s = int(start[k])
    a = int(action[k])
    j = int(to[k])
    could = int(someone[bad].sum())
    here = simulator.names.state(s)
    there = simulator.names.state(j)
    return (
        f"No action leads from {here} to {there} in the simulator, so action noise does"
        " not help"
        + (f" (it does for {could} of the {bad.size}). " if could else ". ")
        + _number(
            [
                (
                    f"if the target can do this, give it probability: P[{s}, {a}] *= 0.99;"
                    f" P[{s}, {a}, {j}] += 0.01"
                ),
                "if the log is wrong, remove these transitions from it",
                *ways,
            ]
        )
    )


def _number(ways: list[str]) -> str:
    return (
        "Fix one of these:"
        f" {'; '.join(f'({k}) {way}' for k, way in enumerate(ways, 1))}"
    )


def uncovered_share(moves: sparse.csr_array, simulator: FiniteMDP) -> float:
    """Compute the share of ``moves`` to which the simulator gives probability 0.

    Parameters
    ----------
    moves : csr (S*A, S), counts or weighted probabilities
    simulator : FiniteMDP

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = oee.tasks.gridworld(2, slip=0.0), oee.tasks.gridworld(2, slip=0.1)
    >>> uncovered_share(target.transitions, simulator) > 0, uncovered_share(simulator.transitions, target)
    (True, 0.0)
    """
    moves, possible = _possible(moves, simulator)
    total = moves.data.sum()
    if not 0 < total < np.inf:
        raise ArgumentError(
            "moves", f"must have a positive, finite sum; it is {total:g}"
        )
    return float(moves.data[~possible].sum() / total)


def _possible(
    moves: Any, simulator: FiniteMDP, name: str = "moves"
) -> tuple[sparse.csr_array, _checks.BoolArray]:
    """The transitions as csr, and which of them have a probability in the simulator
    that a ratio can be taken of.
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    matrix = simulator.transitions
    if not sparse.issparse(moves) or moves.shape != matrix.shape:
        raise ArgumentError(
            name,
            f"must be sparse of shape {matrix.shape}; got"
            f" {getattr(moves, 'shape', type(moves).__name__)}",
        )
    rows = check_csr(moves, name)
    position, stored = find(matrix, row_of_entry(rows), rows.indices.astype(np.int64))
    return rows, stored & (matrix.data[position] >= LEAST_PROBABILITY)


def without_impossible(
    counts: sparse.csr_array, simulator: FiniteMDP
) -> tuple[sparse.csr_array, Array]:
    """Canonical counts without transitions of simulator probability 0, and (S*A,) how
    many those were.

    Examples
    --------
    >>> line = FiniteMDP([[[0.5, 0.5, 0]], [[0, 0, 1]], [[0, 0, 1]]], [1, 1, 0], 0, 0.9)
    >>> kept, dropped = without_impossible(sparse.csr_array([[2, 1, 3], [0, 0, 1], [0, 0, 0]]), line)
    >>> kept.toarray().tolist(), dropped.tolist()
    ([[2.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], [3.0, 0.0, 0.0])
    """
    moves, possible = _possible(counts, simulator, "counts")
    kept = sparse.csr_array(
        (np.where(possible, moves.data, 0.0), moves.indices, moves.indptr), moves.shape
    )
    rows = row_of_entry(moves)[~possible]
    dropped = np.bincount(rows, moves.data[~possible], counts.shape[0]).astype(
        np.float64
    )
    return canonical(kept, drop_zeros=True), dropped


def checked_counts(counts: Any, simulator: FiniteMDP) -> sparse.csr_array:
    """Counts as a canonical csr of the simulator's shape; errors for shape, sign and
    size that name the place.
    """
    shape = simulator.transitions.shape
    if not sparse.issparse(counts):
        raise ArgumentError(
            "counts", f"must be sparse, of shape {shape}; got {type(counts).__name__}"
        )
    if counts.shape != shape:
        raise ArgumentError(
            "counts",
            f"must have shape {shape} (row s*A + a, column s'); they have shape"
            f" {counts.shape}",
        )
    if counts.dtype.kind not in "fiub":
        raise ArgumentError("counts", f"must be real numbers; they are {counts.dtype}")
    matrix = canonical(check_csr(counts, "counts"), drop_zeros=True)
    is_count = np.isfinite(matrix.data) & (matrix.data >= 0)
    for fine, rule in (
        (is_count, "finite and nonnegative"),
        (matrix.data <= LARGEST_COUNT, "at most 2**53"),
    ):
        if not fine.all():
            k = int(np.flatnonzero(~fine)[0])
            where = name_transition(matrix, k, simulator.n_actions, simulator.names)
            raise ArgumentError(
                "counts", f"must be {rule}; at {where} there is {matrix.data[k]:g}"
            )
    return matrix


def aligned_counts(counts: sparse.csr_array, simulator: FiniteMDP) -> Array:
    """Counts on the entries of the simulator's transitions; errors for shapes, signs
    and support.
    """
    return supported_counts(checked_counts(counts, simulator), simulator)


def supported_counts(counts: sparse.csr_array, simulator: FiniteMDP) -> Array:
    """The same of canonical counts: errors for support alone."""
    values, stored = align(counts, simulator.transitions)
    if (
        np.count_nonzero(stored) < counts.nnz
        or (simulator.transitions.data[values > 0] < LEAST_PROBABILITY).any()
    ):
        refuse_unsupported(counts, simulator)
    return values


def require_pair(target: object, simulator: object) -> None:
    """Two MDPs with the same states and actions."""
    first = _checks.instance(target, FiniteMDP, "target").transitions
    second = _checks.instance(simulator, FiniteMDP, "simulator").transitions
    if first.shape != second.shape:
        raise ValueError(
            "target and simulator must have the same states and actions; their"
            f" transitions have shapes {first.shape} and {second.shape}"
        )


@dataclass(frozen=True)
class Assumptions:
    """Assumptions V.1 and V.2 for p, q and the box [lower, upper].

    Attributes
    ----------
    box_contains_one : nu < 1 < mu (Assumption V.1)
    inside : nu <= p/q <= mu wherever q > 0 (Assumption V.2 for the class of all
        functions in the box)
    supported : p = 0 wherever q = 0
    below, above, unsupported : how many entries miss each
    smallest, largest : of p/q where q > 0
    renyi_infinity : D_inf(p || q) = log max p/q, infinite without support

    Examples
    --------
    >>> assumptions = check_assumptions([3, 1], [2, 2], lower=0.1, upper=1.2)
    >>> assumptions.inside, assumptions.above, assumptions.largest, assumptions.supported
    (False, 1, 1.5, True)
    """

    box_contains_one: bool
    inside: bool
    supported: bool
    below: int
    above: int
    unsupported: int
    smallest: float
    largest: float
    renyi_infinity: float

    def __str__(self) -> str:
        box = "holds" if self.box_contains_one else "fails"
        inside = (
            "holds"
            if self.inside
            else f"fails ({self.below} entries below, {self.above} above)"
        )
        support = "holds" if self.supported else f"fails at {self.unsupported} entries"
        return (
            f"nu < 1 < mu: {box}; nu <= p/q <= mu: {inside}, p/q from"
            f" {self.smallest:.4g} to {self.largest:.4g}; support: {support}; D_inf ="
            f" {self.renyi_infinity:.4g}"
        )


def check_assumptions(
    p: ArrayLike, q: ArrayLike, *, lower: float, upper: float
) -> Assumptions:
    """Check assumptions V.1 and V.2 for the distributions p, q (counts are scaled) and
    the box [lower, upper].

    Parameters
    ----------
    p, q : (n,) nonnegative; counts or probabilities, each is scaled to sum to 1
    lower, upper : the paper's nu >= 0 and mu, inf allowed

    Examples
    --------
    >>> print(check_assumptions([3, 1], [2, 2], lower=0.1, upper=1.2))
    nu < 1 < mu: holds; nu <= p/q <= mu: fails (0 entries below, 1 above), p/q from 0.5 to 1.5; support: holds; D_inf = 0.4055
    """
    ps, qs = check_distributions(p, q)
    nu = _checks.number_in(lower, "lower", 0.0, np.inf)
    mu = _checks.number_in(upper, "upper", 0.0, np.inf, infinite=True)
    ratio = ps[qs > 0] / qs[qs > 0]
    unsupported, below, above = (
        int(np.sum(x)) for x in ((qs == 0) & (ps > 0), ratio < nu, ratio > mu)
    )
    return Assumptions(
        box_contains_one=nu < 1.0 < mu,
        inside=below == above == 0,
        supported=unsupported == 0,
        below=below,
        above=above,
        unsupported=unsupported,
        smallest=float(ratio.min()),
        largest=float(ratio.max()),
        renyi_infinity=float("inf") if unsupported else float(np.log(ratio.max())),
    )
