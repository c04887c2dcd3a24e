"""CPU seconds from a new interpreter to the end of a first command; smallest of several starts, in turns.

The peer is what all but the first two need anyway, ``import numpy, scipy.sparse``; the differences to it are in the notes. A
"second start" finds the kernels that an earlier process compiled.
"""

import resource
import subprocess
import sys

from common import row

HELP = """
import sys
from oee_tabular.cli import main
sys.argv = ["oee", "--help"]
try:
    main()
except SystemExit:
    pass
"""
VALUE = """
import oee_tabular as oee
grid = oee.tasks.gridworld(10, 0.3)
oee.policy_value(grid, oee.uniform_policy(grid))
oee.policy_value(grid, oee.uniform_policy(grid), horizon=200)
"""
RATIO = """
import oee_tabular as oee
simulator, target = oee.tasks.gridworld(10, 0.3), oee.tasks.gridworld(10, 0.1)
log = oee.sample_episodes(target, oee.uniform_policy(target), 50, 100, seed=0)
oee.transition_ratio(log, simulator)
"""
PEER = "import numpy, scipy.sparse"
PROGRAMS = {
    "import oee_tabular": "import oee_tabular",
    "oee --help": HELP,
    "second start: two values": VALUE,
    "second start: a log and its ratio": RATIO,
}


def started(code):
    """User and system seconds of a child that runs ``code``."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def rows(*, quick):
    """The table's rows."""
    times = {code: [] for code in (PEER, *PROGRAMS.values())}
    for _ in range(3 if quick else 9):
        for code, taken in times.items():
            taken.append(started(code))
    base = min(times[PEER])
    for case, code in PROGRAMS.items():
        ours = min(times[code])
        yield row("start", case, "ours", ours, note=f"{ours - base:+.3f} s")
        yield row("start", case, PEER, base)
