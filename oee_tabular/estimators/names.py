"""The short names of estimators, for the command line, reports and tables."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from oee_tabular.exceptions import ArgumentError

if TYPE_CHECKING:
    from oee_tabular.estimators.estimate import Estimator
    from oee_tabular.estimators.problem import Problem
    from oee_tabular.mdp import FiniteMDP


@dataclass(frozen=True)
class Named:
    """An estimator that has a short name: its class, its options and its meaning.

    Attributes
    ----------
    kind : str
        The name of the class in ``oee_tabular.estimators``, or "Class.constructor".
    meaning : str
        What the estimator does, in a sentence or two.
    options : mapping
        The options of the class.
    needs_target : bool
        Whether the estimator is made from the target, which only someone who knows it
        has.
    """

    kind: str
    meaning: str
    options: Mapping[str, Any] = field(default_factory=dict)
    needs_target: bool = False

    def __call__(self, target: FiniteMDP | None = None) -> Estimator:
        """Make the estimator with its options."""
        make = attrgetter(self.kind)(importlib.import_module("oee_tabular.estimators"))
        arguments = [target] if self.needs_target else []
        estimator: Estimator = make(*arguments, **self.options)
        return estimator


NAMED: Mapping[str, Named] = {
    "simulator": Named(
        "Simulator",
        "The policy's exact value in the simulator as it is: what one would believe"
        " without a log.",
    ),
    "oee": Named(
        "OffEnvironment",
        "Off-environment evaluation corrects the simulator's probabilities by the log,"
        " then computes the policy's exact value in the corrected simulator. If the log"
        " contradicts the correction, the value moves towards maximum likelihood's.",
    ),
    "oee-product": Named(
        "OffEnvironment",
        "The same correction, as products of ratios along simulated episodes; exact on"
        " average, but noisy.",
        {"evaluation": "monte_carlo"},
    ),
    "oee-product-sn": Named(
        "OffEnvironment",
        "Products of ratios, divided by their sum.",
        {"evaluation": "monte_carlo", "self_normalized": True},
    ),
    "oee-trajectory": Named(
        "OffEnvironment",
        "One product of ratios for each whole simulated episode.",
        {"evaluation": "monte_carlo", "weighting": "trajectory"},
    ),
    "ratio-of-ratios": Named(
        "OffEnvironment",
        "The paper's quotient of two fitted ratios, each normalised; its rows need not"
        " be probabilities.",
        {"ratio": "ratio_of_ratios"},
    ),
    "paper": Named(
        "OffEnvironment.paper",
        "The paper's own estimator: the same quotient, not normalised, as products of"
        " ratios along simulated episodes.",
    ),
    "model-based": Named(
        "ModelBased",
        "The policy's exact value in the log's frequencies. In an unrecorded pair the"
        " state never changes.",
    ),
    "fqe": Named(
        "ModelBased",
        "Fitted Q evaluation, solved exactly: Q of a recorded pair is the log's mean of"
        " r + discount * V(next state). Of an unrecorded pair it is the simulator's.",
        {"fallback": "simulator"},
    ),
    "fqe-zero": Named(
        "ModelBased",
        "Fitted Q evaluation of the log alone: Q of an unrecorded pair stays 0.",
        {"fallback": "zero"},
    ),
    "is": Named(
        "ImportanceSampling",
        "Importance sampling: the log's returns, weighted by how much likelier the"
        " policy makes each episode.",
        {"kind": "trajectory"},
    ),
    "wis": Named(
        "ImportanceSampling",
        "Importance sampling with weights that are divided by their sum.",
        {"kind": "trajectory", "self_normalized": True},
    ),
    "pdis": Named(
        "ImportanceSampling",
        "Importance sampling, reward by reward (per decision); uses no transition"
        " probabilities.",
    ),
    "wpdis": Named(
        "ImportanceSampling",
        "Importance sampling reward by reward, with weights that are divided by their"
        " sum.",
        {"self_normalized": True},
    ),
    "dr": Named(
        "DoublyRobust", "Doubly robust: a model's value, corrected by the log."
    ),
    "dr-beta": Named(
        "DoublyRobust",
        "Doubly robust, with the ratio of occupancies as weights.",
        {"weights": "beta"},
    ),
    "dr-rollouts": Named(
        "DoublyRobust", "Doubly robust on simulated episodes.", {"data": "rollouts"}
    ),
    "dr-episodes": Named(
        "DoublyRobust", "Doubly robust on the log's episodes.", {"data": "episodes"}
    ),
    "wdr": Named(
        "DoublyRobust",
        "Doubly robust on the log's episodes, with weights that are divided by their"
        " sum.",
        {"data": "episodes", "self_normalized": True},
    ),
    "magic": Named(
        "Magic",
        "A blend of model and importance sampling, chosen for the smallest error.",
    ),
    "marginalized": Named(
        "Marginalized",
        "The log's rewards, weighted by how much more often the policy is in each"
        " place.",
    ),
    "dualdice": Named("DualDice", "The same weights, from a saddle-point problem."),
    "oracle": Named(
        "Oracle",
        "The value with the true ratio, which only someone who knows the target has.",
        needs_target=True,
    ),
    "oracle-product": Named(
        "Oracle",
        "Products of the true ratio along simulated episodes. Sampling noise is the"
        " only error.",
        {"evaluation": "monte_carlo"},
        needs_target=True,
    ),
}


# names from the literature: in a table each has the solution of an estimator above
ALIASES: Mapping[str, str] = {
    # minimax Q learning: fitted Q evaluation's equation, one moment for each pair
    "mql": "fqe",
    "dm": "fqe",  # the direct method: the same Q
    "mle": "fqe",  # maximum likelihood: Q of the log's frequencies
    "mis": "marginalized",
    # minimax weight learning: weights under which the log's frequencies balance the
    # policy's flow
    "mwl": "dualdice",
    "bestdice": "dualdice",  # as have the other saddle points of the DICE family
    "gendice": "dualdice",
    "gradientdice": "dualdice",
    "snis": "wis",
}


# what type checkers accept as the name of an estimator: the keys of NAMED and ALIASES
EstimatorName: TypeAlias = Literal[
    "simulator",
    "oee",
    "oee-product",
    "oee-product-sn",
    "oee-trajectory",
    "ratio-of-ratios",
    "paper",
    "model-based",
    "fqe",
    "fqe-zero",
    "is",
    "wis",
    "pdis",
    "wpdis",
    "dr",
    "dr-beta",
    "dr-rollouts",
    "dr-episodes",
    "wdr",
    "magic",
    "marginalized",
    "dualdice",
    "oracle",
    "oracle-product",
    "mql",
    "dm",
    "mle",
    "mis",
    "mwl",
    "bestdice",
    "gendice",
    "gradientdice",
    "snis",
]


def names(*, needs_target: bool = False) -> list[str]:
    """Return the names of the estimators that need the target, or of the others."""
    return [name for name, named in NAMED.items() if named.needs_target == needs_target]


def named_estimators(
    names: Sequence[str], target: FiniteMDP | None = None
) -> dict[str, Estimator]:
    """Make the estimators of these names or aliases.

    An unknown name is a ValueError that suggests the nearest one.
    """
    estimators: dict[str, Estimator] = {}
    for given in names:
        name = ALIASES.get(given, given)
        if name not in NAMED:
            near = difflib.get_close_matches(name, [*NAMED, *ALIASES], n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise ArgumentError(
                "estimators", f"must be among {', '.join(NAMED)}; got {name!r}{hint}"
            )
        if NAMED[name].needs_target and target is None:
            raise ValueError(
                f"estimator {name!r} needs the target environment, which is not given"
                " (--target)"
            )
        estimators[name] = NAMED[name](target)
    if not estimators:
        raise ArgumentError("estimators", "must name at least one; it is empty")
    return estimators


def default_names(problem: Problem) -> tuple[list[str], list[str]]:
    """Choose the estimators that a problem's data allow.

    The second list has a sentence for each that they do not allow.
    """
    chosen = ["simulator", "oee", "model-based"]
    left_out = []
    log = problem.recorded
    if log.episode is None:
        left_out.append("Importance sampling is left out: the log has no episodes.")
    elif log.behavior_probability is None and problem.behavior_policy is None:
        left_out.append(
            "Importance sampling is left out: the behaviour policy is not known."
        )
    else:
        chosen += ["pdis", "wpdis"]
    return chosen, left_out
