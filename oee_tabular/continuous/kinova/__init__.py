"""The paper's robot, a Kinova Gen3 that moves its hand to five goals (Section VI.D, Table I), as a simulated stand-in.

**It is not the robot, and its target is not reality**: no data of the arm was ever published. ``KinovaArm`` simulates it with
MuJoCo (extra ``mujoco``) from the manufacturer's published geometry and masses, with assumed servos; the same arm with another
``velocity_scale``, latency, payload, friction, gain or encoder noise plays the target. Payload, gain and friction change the
value by less than 1 %, since the servos are stiff and gravity is compensated; what a task of Cartesian commands notices is how
far a command moves the hand. ``hand_log`` and ``load_kinova_log`` take what a real arm would log.

    simulator = discretize(KinovaArm(), floor=0.1)                         a FiniteMDP of the hand's position
    log = record_goals(KinovaArm(velocity_scale=1.4), n_runs=10, seed=0)   50 trajectories of T = 25
    counts, uncovered = simulator.supported(simulator.counts(log))
    zeta = oee_tabular.transition_ratio(counts, simulator.mdp, tie=simulator.displacement_ties(), strength=3.0)

Without MuJoCo everything imports; what simulates the arm raises an ImportError that names the extra.
"""

from oee_tabular.continuous.kinova.arm import STAND_IN, KinovaArm, require_mujoco
from oee_tabular.continuous.kinova.dynamics import COMMANDS, GOALS, HOME, end_effector
from oee_tabular.continuous.kinova.hand import (
    HORIZON,
    KinovaHand,
    KinovaPolicy,
    fit_hand,
    hand_log,
    ideal_hand,
    kinova_policy,
    load_kinova_log,
    record_goals,
)

__all__ = [
    "COMMANDS", "GOALS", "HOME", "HORIZON", "STAND_IN", "KinovaArm", "KinovaHand", "KinovaPolicy", "end_effector", "fit_hand",
    "hand_log", "ideal_hand", "kinova_policy", "load_kinova_log", "record_goals", "require_mujoco",
]  # fmt: skip
