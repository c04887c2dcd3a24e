"""What a report holds: rows, notes, JSON and files; the estimators and policies that it
takes.
"""

import json
import math
import re
from dataclasses import replace
from typing import get_args

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators import Estimate, OffEnvironment, Problem
from oee_tabular.estimators.findings import NEVER_VARIED
from oee_tabular.estimators.names import ALIASES, NAMED, EstimatorName
from oee_tabular.report import columns, text
from oee_tabular.report.text import Answer

SMALL = oee.tasks.gridworld(3, 0.3)
TARGET = oee.tasks.gridworld(4, 0.1)
UNIFORM = oee.uniform_policy(SMALL)
POLICIES = {
    "cautious": oee.tasks.gridworld_policy(4, 0.2),
    "bold": oee.tasks.gridworld_policy(4, 0.9),
}


@pytest.fixture(scope="module")
def problem():
    log = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 30, 40, seed=0)
    return Problem(oee.tasks.gridworld(4, 0.3), log, horizon=40)


@pytest.fixture(scope="module")
def report(problem):
    return oee.evaluate(problem, POLICIES, seed=0)


def returning(*args, **options):
    """An estimator that returns the same estimate always."""
    return lambda problem, policy, *, seed=None: Estimate(*args, **options)


def test_the_table_has_every_policy_and_estimator(problem, report):
    assert list(report.table["estimator"].unique()) == [
        "simulator",
        "oee",
        "model-based",
        "pdis",
        "wpdis",
    ]
    assert len(report.table) == 10
    row = report.table.query("policy == 'bold' and estimator == 'oee'").iloc[0]
    assert row["value"] == OffEnvironment()(problem, POLICIES["bold"]).value
    sure = oee.interval(problem, POLICIES["bold"])
    assert (row["lower"], row["upper"], row["interval_method"]) == (
        sure.lower,
        sure.upper,
        "likelihood",
    )
    row = report.table.query("policy == 'bold' and estimator == 'pdis'").iloc[0]
    assert_allclose(
        row["upper"] - row["lower"],
        2 * 1.959963984540054 * row["standard_error"],
        rtol=1e-12,
    )
    assert row["interval_method"] == "standard error"


def test_text_names_unit_truth_and_errors(problem):
    report = oee.evaluate(
        problem, POLICIES, seed=0, normalized=True, target=TARGET, confidence=0.9
    )
    text = report.to_text(verbose=True)
    assert (
        "Value: (1 - discount) * sum of discount^t * reward over t = 0..39, discount"
        " 0.99" in text
    )
    truth = oee.policy_value(TARGET, POLICIES["bold"], horizon=40, normalized=True)
    row = report.table.query("policy == 'bold' and estimator == 'simulator'").iloc[0]
    assert_allclose(row["error"], row["value"] - truth, rtol=1e-12)
    short = ["policy", "value", "90% interval", "simulator says", "P(best)"]
    short += ["below the top row by", "exact value"]
    long = [
        "policy",
        "estimator",
        "value",
        "90% interval",
        "std. error",
        "error",
        "eff. n",
        "coverage",
        "max weight",
        "row-sum err.",
        "note",
    ]
    for titles, verbose in ((short, False), (long, True)):
        assert "\n" + " ".join(titles) in "\n".join(
            " ".join(line.split())
            for line in report.to_text(verbose=verbose).split("\n")
        )


def test_the_same_seed_gives_the_same_report_whatever_else_is_asked_for(problem):
    product = OffEnvironment(evaluation="monte_carlo")
    one, two = (
        oee.evaluate(problem, POLICIES, estimators={"a": product, "b": product}, seed=5)
        for _ in range(2)
    )
    pd.testing.assert_frame_equal(one.table, two.table)
    assert one.table["value"].nunique() == 4
    alone = oee.evaluate(problem, POLICIES, estimators={"a": product}, seed=5)
    assert alone.table["value"][0] == one.table["value"][0]


def test_json_is_strict_and_complete(problem):
    broken = returning(math.nan, status="the sensor was off")
    report = oee.evaluate(
        problem,
        POLICIES,
        estimators={"broken": broken, "oee": OffEnvironment()},
        seed=1,
    )
    loaded = json.loads(report.to_json(), parse_constant=lambda word: pytest.fail(word))
    keys = (
        "version answer unit discount horizon normalized confidence interval seed facts"
        " results intervals best comparison trials"
    )
    assert " ".join(loaded) == f"{keys} conclusion warnings"
    assert (loaded["results"][0]["value"], loaded["results"][0]["status"]) == (
        None,
        "the sensor was off",
    )
    assert (loaded["horizon"], loaded["seed"]) == (40, 1)
    assert any(
        "no value: the sensor was off" in warning for warning in loaded["warnings"]
    )


