"""The ratio of transition probabilities zeta = P_target / P_simulator: the paper's Section IV.B.

Six ways from counts to zeta:

"conditional" (the default)
    The simulator P is known. For each (s, a): minimise sum_s' P z - p log z (+ ridge) over the box, subject to
    sum_s' P z = 1, with p the row's frequencies shrunk to a prior row (``conditional``). At strength 0 the
    maximum-likelihood model.
"linear", "kernel"
    The same risk over zeta = 1 + Phi w, features centred in each row: all rows share w (``linear``).
"tied"
    Entries with one key share one ratio, so that rows which are alike pool their counts (``ties``).
"ratio_of_ratios" (the paper's)
    beta_sas' and beta_sa are fitted apart, target counts against data of the simulator, and zeta is their quotient
    (``quotient``). Nothing makes the rows of zeta * P sum to 1.
"joint"
    Both betas in one program, under sum_s' d(s, a, s') beta_sas' = d(s, a) beta_sa (``joint``), which makes the rows sum to 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import align, on_pattern
from oee_tabular._threads import one_thread
from oee_tabular.data import Transitions
from oee_tabular.exact import occupancy
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import optional_steps
from oee_tabular.ratio.box import check_box
from oee_tabular.ratio.conditional import PRIORS, Ridge, fit_conditional
from oee_tabular.ratio.features import Kernel
from oee_tabular.ratio.joint import fit_joint
from oee_tabular.ratio.library import values_in
from oee_tabular.ratio.linear import N_CENTERS, fit_linear
from oee_tabular.ratio.quotient import SimulatorData, fit_quotient
from oee_tabular.ratio.result import TransitionRatio, make_result
from oee_tabular.ratio.support import aligned_counts, refuse_unsupported, require_pair
from oee_tabular.ratio.ties import Tie, tied_ratio

# the options that a method has for itself
_OWN = {
    "conditional": {"prior", "strength", "features", "smoothness", "values_of", "horizon"},
    "tied": {"tie", "strength"},
    "linear": {"features"},
    "kernel": {"kernel", "coordinates", "bandwidth", "n_centers"},
    "ratio_of_ratios": {"simulator_data", "behavior_policy"},
    "joint": {"simulator_data", "behavior_policy", "ratio_lower", "ratio_upper"},
}
METHODS = tuple(_OWN)


@one_thread
def transition_ratio(
    log_or_counts: Transitions | sparse.csr_array,
    simulator: FiniteMDP,
    *,
    method: str = "conditional",
    simulator_data: SimulatorData = None,
    prior: str | None = None,
    strength: float | str | None = None,
    features: Any = None,
    values_of: Any = None,
    horizon: int | None = None,
    smoothness: float | str | None = None,
    tie: Tie | Any = None,
    kernel: str | Kernel | None = None,
    coordinates: Any = None,
    bandwidth: float | None = None,
    n_centers: int | None = None,
    lower: float | None = None,
    upper: float | None = None,
    ratio_lower: float | None = None,
    ratio_upper: float | None = None,
    ridge: Ridge | None = None,
    toward: float | None = 1.0,
    discount: float | None = None,
    behavior_policy: Any = None,
    seed: Any = None,
    solver: str = "dual",
) -> TransitionRatio:
    """zeta(s, a, s') = P_target / P_simulator from a log of the target.

    Parameters
    ----------
    log_or_counts : Transitions, or csr of counts of shape (S*A, S)
    simulator : FiniteMDP
    method : "conditional" | "tied" (also where ``tie`` is given) | "linear" | "kernel" | "ratio_of_ratios" | "joint"
    prior : "average" (default) | "tilt" (default where ``features`` or ``smoothness`` is given) | "simulator" | "none";
        conditional only
        The row that every row is shrunk to: the simulator's, that of its conditional exponential tilt zeta proportional to
        exp(theta . phi), fitted to all rows together under the penalty |theta|^2 / 2 on standardised features, a unit
        Gaussian prior (theta varies over the states where the log gives evidence that it does), or the average by
        evidence of these two and of tilts along directions made from the simulator and ``values_of`` (``ratio.centre``).
    strength : "evidence" (default) | "loo", or a nonnegative number; conditional, and tied (a number, default 3)
        How many moves the prior's row is worth (kappa, the strength of a Dirichlet prior): chosen by its marginal
        likelihood or by leave-one-out, at least 1, one for each kind of rows (those in which the simulator has the same
        probabilities; kinds with fewer than 5 visited rows or 100 moves are pooled), or given. ``details`` has the choice,
        its curve and its meaning.
    features : phi for the tilt and for "linear": None (tilt: log P, and (log P)^2 where the evidence asks for it), an
        array aligned with ``simulator.transitions.data``, one of shape (S, A, S) or (S, A, S, d), or a function of
        (s, a, s'); ``oee.ratio.action_displacement`` makes some
    values_of : (S, A), or a list of such
        The policy, or policies, whose values matter: r(s, a, s') + gamma V(s') of each in the simulator is one of the
        directions of "average"; the other priors do not use them, so that giving both is an error
    horizon : of these values; None: the infinite sum. Without ``values_of`` it has no use and must be left out
    smoothness : "evidence" (default), a positive number, or ``numpy.inf``; conditional with the tilt only
        How much alike theta is in neighbouring states (lambda of ``ratio.local_tilt``): chosen by its evidence, given, or
        infinite: one theta for all states. ``details["theta_by_state"]`` shows where the target differs.
    tie : which entries share one ratio: integers, one for each entry of ``simulator.transitions.data``, or a function of
        the arrays (s, a, s') of all entries that returns them; see ``ratio.tied_ratio``
    kernel, coordinates, bandwidth, n_centers : "gaussian" (moves of one action are alike as the coordinates of s, (S,) or
        (S, c), and the displacements to s' are; ``bandwidth`` 1 in standard deviations), or a function of (m, 1 + 2c) and
        (k, 1 + 2c) points (action, coordinates of s, displacement) giving an (m, k) array; beyond ``n_centers`` (200) moves the
        kernel is replaced by its pivoted Cholesky approximation, whose error is in ``details``
    lower, upper : bounds on zeta (conditional, linear, kernel; default none) or on each beta (the other two; default 0.01
        and 10, the paper's nu and mu; ``numpy.inf`` for none), so that the quotient lies in [lower/upper, upper/lower]
    ratio_lower, ratio_upper : joint only: the box ratio_lower <= beta_sas' / beta_sa <= ratio_upper
    ridge, toward : as in ``density_ratio`` (default 0); linear and kernel: ridge/2 * |w|^2 in the risk per move, default 1 / n;
        conditional: a row's program has ridge/2 * sum P (zeta - toward)^2 (toward
        None: sum zeta^2), a function gets the count n_sa of each row that has one, and "evidence" or "loo" chooses
        kappa / n_sa on the data
    discount : count each move discount^timestep, as the paper's discounted d does, on both sides (default: count all alike)
    simulator_data : ratio_of_ratios and joint (which uses its d(s, a) alone)
        A log of the simulator; None: one of the target log's size is sampled under its estimated behaviour policy, with
        ``seed``; "exact": the simulator's exact occupancy under that policy
    behavior_policy : (S, A), instead of the estimated one; ratio_of_ratios and joint
    seed : of the simulator's data, where they are sampled
    solver : "dual", or a cvxpy solver

    Returns
    -------
    TransitionRatio
        Rows without data have the prior's zeta (1, or the centre's); ``visited`` says which have some.

    Raises
    ------
    ValueError
        A move of the log to which the simulator gives probability 0 (named); bad options.

    Notes
    -----
    conditional -> the true zeta on every row visited, at rate n^-1/2; O(nnz) with "dual".

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> fit = transition_ratio(log, simulator)
    >>> bool(abs(fit.values.data - [0.8, 1.2, 0.8, 1.2]).max() < 0.05), fit.gap < 1e-9
    (True, True)
    """
    _checks.one_of(method, "method", METHODS)
    _checks.instance(solver, str, "solver")
    if tie is not None and method == "conditional":
        method = "tied"
    _checks.instance(simulator, FiniteMDP, "simulator")
    options = {
        "prior": prior,
        "strength": strength,
        "features": features,
        "values_of": values_of,
        "horizon": horizon,
        "smoothness": smoothness,
        "tie": tie,
        "kernel": kernel,
        "coordinates": coordinates,
        "bandwidth": bandwidth,
        "n_centers": n_centers,
        "simulator_data": simulator_data,
        "behavior_policy": behavior_policy,
        "ratio_lower": ratio_lower,
        "ratio_upper": ratio_upper,
    }
    for name, value in options.items():
        if value is not None and name not in _OWN[method]:
            raise ValueError(f"{name} must not be given with method {method!r}, which does not use it; got {value!r}")
    if prior is None:
        prior = "average" if features is None and smoothness is None else "tilt"
    _checks.one_of(prior, "prior", PRIORS)
    for name, user in {"features": "tilt", "smoothness": "tilt", "values_of": "average"}.items():
        if options[name] is not None and prior != user:
            raise ValueError(f"{name} must be left out with prior {prior!r}, which does not use them")
    if horizon is not None and values_of is None:
        raise ValueError("horizon must be left out without values_of: it is that of the values")
    observed = _observed(log_or_counts, simulator, discount)
    if method == "conditional":
        steps = optional_steps(horizon, simulator)
        return fit_conditional(
            observed,
            simulator,
            prior=prior,
            strength="evidence" if strength is None else strength,
            features=features,
            smoothness="evidence" if smoothness is None else smoothness,
            box=check_box(lower, upper, normalized=True),
            ridge=0.0 if ridge is None else ridge,
            toward=toward,
            solver=solver,
            **_of_policies(_policies(values_of, simulator), simulator, steps),
        )
    if method == "tied":
        for name, value in {"lower": lower, "upper": upper, "ridge": ridge}.items():
            if value is not None:
                raise ValueError(f"{name} must not be given with method 'tied', which does not use it; got {value!r}")
        if tie is None:
            raise ValueError("tie must be given with method 'tied': a key for each entry, or a function of (s, a, s')")
        pooled = on_pattern(simulator.transitions, observed)
        return tied_ratio(pooled, simulator, tie, strength=_strength(strength))
    if isinstance(ridge, str):
        raise ValueError(f"ridge must be a number or a function of n with method {method!r}; got {ridge!r}")
    if method in ("linear", "kernel"):
        return fit_linear(
            observed,
            simulator,
            features=features,
            kernel=("gaussian" if kernel is None else kernel) if method == "kernel" else None,
            coordinates=coordinates,
            bandwidth=1.0 if bandwidth is None else bandwidth,
            n_centers=N_CENTERS if n_centers is None else _checks.positive_integer(n_centers, "n_centers"),
            box=check_box(lower, upper, normalized=True),
            ridge=ridge,
            solver=solver,
        )
    whole = log_or_counts if isinstance(log_or_counts, Transitions) else None
    if behavior_policy is not None:
        behavior_policy = check_policy(behavior_policy, simulator, name="behavior_policy")
    common: dict[str, Any] = {
        "seed": seed,
        "ridge": 0.0 if ridge is None else ridge,
        "solver": solver,
        "discount": discount,
        "lower": 0.01 if lower is None else lower,
        "upper": 10.0 if upper is None else upper,
    }
    if method == "joint":
        return fit_joint(
            observed,
            whole,
            simulator,
            simulator_data,
            behavior=behavior_policy,
            ratio_lower=ratio_lower,
            ratio_upper=ratio_upper,
            **common,
        )
    quotient = fit_quotient(
        observed, whole, simulator, simulator_data, behavior_policy=behavior_policy, toward=toward, **common
    )
    return make_result(simulator, quotient.zeta, "ratio_of_ratios", quotient.gap, observed, quotient.details)


def _of_policies(policies: list[Array], simulator: FiniteMDP, horizon: int | None) -> dict[str, Any]:
    """V of each policy in the simulator, and the time that they spend in each row, all together."""
    found: dict[str, Any] = {"values": values_in(simulator, policies, horizon)}
    if policies and (horizon is not None or simulator.discount < 1.0):
        times = [occupancy(simulator, policy, horizon=horizon).reshape(-1) for policy in policies]
        found["time"] = np.sum(times, axis=0)
    return found


def _policies(values_of: Any, simulator: FiniteMDP) -> list[Array]:
    """The policy or policies given, checked."""
    if values_of is None:
        return []
    several = isinstance(values_of, list | tuple) and len(values_of) > 0 and np.ndim(values_of[0]) == 2
    given = list(values_of) if several else [values_of]
    names = [f"values_of[{k}]" for k in range(len(given))] if several else ["values_of"]
    return [check_policy(policy, simulator, name=name) for policy, name in zip(given, names, strict=True)]


def _strength(value: float | str | None) -> float:
    if isinstance(value, str):
        raise ValueError(f"strength must be a number with method 'tied'; got {value!r}")
    return 3.0 if value is None else value


def _observed(log_or_counts: Any, simulator: FiniteMDP, discount: float | None) -> Array:
    """Counts on the simulator's entries, weighted by discount^timestep where a discount is given."""
    if isinstance(log_or_counts, Transitions):
        counts = log_or_counts.counts(simulator.n_states, simulator.n_actions, discount=discount)
    elif sparse.issparse(log_or_counts):
        if discount is not None:
            raise ValueError("discount must be left out where counts are given: they have no timesteps")
        counts = log_or_counts
    else:
        raise ValueError(f"log_or_counts must be Transitions or sparse counts; got {type(log_or_counts).__name__}")
    observed = aligned_counts(counts, simulator)
    if not observed.sum() > 0:
        raise ValueError("log_or_counts must have at least one move; it has none")
    return observed


def true_ratio(target: FiniteMDP, simulator: FiniteMDP) -> TransitionRatio:
    """zeta = P_target / P_simulator on the simulator's support.

    Parameters
    ----------
    target, simulator : FiniteMDP, of the same states and actions

    Raises
    ------
    ValueError
        The target moves outside that support; names the moves.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> true_ratio(target, simulator).values.toarray().round(6).tolist()
    [[0.8, 1.2], [0.8, 1.2]]
    """
    require_pair(target, simulator)
    refuse_unsupported(target.transitions, simulator, what="target")
    data, _ = align(target.transitions, simulator.transitions)
    return make_result(simulator, data / simulator.transitions.data, "true", 0.0, data, {})
