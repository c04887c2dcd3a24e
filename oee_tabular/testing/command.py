"""What ``oee check module:object`` does."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import os
import sys
from collections.abc import Iterator
from typing import Any

from oee_tabular.testing.conformance import Verdicts, check_estimator


def check(spec: str, *, seed: int = 0, repetitions: int = 8) -> Verdicts:
    """Import an estimator, from the current directory or what is installed, and check it.

    Parameters
    ----------
    spec : "module:object"; the object is an estimator, or a class or function that makes one without arguments
    seed, repetitions : as in ``check_estimator``

    Raises
    ------
    ValueError
        A spec of another form, no such module or object, a module that cannot be imported, an object that is no estimator.
    """
    with own_modules():
        return check_estimator(own_estimator(spec), seed=seed, repetitions=repetitions)


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


def own_object(spec: str, what: str, example: str) -> Any:
    """The object of "module:object"; errors call it ``what`` and give an ``example`` of the form."""
    module_name, colon, path = spec.partition(":")
    if not (colon and module_name and path):
        raise ValueError(f"{what} must be given as MODULE:OBJECT, {example}; got {spec!r}")
    if module_name.endswith(".py") or os.sep in module_name:
        hint = module_name.removesuffix(".py").replace(os.sep, ".").strip(".")
        raise ValueError(f"MODULE must be a module's name, not a file's; got {module_name!r} (try {hint}:{path})")
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
