"""The command in a folder, with streams, limits and signals that it did not choose."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import warnings
from importlib import metadata
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import IS_COMPILED
from helpers import GIVE_UP_SECONDS

import oee_tabular as oee
from oee_tabular import _compiling, _isolation, _memory, _printing, _progress
from oee_tabular._arguments import own_module, own_modules
from oee_tabular.cli import main
from oee_tabular.cli.options import say
from oee_tabular.exceptions import ArgumentError, CostWarning, OutputWarning
from oee_tabular.plots.style import draw_or_warn

ROOT = Path(oee.__file__).parents[1]
GRID = oee.tasks.gridworld(3, 0.3)
# as the script that pip installs does, whose folder is first on the path
SCRIPT = ("-P", "-c", "from oee_tabular.__main__ import main; main()")

# ---- a folder from a stranger

AUDIT = """
import os, sys
folder, log = os.environ["HOSTILE"], os.environ["OPENED"]
handle = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

def note(event, args):
    if event == "open" and isinstance(args[0], str):
        path = os.path.abspath(args[0])
        if os.path.dirname(path) == folder:
            os.write(handle, (os.path.basename(path) + "\\n").encode())

sys.addaudithook(note)
"""
SETTINGS = {
    ".numba_config.yaml": "cache_dir: cache\ndisable_jit: 1\nboundscheck: 1\n",
    "matplotlibrc": "text.usetex: True\nbackend: module://evil\nfigure.facecolor: red",
    "pyproject.toml": "[tool.x\n",
    "setup.cfg": "[x",
    "tox.ini": "[x",
    ".env": "OEE=1",
    ".coveragerc": "[x",
    ".duckdbrc": ".exit 3",
    "dask.yaml": "x: [",
    "distributed.yaml": "x: [",
    "jupyter_config.json": "{",
    "ipython_config.py": "raise SystemExit(3)",
    "conftest.py": "raise SystemExit(3)",
    "pyvenv.cfg": "home = /nowhere",
    "evil.pth": "import evil",
    "python311._pth": ".",
}


def hostile_modules():
    """Names of all modules that a command could import, but what Python has built in."""
    names = {*sys.stdlib_module_names, *metadata.packages_distributions()}
    names |= {"sitecustomize", "usercustomize", "yaml", "cuda", "evil"}
    names -= {*sys.builtin_module_names, "oee_tabular"}
    return {name for name in names if name.isidentifier()}


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """A folder with modules that leave a mark, and files of settings."""
    folder = tmp_path / "hostile"
    marks = tmp_path / "marks"
    for path in (folder, marks, tmp_path / "audit", folder / "evil-1.dist-info"):
        path.mkdir()
    for name in hostile_modules():
        mark = f"open({str(marks / name)!r}, 'w')\nraise ImportError('hostile')\n"
        (folder / f"{name}.py").write_text(mark)
    for name, text in SETTINGS.items():
        (folder / name).write_text(text)
    groups = ("gymnasium.envs", "numba_extensions", "matplotlib.backend")
    (folder / "evil-1.dist-info" / "entry_points.txt").write_text(
        "".join(f"[{group}]\nevil = evil:f\n" for group in groups)
    )
    (folder / "evil-1.dist-info" / "METADATA").write_text("Name: evil\nVersion: 1\n")
    (tmp_path / "audit" / "sitecustomize.py").write_text(AUDIT)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path / 'audit'}{os.pathsep}{ROOT}")
    monkeypatch.setenv("HOSTILE", str(folder))
    monkeypatch.setenv("OPENED", str(tmp_path / "opened"))
    target = oee.tasks.gridworld(3, 0.1)
    policy = oee.uniform_policy(target)
    for seed, name in enumerate(("log.parquet", "a.csv", "b.csv")):
        log = oee.sample_episodes(target, policy, 30, 20, seed=seed)
        log.save(folder / name)
        log.save(tmp_path / name)
    return folder


FILES = "--simulator gridworld:3,slip=0.3 --log"
COMMANDS = [
    f"evaluate {FILES} log.parquet --output out --report page.html",
    f"compare {FILES} a.csv --policy optimal --policy uniform --quick",
    f"plan {FILES} a.csv --transitions 10",
    "sample gridworld:3,slip=0.3 --episodes 3 --output new.csv",
    "policy gridworld:3,slip=0.3 optimal --output new.npy",
    "export gridworld:3,slip=0.3 --output new.npz",
    "export FrozenLake-v1 --samples-per-pair 3 --output new.npz",
    "info a.csv",
    "counts a.csv b.csv --jobs 2 --output new.npz",
    "reproduce estimands --smoke --seeds 2 --jobs 2 --output r",
    "bench --families machine --sizes 3 --seeds 2 --jobs 2 --output b",
    "evaluate --simulator cartpole:gravity=10 --log none.csv",
]


def call(words, folder, start=SCRIPT, **options):
    """Run a command in a process of its own."""
    return subprocess.run(
        [sys.executable, *start, *words.split()],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


@pytest.mark.parametrize("words", COMMANDS)
def test_nothing_of_the_current_folder_is_run_or_read(words, hostile, tmp_path, run):
    done = call(words, hostile)
    assert os.listdir(tmp_path / "marks") == []
    opened = {*(tmp_path / "opened").read_text().split()}
    assert opened.isdisjoint({*SETTINGS, *(f"{n}.py" for n in hostile_modules())})
    if "none.csv" in words:
        assert done.returncode == 2
        return
    assert done.returncode == 0, done.stderr
    found = run(words)
    if words.startswith("bench"):  # which prints seconds
        tables = [pd.read_csv(path / "b" / "table.csv") for path in (hostile, tmp_path)]
        pd.testing.assert_frame_equal(*(t.drop(columns="seconds") for t in tables))
    else:
        plain = [re.sub(r"\(\d+ s\)", "", text) for text in (done.stdout, found)]
        assert plain[0] == plain[1]


def test_neither_does_a_check_of_an_estimator_of_one_s_own(hostile, tmp_path):
    (hostile / "own_estimator.py").write_text(
        "import oee_tabular as oee\nmade = oee.estimators.Simulator()\n"
    )
    done = call("check own_estimator:made --repetitions 3 --json", hostile)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["passed"]
    assert os.listdir(tmp_path / "marks") == []


def test_python_m_imports_nothing_of_it_itself(hostile, tmp_path):
    """What Python imports before it knows of the package cannot be helped."""
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "__main__.py").write_text("import sys; print(*sys.modules)")
    there = call("", tmp_path, ("-m", "alone"), env=dict(os.environ, PYTHONPATH=""))
    for name in (*there.stdout.split(), "importlib", "contextlib"):
        (hostile / f"{name}.py").unlink(missing_ok=True)
    done = call("info a.csv", hostile, ("-m", "oee_tabular"))
    assert done.returncode == 0, done.stderr
    assert os.listdir(tmp_path / "marks") == []


def test_a_module_that_is_named_comes_first_and_no_other(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = ("this", "antigravity", "aid_of_this")
    for name in names:
        monkeypatch.delitem(sys.modules, name, raising=False)
    (tmp_path / "this.py").write_text("from aid_of_this import value\n")
    (tmp_path / "aid_of_this.py").write_text("value = 3\n")
    (tmp_path / "nntplib.py").write_text("raise SystemExit(3)\n")
    before = [*sys.path]
    with own_modules():
        # the standard library has a module of this name
        assert own_module("this").value == 3
        assert sys.path == before
        for name in ("aid_of_nobody", "aid_of_that"):
            (tmp_path / f"{name}.py").write_text("raise SystemExit(3)\n")
            with pytest.raises(ImportError):
                __import__(name)  # by a test, which is not in the folder
    assert sys.path == before
    for name in names:
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_the_search_for_modules_is_as_before(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in ([str(tmp_path), *sys.path], [*sys.path]):
        monkeypatch.setattr(sys, "path", path)
        before = ([*sys.path], [*sys.meta_path])
        with own_modules(), own_modules():
            pass
        assert (sys.path, sys.meta_path) == before


# a library that is installed, and the modules that it would like to have
LIBRARY = """
import importlib, importlib.util
for name in NAMES:
    try:
        importlib.import_module(name)
    except ImportError:
        pass
    try:
        exec(f"import {name}")
    except ImportError:
        pass
    assert importlib.util.find_spec(name) is None

