"""``check_estimator``: an estimator, ours or a user's, against the laws of estimators, with a verdict on each."""

from __future__ import annotations

import difflib
import inspect
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from oee_tabular import _checks, _printing
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.testing import laws, protocol_laws
from oee_tabular.testing.cases import case
from oee_tabular.testing.subject import Broken, Subject, name_of


@dataclass(frozen=True)
class Law:
    """A law: how it is checked, and who owes it (any of these claims; none: everybody)."""

    check: Callable[[Subject], str]
    claims: frozenset[str]

    def is_claimed(self, claims: frozenset[str]) -> bool:
        """Whether an estimator with these claims owes it."""
        return not self.claims or bool(self.claims & claims)

    @property
    def statement(self) -> str:
        """What it says."""
        return (inspect.getdoc(self.check) or "").split("\n\n")[0]


LAWS: Mapping[str, Law] = {
    check.__name__: Law(check, frozenset(claims.split()))
    for check, claims in (
        (protocol_laws.well_formed, ""),
        (protocol_laws.input_unchanged, ""),
        (protocol_laws.reproducible, ""),
        (protocol_laws.support, ""),
        (laws.limit, ""),
        (laws.consistent, "consistent"),
        (laws.ragged, "consistent"),
        (laws.identical, "consistent identical"),
        (laws.unbiased, "unbiased"),
        (laws.relabelling, "relabelling"),
        (laws.scale, "scale"),
        (laws.shift, "shift"),
        (laws.padding, "padding"),
        (laws.after_end, "after_end"),
        (protocol_laws.seeds, ""),
    )
}
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


@dataclass(frozen=True)
class Verdict:
    """The outcome of one law.

    Attributes
    ----------
    law : its name, a key of ``LAWS``
    outcome : "holds", "fails", "raises" or "not claimed"; of ``oee check`` also "exits" (the process ended), "hangs" and
        "not run" (after three laws that hang)
    text : the numbers found
    example : how to see it again

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> verdict = check_estimator(Simulator(), claims=["consistent"], laws=["consistent"])["consistent"]
    >>> verdict.outcome, verdict.text
    ('fails', 'ragged (horizon 6, discount 0.9): its limit is not J_target: 7.969194231, expected 10.06961735 (off by 2.1)')
    """

    law: str
    outcome: str
    text: str
    example: str = ""


@dataclass(frozen=True, eq=False)
class Verdicts(Mapping[str, Verdict]):
    """A verdict for each law; prints as a table, ``verdicts["shift"]`` is one of them.

    Attributes
    ----------
    estimator : its name
    claims : the words by which laws were chosen
    seed : of the logs
    verdicts : law -> Verdict

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> verdicts = check_estimator(Simulator(), claims=["consistent", "scale"], laws=["consistent", "scale"])
    >>> verdicts.passed, verdicts.broken, len(verdicts)
    (False, ('consistent',), 2)
    """

    estimator: str
    claims: frozenset[str]
    seed: int
    verdicts: Mapping[str, Verdict]

    @property
    def passed(self) -> bool:
        """Whether every law that is owed or claimed holds."""
        return not self.broken

    @property
    def broken(self) -> tuple[str, ...]:
        """The laws that do not hold though they are owed or claimed."""
        kept = ("holds", "not claimed", "not run")
        return tuple(law for law, verdict in self.verdicts.items() if verdict.outcome not in kept)

    @property
    def conclusion(self) -> str:
        """Which laws are broken; else that all hold, and what others claim by default and this one does not."""
        if self.broken:
            return f"broken laws: {', '.join(self.broken)}"
        if left := sorted(DEFAULT - self.claims):
            return f"all laws hold that it claims; it does not claim {', '.join(left)}"
        return "all laws hold"

    def __getitem__(self, law: str) -> Verdict:
        return self.verdicts[law]

    def __iter__(self) -> Iterator[str]:
        return iter(self.verdicts)

    def __len__(self) -> int:
        return len(self.verdicts)

    def __str__(self) -> str:
        outcomes = [verdict.outcome for verdict in self.verdicts.values()]
        n_kept, n_idle, n_left = (outcomes.count(word) for word in ("holds", "not claimed", "not run"))
        kept = f"{n_kept} law{' holds' if n_kept == 1 else 's hold'}"
        summary = f"{kept}, {len(self.broken)} broken, {n_idle} not claimed"
        summary += f", {n_left} not run" if n_left else ""
        lines = [f"{self.estimator}: {'passed' if self.passed else 'NOT PASSED'} ({summary}; seed {self.seed})"]
        lines.append(f"claims: {', '.join(sorted(self.claims)) or 'none'}")
        for verdict in self.verdicts.values():
            example = f"see it: {verdict.example}" if verdict.example and verdict.outcome != "holds" else ""
            body = [*textwrap.wrap(verdict.text, 92), *textwrap.wrap(example, 92), ""]
            lines.append(f"{verdict.law:16}{verdict.outcome:12}{body[0]}".rstrip())
            lines += [" " * 28 + line for line in body[1:-1]]
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return _printing.text(self, "Laws of estimators")


