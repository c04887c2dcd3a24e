"""Labels of tables: which column of a file or a frame holds which column of a log.

What ``columns`` says comes first, then a log's own labels, then those of other projects
(``aliases.py``). A label that may mean two things, or that resembles one of a log's, is
refused where a log would lose something without it.
"""

from __future__ import annotations

import difflib
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

from oee_tabular import _checks
from oee_tabular.data.aliases import (
    DOUBTS,
    END,
    FIELDS,
    NUMBERED,
    OTHER_WORDS,
    Doubt,
    find_field,
    find_near_label,
    plain,
    stem,
)
from oee_tabular.data.rules import COLUMNS, MOVE, as_objects, is_absent
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp import is_number_text
from oee_tabular.typing import Column

# what a file calls a log's columns; several labels make a name or a vector, and None
# stands for no column
ColumnsLike: TypeAlias = Mapping[str, Any]

MAX_SHOWN_COLUMNS = 10  # of those that are left out
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}


class Matching(NamedTuple):
    """Hold which labels of a table hold which columns of a log.

    ``taken``: the labels of each column, several where they make a name. ``renamed``:
    the columns that were found by labels of other projects. ``left_out``: labels that
    hold no column.
    """

    taken: dict[str, tuple[Any, ...]]
    renamed: tuple[tuple[Any, str], ...] = ()
    left_out: tuple[Any, ...] = ()

    def to_read(self) -> list[str]:
        """Return the labels, as ``rename`` gives them, of the columns that are read."""
        parts = [part for group in self.taken.values() for part in self.rename(group)]
        return list(dict.fromkeys(parts))

    def fields(self) -> dict[Any, str]:
        """Return the column of a log that each label holds by itself."""
        return {
            group[0]: field for field, group in self.taken.items() if len(group) == 1
        }

    def rename(self, labels: Iterable[Any]) -> list[str]:
        """Return labels of a file as a log's where each is a whole column of it.

        Others are not taken for a log's own.
        """
        whole = self.fields()
        return [
            whole.get(label, f"\0{label}" if stem(label) in COLUMNS else label)
            for label in labels
        ]

    def join(self, columns: Mapping[str, Column]) -> dict[str, Column]:
        """Return the columns of a log of raw ones, under the labels of ``rename``."""
        joined = {}
        for field, group in self.taken.items():
            parts = [columns[label] for label in self.rename(group)]
            joined[field] = parts[0]
            if len(parts) > 1:
                joined[field] = join_parts([_as_parts(part) for part in parts])
        return joined


def join_parts(columns: Sequence[list[Any]]) -> Column:
    """Return the tuples of several columns' values, None where one is missing."""
    rows = zip(*columns, strict=True)
    return as_objects([None if any(map(is_absent, row)) else row for row in rows])


def _as_parts(column: Column) -> list[Any]:
    """Return the values of one part of a name; what reads as an integer is one."""
    parts = []
    for item in column.tolist():
        part = item
        if isinstance(part, str) and is_number_text(part):
            part = int(part) if part.strip().isdecimal() else float(part)
        is_whole = isinstance(part, float) and part.is_integer()
        parts.append(int(part) if is_whole else part)
    return parts