def register():
    pass
"""
OWN = """
import library_of_tests
import FIRST_helper
from FIRST_parts.inner import made
import gymnasium, joblib, multiprocessing, os
import oee_tabular as oee

class Late:
    def __call__(self, problem, policy):
        import FIRST_late
        return oee.estimators.Simulator()(problem, policy).value

class Mine:
    def __call__(self, problem, policy):
        value = Late()(problem, policy)
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            assert pool.map(FIRST_helper.same, [value]) == [value]
        jobs = joblib.Parallel(n_jobs=2)
        assert jobs(joblib.delayed(same)(x) for x in [value] * 2) == [value] * 2
        return value

def same(value):
    import FIRST_late
    assert FIRST_late.__file__ == os.path.abspath("FIRST_late.py")
    return value

gymnasium.register("FIRST-v0", entry_point="FIRST_table:Table")
assert gymnasium.make("FIRST_envs:FIRST_late-v0").unwrapped.P
gymnasium.register("FIRST_other-v0", entry_point="FIRST_other:Other")
"""
TABLE = """
import gymnasium

class Other(gymnasium.Env):
    P = {0: {0: [(1.0, 0, 1.0, False)]}}
    observation_space = gymnasium.spaces.Discrete(1)
    action_space = gymnasium.spaces.Discrete(1)
    initial_state_distrib = [1.0]

