"""Eight slide decks, one for each week of the syllabus, from tagged cells of notebooks.

python notebooks/slides.py slides                          all eight, into slides/
python notebooks/slides.py slides --weeks 3 5              those of two weeks
python notebooks/slides.py slides --reveal package         with a copy of reveal.js

A cell is on a slide where its metadata have ``"slideshow": {"slide_type": "slide"}``. A
cell of text is a slide for each of its headings, a cell of code one with the picture
that it draws, or with its few lines and what they print. ``"slide": "..."`` in the
metadata is the slide's text: in place of a cell's own, or above a picture. So a slide
stands alone, with its numbers and assumptions. Where a text of code has no heading, it
is the title of the picture. Exercises and solutions are never shown. The notebooks are
run for pictures of 1920 x 1080 pixels, which takes about two minutes of one core;
``--stored`` takes their stored pictures and a few seconds. A cell with
``"slide_picture": "stored"`` in its metadata always has its stored picture: one with
many panels is too small in the shape of a slide.

Decks are shown by reveal.js 4, which is loaded from a URL unless ``--reveal`` names a
folder with a copy: ``npm pack reveal.js@4.6.1`` and ``tar xf reveal.js-4.6.1.tgz``
make the folder ``package``. With a copy the decks need no network.
"""

import argparse
import base64
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import nbformat

FOLDER = Path(__file__).parent
REVEAL_URL = "https://unpkg.com/reveal.js@4.6.1"
REVEAL_FILES = ("reveal.js", "reveal.css", "theme/white.css", "theme/fonts")
MAX_GOALS = 6  # on the slide with the title
MAX_CODE_LINES = 19
MAX_PRINTED_LINES = 16
MIN_PRINTED_LINES = 8
MAX_LINES = 28  # of code and what it prints
KINDS = ("slide", "subslide")
# the titles in a cell of code; a single one is the slide's heading
TITLE = r'title(?:\(|=)\s*"([^"]+)"'
# A notebook's figures become slides after each cell, before they are shown.
BEFORE = """
import textwrap

from IPython import get_ipython
from matplotlib._pylab_helpers import Gcf
from oee_tabular import plots


def fit_all(shell=get_ipython(), fill=textwrap.fill, plots=plots):
    for manager in Gcf.get_all_fig_managers():
        figure = manager.canvas.figure
        with plots.slides():
            plots.fit_slide(figure)
        for ax in figure.axes:
            inches = ax.get_window_extent().width / figure.dpi
            is_heading = ax.get_title().lower() in HEADINGS
            letters = max(int(N_TITLE_LETTERS * inches), 12)
            ax.set_title("" if is_heading else fill(ax.get_title(), letters))


get_ipython().events.register("post_execute", fit_all)
get_ipython().run_line_magic("matplotlib", "inline")
get_ipython().run_line_magic(
    "config", "InlineBackend.print_figure_kwargs = {'bbox_inches': None}"
)
style = plots.slides()
style.__enter__()
""".replace("N_TITLE_LETTERS", "10.0")


class Week(NamedTuple):
    """Hold a line of the syllabus."""

    number: int
    topic: str
    notebooks: list[Path]
    exercises: str
    assignment: str


def read_weeks() -> list[Week]:
    """Read the table of weeks from the syllabus."""
    text = (FOLDER / "syllabus.md").read_text(encoding="utf-8")
    weeks = []
    for line in re.findall(r"^\| \d \|.*", text, re.MULTILINE):
        number, topic, _, read, _, exercises, assignment = line.strip("| ").split(" | ")
        books = [FOLDER / name for name in re.findall(r"\((\w+\.ipynb)\)", read)]
        assignment = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", assignment)
        weeks.append(Week(int(number), topic, books, exercises, assignment))
    return weeks


def is_tagged(cell: Any) -> bool:
    """Return whether a cell is on a slide."""
    return cell.metadata.get("slideshow", {}).get("slide_type") in KINDS


