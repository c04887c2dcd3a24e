"""The judge of code exercises: it calls a function on drawn cases and explains a refusal.

A ``Task`` has the right answer by the package, and the mistakes that are often made,
each as a function of the same arguments with its hint. A wrong answer that equals one
of them gets that hint. Its cases are of several kinds: the first kind is plain, and each
other has something that separates right answers from wrong ones, and a hint for answers
that are wrong only there.
"""

from __future__ import annotations

import contextlib
import copy
import dis
import inspect
import io
import math
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from numbers import Real
from types import CodeType, FunctionType, GeneratorType, ModuleType
from typing import Any, NoReturn
from unittest import mock

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import is_sparse
from oee_tabular.testing.assignments.differences import (
    explain_pattern,
    is_between,
    say_difference,
)
from oee_tabular.typing import Array, BoolArray

CLOSE = 1e-3  # of the largest right entry
# that an answer must share with a mistake: plain ones for a number, any for a word
N_PLAIN_CASES = 3
N_PLAIN_CASES_OF_A_WORD = 12
N_CASES_OF_A_WORD = 40
# what is in memory where an answer writes nothing; no result has it
UNSET = -6.02214076e200
N_MARKED = 8  # arrays of a size, of which numpy keeps as many to give them out again
MAX_AXES = 64  # that an array of numpy may have
# to what numpy says most often in a student's function
NUMPY_REMEDIES = {
    "could not be broadcast": (
        "a sum over an axis loses this axis; keepdims=True keeps it"
    ),
    "Cannot cast ufunc": (
        "an array of whole numbers cannot hold the result; make it one of floats, as"
        " np.zeros(shape) does, or x.astype(float)"
    ),
}
LOADS = ("LOAD_GLOBAL", "LOAD_NAME", "IMPORT_NAME")

Arguments = dict[str, Any]


class RefusedAnswer(AssertionError):
    """Report an answer that is not right; the text says why, with a hint.

    A notebook shows the text alone, without the lines of the package.
    """

    def _render_traceback_(self) -> list[str]:
        """Return what IPython prints in place of a traceback."""
        return [f"{type(self).__name__}: {self}"]


@dataclass(frozen=True)
class Mistake:
    """A mistake that is often made: what it computes, and the hint that it gets."""

    function: Callable[..., Any]
    hint: str


@dataclass(frozen=True)
class Kind:
    """A kind of case.

    Attributes
    ----------
    about : str
        What is special in it, after the word "where"; empty in a plain case.
    draw : callable
        The function of a generator that draws the arguments.
    hint : str
        The hint for an answer that is right in plain cases and wrong here.
    at : callable or None
        The function of the arguments that returns which entries the hint is about; it
        is given only to answers that are wrong there. None: about all of them.
    """

    about: str
    draw: Callable[[np.random.Generator], Arguments]
    hint: str = ""
    at: Callable[..., BoolArray] | None = None


