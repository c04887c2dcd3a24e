"""Answers to the exercises of the notebooks: ``check("05_b", answer)`` is exercise b of notebook 05."""

import tomllib
from importlib import resources
from typing import Any

import numpy as np

__all__ = ["check"]

TOLERANCE = 0.005  # relative


def check(exercise: str, answer: Any) -> None:
    """Print whether an answer is right, or that there is none yet.

    Parameters
    ----------
    exercise : the notebook's number and the exercise's letter, as in "05_b"
    answer : a number, a list of numbers, or True or False; None if there is no answer yet

    Raises
    ------
    AssertionError
        The answer is wrong; the message has a hint.

    Examples
    --------
    >>> check("00_a", 0.99**13)
    Right.
    """
    with resources.files("oee_tabular.testing").joinpath("exercises.toml").open("rb") as file:
        exercises: dict[str, dict[str, Any]] = tomllib.load(file)
    if exercise not in exercises:
        raise ValueError(f"exercise must be one of {', '.join(exercises)}; it is {exercise!r}")
    expected = exercises[exercise]["answer"]
    tolerance = exercises[exercise].get("tolerance", TOLERANCE)
    if answer is None:
        print("Not answered yet: put your answer in place of None and run the cell again.")
        return
    if isinstance(expected, bool):
        kind, is_right = "True or False", answer is expected
        has_kind = isinstance(answer, bool)
    else:
        kind = f"a list of {len(expected)} numbers" if isinstance(expected, list) else "one number"
        has_kind = _is_numeric(answer, np.shape(expected))
        is_right = has_kind and bool(np.all(np.abs(np.subtract(answer, expected)) <= tolerance * np.abs(expected)))
    hint = exercises[exercise]["hint"] if has_kind else f"the answer is {kind}; {exercises[exercise]['hint']}"
    assert is_right, f"{answer!r} is not right. Hint: {hint}"
    print("Right.")


def _is_numeric(answer: Any, shape: tuple[int, ...]) -> bool:
    try:
        numbers = np.asarray(answer)
    except ValueError:  # a ragged list
        return False
    return numbers.dtype.kind in "iuf" and numbers.shape == shape
