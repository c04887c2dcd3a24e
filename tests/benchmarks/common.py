"""What the speed benchmarks share: clocks, and competitors that take turns in one process.

A benchmark yields rows, dicts with these keys:

task, case     what was computed, and on what: {"task": "V", "case": "grid 300, delta .5, discount .99"}
program        "ours" (or "ours, ..."), else the peer's name
seconds        median CPU seconds of this thread, or nan where it failed
error          what the answer misses (each task says in its docstring in which unit), nan where it is not known
note           "", or why there is no time, or what is odd about it
"""

import time

import numpy as np


def cpu(call, *arguments):
    """The call's result, and its CPU seconds (all threads of the process)."""
    start = time.process_time()
    found = call(*arguments)
    return found, time.process_time() - start


def interleaved(calls, seconds=1.0, least=3, most=200):
    """{name: (median CPU seconds, last result)} of functions without arguments that take turns, after one warm call each.

    A name is timed for about ``seconds`` in all, between ``least`` and ``most`` times; a call that raises is reported as
    (nan, the exception).
    """
    found, times = {}, {}
    for name, call in calls.items():
        try:
            found[name], first = cpu(call)
            again, second = cpu(call)  # the first may have compiled
            found[name] = again
            times[name] = [] if first > 3.0 * second else [first]
            times[name].append(second)
        except Exception as error:
            found[name], times[name] = error, None
    left = {name for name, taken in times.items() if taken}
    while left:
        for name in sorted(left):
            found[name], taken = cpu(calls[name])
            times[name].append(taken)
            if len(times[name]) >= least and (sum(times[name]) >= seconds or len(times[name]) >= most):
                left.discard(name)
    return {name: (float(np.median(taken)) if taken else np.nan, found[name]) for name, taken in times.items()}


def per_call(call, repeat):
    """A function that calls ``repeat`` times, for calls that a clock cannot see; divide its seconds by ``repeat``."""

    def many():
        for _ in range(repeat - 1):
            call()
        return call()

    return many


def row(task, case, program, seconds, error=np.nan, note=""):
    """One row of the table."""
    return {"task": task, "case": case, "program": program, "seconds": seconds, "error": error, "note": note}


def rows_of(task, case, timed, miss=None, scale=1.0):
    """Rows of what ``interleaved`` found; ``miss(result)`` is the error of an answer, ``scale`` divides the seconds."""
    for name, (seconds, result) in timed.items():
        if isinstance(result, Exception):
            yield row(task, case, name, np.nan, note=f"{type(result).__name__}: {result}"[:120])
        else:
            yield row(task, case, name, seconds / scale, np.nan if miss is None else float(miss(result)))
