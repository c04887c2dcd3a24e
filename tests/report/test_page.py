"""The page of a report, without a browser: what it says, what it was made from, that it
needs nothing from outside.
"""

import base64
import itertools
import math
import os
import re
import shlex
import subprocess
import sys
from html import unescape

import numpy as np
import pandas as pd
import pytest
from helpers import Page, run_command

import oee_tabular as oee
from oee_tabular.cli.evaluation import date_of
from oee_tabular.estimators import Estimate, OffEnvironment, Problem
from oee_tabular.report import Report, page
from oee_tabular.report.text import PLANNED, format_interval, format_value


def lake(n=3000, seed=0):
    simulator, target = (
        oee.tasks.toy_text("FrozenLake-v1", map_name="4x4", success_rate=rate)
        for rate in (1 / 3, 0.7)
    )
    behavior = oee.mix(oee.optimal_policy(target), oee.uniform_policy(target), 0.5)
    log = oee.sample_episodes(target, behavior, n // 10, 60, seed=seed)
    return Problem(simulator, log), target


@pytest.fixture(scope="module")
def report():
    problem, target = lake()
    policies = {
        "bold": oee.optimal_policy(target),
        "careful": oee.uniform_policy(target),
    }
    return oee.evaluate(
        problem, policies, target=target, seed=3, facts={"log_name": "lake log.npz"}
    )


@pytest.fixture(scope="module")
def html(report):
    return report.to_html()


def test_it_holds_together_and_needs_nothing_from_outside(html):
    parsed = Page(html)
    assert parsed.open == []
    assert not {"script", "img", "iframe", "object", "base", "form"} & {
        tag for tag, _ in parsed.tags
    }
    outside = [
        word
        for word in re.findall(r"https?://[^\s\"'<]*", html)
        if not word.startswith("http://www.w3.org/")
    ]
    assert outside == []
    assert all(link["href"] == "data:," for link in parsed.all("link"))
    assert "url(http" not in html
    assert "@import" not in html
    ids = [attributes["id"] for _, attributes in parsed.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in parsed.tags:
        for key in ("href", "xlink:href"):
            if attributes.get(key, "").startswith("#"):
                assert attributes[key][1:] in ids
        for key in ("aria-labelledby", "aria-describedby"):
            for name in attributes.get(key, "").split():
                assert name in ids
    for used in re.findall(r"url\(#([^)]*)\)", html):
        assert used in ids


def test_every_picture_has_a_title_and_a_description(html):
    pictures = re.findall(r"<svg.*?</svg>", html, re.S)
    assert len(pictures) == 6  # two forests, recorded, two policies, changes
    for picture in pictures:
        assert 'role="img"' in picture
        title, words = (
            re.search(rf"<{tag} id=[^>]*>(.*?)</{tag}>", picture).group(1)
            for tag in ("title", "desc")
        )
        assert len(title) > 10
        assert len(words) > 40


def test_it_says_the_answer_and_how_it_was_found(report, html):
    text = Page(html).text
    value = next(
        row["value"]
        for row in report.records()
        if (row["policy"], row["estimator"]) == ("bold", "oee")
    )
    sure = report.uncertainty.intervals["bold"]["likelihood"]
    assert "Of 2 policies, “bold” is worth most in the target" in text
    assert format_interval(sure.lower, sure.upper) in text
    assert format_value(value, sure.lower, sure.upper) in text
    assert (
        "sum of discount^t * reward over t >= 0, discount 0.99 (not normalised)" in text
    )
    assert "lake log.npz" in text
    assert f"oee_tabular {oee.__version__}, seed 3" in text
    for warning in report.warnings:
        assert " ".join(warning.split()) in text
    for word in (
        "numpy",
        "Python",
        "interval: likelihood",
        "Importance sampling, reward by reward",
        "FiniteMDP(",
    ):
        assert word in text
    assert " in cell (" in text  # the lake is drawn as a grid
    assert "ends in other states than the simulator says" in text


def test_the_same_input_gives_the_same_bytes(report, html):
    assert report.to_html() == html
    problem, target = lake()
    policies = {
        "bold": oee.optimal_policy(target),
        "careful": oee.uniform_policy(target),
    }
    again = oee.evaluate(
        problem, policies, target=target, seed=3, facts={"log_name": "lake log.npz"}
    )
    assert again.to_html() == html
    assert re.search(r"20\d\d-\d\d-\d\d", html) is None


NAMES = [
    "<script>alert(1)</script>",
    "a & b \"quoted\" 'single'",
    "$x$ $",
    "{{ 1234 * 1234 }}",
    "nul\x00 esc\x1b[0m",
    "n" * 300,
]


def test_names_are_escaped():
    problem, target = lake(200)
    policies = {name: oee.uniform_policy(target) for name in NAMES}
    facts = {"simulator_name": "</style><b>sim", "log_name": "\x07log", "note": "<i>"}
    found = oee.evaluate(
        problem,
        policies,
        estimators={"<img src=x>": OffEnvironment()},
        seed=0,
        facts=facts,
    )
    text = found.to_html(title="</title><script>")
    parsed = Page(text)
    assert not {"script", "img", "b", "i"} & {tag for tag, _ in parsed.tags}
    for name in (
        *NAMES[:4],
        "nul\ufffd esc\ufffd[0m",
        "n" * 300,
        "<img src=x>",
        "</style><b>sim",
    ):
        assert " ".join(name.split()) in parsed.text
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", text)
    assert "1522756" not in [word.strip() for word in parsed.words]


def test_a_task_without_a_grid_gets_the_generic_picture():
    simulator = oee.tasks.toy_text("Taxi-v4")
    log = oee.sample_episodes(simulator, oee.uniform_policy(simulator), 5, 50, seed=0)
    found = oee.evaluate(
        Problem(simulator, log), oee.uniform_policy(simulator), estimators="oee"
    )
    text = Page(found.to_html()).text
    assert "the states where the policy spends most of its discounted time" in text
    assert "What is recorded" not in text
    assert "never recorded" in text
    drawn = Page(found.to_html(grid=(21, 24))).text
    assert "What is recorded" in drawn
    assert "A grid of 21 rows and 24 columns" in drawn


def test_at_discount_one_the_time_is_that_until_absorption():
    transitions = np.array([[[0.0, 0.5, 0.5]], [[0.5, 0.0, 0.5]], [[0.0, 0.0, 1.0]]])
    simulator = oee.FiniteMDP(transitions, [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], 1.0)
    found = oee.evaluate(
        Problem(simulator, oee.Transitions([0, 0], [0, 0], [1, 2], [1.0, 1.0])),
        np.ones((3, 1)),
    )
    page_text = found.to_html()
    assert (
        "Most of its time before an episode is over: state 0 66.7%, state 1 33.3%."
        in page_text
    )
    assert "no value" in Page(page_text).text
    stays = np.array([[[0.5, 0.5, 0.0]], [[0.5, 0.5, 0.0]], [[0.0, 0.0, 1.0]]])
    for_ever = oee.FiniteMDP(stays, [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], 1.0)
    found = oee.evaluate(
        Problem(for_ever, oee.Transitions([0], [0], [1], [1.0])), np.ones((3, 1))
    )
    assert (
        "At discount 1 a policy that never ends spends infinite time in its states"
        in Page(found.to_html()).text
    )


def test_guaranteed_intervals_and_normalised_values_are_named():
    problem = Problem(
        oee.tasks.gridworld(3, 0.3), oee.Transitions([0, 0], [0, 1], [3, 0]), horizon=10
    )
    found = oee.evaluate(
        problem,
        np.full((9, 4), 0.25),
        estimators="oee",
        guaranteed=True,
        normalized=True,
    )
    text = Page(found.to_html()).text
    assert "guaranteed interval" in text
    assert "(1 − discount) × discounted sum of rewards" in text
    assert "discount 0.99 (normalised)" in text
    assert (
        "What a value is: 0.01 × the discounted sum of 10 rewards (discount 0.99)."
        in text
    )
    assert "In none of the 2 tested pairs does the log bound how large" in text


def test_many_policies_have_six_maps():
    problem = Problem(oee.tasks.gridworld(2, 0.3), oee.Transitions([0], [0], [2]))
    found = oee.evaluate(problem, [np.full((4, 4), 0.25)] * 7, estimators="oee")
    text = found.to_html()
    assert "Pictures of 1 more policy are left out." in text
    assert [f'id="visits{k}-title"' in text for k in range(7)] == [True] * 6 + [False]


def test_a_report_without_its_problem_has_a_page(report):
    bare = Report(
        **{
            name: getattr(report, name)
            for name in Report.__dataclass_fields__
            if name not in ("problem", "policies")
        }
    )
    assert bare == report
    text = bare.to_html()
    assert 'id="coverage"' not in text
    assert Page(text).open == []
    with pytest.raises(
        ValueError, match="grid must be None for a report without its problem"
    ):
        bare.to_html(grid=(4, 4))


def constant(value, error=None):
    def estimator(problem, policy, *, seed=None):
        return Estimate(
            value, error, status="ok" if math.isfinite(value) else "the sensor was off"
        )

    return estimator


def test_the_sentence_for_one_policy_for_none_and_without_intervals():
    problem = Problem(
        oee.tasks.gridworld(2, 0.3, discount=1.0), oee.Transitions([0], [0], [2])
    )
    uniform = np.full((4, 4), 0.25)
    one = oee.evaluate(
        problem, {"mine": uniform}, estimators={"own": constant(2.0)}, confidence=0.9
    )
    assert (
        one.headline
        == one.answer
        == "In the target, the policy “mine” is worth about 2.000."
    )
    sure = oee.evaluate(
        problem,
        {"mine": uniform},
        estimators={"own": constant(2.0, 1.0)},
        confidence=0.999,
    )
    assert "about 2.0 (99.9% interval: −1.3 to 5.3)" in sure.headline
    none = oee.evaluate(
        problem, {"mine": uniform}, estimators={"own": constant(math.nan)}
    )
    assert none.headline.startswith(
        "No estimator could give the value of a policy in the target."
    )
    assert "the sensor was off" in none.to_html()
    two = oee.evaluate(
        problem, {"a": uniform, "b": uniform}, estimators={"own": constant(2.0, 1.0)}
    )
    assert two.headline.startswith(
        "At discount 1 policies are ranked only with a horizon"
    )


def test_it_is_written_whole_into_a_folder_that_is_made(
    report, html, tmp_path, monkeypatch
):
    path = tmp_path / "new" / "deeper" / "answer.html"
    assert report.to_html(path) == html
    assert path.read_bytes() == html.encode()
    assert [entry.name for entry in path.parent.iterdir()] == ["answer.html"]
    path.write_text("what stood there")

    def fail(number):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("oee_tabular._files.os.fsync", fail)
    with pytest.raises(OSError, match="No space"):
        report.to_html(path)
    assert path.read_text() == "what stood there"
    assert [entry.name for entry in path.parent.iterdir()] == ["answer.html"]


@pytest.mark.parametrize(
    ("path", "text"),
    [
        (
            "answer.txt",
            r"path of the report must end in .html or .htm; it is '.*answer.txt'",
        ),
        (
            "folder.html",
            r"path of the report must be a file; '.*folder.html' is a folder",
        ),
        (
            "file/answer.html",
            r"report's folder must be a folder that can be written; '.*file' is a file",
        ),
    ],
)
def test_paths_that_cannot_be_written_are_refused_before_the_work(
    path, text, report, tmp_path, capsys
):
    (tmp_path / "folder.html").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match=text):
        report.to_html(tmp_path / path)
    assert run_command("evaluate", "--report", tmp_path / path) == 2
    assert re.search(text, capsys.readouterr().err)


def problem(slip=0.3, seed=0, **options):
    log = oee.sample_transitions(
        oee.tasks.gridworld(3, 0.1), np.full((9, 4), 1 / 36), 60, seed=seed
    )
    return oee.Problem(oee.tasks.gridworld(3, slip), log, **options)


EXPERT = {"expert": oee.tasks.gridworld_expert(3)}


def test_the_hash_depends_on_the_inputs_alone():
    same = page.fingerprint(problem(), EXPERT)
    assert re.fullmatch("[0-9a-f]{8}", same)
    assert same == page.fingerprint(
        problem(), {"expert": EXPERT["expert"].astype(np.float32)}
    )
    others = [
        page.fingerprint(problem(slip=0.31), EXPERT),
        page.fingerprint(problem(seed=1), EXPERT),
        page.fingerprint(problem(horizon=9), EXPERT),
        page.fingerprint(problem(), {"other": EXPERT["expert"]}),
        page.fingerprint(problem(), {"expert": oee.tasks.gridworld_policy(3, 0.5)}),
    ]
    assert len({same, *others}) == 6


def test_the_day_is_the_newest_input_s_or_source_date_epoch(tmp_path, monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    old = tmp_path / "old.npz"
    new = tmp_path / "new.npz"
    for path, day in ((old, 100), (new, 365)):
        path.touch()
        os.utime(path, (day * 86400, day * 86400))
    assert date_of([new, old, "gridworld:3"]) == "1 January 1971"
    assert date_of(["expert"]) == ""
    report = oee.evaluate(
        problem(), EXPERT, estimators=["oee"], facts={"date": "1 January 1971"}
    )
    assert page.date(report) == "1 January 1971"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(400 * 86400))
    assert page.date(report) == "5 February 1971"
    assert "5 February 1971" in report.to_html()
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "soon")
    with pytest.raises(
        ValueError,
        match=(
            "SOURCE_DATE_EPOCH must be a whole number of seconds since 1970; it is"
            " 'soon'"
        ),
    ):
        report.to_html()


