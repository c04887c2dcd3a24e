"""Functions as estimators: ``(problem, policy)`` or ``(problem, policy, seed)`` to a
float or an ``Estimate``.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular.estimators.base import Estimate
from oee_tabular.estimators.problem import Problem
from oee_tabular.exceptions import AnswerError, ArgumentError
from oee_tabular.typing import PolicyLike, Seed

# the diagnostic by which an Estimate says that the function's answer was a bare number
RETURNED = "returned"
FORMS = (
    "a function (problem, policy) or (problem, policy, seed), an estimator, or a class"
    " or function that makes one"
)


@dataclass(frozen=True, eq=False)
class FunctionEstimator:
    """Somebody's callable as an estimator of the package's protocol.

    Attributes
    ----------
    function : the callable
    takes_seed : whether it has a parameter ``seed``
    """

    function: Any
    takes_seed: bool

    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """The function's answer as an ``Estimate``; AnswerError where it is neither a
        number nor an ``Estimate``.
        """
        answer = self.function(
            problem, policy, **({"seed": seed} if self.takes_seed else {})
        )
        if is_number(answer):
            return Estimate(float(answer), diagnostics={RETURNED: "float"})
        if isinstance(answer, Estimate):
            return answer
        kind = type(answer).__name__
        hint = (
            ": Estimate(value, standard_error) holds both"
            if isinstance(answer, tuple)
            else ""
        )
        raise AnswerError(
            f"an estimator must return a float or an Estimate; it returned {kind}{hint}"
        )


def as_estimator(given: object, name: str = "estimator") -> FunctionEstimator:
    """An estimator from a function, from another callable, or from a class or function
    that makes one without arguments.

    Parameters
    ----------
    given : callable (problem, policy) or (problem, policy, seed) -> float or
        ``Estimate``; seed is passed by its name
    name : what errors call it

    Raises
    ------
    ValueError
        An object that cannot be called, or has another signature; a class that cannot
        be made without arguments.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> def mean_reward(problem, policy):
    ...     return problem.log.reward.mean()
    >>> as_estimator(mean_reward)(pair.problem(50, seed=0), pair.policy, seed=0)
    Estimate(2.66061)
    >>> as_estimator(lambda log: 1.0)
    Traceback (most recent call last):
    ValueError: estimator must be callable as (problem, policy) or (problem, policy, seed); it takes (log)
    """
    if not callable(given):
        raise ArgumentError(name, f"must be {FORMS}; got {type(given).__name__}")
    made: Any = given
    if isinstance(given, type) or (
        _accepts(given) and not _accepts(given, None, None, seed=None)
    ):
        try:
            made = given()
        except Exception as error:
            text = (
                f"{name} must make an estimator without arguments; it raises"
                f" {type(error).__name__}: {error}"
            )
            raise ValueError(text) from error
        if not callable(made):
            raise ArgumentError(
                name, f"must make {FORMS}; it makes {type(made).__name__}"
            )
    takes_seed = _accepts(made, None, None, seed=None)
    if not takes_seed and not _accepts(made, None, None):
        signature = inspect.signature(made)
        raise ArgumentError(
            name,
            "must be callable as (problem, policy) or (problem, policy, seed); it"
            f" takes {signature}",
        )
    return FunctionEstimator(made, takes_seed)


def is_number(value: object) -> bool:
    """A Python or numpy real number (no boolean)."""
    return isinstance(value, float | int | np.floating | np.integer) and not isinstance(
        value, bool
    )


def _accepts(function: Any, *arguments: object, **options: object) -> bool:
    """Whether a call with these arguments is possible; a callable that does not tell
    its parameters takes the protocol's.
    """
    try:
        inspect.signature(function).bind(*arguments, **options)
    except TypeError:
        return False
    except ValueError:
        return bool(arguments)
    return True
