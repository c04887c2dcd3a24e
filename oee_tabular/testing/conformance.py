"""Check an estimator, ours or a user's, against the laws of estimators.

``check_module`` is ``oee check module:object``: the laws in a process of their own,
which may hang, exit or be killed. What happens to the process is a verdict like any
other.
"""

from __future__ import annotations

import inspect
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from oee_tabular import _checks
from oee_tabular._arguments import module_and_path, own_modules, own_object
from oee_tabular._isolation import call_in_worker, safe_children
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import end_with_parent
from oee_tabular._progress import report_finished
from oee_tabular.estimators import Simulator
from oee_tabular.estimators.functions import as_estimator
from oee_tabular.exceptions import ArgumentError
from oee_tabular.testing import laws
from oee_tabular.testing.cases import case
from oee_tabular.testing.subject import (
    Broken,
    NotClaimed,
    Subject,
    Verdict,
    Verdicts,
    claims_of,
    name_of,
    tolerance_of,
)


@dataclass(frozen=True)
class Law:
    """Hold how a law is checked, and which claims owe it; without claims all do."""

    check: Callable[[Subject], str]
    claims: frozenset[str]

    def is_claimed(self, claims: frozenset[str]) -> bool:
        """Return whether an estimator with these claims owes the law."""
        return not self.claims or bool(self.claims & claims)

    @property
    def statement(self) -> str:
        """Return what the law says, the first paragraph of its check."""
        return (inspect.getdoc(self.check) or "").split("\n\n")[0]


LAWS: Mapping[str, Law] = {
    check.__name__: Law(check, frozenset(claims.split()))
    for check, claims in (
        (laws.well_formed, ""),
        (laws.input_unchanged, ""),
        (laws.reproducible, ""),
        (laws.support, ""),
        (laws.exact, ""),
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
        (laws.seeds, ""),
    )
}


@suggest_keywords
def check_estimator(
    estimator: object,
    *,
    seed: int = 0,
    claims: Iterable[str] | None = None,
    laws: Iterable[str] | None = None,
    repetitions: int = 8,
    from_pair: bool = False,
    tolerance: float | None = None,
) -> Verdicts:
    """Run an estimator through the laws of estimators.

    They are checked on small pairs of environments that are known exactly.

    Parameters
    ----------
    estimator : callable or estimator
        A function (problem, policy) or (problem, policy, seed) that returns a float or
        an ``Estimate``; or a class or function that makes one without arguments.
    seed : int, default 0
        An integer of at least 0, from which the logs of the statistical laws come.
    claims : iterable of str, optional
        Words of ``CLAIMS``, which say what laws it should satisfy. None means
        ``estimator.claims``, a collection of words or a method that returns one;
        without it ``DEFAULT`` (consistent, relabelling, scale).
    laws : iterable of str, optional
        Names in ``LAWS``; None means all.
    repetitions : int, default 8
        Logs of each statistical comparison, at least 3.
    from_pair : bool, default False
        Whether ``estimator`` is a function (simulator, target) -> estimator, as for
        oracles.
    tolerance : float, optional
        By what share of the value it may be off on exact data (``exact``). None means
        ``estimator.tolerance``; without it 1e-6.

    Returns
    -------
    Verdicts
        ``passed``, ``broken`` and ``verdicts[law]``; it prints as a table. "holds" and
        "fails" come with their numbers, "raises" with the error; laws that are "not
        claimed" are not run.

    Raises
    ------
    ValueError
        If an argument is wrong. What the estimator does wrong is a verdict.

    See Also
    --------
    compare_with_oracle : Bias, variance and error of an estimator as numbers.

    Notes
    -----
    Every estimator owes well_formed, input_unchanged, reproducible and support, limit
    where it has one, and seeds unless it claims random. ``exact`` has no chance in it:
    it finds every bias above its tolerance (1e-6 of the value) that shows in its two
    cases, of an estimator that claims consistent or has a limit. A right estimator
    fails a statistical law with a chance of about 1e-5 a comparison (unbiased: 1e-4);
    so these laws alone let a bias of less than some 11 standard errors of the mean of 8
    logs (3% of the value in these pairs) pass; with 30 logs (``repetitions``) a quarter
    of that. An estimator that is a dataclass with a field ``n_rollouts`` is given more
    rollouts with more episodes where its limit is looked at. The cost is some 100
    estimates (900 where it claims to be unbiased), of logs of up to 4800 episodes.

    Examples
    --------
    >>> from oee_tabular.estimators import ModelBased
    >>> verdicts = check_estimator(ModelBased(), laws=["scale", "shift", "unbiased"])
    >>> verdicts.passed, verdicts["shift"].outcome, verdicts["unbiased"].outcome
    (True, 'holds', 'not claimed')
    """
    _checks.boolean(from_pair, "from_pair")
    chosen = list(LAWS)
    if laws is not None:
        chosen = list(_checks.collection(laws, "laws", "a list of names"))
    for name in chosen:
        _checks.one_of(name, "laws", tuple(LAWS))
    check_numbers(seed, repetitions)
    subject = make_subject(
        estimator,
        seed,
        repetitions,
        claims=claims,
        from_pair=from_pair,
        tolerance=tolerance,
    )
    return Verdicts(
        subject.name,
        subject.claims,
        seed,
        {name: check_law(name, subject) for name in chosen},
    )


