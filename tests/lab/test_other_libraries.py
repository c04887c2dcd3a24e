"""Tests of the page that hands a log to SCOPE-RL and offline-rl-ope.

Its code is run with the libraries where they are installed, and else with functions
that have their names and arguments. Names from the literature are checked by equations
that have one solution in a table.
"""

import re
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators.names import named_estimators

PAGE = Path(__file__).parents[2] / "notebooks" / "other_libraries.md"
PADDING, SCOPE_RL, OFFLINE_RL_OPE = re.findall(
    r"^```python\n(.*?)^```", PAGE.read_text(), re.S | re.M
)
SAME = {  # their name -> ours
    "PerDecisionImportanceSampling": "pdis",
    "SelfNormalizedPDIS": "wpdis",
    "VanillaISPDIS": "pdis",
    "PDWIS": "wpdis",
}


def padded(name):
    """The names that the page's first block leaves, on a family."""
    names = {}
    with redirect_stdout(StringIO()):
        exec(PADDING.replace('"machine"', repr(name)), names)
    return names


def printed_values(block, names):
    """Estimator -> value that a block of the page prints."""
    out = StringIO()
    with redirect_stdout(out):
        exec(block, names)
    return {
        name: float(value)
        for name, value in (line.split(": ") for line in out.getvalue().splitlines())
    }


@pytest.mark.parametrize("name", ["machine", "random_walk"])
def test_padded_episodes_give_the_same_importance_sampling(name):
    names = padded(name)
    assert_allclose(names["per_decision"].mean(), names["ours"].value, rtol=1e-12)
    assert names["is_alive"].sum() == len(names["log"])
    assert_allclose(names["wanted"].sum(axis=2), 1.0)
    assert names["weight"].shape == (len(names["length"]), names["length"].max())


@pytest.mark.parametrize("name", ["machine", "random_walk"])
@pytest.mark.parametrize(
    ("module", "block"),
    [
        ("scope_rl.ope.discrete", SCOPE_RL),
        ("offline_rl_ope.api", OFFLINE_RL_OPE),
    ],
)
def test_with_the_libraries_the_values_are_ours(module, block, name):
    pytest.importorskip(module, reason=f"needs {module.partition('.')[0]}, with torch")
    compare(block, name)


def compare(block, name):
    """Hold the values that a block prints to this package's estimators."""
    names = padded(name)
    values = printed_values(block, names)
    assert len(values) >= 2
    for theirs, value in values.items():
        if theirs in SAME:
            (own,) = named_estimators([SAME[theirs]]).values()
            ours = own(names["problem"], names["policy"]).value
            assert_allclose(value, ours, rtol=1e-4, atol=6e-4)


def scope_rl(
    *,
    step_per_trajectory,
    action,
    reward,
    pscore,
    evaluation_policy_action_dist,
    gamma,
    state_action_value_prediction,
):
    """Estimate by per-decision importance sampling on SCOPE-RL's flat arrays."""
    taken = evaluation_policy_action_dist[np.arange(len(action)), action] / pscore
    weights = np.cumprod(taken.reshape(-1, step_per_trajectory), axis=1)
    assert state_action_value_prediction.shape == evaluation_policy_action_dist.shape
    after_the_end = (state_action_value_prediction == 0.0).all(axis=1)
    assert (pscore[after_the_end] == 1.0).all()
    paid = weights * reward.reshape(weights.shape)
    return (paid @ gamma ** np.arange(step_per_trajectory)).mean()


def offline_rl_ope(*, rewards, states, actions, weights, discount, is_msk):
    """Estimate the same on offline-rl-ope's columns of rewards for each episode."""
    paid = np.array([column[:, 0] for column in rewards]) * is_msk
    return ((weights * paid) @ discount ** np.arange(weights.shape[1])).mean()


class Tensor(np.ndarray):
    def unsqueeze(self, axis):
        return np.expand_dims(self, axis)


def stand_in(name, **contents):
    module = ModuleType(name)
    vars(module).update(contents)
    return module


