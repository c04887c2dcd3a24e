"""Notebooks are stored with their outputs, which a code host and the site show: what they say when they are run.

PYTHONPATH=. python tests/saved_notebook.py          runs all of them and stores them again
PYTHONPATH=. python tests/saved_notebook.py 00 05    these
"""

import base64
import io
import os
import sys
import tempfile
from pathlib import Path

import nbclient
import nbformat
from PIL import Image

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("[0-9]*.ipynb"))


def run(path, folder):
    """Run a notebook in a folder; give it with its outputs, without times, versions and what goes to stderr."""
    book = nbformat.read(path, as_version=4)
    stored = {"kernelspec": book.metadata.kernelspec, "language_info": {"name": "python"}}
    client = nbclient.NotebookClient(book, timeout=600, record_timing=False, resources={"metadata": {"path": folder}})
    client.execute(env=os.environ | {"MPLBACKEND": "module://matplotlib_inline.backend_inline"})
    book.metadata = nbformat.from_dict(stored)
    for cell in book.cells:
        if cell.cell_type == "code":
            cell.execution_count = None
            cell.outputs = join_streams([output for output in cell.outputs if output.get("name") != "stderr"])
            for output in cell.outputs:
                strip(output)
    return book


def join_streams(outputs):
    """Join what is printed in several pieces, which depend on the machine's load."""
    joined = []
    for output in outputs:
        if joined and output.output_type == joined[-1].output_type == "stream":
            joined[-1].text += output.text
        else:
            joined.append(output)
    return joined


def strip(output):
    """Take the count, metadata and the rarest colours of a picture from an output."""
    if output.output_type != "stream":
        output.metadata = nbformat.from_dict({})
    if "execution_count" in output:
        output.execution_count = None
    if picture := output.get("data", {}).get("image/png"):
        small = io.BytesIO()
        image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
        image.quantize(256, dither=Image.Dither.NONE).save(small, "png", optimize=True)
        output.data["image/png"] = base64.b64encode(small.getvalue()).decode()


def texts(book):
    """What each code cell prints and returns; of a picture nothing, since its size depends on the extras."""
    return ["".join(map(text_of, cell.outputs)) for cell in book.cells if cell.cell_type == "code"]


def text_of(output):
    """The text of one output."""
    if output.output_type == "stream":
        return output.text
    return "" if "image/png" in output.data else output.data["text/plain"]


if __name__ == "__main__":
    for path in NOTEBOOKS:
        if path.name[:2] in sys.argv[1:] or len(sys.argv) == 1:
            with tempfile.TemporaryDirectory() as folder:
                nbformat.write(run(path, folder), path)
