"""Calibration: taking out of an estimate what discretising has put into it.

A task's FiniteMDP values a policy at J_d, the task itself at J_c (by Monte Carlo). The
difference is the discretisation's, and an estimate in the same finite states carries
much the same:

    ratio        J_hat * J_c / J_d        where returns have one sign, and the error is one of scale
    difference   J_hat + J_c - J_d        where they change sign

A calibrated value stands beside the raw one and never replaces it. It helps as far as
the estimate and J_d
see the cells alike: the simulator must be discretised at the log's own places
(``tasks.discretize(task, log)``), or the estimate differs from J_d by where in its cell
a state lies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular.estimators.base import Estimate
from oee_tabular.exceptions import ArgumentError

KINDS = ("ratio", "difference")


@one_thread
def calibrate(
    estimate: Estimate,
    *,
    discretised: float,
    continuous: float,
    continuous_error: float = 0.0,
    kind: str = "ratio",
) -> Estimate:
    """Add a calibrated value to the diagnostics of an estimate; its own value is
    unchanged.

    Parameters
    ----------
    estimate : the raw estimate, of a policy's value in the target
    discretised : J_d, the same policy's exact value in the simulator's FiniteMDP, in
        the estimate's unit
    continuous : J_c, its value in the continuous simulator, by Monte Carlo
    continuous_error : standard error of ``continuous``
    kind : "ratio" | "difference"

    Returns
    -------
    Estimate
        ``diagnostics["calibrated_value"]``; ``["calibrated_standard_error"]`` (the
        estimate's own, carried along, and Monte Carlo's; None where the estimate has
        none); ``["calibration"]``, what was done in words.

    Raises
    ------
    ValueError
        Numbers that are not finite; "ratio" where the two values differ in sign or
        ``discretised`` is 0.

    Examples
    --------
    >>> calibrate(Estimate(0.45), discretised=0.50, continuous=0.51).diagnostics["calibration"]
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
    calibrated = {
        "calibrated_value": value,
        "calibrated_standard_error": (
            None if own is None else float(np.hypot(factor * own, slope * error))
        ),
        "calibration": f"{kind}: {words}",
    }
    return replace(estimate, diagnostics=estimate.diagnostics | calibrated)
