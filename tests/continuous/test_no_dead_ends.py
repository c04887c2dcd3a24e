"""What stopped a report, or was said without a word of warning, before: each with its log."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest

from oee_tabular.continuous.command import continuous_simulator
from oee_tabular.continuous.correction import difference
from oee_tabular.continuous.episodes import MonteCarlo
from oee_tabular.continuous.rows import calibrated_row, refuse_impossible
from oee_tabular.data import ContinuousTransitions
from oee_tabular.estimators import Estimate
from oee_tabular.lab.experiments import classic
from oee_tabular.report import Settings, evaluate_continuous
from oee_tabular.tasks import (
    CartPole,
    LinearModel,
    ResidualSimulator,
    cartpole_policy,
    corrected_value,
    monte_carlo_value,
    record,
)

FEW = Settings(grid=(16, 16), episodes=200)


@dataclass(frozen=True)
class Windy(CartPole):
    """Pushed by gusts."""

    gusts: float = 0.0

    def moves(self, states, actions, disturbance):
        moved = super().moves(states, actions, disturbance)
        moved.next_state[:, 3] += self.gusts * disturbance[:, 3]
        return replace(moved, terminated=self.terminated(moved.next_state))


def report_of(log, settings=FEW, simulator="cartpole:gravity=10", **options):
    given = continuous_simulator(simulator) if isinstance(simulator, str) else simulator
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return evaluate_continuous(
            given, log, {"mixed": cartpole_policy(0.4)}, settings=settings, seed=0, estimators=["oee"], **options
        )


def log_of(task, n=3000):
    return record(task, cartpole_policy(0.3), n_transitions=n, max_steps=100, seed=0)


# ---------------------------------------------------------------- support


# ---------------------------------------------------------------- calibration


@pytest.mark.parametrize(
    ("value", "error", "found"),
    [
        (5.0, None, 5.0),
        (10.5, None, np.nan),
        (10.5, 0.1, np.nan),
        (10.5, 0.4, 10.0),
        (10.5, 0.253, np.nan),
        (-0.1, 0.01, np.nan),
    ],
)
def test_values_that_cannot_be_are_refused(value, error, found):
    given = Estimate(value, error, None if error is None else (value - 1, value + 1))
    estimate = refuse_impossible(given, 0.0, 10.0, 10)
    assert estimate.value == pytest.approx(found, nan_ok=True)
    if np.isnan(found):
        assert estimate.status == f"{value:.4g} is impossible: a sum of 10 rewards is between 0 and 10"
        assert estimate.interval is None
    assert refuse_impossible(given, -np.inf, np.inf, 10) is given  # rewards without bounds refuse no value


@pytest.mark.parametrize(("raw", "below", "said"), [(5.0, 6.0, False), (9.0, 6.0, True)])
def test_calibration_that_changes_more_than_the_simulator_has_a_warning(raw, below, said):
    """By the ratio 9/6 a raw 9 moves by 4.5, the simulator's own value by 3."""
    raw = Estimate(raw, 0.1, (raw - 0.2, raw + 0.2), {"interval_method": "one-step", "one_step_value": 9.9})
    estimate = calibrated_row(raw, MonteCarlo(9.0, 0.01, 1.0, 100), below, "ratio", 1.0)
    assert estimate.value == pytest.approx(raw.value * 1.5)
    assert estimate.interval == pytest.approx(
        (estimate.value - 1.96 * estimate.standard_error, estimate.value + 1.96 * estimate.standard_error)
    )
    assert any("Rely on the corrected simulator instead" in str(finding) for finding in estimate.findings) == said


# ---------------------------------------------------------------- the linear model, rewards


def test_a_linear_model_is_least_squares_with_the_log_s_residuals():
    log = log_of(CartPole(15.0))
    model = LinearModel(CartPole(10.0), log)
    a = log.action == 1
    x = np.column_stack([np.ones(a.sum()), log.state[a]])
    by_hand = np.linalg.lstsq(x, log.next_state[a] - log.state[a])[0]
    left = log.next_state[a] - log.state[a] - x @ by_hand
    np.testing.assert_allclose(model.residuals[a], left, atol=1e-9)
    states, actions = np.zeros((4000, 4)), np.ones(4000, dtype=np.int64)
    moved = model.step(states, actions, np.random.default_rng(0)).next_state - by_hand[0]
    assert np.abs(moved.std(axis=0) / model.residuals[a].std(axis=0) - 1).max() < 0.1
    again = model.resampled(0)
    assert 0 < np.abs(again.coefficients - model.coefficients).max() < 0.1
    truth, found, before = (
        monte_carlo_value(task, cartpole_policy(0.4), 4000, 100, seed=0, normalized=True).value
        for task in (CartPole(15.0), model, CartPole(10.0))
    )
    assert abs(found - truth) < 0.3 * abs(before - truth)