def test_warnings_say_what_the_numbers_do_not():
    log = oee.sample_episodes(TARGET, oee.tasks.gridworld_expert(4), 4, 30, seed=0)
    simulator = oee.tasks.gridworld(4, 0.3)
    report = oee.evaluate(
        Problem(simulator, log, horizon=60), oee.uniform_policy(simulator), seed=0
    )
    text = "\n".join(report.warnings)
    assert re.search(
        r"model-based \(policy\): \d+% of the policy's discounted time", text
    )
    # of the default, this is said beside the interval
    assert "state-action pairs were never recorded, and the policy" in report.headline
    assert "never recorded" not in report.brief
    assert not re.search(r"oee \(policy\): \d+% of the policy's discounted time", text)
    assert "the effective sample size is" in text
    assert report.notes["policy", "model-based"]
    assert not report.notes["policy", "simulator"]


def test_reward_conflicts_are_noted_with_the_remedy_on_every_value_that_a_model_gives():
    log = oee.sample_episodes(SMALL, UNIFORM, 20, 30, seed=0)
    paid = oee.Transitions(**(log.columns() | {"reward": log.reward + 1.0}))
    report = oee.evaluate(Problem(SMALL, paid, horizon=20), UNIFORM)
    assert (
        f"The log's rewards contradict the simulator's in {len(log)} of {len(log)}"
        " transitions" in report.warnings[0]
    )
    assert 'rewards="log" (--rewards log) uses those of the log' in report.warnings[0]
    assert report.headline.startswith(
        "The log's rewards contradict the simulator's in "
    )
    assert [
        report.notes["policy", name][:1] for name in ("simulator", "oee", "model-based")
    ] == [(1,)] * 3
    assert 1 not in report.notes["policy", "pdis"]
    assert json.loads(report.to_json())["results"][0]["notes"] == [1]
    settled = oee.evaluate(Problem(SMALL, paid, horizon=20, rewards="log"), UNIFORM)
    assert "use the log's mean" in settled.warnings[0]
    assert all(1 not in notes for notes in settled.notes.values())
    assert settled.headline.startswith("In the target")


PAID = np.random.default_rng(0).normal(size=(SMALL.n_states, 4))


def evaluated(change, scale=1.0):
    """The headline and warnings of a log whose rewards are changed."""
    pay = scale * PAID * ~SMALL.absorbing()[:, None]
    simulator = SMALL.with_rewards(pay)
    log = oee.sample_episodes(simulator, UNIFORM, 40, 30, seed=0)
    log = oee.Transitions(**(log.columns() | {"reward": change(log.reward)}))
    report = oee.evaluate(
        Problem(simulator, log, horizon=30), UNIFORM, estimators=["oee", "simulator"]
    )
    return report, [text for text in report.warnings if "rewards" in text]


@pytest.mark.parametrize(
    ("change", "scale"),
    [
        (lambda r: np.round(r, 2), 1.0),
        (lambda r: np.round(r, 3), 1.0),
        (lambda r: np.round(r, 4), 0.1),
        (np.round, 300.0),  # in cents
    ],
)
def test_rounded_rewards_are_a_note_with_their_effect(change, scale):
    report, notes = evaluated(change, scale)
    assert report.headline.startswith("In the target")
    assert re.search(
        r"^The log's rewards are rounded from the simulator's in \d+ of \d+ transitions"
        r" \(.* is [\d.-]+ in the log, [\d.-]+ in the simulator\)\. In the simulator"
        r" they change the value by [\de.-]+\. ",
        notes[0],
    )
    assert not any(1 in numbers for numbers in report.notes.values())


@pytest.mark.parametrize(
    "change",
    [
        np.float32,
        np.float16,
        lambda r: np.trunc(1000 * r) / 1000,
        lambda r: r + 1e-5,
    ],
)
def test_rewards_whose_effect_is_small_are_not_in_the_headline(change):
    report, notes = evaluated(change)
    assert report.headline.startswith("In the target")
    assert all("In the simulator they change the value by" in text for text in notes)


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r + 0.5,
        lambda r: -r,
        lambda r: np.round(r),  # an effect of its own
        lambda r: 10 * r,
    ],
)
def test_rewards_that_matter_stay_in_the_headline(change):
    report, notes = evaluated(change)
    assert report.headline.startswith("The log's rewards contradict the simulator's in")
    assert "they change the value by" in notes[0]


