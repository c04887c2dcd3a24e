"""Reacher with longer or shorter links (the paper's Section VI.C), by the configuration that logs are evaluated by."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

from scipy import sparse

from oee_tabular import _checks
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.reacher.cells import ArmCells, arm_cells, reacher_log
from oee_tabular.continuous.reacher.dynamics import Reacher
from oee_tabular.continuous.reacher.expert import reacher_policy
from oee_tabular.continuous.simulator import ContinuousSimulator

FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)  # of the links in the averaged simulator
N_SIMULATED = 20_000  # moves of a log of the simulator's own, where there is no other


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
        _cells_of_log,
        horizon=25 if tamed else 100,
        floor=1.0,
        ratio={"prior": "simulator", "strength": 0.1},
        calibration="none",
        defence=f"a step is that of links as long times one of {', '.join(map(str, FACTORS))}",
        episodes=10_000,
        cells_of_log=True,
    )


def _cells_of_log(task: Reacher, *, at: ContinuousTransitions | None, floor: float, discount: float) -> Discretization:
    """The arm on cells of the log; without one, of the arm's own."""
    share = _checks.number_in(floor, "floor", 0.0, 1.0)
    arm = replace(_arm(task, at), discount=discount)
    plain = arm.transitions[task.length]
    mixed = sparse.csr_array((1.0 - share) * plain + share * arm.mixture()) if share else plain
    return arm.build(mixed, floor=share, factors=list(FACTORS))


@functools.lru_cache(maxsize=1)  # with and without the floor
def _arm(task: Reacher, log: ContinuousTransitions | None) -> ArmCells:
    horizon = 25 if task.substeps > 1 else 100
    if log is None:
        log = reacher_log(task, N_SIMULATED, max_steps=horizon, seed=0)
    return arm_cells(log, task=task, lengths=[factor * task.length for factor in FACTORS], horizon=horizon, seed=0)