@dataclass(frozen=True)
class Task:
    """A code exercise.

    Attributes
    ----------
    name : str
        The assignment's number and a word, as in "1_risk".
    call : str
        How the answer is called, as in "risk(g, p, q)".
    kinds : tuple of Kind
        The kinds of cases, a plain one first; case k is of kind k modulo their number.
    solve : callable
        The function of the arguments that returns the right answer.
    hint : str
        The hint where no mistake is recognised.
    mistakes : tuple of Mistake
        The mistakes that are recognised.
    axes : tuple of str
        What each axis of the answer counts, as in ("state", "action").
    choices : tuple of str
        The texts that may be returned, where the answer is a text.
    tolerance : float
        The allowed error, relative to the largest right entry or to 1.
    is_entrywise : bool
        Whether the error is relative to each entry, and not to the largest.
    bounds : callable or None
        The function of the arguments that returns the least and the largest right
        answer, where several are right.
    judge : callable or None
        The function (task, answer, arguments) that replaces the comparison; it returns
        why the answer is refused, or "".
    explain : callable or None
        The function of the arguments that returns a sentence on why the right answer is
        right, where that is True, False or a word.
    """

    name: str
    call: str
    kinds: tuple[Kind, ...]
    solve: Callable[..., Any]
    hint: str
    mistakes: tuple[Mistake, ...] = ()
    axes: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()
    tolerance: float = 1e-7
    is_entrywise: bool = False
    bounds: Callable[..., tuple[Array, Array]] | None = None
    judge: Callable[[Task, Any, Arguments], str] | None = None
    explain: Callable[..., str] | None = None

    @property
    def function(self) -> str:
        """Return the name of the function that is asked for."""
        return self.call.partition("(")[0]

    @property
    def parameters(self) -> str:
        """Return the parameters that it is called with."""
        return self.call.partition("(")[2].removesuffix(")")

    def kind_of(self, case: int) -> Kind:
        """Return the kind of a case."""
        return self.kinds[case % len(self.kinds)]

    def draw_case(self, case: int) -> Arguments:
        """Draw the arguments of a case."""
        rng = np.random.default_rng([zlib.crc32(self.name.encode()), case])
        return self.kind_of(case).draw(rng)

    def judge_case(self, answer: Any, case: int) -> None:
        """Refuse an answer that is wrong in a case."""
        arguments = self.draw_case(case)
        kind = self.kind_of(case)
        where = f"in case {case}" + (f", where {kind.about}" if kind.about else "")
        try:
            with silence():
                why = (
                    self.judge(self, answer, arguments)
                    if self.judge
                    else self._compare(answer, arguments, kind)
                )
        except RefusedAnswer as refusal:
            # what is no result in the first case either needs no place
            if not kind.about or not self._has_result(answer, range(1)):
                raise
            said = f"{refusal} This happens {where}"
            if not self._has_result(answer, range(0, 100, len(self.kinds))):
                said += self._compare_sizes(arguments)
            elif kind.hint:
                said += f": {kind.hint}"
            else:
                said += "."
            raise RefusedAnswer(said) from None
        if why:
            raise RefusedAnswer(
                f"{self.function} is not right {where}: {why} Its arguments:"
                f' draw_case("{self.name}", {case}).'
            )

    def _solve(self, arguments: Arguments) -> Any:
        """Return the right answer."""
        return self.solve(*copy.deepcopy(arguments).values())

    def _is_right(self, found: Any, right: Any, arguments: Arguments) -> bool:
        """Return whether an answer is right, or near enough."""
        if isinstance(right, bool | str):
            return bool(found == right)
        if self.bounds:
            low, high = self.bounds(*copy.deepcopy(arguments).values())
        else:
            low, high = right, right
        return bool(np.all(self._is_between(found, low, high)))

    def _is_between(self, found: Any, low: Any, high: Any) -> BoolArray:
        """Return which entries lie between two others, by the task's tolerance."""
        return is_between(
            found, low, high, self.tolerance, is_entrywise=self.is_entrywise
        )

    def _compare(self, answer: Any, arguments: Arguments, kind: Kind) -> str:
        """Return why the answer's result is wrong, or an empty text."""
        right = self._solve(arguments)
        found = self.read(ask(self, answer, arguments), right)
        if self._is_right(found, right, arguments):
            return ""
        if isinstance(right, bool | str):
            said = f"it returns {found!r}, and {right!r} is right."
        else:
            right = np.asarray(right, dtype=float)
            is_wrong = ~self._is_between(found, right, right)
            said = say_difference(found, right, is_wrong, self.axes, arguments)
        numbers = [value for value in arguments.values() if np.ndim(value) == 0]
        if len(numbers) == len(arguments):
            given = ", ".join(f"{name} = {x:.6g}" for name, x in arguments.items())
            said = f"for {given} {said}"
        if self.explain:
            said += f" {self.explain(*copy.deepcopy(arguments).values())}"
        return (
            f"{said} Hint: {self._choose_hint(answer, found, right, arguments, kind)}"
        )

    def _choose_hint(
        self, answer: Any, found: Any, right: Any, arguments: Arguments, kind: Kind
    ) -> str:
        """Return the hint that fits best: of a mistake, of the kind, or of the task."""
        is_huge = self._is_huge_alone(found, right)
        for mistake in self.mistakes:
            if not is_huge and self._is_recognised(
                answer, mistake, found, right, arguments
            ):
                return mistake.hint
        hint = self.hint
        if self._is_of_the_kind(answer, found, right, arguments, kind):
            hint = kind.hint
        if is_huge:
            return (
                "a division by 0 gives inf, and numpy.nan_to_num makes 1.8e308 of it; say"
                f" what holds there: {hint}"
            )
        if isinstance(right, bool | str):
            return hint
        if np.any(found == UNSET):
            return (
                "entries were never written: np.empty, and np.divide with where= and"
                " without out=, leave what was in memory. Begin with np.zeros;"
                f" {hint}"
            )
        is_lost = ~np.isfinite(found) & np.isfinite(right)
        if is_lost.any() and np.all(is_lost | self._is_between(found, right, right)):
            return (
                "nan and inf come from a division by 0 or from the logarithm of 0; say"
                f" what holds there: {hint}"
            )
        if hint is kind.hint:
            return hint
        pattern = explain_pattern(
            found, right, arguments, is_entrywise=self.is_entrywise
        )
        if pattern:
            return f"{pattern}; {hint}"
        if np.all(is_between(found, right, right, CLOSE, floor=0.0)):
            return (
                "this is close and not exact: something small is added, cut off or"
                f" rounded, or an iteration stops too early; {hint}"
            )
        return hint

    def _is_huge_alone(self, found: Any, right: Any) -> bool:
        """Return whether an answer is right but where it is the largest of floats."""
        if isinstance(right, bool | str):
            return False
        is_huge = (np.abs(found) == np.finfo(np.float64).max) & np.isfinite(right)
        return bool(
            np.any(is_huge) and np.all(is_huge | self._is_between(found, right, right))
        )

    def _is_of_the_kind(
        self, answer: Any, found: Any, right: Any, arguments: Arguments, kind: Kind
    ) -> bool:
        """Return whether an answer is wrong only by what is special in a kind."""
        if not kind.hint:
            return False
        if kind.at is not None:
            at = kind.at(*copy.deepcopy(arguments).values())
            if not np.any(at & ~self._is_between(found, right, right)):
                return False
        return self._holds_in(answer, self._plain_cases(right), self._is_right)

    def _has_result(self, answer: Any, cases: range) -> bool:
        """Return whether an answer has a result of the right kind in some cases."""
        if self.judge:
            return True
        with silence():
            return self._holds_in(answer, cases, lambda *_: True)

    def _compare_sizes(self, arguments: Arguments) -> str:
        """Say whether the arguments have other sizes than those of the first case."""
        first = self.draw_case(0)
        for name, value in arguments.items():
            here, there = np.shape(value), np.shape(first[name])
            if here != there:
                return (
                    f". There {name} has the shape {here}, and {there} in case 0: take"
                    " sizes from the arguments."
                )
        return "."

    def _plain_cases(self, right: Any) -> range:
        """Return plain cases, more of them where an answer has one of few values."""
        n = N_PLAIN_CASES_OF_A_WORD if isinstance(right, bool | str) else N_PLAIN_CASES
        return range(0, n * len(self.kinds), len(self.kinds))

    def _holds_in(
        self,
        answer: Any,
        cases: range,
        condition: Callable[[Any, Any, Arguments], bool],
    ) -> bool:
        """Return whether something is so for an answer's results in some cases."""
        for case in cases:
            drawn = self.draw_case(case)
            right = self._solve(drawn)
            try:
                found = self.read(ask(self, answer, drawn), right)
            except RefusedAnswer:
                return False
            if not condition(found, right, drawn):
                return False
        return True

    def _is_recognised(
        self,
        answer: Any,
        mistake: Mistake,
        found: Any,
        right: Any,
        arguments: Arguments,
    ) -> bool:
        """Return whether an answer is a mistake, in this case and in others.

        One case is not enough: nan, True or a word come from many mistakes.
        """
        if not self._equals_mistake(found, right, mistake, arguments, is_wrong=True):
            return False

        def is_same(again: Any, right: Any, drawn: Arguments) -> bool:
            return self._equals_mistake(again, right, mistake, drawn, is_wrong=False)

        if isinstance(found, bool | str):
            return self._holds_in(answer, range(N_CASES_OF_A_WORD), is_same)
        return self._holds_in(answer, self._plain_cases(right), is_same)

    def _equals_mistake(
        self,
        found: Any,
        right: Any,
        mistake: Mistake,
        arguments: Arguments,
        *,
        is_wrong: bool,
    ) -> bool:
        """Return whether an answer is what a mistake computes.

        Entries where one of the two is nan or inf are left out, if others show the
        mistake: a wrong axis is the same mistake with 0 / 0 and without.
        """
        try:
            wrong = mistake.function(*copy.deepcopy(arguments).values())
        except Exception:  # the mistake is none here, as a logarithm of a negative
            return False
        if isinstance(found, bool | str):
            return bool(found == wrong)
        if np.shape(wrong) != np.shape(found):
            return False
        wrong = np.asarray(wrong, dtype=float)
        is_finite = np.isfinite(wrong) & np.isfinite(found)
        if not np.all(self._is_between(found, wrong, wrong) | ~is_finite):
            return False
        same = np.isnan(wrong) == np.isnan(found)
        same &= np.isinf(wrong) == np.isinf(found)
        is_shown = is_finite & ~self._is_between(found, right, right)
        return bool(same.all() or is_shown.any() or not is_wrong)

    def read(self, result: Any, right: Any) -> Any:
        """Return the result as the kind that the right answer has, or refuse it."""
        why = ""
        if isinstance(right, bool):
            kind = "True or False"
            is_array = isinstance(result, np.ndarray) and result.shape == ()
            if isinstance(result, bool | np.bool_) or (
                is_array and result.dtype == np.bool_
            ):
                return bool(result)
        elif isinstance(right, str):
            kind = " or ".join(repr(choice) for choice in self.choices)
            is_kind = isinstance(result, str) and result in self.choices
            if is_kind:
                return str(result)
        else:
            shape = np.shape(right)
            kind = f"an array of shape {shape}" if shape else "one number"
            if self.axes:
                kind += f" with one entry for each {' and '.join(self.axes)}"
            if (array := as_numbers(result)) is not None:
                if not shape and array.size == 1:
                    return array.reshape(())
                if array.shape == shape:
                    return array
                if len(shape) > 1 and sorted(array.shape) == sorted(shape):
                    why = ", the right sizes in another order"
        refuse(self, f"must return {kind}; it returns {describe(result)}{why}")


