"""``check_estimator``: an estimator, ours or a user's, against the laws of estimators, with a verdict on each."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from oee_tabular import _checks, _printing
from oee_tabular._checks import Seed
from oee_tabular.testing import laws, manners
from oee_tabular.testing.calls import Broken, Subject, claims_of, name_of, one_thread
from oee_tabular.testing.cases import case


@dataclass(frozen=True)
class Law:
    """A law: who owes it (any of these claims; none: everybody) and how it is checked."""

    claims: frozenset[str]
    check: Callable[[Subject], str]

    @property
    def statement(self) -> str:
        """What it says."""
        return " ".join(inspect.getdoc(self.check).split("\n\n")[0].split())  # type: ignore[union-attr]


def _law(check: Callable[[Subject], str], *claims: str) -> Law:
    return Law(frozenset(claims), check)


LAWS: Mapping[str, Law] = {
    "well_formed": _law(manners.well_formed),
    "input_unchanged": _law(manners.input_unchanged),
    "reproducible": _law(manners.reproducible),
    "support": _law(manners.support),
    "limit": _law(laws.limit),
    "consistent": _law(laws.consistent, "consistent"),
    "ragged": _law(laws.ragged, "consistent"),
    "identical": _law(laws.identical, "consistent", "identical"),
    "unbiased": _law(laws.unbiased, "unbiased"),
    "relabelling": _law(laws.relabelling, "relabelling"),
    "scale": _law(laws.scale, "scale"),
    "shift": _law(laws.shift, "shift"),
    "padding": _law(laws.padding, "padding"),
    "after_end": _law(laws.after_end, "after_end"),
    "seeds": _law(laws.seeds),
}


@dataclass(frozen=True)
class Verdict:
    """What became of one law.

    Attributes
    ----------
    law : its name, a key of ``LAWS``
    outcome : "holds", "fails", "raises" or "not claimed"; of ``oee check`` also "exits" (the process ended) or "hangs"
    text : the numbers found
    example : how to see it again

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> verdict = check_estimator(Simulator(), claims=["consistent"], laws=["consistent"])["consistent"]
    >>> verdict.outcome, verdict.text
    ('fails', 'ragged: its limit is not J_target: 7.969194231, expected 10.06961735 (off by 2.1)')
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
        kept = ("holds", "not claimed")
        return tuple(law for law, verdict in self.verdicts.items() if verdict.outcome not in kept)

    def __getitem__(self, law: str) -> Verdict:
        return self.verdicts[law]

    def __iter__(self) -> Iterator[str]:
        return iter(self.verdicts)

    def __len__(self) -> int:
        return len(self.verdicts)

    def __str__(self) -> str:
        held = sum(verdict.outcome == "holds" for verdict in self.verdicts.values())
        idle = sum(verdict.outcome == "not claimed" for verdict in self.verdicts.values())
        summary = f"{held} {'law holds' if held == 1 else 'laws hold'}, {len(self.broken)} broken, {idle} not claimed"
        lines = [f"{self.estimator}: {'passed' if self.passed else 'NOT PASSED'} ({summary}; seed {self.seed})"]
        lines.append(f"claims: {', '.join(sorted(self.claims)) or 'none'}")
        for verdict in self.verdicts.values():
            texts = [verdict.text] if verdict.text else []
            if verdict.example and verdict.outcome != "holds":
                texts.append(f"see it: {verdict.example}")
            body = [line for text in texts for line in textwrap.wrap(text, 92)] or [""]
            lines.append(f"{verdict.law:16}{verdict.outcome:12}{body[0]}".rstrip())
            lines += [" " * 28 + line for line in body[1:]]
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
    estimator : callable (problem, policy, *, seed=None) -> Estimate
    seed : int of at least 0; the logs of the statistical laws come from it
    claims : words of ``CLAIMS``: which laws it should satisfy. None: ``estimator.claims``, a collection of words or a method
        that returns one; for the package's own estimators a table; otherwise ``DEFAULT`` (consistent, relabelling, scale)
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
    Every estimator owes well_formed, input_unchanged, reproducible and support, and limit where it has one. A right
    estimator fails a statistical law with a chance of about 1e-5 a comparison (unbiased: 1e-4); so a bias of less than some
    11 standard errors of the mean of 8 logs (3% of the value in these pairs) may pass; with 30 logs (``repetitions``) a
    quarter of that. An estimator that is a dataclass with a field ``n_rollouts`` is given more rollouts with more episodes
    where its limit is looked at. Cost: some 100 estimates (900 where it claims to be unbiased), of logs of up to 4800
    episodes.

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
    with one_thread():
        title, subject = subject_of(estimator, seed, repetitions, claims=claims, from_pair=from_pair)
        verdicts = {name: verdict_on(name, subject) for name in chosen}
    return Verdicts(title, subject.claims, seed, verdicts)


def check_numbers(seed: Seed, repetitions: object) -> None:
    """ValueError where they are not what ``check_estimator`` takes."""
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ValueError(f"seed must be an integer of at least 0; got {_checks.show(seed)}")
    if _checks.positive_integer(repetitions, "repetitions") < 3:
        raise ValueError(f"repetitions must be at least 3; it is {repetitions}")


def subject_of(
    estimator: Any, seed: int, repetitions: int, *, claims: Iterable[str] | None = None, from_pair: bool = False
) -> tuple[str, Subject]:
    """The estimator's name, and what the laws are checked on; ValueError where it is no estimator."""
    if not callable(estimator):
        raise ValueError(
            f"estimator must be callable as (problem, policy, *, seed=None); got {type(estimator).__name__}"
        )
    if from_pair:
        pair = case("ragged")
        try:
            first = estimator(pair.simulator, pair.target)
        except Exception as error:
            raise ValueError(
                f"estimator must be a function (simulator, target) -> estimator; it raises {error!r}"
            ) from error
        make = estimator
    else:
        first = estimator

        def make(simulator: Any, target: Any) -> Any:
            return estimator

    words = claims_of(first, claims)
    has_limit = callable(getattr(first, "limit", None))
    return name_of(first), Subject(make, words, seed, repetitions, from_pair, has_limit)


def verdict_on(name: str, subject: Subject) -> Verdict:
    """What becomes of one law."""
    law = LAWS[name]
    if name == "limit" and not subject.has_limit:
        return Verdict(name, "not claimed", "it has no limit of its own")
    if name == "seeds" and "random" in subject.claims:
        return Verdict(name, "not claimed", "it claims to be random")
    if law.claims and not law.claims & subject.claims:
        return Verdict(name, "not claimed", "")
    try:
        return Verdict(name, "holds", law.check(subject))
    except Broken as broken:
        return Verdict(name, broken.outcome, broken.text, broken.example)
