"""A misspelt keyword is answered with the function's name and the nearest keyword."""

import importlib
import inspect
import pickle
import sys
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.exceptions import UnknownKeywordError

sys.path.insert(0, str(Path(__file__).parents[1] / "notebooks"))
from subjects import SUBJECTS

sys.path.pop(0)


def optional_of(function):
    """The names of optional parameters; none where any keyword is taken."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return []
    if any(each.kind is each.VAR_KEYWORD for each in parameters):
        return []
    return [
        each.name
        for each in parameters
        if each.default is not each.empty and not each.name.startswith("_")
    ]


def is_result(kind):
    """Whether users only receive such objects: their fields are Attributes."""
    text = inspect.getdoc(kind) or ""
    return "Attributes\n---" in text and "Parameters\n---" not in text


def doors():
    """Name -> function or class of the package that users call with options."""
    found = {}
    for module, headings in SUBJECTS.items():
        if module in ("paper", "exceptions"):
            continue
        loaded = importlib.import_module(f"oee_tabular.{module}")
        for name in (name for group in headings.values() for name in group):
            value = getattr(loaded, name)
            if not getattr(value, "__module__", "").startswith("oee_tabular"):
                continue
            if inspect.isclass(value):
                if "__init__" in vars(value) and not is_result(value):
                    found[name] = value
                for method, made in vars(value).items():
                    if isinstance(made, classmethod) and not method.startswith("_"):
                        found[f"{name}.{method}"] = getattr(value, method)
            elif inspect.isroutine(value):
                found[name] = value
    return {name: door for name, door in found.items() if optional_of(door)}


DOORS = doors()


@pytest.mark.parametrize("name", DOORS)
def test_a_misspelt_keyword_names_the_nearest(name):
    door = DOORS[name]
    own = door.__name__
    for keyword in optional_of(door):
        wrong = f"{keyword}x"
        with pytest.raises(TypeError) as raised:
            door(**{wrong: None})
        text = str(raised.value)
        assert text.startswith(f"{own}() got an unexpected keyword argument '{wrong}'")
        assert f"Did you mean '{keyword}'?" in text or len(keyword) < 3


def test_most_doors_are_tried():
    assert len(DOORS) > 110
    assert {"evaluate", "interval", "FiniteMDP", "OffEnvironment", "gridworld"} <= set(
        DOORS
    )


def test_a_keyword_that_resembles_none_lists_them():
    with pytest.raises(
        UnknownKeywordError, match=r"It takes size, slip, pay, discount"
    ):
        oee.tasks.gridworld(4, slip=0.1, wind=0.5)


def test_the_error_carries_its_parts_also_from_another_process():
    error = UnknownKeywordError("evaluate", "sed", "seed", ["seed", "quick"])
    copied = pickle.loads(pickle.dumps(error))
    assert (copied.function, copied.keyword, copied.nearest) == (
        "evaluate",
        "sed",
        "seed",
    )
    assert str(copied) == str(error)


def test_other_type_errors_pass_unchanged():
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        oee.tasks.gridworld(slip=0.1)


def test_an_unknown_keyword_of_a_function_below_is_not_taken_for_one_of_the_door():
    def estimator(problem, policy):
        return {"value": 1.0}[problem]  # raises, but no TypeError of a door

    problem = oee.testing.case("ragged").problem(10, seed=0)
    with pytest.raises((KeyError, TypeError)) as raised:
        oee.evaluate(problem, [0, 0, 0, 0], estimators=[estimator])
    assert not isinstance(raised.value, UnknownKeywordError)


@pytest.mark.parametrize(
    "make",
    [
        lambda hostile: oee.ratio.Joint(ridge=hostile),
        lambda hostile: oee.ratio.InClass(features=[0.0], lower=hostile),
        lambda hostile: oee.estimators.Estimate(1.0, diagnostics={"mine": hostile}),
    ],
)
def test_what_holds_an_object_without_a_text_has_a_text(make):
    class Unwritable(float):
        def __repr__(self):
            raise RuntimeError("no text")

        def __call__(self, n):
            return 0.0

    assert repr(make(Unwritable(0.5)))


def test_a_number_of_more_digits_than_python_writes_has_a_text():
    assert repr(oee.estimators.Estimate(1.0, diagnostics={"mine": 10**5000}))
    assert repr(oee.bench.Families({}, 10**5000, {}))


def test_options_are_kept_as_floats():
    """Numbers of other types do not mix with floats, or are longer than scipy's."""
    tasks = oee.tasks
    cart = tasks.CartPole(gravity=Decimal("9.8"))
    assert cart == tasks.CartPole(9.8)
    assert type(cart.gravity) is float
    ridge = oee.ratio.Quotient(ridge=Fraction(1, 2)).ridge
    assert ridge == 0.5
    assert type(ridge) is float
    for kind in (np.longdouble, np.float32, np.float16):
        ridge = oee.ratio.Quotient(ridge=kind(0.5)).ridge
        assert ridge == 0.5
        assert type(ridge) is float
    with pytest.raises(ValueError, match="gravity must be"):
        tasks.CartPole(gravity=Decimal("sNaN"))
