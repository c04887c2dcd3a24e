"""Weighted paths: how they are drawn and weighted, where they lead, and how fast their
weights grow.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular.exact import _moments
from oee_tabular.exact.reweighted import entries_of_ratio
from oee_tabular.exact.system import as_readonly, rows_of, spectral_radius
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import limit_horizon
from oee_tabular.typing import Array, BoolArray, IntArray, PolicyLike


class Walk(NamedTuple):
    """How paths are drawn, weighted and rewarded, as the kernels read it.

    Actions are drawn from ``act`` and transitions from ``prob``; a step multiplies the
    weight by u(s, a) and w(s, a, s').

    Attributes
    ----------
    indptr, indices, prob : the rows of P
    w : aligned with its entries
    act, u : (1 or T, S*A)
    by_transition : whether rewards are r(s, a, s')
    rewards : (1 or T, .), aligned with the entries of P, or with its rows unless
        ``by_transition``
    initial, discount : of the MDP
    """

    indptr: Any
    indices: Any
    prob: Array
    w: Array
    act: Array
    u: Array
    by_transition: bool
    rewards: Array
    initial: Array
    discount: float

    @property
    def n_states(self) -> int:
        """S."""
        return len(self.initial)

    @property
    def rows(self) -> IntArray:
        """The row s*A + a of each entry."""
        return np.repeat(np.arange(self.act.shape[1]), np.diff(self.indptr))

    def sum_actions(self, numbers: Array) -> Array:
        """(., S): sums over the actions of (., S*A)."""
        return np.asarray(numbers.reshape(len(numbers), self.n_states, -1).sum(axis=2))

    def row_matrix(self, data: Array) -> sparse.csr_array:
        """(S*A, S) with these values on the transitions."""
        kind = np.int32 if self.indptr.dtype == np.uint32 else np.int64
        shape = self.act.shape[1], self.n_states
        return sparse.csr_array(
            (data, self.indices.view(kind), self.indptr.view(kind)), shape=shape
        )

    def state_matrix(self, data: Array) -> sparse.csr_array:
        """(S, S) with the sums over the actions of these values on the transitions."""
        n = self.n_states
        return sparse.csr_array(
            (data, (self.rows // (self.act.shape[1] // n), self.indices)), shape=(n, n)
        )

    def weighted_kernel(self, power: int) -> sparse.csr_array:
        """(S, S): sum_a act u^power sum P w^power."""
        rows = self.rows
        return self.state_matrix(
            self.act[0][rows] * self.u[0][rows] ** power * self.prob * self.w**power
        )

    def weights_by_state(
        self, horizon: int, *, power: int, with_returns: bool = False
    ) -> Array:
        """(T + 1, 3 or 1, S): E[W^power G^i 1{s_t = s}]; without ``with_returns`` i = 0
        alone.
        """
        return np.asarray(_moments.forward(self, horizon, power, with_returns))

    def reachable_states(self, horizon: int | None = None) -> BoolArray:
        """(S,): whether a path may be there at some t below the horizon."""
        graph = self.state_matrix(self.act.max(axis=0)[self.rows] * self.prob).T
        reached = self.initial > 0.0
        for _ in range(
            self.n_states if horizon is None else min(horizon - 1, self.n_states)
        ):
            ahead = reached | (graph @ reached > 0.0)
            if (ahead == reached).all():
                break
            reached = ahead
        return np.asarray(reached)


def walk_of(
    mdp: FiniteMDP,
    behavior: Array,
    *,
    ratio: object = None,
    policy: Array | None = None,
) -> Walk:
    """Paths of ``behavior`` in ``mdp`` weighted by ``ratio`` on transitions or by
    policy / behavior on actions.

    The weights are constant in absorbing states. Behaviour policies without support are
    the callers' concern.
    """
    matrix = mdp.csr
    absorbing = mdp.absorbing()
    w = (
        np.ones(matrix.nnz)
        if ratio is None
        else transition_factors(mdp, ratio, absorbing)
    )
    act = np.atleast_2d(behavior.reshape(-1, mdp.n_states * mdp.n_actions))
    u = np.ones_like(act)
    if policy is not None:
        evaluated = np.broadcast_to(
            policy.reshape(-1, mdp.n_states * mdp.n_actions), act.shape
        )
        u = np.divide(evaluated, act, out=np.zeros_like(act), where=act > 0)
        u = np.where(np.repeat(absorbing, mdp.n_actions), 1.0, u)
    by_transition = mdp.reward_data is not None
    rewards = (
        mdp.reward_data if mdp.reward_data is not None else mdp.rewards.reshape(-1)
    )
    drawn = as_readonly(w), as_readonly(act), as_readonly(u)
    return Walk(
        *rows_of(matrix),
        *drawn,
        by_transition,
        as_readonly(rewards[None]),
        mdp.initial,
        mdp.discount,
    )


def transition_factors(mdp: FiniteMDP, ratio: object, absorbing: BoolArray) -> Array:
    """(entries,) zeta on the transitions; 1 in absorbing states."""
    entries = np.diff(mdp.csr.indptr[:: mdp.n_actions])
    return np.where(
        np.repeat(absorbing, entries), 1.0, entries_of_ratio(mdp, ratio, "zeta")
    )


def weight_moments(
    simulator: FiniteMDP, zeta: object, policy: PolicyLike, *, horizon: int
) -> tuple[Array, Array]:
    """Compute E[W_t] and E[W_t^2] for t = 0..T, W_t = zeta_1 ... zeta_t: two (T + 1,)
    arrays.

    In absorbing states with reward 0, where an episode has ended, W_t is constant.

    E[W_t] = 1 for every t where the rows of zeta * P sum to 1; log E[W_t^2] / t ->
    ``weight_growth``.

    Parameters
    ----------
    simulator, zeta : as in ``weighted_return_moments``
    policy : (S, A) or (T, S, A)
    horizon : T, a positive int

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> first, second = weight_moments(simulator, oee.true_ratio(target, simulator), [[1.0]] * 2, horizon=3)
    >>> first.round(6).tolist(), second.round(4).tolist()  # 1.04^t
    ([1.0, 1.0, 1.0, 1.0], [1.0, 1.04, 1.0816, 1.1249])
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    length = _checks.positive_integer(horizon, "horizon")
    pi = check_policy(policy, simulator, horizon=length)
    walk = walk_of(simulator, pi, ratio=zeta)
    length = limit_horizon(
        length, 1.0, work=4.0 * len(walk.prob), kept=6.0 * walk.n_states
    )
    first, second = (
        walk.weights_by_state(length, power=power)[:, 0].sum(axis=1) for power in (1, 2)
    )
    return first, second


def radius_of(matrix: sparse.csr_array) -> float:
    """The spectral radius, by its eigenvalues where there are few."""
    if not np.isfinite(matrix.data).all():
        return np.inf  # of squares beyond the largest float
    if matrix.shape[0] <= 400:
        return float(np.abs(np.linalg.eigvals(matrix.toarray())).max())
    return spectral_radius(matrix)


@one_thread
def weight_growth(simulator: FiniteMDP, zeta: object, policy: PolicyLike) -> float:
    """Compute the log of the spectral radius of (P zeta^2) under the policy: the rate
    at which E[W_t^2] grows, nats a step.

    Nonnegative where rows of zeta * P sum to 1, 0 only where zeta = 1 on the
    transitions that recur. Of a reducible chain the largest over all classes.

    Parameters
    ----------
    simulator, zeta : as in ``weighted_return_moments``
    policy : (S, A)

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> round(weight_growth(simulator, oee.true_ratio(target, simulator), [[1.0]] * 2), 4)  # log 1.04
    0.0392
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    walk = walk_of(simulator, check_policy(policy, simulator), ratio=zeta)
    radius = radius_of(walk.weighted_kernel(2))
    return float(np.log(radius)) if radius > 0 else -np.inf