def test_saving_writes_all_or_nothing(problem, report, tmp_path, monkeypatch):
    written = report.save(tmp_path / "a" / "b")
    assert sorted(path.name for path in written) == [
        "report.json",
        "table.csv",
        "values.pdf",
        "values.png",
        "values.svg",
    ]
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == [
        "report.json",
        "table.csv",
        "values.pdf",
        "values.png",
        "values.svg",
    ]
    assert (tmp_path / "a" / "b" / "values.png").read_bytes().startswith(b"\x89PNG")
    again = oee.evaluate(problem, POLICIES, seed=0).save(tmp_path / "c")
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in written]
    (tmp_path / "file").write_text("")
    with pytest.raises(
        ValueError,
        match=r"folder must be a folder that can be written; '.*file' is a file",
    ):
        report.save(tmp_path / "file" / "below")

    calls = iter(range(9))

    def fail(number):
        if next(calls) == 1:  # the second file
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("oee_tabular._files.os.fsync", fail)
    with pytest.raises(OSError, match="No space"):
        report.save(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_policies_may_be_one_array_a_list_or_a_mapping(problem):
    bold = POLICIES["bold"]
    cautious = POLICIES["cautious"]
    one = oee.evaluate(problem, bold, estimators="oee")
    several = oee.evaluate(problem, [bold, cautious], estimators=["oee"])
    assert list(one.table["policy"]) == ["policy"]
    assert list(several.table["policy"]) == ["policy 0", "policy 1"]
    assert one.table["value"][0] == several.table["value"][0]


def test_a_user_s_own_estimators_their_names_and_intervals(problem):
    class Constant:
        def __call__(self, problem, policy, *, seed=None):
            return Estimate(1.5, 0.5)

    found = oee.evaluate(
        problem, POLICIES["bold"], estimators=["oee", Constant(), Constant()]
    )
    assert list(found.table["estimator"]) == ["oee", "Constant", "Constant'"]
    assert found.results[1].estimate.interval == pytest.approx((0.52, 2.48), abs=1e-3)
    own = {"own": returning(1.0, 0.5, (0.0, 3.0), findings=(NEVER_VARIED,))}
    found = oee.evaluate(problem, POLICIES["bold"], estimators=own, confidence=0.99)
    # it stays, and what explains its lack is not said
    assert found.results[0].estimate.interval == (0.0, 3.0)
    assert found.records()[0]["interval_method"] == "the estimator's own"
    assert found.warnings == ()


def test_the_corrected_value_stands_first_and_the_simulator_s_last(problem):
    every = {
        "alone": returning(1.0, is_from_log=False),
        "other": returning(2.0),
        "lost": returning(math.nan, model_value=3.0),
        "corrected": returning(3.0, model_value=3.0),
    }

    def first(*names):
        chosen = {name: every[name] for name in names}
        return (
            oee.evaluate(problem, POLICIES["bold"], estimators=chosen)
            .answers[0]
            .estimator
        )

    assert first(*every) == "corrected"
    assert first("alone", "other", "lost") == "other"
    assert first("alone", "lost") == "alone"


def test_one_divergent_value_does_not_end_the_report():
    """At discount 1 the fallback of the model stays for ever where it pays; the others
    have values.
    """
    transitions = np.array([[[0.0, 0.5, 0.5]], [[0.5, 0.0, 0.5]], [[0.0, 0.0, 1.0]]])
    simulator = oee.FiniteMDP(transitions, [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], 1.0)
    log = oee.Transitions([0, 0], [0, 0], [1, 2], [1.0, 1.0])
    report = oee.evaluate(Problem(simulator, log), np.ones((3, 1)))
    values = dict(zip(report.table["estimator"], report.table["value"], strict=True))
    assert np.isfinite([values["simulator"], values["oee"]]).all()
    assert np.isnan(values["model-based"])
    text = "\n".join(report.warnings)
    assert "model-based (policy): no value: horizon must be given" in text
    assert (
        "it stays for ever among states of which s=1 has reward 1 (1 such states in"
        " all)" in text
    )
    named = oee.evaluate(
        Problem(simulator.with_names(["hall", "ramp", "dock"]), log), np.ones((3, 1))
    )
    assert "among states of which s=ramp has reward 1" in "\n".join(named.warnings)
    # of 2 steps 2 / 3 in state 1
    assert (
        "oee (policy): 33% of the policy's discounted time is in state-action" in text
    )
    assert report.results[1].estimate.interval is not None


def test_advice_stands_once_and_a_wrong_behaviour_policy_has_a_warning():
    policies = {"a": UNIFORM, "b": oee.tasks.gridworld_policy(3, 0.5)}
    text = str(
        oee.evaluate(
            Problem(SMALL, oee.Transitions([0], [0], [3])), policies, estimators="oee"
        )
    )
    assert text.count("Record action ") + text.count(", record action ") == 1
    log = oee.sample_episodes(SMALL, oee.tasks.gridworld_policy(3, 0.4), 10, 20, seed=0)
    warnings = oee.evaluate(
        Problem(SMALL, log, behavior_policy=UNIFORM), UNIFORM
    ).warnings
    assert any(
        f"differ from behavior_policy in {len(log)} transitions" in text
        for text in warnings
    )


# ---- each sentence of a report, with its numbers
def answer(**changes):
    usual = {
        "policy": "new",
        "estimator": "oee",
        "value": -6.41,
        "lower": -8.0,
        "upper": -5.0,
        "method": "likelihood",
        "simulator": -7.0,
        "simulator_error": None,
        "truth": None,
        "coverage": 0.9,
        "unrecorded": 0,
        "assumption": "",
        "is_inner": False,
        "is_from_log": True,
    }
    return Answer(**usual | changes)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {},
            (
                "In the target, the policy “new” is worth about −6.4 (95% interval:"
                " −8.0 to −5.0); the simulator says −7.0."
            ),
        ),
        (
            {"lower": None, "upper": None},
            (
                "In the target, the policy “new” is worth about −6.410; the simulator"
                " says −7.000."
            ),
        ),
        (
            {"simulator": None, "truth": -6.0},
            (
                "In the target, the policy “new” is worth about −6.4 (95% interval:"
                " −8.0 to −5.0). The exact value, known here, is −6.000."
            ),
        ),
        (
            {"simulator_error": 0.25},
            (
                "In the target, the policy “new” is worth about −6.4 (95% interval:"
                " −8.0 to −5.0); the simulator says −7.0 (standard error 0.25,"
                " because it was sampled)."
            ),
        ),
        (
            {"coverage": 0.17, "lower": -20.0, "upper": 5.0},
            (
                "The log covers only 17.0% of what the policy “new” does, so its value in"
                " the target is known only to be between −20 and 5 (95% interval); the"
                " simulator says −7."
            ),
        ),
        (
            {"coverage": 0.17, "lower": None, "upper": None, "simulator": None},
            (
                "The log covers only 17.0% of what the policy “new” does, so its value in"
                " the target, about −6.410, has no interval."
            ),
        ),
        (
            {"is_inner": True, "assumption": "The interval lets one differ."},
            (
                "In the target, the policy “new” is worth about −6.4 (inner bounds of"
                " the 95% interval: −8.0 to −5.0); the simulator says −7.0. The interval"
                " lets one differ."
            ),
        ),
        (
            {"is_from_log": False, "lower": None, "upper": None},
            "In the simulator, the policy “new” is worth about −6.410.",
        ),
    ],
)
def test_what_a_policy_is_worth(changes, sentence):
    assert text.policy_worth(answer(**changes), 0.95) == sentence


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (
            text.silent_log([answer(), answer(policy="b", coverage=0.2)]),
            "The log covers only 20.0% of what “b” does.",
        ),
        (text.silent_log([answer()]), ""),
        (
            text.best_policy("a", "b", 2, (0.25, 0.125, 0.5), 0.999, overlap=True),
            (
                "Of 2 policies, “a” is worth most in the target. It is better than “b”"
                " by 0.25 (99.9%: 0.12 to 0.50). The difference is known more"
                " precisely than either value because both rest on the same"
                " transitions."
            ),
        ),
        (
            text.best_policy("a", "b", 2, (float("nan"), 0.0, 0.0), 0.95, overlap=True),
            "Of 2 policies, “a” is worth most in the target.",
        ),
        (
            text.no_best_policy(["a", "b"], 4, are_equal=False),
            (
                "The log cannot say which of “a” and “b” is worth most in the target;"
                " the other 2 are worth less."
            ),
        ),
        (
            text.no_best_policy(["a", "b", "c"], 4, are_equal=True),
            (
                "“a”, “b” and “c” are worth the same in the target; the other 1 is"
                " worth less."
            ),
        ),
        (
            text.verdict_on_simulator(-29.04, 1, 739, is_rejected=True),
            (
                "The target differs from the simulator: what the simulator calls likely"
                " happens less often than it says (z = -29.0 standard deviations, over"
                " all recorded transitions together). 1 of the 739 tested state-action pairs differs"
                " surely by itself."
            ),
        ),
        (
            text.verdict_on_simulator(24.51, 0, 1200, is_rejected=True),
            (
                "The target differs from the simulator: what the simulator calls likely"
                " happens even more often than it says (z = 24.5 standard deviations,"
                " over all recorded transitions together). No single one of the 1,200 tested"
                " state-action pairs has enough transitions to show it by itself, in a"
                " test that allows for looking at all of them."
            ),
        ),
        (
            text.verdict_on_simulator(24.51, 6, 6, is_rejected=True).split("). ")[1],
            "Each of the 6 tested state-action pairs differs surely by itself.",
        ),
        (
            text.verdict_on_simulator(24.51, 1, 1, is_rejected=True).split("). ")[1],
            "All are of one state-action pair.",
        ),
        (
            text.verdict_on_simulator(0.52, 3, 40, is_rejected=False),
            (
                "The target differs from the simulator: 3 of the 40 tested state-action"
                " pairs show it. Over the whole log, outcomes that are likely in the"
                " simulator are about as frequent as it says (z = 0.5), where"
                " differences in opposite directions may cancel."
            ),
        ),
        (
            text.verdict_on_simulator(0.52, 1, 40, is_rejected=False).split(". ")[0],
            (
                "The target differs from the simulator: 1 of the 40 tested state-action"
                " pairs shows it"
            ),
        ),
        (
            text.verdict_on_simulator(-1.2, 0, 40, is_rejected=False),
            (
                "The data show no significant difference from the simulator in the 40"
                " tested state-action pairs, neither together (z = -1.2) nor one by"
                " one. A short log cannot show a small one."
            ),
        ),
        (
            text.verdict_on_simulator(0.0, 0, 1, is_rejected=False),
            (
                "The data show no significant difference from the simulator in the one"
                " tested state-action pair (z = 0.0). A short log cannot show a small"
                " one."
            ),
        ),
        (
            text.verdict_on_simulator(
                0.0, 0, 1, is_rejected=False, left_out=["mine", "b"]
            ),
            (
                "The simulator's value lies outside the intervals of “mine” and “b”,"
                " which suggests that the target differs. Go by the interval: it adds up"
                " what small differences do to the value, and the tests do not see them"
                " (the one tested state-action pair does not differ significantly, z ="
                " 0.0)."
            ),
        ),
        (
            text.distance_from_simulator(-9.53, -1.1, -8.43, 0.0),
            (
                "The corrected simulator's value differs from the simulator's by −9.5:"
                " −1.1 comes from pairs that reject the simulator one by one, −8.4 from"
                " other recorded pairs, 0 from pairs that were never recorded."
            ),
        ),
        (
            text.assumption(3.0, 6, 0.06, (-45.2, -31.1), (-173.2, -31.7)),
            (
                "6 state-action pairs were never recorded, and the policy spends 6.0% of"
                " its time in them. The interval assumes that their probabilities are"
                " within a factor of three of the estimated ones. If they are as"
                " estimated, it is −45 to −31; if they can be anything, −173 to −32."
            ),
        ),
        (
            text.assumption(1.0, 1, None, None, (-2.0, 1.0)),
            (
                "One state-action pair was never recorded. The interval takes its"
                " probabilities as estimated. If they can be anything, it is −2.0 to"
                " 1.0."
            ),
        ),
        (
            text.assumption(math.inf, 1200, 0.5, (-2.0, 1.0), None, has_box=True),
            (
                "1,200 state-action pairs were never recorded, and the policy spends"
                " 50.0% of its time in them. The interval lets their probabilities be"
                " anything that the box allows. If they are as estimated, it is −2.0 to"
                " 1.0."
            ),
        ),
        (
            text.assumption(2.5, 2, 0.02, None, None),
            (
                "2 state-action pairs were never recorded, and the policy spends 2.0% of"
                " its time in them. The interval assumes that their probabilities are"
                " within a factor of 2.5 of the estimated ones."
            ),
        ),
        (
            text.without_dropped(-2.0, 1.0),
            (
                "The interval lets dropped transitions lead anywhere; without them it is"
                " −2.0 to 1.0."
            ),
        ),
        (
            text.legend("one-step", ["oee", "mine"], 0.9),
            (
                "90% interval of oee, mine (one-step): value ± normal quantile ×"
                " standard error. An unrecorded pair has the variance of one"
                " transition."
            ),
        ),
        (text.omissions(0), ""),
        (text.omissions(1), "1 more row with --all (in Python: to_text(all=True))."),
        (text.left_out(0, 0, 0), ""),
        (
            text.left_out(1, 0, 0),
            (
                "Not shown: 1 less important note (--verbose); in Python:"
                " report.to_text(verbose=True)."
            ),
        ),
        (
            text.left_out(5, 9, 6),
            (
                "Not shown: 5 less important notes and a table of 9 rows by estimator"
                " (--verbose); 6 rows of other estimators (--all); in Python:"
                " report.to_text(verbose=True, all=True)."
            ),
        ),
        (text.provenance((None, None), (None, None)), ""),
        (
            text.provenance((3162, 100), ("log.csv", None)),
            (
                "Made from the log that was recorded in the target (log.csv, 3,162"
                " transitions) and the simulator (100 states)."
            ),
        ),
        (
            text.provenance((9, 3), (None, None), {"a": 1}),
            (
                "Made from the log that was recorded in the target (9 transitions), the"
                " simulator (3 states) and 1 trial of “a”."
            ),
        ),
        (
            text.provenance((None, None), (None, "b"), {"a": 1200, "c": 3}),
            "Made from the simulator (b) and 1,203 trials (1,200 of “a”, 3 of “c”).",
        ),
        (
            text.contradiction("a", (0.02, 0.21), (0.9999955, 1.0000026), 1e-9, 0.01),
            (
                "The trials of “a” and the log contradict each other (p < 0.0001, below"
                " 0.01): the trials say 0.02 to 0.21, the log says 1.00. One of them may"
                " be of another target, of other first states or of another policy. Find"
                " out which one before either is used."
            ),
        ),
    ],
)
def test_sentences(made, sentence):
    assert made == sentence


