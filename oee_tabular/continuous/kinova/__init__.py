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

from dataclasses import replace
from typing import Any

from oee_tabular import _checks
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.kinova.dynamics import (
    COMMANDS,
    GOALS,
    STAND_IN,
    KinovaArm,
    require_mujoco,
)
from oee_tabular.continuous.kinova.expert import KinovaPolicy, kinova_policy
from oee_tabular.continuous.kinova.hand import (
    KinovaHand,
    box_policy,
    displacement_tie,
    fit_hand,
    goal_costs,
    ideal_hand,
    kinova_model,
    move_counts,
    within_support,
)
from oee_tabular.continuous.kinova.kinematics import HOME, end_effector
from oee_tabular.continuous.kinova.logs import hand_log, load_kinova_log
from oee_tabular.continuous.log import ContinuousTransitions

HORIZON = 25  # commands of a run
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


def record_goals(
    arm: KinovaArm | KinovaHand, *, n_runs: int = 10, delta: float = 0.0, horizon: int = HORIZON, seed: Any = None
) -> ContinuousTransitions:
    """``n_runs`` runs to each of the five goals under ``kinova_policy(goal, delta)``, by default the paper's 50 trajectories.

    Parameters
    ----------
    arm : KinovaArm, which needs MuJoCo, or KinovaHand; its own goal is not used
    n_runs : to each goal
    delta : share of random commands, in [0, 1]
    horizon : commands of a run
    seed : the same seed gives the same bits

    Returns
    -------
    ContinuousTransitions
        States are whole states of ``arm``; goal g has the episodes g n_runs to (g + 1) n_runs - 1; rewards are those of the
        episode's goal. It is a simulated stand-in's log, not a robot's.

    Examples
    --------
    >>> log = record_goals(ideal_hand(1.4), n_runs=1, seed=0)  # no arm, only commands that move it too far
    >>> len(log), log.n_state, int(log.truncated.sum())
    (125, 3, 5)
    """
    runs = _checks.positive_integer(n_runs, "n_runs")
    steps = _checks.positive_integer(horizon, "horizon")
    rng = _checks.generator(seed)
    logs = [
        record(replace(arm, goal=g), kinova_policy(g, delta), n_episodes=runs, max_steps=steps, seed=rng)
        for g in range(len(GOALS))
    ]
    return ContinuousTransitions.concatenate(logs)