Table = Other
"""


@pytest.fixture
def beside_a_library(tmp_path, monkeypatch):
    """A folder with modules that nobody names, which a library tries to import."""
    folder, site = tmp_path / "folder", tmp_path / "site"
    marks = tmp_path / "marks"
    for path in (folder, marks, site / "lib-1.dist-info", folder / "e-1.dist-info"):
        path.mkdir(parents=True)
    wanted = [f"wanted_{os.urandom(4).hex()}" for _ in range(3)]
    mark = "open({!r} + __name__, 'w')\n"
    for name in (*wanted, "_winapi", "envwrap", "evil"):
        (folder / f"{name}.py").write_text(mark.format(f"{marks}{os.sep}"))
    (folder / wanted[-1]).mkdir()  # a package without __init__.py
    text = LIBRARY.replace("NAMES", repr(wanted))
    (site / "library_of_tests.py").write_text(text)
    # gymnasium imports what is installed and registers environments
    for path, entry in (
        (site / "lib-1.dist-info", "library_of_tests:register"),
        (folder / "e-1.dist-info", "evil:f"),
    ):
        (path / "entry_points.txt").write_text(
            f"[gymnasium.envs]\n__root__ = {entry}\n"
        )
        (path / "METADATA").write_text(f"Name: {path.stem[:-2]}\nVersion: 1\n")
    monkeypatch.setenv("PYTHONPATH", f"{site}{os.pathsep}{ROOT}")
    first = f"own_{os.urandom(4).hex()}"
    (folder / f"{first}.py").write_text(OWN.replace("FIRST", first))
    (folder / f"{first}_helper.py").write_text(
        f"def same(value):\n    import {first}_late\n    return value\n"
    )
    (folder / f"{first}_late.py").write_text("import os\n")
    (folder / f"{first}_envs.py").write_text(
        f"import gymnasium\nname = '{first}_late-v0'\n"
        f"gymnasium.register(name, entry_point='{first}_third:Table')\n"
    )
    for kind in ("table", "other", "third"):
        (folder / f"{first}_{kind}.py").write_text(TABLE)
    (folder / f"{first}_parts").mkdir()
    (folder / f"{first}_parts" / "inner.py").write_text(
        "import oee_tabular as oee\nmade = oee.tasks.gridworld(3, 0.1)\n"
    )
    return folder, marks, first


@pytest.mark.parametrize(
    "words",
    [
        "export FrozenLake-v1 --samples-per-pair 3 --output new.npz",
        "export gymnasium:Taxi-v4 --output new.npz",
        "export library_of_tests:register --output new.npz",
        "export FIRST:made --output new.npz",
        "export FIRST_parts.inner:made --output new.npz",
        "export FIRST:FIRST-v0 --output new.npz",
        "export FIRST:FIRST_other-v0 --output new.npz",
        "check FIRST:Mine --repetitions 3",
        "bench --families machine --sizes 3 --seeds 2 --jobs 2 --estimators FIRST:Late"
        " --output b",
    ],
)
def test_libraries_find_nothing_beside_a_module_that_is_named(words, beside_a_library):
    folder, marks, first = beside_a_library
    done = call(words.replace("FIRST", first), folder, timeout=GIVE_UP_SECONDS)
    wanted = 2 if "register" in words else 1 if "check" in words else 0
    assert done.returncode == wanted, done.stderr
    assert "Error" not in done.stdout + done.stderr
    assert os.listdir(marks) == []


def test_the_environment_is_as_before(monkeypatch):
    monkeypatch.setenv("PYTHONSAFEPATH", "")
    with _isolation.safe_children() as inherited:
        assert os.environ["PYTHONSAFEPATH"] == "1"
        # another test may have run a command in this process
        assert inherited() == (_isolation.is_isolated(), "")
    assert os.environ["PYTHONSAFEPATH"] == ""


# ---- compiled code


def test_kernels_work_without_a_folder_for_them(monkeypatch):
    monkeypatch.setattr(_compiling.config, "CACHE_DIR", "", raising=False)
    monkeypatch.setattr(_compiling, "_is_writable", lambda folder: False)
    monkeypatch.setattr(_compiling, "_has_user_folder", lambda: False)
    monkeypatch.setattr(_compiling, "temporary_cache", lambda: None)
    _compiling._warn_once.cache_clear()
    with pytest.warns(CostWarning, match="cannot be kept.*NUMBA_CACHE_DIR"):
        twice = _compiling.njit(cache=True)(lambda x: 2 * x)
    assert twice(3) == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # it is said once
        assert _compiling.njit(cache=True)(lambda x: 3 * x)(3) == 9


@pytest.mark.skipif(not IS_COMPILED, reason="nothing is compiled")
def test_a_temporary_folder_takes_its_place(monkeypatch, tmp_path):
    monkeypatch.setattr(_compiling.config, "CACHE_DIR", "", raising=False)
    monkeypatch.setattr(_compiling, "_is_writable", lambda folder: False)
    monkeypatch.setattr(_compiling, "_has_user_folder", lambda: False)
    monkeypatch.setattr(_compiling, "temporary_cache", lambda: str(tmp_path))
    twice = _compiling.njit(cache=True)(lambda x: 2 * x)
    assert twice(3) == 6
    assert [*tmp_path.rglob("*.nbi")]
    assert _compiling.config.CACHE_DIR == ""
    for path in tmp_path.rglob("*.nbi"):
        path.write_bytes(b"damaged")
    again = _compiling.njit(cache=True)(lambda x: 2 * x)
    assert again(3) == 6


@pytest.mark.skipif(not IS_COMPILED, reason="nothing is compiled")
def test_a_full_disk_ends_no_kernel(monkeypatch, tmp_path):
    from numba.core.caching import FunctionCache

    def save(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_compiling.config, "CACHE_DIR", str(tmp_path), raising=False)
    monkeypatch.setattr(FunctionCache, "save_overload", save)
    assert _compiling.njit(cache=True)(lambda x: 2 * x)(3) == 6


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="POSIX")
@pytest.mark.parametrize(
    "kind", ["new", "ours", "open", "link", "file", "here", "foreign"]
)
def test_a_temporary_folder_is_trusted_if_it_is_ours_alone(kind, tmp_path, monkeypatch):
    there = tmp_path / "tmp"
    there.mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(there))
    path = there / f"oee-tabular-{os.geteuid()}"
    if kind in ("ours", "open", "foreign"):
        path.mkdir(0o700)
    if kind == "open":
        path.chmod(0o770)
    if kind == "link":
        (tmp_path / "other").mkdir(0o700)
        path.symlink_to(tmp_path / "other")
    if kind == "file":
        path.touch()
    if kind == "here":
        monkeypatch.chdir(there)
    if kind == "foreign":
        user = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: user + 1)
        path.rename(there / f"oee-tabular-{user + 1}")
    _compiling.temporary_cache.cache_clear()
    found = _compiling.temporary_cache()
    _compiling.temporary_cache.cache_clear()
    assert found == (str(path) if kind in ("new", "ours") else None)


@pytest.mark.skipif(sys.platform != "linux", reason="folders of Linux")
@pytest.mark.parametrize(
    ("name", "value"), [("XDG_CACHE_HOME", ""), ("XDG_CACHE_HOME", "c"), ("HOME", ".")]
)
def test_no_code_is_loaded_from_the_current_folder_for_want_of_a_home(
    name, value, monkeypatch
):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert _compiling._has_user_folder()
    monkeypatch.setenv(name, value)
    assert not _compiling._has_user_folder()


SIGNALS = """
import signal, sys
import oee_tabular as oee
from oee_tabular._parallel import ONE_THREAD

