"""The ratio of transition probabilities zeta = P_target / P_simulator, from a log.

``transition_ratio`` estimates it (eq. 4.3 of the paper) by any method of
``oee_tabular.ratio``. It stands here because its default shrinks; with
``method=Quotient(normalized=False)`` it is the paper's.
"""

from __future__ import annotations

from dataclasses import fields
from enum import Enum
from typing import Any, Literal, TypeAlias, overload

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.conditional import Conditional, RidgeLike
from oee_tabular.ratio.features import FeaturesLike, KernelLike
from oee_tabular.ratio.joint import Joint
from oee_tabular.ratio.linear import InClass
from oee_tabular.ratio.method import Method, SimulatorData
from oee_tabular.ratio.network import Network
from oee_tabular.ratio.prior import Criterion, Prior, PriorName
from oee_tabular.ratio.quotient import Quotient
from oee_tabular.ratio.result import TransitionRatio
from oee_tabular.ratio.sgd import Sgd
from oee_tabular.ratio.ties import Tied, TieLike
from oee_tabular.typing import PolicyLike, RealArrayLike, Seed, SparseLike

MethodName: TypeAlias = Literal[
    "conditional", "tied", "linear", "kernel", "ratio_of_ratios", "joint"
]


class _Default(Enum):
    """Mark an option that is left out although None is one of its values."""

    LEFT_OUT = "left out"

    def __repr__(self) -> str:
        """Return a text that reads well in a signature."""
        return "<left out>"


# What a method's name stands for: a class, those of its fields that are no options, and
# those whose value the name implies.
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


def method_named(name: str, **options: object) -> Method:
    """Return the method object that a name and options stand for.

    An option of None is one left out, but for ``toward``.

    >>> method_named("linear", features=[1.0, 2.0])
    InClass(kernel=None, bandwidth=1.0, n_centers=200, lower=None, upper=None, ridge=None, solver='dual')
    """
    _checks.one_of(name, "method", tuple(METHODS))
    make, _, implied = METHODS[name]
    given = _options_given(options)
    for option, value in given.items():
        if option not in OPTIONS[name]:
            raise ArgumentError(
                option,
                f"must not be given with method {name!r}, which does not use it; got"
                f" {_checks.show(value)}",
            )
    made: Method = make(**{**implied, **given})
    return made


def _options_given(options: dict[str, object]) -> dict[str, object]:
    """Return the options that are not left out."""
    return {
        name: value
        for name, value in options.items()
        if value is not None or name == "toward"
    }


@overload
def transition_ratio(
    log_or_counts: Transitions | SparseLike,
    simulator: FiniteMDP,
    *,
    method: Method,
    discount: float | None = ...,
    values_of: PolicyLike | None = ...,
    horizon: int | None = ...,
    simulator_data: SimulatorData = ...,
    behavior_policy: PolicyLike | None = ...,
    seed: Seed = ...,
) -> TransitionRatio: ...


@overload
def transition_ratio(
    log_or_counts: Transitions | SparseLike,
    simulator: FiniteMDP,
    *,
    method: MethodName = ...,
    discount: float | None = ...,
    values_of: PolicyLike | None = ...,
    horizon: int | None = ...,
    simulator_data: SimulatorData = ...,
    behavior_policy: PolicyLike | None = ...,
    seed: Seed = ...,
    prior: PriorName | Prior | None = ...,
    strength: float | Criterion | None = ...,
    features: FeaturesLike | None = ...,
    tie: TieLike | None = ...,
    kernel: KernelLike | None = ...,
    coordinates: RealArrayLike | None = ...,
    bandwidth: float | None = ...,
    n_centers: int | None = ...,
    lower: float | None = ...,
    upper: float | None = ...,
    ratio_lower: float | None = ...,
    ratio_upper: float | None = ...,
    ridge: RidgeLike | None = ...,
    toward: float | None = ...,
    normalized: bool | None = ...,
    solver: str | Sgd | None = ...,
    data: SimulatorData = ...,
    functions: Network | None = ...,
) -> TransitionRatio: ...


