"""Weighted paths: how they are drawn, and the moments per decision that the public functions build on."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse

from oee_tabular import _checks, _printing
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, canonical, checked
from oee_tabular._threads import dot
from oee_tabular.exact.finite import CACHED, locked, rows_of
from oee_tabular.exact.linear import DivergentKernelError, solve_policy_system
from oee_tabular.mdp import FiniteMDP

# offsets, columns, whether they are consecutive, numbers, masses and residuals, order of the states, band of kernels.merged
Strips: TypeAlias = tuple[Array, Array, Array, Array, Array, IntArray, int]


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean and variance of one episode's X; for a self-normalised estimator, what n episodes have to first order.

    Attributes
    ----------
    mean : E[X]; self-normalised: the limit of the estimator
    variance : Var[X]; self-normalised: lim n * variance of the estimator
    bias : 0; self-normalised: lim n * (expectation of the estimator - mean)
        What is made of numbers beyond the largest float is infinite, or nan, with a warning.
    by_step : (T + 1,) parts of the variance: that of the start, then of each step; None unless asked for
    by_state : (S,) parts of the variance by the state that the step was taken from (without the start's); None unless
        asked for

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> found = oee.return_moments(coin, [[1.0]] * 2, horizon=2, sources=True)
    >>> found, found.by_step.tolist()  # the first state's chance, the first move's, the last's
    (Moments(mean=0.75, variance=0.3125, bias=0.0), [0.25, 0.0625, 0.0])
    """

    mean: float
    variance: float
    bias: float = 0.0
    by_step: Array | None = field(default=None, repr=False)
    by_state: Array | None = field(default=None, repr=False)
    _deviation: float | None = field(default=None, repr=False)  # where the variance leaves the range of floats

    @property
    def standard_deviation(self) -> float:
        """sqrt(variance), also where the variance is too large or too small for a float."""
        return float(np.sqrt(self.variance)) if self._deviation is None else self._deviation

    def _repr_html_(self) -> str:
        rows: list[tuple[str, object]] = [
            ("mean", f"{self.mean:.6g}"), ("variance (squared units)", f"{self.variance:.6g}"),
            ("standard deviation", f"{self.standard_deviation:.6g}"), ("bias", f"{self.bias:.4g}"),
        ]  # fmt: skip
        return _printing.facts(f"Moments of one episode: {_printing.SUM}", rows)


@dataclass(frozen=True, eq=False)
class Walk:
    """How paths are drawn and weighted, as the kernels read it: policies (1 or T, S*A), moves aligned with the entries."""

    indptr: Any
    indices: Any
    prob: Array
    w: Array
    act: Array
    u: Array
    by_move: bool
    pay: Array
    initial: Array
    discount: float

    @property
    def n_states(self) -> int:
        """S."""
        return len(self.initial)

    @property
    def first(self) -> tuple[IntArray, Array]:
        """The states where episodes start, and their probabilities: what the others have must not count, even infinite."""
        first = np.flatnonzero(self.initial)
        return first, self.initial[first]

    @property
    def shape(self) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
        """The arguments that all kernels begin with."""
        return self.indptr, self.indices, self.prob, self.w, self.act, self.u, self.by_move, self.pay


def require_mdp(value: object, name: str = "mdp") -> None:
    """A ValueError for what is no FiniteMDP."""
    _checks.instance(value, FiniteMDP, name)


def walk_of(mdp: FiniteMDP, behavior: Array, *, ratio: Any = None, policy: Array | None = None) -> Walk:
    """Paths of ``behavior`` in ``mdp`` weighted by ``ratio`` on moves and by policy / behavior on actions.

    The weights stand still in absorbing states. Behaviour policies without support are the callers' concern.
    """
    from oee_tabular.exact._frontier import absorbing

    matrix = mdp.transitions
    rows = rows_of(matrix)
    over = absorbing(*rows[:2], locked(mdp.rewards))
    w = np.ones(matrix.nnz)
    if ratio is not None:
        values = getattr(ratio, "values", ratio)
        if not sparse.issparse(values) or values.shape != matrix.shape:
            found = getattr(values, "shape", type(values).__name__)
            raise ValueError(f"zeta must be sparse of shape {matrix.shape}, row s*A + a; got {found}")
        if np.iscomplexobj(values):
            raise ValueError("zeta must hold real numbers; it is complex")
        w, _ = align(canonical(checked(values, "zeta"), drop_zeros=False), matrix)
        if not 0.0 <= w.min() <= w.max() < np.inf:
            bad = np.flatnonzero(~(np.isfinite(w) & (w >= 0)))
            raise ValueError(f"zeta must be finite and nonnegative; entry {bad[0]} is {w[bad[0]]}")
        w[np.repeat(over, np.diff(matrix.indptr[:: mdp.n_actions]))] = 1.0
    act = np.atleast_2d(behavior.reshape(-1, mdp.n_states * mdp.n_actions))
    u = np.ones_like(act)
    if policy is not None:
        wanted = np.broadcast_to(policy.reshape(-1, mdp.n_states * mdp.n_actions), act.shape)
        u = np.divide(wanted, act, out=np.zeros_like(act), where=act > 0)
        u = np.where(np.repeat(over, mdp.n_actions), 1.0, u)
    by_move = mdp.reward_data is not None
    pay = mdp.reward_data if mdp.reward_data is not None else mdp.rewards.reshape(-1)
    return Walk(*rows, locked(w), locked(act), locked(u), by_move, locked(pay), locked(mdp.initial), mdp.discount)


