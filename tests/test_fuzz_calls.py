"""A short run of tests/fuzz_calls.py, and what it must be able to see."""

import inspect

import fuzz_files
import numpy as np
import pytest
from fuzz_calls import (
    INNER,
    arguments_of,
    call,
    from_package,
    functions,
    fuzz,
    is_called,
    judged,
    rooms_of_package,
)
from fuzz_values import valid_values

import oee_tabular as oee
from oee_tabular import paper


@pytest.fixture(scope="module")
def known():
    return valid_values()


def test_hostile_values_do_no_harm():
    # one call of each public name; the first ones, which are valid, are tested below.
    # 0 waits: no outcome depends on how quick a machine is
    calls = 500
    counts, wrong = fuzz(seed=0, calls=calls, first=1000, limit=0)
    assert not [outcome for outcome in wrong if outcome[0] != "slow"]
    assert sum(counts.values()) == calls
    assert counts["refused"] > counts["accepted"] > 0


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
        "League.heat",
        "Case.with_rewards",
        "Discretization.encode",
        "Estimate.__eq__",
        "Interval.__contains__",
        "Families.__getitem__",
        "ArgumentError",
    } <= set(every)
    for name, function in every.items():
        call(function, arguments_of(name, function, known))
    rooms = rooms_of_package()
    assert {name for name in oee.__all__ if inspect.ismodule(getattr(oee, name))} == {
        *rooms
    } - {"top"}
    others = {
        name
        for room in rooms.values()
        for name in room.__all__
        if not is_called(getattr(room, name))
    } - {*oee.__all__}
    # a union, base classes, a type of functions
    kinds = {"ContinuousTask", "Estimator", "Model", "Prior", "StatePolicy"}
    errors = {
        name for name in oee.exceptions.__all__ if name.endswith(("Error", "Warning"))
    }
    assert {name for name in others - errors if not name.isupper()} == kinds


def test_what_is_left_out_says_why(known):
    """Methods that the package calls itself are those of its base classes."""
    every = functions(known)
    left_out = set()
    for room, module in rooms_of_package().items():
        for name in module.__all__:
            kind = getattr(module, name)
            if inspect.isclass(kind) and is_called(kind):
                left_out |= {
                    (room, attribute)
                    for attribute in dir(kind)
                    if attribute[0] != "_"
                    and from_package(kind, attribute)
                    and callable(getattr(kind, attribute))
                    and not {f"{name}.{attribute}", f"{room}.{name}.{attribute}"}
                    & set(every)
                    and room != "top"
                }
    listed = {
        (room, attribute.rpartition(".")[2])
        for room, attributes in INNER.items()
        for attribute in attributes
    }
    assert left_out <= listed
    assert "Nothing is checked here" in " ".join(paper.__doc__.split())


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
    number, outcomes, failures = fuzz_files.fuzz(
        seed=1, seconds=float("inf"), folder=tmp_path, most=150, limit=None
    )
    assert not [one for one in failures if "death" in str(one) or "hang" in str(one)]
    assert number == 150
    assert outcomes["refused"] > outcomes["finite"] > 0
