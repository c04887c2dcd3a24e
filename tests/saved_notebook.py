"""Notebooks are stored with their outputs, which a code host and the site show: what
they say when they are run.

PYTHONPATH=. python tests/saved_notebook.py          runs all of them and stores them
again
PYTHONPATH=. python tests/saved_notebook.py 00 05    these
"""

import base64
import contextlib
import importlib
import inspect
import io
import os
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import matplotlib
import nbformat
from PIL import Image

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("[0-9]*.ipynb"))
# Notebook 05 has no assertions that a student reads. They are in checks/after_05.py:
# its function after_05_17 runs after the cell 05-17, with the notebook's variables.
CHECKS = Path(__file__).parent / "notebooks" / "checks"
SERVE = "--serve"
WIDGET = "application/vnd.jupyter.widget-view+json"


@contextlib.contextmanager
def notebook_runner():
    """A function (path, folder) that runs a notebook in a folder and gives it with its
    outputs.

    It runs in a process of its own, a fork of one that has imported what all notebooks
    import and nothing else.
    """
    environment = os.environ | {
        "MPLBACKEND": "module://matplotlib_inline.backend_inline"
    }
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with (
        tempfile.TemporaryDirectory() as results,
        subprocess.Popen(
            [sys.executable, __file__, SERVE], env=environment, **pipes
        ) as server,
    ):

        def run(path, folder):
            result = Path(results) / path.name
            print(path, folder, result, sep="\t", file=server.stdin, flush=True)
            assert server.stdout.readline() == "0\n", (
                f"{path.name} failed, as its process said"
            )
            return nbformat.read(result, as_version=4)

        yield run
        server.stdin.close()


def number(path):
    """A notebook's number, such as 05."""
    return path.stem.split("_")[0]


def checks_of(path):
    """The functions that check a notebook, by the names of the cells they run after."""
    file = CHECKS / f"after_{number(path)}.py"
    if not file.is_file():
        return {}
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return {
        name.removeprefix("after_").replace("_", "-"): check
        for name, check in vars(module).items()
        if name.startswith("after_")
    }


def serve():
    """Fork for each line of stdin; print how the fork ended."""
    for module in (
        "IPython",
        "matplotlib.pyplot",
        "pandas",
        "oee_tabular.plots",
        "oee_tabular.testing.exercises",
    ):
        importlib.import_module(module)

    for line in sys.stdin:
        path, folder, result = line.rstrip("\n").split("\t")
        if not (pid := os.fork()):
            os.dup2(2, 1)
            os.chdir(folder)
            book = nbformat.read(path, as_version=4)
            nbformat.write(execute(book, checks_of(Path(path))), result)
            os._exit(0)
        print(os.waitpid(pid, 0)[1], flush=True)


def execute(book, checks):
    """The notebook with its outputs, without times, versions and what goes to stderr.

    A check that fails ends the process, as a cell that fails does.
    """
    from IPython.core import displayhook, displaypub
    from IPython.core.interactiveshell import InteractiveShell
    from IPython.utils.capture import capture_output
    from matplotlib_inline.backend_inline import configure_inline_support
    from traitlets.config import Config

    shown = []

    class Hook(displayhook.DisplayHook):
        def __call__(self, result=None):
            if result is not None and not self.quiet():
                shown.append(
                    nbformat.v4.new_output(
                        "execute_result", data=self.compute_format_data(result)[0]
                    )
                )

    class Publisher(displaypub.DisplayPublisher):
        def publish(self, data, *_, **__):
            # controls are of no use without Python, and have no text
            if WIDGET not in data:
                shown.append(nbformat.v4.new_output("display_data", data=data))

    class Shell(InteractiveShell):
        displayhook_class = Hook
        display_pub_class = Publisher

    shell = Shell.instance(config=Config(HistoryManager={"enabled": False}))
    matplotlib.interactive(True)
    configure_inline_support(shell, os.environ["MPLBACKEND"])
    sys.path.insert(0, "")
    for cell in book.cells:
        if cell.cell_type == "code":
            with capture_output(display=False) as captured:
                result = shell.run_cell(cell.source, store_history=True)
            if not result.success:
                print(captured.stdout, captured.stderr, file=sys.stderr)
                os._exit(1)
            if check := checks.get(cell.id):
                run_check(check, shell.user_ns)
            printed = (
                [nbformat.v4.new_output("stream", text=captured.stdout)]
                if captured.stdout
                else []
            )
            cell.execution_count = None
            cell.outputs = [*printed, *shown]
            for output in shown:
                compress(output.data)
            shown.clear()
    book.metadata = nbformat.from_dict(
        {
            "kernelspec": book.metadata.kernelspec,
            "language_info": {"name": "python"},
            "oee": book.metadata.oee,
        }
    )
    return book


def run_check(check, variables):
    """Call a check with those of the notebook's variables that it names."""
    try:
        check(**{name: variables[name] for name in inspect.signature(check).parameters})
    except Exception:
        traceback.print_exc()
        os._exit(1)


def compress(data):
    """Take the rarest colours of a picture from an output."""
    if picture := data.get("image/png"):
        small = io.BytesIO()
        encoded = picture if isinstance(picture, bytes) else base64.b64decode(picture)
        image = Image.open(io.BytesIO(encoded)).convert("RGB")
        image.quantize(256, dither=Image.Dither.NONE).save(small, "png", optimize=True)
        data["image/png"] = base64.b64encode(small.getvalue()).decode()


def texts(book):
    """What each code cell prints and returns; of a picture nothing, since its size
    depends on the extras.
    """
    return [
        "".join(map(text_of, cell.outputs))
        for cell in book.cells
        if cell.cell_type == "code"
    ]


def text_of(output):
    """The text of one output."""
    if output.output_type == "stream":
        return output.text
    return "" if "image/png" in output.data else output.data["text/plain"]


if __name__ == "__main__" and SERVE in sys.argv:
    serve()
elif __name__ == "__main__":
    with notebook_runner() as run:
        for path in NOTEBOOKS:
            if number(path) in sys.argv[1:] or len(sys.argv) == 1:
                with tempfile.TemporaryDirectory() as folder:
                    nbformat.write(run(path, folder), path)
