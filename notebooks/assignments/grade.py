"""Grade students' notebooks without nbgrader, by the tests of ``source``.

python notebooks/assignments/grade.py submitted --output points.csv

A folder has one folder for each student, with that student's notebooks in it or in
folders of the assignments, as nbgrader has them: ``submitted/anna/risk.ipynb`` or
``submitted/anna/assignment_1/risk.ipynb``. A notebook is known by its name. Its test
cells are replaced by the instructor's, so that nothing a student changes in them counts.

Of a notebook that a student handed in several times the best counts. A row is written as
soon as a notebook is graded, a total as soon as a student is. What
cannot be graded is a row with its reason. Each notebook runs in a process of its own, in
an empty folder. That keeps mistakes apart; it is no sandbox, so run it where a student's
program may run.
"""

import argparse
import contextlib
import csv
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
PLACES = {"source": FOLDER / "source"}  # of the instructor's notebooks
SECONDS = 300  # that one notebook may run
COLUMNS = ("student", "assignment", "points", "of", "message", "file")
TEST_COLUMNS = ("student", "assignment", "test", "points", "of", "message")
TOTAL = "total"  # in the column of the assignment
NOT_COUNTED = "not counted"
SKIPPED = re.compile(r"^\.|^__")  # hidden folders, as .ipynb_checkpoints
ASSIGNMENT = re.compile(r"^assignment_\d+$")
COPY = re.compile(r"( ?\(\d+\)|-Copy\d+)$")  # that browsers and Jupyter add to a name


def assignments():
    """Return the instructor's notebooks by the names of their files."""
    paths = sorted(PLACES["source"].glob("assignment_*/*.ipynb"))
    return {path.name: path for path in paths}


def points_of(path):
    """Return the points of the instructor's notebook."""
    return sum(points for _, points, _ in read_cells(path) if points is not None)


@dataclass
class Submission:
    """A notebook of a student, or one that is missing: then ``path`` is None."""

    student: str
    name: str
    path: Path | None = None
    tests: list = field(default_factory=list)  # (name, points, of, message)
    problem: str = ""

    @property
    def assignment(self):
        """Return the folder's name of the assignment, or "" where it is none."""
        source = assignments().get(self.name)
        return source.parent.name if source else ""

    @property
    def points(self):
        """Return the points that were reached."""
        return sum(points for _, points, _, _ in self.tests)

    @property
    def most(self):
        """Return the points that can be reached; none where it counts nothing."""
        source = assignments().get(self.name)
        return (
            points_of(source) if source and not self.problem.startswith("not ") else 0
        )

    @property
    def message(self):
        """Return why points are missing, in one line."""
        if self.problem:
            return self.problem
        lost = {}  # tests by their message: a notebook that hangs loses many by one
        for name, _, _, why in self.tests:
            if why:
                lost.setdefault(first_line(why), []).append(name)
        return "; ".join(f"{', '.join(names)}: {why}" for why, names in lost.items())


def first_line(text):
    """Return the first line of a text."""
    return text.splitlines()[0] if text else ""


def student_of(path):
    """Return whose notebook it is: the folder above the file, or above assignment_N."""
    folder = path.resolve().parent
    if ASSIGNMENT.match(folder.name):
        folder = folder.parent
    return folder.name


def name_of(path):
    """Return the name of an assignment's notebook, without what a copy adds to it."""
    return COPY.sub("", path.stem) + path.suffix


def is_hidden(path, folder):
    """Return whether a path in a folder is a hidden one, as .ipynb_checkpoints are."""
    return any(map(SKIPPED.match, path.relative_to(folder).parts))


def notebooks_in(folder):
    """Return the notebooks in a folder and its folders."""
    found = sorted(folder.rglob("*.ipynb"))
    return [path for path in found if not is_hidden(path, folder)]