def check_estimator(
    estimator: object,
    *,
    seed: int = 0,
    claims: Iterable[str] | None = None,
    laws: Iterable[str] | None = None,
    repetitions: int = 8,
    from_pair: bool = False,
) -> Verdicts:
    """Run an estimator through the laws of estimators, on small pairs of environments that are known exactly.

    Parameters
    ----------
    estimator : callable (problem, policy) or (problem, policy, seed) -> float or ``Estimate``; a class or function that makes
        one without arguments
    seed : int of at least 0; the logs of the statistical laws come from it
    claims : words of ``CLAIMS``: which laws it should satisfy. None: ``estimator.claims``, a collection of words or a method
        that returns one; without it ``DEFAULT`` (consistent, relabelling, scale)
    laws : names in ``LAWS``; None: all
    repetitions : logs of each statistical comparison, at least 3
    from_pair : for oracles: ``estimator`` is a function (simulator, target) -> estimator

    Returns
    -------
    Verdicts
        ``passed``, ``broken``, ``verdicts[law]``; prints as a table. "holds" and "fails" come with their numbers, "raises"
        with the error, "not claimed" laws are not run.

    Raises
    ------
    ValueError
        Arguments that are wrong. What the estimator does wrong is a verdict.

    Notes
    -----
    Every estimator owes well_formed, input_unchanged, reproducible and support, limit where it has one, and seeds
    unless it claims random. A right estimator fails a statistical law with a chance of about 1e-5 a comparison
    (unbiased: 1e-4); so a bias of less than some 11 standard errors of the mean of 8 logs (3% of the value in these
    pairs) may pass; with 30 logs (``repetitions``) a quarter of that. An estimator that is a dataclass with a field
    ``n_rollouts`` is given more rollouts with more episodes where its limit is looked at. Cost: some 100 estimates (900
    where it claims to be unbiased), of logs of up to 4800 episodes.

    Examples
    --------
    >>> from oee_tabular.estimators import ModelBased
    >>> verdicts = check_estimator(ModelBased(), laws=["scale", "shift", "unbiased"])
    >>> verdicts.passed, verdicts["shift"].outcome, verdicts["unbiased"].outcome
    (True, 'holds', 'not claimed')
    """
    _checks.boolean(from_pair, "from_pair")
    chosen = list(LAWS) if laws is None else list(laws)
    for name in chosen:
        _checks.one_of(name, "laws", tuple(LAWS))
    check_numbers(seed, repetitions)
    subject = make_subject(estimator, seed, repetitions, claims=claims, from_pair=from_pair)
    return Verdicts(subject.name, subject.claims, seed, {name: check_law(name, subject) for name in chosen})


def check_numbers(seed: object, repetitions: object) -> None:
    """ValueError where they are not what ``check_estimator`` takes."""
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ValueError(f"seed must be an integer of at least 0; got {_checks.show(seed)}")
    if _checks.positive_integer(repetitions, "repetitions") < 3:
        raise ValueError(f"repetitions must be at least 3; it is {repetitions}")


def make_subject(
    estimator: Any, seed: int, repetitions: int, *, claims: Iterable[str] | None = None, from_pair: bool = False
) -> Subject:
    """What the laws are checked on; ValueError where it is no estimator."""
    given = estimator
    if from_pair:
        _checks.function(estimator, "estimator")
        pair = case("ragged")
        try:
            given = estimator(pair.simulator, pair.target)
        except Exception as error:
            text = f"estimator must be a function (simulator, target) -> estimator; it raises {error!r}"
            raise ValueError(text) from error
    own = as_estimator(given).function
    make = estimator if from_pair else lambda simulator, target: own
    return Subject(name_of(own), make, claims_of(own, claims), seed, repetitions, is_oracle=from_pair)


def check_law(name: str, subject: Subject) -> Verdict:
    """The verdict on one law."""
    if not LAWS[name].is_claimed(subject.claims):
        return Verdict(name, "not claimed", "")
    try:
        return Verdict(name, "holds", LAWS[name].check(subject))
    except Broken as broken:
        return Verdict(name, broken.outcome, broken.text, broken.example)


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
    words: Any = claims
    name = "claims"
    if claims is None:
        name = f"{type(estimator).__name__}.claims"
        try:
            words = getattr(estimator, "claims", None)
            words = words() if callable(words) else words
        except Exception as error:
            raise ValueError(f"{name} must be a collection of words; it raises {error!r}") from None
        if words is None:
            return DEFAULT
    words = _checks.collection(words, name, "a collection of words")
    for word in words:
        near = difflib.get_close_matches(str(word), CLAIMS, n=1)
        _checks.one_of(word, name, tuple(CLAIMS), f" (did you mean {near[0]!r}?)" if near else "")
    return frozenset(words)
