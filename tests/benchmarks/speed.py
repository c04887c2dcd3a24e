"""Speed against every peer and against an earlier state of the package: a table in
Markdown.

    pip install quantecon pypardiso mdpsolver duckdb pyarrow
    git worktree add ../before c81a0ed
    PYTHONPATH=. python tests/benchmarks/speed.py [TASK ...] [--before ../before] [--quick]

A task is a name in TASKS; all without one. It yields rows, most of them by ``compare``:
programs that take turns. ``--before`` runs our own programs of the same cases in
another checkout, too, in a process of its own that takes its turns. Times are user and
system seconds, those of child processes included, with one BLAS thread: medians, the
first run apart. ``error`` is what an answer misses. A peer that is not installed, or
fails, is said.
"""

import argparse
import contextlib
import datetime
import importlib
import json
import os
import platform
import resource
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

TASKS = {
    "small_calls": "jobs",
    "small_estimates": "jobs",
    "solve": "values",
    "plan": "values",
    "occupy": "values",
    "rollouts": "jobs",
    "fit_cells": "jobs",
    "intervals": "jobs",
    "reports": "jobs",
    "starts": "jobs",
    "counts": "jobs",
    "millions": "jobs",
    "memory": "values",
    "horizon": "values",
    "ratio": "jobs",
}
QUICK = 2_000  # states of the largest problem with --quick
# times that a program is timed
LEAST = 3
MOST = 200
BEFORE = "before: "  # a program of ours in the other checkout


class Other:
    """The other checkout's process: a line asks for one timing of a program of the case
    where it stands.
    """

    process = None  # where it runs
    is_self = False  # this process is it

    @classmethod
    def begin(cls, folder, words):
        command = [sys.executable, __file__, *words, "--answer"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        cls.process = subprocess.Popen(
            command, env=os.environ | {"PYTHONPATH": str(folder.resolve())}, **pipes
        )

    @classmethod
    def ask(cls, program):
        """The other's seconds; a text where it failed; None asks for the next case."""
        with contextlib.suppress(BrokenPipeError):
            cls.process.stdin.write(json.dumps(program) + "\n")
            cls.process.stdin.flush()
        return (
            None
            if program is None
            else json.loads(cls.process.stdout.readline() or '"it ended"')
        )

    @staticmethod
    def answer(calls, repeat):
        """Serve one case."""
        while (program := json.loads(input())) is not None:
            try:
                with contextlib.redirect_stdout(sys.stderr):
                    reply = measure(calls[program], repeat)[0]
            except Exception as error:
                reply = f"{type(error).__name__}: {error}"[:120]
            print(json.dumps(reply), flush=True)


def cpu():
    """User and system seconds of this process and of its children that ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def measure(call, repeat):
    """Seconds of ``repeat`` calls, and the last result."""
    start = cpu()
    for _ in range(repeat):
        result = call()
    return cpu() - start, result


def row(task, case, program, seconds, error=np.nan, note=""):
    """One program of a case; ``note``: why there is no time, or what is odd about it."""
    numbers = {"seconds": float(seconds), "error": float(error)}
    return {"task": task, "case": case, "program": program, "note": note} | numbers


def compare(
    task, case, ours, peers=None, *, miss=None, repeat=1, seconds=0.5, units=None
):
    """Rows of a case.

    ours    : name -> call
    peers   : name -> function that gets ready and returns the call
    miss    : result -> what the answer misses
    repeat  : calls of one timing, for calls that a clock cannot see
    seconds : to spend on each program; 0: once
    units   : result -> what its seconds are divided by
    """
    if Other.is_self:
        return Other.answer(ours, repeat)
    run = {name: partial(measure, call, repeat) for name, call in ours.items()}
    if Other.process:
        run |= {
            BEFORE + name: lambda name=name: (Other.ask(name), None) for name in ours
        }
    times = {}
    results = {}
    for program in [*run, *(peers or {})]:
        try:
            if program not in run:
                run[program] = partial(measure, peers[program](), repeat)
            # the first run may compile
            if isinstance(answer := run[program]()[0], str):
                raise RuntimeError(answer)
            times[program] = []
        except Exception as error:
            yield row(
                task,
                case,
                program,
                np.nan,
                note=f"{type(error).__name__}: {error}"[:120],
            )
    left = set(times)
    while left:
        for program in sorted(left):
            taken = times[program]
            last, results[program] = run[program]()
            taken.append(last)
            if seconds == 0 or (
                len(taken) >= LEAST and (sum(taken) >= seconds or len(taken) >= MOST)
            ):
                left.discard(program)
    if Other.process:
        Other.ask(None)
    for program, taken in times.items():
        result = results[program]
        unit = 1.0 if units is None else units(results[program.removeprefix(BEFORE)])
        error = np.nan if miss is None or result is None else miss(result)
        yield row(task, case, program, np.median(taken) / repeat / unit, error)


def markdown(rows):
    """A line for each program; the last ratio is its time over that of our program (of
    the same name, or the first).
    """
    yield "| task | case | program | seconds | error | time / ours | note |"
    yield "|" + "---|" * 7
    for r in rows:
        case = {
            o["program"]: o["seconds"]
            for o in rows
            if (o["task"], o["case"]) == (r["task"], r["case"])
        }
        first = next((program for program in case if program.startswith("ours")), None)
        ours = case.get(
            (
                r["program"].removeprefix(BEFORE)
                if r["program"].startswith(BEFORE)
                else first
            ),
            np.nan,
        )
        yield (
            "| {task} | {case} | {program} | {seconds:.3g} | {error:.1g} | {0:.3g} |"
            " {note} |".format(r["seconds"] / ours, **r)
        )


def main():
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "tasks", nargs="*", choices=[*TASKS, []], default=[], metavar="TASK"
    )
    parser.add_argument("--before", type=Path, help="another checkout of the package")
    parser.add_argument(
        "--quick", action="store_true", help=f"problems of at most {QUICK} states"
    )
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    rows = []
    tasks = options.tasks or list(TASKS)
    Other.is_self = options.answer
    if options.before:
        Other.begin(options.before, [*tasks, *["--quick"] * options.quick])
    with threadpool_limits(limits=1):
        for task in tasks:
            for new in getattr(importlib.import_module(TASKS[task]), task)(
                QUICK if options.quick else 10**9
            ):
                rows.append(new)
                print(
                    f"  {new['task']} | {new['case']} | {new['program']}:"
                    f" {new['seconds']:.3g} s",
                    file=sys.stderr,
                )
    if not Other.is_self:
        print(
            f"`python {' '.join(sys.argv)}`, {datetime.date.today()},"
            f" {platform.machine()}, {os.cpu_count()} cores,"
        )
        print(f"Python {platform.python_version()}\n")
        print("\n".join(markdown(rows)))


if __name__ == "__main__":
    importlib.import_module("speed").main()  # the module that the tasks import
