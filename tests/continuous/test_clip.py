"""A correction adds no more than the log has shown, also where what is fitted to it overshoots."""

import numpy as np

from oee_tabular.tasks import ContinuousTask, Moves, ResidualSimulator, record


class Line(ContinuousTask):
    """s' = s + push + jump, the jump of the sign of s; paid by where it leads."""

    name, state_names, feature_names = "line", ("s",), ("s",)
    actions, n_disturbances, periodic, terminates = np.array([-0.25, 0.25]), 1, (False,), False
    feature_low, feature_high = np.array([-2.0]), np.array([2.0])

    def __init__(self, jump):
        self.jump = jump

    def moves(self, states, actions, disturbance):
        following = states + self.actions[actions][:, None] + np.where(states > 0, self.jump, -self.jump)
        return Moves(following, following[:, 0], np.zeros(len(states), dtype=bool))

    def initial_states(self, n, rng):
        return rng.uniform(-1.0, 1.0, (n, 1))


def test_a_correction_stays_within_the_residuals_that_were_logged():
    """They are -.3 and .3; the fit alone reaches .97; what it leaves, which is drawn, adds to what is cut off."""
    log = record(Line(0.3), lambda s: np.full((len(s), 2), 0.5), n_transitions=100, max_steps=4, seed=2)
    corrected = ResidualSimulator(Line(0.0), log, seed=0)
    states, actions = np.linspace(-3.0, 3.0, 2001)[:, None], np.zeros(2001, dtype=int)
    plain = Line(0.0).moves(states, actions, None).next_state
    added = corrected.moves(states, actions, np.zeros((2001, corrected.n_disturbances))).next_state - plain
    assert 0.3 < np.abs(added).max() < 0.45
