"""The estimator under check: what it claims, and its verdicts.

Every call of it becomes a value or a ``Broken``, never a crash.
"""

from __future__ import annotations

import copy
import dataclasses
import difflib
import random
import textwrap
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import wraps
from typing import Any

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import UNEXPLAINED
from oee_tabular.estimators.functions import as_estimator, is_number
from oee_tabular.exceptions import AnswerError, ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.cases import Case, case
from oee_tabular.typing import Array

CLAIMS: Mapping[str, str] = {
    "consistent": (
        "its value tends to J_target as the log (and its rollouts) grow, where the"
        " log's behaviour has support"
    ),
    "unbiased": "its mean over logs is J_target at every number of episodes",
    "identical": "it is right where the target is the simulator (part of consistent)",
    "relabelling": (
        "names of states and actions do not matter where the states keep their places"
        " (layout)"
    ),
    "scale": "rewards a r give a J, to 1e-8, from the same log and seed",
    "shift": (
        "rewards r + b give J + b sum gamma^t, to 1e-8, from the same log and seed,"
        " nothing being absorbing"
    ),
    "padding": "rows in an absorbing state after the end of an episode change nothing",
    "after_end": "padding, whatever actions those rows have",
    "random": (
        "other seeds may give other values; without this word they must give the same"
        " bits"
    ),
    "finite": (
        "it answers problems with a horizon; claimed without infinite, those alone"
    ),
    "infinite": (
        "it answers problems without a horizon; claimed without finite, those alone"
    ),
}
DEFAULT: frozenset[str] = frozenset({"consistent", "relabelling", "scale"})


@suggest_keywords
def claims_of(estimator: Any, claims: Iterable[str] | None = None) -> frozenset[str]:
    """Return what an estimator claims: the words that say which laws it owes.

    ``claims``, else the estimator's own ``claims`` (a collection of words, or a method
    that returns one), else ``DEFAULT``.

    Parameters
    ----------
    estimator : object
        Any object.
    claims : iterable of str, optional
        Words of ``CLAIMS``.

    Returns
    -------
    frozenset of str
        Words of ``CLAIMS``.

    Raises
    ------
    ValueError
        If a word is none of ``CLAIMS``; the error names the nearest one.

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> sorted(claims_of(Simulator()) - DEFAULT)
    ['after_end', 'identical', 'padding', 'shift']
    >>> claims_of(lambda problem, policy, *, seed=None: None) == DEFAULT
    True
    """
    words: Any = claims
    name = "claims"
    if claims is None:
        name = f"{type(estimator).__name__}.claims"
        try:
            words = getattr(estimator, "claims", None)
            words = words() if callable(words) else words
        except Exception as error:
            raise ArgumentError(
                name, f"must be a collection of words; it raises {_checks.show(error)}"
            ) from None
        if words is None:
            return DEFAULT
    words = _checks.collection(words, name, "a collection of words")
    for word in words:
        near = []
        if isinstance(word, str):
            near = difflib.get_close_matches(word, CLAIMS, n=1)
        _checks.one_of(
            word, name, tuple(CLAIMS), f" (did you mean {near[0]!r}?)" if near else ""
        )
    return frozenset(words)


@checked()
@dataclass(frozen=True)
class Verdict:
    """Hold the outcome of one law.

    Attributes
    ----------
    law : str
        Name of the law, a key of ``LAWS``.
    outcome : str
        "holds", "fails", "raises" or "not claimed"; of ``oee check`` also "exits" (the
        process ended), "hangs" and "not run" (after three laws that hang).
    text : str
        The numbers found.
    example : str
        How to see it again.

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> from oee_tabular.testing import check_estimator
    >>> verdict = check_estimator(
    ...     Simulator(), claims=["consistent"], laws=["consistent"]
    ... )["consistent"]
    >>> verdict.outcome, verdict.text
    ('fails', 'ragged (horizon 6, discount 0.9): its limit is not J_target: 7.969194231, expected 10.06961735 (off by 2.1)')
    """

    law: str
    outcome: str
    text: str
    example: str = ""


