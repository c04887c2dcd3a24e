"""The judge of code exercises: it calls a function on drawn cases and explains a refusal.

A ``Task`` has the right answer by the package, and the mistakes that are often made,
each as a function of the same arguments with its hint. A wrong answer that equals one
of them gets that hint.
"""

from __future__ import annotations

import contextlib
import copy
import dis
import inspect
import io
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import CodeType, FunctionType, ModuleType
from typing import Any, NoReturn

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import is_sparse
from oee_tabular.typing import Array

FIRST_HARD_CASE = 10  # cases before it have no zeros, ends or other special values
CLOSE = 0.03  # of the largest right entry
# that an answer must share with a mistake, if it is a number or one of a few words
N_CASES_OF_A_NUMBER = 3
N_CASES_OF_A_WORD = 40
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
class Task:
    """A code exercise.

    Attributes
    ----------
    name : str
        The assignment's number and a word, as in "1_risk".
    call : str
        How the answer is called, as in "risk(g, p, q)".
    draw : callable
        The function (generator, whether the case is hard) that draws the arguments.
    solve : callable
        The function of the arguments that returns the right answer.
    hint : str
        The hint where no mistake is recognised.
    mistakes : tuple of Mistake
        The mistakes that are recognised.
    choices : tuple of str
        The texts that may be returned, where the answer is a text.
    tolerance : float
        The allowed error, relative to the largest right entry or to 1.
    bounds : callable or None
        The function of the arguments that returns the least and the largest right
        answer, where several are right.
    judge : callable or None
        The function (task, answer, arguments) that replaces the comparison; it returns
        why the answer is refused, or "".
    """

    name: str
    call: str
    draw: Callable[[np.random.Generator, bool], Arguments]
    solve: Callable[..., Any]
    hint: str
    mistakes: tuple[Mistake, ...] = ()
    choices: tuple[str, ...] = ()
    tolerance: float = 1e-7
    bounds: Callable[..., tuple[Array, Array]] | None = None
    judge: Callable[[Task, Any, Arguments], str] | None = None

    @property
    def function(self) -> str:
        """Return the name of the function that is asked for."""
        return self.call.partition("(")[0]

    @property
    def parameters(self) -> str:
        """Return the parameters that it is called with."""
        return self.call.partition("(")[2].removesuffix(")")

    def draw_case(self, case: int) -> Arguments:
        """Draw the arguments of a case."""
        rng = np.random.default_rng([zlib.crc32(self.name.encode()), case])
        return self.draw(rng, case >= FIRST_HARD_CASE)

    def judge_case(self, answer: Any, case: int) -> None:
        """Refuse an answer that is wrong in a case."""
        arguments = self.draw_case(case)
        with silence():
            why = (
                self.judge(self, answer, arguments)
                if self.judge
                else self._compare(answer, arguments)
            )
        if why:
            raise RefusedAnswer(f"{self.function} is not right in case {case}: {why}")

    def _compare(self, answer: Any, arguments: Arguments) -> str:
        """Return why the answer's result is wrong, or an empty text."""
        right = self.solve(*copy.deepcopy(arguments).values())
        found = self.read(ask(self, answer, arguments), right)
        low, high = (
            self.bounds(*copy.deepcopy(arguments).values())
            if self.bounds
            else (right, right)
        )
        if isinstance(right, bool | str):
            if found == right:
                return ""
            said = f"it returns {found!r}, and {right!r} is right."
        elif _is_between(found, low, high, self.tolerance):
            return ""
        else:
            said = _difference(found, np.asarray(right, dtype=float))
        for mistake in self.mistakes:
            if self._is_recognised(answer, mistake, found, arguments):
                return f"{said} Hint: {mistake.hint}"
        if not isinstance(right, bool | str):
            if not np.all(np.isfinite(found) | ~np.isfinite(right)):
                return (
                    f"{said} Hint: nan and inf come from a division by 0 or from the"
                    f" logarithm of 0; say what holds there: {self.hint}"
                )
            if _is_between(found, low, high, CLOSE, floor=0.0):
                return (
                    f"{said} Hint: this is close. An iteration stops too early, a sum"
                    f" ends too early, or something is rounded: {self.hint}"
                )
        return f"{said} Hint: {self.hint}"

    def _is_recognised(
        self, answer: Any, mistake: Mistake, found: Any, arguments: Arguments
    ) -> bool:
        """Return whether an answer is a mistake, in this case and in others.

        One case is not enough: nan, True or a word come from many mistakes.
        """
        if not self._equals_mistake(found, mistake, arguments):
            return False
        is_word = isinstance(found, bool | str)
        for case in range(N_CASES_OF_A_WORD if is_word else N_CASES_OF_A_NUMBER):
            drawn = self.draw_case(case)
            right = self.solve(*copy.deepcopy(drawn).values())
            try:
                again = self.read(ask(self, answer, drawn), right)
            except RefusedAnswer:
                return False
            if not self._equals_mistake(again, mistake, drawn):
                return False
        return True

    def _equals_mistake(
        self, found: Any, mistake: Mistake, arguments: Arguments
    ) -> bool:
        """Return whether an answer is what a mistake computes."""
        try:
            wrong = mistake.function(*copy.deepcopy(arguments).values())
        except Exception:  # the mistake is none here, as a logarithm of a negative
            return False
        if isinstance(found, bool | str):
            return bool(found == wrong)
        if np.shape(wrong) != np.shape(found):
            return False
        wrong = np.asarray(wrong, dtype=float)
        same = np.isnan(wrong) & np.isnan(found)
        wrong, found = np.where(same, 0.0, wrong), np.where(same, 0.0, found)
        return _is_between(found, wrong, wrong, self.tolerance)

    def read(self, result: Any, right: Any) -> Any:
        """Return the result as the kind that the right answer has, or refuse it."""
        if isinstance(right, bool):
            kind, is_kind = "True or False", isinstance(result, bool | np.bool_)
            if is_kind:
                return bool(result)
        elif isinstance(right, str):
            kind = " or ".join(repr(choice) for choice in self.choices)
            is_kind = isinstance(result, str) and result in self.choices
            if is_kind:
                return str(result)
        else:
            shape = np.shape(right)
            kind = f"an array of shape {shape}" if shape else "one number"
            if (array := _as_numbers(result)) is not None:
                if not shape and array.size == 1:
                    return array.reshape(())
                if array.shape == shape:
                    return array
        refuse(self, f"must return {kind}; it returns {describe(result)}")


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
        result = answer(*given.values())
    except NotImplementedError:
        refuse(task, "is not answered yet; write its body and run the cell again")
    except (Exception, SystemExit) as error:
        text = _checks.first_line(error) or "no text"
        refuse(task, f"raises {type(error).__name__}{_line_of(error, answer)}: {text}")
    if result is None:
        refuse(task, "returns nothing; end it with return and the result")
    for name, value in arguments.items():
        if isinstance(value, np.ndarray) and not np.array_equal(
            value, given[name], equal_nan=True
        ):
            refuse(task, f"changes its argument {name}; work on a copy of it")
    return result


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
    if isinstance(value, int | float | complex | np.number):
        return f"the number {_checks.show(value)}"
    if isinstance(value, FunctionType):
        return "a function; call it, and return its result"
    array = _as_numbers(value)
    if array is not None:
        return f"numbers of shape {array.shape}"
    return f"a {type(value).__name__}"


