"""Objects that calls return: what they refuse, and that their texts never raise."""

import copy
import dataclasses
import pickle
from decimal import Decimal

import numpy as np
import pytest
from fuzz_values import SpiteOfText, spiteful, valid_values
from scipy import sparse

import oee_tabular as oee
from oee_tabular.exceptions import ArgumentError


@pytest.fixture(scope="module")
def results():
    """Name -> a valid object of each public dataclass."""
    found = valid_values()["holders"]
    return {
        name: one for name, one in found.items() if hasattr(type(one), "_is_checked")
    }


WRONG = (
    None,
    "x",
    "",
    b"x",
    3,
    -1,
    1.5,
    float("nan"),
    10**5000,
    True,
    1j,
    [],
    ["a"],
    [[1.0], [2.0, 3.0]],
    {},
    {"a": "b"},
    {1: 2},
    {0.5},
    np.array(1.0),
    np.array(["a"]),
    np.ones((2, 2, 2)),
    np.array([None]),
    np.ma.masked_array([1.0], mask=[True]),
    sparse.csr_array((2, 2)),
    Decimal("sNaN"),
    object(),
    oee.FiniteMDP,
    lambda: 1,
)


@pytest.mark.filterwarnings("ignore")
def test_a_wrong_field_is_named_or_the_object_can_be_written(results):
    refused = longest = 0
    for result in results.values():
        fields = [f.name for f in dataclasses.fields(result) if f.init]
        for field in fields:
            for wrong in WRONG:
                try:
                    made = dataclasses.replace(result, **{field: wrong})
                except ArgumentError as error:
                    refused += 1
                    longest = max(longest, len(str(error)))
                else:
                    assert repr(made)
                    assert isinstance(str(made), str)
    assert refused > 3000
    assert longest < 1000


@pytest.mark.filterwarnings("ignore")
def test_texts_of_edited_results_never_raise(results):
    spite = spiteful("__repr__", "__str__", "__format__", error=SpiteOfText)
    for result in results.values():
        for field in dataclasses.fields(result):
            edited = copy.copy(result)
            object.__setattr__(edited, field.name, spite)
            for write in (repr, str):
                assert isinstance(write(edited), str)
            html = getattr(edited, "_repr_html_", None)
            assert html is None or isinstance(html(), str)


@pytest.mark.filterwarnings("ignore")
def test_results_equal_their_pickles_and_copies(results):
    compared = 0
    for name, result in results.items():
        params = type(result).__dataclass_params__
        if not params.eq:
            continue
        same = dataclasses.replace(result)
        assert same == result, name
        if name not in NOT_PICKLED:
            again = pickle.loads(pickle.dumps(result))
            assert repr(again) == repr(result)
        assert copy.copy(result) == result
        assert result != 3
        assert result != np.ones(3).tolist()
        compared += 1
    assert compared > 15


# hold functions that are defined where they are used
NOT_PICKLED = ("NamedTask", "ContinuousSimulator")


