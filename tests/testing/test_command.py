import os
import re
import signal
import subprocess
import sys

import pytest
from helpers import GIVE_UP_SECONDS, run_command, wait_until

from oee_tabular._arguments import own_modules
from oee_tabular.testing.conformance import own_estimator

MINE = """
import os, signal, subprocess, sys, time, traceback
import oee_tabular as oee
from oee_tabular.estimators import Simulator

class Mine:
    claims = frozenset({"identical", "shift"})

    def __call__(self, problem, policy, *, seed=None):
        return Simulator()(problem, policy)

class Holder:
    inner = Mine

instance, number = Mine(), 3
factory, useless, odd = lambda fails=False: Mine(), lambda: 3, lambda problem: 1.0

def function(problem, policy):
    return 1.0

def hangs(problem, policy, seed):
    time.sleep(3600)

def fatal(problem, policy):
    laws = {frame.name for frame in traceback.extract_stack()}
    if "well_formed" in laws:
        os._exit(0)
    if "input_unchanged" in laws:
        os.kill(os.getpid(), signal.SIGKILL)
    if "reproducible" in laws:
        time.sleep(3600)
    return Simulator()(problem, policy).value

def starts_another(problem, policy):
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"])
    open("started", "w").close()
    other.wait()
"""


MODULES = {
    "": MINE,
    "_broken": "import no_such_module_at_all",
    "_exits": "raise SystemExit(5)",
    "_leaves": "import os; os._exit(0)",
    "_sleeps": "import time; time.sleep(3600)",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a module of a name that no other test has."""
    name = f"mine_{abs(hash(str(tmp_path)))}"
    for ending, text in MODULES.items():
        (tmp_path / f"{name}{ending}.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    before = list(sys.path)
    yield name
    assert sys.path == before
    for ending in MODULES:
        sys.modules.pop(f"{name}{ending}", None)


def run(capsys, *arguments):
    code = run_command("check", *arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.parametrize("what", ["instance", "Mine", "factory", "Holder.inner"])
def test_an_estimator_or_what_makes_one(here, what):
    with own_modules():
        assert type(own_estimator(f"{here}:{what}")).__name__ == "Mine"


def test_what_it_claims_holds(capsys, here):
    code, out, err = run(capsys, f"{here}:Mine", "--seed", "3")
    assert (code, err) == (0, "")
    assert "passed (" in out.splitlines()[0]
    assert "seed 3" in out.splitlines()[0]
    assert "shift           holds" in out
    assert "consistent      not claimed" in out
    last = out.splitlines()[-1]
    assert last.startswith(
        "all laws hold that it claims; it does not claim consistent, relabelling,"
        " scale; to what share of the value: identical "
    )
    assert "shift 1e-08; not tested: exact (not claimed), limit (not claimed)," in last
    assert last.endswith(
        "pairs that were never recorded, whether standard errors and intervals are"
        " right, rewards that the log alone has, more than 5 states"
    )
    assert here not in sys.modules


def test_broken_laws_of_a_function_are_exit_code_1(capsys, here):
    code, out, err = run(capsys, f"{here}:function")
    assert (code, err) == (1, "")
    assert out.startswith("function: NOT PASSED")
    assert (
        "consistent      fails       ragged (horizon 6, discount 0.9): mean 1 " in out
    )
    assert "see it: " in out
    code = out.split("is broken (verdicts[law].code has other laws)\n")[1]
    made = {}
    exec(code[: code.rindex("\n", 0, -1)], made)
    assert made["truth"] != pytest.approx(1.0)
    assert out.splitlines()[-1].startswith("broken laws: exact, consistent, ragged")
    assert "all laws hold" not in out


def test_after_an_estimator_exits_or_hangs_or_is_killed_the_next_law_is_run(
    capsys, here
):
    code, out, err = run(capsys, f"{here}:fatal", "--timeout", "20")
    assert (code, err) == (1, "")
    assert "all laws hold" not in out
    out = " ".join(out.split())
    for line in (
        (
            "well_formed exits one state (horizon 3, discount 0.5): the process ends,"
            " with exit code 0"
        ),
        (
            "input_unchanged exits ragged (horizon 6, discount 0.9): the process is"
            " killed by SIGKILL"
        ),
        (
            "reproducible hangs ragged (horizon 6, discount 0.9): no answer within 20 s"
            " (--timeout gives it more)"
        ),
        "seeds holds",
    ):
        assert line in out


def test_after_the_third_law_that_hangs_the_others_are_not_run(capsys, here):
    code, out, err = run(capsys, f"{here}:hangs", "--timeout", "2")
    assert (code, err) == (1, "")
    assert (
        "hangs: NOT PASSED (0 laws hold, 3 broken, 4 not claimed, 9 not run; seed 0)"
        in out
    )
    assert len(re.findall(r" hangs .* no answer within 2 s", out)) == 3
    assert "scale           not run     3 laws hang" in out
    assert re.search(r"^shift +not claimed$", out, re.M)


@pytest.mark.parametrize(
    ("what", "seconds", "text"),
    [
        (
            "{}_leaves:Mine",
            "3600",
            "'{}_leaves:Mine' cannot be imported: the process ends, with exit code 0",
        ),
        (
            "{}_sleeps:Mine",
            "1",
            (
                "'{}_sleeps:Mine' cannot be imported: no answer within 1 s (--timeout"
                " gives it more)"
            ),
        ),
    ],
)
def test_an_import_that_exits_or_hangs_is_one_line_and_exit_code_2(
    capsys, here, what, seconds, text
):
    code, out, err = run(capsys, what.replace("{}", here), "--timeout", seconds)
    assert (code, out, err) == (2, "", f"oee: {text.replace('{}', here)}\n")


@pytest.mark.skipif(
    not hasattr(os, "killpg"), reason="no groups of processes on this system"
)
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_nothing_goes_on_when_the_command_ends(here, how):
    """Neither the process of the laws nor what the estimator has started: either would
    keep the pipe open.
    """
    command = [sys.executable, "-m", "oee_tabular", "check", f"{here}:starts_another"]
    # children of a background job would ignore it
    heeded = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
    finally:
        signal.signal(signal.SIGINT, heeded)
    wait_until(lambda: os.path.exists("started"), process)
    process.send_signal(how)
    process.communicate(timeout=GIVE_UP_SECONDS)
    assert process.returncode != 0


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf", "1e300"])
def test_a_time_limit_that_is_none(capsys, here, seconds):
    code, _, err = run(capsys, f"{here}:Mine", "--timeout", seconds)
    assert code == 2
    assert err.startswith("oee: --timeout must be ")


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ("{}", "the estimator must be given as MODULE:OBJECT"),
        (
            "{}.py:Mine",
            "MODULE must be a module's name, not a file's; got '{}.py' (try {}:Mine)",
        ),
        ("folder/{}.py:Mine", "(try folder.{}:Mine)"),
        ("{}_nowhere:Mine", "module '{}_nowhere' cannot be found, neither in "),
        (
            "{}_broken:Mine",
            (
                "module '{}_broken' cannot be imported: ModuleNotFoundError: No module"
                " named 'no_such_module_at_all'"
            ),
        ),
        ("{}_exits:Mine", "module '{}_exits' cannot be imported: SystemExit: 5"),
        ("{}:Yours", "'{}' has no object 'Yours' (it has Holder, Mine, Simulator, "),
        (
            "{}:number",
            (
                "'{}:number' must be a function (problem, policy) or (problem, policy,"
                " seed), an estimator, or "
            ),
        ),
        (
            "{}:odd",
            (
                "'{}:odd' must be callable as (problem, policy) or (problem, policy,"
                " seed); it takes (problem)"
            ),
        ),
        ("{}:useless", "or a class or function that makes one; it makes int"),
        (
            "oee_tabular.estimators:Oracle",
            "must make an estimator without arguments; it raises TypeError",
        ),
    ],
)
def test_usage_errors_say_what_is_wrong(here, spec, text):
    with (
        own_modules(),
        pytest.raises(ValueError, match=re.escape(text.replace("{}", here))),
    ):
        own_estimator(spec.replace("{}", here))


def test_usage_errors_are_one_line_and_exit_code_2(capsys, here):
    code, out, err = run(capsys, f"{here}:number")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert re.match("oee: .*got int", err)
