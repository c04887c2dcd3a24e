"""Three states that go on and one where it is over: a problem small enough to be
recomputed by hand.
"""

import numpy as np

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem

POLICY = np.array([[0.3, 0.7], [0.6, 0.4], [0.8, 0.2], [0.5, 0.5]])

BEHAVIOR = np.array([[0.5, 0.5], [0.5, 0.5], [0.4, 0.6], [0.5, 0.5]])


def environments(form=3, discount=0.9):
    """Three states that go on, one where it is over; rewards of ``form`` 2 = r(s, a) or
    3 = r(s, a, s').
    """
    rng = np.random.default_rng(form)
    rows = np.zeros((4, 2, 4))
    rows[:3] = rng.dirichlet(np.full(4, 3.0), (3, 2))
    rows[3, :, 3] = 1.0
    other = rows.copy()
    other[:3] = 0.6 * rows[:3] + 0.4 * rng.dirichlet(np.ones(4), (3, 2))
    rewards = np.zeros((4, 2, 4)[:form])
    rewards[:3] = rng.normal(size=rewards[:3].shape)
    simulator = FiniteMDP(rows, rewards, [0.5, 0.3, 0.2, 0.0], discount)
    return simulator, simulator.with_transitions(other)


def recorded_problem(form=3, horizon=None, n=30, length=6, **options):
    simulator, target = environments(form)
    log = oee.sample_episodes(target, BEHAVIOR, n, length, seed=1)
    return Problem(simulator, log, horizon=horizon, **options), target


def plain_episodes(log):
    """[(s, a, s', r), ...] of each episode, and whether it is over at its end."""
    starts = log.episode_starts
    return [
        (
            list(
                zip(
                    log.state[i:j],
                    log.action[i:j],
                    log.next_state[i:j],
                    log.reward[i:j],
                    strict=True,
                )
            ),
            bool(log.terminated[j - 1] or log.next_state[j - 1] == 3),
        )
        for i, j in zip(starts[:-1], starts[1:], strict=True)
    ]


def reweighted_zeta(simulator, target, factor):
    """A TransitionRatio whose rows sum to ``factor``."""
    true = oee.true_ratio(target, simulator)
    return oee.TransitionRatio(
        true.values * factor, "given", 0.0, true.visited, abs(factor - 1.0), true.counts
    )


SIMULATOR, TARGET = environments()

FULL = np.full((4, 2), 1 / 8)
