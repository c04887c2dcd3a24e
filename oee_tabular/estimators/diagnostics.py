"""The diagnostics of an estimate: each is declared once, with its type and its unit."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from textwrap import fill
from typing import (
    Any,
    Generic,
    Literal,
    Never,
    NoReturn,
    Self,
    TypeVar,
    final,
    overload,
)

import numpy as np

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError

# value: a discounted sum of rewards, or an error of one; share: in [0, 1]; ratio: of
# two probabilities, or of two occupancies; nats: of a logarithm of probabilities
Unit = Literal[
    "value",
    "share",
    "count",
    "ratio",
    "probability",
    "nats",
    "transitions",
    "standard errors",
    "text",
]
Number = TypeVar("Number", float, int, str)


class Diagnostic(Generic[Number]):
    """Declare one diagnostic: its type, its unit and its meaning.

    Parameters
    ----------
    kind : type
        The type of its values: float, int or str.
    unit : Unit
        The unit of its values.
    meaning : str
        One sentence, which is its documentation.
    """

    def __init__(self, kind: type[Number], unit: Unit, meaning: str) -> None:
        self.kind: type[Number] = kind
        self.unit = unit
        self.__doc__ = meaning

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def check(self, value: object) -> None:
        """Require a value to be of the declared kind."""
        if self.kind is str:
            is_one = isinstance(value, str)
        else:
            is_one = isinstance(value, float | int | np.integer | np.floating)
            is_one = is_one and not isinstance(value, np.timedelta64)
        if not is_one:
            what = "a text" if self.kind is str else "a number"
            raise ArgumentError(
                f"diagnostics[{self.name!r}]",
                f"must be {what}, or None; got {_checks.show(value)}",
            )

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...

    @overload
    def __get__(self, instance: Diagnostics, owner: type) -> Number | None: ...

    def __get__(self, instance: Diagnostics | None, owner: type) -> Self | Any:
        return self if instance is None else instance.get(self.name)


@final
class Diagnostics(dict[str, Any]):
    """The diagnostics of an estimate: a read-only dict whose known keys are declared.

    ``diagnostics["coverage"]`` and ``diagnostics.coverage`` are the same number; the
    attribute is typed, and None where the estimate has no such diagnostic. Keys that
    are not declared, which an estimator of your own may add, are kept: they have no
    attribute, and their unit is not known. The type of each attribute is followed by
    its unit, of which "value" is that of a discounted sum of rewards.

    Parameters
    ----------
    facts : mapping, or iterable of (key, value), optional
        The diagnostics, in the order in which they are shown.
    **more : float, int, str or None
        Further diagnostics, by keyword.

    Examples
    --------
    >>> diagnostics = Diagnostics(coverage=0.8, one_step_value=5.0, colour="red")
    >>> diagnostics, diagnostics["colour"], diagnostics.coverage, diagnostics.gap
    ({'coverage': 0.8, 'one_step_value': 5.0, 'colour': 'red'}, 'red', 0.8, None)
    >>> diagnostics.scaled(0.1)
    {'coverage': 0.8, 'one_step_value': 0.5, 'colour': 'red'}
    >>> Diagnostics.unit_of("one_step_value"), Diagnostics.unit_of("colour")
    ('value', None)
    """

    __slots__ = ()

    def __init__(
        self, facts: Mapping[str, Any] | Iterable[tuple[str, Any]] = (), /, **more: Any
    ) -> None:
        try:
            super().__init__(facts, **more)
        except (TypeError, ValueError, NotImplementedError):
            raise ArgumentError(
                "facts",
                "must be a mapping, or pairs of key and value; got"
                f" {_checks.show(facts)}",
            ) from None
        declared = vars(Diagnostics)
        for key, value in self.items():
            field = declared.get(key) if isinstance(key, str) else None
            if field is None and not isinstance(key, str):
                raise ArgumentError(
                    "diagnostics", f"must have texts for keys; got {_checks.show(key)}"
                )
            if isinstance(field, Diagnostic) and value is not None:
                field.check(value)

    def __repr__(self) -> str:
        """Return the text of the dict, whatever the values' own texts raise."""
        try:
            return super().__repr__()
        except Exception:
            return _checks.show(dict(self))

    # what the error and the interval are
    standard_error_of = Diagnostic(
        str,
        "text",
        "What the standard error covers: the log, the rollouts, or the simulator's"
        " samples. It is None where an exact value has no error yet.",
    )
    interval_method = Diagnostic(str, "text", "The method of the interval.")

    # values beside the estimate's own, and errors
    simulator_value = Diagnostic(
        float, "value", "The policy's exact value in the simulator."
    )
    model_value = Diagnostic(
        float, "value", "The policy's exact value in the corrected simulator zeta * P."
    )
    one_step_value = Diagnostic(
        float,
        "value",
        "The value of zeta * P with the first-order correction by the log.",
    )
    one_step_standard_error = Diagnostic(
        float,
        "value",
        "The standard error of the one-step value, unrecorded pairs included.",
    )
    one_step_distance = Diagnostic(
        float,
        "standard errors",
        "The distance from the value of zeta * P to the value that the log suggests,"
        " in standard errors of their difference.",
    )
    moved = Diagnostic(
        float,
        "share",
        "The share of the way from the value of zeta * P to the value that the log"
        " suggests by which the estimate was moved.",
    )
    maximum_likelihood_value = Diagnostic(
        float,
        "value",
        "The policy's value under the log's frequencies, with zeta * P in unrecorded"
        " pairs.",
    )
    standard_error_if_centre_fits = Diagnostic(
        float,
        "value",
        "A lower bound of the standard error: what it is if the prior of zeta is right.",
    )
    unrecorded_standard_error = Diagnostic(
        float,
        "value",
        "The part of the standard error that unrecorded pairs contribute.",
    )
    standard_error_of_the_log = Diagnostic(
        float,
        "value",
        "The part of the standard error that the log contributes, by refits to"
        " resampled logs.",
    )
    truncation_bias_bound = Diagnostic(
        float,
        "value",
        "A bound on what the missing rewards of truncated episodes can change.",
    )
    calibrated_value = Diagnostic(
        float, "value", "The value without the error of the discretisation."
    )
    calibrated_standard_error = Diagnostic(
        float,
        "value",
        "The standard error of the calibrated value; None where the value has none.",
    )
    calibration = Diagnostic(str, "text", "How the value was calibrated.")
    replaced_value = Diagnostic(
        float, "value", "The estimator's own value, which the log rules out."
    )
    replaced_by = Diagnostic(
        str, "text", "The end of the interval that takes the own value's place."
    )
    refused_value = Diagnostic(
        float,
        "value",
        "The own value, which no sum of the rewards can reach, or which is a guess.",
    )

    # how well the data cover the policy
    unrecorded = Diagnostic(
        str,
        "text",
        "Up to three unrecorded pairs in which the policy spends the most time.",
    )
    coverage = Diagnostic(
        float, "share", "The share of the policy's discounted time in recorded pairs."
    )
    unrecorded_share = Diagnostic(
        float, "share", "The share of the policy's discounted time in unrecorded pairs."
    )
    single_share = Diagnostic(
        float,
        "share",
        "The share of the policy's discounted time in pairs with one recorded"
        " transition, though several next states are possible.",
    )
    effective_sample_size = Diagnostic(
        float,
        "count",
        "The number of equally weighted samples with the same variance: episodes,"
        " rollouts, or transitions drawn from the policy's occupancy.",
    )
    n_episodes = Diagnostic(int, "count", "The number of the log's episodes.")
    n_rollouts = Diagnostic(int, "count", "The number of simulated episodes.")
    refits = Diagnostic(int, "count", "The number of refits to resampled logs.")
    rounding_error = Diagnostic(
        float,
        "value",
        "By how much the value is larger where commands are not rounded, in the"
        " simulator; the interval includes it.",
    )
    beyond_log = Diagnostic(
        float,
        "share",
        "The share of the policy's steps in states unlike those of the log.",
    )
    uncovered_mass = Diagnostic(
        float,
        "share",
        "The share of the log's transitions that are impossible in the plain"
        " simulator.",
    )

    # weights, and the ratio
    largest_weight = Diagnostic(
        float, "ratio", "The largest weight; of an exact value, the largest zeta."
    )
    mean_weight = Diagnostic(float, "ratio", "The mean weight, which should be near 1.")
    share_of_model = Diagnostic(
        float, "share", "The weight of the model alone in the blend of MAGIC."
    )
    row_sum_error = Diagnostic(
        float, "probability", "The largest distance from 1 of a row's sum in zeta * P."
    )
    strength = Diagnostic(
        float,
        "transitions",
        "The strength of the prior of zeta, as a number of transitions a row.",
    )
    meaning = Diagnostic(str, "text", "What the strength of the prior means.")
    n_keys = Diagnostic(
        int, "count", "The number of keys that share one ratio each, in a tied zeta."
    )
    explained = Diagnostic(
        str, "text", "The share of each coordinate's residual that was learned."
    )
    largest_zeta = Diagnostic(
        float, "ratio", "The largest zeta on the cells of a continuous task."
    )
    d_inf = Diagnostic(
        float,
        "nats",
        "The largest logarithm of zeta on the cells of a continuous task.",
    )

    # the computation
    method = Diagnostic(str, "text", "The method of the linear solver.")
    error_bound = Diagnostic(
        float,
        "value",
        "A bound on the rounding of the value: of the linear solve, or of a horizon's"
        " recursion.",
    )
    gap = Diagnostic(
        float, "nats", "The duality gap of the convex program that gave the ratio."
    )
    residual = Diagnostic(
        float, "ratio", "The largest residual of DualDICE's optimality conditions."
    )
    returned = Diagnostic(
        str, "text", "The type of a function's answer that was no ``Estimate``."
    )

    @classmethod
    def declared(cls) -> dict[str, Diagnostic[Any]]:
        """Return the declaration of each known diagnostic, by its key.

        Returns
        -------
        dict of str to Diagnostic
            Each has ``kind`` (its type), ``unit`` and ``__doc__`` (its meaning).
        """
        return {
            name: field
            for name, field in vars(cls).items()
            if isinstance(field, Diagnostic)
        }

    @classmethod
    def unit_of(cls, key: str) -> Unit | None:
        """Return the unit of a diagnostic.

        Parameters
        ----------
        key : str
            The key of the diagnostic.

        Returns
        -------
        str or None
            The unit; None for a key that is not declared.
        """
        field = vars(cls).get(_checks.instance(key, str, "key", "text"))
        return field.unit if isinstance(field, Diagnostic) else None

    def scaled(self, factor: float) -> Diagnostics:
        """Multiply the diagnostics whose unit is that of the value.

        Parameters
        ----------
        factor : float
            The factor; 1 - discount for a normalised report.

        Returns
        -------
        Diagnostics
            The same diagnostics in the same order, in the unit of the scaled value.
        """
        _checks.number_in(factor, "factor", -np.inf, np.inf)
        return Diagnostics(
            (key, x * factor if self._is_value(key, x) else x)
            for key, x in self.items()
        )

    def _is_value(self, key: str, x: object) -> bool:
        """Return whether a diagnostic is a number in the unit of the value."""
        is_number = isinstance(x, int | float | np.number)
        return is_number and self.unit_of(key) == "value"

    # The methods that would change the dict. ``Never`` lets type checkers refuse each
    # call; NoReturn would tell them that what follows is not reached.
    def __setitem__(self, key: Never, value: Never, /) -> None:  # type: ignore[override]
        _refuse_change()

    def __delitem__(self, key: Never, /) -> None:  # type: ignore[override]
        _refuse_change()

    def __ior__(self, other: Never, /) -> Self:  # type: ignore[override, misc]
        return _refuse_change()

    def clear(self) -> None:
        """Refuse to be changed."""
        _refuse_change()

    def pop(self, *args: Never) -> None:  # type: ignore[override]
        """Refuse to be changed.

        Parameters
        ----------
        *args : Never
            Nothing is taken.
        """
        _refuse_change()

    def popitem(self) -> NoReturn:
        """Refuse to be changed."""
        _refuse_change()

    def setdefault(self, *args: Never) -> None:  # type: ignore[override]
        """Refuse to be changed.

        Parameters
        ----------
        *args : Never
            Nothing is taken.
        """
        _refuse_change()

    def update(self, *args: Never, **kwargs: Never) -> None:  # type: ignore[override]
        """Refuse to be changed.

        Parameters
        ----------
        *args : Never
            Nothing is taken.
        **kwargs : Never
            Nothing is taken.
        """
        _refuse_change()

    def __reduce__(self) -> tuple[type[Diagnostics], tuple[dict[str, Any]]]:
        """Return what pickles rebuild it from: a dict, since items cannot be set."""
        return Diagnostics, (dict(self),)


