"""The prior as an object: what names are short for, and priors of one's own."""

import pickle
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import FEATURES, SIMULATOR, fit

from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio import Conditional, NoPrior, PriorRows
from oee_tabular.shrinkage import Shrinkage

OPTIONS = [
    {},
    {"prior": "ridge", "features": FEATURES},
    {"prior": "tilt"},
    {"prior": "tilt", "features": FEATURES, "strength": "loo"},
    {"prior": "simulator"},
    {"prior": "simulator", "strength": 3.0},
    {"prior": "none"},
    {"prior": "ridge", "strength": 0.0},
]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("more", [{}, {"upper": 1.5}, {"ridge": "evidence"}], ids=str)
def test_names_are_short_for_the_object(options, more):
    named = fit(method=Conditional(**options, **more))
    made = fit(method=Conditional(Shrinkage(**options), **more))
    assert_array_equal(made.values.data, named.values.data)
    assert made.gap == named.gap
    assert repr(made.details) == repr(named.details)
    gradient = np.linspace(-1.0, 1.0, made.values.nnz)
    assert made.log_standard_error(gradient) == named.log_standard_error(gradient)


def test_no_prior_is_the_name_none():
    frequencies = fit(method=Conditional(NoPrior()))
    assert_array_equal(frequencies.values.data, fit(prior="none").values.data)
    assert frequencies.details["strength"] == 0.0
    again = fit(method=Conditional(Shrinkage("none", strength=7.0)))
    assert_array_equal(again.values.data, frequencies.values.data)


@dataclass(frozen=True)
class Halves:
    """A prior of one's own: the simulator's rows, worth half of each row's counts."""

    uses = frozenset()

    def fit_rows(self, given, *, solver):
        return PriorRows(given.rows.sums(given.observed) / 2, None, {"strength": 0.5})


def test_a_prior_of_ones_own():
    """A third of the weight is the prior's, whose ratio is 1."""
    halves = fit(method=Conditional(Halves()))
    plain = fit(prior="none")
    recorded = np.repeat(plain.visited.reshape(-1), np.diff(plain.values.indptr))
    expected = np.where(recorded, (2.0 * plain.values.data + 1.0) / 3.0, 1.0)
    assert_allclose(halves.values.data, expected, rtol=1e-12)


def test_values_are_for_priors_that_use_them():
    policy = np.full((SIMULATOR.n_states, SIMULATOR.n_actions), 1 / SIMULATOR.n_actions)
    assert Shrinkage().uses == {"values_of", "horizon"}
    assert Shrinkage("tilt").uses == Shrinkage("simulator").uses == frozenset()
    fit(method=Conditional(Shrinkage()), values_of=policy)
    for prior in (Shrinkage("tilt"), Halves(), NoPrior()):
        with pytest.raises(
            ArgumentError, match="values_of must be left out with prior"
        ):
            fit(method=Conditional(prior), values_of=policy)


def test_a_prior_survives_pickling():
    prior = Shrinkage("tilt", 2.0, FEATURES)
    again = pickle.loads(pickle.dumps(prior))
    assert_array_equal(
        fit(method=Conditional(again)).values.data,
        fit(method=Conditional(prior)).values.data,
    )


def test_the_paper_needs_nothing_of_this_room():
    """The quotient and the row program without a prior import no shrinkage."""
    code = (
        "import sys, oee_tabular as oee\n"
        "oee.ratio.Conditional(prior='none'), oee.ratio.Quotient()\n"
        "assert 'oee_tabular.shrinkage' not in sys.modules\n"
        "assert oee.ratio.transition_ratio is oee.transition_ratio\n"
        "assert 'oee_tabular.shrinkage' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
