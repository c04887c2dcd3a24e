"""What ``oee check module:object`` does."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import sys
from collections.abc import Iterator
from typing import Any

from oee_tabular import _checks
from oee_tabular.testing.apart import check_apart
from oee_tabular.testing.conformance import Verdicts, check_numbers

LONGEST = 1e6  # seconds; operating systems wait for little more


def check(spec: str, *, seed: int = 0, repetitions: int = 8, timeout: float = 60.0) -> Verdicts:
    """Import an estimator, from the current directory or what is installed, in a process of its own, and check it there.

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
    return check_apart(spec, seed, repetitions, seconds)


@contextlib.contextmanager
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
        raise ValueError(f"{what} must be given as MODULE:OBJECT, {example}; got {spec!r}")
    if module_name.endswith(".py") or os.sep in module_name:
        hint = module_name.removesuffix(".py").replace(os.sep, ".").strip(".")
        raise ValueError(f"MODULE must be a module's name, not a file's; got {module_name!r} (try {hint}:{path})")
    return module_name, path


def own_object(spec: str, what: str, example: str) -> Any:
    """The object of "module:object"; errors call it ``what`` and give an ``example`` of the form."""
    module_name, path = module_and_path(spec, what, example)
    try:
        found = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and (module_name == error.name or module_name.startswith(f"{error.name}.")):
            raise ValueError(
                f"module {module_name!r} cannot be found, neither in {os.getcwd()} nor installed"
            ) from None
        raise ValueError(f"module {module_name!r} cannot be imported: {type(error).__name__}: {error}") from error
    except (Exception, SystemExit) as error:
        raise ValueError(f"module {module_name!r} cannot be imported: {type(error).__name__}: {error}") from error
    for name in path.split("."):
        if not hasattr(found, name):
            public = [key for key, value in vars(found).items() if callable(value) and not key.startswith("_")]
            known = f" (it has {', '.join(sorted(public)[:8])})" if public else ""
            raise ValueError(f"{module_name!r} has no object {path!r}{known}")
        found = getattr(found, name)
    return found


def _made(found: Any, spec: str) -> Any:
    """The estimator itself, or what a class or factory makes."""
    if not callable(found):
        raise ValueError(
            f"{spec!r} must be an estimator, or a class or function that makes one; it is a {type(found).__name__}"
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
