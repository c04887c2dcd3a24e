"""The house: which module imports which, the floors of the subpackages, and the page
that shows them.
"""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

import oee_tabular

ROOT = Path(oee_tabular.__file__).parents[1]
TESTS = Path(__file__).parent
# of packages and of files beside them, the command line's first line on top; at most 14
# are allowed
FLOORS = 14
BY_NAME = re.compile(r'import_module\("(oee_tabular[\w.]*)"\)')


def graph_of(by_name=True):
    """Module -> the modules of the package that it imports anywhere, types aside;
    ``by_name``: those it asks for on use too.
    """
    found = grimp.build_graph(
        "oee_tabular", exclude_type_checking_imports=True, cache_dir=None
    )
    graph = {
        name: set(found.find_modules_directly_imported_by(name))
        for name in found.modules
    }
    for name in graph if by_name else ():
        path = ROOT.joinpath(*name.split("."))
        text = (
            file
            if (file := path.with_suffix(".py")).is_file()
            else path / "__init__.py"
        ).read_text()
        graph[name] |= set(BY_NAME.findall(text))
    return graph


def rooms_of(graph):
    """The same between packages, and files beside them; errors, types and what else
    imports nothing of the package stand below all floors.
    """

    def room(name):
        return ".".join(name.split(".")[:2])

    left_out = {"oee_tabular.exceptions", "oee_tabular.typing"}
    left_out |= {n for n in graph if n.startswith("oee_tabular._") and not graph[n]}
    rooms = {room(name): set() for name in graph if name not in left_out}
    for name in graph.keys() - left_out:
        others = {room(other) for other in graph[name] - left_out}
        rooms[room(name)] |= others - {room(name)}
    return rooms


def floors(graph):
    """Name -> floor: 1 for what imports nothing, else one above the highest that is
    imported.
    """

    @cache
    def floor(name):
        return 1 + max(map(floor, graph[name]), default=0)

    return {name: floor(name) for name in graph}


def test_no_circle_of_files():
    graph = graph_of()
    assert "oee_tabular.exact" in graph["oee_tabular.report.evaluation"]
    assert any(
        name.startswith("oee_tabular.continuous") for name in graph["oee_tabular.data"]
    )  # by name
    list(TopologicalSorter(graph).static_order())


def test_at_most_fourteen_floors():
    """Of packages, which have no circle either; what the core has of the wing it asks
    for by name, on use.
    """
    assert max(floors(rooms_of(graph_of(by_name=False))).values()) <= FLOORS


def test_layout_has_the_rooms_and_their_floors():
    """``notebooks/layout.md``: each room on its floor, highest first, in a sentence;
    and every file that it names.
    """
    page = (ROOT / "notebooks" / "layout.md").read_text()
    rows = re.findall(
        r"^\| (\d+) \| `(\w+)` \| [A-Z`][^|.]*(?:\.\w[^|.]*)*\. \|$", page, re.M
    )
    expected = {
        name.partition(".")[2]: at
        for name, at in floors(rooms_of(graph_of(by_name=False))).items()
    }
    assert {name: int(at) for at, name in rows} == {
        name: at for name, at in expected.items() if name[:1] not in ("", "_")
    }
    assert [int(at) for at, _ in rows] == sorted(
        (int(at) for at, _ in rows), reverse=True
    )
    for file in re.findall(r"`(?:oee_tabular/)?(\w+/(?:\w+/)*\w+\.py)`", page):
        assert (ROOT / "oee_tabular" / file).exists() or (ROOT / file).exists(), file


BY_DOOR = {
    "mdp",
    "exact",
    "simulate",
    "tasks",
    "plots",
    "testing",
    "report",
    "continuous",
}
# an import by the door would be a circle of files, load what is imported on use, or hide
# a function behind the file of its name
BESIDE_THE_DOOR = {
    ("tasks", "mdp.empirical"),
    ("tasks", "mdp.environments"),
    ("tasks", "mdp.gymnasium_table"),
    ("tasks", "mdp.naming"),
    ("continuous", "tasks.stepping"),
    ("continuous", "tasks.toy_text"),
    ("cli", "report.page"),
    ("__init__.py", "exact.occupancy"),
}


def inner_imports():
    """Yield (room, inner module of another room) of each such import."""
    package = ROOT / "oee_tabular"
    for path in package.rglob("*.py"):
        here = path.relative_to(package).parts[0]
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                first, _, inner = node.module.partition(".")
                room, _, module = inner.partition(".")
                if first == "oee_tabular" and module and room not in ("", here):
                    yield here, inner


def test_rooms_are_entered_by_their_doors():
    found = {
        (here, inner)
        for here, inner in inner_imports()
        if inner.partition(".")[0] in BY_DOOR
    }
    assert found <= BESIDE_THE_DOOR


def test_the_core_does_not_import_the_wing():
    code = (
        "import sys, oee_tabular as oee\n"
        "oee.tasks.gridworld, oee.Transitions, oee.report.evaluate\n"
        "assert not [name for name in sys.modules if name.startswith('oee_tabular.continuous')]\n"
        "from oee_tabular.data import ContinuousTransitions\n"
        "assert ContinuousTransitions is oee.ContinuousTransitions\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_pictures_and_agents_are_imported_on_use():
    """``plot`` of a result imports its picture, ``from_env`` the agent that steps."""
    code = (
        "import sys, oee_tabular.inference, oee_tabular.design, oee_tabular.theory\n"
        "names = ('plots', 'tasks', 'report')\n"
        "assert not [n for n in names if f'oee_tabular.{n}' in sys.modules]\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("room", ["lab", "continuous"])
def test_what_measures_and_the_wing_are_imported_from_above_alone(room):
    """Others ask for their names on use: the core loads without them."""
    above = {"lab": {"cli"}, "continuous": {"lab", "cli"}}[room]
    rooms = rooms_of(graph_of(by_name=False))
    assert {name for name in rooms if f"oee_tabular.{room}" in rooms[name]} == {
        f"oee_tabular.{name}" for name in above
    }


def imported(path):
    """What a file of tests imports of the package, with its modules."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_tests_import_public_names():
    """But those of tests/kernels, and one of how the command line finds the user's
    modules.
    """
    hidden = re.compile(r"oee_tabular\b.*\._[a-z]")
    found = {
        path.relative_to(TESTS)
        for path in TESTS.rglob("*.py")
        if any(map(hidden.match, imported(path)))
    }
    assert {path.as_posix() for path in found if path.parent.name != "kernels"} == {
        "testing/test_command.py"
    }