def scaled_moments(found: Moments, shift: int) -> Moments:
    """The moments of 2^shift X from those of X, with a warning where they are not finite."""
    if shift != 0:
        with np.errstate(over="ignore", under="ignore"):
            deviation = float(np.ldexp(found.standard_deviation, shift))
            mean, bias = (float(np.ldexp(x, shift)) for x in (found.mean, found.bias))
            by_step, by_state = (None if x is None else np.ldexp(x, 2 * shift) for x in (found.by_step, found.by_state))
            found = Moments(mean, float(np.ldexp(found.variance, 2 * shift)), bias, by_step, by_state, deviation)
        if found.variance < np.finfo(float).tiny < deviation or found.variance == np.inf > deviation:
            warnings.warn(
                f"the variance {found.variance:g} is beyond floats; standard_deviation has its root", stacklevel=4
            )
    if not np.isfinite([found.mean, found.standard_deviation]).all():
        what = "beyond the largest float: the weights or the rewards are too large; or all weights of a step are 0"
        warnings.warn(f"a moment is {what}", stacklevel=4)
    return found


def per_decision(
    walk: Walk,
    steps: int,
    *,
    shift: Array | None = None,
    scale: Array | None = None,
    c: Array | None = None,
    h: Array | None = None,
    k: Array | None = None,
    sources: bool = False,
) -> Moments:
    """The kernel's X over ``steps`` steps; what is not given is 0 (``scale``: 1)."""
    shifted = shift is not None and not walk.by_move
    constant = len(walk.act) == len(walk.u) == 1 and c is None
    if constant and (not shifted or _all_one(walk.u) or _all_one(walk.w)):
        mean, var, local = merged(walk, strips_of(walk), steps, shift, scale, h, k, sources)
    else:
        mean, var, local = centred(walk, steps, shift, scale, c, h, k, sources)
    first, initial = walk.first
    value = dot(initial, mean[first])
    start = dot(initial, (mean[first] - value) ** 2)
    found = Moments(value, start + dot(initial, var[first]))
    if not sources:
        return found
    second = forward_measure(walk, steps, power=2)[:steps, 0]
    parts = walk.discount ** (2.0 * np.arange(steps))[:, None] * second * local
    return Moments(value, found.variance, 0.0, np.concatenate([[start], parts.sum(axis=1)]), parts.sum(axis=0))