@checked()
@dataclass(frozen=True, eq=False)
class Verdicts(Mapping[str, Verdict]):
    """Hold a verdict for each law; it prints as a table.

    ``verdicts["shift"]`` is one of them.

    Attributes
    ----------
    estimator : str
        Name of the estimator.
    claims : frozenset of str
        The words by which laws were chosen.
    seed : int
        Seed of the logs.
    verdicts : mapping of str to Verdict
        The verdict on each law, by its name.

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> from oee_tabular.testing import check_estimator
    >>> verdicts = check_estimator(
    ...     Simulator(), claims=["consistent", "scale"], laws=["consistent", "scale"]
    ... )
    >>> verdicts.passed, verdicts.broken, len(verdicts)
    (False, ('consistent',), 2)
    """

    estimator: str
    claims: frozenset[str]
    seed: int
    verdicts: Mapping[str, Verdict]

    @property
    def passed(self) -> bool:
        """Return whether every law that is owed or claimed holds."""
        return not self.broken

    @property
    def broken(self) -> tuple[str, ...]:
        """Return the laws that do not hold though they are owed or claimed."""
        kept = ("holds", "not claimed", "not run")
        return tuple(
            law for law, verdict in self.verdicts.items() if verdict.outcome not in kept
        )

    @property
    def conclusion(self) -> str:
        """Return which laws are broken, or what all laws that hold leave open."""
        if self.broken:
            return f"broken laws: {', '.join(self.broken)}"
        if left := sorted(DEFAULT - self.claims):
            return f"all laws hold that it claims; it does not claim {', '.join(left)}"
        return "all laws hold"

    def __getitem__(self, law: str) -> Verdict:
        """Return the verdict on a law; a KeyError where there is none."""
        if not isinstance(law, str) or law not in self.verdicts:
            raise KeyError(
                f"law must be one of {', '.join(self.verdicts)}; got"
                f" {_checks.show(law)}"
            )
        return self.verdicts[law]

    def __iter__(self) -> Iterator[str]:
        return iter(self.verdicts)

    def __len__(self) -> int:
        return len(self.verdicts)

    def __str__(self) -> str:
        outcomes = [verdict.outcome for verdict in self.verdicts.values()]
        n_kept, n_idle, n_left = (
            outcomes.count(word) for word in ("holds", "not claimed", "not run")
        )
        kept = f"{n_kept} law{' holds' if n_kept == 1 else 's hold'}"
        summary = f"{kept}, {len(self.broken)} broken, {n_idle} not claimed"
        summary += f", {n_left} not run" if n_left else ""
        lines = [
            f"{self.estimator}: {'passed' if self.passed else 'NOT PASSED'} ({summary};"
            f" seed {self.seed})"
        ]
        lines.append(f"claims: {', '.join(sorted(self.claims)) or 'none'}")
        for verdict in self.verdicts.values():
            example = ""
            if verdict.example and verdict.outcome != "holds":
                example = f"see it: {verdict.example}"
            body = [*textwrap.wrap(verdict.text, 92), *textwrap.wrap(example, 92), ""]
            lines.append(f"{verdict.law:16}{verdict.outcome:12}{body[0]}".rstrip())
            lines += [" " * 28 + line for line in body[1:-1]]
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return _printing.text(self, "Laws of estimators")


class Broken(Exception):
    """Report a law that does not hold: the numbers, and how to see it again."""

    outcome = "fails"

    def __init__(self, text: str, example: str = "") -> None:
        super().__init__(text)
        self.text = text
        self.example = example


class Raises(Broken):
    """Report that the estimator raised an error."""

    outcome = "raises"


class Refused(Raises):
    """Report that the estimator raised a ValueError, to which it may have a right."""


class NotClaimed(Broken):
    """Report that the law says nothing about this estimator."""

    outcome = "not claimed"


def ignore(title: str) -> None:
    """Do nothing with the title of a case."""


