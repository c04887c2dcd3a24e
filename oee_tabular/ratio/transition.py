"""The ratio of transition probabilities zeta = P_target / P_simulator: the paper's Section IV.B.

Three ways from counts to zeta:

"conditional" (the default)
    The simulator P is known. For each (s, a): minimise sum_s' P z - p log z (+ ridge) over the box, subject to
    sum_s' P z = 1, with p the row's frequencies shrunk to a prior row (``conditional``). At strength 0 the
    maximum-likelihood model.
"ratio_of_ratios" (the paper's)
    beta_sas' and beta_sa are fitted apart, target counts against data of the simulator, and zeta is their quotient
    (``quotient``). Nothing makes the rows of zeta * P sum to 1.
"joint"
    Both betas in one program, under sum_s' d(s, a, s') beta_sas' = d(s, a) beta_sa (``joint``), which makes the rows sum to 1.
"""

from __future__ import annotations

from typing import Any

from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import align
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.ratio.conditional import PRIORS, Ridge, fit_conditional
from oee_tabular.ratio.density import check_box
from oee_tabular.ratio.joint import fit_joint
from oee_tabular.ratio.quotient import SimulatorData, fit_quotient
from oee_tabular.ratio.result import TransitionRatio, make_result
from oee_tabular.ratio.support import aligned_counts, refuse_unsupported

METHODS = ("conditional", "ratio_of_ratios", "joint")


def transition_ratio(
    log_or_counts: Transitions | sparse.csr_array,
    simulator: FiniteMDP,
    *,
    method: str = "conditional",
    simulator_data: SimulatorData = None,
    prior: str | None = None,
    strength: float | str | None = None,
    features: Any = None,
    lower: float | None = None,
    upper: float | None = None,
    ridge: Ridge = 0.0,
    toward: float | None = 1.0,
    behavior_policy: Any = None,
    seed: Any = None,
    solver: str = "dual",
) -> TransitionRatio:
    """zeta(s, a, s') = P_target / P_simulator from a log of the target.

    Parameters
    ----------
    log_or_counts : Transitions, or csr of counts of shape (S*A, S)
    simulator : FiniteMDP
    method : "conditional" | "ratio_of_ratios" | "joint"
    prior : "tilt" (default) | "simulator" | "none"; conditional only
        The row that every row is shrunk to: the simulator's, or that of its conditional exponential tilt
        zeta proportional to exp(theta . phi), fitted to all rows together.
    strength : "evidence" (default) | "loo", or a nonnegative number; conditional only
        How many moves the prior's row is worth (kappa, the strength of a Dirichlet prior): chosen by its marginal
        likelihood or by leave-one-out, one for each kind of rows (those in which the simulator has the same
        probabilities), or given. ``details`` has the choice, its curve and its meaning.
    features : phi for the tilt: None (log P, one parameter), an array aligned with ``simulator.transitions.data``, one of
        shape (S, A, S) or (S, A, S, d), or a function of (s, a, s'); ``oee.ratio.action_displacement`` makes some
    lower, upper : bounds on zeta (conditional; default none) or on each beta (the other two; default 0.01 and 10, the
        paper's nu and mu; ``numpy.inf`` for none), so that the quotient lies in [lower/upper, upper/lower]
    ridge, toward : as in ``density_ratio``; conditional: a row's program has ridge/2 * sum P (zeta - toward)^2 (toward
        None: sum zeta^2), a function gets the count n_sa of each row that has one, and "evidence" or "loo" chooses
        kappa / n_sa on the data
    simulator_data : ratio_of_ratios and joint (which uses its d(s, a) alone)
        A log of the simulator; None: one of the target log's size is sampled under its estimated behaviour policy, with
        ``seed``; "exact": the simulator's exact occupancy under that policy
    behavior_policy : (S, A), instead of the estimated one; not for conditional
    solver : "dual", or a cvxpy solver

    Returns
    -------
    TransitionRatio
        Rows without data have the prior's zeta (1, or the tilt's); ``visited`` says which have some.

    Raises
    ------
    ValueError
        A move of the log to which the simulator gives probability 0 (named); bad options.

    Notes
    -----
    conditional -> the true zeta on every row visited, at rate n^-1/2; O(nnz) with "dual".
    """
    _checks.one_of(method, "method", METHODS)
    if not isinstance(simulator, FiniteMDP):
        raise ValueError(f"simulator must be a FiniteMDP; got {type(simulator).__name__}")
    if isinstance(log_or_counts, Transitions):
        counts = log_or_counts.counts(simulator.n_states, simulator.n_actions)
    elif sparse.issparse(log_or_counts):
        counts = sparse.csr_array(log_or_counts)
    else:
        raise ValueError(f"log_or_counts must be Transitions or sparse counts; got {type(log_or_counts).__name__}")
    observed = aligned_counts(counts, simulator)
    if not observed.sum() > 0:
        raise ValueError("log_or_counts must have at least one move; it has none")
    conditional = method == "conditional"
    foreign = {"simulator_data": simulator_data, "behavior_policy": behavior_policy}
    if not conditional:
        foreign = {"prior": prior, "strength": strength, "features": features}
    elif features is not None and prior not in (None, "tilt"):
        raise ValueError(f"features must be left out with prior {prior!r}, which does not use them")
    for name, value in foreign.items():
        if value is not None:
            raise ValueError(f"{name} must not be given with method {method!r}, which does not use it; got {value!r}")
    if conditional:
        prior = "tilt" if prior is None else prior
        _checks.one_of(prior, "prior", PRIORS)
        return fit_conditional(
            observed,
            simulator,
            prior=prior,
            strength="evidence" if strength is None else strength,
            features=features,
            box=check_box(lower, upper, normalized=True),
            ridge=ridge,
            toward=toward,
            solver=solver,
        )
    if isinstance(ridge, str):
        raise ValueError(f"ridge must be a number or a function of n with method {method!r}; got {ridge!r}")
    bounds = {"lower": 0.01 if lower is None else lower, "upper": 10.0 if upper is None else upper}
    whole = log_or_counts if isinstance(log_or_counts, Transitions) else None
    if behavior_policy is not None:
        behavior_policy = check_policy(behavior_policy, simulator, name="behavior_policy")
    if method == "joint":
        return fit_joint(
            observed,
            whole,
            simulator,
            simulator_data,
            behavior=behavior_policy,
            seed=seed,
            ridge=ridge,
            solver=solver,
            **bounds,
        )
    quotient = fit_quotient(
        observed,
        whole,
        simulator,
        simulator_data,
        behavior_policy=behavior_policy,
        seed=seed,
        **bounds,
        ridge=ridge,
        toward=toward,
        solver=solver,
    )
    return make_result(simulator, quotient.zeta, "ratio_of_ratios", quotient.gap, observed, quotient.details)


def true_ratio(target: FiniteMDP, simulator: FiniteMDP) -> TransitionRatio:
    """zeta = P_target / P_simulator on the simulator's support.

    Raises ValueError where the target moves outside that support, naming the moves.
    """
    for name, value in (("target", target), ("simulator", simulator)):
        if not isinstance(value, FiniteMDP):
            raise ValueError(f"{name} must be a FiniteMDP; got {type(value).__name__}")
    if target.transitions.shape != simulator.transitions.shape:
        raise ValueError(
            f"target and simulator must have the same states and actions; their transitions have shapes "
            f"{target.transitions.shape} and {simulator.transitions.shape}"
        )
    refuse_unsupported(target.transitions, simulator, what="target")
    data, _ = align(target.transitions, simulator.transitions)
    return make_result(simulator, data / simulator.transitions.data, "true", 0.0, data, {})
