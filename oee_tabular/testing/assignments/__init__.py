"""Checks of the eight assignments: code exercises, judged by the package's own oracles.

``check("1_risk", risk)`` calls the function ``risk`` on drawn cases and compares it with
the right answers. A wrong answer is refused with a hint.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.testing.assignments import (
    bootstrap,
    decision,
    estimator_law,
    evaluation,
    importance_sampling,
    neyman_design,
    risk,
    true_ratio,
)
from oee_tabular.testing.assignments.judging import (
    RefusedAnswer,
    Task,
    require_function,
)

__all__ = ["TASKS", "RefusedAnswer", "check", "draw_case"]

ASSIGNMENTS = (
    risk,
    true_ratio,
    evaluation,
    importance_sampling,
    bootstrap,
    neyman_design,
    estimator_law,
    decision,
)
# the names of the exercises, with the call that each asks for
_TASKS: dict[str, Task] = {
    task.name: task for part in ASSIGNMENTS for task in part.TASKS
}
TASKS: dict[str, str] = {name: task.call for name, task in _TASKS.items()}
VISIBLE_CASES = range(10)  # of every kind one
MAX_CASE = 9999


@suggest_keywords
def check(exercise: str, answer: Any, *, cases: Iterable[int] = VISIBLE_CASES) -> None:
    """Print whether a function is right, or refuse it with a hint.

    Parameters
    ----------
    exercise : str
        The assignment's number and a word, as in "1_risk"; one of ``TASKS``.
    answer : callable
        Your function; ``TASKS[exercise]`` says how it is called.
    cases : iterable of int, default range(10)
        The numbers of the cases that it is tried on. Case 0 is a plain one; every ten
        cases have all that is special in an exercise, as zeros, tiny probabilities and
        a discount near 1.

    Raises
    ------
    RefusedAnswer
        If the answer is wrong or no function of that kind; the message has a hint. It
        is an ``AssertionError``.
    ValueError
        If there is no such exercise or no such case.

    See Also
    --------
    draw_case : Draw the arguments of one case.

    Examples
    --------
    >>> import numpy as np
    >>> def risk(g, p, q):
    ...     return q @ g - p[p > 0] @ np.log(g[p > 0])
    >>> check("1_risk", risk)
    Right, in 10 cases.
    """
    task = _task(exercise)
    numbers = _case_numbers(cases)
    require_function(task, answer)
    for case in numbers:
        task.judge_case(answer, case)
    print(f"Right, in {len(numbers)} case{'s' if len(numbers) > 1 else ''}.")


@suggest_keywords
def draw_case(exercise: str, case: int) -> dict[str, Any]:
    """Draw the arguments that ``check`` calls a function with in one case.

    Parameters
    ----------
    exercise : str
        The exercise, one of ``TASKS``.
    case : int
        The number of the case, from 0 on.

    Returns
    -------
    dict of str to object
        The arguments by their names; an estimator that is one of them is None.

    Raises
    ------
    ValueError
        If there is no such exercise or no such case.

    See Also
    --------
    check : Print whether a function is right.

    Examples
    --------
    >>> import numpy as np
    >>> arguments = draw_case("1_risk", 0)
    >>> list(arguments)
    ['g', 'p', 'q']

    Call your own function on them:

    >>> def risk(g, p, q):
    ...     return q @ g - p[p > 0] @ np.log(g[p > 0])
    >>> bool(risk(**arguments) > 0)
    True
    """
    task = _task(exercise)
    return task.draw_case(_case_number(case, "case"))


def _task(exercise: Any) -> Task:
    """Return the exercise of a name."""
    if not isinstance(exercise, str) or exercise not in _TASKS:
        raise ArgumentError(
            "exercise",
            f"must be one of {', '.join(_TASKS)}; it is {_checks.show(exercise)}",
        )
    return _TASKS[exercise]


def _case_numbers(cases: Any) -> list[int]:
    """Return the numbers of cases, checked."""
    has_items = isinstance(cases, Iterable) and getattr(cases, "ndim", 1) > 0
    if isinstance(cases, str) or not has_items:
        raise ArgumentError(
            "cases",
            f"must be numbers of cases, as in range(5); it is {_checks.show(cases)}",
        )
    numbers = [_case_number(case, f"cases[{k}]") for k, case in enumerate(cases)]
    if not numbers:
        raise ArgumentError("cases", "must have a case; it is empty")
    return numbers


def _case_number(case: Any, name: str) -> int:
    """Return the number of a case, checked."""
    if not _checks.is_integer(case) or not 0 <= case <= MAX_CASE:
        raise ArgumentError(
            name, f"must be an integer from 0 to {MAX_CASE}; it is {_checks.show(case)}"
        )
    return int(case)