@pytest.mark.parametrize(
    ("make", "argument", "rule"),
    [
        (lambda: oee.Estimate("1"), "value", "must be a number; got '1'"),
        (
            lambda: oee.Estimate(10**400),
            "value",
            "must be a number; got 1000000",
        ),
        (
            lambda: oee.Estimate(1.0, interval=(0.0,)),
            "interval",
            "must have 2 entries; it has 1",
        ),
        (
            lambda: oee.Estimate(1.0, interval=(0.0, "b")),
            "interval[1]",
            "must be a number; got 'b'",
        ),
        (
            lambda: oee.Estimate(1.0, diagnostics={"coverage": "half"}),
            "diagnostics['coverage']",
            "must be a number, or None; got 'half'",
        ),
        (
            lambda: oee.Interval(0.0, 1.0, 95.0, "delta"),
            "confidence",
            "must be in (0, 1]; it is 95",
        ),
        (
            lambda: oee.estimators.Finding("a", "high", "b"),
            "severity",
            "must be a number; got 'high'",
        ),
        (
            lambda: oee.plots.Map((0.0,), (1,), [0.5]),
            "cell",
            "must be an array of integers; its entries are of type float64",
        ),
        (
            lambda: oee.Moments(1.0, 0.0, by_step=np.ones((2, 2))),
            "by_step",
            "must have 1 dimension(s), (t); it has shape (2, 2)",
        ),
        (
            lambda: oee.testing.Verdict("limit", None, "x"),
            "outcome",
            "must be a text; got NoneType",
        ),
        (
            lambda: oee.bench.Families({"a": 1}, 0, {}),
            "makers['a']",
            "must be a function; got int",
        ),
        (
            lambda: oee.bench.league_of([1]),
            "table",
            "must be a DataFrame; got list",
        ),
    ],
)
def test_what_is_refused(make, argument, rule):
    with pytest.raises(ArgumentError) as caught:
        make()
    assert caught.value.argument == argument
    assert caught.value.rule.startswith(rule)


def test_comparison_names_what_it_does_not_know():
    pair = oee.testing.case("ragged")
    policies = {"new": pair.policy, "old": pair.behavior}
    found = oee.inference.compare_policies(pair.problem(100, seed=0), policies)
    for call, argument in (
        (lambda: found.bounds("new", "newest"), "other"),
        (lambda: found.bounds(np.ones(2), "old"), "one"),
        (lambda: found.bounds("new", "old", {"new": (0, 1)}), r"intervals\['new'\]"),
        (lambda: found.decide({"new": None}), r"values\['new'\]"),
        (lambda: found.decide({"newest": 1.0}), "a key of values"),
        (lambda: found.decide({}), "values"),
        (lambda: found.decide(intervals=[1]), "intervals"),
        (
            lambda: dataclasses.replace(found, lower=found.lower[:1]),
            "lower",
        ),
        (lambda: dataclasses.replace(found, names=("a", "a")), "names"),
    ):
        with pytest.raises(ArgumentError, match=f"^{argument} must "):
            call()
    assert found.decide({"new": 1.0, "old": 0.0}).candidates[0] == "new"


def test_lists_become_what_is_declared():
    trace = oee.ratio.SgdTrace([1, 2], [0.5, 0.25], np.ones(2, dtype=np.float32))
    assert trace.iteration.dtype == np.int64
    assert trace.excess.dtype == np.float64
    assert trace.error.dtype == np.float32  # what fits stays the object that it is
    decision = oee.inference.Decision(["a"], np.True_, {"a": None}, [1.0, 0.5, 1.5])
    assert decision.candidates == ("a",)
    assert decision.margin == (1.0, 0.5, 1.5)
    assert oee.Estimate(np.array(2.0)).value == 2.0
    assert oee.Estimate(Decimal("0.5")).value == 0.5


@pytest.mark.parametrize("law", ["limits", 3, Decimal("sNaN"), ["limit"], None])
def test_a_law_that_has_no_verdict(law):
    verdict = oee.testing.Verdict("limit", "holds", "x")
    verdicts = oee.testing.Verdicts("x", frozenset(), 0, {"limit": verdict})
    assert verdicts["limit"] == verdict
    with pytest.raises(KeyError, match="law must be one of limit; got"):
        verdicts[law]


