"""Bad calls of ratios: each error names the argument, the rule and the value."""

import re

import numpy as np
import pytest
from ratio import problem
from ratio.problem import COUNTS, FEATURES, PLACES, POLICY, SIMULATOR
from scipy import sparse

import oee_tabular as oee
from oee_tabular.ratio import Joint, Network, Quotient

TIE = np.arange(18) % 3
SGD = {"solver": "sgd", "normalized": False, "lower": 0.1, "upper": 9.0}
OWN = {  # a method's options, of those that not all have; what it needs
    "conditional": ({"prior", "strength", "features"}, {}),
    "linear": ({"features"}, {"features": FEATURES}),
    "kernel": ({"kernel", "coordinates", "bandwidth", "n_centers"}, {"coordinates": PLACES}),
    "ratio_of_ratios": ({"simulator_data", "behavior_policy"}, {}),
    "joint": ({"simulator_data", "behavior_policy", "ratio_lower", "ratio_upper"}, {}),
    "tied": ({"strength"}, {"tie": TIE}),
}
UNUSED = {
    "strength": 1.0, "features": FEATURES, "kernel": "gaussian", "coordinates": PLACES, "bandwidth": 1.0, "n_centers": 5,
    "simulator_data": "exact", "behavior_policy": POLICY, "ratio_lower": 0.5, "ratio_upper": 2.0, "prior": "none",
}  # fmt: skip


def density(**options):
    return oee.density_ratio([3, 1, 2], [1, 1, 1], **options)


def zeta(**options):
    return oee.transition_ratio(sparse.csr_array(COUNTS), SIMULATOR, **options)


def boxed(**options):
    return Quotient(**{"lower": 0.2, "upper": 5.0, "normalized": False, "functions": Network()} | options)


@pytest.mark.parametrize("method", OWN)
@pytest.mark.parametrize("name", UNUSED)
def test_options_that_a_method_does_not_use(method, name):
    own, needed = OWN[method]
    if name not in own:
        with pytest.raises(
            ValueError, match=f"^{name} must not be given with method '{method}', which does not use it"
        ):
            zeta(method=method, **needed, **{name: UNUSED[name]})