error = {"KeyboardInterrupt": KeyboardInterrupt, "TimeoutError": TimeoutError}[
    sys.argv[1]
]
grid = oee.tasks.gridworld(4, 0.1)
log = oee.sample_episodes(grid, oee.uniform_policy(grid), 30, 30, seed=0)
policy = oee.optimal_policy(grid)
fired = []

def stop(*_):
    fired.append(1)
    raise error

def estimate():
    return oee.estimators.OffEnvironment()(oee.Problem(grid, log), policy)

def estimate_until(seconds):
    fired.clear()
    signal.setitimer(signal.ITIMER_REAL, seconds)
    # where Python ignores an error (in a destructor), the loop ends without it
    while not fired:
        estimate()

expected = estimate()  # what is compiled here cannot be interrupted in the middle
signal.signal(signal.SIGALRM, stop)
n_raised = 0
for k in range(150):
    try:
        estimate_until(2e-4 * (1 + k))
    except error:
        n_raised += 1
    if ONE_THREAD.n_inside:
        with ONE_THREAD:
            assert {library.num_threads for library in ONE_THREAD.libraries} <= {1}
assert estimate() == expected
print(n_raised)
"""


@pytest.mark.skipif(
    not IS_COMPILED or not hasattr(signal, "setitimer"), reason="needs an alarm"
)
@pytest.mark.parametrize("error", ["KeyboardInterrupt", "TimeoutError"])
def test_what_a_signal_raises_leaves_a_kernel_as_it_is(error):
    """Without care, about one in twenty is a SystemError.

    In a process of its own: a signal may also be raised in what pytest does meanwhile.
    """
    found = subprocess.run(
        [sys.executable, "-c", SIGNALS, error],
        capture_output=True,
        text=True,
        check=False,
        timeout=GIVE_UP_SECONDS,
    )
    assert not found.returncode, found.stderr
    assert int(found.stdout) > 100


# ---- streams

SENTENCE = "the policy “café” is worth −1.5 ± 0.2 in 状态 → 2 × 3…"


@pytest.mark.parametrize(
    "encoding",
    ["ascii", "latin-1", "cp1250", "cp850", "koi8-r", "shift_jis", "gb2312", "utf-16"],
)
def test_every_encoding_shows_a_sentence(encoding, monkeypatch):
    buffer = io.BytesIO()
    stream = io.TextIOWrapper(buffer, encoding=encoding, errors="strict")
    monkeypatch.setattr(sys, "stdout", stream)
    say(SENTENCE)
    shown = buffer.getvalue().decode(encoding)
    # a name is whole or escaped, a number is read as before
    found = shown.encode("ascii", "backslashreplace").decode()
    found = found.replace("\\u2212", "-").replace("\\uff0d", "-")
    assert "1.5" in found
    assert re.search(r"worth -1\.5", found)
    assert "caf\\xe9" in found
    assert "\\u72b6\\u6001" in found


def test_letters_that_have_no_look_alike_are_escaped():
    assert _printing.fit("π \U0001f916 \udce9", "cp437") == "π \\U0001f916 \\udce9"
    assert _printing.fit("any", "no such encoding") == "any"
    assert _printing.fit("−", None) == "−"


@pytest.mark.parametrize("encoding", ["cp437", "ascii", "big5"])
def test_redirected_output_is_whole(encoding, tmp_path):
    target = oee.tasks.gridworld(3, 0.1).with_names(
        [f"état {s}" for s in range(9)], ["ä", "ö", "ü", "ß"]
    )
    target.save(tmp_path / "sim.npz")
    log = oee.sample_episodes(target, oee.uniform_policy(target), 20, 20, seed=0)
    log.save(tmp_path / "log.csv")
    environment = dict(os.environ, PYTHONIOENCODING=encoding, PYTHONPATH=str(ROOT))
    done = subprocess.run(
        [
            *(sys.executable, *SCRIPT, "evaluate", "--simulator", "sim.npz"),
            *("--log", "log.csv", "--quick"),
        ],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    text = done.stdout.decode(encoding)
    assert "In the target, the policy" in text
    assert "A value is the discounted sum" in text


@pytest.mark.skipif(os.name != "posix", reason="a shell")
@pytest.mark.parametrize(
    ("tail", "code", "text"),
    [
        (">&-", 2, "oee: standard output is closed, so nothing can be shown (send it"),
        ("2>&-", 0, ""),
        ("<&-", 0, ""),
        (
            ">/dev/full",
            2,
            "oee: the output cannot be written (No space left on device)",
        ),
        ("1</dev/null", 2, "oee: the output cannot be written (Bad file descriptor)"),
        ("| true", 2, ""),
    ],
)
def test_streams_that_are_closed_full_or_gone(tail, code, text, tmp_path):
    line = f"evaluate {FILES} log.csv --quick --output out"
    log = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 20, 20, seed=0)
    log.save(tmp_path / "log.csv")
    start = f"{sys.executable} -P -m oee_tabular"
    script = f"({start} {line}; echo $? >&3) {tail}"
    if "|" not in tail:
        script = f"{start} {line} {tail}; echo $? >&3"
    done = subprocess.run(
        ["bash", "-c", f"exec 3>code; {script}"],
        cwd=tmp_path,
        env=dict(os.environ, PYTHONPATH=str(ROOT)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert int((tmp_path / "code").read_text()) == code, done.stderr
    assert text in done.stderr
    assert "Traceback" not in done.stderr
    # only a closed output is known before the work
    assert (tmp_path / "out" / "report.json").exists() == (tail != ">&-")


class Bare:
    """A stream of somebody's notebook."""

    def write(self, text):
        return len(text)