def refuse(task: Task, text: str) -> NoReturn:
    """Raise the refusal of an answer that has no value to compare."""
    raise RefusedAnswer(f"{task.function} {text}. Hint: {task.hint}") from None


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep warnings and the error stream silent.

    nbgrader gives no point to a cell that writes to the error stream.
    """
    with (
        warnings.catch_warnings(),
        np.errstate(all="ignore"),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        warnings.simplefilter("ignore")
        yield


def require_function(task: Task, answer: Any) -> None:
    """Refuse what is not a function of the task's parameters, written without us."""
    if answer is None or answer is ...:
        refuse(task, "is not answered yet; define the function and run the cell again")
    if not callable(answer):
        refuse(task, f"must be a function {task.call}; it is {describe(answer)}")
    try:
        signature = inspect.signature(answer)
    except Exception:  # a builtin, or a __signature__ that is none
        signature = None
    if signature:
        names = task.parameters.split(", ")
        try:
            signature.bind(*names)
        except TypeError:
            refuse(task, f"must take ({task.parameters}); it takes {signature}")
        theirs = list(signature.parameters)
        if theirs != names and sorted(theirs) == sorted(names):
            refuse(
                task,
                f"must take ({task.parameters}) in this order; it takes {signature}",
            )
    if name := borrowed_name(answer, set()):
        refuse(
            task,
            f"must be computed by your own code; it uses {name} of the package that it"
            " is compared with",
        )


