"""The short report: the answer, one table, three notes, and what is left out."""

import re

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.findings import Finding, no_value
from oee_tabular.report import render_comparison
from oee_tabular.report.columns import write_basis
from oee_tabular.report.notes import RANKS, Rank, rank_notes

SIMULATOR = oee.tasks.gridworld(5, 0.3)
TARGET = oee.tasks.gridworld(5, 0.1)
EXPERT = oee.tasks.gridworld_expert(5)
UNIFORM = oee.uniform_policy(SIMULATOR)
LOG = oee.sample_episodes(TARGET, oee.mix(EXPERT, UNIFORM, 0.5), 40, 25, seed=3)
FEW = oee.sample_episodes(TARGET, UNIFORM, 2, 10, seed=1)
THREE = {"expert": EXPERT, "any": UNIFORM, "half": oee.mix(EXPERT, UNIFORM, 0.5)}


def trials_of(returns):
    return oee.Trials(np.array(returns))


REPORTS = {
    "one policy": lambda: oee.evaluate(Problem(SIMULATOR, LOG), EXPERT, seed=0),
    "few": lambda: oee.evaluate(Problem(SIMULATOR, FEW), EXPERT, seed=0),
    "three": lambda: oee.evaluate(Problem(SIMULATOR, LOG), THREE, seed=0),
    "contest": lambda: oee.report.contest(Problem(SIMULATOR, LOG), THREE),
    "own": lambda: oee.evaluate(
        Problem(SIMULATOR, LOG),
        THREE,
        estimators={"mine": lambda problem, policy: Estimate(1.0, 0.5)},
    ),
    "trials": lambda: oee.evaluate(
        Problem(SIMULATOR, LOG, trials=trials_of([-39.0, -41.0, -40.0, -42.0])), EXPERT
    ),
    "horizon": lambda: oee.evaluate(
        Problem(SIMULATOR, LOG, horizon=20), THREE, target=TARGET, normalized=True
    ),
}


@pytest.mark.parametrize("name", REPORTS)
def test_a_short_report_has_four_parts_and_loses_nothing(name):
    report = REPORTS[name]()
    answer, table, *notes, last = report.to_text().split("\n\n")
    assert str(report) == report.to_text()
    assert " ".join(answer.split()) == report.brief
    assert len(table.splitlines()) >= 2
    marks = re.findall(r"^(\[\d\]|-) ", "\n".join(notes), re.M)
    numbers = [mark for mark in marks if mark != "-"]
    # a number stands at a row of the table, and a note without rows has none
    assert numbers == [f"[{k + 1}]" for k in range(len(numbers))]
    assert sorted(numbers) == sorted(set(re.findall(r"\[\d\](?!,)", table)))
    assert len(marks) <= 3
    assert last.startswith("Made from the log that was recorded in the target (")
    every = rank_notes(report)
    more = len(every) - len(marks)
    told = " ".join(last.split())
    assert f"{more} less important note{'' if more == 1 else 's'}" in told
    whole = " ".join(report.to_text(verbose=True, all=True).split())
    for note in every:
        assert " ".join(note.text.split()) in whole


def test_the_long_comparison_has_every_note():
    report = REPORTS["contest"]()
    whole = " ".join(render_comparison(report, verbose=True).split())
    for note in rank_notes(report):
        assert " ".join(note.text.split()) in whole
    short = render_comparison(report, verbose=False)
    assert short == report.to_text()
    assert re.search(r"Not shown: \d+ less important notes?", short)


def test_every_warning_has_the_kind_of_its_finding():
    for make in REPORTS.values():
        report = make()
        assert len(report.kinds) == len(report.warnings)


def test_what_makes_a_value_unusable_comes_first():
    findings = (
        Finding("units", 1.0, "the units are unknown."),
        Finding("first states", 2.0, "Episodes begin elsewhere."),
        no_value("the sensor was off", 1.0),
    )

    def mine(problem, policy):
        return Estimate(1.0, 0.5, findings=findings, is_headline=True)

    report = oee.evaluate(Problem(SIMULATOR, LOG), EXPERT, estimators={"mine": mine})
    first = [note.kind for note in rank_notes(report)[:2]]
    assert first == ["status", "first states"]
    assert "[1] mine (policy): do not rely on the value" in str(report)


def test_a_note_about_a_row_that_is_not_stated_comes_after_what_concerns_the_answer():
    def weak(problem, policy):
        return Estimate(1.0, findings=(no_value("the sensor was off", 1.0),))

    chosen = {"oee": oee.estimators.OffEnvironment(), "weak": weak}
    report = oee.evaluate(Problem(SIMULATOR, FEW), EXPERT, estimators=chosen)
    kinds = [note.kind for note in rank_notes(report)]
    assert kinds.index("unrecorded") < kinds.index("status")


def test_a_second_note_of_a_kind_waits_for_other_kinds():
    report = oee.report.contest(Problem(SIMULATOR, FEW), THREE)
    kinds = [note.kind for note in rank_notes(report)]
    assert kinds.count("unrecorded") > 1
    assert kinds[:3] == ["unrecorded", "simulator", "next"]


def test_a_second_note_about_the_data_waits_for_nothing():
    findings = tuple(
        Finding("first states", size, f"Episodes begin elsewhere, by {size}.")
        for size in (2.0, 1.0)
    )

    def mine(problem, policy):
        return Estimate(1.0, 0.5, findings=findings, is_headline=True)

    report = oee.evaluate(Problem(SIMULATOR, FEW), EXPERT, estimators={"mine": mine})
    kinds = [note.kind for note in rank_notes(report)]
    assert kinds[:2] == ["first states"] * 2
    assert "unrecorded" in kinds[2:]


def test_the_least_recorded_policy_is_named_first():
    report = oee.report.contest(Problem(SIMULATOR, FEW), THREE)
    shares = {row["policy"]: row["unrecorded_share"] for row in report.comparison()}
    worst = max(shares, key=shares.get)
    assert rank_notes(report)[0].text.startswith(f"{worst}: ")


def test_ranks_are_those_of_kinds_that_exist():
    assert set(RANKS.values()) <= set(Rank)


def test_trials_that_contradict_the_log_leave_no_value_in_the_answer():
    report = REPORTS["trials"]()
    assert report.brief.startswith("The trials of “policy” and the log contradict each")
    assert "Until then all that can be said of “policy” is the range" in report.brief
    assert "is worth about" not in report.brief


@pytest.mark.parametrize(
    ("coverage", "said"),
    [(0.0, ", which covers 0.0%"), (0.4, ", which covers 40.0%"), (0.5, ""), (1.0, "")],
)
def test_a_value_of_a_log_that_covers_little_says_how_much(coverage, said):
    row = {"status": "ok", "estimator": "oee", "coverage": coverage}
    assert write_basis(row) == f"the simulator, corrected by the log{said}"
    assert write_basis(row | {"estimator": "mine"}) == ""
    assert write_basis(row | {"status": "the sensor was off"}) != write_basis(row)


def test_a_contest_of_simulated_values_shows_them_once():
    """A column of what the simulator says beside them would be the same numbers."""
    problem = Problem(SIMULATOR, LOG)
    one, several = (
        render_comparison(oee.evaluate(problem, THREE, **options), verbose=False)
        for options in ({"estimators": ["simulator"]}, {})
    )
    assert "simulator says" in several
    assert "simulator says" not in one


def test_a_table_without_the_default_row_has_a_row_for_each_estimator():
    assert "estimator" in REPORTS["own"]().to_text().split("\n\n")[1].splitlines()[0]
    assert "estimator" not in REPORTS["three"]().to_text().split("\n\n")[1]
