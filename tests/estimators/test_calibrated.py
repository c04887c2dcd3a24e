import numpy as np
import pytest
from numpy.testing import assert_allclose

from oee_tabular.estimators import Estimate
from oee_tabular.estimators.calibrated import calibrate


def test_ratio_and_difference_by_hand():
    raw = Estimate(0.45, 0.02, diagnostics={"gap": 0.0})
    found = calibrate(raw, discretised=0.5, continuous=0.55, continuous_error=0.01)
    assert found.value == 0.45
    assert found.standard_error == 0.02
    assert found.diagnostics["gap"] == 0.0
    assert_allclose(found.diagnostics["calibrated_value"], 0.495)
    assert_allclose(found.diagnostics["calibrated_standard_error"], np.hypot(0.02 * 1.1, 0.45 / 0.5 * 0.01))
    moved = calibrate(raw, discretised=-0.1, continuous=0.2, continuous_error=0.01, kind="difference")
    assert_allclose(moved.diagnostics["calibrated_value"], 0.75)
    assert_allclose(moved.diagnostics["calibrated_standard_error"], np.hypot(0.02, 0.01))
    assert moved.diagnostics["calibration"] == "difference: plus 0.2 - -0.1 (simulator: continuous - discretised)"
    assert "calibrated_value" not in raw.diagnostics


@pytest.mark.parametrize("kind", ["ratio", "difference"])
def test_an_estimate_of_the_simulator_itself_becomes_its_continuous_value(kind):
    found = calibrate(Estimate(3.0), discretised=3.0, continuous=2.5, kind=kind)
    assert found.diagnostics["calibrated_value"] == 2.5
    assert found.diagnostics["calibrated_standard_error"] is None