class Gone(io.StringIO):
    def isatty(self):
        raise OSError("gone")

    def flush(self):
        raise OSError("gone")


class NotCallable(io.StringIO):
    isatty = None


class Broken:
    """A stream that raises wherever it is asked."""

    def __getattr__(self, name):
        raise RuntimeError(name)


class Odd(io.StringIO):
    """A terminal that fails where it is used."""

    def isatty(self):
        return True

    @property
    def encoding(self):
        raise KeyError("encoding")

    def write(self, text):
        raise ZeroDivisionError


@pytest.mark.parametrize("make", [lambda: None, Bare, Gone])
@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_python_needs_no_streams(make, name, tmp_path, monkeypatch):
    log = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 20, 20, seed=0)
    problem = oee.Problem(GRID, log)
    other = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 20, 20, seed=1)
    log.save(tmp_path / "a.csv")
    other.save(tmp_path / "b.csv")
    monkeypatch.setattr(sys, name, make())
    report = oee.evaluate(problem, {"u": oee.uniform_policy(GRID)}, quick=True)
    counts = oee.Transitions.open([tmp_path / "a.csv", tmp_path / "b.csv"], jobs=2)
    monkeypatch.undo()
    assert len(report.table) > 1
    assert counts.count.sum() == len(log) + len(other)