def _as_numbers(value: Any) -> Array | None:
    """Return real numbers as an array, and None for all else."""
    if is_sparse(value):
        value = value.toarray()
    if not isinstance(value, int | float | list | tuple) and not hasattr(
        value, "__array__"
    ):
        return None
    try:
        array = np.asarray(value)
    except Exception:  # a ragged list, or an object whose __array__ raises anything
        return None
    return array.astype(float) if array.dtype.kind in "iuf" else None


def _is_between(
    found: Any, low: Any, high: Any, tolerance: float, floor: float = 1.0
) -> bool:
    """Return whether numbers lie between two others, inf as itself.

    The tolerance is relative to the largest, or to ``floor`` where all are smaller: a
    standard error of 0 is the root of what rounding leaves.
    """
    found, low, high = (np.asarray(x, dtype=float) for x in (found, low, high))
    finite = np.abs(high)[np.isfinite(high)]
    room = tolerance * max(floor, finite.max(initial=0.0))
    inside = (found >= low - room) & (found <= high + room)
    return bool(np.all(inside | (found == low)))


def _difference(found: Array, right: Array) -> str:
    """Write where two results differ most."""
    if not right.shape:
        return f"it returns {float(found):.6g}, and {float(right):.6g} is right."
    gap = np.where(found == right, 0.0, np.abs(found - right))
    gap = np.where(np.isnan(gap), np.inf, gap)
    at = tuple(int(k) for k in np.unravel_index(int(gap.argmax()), gap.shape))
    place = ", ".join(map(str, at))
    return f"entry [{place}] is {found[at]:.6g}, and {right[at]:.6g} is right."
