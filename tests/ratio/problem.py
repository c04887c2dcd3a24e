"""A small pair of environments with counts, for the tests of ratios."""

import numpy as np
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP

POLICY = np.array([[0.3, 0.7], [0.6, 0.4], [0.8, 0.2]])


def environments():
    rng = np.random.default_rng(0)
    rows = rng.dirichlet(np.full(3, 3.0), (3, 2))
    simulator = FiniteMDP(rows, rng.normal(size=(3, 2)), [0.5, 0.3, 0.2], 0.8)
    return simulator, simulator.with_transitions(
        0.6 * rows + 0.4 * rng.dirichlet(np.ones(3), (3, 2))
    )


SIMULATOR, TARGET = environments()

PLACES = np.array([0.0, 1.0, 3.0])

LOG = oee.sample_episodes(TARGET, POLICY, 20, 8, seed=0)

COUNTS = np.array(
    [[4, 3, 1], [0, 2, 5], [6, 1, 1], [3, 3, 3], [0, 0, 0], [2, 0, 9]], dtype=float
)

FEATURES = np.stack([np.arange(18.0) % 5, (np.arange(18.0) * 7) % 4], axis=1)


def fit(counts=COUNTS, **options):
    return oee.transition_ratio(sparse.csr_array(counts), SIMULATOR, **options)