@pytest.mark.parametrize("make", [NotCallable, Broken, Odd])
@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_a_stream_that_fails_shows_no_progress(make, name, monkeypatch):
    monkeypatch.setattr(sys, name, make())
    items = list(_progress.progress_bar("counting", range(3), delay=0, disable=False))
    with _progress.show_steps(only_terminal=True):
        _progress.report_step("a step")
    monkeypatch.undo()
    assert items == [0, 1, 2]


def test_a_stream_that_is_no_terminal():
    for stream in (None, Bare(), Gone(), NotCallable(), Broken()):
        assert not _progress.is_terminal(stream)
    closed = io.StringIO()
    closed.close()
    assert not _progress.is_terminal(closed)


# ---- memory


@pytest.fixture
def system(tmp_path, monkeypatch):
    """A root folder for proc and sys, and a function that writes files there."""
    monkeypatch.setattr(_memory, "ROOT", tmp_path)
    monkeypatch.setattr(_memory, "_limits", lambda: iter(()))
    _memory._limited_groups.cache_clear()

    def write(files):
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)
        return _memory.free_memory()

    yield write
    _memory._limited_groups.cache_clear()


MEMINFO = {"proc/meminfo": "MemTotal: 9 kB\nMemAvailable:   8000 kB\nMemFree: 1 kB\n"}