@pytest.mark.parametrize(
    ("probability", "shown"),
    [
        (1.0, "> 99.9%"),
        (0.9996, "> 99.9%"),
        (0.9994, "99.9%"),
        (0.421, "42.1%"),
        (0.0006, "0.1%"),
        (0.0004, "< 0.1%"),
        (0.0, "< 0.1%"),
        (None, "-"),
    ],
)
def test_no_p_best_reads_as_certain(probability, shown):
    assert columns.write_p_best({"probability_best": probability}) == shown


def test_numbers():
    numbers = [
        text.format_number(x)
        for x in (-0.5, 0.0, 1234.5678, 1e-30, math.inf, None, math.nan)
    ]
    assert numbers == ["−0.5000", "0", "1235", "1.000e−30", "inf", "–", "no value"]
    assert [text.format_interval(*ends) for ends in ((-1.0, 2.0), (None, 1.0))] == [
        "−1.0 to 2.0",
        "–",
    ]
    assert [text.format_level(x) for x in (0.95, 0.999, 0.9)] == ["95%", "99.9%", "90%"]
    assert [text.count(n, "pair") for n in (0, 1, 1234)] == [
        "0 pairs",
        "1 pair",
        "1,234 pairs",
    ]
    assert text.format_value(-0.123456, -1.0, 1.0) == "−0.1"
    assert text.format_value(-0.123456, -0.14, -0.09) == "−0.123"


