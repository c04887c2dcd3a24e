"""Notes of a report as data, ranked by how much they change what a reader should do.

A short report shows the first few. A note that makes the value unusable goes before one
that says what the value rests on, and this one before explanations. Of two notes of one
kind the first alone is shown early, so that a kind does not push the others out.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from oee_tabular.inference import Interval
from oee_tabular.report import text
from oee_tabular.report.uncertainty import GUARANTEED

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

Pair = tuple[str, str]  # (policy, estimator)
# the kinds of notes that are no findings of an estimator or of the data
LEFT_OUT = "left out"
REMARK = "remark"
ASIDE = "aside"  # a finding about the data on which no model's value depends
UNRECORDED = "unrecorded"
TRIALS = "trials"
INTERVAL = "interval"
ENDS = "ends"  # of an interval that is guaranteed, or whose search was stopped
SIMULATOR = "simulator"
NEXT = "next"
MISSING = "missing"
LEGEND = "legend"
LOG = "log"  # what the reader of a log warned of


class Rank(IntEnum):
    """Say how much a note changes what a reader should do; the least goes first."""

    UNUSABLE = 0
    DATA = 1
    UNRECORDED = 2
    VALUE = 3
    TRIALS = 4
    SIMULATOR = 5
    NEXT = 6
    INTERVAL = 7
    OTHER = 8
    ROWS = 9
    REMARK = 10
    LEGEND = 11


# the kind of a note -> its rank; others are ``OTHER``
RANKS = {
    "status": Rank.UNUSABLE,
    "impossible": Rank.DATA,
    "unread": Rank.DATA,
    "dropped": Rank.DATA,
    "first states": Rank.DATA,
    "rewards": Rank.DATA,
    "support": Rank.DATA,
    UNRECORDED: Rank.UNRECORDED,
    "against": Rank.VALUE,
    "selected": Rank.VALUE,
    "outside": Rank.VALUE,
    "truncation": Rank.VALUE,
    "linear algebra": Rank.VALUE,
    ENDS: Rank.VALUE,
    TRIALS: Rank.TRIALS,
    SIMULATOR: Rank.SIMULATOR,
    NEXT: Rank.NEXT,
    INTERVAL: Rank.INTERVAL,
    MISSING: Rank.SIMULATOR,
    LEFT_OUT: Rank.REMARK,
    "sample": Rank.REMARK,
    "sampled": Rank.REMARK,
    "behavior": Rank.REMARK,
    LOG: Rank.REMARK,
    REMARK: Rank.REMARK,
    LEGEND: Rank.LEGEND,
}


@dataclass(frozen=True)
class Note:
    """Hold a sentence of a report that stands below its table.

    Attributes
    ----------
    text : str
        The sentences.
    kind : str
        The kind, such as that of a finding; notes of one kind have one rank.
    rank : Rank
        How much the note changes what a reader should do.
    pairs : frozenset of (policy, estimator)
        The rows of the table that it is about; empty if about none in particular.
    """

    text: str
    kind: str
    rank: Rank
    pairs: frozenset[Pair] = frozenset()


def rank_notes(report: Report) -> list[Note]:
    """Return every note of a report, the one that a reader needs first at the front."""
    notes = [
        *_from_warnings(report),
        *_about_policies(report),
        *_about_simulator(report),
    ]
    notes += [_make(LEGEND, sentence) for sentence in report.legend(report.rows())]
    ordered = sorted(notes, key=lambda note: note.rank)
    seen: Counter[str] = Counter()
    places = []
    for place, note in enumerate(ordered):
        # the second of a kind waits until every kind that matters has had its turn
        waits = seen[note.kind] > 0 and note.rank > Rank.DATA
        places.append((max(note.rank, Rank.OTHER) if waits else note.rank, place))
        seen[note.kind] += 1
    return [ordered[place] for _, place in sorted(places)]


def _make(kind: str, sentence: str) -> Note:
    """Return a note about no row in particular."""
    return Note(sentence, kind, RANKS.get(kind, Rank.OTHER))


def _from_warnings(report: Report) -> list[Note]:
    """Return the warnings of a report as notes.

    One that is only about rows that are not stated first changes no decision.
    """
    stated = {(answer.policy, answer.estimator) for answer in report.answers}
    notes = []
    for k, sentence in enumerate(report.warnings):
        kind = report.kinds[k] if k < len(report.kinds) else ""
        rows = (pair for pair, numbers in report.notes.items() if k + 1 in numbers)
        pairs = frozenset(rows)
        rank = RANKS.get(kind, Rank.OTHER)
        if pairs and not pairs & stated:
            rank = max(rank, Rank.ROWS)
        notes.append(Note(sentence, kind, rank, pairs))
    return notes


def _about_policies(report: Report) -> list[Note]:
    """Return what the intervals of policies assume, the least recorded policy first."""
    found = report.uncertainty
    is_single = len(report.answers) == 1

    def unrecorded(policy: str) -> float:
        """Return the share of a policy's time in unrecorded pairs, 0 if unknown."""
        estimate = found.default.get(policy)
        coverage = None if estimate is None else estimate.diagnostics.get("coverage")
        return 0.0 if coverage is None else 1.0 - float(coverage)

    notes = []
    for policy in sorted(found.policies, key=unrecorded, reverse=True):
        assumption = found.assumptions.get(policy, "")
        sentence = found.policies[policy]
        kind = INTERVAL
        intervals = found.intervals.get(policy, {}).values()
        if any(has_other_ends(one) for one in intervals):
            kind = ENDS
        if policy in found.trials:
            # the answer already says what trials and log say that contradict each other
            kind = REMARK if found.trials[policy].is_contradicted else TRIALS
        if is_single and assumption:
            notes.append(_make(UNRECORDED, assumption))
        elif assumption:
            kind = UNRECORDED
        if sentence:
            named = sentence if is_single else f"{policy}: {sentence}"
            notes.append(_make(kind, named))
    return notes


def has_other_ends(one: Interval) -> bool:
    """Say whether an interval was asked for, or is only known from inside."""
    return one.method == GUARANTEED or "stopped_after" in one.diagnostics


def _about_simulator(report: Report) -> list[Note]:
    """Return how far the simulator is from the target, and what to record next."""
    found = report.uncertainty
    notes = [_make(SIMULATOR, sentence) for sentence in found.distance[:1]]
    notes += [_make(MISSING, sentence) for sentence in found.distance[1:]]
    if found.next:
        notes.append(_make(NEXT, found.next))
    rows = report.comparison()
    if rows and any(row["probability_best"] is None for row in rows):
        notes.append(_make(REMARK, text.NO_P_BEST))
    return notes