def group(place, limit, used, cached):
    """Files of a control group of version 2."""
    return {
        f"sys/fs/cgroup{place}/memory.max": f"{limit}\n",
        f"sys/fs/cgroup{place}/memory.current": f"{used}\n",
        f"sys/fs/cgroup{place}/memory.stat": f"anon 5\ninactive_file {cached}\n",
    }


def test_memory_where_the_system_says_nothing(system):
    assert system({}) == np.inf


def test_memory_of_the_system(system):
    assert system(MEMINFO) == 8000 * 1024


@pytest.mark.parametrize(
    ("groups", "free"),
    [
        ([("/a/b", 5000, 2000, 100)], 3100),
        # a parent's limit holds as well
        ([("/a/b", "max", 2000, 100), ("/a", 4000, 3500, 0)], 500),
        # a container sees its own group at the top
        ([("", 3000, 1000, 0)], 2000),
        ([("/a/b", "max", 10, 0)], 8000 * 1024),
        # more than the limit is used
        ([("/a/b", 10, 20, 0)], 0),
    ],
)
def test_memory_of_control_groups(system, groups, free):
    files = MEMINFO | {"proc/self/cgroup": "0::/a/b\n"}
    for one in groups:
        files |= group(*one)
    assert system(files) == free


def test_memory_of_control_groups_of_version_1(system):
    place = "sys/fs/cgroup/memory/job"
    files = {
        "proc/self/cgroup": "5:cpu,cpuacct:/x\n4:memory:/job\n0::/\n",
        f"{place}/memory.limit_in_bytes": "9000\n",
        f"{place}/memory.usage_in_bytes": "4000\n",
        f"{place}/memory.stat": "cache 3\ntotal_inactive_file 1000\n",
        "sys/fs/cgroup/memory/memory.limit_in_bytes": f"{2**63 - 4096}\n",
    }
    assert system(MEMINFO | files) == 6000


