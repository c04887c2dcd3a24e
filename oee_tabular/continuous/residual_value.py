"""What a policy is worth in a simulator corrected by a log, and how sure that is: no cells, no report."""

from __future__ import annotations

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Seed
from oee_tabular.continuous.correction import describe_flaw
from oee_tabular.continuous.estimators import MonteCarloValue, Residual
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import StatePolicy
from oee_tabular.estimators import Estimate


def corrected_value(
    corrected: ResidualSimulator,
    policy: StatePolicy,
    n_episodes: int,
    horizon: int,
    *,
    discount: float = 0.99,
    refits: int = 20,
    paths: int = 1000,
    seed: Seed = None,
) -> Estimate:
    """J = E[sum_{t<T} gamma^t r_t] in the corrected simulator by Monte Carlo, its standard error and 95% interval.

        se^2 = se_MC^2 + Var_b (J_b - J),   J_b of the correction fitted to resampled episodes; by common random numbers

    Parameters
    ----------
    corrected : ResidualSimulator
    policy : function of states (n, d) giving probabilities (n, A)
    n_episodes : of the value
    horizon : T, the number of rewards
    discount : gamma, in [0, 1]
    refits, paths : how many logs are resampled, at least 2, and the episodes by which J_b - J is found
    seed : the same seed gives the same bits

    Returns
    -------
    Estimate
        ``status`` is not "ok", and there is no interval, where history explains what the correction leaves over: the state is
        not Markov then.

    Notes
    -----
    (n_episodes + (refits + 1) paths) horizon steps of the corrected simulator. The interval is that of Student's t. It covers
    what another log would have said; not a change that a smooth correction cannot follow.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=2000, max_steps=100, seed=0)
    >>> corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    >>> found = corrected_value(corrected, cartpole_policy(0.6), 1000, 100, refits=5, paths=200, seed=0)
    >>> found.status, bool(found.interval[0] < found.value < found.interval[1])
    ('ok', True)
    """
    _checks.instance(corrected, ResidualSimulator, "corrected")
    _checks.function(policy, "policy")
    steps = _checks.positive_integer(horizon, "horizon")
    episodes, n_refits = _checks.positive_integer(n_episodes, "n_episodes"), _checks.positive_integer(refits, "refits")
    if n_refits < 2:
        raise ValueError(f"refits must be at least 2, for a variance; got {refits}")
    each, gamma = _checks.positive_integer(paths, "paths"), _checks.number_in(discount, "discount", 0.0, 1.0)
    key = np.zeros((0, 0))  # the policy's only name
    value = MonteCarloValue(corrected, {key.tobytes(): policy}, steps, episodes, gamma, _checks.seed_sequence(seed, ()))
    return Residual(value, corrected, n_refits, each, describe_flaw(corrected))(None, key)  # type: ignore[arg-type]  # no finite problem is behind it
