"""Pictures as files: PNG, PDF and SVG, slides, and the schematic of the site."""

import io
import re
import sys
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from helpers import run_command
from matplotlib import pyplot
from matplotlib.figure import Figure
from PIL import Image

import oee_tabular as oee
from oee_tabular import plots
from oee_tabular.exceptions import OutputWarning

sys.path.insert(0, str(Path(__file__).parents[1]))
import drawn_images

BEGINNINGS = {"png": b"\x89PNG", "pdf": b"%PDF-", "svg": b"<?xml"}
MIN_TEXT_SHARE = 1 / 32  # of the height of a slide


def draw(ax):
    ax.plot([0, 1], [1, 0])
    ax.set_title("50% of $x")


def size_of(png):
    with Image.open(io.BytesIO(png)) as image:
        return image.size


def box_of(svg):
    """Width over height of an SVG."""
    width, height = map(float, re.search(r'viewBox="0 0 (\S+) (\S+)"', svg).groups())
    return width / height


@pytest.mark.parametrize("kind", BEGINNINGS)
@pytest.mark.parametrize("name", ["a.{}", "a.b.{}", ".{}"])
def test_the_ending_says_the_kind(kind, name, tmp_path):
    for ending in (kind, kind.upper()):
        path = tmp_path / name.format(ending)
        assert plots.save_figure(draw, path) == path
        content = path.read_bytes()
        assert content.startswith(BEGINNINGS[kind])
        # the same picture, the same bytes: no date
        plots.save_figure(draw, str(path))
        assert path.read_bytes() == content


def test_a_picture_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    with pytest.raises(
        ValueError, match=r"draw must be .*ZeroDivisionError"
    ) as refused:
        plots.save_figure(lambda ax: 1 / 0, path)
    assert isinstance(refused.value.__cause__, ZeroDivisionError)
    assert path.read_bytes() == b"old"
    assert [one.name for one in tmp_path.iterdir()] == ["a.png"]


@pytest.fixture(scope="module")
def report():
    pair = oee.testing.case("ragged")
    policies = {"new": pair.policy, "recorded": pair.behavior}
    return oee.evaluate(pair.problem(1000, seed=0), policies, seed=0)


def test_a_report_has_its_picture_three_times(report, tmp_path):
    report.save(tmp_path)
    for kind, beginning in BEGINNINGS.items():
        assert (tmp_path / f"values.{kind}").read_bytes().startswith(beginning)


def test_results_save_to_every_kind(report, tmp_path):
    for kind, beginning in BEGINNINGS.items():
        path = tmp_path / f"a.{kind}"
        ax = report.plot()
        ax.figure.savefig(path)
        pyplot.close(ax.figure)
        assert path.read_bytes().startswith(beginning)
        assert plots.save_figure(report.plot, path).read_bytes().startswith(beginning)


# ---- slides


def least_text(figure):
    """Height in points of the smallest letters, as a share of the figure's height."""
    figure.canvas.draw()
    sizes = [
        text.get_fontsize()
        for text in figure.findobj(lambda artist: hasattr(artist, "get_fontsize"))
        if text.get_visible() and text.get_text()
    ]
    return min(sizes) / (72.0 * figure.get_figheight())


GRID = oee.tasks.gridworld(4, 0.1)
UNIFORM = oee.uniform_policy(GRID)
ROW = {"value": 1.0, "lower": 0.5, "upper": 1.5, "true_value": 0.9}
DRAWN = {
    "curves": lambda ax: plots.plot_curves([0, 1], {"a": [1, 2]}, ax),
    "ends": lambda ax: plots.label_ends(plots.plot_curves([0, 1], {"a": [1, 2]}, ax)),
    "errors": lambda ax: plots.plot_errors([10, 99], {"a": [1, 2]}, ax),
    "growth": lambda ax: plots.plot_variance_growth({"a": [1, 2]}, ax),
    "values": lambda ax: plots.plot_values(
        [
            ROW | {"policy": policy, "estimator": name}
            for policy in ("first", "second", "third")
            for name in ("simulator", "oee", "model-based")
        ],
        ax,
        title="What the log says",
    ),
    "states": lambda ax: plots.plot_states(np.ones(30) / 30, np.arange(30), ax),
    "coverage": lambda ax: plots.plot_coverage(np.arange(16), (4, 4), ax),
    "ratio": lambda ax: plots.plot_ratio(np.ones(144), (12, 12), ax),
    "policy": lambda ax: plots.plot_policy(GRID, UNIFORM, ax),
    "paths": lambda ax: plots.plot_paths(GRID, [0, 1, 2], ax),
    "schematic": plots.schematic,
}


@pytest.mark.parametrize("name", DRAWN)
def test_a_slide_has_its_pixels_and_letters_for_the_last_row(name, tmp_path):
    with plots.slides():
        assert size_of(plots.figure_png(DRAWN[name], size=(3, 9))) == (1920, 1080)
        made = DRAWN[name](None)
    figure = made.figure
    assert least_text(figure) >= MIN_TEXT_SHARE
    figure.savefig(tmp_path / "a.png")  # after the block as well
    assert size_of((tmp_path / "a.png").read_bytes()) == (1920, 1080)
    pyplot.close(figure)


def test_outside_of_slides_pictures_are_as_before():
    before = dict(pyplot.rcParams)
    plain = plots.figure_png(draw)
    page = plots.figure_svg(draw, name="a", title="t", description="d")
    with plots.slides():
        with plots.slides():
            assert plots.figure_png(draw) != plain
        assert size_of(plots.figure_png(draw)) == (1920, 1080)
        # a page is no slide
        assert plots.figure_svg(draw, name="a", title="t", description="d") == page
    assert dict(pyplot.rcParams) == before
    assert plots.figure_png(draw) == plain
    with pytest.raises(ZeroDivisionError), plots.slides():
        raise ZeroDivisionError
    assert plots.figure_png(draw) == plain


