"""What the site says of a notebook beside its cells: level, minutes, its files and its
pictures.
"""

import base64
import html
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nbformat

FOLDER = Path(__file__).parent
# A notebook says itself how hard it is: {"oee": {"level": ..., "minutes": ...}} in its
# metadata. These are the levels of those that do not; others are intermediate.
LEVELS = {
    "00_will_my_policy_work": "beginner",
    "01_finite_mdps": "beginner",
    "05_little_data": "advanced",
    "06_the_papers_three_questions": "advanced",
    "08_cartpole": "advanced",
    "09_reacher_and_kinova": "advanced",
}
# "**Time**: 25 minutes to read, 50 with the exercises"
TIME = re.compile(r"\*\*Time\*\*:\D*(\d+) minutes(?: to read, (\d+) with)?")
# How fast a notebook is worked through where it does not say how long it takes.
WORDS_A_MINUTE = 200
LINES_OF_CODE_A_MINUTE = 15
MINUTES_OF_AN_EXERCISE = 5


@dataclass(frozen=True)
class Picture:
    """Hold a picture that a notebook shows.

    Attributes
    ----------
    png : bytes
        The file.
    title : str
        What the code that draws it calls it; empty without a title.
    """

    png: bytes
    title: str


def read(path: Path) -> Any:
    """Read a notebook."""
    return nbformat.read(path, as_version=4)


def main_notebooks() -> list[Path]:
    """List the numbered notebooks of the site, in their order."""
    return sorted(FOLDER.glob("[0-9]*.ipynb"))


def title_of(book: Any) -> str:
    """Return the first heading of a notebook, without its number."""
    for cell in book.cells:
        found = re.search(r"^# (.+)$", cell.source, re.M)
        if cell.cell_type == "markdown" and found:
            return re.sub(r"^\d+\.?\s+|\$|\*", "", found[1])
    return ""


def level_of(name: str, book: Any) -> str:
    """Return how hard a notebook is, in a word."""
    told = book.metadata.get("oee", {}).get("level")
    return str(told or LEVELS.get(name, "intermediate"))


def minutes_of(book: Any) -> int:
    """Return how long a notebook takes with its exercises, in minutes.

    It says so in its metadata or in a line of its own; without either it is estimated.
    """
    told = book.metadata.get("oee", {}).get("minutes")
    if told:
        return int(told)
    texts = [cell.source for cell in book.cells if cell.cell_type == "markdown"]
    if said := TIME.search("\n".join(texts)):
        return int(said[2] or said[1])
    codes = [cell.source for cell in book.cells if cell.cell_type == "code"]
    minutes = sum(len(text.split()) for text in texts) / WORDS_A_MINUTE
    minutes += sum(len(code.splitlines()) for code in codes) / LINES_OF_CODE_A_MINUTE
    exercises = sum(
        len(re.findall(r"^(?:#+ |\*\*)Exercise", text, re.M)) for text in texts
    )
    minutes += exercises * MINUTES_OF_AN_EXERCISE
    return max(5, 5 * math.ceil(minutes / 5))


def script(book: Any) -> str:
    """Return a notebook as Python: cells begin with ``# %%``, and texts are comments.

    Spyder, PyCharm, Visual Studio Code and Jupytext read such files cell by cell.
    """
    parts = []
    for cell in book.cells:
        if cell.cell_type == "code":
            lines = [
                f"# {line}" if line.startswith(("%", "!")) else line
                for line in cell.source.splitlines()
            ]
            parts.append(["# %%", *lines])
        else:
            lines = [f"# {line}".rstrip() for line in cell.source.splitlines()]
            parts.append(["# %% [markdown]", *lines])
    return "\n\n".join("\n".join(lines).rstrip() for lines in parts) + "\n"


def picture_title(code: str) -> str:
    """Return the titles in the code that draws a picture.

    Formulas lose their dollars, and a number that the code puts in is three dots.
    """
    titles = re.findall(r'title(?:\(|=)\s*(f?)"([^"]+)"', code)
    plain = [re.sub(r"\{[^}]*\}", "...", text) if f else text for f, text in titles]
    return "; ".join(plain).replace("$", "")


def pictures_of(book: Any) -> Iterator[Picture]:
    """Yield the pictures that a notebook has stored, in their order."""
    for cell in book.cells:
        for output in cell.get("outputs", []):
            png = output.get("data", {}).get("image/png")
            if png:
                yield Picture(base64.b64decode(png), picture_title(cell.source))


def files_of(page: str) -> list[str]:
    """List the files that can be downloaded from a notebook's page, from the root.

    A page of another kind has none. An assignment has no script: it is handed in as a
    notebook.
    """
    path = FOLDER / f"{page}.ipynb"
    if not path.is_file():
        return []
    name = f"downloads/{path.stem}"
    is_main = path.parent == FOLDER
    return [f"{name}.ipynb", f"{name}.py"] if is_main else [f"{name}.ipynb"]


def write_files(page: str, site: Path) -> None:
    """Write what can be downloaded from a notebook's page into the site."""
    source = FOLDER / f"{page}.ipynb"
    for name in files_of(page):
        target = site / name
        target.parent.mkdir(exist_ok=True)
        if target.suffix == ".ipynb":
            target.write_bytes(source.read_bytes())
        else:
            target.write_text(script(read(source)), encoding="utf-8")


def facts(page: str, root: str) -> str:
    """Return the line below a notebook's title, as HTML; ``root`` leads to the site's.

    It has the level, the minutes and the files.
    """
    files = files_of(page)
    if not files:
        return ""
    links = ", ".join(
        f'<a href="{html.escape(root + name)}" download>'
        f"{html.escape(name.rpartition('/')[2])}</a>"
        for name in files
    )
    book = read(FOLDER / f"{page}.ipynb")
    told = "level" in book.metadata.get("oee", {}) or "/" not in page
    words = f"Download: {links}"
    if told:
        level = level_of(page, book).capitalize()
        words = f"{level} · about {minutes_of(book)} minutes · {words}"
    return f'<p class="notebook-facts">{words}</p>'
