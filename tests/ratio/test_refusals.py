"""Bad calls of ratios: each error names the argument, the rule and the value."""

import functools

import numpy as np
import pytest
from ratio.problem import COUNTS, FEATURES, LOG, PLACES, POLICY, SIMULATOR, TARGET
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.ratio.features import action_displacement
from oee_tabular.ratio.support import check_assumptions

zeta = functools.partial(functools.partial, oee.transition_ratio, sparse.csr_array(COUNTS), SIMULATOR)


density = functools.partial(functools.partial, oee.density_ratio, [1, 2], [2, 1])


SGD = {"solver": "sgd", "normalized": False, "lower": 0.1, "upper": 9.0}


UNUSED = {
    "strength": 1.0, "features": FEATURES, "kernel": "gaussian", "coordinates": PLACES, "bandwidth": 1.0, "n_centers": 5,
    "simulator_data": "exact", "behavior_policy": POLICY, "ratio_lower": 0.5, "ratio_upper": 2.0, "prior": "none",
}  # fmt: skip


OWN = {
    "conditional": {"prior", "strength", "features"},
    "linear": {"features"},
    "kernel": {"kernel", "coordinates", "bandwidth", "n_centers"},
    "ratio_of_ratios": {"simulator_data", "behavior_policy"},
    "joint": {"simulator_data", "behavior_policy", "ratio_lower", "ratio_upper"},
}


NEEDED = {"linear": {"features": FEATURES}, "kernel": {"coordinates": PLACES}}


@pytest.mark.parametrize("method", OWN)
@pytest.mark.parametrize("name", UNUSED)
def test_options_that_a_method_does_not_use(method, name):
    if name in OWN[method]:
        return
    with pytest.raises(
        ValueError, match=rf"^{name} must not be given with method '{method}', which does not use it; got"
    ):
        zeta(method=method, **NEEDED.get(method, {}), **{name: UNUSED[name]})()


