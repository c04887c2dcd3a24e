"""Weighted paths: how they are drawn and weighted, and how fast their weights grow."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import repeat_rows
from oee_tabular.exact import _moments
from oee_tabular.exact.reweighted import RatioLike, entries_of_ratio
from oee_tabular.exact.system import as_readonly, rows_of, spectral_radius
from oee_tabular.mdp import FiniteMDP, check_policy, limit_horizon
from oee_tabular.typing import Array, BoolArray, Csr, IntArray, PolicyLike

# states up to which eigenvalues are computed, exactly but for rounding, in O(S^3)
MAX_EIGENVALUE_STATES = 400


class Walk(NamedTuple):
    """Hold how paths are drawn, weighted and rewarded, in arrays for compiled loops.

    Actions are drawn from ``act`` and transitions from ``prob``; a step multiplies the
    weight by u(s, a) and w(s, a, s').

    Attributes
    ----------
    indptr, indices, prob : ndarray
        The rows of P in CSR form.
    w : ndarray of shape (nnz,)
        Factor of each entry of P.
    act, u : ndarray of shape (1 or T, S*A)
        Probability and factor of each state-action pair.
    by_transition : bool
        Whether rewards are r(s, a, s').
    rewards : ndarray of shape (1 or T, nnz or S*A)
        Rewards aligned with the entries of P, or with its rows unless
        ``by_transition``.
    initial : ndarray of shape (S,)
        The initial distribution of the MDP.
    discount : float
        The discount of the MDP.
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
        """Return the number of states S."""
        return len(self.initial)

    @property
    def rows(self) -> IntArray:
        """Return the row s*A + a of each entry."""
        return np.repeat(np.arange(self.act.shape[1]), np.diff(self.indptr))

    def sum_actions(self, numbers: Array) -> Array:
        """Sum numbers of shape (n, S*A) over the actions, to shape (n, S)."""
        return np.asarray(numbers.reshape(len(numbers), self.n_states, -1).sum(axis=2))

    def row_matrix(self, data: Array) -> Csr:
        """Make the csr matrix (S*A, S) with these values on the transitions."""
        kind = np.int32 if self.indptr.dtype == np.uint32 else np.int64
        shape = self.act.shape[1], self.n_states
        return sparse.csr_array(
            (data, self.indices.view(kind), self.indptr.view(kind)), shape=shape
        )

    def state_matrix(self, data: Array) -> Csr:
        """Sum values on the transitions over the actions, as csr (S, S)."""
        n = self.n_states
        states = self.rows // (self.act.shape[1] // n)
        return sparse.csr_array((data, (states, self.indices)), shape=(n, n))

    def weighted_kernel(self, power: int) -> Csr:
        """Compute sum_a act(a | s) u(s, a)^p P w^p, p = ``power``, as csr (S, S)."""
        rows = self.rows
        return self.state_matrix(
            self.act[0][rows] * self.u[0][rows] ** power * self.prob * self.w**power
        )

    def weights_by_state(
        self, horizon: int, *, power: int, with_returns: bool = False
    ) -> Array:
        """Compute E[W_t^power G_t^i 1{s_t = s}], of shape (T + 1, 3 or 1, S).

        i is 0, 1, 2 with returns and 0 alone without.
        """
        return np.asarray(_moments.forward(self, horizon, power, with_returns))

    def reachable_states(self, horizon: int | None = None) -> BoolArray:
        """Find the states (S,) where a path may be at some t below the horizon."""
        graph = self.state_matrix(self.act.max(axis=0)[self.rows] * self.prob).T
        reached = self.initial > 0.0
        n_steps = self.n_states
        if horizon is not None:
            n_steps = min(horizon - 1, n_steps)
        for _ in range(n_steps):
            ahead = reached | (graph @ reached > 0.0)
            if (ahead == reached).all():
                break
            reached = ahead
        return np.asarray(reached)


def walk_of(
    mdp: FiniteMDP,
    behavior: Array,
    *,
    ratio: RatioLike | None = None,
    policy: Array | None = None,
) -> Walk:
    """Make the paths of ``behavior`` in ``mdp`` with their weights.

    The weights are ``ratio`` on transitions, or policy / behavior on actions. They are
    constant in absorbing states. Callers check behaviour policies for their support.
    """
    matrix = mdp.csr
    absorbing = mdp.absorbing()
    if ratio is None:
        w = np.ones(matrix.nnz)
    else:
        w = transition_factors(mdp, ratio, absorbing)
    n_pairs = mdp.n_states * mdp.n_actions
    act = np.atleast_2d(behavior.reshape(-1, n_pairs))
    u = np.ones_like(act)
    if policy is not None:
        evaluated = np.broadcast_to(policy.reshape(-1, n_pairs), act.shape)
        u = np.divide(evaluated, act, out=np.zeros_like(act), where=act > 0)
        u = np.where(np.repeat(absorbing, mdp.n_actions), 1.0, u)
    rewards = mdp.reward_data
    by_transition = rewards is not None
    if rewards is None:
        rewards = mdp.rewards.reshape(-1)
    rows = rows_of(matrix)
    return Walk(
        indptr=rows.indptr,
        indices=rows.indices,
        prob=rows.data,
        w=as_readonly(w),
        act=as_readonly(act),
        u=as_readonly(u),
        by_transition=by_transition,
        rewards=as_readonly(rewards[None]),
        initial=mdp.initial,
        discount=mdp.discount,
    )


def transition_factors(mdp: FiniteMDP, ratio: RatioLike, absorbing: BoolArray) -> Array:
    """Return zeta on the transitions (nnz,), and 1 in absorbing states."""
    zeta = entries_of_ratio(mdp, ratio, "zeta")
    has_ended = repeat_rows(mdp.csr, np.repeat(absorbing, mdp.n_actions))
    return np.where(has_ended, 1.0, zeta)


def weight_moments(
    simulator: FiniteMDP, zeta: RatioLike, policy: PolicyLike, *, horizon: int
) -> tuple[Array, Array]:
    """Compute E[W_t] and E[W_t^2] for t = 0..T, where W_t = zeta_1 ... zeta_t.

    In absorbing states with reward 0, where an episode has ended, W_t is constant.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator that paths are drawn from.
    zeta : sparse array of shape (S*A, S), or an object with such ``values``
        The ratio of transition probabilities, row s*A + a, on the simulator's support.
        An entry that is not stored is 0.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A).
    horizon : int
        Number of transitions T.

    Returns
    -------
    first : ndarray of shape (T + 1,)
        E[W_t], which is 1 for every t where the rows of zeta * P sum to 1.
    second : ndarray of shape (T + 1,)
        E[W_t^2].

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    weight_growth : The limit of log E[W_t^2] / t.

    Notes
    -----
    Costs O(T nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> target = oee.FiniteMDP([[[0.4, 0.6]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> zeta = oee.true_ratio(target, simulator)
    >>> first, second = weight_moments(simulator, zeta, [[1.0]] * 2, horizon=3)
    >>> first.round(6).tolist()
    [1.0, 1.0, 1.0, 1.0]
    >>> second.round(4).tolist()  # 1.04^t
    [1.0, 1.04, 1.0816, 1.1249]
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


def radius_of(matrix: Csr) -> float:
    """Compute the spectral radius, by all eigenvalues where there are few states."""
    if not np.isfinite(matrix.data).all():
        return np.inf  # the kernel has squares beyond the largest float
    if matrix.shape[0] <= MAX_EIGENVALUE_STATES:
        return float(np.abs(np.linalg.eigvals(matrix.toarray())).max())
    return spectral_radius(matrix)


@one_thread
def weight_growth(simulator: FiniteMDP, zeta: RatioLike, policy: PolicyLike) -> float:
    """Compute the rate at which E[W_t^2] grows, in nats a step.

    It is the log of the spectral radius of (P zeta^2) under the policy.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator that paths are drawn from.
    zeta : sparse array of shape (S*A, S), or an object with such ``values``
        The ratio of transition probabilities, row s*A + a, on the simulator's support.
        An entry that is not stored is 0.
    policy : PolicyLike
        Stationary action probabilities of shape (S, A); other forms as in
        ``check_policy``.

    Returns
    -------
    float
        The growth rate; -inf where weights become 0.

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    weight_moments : E[W_t] and E[W_t^2] for each t.

    Notes
    -----
    It is nonnegative where rows of zeta * P sum to 1, and 0 only where zeta = 1 on the
    transitions that recur. For a reducible chain it is the largest over all classes.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> target = oee.FiniteMDP([[[0.4, 0.6]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> zeta = oee.true_ratio(target, simulator)
    >>> round(weight_growth(simulator, zeta, [[1.0]] * 2), 4)  # log 1.04
    0.0392
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    walk = walk_of(simulator, check_policy(policy, simulator), ratio=zeta)
    radius = radius_of(walk.weighted_kernel(2))
    return float(np.log(radius)) if radius > 0 else -np.inf
