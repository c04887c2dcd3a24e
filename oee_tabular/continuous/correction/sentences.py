"""What a report says of a correction: differences, flaws, odd rows and history."""

from __future__ import annotations

import numpy as np

from oee_tabular import _printing
from oee_tabular.continuous.correction.hidden_state import (
    MAX_LAG,
    hidden_state,
)
from oee_tabular.continuous.correction.residual import ResidualSimulator

HIDDEN = (
    "the next state depends on more than the recorded state and action (a hidden state,"
    " or noise in what was recorded)"
)
UNITS = "the log's columns seem to be in another unit than the simulator's: "


def describe_flaw(learned: ResidualSimulator) -> str:
    """Describe why a corrected simulator cannot be trusted, or return "ok".

    The columns may be in other units, the first rows of episodes may not fit the
    others, or history may explain the residuals.
    """
    if learned.units:
        return f"{UNITS}{learned.units}"
    if starts := describe_starts(learned):
        return starts
    effect = hidden_state(learned)
    return f"{HIDDEN}: {effect}" if effect else "ok"


def describe_starts(learned: ResidualSimulator) -> str:
    """Describe in what the first rows of episodes do not fit the others, or return "".

    All coordinates are named of which they make most of what is unexplained.
    """
    odd = np.flatnonzero(learned.odd_starts)
    if len(odd) == 0:
        return ""
    names = [f"“{learned.coordinates[k].name}”" for k in odd]
    return (
        "the first rows of its episodes do not fit the others: they alone make"
        f" {learned.odd_starts[odd].min():.0%} of what is unexplained in"
        f" {_printing.listing(names)}"
    )


def difference(corrected: ResidualSimulator) -> str:
    """Describe in which coordinates the target's steps differ from the simulator's."""
    told = []
    for c in corrected.coordinates:
        if not c.differs:
            continue
        noise = f"{c.simulator_scatter:.2g}"
        beside = ""
        if noise != "0":
            beside = f", where the simulator's own noise is {noise}"
        told.append(
            f"“{c.name}” (by {c.residual_scatter:.2g}{beside}; the correction removes"
            f" {max(c.explained, 0.0):.1%})"
        )
    changes = ", ".join(told)
    if not changes:
        return (
            "The log shows no difference between the target's steps and the"
            " simulator's. Its residuals s' - f(s, a) are as large as the simulator's"
            " own scatter."
        )
    text = f"The target's steps differ from the simulator's in {changes}."
    if corrected.units:
        return f"{UNITS.capitalize()}{corrected.units}. {text}"
    text += (
        " Differences and noise are root mean squares over the log's steps; what the"
        " correction removes is a share of the mean square."
    )
    return text + odd_row(corrected)


def odd_row(corrected: ResidualSimulator) -> str:
    """Describe the row that makes most of the unexplained residual of a coordinate.

    It may be an error. Returns "" where no row alone does so.
    """
    for k, c in enumerate(corrected.coordinates):
        squares = corrected.left_over[:, k] ** 2
        row = int(squares.argmax())
        total = float(squares.sum())
        if squares[row] > 0.5 * total and c.left_over**2 > 0.01 * c.residual_scatter**2:
            return (
                f" Row {row} of the log alone makes {squares[row] / total:.0%} of the"
                f" unexplained residual in “{c.name}” (by"
                f" {corrected.left_over[row, k]:.3g}). If it is an error, leave it out,"
                " because every value depends on it."
            )
    return ""


def remedy(learned: ResidualSimulator, steps: int = 0) -> str:
    """Say what may be hidden, and what to do before a value can be trusted.

    ``steps`` is the number of last actions that the state has already.
    """
    hidden = [c.history for c in learned.coordinates if c.hidden]
    first = max(hidden, key=lambda effect: effect.lag_r_squared)
    # what a sensor adds to one state is taken back in the next step
    if first.of == "residual" and first.lag == 1:
        return (
            "The cause may be sensor noise: an error in one recorded state makes two"
            " steps wrong, in opposite directions. Filter the states before they are"
            " logged (a Kalman filter, or a mean over several samples), or take speeds"
            " as differences over several steps. If the sensor is good, it may be a slow"
            " actuator or a quantity that is not recorded: record it."
        )
    return (
        "A slow actuator, a longer delay or a quantity that is not recorded may be the"
        " cause. Record what is missing, or keep more actions (history"
        f" {max(MAX_LAG, steps) + 3})."
    )


def describe_count(steps: int) -> str:
    """Return how many actions there are, in words after "last"."""
    return "action" if steps == 1 else f"{steps} actions"


def describe_history(
    plain: ResidualSimulator, learned: ResidualSimulator, steps: int, is_auto: bool
) -> str:
    """Describe how many last actions are in the state and why; "" where none are."""
    if not steps:
        return ""
    text = f"The value in front has the last {describe_count(steps)} in the state"
    if not is_auto:
        return f"{text}." if describe_flaw(learned) == "ok" else ""
    before, after = (f"{each.held_out_error**0.5:.2g}" for each in (plain, learned))
    text += (
        f", because {hidden_state(plain)}. The held-out one-step error falls from"
        f" {before} to {after} of a step's standard deviation."
    )
    if steps == MAX_LAG:
        text += f" At most {MAX_LAG} are tried; history {MAX_LAG + 3} keeps more."
    return text
