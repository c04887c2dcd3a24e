"""Each sentence of a report, with its numbers."""

import math

import pytest

from oee_tabular.report import text
from oee_tabular.report.text import Answer


def answer(**changes):
    usual = {
        "policy": "new", "estimator": "oee", "value": -6.41, "lower": -8.0, "upper": -5.0, "method": "likelihood",
        "simulator": -7.0, "simulator_error": None, "truth": None, "coverage": 0.9, "unrecorded": 0, "is_from_log": True,
    }  # fmt: skip
    return Answer(**usual | changes)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({},
         "In the target, the policy “new” is worth about −6.410 (95% interval: −8.000 to −5.000); the simulator says −7.000."),
        ({"lower": None, "upper": None}, "In the target, the policy “new” is worth about −6.410; the simulator says −7.000."),
        ({"simulator": None, "truth": -6.0},
         "In the target, the policy “new” is worth about −6.410 (95% interval: −8.000 to −5.000). The exact value, known here, "
         "is −6.000."),
        ({"simulator_error": 0.25},
         "In the target, the policy “new” is worth about −6.410 (95% interval: −8.000 to −5.000); the simulator says −7.000 "
         "(standard error 0.25, because it was sampled)."),
        ({"coverage": 0.17, "lower": -20.0, "upper": 5.0},
         "The log covers 17.0% of what the policy “new” does: between −20.00 and 5.00 (95% interval); the simulator says "
         "−7.00."),
        ({"coverage": 0.17, "lower": None, "upper": None, "simulator": None},
         "The log covers 17.0% of what the policy “new” does: about −6.410, without an interval."),
        ({"is_from_log": False, "lower": None, "upper": None}, "In the simulator, the policy “new” is worth about −6.410."),
    ],
)  # fmt: skip
def test_what_a_policy_is_worth(changes, sentence):
    assert text.policy_worth(answer(**changes), 0.95) == sentence


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (text.silent_log([answer(), answer(policy="b", coverage=0.2)]), "The log covers only 20.0% of what “b” does."),
        (text.silent_log([answer()]), ""),
        (text.best_policy("a", "b", 2, (0.25, 0.125, 0.5), 0.999, overlap=True),
         "Of 2 policies, “a” is worth most in the target. It is better than “b” by 0.2500 (99.9%: 0.1250 to 0.5000). The "
         "difference is known more precisely than either value because both rest on the same transitions."),
        (text.best_policy("a", "b", 2, (float("nan"), 0.0, 0.0), 0.95, overlap=True),
         "Of 2 policies, “a” is worth most in the target."),
        (text.no_best_policy(["a", "b"], 4, are_equal=False),
         "The log cannot say which of “a” and “b” is worth most in the target; the other 2 are worth less."),
        (text.no_best_policy(["a", "b", "c"], 4, are_equal=True),
         "“a”, “b” and “c” are worth the same in the target; the other 1 is worth less."),
        (text.pair_rejections(3, 40),
         "The data reject the simulator in 3 of the 40 recorded state-action pairs. In the others the log shows no significant "
         "difference."),
        (text.joint_rejection(24.51),
         "The data as a whole reject the simulator (z = 24.5), although no single state-action pair does. Transitions that the "
         "simulator calls likely are more frequent in the target."),
        (text.agreement(1),
         "The data show no significant difference from the simulator in the one recorded state-action pair. A short log cannot "
         "show a small one."),
        (text.worst_case(1, 0.003, dropped=False),
         "The interval allows any outcome in 1 unrecorded pair (0.3% of the policy's time)."),
        (text.worst_case(4, 0.25, dropped=True),
         "The interval allows any outcome in 4 unrecorded pairs (25.0% of the policy's time). "
         "It lets dropped transitions lead anywhere."),
        (text.worst_case(0, 0.0, dropped=False), ""),
        (text.sampling_interval(-2.0, 1.0, unrecorded=3),
         "If such pairs behave as estimated, the interval is −2.000 to 1.000."),
        (text.sampling_interval(-2.0, 1.0, unrecorded=0), "Without these transitions, the interval is −2.000 to 1.000."),
        (text.legend("one-step", ["oee", "mine"], 0.9),
         "90% interval of oee, mine (one-step): value ± normal quantile × standard error. An unrecorded pair has the variance "
         "of one transition."),
        (text.omissions(0, 0), ""),
        (text.omissions(2, 1),
         "2 more notes with --verbose and 1 more row with --all (in Python: to_text(verbose=True, all=True))."),
    ],
)  # fmt: skip
def test_sentences(made, sentence):
    assert made == sentence


def test_numbers():
    numbers = [text.format_number(x) for x in (-0.5, 0.0, 1234.5678, 1e-30, math.inf, None, math.nan)]
    assert numbers == ["−0.5000", "0", "1235", "1.000e−30", "inf", "–", "no value"]
    assert [text.format_interval(*ends) for ends in ((-1.0, 2.0), (None, 1.0))] == ["−1.000 to 2.000", "–"]
    assert [text.format_level(x) for x in (0.95, 0.999, 0.9)] == ["95%", "99.9%", "90%"]
    assert [text.count(n, "pair") for n in (0, 1, 1234)] == ["0 pairs", "1 pair", "1,234 pairs"]
    assert text.format_value(-0.123456, -1.0, 1.0) == "−0.123"
