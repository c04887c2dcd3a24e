"""What ``oee check module:object`` does: the laws in a process of their own, which may hang, exit or be killed.

What happens to the process is a verdict like any other.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from oee_tabular import _checks
from oee_tabular._arguments import module_and_path, own_modules, own_object
from oee_tabular._workers import end_with_parent
from oee_tabular.estimators import Simulator
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.testing.conformance import (
    LAWS,
    Verdict,
    Verdicts,
    check_estimator,
    check_law,
    check_numbers,
    make_subject,
)

EXAMPLE = "my_package.mine:MyEstimator"
LONGEST = 1e6  # seconds; operating systems wait for little more
PREPARING = 3600.0  # seconds that compilation and import of this package may take: no fault of the estimator's
MOST_HANGS = 3  # laws that may hang before the rest is left


def check(spec: str, *, seed: int = 0, repetitions: int = 8, timeout: float = 60.0) -> Verdicts:
    """Import an estimator, from the current directory or what is installed, in a process of its own, and check it there.

    A law that ends the process, or takes longer than ``timeout`` seconds, is broken; another process goes on with the next law,
    until three laws have hung: the others are then "not run".

    Parameters
    ----------
    spec : "module:object"; the object is an estimator, a function (problem, policy[, seed]), or what makes one of these
        without arguments
    seed, repetitions : as in ``check_estimator``
    timeout : seconds that a law may take, and the import; an estimator that takes longer, or ends its process, breaks the law

    Raises
    ------
    ValueError
        A spec of another form, no such module or object, a module that cannot be imported, or ends the process or takes longer
        when it is, an object that is no estimator.
    """
    check_numbers(seed, repetitions)
    seconds = _checks.number_in(timeout, "timeout", 0.0, LONGEST, open_ends=True)
    module_and_path(spec, "the estimator", EXAMPLE)
    verdicts: dict[str, Verdict] = {}
    n_hangs = 0
    while (left := [name for name in LAWS if name not in verdicts]) and n_hangs < MOST_HANGS:
        with _process(spec, seed, repetitions, left) as answer:
            answer(PREPARING)
            try:
                title, claims = answer(seconds)
            except Ended as ended:
                raise ValueError(f"{spec!r} cannot be imported: {ended.text}") from None
            for name in left:
                try:
                    verdicts[name] = answer(seconds)
                except Ended as ended:
                    example = f"check_estimator(..., laws=[{name!r}], seed={seed})"
                    verdicts[name] = Verdict(name, ended.outcome, ended.text, example)
                    n_hangs += ended.outcome == "hangs"
                    break
    for name in left:
        is_claimed = LAWS[name].is_claimed(claims)
        verdicts[name] = Verdict(name, *(("not run", f"{MOST_HANGS} laws hang") if is_claimed else ("not claimed", "")))
    return Verdicts(title, claims, seed, verdicts)


class Ended(Exception):
    """The process gives no answer: an outcome, "exits" or "hangs", and how."""

    def __init__(self, outcome: str, text: str) -> None:
        super().__init__(text)
        self.outcome, self.text = outcome, text


@contextmanager
def _process(spec: str, seed: int, repetitions: int, laws: list[str]) -> Iterator[Callable[[float], Any]]:
    """A process that checks the laws, as a function: seconds -> its next answer, or ``Ended``. It is killed on leaving."""
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(writer, spec, seed, repetitions, laws))
    process.start()
    writer.close()

    def answer(seconds: float) -> Any:
        message: Any = ""
        end, title = time.monotonic() + seconds, ""
        while isinstance(message, str):  # the title of a case that is begun
            title = f"{message}: " if message else ""
            if not reader.poll(max(end - time.monotonic(), 0.0)):
                raise Ended("hangs", f"{title}no answer within {seconds:g} s (--timeout gives it more)")
            try:
                message = reader.recv()
            except (EOFError, OSError):
                process.join(5.0)
                raise Ended("exits", f"{title}{_describe_end(process.exitcode)}") from None
        if isinstance(message, ValueError):
            raise message
        return message

    try:
        yield answer
    finally:
        with suppress(ProcessLookupError, PermissionError, AttributeError):  # none left; on Windows, no groups
            os.killpg(process.pid or 0, signal.SIGKILL)  # with those that it has started
        process.kill()
        process.join()
        process.close()
        reader.close()


def _describe_end(code: int | None) -> str:
    if code is None:
        return "the process closes its connection"
    if code >= 0:
        return f"the process ends, with exit code {code}"
    with suppress(ValueError):
        return f"the process is killed by {signal.Signals(-code).name}"
    return f"the process is killed by signal {-code}"


def _run(answers: Connection, spec: str, seed: int, repetitions: int, laws: list[str]) -> None:
    """What the process does: it says that it is ready, what the estimator is or why there is none, and each verdict."""
    if hasattr(os, "setsid"):
        os.setsid()  # a group, with what the estimator starts
    end_with_parent(os.getppid(), with_group=True)
    check_estimator(Simulator(), repetitions=3)  # compiles what laws need: the seconds are not the estimator's
    answers.send(None)  # ready
    with own_modules():
        try:
            subject = make_subject(own_estimator(spec), seed, repetitions)
        except Exception as error:
            text = str(error) if isinstance(error, ValueError) else f"{spec!r} raises {type(error).__name__}: {error}"
            answers.send(ValueError(text))
            return
        answers.send((subject.name, subject.claims))
        for name in laws:
            answers.send(check_law(name, replace(subject, report=answers.send)))


def own_estimator(spec: str) -> Any:
    """The estimator of "module:object", or what a class or function there makes without arguments."""
    return as_estimator(own_object(spec, "the estimator", EXAMPLE), repr(spec)).function