def match_labels(
    labels: Iterable[Any],
    name: str,
    columns: ColumnsLike,
    require: Callable[[list[Any], dict[str, tuple[Any, ...]]], None],
    *,
    has_vectors: bool = False,
    has_capitals: bool = False,
) -> Matching:
    """Find the columns of a log among the labels of a table.

    Parameters
    ----------
    labels : iterable
        The labels, in their order.
    name : str
        What errors call the table.
    columns : mapping
        What the table calls a log's columns, as ``check_columns`` returns it.
    require : callable
        Raises an error where, of these labels, those of a log's columns that were found
        are not enough.
    has_vectors : bool, default False
        Whether states are vectors, state_0, state_1, ...
    has_capitals : bool, default False
        Whether two labels may differ by capitals alone.

    Returns
    -------
    Matching
        The columns in the order of the labels.

    Raises
    ------
    ValueError
        If the table lacks a label of ``columns``, has one twice, lacks a required
        column, or has a label of which it is not clear what it holds.
    """
    given = list(labels)
    absent = {field for field, group in columns.items() if group is None}
    taken = {
        field: _find_group(field, group, given, name)
        for field, group in columns.items()
        if group is not None
    }
    _require_distinct_labels(taken)
    used = {label for group in taken.values() for label in group}
    # a part of a name, but not of a vector, may be a column as well
    whole = {group[0] for group in taken.values() if len(group) == 1}
    own = [
        label
        for label in dict.fromkeys(given)
        if label not in (used if has_vectors else whole) and _is_own(label, has_vectors)
    ]
    free = [label for label in dict.fromkeys(given) if label not in used]
    if has_vectors:
        taken = _number_vectors(taken)
    for label in own:
        if label not in taken and label not in absent:
            taken[label] = (label,)
    held = {stem(field) for field in taken} | absent
    candidates: dict[str, list[Any]] = {}
    for label in free:
        field = find_field(label, has_vectors)
        if field is not None and label not in own and stem(field) not in held:
            candidates.setdefault(field, []).append(label)
    found = [label for group in candidates.values() for label in group]
    read = [label for group in taken.values() for label in group]
    _require_labels_once([*read, *found], given, name, has_capitals=has_capitals)
    renamed = [
        (choose_label(field, group, name), field) for field, group in candidates.items()
    ]
    taken |= {field: (label,) for label, field in renamed}
    place = {label: k for k, label in reversed(list(enumerate(given)))}
    taken = dict(sorted(taken.items(), key=lambda item: place[item[1][0]]))
    require(given, taken)
    used = {label for group in taken.values() for label in group}
    left = [label for label in dict.fromkeys(given) if label not in used]
    if not {"state", "next_state"} <= set(columns):
        _refuse_mixture(taken, left, name)
    known = {stem(field) for field in taken} | absent
    for label in left:
        # 0 alone has the sizes of pandas' groups; with 1 it is one of many columns
        if label not in (0, "0") or {1, "1"}.isdisjoint(left):
            refuse_doubt(label, known, name)
    noted = [label for label in left if label not in absent]
    return Matching(taken, tuple(renamed), tuple(noted))


def check_columns(
    columns: object, *, name: str = "columns", has_vectors: bool = False
) -> dict[str, Any]:
    """Check a user's names for a log's columns and return them; None means no names.

    Several labels are a tuple.
    """
    if columns is None:
        return {}
    if not isinstance(columns, Mapping):
        raise ArgumentError(
            name,
            "must be a mapping from a log's columns to those of the file, {'state':"
            f" 'pose_before'}}; it is {_checks.show(columns)}",
        )
    for field, label in columns.items():
        is_known = isinstance(field, str) and (
            field in COLUMNS or (has_vectors and NUMBERED.fullmatch(field))
        )
        if is_known and label is None and stem(field) in MOVE:
            raise ArgumentError(name, f"must name a column for {field}; it is None")
        if is_known:
            continue
        known = (*COLUMNS, "state_0", "next_state_0") if has_vectors else COLUMNS
        hint = suggest(field, known)
        near = difflib.get_close_matches(str(field)[:80], known, n=1)
        if isinstance(label, str) and label in known and near in ([], [label]):
            hint = f" (the other way round: {{{label!r}: {_checks.show(field)}}})"
        raise ArgumentError(
            name,
            f"must have keys of {', '.join(known)}; got {_checks.show(field)}{hint}",
        )
    return dict(columns)


def _find_group(
    field: str, named: Any, labels: list[Any], name: str
) -> tuple[Any, ...]:
    """Return the labels that ``columns`` names for a column; all must be there."""
    is_whole = is_label(named, labels)
    is_several = isinstance(named, list | tuple)
    group = tuple(named) if is_several and not is_whole else (named,)
    if is_whole and is_several and all(is_label(part, labels) for part in named):
        raise ArgumentError(
            "columns",
            f"must be clear; for {field}, {name} has the column {_checks.show(named)},"
            f" and each of {', '.join(map(_checks.show, named))} as well",
        )
    for label in group:
        if not is_label(label, labels):
            hint = suggest_label(label, labels)
            if isinstance(label, str):
                hint = suggest_columns([plain(label)], labels) or hint
            raise ArgumentError(
                "columns",
                f"must name columns of {name}, which are {show_labels(labels)}; for"
                f" {field} it names {_checks.show(label)}{hint}",
            )
    if (
        not group
        or (len(group) > 1 and stem(field) not in MOVE)
        or (len(group) > 1 and stem(field) != field)
    ):
        raise ArgumentError(
            "columns",
            f"must name one column for {field}; it names {_checks.show(named)}",
        )
    return tuple(labels[labels.index(label)] for label in group)


