"""Functions as estimators, from problem and policy to a float or an ``Estimate``."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.problem import Problem
from oee_tabular.exceptions import AnswerError, ArgumentError
from oee_tabular.typing import PolicyLike, Seed

# the diagnostic that is set where the function's answer was a bare number
RETURNED = "returned"
FORMS = (
    "a function (problem, policy) or (problem, policy, seed), an estimator, or a class"
    " or function that makes one"
)


@dataclass(frozen=True, eq=False)
class FunctionEstimator:
    """A callable as an estimator of the package's protocol.

    Attributes
    ----------
    function : callable
        The callable (problem, policy) or (problem, policy, seed).
    takes_seed : bool
        Whether it has a parameter ``seed``.
    """

    function: Any
    takes_seed: bool

    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """Return the function's answer as an ``Estimate``.

        An answer that is neither a number nor an ``Estimate`` is an ``AnswerError``.
        """
        options = {"seed": seed} if self.takes_seed else {}
        answer = self.function(problem, policy, **options)
        if is_number(answer):
            return Estimate(float(answer), diagnostics={RETURNED: "float"})
        if isinstance(answer, Estimate):
            return answer
        kind = type(answer).__name__
        hint = ""
        if isinstance(answer, tuple):
            hint = ": Estimate(value, standard_error) holds both"
        raise AnswerError(
            f"an estimator must return a float or an Estimate; it returned {kind}{hint}"
        )


def as_estimator(given: object, name: str = "estimator") -> FunctionEstimator:
    """Make an estimator of a callable.

    Parameters
    ----------
    given : callable
        A function or estimator (problem, policy) or (problem, policy, seed) that
        returns a float or an ``Estimate``, where seed is passed by its name; or a class
        or function that makes one without arguments.
    name : str, default 'estimator'
        The name of the argument in errors.

    Returns
    -------
    FunctionEstimator
        The estimator.

    Raises
    ------
    ValueError
        If the object cannot be called or has another signature, or if the class cannot
        be made without arguments.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> def mean_reward(problem, policy):
    ...     return problem.log.reward.mean()
    >>> as_estimator(mean_reward)(pair.problem(50, seed=0), pair.policy, seed=0)
    Estimate(2.66061)
    >>> as_estimator(lambda log: 1.0)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    oee_tabular.exceptions.ArgumentError: estimator must be callable as (problem, policy) ...
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
    """Return whether a value is a Python or numpy real number, and no boolean."""
    return _checks.is_integer(value) or isinstance(value, float | np.floating)


def _accepts(function: Any, *arguments: object, **options: object) -> bool:
    """Return whether a call with these arguments is possible.

    A callable that does not tell its parameters is taken to have the protocol's.
    """
    try:
        inspect.signature(function).bind(*arguments, **options)
    except TypeError:
        return False
    except ValueError:
        return bool(arguments)
    return True
