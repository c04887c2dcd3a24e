"""Figures on the pages: each section with a decimal or a percentage names what shows it,
or notebooks/figures.md does, and what they name exists.
"""

import importlib.util
import math
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee
from oee_tabular.cli import app

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
COMMANDS = typer.main.get_command(app).commands
# release notes tell what was; the list itself
NOT_READ = {"changes", "figures"}
FIGURE = re.compile(r"(?<![\w./:-])[-−]?\d*\.\d+(?![\w.]*\.\d)|\d+(?:\.\d+)? ?%")
SOURCE = re.compile(
    r"`((?:python |PYTHONPATH=\. python )?(?:-m )?(?:\w+/)*\w+\.py(?:::\w+)?[^`\n]*"
    r"|python -m [\w.]+[^`\n]*|oee [a-z]+[^`\n]*|\.ci/\w+)`"
    r"|^((?:PYTHONPATH=\. )?python [^\n]+|oee [a-z][^\n]*)$",
    re.M,
)
PAGES = {
    str(path.relative_to(ROOT if path.parent == ROOT else NOTEBOOKS)): path
    for path in (
        ROOT / "README.md",
        *sorted(NOTEBOOKS.glob("*.md")),
        *sorted((NOTEBOOKS / "course").glob("*.md")),
    )
    if path.stem not in NOT_READ
}
ROWS = re.findall(
    r"^\| ([\w/.]+\.md) \| (.+) \| (.+) \|$",
    (NOTEBOOKS / "figures.md").read_text(),
    re.M,
)


def sections(text):
    """Yield the heading and the text of each section; the first is "the page"."""
    heading, lines, is_code = "the page", [], False
    for line in text.splitlines():
        is_code ^= line.startswith("```")
        if line.startswith("## ") and not is_code:
            yield heading, "\n".join(lines)
            heading, lines = line[3:], []
        else:
            lines.append(line)
    yield heading, "\n".join(lines)


def figures(text):
    """The decimals and percentages in a section's prose."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    prose = re.sub(r"`[^`]*`|arXiv [\d.]+|Python 3\.\d+|\]\([^)]*\)", "", prose)
    return FIGURE.findall(prose)


def missing(source):
    """What a source names that is not there, or None."""
    if found := re.match(r"(?:PYTHONPATH=\. )?python -m ([\w.]+)", source):
        return None if importlib.util.find_spec(found[1]) else found[1]
    if found := re.match(r"oee ([a-z]+)", source):
        return None if found[1] in COMMANDS else source
    if source.startswith(".ci/"):
        return None if (ROOT / source).is_file() else source
    path, test = re.search(r"((?:\w+/)*\w+\.py)(?:::(\w+))?", source).groups()
    for folder in (ROOT, ROOT / "tests", ROOT / "oee_tabular"):
        if (folder / path).is_file():
            text = (folder / path).read_text()
            return source if test and f"def {test}(" not in text else None
    return source


def sources(text):
    """What a text names that may show a figure."""
    return [one or other for one, other in SOURCE.findall(text)]


@pytest.mark.parametrize("page", PAGES)
def test_every_section_with_a_figure_names_what_shows_it(page):
    listed = {heading for name, heading, _ in ROWS if name == page}
    for heading, text in sections(PAGES[page].read_text()):
        if heading in listed or not (found := figures(text)):
            continue
        assert any(missing(source) is None for source in sources(text)), (
            f"{page}, section “{heading}”, has the figures {found[:5]} and names no test"
            " or command: name one there, or add a row to notebooks/figures.md"
        )


def test_the_list_of_figures_names_what_is_there():
    assert len(ROWS) > 50
    for page, heading, shown in ROWS:
        assert heading in dict(sections(PAGES[page].read_text())), (page, heading)
        assert sources(shown), (page, heading)
        for source in sources(shown):
            assert missing(source) is None, (page, source)


def test_what_is_missing_is_seen():
    assert figures("It is 12% of `0.3`, arXiv 2404.00099, 4 and -.5.") == ["12%", "-.5"]
    assert missing("tests/test_figures.py::test_of_nothing")
    assert missing("tests/nothing.py")
    assert missing("oee nothing")
    assert missing("python -m oee_tabular.nothing")
    assert missing("tests/test_figures.py::test_what_is_missing_is_seen") is None


# ---- figures that no code block prints


def page_has(page, *texts):
    words = " ".join(PAGES[page].read_text().split())
    for text in texts:
        assert text in words, (page, text)


def test_solutions_of_the_chapters():
    grid, expert = oee.tasks.gridworld(4, slip=0.1), oee.tasks.gridworld_expert(4)
    goal = oee.occupancy(grid, expert).sum(axis=1)[-1]
    page_has("course/01_values.md", f"is {goal:.2f}", rf"\gamma^7 = {0.99**7:.3f}")

    slips = [oee.tasks.gridworld(4, slip=slip) for slip in (0.3, 0.2, 0.1)]
    zeta = np.unique(oee.true_ratio(slips[2], slips[0]).values.data.round(9))
    assert_allclose(zeta, [1 / 3, 1, 7 / 6, 9 / 7])
    page_has("course/02_question.md", "$0.9 / 0.7 = 9/7$", "7/6")
    values = [oee.policy_value(mdp, expert) for mdp in slips]
    said = [f"{value:.2f}".replace("-", "−") for value in values]
    page_has(
        "course/03_simulation_lemma.md",
        f"the values are {said[0]}, {said[1]} and {said[2]}",
        f"are {values[1] - values[0]:.2f} and {values[2] - values[0]:.2f}",
    )

    p, q = np.array([0.5, 0.3, 0.2]), np.array([0.2, 0.3, 0.5])
    fit = oee.density_ratio(p, q, upper=2.0, normalized=True)
    assert_allclose(fit.ratio, [2, 1.2, 0.48], atol=1e-6)
    page_has("course/04_dual.md", "g = (2, 1.2, 0.48)")
    assert_allclose((3 + 0.75 / 2) / (3 + 0.75), 0.9)
    page_has("course/05_rows.md", r"\kappa = 0.75")
    assert_allclose(((1 - 0.5) / 0.5 + (1 - 0.2) / 0.2) / 0.01**2, 50_000)
    page_has("course/06_estimation.md", r"n = 50\,000")
    assert_allclose(oee.theory.ratio_error_bound(0.01, 2.0, 0.5, tight=True), 0.1)
    page_has("course/07_quotient.md", r"2.5 / 0.25 \cdot 0.01 = 0.1")

    t = np.arange(100_000)
    bound = (0.99**t * np.minimum(2, 0.02 * t)).sum()
    page_has("course/08_value_error.md", f"which is {bound:.1f}")
    page_has("course/08_value_error.md", f"= {0.99 * 0.02 / 0.01**2:.0f}$")
    half = stats.chi2.ppf(0.95, 1) / 2
    page_has(
        "course/11_intervals.md",
        f"= {half:.2f} .",
        f"= {1 - math.exp(-half / 3):.2f}$",
    )


def test_the_true_value_of_the_robot_with_a_delay():
    """By midpoints of the first states; the motor is two steps late."""
    middle = (np.arange(200) + 0.5) / 100 - 1
    position, speed = np.meshgrid(middle, middle)
    waiting, value = [0.0, 0.0], 0.0
    for t in range(50):
        waiting.append(np.clip(-2 * position - 2 * speed, -1, 1))
        speed = 0.98 * speed + 0.2 * waiting.pop(0)
        position, value = (
            position + 0.1 * speed,
            value - 0.99**t * (position**2 + 0.1 * speed**2),
        )
    page_has("how_to.md", f"the true value, {value.mean():.2f}.")