def test_the_page_s_command_runs_and_gives_the_page_s_advice(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    problem().log.save("my log.csv")
    words = (
        "evaluate --simulator gridworld:3,slip=0.3 --log 'my log.csv' --policy"
        " mine=mix:0.9 --horizon 20"
    )
    words += (
        " --action-noise 0.05 --impossible allow=0.01 --discount 0.9 --report 'Our dock"
        " & hall=page.html'"
    )
    assert run_command(*shlex.split(words)) == 0
    text = (tmp_path / "page.html").read_text()
    printed = capsys.readouterr().out
    again = [*shlex.split(words), "--overwrite"]
    script = f"from oee_tabular.cli import main; main({again!r})"
    # in a process of its own, with another hash seed and the same BLAS kernels: the
    # same bytes
    subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        check=True,
        env=os.environ | {"PYTHONHASHSEED": "7"},
    )
    assert (tmp_path / "page.html").read_text() == text
    assert "<h1>Our dock &amp; hall</h1>" in text
    assert re.search(
        r"gridworld:3,slip=0.3 · my log.csv · mix:0.9 · \d+ \w+ \d{4} · inputs"
        r" [0-9a-f]{8}",
        text,
    )
    command = (
        re.search(r"<pre[^>]*><code>(.*?)</code>", text, re.S)[1]
        .replace("&#39;", "'")
        .replace("&gt;", ">")
    )
    typed = shlex.split(command)
    assert typed[:2] == ["oee", "plan"]
    assert typed[typed.index("--transitions") + 1] == "60"
    assert run_command(*typed[1:]) == 0
    lines = printed.splitlines()
    advice = next(line for line in lines if "narrow the interval, record" in line)
    advice = advice.removeprefix("- ")
    assert advice in capsys.readouterr().out
    assert advice.replace("'", "&#39;") in text


