import sys

import pytest

from oee_tabular.cli import main

MINE = """
import oee_tabular as oee
from oee_tabular.estimators import Simulator

class Mine:
    claims = frozenset({"identical", "shift"})

    def __init__(self, fails=False):
        self.fails = fails

    def __call__(self, problem, policy, *, seed=None):
        found = Simulator()(problem, policy)
        return oee.Estimate(-1.0) if self.fails else found

class Needy:
    def __init__(self, strength):
        pass

class Holder:
    inner = Mine

instance, broken, number = Mine(), Mine(fails=True), 3

def function(problem, policy, *, seed=None):
    return oee.Estimate(1.0)

def factory(fails=False):
    return Mine(fails)

def useless():
    return 3
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a module of a name that no other test has."""
    name = f"mine_{abs(hash(str(tmp_path)))}"
    (tmp_path / f"{name}.py").write_text(MINE)
    (tmp_path / f"{name}_broken.py").write_text("import no_such_module_at_all\n")
    (tmp_path / f"{name}_exits.py").write_text("raise SystemExit(5)\n")
    monkeypatch.chdir(tmp_path)
    before = list(sys.path)
    yield name
    assert sys.path == before
    for module in (name, f"{name}_broken", f"{name}_exits"):
        sys.modules.pop(module, None)


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        main(["check", *arguments])
    captured = capsys.readouterr()
    return ended.value.code or 0, captured.out, captured.err


@pytest.mark.parametrize("what", ["instance", "Mine", "factory", "Holder.inner"])
def test_an_estimator_or_what_makes_one(capsys, here, what):
    code, out, err = run(capsys, f"{here}:{what}", "--seed", "3")
    assert (code, err) == (0, "")
    assert "passed (" in out.splitlines()[0]
    assert "seed 3" in out.splitlines()[0]
    assert "shift           holds" in out
    assert "consistent      not claimed" in out


@pytest.mark.parametrize("what", ["broken", "function"])
def test_broken_laws_are_exit_code_1(capsys, here, what):
    code, out, err = run(capsys, f"{here}:{what}")
    assert (code, err) == (1, "")
    assert "NOT PASSED" in out
    assert "fails" in out
    assert "see it: " in out


@pytest.mark.parametrize(("spec", "text"), [
    ("{}", "the estimator must be given as MODULE:OBJECT"),
    ("{}.py:Mine", "MODULE must be a module's name, not a file's; got '{}.py' (try {}:Mine)"),
    ("folder/{}.py:Mine", "(try folder.{}:Mine)"),
    ("{}_nowhere:Mine", "module '{}_nowhere' cannot be found, neither in "),
    ("{}_broken:Mine", "module '{}_broken' cannot be imported: ModuleNotFoundError: No module named 'no_such_module_at_all'"),
    ("{}_exits:Mine", "module '{}_exits' cannot be imported: SystemExit: 5"),
    ("{}:Yours", "'{}' has no object 'Yours' (it has Holder, Mine, "),
    ("{}:number", "must be an estimator, or a class or function that makes one; it is a int"),
    ("{}:Needy", "must make an estimator without arguments; it raises TypeError"),
    ("{}:useless", "must make an estimator, callable as (problem, policy, *, seed=None); it makes a int"),
    ("oee_tabular.estimators:Oracle", "must make an estimator without arguments; it raises TypeError"),
])  # fmt: skip
def test_usage_errors_are_one_line_and_exit_code_2(capsys, here, spec, text):
    code, out, err = run(capsys, spec.replace("{}", here))
    assert (code, out) == (2, "")
    assert err.startswith("oee: ")
    assert err.count("\n") == 1
    assert text.replace("{}", here) in err


def test_a_negative_seed_is_a_usage_error(capsys, here):
    code, _, err = run(capsys, f"{here}:Mine", "--seed", "-1")
    assert (code, err) == (2, "oee: seed must be an integer of at least 0; got -1\n")
