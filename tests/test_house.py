"""The house: who imports whom: no circle of files or packages, at most twelve floors."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import oee_tabular

ROOT = Path(oee_tabular.__file__).parent
FLOORS = 12  # of packages and of files beside them, the command line's first line on top


def imported(tree, by_name):
    """(module, name) of every import, within functions and by name too."""
    found, left = set(), [tree]
    while left:
        node = left.pop()
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are from oee_tabular on"
            found |= {(node.module, alias.name) for alias in node.names}
        elif by_name and isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found |= {(value.value, "") for value in node.args if isinstance(value, ast.Constant)}
        left += ast.iter_child_nodes(node)
    return found


def without_types(tree):
    """Without ``if TYPE_CHECKING``: what a package's face names there is imported on use, from where it is."""
    body = [node for node in tree.body if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")]
    return ast.Module(body, [])


def graph_of(root, by_name=True):
    """Module -> the modules of the package that it imports anywhere."""
    paths = {path: ".".join([root.name, *path.relative_to(root).with_suffix("").parts]) for path in root.rglob("*.py")}
    paths = {path: name.removesuffix(".__init__") for path, name in paths.items()}
    modules, graph = set(paths.values()), {}
    for path, name in paths.items():
        tree = ast.parse(path.read_text())
        used = imported(without_types(tree) if path.name == "__init__.py" else tree, by_name)
        whole = {f"{module}.{alias}" if f"{module}.{alias}" in modules else module for module, alias in used}
        graph[name] = (whole & modules) - {name}
    return graph


def rooms_of(graph):
    """The same between packages, and files beside them."""

    def room(name):
        return ".".join(name.split(".")[:2])

    rooms = {room(name): set() for name in graph}
    for name, others in graph.items():
        rooms[room(name)] |= {room(other) for other in others} - {room(name)}
    return rooms


def height(graph):
    """Floors: 1 for what imports nothing, else one above the highest that is imported."""

    @cache
    def floor(name):
        return 1 + max(map(floor, graph[name]), default=0)

    return max(map(floor, graph))


GRAPH = graph_of(ROOT)


def test_no_circle_of_files():
    list(TopologicalSorter(GRAPH).static_order())


def test_at_most_twelve_floors():
    """Of packages, which have no circle either; what the core has of the wing it asks for by name, on use."""
    assert height(rooms_of(graph_of(ROOT, by_name=False))) <= FLOORS


def test_the_core_does_not_import_the_wing():
    code = (
        "import sys, oee_tabular as oee\n"
        "oee.tasks.gridworld, oee.Transitions, oee.report.evaluate\n"
        "assert not [name for name in sys.modules if name.startswith('oee_tabular.continuous')]\n"
        "from oee_tabular.data import ContinuousTransitions\n"
        "assert ContinuousTransitions is oee.ContinuousTransitions\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_circles_are_found(tmp_path):
    """A circle by way of an import within a function, one by a module's name, one of types alone."""
    for name, lines in (
        ("__init__", "if TYPE_CHECKING:\n    from house.a import x\n"),
        ("a", "import house\nfrom house import b\n"),
        ("b", "def f():\n    from house.c import g\n"),
        ("c", "if TYPE_CHECKING:\n    from house.d import x\n"),
        ("d", "def f():\n    return importlib.import_module('house.a').x\n"),
    ):
        (tmp_path / "house").mkdir(exist_ok=True)
        (tmp_path / "house" / f"{name}.py").write_text(lines)
    graph = graph_of(tmp_path / "house")
    assert graph == {
        "house": set(),
        "house.a": {"house", "house.b"},
        "house.b": {"house.c"},
        "house.c": {"house.d"},
        "house.d": {"house.a"},
    }
    with pytest.raises(CycleError):
        list(TopologicalSorter(graph).static_order())
    graph["house.d"] = set()
    assert height(graph) == 4