def test_a_resample_of_a_short_log_has_rows():
    model = LinearModel(CartPole(10.0), log_of(CartPole(15.0), 2))
    for seed in range(30):
        assert np.abs(model.resampled(seed).coefficients).max() > 0


def test_rewards_that_are_not_the_task_s_are_reported():
    class Paid(CartPole):
        def reward_between(self, states, actions, next_states):
            return np.ones(len(states))

    simulator = replace(continuous_simulator("cartpole"), task=Paid(10.0))
    log = log_of(CartPole(10.0), 400)
    assert not any("contradict" in text for text in report_of(log, simulator=simulator).warnings)
    columns = log.columns() | {"reward": np.where(np.arange(400) < 3, 2.0, 1.0)}
    said = report_of(ContinuousTransitions(**columns), simulator=simulator).warnings
    assert any(
        "rewards contradict the simulator's r(s, a, s') in 3 of 400 transitions. The reward of row 0 is 2" in text
        for text in said
    )


# ---------------------------------------------------------------- units, and places that the log has not seen


def in_units(log, columns, factor):
    given = log.columns()
    for name in ("state", "next_state"):
        given[name] = given[name].copy()
        given[name][:, list(columns)] *= factor
    return ContinuousTransitions(**given)


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [
        ((), 1.0, ""),
        ((2,), 180 / np.pi, "theta (degrees for radians)"),
        ((2, 3), 180 / np.pi, "theta and theta_dot (degrees for radians)"),
        ((0,), 1e3, "x (mm for m)"),
        ((0, 1), 1e2, "x and x_dot (cm for m)"),
    ],
)
@pytest.mark.parametrize("gusts", [0.0, 0.1])
def test_columns_in_another_unit(columns, factor, said, gusts):
    """Whatever else has changed: gravity, and gusts as large as a push."""
    log = in_units(log_of(Windy(15.0, gusts=gusts), 1000), columns, factor)
    assert ResidualSimulator(CartPole(10.0), log, seed=0).units == said


def test_another_unit_is_no_hidden_state():
    """An angle in degrees: told of with the unit, in the first sentence and in the row's status."""
    task = classic.Acrobot()
    log = in_units(record(task, classic.pumping(0.3), n_transitions=3000, max_steps=500, seed=0), (1,), 180 / np.pi)
    corrected = ResidualSimulator(task, log, seed=0)
    told = "The log's columns seem to be in another unit than the simulator's: angle_2 (degrees for radians)"
    assert difference(corrected).startswith(told)
    assert "Hidden state" not in difference(corrected)
    found = corrected_value(corrected, classic.pumping(0.1), 20, 20, refits=2, paths=10, seed=0)
    assert "degrees for radians" in found.status
    assert "hidden state" not in found.status


def test_a_policy_beyond_the_log_is_reported():
    """The log's cart is pushed at random from the middle; a policy that always pushes right is soon where it never was."""
    log = record(CartPole(15.0), cartpole_policy(1.0), n_transitions=2000, max_steps=8, seed=0)
    corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    away = np.array([log.state[5], 2.0 * log.state.max(axis=0)])
    assert corrected.beyond(away).tolist() == [False, True]
    far, near = (
        corrected_value(corrected, cartpole_policy(1.0), 300, steps, refits=2, paths=100, seed=0) for steps in (60, 5)
    )
    assert far.diagnostics["beyond_log"] > 0.04
    assert near.diagnostics["beyond_log"] < 0.01
    assert [finding.kind for finding in far.findings] == ["beyond"]
    assert not near.findings
    assert "start outside the range of the recorded states" in str(far.findings[0])


def test_without_cells_a_value_of_the_wrong_sign_is_refused(monkeypatch):
    """Rewards are at most 0, in the log and in the simulator: no value above 0 stands."""
    log = record(classic.MountainCar(force=0.0012), classic.rocking(0.3), n_transitions=600, max_steps=200, seed=0)
    monkeypatch.setattr(ResidualSimulator, "_reward", lambda self, states, *rest: np.ones(len(states)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report = evaluate_continuous(
            classic.MountainCar(), log, {"mixed": classic.rocking(0.4)}, settings=Settings(episodes=50),
            horizon=20, seed=0, estimators=["oee"],
        )  # fmt: skip
    residual = report.results[0]
    assert residual.estimator == "oee (residual)"
    assert np.isnan(residual.estimate.value)
    assert "is impossible: a sum of 20 rewards is between -inf and 0" in residual.estimate.status
