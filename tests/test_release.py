"""What a release says of itself: one version everywhere, the lowest releases that are
tried, the licences of what it needs.
"""

import re
import sys
import tomllib
from pathlib import Path

import pytest

import oee_tabular
from oee_tabular.lab.experiments import load_saved_table

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]


@pytest.fixture
def dependencies(monkeypatch):
    """The site's module of that name."""
    monkeypatch.syspath_prepend(str(ROOT / "notebooks"))
    import dependencies

    yield dependencies
    sys.modules.pop("dependencies")


def test_one_version():
    version = oee_tabular.__version__
    assert PROJECT["dynamic"] == ["version"]
    citation = (ROOT / ".github" / "CITATION.cff").read_text()
    assert f"\nversion: {version}\n" in citation
    assert f"version = {{{version}}}" in (ROOT / "README.md").read_text()
    assert (
        re.search(r"^## (\S+)", (ROOT / "notebooks" / "changes.md").read_text(), re.M)[
            1
        ]
        == version
    )


def test_pythons_that_are_named_begin_with_the_lowest():
    named = [
        line.rpartition(" ")[2] for line in PROJECT["classifiers"] if ":: 3." in line
    ]
    assert PROJECT["requires-python"] == f">={named[0]}"
    assert PYPROJECT["tool"]["mypy"]["python_version"] == named[0]
    assert (
        PYPROJECT["tool"]["ruff"]["target-version"] == f"py{named[0].replace('.', '')}"
    )
    table = (ROOT / "notebooks" / "versions.md").read_text()
    for version in named:
        assert re.search(rf"^\| [\d-]+ \| {re.escape(version)}\b", table, re.M), version


def bounds(*requirements):
    found = (
        re.match(r"([\w.-]+)(?:\[.*?\])?>=([\w.]+)", text) for text in requirements
    )
    return {match[1]: match[2] for match in found if match}


def test_the_lowest_releases_are_those_that_pyproject_names():
    lines = (ROOT / "tests" / "lowest.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    extras = PROJECT["optional-dependencies"]
    tested = [
        extra
        for extra in extras
        if f"{extra}," in extras["dev"][0] or f"{extra}]" in extras["dev"][0]
    ]
    needed = bounds(
        *PROJECT["dependencies"],
        *(line for extra in [*tested, "dev"] for line in extras[extra]),
    )
    assert set(pinned) == set(needed)
    for name, bound in needed.items():
        assert f"{pinned[name]}.".startswith(f"{bound}."), (
            f"{name}>={bound} is tried with {pinned[name]}"
        )


def test_dependencies_have_licences(dependencies):
    pytest.importorskip("packaging")
    page = dependencies.page()
    rows = {
        row.split(" | ")[0].removeprefix("| ").lower(): row
        for row in page.splitlines()
        if row.startswith("| ")
    }
    for name in bounds(*PROJECT["dependencies"]):
        assert re.search(r"\| \d[\w.]* \| .*\w.* \| .*oee-tabular", rows[name]), name
    assert "llvmlite" in rows  # what is needed in turn
    assert "hypothesis" not in rows  # an extra's
    assert "not named" not in page


def test_the_wheel_has_the_tables_that_notebooks_load():
    code = " ".join(
        path.read_text() for path in (ROOT / "notebooks").glob("*.ipynb")
    ).replace("\\", "")
    loaded = re.findall(r'load_saved_table\("(\w+)"(?:, "(\w+)")?\)', code)
    files = {f"{name}/{table or 'table'}.csv" for name, table in loaded}
    wheel = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert wheel == {
        f"notebooks/results/{file}": f"oee_tabular/lab/experiments/saved/{file}"
        for file in files
    }
    with pytest.raises(
        ValueError, match="name and table must be those of a saved table"
    ):
        load_saved_table("nothing")


def test_hooks_and_workflow_run_what_the_checks_run():
    run = (ROOT / ".ci" / "run").read_text()
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    entries = re.findall(r"entry: (.+)", hooks)
    assert len(entries) == 4
    assert [entry for entry in entries if f"\n{entry}" not in run] == []
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    assert "- run: .ci/run" in workflow
    named = [
        line.rpartition(" ")[2] for line in PROJECT["classifiers"] if ":: 3." in line
    ]
    assert re.findall(r'"(3\.\d+)"', workflow) == named
