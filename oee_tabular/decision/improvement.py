"""The result of ``improve``: the best candidate, its gain, and the decision."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from oee_tabular import _checks, _files, _printing
from oee_tabular._results import checked
from oee_tabular.decision import views
from oee_tabular.design import Plan
from oee_tabular.exceptions import ArgumentError
from oee_tabular.report import check_page
from oee_tabular.typing import Array

Verdict: TypeAlias = Literal["deploy", "keep", "record"]


@checked(shapes={"policy": "S A"})
@dataclass(frozen=True, eq=False)
class Candidate:
    """A policy that may be deployed, with its gain over the running one.

    Attributes
    ----------
    name : str
        The name of the policy.
    policy : ndarray of shape (S, A)
        Its action probabilities.
    gain : float
        Its estimated gain, in the unit of J; nan where the default has no value.
    gain_lower : float
        The lower end of the gain; nan for a policy that was made from the log's own
        counts. The search for it is thorough for the candidate that the decision names
        and for those that might have the largest end. Other ends are from a short
        search, and a longer one may find a lower end.
    optimism : float
        What the lower end was lowered by, at least 0: how much better a policy that the
        log made looks in that log, by its halves. 0 for your own candidates.

    See Also
    --------
    improve : Compare the candidates.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> found = oee.improve(pair.problem(1000, seed=0), pair.behavior)
    >>> found.candidates[0].name, found.candidates[0].gain > 0
    ('corrected', True)
    """

    name: str
    policy: Array
    gain: float
    gain_lower: float
    optimism: float = 0.0


@checked(shapes={"policy": "S A", "running": "S A"}, levels=("confidence",))
@dataclass(frozen=True, eq=False)
class Improvement:
    """The decision between the running policy and candidates, with its numbers.

    Attributes
    ----------
    policy : ndarray of shape (S, A)
        The best candidate. It is to be deployed only where ``deploy`` is True.
    gain : float
        Its estimated gain over the running policy, a discounted sum of rewards.
    gain_lower : float
        The lower end of this gain at ``confidence``.
    decision : {'deploy', 'keep', 'record'}
        "deploy" where ``gain_lower`` is above 0. "record" where the gain is above 0 and
        more transitions can decide. "keep" otherwise: no candidate is better.
    candidates : tuple of Candidate
        All candidates, yours first.
    plan : Plan or None
        What to record for the gain, where ``decision`` is "record".
    name : str
        The name of the best candidate.
    running : ndarray of shape (S, A)
        The policy that runs.
    confidence : float
        The level of the interval for the gain, in (0, 1).
    unrecorded : float
        The factor by which unrecorded pairs may differ from the estimate.
    split : float or None
        The share of the log that chose; the rest certifies. None: all of it did both.
    seed : int or None
        The seed of the split, by which it is drawn again.
    deploy : bool
        Whether the candidate is to be deployed.

    See Also
    --------
    improve : Make the decision.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> found = oee.improve(pair.problem(1000, seed=0), pair.behavior)
    >>> found.decision, found.name
    ('deploy', 'corrected')
    """

    policy: Array
    gain: float
    gain_lower: float
    decision: Verdict
    candidates: tuple[Candidate, ...]
    plan: Plan | None
    name: str
    running: Array
    confidence: float
    unrecorded: float
    split: float | None = None
    seed: int | None = None

    def __post_init__(self) -> None:
        names = [each.name for each in self.candidates]
        _checks.one_of(self.name, "name", tuple(names))
        if len(set(names)) < len(names):
            raise ArgumentError(
                "candidates",
                f"must have names that differ; they are {_checks.show(names)}",
            )
        if (self.decision == "deploy") != (self.gain_lower > 0.0):
            raise ArgumentError(
                "decision",
                "must be 'deploy' where gain_lower is above 0, and only there; it is"
                f" {self.decision!r}, and gain_lower is {self.gain_lower:g}",
            )

    @property
    def deploy(self) -> bool:
        """Return whether the candidate is to be deployed."""
        return self.decision == "deploy"

    @property
    def sentence(self) -> str:
        """Return the decision in one sentence, with its numbers."""
        return views.write_sentence(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the decision as plain values.

        Returns
        -------
        dict
            Numbers, texts, lists and dicts.
        """
        return views.to_dict(self)

    def to_html(
        self, path: str | os.PathLike[str] | None = None, *, title: str | None = None
    ) -> str:
        """Write the decision as one self-contained page.

        Parameters
        ----------
        path : str or path, optional
            The .html or .htm file to write, which appears whole or not at all. None
            writes no file.
        title : str, optional
            The title of the page. None says what the decision is.

        Returns
        -------
        str
            The text of the page.

        Raises
        ------
        ValueError
            If the path cannot be written.
        """
        if title is not None:
            _checks.instance(title, str, "title", "string")
        file = None if path is None else check_page(path)
        page = views.render_page(self, title)
        if file is not None:
            _files.write_all(file.parent, {file.name: _files.text_bytes(page)})
        return page

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        return views.write_text(self)

    def _repr_html_(self) -> str:
        header, *rows = views.list_rows(self)
        return _printing.table(
            header, rows, caption=self.sentence, below=views.write_notes(self)
        )
