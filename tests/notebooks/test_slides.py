"""The slide decks: one a week, with pictures and without solutions."""

import importlib
import re
import struct
import sys
from pathlib import Path

import nbformat
import pytest
from saved_notebook import NOTEBOOKS

pytest.importorskip("nbconvert")

FOLDER = Path(__file__).parents[2] / "notebooks"
WEEKS = range(1, 9)
MIN_SLIDES = 8
MAX_WORDS = 130
URL = "https://example.org/reveal.js"
SECTION = re.compile(r"<section.*?</section>", re.DOTALL)
PICTURE = re.compile(r"""<img alt=(["'])(.+?)\1 src="([^"]+)""")


@pytest.fixture(scope="module")
def slides():
    """The module that makes the decks."""
    sys.path.insert(0, str(FOLDER))
    yield importlib.import_module("slides")
    sys.path.remove(str(FOLDER))
    sys.modules.pop("slides", None)


@pytest.fixture(scope="module")
def decks(slides, tmp_path_factory):
    """The folder of all eight, with the stored pictures."""
    folder = tmp_path_factory.mktemp("decks") / "new"
    slides.main([str(folder), "--stored", "--reveal", URL])
    return folder


def size(picture):
    """Width and height of a PNG, from its header."""
    data = picture.read_bytes()
    assert data[:4] == b"\x89PNG"
    return struct.unpack(">II", data[16:24])


def solutions():
    """What folds out below the exercises, a line each."""
    texts = [
        cell.source
        for path in NOTEBOOKS
        for cell in nbformat.read(path, as_version=4).cells
        if cell.cell_type == "markdown"
    ]
    found = re.findall(r"<details>.*?</details>", "\n".join(texts), re.DOTALL)
    lines = [line.strip() for text in found for line in text.split("\n")]
    return {line for line in lines if len(line) > 25 and "<" not in line}


@pytest.mark.parametrize("number", WEEKS)
def test_a_deck_has_a_title_slides_and_pictures(slides, decks, number):
    html = (decks / f"week_{number}.html").read_text()
    week = slides.read_weeks()[number - 1]
    parts = SECTION.findall(html)
    assert len(parts) >= MIN_SLIDES
    assert f"Week {number}: {week.topic}" in parts[0]
    assert "At the computer" in parts[-1]
    assert week.exercises in parts[-1]
    assert all(re.search("<h[12]", part) for part in parts)
    pictures = PICTURE.findall(html)
    assert 3 <= len(pictures) == html.count("<img")
    for source in {source for *_, source in pictures if source[:5] != "data:"}:
        assert min(size(decks / source)) > 200


@pytest.mark.parametrize("number", WEEKS)
def test_a_deck_shows_no_exercise_and_no_solution(slides, decks, tmp_path, number):
    week = slides.read_weeks()[number - 1]
    cells = slides.deck_cells(week, tmp_path / "pictures", True)
    text = "\n".join(cell.source for cell in cells)
    lines = solutions()
    assert len(lines) > 30
    assert not [line for line in lines if line in text]
    assert not re.search(r"<details|Solution|check\(|answer = |Exercise [a-e]\b", text)


def numbers_of(text):
    """The numbers of a text, each with the digits behind its point; of 12% also 0.12."""
    text = re.sub(r"(?<=\d)[ _](?=\d{3}\b)", "", text.replace("−", "-"))
    found = re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?:e[-+]?\d+)?(?= ?%)?", text)
    shares = re.findall(r"(\d+(?:\.\d+)?) ?%", text)
    return found, shares


def rounds_to(number, digits, texts):
    """Whether one of the numbers in texts is a number, rounded to some digits."""
    return any(round(abs(float(x)), digits) == number for x in texts)


@pytest.mark.parametrize("number", WEEKS)
def test_a_slide_s_numbers_are_those_of_its_notebook(slides, number):
    """Each decimal and each number above 20 is one that the notebook says or prints."""
    checked = 0
    for path in slides.read_weeks()[number - 1].notebooks:
        book = nbformat.read(path, as_version=4)
        outputs = [
            output.get("text") or output.get("data", {}).get("text/plain", "")
            for cell in book.cells
            for output in cell.get("outputs", [])
        ]
        sources = [cell.source for cell in book.cells]
        known, known_shares = numbers_of("\n".join(sources + outputs))
        known += [str(float(share) / 100) for share in known_shares]
        for cell in book.cells:
            text = cell.metadata.get("slide", "")
            text = re.sub(r"\$\$.*?\$\$|`[^`]*`", "", text, flags=re.DOTALL)
            found, shares = numbers_of(text)
            for word in found:
                if word in shares or (float(word) <= 20 and "." not in word):
                    continue
                digits = len(word.partition("e")[0].partition(".")[2])
                scale = 10.0 ** int(word.partition("e")[2] or 0)
                ready = [float(x) / scale for x in known]
                is_known = rounds_to(float(word) / scale, digits, ready)
                assert is_known, (path.name, cell.id, word)
                checked += 1
            for share in shares:
                digits = len(share.partition(".")[2]) + 2
                is_known = share in known_shares or rounds_to(
                    round(float(share) / 100, digits), digits, known
                )
                assert is_known, (path.name, cell.id, f"{share}%")
                checked += 1
    assert checked >= 5