def check_numbers(seed: object, repetitions: object) -> None:
    """Refuse a seed or a number of repetitions that ``check_estimator`` cannot take."""
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise ArgumentError(
            "seed", f"must be an integer of at least 0; got {_checks.show(seed)}"
        )
    if _checks.positive_integer(repetitions, "repetitions") < 3:
        raise ArgumentError("repetitions", f"must be at least 3; it is {repetitions}")
    _checks.require_memory(
        float(repetitions),  # type: ignore[arg-type]
        "repetitions",
        repetitions,
        size=BYTES_OF_REPETITION,
    )


def make_subject(
    estimator: Any,
    seed: int,
    repetitions: int,
    *,
    claims: Iterable[str] | None = None,
    from_pair: bool = False,
    tolerance: float | None = None,
) -> Subject:
    """Return what the laws are checked on; refuse what is no estimator."""
    given = estimator
    if from_pair:
        _checks.function(estimator, "estimator")
        pair = case("ragged")
        try:
            given = estimator(pair.simulator, pair.target)
        except Exception as error:
            text = (
                "estimator must be a function (simulator, target) -> estimator; it"
                f" raises {error!r}"
            )
            raise ValueError(text) from error
    own = as_estimator(given).function
    make = estimator if from_pair else lambda simulator, target: own
    return Subject(
        name_of(own),
        make,
        claims_of(own, claims),
        seed,
        repetitions,
        is_oracle=from_pair,
        tolerance=tolerance_of(own, tolerance),
    )


def check_law(name: str, subject: Subject) -> Verdict:
    """Return the verdict on one law."""
    if not LAWS[name].is_claimed(subject.claims):
        return Verdict(name, "not claimed", "")
    seen = subject.seen
    seen.clear()
    try:
        text = LAWS[name].check(subject)
    except NotClaimed as idle:
        return Verdict(name, idle.outcome, idle.text)
    except Broken as broken:
        return Verdict(
            name, broken.outcome, broken.text, broken.example, seen.program()
        )
    tolerance = max(seen.tolerances, default=None)
    return Verdict(name, "holds", text, tolerance=tolerance)


# ---- in a process of its own

EXAMPLE = "my_package.mine:MyEstimator"
BYTES_OF_REPETITION = 10_800  # of the log of 150 episodes that it draws
MAX_TIMEOUT_SECONDS = 1e6  # operating systems wait for little more
# for compilation and import of this package, which are no fault of the estimator's
MAX_PREPARATION_SECONDS = 3600.0
MAX_HANGS = 3  # laws that may hang before the rest is left


