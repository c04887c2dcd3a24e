"""The default on families of the bench: a small twin of the saved run in notebooks/results/bench."""

import numpy as np
import pytest

from oee_tabular.estimators import ModelBased, OffEnvironment, Simulator
from oee_tabular.lab.bench import families

SEEDS = range(8)


def errors(name, size, seeds=SEEDS):
    """Errors of the default, of maximum likelihood (the simulator in unseen rows) and of the bare simulator."""
    found = []
    for seed in seeds:
        family = families(seed, large=True)[name]
        problem = family.problem(round(size * family.open_rows), seed)
        estimators = (OffEnvironment(), ModelBased(fallback="simulator"), Simulator())
        found.append([estimator(problem, family.policy).value - family.truth for estimator in estimators])
    return np.array(found)


def rmse(errors):
    return np.sqrt(np.mean(errors**2, axis=0))


@pytest.mark.parametrize(
    ("name", "size", "most"),
    [
        ("inventory20", 10, 1.5),  # a prior that is centred on the simulator or on its tilt by log P: 4.9
        ("inventory_slack", 10, 1.1),
        ("garnet_worse", 30, 1.5),  # 8.7
        ("garnet_worse80", 10, 1.2),  # 5.5
        ("fishery", 10, 1.6),  # 7.0
        ("floor_motor", 10, 0.4),
        ("corridor30", 10, 1.5),
        ("paper_grid", 3, 0.25),
        ("tandem9", 10, 0.8),
    ],
)
def test_it_is_not_far_from_the_better_of_maximum_likelihood_and_simulator(name, size, most):
    ours, likely, bare = rmse(errors(name, size))
    assert ours <= most * min(likely, bare)


@pytest.mark.parametrize("name", ["queue_identical", "garnet_identical", "floor_identical", "inventory_identical"])
def test_where_nothing_is_wrong_it_errs_by_little(name):
    """At most half of maximum likelihood's error over 40 logs; eight logs leave that a third uncertain."""
    ours, likely, _ = rmse(errors(name, 10))
    assert ours <= 0.85 * likely


def test_the_tandem_queue():
    """45 x 45 states, 40 000 moves: the simulator is 48 off, a tilt by log P 30."""
    family = families(0, large=True)["tandem45"]
    found = [OffEnvironment()(family.problem(40_000, seed), family.policy) for seed in (0, 1)]
    assert family.truth == pytest.approx(-110.294, abs=1e-3)
    assert all(abs(estimate.value - family.truth) < 10 for estimate in found)
    assert all(low <= family.truth <= high for low, high in (estimate.interval for estimate in found))
