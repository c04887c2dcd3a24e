"""The diagnostics of estimates: which there are, their types and units, and what a
mapping can do.
"""

import copy
import dataclasses
import json
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.continuous.command import continuous_simulator
from oee_tabular.continuous.evaluation.on_cells import calibrated_row
from oee_tabular.estimators import (
    Estimate,
    ImportanceSampling,
    Marginalized,
    ModelBased,
    OffEnvironment,
)
from oee_tabular.estimators.calibrated import calibrate
from oee_tabular.estimators.diagnostics import Diagnostics
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.estimators.names import NAMED, named_estimators
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio import Conditional, Tied
from oee_tabular.report import Settings, evaluate_continuous
from oee_tabular.tasks import CartPole, cartpole_policy, record

CASES = ("ragged", "ragged infinite", "moves", "survival infinite", "partial")
REFUSED = {"dualdice"}  # with a horizon


def estimators_of(pair):
    """Every named estimator, and forms of them that set further diagnostics."""
    named = named_estimators(list(NAMED), pair.target)
    if pair.horizon is not None:
        named = {name: e for name, e in named.items() if name not in REFUSED}
    return [
        *named.values(),
        OffEnvironment(Tied(tie=lambda s, a, j: j)),
        OffEnvironment(Conditional(strength=3.0)),
        ImportanceSampling(self_normalized=True, ragged="zero"),
        ModelBased(fallback="simulator"),
        Marginalized(lower=0.5, upper=2.0),
        as_estimator(lambda problem, policy: 1.0),
    ]


def all_diagnostics():
    """Every diagnostic that an estimate or a row of a report has, with its values."""
    for name in CASES:
        pair = oee.testing.case(name)
        for n in (1, 30):
            problem = pair.problem(n, seed=n)
            estimators = estimators_of(pair)
            for estimator in estimators:
                estimate = estimator(problem, pair.policy, seed=0)
                yield from estimate.diagnostics.items()
            report = oee.evaluate(
                problem,
                pair.policy,
                estimators={str(k): e for k, e in enumerate(estimators)},
                seed=0,
            )
            for result in report.results:
                yield from result.estimate.diagnostics.items()
            if estimate.value > 0:
                shifted = calibrate(estimate, discretised=1.0, continuous=1.1)
                yield from shifted.diagnostics.items()


def continuous_diagnostics():
    """Every diagnostic of the rows of a report on a continuous task."""
    target = CartPole(15.0)
    policy = cartpole_policy(0.3)
    report = evaluate_continuous(
        continuous_simulator("cartpole:gravity=10"),
        record(target, policy, n_transitions=400, max_steps=50, seed=0),
        {"policy": policy},
        settings=Settings(grid=(6, 6), episodes=20, outside="nearest"),
        estimators=["oee", "simulator"],
        horizon=20,
        seed=0,
    )
    for result in report.results:
        yield from result.estimate.diagnostics.items()


@pytest.mark.filterwarnings("ignore::oee_tabular.exceptions.DiscretizationWarning")
def test_every_diagnostic_of_the_package_is_declared_with_its_type():
    declared = Diagnostics.declared()
    found = {}
    for key, value in (*all_diagnostics(), *continuous_diagnostics()):
        found.setdefault(key, []).append(value)
    assert found.keys() - declared.keys() == set()
    for key, values in found.items():
        types = {
            "float": (float, int, np.floating),
            "int": (int, np.integer),
            "str": str,
        }[declared[key].kind.__name__]
        wrong = [x for x in values if x is not None and not isinstance(x, types)]
        assert wrong == [], key
    # nothing is declared in vain; these need logs that contradict the value,
    # or commands that are rounded
    rare = {"replaced_value", "replaced_by", "refused_value", "rounding_error"}
    assert declared.keys() - found.keys() <= rare


def test_each_is_documented_where_it_is_declared():
    declared = Diagnostics.declared()
    for name, field in declared.items():
        assert field.__doc__.endswith(".")
        assert field.__doc__[0].isupper()
        assert f"{name} : {field.kind.__name__}, {field.unit}" in Diagnostics.__doc__
        assert not hasattr(dict, name)  # else its attribute would hide a method
        assert (field.unit == "text") == (field.kind is str)
    assert all(len(line) <= 88 for line in Diagnostics.__doc__.split("\n"))


def test_they_are_a_read_only_dict():
    estimate = Estimate(1.0, diagnostics={"coverage": 0.5, "mine": [3]})
    facts = estimate.diagnostics
    assert facts == {"coverage": 0.5, "mine": [3]} == dict(facts)
    assert repr(facts) == str(facts) == "{'coverage': 0.5, 'mine': [3]}"
    assert list(facts) == ["coverage", "mine"]
    assert "gap" not in facts
    assert (facts.coverage, facts.gap, facts.get("gap", 2.0)) == (0.5, None, 2.0)
    assert facts | {"gap": 0.0} == {"coverage": 0.5, "mine": [3], "gap": 0.0}
    assert {"gap": 0.0} | facts == {"gap": 0.0, "coverage": 0.5, "mine": [3]}
    assert json.loads(json.dumps(facts)) == facts
    for change in (
        lambda: facts.update(gap=0.0),
        lambda: facts.pop("mine"),
        lambda: facts.setdefault("gap", 0.0),
        lambda: facts.__setitem__("gap", 0.0),
        lambda: facts.__delitem__("mine"),
        lambda: facts.__ior__({"gap": 0.0}),
        facts.clear,
        facts.popitem,
    ):
        with pytest.raises(TypeError, match="read-only; dict"):
            change()
    for other in (
        pickle.loads(pickle.dumps(estimate)),
        copy.deepcopy(estimate),
        dataclasses.replace(estimate, status="ok"),
    ):
        assert other == estimate
        assert type(other.diagnostics) is Diagnostics
    assert dataclasses.asdict(estimate)["diagnostics"] == facts
    assert Estimate(1.0).diagnostics == {} == Diagnostics()


