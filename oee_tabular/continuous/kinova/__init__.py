"""The paper's robot, a Kinova Gen3 that moves its hand to five goals (Section VI.D, Table I), as a simulated stand-in.

**It is not the robot, and its target is not reality**: no data of the arm was ever published. ``KinovaArm`` simulates it with
MuJoCo (extra ``mujoco``) from the manufacturer's published geometry and masses, with assumed servos; the same arm with another
``velocity_scale``, latency, payload, friction, gain or encoder noise plays the target. ``hand_log`` and ``load_kinova_log``
take what a real arm would log.

    simulator = kinova_model(KinovaArm(), defensive=0.1)                   a FiniteMDP of the hand's position
    log = record_goals(KinovaArm(velocity_scale=1.4), n_runs=10, seed=0)   50 trajectories of T = 25
    counts, uncovered = within_support(move_counts(simulator, log), simulator)
    zeta = oee_tabular.transition_ratio(counts, simulator.mdp, tie=displacement_tie(simulator))

Without MuJoCo everything imports; what simulates the arm raises an ImportError that names the extra.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

from scipy import sparse

from oee_tabular import _checks
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.kinova.dynamics import (
    COMMANDS,
    GOALS,
    HOME,
    STAND_IN,
    KinovaArm,
    end_effector,
    require_mujoco,
)
from oee_tabular.continuous.kinova.grid import box_policy, displacement_tie, goal_costs, kinova_model, move_counts
from oee_tabular.continuous.kinova.hand import KinovaHand, fit_hand, ideal_hand
from oee_tabular.continuous.kinova.logs import (
    HORIZON,
    KinovaPolicy,
    hand_log,
    kinova_policy,
    load_kinova_log,
    record_goals,
)
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.simulator import ContinuousSimulator
from oee_tabular.continuous.support import within_support

KINOVA_RUNS = 250  # of Monte Carlo: some thousand commands a second
REFERENCE_SCALE = 1.4  # velocity_scale of the reference mismatch

__all__ = [
    "COMMANDS",
    "GOALS",
    "HOME",
    "HORIZON",
    "REFERENCE_SCALE",
    "STAND_IN",
    "KinovaArm",
    "KinovaHand",
    "KinovaPolicy",
    "box_policy",
    "displacement_tie",
    "end_effector",
    "fit_hand",
    "goal_costs",
    "hand_log",
    "ideal_hand",
    "kinova_model",
    "kinova_policy",
    "load_kinova_log",
    "move_counts",
    "record_goals",
    "require_mujoco",
    "within_support",
]


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
        ratio={"strength": 3.0},
        tie=displacement_tie,
        calibration="difference",
        count=_moves_with_support,
        defence="a command moves the hand half or one and a half times as far",
        at_log=False,
        no_grid="kinova: its vertices are a command's step apart",
        episodes=KINOVA_RUNS if form == "arm" else 10_000,
    )


def _kinova_grid(
    task: KinovaArm | KinovaHand, *, at: ContinuousTransitions | None, floor: float, discount: float
) -> Discretization:
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
