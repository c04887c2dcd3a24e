"""Rewards, probabilities and counts at the edge of what floats hold: scaled, refused by
name, or said.
"""

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.data import Transitions
from oee_tabular.estimators import (
    DoublyRobust,
    ImportanceSampling,
    ModelBased,
    OffEnvironment,
)

TARGET, SIMULATOR = (oee.tasks.gridworld(3, slip) for slip in (0.1, 0.3))
UNIFORM = oee.uniform_policy(TARGET)


def times(mdp, scale):
    return oee.FiniteMDP(
        mdp.transitions, mdp.transition_rewards * scale, mdp.initial, mdp.discount
    )


@pytest.mark.parametrize("scale", [1e150, 1e160, 1e-200])
@pytest.mark.parametrize("kind", ["per_decision", "trajectory"])
@pytest.mark.parametrize("self_normalized", [False, True])
def test_moments_have_the_scale_of_the_rewards(scale, kind, self_normalized, recwarn):
    zeta = oee.true_ratio(TARGET, SIMULATOR)
    options = {"kind": kind, "self_normalized": self_normalized, "horizon": 15}
    plain = oee.weighted_return_moments(SIMULATOR, zeta, UNIFORM, **options)
    scaled = oee.weighted_return_moments(
        times(SIMULATOR, scale), zeta, UNIFORM, **options
    )
    assert [scaled.mean, scaled.standard_deviation, scaled.bias] == pytest.approx(
        [plain.mean * scale, plain.standard_deviation * scale, plain.bias * scale],
        rel=1e-9,
    )
    said = [str(w.message) for w in recwarn]
    assert all("standard_deviation has its root" in text for text in said)
    assert bool(said) == (scale in (1e160, 1e-200))


def test_baselines_are_scaled_with_the_rewards():
    zeta = oee.true_ratio(TARGET, SIMULATOR)
    plain = oee.doubly_robust_moments(SIMULATOR, zeta, UNIFORM, horizon=10)
    scaled = oee.doubly_robust_moments(
        times(SIMULATOR, 1e120), zeta, UNIFORM, horizon=10
    )
    assert scaled.variance == pytest.approx(plain.variance * 1e240, rel=1e-9)


@pytest.mark.parametrize(
    "estimator", [OffEnvironment(), ModelBased(), DoublyRobust(), ImportanceSampling()]
)
@pytest.mark.parametrize("scale", [1e150, 1e160, 1e-200])
def test_standard_errors_have_the_scale_of_the_rewards(estimator, scale):
    log = oee.sample_episodes(TARGET, UNIFORM, 30, 20, seed=0)

    def found(by):
        rewards = log.columns() | {"reward": log.reward * by}
        return estimator(
            oee.Problem(times(SIMULATOR, by), Transitions(**rewards), horizon=20),
            UNIFORM,
            seed=0,
        )

    plain = found(1.0)
    scaled = found(scale)
    assert scaled.status == "ok"
    assert scaled.value == pytest.approx(plain.value * scale, rel=1e-9)
    assert scaled.standard_error == pytest.approx(
        plain.standard_error * scale, rel=1e-9
    )


@pytest.mark.parametrize("probability", [1e-320, 1e-200])
def test_weights_beyond_floats_are_refused_at_their_row(probability):
    log = Transitions(
        [0, 0],
        [0, 1],
        [1, 1],
        [0.0, 0.0],
        episode=[0, 1],
        behavior_probability=[0.5, probability],
    )
    problem = oee.Problem(SIMULATOR, log)
    with pytest.raises(
        ValueError,
        match=(
            r"behavior_probability must be large enough .* in row 1 it is"
            rf" {probability:g}"
        ),
    ):
        ImportanceSampling()(problem, UNIFORM)


def test_a_product_of_weights_beyond_floats_is_reported():
    n = 400
    stay = oee.FiniteMDP(np.ones((1, 2, 1)), [1.0], [1.0], 0.9)
    log = Transitions(
        [0] * n,
        [0] * n,
        [0] * n,
        [1.0] * n,
        episode=[0] * n,
        behavior_probability=[0.1] * n,
    )
    found = ImportanceSampling()(oee.Problem(stay, log), [[1.0, 0.0]])
    assert np.isnan(found.value)
    assert "overflows in row 149 of the log, step 149 of its episode" in found.status


def test_a_probability_below_every_ratio_is_no_support():
    faint = oee.FiniteMDP([[[1e-320, 1.0]], [[0.5, 0.5]]], [0.0, 1.0], [1.0, 0.0], 0.9)
    target = oee.FiniteMDP([[[0.5, 0.5]], [[0.5, 0.5]]], [0.0, 1.0], [1.0, 0.0], 0.9)
    text = r"probability 0 or below 1e-300 to 1 of its transitions .* s=0, a=0 -> s'=0"
    with pytest.raises(ValueError, match=text):
        oee.true_ratio(target, faint)
    with pytest.raises(ValueError, match=text):
        oee.Problem(faint, Transitions([0], [0], [0]))
    assert oee.ratio.uncovered_share(target.transitions, faint) == 0.25
    # where the target does not go it may be
    assert oee.Problem(faint, Transitions([0], [0], [1])).simulator is faint