def _refuse_change() -> NoReturn:
    """Refuse a change: the diagnostics are part of a frozen result."""
    raise TypeError(
        "the diagnostics of an estimate are read-only; dict(diagnostics) is a copy"
        " that can be changed"
    )


def _describe_fields() -> str:
    """Write the section of the class docstring that lists the declared diagnostics."""
    margin = "    "
    lines = ["Attributes", "----------"]
    for name, field in Diagnostics.declared().items():
        text = field.__doc__ or ""
        lines.append(f"{name} : {field.kind.__name__}, {field.unit}")
        lines.append(fill(text, 84, initial_indent=margin, subsequent_indent=margin))
    return "\n".join(lines)


# the list is made from the declarations, so that it cannot differ from them; without
# docstrings (python -OO) there is nothing to add it to
if Diagnostics.__doc__ is not None:
    # Python 3.13 keeps docstrings without their indentation; earlier ones with it
    Diagnostics.__doc__ = inspect.cleandoc(Diagnostics.__doc__).replace(
        "Examples\n--------", f"{_describe_fields()}\n\nExamples\n--------", 1
    )


class DiagnosticsField:
    """Store a mapping that is assigned to a field of a dataclass as ``Diagnostics``."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> tuple[()]: ...

    @overload
    def __get__(self, instance: object, owner: type) -> Diagnostics: ...

    def __get__(self, instance: object | None, owner: type) -> Any:
        # the class's own attribute is the default, and may be no dict, which is mutable
        if instance is None:
            return ()
        stored = vars(instance)[self.name]
        if type(stored) is dict:  # in a pickle that was written before there were units
            stored = vars(instance)[self.name] = Diagnostics(stored)
        return stored

    def __set__(self, instance: object, value: Mapping[str, Any] | tuple[()]) -> None:
        # anything else stays what it is: ``testing.check_estimator`` reports it
        if isinstance(value, Mapping | tuple):
            try:
                value = Diagnostics(value)
            except ArgumentError as error:
                if error.argument != "facts":
                    raise
                raise ArgumentError(self.name, error.rule) from None
        vars(instance)[self.name] = value
