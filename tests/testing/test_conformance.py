import re
import subprocess
import sys

import numpy as np
import pytest
from testing import wrong

import oee_tabular as oee
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
from oee_tabular.testing import CLAIMS, DEFAULT, LAWS, case, check_estimator, claims_of

PRODUCT = {"evaluation": "monte_carlo", "n_rollouts": 400}
SHIPPED = {
    "simulator": Simulator(),
    "oee": OffEnvironment(),
    "oee, ratio of ratios": OffEnvironment("ratio_of_ratios"),
    "oee product": OffEnvironment("joint", **PRODUCT),
    "oee product, self-normalised": OffEnvironment("ratio_of_ratios", **PRODUCT, self_normalized=True),
    "is": ImportanceSampling("trajectory"),
    "wis": ImportanceSampling("trajectory", self_normalized=True),
    "pdis": ImportanceSampling(),
    "pdis, estimated behaviour": ImportanceSampling(behavior="estimated"),
    "wpdis": ImportanceSampling(self_normalized=True),
    "wpdis, zero": ImportanceSampling(self_normalized=True, ragged="zero"),
    "model": ModelBased(),
    "model, else the simulator": ModelBased("simulator"),
    "dr": DoublyRobust(ratio="joint"),
    "dr, beta": DoublyRobust(weights="beta"),
    "dr, rollouts": DoublyRobust("rollouts", ratio="joint"),
    "dr, episodes": DoublyRobust("episodes", ratio="joint"),
    "wdr": DoublyRobust("episodes", self_normalized=True, ratio="joint"),
    "magic": Magic(n_bootstrap=50, ratio="joint"),
    "marginalised": Marginalized("joint"),
    "marginalised, boxed": Marginalized(ratio="joint", lower=0.5, upper=1.5),
    "dualdice": DualDice(),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_estimator_satisfies_what_it_claims(name):
    verdicts = check_estimator(SHIPPED[name], repetitions=6)
    assert verdicts.passed, verdicts
    assert len(verdicts) == len(LAWS)


def test_an_oracle_satisfies_what_it_claims():
    def make(simulator, target):
        return Oracle(target, **PRODUCT, self_normalized=True)

    verdicts = check_estimator(make, from_pair=True, repetitions=6)
    assert verdicts.passed, verdicts
    assert "oracle: " in verdicts["support"].text
    exact = check_estimator(
        lambda simulator, target: Oracle(target), from_pair=True, laws=["limit", "support", "shift"]
    )
    assert exact.passed, exact


def test_doubly_robust_with_a_wrong_zeta_is_unbiased():
    def with_no_ratio(simulator, target):
        return DoublyRobust("episodes", ratio=oee.true_ratio(simulator, simulator))

    verdicts = check_estimator(with_no_ratio, from_pair=True, laws=["unbiased"])
    assert verdicts.passed, verdicts
    assert verdicts["unbiased"].outcome == "holds"


def test_the_limit_of_weighted_sampling_without_the_finished_and_with_estimated_behaviour():
    estimator = ImportanceSampling(self_normalized=True, ragged="zero", behavior="estimated")
    assert check_estimator(estimator, laws=["limit"]).passed


@pytest.mark.parametrize("estimator", wrong.TABLE, ids=lambda kind: kind.__name__)
def test_a_wrong_estimator_breaks_the_laws_that_it_breaks_and_no_other(estimator):
    verdicts = check_estimator(estimator())
    assert set(verdicts.broken) == wrong.TABLE[estimator], verdicts
    assert not verdicts.passed
    assert all(verdicts[law].text for law in verdicts.broken)


@pytest.mark.parametrize(("estimator", "said"), [
    (wrong.Raises(), "raises KeyError: 'no such key'"),
    (wrong.Exits(), "raises SystemExit: 3"),
    (lambda problem, policy: None, "an estimator must return a float or an Estimate; it returned NoneType"),
    (lambda problem, policy: (1.0, 0.1), "it returned tuple: Estimate(value, standard_error) holds both"),
    (lambda problem, policy: np.nan, 'value must be finite where status is "ok"; it is nan'),
    (wrong.NegativeError(), "standard_error must be None or a nonnegative number; it is -1.0"),
    (lambda problem, policy, *, seed=None: oee.Estimate("high"), "value must be a float; it is str"),
    (lambda problem, policy, *, seed=None: oee.Estimate(1.0, status=None), "status must be "),
    (lambda problem, policy, *, seed=None: oee.Estimate(np.inf), "value must be finite where status is"),
    (lambda problem, policy, *, seed=None: oee.Estimate(1.0, interval=(2.0, 1.0)), "interval must be None or"),
    (lambda problem, policy, *, seed=None: oee.Estimate(1.0, diagnostics=None), "diagnostics must be a dict"),
])  # fmt: skip
def test_whatever_an_estimator_does_is_a_verdict(estimator, said):
    verdicts = check_estimator(estimator)
    assert not verdicts.passed
    assert said in verdicts["well_formed"].text
    assert {verdict.outcome for verdict in verdicts.values()} <= {"holds", "fails", "raises", "not claimed"}
    assert said in " ".join(str(verdicts).split())


def test_an_estimator_that_has_nothing_to_say_fails_what_it_claims():
    def silent(problem, policy, *, seed=None):
        return oee.Estimate(float("nan"), status="not today")

    verdicts = check_estimator(silent)
    assert verdicts["well_formed"].outcome == "holds"
    assert verdicts["consistent"].text == "ragged (horizon 6, discount 0.9): no value: status 'not today'"


def test_an_estimator_that_refuses_everything_is_not_well_formed():
    def refuses(problem, policy, *, seed=None):
        raise ValueError("horizon must be 77")

    verdict = check_estimator(refuses, laws=["well_formed"])["well_formed"]
    assert verdict.outcome == "raises"
    assert "problems are refused, the last: " in verdict.text
    assert "horizon must be 77" in verdict.text


def test_a_user_s_estimator_passes():
    verdicts = check_estimator(wrong.Shrunk())
    assert verdicts.passed, verdicts
    assert verdicts["limit"].text == "it has no limit of its own"
    assert verdicts["padding"].outcome == "not claimed"
    shown = str(verdicts)
    assert re.search(r"^shift +holds +moves: ", shown, re.M)
    assert shown.splitlines()[1] == "claims: consistent, relabelling, scale, shift"
    assert max(map(len, shown.splitlines()[1:])) <= 120


def test_a_broken_law_says_how_to_see_it():
    verdict = check_estimator(wrong.PolicyIgnored(), laws=["consistent"])["consistent"]
    assert "estimator(pair.problem(4800, seed=0), pair.policy, seed=0)" in verdict.example
    pair = case("ragged")
    assert abs(wrong.PolicyIgnored()(pair.problem(4800, seed=0), pair.policy).value - pair.truth) > 1.0
    assert abs(wrong.Sampling()(pair.problem(4800, seed=0), pair.policy).value - pair.truth) < 1.5


def test_checks_are_reproducible_and_other_seeds_give_other_logs():
    texts = [str(check_estimator(wrong.Sampling(), seed=seed, laws=["consistent"])) for seed in (3, 3, 4)]
    assert texts[0] == texts[1]
    assert texts[0] != texts[2].replace("seed 4", "seed 3")


def test_where_claims_come_from():
    assert claims_of(lambda problem, policy: None) == DEFAULT
    assert claims_of(wrong.Shrunk()) == wrong.Shrunk.claims
    assert claims_of(wrong.Shrunk(), {"unbiased"}) == {"unbiased"}
    assert "unbiased" in claims_of(ImportanceSampling())
    assert "unbiased" not in claims_of(ImportanceSampling(self_normalized=True))

    class Method:
        def claims(self):
            return ["finite"]

    class Mine(Simulator):
        """A subclass claims what its parent does, until it says otherwise."""

    assert claims_of(Method()) == {"finite"}
    assert claims_of(Mine()) == claims_of(Simulator()) > DEFAULT - {"consistent"}
    for law in LAWS.values():
        assert law.claims <= set(CLAIMS)
        assert law.statement


def test_an_estimator_for_horizons_alone_is_not_asked_for_more():
    class Short(wrong.Sampling):
        claims = frozenset({"consistent", "finite"})

        def __call__(self, problem, policy, *, seed=None):
            if problem.horizon is None:
                raise ValueError("horizon must be given")
            return super().__call__(problem, policy)

    verdicts = check_estimator(Short())
    assert verdicts.passed, verdicts
    assert check_estimator(Short(), claims={"consistent"}).broken


class Unclaimable:
    def __init__(self, claims):
        self.claims = claims

    def __call__(self, problem, policy, *, seed=None):
        return None


def raising():
    raise RuntimeError("later")


@pytest.mark.parametrize(("call", "text"), [
    (lambda: check_estimator(3), r"estimator must be a function \(problem, policy\) .*; got int"),
    (lambda: check_estimator(lambda problem: 1.0), r"estimator must be callable as .*, seed\); it takes \(problem\)"),
    (lambda: check_estimator(wrong.Wrongly()), r"estimator must be callable as .*; it takes \(problem\)"),
    (lambda: check_estimator(lambda problem, policy, rng: 1.0), r"it takes \(problem, policy, rng\)"),
    (lambda: check_estimator(Oracle), r"estimator must make an estimator without arguments; it raises TypeError"),
    (lambda: check_estimator(Simulator(), seed=-1), "seed must be an integer of at least 0; got -1"),
    (lambda: check_estimator(Simulator(), seed=0.5), "seed must be an integer of at least 0; got 0.5"),
    (lambda: check_estimator(Simulator(), repetitions=2), "repetitions must be at least 3; it is 2"),
    (lambda: check_estimator(Simulator(), laws=["shfit"]), "laws must be one of .*'shift'.*; got 'shfit'"),
    (lambda: check_estimator(Simulator(), claims=["unbaised"]), r"got 'unbaised' \(did you mean 'unbiased'\?\)"),
    (lambda: check_estimator(Simulator(), claims="unbiased"), "claims must be a collection of words; it is 'unbiased'"),
    (lambda: check_estimator(Unclaimable(3)), "Unclaimable.claims must be a collection of words; it is 3"),
    (lambda: check_estimator(Unclaimable(raising)), "Unclaimable.claims must be .*; it raises RuntimeError"),
    (lambda: check_estimator(Unclaimable([["shift"]])), r"Unclaimable.claims must be .*; it is \[\['shift'\]\]"),
    (lambda: check_estimator(Oracle, from_pair=True), r"estimator must be a function \(simulator, target\) -> "),
    (lambda: case("raged"), "name must be one of 'ragged', .*; got 'raged'"),
])  # fmt: skip
def test_bad_calls(call, text):
    with pytest.raises(ValueError, match=text):
        call()


def test_without_hypothesis_only_the_strategies_are_missing():
    script = """
import sys
sys.modules["hypothesis"] = None
import oee_tabular.testing as testing
from oee_tabular.estimators import Simulator
print(testing.check_estimator(Simulator(), laws=["support", "shift"]).passed)
try:
    testing.mdps
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[0] == "True"
    assert done.stdout.splitlines()[1].endswith("not installed; in a clone: pip install '.[testing]'")