@suggest_keywords
def transition_ratio(
    log_or_counts: Transitions | SparseLike,
    simulator: FiniteMDP,
    *,
    method: MethodName | Method = "conditional",
    discount: float | None = None,
    values_of: PolicyLike | None = None,
    horizon: int | None = None,
    simulator_data: SimulatorData = None,
    behavior_policy: PolicyLike | None = None,
    seed: Seed = None,
    prior: PriorName | Prior | None = None,
    strength: float | Criterion | None = None,
    features: FeaturesLike | None = None,
    tie: TieLike | None = None,
    kernel: KernelLike | None = None,
    coordinates: RealArrayLike | None = None,
    bandwidth: float | None = None,
    n_centers: int | None = None,
    lower: float | None = None,
    upper: float | None = None,
    ratio_lower: float | None = None,
    ratio_upper: float | None = None,
    ridge: RidgeLike | None = None,
    toward: float | Literal[_Default.LEFT_OUT] | None = _Default.LEFT_OUT,
    normalized: bool | None = None,
    solver: str | Sgd | None = None,
    data: SimulatorData = None,
    functions: Network | None = None,
) -> TransitionRatio:
    """Estimate zeta(s, a, s') = P_target / P_simulator from a log of the target.

    Multiplied by this ratio, the simulator's transition probabilities estimate the
    target's. ``oee.evaluate`` does this by itself; call this function to inspect the
    ratio, or to choose another method.

    Parameters
    ----------
    log_or_counts : Transitions or sparse array of shape (S*A, S)
        A log of the target, or the counts of its transitions, row s*A + a and column
        s'.
    simulator : FiniteMDP
        The model whose transition probabilities stand in the denominator.
    method : str or Method, default 'conditional'
        One of 'conditional', 'tied' (also where ``tie`` is given), 'linear', 'kernel',
        'ratio_of_ratios' and 'joint', with the options below; or an object that has its
        options: ``Conditional``, ``Tied``, ``InClass``, ``Quotient``, ``Joint``
        (``oee.ratio``).
    discount : float, optional
        Weight of each transition by discount^timestep, as the paper's discounted d
        does, on both sides. None weights all transitions by 1.
    values_of : (S, A) policy, or list of policies, optional
        The policies whose values matter: r(s, a, s') + gamma V(s') of each in the
        simulator is a direction of ``Conditional``'s prior 'ridge'. It is an error with
        another prior.
    horizon : int, optional
        Number of rewards in these values; None means the infinite discounted sum. Only
        with ``values_of``.
    simulator_data : Transitions, 'exact' or None, optional
        Data of the simulator for ``Quotient`` and ``Joint`` (which uses its d(s, a)
        alone). None samples a log of the target log's size under its estimated
        behaviour policy, with ``seed``; 'exact' is the simulator's exact occupancy
        under that policy.
    behavior_policy : (S, A) policy, optional
        Behaviour policy of the simulator's data, instead of the estimated one, for
        ``Quotient`` and ``Joint``.
    seed : int, Generator or None, optional
        Seed of the simulator's data, if they are sampled, and of Algorithm 1's batches.
    prior : Prior, {'ridge', 'tilt', 'simulator', 'none'}, optional
        What zeta is shrunk to, by name or as an object such as ``Shrinkage(...)``. For
        'conditional'; default 'ridge'. Here and below None means the default of the
        method.
    strength : float, 'evidence' or 'loo', optional
        How many transitions the prior is worth in each pair. For 'conditional', default
        'evidence', and for 'tied', where it is a number, default 3.0.
    features : array_like, data frame or callable, optional
        Features of the simulator's transitions. For 'conditional', default none, and
        for 'linear', which needs them.
    tie : array_like of int, data frame or callable, optional
        Keys of the simulator's transitions; transitions with the same key share one
        ratio. For 'tied', which needs it.
    kernel : 'gaussian' or callable, optional
        The kernel. For 'kernel'; default 'gaussian'.
    coordinates : array_like of shape (S,) or (S, c), optional
        The coordinates of the states. For 'kernel'.
    bandwidth : float, optional
        The bandwidth of the Gaussian, in standard deviations. For 'kernel'; default
        1.0.
    n_centers : int, optional
        The number of transitions above which the kernel is approximated. For 'kernel';
        default 200.
    lower : float, optional
        The lower bound on zeta; for 'ratio_of_ratios' and 'joint' on each density
        ratio beta, default 0.01. Otherwise default 0. Not for 'tied'.
    upper : float, optional
        The upper bound, likewise; for 'ratio_of_ratios' and 'joint' default 10.0.
        Otherwise default unbounded. Not for 'tied'.
    ratio_lower : float, optional
        The lower bound on the quotient of the two betas. For 'joint'; default 0.
    ratio_upper : float, optional
        The upper bound on the quotient of the two betas. For 'joint'; default
        unbounded.
    ridge : float, callable, 'evidence' or 'loo', optional
        The factor of the squared penalty. Default 0.0; for 'linear' and 'kernel' 1 / n.
        'evidence' and 'loo' are for 'conditional' only. Not for 'tied'.
    toward : float or None, optional
        The number that the ridge pulls the ratio to, default 1.0. None is a value of
        its own: the penalty is then the paper's I(g)^2 = sum g^2. For 'conditional' and
        'ratio_of_ratios'.
    normalized : bool, optional
        Whether each beta is constrained to have mean 1. For 'ratio_of_ratios'; default
        True. The paper's estimator has False.
    solver : str or Sgd, optional
        'dual', the default, or the name of a cvxpy solver; ``Sgd(...)`` for
        'ratio_of_ratios' only. Not for 'tied'.
    data : Transitions or 'exact', optional
        The same as ``simulator_data``, which it replaces. For 'ratio_of_ratios' and
        'joint'.
    functions : Network, optional
        The neural network that represents the ratio. None means a table. For
        'conditional' and 'ratio_of_ratios'.

    Returns
    -------
    TransitionRatio
        The fitted ratio. ``values`` is zeta, a sparse array of shape (S*A, S) on the
        simulator's transitions; ``gap`` bounds the error of the optimisation, and
        ``target_model(simulator)`` is the corrected simulator. Where a pair was never
        recorded (``visited`` is False), zeta is the prior's: 1, or the tilt's.

    Raises
    ------
    ValueError
        If a transition has simulator probability 0 (it is named), if the method does
        not have an option that is given, or if an option is out of its range.
    TypeError
        If an option is given beside a method object.

    See Also
    --------
    true_ratio : The exact ratio of two models.
    density_ratio : The same program for two distributions.

    Notes
    -----
    The class of each method explains its options, its limit and its cost.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (
    ...     oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    ...     for p in (0.5, 0.6)
    ... )
    >>> log = oee.sample_transitions(target, [[0.5], [0.5]], 10_000, seed=0)
    >>> fit = transition_ratio(log, simulator)
    >>> bool(abs(fit.values.data - [0.8, 1.2, 0.8, 1.2]).max() < 0.05), fit.gap < 1e-9
    (True, True)
    >>> paper = transition_ratio(
    ...     log, simulator, method=Quotient(normalized=False), simulator_data="exact"
    ... )
    >>> bool(abs(paper.values.data - [0.8, 1.2, 0.8, 1.2]).max() < 0.05)
    True
    """
    options: dict[str, object] = {
        "prior": prior,
        "strength": strength,
        "features": features,
        "tie": tie,
        "kernel": kernel,
        "coordinates": coordinates,
        "bandwidth": bandwidth,
        "n_centers": n_centers,
        "lower": lower,
        "upper": upper,
        "ratio_lower": ratio_lower,
        "ratio_upper": ratio_upper,
        "ridge": ridge,
        "normalized": normalized,
        "solver": solver,
        "data": data,
        "functions": functions,
    }
    if not isinstance(toward, _Default):
        options["toward"] = toward
    if isinstance(method, Method):
        given = _options_given(options)
        if given:
            raise TypeError(
                f"{next(iter(given))} must be given to the method object; the method"
                f" is {method!r}"
            )
        chosen = method
    else:
        is_default = isinstance(method, str) and method == "conditional"
        is_tied = is_default and tie is not None
        chosen = method_named("tied" if is_tied else method, **options)
    chosen.refuse_unused(
        values_of=values_of,
        horizon=horizon,
        simulator_data=simulator_data,
        behavior_policy=behavior_policy,
    )
    if horizon is not None and values_of is None:
        raise ArgumentError(
            "horizon", "must be left out without values_of: it is that of the values"
        )
    return chosen.fit(
        log_or_counts,
        simulator,
        discount=discount,
        values_of=values_of,
        horizon=horizon,
        simulator_data=simulator_data,
        behavior_policy=behavior_policy,
        seed=seed,
    )
