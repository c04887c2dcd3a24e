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
from oee_tabular.estimators.estimate import UNEXPLAINED
from oee_tabular.estimators.functions import as_estimator, is_number
from oee_tabular.exceptions import AnswerError, ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.cases import Case, case
from oee_tabular.testing.code import program
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
# what no law looks at
UNTESTED = (
    "whether standard errors and intervals are right",
    "rewards that the log alone has",
    "more than 5 states",
)
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
    words = _checks.collection(words, name, "a collection of words", may_be_set=True)
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
    code : str
        Where it does not hold: its case as a program, whose ``estimator(problem,
        policy)`` breaks the law. Simulator, target, policy and behaviour are written
        out; so is the log, or how it is made again if it is long.
    tolerance : float, optional
        The largest error, as a share of the value, at which the law holds.

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
    code: str = ""
    tolerance: float | None = None


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
        """Return which laws are broken or hold, at what tolerance, and what is open.

        It is one line.
        """
        if self.broken:
            text = f"broken laws: {', '.join(self.broken)}"
        elif left := sorted(DEFAULT - self.claims):
            text = f"all laws hold that it claims; it does not claim {', '.join(left)}"
        else:
            text = "all laws hold"
        held = [
            f"{verdict.law} {_show_share(verdict.tolerance)}"
            for verdict in self.verdicts.values()
            if verdict.outcome == "holds" and verdict.tolerance is not None
        ]
        if held:
            text += f"; to what share of the value: {', '.join(held)}"
        return f"{text}; not tested: {', '.join(self.untested)}"

    @property
    def untested(self) -> tuple[str, ...]:
        """Return what the laws leave open: laws not run, and what no law looks at."""
        idle = {
            law: verdict.outcome
            for law, verdict in self.verdicts.items()
            if verdict.outcome in ("not claimed", "not run")
        }
        rests = [f"{law} ({outcome})" for law, outcome in idle.items()]
        if "limit" in idle:
            rests.append("pairs that were never recorded")
        for word, other in (("finite", "infinite"), ("infinite", "finite")):
            if word in self.claims and other not in self.claims:
                form = "without" if word == "finite" else "with"
                rests.append(f"problems {form} a horizon")
        return (*rests, *UNTESTED)

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
        for law in self.broken:
            if code := self.verdicts[law].code:
                lines.append(
                    f"# where {law} is broken (verdicts[law].code has other laws)"
                )
                lines.append(code)
                break
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return _printing.text(self, "Laws of estimators")


def _show_share(share: float | None) -> str:
    """Write a tolerance: percents, or a power of ten where it is rounding alone."""
    assert share is not None
    return f"{share:.2g}" if share < 1e-3 else f"{share:.1%}"


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


# the share of the value by which an estimator may be off that declares none
DEFAULT_TOLERANCE = 1e-6


@suggest_keywords
def tolerance_of(estimator: Any, tolerance: float | None = None) -> float:
    """Return by what share of the value an estimator may be off on exact data.

    Parameters
    ----------
    estimator : object
        Any object; its attribute ``tolerance`` is taken where no number is given.
    tolerance : float, optional
        The share, above 0 and below 1.

    Returns
    -------
    float
        The number that is given, else the estimator's own, else 1e-6.

    Raises
    ------
    ValueError
        If it is no number in (0, 1).

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> tolerance_of(Simulator()), tolerance_of(Simulator(), 1e-3)
    (1e-06, 0.001)
    """
    name = "tolerance"
    share: Any = tolerance
    if share is None:
        name = f"{type(estimator).__name__}.tolerance"
        share = getattr(estimator, "tolerance", None)
    if share is None:
        return DEFAULT_TOLERANCE
    return _checks.number_in(share, name, 0.0, 1.0, open_ends=True)