def test_the_page_s_command_reads_the_log_as_the_page_s_own_did(
    tmp_path, monkeypatch, capsys
):
    """Columns with other labels, in several files; all options that a plan knows."""
    monkeypatch.chdir(tmp_path)
    grid = oee.tasks.gridworld(3, slip=0.3, discount=0.9)
    names = [f"cell {s}" for s in range(9)]
    grid.with_names(names, ["n", "e", "s", "w"]).save("sim.npz")
    table = pd.DataFrame(problem().log.columns())
    labels = {"state": "was at", "action": "did", "next_state": "came=to"}
    for label in ("state", "next_state"):
        table[label] = [names[s] for s in table[label]]
    table = table[list(labels)].rename(columns=labels)
    table[:30].to_csv("first.csv", index=False)
    table[30:].to_csv("second.csv", index=False)
    options = ["--initial", "cell 0", "--box", ",50", "--confidence", "0.9"]
    for name, label in labels.items():
        options += ["--column", f"{name}={label}"]
    words = ["evaluate", "--simulator", "sim.npz", "--log", "first.csv"]
    words += ["--log", "second.csv", *options, "--report", "page.html"]
    assert run_command(*words) == 0
    text = (tmp_path / "page.html").read_text()
    command = unescape(re.search(r"<pre[^>]*><code>(.*?)</code>", text, re.S)[1])
    typed = shlex.split(command)
    assert {("--column", f"{a}={b}") for a, b in labels.items()} <= set(
        itertools.pairwise(typed)
    )
    assert set(options) <= set(typed)
    capsys.readouterr()
    assert run_command(*typed[1:]) == 0
    shown = capsys.readouterr().out
    assert "next.csv" in shown
    assert "90%" in shown
    # the same command is in the terminal, on request
    words = [*words[: words.index("--report")], "--verbose"]
    assert run_command(*words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert shlex.split(lines[lines.index(PLANNED) + 1]) == typed


def test_no_command_plans_for_the_probability_of_success(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problem().log.save("log.csv")
    words = "evaluate --simulator gridworld:3,slip=0.3 --log log.csv --success 8"
    assert run_command(*words.split(), "--report", "page.html") == 0
    assert "oee plan" not in (tmp_path / "page.html").read_text()


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
        sum(
            "Importance sampling is left out (expert): the weight of every whole"
            in text
            for text in report.warnings
        )
        == 1
    )
    asked = oee.evaluate(given, policies, estimators=["pdis", "wpdis"], seed=0)
    about = [
        text
        for text in asked.warnings
        if text.startswith("pdis, wpdis (expert)") or "wpdis (expert)" in text
    ]
    # "do not rely on the value", "no value": one fact, one note each
    assert 1 <= len(about) <= 2
    assert "uniform" in report.to_html()


def test_covered_does_not_read_as_all_of_it():
    share = np.full((9, 4), 1.0)
    share[4, 3] = 0.0
    log = oee.sample_transitions(
        oee.tasks.gridworld(3, 0.1), share / share.sum(), 4000, seed=0
    )
    mine = 0.9999 * EXPERT["expert"] + 0.0001 * 0.25
    report = oee.evaluate(
        oee.Problem(oee.tasks.gridworld(3, 0.3), log), {"mine": mine}, seed=0
    )
    assert "> 99.9%" in report.to_text(verbose=True)
    assert re.search(
        r"time in recorded pairs</dt><dd>&gt; 99.9% <span class=\"soft\">1 pair never",
        report.to_html(),
    )


def test_no_view_of_a_ranking_reads_as_certain_and_json_keeps_its_numbers():
    pair = oee.testing.case("ragged")
    policies = {"new": pair.policy, "recorded": pair.behavior}
    problem = pair.problem(1000, seed=0)
    report = oee.report.contest(problem, policies)
    compared = oee.inference.compare_policies(problem, policies)
    shown = (report.to_text(), report.to_text(verbose=True), str(compared))
    for view in shown:
        assert re.search(r"^new .* > 99\.9%", view, re.M)
        assert re.search(r"^recorded .* < 0\.1%", view, re.M)
    assert '<td class="num">&gt; 99.9%</td>' in report.to_html()
    assert '<td class="num">&lt; 0.1%</td>' in report.to_html()
    numbers = [row["probability_best"] for row in report.to_dict()["comparison"]]
    assert sum(numbers) == pytest.approx(1.0)
    assert numbers[0] > 0.9995


def test_the_page_lists_every_note_that_a_row_has(html, report):
    """Whatever the estimator of the row, under “Read before use”."""
    listed = dict(re.findall(r'<li id="note(\d+)">(.*?)</li>', html, re.S))
    cited = {str(k) for row in report.records() for k in row["notes"]}
    assert cited <= listed.keys()
    assert len(listed) == len(report.warnings)


def test_the_page_holds_its_table_as_csv(report, html, tmp_path):
    link = next(link for link in Page(html).all("a") if link.get("download"))
    assert link["download"] == "table.csv"
    head, _, content = link["href"].partition(",")
    assert head == "data:text/csv;charset=utf-8;base64"
    report.save(tmp_path)
    assert base64.b64decode(content) == (tmp_path / "table.csv").read_bytes()


def test_pictures_have_tooltips_with_names_of_cells_and_actions(report, html):
    recorded = re.search(r'<svg[^>]*"recorded-title.*?</svg>', html, re.S)[0]
    told = re.findall(r"<title>(.*?)</title>", recorded)
    assert len(told) == 16
    counts = report.problem.counts.sum(axis=1).reshape(16, 4)
    first = ", ".join(
        f"{name} {counts[0, a]:,.0f}"
        for a, name in enumerate(("left", "down", "right", "up"))
    )
    assert told[0] == (
        f"cell (0, 0): {counts[0].sum():,.0f} recorded transitions ({first})"
    )
    visits = re.search(r'<svg[^>]*"visits0-title.*?</svg>', html, re.S)[0]
    assert "% of the time" in re.findall(r"<title>(.*?)</title>", visits)[0]
    forest = re.search(r'<svg[^>]*"forest0-title.*?</svg>', html, re.S)[0]
    assert any(
        title.startswith("oee: ") and "95% interval" in title
        for title in re.findall(r"<title>(.*?)</title>", forest)
    )


def test_names_stand_in_the_table_of_differences_where_states_have_them():
    simulator, target = (oee.tasks.gridworld(3, slip) for slip in (0.5, 0.0))
    log = oee.sample_episodes(target, oee.uniform_policy(target), 60, 30, seed=0)
    policy = oee.tasks.gridworld_expert(3)
    placed = oee.evaluate(Problem(simulator, log), policy).to_html()
    assert re.search(r">(up|down|left|right) in cell \(\d, \d\) <span", placed)
    assert re.search(r"state \d, action \d</span>", placed)
    named = simulator.with_names(
        [f"<room> {k}" for k in range(9)], ["up & off", "down", "left", "right"]
    )
    text = oee.evaluate(Problem(named, log), policy).to_html()
    assert " in state “&lt;room&gt; " in text
    assert "“up &amp; off” in " in text
    assert "<room>" not in text


def test_rows_have_a_place_in_each_order():
    assert page.rank_rows([1.0, None, 3.0, math.nan, 2.0]) == [2, 3, 0, 4, 1]
    assert page.rank_rows([]) == []


@pytest.mark.parametrize("seed", range(6))
def test_the_page_does_not_count_different_pairs_twice(seed):
    """To bound a difference takes more than to show it: the words say which is which."""
    problem, _ = lake(400 + 300 * seed, seed=seed)
    report = oee.evaluate(problem, {"u": oee.uniform_policy(problem.simulator)}, seed=0)
    text = " ".join(re.sub(r"<[^>]+>", " ", report.to_html()).split())
    changes = oee.inference.row_changes(problem)
    assert "certain in" not in text
    if changes.n_certain:
        told = f"In {changes.n_certain} of {changes.tested} tested pairs"
        assert "the log also bounds how large the difference is at least" in text
    else:
        told = f"In none of the {changes.tested} tested pairs does the log bound"
    assert told in text
