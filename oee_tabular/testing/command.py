"""What ``oee check module:object`` does: the laws in a process of their own, which may hang, exit or be killed.

What happens to the process is a verdict like any other.
"""

from __future__ import annotations

import importlib
import inspect
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from types import ModuleType
from typing import Any

from oee_tabular import _checks
from oee_tabular.estimators import Simulator
from oee_tabular.testing.calls import one_thread
from oee_tabular.testing.conformance import (
    LAWS,
    Verdict,
    Verdicts,
    check_estimator,
    check_numbers,
    subject_of,
    verdict_on,
)

LONGEST = 1e6  # seconds; operating systems wait for little more
PREPARING = 3600.0  # seconds that compilation and import of this package may take: no fault of the estimator's


def check(spec: str, *, seed: int = 0, repetitions: int = 8, timeout: float = 60.0) -> Verdicts:
    """Import an estimator, from the current directory or what is installed, in a process of its own, and check it there.

    A law that ends the process, or takes longer than ``timeout`` seconds, is broken; another process goes on with the next law.

    Parameters
    ----------
    spec : "module:object"; the object is an estimator, or a class or function that makes one without arguments
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
    module_and_path(spec, "the estimator", "my_package.mine:MyEstimator")
    verdicts: dict[str, Verdict] = {}
    while len(verdicts) < len(LAWS):
        left = [name for name in LAWS if name not in verdicts]
        with _process(spec, seed, repetitions, left) as answer:
            title, claims = _imported(spec, answer, seconds)
            for name in left:
                try:
                    verdicts[name] = Verdict(*answer(seconds))
                except Ended as ended:
                    example = f"check_estimator(..., laws=[{name!r}], seed={seed})"
                    verdicts[name] = Verdict(name, ended.outcome, ended.text, example)
                    break
    return Verdicts(title, frozenset(claims), seed, verdicts)


class Ended(Exception):
    """The process gives no answer: an outcome, "exits" or "hangs", and how."""

    def __init__(self, outcome: str, text: str) -> None:
        super().__init__(text)
        self.outcome, self.text = outcome, text


def _imported(spec: str, answer: Any, timeout: float) -> tuple[str, list[str]]:
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


# ---- MODULE:OBJECT -----------------------------------------------------------------------------------------------------


@contextmanager
def own_modules() -> Iterator[None]:
    """Modules of the current directory can be imported, as those that are installed."""
    folder = os.getcwd()
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


def own_estimator(spec: str) -> Any:
    """The estimator of "module:object", or what a class or function there makes without arguments."""
    return _made(own_object(spec, "the estimator", "my_package.mine:MyEstimator"), spec)


def module_and_path(spec: str, what: str, example: str) -> tuple[str, str]:
    """The two parts of "module:object"; nothing is imported."""
    module_name, colon, path = spec.partition(":")
    if not (colon and module_name and path):
        raise ValueError(f"{what} must be given as MODULE:OBJECT, {example}; got {_checks.show(spec)}")
    if module_name.endswith(".py") or os.sep in module_name:
        hint = module_name.removesuffix(".py").replace(os.sep, ".").strip(".")
        raise ValueError(
            f"MODULE must be a module's name, not a file's; got {_checks.show(module_name)} (try {hint}:{path})"
        )
    return module_name, path


def own_object(spec: str, what: str, example: str) -> Any:
    """The object of "module:object"; errors call it ``what`` and give an ``example`` of the form."""
    module_name, path = module_and_path(spec, what, example)
    found: object = own_module(module_name)
    for name in path.split("."):
        if not hasattr(found, name):
            public = [key for key, value in vars(found).items() if callable(value) and not key.startswith("_")]
            known = f" (it has {', '.join(sorted(public)[:8])})" if public else ""
            raise ValueError(f"{module_name!r} has no object {path!r}{known}")
        found = getattr(found, name)
    return found


def own_module(module_name: str) -> ModuleType:
    """The module of that name, imported; a ValueError where that fails."""
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(f"{error.name}.")):
            raise ValueError(
                f"module {module_name!r} cannot be found, neither in {os.getcwd()} nor installed"
            ) from None
        raise ValueError(f"module {module_name!r} cannot be imported: {type(error).__name__}: {error}") from error
    except (Exception, SystemExit) as error:
        raise ValueError(f"module {module_name!r} cannot be imported: {type(error).__name__}: {error}") from error


def _made(found: object, spec: str) -> Any:
    """The estimator itself, or what a class or factory makes."""
    if not callable(found):
        raise ValueError(
            f"{spec!r} must be an estimator, or a class or function that makes one; got {type(found).__name__}"
        )
    if not isinstance(found, type) and _takes(found, None, None, seed=None):
        return found
    try:
        made = found()
    except Exception as error:
        raise ValueError(
            f"{spec!r} must make an estimator without arguments; it raises {type(error).__name__}: {error}"
        ) from error
    if not callable(made):
        raise ValueError(
            f"{spec!r} must make an estimator, callable as (problem, policy, *, seed=None); it makes a {type(made).__name__}"
        )
    return made


def _takes(function: Any, *arguments: Any, **options: Any) -> bool:
    try:
        inspect.signature(function).bind(*arguments, **options)
    except (TypeError, ValueError):
        return False
    return True
