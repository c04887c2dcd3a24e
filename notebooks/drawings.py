"""Drawings that follow the page's colours: SVG files whose colours are CSS variables
stand in the page itself, so that they can be read in the dark as well.
"""

from pathlib import Path

from docutils import nodes


def drawing_of(folder: Path, address: str) -> str | None:
    """Return the SVG that stands for a picture, or nothing.

    It has the picture's name and colours that are variables of the page.
    """
    path = (folder / address).with_suffix(".svg")
    if "://" in address or not path.is_file():
        return None
    text = path.read_text(encoding="utf-8")
    return text if text.startswith("<svg") and "var(--" in text else None


def put_into_page(app, doctree) -> None:
    """Put drawings in place of the pictures for which there are any."""
    for picture in list(doctree.findall(nodes.image)):
        address = picture["uri"]
        svg = drawing_of(Path(app.srcdir), address)
        if svg is not None:
            app.env.note_dependency(str(Path(address).with_suffix(".svg")))
            box = f'<div class="drawing">{svg}</div>'
            picture.replace_self(nodes.raw("", box, format="html"))
