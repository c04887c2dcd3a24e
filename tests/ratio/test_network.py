"""Networks as the class of functions of eq. 3.7: what they find, their bits, when they
stop, what is refused.
"""

import re
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.ratio import Conditional, Network, Quotient

trained = pytest.mark.skipif(
    find_spec("equinox") is None, reason="the extra neural is not installed"
)
BOX = {"lower": 0.2, "upper": 5.0, "normalized": False}


@pytest.fixture(scope="module")
def logs():
    """3 states, 2 actions, every move possible: simulator, 4000 moves of the target and
    of the simulator.
    """
    rng = np.random.default_rng(0)
    simulator, target = (
        oee.FiniteMDP(
            rng.dirichlet(np.full(3, 2.0), (3, 2)), np.zeros(3), np.eye(3)[0], 0.9
        )
        for _ in range(2)
    )
    return simulator, *(
        oee.sample_transitions(mdp, np.full((3, 2), 1 / 6), 4000, seed=k)
        for k, mdp in enumerate((target, simulator))
    )


def fit(logs, *, data=None, seed=0, options=BOX, **network):
    simulator, te, tr = logs
    functions = Network(
        **{"layers": (16,), "n_iterations": 1500, "step_size": 0.01} | network
    )
    return Quotient(
        **options, data=tr if data is None else data, functions=functions
    ).fit(te, simulator, seed=seed)


def by_rows(logs, *, seed=0, options=None, **network):
    simulator, te, _ = logs
    functions = Network(
        **{"layers": (16,), "n_iterations": 1500, "step_size": 0.01} | network
    )
    return Conditional(**options or {}, functions=functions).fit(
        te, simulator, seed=seed
    )


def exact(logs, options=BOX):
    simulator, te, tr = logs
    return Quotient(**options, data=tr).fit(te, simulator)


@trained
@pytest.mark.parametrize(
    ("activation", "ridge"),
    [("relu", {}), ("tanh", {}), ("silu", {}), ("silu", {"ridge": 0.5, "toward": 1.0})],
)
def test_a_full_batch_finds_the_optimum_of_a_class_that_holds_it(
    logs, activation, ridge
):
    options = BOX | ridge
    found = fit(
        logs, batch_size=None, held_out=0, activation=activation, options=options
    )
    best = exact(logs, options)
    for beta, table in zip(found.details["beta"], best.details["beta"], strict=True):
        assert_allclose(beta.ratio, table.ratio, rtol=0.01)
        assert 0 <= beta.gap < 2e-4
        assert_allclose(beta.objective, table.objective + beta.gap, atol=1e-12)
        assert_allclose(beta.gap, beta.trace.excess[-1], atol=1e-12)
        assert beta.trace.excess[0] > 5 * beta.gap
    assert_allclose(found.values.data, best.values.data, rtol=0.02)


# ---- row by row, the simulator known
# ------------------------------------------------------------------------------------


@trained
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"ridge": 0.5},
        {"ridge": lambda n: 100.0 / n},
        {"ridge": 0.5, "toward": None},
        {"ridge": "evidence"},
    ],
)
def test_a_full_batch_finds_the_rows_optimum(logs, options):
    simulator, te, _ = logs
    found = by_rows(
        logs, batch_size=None, held_out=0, activation="tanh", options=options
    )
    best = Conditional(prior="none", **options).fit(te, simulator)
    assert_allclose(found.values.data, best.values.data, rtol=0.01)
    assert 0 <= found.gap < 1e-4
    assert found.method == best.method
    assert found.details["trace"].excess[0] > 5 * found.gap
    assert found.details["trace"].excess[-1] == pytest.approx(found.gap, abs=1e-12)
    assert found.details["kept"] == found.details["iterations"] == 1500


@pytest.fixture(scope="module")
def ragged():
    """A grid, whose rows have one to four moves, and 2000 moves of another; one state's
    rows are left out.
    """
    simulator, target = (oee.tasks.gridworld(4, slip) for slip in (0.4, 0.1))
    seen = np.ones((16, 4))
    seen[5] = 0.0
    return (
        simulator,
        oee.sample_transitions(target, seen / seen.sum(), 2000, seed=0),
        target,
    )


@trained
@pytest.mark.parametrize("size", [None, 64])
def test_rows_sum_to_one_whatever_their_width_and_the_logs_share(ragged, size):
    simulator = ragged[0]
    assert len(np.unique(np.diff(simulator.transitions.indptr))) > 1
    found = by_rows(ragged, batch_size=size, n_iterations=200)
    rows = np.add.reduceat(
        found.values.data * simulator.transitions.data,
        simulator.transitions.indptr[:-1],
    )
    assert_allclose(rows, 1.0, atol=1e-14)
    assert found.row_sum_error < 1e-14
    unseen = found.values.toarray().reshape(16, 4, 16)[5]
    assert not found.visited[5].any()
    # the network's word, not the prior's
    assert np.abs(unseen[unseen > 0] - 1).max() > 0.01