@dataclass
class Seen:
    """Hold what a law has looked at last, for the message that it is broken.

    Attributes
    ----------
    pair : Case or None
        The last case.
    log : Transitions or None
        The last log.
    recipes : dict of int to (Transitions, str)
        By the identities of logs, the logs and expressions that make them anew.
    tolerances : list of float
        Largest errors, as shares of the value, at which a comparison was right.
    """

    pair: Case | None = None
    log: Transitions | None = None
    recipes: dict[int, tuple[Transitions, str]] = field(default_factory=dict)
    tolerances: list[float] = field(default_factory=list)

    def clear(self) -> None:
        """Forget everything, before the next law."""
        self.pair = self.log = None
        self.recipes.clear()
        self.tolerances.clear()

    def remember(self, log: Transitions, recipe: str) -> Transitions:
        """Keep how a log is made anew, and return the log."""
        self.recipes[id(log)] = (log, recipe)
        return log

    def recipe(self, log: Transitions) -> str:
        """Return how a log is made anew, or an empty text."""
        return self.recipes.get(id(log), (log, ""))[1]

    def program(self) -> str:
        """Return the case as a program, or an empty text without one."""
        pair = self.pair
        if pair is None:
            return ""
        parts: dict[str, object] = {
            "simulator": pair.simulator,
            "target": pair.target,
            "policy": pair.policy,
            "behavior": pair.behavior,
        }
        goal = f"oee.policy_value(target, policy, horizon={pair.horizon})"
        if self.log is None:
            return f"{program(parts, {})}\ntruth = {goal}"
        recipe = self.recipe(self.log)
        parts["log"] = self.log
        return (
            f"{program(parts, {'log': recipe} if recipe else {})}\n"
            f"problem = oee.Problem(simulator, log, horizon={pair.horizon},"
            f" behavior_policy=behavior)\ntruth = {goal}"
        )


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
    tolerance : float
        Share of the value by which an answer to exact data may be off.
    values : dict
        Values of small and of large logs by case, which several laws need.
    seen : Seen
        What the law that is being checked has looked at.
    """

    name: str
    make: Callable[[FiniteMDP, FiniteMDP], Any]
    claims: frozenset[str]
    seed: int
    repetitions: int
    is_oracle: bool = False
    report: Callable[[str], object] = ignore
    tolerance: float = DEFAULT_TOLERANCE
    values: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    seen: Seen = field(default_factory=lambda: Seen())

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
        self.seen.pair = pair
        self.seen.log = None
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

    def draw_log(self, pair: Case, n: int, *words: object) -> Transitions:
        """Draw a log of ``n`` episodes with the seed of ``words``.

        How it is made anew is kept.
        """
        seed = self.log_seed(*words)
        return self.seen.remember(
            pair.log(n, seed=seed),
            f"oee.sample_episodes(target, behavior, {n}, {pair.steps},"
            f" seed={_show_seed(seed)})",
        )

    def draw_logs(
        self, pair: Case, n: int, repetitions: int, *words: object
    ) -> Iterator[Transitions]:
        """Draw independent logs of ``n`` episodes each, one after the other.

        How the present one is made anew is kept.
        """
        seed = self.log_seed(*words)
        for k, log in enumerate(pair.logs(n, repetitions, seed=seed)):
            self.seen.recipes.clear()
            yield self.seen.remember(
                log,
                f"list(oee.testing.case({pair.name!r}).logs({n}, {repetitions},"
                f" seed={_show_seed(seed)}))[{k}]",
            )

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
        return self.estimate_problem(
            pair, log, pair.problem_of(log), seed, rollouts=rollouts
        )

    def estimate_problem(
        self,
        pair: Case,
        log: Transitions,
        problem: Problem,
        seed: int,
        *,
        rollouts: int = 0,
    ) -> Estimate:
        """Return one well-formed estimate of a problem of a case and a log of it."""
        self.seen.pair = pair
        self.seen.log = log
        estimator = self.estimator(pair)
        own = getattr(estimator, "n_rollouts", None)
        if rollouts and isinstance(own, int) and dataclasses.is_dataclass(estimator):
            with capture_errors("dataclasses.replace(estimator, n_rollouts=...)"):
                estimator = dataclasses.replace(
                    estimator, n_rollouts=max(own, rollouts)
                )  # type: ignore[type-var]
        return call(estimator, problem, pair.policy.copy(), seed)

    def value(
        self, pair: Case, log: Transitions, seed: int = 0, *, rollouts: int = 0
    ) -> float:
        """Return the value of one estimate; raise ``Broken`` if its status is not "ok"."""
        return value_of(self.estimate(pair, log, seed, rollouts=rollouts), seed)

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


def value_of(estimate: Estimate, seed: int) -> float:
    """Return the value of an estimate, or raise ``Broken`` if its status is not "ok"."""
    if estimate.status != "ok":
        raise Broken(f"no value: status {shorten(estimate.status)!r}", f"seed={seed}")
    return float(estimate.value)


def _show_seed(seed: np.random.SeedSequence) -> str:
    """Write a seed as code."""
    key = tuple(int(word) for word in seed.spawn_key)
    return f"np.random.SeedSequence({seed.entropy}, spawn_key={key})"


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
    state = random.getstate()
    # numpy's global state is what an estimator may have changed
    numpy_state = np.random.get_state()  # noqa: NPY002
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