def borrowed_name(function: Any, seen: set[int]) -> str:
    """Return a name of this package that a function uses, or an empty text.

    It reads names in the code of the function and of the functions that it calls. It is
    a reminder for students, and no lock.
    """
    function = inspect.unwrap(function) if callable(function) else function
    if not isinstance(function, FunctionType) or id(function) in seen:
        return ""
    seen.add(id(function))
    inside = dict(function.__globals__)
    for name, cell in zip(
        function.__code__.co_freevars, function.__closure__ or (), strict=True
    ):
        with contextlib.suppress(ValueError):  # a name that has no value yet
            inside[name] = cell.cell_contents
    for name in _names(function.__code__):
        if name.partition(".")[0] == "oee_tabular":
            return name
        value = inside.get(name)
        module = (
            value.__name__
            if isinstance(value, ModuleType)
            else getattr(value, "__module__", None)
        )
        if isinstance(module, str) and module.partition(".")[0] == "oee_tabular":
            return name
        if deeper := borrowed_name(value, seen):
            return deeper
    return ""


def _names(code: CodeType) -> list[str]:
    """Return the names in a code object and in the functions inside it."""
    names = [*code.co_freevars] + [
        str(step.argval)
        for step in dis.get_instructions(code)
        if step.opname in LOADS  # attributes are names as well, and mean nothing here
    ]
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names += _names(constant)
    return names


