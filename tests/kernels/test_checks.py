"""What errors show of values, and how many workers there are, whom no Ctrl-C reaches."""

import subprocess
import sys
import time

import numpy as np
import pytest
from scipy import sparse

import oee_tabular as oee
from oee_tabular import _checks, _workers
from oee_tabular.lab.run import _hold_interrupts

GRID = oee.tasks.gridworld(3, 0.3)
UNIFORM = oee.uniform_policy(GRID)
LOG = oee.sample_episodes(GRID, UNIFORM, 4, 20, seed=0)


def nested_list(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


class Silent:
    def __repr__(self):
        raise RecursionError


@pytest.mark.parametrize(
    "value",
    [
        nested_list(10_000), np.zeros((2,) * 30, dtype=bool), np.full((400, 400), None), 10**5000, "x" * 10**7,
        list(range(10**6)), Silent(), sparse.eye_array(5), dict.fromkeys(range(1000), "y" * 1000),
    ],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_any_value_is_shown_quickly_and_briefly(value):
    began = time.process_time()
    text = _checks.show(value)
    assert time.process_time() - began < 1.0
    assert 0 < len(text) <= 300
    with pytest.raises(ValueError, match="horizon must be"):
        oee.policy_value(GRID, UNIFORM, horizon=value if not isinstance(value, int) else -value)
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize("text", ["\x1b[31mX", "a\nb", "\x9b31m", "\u202egnp"])
def test_control_characters_are_visible(text):
    assert _checks.show(text).isprintable()
    assert _checks.escape_controls(text).isprintable()
    with pytest.raises(ValueError, match="estimators") as refused:
        oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators=[text])
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(("jobs", "cells", "most"), [(1000, 3, 3), (2, 3, 2), (2, 1, 2), (1, 5, 1)])
def test_no_more_jobs_than_cells_but_one_cell_has_a_process_of_its_own(jobs, cells, most):
    assert _workers.parallel(cells, jobs, None).n_jobs == most


def test_workers_are_not_interrupted_themselves():
    """Ctrl-C reaches every process of a terminal; those that still import would each print a traceback."""
    script = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))"
    with _hold_interrupts():
        inside = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    outside = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (inside.stdout, outside.stdout) == ("True\n", "False\n")
