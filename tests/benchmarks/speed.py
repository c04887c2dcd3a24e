"""Exact evaluation, moments and rollouts against every peer: one table, Markdown and JSON.

    python tests/benchmarks/speed.py [TASK ...] [--quick] [--environment FOLDER] [--json FILE]

A task is one of values, regimes, graphs, horizon, rollouts, planning and jobs; all but graphs without one.

The peers (PEERS) are installed into a virtual environment of their own, beside this package: a temporary one, or FOLDER,
where what is there already is used; one that cannot be installed is said and left out. The benchmark then runs there, all
competitors of a case taking turns in one process; times are CPU seconds with one BLAS thread, medians, compilation apart.
"""

import argparse
import importlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

PEERS = ("quantecon", "pypardiso", "mdpsolver", "mdptoolbox-hiive", "pymdptoolbox", "jax", "duckdb", "pyarrow")
TASKS = {  # module and function
    "values": ("values", "rows"), "regimes": ("values", "regimes"), "horizon": ("horizon", "rows"),
    "rollouts": ("rollouts", "rows"), "planning": ("planning", "rows"), "jobs": ("jobs", "rows"),
    "graphs": ("values", "graphs"),
}  # fmt: skip
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
XLA = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1", "JAX_ENABLE_X64": "1"}


def environment(folder):
    """The Python of an environment that has this package and the peers."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
        root = Path(__file__).parents[2]
        subprocess.run([python, "-m", "pip", "install", "--quiet", "-e", str(root)], check=True)
        for peer in PEERS:
            done = subprocess.run([python, "-m", "pip", "install", "--quiet", peer], capture_output=True, text=True)
            if done.returncode:
                print(f"{peer} is left out: {done.stderr.strip().splitlines()[-1][:200]}", file=sys.stderr)
    return python


def inside(tasks, quick, output):
    """Run by the environment's Python."""
    rows = []
    for task in tasks:
        module, function = TASKS[task]
        for row in getattr(importlib.import_module(module), function)(quick=quick):
            rows.append(row)
            print(f"  {row['task']} | {row['case']} | {row['program']}: {row['seconds']:.3g} s", file=sys.stderr)
        output.write_text(json.dumps(rows))


def markdown(rows):
    """A line for each case: our best time, the best peer's, the others', and errors."""
    cases = {}
    for row in rows:
        cases.setdefault((row["task"], row["case"]), []).append(row)
    lines = [
        "| task | case | ours (s) | error | best peer (s) | error | times | others: times ours |",
        "|" + "---|" * 8,
    ]
    for (task, case), found in cases.items():
        timed = [row for row in found if row["seconds"] == row["seconds"]]
        ours = min((r for r in timed if r["program"].startswith("ours")), key=lambda r: r["seconds"], default=None)
        peers = sorted((r for r in timed if not r["program"].startswith("ours")), key=lambda r: r["seconds"])
        if ours is None:
            lines.append(f"| {task} | {case} | failed | | | | | |")
            continue
        others = [f"{r['program']} {r['seconds'] / ours['seconds']:.3g}" for r in peers[1:]]
        others += [f"{r['program']} {r['seconds'] / ours['seconds']:.3g}" for r in timed
                   if r["program"].startswith("ours") and r is not ours]  # fmt: skip
        others += [f"{r['program']}: {r['note']}" for r in found if r["note"]]
        best = peers[0] if peers else None
        lines.append(
            f"| {task} | {case} | {ours['seconds']:.3g} | {ours['error']:.1g} | "
            + (f"{best['program']} {best['seconds']:.3g} | {best['error']:.1g} | {best['seconds'] / ours['seconds']:.3g}"
               if best else " | | ")
            + f" | {'; '.join(others)} |"
        )  # fmt: skip
    return "\n".join(lines)


def main():
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", default=[*TASKS][:-1], choices=(*TASKS, []), metavar="TASK")
    parser.add_argument("--quick", action="store_true", help="small cases only")
    parser.add_argument("--environment", type=Path)
    parser.add_argument("--json", type=Path, help="where the rows are written")
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        return inside(options.tasks, options.quick, options.inside)
    with tempfile.TemporaryDirectory() as temporary:
        python = environment(options.environment or Path(temporary) / "peers")
        rows = Path(temporary) / "rows.json"
        command = [python, __file__, *options.tasks, "--inside", rows] + ["--quick"] * options.quick
        subprocess.run(command, check=True, env={**os.environ, **ONE_THREAD, **XLA})
        found = json.loads(rows.read_text())
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    print(markdown(found))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
