"""The estimator under check: every call of it becomes a value or a ``Broken``, never a crash."""

from __future__ import annotations

import copy
import dataclasses
import random
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from typing import Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import UNEXPLAINED
from oee_tabular.estimators.functions import AnswerError, as_estimator, is_number
from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.cases import Case, case


class Broken(Exception):
    """A law that does not hold: the numbers, and how to see it again."""

    outcome = "fails"

    def __init__(self, text: str, example: str = "") -> None:
        super().__init__(text)
        self.text, self.example = text, example


class Raises(Broken):
    """The estimator raised an error."""

    outcome = "raises"


class Refused(Raises):
    """The estimator raised a ValueError: it may have a right to."""


class NotClaimed(Broken):
    """The law says nothing about this estimator."""

    outcome = "not claimed"


@dataclass(frozen=True)
class Subject:
    """The estimator under check.

    Attributes
    ----------
    name : what tables call it
    make : (simulator, target) -> estimator; gives the same one for every pair unless it is an oracle's
    claims : words of ``CLAIMS``
    seed, repetitions : of the logs that the statistical laws draw
    is_oracle : whether ``make`` looks at the pair
    report : is told each case before it is looked at
    values : of small and of large logs, which several laws need, by case
    """

    name: str
    make: Callable[[FiniteMDP, FiniteMDP], Any]
    claims: frozenset[str]
    seed: int
    repetitions: int
    is_oracle: bool = False
    report: Callable[[str], object] = lambda title: None
    values: dict[str, tuple[Array, Array]] = field(default_factory=dict)

    def cases(self, *names: str) -> list[Case]:
        """The cases, each without its horizon (or with it) where the estimator claims to answer only those."""
        asked = self.claims & {"finite", "infinite"}  # claiming neither is claiming both
        if len(asked) == 1:
            end = " infinite" if "infinite" in asked else ""
            names = tuple(name.removesuffix(" infinite") + end for name in names)
        return [case(name) for name in dict.fromkeys(names)]

    @contextmanager
    def look_at(self, pair: Case, more: str = "", example: str = "") -> Iterator[None]:
        """``Broken`` says on which case, with its horizon and discount."""
        self.report(pair.title)
        try:
            yield
        except NotClaimed:
            raise
        except Broken as broken:
            example = f"{example}{broken.example}".rstrip("; ")
            raise type(broken)(f"{pair.title}{more}: {broken.text}", example) from broken

    def log_seed(self, *words: object) -> np.random.SeedSequence:
        """The seed of a log, by a law's name, a case's name or a size."""
        key = [zlib.crc32(str(word).encode()) for word in words]
        return np.random.SeedSequence(self.seed, spawn_key=key)

    def estimator(self, pair: Case) -> Any:
        """The estimator for a pair, made on copies of it."""
        with capture_errors("making the estimator"):
            return self.make(copy.deepcopy(pair.simulator), copy.deepcopy(pair.target))

    def estimate(self, pair: Case, log: Transitions, seed: int, *, rollouts: int = 0) -> Estimate:
        """One well-formed estimate, or ``Broken``; ``rollouts``: at least so many, for an estimator that has such a field."""
        estimator = self.estimator(pair)
        own = getattr(estimator, "n_rollouts", None)
        if rollouts and isinstance(own, int) and dataclasses.is_dataclass(estimator):
            with capture_errors("dataclasses.replace(estimator, n_rollouts=...)"):
                estimator = dataclasses.replace(estimator, n_rollouts=max(own, rollouts))  # type: ignore[type-var]
        return call(estimator, pair.problem_of(log), pair.policy.copy(), seed)

    def value(self, pair: Case, log: Transitions, seed: int = 0, *, rollouts: int = 0) -> float:
        """The value of one estimate; ``Broken`` where its status is not "ok"."""
        estimate = self.estimate(pair, log, seed, rollouts=rollouts)
        if estimate.status != "ok":
            raise Broken(f"no value: status {shorten(estimate.status)!r}", f"seed={seed}")
        return float(estimate.value)

    def limit(self, pair: Case, **data: object) -> float | None:
        """Its own limit; None where it has none to tell."""
        estimator = self.estimator(pair)
        with capture_errors("estimator.limit"):
            method = getattr(estimator, "limit", None)
            if not callable(method):
                return None
            copies = copy.deepcopy(pair.simulator), copy.deepcopy(pair.target), pair.policy.copy()
            limit = method(*copies, horizon=pair.horizon, **data)
        if not is_number(limit):
            raise Broken(f"limit must be a float; it is {type(limit).__name__}")
        return float(limit)