@dataclass(frozen=True)
class Subject:
    """Hold the estimator under check.

    Attributes
    ----------
    name : str
        What tables call it.
    make : callable
        Function (simulator, target) -> estimator; it gives the same one for every pair
        unless it is an oracle's.
    claims : frozenset of str
        Words of ``CLAIMS``.
    seed : int
        Seed of the logs that the statistical laws draw.
    repetitions : int
        Number of these logs.
    is_oracle : bool
        Whether ``make`` looks at the pair.
    report : callable
        Function that is told each case before it is looked at.
    values : dict
        Values of small and of large logs by case, which several laws need.
    """

    name: str
    make: Callable[[FiniteMDP, FiniteMDP], Any]
    claims: frozenset[str]
    seed: int
    repetitions: int
    is_oracle: bool = False
    report: Callable[[str], object] = ignore
    values: dict[str, tuple[Array, Array]] = field(default_factory=dict)

    def cases(self, *names: str) -> list[Case]:
        """Return the cases, in the form that the estimator claims to answer.

        Each comes without its horizon (or with it) where the estimator claims to answer
        only those.
        """
        # claiming neither is claiming both
        asked = self.claims & {"finite", "infinite"}
        if len(asked) == 1:
            end = " infinite" if "infinite" in asked else ""
            names = tuple(name.removesuffix(" infinite") + end for name in names)
        return [case(name) for name in dict.fromkeys(names)]

    @contextmanager
    def look_at(self, pair: Case, more: str = "", example: str = "") -> Iterator[None]:
        """Report the case, and let a ``Broken`` name it."""
        self.report(pair.title)
        try:
            yield
        except NotClaimed:
            raise
        except Broken as broken:
            example = f"{example}{broken.example}".rstrip("; ")
            raise type(broken)(
                f"{pair.title}{more}: {broken.text}", example
            ) from broken

    def log_seed(self, *words: object) -> np.random.SeedSequence:
        """Return the seed of a log, by a law's name, a case's name or a size."""
        key = [zlib.crc32(str(word).encode()) for word in words]
        return np.random.SeedSequence(self.seed, spawn_key=key)

    def estimator(self, pair: Case) -> Any:
        """Return the estimator for a pair, made on copies of it."""
        with capture_errors("making the estimator"):
            return self.make(copy.deepcopy(pair.simulator), copy.deepcopy(pair.target))

    def estimate(
        self, pair: Case, log: Transitions, seed: int, *, rollouts: int = 0
    ) -> Estimate:
        """Return one well-formed estimate, or raise ``Broken``.

        ``rollouts`` is how many there are at least, for an estimator that has such a
        field.
        """
        estimator = self.estimator(pair)
        own = getattr(estimator, "n_rollouts", None)
        if rollouts and isinstance(own, int) and dataclasses.is_dataclass(estimator):
            with capture_errors("dataclasses.replace(estimator, n_rollouts=...)"):
                estimator = dataclasses.replace(
                    estimator, n_rollouts=max(own, rollouts)
                )  # type: ignore[type-var]
        return call(estimator, pair.problem_of(log), pair.policy.copy(), seed)

    def value(
        self, pair: Case, log: Transitions, seed: int = 0, *, rollouts: int = 0
    ) -> float:
        """Return the value of one estimate; raise ``Broken`` if its status is not "ok"."""
        estimate = self.estimate(pair, log, seed, rollouts=rollouts)
        if estimate.status != "ok":
            raise Broken(
                f"no value: status {shorten(estimate.status)!r}", f"seed={seed}"
            )
        return float(estimate.value)

    def limit(self, pair: Case, **data: object) -> float | None:
        """Return the estimator's own limit; None if it has none to tell."""
        estimator = self.estimator(pair)
        with capture_errors("estimator.limit"):
            method = getattr(estimator, "limit", None)
            if not callable(method):
                return None
            copies = (
                copy.deepcopy(pair.simulator),
                copy.deepcopy(pair.target),
                pair.policy.copy(),
            )
            limit = method(*copies, horizon=pair.horizon, **data)
        if not is_number(limit):
            raise Broken(f"limit must be a float; it is {type(limit).__name__}")
        return float(limit)


def on_cases(
    *names: str,
) -> Callable[[Callable[[Subject, Case], str]], Callable[[Subject], str]]:
    """Make a law of a check that runs on each of these cases.

    The law says what the check found on each.
    """

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
    """Return ``estimator(problem, policy, seed=seed)``, or raise ``Broken``."""
    with capture_errors(f"estimator(problem, policy, seed={seed})"):
        estimate = as_estimator(estimator)(problem, policy, seed=seed)
        defect = find_defect(estimate)
    if defect:
        raise Broken(defect, f"seed={seed}")
    return estimate


def find_defect(estimate: Any) -> str:
    """Return what is wrong with an estimate, whose fields may hold anything."""
    value = estimate.value
    error = estimate.standard_error
    interval = estimate.interval
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
    if error is not None and not (
        is_number(error) and np.isfinite(error) and error >= 0
    ):
        return f"standard_error must be None or a nonnegative number; it is {error!r}"
    if not is_ordered:
        return (
            "interval must be None or (lower, upper) with lower <= upper; it is"
            f" {interval!r}"
        )
    if not isinstance(estimate.diagnostics, Mapping):
        return (
            f"diagnostics must be a dict; it is {type(estimate.diagnostics).__name__}"
        )
    return ""


@contextmanager
def capture_errors(what: str) -> Iterator[None]:
    """Turn the estimator's errors into ``Broken``.

    Its warnings are not shown, and its global random state is put back.
    """
    state, numpy_state = (
        random.getstate(),
        np.random.get_state(),  # noqa: NPY002 (what is watched over is the global one)
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except AnswerError as error:
        raise Broken(str(error)) from error
    except (Exception, SystemExit) as error:
        is_refusal = isinstance(error, ValueError) and not isinstance(
            error, np.linalg.LinAlgError
        )
        raised = "ValueError" if is_refusal else type(error).__name__
        raise (Refused if is_refusal else Raises)(
            f"{what} raises {raised}: {shorten(str(error))}"
        ) from error
    finally:
        random.setstate(state)
        np.random.set_state(numpy_state)  # noqa: NPY002


def shorten(text: str, length: int = 160) -> str:
    """Return one line of at most so many characters."""
    line = " ".join(text.split())
    return line if len(line) <= length else line[: length - 3] + "..."


def name_of(estimator: object) -> str:
    """Return what to call an estimator in a table.

    It is a function's name, a representation that says something, or the class's name.
    """
    name = getattr(estimator, "__name__", "")
    text = repr(estimator)
    if name or text.startswith("<") or len(text) > 100:
        return str(name or type(estimator).__name__)
    return text