@pytest.mark.parametrize("kind", ["pdf", "svg"])
def test_the_other_kinds_have_the_shape_of_a_slide(kind, tmp_path):
    with plots.slides():
        path = plots.save_figure(draw, tmp_path / f"a.{kind}")
    text = path.read_bytes().decode("latin1")
    if kind == "svg":
        assert box_of(text) == pytest.approx(16 / 9)
    else:
        found = re.search(r"/MediaBox \[ 0 0 (\S+) (\S+) \]", text).groups()
        width, height = map(float, found)
        assert width / height == pytest.approx(16 / 9)


def test_a_slide_leaves_estimators_out_and_says_which():
    rows = [
        ROW | {"policy": policy, "estimator": name}
        for policy in ("first", "second", "third")
        for name in ("mine", "pdis", "simulator", "model-based", "oee")
    ]
    whole = plots.plot_values(rows, Figure().subplots())
    assert len(whole.get_yticks()) == 18
    with (
        plots.slides(),
        pytest.warns(OutputWarning, match="leaves out pdis, model-based"),
    ):
        few = plots.plot_values(rows, Figure().subplots())
    labels = [label.get_text() for label in few.get_yticklabels()]
    assert labels == [
        text
        for policy in ("first", "second", "third")
        for text in (policy, "mine", "simulator", "oee")
    ]


def test_a_picture_of_many_panels_says_that_its_letters_are_small():
    from oee_tabular.lab.experiment import draw_bytes

    def panels(figure):
        figure.set_size_inches(30.0, 9.0)
        for ax in figure.subplots(2, 6).flat:
            ax.set_xlabel("a long label of an axis that needs several lines")

    with (
        plots.slides(),
        pytest.warns(OutputWarning, match="letters are only 11 pixels"),
    ):
        made = draw_bytes(panels, salt="x")
    assert {*made} == {*BEGINNINGS}
    assert size_of(made["png"]) == (1920, 1080)
    with warnings.catch_warnings():
        warnings.simplefilter("error", OutputWarning)
        assert size_of(draw_bytes(panels, salt="x")["png"]) == (3300, 990)


def test_the_option_slides_draws_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    line = "evaluate --quick --estimators simulator,oee"
    assert run_command(*line.split(), "--slides") == 2
    assert "--slides must be given with --output" in capsys.readouterr().err
    assert run_command(*line.split(), "--slides", "--output", "out") == 0
    assert size_of(Path("out/values.png").read_bytes()) == (1920, 1080)
    assert box_of(Path("out/values.svg").read_text()) == pytest.approx(16 / 9)
    # the same command without it replaces what it wrote
    assert run_command(*line.split(), "--output", "out") == 0
    assert size_of(Path("out/values.png").read_bytes()) != (1920, 1080)


def test_studies_draw_slides(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one = "bench --families machine --sizes 3 --seeds 2 --jobs 1 --slides --output b"
    assert run_command(*one.split()) == 0
    for name in ("sizes", "profile", "heat"):
        assert size_of(Path("b", f"{name}.png").read_bytes()) == (1920, 1080)
    two = "reproduce estimands --smoke --seeds 1 --jobs 1 --slides --output r"
    assert run_command(*two.split()) == 0
    folder = Path("r/smoke/estimands")
    assert size_of((folder / "figure.png").read_bytes()) == (1920, 1080)
    for kind, beginning in BEGINNINGS.items():
        assert (folder / f"figure.{kind}").read_bytes().startswith(beginning)


# ---- the schematic


def test_the_stored_schematic_is_what_the_script_draws():
    stored = drawn_images.SCHEMATIC.read_text()
    drawn = drawn_images.schematic()
    assert drawn_images.comparable(stored) == drawn_images.comparable(drawn)
    # it would differ by a word, a colour or a place
    for change in (
        ("Policy", "policy"),
        ("#0072b2", "#0072b3"),
        ("L 460.8", "L 461.8"),
    ):
        assert drawn_images.comparable(stored.replace(*change)) != (
            drawn_images.comparable(drawn)
        )


@pytest.mark.parametrize("name", drawn_images.EXAMPLES)
def test_the_stored_pictures_of_the_example_are_what_the_script_draws(name):
    """Huge numbers, whose digits depend on the solver, apart."""

    def plain(text):
        return re.sub(r"−?[\d.]+e\+\d+", "", drawn_images.comparable(text))

    stored = (drawn_images.IMAGES / f"{name}.svg").read_text()
    assert plain(stored) == plain(drawn_images.example(name))
    assert "var(--ink" in stored


def test_the_schematic_can_be_read_aloud():
    root = ET.fromstring(drawn_images.SCHEMATIC.read_text())
    name = "{http://www.w3.org/2000/svg}"
    assert root.get("role") == "img"
    labels = root.get("aria-labelledby").split()
    found = {node.get("id"): node.text for node in root.iter() if node.text}
    assert len({found[label] for label in labels}) == 2
    about = found[labels[1]].lower()
    texts = {"".join(node.itertext()).strip() for node in root.iter(f"{name}text")}
    for word in ("Simulator", "Target", "Policy", "Log", "Value"):
        assert word in texts
        assert word.lower() in about


def test_words_of_the_schematic_do_not_overlap():
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    ax = plots.schematic(figure.subplots())
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in ax.texts]
    for k, one in enumerate(boxes):
        assert ax.get_window_extent().containsx(one.x0)
        assert ax.get_window_extent().containsx(one.x1)
        assert not any(one.overlaps(other) for other in boxes[:k])
