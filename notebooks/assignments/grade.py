"""Grade students' notebooks without nbgrader, by the tests of ``source``.

python notebooks/assignments/grade.py submitted/*/risk.ipynb --output grades.csv

A notebook is known by its name (``risk.ipynb``). Its test cells are replaced by the
instructor's, so that nothing a student changes in them counts. Each notebook runs in a
process of its own, in an empty folder. That keeps mistakes apart; it is no sandbox, so
run it where a student's program may run.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
SECONDS = 300  # that one notebook may run
COLUMNS = ("file", "test", "points", "of", "message")


def source_of(path):
    """Return the cells of the instructor's notebook of a submission."""
    found = sorted((FOLDER / "source").glob(f"assignment_*/{path.name}"))
    if not found:
        names = sorted(p.name for p in (FOLDER / "source").glob("assignment_*/*.ipynb"))
        raise ValueError(
            f"{path} must have the name of an assignment: {', '.join(names)}"
        )
    return read_cells(found[0])


def read_cells(path):
    """Return the code cells of a notebook as (grade id, points, source)."""
    try:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        return [
            (about.get("grade_id"), about.get("points"), "".join(cell["source"]))
            for cell in cells
            if cell["cell_type"] == "code"
            for about in [cell["metadata"].get("nbgrader", {})]
        ]
    except OSError as error:
        raise ValueError(f"{path} must be a file: {error.strerror}") from None
    except (KeyError, TypeError, AttributeError, ValueError):
        raise ValueError(f"{path} must be a notebook of format 4") from None


def merge(submitted, source):
    """Return the student's cells with the instructor's tests, each of them once."""
    tests = {name: (name, n, text) for name, n, text in source if n is not None}
    merged = []
    for name, points, text in submitted:
        if name in tests:
            merged.append(tests.pop(name))
        elif points is None:
            merged.append((name, None, text))
    return [*merged, *tests.values()]  # what was deleted is tested at the end


def run(path):
    """Run the cells of stdin; write a line of JSON for each test into a file."""
    names = {"__name__": "__main__"}
    with open(path, "w", encoding="utf-8") as results:
        for name, points, text in json.load(sys.stdin):
            code = "\n".join(
                line for line in text.split("\n") if line.lstrip()[:1] not in ("%", "!")
            )
            message = ""
            try:
                exec(compile(code, name or "cell", "exec"), names)
            except (Exception, SystemExit) as error:
                message = f"{type(error).__name__}: {error}"
            if points is not None:
                results.write(json.dumps([name, message]) + "\n")
                results.flush()


def grade(path, seconds=SECONDS):
    """Return a row of the table for each test of a submission."""
    source = source_of(path)  # which refuses other names first
    cells = merge(read_cells(path), source)
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results"
        empty = Path(folder) / "empty"
        empty.mkdir()
        late = f"it ran longer than {seconds} s"
        try:
            subprocess.run(
                [sys.executable, str(FOLDER / "grade.py"), "--run", str(results)],
                input=json.dumps(cells),
                text=True,
                cwd=empty,
                env=os.environ | {"MPLBACKEND": "agg"},
                timeout=seconds,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                check=False,
            )
        except subprocess.TimeoutExpired:
            pass
        else:
            late = "the notebook ended its process"
        lines = results.read_text(encoding="utf-8").splitlines()
        said = dict(json.loads(line) for line in lines)
    return [
        (str(path), name, 0 if (why := said.get(name, late)) else points, points, why)
        for name, points, _ in cells
        if points is not None
    ]


def main():
    """Grade the files of the command line, and print the sum of each."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("files", nargs="*", type=Path, help="Submitted notebooks.")
    parser.add_argument("--output", type=Path, help="Write all rows to this CSV file.")
    parser.add_argument(
        "--seconds", type=float, default=SECONDS, help="Time for one notebook."
    )
    parser.add_argument("--run", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        run(options.run)
        return
    if not options.files:
        parser.error("give the notebooks to grade")
    rows = []
    for path in options.files:
        try:
            mine = grade(path, options.seconds)
        except ValueError as error:
            parser.error(str(error))
        rows += mine
        print(f"{path}: {sum(r[2] for r in mine)} of {sum(r[3] for r in mine)} points")
        for _, name, points, _, why in mine:
            if why:
                print(f"  {name}: {points}: {why.splitlines()[0]}")
    if options.output:
        with options.output.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
