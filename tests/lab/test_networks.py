"""Figure 1a with our own networks, a small part of it computed: they reach the published curve; the parts make the error."""

import numpy as np
import pytest

from oee_tabular.lab.experiments import paper
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS


def test_networks_computed():
    """One log of another seed than the saved ones."""
    for module in EXPERIMENTS["networks"].requires:
        pytest.importorskip(module)
    table = EXPERIMENTS["networks"].table(seed=1, n=(1000,), repetitions=1)
    trained = table[table.fit.str.startswith("network, trained")]
    published = paper.at("fig1a", "grid=10", "mean_absolute_error_of_zeta", 1000.0)
    assert (trained.error < 1.5 * published).all()
    parts = table.dropna(subset="sampling")
    whole = parts[["approximation", "sampling", "optimisation"]].sum(axis=1)
    assert (parts.approximation < 1e-18).all()
    assert (parts[["sampling", "optimisation"]] > 0).all(axis=None)
    assert (parts.excess < whole).all()
    assert np.isfinite(table.error).all()
