"""The package without one of the libraries that it uses: what needs it says so."""

import subprocess
import sys

import pytest

# what works without any of them, and what each is for
CODE = '''
import sys, warnings

class Blocked:
    """Refuses to find one module."""

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == sys.argv[1]:
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Blocked())
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    import numpy as np
    import oee_tabular as oee

    simulator = oee.FiniteMDP(
        [[[0.9, 0.1], [0.1, 0.9]], [[0.5, 0.5], [0.2, 0.8]]],
        [[1.0, 2.0], [3.0, 4.0]], [1.0, 0.0], 0.9,
    )
    policy = oee.uniform_policy(simulator)
    log = oee.sample_episodes(simulator, policy, 5, 10, seed=0)
    problem = oee.Problem(simulator, log)
    found = oee.interval(problem, policy)
    report = oee.evaluate(problem, {"new": policy}, seed=0)
    print(f"{oee.policy_value(simulator, policy):.9f}")
    print(f"{oee.estimators.OffEnvironment()(problem, policy).value:.9f}")
    print(f"{found.lower:.7f} {found.upper:.7f}")
    print(oee.density_ratio([1.0, 2.0], [2.0, 1.0]).ratio.round(9).tolist())
    print(report.headline)
    attempts = {
        "cvxpy": lambda: oee.density_ratio([1.0, 2.0], [2.0, 1.0], solver="CLARABEL"),
        "gymnasium": lambda: oee.tasks.gymnasium_simulator("CartPole-v1"),
        "pandas": lambda: log.save("log.csv"),
        "matplotlib": lambda: report.to_html("report.html"),
        "typer": lambda: __import__("oee_tabular.cli"),
    }
    if sys.argv[1] in attempts:
        try:
            attempts[sys.argv[1]]()
        except ImportError as error:
            print("needed:", error)
if sys.argv[1] == "numba":
    assert any("numba cannot be imported" in str(one.message) for one in told)
'''


def run(module, folder):
    """Return what the code prints where a module cannot be imported."""
    done = subprocess.run(
        [sys.executable, "-c", CODE, module],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    """Return what the code prints where all modules are there."""
    return run("none", tmp_path_factory.mktemp("usual"))


@pytest.mark.parametrize(
    "module",
    ["numba", "cvxpy", "gymnasium", "typer", "filelock", "pandas", "matplotlib"],
)
def test_a_missing_library_is_missed_where_it_is_needed(tmp_path, usual, module):
    found = run(module, tmp_path)
    assert found[:5] == usual[:5]
    if module in ("cvxpy", "gymnasium", "pandas", "typer"):
        assert found[5].startswith("needed:")
        assert module in found[5]
    assert not list(tmp_path.iterdir()) or module == "matplotlib"