@pytest.mark.parametrize("number", WEEKS)
def test_each_slide_stands_alone(slides, tmp_path, number):
    """Its own heading, some words beside a picture, and few enough to be read."""
    week = slides.read_weeks()[number - 1]
    texts = [cell.source for cell in slides.deck_cells(week, tmp_path, True)]
    headings = [text.partition("\n")[0] for text in texts]
    assert len(set(headings)) == len(headings)
    for text in texts[1:-1]:
        prose = re.sub(r"\$\$.*?\$\$|^```.*?^```", "", text, flags=re.DOTALL | re.M)
        prose = re.sub(r"^## .*$|!\[.*|<img.*|^\|.*$", "", prose, flags=re.M)
        words = len(prose.split())
        assert words <= MAX_WORDS, (words, text)
        assert words >= 8 or "|" in text, text
        assert not re.search(r"\bbelow\b|:\s*$", prose), text


def test_slides_say_what_they_assume(slides, tmp_path):
    """What a first sentence alone would leave out."""
    for number, *said in (
        (1, "must depend on the state and the action alone"),
        (3, "The tilt is an assumption", "tilt's assumption holds here"),
        (4, "wherever $\\hat\\zeta$ is wrong"),
        (5, "the slip changed alike in all cells", "assumes that change is normal"),
        (6, "an assumption of yours", "Rewards are taken as known"),
        (7, "need the unknown $P'$"),
    ):
        week = slides.read_weeks()[number - 1]
        text = "\n".join(c.source for c in slides.deck_cells(week, tmp_path, True))
        for words in said:
            assert words in text, (number, words)


@pytest.mark.parametrize("number", WEEKS)
def test_a_deck_asks_for_reveal_and_mathjax_alone(decks, number):
    html = (decks / f"week_{number}.html").read_text()
    asked = re.findall(r'<(?:script|link)[^>]+(?:src|href)="([^"]+)"', html)
    assert {source for source in asked if "://" not in source} == {"mathjax/tex-svg.js"}
    assert all(source.startswith(URL) for source in asked if "://" in source)
    assert (decks / "mathjax" / "tex-svg.js").is_file()


def test_pictures_are_made_anew_in_the_shape_of_a_slide(slides, tmp_path):
    slides.main([str(tmp_path), "--weeks", "2", "--reveal", URL])
    pictures = list((tmp_path / "week_2").glob("*.png"))
    assert len(pictures) >= 5
    assert {size(picture) for picture in pictures} == {(1920, 1080)}


def test_a_cell_keeps_its_stored_picture_where_it_says_so(slides):
    """A notebook that is run draws the others anew."""
    marks = {"slideshow": {"slide_type": "slide"}}
    draw = "import matplotlib.pyplot as plt\nplt.plot([1, 2])"
    old = nbformat.v4.new_output("stream", text="stored")
    cells = [
        nbformat.v4.new_code_cell(draw, metadata=marks | more, outputs=[old])
        for more in ({}, {"slide_picture": "stored"})
    ]
    _, anew, kept = slides.run_for_slides(nbformat.v4.new_notebook(cells=cells)).cells
    assert kept.outputs == [old]
    assert old not in anew.outputs


def test_a_slide_defines_the_names_that_the_next_ones_use(slides, tmp_path):
    """Week 3 shows the cell that makes what "One value, three ways" is made of."""
    week = slides.read_weeks()[2]
    text = "\n".join(c.source for c in slides.deck_cells(week, tmp_path, True))
    first = text.partition("## One value, three ways")[0]
    for name in ("by_the_page", "P_tr, P_te", "zeta", "simulator", "target", "T"):
        assert re.search(rf"^{name} = ", first, re.M), name


def test_a_copy_of_reveal_goes_beside_the_decks(slides, tmp_path):
    copy = tmp_path / "package" / "dist"
    (copy / "theme" / "fonts").mkdir(parents=True)
    for name in ("reveal.js", "reveal.css", "theme/white.css", "theme/fonts/a.css"):
        (copy / name).write_text(name)
    output = tmp_path / "decks"
    slides.main([str(output), "--weeks", "3", "--stored", "--reveal", str(copy.parent)])
    html = (output / "week_3.html").read_text()
    for name in ("reveal.js", "reveal.css", "theme/white.css"):
        assert f'"reveal.js/dist/{name}"' in html
        assert (output / "reveal.js" / "dist" / name).read_text() == name
    assert (output / "reveal.js" / "dist" / "theme" / "fonts" / "a.css").is_file()
    assert "https://" not in " ".join(re.findall(r'(?:src|href)="([^"]+)"', html))


def test_wrong_arguments_are_errors(slides, tmp_path, capsys):
    with pytest.raises(SystemExit, match=r"--reveal must be a URL or a folder with"):
        slides.main([str(tmp_path), "--reveal", str(tmp_path / "nothing")])
    with pytest.raises(SystemExit):
        slides.main([str(tmp_path), "--weeks", "9"])
    assert "--weeks: invalid choice: 9" in capsys.readouterr().err