def find_notebooks(given):
    """Return the notebooks of files and folders, and the students who have none.

    These are folders without a notebook: one that is given, or one that lies beside
    other students' folders.
    """
    found, empty = [], []
    for path in given:
        if not path.is_dir():
            found.append(path)
            continue
        inside = notebooks_in(path)
        found += inside
        if not inside:
            empty.append(student_of(path / "none"))
        elif student_of(path / "none") not in map(student_of, inside):
            empty += [
                folder.name
                for folder in sorted(path.iterdir())
                if folder.is_dir()
                and not is_hidden(folder, path)
                and not notebooks_in(folder)
            ]
    if not found:
        raise ValueError(f"{given[0]} must have notebooks (.ipynb); it has none")
    return list(dict.fromkeys(found)), empty


def is_asked(path, asked):
    """Return whether a notebook may be of the assignments that are asked for.

    One of another name may, where it does not lie in another assignment's folder.
    """
    source = assignments().get(name_of(path))
    if source is not None:
        return source.name in asked
    folders = [assignments()[name].parent.name for name in asked]
    folder = path.resolve().parent.name
    return folder in folders or not ASSIGNMENT.match(folder)


def sort_submissions(paths, empty, asked):
    """Return the submissions of each student, and what each of them has not handed in.

    Expected is every assignment that is asked for, or else that some student has handed
    in. ``empty``: students who handed in nothing.
    """
    known = assignments()
    by_student = {student: [] for student in empty}
    for path in paths:
        by_student.setdefault(student_of(path), [])
        if not asked or is_asked(path, asked):
            by_student[student_of(path)].append(path)
    names = set(map(name_of, paths))
    expected = asked or [name for name in known if name in names]
    for student in sorted(by_student):
        by_name = {}
        for path in by_student[student]:
            one = Submission(student, name_of(path), path)
            if one.name not in known:
                one.problem = (
                    "not graded: it must have the name of an assignment,"
                    f" {', '.join(sorted(known))}"
                )
            by_name.setdefault(one.name, []).append(one)
        for name in expected:
            if name not in by_name:
                missing = Submission(student, name)
                missing.tests = [
                    (test, 0, most, "") for test, most, _ in tests_of(known[name])
                ]
                missing.problem = "handed in nothing"
                by_name[name] = [missing]
        yield student, list(by_name.values())


def tests_of(source):
    """Return the instructor's test cells: (grade id, points, text)."""
    return [cell for cell in read_cells(source) if cell[1] is not None]


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
        raise ValueError(f"it must be a file: {error.strerror}") from None
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError):
        raise ValueError("it must be a notebook of format 4") from None


def merge(submitted, source):
    """Return the student's cells with the instructor's tests, each of them once.

    Before each test the instructor's imports run again, so that a student's variable of
    the name ``check`` does not stand in its place.
    """
    imports = source[0][2]
    tests = {
        name: (name, n, f"{imports}\n\n{text}")
        for name, n, text in source
        if n is not None
    }
    merged = []
    for name, points, text in submitted:
        if isinstance(name, str) and name in tests:
            merged.append(tests.pop(name))
        elif points is None:
            merged.append((name, None, text))
    return [*merged, *tests.values()]  # what was deleted is tested at the end


def run(path):
    """Run the cells of stdin; write a line of JSON before and after each into a file."""
    names = {"__name__": "__main__"}
    broken = []  # (number, text, what it raised) of the student's cells
    with open(path, "w", encoding="utf-8") as results:

        def say(*what):
            results.write(json.dumps(what) + "\n")
            results.flush()

        for number, (name, points, text) in enumerate(json.load(sys.stdin)):
            code = "\n".join(
                line for line in text.split("\n") if line.lstrip()[:1] not in ("%", "!")
            )
            say("begun", name or f"code cell {number + 1}")
            message = ""
            try:
                exec(compile(code, name or "cell", "exec"), names)
            except (Exception, SystemExit, KeyboardInterrupt) as error:
                message = f"{type(error).__name__}: {error}"
                if points is None:
                    broken.append((number + 1, code, message))
                elif isinstance(error, NameError):
                    message += where_missing(error.name, broken)
            if points is not None:
                say("tested", name, message)