def test_the_names_that_type_checkers_know_are_those_that_evaluate_takes():
    assert get_args(EstimatorName) == (*NAMED, *ALIASES)


# ---- random streams

SAMPLERS = {
    "rollouts": OffEnvironment(evaluation="monte_carlo", n_rollouts=20),
    "oracle": oee.estimators.Oracle(TARGET, evaluation="monte_carlo", n_rollouts=20),
    "ratio of ratios": OffEnvironment("ratio_of_ratios"),
    "robust rollouts": oee.estimators.DoublyRobust(data="rollouts", n_rollouts=20),
    "blend": oee.estimators.Magic(n_bootstrap=10),
}
THREE = {**POLICIES, "random": oee.uniform_policy(TARGET)}


def rows_by_name(problem, policies, estimators, seed=5):
    report = oee.evaluate(
        problem, policies, estimators=estimators, seed=seed, quick=True
    )
    return {
        (row.policy, row.estimator): (row.estimate.value, row.estimate.standard_error)
        for row in report.results
    }


def test_a_random_stream_is_that_of_the_names_and_not_of_the_place(problem):
    plain = rows_by_name(problem, THREE, SAMPLERS)
    assert len({value for value, _ in plain.values()}) == len(plain)
    backward = rows_by_name(
        problem, dict(reversed(THREE.items())), dict(reversed(SAMPLERS.items()))
    )
    assert backward == plain
    for name, policy in THREE.items():
        for label, estimator in SAMPLERS.items():
            alone = rows_by_name(problem, {name: policy}, {label: estimator})
            assert alone == {(name, label): plain[name, label]}


