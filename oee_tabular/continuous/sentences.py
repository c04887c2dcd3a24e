"""What the report of a continuous task says in words."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import MonteCarlo
from oee_tabular.continuous.history import MAX_LAG
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import ContinuousTask
from oee_tabular.exact import policy_value

if TYPE_CHECKING:
    from oee_tabular.continuous.correction import Correction
    from oee_tabular.continuous.parameters import ParameterFit

NUMBERS = ("", "one step", "two steps", "three steps", "four steps", "five steps")
UNITS = "the log's columns seem to be in another unit than the simulator's: "


def hidden_state(learned: ResidualSimulator) -> str:
    """Which earlier action or residual matters, and by how much; "" where the state is Markov."""
    hidden = sorted((c for c in learned.coordinates if c.hidden), key=lambda c: -c.history.lag_r_squared)
    if not hidden:
        return ""
    effect = hidden[0].history
    same = [c.name for c in hidden if (c.history.lag, c.history.of) == (effect.lag, effect.of)]
    text = f"the {effect.of} of {NUMBERS[effect.lag]} ago explains {effect.lag_r_squared:.0%} of the residual in "
    text += " and ".join([", ".join(same[:-1]), same[-1]] if len(same) > 1 else same)
    more = f" (the last {NUMBERS[MAX_LAG].split()[0]} actions and residuals together: {effect.r_squared:.0%})"
    return text + more * (effect.r_squared > effect.lag_r_squared + 0.05)


def flaw(learned: ResidualSimulator) -> str:
    """What is wrong where columns are in other units, or history explains the residuals; "ok" where all is well."""
    if learned.units:
        return f"{UNITS}{learned.units}"
    told = hidden_state(learned)
    return f"the state is not all that the next one depends on (hidden state): {told}" if told else "ok"


def advice(chosen: Correction) -> str:
    """What to do where history explains residuals and no correction can be trusted."""
    if chosen.history != "auto":
        return "Leave the number of last actions in the state open (history auto), which tries up to five."
    share = chosen.learned.hidden_part / chosen.plain.hidden_part
    tried = f"With the last {chosen.steps} actions in the state, {share:.0%} of that effect is left."
    if chosen.steps == 0:
        tried = f"Keeping the last actions in the state, up to {MAX_LAG}, does not help."
    return (
        f"{tried} Sensor noise, a slow actuator, or a quantity that is not recorded may be the cause. Filter the states, "
        "or record what is missing. Until then read the simulator's value, which has no interval."
    )


def parameters(
    fit: ParameterFit, plain: ResidualSimulator, fitted: ResidualSimulator, given: ResidualSimulator, is_taken: bool
) -> str:
    """What was fitted, whether the value in front has it, and where a fit without history (``plain``) is no physics."""
    caution = " The fit took the state alone, and history matters: do not read its numbers as physics."
    both, alone = (f"{learned.held_out_error**0.5:.2g}" for learned in (fitted, given))
    return (
        f"{fit.describe()} The value in front corrects the residuals of the {'fitted' if is_taken else 'given'} simulator, "
        f"because its held-out one-step error is {'no larger' if is_taken else 'smaller'} ({both} of a step's standard "
        f"deviation with fitted parameters, {alone} without).{caution if hidden_state(plain) else ''}"
    )


def history(plain: ResidualSimulator, learned: ResidualSimulator, steps: int, is_chosen: bool) -> str:
    """How many last actions are in the state, and why; "" where none are."""
    if not steps:
        return ""
    text = f"The value in front has the last {'action' if steps == 1 else f'{steps} actions'} in the state"
    if not is_chosen:
        return f"{text}." if flaw(learned) == "ok" else ""
    before, after = (f"{each.held_out_error**0.5:.2g}" for each in (plain, learned))
    return (
        f"{text}, because {hidden_state(plain)}. The held-out one-step error falls from {before} to {after} of a step's "
        "standard deviation."
        + (f" {MAX_LAG} is the most that is tried; history {MAX_LAG + 3} keeps more." if steps == MAX_LAG else "")
    )


def difference(corrected: ResidualSimulator) -> str:
    """Does the target differ, and in which coordinate: the log's residuals against the simulator."""
    changed = [c for c in corrected.coordinates if c.differs]
    if not changed:
        return (
            "The target's steps do not differ from the simulator's, as far as the log tells: its residuals s' - f(s, a) are "
            "those of the simulator's own scatter."
        )
    told = "; ".join(
        f"{c.name} (residuals {c.residual_scatter:.2g}, the simulator's own scatter {c.simulator_scatter:.2g}; the correction "
        f"explains {max(c.explained, 0.0):.1%} of their mean square)"
        for c in changed
    )
    said = f"The target's steps differ from the simulator's in {told}."
    if corrected.units:
        return f"{UNITS.capitalize()}{corrected.units}. {said}"
    return said + odd_row(corrected)


def odd_row(corrected: ResidualSimulator) -> str:
    """The row that alone makes most of what is left over in a coordinate, an error of the log perhaps; "" where none does."""
    for k, c in enumerate(corrected.coordinates):
        squares = corrected.left_over[:, k] ** 2
        row, total = int(squares.argmax()), float(squares.sum())
        if squares[row] > 0.5 * total and c.left_over**2 > 0.01 * c.residual_scatter**2:
            return (
                f" Row {row} of the log alone makes {squares[row] / total:.0%} of what is left over in {c.name}, by "
                f"{corrected.left_over[row, k]:.3g}: leave it out if it is an error, every value rests on it otherwise."
            )
    return ""


def name_loss(
    model: Discretization, mc: Callable[[Array], MonteCarlo], tables: Mapping[str, Array], horizon: int
) -> str:
    """What the cells make of the simulator's own values, which no interval covers."""
    found = []
    for name, table in tables.items():
        there = mc(table)
        found.append(
            f"{policy_value(model.plain, table, horizon=horizon) - there.value:+.3g} of {there.value:.3g} ({name})"
        )
    return (
        "standard errors and intervals are of the log alone; what the cells lose is not in them. Of the simulator's own value "
        f"they make {', '.join(found)}, and another environment's may suffer more"
    )


def add_features(text: str, model: Discretization) -> str:
    """A warning with the features of the states that it numbers."""
    n, names = model.cells.n_cells, model.task.feature_names

    def place(match: re.Match[str]) -> str:
        number = int(match[1])
        points = model.points[model.places.point_cell == number] if number < n else model.points[:0]
        if len(points) == 0:
            return match[0]
        at = model.task.features(points).mean(axis=0)
        return f"{match[0]} ({', '.join(f'{name}={value:.3g}' for name, value in zip(names, at, strict=True))})"

    return re.sub(r"\bstate (\d+)", place, text)


def rewards_contradict(task: ContinuousTask, log: ContinuousTransitions) -> str:
    """Where the log does not pay what the task's r(s, a, s') says; "" where it does, or where neither is known."""
    if log.reward is None:
        return ""
    known = task.reward_between(log.state, log.action, log.next_state)
    if known is None:
        return ""
    away = np.abs(log.reward - known)
    bad = np.flatnonzero(away > 1e-6 * max(1.0, float(np.abs(known).max())))
    if bad.size == 0:
        return ""
    k = int(away.argmax())
    return (
        f"The log's rewards contradict the simulator's r(s, a, s') in {bad.size} of {len(log)} moves; row {k} pays "
        f"{log.reward[k]:g} in the log, {known[k]:g} in the simulator, whose rewards are used"
    )
