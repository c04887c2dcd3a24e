"""Calibration: the error of a discretised task, taken out of an estimate.

A policy has the value J_d in a task's FiniteMDP, and J_c in the task itself (by Monte
Carlo). The difference is the error of the discretisation, and an estimate in the same
finite states has much the same error:

    ratio        J_hat * J_c / J_d    where returns have one sign (an error of scale)
    difference   J_hat + J_c - J_d    where they change sign

A calibrated value is given beside the raw one and never replaces it. It helps only if
the cells change the estimate and J_d alike: the simulator must be discretised at the
log's own places (``tasks.discretize(task, log)``), or the estimate differs from J_d by
where in its cell a state lies.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.exceptions import ArgumentError

KINDS = ("ratio", "difference")


@suggest_keywords
@one_thread
def calibrate(
    estimate: Estimate,
    *,
    discretised: float,
    continuous: float,
    continuous_error: float = 0.0,
    kind: Literal["ratio", "difference"] = "ratio",
) -> Estimate:
    """Add a calibrated value to the diagnostics of an estimate.

    Parameters
    ----------
    estimate : Estimate
        The raw estimate of a policy's value in the target.
    discretised : float
        J_d, the policy's exact value in the simulator's FiniteMDP, in the estimate's
        unit.
    continuous : float
        J_c, the policy's value in the continuous simulator, by Monte Carlo.
    continuous_error : float, default 0.0
        The standard error of ``continuous``.
    kind : {'ratio', 'difference'}, default 'ratio'
        Whether the value is multiplied by J_c / J_d, or J_c - J_d is added to it.

    Returns
    -------
    Estimate
        The same estimate, its own value unchanged, with three more diagnostics:
        ``calibrated_value``; ``calibrated_standard_error`` (the estimate's own, scaled
        likewise, and Monte Carlo's; None where the estimate has none); and
        ``calibration``, a text that says what was done.

    Raises
    ------
    ValueError
        If a number is not finite, or for "ratio" if the two values differ in sign or
        ``discretised`` is 0.

    Examples
    --------
    >>> calibrate(Estimate(0.45), discretised=0.50, continuous=0.51).diagnostics[
    ...     "calibration"
    ... ]
    'ratio: times 0.51 / 0.5 (simulator: continuous / discretised)'
    """
    _checks.instance(estimate, Estimate, "estimate")
    _checks.one_of(kind, "kind", KINDS)
    below = _checks.number_in(discretised, "discretised", -np.inf, np.inf)
    truth = _checks.number_in(continuous, "continuous", -np.inf, np.inf)
    error = _checks.number_in(continuous_error, "continuous_error", 0.0, np.inf)
    if kind == "ratio" and below * truth <= 0.0:
        raise ArgumentError(
            "kind",
            "must be 'difference' unless discretised and continuous have one sign;"
            f" they are {below:g} and {truth:g}",
        )
    if kind == "ratio":
        value = estimate.value * truth / below
        factor = truth / below
        slope = estimate.value / below
        words = f"times {truth:g} / {below:g} (simulator: continuous / discretised)"
    else:
        value = estimate.value + truth - below
        factor = 1.0
        slope = 1.0
        words = f"plus {truth:g} - {below:g} (simulator: continuous - discretised)"
    own = estimate.standard_error
    calibrated_error = None
    if own is not None:
        calibrated_error = float(np.hypot(factor * own, slope * error))
    calibrated = {
        "calibrated_value": value,
        "calibrated_standard_error": calibrated_error,
        "calibration": f"{kind}: {words}",
    }
    return replace(estimate, diagnostics=estimate.diagnostics | calibrated)