def test_values_are_scaled_by_their_unit():
    facts = Diagnostics(
        coverage=0.5,
        error_bound=2.0,
        calibrated_value=3.0,
        calibrated_standard_error=None,
        method="direct",
        value=5.0,
    )
    assert facts.scaled(0.1) == {
        "coverage": 0.5,
        "error_bound": 0.2,
        "calibrated_value": pytest.approx(0.3),
        "calibrated_standard_error": None,
        "method": "direct",
        "value": 5.0,  # of one's own: its unit is not known
    }
    units = {name: field.unit for name, field in Diagnostics.declared().items()}
    assert {name for name, unit in units.items() if unit == "value"} == {
        "simulator_value",
        "model_value",
        "one_step_value",
        "one_step_standard_error",
        "maximum_likelihood_value",
        "standard_error_if_centre_fits",
        "unrecorded_standard_error",
        "standard_error_of_the_log",
        "truncation_bias_bound",
        "calibrated_value",
        "calibrated_standard_error",
        "replaced_value",
        "refused_value",
        "rounding_error",
        "error_bound",
    }
    assert [Diagnostics.unit_of(name) for name in (*units, "scaled", "mine")] == [
        *units.values(),
        None,
        None,
    ]


def test_a_normalised_report_scales_values_and_keeps_keys_of_ones_own():
    pair = oee.testing.case("ragged")
    problem = pair.problem(20, seed=0)

    def mine(problem, policy):
        return Estimate(2.0, diagnostics={"error_bound": 1e-8, "mine": 7.0})

    plain, scaled = (
        oee.evaluate(
            problem,
            pair.policy,
            estimators={"mine": mine, "oee": OffEnvironment()},
            normalized=normalized,
            seed=0,
        ).records()
        for normalized in (False, True)
    )
    factor = 1.0 - pair.target.discount
    assert [list(row) for row in plain] == [list(row) for row in scaled]
    assert scaled[0]["error_bound"] == 1e-8 * factor
    assert plain[0]["mine"] == scaled[0]["mine"] == 7.0
    for key in ("value", "one_step_value", "unrecorded_standard_error"):
        assert scaled[1][key] == plain[1][key] * factor
    for key in ("coverage", "moved", "one_step_distance", "effective_sample_size"):
        assert scaled[1][key] == plain[1][key]


def test_a_calibrated_row_leaves_out_the_values_of_the_raw_one():
    raw = Estimate(
        2.0,
        0.1,
        diagnostics={
            "model_value": 2.0,
            "error_bound": 1e-9,
            "row_sum_error": 0.0,
            "coverage": 0.9,
            "mine": 1,
        },
    )
    outside = SimpleNamespace(value=1.1, standard_error=0.0)
    found = calibrated_row(raw, outside, 1.0, "ratio", 1.0)
    assert found.value == pytest.approx(2.2)
    assert found.diagnostics == {
        "coverage": 0.9,
        "mine": 1,
        "calibration": "ratio: times 1.1 / 1 (simulator: continuous / discretised)",
        "interval_method": "calibrated",
    }


def test_no_attribute_can_be_set_beside_the_keys():
    facts = Estimate(1.0, diagnostics={"coverage": 0.5}).diagnostics
    for name in ("coverage", "covrage"):
        with pytest.raises(AttributeError):
            setattr(facts, name, 3.0)
    assert facts == {"coverage": 0.5}


def test_a_pickle_that_holds_a_plain_dict_is_read():
    """As those were that an earlier state of the package wrote."""
    estimate = Estimate(1.0, diagnostics={"coverage": 0.5})
    vars(estimate)["diagnostics"] = {"coverage": 0.5}
    old = pickle.loads(pickle.dumps(estimate))
    assert old.diagnostics.coverage == 0.5
    assert isinstance(old.diagnostics, Diagnostics)


@pytest.mark.parametrize(
    ("facts", "place", "rule"),
    [
        ({"model_value": "high"}, "diagnostics['model_value']", "must be a number"),
        ({"n_episodes": [3]}, "diagnostics['n_episodes']", "must be a number"),
        ({"interval_method": 3}, "diagnostics['interval_method']", "must be a text"),
        ({3: 1.0}, "diagnostics", "must have texts for keys; got 3"),
        ([1, 2], "diagnostics", "must be a mapping; got list"),
        ((1, 2), "diagnostics", "must be a mapping, or pairs of key and value"),
    ],
)
def test_a_declared_key_has_its_type(facts, place, rule):
    with pytest.raises(ArgumentError) as caught:
        Estimate(1.0, diagnostics=facts)
    assert caught.value.argument == place
    assert caught.value.rule.startswith(rule)


def test_other_keys_and_none_are_kept_as_they_are():
    facts = {"model_value": None, "colour": ["red"], "coverage": np.float32(0.5)}
    assert Estimate(1.0, diagnostics=facts).diagnostics == facts