@pytest.fixture
def stand_ins(monkeypatch):
    """Put modules with the libraries' names in place, as far as the page calls them."""
    made = SimpleNamespace(estimate_policy_value=scope_rl, predict=offline_rl_ope)
    names = (*SAME, "DoublyRobust")
    estimators = SimpleNamespace(**dict.fromkeys(names, lambda: made))
    modules = {
        "scope_rl": {},
        "scope_rl.ope": {},
        "scope_rl.ope.discrete": {"basic_estimators": estimators},
        "offline_rl_ope": {},
        "offline_rl_ope.api": {"StandardEstimators": SimpleNamespace(IS=estimators)},
        "torch": {
            "float32": float,
            "tensor": lambda values, dtype: np.asarray(values).view(Tensor),
            "ones": np.ones,
        },
    }
    for name, contents in modules.items():
        monkeypatch.setitem(sys.modules, name, stand_in(name, **contents))


@pytest.mark.parametrize("block", [SCOPE_RL, OFFLINE_RL_OPE])
def test_the_code_without_the_libraries(stand_ins, block):
    """The stand-ins have one estimator, per-decision importance sampling."""
    names = padded("machine")
    values = printed_values(block, names)
    assert_allclose(
        list(values.values()), names["per_decision"].mean(), rtol=1e-12, atol=6e-4
    )


def test_the_values_in_the_text_are_those_of_our_estimators():
    names = padded("machine")
    for name in ("pdis", "wpdis"):
        (own,) = named_estimators([name]).values()
        value = own(names["problem"], names["policy"]).value
        assert PAGE.read_text().count(f" {value:.3f}") >= 1


def test_doubly_robust_is_the_published_recursion():
    """SCOPE-RL's third value, by the page's arrays."""
    names = padded("machine")
    exec(SCOPE_RL.partition("for name")[0].partition("\n\n")[2], names)
    gamma, step, weight = (names[name] for name in ("gamma", "step", "weight"))
    q = names["q"]
    of_taken = np.take_along_axis(q, names["action"][:, :, None], axis=2)[:, :, 0]
    before = np.hstack([np.ones((len(weight), 1)), weight[:, :-1]])
    terms = weight * (names["reward"] - of_taken)
    terms += before * (names["wanted"] * q).sum(axis=2)
    assert f" {(terms @ gamma**step).mean():.3f}." in PAGE.read_text()


def test_each_library_takes_fifteen_lines():
    for block in (SCOPE_RL, OFFLINE_RL_OPE):
        assert len([line for line in block.splitlines() if line]) <= 15


@pytest.mark.parametrize("name", ["machine", "queue25"])
def test_names_from_the_literature_solve_the_published_equations(name):
    """Check the published equations on a log of all pairs.

    They are E[(r + gamma q(s', pi) - q(s, a)) f] = 0 and E[w (f(s, a) - gamma f(s',
    pi))] = f(s_0, pi).
    """
    family = oee.bench.families()[name]
    simulator = family.simulator
    policy = family.policy
    log = oee.sample_transitions(
        family.target, np.full(policy.shape, 1 / policy.size), 20_000, seed=0
    )
    problem = oee.Problem(simulator, log)
    pair = log.state * policy.shape[1] + log.action
    moves = np.zeros((policy.size, policy.shape[0]))
    np.add.at(moves, (pair, log.next_state), simulator.discount)
    matrix = np.diag(np.bincount(pair)) - (moves[:, :, None] * policy).reshape(
        policy.size, -1
    )
    rewards = np.bincount(pair, problem.rewards_of(log))
    start = (simulator.initial[:, None] * policy).ravel()
    by_q = start @ np.linalg.solve(matrix, rewards)
    by_w = np.linalg.solve(matrix.T, start) @ rewards
    for own, value in {
        "fqe": by_q,
        "mql": by_q,
        "mwl": by_w,
        "gendice": by_w,
        "dualdice": by_w,
    }.items():
        (estimator,) = named_estimators([own]).values()
        assert_allclose(estimator(problem, policy).value, value, rtol=1e-9)
    rows = oee.bench.run(
        ["fqe", "mql", "gradientdice"], families=[name], sizes=[3], seeds=1
    ).table
    assert rows.estimator.tolist()[2:] == ["fqe", "mql", "gradientdice"]
    assert rows.status.tolist() == ["ok"] * 5
