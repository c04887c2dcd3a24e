"""What the report of a continuous task says in words."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import MonteCarlo
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import ContinuousTask
from oee_tabular.exact import policy_value


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
        return f"The log's columns seem to be in another unit than the simulator's: {corrected.units}. {said}"
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


def lost(model: Discretization, mc: Callable[[Array], MonteCarlo], tables: Mapping[str, Array], horizon: int) -> str:
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


def placed(text: str, model: Discretization) -> str:
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
