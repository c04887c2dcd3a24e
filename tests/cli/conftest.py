"""What tests of the command share."""

import pytest

import oee_tabular as oee


@pytest.fixture
def folder(run, tmp_path):
    """A folder with a 3 x 3 simulator with names, and a log of its target."""
    grid = oee.tasks.gridworld(3, slip=0.3).with_names(
        [f"r{s // 3}c{s % 3}" for s in range(9)], ["n", "e", "s", "w"]
    )
    grid.save("sim.npz")
    target = oee.tasks.gridworld(3, slip=0.1)
    oee.sample_episodes(target, oee.uniform_policy(target), 40, 30, seed=0).save(
        "log.csv"
    )
    return tmp_path