WRONG = {
    "method": (zeta(method="q"), r"^method must be one of 'conditional', 'tied', 'linear', .*, 'joint'; got 'q'$"),
    "simulator": (lambda: oee.transition_ratio(LOG, 3), r"^simulator must be a FiniteMDP; got int$"),
    "prior": (zeta(prior="q"), r"^prior must be one of 'ridge', 'tilt', 'simulator', 'none'; got 'q'$"),
    "strength": (zeta(strength="q"), r"^strength must be one of 'evidence', 'loo'; got 'q'$"),
    "a negative strength": (zeta(strength=-1), r"^strength must be in \[0, inf\); it is -1$"),
    "a negative ridge": (zeta(ridge=-1), r"^ridge must be in \[0, inf\); it is -1$"),
    "a ridge of n": (density(ridge=lambda n: -n), r"^ridge\(3\) must be in \[0, inf\); it is -3$"),
    "toward": (zeta(toward=-1), r"^toward must be in \[0, inf\); it is -1$"),
    "lower": (zeta(lower=-1), r"^lower must be in \[0, inf\); it is -1$"),
    "upper": (zeta(upper=-1), r"^upper must be in \[0, inf\]; it is -1$"),
    "upper below 1": (
        zeta(upper=0.5),
        r"^the box \[lower, upper\] must contain 1 for sum q g = 1 to be possible; it is \[0, 0",
    ),
    "the joint box": (
        zeta(method="joint", ratio_upper=0.5),
        r"^the box \[ratio_lower, ratio_upper\] must contain 1 for sum q g = 1",
    ),
    "features with a prior": (
        zeta(prior="simulator", features=FEATURES),
        r"^features must be left out with prior 'simulator', which does not use them$",
    ),
    "a word for the ridge": (
        zeta(method="joint", ridge="loo"),
        r"^ridge must be a number or a function of n with method 'joint'; got 'loo'$",
    ),
    "behaviour": (
        zeta(method="joint", behavior_policy=POLICY * 2),
        r"^behavior_policy\[0\] must sum to 1",
    ),
    "centres": (
        zeta(method="kernel", coordinates=PLACES, n_centers=0),
        r"^n_centers must be a positive integer; it is 0$",
    ),
    "a discount for counts": (
        zeta(discount=0.9),
        r"^discount must be left out where counts are given: they have no timesteps$",
    ),
    "what is no log": (
        lambda: oee.transition_ratio(COUNTS, SIMULATOR),
        r"^log_or_counts must be Transitions or sparse counts; got ndarray$",
    ),
    "the true ratio's target": (lambda: oee.true_ratio(3, SIMULATOR), r"^target must be a FiniteMDP; got int$"),
    "the true ratio's simulator": (lambda: oee.true_ratio(TARGET, 3), r"^simulator must be a FiniteMDP; got int$"),
    "a seed": (
        zeta(method="ratio_of_ratios", seed="q"),
        r"^seed must be what numpy.random.default_rng takes",
    ),
    "places that are not finite": (
        zeta(method="kernel", coordinates=[0, 1, np.nan]),
        r"^coordinates\[2\] must be finite; it is nan$",
    ),
    "places of another number": (
        lambda: action_displacement(SIMULATOR, [0, 1]),
        r"^coordinates must have 3 rows, one a state; they have 2$",
    ),
    "features that are not finite": (
        zeta(features=np.where(FEATURES == 2, np.inf, FEATURES)),
        r"^features\[2, 0\] must be finite; it is inf$",
    ),
    "a loss": (density(loss="q"), r"^loss must be one of 'kl', 'chi2'; got 'q'$"),
    "p": (lambda: oee.density_ratio([-1], [1]), r"^p\[0\] must be nonnegative; it is -1\.0$"),
    "q": (lambda: oee.density_ratio([1], [-1]), r"^q\[0\] must be nonnegative; it is -1\.0$"),
    "a step": (density(step_size=0, **SGD), r"^step_size must be in \(0, inf\); it is 0$"),
    "a batch": (density(batch_size=0, **SGD), r"^batch_size must be a positive integer; it is 0$"),
    "iterations": (density(n_iterations=0, **SGD), r"^n_iterations must be a positive integer; it is 0$"),
    "Algorithm 1 without an upper bound": (
        density(**(SGD | {"upper": None})),
        r'^solver "sgd" must have 0 < lower and a finite upper; the box is \[0\.1, inf\]$',
    ),
    "Algorithm 1 without a lower bound": (
        density(**(SGD | {"lower": None})),
        r'^solver "sgd" must have 0 < lower and a finite upper; the box is \[0, 9\]$',
    ),
    "Algorithm 1 normalised": (
        density(**(SGD | {"normalized": True})),
        r'^solver "sgd" must have normalized=False and loss="kl": Algorithm 1 knows no other program$',
    ),
    "Algorithm 1 with another loss": (
        density(loss="chi2", **SGD),
        r'^solver "sgd" must have normalized=False and loss="kl"',
    ),
    "assumptions: p": (lambda: check_assumptions([-1], [1], lower=0, upper=1), r"^p\[0\] must be nonnegative"),
    "assumptions: q": (
        lambda: check_assumptions([1], [0], lower=0, upper=1),
        r"^q must have a positive, finite sum; it is 0$",
    ),
    "coordinates that are not finite": (
        density(kernel="gaussian", coordinates=[0, np.inf]),
        r"^coordinates\[1\] must be finite; it is inf$",
    ),
    "a class far from its box": (
        density(features=[1, -1], lower=0.5, upper=4.0, normalized=False),
        r"^features must span a function that is at least 0\.5 and at most 4; the nearest misses by 0\.5 \(a constant",
    ),
    "assumptions: lower": (
        lambda: check_assumptions([1], [1], lower=-1, upper=1),
        r"^lower must be in \[0, inf\); it is -1$",
    ),
    "assumptions: lengths": (
        lambda: check_assumptions([1], [1, 1], lower=0, upper=1),
        r"^p and q must have one length; they have 1 and 2$",
    ),
    "another simulator's ratio": (
        lambda: exact.reweight(SIMULATOR, oee.true_ratio(*[FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 0.5)] * 2)),
        r"^ratio must be sparse of shape \(6, 3\)",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_calls_name_their_argument(name):
    call, text = WRONG[name]
    with pytest.raises(ValueError, match=text):
        call()
