"""Answers to the exercises of the notebooks.

``check("05_b", answer)`` looks at exercise b of notebook 05.
"""

import tomllib
from contextlib import suppress
from importlib import resources
from typing import Any

import numpy as np

from oee_tabular.exceptions import ArgumentError

__all__ = ["check"]

RELATIVE_TOLERANCE = 0.005


def check(exercise: str, answer: Any) -> None:
    """Print whether an answer is right, or that there is none yet.

    Parameters
    ----------
    exercise : str
        The notebook's number and the exercise's letter, as in "05_b".
    answer : float, list of float, bool, or None
        Your answer; None if there is none yet.

    Raises
    ------
    AssertionError
        If the answer is wrong; the message has a hint.
    ValueError
        If there is no such exercise.

    Examples
    --------
    >>> check("00_a", 0.99**13)
    Right.
    """
    text = (
        resources.files("oee_tabular.testing")
        .joinpath("exercises.toml")
        .read_text(encoding="utf-8")
    )
    exercises: dict[str, dict[str, Any]] = tomllib.loads(text)
    if exercise not in exercises:
        raise ArgumentError(
            "exercise", f"must be one of {', '.join(exercises)}; it is {exercise!r}"
        )
    expected = exercises[exercise]["answer"]
    hint = exercises[exercise]["hint"]
    if answer is None:
        print(
            "Not answered yet: put your answer in place of None and run the cell again."
        )
        return
    if isinstance(expected, bool):
        kind = "True or False"
        has_kind = isinstance(answer, bool)
        is_right = answer is expected
    else:
        kind = (
            f"a list of {len(expected)} numbers"
            if isinstance(expected, list)
            else "one number"
        )
        numbers = np.empty(0, dtype=object)
        with suppress(ValueError):  # a ragged list
            numbers = np.asarray(answer)
        has_kind = numbers.dtype.kind in "iuf" and numbers.shape == np.shape(expected)
        allowed = exercises[exercise].get("tolerance", RELATIVE_TOLERANCE) * np.abs(
            expected
        )
        is_right = has_kind and bool(np.all(np.abs(numbers - expected) <= allowed))
    assert is_right, (
        f"{answer!r} is not right. Hint:"
        f" {'' if has_kind else f'the answer is {kind}; '}{hint}"
    )
    print("Right.")
