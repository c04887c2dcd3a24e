"""Errors and warnings of the package, to be caught or filtered by class.

Every error is also a ``ValueError`` or a ``RuntimeError``, and every warning is also a
``UserWarning``: code that knows only Python's own classes keeps working.

>>> import warnings
>>> import oee_tabular as oee
>>> from oee_tabular.exceptions import ArgumentError, OeeWarning
>>> try:
...     oee.tasks.gridworld(4, slip=1.5)
... except ArgumentError as error:
...     print(error.argument, "|", error.rule)
slip | must be in [0, 1]; it is 1.5
>>> with warnings.catch_warnings():
...     warnings.simplefilter("ignore", OeeWarning)  # what the package itself warns of
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

__all__ = [
    "AnswerError",
    "ArgumentError",
    "CostWarning",
    "DataWarning",
    "DiscretizationWarning",
    "DivergentKernelError",
    "NoCellsError",
    "NumericalWarning",
    "OeeWarning",
    "OutputWarning",
    "SimulatorWarning",
    "SolverStatusError",
    "UnknownKeywordError",
]


MAX_NAME_CHARACTERS = 300  # of an argument in a message


def _rebuild(
    kind: type[BaseException], args: tuple[Any, ...], fields: dict[str, Any]
) -> BaseException:
    """Make an error of its parts, whatever the constructor of its class takes."""
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(fields)
    return error


def _text(value: object) -> str:
    """Return a part of a message; of what is no text the name of its class.

    The text of a user's object may raise, and that of a damaged sparse matrix may end
    the process.
    """
    return value if isinstance(value, str) else f"<{type(value).__name__}>"


def _shorten(name: str) -> str:
    """Return a name without its middle where it is longer than anyone reads."""
    if len(name) <= MAX_NAME_CHARACTERS:
        return name
    return f"{name[:200]}...{name[-97:]}"


class ArgumentError(ValueError):
    """Report an argument that breaks a rule: ``str(error)`` is "argument rule".

    Parameters
    ----------
    argument : str
        The argument as the caller wrote it, with the place where it has one:
        ``"discount"``, ``"transitions[3, 1]"``.
    rule : str
        The rest of the sentence: the rule, and the value that breaks it.

    Attributes
    ----------
    argument : str
        The argument, with its place.
    rule : str
        The rule and the value found.

    Examples
    --------
    >>> error = ArgumentError("discount", "must be in [0, 1]; got 2.0")
    >>> str(error), error.argument
    ('discount must be in [0, 1]; got 2.0', 'discount')
    """

    def __init__(self, argument: str, rule: str) -> None:
        super().__init__(f"{_shorten(_text(argument))} {_text(rule)}")
        self.argument = argument
        self.rule = rule

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self.args, self.__dict__)


class UnknownKeywordError(TypeError):
    """Report a keyword that a function does not have, and the one that is nearest.

    Parameters
    ----------
    function : str
        The name of the function or class that was called.
    keyword : str
        The unknown keyword.
    nearest : str or None
        The known keyword that resembles it most; None if none does.
    known : sequence of str
        All keywords of the function, which the message lists if none is near.

    Attributes
    ----------
    function : str
        The name of the function or class that was called.
    keyword : str
        The unknown keyword.
    nearest : str or None
        The known keyword that resembles it most; None if none does.

    Examples
    --------
    >>> error = UnknownKeywordError("evaluate", "sed", "seed", ["seed"])
    >>> str(error)
    "evaluate() got an unexpected keyword argument 'sed'. Did you mean 'seed'?"
    """

    def __init__(
        self, function: str, keyword: str, nearest: str | None, known: Sequence[str]
    ) -> None:
        try:
            hint = f"It takes {', '.join(known)}." if len(known) else "It takes none."
        except (TypeError, MemoryError):  # these are no names
            hint = ""
        if nearest is not None:
            hint = f"Did you mean {_text(nearest)!r}?"
        super().__init__(
            f"{_text(function)}() got an unexpected keyword argument"
            f" {_text(keyword)!r}. {hint}"
        )
        self.function = function
        self.keyword = keyword
        self.nearest = nearest

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self.args, self.__dict__)


class DivergentKernelError(ValueError):
    """Report a kernel gamma K whose spectral radius is 1 or more.

    The infinite discounted sum over powers of gamma K does not exist then. It happens
    at discount 1 where a policy need not end, and for weighted kernels.
    """


class SolverStatusError(RuntimeError):
    """Report a convex solver that did not end at an optimal point.

    The numbers of such a solve are not handed on.
    """


class AnswerError(ValueError):
    """Report an estimator's answer that is neither a number nor an ``Estimate``."""


class NoCellsError(ValueError):
    """Report cells of a continuous task that cannot take the log.

    Its text is the sentence that a report prints in place of the rows on the cells.
    """


class OeeWarning(UserWarning):
    """Stand for every warning of this package, as the base of the others."""


class DataWarning(OeeWarning):
    """Warn of rows or columns of a log that are left out, moved or read otherwise."""


class SimulatorWarning(OeeWarning):
    """Warn of a simulator that was recorded or sampled incompletely."""


class DiscretizationWarning(OeeWarning):
    """Warn of what a continuous task loses when it is cut into cells."""


class NumericalWarning(OeeWarning, RuntimeWarning):
    """Warn of a result that is beyond floats, inaccurate, or not determined."""


class CostWarning(OeeWarning):
    """Warn of a call that will take long, or that is shortened without loss."""


class OutputWarning(OeeWarning):
    """Warn of a part of the output that is left out, such as a picture."""
