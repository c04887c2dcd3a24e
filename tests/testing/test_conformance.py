import dataclasses
import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from testing import wrong

import oee_tabular as oee
from oee_tabular import testing
from oee_tabular.estimators import (
    DoublyRobust,
    DualDice,
    ImportanceSampling,
    Magic,
    Marginalized,
    ModelBased,
    OffEnvironment,
    Oracle,
    Simulator,
)
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.testing import (
    CLAIMS,
    DEFAULT,
    LAWS,
    case,
    check_estimator,
    claims_of,
    padded_log,
    relabelled_log,
)

PRODUCT = {"evaluation": "monte_carlo", "n_rollouts": 400}
SHIPPED = {
    "simulator": Simulator(),
    "oee": OffEnvironment(),
    "oee, ratio of ratios": OffEnvironment("ratio_of_ratios"),
    "oee product": OffEnvironment("joint", **PRODUCT),
    "oee product, self-normalised": OffEnvironment(
        "ratio_of_ratios", **PRODUCT, self_normalized=True
    ),
    "is": ImportanceSampling("trajectory"),
    "wis": ImportanceSampling("trajectory", self_normalized=True),
    "pdis": ImportanceSampling(),
    "pdis, estimated behaviour": ImportanceSampling(behavior="estimated"),
    "wpdis": ImportanceSampling(self_normalized=True),
    "wpdis, zero": ImportanceSampling(self_normalized=True, ragged="zero"),
    "wpdis, zero, estimated behaviour": ImportanceSampling(
        self_normalized=True, ragged="zero", behavior="estimated"
    ),
    "model": ModelBased(),
    "model, else the simulator": ModelBased("simulator"),
    "model, else 0": ModelBased("zero"),
    "dr": DoublyRobust(ratio="joint"),
    "dr, beta": DoublyRobust(weights="beta"),
    "dr, rollouts": DoublyRobust("rollouts", ratio="joint"),
    "dr, episodes": DoublyRobust("episodes", ratio="joint"),
    "wdr": DoublyRobust("episodes", self_normalized=True, ratio="joint"),
    "magic": Magic(n_bootstrap=50, ratio="joint"),
    "marginalised": Marginalized("joint"),
    "marginalised, boxed": Marginalized(ratio="joint", lower=0.5, upper=1.5),
    "dualdice": DualDice(),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_estimator_satisfies_what_it_claims(name):
    verdicts = check_estimator(SHIPPED[name], repetitions=6)
    assert verdicts.passed, verdicts
    assert len(verdicts) == len(LAWS)


@pytest.mark.parametrize(
    ("make", "laws", "kept"),
    [
        (
            lambda simulator, target: Oracle(target, **PRODUCT, self_normalized=True),
            None,
            "support",
        ),
        (
            lambda simulator, target: Oracle(target),
            ["limit", "support", "shift"],
            "support",
        ),
        (
            lambda simulator, target: DoublyRobust(
                "episodes", ratio=oee.true_ratio(simulator, simulator)
            ),
            ["unbiased"],
            "unbiased",
        ),
    ],
)
def test_oracles_satisfy_what_they_claim(make, laws, kept):
    """Doubly robust values with a wrong zeta are still unbiased."""
    verdicts = check_estimator(make, from_pair=True, laws=laws, repetitions=6)
    assert verdicts.passed, verdicts
    assert verdicts[kept].outcome == "holds"
    assert kept != "support" or "oracle: " in verdicts["support"].text


@pytest.mark.parametrize("name", wrong.TABLE)
def test_a_wrong_estimator_breaks_the_laws_that_it_breaks_and_no_other(name):
    estimator, claims, breaks = wrong.TABLE[name]
    verdicts = check_estimator(estimator, claims=claims.split())
    assert set(verdicts.broken) == set(breaks.split()), verdicts
    assert not verdicts.passed
    assert all(
        re.search(r"(horizon|discount) \d", verdicts[law].text)
        for law in verdicts.broken
    )


@pytest.mark.parametrize("name", wrong.SLIGHTLY)
def test_a_small_bias_is_found_and_nothing_else(name):
    estimator, claims = wrong.SLIGHTLY[name]
    biases = []
    for pair in map(case, ("exact", "exact infinite")):
        value = estimator(pair.problem_of(pair.exact_log()), pair.policy)
        biases.append(abs(value / pair.truth - 1.0))
    assert 2e-3 < max(biases) < 4e-2
    verdicts = check_estimator(estimator, claims=claims.split())
    assert verdicts.broken == ("exact",), verdicts
    assert verdicts.conclusion.startswith("broken laws: exact; to what share of the")


@pytest.mark.parametrize("name", wrong.SLIGHTLY)
def test_the_code_of_a_broken_law_evaluates_to_a_case_that_breaks_it(name):
    """The printed program is run as it stands."""
    estimator, claims = wrong.SLIGHTLY[name]
    verdict = check_estimator(estimator, claims=claims.split(), laws=["exact"])["exact"]
    made = {}
    exec(verdict.code, made)
    value = estimator(made["problem"], made["policy"])
    assert abs(value - made["truth"]) > 1e-3 * abs(made["truth"])
    told = [float(x) for x in re.findall(r"-?\d+(?:\.\d+)?", verdict.text)]
    assert min(abs(value - x) for x in told) < 1e-6 * abs(value)
    right = wrong.likely()(made["problem"], made["policy"])
    assert right == pytest.approx(made["truth"], rel=1e-9)
    assert len(verdict.code) < 12_000


@pytest.mark.parametrize("name", wrong.TABLE)
def test_the_code_of_every_broken_law_can_be_run(name):
    """Long logs are made anew, to the bit: the wrong value is that of the law."""
    estimator, claims, breaks = wrong.TABLE[name]
    laws = breaks.split()
    verdicts = check_estimator(estimator, claims=claims.split(), laws=laws)
    for law in verdicts.broken:
        made = {}
        exec(verdicts[law].code, made)
        assert np.isfinite(made["truth"])
        assert len(verdicts[law].code) < 12_000
        if law in ("scale", "shift", "relabelling", "padding", "exact"):
            value = as_estimator(estimator)(made["problem"], made["policy"], seed=0)
            told = [
                float(x) for x in re.findall(r"-?\d+(?:\.\d+)?", verdicts[law].text)
            ]
            assert min(abs(value.value - x) for x in told) < 1e-4


def test_the_code_of_a_shortened_case_with_a_long_log_makes_that_log():
    def biased(problem, policy):
        return 1.01 * wrong.Shrunk(0.5)(problem, policy).value

    verdict = check_estimator(biased, laws=["exact"])["exact"]
    assert ".exact_log()" in verdict.code
    made = {}
    exec(verdict.code, made)
    horizon = made["problem"].horizon
    assert f"already at horizon {horizon}" in verdict.text
    assert made["log"].timestep.max() + 1 in (horizon, horizon + 1)
    assert biased(made["problem"], made["policy"]) != pytest.approx(made["truth"], 1e-3)


def test_the_right_estimators_of_a_user_are_exact():
    """With a prior of their own, from counts and from the log's rows alone; with a
    tolerance that they declare; with rollouts, whose five standard errors are allowed.
    """
    assert check_estimator(wrong.likely(), laws=["exact"])["exact"].tolerance == 1e-6
    assert check_estimator(wrong.Shrunk(), laws=["exact"]).passed

    def of_rows(problem, policy):
        log = problem.log
        bare = oee.Transitions(log.state, log.action, log.next_state)
        return wrong.Shrunk()(
            oee.Problem(problem.simulator, bare, problem.horizon), policy
        ).value

    found = check_estimator(of_rows, laws=["exact"])["exact"]
    assert found.outcome == "holds"
    assert 1e-6 < found.tolerance < 0.01

    def roughly(problem, policy):
        return 1.0003 * wrong.likely()(problem, policy)

    assert check_estimator(roughly, laws=["exact"]).broken == ("exact",)
    assert check_estimator(roughly, laws=["exact"], tolerance=1e-3).passed
    roughly.tolerance = 1e-3
    verdicts = check_estimator(roughly, laws=["exact"])
    assert "exact 0.1%" in verdicts.conclusion
    roughly.tolerance = 0.0
    with pytest.raises(ValueError, match=r"function.tolerance must be in \(0, 1\)"):
        check_estimator(roughly)

    def drawn(problem, policy, seed):
        generator = np.random.default_rng(seed)
        return wrong.likely()(problem, policy) * (1 + 0.01 * generator.normal())

    claims = {"consistent", "random"}
    assert check_estimator(drawn, claims=claims, laws=["exact"]).passed
    off = lambda problem, policy, seed: 1.05 * drawn(problem, policy, seed)  # noqa: E731
    assert check_estimator(off, claims=claims, laws=["exact"]).broken == ("exact",)


@pytest.mark.parametrize("name", ["exact", "exact infinite", "exact partial"])
def test_an_exact_log_has_each_episode_as_often_as_it_is_probable(name):
    pair = case(name)
    log = pair.exact_log()
    assert list(log.columns()) == list(pair.log(5, seed=0).columns())
    counts = log.counts(pair.target.n_states, pair.target.n_actions).toarray()
    seen = counts.sum(axis=1) > 0
    np.testing.assert_array_equal(
        counts[seen] / counts[seen].sum(axis=1, keepdims=True),
        pair.target.transitions.toarray()[seen],
    )
    np.testing.assert_allclose(
        counts.sum(axis=1) / counts.sum(), pair.data_distribution.ravel(), atol=1e-15
    )
    returns = np.add.reduceat(
        log.reward * pair.target.discount**log.timestep, log.episode_starts[:-1]
    )
    assert returns.mean() == pytest.approx(
        oee.policy_value(pair.target, pair.behavior, horizon=pair.steps), rel=1e-12
    )
    assert len(pair.exact_log(3)) == 3 * len(log)


def test_a_case_without_an_exact_log_says_why():
    with pytest.raises(
        ValueError, match="pair must have at most 100000 equally likely"
    ):
        case("ragged").exact_log()
    pair = case("exact")
    with pytest.raises(
        ValueError, match=r"^copies must be at most [0-9]+: .* got 10+$"
    ):
        pair.exact_log(10**6)
    with pytest.raises(ValueError, match=r"^pair must .* it has about 10\^[0-9]+ "):
        dataclasses.replace(pair, steps=10**4).exact_log()
    odd = pair.behavior.copy()
    odd[0] = [1 / 3, 2 / 3]
    odd[1] = [1 / 67, 66 / 67]
    with pytest.raises(ValueError, match="behavior must be multiples of 1/D"):
        dataclasses.replace(pair, behavior=odd).exact_log()


def test_functions_are_estimators():
    """With a seed or without; a class or function that makes an estimator; what is said
    of floats.
    """
    right = wrong.sampling()
    with_seed = lambda problem, policy, *, seed: right(problem, policy)  # noqa: E731
    for function in (
        lambda problem, policy: right(problem, policy),
        with_seed,
        right,
        lambda: right,
    ):
        verdicts = check_estimator(function)
        assert verdicts.passed, verdicts
        assert (
            "floats, so that standard errors, intervals and statuses are skipped"
            in verdicts["well_formed"].text
        )
        assert verdicts["limit"].text == "it has no limit of its own"
    assert check_estimator(wrong.Shrunk).estimator == "Shrunk"
    seeds = []
    check_estimator(
        lambda problem, policy, seed: seeds.append(seed) or 0.0, laws=["seeds"]
    )
    assert seeds == [0, 1, 2, 3]


def raises(error):
    def estimator(problem, policy):
        raise error

    return estimator


def of(*values, **fields):
    return lambda problem, policy, *, seed=None: oee.Estimate(*values, **fields)


@pytest.mark.parametrize(
    ("estimator", "outcome", "said"),
    [
        (raises(KeyError("no such key")), "raises", "raises KeyError: 'no such key'"),
        (raises(SystemExit(3)), "raises", "raises SystemExit: 3"),
        (
            raises(ValueError("horizon must be 77")),
            "raises",
            "problems are refused: .*horizon must be 77",
        ),
        (
            raises(np.linalg.LinAlgError("Singular matrix")),
            "raises",
            "raises LinAlgError: Singular matrix",
        ),
        (
            lambda problem, policy: None,
            "fails",
            "an estimator must return a float or an Estimate; it returned NoneType",
        ),
        (
            lambda problem, policy: (1.0, 0.1),
            "fails",
            r"it returned tuple: Estimate\(value, standard_error\) holds both",
        ),
        (lambda problem, policy: np.ones(1), "fails", "it returned ndarray"),
        (lambda problem, policy: True, "fails", "it returned bool"),
        (
            lambda problem, policy: np.nan,
            "fails",
            'value must be finite where status is "ok"; it is nan',
        ),
        (
            of(1.0, -1.0),
            "fails",
            "standard_error must be None or a nonnegative number; it is -1.0",
        ),
        (of("high"), "raises", "value must be a number; got 'high'"),
        (of(1.0, status=None), "raises", "status must be "),
        (
            of(1.0, status=""),
            "fails",
            'status must be "ok" or say what is wrong; it is empty',
        ),
        (of(np.inf), "fails", "value must be finite where status is"),
        (of(1.0, interval=(2.0, 1.0)), "fails", "interval must be None or"),
        (of(1.0, diagnostics=None), "raises", "diagnostics must be a mapping"),
    ],
)
def test_whatever_an_estimator_does_is_a_verdict(estimator, outcome, said):
    verdicts = check_estimator(estimator)
    assert not verdicts.passed
    assert verdicts["well_formed"].outcome == outcome
    assert re.search(said, verdicts["well_formed"].text)
    assert {verdict.outcome for verdict in verdicts.values()} <= {
        "holds",
        "fails",
        "raises",
        "not claimed",
    }
    assert re.search(said, " ".join(str(verdicts).split()))


def test_an_estimator_that_has_nothing_to_say_fails_what_it_claims():
    verdicts = check_estimator(
        of(float("nan"), status="not today"), laws=["well_formed", "consistent"]
    )
    assert verdicts["well_formed"].outcome == "holds"
    assert (
        verdicts["consistent"].text
        == "ragged (horizon 6, discount 0.9): no value: status 'not today'"
    )


def test_a_user_s_estimator_passes():
    verdicts = check_estimator(wrong.Shrunk())
    assert verdicts.passed, verdicts
    assert verdicts["limit"].text == "it has no limit of its own"
    assert verdicts["padding"].outcome == "not claimed"
    first, second, *rows = str(verdicts).splitlines()
    assert first == "Shrunk: passed (12 laws hold, 0 broken, 4 not claimed; seed 0)"
    assert second == "claims: consistent, relabelling, scale, shift"
    assert re.search(r"^shift +holds +moves: ", "\n".join(rows), re.M)
    assert max(map(len, rows)) <= 120


def test_a_broken_law_says_where_and_how_to_see_it():
    estimator = wrong.TABLE["policy ignored"][0]
    verdict = check_estimator(estimator, laws=["consistent"])["consistent"]
    assert verdict.text.startswith("ragged (horizon 6, discount 0.9): mean ")
    example = (
        "pair = case('ragged'); estimator(pair.problem(4800, seed=0), pair.policy,"
        " seed=0) against 10.07"
    )
    assert verdict.example == example
    pair = case("ragged")
    assert abs(estimator(pair.problem(4800, seed=0), pair.policy) - pair.truth) > 1.0
    assert (
        abs(wrong.sampling()(pair.problem(4800, seed=0), pair.policy) - pair.truth)
        < 1.5
    )
    endless = check_estimator(
        estimator, laws=["consistent"], claims={"consistent", "infinite"}
    )["consistent"]
    assert endless.text.startswith("ragged infinite (no horizon, discount 0.8): mean ")


def test_where_claims_come_from():
    class Method:
        def claims(self):
            return ["finite"]

    class Mine(Simulator):
        """A subclass claims what its parent does, until it says otherwise."""

    assert claims_of(lambda problem, policy: None) == DEFAULT
    assert claims_of(wrong.Shrunk()) == wrong.Shrunk.claims
    assert claims_of(wrong.Shrunk(), {"unbiased"}) == {"unbiased"}
    assert "unbiased" in claims_of(ImportanceSampling()) - claims_of(
        ImportanceSampling(self_normalized=True)
    )
    assert claims_of(Method()) == {"finite"}
    assert claims_of(Mine()) == claims_of(Simulator()) > DEFAULT - {"consistent"}
    assert all(law.statement and law.claims <= set(CLAIMS) for law in LAWS.values())


def test_an_estimator_for_horizons_alone_is_not_asked_for_more():
    def short(problem, policy):
        if problem.horizon is None:
            raise ValueError("horizon must be given")
        return wrong.sampling()(problem, policy)

    verdicts = check_estimator(short, claims={"consistent", "finite"})
    assert verdicts.passed, verdicts
    assert check_estimator(short, claims={"consistent"}).broken


def test_relabelled_and_padded_logs():
    """Permutations in any form; names of states and actions stay theirs; every column
    that a log may have or lack.
    """
    log = case("ragged").log(3, seed=0)
    states = [1, 2, 3, 0]
    actions = [1, 0]
    new = relabelled_log(log, pd.Series(states), actions)
    # by position and by label it would be another permutation
    with pytest.raises(ValueError, match="states must be a plain array"):
        relabelled_log(log, pd.Series(states, index=[3, 2, 1, 0]), actions)
    assert new.state.tolist() == [states[s] for s in log.state]
    assert new.action.tolist() == [1 - a for a in log.action]
    assert new.reward.tolist() == log.reward.tolist()
    back = relabelled_log(new, np.argsort(states), np.array([1.0, 0.0]))
    for name, column in log.columns().items():
        np.testing.assert_array_equal(back.columns()[name], column)
    named = oee.Transitions(["hall", "roof"], ["up", "down"], ["roof", "hall"])
    assert relabelled_log(named, [1, 0], [1, 0]).columns()["state"].tolist() == [
        "hall",
        "roof",
    ]
    assert relabelled_log(
        oee.Transitions([0], [0], [2]), [2, 1, 0], [0]
    ).next_state.tolist() == [0]
    bare = oee.Transitions(
        [0, 1, 0], [0, 1, 0], [1, 0, 1], episode=[0, 0, 1], terminated=[0, 1, 0]
    )
    padded = padded_log(bare, [0, 1], 0.5)
    assert padded.state.tolist() == [0, 1, 0, 0, 0]
    assert padded.terminated.tolist() == [False, False, False, True, False]
    assert padded.episode.tolist() == [0, 0, 0, 0, 1]
    with pytest.raises(ValueError, match=r"^actions\[1\] must be at least 0; it is -1"):
        padded_log(bare, [0, -1], 0.5)


class Unclaimable:
    def __init__(self, claims):
        self.claims = claims

    def __call__(self, problem, policy, *, seed=None):
        return None


def raising():
    raise RuntimeError("later")


@pytest.mark.parametrize(
    ("claims", "text"),
    [
        (3, "must be a collection of words; got int"),
        (raising, "must be .*; it raises RuntimeError"),
        ([["shift"]], r"must be one of .*; got \['shift'\]"),
    ],
)
def test_claims_that_are_none(claims, text):
    with pytest.raises(ValueError, match=f"Unclaimable.claims {text}"):
        check_estimator(Unclaimable(claims))


def test_without_hypothesis_only_the_strategies_are_missing():
    script = """
import sys
sys.modules["hypothesis"] = None
import oee_tabular.testing as testing
from oee_tabular.estimators import Simulator
print(testing.check_estimator(Simulator(), laws=["support", "shift"]).passed)
try:
    testing.mdps
except ImportError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[0] == "True"
    assert done.stdout.splitlines()[1].endswith(
        "not installed; in a clone: pip install '.[testing]'"
    )
    assert set(testing.__all__) <= set(dir(testing))