def test_the_rules_of_fields():
    pair = oee.testing.case("ragged")
    plan = oee.plan_data_collection(pair.problem(50, seed=0), pair.policy, n=20)
    outlook = plan.policies[0]
    trace = oee.ratio.SgdTrace([1], [0.5], [0.25])
    verdict = oee.testing.Verdict("limit", "holds", "x")
    verdicts = oee.testing.Verdicts("x", frozenset(), 0, {"limit": verdict})
    for result, fields, argument in (
        (plan, {"policies": outlook}, "policies"),
        (plan, {"policies": [outlook, "b"]}, "policies[1]"),
        (plan, {"policies": ()}, "policies"),
        (plan, {"counts": np.ones((2, 1))}, "counts"),
        (plan, {"counts": np.ones(1)}, "counts"),
        (plan, {"counts": [["x"]]}, "counts"),
        (plan, {"costs": {"policy": np.ones((1, 1))}}, "costs['policy']"),
        (plan, {"costs": {1: plan.counts}}, "a key of costs"),
        (plan, {"optimistic": plan.counts}, "optimistic"),
        (plan, {"next_pairs": [(0, 10**6)]}, "next_pairs[0]"),
        (plan, {"next_pairs": [(0,)]}, "next_pairs[0]"),
        (plan, {"next_pairs": [(0, 0.5)]}, "next_pairs[0][1]"),
        (plan, {"sampling": "both"}, "sampling"),
        (plan, {"confidence": 0.0}, "confidence"),
        (outlook, {"confidence": float("nan")}, "confidence"),
        (plan, {"n": -1}, "n"),
        (plan, {"n": True}, "n"),
        (plan, {"n": 2**64}, "n"),
        (plan, {"restart": "no"}, "restart"),
        (trace, {"iteration": [0.5]}, "iteration"),
        (trace, {"error": [1.0, 2.0]}, "error"),
        (verdicts, {"claims": ["limit"]}, "claims"),
        (verdicts, {"claims": {1}}, "an item of claims"),
        (verdicts, {"verdicts": {"limit": "holds"}}, "verdicts['limit']"),
        (verdicts, {"verdicts": [("limit", verdict)]}, "verdicts"),
    ):
        with pytest.raises(ArgumentError) as caught:
            dataclasses.replace(result, **fields)
        assert caught.value.argument == argument
    assert dataclasses.replace(plan, policies=[outlook]).policies == (outlook,)
    assert dataclasses.replace(verdicts, claims={"limit"}).claims == {"limit"}
    with pytest.raises(TypeError, match="unexpected keyword argument 'laws'"):
        oee.testing.Verdict(laws="limit", outcome="holds", text="x")


def test_arrays_are_compared_by_their_entries():
    one, same, other = (oee.density_ratio([1, k], [2, 1]) for k in (2, 2, 3))
    assert one == same
    assert one != other
    with_arrays = [
        oee.Estimate(1.0, diagnostics={"x": np.array(x), "y": [np.ones(2)]})
        for x in ([1.0, 2.0], [1.0, 2.0], [1.0, 3.0], [1.0])
    ]
    assert with_arrays[0] == with_arrays[1]
    assert with_arrays[0] != with_arrays[2]
    assert with_arrays[0] != with_arrays[3]


def test_a_result_that_holds_itself_can_be_written():
    holder = []
    facts = {"limit": 1.0, "holder": holder}
    interval = oee.Interval(0.0, 1.0, 0.95, "delta", facts)
    decision = oee.inference.Decision(("a",), False, {"a": None}, None)
    report = oee.evaluate(
        oee.testing.case("ragged").problem(20, seed=0),
        oee.testing.case("ragged").policy,
        estimators=["simulator"],
    )
    report = dataclasses.replace(report, facts={**report.facts, "mine": holder})
    holder += [interval, decision, report]
    assert repr(interval)
    assert interval._repr_html_()
    assert repr(report)
    assert dataclasses.replace(report) == report


def test_an_error_of_a_callers_array_names_the_argument_and_what_it_raised():
    with pytest.raises(ValueError, match=r"^policy must be .*Spite"):
        oee.policy_value(oee.testing.case("ragged").target, spiteful("__array__"))


def test_a_longer_float_is_kept_as_a_float():
    """Scipy has no functions of them: a width failed long after the call."""
    found = oee.inference.Interval(
        np.longdouble("0.1"), 1.0, np.longdouble("0.95"), "likelihood", {}
    )
    assert type(found.confidence) is float
    assert type(found.lower) is float
