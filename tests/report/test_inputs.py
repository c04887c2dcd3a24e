"""What a page was made from: names, day and hash of its inputs, and the command that plans the next recording."""

import os
import re
import shlex

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.cli import main
from oee_tabular.report import page


def problem(slip=0.3, seed=0, **options):
    log = oee.sample_transitions(oee.tasks.gridworld(3, 0.1), np.full((9, 4), 1 / 36), 60, seed=seed)
    return oee.Problem(oee.tasks.gridworld(3, slip), log, **options)


EXPERT = {"expert": oee.tasks.gridworld_expert(3)}


def test_the_hash_tells_inputs_apart_and_nothing_else():
    same = page.fingerprint(problem(), EXPERT)
    assert re.fullmatch("[0-9a-f]{8}", same)
    assert same == page.fingerprint(problem(), {"expert": np.array(EXPERT["expert"])})
    others = [
        page.fingerprint(problem(slip=0.31), EXPERT),
        page.fingerprint(problem(seed=1), EXPERT),
        page.fingerprint(problem(horizon=9), EXPERT),
        page.fingerprint(problem(), {"other": EXPERT["expert"]}),
        page.fingerprint(problem(), {"expert": oee.tasks.gridworld_policy(3, 0.5)}),
    ]
    assert len({same, *others}) == 6


def test_the_day_is_the_newest_input_s_or_source_date_epoch(tmp_path, monkeypatch):
    monkeypatch.delenv(page.EPOCH, raising=False)
    old, new = tmp_path / "old.npz", tmp_path / "new.npz"
    for path, day in ((old, 100), (new, 365)):
        path.touch()
        os.utime(path, (day * 86400, day * 86400))
    assert page.date_of([new, old, "gridworld:3"]) == "1 January 1971"
    assert page.date_of(["expert"]) == ""
    report = oee.evaluate(problem(), EXPERT, estimators=["oee"], facts={"date": "1 January 1971"})
    assert page.date(report) == "1 January 1971"
    monkeypatch.setenv(page.EPOCH, str(400 * 86400))
    assert page.date(report) == "5 February 1971"
    assert "5 February 1971" in report.to_html()
    monkeypatch.setenv(page.EPOCH, "soon")
    with pytest.raises(
        ValueError, match="SOURCE_DATE_EPOCH must be a whole number of seconds since 1970; it is 'soon'"
    ):
        report.to_html()


def test_the_page_s_command_runs_and_gives_the_page_s_advice(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    noisy = "my log.csv"
    problem().log.save(noisy)
    words = [
        "evaluate",
        "--simulator",
        "gridworld:3,slip=0.3",
        "--log",
        noisy,
        "--policy",
        "mine=mix:0.9",
        "--horizon",
        "20",
    ]
    words += ["--action-noise", "0.05", "--impossible", "allow=0.01", "--discount", "0.9"]
    with pytest.raises(SystemExit):
        main([*words, "--report", "page.html", "--title", "Our dock & hall"])
    page, printed = (tmp_path / "page.html").read_text(), capsys.readouterr().out
    assert "<h1>Our dock &amp; hall</h1>" in page
    assert re.search(r"gridworld:3,slip=0.3 · my log.csv · mix:0.9 · \d+ \w+ \d{4} · inputs [0-9a-f]{8}", page)
    command = re.search(r"<pre[^>]*><code>(.*?)</code>", page, re.S)[1].replace("&#39;", "'").replace("&gt;", ">")
    typed = shlex.split(command)
    assert typed[:2] == ["oee", "plan"]
    assert typed[typed.index("--transitions") + 1] == "60"
    with pytest.raises(SystemExit) as ended:
        main(typed[1:])
    assert not ended.value.code
    advice = next(line for line in printed.splitlines() if line.startswith("Record "))
    assert advice in capsys.readouterr().out
    assert advice in page


def test_from_python_the_page_names_the_call():
    report = oee.evaluate(problem(), EXPERT, estimators=["oee"])
    assert page.plan_command(report) == "oee.plan_data_collection(problem, {'expert': ...}, n=60)"
    told = oee.evaluate(problem(), EXPERT, estimators=["oee"], facts={"simulator_name": "cartpole"})
    assert page.plan_command(told) == ""


def test_a_title_needs_a_page(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", "--title", "x"])
    assert ended.value.code == 2
    assert "--title needs --report FILE.html" in capsys.readouterr().err


def test_the_answer_is_one_sentence_with_the_one_interval_beside_the_simulator():
    report = oee.evaluate(problem(), EXPERT, estimators=["simulator", "oee"])
    sure = report.uncertainty.intervals["expert"]["likelihood"]
    assert report.answer == report.headline
    assert re.fullmatch(
        r"In the target, the policy “expert” is worth about −[\d.]+ \(95% interval: −[\d.]+ to −[\d.]+\); the simulator says "
        r"−[\d.]+\.",
        report.answer,
    )
    assert f"{sure.lower:.2f}"[1:5] in report.answer
    page = report.to_html()
    above = page[page.index('id="answer"') : page.index('id="values"')]
    assert "^" not in above
    assert "* reward" not in above
    assert page.index('id="changes"') < page.index('id="coverage"')


def test_importance_sampling_without_weight_is_left_out_of_the_default_table():
    target = oee.tasks.gridworld(3, 0.1)
    log = oee.sample_episodes(target, oee.uniform_policy(target), 3, 40, seed=0)
    given = oee.Problem(oee.tasks.gridworld(3, 0.3), log)
    policies = {"expert": EXPERT["expert"], "uniform": oee.uniform_policy(target)}
    report = oee.evaluate(given, policies, seed=0)
    shown = {(row["policy"], row["estimator"]) for row in report.records()}
    assert ("uniform", "pdis") in shown
    assert not {("expert", "pdis"), ("expert", "wpdis")} & shown
    assert (
        sum("Importance sampling is left out (expert): the weight of every whole" in text for text in report.warnings)
        == 1
    )
    asked = oee.evaluate(given, policies, estimators=["pdis", "wpdis"], seed=0)
    about = [text for text in asked.warnings if text.startswith("pdis, wpdis (expert)") or "wpdis (expert)" in text]
    assert 1 <= len(about) <= 2  # "do not rely on the value", "no value": one fact, one note each
    assert "uniform" in report.to_html()


def test_covered_does_not_read_as_all_of_it():
    share = np.full((9, 4), 1.0)
    share[4, 3] = 0.0
    log = oee.sample_transitions(oee.tasks.gridworld(3, 0.1), share / share.sum(), 4000, seed=0)
    mine = 0.9999 * EXPERT["expert"] + 0.0001 * 0.25
    report = oee.evaluate(oee.Problem(oee.tasks.gridworld(3, 0.3), log), {"mine": mine}, seed=0)
    assert "> 99.9%" in report.to_text(verbose=True)
    page = report.to_html()
    assert re.search(r"covered by the log</dt><dd>&gt; 99.9% <span class=\"soft\">1 pair never recorded", page)
