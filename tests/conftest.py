import os

# small matrices, several workers: threads only wait for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import shlex
import warnings

import pytest
from hypothesis import HealthCheck, settings

# run by hand, from their own folder; they import each other and peers
collect_ignore = ["benchmarks"]

# neither a test nor the drawing of its cases has a limit in time
unhurried = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("dev", unhurried, max_examples=30)
settings.register_profile(
    "ci", unhurried, max_examples=100, derandomize=True, print_blob=True
)
settings.load_profile("ci" if os.environ.get("CI") else "dev")


@pytest.fixture(autouse=True)
def _hurried(monkeypatch):
    """A loaded machine, or one that has compiled nothing yet, is not told what takes it
    long: tests compare what is said.
    """
    monkeypatch.setattr("oee_tabular._progress.SECONDS", 600.0)
    monkeypatch.setattr("oee_tabular._progress.announce_compiling", lambda tell: None)


@pytest.fixture(autouse=True)
def _own_path():
    """What a test leaves in this variable decides what scripts of other tests import."""
    before = os.environ.pop("PYTHONSAFEPATH", None)
    yield
    os.environ.pop("PYTHONSAFEPATH", None)
    if before is not None:
        os.environ["PYTHONSAFEPATH"] = before


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """``oee`` with words, in strings, in a folder of its own: stdout, or stderr with
    the one line of an error.
    """
    from oee_tabular.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)

    def run(*words, code=0):
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            with pytest.raises(SystemExit) as ended:
                main(shlex.split(" ".join(str(word) for word in words)))
        captured = capsys.readouterr()
        assert (ended.value.code or 0) == code, captured.err
        if code == 0:
            return captured.out
        told = [
            line
            for line in captured.err.splitlines()
            if not line.startswith("oee: warning: ")
        ]
        assert told[0].startswith("Usage: ") or (
            len(told) == 1 and told[0].startswith("oee: ")
        )
        return captured.err

    return run


IS_COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")


def pytest_configure(config):
    """Where kernels are not compiled, numpy warns of overflow to infinity, which
    machine code does not.
    """
    if not IS_COMPILED:
        config.addinivalue_line("filterwarnings", "ignore::RuntimeWarning")


def pytest_collection_modifyitems(config, items):
    """Large problems are left out where kernels are not compiled: they would take
    hours.
    """
    if not IS_COMPILED:
        large = [item for item in items if item.get_closest_marker("large")]
        config.hook.pytest_deselected(items=large)
        items[:] = [item for item in items if not item.get_closest_marker("large")]
