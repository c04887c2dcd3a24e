"""Tests of what the room of tasks shows: what problems are made from, by one name each."""

import importlib

import pytest

import oee_tabular as oee

ROOMS = (
    *("data", "decision", "design", "estimators", "exact", "inference", "lab.bench"),
    *("mdp", "plots", "ratio", "report", "shrinkage", "simulate", "testing", "theory"),
)
HELD = (
    *("CartPole", "GymnasiumTask", "HistoryTask", "ResidualSimulator", "bus_engines"),
    *("discretize", "fit_parameters", "gridworld", "gridworld_expert", "named_task"),
)


@pytest.mark.parametrize("room", ROOMS)
def test_no_name_of_another_room_is_here_as_well(room):
    other = importlib.import_module(f"oee_tabular.{room}")
    shared = set(oee.tasks.__all__) & set(getattr(other, "__all__", ()))
    assert shared == set()


def test_names_that_stay():
    assert oee.tasks.kinova.GOALS.shape == (5, 3)
    assert [name for name in HELD if not hasattr(oee.tasks, name)] == []


def test_continuous_names_are_those_of_the_wing():
    wing = importlib.import_module("oee_tabular.continuous")
    own = [name for name in oee.tasks.__all__ if name not in vars(oee.tasks)]
    assert own
    for name in own:
        assert getattr(oee.tasks, name) is getattr(wing, name)


@pytest.mark.parametrize("name", ["evaluate_continuous", "Settings"])
def test_what_is_no_task_is_not_here(name):
    with pytest.raises(AttributeError, match=f"has no attribute '{name}'"):
        getattr(oee.tasks, name)


def test_what_evaluates_them_is_in_the_report():
    report = importlib.import_module("oee_tabular.report")
    for name in ("ContinuousSimulator", "Settings", "evaluate_continuous"):
        assert name in report.__all__
        assert callable(getattr(report, name))