def check_module(
    spec: str, *, seed: int = 0, repetitions: int = 8, timeout: float = 60.0
) -> Verdicts:
    """Import an estimator and check it, in a process of its own.

    It is imported from the current directory or from what is installed. A law that ends
    the process, or takes longer than ``timeout`` seconds, is broken; another process
    goes on with the next law, until three laws have hung: the others are then "not
    run".

    Parameters
    ----------
    spec : str
        "module:object"; the object is an estimator, a function (problem, policy) or
        (problem, policy, seed), or what makes one of these without arguments.
    seed : int, default 0
        As in ``check_estimator``.
    repetitions : int, default 8
        As in ``check_estimator``.
    timeout : float, default 60.0
        Seconds that a law may take, and the import.

    Returns
    -------
    Verdicts
        A verdict for each law.

    Raises
    ------
    ValueError
        If the spec has another form, the module cannot be imported (or ends the process
        or takes longer when it is), or the object is no estimator.
    """
    check_numbers(seed, repetitions)
    seconds = _checks.number_in(
        timeout, "timeout", 0.0, MAX_TIMEOUT_SECONDS, open_ends=True
    )
    module_and_path(spec, "the estimator", EXAMPLE)
    verdicts: dict[str, Verdict] = {}
    n_hangs = 0
    left = list(LAWS)
    while left and n_hangs < MAX_HANGS:
        with _process(spec, seed, repetitions, left) as answer:
            answer(MAX_PREPARATION_SECONDS)
            try:
                title, claims = answer(seconds)
            except Ended as ended:
                raise ValueError(f"{spec!r} cannot be imported: {ended.text}") from None
            for name in left:
                try:
                    verdicts[name] = answer(seconds)
                    report_finished(f"{name}: {verdicts[name].outcome}")
                except Ended as ended:
                    example = f"check_estimator(..., laws=[{name!r}], seed={seed})"
                    verdicts[name] = Verdict(name, ended.outcome, ended.text, example)
                    n_hangs += ended.outcome == "hangs"
                    break
        left = [name for name in LAWS if name not in verdicts]
    for name in left:
        if LAWS[name].is_claimed(claims):
            verdicts[name] = Verdict(name, "not run", f"{MAX_HANGS} laws hang")
        else:
            verdicts[name] = Verdict(name, "not claimed", "")
    return Verdicts(title, claims, seed, verdicts)


class Ended(Exception):
    """Report a process that gives no answer: an outcome, "exits" or "hangs", and how."""

    def __init__(self, outcome: str, text: str) -> None:
        super().__init__(text)
        self.outcome = outcome
        self.text = text


@contextmanager
def _process(
    spec: str, seed: int, repetitions: int, laws: list[str]
) -> Iterator[Callable[[float], Any]]:
    """Start a process that checks the laws; yield a function that waits for answers.

    The function takes seconds and returns the next answer, or raises ``Ended``. The
    process is killed on leaving.
    """
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    with safe_children() as inherited:
        process = context.Process(
            target=call_in_worker,
            args=(
                *(inherited(), __name__, _run.__name__),
                *(writer, spec, seed, repetitions, laws),
            ),
        )
        process.start()
    writer.close()

    def answer(seconds: float) -> Any:
        message: Any = ""
        end = time.monotonic() + seconds
        title = ""
        while isinstance(message, str):  # the title of a case that is begun
            title = f"{message}: " if message else ""
            if not reader.poll(max(end - time.monotonic(), 0.0)):
                raise Ended(
                    "hangs",
                    f"{title}no answer within {seconds:g} s (--timeout gives it more)",
                )
            try:
                message = reader.recv()
            except (EOFError, OSError):
                process.join(5.0)
                raise Ended(
                    "exits", f"{title}{_describe_end(process.exitcode)}"
                ) from None
        if isinstance(message, ValueError):
            raise message
        return message

    try:
        yield answer
    finally:
        # none left; on Windows, no groups
        with suppress(ProcessLookupError, PermissionError, AttributeError):
            # with those that it has started
            os.killpg(process.pid or 0, signal.SIGKILL)
        process.kill()
        process.join()
        process.close()
        reader.close()


def _describe_end(code: int | None) -> str:
    """Return how a process has ended, in words."""
    if code is None:
        return "the process closes its connection"
    if code >= 0:
        return f"the process ends, with exit code {code}"
    with suppress(ValueError):
        return f"the process is killed by {signal.Signals(-code).name}"
    return f"the process is killed by signal {-code}"


def _run(
    answers: Connection, spec: str, seed: int, repetitions: int, laws: list[str]
) -> None:
    """Check the laws inside the process, and send what is found.

    It sends that it is ready, what the estimator is (or why there is none), and each
    verdict.
    """
    if hasattr(os, "setsid"):
        os.setsid()  # a group, with what the estimator starts
    end_with_parent(os.getppid(), with_group=True)
    # compiles what laws need: the seconds are not the estimator's
    check_estimator(Simulator(), repetitions=3)
    answers.send(None)  # ready
    with own_modules():
        try:
            subject = make_subject(own_estimator(spec), seed, repetitions)
        except Exception as error:
            text = (
                str(error)
                if isinstance(error, ValueError)
                else f"{spec!r} raises {type(error).__name__}: {error}"
            )
            answers.send(ValueError(text))
            return
        answers.send((subject.name, subject.claims))
        for name in laws:
            answers.send(check_law(name, replace(subject, report=answers.send)))


def own_estimator(spec: str) -> Any:
    """Return the estimator of "module:object".

    A class or function there that makes one without arguments is called.
    """
    return as_estimator(own_object(spec, "the estimator", EXAMPLE), repr(spec)).function