def ask(task: Task, answer: Any, arguments: Arguments) -> Any:
    """Call the answer with copies of the arguments, and refuse what goes wrong."""
    given = copy.deepcopy(arguments)
    try:
        with _marked_memory(arguments):
            result = answer(*given.values())
    except NotImplementedError:
        refuse(task, "is not answered yet; write its body and run the cell again")
    except (Exception, SystemExit) as error:
        text = _checks.first_line(error) or "no text"
        for words, remedy in NUMPY_REMEDIES.items():
            if words in text:
                text += f" ({remedy})"
        refuse(task, f"raises {type(error).__name__}{_line_of(error, answer)}: {text}")
    if result is None:
        refuse(
            task, "returns nothing; each way through it ends with return and a result"
        )
    for name, value in arguments.items():
        if isinstance(value, np.ndarray) and not np.array_equal(
            value, given[name], equal_nan=True
        ):
            refuse(task, f"changes its argument {name}; work on a copy of it")
    return result


@contextlib.contextmanager
def _marked_memory(arguments: Arguments) -> Iterator[None]:
    """Put a number where arrays without a content of their own take what is there.

    What ``np.empty`` returns is often 0, so that an answer that forgets an entry would
    seem right. ``np.divide`` with ``where`` takes memory that was given back: arrays of
    the sizes of the arguments' axes are.
    """
    sizes = {1}
    for value in arguments.values():
        shape = np.shape(value)
        for first in range(len(shape)):
            for last in range(first, len(shape)):
                sizes.add(math.prod(shape[first : last + 1]))
    kept = [np.full(size, UNSET) for size in sizes for _ in range(N_MARKED)]
    kept.clear()

    def marked(function: Callable[..., Any]) -> Callable[..., Any]:
        def empty(*given: Any, **named: Any) -> Any:
            array = function(*given, **named)
            if array.dtype == np.float64:
                array.fill(UNSET)
            return array

        return empty

    with mock.patch.multiple(
        np, empty=marked(np.empty), empty_like=marked(np.empty_like)
    ):
        yield


def _line_of(error: BaseException, answer: Any) -> str:
    """Return where in the answer's own file or cell an error was raised."""
    code = getattr(inspect.unwrap(answer), "__code__", None)
    place = ""
    at = error.__traceback__
    while at is not None:
        if code is not None and at.tb_frame.f_code.co_filename == code.co_filename:
            place = f" in line {at.tb_lineno}"
        at = at.tb_next
    return place


