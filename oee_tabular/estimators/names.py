"""Short names of estimators, for the command line and for tables."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence

from oee_tabular.estimators.base import Estimator
from oee_tabular.estimators.doubly_robust import DoublyRobust
from oee_tabular.estimators.importance_sampling import ImportanceSampling
from oee_tabular.estimators.magic import Magic
from oee_tabular.estimators.marginalized import DualDice, Marginalized
from oee_tabular.estimators.model_based import ModelBased
from oee_tabular.estimators.off_environment import OffEnvironment
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.simulator import Oracle, Simulator
from oee_tabular.mdp import FiniteMDP

NAMED: Mapping[str, Callable[[], Estimator]] = {
    "simulator": Simulator,
    "oee": OffEnvironment,
    "oee-product": lambda: OffEnvironment(evaluation="monte_carlo"),
    "oee-product-sn": lambda: OffEnvironment(evaluation="monte_carlo", self_normalized=True),
    "oee-trajectory": lambda: OffEnvironment(evaluation="monte_carlo", weighting="trajectory"),
    "ratio-of-ratios": lambda: OffEnvironment(ratio="ratio_of_ratios"),
    "model-based": ModelBased,
    "is": lambda: ImportanceSampling(kind="trajectory"),
    "wis": lambda: ImportanceSampling(kind="trajectory", self_normalized=True),
    "pdis": ImportanceSampling,
    "wpdis": lambda: ImportanceSampling(self_normalized=True),
    "dr": DoublyRobust,
    "dr-beta": lambda: DoublyRobust(weights="beta"),
    "dr-rollouts": lambda: DoublyRobust(data="rollouts"),
    "dr-episodes": lambda: DoublyRobust(data="episodes"),
    "wdr": lambda: DoublyRobust(data="episodes", self_normalized=True),
    "magic": Magic,
    "marginalized": Marginalized,
    "dualdice": DualDice,
}
WITH_TARGET: Mapping[str, Callable[[FiniteMDP], Estimator]] = {
    "oracle": Oracle,
    "oracle-product": lambda target: Oracle(target, evaluation="monte_carlo"),
}


def named_estimators(names: Sequence[str], target: FiniteMDP | None = None) -> dict[str, Estimator]:
    """The estimators of these names; a ValueError with the nearest names for an unknown one."""
    found: dict[str, Estimator] = {}
    for name in names:
        if name in NAMED:
            found[name] = NAMED[name]()
        elif name in WITH_TARGET and target is not None:
            found[name] = WITH_TARGET[name](target)
        elif name in WITH_TARGET:
            raise ValueError(f"estimator {name!r} needs the target environment, which is not given (--target)")
        else:
            known = [*NAMED, *WITH_TARGET]
            near = difflib.get_close_matches(name, known, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise ValueError(f"estimators must be among {', '.join(known)}; got {name!r}{hint}")
    if not found:
        raise ValueError("estimators must name at least one; it is empty")
    return found


def default_names(problem: Problem) -> tuple[list[str], list[str]]:
    """The estimators that this problem's data allow, and a sentence for each that they do not."""
    names, left_out = ["simulator", "oee", "model-based"], []
    log = problem.log if problem.episodes is None else problem.episodes
    if log.episode is None:
        left_out.append("Importance sampling is left out: the log has no episodes.")
    elif log.behavior_probability is None and problem.behavior_policy is None:
        left_out.append("Importance sampling is left out: the behaviour policy is not known.")
    else:
        names += ["pdis", "wpdis"]
    return names, left_out
