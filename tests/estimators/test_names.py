"""Short names, bad options, and which estimators a problem's data allow."""

from estimators.four_states import BEHAVIOR, environments

import oee_tabular as oee
from oee_tabular import Problem, Transitions
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
from oee_tabular.estimators.names import default_names, named_estimators


def test_short_names_and_what_they_stand_for():
    _, target = environments()
    expected = [
        Simulator(), OffEnvironment(), OffEnvironment(evaluation="monte_carlo"),
        OffEnvironment(evaluation="monte_carlo", self_normalized=True),
        OffEnvironment(evaluation="monte_carlo", weighting="trajectory"), OffEnvironment(ratio="ratio_of_ratios"),
        ModelBased(), ImportanceSampling(kind="trajectory"), ImportanceSampling(kind="trajectory", self_normalized=True),
        ImportanceSampling(), ImportanceSampling(self_normalized=True), DoublyRobust(), DoublyRobust(weights="beta"),
        DoublyRobust(data="rollouts"), DoublyRobust(data="episodes"), DoublyRobust(data="episodes", self_normalized=True),
        Magic(), Marginalized(), DualDice(), Oracle(target), Oracle(target, evaluation="monte_carlo"),
    ]  # fmt: skip
    names = [
        "simulator", "oee", "oee-product", "oee-product-sn", "oee-trajectory", "ratio-of-ratios", "model-based", "is", "wis",
        "pdis", "wpdis", "dr", "dr-beta", "dr-rollouts", "dr-episodes", "wdr", "magic", "marginalized", "dualdice", "oracle",
        "oracle-product",
    ]  # fmt: skip
    named = named_estimators(names, target)
    assert {name: repr(estimator) for name, estimator in named.items()} == dict(
        zip(names, map(repr, expected), strict=True)
    )


def test_names_that_people_type():
    ragged = oee.testing.case("ragged")
    assert named_estimators(["fqe", "oee", "model-based"]) == named_estimators(["model-based", "oee"])
    problem = ragged.problem(20, seed=0)
    rows = [oee.evaluate(problem, ragged.policy, estimators=name).records() for name in ("fqe", ["dm"], "model-based")]
    assert rows[0] == rows[1] == rows[2]


def test_the_default_estimators_and_what_is_left_out():
    simulator, target = environments()
    log = oee.sample_episodes(target, BEHAVIOR, 5, 6, seed=1)
    bare = Transitions(**{k: v for k, v in log.columns().items() if k != "behavior_probability"})
    basic = ["simulator", "oee", "model-based"]
    assert default_names(Problem(simulator, log)) == ([*basic, "pdis", "wpdis"], [])
    assert default_names(Problem(simulator, bare, behavior_policy=BEHAVIOR)) == ([*basic, "pdis", "wpdis"], [])
    unknown = "Importance sampling is left out: the behaviour policy is not known."
    assert default_names(Problem(simulator, bare)) == (basic, [unknown])
    bag = log.draw(5, seed=0)
    assert default_names(Problem(simulator, bag)) == (
        basic,
        ["Importance sampling is left out: the log has no episodes."],
    )
    assert default_names(Problem(simulator, bag, episodes=log)) == ([*basic, "pdis", "wpdis"], [])
