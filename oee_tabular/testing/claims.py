"""What an estimator says of itself: words, what they mean, and what the estimators of this package claim."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

from oee_tabular._checks import SUM_TOLERANCE
from oee_tabular.estimators import (
    DoublyRobust,
    DualDice,
    ImportanceSampling,
    Magic,
    Marginalized,
    ModelBased,
    OffEnvironment,
    Oracle,
    Simulator,
)
from oee_tabular.ratio import TransitionRatio

CLAIMS: Mapping[str, str] = {
    "consistent": "its value tends to J_target as the log (and its rollouts) grow, where the log's behaviour has support",
    "unbiased": "its mean over logs is J_target at every number of episodes",
    "identical": "it is right where the target is the simulator (part of consistent)",
    "relabelling": "names of states and actions do not matter where the states keep their places (layout)",
    "scale": "rewards a r give a J, to 1e-8, from the same log and seed",
    "shift": "rewards r + b give J + b sum gamma^t, to 1e-8, from the same log and seed, nothing being absorbing",
    "padding": "rows in an absorbing state after the end of an episode change nothing",
    "after_end": "padding, whatever actions those rows have",
    "random": "other seeds may give other values; without this word they must give the same bits",
    "finite": "it answers problems with a horizon; claimed without infinite, those alone",
    "infinite": "it answers problems without a horizon; claimed without finite, those alone",
}
DEFAULT: frozenset[str] = frozenset({"consistent", "relabelling", "scale"})

_EXACT = frozenset({"relabelling", "scale", "padding", "after_end"})  # of the log's counts alone


def claims_of(estimator: Any, claims: Iterable[str] | None = None) -> frozenset[str]:
    """What an estimator claims: the words that say which laws it owes.

    ``claims``, else the estimator's own ``claims`` (a collection of words, or a method that returns one), else the table
    of the package's own estimators, else ``DEFAULT``.

    Parameters
    ----------
    estimator : any object
    claims : words of ``CLAIMS``, or None

    Raises
    ------
    ValueError
        A word that is none of ``CLAIMS`` (with the nearest one).

    Examples
    --------
    >>> sorted(claims_of(Simulator()) - DEFAULT)
    ['after_end', 'identical', 'padding', 'shift']
    >>> claims_of(lambda problem, policy, *, seed=None: None) == DEFAULT
    True
    """
    found: Any = claims
    name = "claims"
    if found is None:
        name = f"{type(estimator).__name__}.claims"
        try:
            found = getattr(estimator, "claims", None)
            found = found() if callable(found) else found
        except Exception as error:
            raise ValueError(f"{name} must be a collection of words; it raises {error!r}") from None
    if found is None:
        shipped = _shipped(estimator)
        return DEFAULT if shipped is None else shipped
    try:
        if isinstance(found, str):
            raise TypeError
        words = frozenset(found)
    except TypeError:
        raise ValueError(f"{name} must be a collection of words; it is {found!r}") from None
    for word in sorted(words, key=str):
        if word not in CLAIMS:
            near = difflib.get_close_matches(str(word), list(CLAIMS), n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise ValueError(f"{name} must be among {', '.join(CLAIMS)}; got {word!r}{hint}")
    return words


def _shipped(estimator: Any) -> frozenset[str] | None:
    """The claims of one of our estimators by its type and options; None for any other (subclasses included)."""
    kind = type(estimator)
    if kind is Simulator:
        return _EXACT | {"identical", "shift"}
    if kind is Oracle:
        if estimator.evaluation == "exact":
            return _EXACT | {"consistent", "unbiased", "shift"}
        return _on_rollouts(_EXACT | {"consistent"}, estimator) | (set() if estimator.self_normalized else {"unbiased"})
    if kind is OffEnvironment:
        known = of_ratio(estimator.ratio)
        return known if estimator.evaluation == "exact" else _on_rollouts(known, estimator)
    if kind is ModelBased:
        return _EXACT | {"consistent", "shift"}
    if kind is DualDice:
        return _EXACT | {"consistent", "shift", "infinite"}
    if kind is ImportanceSampling:
        return _importance_sampling(estimator)
    if kind is DoublyRobust:
        return _doubly_robust(estimator)
    if kind is Magic:
        return of_ratio(estimator.ratio) - {"after_end"} | {"consistent", "random"}
    if kind is Marginalized:  # rows that the log never visited pay nothing: no shift
        boxed = estimator.lower is not None or estimator.upper is not None
        lost = {"shift", "consistent", "padding", "after_end"} if boxed else {"shift"}
        return of_ratio(estimator.ratio) - lost
    return None


def of_ratio(ratio: Any) -> frozenset[str]:
    """What the exact value of zeta * P has by the way zeta is found.

    "ratio_of_ratios" and "joint" sample the simulator, as many moves as the log has; the former's rows have any sum. A zeta
    that is given is right for one pair only; a function promises nothing but that it does not look at rewards.
    """
    if isinstance(ratio, TransitionRatio):
        return _EXACT | ({"shift"} if ratio.row_sum_error <= SUM_TOLERANCE else set())
    sampled = {"consistent", "relabelling", "scale", "random"}
    known = {"conditional": _EXACT | {"consistent", "shift"}, "joint": sampled | {"shift"}, "ratio_of_ratios": sampled}
    return frozenset(known.get(ratio, {"scale"}) if isinstance(ratio, str) else {"scale"})


def _on_rollouts(known: frozenset[str], estimator: Any) -> frozenset[str]:
    """The product of ratios moves with the rewards where it is divided by the sum of its weights, and only there."""
    found = known - {"shift"} | {"random"}
    return found | {"shift"} if estimator.self_normalized else found


def _importance_sampling(estimator: ImportanceSampling) -> frozenset[str]:
    per_decision = estimator.kind == "per_decision"
    found = {"relabelling", "scale"}
    if not (estimator.self_normalized and per_decision and estimator.ragged == "zero"):
        found |= {"consistent", "padding"}
    if estimator.self_normalized:
        found.add("shift")
    else:
        found |= {"after_end"} if per_decision else set()
        found |= {"unbiased"} if estimator.behavior == "recorded" else set()
    return frozenset(found)


def _doubly_robust(estimator: DoublyRobust) -> frozenset[str]:
    known = of_ratio(estimator.ratio)
    if estimator.data == "transitions":
        if estimator.weights == "beta":  # no zeta is fitted
            return _EXACT | {"identical", "shift"}
        return known | {"shift"}
    if estimator.data == "rollouts":
        return known | {"random"}
    if estimator.self_normalized:
        return known - {"after_end"} | {"consistent"}
    fixed = isinstance(estimator.ratio, TransitionRatio)
    return known | {"consistent"} | ({"unbiased"} if fixed else set())