def on_cases(*names: str) -> Callable[[Callable[[Subject, Case], str]], Callable[[Subject], str]]:
    """A law that is checked on each of these cases, and says what it found on each."""

    def repeat(check: Callable[[Subject, Case], str]) -> Callable[[Subject], str]:
        @wraps(check)
        def check_cases(subject: Subject) -> str:
            texts = []
            for pair in subject.cases(*names):
                with subject.look_at(pair, example=f"pair = case({pair.name!r}); "):
                    texts.append(f"{pair.name}: {check(subject, pair)}")
            return "; ".join(texts)

        return check_cases

    return repeat


def call(estimator: Any, problem: Problem, policy: Array, seed: int) -> Estimate:
    """``estimator(problem, policy, seed=seed)``, well-formed, or ``Broken``."""
    with capture_errors(f"estimator(problem, policy, seed={seed})"):
        estimate = as_estimator(estimator)(problem, policy, seed=seed)
        defect = find_defect(estimate)
    if defect:
        raise Broken(defect, f"seed={seed}")
    return estimate


def find_defect(estimate: Any) -> str:
    """What is wrong with an estimate, whose fields may hold anything; or nothing."""
    value, error, interval = estimate.value, estimate.standard_error, estimate.interval
    try:
        lower, upper = (0.0, 0.0) if interval is None else interval
        is_ordered = bool(lower <= upper)
    except (TypeError, ValueError):
        is_ordered = False
    if not is_number(value):
        return f"value must be a float; it is {type(value).__name__}"
    if not estimate.status:
        return 'status must be "ok" or say what is wrong; it is empty'
    if estimate.status in ("ok", UNEXPLAINED) and not np.isfinite(value):
        return f'value must be finite where status is "ok"; it is {float(value)}'
    if error is not None and not (is_number(error) and np.isfinite(error) and error >= 0):
        return f"standard_error must be None or a nonnegative number; it is {error!r}"
    if not is_ordered:
        return f"interval must be None or (lower, upper) with lower <= upper; it is {interval!r}"
    is_fine = isinstance(estimate.diagnostics, dict)
    return "" if is_fine else f"diagnostics must be a dict; it is {type(estimate.diagnostics).__name__}"


@contextmanager
def capture_errors(what: str) -> Iterator[None]:
    """Errors of the estimator's become ``Broken``; its warnings are not shown, its global random state is put back."""
    state, numpy_state = random.getstate(), np.random.get_state()  # noqa: NPY002 (what is watched over is the global one)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except AnswerError as error:
        raise Broken(str(error)) from error
    except (Exception, SystemExit) as error:
        is_refusal = isinstance(error, ValueError) and not isinstance(error, np.linalg.LinAlgError)
        raised = "ValueError" if is_refusal else type(error).__name__
        raise (Refused if is_refusal else Raises)(f"{what} raises {raised}: {shorten(str(error))}") from error
    finally:
        random.setstate(state)
        np.random.set_state(numpy_state)  # noqa: NPY002


def shorten(text: str, length: int = 160) -> str:
    """One line of at most so many characters."""
    line = " ".join(text.split())
    return line if len(line) <= length else line[: length - 3] + "..."


def name_of(estimator: object) -> str:
    """What to call an estimator in a table: a function's name, a representation that says something, or the class's name."""
    name, text = getattr(estimator, "__name__", ""), repr(estimator)
    return str(name or type(estimator).__name__) if name or text.startswith("<") or len(text) > 100 else text
