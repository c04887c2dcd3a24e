"""A short run of tests/fuzz_calls.py, and what it must be able to see."""

import inspect

import numpy as np
import pytest
from fuzz_calls import arguments_of, call, functions, fuzz, judged
from fuzz_values import valid_values

import oee_tabular as oee


def test_no_hostile_value_does_harm():
    counts, wrong = fuzz(seed=0, seconds=120.0, calls=1500)
    assert not wrong
    assert sum(counts.values()) > 100


def test_most_public_functions_are_reached():
    known = valid_values()
    found = functions(known)
    assert len(found) >= 100
    for name in (
        "policy_value",
        "sample_episodes",
        "FiniteMDP",
        "OffEnvironment.__call__",
        "evaluate",
        "transition_ratio",
    ):
        call(found[name], arguments_of(name, found[name], known))


def test_every_yes_or_no_is_true_or_false():
    known = valid_values()
    checked = 0
    for name, function in functions(known).items():
        for argument, parameter in inspect.signature(function).parameters.items():
            if parameter.annotation not in ("bool", bool):
                continue
            values = arguments_of(name, function, known)
            for wrong in ("raw", "", 0, 1, None, [1.5], float("nan"), object(), np.array([True, False])):
                with pytest.raises(ValueError, match=rf"{argument} must be True or False; got"):
                    call(function, values | {argument: wrong})
            checked += 1
    assert checked >= 25
    mdp, policy = known["mdp"], known["policy"]
    assert oee.policy_value(mdp, policy, normalized=np.True_) == oee.policy_value(mdp, policy, normalized=True)


@pytest.mark.parametrize(
    ("function", "kind"),
    [
        (lambda mdp: mdp.n_states, "raw"),
        (lambda mdp: float(mdp), "nameless"),
        (lambda mdp: float("nan"), "nan"),
        (lambda mdp: oee.policy_value(mdp, [[1.0]]), "refused"),
        (lambda mdp: np.ones(2), "accepted"),
    ],
)
def test_a_bad_function_is_seen(function, kind):
    assert judged(function, {"mdp": "raw"}, ["mdp"])[0] == kind
