"""``value_range``: all values that Assumption V.1 allows before any log.

Assumption V.1 bounds the ratio, nu P(s' | s, a) <= P'(s' | s, a) <= mu P(s' | s, a). The models within that box have their
least value in [1, 2]

    V-(s) = sum_a pi(a | s) [nu E_P u + (1 - nu) CVaR_tau(u)],    u(s') = r(s, a, s') + gamma V-(s'),
    tau   = (1 - nu) / (mu - nu),

CVaR_tau the mean of u over its worst share tau under P: each row keeps nu P and sends the remaining 1 - nu to the worst next
states, (mu - nu) P at most to each. Their largest value V+ has the best share in place of the worst. This is the robust
Bellman equation of ``inference.robust`` without counts.

Sources: [1] A. Bennett, N. Kallus, M. Oprescu, W. Sun and K. Wang, Efficient and sharp off-policy evaluation in robust Markov
decision processes, NeurIPS 2024, arXiv 2404.00099. [2] G. Iyengar, Robust dynamic programming, Mathematics of Operations
Research 30, 2005.
"""

from __future__ import annotations

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import PolicyLike
from oee_tabular._threads import one_thread
from oee_tabular.exact.system import policy_system, recurrent_states
from oee_tabular.inference.evidence import Evidence, evidence_of
from oee_tabular.inference.intervals import Interval
from oee_tabular.inference.robust import extreme_value
from oee_tabular.mdp import FiniteMDP, check_policy


@one_thread
def value_range(
    simulator: FiniteMDP,
    policy: PolicyLike,
    lower_ratio: float | None,
    upper_ratio: float | None,
    *,
    horizon: int | None = None,
) -> Interval:
    """Return the values of a policy in all targets with lower_ratio * P <= P' <= upper_ratio * P (Assumption V.1).

    Parameters
    ----------
    simulator : FiniteMDP
    policy : as for ``policy_value``; with a horizon T also (T, S, A)
    lower_ratio : nu in [0, 1]; 0 (or None) sets no lower bound
    upper_ratio : mu in [1, inf]; inf (or None) sets no upper bound
    horizon : number of rewards; None: the infinite discounted sum

    Returns
    -------
    Interval
        Both ends are attained by models in the box, so that nothing narrower is true of all of them. ``confidence`` is 1, and
        ``method`` "range". ``diagnostics``: the number of ``sweeps``, and by how much at most rounding widened an end
        (``certified_beyond``).

    Raises
    ------
    ValueError
        Bad arguments; discount 1 without a horizon where the sum diverges in some model of the box.

    Notes
    -----
    ``interval`` with this box tends to the range of the models that agree with the log: where nothing is recorded the two
    are the same. With a horizon the target may change from step to step. Cost: some policy evaluations, and O(nnz) a sweep.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.tasks.gridworld(4, slip=0.3)
    >>> expert = oee.tasks.gridworld_expert(4)
    >>> print(value_range(simulator, expert, 0.5, 2.0))
    [-13.48, -3.82], range over all models in the box; discounted sum of rewards, not normalised
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    horizon = _checks.optional_horizon(horizon)
    pi = check_policy(policy, simulator, horizon=horizon)
    evidence = evidence_of(simulator, pi, horizon, None, lower_ratio, upper_ratio)
    if simulator.discount == 1.0 and horizon is None:
        _require_end(evidence)
    free = np.full(len(evidence.n), np.inf)
    low, high = (extreme_value(evidence, free, sign) for sign in (-1.0, 1.0))
    beyond = max(abs(end.bound - end.value) for end in (low, high))
    facts = {"sweeps": max(low.sweeps, high.sweeps), "certified_beyond": beyond}
    return Interval(low.bound, high.bound, 1.0, "range", facts)


def _require_end(evidence: Evidence) -> None:
    """Refuse a box in which some model keeps the policy for ever among states that it leaves in the simulator.

    The largest set X of such states: of each of its rows nothing has to leave X (nu = 0 or no successor outside), and X can
    take all mass (mu P(X) >= 1).
    """
    model, rows = evidence.model, evidence.rows
    system, rewards = policy_system(model, evidence.policy), (evidence.policy * model.rewards).sum(axis=1)
    inside = ~recurrent_states(system, rewards, model.names)  # which refuses a simulator whose own sum diverges
    taken = evidence.policy.reshape(-1) > 0
    while inside.any():
        kept = inside[rows.arrival]
        leaving = rows.sums(np.where(kept, 0.0, evidence.low))
        room = rows.sums(np.where(kept, evidence.high, 0.0))
        closed = ~taken | ((leaving <= 0.0) & (room >= 1.0 - _checks.SUM_TOLERANCE))
        smaller = inside & closed.reshape(-1, model.n_actions).all(axis=1)
        if (smaller == inside).all():
            state = model.names.state(np.flatnonzero(inside)[0])
            raise ValueError(
                "horizon must be given: at discount 1 the infinite sum exists only where the policy is absorbed in every "
                f"model of the box; with lower_ratio 0 it may stay for ever among states of which s={state} is one"
            )
        inside = smaller
