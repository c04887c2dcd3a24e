"""A short run of tests/fuzz_calls.py, and what it must be able to see."""

import inspect

import fuzz_files
import numpy as np
import pytest
from fuzz_calls import arguments_of, call, functions, fuzz, is_called, judged
from fuzz_values import valid_values

import oee_tabular as oee


@pytest.fixture(scope="module")
def known():
    return valid_values()


def test_hostile_values_do_no_harm():
    # the first ones are valid
    counts, wrong = fuzz(seed=0, seconds=60.0, calls=300, first=1000)
    assert not [outcome for outcome in wrong if outcome[0] in ("death", "hang", "slow")]
    assert sum(counts.values()) > 100


@pytest.mark.filterwarnings("ignore")
def test_no_name_is_left_out(known):
    """Every public function and class has a valid call; what else is public is a
    module, a constant or a kind of objects.
    """
    every = functions(known)
    assert {
        "Transitions.open",
        "FiniteMDP.from_env",
        "TransitionCounts.of",
        "Report.save",
        "Magic.limit",
    } <= set(every)
    for name, function in every.items():
        call(function, arguments_of(name, function, known))
    rooms = [
        oee,
        *(
            getattr(oee, name)
            for name in oee.__all__
            if inspect.ismodule(getattr(oee, name)) and name != "exceptions"
        ),
    ]
    others = {
        name
        for room in rooms
        for name in room.__all__
        if not is_called(getattr(room, name))
    } - {*oee.__all__}
    # a union, two base classes, a type of functions
    kinds = {"ContinuousTask", "Estimator", "Model", "StatePolicy"}
    assert {name for name in others if not name.isupper()} == kinds


def test_every_yes_or_no_is_true_or_false(known):
    checked = 0
    for name, function in functions(known).items():
        for argument, parameter in inspect.signature(function).parameters.items():
            # which take what they get
            if parameter.annotation not in ("bool", bool) or name in known["holders"]:
                continue
            values = arguments_of(name, function, known)
            for wrong in (
                "raw",
                "",
                0,
                1,
                None,
                [1.5],
                float("nan"),
                object(),
                np.array([True, False]),
            ):
                with pytest.raises(
                    ValueError, match=rf"{argument} must be True or False; got"
                ):
                    call(function, values | {argument: wrong})
            checked += 1
    assert checked >= 25
    mdp = known["mdp"]
    policy = known["policy"]
    assert oee.policy_value(mdp, policy, normalized=np.True_) == oee.policy_value(
        mdp, policy, normalized=True
    )


@pytest.mark.parametrize(
    ("function", "kind"),
    [
        (lambda mdp: mdp.n_states, "raw"),
        (lambda mdp: float(mdp), "raw"),
        (lambda mdp: float("nan"), "nan"),
        (lambda mdp: oee.policy_value(mdp, [[1.0]]), "refused"),
        (lambda mdp: np.ones(2), "accepted"),
    ],
)
def test_a_bad_function_is_detected(function, kind):
    assert judged(function, {"mdp": "raw"}, ["mdp"])[0] == kind


# ---- a short run of ``fuzz_files.py``: files that are broken in every way that it
# knows
@pytest.mark.filterwarnings("ignore")
def test_broken_files_are_refused_with_a_sentence(tmp_path):
    number, outcomes, failures = fuzz_files.fuzz(seed=1, seconds=5, folder=tmp_path)
    assert not [one for one in failures if "death" in str(one) or "hang" in str(one)]
    assert number > 100
    assert outcomes["refused"] > outcomes["finite"] > 0
