"""The checks of the notebooks' exercises: right answers are accepted, wrong ones rejected with their hint, none is no error.

The right answers are computed here by the package, not copied from the checks.
"""

import importlib
import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from answers import CASES as LATER

import oee_tabular as oee
from oee_tabular import exact

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


def _exercises() -> ModuleType:
    spec = importlib.util.spec_from_file_location("exercises", NOTEBOOKS / "exercises.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


exercises = _exercises()


def slow_motor():
    transitions = np.array([[[0.5, 0.5], [0.9, 0.1]], [[0.1, 0.9], [0.1, 0.9]]])
    motor = oee.FiniteMDP(transitions, np.array([[2.0, 1.0], [0.0, 0.0]]), [1.0, 0.0], 0.9)
    return oee.policy_value(motor, [[0.0, 1.0], [0.0, 1.0]])


def horizon_for_the_rest():
    return next(t for t in range(1, 2000) if 0.99**t / 0.01 <= 0.5)


def episodes_for_a_tenth():
    floor = oee.tasks.gridworld(10, slip=0.1)
    variance = oee.return_moments(floor, oee.tasks.gridworld_policy(10, 0.5), horizon=200).variance
    return int(np.ceil(variance / 0.1**2))


def boxed_pair():
    return oee.density_ratio([0.8, 0.2], [0.5, 0.5], upper=1.2).ratio


def gap_of_ones():
    p, q = [0.10, 0.20, 0.20, 0.10, 0.25, 0.15], [0.30, 0.25, 0.20, 0.10, 0.10, 0.05]
    return 1.0 - oee.density_ratio(p, q, lower=0.5, upper=2.0).objective


def samples_for_a_tenth():
    return next(n for n in range(1000, 10_000) if np.sqrt(2 * (0.95 / 0.05) / n) <= 0.1 + 1e-12)


def grids(simulated=0.3, real=0.1):
    simulator, target = oee.tasks.gridworld(10, simulated), oee.tasks.gridworld(10, real)
    return simulator, oee.true_ratio(target, simulator)


def corner():
    _, zeta = grids()
    return zeta.values[90 * 4, 90]


def largest_slip():
    slips = np.arange(0.01, 0.9, 0.01)
    return max(e for e in slips if grids(e)[1].values.data.max() <= 1.2 + 1e-9)


def mass_after_200():
    mdp = oee.FiniteMDP(np.full((4, 1, 4), [0.7, 0.1, 0.1, 0.1]), np.zeros(4), [1.0, 0.0, 0.0, 0.0], 0.9)
    zeta = mdp.transitions.copy()
    zeta.data = np.where(zeta.indices == 0, 1.3, 0.4)
    return exact.weight_moments(mdp, zeta, oee.uniform_policy(mdp), horizon=200)[0][-1]


def one_move(simulated, real):
    """E[W_1^2] from a cell without walls."""
    simulator, zeta = grids(simulated, real)
    start = np.zeros(100)
    start[44] = 1.0
    inside = oee.FiniteMDP(simulator.transitions, simulator.transition_rewards, start, 0.99)
    return exact.weight_moments(inside, zeta, oee.uniform_policy(inside), horizon=1)[1][1]


def paths_for_one():
    simulator, zeta = grids()
    return oee.weighted_return_moments(simulator, zeta, oee.tasks.gridworld_policy(10, 0.5), horizon=100).variance


# check -> (the right answer, answers that readers are likely to give instead, a word of the hint)
CASES = {
    "check_01_a": (slow_motor, [5.9375, 10.0, 0.67857], "V(1)"),
    "check_01_b": (horizon_for_the_rest, [527, 529, 69, 527.2], "left out"),
    "check_01_c": (episodes_for_a_tenth, [2782, 279, 278.2, 1668], "variance"),
    "check_02_a": (boxed_pair, [[1.6, 0.4], [1.2, 0.4], [0.8, 1.2], [1.2], 1.2], "bound"),
    "check_02_b": (gap_of_ones, [0.0, 1.0, 0.789, 0.2394], "risk"),
    "check_02_c": (samples_for_a_tenth, [1900, 380, 38, 7600], "twice"),
    "check_03_a": (corner, [9 / 7, 1 / 3, 0.9333, 0.8571], "two directions"),
    "check_03_b": (largest_slip, [0.0833, 0.0, 0.1, 0.3], "grows"),
    "check_03_c": (mass_after_200, [1.03, 206, 7.0, 3.0], "sum"),
    "check_04_a": (lambda: one_move(0.3, 0.1), [1.0, 1.1571, 0.1905, 1.4444], "four directions"),
    "check_04_b": (lambda: one_move(0.1, 0.3), [1.1905, 0.4444, 1.0], "exchanged"),
    "check_04_c": (paths_for_one, [624, 6.6e6, 63, 3890], "horizons[7]"),
} | LATER


@pytest.mark.parametrize("name", CASES)
def test_right_answers_are_accepted(name, capsys):
    right = CASES[name][0]()
    getattr(exercises, name)(right)
    assert capsys.readouterr().out.startswith("Right")
    if np.ndim(right) == 0:  # as a reader types it
        getattr(exercises, name)(float(f"{float(right):.5g}"))


@pytest.mark.parametrize("name", CASES)
def test_wrong_answers_are_rejected_with_a_hint(name, capsys):
    _, wrong, word = CASES[name]
    for answer in [*wrong, "seven", [], float("nan"), True, object()]:
        with pytest.raises(AssertionError, match=rf"is not right\. Hint: .*{re.escape(word)}"):
            getattr(exercises, name)(answer)
    assert "Right" not in capsys.readouterr().out


@pytest.mark.parametrize("name", CASES)
def test_no_answer_yet_is_said(name, capsys):
    getattr(exercises, name)(None)
    assert "Not answered yet" in capsys.readouterr().out


def _cells(path, kind):
    return ["".join(cell["source"]) for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == kind]


BOOKS = sorted({name[6:8] for name in CASES})  # 05 has its own tests
PATHS = [next(NOTEBOOKS.glob(f"{number}_*.ipynb")) for number in BOOKS]


def test_which_notebooks_ask_how_much():
    asked = {number: sum(name[6:8] == number for name in CASES) for number in BOOKS}
    assert asked == {"00": 1} | dict.fromkeys(("01", "02", "03", "04", "06", "07", "08", "09", "10"), 3)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_notebooks_leave_the_answers_to_the_reader(path):
    code, text = _cells(path, "code"), _cells(path, "markdown")
    asked = [cell for cell in code if re.search(r"^check_\w+\(answer\)", cell, re.MULTILINE)]
    assert all(re.match(r"answer = None\b", cell) for cell in asked)
    found = {name for cell in asked for name in re.findall(r"check_\d\d_\w", cell)}
    assert found == {name for name in CASES if name[6:8] == path.stem[:2]}
    assert sum("<details><summary>Solution</summary>" in cell for cell in text) == len(asked)


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("[0-9]*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_open_with_what_one_will_be_able_to_do_and_how_long_it_takes(path):
    opening = " ".join(_cells(path, "markdown")[0].split())
    assert "After this notebook you can" in opening
    assert re.search(r"\*\*Time\*\*: \d+ minutes to read(, \d+ with the exercises?)?; \d+ s to run", opening)


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("[0-9]*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_use_public_names(path):
    """Modules that have ``__all__``, and names in it: what is written down in test_public_names.py."""
    code = "\n".join(_cells(path, "code"))
    for module, names in re.findall(r"^from (oee_tabular[\w.]*) import (.+)$", code, re.MULTILINE):
        public = importlib.import_module(module).__all__
        submodules = {"paper", "exact", "experiments", "kinova", "plots", "estimators", "testing"}
        hidden = [name for name in names.split("#")[0].split(", ") if name.strip() not in {*public, *submodules}]
        assert hidden == []


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("[0-9]*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_but_the_first_are_stored_without_outputs(path):
    book = json.loads(path.read_text())
    assert book["metadata"]["kernelspec"]["name"] == "python3"
    for cell in book["cells"] if path.stem[:2] != "00" else []:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None
    ids = [cell["id"] for cell in book["cells"]]
    assert len(set(ids)) == len(ids)
