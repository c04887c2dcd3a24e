"""Bad options of estimators: the error names the argument."""

import pytest
from estimators.four_states import POLICY, TARGET, recorded_problem

from oee_tabular.estimators import DoublyRobust, ImportanceSampling, Magic, ModelBased, OffEnvironment, Oracle

WRONG = {
    "oracle: target": (lambda: Oracle(3), r"^target must be a FiniteMDP; got int$"),
    "oracle: evaluation": (
        lambda: Oracle(TARGET, "mc"),
        r"^evaluation must be one of 'exact', 'monte_carlo'; got 'mc'$",
    ),
    "oracle: weighting": (
        lambda: Oracle(TARGET, weighting="step"),
        r"^weighting must be one of 'per_decision', 'trajectory'; got 'step'$",
    ),
    "oracle: rollouts": (lambda: Oracle(TARGET, n_rollouts=0), r"^n_rollouts must be a positive integer; it is 0$"),
    "oee: evaluation": (
        lambda: OffEnvironment(evaluation="mc"),
        r"^evaluation must be one of 'exact', 'monte_carlo'; got 'mc'$",
    ),
    "oee: ratio": (
        lambda: OffEnvironment(ratio="q"),
        r"^ratio must be one of 'conditional', 'ratio_of_ratios', 'joint'; got 'q'$",
    ),
    "importance sampling: kind": (
        lambda: ImportanceSampling("q"),
        r"^kind must be one of 'trajectory', 'per_decision'; got",
    ),
    "importance sampling: ragged": (
        lambda: ImportanceSampling(ragged="q"),
        r"^ragged must be one of 'pad', 'zero'; got 'q'$",
    ),
    "importance sampling: behaviour": (
        lambda: ImportanceSampling(behavior="q"),
        r"^behavior must be one of 'recorded', 'estimated'; got 'q'$",
    ),
    "model: fallback": (lambda: ModelBased("q"), r"^fallback must be one of 'stay', 'simulator'; got 'q'$"),
    "doubly robust: data": (
        lambda: DoublyRobust(data="q"),
        r"^data must be one of 'transitions', 'rollouts', 'episodes'; got 'q'$",
    ),
    "doubly robust: weights": (
        lambda: DoublyRobust(weights="q"),
        r"^weights must be one of 'occupancy', 'beta'; got 'q'$",
    ),
    "doubly robust: ratio": (lambda: DoublyRobust(ratio="q"), r"^ratio must be one of"),
    "doubly robust: rollouts": (
        lambda: DoublyRobust(n_rollouts=0),
        r"^n_rollouts must be a positive integer; it is 0$",
    ),
    "magic: ratio": (lambda: Magic(ratio="q"), r"^ratio must be one of"),
    "magic: lengths": (lambda: Magic(n_lengths=0), r"^n_lengths must be a positive integer; it is 0$"),
    "magic: bootstrap": (lambda: Magic(n_bootstrap=0), r"^n_bootstrap must be a positive integer; it is 0$"),
    "a seed": (
        lambda: OffEnvironment()(recorded_problem()[0], POLICY, seed="q"),
        r"^seed must be what numpy.random.default_rng",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_options_name_their_argument(name):
    call, text = WRONG[name]
    with pytest.raises(ValueError, match=text):
        call()