def is_label(label: Any, labels: list[Any]) -> bool:
    """Return whether a label is one of these; one that cannot be compared is not."""
    try:
        return label in labels and not isinstance(label, list)
    except (TypeError, ValueError, RecursionError):
        return False


def _number_vectors(taken: dict[str, tuple[Any, ...]]) -> dict[str, tuple[Any, ...]]:
    """Return the labels of each coordinate where several make a vector."""
    numbered: dict[str, tuple[Any, ...]] = {}
    for field, group in taken.items():
        parts = {field: group}
        if len(group) > 1:
            parts = {f"{field}_{k}": (label,) for k, label in enumerate(group)}
        twice = next((part for part in parts if part in numbered), None)
        if twice is not None:
            raise ArgumentError("columns", f"must name {twice} once; it is named twice")
        numbered |= parts
    return numbered


def _require_distinct_labels(taken: dict[str, tuple[Any, ...]]) -> None:
    """Raise an ArgumentError where one label is named for two columns.

    Names and vectors may share a part, such as a goal that does not change.
    """
    first_of: dict[Any, str] = {}
    for field, group in taken.items():
        if len(group) > 1 or stem(field) != field:
            continue
        label = group[0]
        if label in first_of:
            raise ArgumentError(
                "columns",
                f"must name each column once; {_checks.show(label)} is named for"
                f" {first_of[label]} and {field}",
            )
        first_of[label] = field
    for label, field in first_of.items():
        if label in MOVE and label not in map(stem, taken):
            raise ArgumentError(
                "columns",
                f"must name a column for {label} as well; it names"
                f" {_checks.show(label)} for {field}",
            )


def _require_labels_once(
    chosen: Sequence[Any], labels: list[Any], name: str, *, has_capitals: bool
) -> None:
    """Raise an ArgumentError where a label that is read stands twice.

    DuckDB does not tell capitals.
    """

    def fold(label: Any) -> Any:
        """Return a label in lower case."""
        is_plain = has_capitals or not isinstance(label, str)
        return label if is_plain else label.lower()

    number = Counter(map(fold, labels))
    for label in chosen:
        if number[fold(label)] > 1:
            one, other, *_ = (each for each in labels if fold(each) == fold(label))
            both = f"{_checks.show(one)} and {_checks.show(other)}"
            if one == other:
                both = f"{_checks.show(one)} twice"
            raise ArgumentError(name, f"must have columns that differ; it has {both}")


def _is_own(label: Any, has_vectors: bool) -> bool:
    """Return whether a label is one of a log's own."""
    if not isinstance(label, str):
        return False
    return label in COLUMNS or (has_vectors and NUMBERED.fullmatch(label) is not None)


def choose_label(field: str, group: list[Any], name: str) -> Any:
    """Return a column's only label, or the one that is a log's own but for capitals."""
    same = [label for label in group if plain(label) == field]
    if len(group) == 1 or len(same) == 1:
        return (same or group)[0]
    raise ArgumentError(
        name,
        f"must have one column of {field}; {' and '.join(map(_checks.show, group[:5]))}"
        f" may each hold it (say which: {show_way({field: group[0]})})",
    )


def _refuse_mixture(
    taken: dict[str, tuple[Any, ...]], left: list[Any], name: str
) -> None:
    """Refuse a state and a next state of which one is observed and one true."""
    groups = [taken.get("state", ()), taken.get("next_state", ())]
    is_observed = {
        "obs" in plain(label) or plain(label) == "ob"
        for group in groups
        for label in group
    }
    others = [label for label in left if find_field(label, False) in MOVE[::2]]
    if len(is_observed) > 1 and others and all(len(group) == 1 for group in groups):
        state, following = (group[0] for group in groups)
        shown = (
            f"'state': {_checks.show(state)}, 'next_state': {_checks.show(following)}"
        )
        option = ""
        if isinstance(state, str) and isinstance(following, str):
            words = (f"state={state:.80}", f"next_state={following:.80}")
            option = "".join(
                f", --column {_checks.escape_controls(shlex.quote(word))}"
                for word in words
            )
        raise ArgumentError(
            name,
            f"must have a state and a next state of one kind; they are"
            f" {_checks.show(state)} and {_checks.show(following)}, beside"
            f" {_checks.show(others[0])} (name both: columns={{{shown}}}{option})",
        )