def centred(
    walk: Walk, steps: int, shift: Array | None, scale: Array | None, c: Array | None, h: Array | None, k: Array | None,
    keep: bool,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Mean and variance of X by state, and each step's share of the variance, from the entries as they stand."""
    from oee_tabular.exact import _moments as kernel

    n = walk.n_states
    base, at_start, ahead = (
        locked(np.zeros((1, size)) if x is None else np.atleast_2d(x))
        for x, size in ((c, walk.act.shape[1]), (h, n), (k, n))
    )
    mean, var, local = np.empty(n), np.empty(n), np.empty((steps if keep else 1, n))
    shift = np.zeros(steps) if shift is None else shift
    scale = np.ones(steps) if scale is None else scale
    times = locked(shift), locked(scale)
    kernel.per_decision(steps, *walk.shape, *times, base, at_start, ahead, walk.discount, mean, var, local, keep)
    return mean, var, local


def strips_of(walk: Walk) -> Strips:
    """What ``merged`` reads, for a policy that does not depend on time."""
    from oee_tabular.exact._merged import merge

    act, u = walk.act[0], walk.u[0]
    found: Strips = merge(walk.indptr, walk.indices, walk.prob, walk.w, act, u, walk.by_move, walk.pay, walk.n_states)
    return found


def merged(
    walk: Walk, strips: Strips, steps: int, shift: Array | None, scale: Array | None, h: Array | None, k: Array | None,
    keep: bool,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """What ``centred`` gives for a policy and pays that do not depend on time: one sweep over entries merged over actions."""
    from oee_tabular.exact import _merged as kernel

    n = walk.n_states
    offsets, columns, aligned, numbers, fixed, order, band = strips
    places, based = len(order), h is not None or k is not None
    at_start, ahead = (np.zeros((steps, places) if based else (0, 0)) for _ in range(2))
    for room, x in ((at_start, h), (ahead, k)):
        if x is not None:
            room[:, :n] = np.atleast_2d(x)[:steps, order[:n]]
    ahead[:1] = 0.0
    mean, var, local = np.empty(places), np.empty(places), np.empty((steps if keep else 1, places))
    kernel.merged_moments(
        steps, offsets, columns, aligned, numbers, fixed, not walk.by_move and _all_one(walk.u),
        np.zeros(steps) if shift is None else shift, np.ones(steps) if scale is None else scale, based, at_start, ahead,
        walk.discount, mean, var, local, keep, *_blocks(columns.nbytes + numbers.nbytes, len(offsets) - 1, band),
    )  # fmt: skip
    found = []
    for part in (mean, var, local):
        states = np.empty((*part.shape[:-1], n))
        states[..., order[:n]] = part[..., :n]
        found.append(states)
    return found[0], found[1], found[2]


def _blocks(size: int, strips: int, band: int) -> tuple[int, int, int]:
    """Band, height and width of blocks that stay in the cache, of strips whose entries have ``size`` bytes; one if they may."""
    from oee_tabular.exact._merged import LANES

    one = size / strips + 48 * LANES
    band, fitting = max(int(band), 1), CACHED / one
    width = max(band, min(2 * band, int(fitting / 3)))
    height = int((fitting - width) / band)
    return (band, height, width) if one * strips > CACHED and height >= 2 else (0, 1, strips)


def _all_one(values: Array) -> bool:
    return bool(np.all(values == 1.0))


def forward_measure(walk: Walk, steps: int, *, power: int, returns: bool = False) -> Array:
    """(T + 1, 3, S): E[W^power G^i 1{s_t = s}]."""
    from oee_tabular.exact import _moments as kernel

    out = np.zeros((steps + 1, 3, walk.n_states))
    kernel.forward(steps, *walk.shape, walk.discount, power, walk.initial, returns, out)
    return out


def infinite(walk: Walk, sources: bool) -> Moments:
    """Two linear systems; DivergentKernelError where a moment does not exist."""
    first, second = (weighted_kernel(walk, power) for power in (1, 2))
    gamma, n = walk.discount, walk.n_states
    n_actions = walk.act.shape[1] // n
    act, u = walk.act[0], walk.u[0]
    rows = np.repeat(np.arange(len(act)), np.diff(walk.indptr))
    if gamma == 1.0:
        raise ValueError("horizon must be given: at discount 1 the infinite sum's variance is not worked out")
    chance, f = act[rows] * walk.prob, u[rows]
    state = rows // n_actions
    pay = walk.w * walk.pay if walk.by_move else walk.pay[rows]
    mean = solve_policy_system(first, np.bincount(state, chance * f * pay, n).astype(np.float64), gamma).x
    value = f * (pay + gamma * walk.w * mean[walk.indices])
    own: Array = np.bincount(state, chance * (value - mean[state]) ** 2, n).astype(np.float64)
    try:
        var = solve_policy_system(second, own, gamma**2).x
    except DivergentKernelError as error:
        raise DivergentKernelError(
            "horizon must be given: the infinite sum has no variance, the second moment of its weights grows too fast "
            f"({error})"
        ) from None
    begin, initial = walk.first
    total = dot(initial, mean[begin])
    start = dot(initial, (mean[begin] - total) ** 2)
    found = Moments(total, start + dot(initial, np.maximum(var[begin], 0.0)))
    if not sources:
        return found
    reached = solve_policy_system(second, walk.initial, gamma**2, transpose=True).x
    return Moments(total, found.variance, 0.0, None, reached * own)


def entries(walk: Walk, data: Array) -> sparse.csr_array:
    """(S*A, S) with these values on the moves."""
    kind = np.int32 if walk.indptr.dtype == np.uint32 else np.int64
    shape = walk.act.shape[1], walk.n_states
    return sparse.csr_array((data, walk.indices.view(kind), walk.indptr.view(kind)), shape=shape)


def weighted_kernel(walk: Walk, power: int) -> sparse.csr_array:
    """(S, S): sum_a act u^power sum P w^power."""
    n = walk.n_states
    rows = np.repeat(np.arange(walk.act.shape[1]), np.diff(walk.indptr))
    data = walk.act[0][rows] * walk.u[0][rows] ** power * walk.prob * walk.w**power
    state = rows // (walk.act.shape[1] // n)
    return sparse.csr_array((data, (state, walk.indices)), shape=(n, n))
