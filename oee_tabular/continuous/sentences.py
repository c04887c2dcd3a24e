"""The sentences of a continuous task's report."""

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


def describe_flaw(learned: ResidualSimulator) -> str:
    """What is wrong where columns are in other units, or history explains the residuals; "ok" where all is well."""
    if learned.units:
        return f"{UNITS}{learned.units}"
    effect = hidden_state(learned)
    return f"the next state depends on more than the state and the action (hidden state): {effect}" if effect else "ok"


def advice(chosen: Correction, is_auto: bool) -> str:
    """What to do where history explains residuals and no correction can be trusted; "" elsewhere."""
    if chosen.is_trusted or chosen.learned.units:
        return ""
    if not is_auto:
        return "Use history auto, which tries up to five last actions in the state."
    share = chosen.learned.hidden_part / chosen.plain.hidden_part
    text = f"With the last {chosen.steps} actions in the state, {share:.0%} of that effect is left."
    if chosen.steps == 0:
        text = f"Keeping the last actions in the state, up to {MAX_LAG}, does not help."
    return (
        f"{text} Sensor noise, a slow actuator, or a quantity that is not recorded may be the cause. Filter the states, "
        "or record what is missing. Until then read the simulator's value, which has no interval."
    )


def parameters(
    fit: ParameterFit, plain: ResidualSimulator, fitted: ResidualSimulator, unfitted: ResidualSimulator, is_taken: bool
) -> str:
    """What was fitted, whether the value in front has it, and where a fit without history (``plain``) is no physics."""
    caution = " The fit ignores history, which matters here. Do not read its numbers as physics."
    both, alone = (f"{learned.held_out_error**0.5:.2g}" for learned in (fitted, unfitted))
    return (
        f"{fit.describe()} The value in front corrects the residuals of the {'fitted' if is_taken else 'given'} simulator, "
        f"because its held-out one-step error is {'no larger' if is_taken else 'smaller'} ({both} of a step's standard "
        f"deviation with fitted parameters, {alone} without).{caution if hidden_state(plain) else ''}"
    )


def history(plain: ResidualSimulator, learned: ResidualSimulator, steps: int, is_auto: bool) -> str:
    """How many last actions are in the state, and why; "" where none are."""
    if not steps:
        return ""
    text = f"The value in front has the last {'action' if steps == 1 else f'{steps} actions'} in the state"
    if not is_auto:
        return f"{text}." if describe_flaw(learned) == "ok" else ""
    before, after = (f"{each.held_out_error**0.5:.2g}" for each in (plain, learned))
    text += f", because {hidden_state(plain)}. The held-out one-step error falls from {before} to {after} of a step's "
    text += "standard deviation."
    return text + f" At most {MAX_LAG} are tried; history {MAX_LAG + 3} keeps more." * (steps == MAX_LAG)


def difference(corrected: ResidualSimulator) -> str:
    """In which coordinates the log's residuals show that the target differs from the simulator."""
    changes = ", ".join(
        f"{c.name} (residuals {c.residual_scatter:.2g}, simulator's scatter {c.simulator_scatter:.2g}, "
        f"{max(c.explained, 0.0):.1%} explained)"
        for c in corrected.coordinates
        if c.differs
    )
    if not changes:
        return (
            "The log shows no difference between the target's steps and the simulator's. Its residuals s' - f(s, a) are as "
            "large as the simulator's own scatter."
        )
    text = f"The target's steps differ from the simulator's in {changes}."
    if corrected.units:
        return f"{UNITS.capitalize()}{corrected.units}. {text}"
    return (
        f"{text} Explained is the share of the residuals' mean square that the correction removes.{odd_row(corrected)}"
    )


def odd_row(corrected: ResidualSimulator) -> str:
    """The row that alone makes most of the unexplained residual of a coordinate, perhaps by an error; "" where none does."""
    for k, c in enumerate(corrected.coordinates):
        squares = corrected.left_over[:, k] ** 2
        row, total = int(squares.argmax()), float(squares.sum())
        if squares[row] > 0.5 * total and c.left_over**2 > 0.01 * c.residual_scatter**2:
            return (
                f" Row {row} of the log alone makes {squares[row] / total:.0%} of the unexplained residual in {c.name} (by "
                f"{corrected.left_over[row, k]:.3g}). If it is an error, leave it out, because every value depends on it."
            )
    return ""


def name_loss(
    model: Discretization, simulate: Callable[[Array], MonteCarlo], tables: Mapping[str, Array], horizon: int
) -> str:
    """By how much the cells change the simulator's own values, which no interval counts."""
    values = {name: simulate(table).value for name, table in tables.items()}
    changes = ", ".join(
        f"{policy_value(model.plain, tables[name], horizon=horizon) - value:+.3g} of {value:.3g} ({name})"
        for name, value in values.items()
    )
    return (
        "standard errors and intervals count the log's noise and not the error of the cells. The cells change the simulator's "
        f"own value by {changes}, and may change another environment's by more"
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


def rounding(policy: str, n_commands: int, distance: float, beyond: float) -> str:
    """How far the task's commands are from those of a policy; "" where they are the same."""
    if distance == beyond == 0.0:
        return ""
    cut = f" {beyond:.0%} of them lie beyond the range of these and are cut to it." * (beyond > 0.0)
    return (
        f"The commands of “{policy}” are rounded to the task's {n_commands} commands, by {distance:.2g} (root mean square in "
        f"the log's states).{cut}"
    )


def rewards_contradict(task: ContinuousTask, log: ContinuousTransitions) -> str:
    """Where the log's rewards are not the task's r(s, a, s'); "" where they are, or where either is unknown."""
    known = None if log.reward is None else task.reward_between(log.state, log.action, log.next_state)
    if log.reward is None or known is None:
        return ""
    distance = np.abs(log.reward - known)
    bad = np.flatnonzero(distance > 1e-6 * max(1.0, float(np.abs(known).max())))
    if bad.size == 0:
        return ""
    k = int(distance.argmax())
    return (
        f"The log's rewards contradict the simulator's r(s, a, s') in {bad.size} of {len(log)} transitions. The reward of row "
        f"{k} is {log.reward[k]:g} in the log and {known[k]:g} in the simulator. The simulator's rewards are used"
    )
