"""Make the students' notebooks in ``release`` from the instructor's ones in ``source``.

python notebooks/assignments/make.py

The format is nbgrader's: ``nbgrader generate_assignment`` makes the same cells from
``source``. This script needs nbformat alone.
"""

import re
from pathlib import Path

import nbformat

FOLDER = Path(__file__).parent
STUB = ("# YOUR CODE HERE", "raise NotImplementedError()")


def cut(text, name, stub=()):
    """Return a text with the regions BEGIN name ... END name replaced by a stub."""
    lines, is_inside = [], False
    for line in text.split("\n"):
        if f"BEGIN {name}" in line:
            if is_inside:
                raise ValueError(f"BEGIN {name} stands twice without an END: {line}")
            is_inside = True
            indent = re.match(r"\s*", line).group()
            lines += [indent + part for part in stub]
        elif f"END {name}" in line:
            if not is_inside:
                raise ValueError(f"END {name} stands without a BEGIN: {line}")
            is_inside = False
        elif not is_inside:
            lines.append(line)
    if is_inside:
        raise ValueError(f"BEGIN {name} has no END in the cell {text[:60]!r}")
    return "\n".join(lines)


def release(book):
    """Return the student's notebook of an instructor's one."""
    book = nbformat.from_dict(nbformat.reads(nbformat.writes(book), as_version=4))
    for cell in book.cells:
        if cell.cell_type != "code":
            continue
        cell.source = cut(cell.source, "SOLUTION", STUB)
        cell.source = cut(cell.source, "HIDDEN TESTS")
        cell.outputs, cell.execution_count = [], None
        about = cell.metadata.get("nbgrader")
        if about and (about.solution or about.locked):
            cell.metadata.deletable = False
        if about and about.locked:
            cell.metadata.editable = False
    return book


def sources():
    """Return the instructor's notebooks, in their order."""
    return sorted((FOLDER / "source").glob("assignment_*/*.ipynb"))


def released(path):
    """Return where the student's notebook of an instructor's one is kept."""
    return FOLDER / "release" / path.relative_to(FOLDER / "source")


if __name__ == "__main__":
    for path in sources():
        book = release(nbformat.read(path, as_version=4))
        released(path).parent.mkdir(parents=True, exist_ok=True)
        nbformat.write(book, released(path))
        print(released(path).relative_to(FOLDER))
