"""Bad options of estimators: the error names the argument."""

import pytest
from estimators.four_states import POLICY, TARGET, recorded_problem

from oee_tabular.estimators import DoublyRobust, ImportanceSampling, Magic, ModelBased, OffEnvironment, Oracle

POSITIVE = "must be a positive integer; it is 0$"
WRONG = [
    (lambda: Oracle(3), r"^target must be a FiniteMDP; got int$"),
    (lambda: Oracle(TARGET, "mc"), r"^evaluation must be one of 'exact', 'monte_carlo'; got 'mc'$"),
    (lambda: Oracle(TARGET, weighting="step"), r"^weighting must be one of 'per_decision', 'trajectory'; got 'step'$"),
    (lambda: Oracle(TARGET, n_rollouts=0), f"^n_rollouts {POSITIVE}"),
    (lambda: OffEnvironment(evaluation="mc"), r"^evaluation must be one of 'exact', 'monte_carlo'; got 'mc'$"),
    (lambda: OffEnvironment(ratio="q"), r"^ratio must be one of 'conditional', 'ratio_of_ratios', 'joint'; got 'q'$"),
    (lambda: ImportanceSampling("q"), r"^kind must be one of 'trajectory', 'per_decision'; got"),
    (lambda: ImportanceSampling(ragged="q"), r"^ragged must be one of 'pad', 'zero'; got 'q'$"),
    (lambda: ImportanceSampling(behavior="q"), r"^behavior must be one of 'recorded', 'estimated'; got 'q'$"),
    (lambda: ModelBased("q"), r"^fallback must be one of 'stay', 'simulator'; got 'q'$"),
    (lambda: DoublyRobust(data="q"), r"^data must be one of 'transitions', 'rollouts', 'episodes'; got 'q'$"),
    (lambda: DoublyRobust(weights="q"), r"^weights must be one of 'occupancy', 'beta'; got 'q'$"),
    (lambda: DoublyRobust(ratio="q"), r"^ratio must be one of"),
    (lambda: DoublyRobust(n_rollouts=0), f"^n_rollouts {POSITIVE}"),
    (
        lambda: DoublyRobust(self_normalized=True),
        "self_normalized must be False with data 'transitions': it is for episodes",
    ),
    (lambda: Magic(ratio="q"), r"^ratio must be one of"),
    (lambda: Magic(n_lengths=0), f"^n_lengths {POSITIVE}"),
    (lambda: Magic(n_bootstrap=0), f"^n_bootstrap {POSITIVE}"),
    (lambda: OffEnvironment()(recorded_problem()[0], POLICY, seed="q"), r"^seed must be what numpy.random.default_rng"),
]


@pytest.mark.parametrize(("call", "text"), WRONG)
def test_bad_options_name_their_argument(call, text):
    with pytest.raises(ValueError, match=text):
        call()