def describe(value: Any) -> str:
    """Name what a value is, for a sentence."""
    if value is None:
        return "nothing"
    if isinstance(value, str):
        return f"the text {_checks.show(value)}"
    if isinstance(value, bool | np.bool_):
        return f"{bool(value)}"
    if isinstance(value, complex | np.complexfloating):
        return f"the complex number {_checks.show(value)}"
    if isinstance(value, int | float | np.number):
        plain = value.item() if isinstance(value, np.number) else value
        return f"the number {_checks.show(plain)}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if callable(value):
        return "a function; call it, and return its result"
    if isinstance(value, GeneratorType):
        return "a generator, as a function with yield makes; return the result"
    if isinstance(value, dict):
        return "a dictionary"
    if has_masked(value):
        if isinstance(value, list | tuple):
            kind = "a list" if isinstance(value, list) else "a tuple"
        else:
            kind = f"an array of shape {np.shape(value)}"
        return f"{kind} with masked entries, which are no numbers"
    array = as_numbers(value)
    if array is not None:
        kind = "a tuple of numbers" if isinstance(value, tuple) else "numbers"
        return f"{kind} of shape {array.shape}"
    return _describe_entries(value)


# what an array that has no numbers holds, by the letter of its type
_ENTRIES = {
    "b": "True and False",
    "c": "complex numbers",
    "U": "texts",
    "S": "texts",
    "M": "dates",
    "m": "lengths of time",
    "V": "records",
}


def _describe_entries(value: Any) -> str:
    """Name a list or an array whose entries are no numbers, or another object."""
    if isinstance(value, list | tuple):
        name = "a list" if isinstance(value, list) else "a tuple"
        try:
            array = np.asarray(value)
        except Exception:
            return f"{name} whose parts differ in length or kind"
        is_text = [isinstance(part, str) for part in value]
        if array.dtype.kind == "U" and array.ndim == 1 and not all(is_text):
            return f"{name} of a text and other things"
    elif isinstance(value, np.ndarray):
        name, array = f"an array of shape {value.shape}", value
    else:
        return f"an object of the type {type(value).__name__}"
    if array.dtype.kind == "O":
        for entry in array.flat:
            if not _is_number(entry):
                return f"{name} of objects that are no numbers, as {_checks.show(entry)} is"
        return f"{name} of numbers that no float can hold"
    return f"{name} of {_ENTRIES.get(array.dtype.kind, 'no numbers')}"


def has_masked(value: Any, depth: int = 0) -> bool:
    """Return whether an array has masked entries, or a list such an array.

    Lists within lists are looked at as far as an array may have axes.
    """
    if isinstance(value, list | tuple):
        return depth < MAX_AXES and any(has_masked(part, depth + 1) for part in value)
    return bool(np.ma.is_masked(value))


def as_numbers(value: Any) -> Array | None:
    """Return real numbers as an array, and None for all else.

    Objects that are numbers, as some functions of numpy return them, are numbers; what
    a masked array has masked is none.
    """
    if has_masked(value):
        return None
    if is_sparse(value):
        value = value.toarray()
    is_plain = isinstance(value, Real | Decimal | list | tuple)
    if not is_plain and not hasattr(value, "__array__"):
        return None
    try:
        array = np.asarray(value)
    except Exception:  # a ragged list, or an object whose __array__ raises anything
        return None
    if array.dtype.kind == "O" and all(map(_is_number, array.flat)):
        try:
            return array.astype(float)
        except (OverflowError, ValueError):  # beyond all floats, or a signaling nan
            return None
    return array.astype(float) if array.dtype.kind in "iuf" else None


def _is_number(value: Any) -> bool:
    """Return whether an object is a real number, and not True or False."""
    kinds = Real | Decimal | np.integer | np.floating
    return isinstance(value, kinds) and not isinstance(value, bool)