def test_another_name_or_seed_is_another_stream(problem):
    bold = POLICIES["bold"]
    sampler = {"rollouts": SAMPLERS["rollouts"]}
    values = [
        rows_by_name(problem, {name: bold}, sampler, seed)[name, "rollouts"]
        for name, seed in [
            ("bold", 5),
            ("bold ", 5),
            ("bøld", 5),
            ("", 5),
            ("bold", 6),
            ("bold", [5, 6]),
        ]
    ]
    assert len(set(values)) == len(values)
    # a name and a label do not run together
    labels = {"b": SAMPLERS["rollouts"], "ab": SAMPLERS["rollouts"]}
    found = rows_by_name(problem, {"a": bold, "": bold}, labels)
    assert found["a", "b"] != found["", "ab"]


def test_policies_without_a_name_have_the_stream_of_the_name_that_is_shown(problem):
    bold, cautious = POLICIES["bold"], POLICIES["cautious"]
    sampler = {"rollouts": SAMPLERS["rollouts"]}
    one = rows_by_name(problem, bold, sampler)
    assert one == rows_by_name(problem, {"policy": bold}, sampler)
    two = rows_by_name(problem, [bold, cautious], sampler)
    names = {"policy 1": cautious, "policy 0": bold}
    assert two == rows_by_name(problem, names, sampler)