def refuse_doubt(label: Any, known: set[str], name: str) -> None:
    """Raise an ArgumentError for an unread label that may hold a part of the log."""
    text = plain(label)
    if isinstance(label, int) and not isinstance(label, bool):
        text = str(label)  # 0, as pandas calls the sizes of its groups
    doubt = DOUBTS.get(text)
    if doubt is None:
        if text in OTHER_WORDS or text in FIELDS:
            return
        absent = [field for field in COLUMNS if field not in known]
        near = difflib.get_close_matches(text[:80], absent, n=1, cutoff=0.8)
        near += [field for field in absent if sorted(field) == sorted(text)]
        if near:
            doubt = Doubt((near[0],), f"resembles {near[0]}", (frozenset(near[:1]),))
        else:
            doubt = _doubt_of_misspelt(text)
        if doubt is None:
            return
    if any(fields <= known for fields in doubt.settled_by):
        return
    meaning = doubt.meaning.replace("LABEL", _checks.show(label))
    fields = [field for field in doubt.fields if field not in known]
    if doubt is END and "truncated" in known:
        meaning = (
            "may say that the task ended (terminated), or be true where it was"
            " truncated as well: then write a column terminated, true where this one"
            " is and truncated is not"
        )
    ways = ", or ".join(show_way({field: label}) for field in fields)
    out = dict.fromkeys(sorted(doubt.settled_by[0] - known))
    words = " ".join(f"--column {field}=" for field in out)
    to_read = f"to read it: {ways}; " if ways else ""
    raise ArgumentError(
        name,
        f"must have columns whose meaning is clear; {_checks.show(label)} {meaning}"
        f" ({to_read}to leave it out: columns={out}, {words})",
    )


def _doubt_of_misspelt(text: str) -> Doubt | None:
    """Return the doubt about a label that misspells another project's, or None."""
    meant = find_near_label(text[:80])
    if meant is None:
        return None
    doubt = DOUBTS.get(meant)
    if doubt is not None:
        return doubt._replace(meaning=f"resembles {meant}, which {doubt.meaning}")
    field = stem(FIELDS[meant])
    meaning = f"resembles {meant}, a label of {field}"
    return Doubt((field,), meaning, (frozenset({field}),))


def show_way(columns: Mapping[str, Any]) -> str:
    """Return how to name columns of a log in Python and in the command."""
    shown = ", ".join(
        f"{field!r}: {_checks.show(label)}" for field, label in columns.items()
    )
    way = f"columns={{{shown}}}"
    if all(isinstance(label, str) for label in columns.values()):
        words = (f"{field}={label:.80}" for field, label in columns.items())
        options = " ".join(f"--column {shlex.quote(word)}" for word in words)
        way += f", {_checks.escape_controls(options)}"
    return way


def show_labels(labels: Sequence[Any]) -> str:
    """Return labels in words, at most 300 characters of them."""
    texts = [_text_of(label) for label in labels[:1000]]
    return _checks.escape_controls(", ".join(texts)[:300]) or "none"


def _text_of(label: Any) -> str:
    """Return a label as text, whose own texts may raise anything.

    The index that pandas writes to a file has an empty label, which no reader sees.
    """
    if isinstance(label, str):
        return label if label.strip() else "a column without a name"
    return _checks.show(label)


def suggest_label(label: Any, labels: Sequence[Any]) -> str:
    """Return the label of a table that was probably meant, in words, or nothing."""
    texts = {_text_of(each)[:80]: each for each in labels[:1000]}
    own = _text_of(label)
    near = difflib.get_close_matches(own[:80], list(texts), n=1, cutoff=0.7)
    if not near:
        lower = {text.lower(): text for text in texts}
        near = [lower[text] for text in (own.lower(),) if text in lower]
    return f" (did you mean {_checks.show(texts[near[0]])}?)" if near else ""


