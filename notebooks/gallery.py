"""The gallery's cards: a thumbnail of each picture of the notebooks and of each saved
result, with a link to the page that it is from.
"""

import hashlib
import io
import re

import books
from PIL import Image

RESULTS = books.FOLDER / "results"
# Written beside the pages that are made, which git ignores.
THUMBNAILS = books.FOLDER / "api" / "thumbnails"
WIDTH = 360  # pixels of a thumbnail; a card is at most as wide
GRID = "::::{grid} 1 2 3 4\n:gutter: 2\n:class-container: thumbnails\n"


def thumbnail(png: bytes) -> str:
    """Write a small copy of a picture; return its place among the sources.

    Its name is made from its content, so that it is made once.
    """
    THUMBNAILS.mkdir(parents=True, exist_ok=True)
    path = THUMBNAILS / f"{hashlib.sha256(png).hexdigest()[:16]}.png"
    if not path.is_file():
        image = Image.open(io.BytesIO(png)).convert("RGB")
        height = round(image.height * WIDTH / image.width)
        small = image.resize((WIDTH, height), Image.Resampling.LANCZOS)
        small.quantize(128).save(path, optimize=True)
    return path.relative_to(books.FOLDER).as_posix()


def plain(text: str) -> str:
    """Return a text that Markdown shows as it is, in one line."""
    return re.sub(r"([*_`\[\]<>$|\\])", r"\\\1", " ".join(text.split()))


def card(picture: str, alt: str, page: str, text: str) -> str:
    """Return a card with a thumbnail; all of it is a link to a page."""
    lines = [
        ":::{grid-item-card}",
        f":img-top: {picture}",
        f":img-alt: {' '.join(alt.split())}",
        f":link: {page}",
        ":link-type: doc",
        f":link-alt: {' '.join(text.split())}",
        "",
        plain(text),
        ":::",
        "",
    ]
    return "\n".join(lines)


def notebook_cards() -> str:
    """Return a section for each notebook, with a card for each of its pictures."""
    parts = []
    for path in books.main_notebooks():
        book = books.read(path)
        number = path.stem.partition("_")[0]
        cards = []
        for k, picture in enumerate(books.pictures_of(book), 1):
            text = picture.title or f"Picture {k} of notebook {number}"
            alt = f"Picture {k} of notebook {number}: {picture.title or 'see there'}"
            cards.append(card(thumbnail(picture.png), alt, path.stem, text))
        if cards:
            head = f"### {number}. {plain(books.title_of(book))}\n"
            parts += [head, GRID, *cards, "::::\n"]
    return "\n".join(parts)


def result_cards() -> str:
    """Return a card for each saved result that has a picture and a page."""
    cards = []
    order = re.findall(r"\]\((\w+)/summary\.md\)", (RESULTS / "index.md").read_text())
    for name in dict.fromkeys(order):
        folder = RESULTS / name
        page, picture = folder / "summary.md", folder / "figure.png"
        if not (page.is_file() and picture.is_file()):
            continue
        text = page.read_text()
        title = text.partition("\n")[0].removeprefix("# ")
        shown = re.search(r"!\[(.+)\]\(figure\.png\)", text)
        alt = shown[1] if shown else title
        small = thumbnail(picture.read_bytes())
        cards.append(card(small, alt, f"results/{name}/summary", title))
    return "\n".join([GRID, *cards, "::::\n"])


def fill(text: str) -> str:
    """Return the gallery's page with its cards in place of two comments."""
    filled = text.replace("<!-- cards of notebooks -->", notebook_cards())
    return filled.replace("<!-- cards of results -->", result_cards())
