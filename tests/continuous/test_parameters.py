"""A simulator's parameters by least squares on a log."""

import gymnasium
import numpy as np
import pytest
from benchmarks.hidden_state import Cogging, RandomActions
from numpy.testing import assert_allclose

from oee_tabular.continuous.correction import choose_correction, parameters_of
from oee_tabular.continuous.evaluation import evaluate_continuous
from oee_tabular.lab.experiments import classic
from oee_tabular.tasks import (
    CartPole,
    Settings,
    cartpole_policy,
    fit_parameters,
    gymnasium_simulator,
    record,
)


def cartpole_log(target, n=300, seed=0):
    return record(target, cartpole_policy(0.3), n_transitions=n, max_steps=100, seed=seed)


def pendulum_log(target, n=300, seed=0):
    return record(target, classic.swinging(0.3), n_transitions=n, max_steps=200, seed=seed)


def test_the_right_structure_is_found_exactly():
    """Without noise: all of the parameters, and nothing is left."""
    target = classic.Pendulum(mass=1.2, gravity=11.0, friction=0.1)
    log = pendulum_log(target)
    fit = fit_parameters(*parameters_of(classic.Pendulum(), ["mass", "gravity", "friction"]), log)
    assert_allclose([fit.parameters[name] for name in ("mass", "gravity", "friction")], [1.2, 11.0, 0.1], rtol=1e-6)
    assert fit.start == {"mass": 1.0, "gravity": 10.0, "friction": 0.0}
    assert_allclose(fit.residual, 0.0, atol=1e-8)
    states, actions = log.state[:9], log.action[:9]
    none = np.zeros((9, 0))
    assert_allclose(fit.task.moves(states, actions, none).next_state, target.moves(states, actions, none).next_state)


def test_standard_errors_are_those_of_other_logs():
    fits = [
        fit_parameters(*parameters_of(CartPole(10.0), ["gravity"]), cartpole_log(CartPole(12.0), seed=seed))
        for seed in range(30)
    ]
    found = np.array([fit.parameters["gravity"] for fit in fits])
    errors = np.array([fit.standard_error["gravity"] for fit in fits])
    assert 0.6 < found.std() / errors.mean() < 1.6
    assert (np.abs(found - 12.0) < 2 * errors).mean() > 0.8


def test_rows_that_no_structure_explains_pull_little():
    log = cartpole_log(RandomActions(classic.ChangedCartPole(12.5), 0.1), 2000)
    fit = fit_parameters(*parameters_of(classic.ChangedCartPole(10.0), ["gravity", "force"]), log)
    assert_allclose([fit.parameters["gravity"], fit.parameters["force"]], [12.5, 1.0], rtol=0.01)


def test_what_a_log_does_not_determine_is_reported():
    """Steps depend on gravity / length and 1 / (mass length^2) alone."""
    log = pendulum_log(classic.Pendulum(mass=1.2, gravity=11.0))
    fit = fit_parameters(*parameters_of(classic.Pendulum(), ["mass", "length", "gravity"]), log)
    assert np.isinf(list(fit.standard_error.values())).all()
    assert "The log does not determine mass, length, gravity." in fit.describe()


def test_a_fit_at_its_bound_is_reported():
    fit = fit_parameters(CartPole, {"gravity": 10.0}, cartpole_log(CartPole(15.0)), {"gravity": (5.0, 12.0)})
    assert_allclose(fit.parameters["gravity"], 12.0, rtol=1e-3)
    assert fit.at_bounds == ("gravity",)
    assert "The fit stopped at a bound of gravity." in fit.describe()


@pytest.mark.parametrize(
    ("spec", "truth"),
    [
        ("Pendulum-v1", {"g": 9.0, "m": 1.3}),
        ("CartPole-v1", {"length": 0.7, "gravity": 11.0}),  # from which the environment computes others
    ],
)
def test_gymnasium(spec, truth):
    target = gymnasium_simulator(f"{spec}:" + ",".join(f"{key}={x}" for key, x in truth.items())).task
    policy = lambda states: np.full((len(states), target.n_actions), 1.0 / target.n_actions)  # noqa: E731
    log = target.record(policy, n_transitions=300, max_steps=100, seed=0)
    fit = fit_parameters(*parameters_of(gymnasium_simulator(spec).task, list(truth)), log)
    assert_allclose([fit.parameters[name] for name in truth], list(truth.values()), rtol=1e-4)


def test_mujoco():
    pytest.importorskip("mujoco")
    truth = {"body_mass.pole": 8.0, "dof_damping.slider": 2.0, "actuator_gear.slide": 80.0}
    simulator = gymnasium_simulator("InvertedPendulum-v5", actions=5).task
    model = gymnasium.make("InvertedPendulum-v5").unwrapped.model
    assert simulator.family.known()["body_mass.pole"] == model.body("pole").mass[0]
    target = simulator.family(**truth)
    policy = lambda states: np.full((len(states), 5), 0.2)  # noqa: E731
    log = target.record(policy, n_transitions=300, max_steps=30, seed=0)
    fit = fit_parameters(*parameters_of(simulator, list(truth)), log)
    assert_allclose([fit.parameters[name] for name in truth], list(truth.values()), rtol=1e-2)


def test_parameters_come_first_and_the_residual_on_top():
    log = pendulum_log(Cogging(mass=1.2, gravity=11.0, cogging=0.1, dry=0.1), 3000)
    fit = fit_parameters(*parameters_of(classic.Pendulum(), ["mass", "gravity"]), log)
    chosen = choose_correction(classic.Pendulum(), log, fit=fit, seed=0)
    assert chosen.fit is fit
    assert chosen.name == "oee (parameters, residual)"
    assert chosen.learned.task is fit.task
    assert (
        "corrects the residuals of the fitted simulator, because its held-out one-step error is no larger"
        in chosen.reason
    )
    worse = fit_parameters(classic.Pendulum, {"gravity": 3.0}, log, {"gravity": (2.0, 4.0)})
    assert choose_correction(classic.Pendulum(), log.first(400), fit=worse, seed=0).fit is None


def test_a_report_fits_by_name():
    log = cartpole_log(CartPole(14.0), 1000)
    report = evaluate_continuous(
        CartPole(10.0), log, {"p": cartpole_policy(0.5)}, settings=Settings(episodes=200), horizon=50, seed=0,
        fit=["gravity"], estimators=["oee"],
    )  # fmt: skip
    assert [r["estimator"] for r in report.records()][:2] == ["oee (parameters, residual)", "oee (residual)"]
    assert report.uncertainty.sentences[0].startswith("Least squares gives gravity 14")
