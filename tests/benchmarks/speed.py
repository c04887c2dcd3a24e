"""Speed against every peer: a table in Markdown.

    pip install quantecon pypardiso mdpsolver jax duckdb pyarrow
    python tests/benchmarks/speed.py [TASK ...] [--quick]

A task is a name in TASKS; all but graphs and ratio without one. It yields rows, most of them by ``compare``: programs that
take turns in one process. Times are CPU seconds with one BLAS thread, medians, compilation apart; ``error`` is what an
answer misses. A peer that is not installed, or fails, is said.
"""

import argparse
import importlib
import os
import platform
import sys
import time

import numpy as np
from threadpoolctl import threadpool_limits

TASKS = {
    "values": "values", "regimes": "values", "horizon": "values", "planning": "values", "rollouts": "jobs",
    "jobs": "jobs", "graphs": "values", "ratio": "jobs",
}  # fmt: skip
LEAST, MOST = 3, 200  # times that a program is timed


def row(task, case, program, seconds, error=np.nan, note=""):
    """One program of a case; ``note``: why there is no time, or what is odd about it."""
    numbers = {"seconds": float(seconds), "error": float(error)}
    return {"task": task, "case": case, "program": program, "note": note} | numbers


def compare(task, case, ours, peers=None, *, miss=None, repeat=1, seconds=1.0, units=None):
    """Rows of a case.

    ours    : name -> call
    peers   : name -> function that gets ready and returns the call
    miss    : result -> what the answer misses
    repeat  : calls of one timing, for calls that a clock cannot see
    seconds : to spend on each program; 0: once
    units   : result -> what its seconds are divided by
    """
    calls, times, results = {}, {}, {}
    ready = {name: lambda call=call: call for name, call in ours.items()}
    for program, prepare in (ready | (peers or {})).items():
        try:
            calls[program] = prepare()
            calls[program]()  # which may compile
            times[program] = []
        except Exception as error:
            yield row(task, case, program, np.nan, note=f"{type(error).__name__}: {error}"[:120])
    left = set(times)
    while left:
        for program in sorted(left):
            start = time.process_time()
            for _ in range(repeat):
                results[program] = calls[program]()
            taken = times[program]
            taken.append(time.process_time() - start)
            if seconds == 0 or (len(taken) >= LEAST and (sum(taken) >= seconds or len(taken) >= MOST)):
                left.discard(program)
    for program, taken in times.items():
        result = results[program]
        each = np.median(taken) / repeat / (1.0 if units is None else units(result))
        yield row(task, case, program, each, np.nan if miss is None else miss(result))


def markdown(rows):
    """A line for each case: our best time, the best peer's, the others', and errors."""
    cases = {}
    for new in rows:
        cases.setdefault((new["task"], new["case"]), []).append(new)
    yield "| task | case | ours (s) | error | best peer (s) | error | times | others: times ours |"
    yield "|" + "---|" * 8
    for (task, case), found in cases.items():
        timed = sorted((r for r in found if r["seconds"] == r["seconds"]), key=lambda r: r["seconds"])
        ours = next((r for r in timed if r["program"].startswith("ours")), None)
        best = next((r for r in timed if not r["program"].startswith("ours")), None)
        if ours is None:
            yield f"| {task} | {case} | failed | | | | | |"
            continue
        times = {r["program"]: f"{r['seconds'] / ours['seconds']:.3g}" for r in timed}
        others = [f"{r['program']} {times[r['program']]}" for r in timed if r is not ours and r is not best]
        others += [f"{r['program']}: {r['note']}" for r in found if r["note"]]
        cells = [task, case, f"{ours['seconds']:.3g}", f"{ours['error']:.1g}", "", "", ""]
        if best is not None:
            cells[4:] = f"{best['program']} {best['seconds']:.3g}", f"{best['error']:.1g}", times[best["program"]]
        yield f"| {' | '.join(cells)} | {'; '.join(others)} |"


def main():
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", choices=[*TASKS, []], default=[*TASKS][:-2], metavar="TASK")
    parser.add_argument("--quick", action="store_true", help="small cases only")
    options, rows = parser.parse_args(), []
    with threadpool_limits(limits=1):
        for task in options.tasks:
            for new in getattr(importlib.import_module(TASKS[task]), task)(quick=options.quick):
                rows.append(new)
                print(f"  {new['task']} | {new['case']} | {new['program']}: {new['seconds']:.3g} s", file=sys.stderr)
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    print("\n".join(markdown(rows)))


if __name__ == "__main__":
    main()