def run_for_slides(book: Any) -> Any:
    """Run a notebook up to its last slide, with pictures of the shape of a slide."""
    from nbclient import NotebookClient

    last = max(k for k, cell in enumerate(book.cells) if is_tagged(cell))
    shown = [cell for cell in book.cells[: last + 1] if is_tagged(cell)]
    headings = [
        heading.lower()
        for cell in shown
        for heading in re.findall(r"^## (.+)$", code_text(cell, ""), re.M)
        if cell.cell_type == "code"
    ]
    before = BEFORE.replace("HEADINGS", repr(headings))
    stored = {
        cell.id: cell.outputs
        for cell in shown
        if cell.metadata.get("slide_picture") == "stored"
    }
    book.cells = [nbformat.v4.new_code_cell(before), *book.cells[: last + 1]]
    quiet = ["--IPKernelApp.log_level=40"]
    client = NotebookClient(
        book, timeout=600, kernel_name="python3", extra_arguments=quiet
    )
    client.execute()
    for cell in shown:
        if cell.id in stored:
            cell.outputs = stored[cell.id]
    return book


# ---- what of a cell is on a slide


def text_slides(cell: Any, heading: str) -> list[str]:
    """Return the slides of a cell of text: one a heading, exercises left out."""
    source = cell.metadata.get("slide", cell.source)
    source = re.sub(r"<details>.*?</details>", "", source, flags=re.DOTALL)
    slides = []
    for part in re.split(r"^(?=#+ )", source, flags=re.MULTILINE):
        if not part.strip() or re.match(r"#+ Exercise", part):
            continue
        if not part.startswith("#"):
            part = f"{heading}\n\n{part}"
        slide = re.sub(r"^#+ (\d+\. )?", "## ", part.strip())
        if "\n" in slide:  # more than its heading
            slides.append(slide)
    return slides


def code_text(cell: Any, section: str) -> str:
    """Return the text above a picture: a heading, and what the metadata say.

    The heading is that of the metadata, or the title in the code, or the section's.
    """
    text: str = cell.metadata.get("slide", "")
    if text.startswith("## "):
        return text
    titles = re.findall(TITLE, cell.source)
    if len(titles) == 1:
        section = f"## {titles[0][0].upper()}{titles[0][1:]}"
    return f"{section}\n\n{text}".strip()


def first_lines(text: str, most: int) -> str:
    """Return a block of code with no more than some lines, cut at an empty one."""
    lines = text.rstrip("\n").split("\n")
    if len(lines) > most:
        empty = [k for k, line in enumerate(lines[:most]) if not line.strip()]
        lines = [*lines[: max(empty, default=most)], "..."]
    return "```text\n" + "\n".join(lines) + "\n```"


def code_slide(cell: Any, folder: Path, heading: str) -> str:
    """Return the slide of a cell of code, and write its picture into a folder."""
    parts = [code_text(cell, heading)]
    texts = []
    for output in cell.outputs:
        data = output.get("data", {})
        if "image/png" in data:
            folder.mkdir(exist_ok=True)
            name = f"{cell.id}.png"
            (folder / name).write_bytes(base64.b64decode(data["image/png"]))
            words = re.sub(r"[#$]", "", parts[0].partition("\n")[0]).strip()
            parts.append(f"![{words or 'A picture'}]({folder.name}/{name})")
        elif data.get("text/html", "").startswith("<img"):
            parts.append(data["text/html"])
        else:
            texts.append(output.get("text") or data.get("text/plain", ""))
    if len(parts) == 1:  # no picture: the code, if it is short, and what it prints
        most = MAX_PRINTED_LINES
        n_lines = cell.source.count("\n") + 1
        if n_lines <= MAX_CODE_LINES:
            parts.append(f"```python\n{cell.source}\n```")
            most = min(most, max(MAX_LINES - n_lines, MIN_PRINTED_LINES))
        if any(texts):
            parts.append(first_lines("".join(texts), most))
    return "\n\n".join(part for part in parts if part)


# ---- a deck