# A call, and its ValueError as far as it matters; ... stands for anything
CASES = r"""
>>> zeta(method='q')
method must be one of 'conditional', 'tied', 'linear', ..., 'joint'; got 'q'
>>> oee.transition_ratio(LOG, 3)
simulator must be a FiniteMDP; got int
>>> zeta(strength='q')
strength must be one of 'evidence', 'loo'; got 'q'
>>> zeta(ridge=-1)
ridge must be in [0, inf); it is -1
>>> density(ridge=lambda n: -n)
ridge(6) must be in [0, inf); it is -6
>>> zeta(toward=-1)
toward must be in [0, inf); it is -1
>>> zeta(lower=-1)
lower must be in [0, inf); it is -1
>>> zeta(upper=-1)
upper must be in [0, inf]; it is -1
>>> zeta(upper=0.5)
the box [lower, upper] must contain 1 for sum q g = 1 to be possible; it is [0, 0
>>> zeta(method='joint', ratio_upper=0.5)
the box [ratio_lower, ratio_upper] must contain 1 for sum q g = 1
>>> zeta(prior='simulator', features=FEATURES)
features must be left out with prior 'simulator', which does not use them
>>> zeta(method='joint', ridge='loo')
ridge must be a number or a function of n with method 'joint'; got 'loo'
>>> Quotient(ridge='loo')
ridge must be a number or a function of n with method 'ratio_of_ratios'
>>> zeta(method='linear', features=FEATURES, ridge='loo')
ridge must be a number or a function of n with method 'linear'
>>> zeta(method='joint', behavior_policy=POLICY * 2)
behavior_policy[0] must sum to 1
>>> zeta(method='kernel', coordinates=PLACES, n_centers=0)
n_centers must be a positive integer; it is 0
>>> zeta(method='kernel', coordinates=PLACES, bandwidth=0)
bandwidth must be in (0, inf)
>>> zeta(method='kernel', coordinates=[0, 1, np.nan])
coordinates[2] must be finite; it is nan
>>> zeta(method='kernel', coordinates=[1, 2])
coordinates must have 3 rows, one a state; they have 2
>>> zeta(method='kernel')
coordinates must be given with method "kernel"
>>> zeta(method='linear')
features must be given with method "linear"
>>> zeta(discount=0.9)
discount must be left out where counts are given: they have no timesteps
>>> oee.true_ratio(TARGET, 3)
simulator must be a FiniteMDP; got int
>>> zeta(method='ratio_of_ratios', seed='q')
seed must be what numpy.random.default_rng takes
>>> zeta(features=np.where(FEATURES == 2, np.inf, FEATURES))
features must be finite; feature 0 at s=0, a=0 -> s'=2 is inf
>>> zeta(horizon=3)
horizon must be left out without values_of: it is that of the values
>>> zeta(method=Joint(), values_of=POLICY)
values_of must not be given with method 'joint'
>>> zeta(method=Conditional(prior='tilt'), values_of=POLICY)
values_of must be left out with prior 'tilt'
>>> zeta(method='linear', features=FEATURES, tie=TIE)
tie must not be given with method 'linear', which does not use it
>>> zeta(tie=TIE, ridge=1.0)
ridge must not be given with method 'tied', which does not use it; got 1.0
>>> zeta(tie=TIE, strength='loo')
strength must be a number with method 'tied'; got 'loo'
>>> zeta(method='tied')
tie must be given with method 'tied': a key for each entry
>>> Tied(TIE, strength=-1)
strength must be in [0, inf); it is -1
>>> zeta(tie=np.zeros(3, dtype=int))
tie must have shape (18,), a key for each entry
>>> zeta(tie=np.zeros(18))
tie must have integer keys; they are float64
>>> Tied(TIE).fit([1], SIMULATOR)
log_or_counts must be Transitions or sparse counts; got list
>>> InClass()
features must be given
>>> InClass(features=PLACES, kernel='gaussian', coordinates=PLACES)
features must be left out with a kernel
>>> Quotient(normalized='raw')
normalized must be True or False
>>> Quotient(solver=3)
solver must be a name or Sgd(...); got 3
>>> Quotient(solver=Sgd()).fit(LOG, SIMULATOR)
solver "sgd" must have normalized=False
>>> oee.estimators.OffEnvironment(3)
ratio must be a method's name
>>> oee.exact.reweight(SIMULATOR, oee.true_ratio(*[oee.FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 0.5)] * 2))
ratio must be sparse of shape (6, 3)
>>> density(step_size=0, **SGD)
step_size must be in (0, inf); it is 0
>>> density(batch_size=0, **SGD)
batch_size must be a positive integer; it is 0
>>> density(n_iterations=0, **SGD)
n_iterations must be a positive integer; it is 0
>>> density(**SGD | {'upper': None})
solver "sgd" must have 0 < lower and a finite upper; the box is [0.1, inf]
>>> density(**SGD | {'lower': None})
solver "sgd" must have 0 < lower and a finite upper; the box is [0, 9]
>>> density(**SGD | {'normalized': True})
solver "sgd" must have normalized=False and loss="kl"
>>> density(loss='chi2', **SGD)
solver "sgd" must have normalized=False and loss="kl"
>>> density(features=[1, 2])
features must have 3 rows, one for each entry of p; they have shape (2,)
>>> density(features=[1, np.nan, 2])
features[1] must be finite; it is nan
>>> density(features=[1, -1, 1])
features must span a function that is at least 0, with sum q g = 1; the nearest misses by ... (a constant
>>> density(features=[1, -1, 1], lower=0.5, upper=4.0, normalized=False)
features must span a function that is at least 0.5 and at most 4; the nearest misses by 0.5 (a constant
>>> density(features=[1, 1, 1], kernel='gaussian')
kernel must not be given with features
>>> density(features=[1, 1, 1], toward=1.0)
toward and loss must be left out with features
>>> density(features=[1, 1, 1], solver='sgd')
solver "sgd" must be left out with features or kernel
>>> density(features=[1, 1, 1], lower=1.0)
the box of a linear class must have lower < 1 < upper
>>> density(kernel='gaussian')
coordinates must be given with kernel
>>> density(coordinates=[1, 2, 3])
coordinates must be given with a kernel
>>> density(kernel='gaussian', coordinates=[1, 2])
coordinates must have 3 rows, one for each entry of p; they have 2
>>> density(kernel='gaussian', coordinates=[0, np.inf, 1])
coordinates[1] must be finite; it is inf
>>> density(kernel='rbf', coordinates=[1, 2, 3])
kernel must be one of 'gaussian'; got 'rbf'
>>> density(kernel=lambda x, c: np.ones(3), coordinates=[1, 2, 3])
kernel must have 2 dimension(s); it has shape (3,)
>>> density(kernel=lambda x, c: 1.0 - 3.0 * (x != c.T), coordinates=[1, 2, 3])
kernel must be symmetric and positive semidefinite; given the points
>>> density(kernel=lambda x, c: -np.ones((len(x), len(c))), coordinates=[1, 2, 3])
kernel must be positive semidefinite; k(x, x) is -1 at point 0
>>> density(kernel=lambda x, c: np.zeros((len(x), len(c))), coordinates=[1, 2, 3])
kernel must not be 0 at every point
>>> oee.check_assumptions([-1], [1], lower=0, upper=1)
p[0] must be nonnegative
>>> oee.check_assumptions([1], [1], lower=-1, upper=1)
lower must be in [0, inf); it is -1
>>> Network((0,))
layers[0] must be a positive integer; it is 0
>>> Network(64)
layers must be a collection of widths of hidden layers; got int
>>> Network(activation='sinus')
activation must be one of 'relu', ...'sinus'
>>> Network(optimizer='adagrad')
optimizer must be one of 'adam', 'sgd'...'adagrad'
>>> Network(inputs='pixels')
inputs must be one of 'one_hot'...'pixels'
>>> Network(step_size=0)
step_size must be in (0, inf); it is 0
>>> Network(batch_size=0)
batch_size must be a positive integer; it is 0
>>> Network(n_iterations=1.5)
n_iterations must be a positive integer; got 1.5
>>> Network(held_out=1)
held_out must leave transitions to train on; it is 1
>>> Network(held_out=-0.1)
held_out must be in [0, 1]; it is -0.1
>>> Network(patience=0)
patience must be a positive integer; it is 0
>>> boxed(functions='mlp')
functions must be a Network(...); got str
>>> boxed(normalized=True)
normalized must be False with functions
>>> boxed(solver='CLARABEL')
solver must be left out with functions=...; got 'CLARABEL'
>>> boxed(upper=np.inf)
lower and upper must be a box with 0 < lower ...; it is [0.2, inf]
>>> boxed(lower=None)
lower and upper must be a box ...; it is [0, 5]
>>> boxed(toward=None, ridge=1.0)
toward must be a number with functions
>>> Conditional(functions='mlp')
functions must be a Network(...); got str
>>> Conditional(functions=Network(), solver='CLARABEL')
solver must be left out with functions=...; got 'CLARABEL'
>>> Conditional(functions=Network(), prior='tilt')
prior must be left out with functions=...; got 'tilt'
>>> Conditional(functions=Network(), features=[1.0])
features must be left out with prior 'none'
>>> Conditional(functions=Network(), upper=5.0)
lower and upper must be left out with functions=...; it is [0, 5]
>>> Conditional(functions=Network(), lower=0.1)
lower and upper must be left out with functions=...; it is [0.1, inf]
"""


@pytest.mark.parametrize("case", CASES.strip().split(">>> ")[1:])
def test_bad_calls_name_their_argument(case):
    call, text = case.strip().split("\n")
    with pytest.raises(ValueError, match="^" + re.escape(text).replace(r"\.\.\.", ".*")):
        eval(call, vars(oee.ratio) | vars(problem) | globals())


def test_options_that_no_method_has_are_type_errors():
    with pytest.raises(TypeError, match=r"^priors must be an option of a method: "):
        zeta(priors="tilt")
    with pytest.raises(TypeError, match=r"^lower must be given to the method object"):
        zeta(method=Joint(), lower=1.0)
    with pytest.raises(TypeError, match="tie"):
        Quotient(tie=TIE)