def test_the_order_of_policies_changes_no_number_of_a_contest(problem):
    one, two = (
        oee.report.contest(problem, policies)
        for policies in (THREE, dict(reversed(THREE.items())))
    )
    assert one.comparison() == two.comparison()
    assert one.headline == two.headline


def test_facts_of_any_kind_are_written(report, tmp_path):
    """Arrays as lists, and what JSON does not hold as a text."""
    facts = {"shape": np.arange(3), "rows": sparse.eye_array(3), "empty": np.zeros(0)}
    told = replace(report, facts={**report.facts, **facts})
    assert "[0, 1, 2]" in told.to_html()
    told.save(tmp_path)
    written = json.loads((tmp_path / "report.json").read_text())["facts"]
    assert written["shape"] == [0, 1, 2]
    assert "(3, 3)" in written["rows"]


@pytest.mark.parametrize("odd", ["text", [1, "b"], {"a": 1}, None, math.nan, 3.5, True])
@pytest.mark.parametrize(
    "names",
    [
        ["task", "transitions", "source"],
        ["policy_names"],
        ["policy_names", "simulator_name"],
        ["policy_names", "simulator_name", "log_name"],
        ["policy_names", "simulator_name", "log_files", "column_options"],
        ["simulator_name", "action_noise"],
    ],
)
def test_facts_of_a_user_s_own_are_no_facts_of_the_package(odd, names):
    """Whatever a user calls them, and of whatever form they are."""
    if "action_noise" in names:
        facts = {"simulator_name": odd, "action_noise": 0.1}
    else:
        facts = dict.fromkeys(names, odd)
    pair = oee.testing.case("ragged")
    report = oee.evaluate(
        pair.problem(100, seed=0), pair.policy, estimators="oee", facts=facts, seed=0
    )
    text = report.to_text()
    report.to_text(verbose=True)
    assert {name: report.facts[name] for name in names} == facts or odd != odd
    if names[0] == "task":
        assert "(4 states)" in " ".join(text.split())
