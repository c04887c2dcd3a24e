"""What the first command compiles on a new machine: python tests/benchmarks/compiling.py.

``oee evaluate`` runs in a process of its own with an empty cache. Printed are the CPU
seconds of compiling of each kernel, without those that it calls, and of the whole
command; then the same command with the cache that the first one left.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
CHILD = '''
import json, sys, time
from numba.core import event

class Watch(event.Listener):
    """Keep the seconds that each kernel's compiling takes by itself."""

    def __init__(self):
        self.open = []
        self.seconds = {}

    def on_start(self, found):
        self.open.append([time.process_time(), 0.0])

    def on_end(self, found):
        began, inside = self.open.pop()
        whole = time.process_time() - began
        function = found.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__name__}"
        self.seconds[name] = self.seconds.get(name, 0.0) + whole - inside
        if self.open:
            self.open[-1][1] += whole

watch = Watch()
event.register("numba:compile", watch)
from oee_tabular.cli import main
begun = time.process_time()
try:
    main(sys.argv[1:])
except SystemExit as ending:
    assert not ending.code, ending.code
finally:
    print(json.dumps([time.process_time(), watch.seconds]), file=sys.stderr)
'''


def run(command, cache):
    """Return the CPU seconds of a command, and of each kernel that it compiles."""
    environment = dict(os.environ, NUMBA_CACHE_DIR=cache, PYTHONPATH=str(ROOT))
    with tempfile.TemporaryDirectory() as folder:
        found = subprocess.run(
            [sys.executable, "-c", CHILD, *command],
            env=environment,
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
    if found.returncode:
        raise SystemExit(found.stderr)
    return json.loads(found.stderr.splitlines()[-1])


def main(command):
    """Print the table."""
    with tempfile.TemporaryDirectory() as cache:
        whole, seconds = run(command, cache)
        again, left = run(command, cache)
    for name, own in sorted(seconds.items(), key=lambda pair: -pair[1]):
        print(f"{own:7.2f} s  {name}")
    print(f"{sum(seconds.values()):7.2f} s  {len(seconds)} kernels")
    print(f"{whole:7.2f} s  the whole command, CPU")
    print(
        f"{again:7.2f} s  the same again, of which {sum(left.values()):.2f} compiling"
    )


if __name__ == "__main__":
    main(sys.argv[1:] or ["evaluate"])