def require_columns(
    name: str,
    required: Sequence[str],
    labels: Iterable[Any],
    *,
    taken: Iterable[str] | None = None,
) -> None:
    """Raise an ArgumentError where a required column is missing.

    It has the separator or the spelling that was probably meant. ``taken``: the columns
    that were found among the labels, where these are those of a log.
    """
    given = list(labels)
    found = given if taken is None else list(taken)
    missing = [field for field in required if field not in found]
    if not missing:
        return
    hint = suggest_columns(required, given)
    if not hint and taken is not None and given:
        free = [label for label in given if plain(label) not in found]
        way = show_way(_guess_labels(missing[:MAX_SHOWN_COLUMNS], free))
        held = "it" if len(missing) == 1 else "each"
        hint = f" (say which column holds {held}: {way})"
    raise ArgumentError(
        name,
        f"must have the columns {', '.join(required)}; it has"
        f" {show_labels(given)}{hint}",
    )


def _guess_labels(fields: Iterable[str], labels: Iterable[Any]) -> dict[str, Any]:
    """Return the label that is nearest to each field, or LABEL."""
    free = {plain(label): label for label in labels}
    guesses = {}
    for field in fields:
        near = difflib.get_close_matches(field, list(free), n=1, cutoff=0.7)
        guesses[field] = free.pop(near[0]) if near else "LABEL"
    return guesses


def suggest_columns(required: Sequence[str], labels: Sequence[Any]) -> str:
    """Suggest what to change: the separator, or how a label is written.

    Empty where that cannot be said.
    """
    first = labels[0] if labels and isinstance(labels[0], str) else ""
    for mark, word in SEPARATORS.items():
        if mark in first and {plain(part) for part in first.split(mark)} & set(
            required
        ):
            decimal = ", decimal=','" if mark == ";" else ""
            return (
                f": its fields must be separated by commas; they are by {word} (in"
                f" Python: pandas.read_csv(path, sep={mark!r}{decimal})"
                ".to_csv('new.csv', index=False))"
            )
    written = {
        label: plain(label)
        for label in labels
        if plain(label) in required and plain(label) not in labels
    }
    return "".join(
        f"; write {column} for {_checks.show(label)}"
        for label, column in written.items()
    )


def warn_read_as(
    name: str,
    renamed: Iterable[tuple[Any, str]],
    option: str = " (columns=, --column name other columns)",
    of: str = "log",
) -> None:
    """Warn of columns that are read by labels of other projects, in one sentence.

    ``option`` says how to name others; ``of`` is what has these columns.
    """
    words = [f"{_checks.show(label)} as {field}" for label, field in renamed]
    if len(words) > MAX_SHOWN_COLUMNS:
        words[MAX_SHOWN_COLUMNS:] = [f"and {len(words) - MAX_SHOWN_COLUMNS} more"]
    if words:
        _checks.warn(
            f"{name} has other labels than a {of}: it reads {', '.join(words)}{option}",
            DataWarning,
        )


def warn_left_out(name: str, left_out: Sequence[Any], of: str = "log") -> None:
    """Warn of columns that are not read, of a log or of another table."""
    if not left_out:
        return
    named = [
        _checks.escape_controls(_text_of(label)[:80])
        for label in left_out[:MAX_SHOWN_COLUMNS]
    ]
    if len(left_out) > MAX_SHOWN_COLUMNS:
        named.append(f"and {len(left_out) - MAX_SHOWN_COLUMNS} more")
    _checks.warn(
        f"columns of {name} that a {of} does not use are left out: {', '.join(named)}",
        DataWarning,
    )


def suggest(label: object, known: Sequence[str], *, quotes: bool = False) -> str:
    """Suggest what was probably meant, in words; empty where nothing is near."""
    text = label if isinstance(label, str) else _checks.show(label)
    near = difflib.get_close_matches(text[:80], known, n=1)
    if not near:
        return ""
    return f" (did you mean {near[0]!r}?)" if quotes else f" (did you mean {near[0]}?)"
