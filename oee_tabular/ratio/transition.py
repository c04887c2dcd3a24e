"""The ratio of transition probabilities zeta = P_target / P_simulator (eq. 4.3) from a
log: the front door.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import align
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.conditional import Conditional
from oee_tabular.ratio.joint import Joint
from oee_tabular.ratio.linear import InClass
from oee_tabular.ratio.method import Method, RatioInput, SimulatorData
from oee_tabular.ratio.quotient import Quotient
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.support import refuse_unsupported, require_pair
from oee_tabular.ratio.ties import Tied
from oee_tabular.typing import PolicyLike, Seed

# What a method's name stands for: a class, those of its fields that are no options, and
# those that the name settles
METHODS: dict[str, tuple[Any, set[str], dict[str, Any]]] = {
    "conditional": (Conditional, set(), {}),
    "tied": (Tied, set(), {}),
    "linear": (InClass, {"kernel", "coordinates", "bandwidth", "n_centers"}, {}),
    "kernel": (InClass, {"features"}, {"kernel": "gaussian"}),
    "ratio_of_ratios": (Quotient, set(), {}),
    "joint": (Joint, set(), {}),
}
OPTIONS = {
    name: {each.name for each in fields(make)} - without
    for name, (make, without, _) in METHODS.items()
}


def method_named(name: str, **options: Any) -> Method:
    """The method object that a name and options stand for; an option of None is one
    left out, but for ``toward``.

    >>> method_named("linear", features=[1.0, 2.0])
    InClass(kernel=None, bandwidth=1.0, n_centers=200, lower=None, upper=None, ridge=None, solver='dual')
    """
    _checks.one_of(name, "method", tuple(METHODS))
    make, _, settled = METHODS[name]
    known = sorted(set().union(*OPTIONS.values()))
    given = {
        option: value
        for option, value in options.items()
        if value is not None or option == "toward"
    }
    for option, value in given.items():
        if option not in known:
            raise TypeError(
                f"{option} must be an option of a method: {', '.join(known)}; got"
                f" {_checks.show(value)}"
            )
        if option not in OPTIONS[name]:
            raise ArgumentError(
                option,
                f"must not be given with method {name!r}, which does not use it; got"
                f" {_checks.show(value)}",
            )
    made: Method = make(**{**settled, **given})
    return made


def transition_ratio(
    log_or_counts: Transitions | sparse.csr_array,
    simulator: FiniteMDP,
    *,
    method: str | Method = "conditional",
    discount: float | None = None,
    values_of: object = None,
    horizon: int | None = None,
    simulator_data: SimulatorData = None,
    behavior_policy: PolicyLike | None = None,
    seed: Seed = None,
    **options: object,
) -> TransitionRatio:
    """Estimate zeta(s, a, s') = P_target / P_simulator from a log of the target.

    Parameters
    ----------
    log_or_counts : Transitions, or csr of counts of shape (S*A, S)
    simulator : FiniteMDP
    method : "conditional" | "tied" (also where ``tie`` is given) | "linear" | "kernel"
        | "ratio_of_ratios" | "joint", or an object with its options: ``Conditional``,
        ``Tied``, ``InClass``, ``Quotient``, ``Joint`` (``oee.ratio``)
    discount : weight each transition by discount^timestep, as the paper's discounted d
        does, on both sides (default: 1)
    values_of : (S, A), or a list of such
        The policies whose values matter: r(s, a, s') + gamma V(s') of each in the
        simulator is a direction of ``Conditional``'s prior "ridge"; with another prior
        it is an error
    horizon : of these values; None: the infinite sum. Only with ``values_of``
    simulator_data : ``Quotient`` and ``Joint`` (which uses its d(s, a) alone)
        A log of the simulator; None: one of the target log's size is sampled under its
        estimated behaviour policy, with ``seed``; "exact": the simulator's exact
        occupancy under that policy
    behavior_policy : (S, A), instead of the estimated one; ``Quotient`` and ``Joint``
    seed : of the simulator's data, if they are sampled, and of Algorithm 1's batches
    options : of the method, if it is given by name; each class explains its own

    Returns
    -------
    TransitionRatio
        Unrecorded pairs have the prior's zeta (1, or the tilt's); ``visited`` marks the
        recorded ones.

    Raises
    ------
    ValueError
        A transition with simulator probability 0 (named); an option that the method
        does not have; bad options.
    TypeError
        An option that no method has.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> fit = transition_ratio(log, simulator)
    >>> bool(abs(fit.values.data - [0.8, 1.2, 0.8, 1.2]).max() < 0.05), fit.gap < 1e-9
    (True, True)
    >>> paper = transition_ratio(log, simulator, method=Quotient(normalized=False), simulator_data="exact")
    >>> bool(abs(paper.values.data - [0.8, 1.2, 0.8, 1.2]).max() < 0.05)
    True
    """
    if isinstance(method, Method):
        if options:
            raise TypeError(
                f"{next(iter(options))} must be given to the method object; the method"
                f" is {method!r}"
            )
        chosen = method
    else:
        pooled = method == "conditional" and options.get("tie") is not None
        chosen = method_named("tied" if pooled else method, **options)
    inputs: dict[str, Any] = {
        "values_of": values_of,
        "horizon": horizon,
        "simulator_data": simulator_data,
        "behavior_policy": behavior_policy,
    }
    chosen.refuse_unused(**inputs)
    if horizon is not None and values_of is None:
        raise ArgumentError(
            "horizon", "must be left out without values_of: it is that of the values"
        )
    return chosen.fit(log_or_counts, simulator, discount=discount, seed=seed, **inputs)


def true_ratio(target: FiniteMDP, simulator: FiniteMDP) -> TransitionRatio:
    """Compute zeta = P_target / P_simulator on the simulator's support (eq. 4.3).

    Parameters
    ----------
    target, simulator : FiniteMDP, of the same states and actions

    Raises
    ------
    ValueError
        The target has transitions outside that support; names them.

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
    return RatioInput(data, simulator, Rows.of(simulator)).ratio(
        data / simulator.transitions.data, "true", 0.0, {}
    )