def opening(week: Week, books: Sequence[Any]) -> str:
    """Return the slide with the title, and what one can do after the lecture."""
    first = [book.cells[0].source for book in books]
    items = [item for text in first for item in re.findall(r"^[-*] .*", text, re.M)]
    goals = [item.rstrip(",;.") for item in items[:MAX_GOALS]]
    return "\n\n".join([f"# Week {week.number}: {week.topic}", "\n".join(goals)])


def closing(week: Week) -> str:
    """Return the slide that says what to do at the computer."""
    names = ", ".join(path.stem.split("_")[0] for path in week.notebooks)
    return (
        f"## At the computer\n\n- Notebooks: {names}\n- Exercises: {week.exercises}\n"
        f"- Assignment: {week.assignment}"
    )


def deck_cells(week: Week, folder: Path, is_stored: bool) -> list[Any]:
    """Return a deck as cells of text, each with the metadata of its slide."""
    books = [nbformat.read(path, as_version=4) for path in week.notebooks]
    texts = [opening(week, books)]
    for book in books:
        heading = ""
        for cell in (book if is_stored else run_for_slides(book)).cells:
            if is_tagged(cell) and cell.cell_type == "code":
                texts.append(code_slide(cell, folder, heading))
            elif is_tagged(cell):
                texts += text_slides(cell, heading)
            if cell.cell_type == "markdown":
                found = re.findall(
                    r"^##+ (?!Exercise)(?:\d+\. )?(.+)$", cell.source, re.M
                )
                heading = f"## {found[-1]}" if found else heading
    marks = {"slideshow": {"slide_type": "slide"}}
    return [
        nbformat.v4.new_markdown_cell(text, metadata=marks)
        for text in [*texts, closing(week)]
    ]


def write_deck(week: Week, output: Path, reveal: str, is_stored: bool) -> Path:
    """Write the deck of a week, with its pictures beside it."""
    from nbconvert import SlidesExporter

    cells = deck_cells(week, output / f"week_{week.number}", is_stored)
    book = nbformat.v4.new_notebook(cells=cells, metadata={"title": week.topic})
    exporter = SlidesExporter(
        extra_template_paths=[str(FOLDER)],
        template_file="slides.html.j2",
        reveal_url_prefix=reveal,
        reveal_theme="white",
        mathjax_url="mathjax/tex-svg.js",
    )
    html, _ = exporter.from_notebook_node(book)
    file = output / f"week_{week.number}.html"
    file.write_text(html, encoding="utf-8")
    return file


def copy_scripts(reveal: str, output: Path) -> str:
    """Copy MathJax, and reveal.js from a folder; return where decks find reveal.js."""
    shutil.copytree(FOLDER / "static/mathjax", output / "mathjax", dirs_exist_ok=True)
    if "://" in reveal:
        return reveal
    for name in REVEAL_FILES:
        source = Path(reveal) / "dist" / name
        if not source.exists():
            raise SystemExit(f"--reveal must be a URL or a folder with dist/{name}")
        target = output / "reveal.js" / "dist" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        else:
            shutil.copyfile(source, target)
    return "reveal.js"


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the decks, and print where they are."""
    weeks = read_weeks()
    numbers = [week.number for week in weeks]
    parser = argparse.ArgumentParser(description="Slide decks of the syllabus.")
    parser.add_argument("output", type=Path, help="a folder, made if it is not there")
    parser.add_argument(
        "--weeks", type=int, nargs="+", choices=numbers, default=numbers
    )
    parser.add_argument("--reveal", default=REVEAL_URL, help="a URL or a folder")
    parser.add_argument(
        "--stored", action="store_true", help="do not run the notebooks"
    )
    given = parser.parse_args(arguments)
    given.output.mkdir(parents=True, exist_ok=True)
    reveal = copy_scripts(given.reveal, given.output)
    for week in weeks:
        if week.number in given.weeks:
            print(write_deck(week, given.output, reveal, given.stored))


if __name__ == "__main__":
    main()
