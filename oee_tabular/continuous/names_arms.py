"""Reacher and the arm (a simulated stand-in) by name, each with the configuration that logs are evaluated by."""

from __future__ import annotations

import functools
import warnings
from dataclasses import replace
from typing import Any

from scipy import sparse

from oee_tabular import _checks
from oee_tabular.continuous.discretization import Discretization, task_metadata
from oee_tabular.continuous.kinova.dynamics import KinovaArm
from oee_tabular.continuous.kinova.expert import kinova_policy
from oee_tabular.continuous.kinova.hand import (
    KinovaHand,
    displacement_tie,
    fit_hand,
    kinova_model,
    move_counts,
    within_support,
)
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.reacher.cells import ArmCells, arm_cells, reacher_log
from oee_tabular.continuous.reacher.dynamics import Reacher
from oee_tabular.continuous.reacher.expert import reacher_policy
from oee_tabular.continuous.simulator import ContinuousSimulator, on_grid

FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)  # of Reacher's links in the averaged simulator
N_SIMULATED = 20_000  # moves of a log of the simulator's own, where there is no other
KINOVA_RUNS = 250  # Monte Carlo: some thousand commands a second


def reacher(*, tamed: bool = False, **parameters: Any) -> ContinuousSimulator:
    """Reacher with links of a length, on the cells of the log, against links of half to twice that length.

    Parameters of ``tasks.Reacher``; ``reward_length`` is the length by which the target's reward finds the fingertip. 3000
    cells at the log's own states; the simulator is the average over lengths times .5, .7, 1, 1.4 and 2 (floor 1, *not* the
    plain one, which is shown beside it; a smaller floor mixes the two); zeta with prior "simulator" and strength 0.1, not
    calibrated: on figure 3's two targets calibration did harm.
    """
    _checks.boolean(tamed, "tamed")
    task = Reacher.tamed(**parameters) if tamed else Reacher(**parameters)
    return ContinuousSimulator(
        "reacher",
        task,
        reacher_policy(0.0),
        _reacher_cells,
        horizon=25 if tamed else 100,
        floor=1.0,
        ratio={"prior": "simulator", "strength": 0.1},
        calibration="none",
        defence=f"a step is that of links as long times one of {', '.join(map(str, FACTORS))}",
        episodes=10_000,
        cells_of_log=True,
    )


def _reacher_cells(
    task: Any, *, grid: tuple[int, ...] | None, at: ContinuousTransitions | None, floor: float, discount: float
) -> Discretization:
    """The arm on cells of the log (without one: of the arm's own), or on a grid where one is asked for."""
    if grid is not None:
        return on_grid(grid)(task, grid=None, at=at, floor=floor, discount=discount)
    share = _checks.number_in(floor, "floor", 0.0, 1.0)
    arm = replace(_arm(task, at), discount=discount)
    plain = arm.transitions[task.length]
    mdp = arm.mdp(sparse.csr_array((1.0 - share) * plain + share * arm.mixture()) if share else plain)
    facts = task_metadata(task) | {"builder": "arm_cells", "n_cells": arm.cells.n_cells, "floor": share}
    return Discretization(mdp, task, arm.cells, arm.points, arm.point_cell, facts | {"factors": list(FACTORS)}, {})


@functools.lru_cache(maxsize=1)  # with and without the floor
def _arm(task: Reacher, log: ContinuousTransitions | None) -> ArmCells:
    horizon = 25 if task.substeps > 1 else 100
    if log is None:
        log = reacher_log(task, N_SIMULATED, max_steps=horizon, seed=0)
    return arm_cells(log, task=task, lengths=[factor * task.length for factor in FACTORS], horizon=horizon, seed=0)


def kinova(*, form: str = "arm", **parameters: Any) -> ContinuousSimulator:
    """A simulated stand-in for the Gen3 that moves its hand to a goal, on the grid of table1: it is not the robot.

    Parameters of ``tasks.kinova.KinovaArm``, whose logs have its 27 coordinates; ``form=hand``: logs of the hand's position
    (x, y, z) alone, as a real arm's would be (``tasks.kinova.hand_log`` makes them), against a model of the hand fitted to the
    simulated arm. Defensive (a tenth of the moves half or one and a half times as far), zeta tied over displacements,
    calibrated by the difference. MuJoCo is needed.
    """
    _checks.one_of(form, "form", ("arm", "hand"))
    arm = KinovaArm(**parameters)
    return ContinuousSimulator(
        "kinova",
        fit_hand(arm) if form == "hand" else arm,
        kinova_policy(arm.goal),
        _kinova_grid,
        horizon=25,
        floor=0.1,
        ratio={"tie": displacement_tie, "strength": 3.0},
        calibration="difference",
        count=_moves_with_support,
        defence="a command moves the hand half or one and a half times as far",
        at_log=False,
        episodes=KINOVA_RUNS if form == "arm" else 10_000,
    )


def _kinova_grid(
    task: KinovaArm | KinovaHand,
    *,
    grid: tuple[int, ...] | None,
    at: ContinuousTransitions | None,
    floor: float,
    discount: float,
) -> Discretization:
    if grid is not None:
        raise ValueError("grid must be left out for kinova: its vertices are a command's step apart")
    model = kinova_model(task, defensive=floor)
    return replace(model, mdp=model.mdp.with_discount(discount), task=task)  # logs have the task's own coordinates


def _moves_with_support(model: Discretization, log: ContinuousTransitions, outside: str) -> sparse.csr_array:
    """The log's displacements; those that the defensive simulator does not know are left out, with a warning."""
    counts = move_counts(model, log, outside=outside)
    kept, uncovered = within_support(counts, model)
    if uncovered > 0.0:
        warnings.warn(
            f"log must stay where the simulator has probability; {uncovered:.2g} of its moves have none and are left out",
            stacklevel=3,
        )
    return kept