def where_missing(name, broken):
    """Return which broken cell was to define a name, in brackets; "" for none."""
    defines = re.compile(rf"\bdef\s+{re.escape(name or '')}\b|^{name}\s*=", re.M)
    for number, code, message in broken:
        if name and defines.search(code):
            return f" (code cell {number} raised {first_line(message)})"
    return ""


def stop(process):
    """End a process and what it has started."""
    if os.name == "posix":
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def grade(path, source, seconds=SECONDS):
    """Return what each test of a notebook says: (name, points, of, message)."""
    cells = merge(read_cells(path), read_cells(source))
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results"
        results.touch()
        empty = Path(folder) / "empty"
        empty.mkdir()
        process = subprocess.Popen(
            [sys.executable, str(FOLDER / "grade.py"), "--run", str(results)],
            stdin=subprocess.PIPE,
            text=True,
            cwd=empty,
            env=os.environ | {"MPLBACKEND": "agg"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that it can be ended with its children
        )
        try:
            process.communicate(json.dumps(cells), timeout=seconds)
            late = f"the notebook ended its process (exit code {process.returncode})"
        except subprocess.TimeoutExpired:
            late = f"it ran longer than {seconds:g} s"
        finally:
            stop(process)
        said, last = {}, ""
        for line in results.read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(ValueError):  # a line that was cut off
                what, name, *message = json.loads(line)
                if what == "tested":
                    said[name] = message[0]
                last = name
    late += f", in {last}" if last else ""
    return [
        (name, 0 if (why := said.get(name, late)) else points, points, why)
        for name, points, _ in cells
        if points is not None
    ]


class Table:
    """A CSV file whose rows are on the disk as soon as they are written."""

    def __init__(self, path, columns, *, overwrite):
        """Open the file and write its first line; without a path do nothing."""
        self.file = None
        if path:
            # a pipe or a terminal is no file that could be lost
            mode = "w" if overwrite or (path.exists() and not path.is_file()) else "x"
            self.file = path.open(mode, encoding="utf-8", newline="")
        self.write(columns)

    def write(self, row):
        """Write a row."""
        if self.file:
            csv.writer(self.file).writerow(row)
            self.file.flush()
            os.fsync(self.file.fileno())


def grade_one(one, seconds):
    """Grade a notebook, unless it is already known why that cannot be."""
    if one.problem:
        return
    source = assignments()[one.name]
    try:
        one.tests = grade(one.path, source, seconds)
    except (ValueError, OSError) as error:
        one.problem = f"could not be read: {error}"
        one.tests = [(name, 0, most, one.problem) for name, most, _ in tests_of(source)]


def grade_all(submitted, seconds, grades, tests):
    """Grade notebooks student by student; return the totals and the problems."""
    totals, problems = {}, []
    for student, handed_in in submitted:
        for same in handed_in:  # notebooks of one name
            for one in same:
                grade_one(one, seconds)
            best = max(same, key=lambda one: (one.points, not one.problem))
            for one in same:
                if one is not best and not one.problem.startswith("not "):
                    one.problem = (
                        f"{NOT_COUNTED}: handed in several times, and {best.path} has"
                        f" {best.points} points, this one {one.points}"
                    )
                    one.tests = []
            for one in same:
                report(one)
                if one.problem and one.path and not one.problem.startswith(NOT_COUNTED):
                    problems.append(f"{one.path}: {one.problem}")
                file = str(one.path or "")
                grades.write(
                    (student, one.assignment, one.points, one.most, one.message, file)
                )
                for name, points, most, why in one.tests:
                    tests.write((student, one.assignment, name, points, most, why))
        every = [one for same in handed_in for one in same]
        points = sum(one.points for one in every)
        most = sum(one.most for one in every)
        totals[student] = points, most
        grades.write((student, TOTAL, points, most, "", ""))
    return totals, problems


def report(one):
    """Print the points of a notebook, and what each missing point was for."""
    name = one.path or f"{one.student}, {one.name}"
    print(f"{name}: {one.points} of {one.most} points", flush=True)
    if one.problem:
        print(f"  {one.problem}", flush=True)
        return
    for test, points, most, why in one.tests:
        if why:
            print(f"  {test}: {points} of {most}: {first_line(why)}", flush=True)


def summarise(totals, problems):
    """Print the total of each student, and what could not be graded."""
    print(f"\n{len(totals)} student{'s' if len(totals) != 1 else ''}")
    for student, (points, most) in totals.items():
        print(f"  {student}: {points} of {most}")
    repeated = Counter(problems)
    if repeated:
        print(f"{len(repeated)} not graded")
        for problem in repeated:
            print(f"  {problem}")


def main():
    """Grade the files and folders of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "files",
        nargs="*",
        type=Path,
        help="Submitted notebooks, or folders of them (one folder for each student).",
    )
    parser.add_argument(
        "--output",
        type=Path,
        help="Write a row for each notebook and a total for each student to this CSV"
        " file, each as soon as it is known.",
    )
    parser.add_argument(
        "--tests", type=Path, help="Write a row for each test to this CSV file."
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="Replace tables that exist."
    )
    parser.add_argument(
        "--seconds", type=float, default=SECONDS, help="Time for one notebook."
    )
    parser.add_argument(
        "--assignment",
        help="Grade this one alone, by its folder's name or its number; what students"
        " did not hand in of it counts 0.",
    )
    parser.add_argument(
        "--source",
        type=Path,
        default=FOLDER / "source",
        help="Folder with the instructor's notebooks, for a copy that was changed; by"
        " default the one beside this script.",
    )
    parser.add_argument("--run", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        run(options.run)
        return 0
    if not options.files:
        parser.error("give the notebooks to grade, or their folder")
    if not 0 < options.seconds < float("inf"):
        parser.error(f"--seconds must be above 0; it is {options.seconds:g}")
    PLACES["source"] = options.source
    if not assignments():
        parser.error(
            f"--source must have folders assignment_1, ... with notebooks;"
            f" {options.source} has none"
        )
    asked = []
    if options.assignment is not None:
        by_number = {
            path.parent.name.removeprefix("assignment_"): name
            for name, path in assignments().items()
        }
        number = options.assignment.removeprefix("assignment_")
        if number not in by_number:
            parser.error(
                f"--assignment must be one of {', '.join(by_number)}; it is"
                f" {options.assignment}"
            )
        asked = [by_number[number]]
    try:
        paths, empty = find_notebooks(options.files)
        wanted = ((options.output, COLUMNS), (options.tests, TEST_COLUMNS))
        paths_asked = [path for path, _ in wanted if path]
        if len({path.resolve() for path in paths_asked}) < len(paths_asked):
            parser.error(f"--output and --tests must differ; both are {options.tests}")
        for path in paths_asked:  # before one of the two is made
            if not path.resolve().parent.is_dir():
                parser.error(f"{path} cannot be written: No such file or directory")
            if path.is_file() and not options.overwrite:
                parser.error(f"{path} exists; --overwrite replaces it")
        tables = [
            Table(path, columns, overwrite=options.overwrite)
            for path, columns in wanted
        ]
    except ValueError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename} cannot be written: {error.strerror}")
    try:
        submitted = sort_submissions(paths, empty, asked)
        totals, problems = grade_all(submitted, options.seconds, *tables)
    except KeyboardInterrupt:
        print("\nStopped. What was graded is in the tables.", flush=True)
        return 130
    summarise(totals, problems)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
