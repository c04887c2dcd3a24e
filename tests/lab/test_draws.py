"""The moves that experiments draw: those of the saved tables."""

import numpy as np

import oee_tabular as oee
from oee_tabular.lab.experiments import common


def test_too_few_episodes_are_doubled(monkeypatch):
    """A pilot that promised too much: twice as many episodes are drawn afresh, as when the tables were made."""
    sizes, real = [], common.sample_episodes

    def short(mdp, policy, count, horizon, *, seed):
        sizes.append(count)
        log = real(mdp, policy, count, horizon, seed=seed)
        return log if len(sizes) != 2 else log.first(10)

    monkeypatch.setattr(common, "sample_episodes", short)
    grid = oee.tasks.gridworld(5, 0.3)
    log = common.episodes_for(grid, oee.uniform_policy(grid), 1000, np.random.default_rng(0))
    assert len(log) >= 1000
    assert sizes == [20, sizes[1], 2 * sizes[1]]