RESTRICTED = """
import resource, sys
size = int(sys.argv.pop(1)) << 20
resource.setrlimit(getattr(resource, sys.argv.pop(1)), (size, size))
from oee_tabular.__main__ import main
main()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
@pytest.mark.parametrize(
    ("limit", "megabytes", "words", "text"),
    [
        ("RLIMIT_AS", 400, "evaluate", "needs a limit of 1 GiB or more"),
        ("RLIMIT_DATA", 200, "bench", "needs a limit of 0.4 GiB or more"),
        ("RLIMIT_DATA", 480, "counts a.csv b.csv --jobs 8 --output c.npz", "(--jobs "),
        (
            "RLIMIT_AS",
            3000,
            "sample gridworld:3,slip=0.1 --episodes 100000000 --output c.npz",
            "memory; 100000000 needs",
        ),
    ],
)
def test_limits_of_a_process_are_a_sentence(limit, megabytes, words, text, tmp_path):
    for seed, name in enumerate("ab"):
        log = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 20, 20, seed=seed)
        log.save(tmp_path / f"{name}.csv")
    done = call(
        f"{megabytes} {limit} {words}",
        tmp_path,
        ("-P", "-c", RESTRICTED),
        env=dict(os.environ, PYTHONPATH=str(ROOT)),
    )
    assert done.returncode == 2
    assert text in done.stderr.splitlines()[-1]
    assert not (tmp_path / "c.npz").exists()


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_worker_that_is_killed_is_a_sentence():
    from oee_tabular import _parallel

    calls = [(signal.SIGKILL,)] * 2
    with pytest.raises(RuntimeError, match="worker process was killed, perhaps for"):
        [*_parallel.each(signal.raise_signal, calls, 2, jobs=2, dask=None)]


# ---- Ctrl-C


def stop_after(monkeypatch, n):
    """Let the estimates after the first ``n`` be interrupted."""
    from oee_tabular.estimators import ModelBased

    compute = ModelBased.estimate
    calls = []

    def estimate(self, *args):
        calls.append(1)
        if len(calls) > n:
            raise KeyboardInterrupt
        return compute(self, *args)

    monkeypatch.setattr(ModelBased, "estimate", estimate)


def test_ctrl_c_prints_the_rows_that_are_finished(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    log = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 20, 20, seed=0)
    log.save(tmp_path / "log.csv")
    stop_after(monkeypatch, 1)
    words = f"evaluate {FILES} log.csv --policy optimal --policy uniform --json"
    with pytest.raises(SystemExit) as ended:
        main([*words.split(), "--estimators", "model-based", "--quick"])
    assert ended.value.code == 130
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert lines[:2] == ["oee: interrupted", "Finished so far:"]
    assert len(lines) == 3
    assert re.match(r"model-based of “optimal”: -\d", lines[2])


def test_ctrl_c_is_a_keyboard_interrupt_in_python(monkeypatch):
    log = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 20, 20, seed=0)
    stop_after(monkeypatch, 0)
    with pytest.raises(KeyboardInterrupt):
        oee.evaluate(oee.Problem(GRID, log), {"u": oee.uniform_policy(GRID)})


def test_ctrl_c_says_how_many_cells_are_kept(tmp_path, monkeypatch, capsys):
    from oee_tabular.lab import run as running

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    add = running.Store.add
    added = []

    def add_two(self, *args):
        if len(added) == 2:
            raise KeyboardInterrupt
        added.append(add(self, *args))

    monkeypatch.setattr(running.Store, "add", add_two)
    words = "bench --families machine --sizes 3 --seeds 4 --jobs 1 --output b"
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    assert ended.value.code == 130
    assert "b: 2 of 4 cells are finished and kept" in capsys.readouterr().err
    monkeypatch.setattr(running.Store, "add", add)
    with pytest.raises(SystemExit):
        main(words.split())
    assert "2 cells computed, 2 from the cache" in capsys.readouterr().out


# ---- pictures


def draw(ax):
    ax.plot([0, 1], [1, 0])
    ax.set_title("50% of $x")


@pytest.mark.parametrize(
    "settings",
    [
        {"text.usetex": True},
        {"figure.facecolor": "red", "lines.linewidth": 20.0},
        {"font.family": ["no such font"], "axes.formatter.use_locale": True},
        {"savefig.dpi": 3, "figure.dpi": 7, "path.effects": []},
    ],
)
def test_pictures_are_the_same_whatever_the_user_s_style(settings):
    import matplotlib

    def pictures():
        about = {"name": "n", "title": "t", "description": "d"}
        return oee.plots.figure_png(draw), oee.plots.figure_svg(draw, **about)

    plain = pictures()
    with matplotlib.rc_context(settings):
        before = dict(matplotlib.rcParams.copy())
        assert pictures() == plain
        assert dict(matplotlib.rcParams.copy()) == before


def test_a_picture_that_fails_leaves_the_table(tmp_path, monkeypatch):
    log = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 20, 20, seed=0)
    report = oee.evaluate(oee.Problem(GRID, log), {"u": oee.uniform_policy(GRID)})
    plain = report.to_html()
    report.save(tmp_path)

    def fail(*_, **__):
        raise RuntimeError("latex could\nnot be found")

    monkeypatch.setattr("matplotlib.figure.Figure.subplots", fail)
    with pytest.warns(
        OutputWarning, match=r"values.png is left out.*could not be found"
    ):
        written = report.save(tmp_path)
    # nor is a picture of another report kept beside the table
    assert sorted(path.name for path in written) == ["report.json", "table.csv"]
    assert not (tmp_path / "values.png").exists()
    with pytest.warns(OutputWarning, match="the picture .* is left out"):
        page = report.to_html()
    assert "<svg" in plain
    assert "<svg" not in page
    assert "<table" in page
    with pytest.warns(OutputWarning), contextlib.suppress(ArgumentError):
        assert draw_or_warn("it", fail) is None
