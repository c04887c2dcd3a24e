"""Findings: the titles of the figures are what their tables show, for smoke runs too, and fit on a line."""

import html
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from saved_results import RESULTS, saved

from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.findings import course, entitle, listed, span
from oee_tabular.lab.output import figures, heading, share_legend, summary_of

EACH = pytest.mark.parametrize("experiment", list(EXPERIMENTS), ids=lambda experiment: experiment.id)


def smoke(experiment, table):
    """The rows of a smoke run."""
    settings = experiment.settings(smoke=True)
    for name, values in settings.axes.items():
        table = table[table[name].isin(values)]
    return table[table.repetition < settings.repetitions]


@EACH
def test_the_saved_figure_says_what_its_table_shows_on_one_line(experiment):
    table, figure = saved(experiment.id), Figure(layout="constrained")
    finding = experiment.finding(table)
    assert finding
    for name in ("figure.svg", "summary.md"):
        assert finding in html.unescape((RESULTS / experiment.id / name).read_text())
    experiment.draw(table, summary_of(experiment, table), figure)
    share_legend(figure)
    entitle(figure, finding)
    figure.canvas.draw()
    title = figure._suptitle
    box = title.get_window_extent()
    assert "\n" not in finding
    assert title.get_fontsize() >= 9.0
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.x1


def test_a_figure_and_its_page_are_made_with_the_finding():
    experiment = EXPERIMENTS["estimands"]
    table = smoke(experiment, saved("estimands"))
    made = figures(experiment, table, summary_of(experiment, table))
    assert experiment.finding(table) in html.unescape(made["figure.svg"].decode())
    assert heading(experiment, table)[-1] == f"![{experiment.finding(table)}](figure.png)"
    silent = replace(experiment, finding=lambda _: "")
    assert heading(silent, table)[-1] == f"![{experiment.title}](figure.png)"


@EACH
def test_the_finding_of_a_smoke_run_is_of_its_rows(experiment):
    table = saved(experiment.id)
    part = smoke(experiment, table)
    finding = experiment.finding(part)
    assert finding
    assert finding != experiment.finding(table) or part.drop(columns="repetition").equals(
        table.drop(columns="repetition")
    )
    if "n" in part:
        assert {int(n) for n in re.findall(r"n = (\d+)", finding)} <= {int(n) for n in part.n}


@EACH
def test_a_finding_changes_with_the_numbers(experiment):
    """No number of it is written in the code: tables whose every measure is another give another sentence."""
    table = saved(experiment.id)
    numbers = [
        name for name in table.select_dtypes("number") if name not in {*experiment.keys, *experiment.axes, "repetition"}
    ]
    factors = np.random.default_rng(0).uniform(0.2, 5.0, (len(table), len(numbers)))
    other = table.assign(**{name: table[name] * factors[:, k] for k, name in enumerate(numbers)})
    assert experiment.finding(other) != experiment.finding(table)


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ([8.0, 4.0, 2.0], "falls 4 times to 2"),
        ([2.0, 1.0, 5.0], "rises 2.5 times to 5"),
        ([2.0, 9.0, 2.1], "goes from 2 to 2.1"),
        ([2.0, 1.0, 0.0], "goes from 2 to 0"),
        ([0.0, 1.0, 3.0], "goes from 0 to 3"),
    ],
)
def test_how_a_curve_goes(errors, said):
    table = pd.DataFrame({"n": [1, 2, 3] * 2, "error": errors * 2})
    assert course(table) == said
    assert span(table) == "From n = 1 to 3"
    alone = table[table.n == 1]
    assert (course(alone), span(alone)) == (f"is {errors[0]:.2g}", "At n = 1")


def test_values_with_their_names():
    assert listed(pd.Series({"one": 0.0123, "two": 45.6})) == "0.012 (one), 46 (two)"


def test_an_experiment_without_a_finding_has_no_title():
    figure = Figure()
    entitle(figure, "")
    assert figure._suptitle is None


@pytest.mark.parametrize("text", ["MMMM 0.059 " * 20, "illi, " * 30, "$x^2$, " * 20])
def test_a_title_of_any_letters_fits(text):
    figure = Figure(figsize=(9.0, 3.0))
    entitle(figure, text)
    box = figure._suptitle.get_window_extent()
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.x1
