"""Somebody else's estimator: what it says of itself, and its calls, which become a value or a ``Broken``, never a crash."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import random
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oee_tabular._checks import Array, Seed, show
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.estimators.base import UNEXPLAINED
from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.cases import Case, case


class Broken(Exception):
    """A law that does not hold: what was found, and where."""

    outcome = "fails"

    def __init__(self, text: str, example: str = "") -> None:
        super().__init__(text)
        self.text, self.example = text, example


class Raises(Broken):
    """The estimator raised an error."""

    outcome = "raises"


class Refused(Raises):
    """The estimator raised a ValueError: it may have a right to."""


@dataclass(frozen=True)
class Subject:
    """The estimator under check.

    Attributes
    ----------
    make : (simulator, target) -> estimator; gives the same one for every pair unless it is an oracle's
    claims : words of ``CLAIMS``
    seed, repetitions : of the logs that the statistical laws draw
    oracle : whether ``make`` looks at the pair
    has_limit : whether it has an exact limit to tell
    memory : what several laws need, by case
    """

    make: Callable[[FiniteMDP, FiniteMDP], Any]
    claims: frozenset[str]
    seed: int
    repetitions: int
    oracle: bool = False
    has_limit: bool = False
    memory: dict[str, Any] = field(default_factory=dict)

    def cases(self, *names: str) -> list[Case]:
        """Each case in the forms that the estimator answers: with its horizon, without one, or both."""
        both = ("finite" in self.claims) == ("infinite" in self.claims)
        wanted = [suffix for suffix, word in (("", "finite"), (" infinite", "infinite")) if both or word in self.claims]
        return [case(f"{name}{suffix}") for name in names for suffix in wanted]

    def one_case(self, name: str) -> Case:
        """The case with its horizon, or without one where the estimator answers only those."""
        return self.cases(name)[0]

    def log_seed(self, *key: int) -> np.random.SeedSequence:
        """The seed of a log."""
        return np.random.SeedSequence(self.seed, spawn_key=key)

    def estimator(self, pair: Case) -> Any:
        """The estimator for a pair (an oracle's: on copies of it)."""
        if not self.oracle:
            return self.make(pair.simulator, pair.target)
        with guarded("making the estimator", pair.name):
            return self.make(copy.deepcopy(pair.simulator), copy.deepcopy(pair.target))

    def estimate(self, pair: Case, log: Transitions, seed: int, *, rollouts: int | None = None) -> Estimate:
        """One well-formed estimate, or ``Broken``; ``rollouts``: at least so many, for an estimator that has such a field."""
        estimator = self.estimator(pair)
        own = getattr(estimator, "n_rollouts", None)
        if rollouts is not None and isinstance(own, int) and dataclasses.is_dataclass(estimator):
            with guarded("dataclasses.replace(estimator, n_rollouts=...)", pair.name):
                estimator = dataclasses.replace(estimator, n_rollouts=max(own, rollouts))  # type: ignore[type-var]
        return call(estimator, pair.problem_of(log), pair.policy.copy(), seed, pair.name)

    def value(self, pair: Case, log: Transitions, seed: int, *, rollouts: int | None = None) -> float:
        """The value of one estimate; ``Broken`` where its status is not "ok"."""
        found = self.estimate(pair, log, seed, rollouts=rollouts)
        if found.status != "ok":
            raise Broken(f"no value: status {shorten(found.status)!r}", f"case {pair.name!r}, seed={seed}")
        return float(found.value)

    def limit(self, pair: Case, **data: object) -> float | None:
        """Its own limit; None where it has none to tell."""
        estimator = self.estimator(pair)
        with guarded("estimator.limit", pair.name):
            method = getattr(estimator, "limit", None)
            if not callable(method):
                return None
            found = method(
                copy.deepcopy(pair.simulator),
                copy.deepcopy(pair.target),
                pair.policy.copy(),
                horizon=pair.horizon,
                **data,
            )
        if not is_number(found):
            raise Broken(f"limit must be a float; it is {type(found).__name__}", f"case {pair.name!r}")
        return float(found)


def call(estimator: Any, problem: Problem, policy: Array, seed: Seed, where: str) -> Estimate:
    """``estimator(problem, policy, seed=seed)``, well-formed, or ``Broken``."""
    with guarded(f"estimator(problem, policy, seed={seed})", where):
        found = estimator(problem, policy, seed=seed)
        trouble = malformed(found)
    if trouble:
        raise Broken(trouble, f"problem {where!r}, seed={seed}")
    assert isinstance(found, Estimate)
    return found


def malformed(answer: object) -> str:
    """What is wrong with an estimate, or nothing."""
    if not isinstance(answer, Estimate):
        return f"it must return an Estimate; it returned {type(answer).__name__}"
    found: Any = answer  # its fields may hold anything
    if not is_number(found.value):
        return f"value must be a float; it is {type(found.value).__name__}"
    if not isinstance(found.status, str) or not found.status:
        return f'status must be "ok" or say what is wrong; it is {found.status!r}'
    if found.status in ("ok", UNEXPLAINED) and not np.isfinite(found.value):
        return f'value must be finite where status is "ok"; it is {float(found.value)}'
    error = found.standard_error
    if error is not None and not (is_number(error) and np.isfinite(error) and error >= 0):
        return f"standard_error must be None or a nonnegative number; it is {error!r}"
    if found.interval is not None:
        try:
            lower, upper = found.interval
            ordered = bool(lower <= upper)
        except (TypeError, ValueError):
            ordered = False
        if not ordered:
            return f"interval must be None or (lower, upper) with lower <= upper; it is {found.interval!r}"
    if not isinstance(found.diagnostics, dict):
        return f"diagnostics must be a dict; it is {type(found.diagnostics).__name__}"
    return ""


def is_number(value: object) -> bool:
    """A Python or numpy real number (no boolean)."""
    return isinstance(value, float | int | np.floating | np.integer) and not isinstance(value, bool)


@contextmanager
def guarded(what: str, where: str) -> Iterator[None]:
    """Errors of the estimator's become ``Broken``; its warnings are not shown, its global random state is put back."""
    state, numpy_state = random.getstate(), np.random.get_state()  # noqa: NPY002 (what is watched over is the global one)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except ValueError as error:
        raise Refused(f"{what} raises ValueError: {shorten(str(error))}", f"problem {where!r}") from error
    except (Exception, SystemExit) as error:
        name = type(error).__name__
        raise Raises(f"{what} raises {name}: {shorten(str(error))}", f"problem {where!r}") from error
    finally:
        random.setstate(state)
        np.random.set_state(numpy_state)  # noqa: NPY002


def shorten(text: str, length: int = 160) -> str:
    """One line of at most so many characters."""
    line = " ".join(text.split())
    return line if len(line) <= length else line[: length - 3] + "..."


def name_of(estimator: object) -> str:
    """What to call an estimator in a table: a function's name, a representation that says something, or the class's name."""
    kind: Any = type(estimator)
    name = str(kind.__name__)
    try:
        text = str(estimator.__name__ if hasattr(estimator, "__name__") else repr(estimator))
    except Exception:
        return name
    says_nothing = kind.__repr__ is object.__repr__ or len(text) > 100
    return name if says_nothing else text


@contextmanager
def one_thread() -> Iterator[None]:
    """Many short samples: handing them to other threads costs more than they do. The bits are the same."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


CLAIMS: Mapping[str, str] = {
    "consistent": "its value tends to J_target as the log (and its rollouts) grow, where the log's behaviour has support",
    "unbiased": "its mean over logs is J_target at every number of episodes",
    "identical": "it is right where the target is the simulator (part of consistent)",
    "relabelling": "names of states and actions do not matter where the states keep their places (layout)",
    "scale": "rewards a r give a J, to 1e-8, from the same log and seed",
    "shift": "rewards r + b give J + b sum gamma^t, to 1e-8, from the same log and seed, nothing being absorbing",
    "padding": "rows in an absorbing state after the end of an episode change nothing",
    "after_end": "padding, whatever actions those rows have",
    "random": "other seeds may give other values; without this word they must give the same bits",
    "finite": "it answers problems with a horizon; claimed without infinite, those alone",
    "infinite": "it answers problems without a horizon; claimed without finite, those alone",
}
DEFAULT: frozenset[str] = frozenset({"consistent", "relabelling", "scale"})


def claims_of(estimator: Any, claims: Iterable[str] | None = None) -> frozenset[str]:
    """What an estimator claims: the words that say which laws it owes.

    ``claims``, else the estimator's own ``claims`` (a collection of words, or a method that returns one), else ``DEFAULT``.

    Parameters
    ----------
    estimator : any object
    claims : words of ``CLAIMS``, or None

    Raises
    ------
    ValueError
        A word that is none of ``CLAIMS`` (with the nearest one).

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> sorted(claims_of(Simulator()) - DEFAULT)
    ['after_end', 'identical', 'padding', 'shift']
    >>> claims_of(lambda problem, policy, *, seed=None: None) == DEFAULT
    True
    """
    found: Any = claims
    name = "claims"
    if found is None:
        name = f"{type(estimator).__name__}.claims"
        try:
            found = getattr(estimator, "claims", None)
            found = found() if callable(found) else found
        except Exception as error:
            raise ValueError(f"{name} must be a collection of words; it raises {error!r}") from None
    if found is None:
        return DEFAULT
    try:
        if isinstance(found, str):
            raise TypeError
        words = frozenset(found)
    except TypeError:
        raise ValueError(f"{name} must be a collection of words; it is {show(found)}") from None
    for word in sorted(words, key=str):
        if word not in CLAIMS:
            near = difflib.get_close_matches(str(word), list(CLAIMS), n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise ValueError(f"{name} must be among {', '.join(CLAIMS)}; got {show(word)}{hint}")
    return words
