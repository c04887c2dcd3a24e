"""The laws in a process of their own, which may hang, exit or be killed: what happens to it is a verdict like any other."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from oee_tabular.estimators import Simulator
from oee_tabular.testing.calls import one_thread
from oee_tabular.testing.conformance import LAWS, Verdict, Verdicts, check_estimator, subject_of, verdict_on

PREPARING = 3600.0  # seconds that compilation and import of this package may take: no fault of the estimator's


class Ended(Exception):
    """The process gives no answer: an outcome, "exits" or "hangs", and how."""

    def __init__(self, outcome: str, text: str) -> None:
        super().__init__(text)
        self.outcome, self.text = outcome, text


def check_apart(spec: str, seed: int, repetitions: int, timeout: float) -> Verdicts:
    """``check_estimator`` of "module:object", which is imported and called in processes of its own alone.

    A law that ends the process, or takes longer than ``timeout`` seconds, is broken; another process goes on with the next
    law. ValueError where the estimator cannot be had at all, which the import may take as long for as a law.
    """
    verdicts: dict[str, Verdict] = {}
    while len(verdicts) < len(LAWS):
        left = [name for name in LAWS if name not in verdicts]
        with _process(spec, seed, repetitions, left) as answer:
            title, claims = _made(spec, answer, timeout)
            for name in left:
                try:
                    verdicts[name] = Verdict(*answer(timeout))
                except Ended as ended:
                    example = f"check_estimator(..., laws=[{name!r}], seed={seed})"
                    verdicts[name] = Verdict(name, ended.outcome, ended.text, example)
                    break
    return Verdicts(title, frozenset(claims), seed, verdicts)


def _made(spec: str, answer: Any, timeout: float) -> tuple[str, list[str]]:
    """The estimator's name and claims, once it has been imported and made."""
    answer(PREPARING)
    try:
        title, claims, refusal = answer(timeout)
    except Ended as ended:
        raise ValueError(f"{spec!r} cannot be imported: {ended.text}") from None
    if refusal is not None:
        raise ValueError(refusal)
    return title, claims


@contextmanager
def _process(spec: str, seed: int, repetitions: int, laws: list[str]) -> Iterator[Any]:
    """A process that checks the laws, as a function: seconds -> its next answer, or ``Ended``. It is killed on leaving."""
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(writer, spec, seed, repetitions, laws))
    process.start()
    writer.close()

    def answer(seconds: float) -> Any:
        if not reader.poll(seconds):
            raise Ended("hangs", f"no answer within {seconds:g} s (--timeout gives it more)")
        try:
            return reader.recv()
        except (EOFError, OSError):
            process.join(5.0)
            raise Ended("exits", _how(process.exitcode)) from None

    try:
        yield answer
    finally:
        _kill(process)
        reader.close()


def _how(code: int | None) -> str:
    """How a process ended."""
    if code is None:
        return "the process closes its connection"
    if code >= 0:
        return f"the process ends, with exit code {code}"
    with suppress(ValueError):
        return f"the process is killed by {signal.Signals(-code).name}"
    return f"the process is killed by signal {-code}"


def _kill(process: Any) -> None:
    """The process and those that it has started."""
    with suppress(ProcessLookupError, PermissionError, AttributeError):  # none left; on Windows, no groups
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()
    process.close()


def _run(answers: Connection, spec: str, seed: int, repetitions: int, laws: list[str]) -> None:
    """What the process does: it says that it is ready, what the estimator is or why there is none, and each verdict."""
    from oee_tabular.testing.command import own_estimator, own_modules

    if hasattr(os, "setsid"):
        os.setsid()  # a group, with what the estimator starts
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with one_thread():
        check_estimator(Simulator(), repetitions=3)  # compiles what laws need: the seconds are not the estimator's
        answers.send("ready")
        with own_modules():
            try:
                title, subject = subject_of(own_estimator(spec), seed, repetitions)
            except Exception as error:
                own = isinstance(error, ValueError)
                answers.send(("", [], str(error) if own else f"{spec!r} raises {type(error).__name__}: {error}"))
                return
            answers.send((title, sorted(subject.claims), None))
            for name in laws:
                found = verdict_on(name, subject)
                answers.send((found.law, found.outcome, found.text, found.example))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        if hasattr(os, "killpg"):
            os.killpg(0, signal.SIGKILL)  # itself as well
        os._exit(1)
