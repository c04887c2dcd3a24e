"""Notebook 00 is stored with its outputs, so that a code host shows them: what it says when it is run.

PYTHONPATH=. python tests/saved_notebook.py      runs it and stores it again
"""

import os
from pathlib import Path

import nbclient
import nbformat

FIRST = Path(__file__).parents[1] / "notebooks" / "00_will_my_policy_work.ipynb"


def run(path=FIRST):
    """The notebook with its outputs, without times, versions and what goes to stderr."""
    book = nbformat.read(path, as_version=4)
    stored = {"kernelspec": book.metadata.kernelspec, "language_info": {"name": "python"}}
    client = nbclient.NotebookClient(
        book, timeout=300, record_timing=False, resources={"metadata": {"path": path.parent}}
    )
    client.execute(env=os.environ | {"MPLBACKEND": "module://matplotlib_inline.backend_inline"})
    book.metadata = nbformat.from_dict(stored)
    for cell in book.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    return book


def texts(book):
    """What each code cell prints and returns."""
    return [
        "".join(output.text if output.output_type == "stream" else output.data["text/plain"] for output in cell.outputs)
        for cell in book.cells
        if cell.cell_type == "code"
    ]


if __name__ == "__main__":
    nbformat.write(run(), FIRST)