@trained
def test_batches_of_rows_come_near_and_stop_on_held_out_transitions(logs):
    simulator, te, _ = logs
    found = by_rows(logs, patience=4, n_iterations=20_000)
    best = Conditional(prior="none").fit(te, simulator)
    held = found.details["held_out_risk"]
    trace = found.details["trace"]
    assert found.gap < 0.1 * trace.excess[0]
    assert len(held) == len(trace.iteration) < 201
    assert np.argmin(held) == len(held) - 5
    assert found.details["kept"] == trace.iteration[np.argmin(held)]
    assert found.details["iterations"] == trace.iteration[-1]
    assert np.abs(found.values.data - best.values.data).mean() == pytest.approx(
        trace.error[np.argmin(held)]
    )
    assert held[0] == pytest.approx(1.0)  # zeta = 1: log 1 is 0, and rows sum to 1


@trained
def test_the_limit_of_rows_is_the_targets(ragged):
    simulator, log, target = ragged
    pi = oee.uniform_policy(simulator)
    estimator = oee.estimators.OffEnvironment(
        ratio=Conditional(functions=Network((4,), n_iterations=100))
    )
    assert estimator.limit(simulator, target, pi) == pytest.approx(
        oee.policy_value(target, pi), rel=1e-12
    )
    found = estimator(oee.Problem(simulator, log), pi, seed=0).value
    model = (
        Conditional(functions=Network((4,), n_iterations=100))
        .fit(log, simulator, seed=0)
        .target_model(simulator)
    )
    assert np.isfinite(found)
    assert_allclose(model.transitions.sum(axis=1), 1.0, atol=1e-14)


@trained
def test_a_name_with_functions_is_the_object_with_them(logs):
    simulator, te, _ = logs
    network = Network((8,), n_iterations=100)
    named = oee.transition_ratio(te, simulator, functions=network, seed=3)
    assert_array_equal(
        named.values.data,
        Conditional(functions=network).fit(te, simulator, seed=3).values.data,
    )
    other = oee.transition_ratio(te, simulator, functions=network, seed=4)
    assert (named.values.data != other.values.data).all()


BITS = """
import numpy as np, oee_tabular as oee
from oee_tabular.ratio import Conditional, Network, Quotient
mdp = oee.tasks.gridworld(6, 0.3)
log = oee.sample_transitions(mdp, np.full((36, 4), 1 / 144), 3000, seed=0)
network = Network((64, 64), batch_size=512, n_iterations=200)
for method in (Quotient(0.1, 10.0, normalized=False, functions=network), Conditional(functions=network)):
    print(method.fit(log, mdp, seed=0).values.data.tobytes().hex())
"""


@trained
def test_one_seed_gives_the_same_bits_in_any_process_with_any_number_of_threads():
    def bits(before=()):
        return subprocess.run(
            [*before, sys.executable, "-c", BITS],
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    first = bits()
    assert first == bits(("taskset", "-c", "0") if sys.platform == "linux" else ())


@trained
@pytest.mark.parametrize("step_size", [100.0, 1e300])
def test_a_diverging_training_names_its_step_and_its_risk(logs, step_size):
    text = (
        r"^training must not diverge; at iteration \d+ the risk is (nan|[\d.e+]+), at"
        r" the start it was 1: give a smaller "
    )
    for way in (fit, by_rows):
        with pytest.raises(
            RuntimeError, match=text + re.escape(f"step_size than {step_size:g}")
        ):
            way(logs, step_size=step_size, optimizer="sgd")


def test_without_the_extra_everything_imports_and_a_network_is_one_sentence():
    code = (
        "import sys; sys.modules['equinox'] = sys.modules['jax'] = None\nimport"
        " oee_tabular as oee\nfrom oee_tabular.ratio import Conditional, Network,"
        " Quotient\nmdp = oee.tasks.gridworld(2, 0.3)\nfor method in"
        " (Quotient(normalized=False, functions=Network()),"
        " Conditional(functions=Network())):\n    try: method.fit(mdp.transitions *"
        " 100, mdp)\n    except ImportError as error: print(error)"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    sentence = (
        "Network needs jax, equinox and optax, which are not installed; in a clone: pip"
        " install '.[neural]'"
    )
    assert said.splitlines() == [sentence, sentence]


@trained
@pytest.mark.parametrize(
    ("options", "text"),
    [
        (
            {"inputs": [0.0, 1.0]},
            (
                r"^inputs must have shape \(3,\) or \(3, c\), a place for each state;"
                r" it has shape \(2,\)$"
            ),
        ),
        (
            {"held_out": 0.9999},
            r"^held_out must leave transitions to train on; it keeps out 4000 of 4000$",
        ),
    ],
)
def test_bad_data(logs, options, text):
    for way in (fit, by_rows):
        with pytest.raises(ValueError, match=text):
            way(logs, **options)


@trained
def test_weighted_transitions_can_not_be_held_out(logs):
    simulator = logs[0]
    log = oee.sample_episodes(simulator, oee.uniform_policy(simulator), 50, 20, seed=0)
    network = Network((4,), n_iterations=100)
    for method in (Quotient(**BOX, functions=network), Conditional(functions=network)):
        with pytest.raises(
            ValueError,
            match=r"^held_out must be 0 if the log's transitions are weighted",
        ):
            method.fit(log, simulator, discount=0.9, seed=0)
    whole = Conditional(functions=Network((4,), n_iterations=100, held_out=0))
    assert whole.fit(log, simulator, discount=0.9, seed=0).row_sum_error < 1e-14
