"""Classes of errors and warnings: what users catch and filter, and where they point."""

import dataclasses
import pickle
import typing
import warnings

import numpy as np
import pandas as pd
import pytest

import oee_tabular as oee
from oee_tabular import exceptions
from oee_tabular.exceptions import (
    ArgumentError,
    CostWarning,
    DataWarning,
    DiscretizationWarning,
    NumericalWarning,
    OeeWarning,
    SimulatorWarning,
)

COIN = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], 0, 0.5)
LOG = oee.Transitions([0, 1, 0, 1], [0, 0, 0, 0], [1, 0, 0, 1])


def test_every_class_is_one_of_pythons_too():
    for name in exceptions.__all__:
        kind = getattr(exceptions, name)
        if name.endswith("Warning"):
            assert issubclass(kind, OeeWarning)
            assert issubclass(kind, UserWarning)
        else:
            assert issubclass(kind, ValueError | RuntimeError | TypeError), name


@pytest.mark.parametrize(
    ("call", "argument", "rule"),
    [
        (lambda: oee.tasks.gridworld(4, slip=2.0), "slip", "must be in [0, 1]; it"),
        (
            lambda: oee.FiniteMDP([[[0.5, 0.4]]] * 2, [0.0, 1.0], 0, 0.5),
            "transitions[0, 0]",
            "must sum to 1",
        ),
        (lambda: oee.Problem(COIN, LOG, horizon=0), "horizon", "must be"),
        (
            lambda: oee.interval(oee.Problem(COIN, LOG), [0, 0], method="likely"),
            "method",
            "must be one of",
        ),
        (
            lambda: oee.Transitions([0], [0], [0], terminated=[2]),
            "terminated[0]",
            "must be",
        ),
        (lambda: oee.density_ratio([1.0], [-1.0]), "q[0]", "must be nonnegative"),
    ],
)
def test_an_error_carries_its_argument_and_its_rule(call, argument, rule):
    with pytest.raises(ArgumentError) as raised:
        call()
    error = raised.value
    assert error.argument == argument
    assert error.rule.startswith(rule)
    assert str(error) == f"{error.argument} {error.rule}"
    copied = pickle.loads(pickle.dumps(error))
    assert (str(copied), copied.argument, copied.rule) == (
        str(error),
        error.argument,
        error.rule,
    )
    assert repr(error) == f"ArgumentError({str(error)!r})"


def read_frame():
    """Read a column by another project's label."""
    frame = pd.DataFrame({"state": [0], "action": [0], "next_state": [1]})
    return oee.Transitions.from_frame(frame.assign(rewards=1.0))


def read_file(folder):
    """Leave a column of a file out."""
    path = folder / "log.csv"
    path.write_text("state,action,next_state,remark\n0,0,1,1.0\n")
    return oee.Transitions.load(path)


def overflow():
    """Weigh returns until no float holds their variance."""
    with np.errstate(all="ignore"):
        return oee.policy_value(COIN.with_rewards([1e308, 1.7e308]), [0, 0])


def cut_coarsely():
    """Cut CartPole into too few cells."""
    return oee.tasks.discretize(oee.tasks.CartPole(), cells=(4, 4))


WARNINGS = {
    "a horizon that the discount ends": (
        lambda folder: oee.policy_value(COIN, [0, 0], horizon=10**9),
        CostWarning,
    ),
    "a column of a frame": (lambda folder: read_frame(), DataWarning),
    "a column of a file": (read_file, DataWarning),
    "a value beyond floats": (lambda folder: overflow(), NumericalWarning),
    "pairs never recorded": (
        lambda folder: oee.FiniteMDP.from_log(
            oee.Transitions([0, 0, 1], [0, 1, 0], [1, 1, 0]),
            [0.0, 1.0],
            discount=0.5,
            initial=0,
        ),
        SimulatorWarning,
    ),
    "coarse cells": (lambda folder: cut_coarsely(), DiscretizationWarning),
}


@pytest.mark.parametrize("name", WARNINGS)
def test_a_warning_has_its_kind_and_points_to_the_line_of_the_caller(name, tmp_path):
    call, kind = WARNINGS[name]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(tmp_path)
    own = [each for each in caught if issubclass(each.category, OeeWarning)]
    assert {each.category for each in own} == {kind}
    assert {each.filename for each in own} == {__file__}


def test_a_warning_from_replace_points_to_the_line_of_the_caller():
    problem = oee.Problem(COIN, LOG)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dataclasses.replace(problem, horizon=10**9)
    assert {each.filename for each in caught} == {__file__}


class OwnError(ArgumentError):
    """A subclass whose constructor takes something else."""

    def __init__(self, place):
        super().__init__(place, "must be mine")


def test_a_subclass_of_an_error_is_pickled_as_well():
    copied = pickle.loads(pickle.dumps(OwnError("here")))
    assert (type(copied), str(copied)) == (OwnError, "here must be mine")
    assert copied.args == ("here must be mine",)


def test_an_error_of_a_file_keeps_its_argument(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text("state,action,next_state\n0,-1,1\n")
    with pytest.raises(ArgumentError) as raised:
        oee.Problem(COIN, path)
    assert raised.value.argument.startswith("log: ")


def test_hints_of_types_can_be_read_at_run_time():
    for door in (oee.sample_returns, oee.tasks.NamedTask, oee.tasks.CartPole):
        assert typing.get_type_hints(door)


def test_the_package_s_own_warnings_can_be_filtered():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", OeeWarning)
        read_frame()
    assert caught == []


def test_an_endless_name_of_an_argument_is_shortened_and_kept():
    error = oee.exceptions.ArgumentError("x" * 10**6, "must be short")
    assert len(str(error)) < 400
    assert str(error).endswith("x must be short")
    assert len(error.argument) == 10**6
