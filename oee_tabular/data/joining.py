"""Episodes that are cut where a file ends and go on in the next one.

Writers of part files, of a folder a day and the like cut a log where they like. The
last episode of a file and the first of the next are one where they have one id and
nothing speaks against it: the last row there is neither terminated nor truncated, its
next_state is the state of the first row here, and the timestep, if there is one, goes
on. Otherwise they are two, which is told where it is a guess. It is told as well where
they are one by their states alone, in folders ``column=value`` that differ: ids may
restart in each.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular.data.aliases import find_field
from oee_tabular.data.copies import Namesakes, Overlaps, Reordered, print_of
from oee_tabular.data.rules import ORDER_WAY, settle_episodes
from oee_tabular.data.tables import LogFile, describe_row
from oee_tabular.exceptions import ArgumentError, DataWarning
from oee_tabular.mdp import check_names
from oee_tabular.typing import BoolArray, Column

TIMESTEP = "timestep[0]"
JOINED = "read as one, as its states go on"  # of a note on two files that are joined


class Row(NamedTuple):
    """Hold the first or the last row of a file, by the labels of its columns.

    ``is_sound`` is False where a row next to the file's end is bad or lost.
    """

    path: str
    values: Mapping[str, Any]
    is_sound: bool = True


class Source(NamedTuple):
    """Hold a file of a log of several files, and its number of rows."""

    path: str
    n_rows: int

    def place(self, row: int) -> str:
        """Return the place of a row of the file in words: its line in a CSV file."""
        if LogFile(self.path).suffix == ".csv":
            # the file may be gone, or another one, by now
            with suppress(OSError, ValueError):
                return describe_row(self.path, row)
        return f"row {row}"


class Verdict(NamedTuple):
    """Hold whether two rows belong to one episode, with a note and a fault.

    ``note`` says what speaks against it, ``fault`` what is wrong in either case.
    """

    is_one: bool
    note: str = ""
    fault: str = ""


def judge(
    last: Row | None,
    first: Row,
    differs: Callable[[Any, Any], Any] = np.not_equal,
    show: Callable[[Any], Any] = str,
) -> Verdict:
    """Decide whether the last row of a file and the first of the next are one episode.

    ``differs`` and ``show`` compare and print states.
    """
    here = first.values
    step = here.get("timestep")
    starts = f"must be 0 (steps of an episode in order from 0); it is {step}"
    late = Verdict(is_one=False)
    if step is not None and step != 0 and first.is_sound:
        fault = f"{starts} (an episode that another file begins? Give the files in the"
        late = Verdict(is_one=False, fault=f"{fault} order in which they were written)")
    if last is None or str(last.values["episode"]) != str(here["episode"]):
        return late
    there = last.values
    over = [label for label in ("terminated", "truncated") if there.get(label)]
    if over:
        if late.fault:
            reason = f"its last row in {last.path!r} is {over[0]}"
            return late._replace(fault=f"{starts} ({reason})")
        return late
    going_on = Verdict(is_one=True, note=_doubt_of_folders(last, first))
    if not (last.is_sound and first.is_sound):
        return going_on
    before = there.get("timestep")
    against = ""
    if np.any(differs(there["next_state"], here["state"])):
        against = (
            f"its next_state there, {show(there['next_state'])}, is not its state"
            f" here, {show(here['state'])}"
        )
    if step is not None and before is not None and step != before + 1:
        against = f"its timestep there is {before} and here {step}"
        if step != 0:
            fault = (
                f"must be {before + 1}, where it goes on from {last.path!r}, or 0, where"
                f" it begins; it is {step}"
            )
            return Verdict(is_one=False, fault=fault)
    if against and late.fault:
        return late._replace(fault=f"{starts} ({against}, in {last.path!r})")
    if not against:
        # a timestep that goes on says itself that the ids did not restart
        return Verdict(is_one=True) if step is not None else going_on
    note = (
        f"episode {_checks.show(here['episode'])} ends {last.path!r} and begins"
        f" {first.path!r}; they are two, since {against}"
    )
    return Verdict(is_one=False, note=note)


def _doubt_of_folders(last: Row, first: Row) -> str:
    """Return what speaks against one episode where its files' folders differ.

    Ids may restart in each folder ``column=value``, as of each agent; empty where the
    folders are the same.
    """
    steps = [re.split(r"[\\/]", row.path)[:-1] for row in (last, first)]
    there, here = ([step for step in some if "=" in step] for some in steps)
    others = [step for step in here if step not in there]
    others += [step for step in there if step not in here]
    if not others:
        return ""
    label = _checks.escape_controls(others[0].partition("=")[0][:80])
    return (
        f"episode {_checks.show(first.values['episode'])} ends {last.path!r} and begins"
        f" {first.path!r}; they are {JOINED}, although the folders differ in {label}"
    )


def warn_of(notes: Sequence[str]) -> None:
    """Warn of episodes that were not joined, and of those that may be two."""
    joined = [note for note in notes if JOINED in note]
    others = [note for note in notes if JOINED not in note]
    for some, way in (
        (others, ", or give the files in the order in which they were written"),
        (joined, " or folder, so that they are unique"),
    ):
        if some:
            more = _checks.in_all(len(some), "such places")
            _checks.warn(
                f"{some[0]}{more}; write the file's name before ids that restart in"
                f" each file{way}",
                DataWarning,
            )


class SameColumns:
    """Refuse files that have other columns of a log than the first.

    Rewards may be missing in some.
    """

    OF_ORDER = frozenset({"timestep", "truncated"})

    def __init__(self) -> None:
        self.path = ""
        self.known: frozenset[str] | None = None
        self.is_derived = False

    def add(self, path: str, known: Iterable[str], *, is_derived: bool = False) -> None:
        """Raise an ArgumentError where the file of this path has other columns.

        ``is_derived``: whether its timesteps and truncations may follow from the order
        of its rows, and are nothing that another file lacks.
        """
        own = frozenset(known)
        if self.known is None:
            self.path, self.known, self.is_derived = path, own, is_derived
        free = {"reward"}
        if is_derived or self.is_derived:
            free |= self.OF_ORDER
        differ = sorted((self.known ^ own) - free)
        if not differ:
            return
        has, lacks = self.path, path
        if differ[0] in own:
            has, lacks = path, self.path
        raise ArgumentError(
            "all files",
            f"must have the same columns; {has!r} has {differ[0]!r}, and {lacks!r} does"
            f" not (to read them without it: columns={{{differ[0]!r}: None}}, --column"
            f" {differ[0]}=)",
        )


class Folders:
    """Remember in which folders ``column=value`` the episodes of a log stand.

    A writer that makes such folders keeps no order of the rows between them.
    """

    def __init__(self) -> None:
        self.found: dict[str, tuple[tuple[str, str], ...]] = {}

    def add(
        self,
        file: LogFile,
        known: Iterable[str],
        episodes: Iterable[Any],
        named: Mapping[str, str],
    ) -> None:
        """Raise an ArgumentError where an episode stands in another folder as well.

        ``known``: a log's columns. ``named``: those of the labels that were given.
        """
        folder = _parting_folders(file, known, named)
        if not folder:
            return
        for episode in episodes:
            other = self.found.setdefault(str(episode), folder)
            if other != folder:
                names = [
                    "/".join(f"{label}={text}" for label, text in one)
                    for one in (other, folder)
                ]
                raise ArgumentError(
                    f"{file.path!r}: episode",
                    "must have all rows of an episode in one folder, in their order;"
                    f" {_checks.show(episode)} stands in {names[0]!r} and"
                    f" {names[1]!r} (write the log without folders by"
                    f" {folder[0][0]}, or make ids of episodes unique by file)",
                )


def _parting_folders(
    file: LogFile, known: Iterable[str], named: Mapping[str, str]
) -> tuple[tuple[str, str], ...]:
    """Return the folders that name a column of a log other than the episode.

    ``known``: a log's columns. A folder may have another project's label of one, or one
    that was ``named``.
    """
    columns = set(known) - {"episode"}
    return tuple(
        (label, text)
        for label, text in file.fixed
        if (named.get(label) or find_field(label, has_vectors=False) or label)
        in columns
    )


def order_hint(file: LogFile, known: Iterable[str], named: Mapping[str, str]) -> str:
    """Return a hint for rows of an episode that do not follow each other.

    Empty where the file stands in no folder that names a column. ``named``: the columns
    of labels that were given.
    """
    folder = _parting_folders(file, known, named)
    if not folder:
        return ""
    return (
        f" (folders by {folder[0][0]} part the rows of an episode: write the log without"
        " them)"
    )


def join_logs(
    cls: Any,
    found: Sequence[LogFile],
    parts: Iterable[dict[str, Column]],
    warn_of_empty_files: Callable[[Sequence[str], int], None],
    columns_of: Mapping[str, Any],
) -> Any:
    """Return the log of the columns of several files, in their order.

    ``cls`` is the class of the log. ``warn_of_empty_files`` is told which have no rows,
    and the number of all. ``columns_of``: what the files call a log's columns. Files
    without rows are passed over, where others have some.

    Raises an ArgumentError where files have other columns than the first.
    """
    logs: list[Any] = []
    is_one: list[bool] = []
    shifts: list[int] = []
    notes: list[str] = []
    folders = Folders()
    namesakes = Namesakes(found)
    overlaps = Overlaps()
    same_columns = SameColumns()
    named = {
        label: field for field, label in columns_of.items() if isinstance(label, str)
    }
    empty: list[str] = []
    last = None
    for file, columns in zip(found, parts, strict=True):
        # an npz of ours says itself where its episodes end, and is not checked so far
        is_table = file.suffix in (".csv", ".parquet")
        n = len(columns["state"]) if is_table else 1
        if not n and len(found) > 1 and (logs or file is not found[-1]):
            empty.append(file.path)
            continue
        same_columns.add(file.path, columns, is_derived=file.suffix == ".npz")
        if len(found) > 1:
            namesakes.add(file.path, columns)
            overlaps.add(file.path, print_of(columns))
        verdict = Verdict(is_one=False)
        shift = 0
        if "episode" in columns and n and is_table:
            if file.fixed:
                names = np.unique(columns["episode"].astype(str)).tolist()
                folders.add(file, columns, names, named)
            row = Row(file.path, _row(columns, 0))
            if last is not None:
                verdict = judge(last, row, _differs(cls))
                notes += [verdict.note] if verdict.note else []
            if verdict.fault:
                raise ArgumentError(f"{file.path!r}: {TIMESTEP}", verdict.fault)
            last = Row(file.path, _row(columns, -1))
        else:
            last = None
        if verdict.is_one and "timestep" in columns:
            shift = int(columns["timestep"][0])
            columns["timestep"] = _move_first(columns, -shift)
        if is_table and "episode" in columns:
            columns["episode"] = settle_episodes(columns["episode"])
        with _files.parts_of(file.path, "a log"):
            try:
                logs.append(cls(**columns))
            except ArgumentError as error:
                hint = ""
                if n and "episode" in columns:
                    hint = order_hint(file, columns, named)
                    if is_table and not hint and not cls.FILES.has_vectors:
                        hint = ORDER_WAY
                raise ArgumentError(error.argument, error.rule + hint) from None
        is_one.append(verdict.is_one)
        shifts.append(shift)
    warn_of(notes)
    overlaps.warn()
    warn_of_empty_files(empty, len(found))
    if len(logs) == 1:
        return logs[0]
    without_rows = set(empty)
    paths = [file.path for file in found if file.path not in without_rows]
    reordered = Reordered()
    reordered.add_logs(paths, logs)
    reordered.warn(overlaps.found)
    _require_one_kind(paths, logs)
    _require_different_looks(paths, logs)

    def call(k: int) -> str:
        """Return what warnings call the k-th log."""
        return repr(paths[k])

    whole = cls._concatenate(logs, call)
    if any(is_one):
        whole = _join(cls, whole, logs, is_one)
    sources = zip(paths, map(len, logs), strict=True)
    object.__setattr__(whole, "_sources", tuple(Source(*each) for each in sources))
    return whole


def _require_different_looks(paths: Sequence[str], logs: Sequence[Any]) -> None:
    """Raise an ArgumentError where names of two files differ, and look alike."""
    for label in ("state", "action"):
        owner: dict[Any, int] = {}
        for k, log in enumerate(logs):
            for name in getattr(log, f"{label}_names", None) or ():
                owner.setdefault(name, k)
        if owner:
            place_of = partial(_place_of_name, paths, logs, label, list(owner.items()))
            check_names(list(owner), f"{label}s", len(owner), place_of)


def _place_of_name(
    paths: Sequence[str],
    logs: Sequence[Any],
    label: str,
    owners: Sequence[tuple[Any, int]],
    place: int,
) -> str:
    """Return the file and the row in which the name at a place stands first.

    ``owners`` has the names, each with the number of its first log.
    """
    name, k = owners[place]
    log = logs[k]
    code = getattr(log, f"{label}_names").index(name)
    is_there = getattr(log, label) == code
    if label == "state":
        is_there = is_there | (log.next_state == code)
    row = int(np.flatnonzero(is_there)[0])
    return f"{paths[k]!r}: {Source(paths[k], len(log)).place(row)}"


def _require_one_kind(paths: Sequence[str], logs: Sequence[Any]) -> None:
    """Raise an ArgumentError where some files have names and others have numbers."""
    for label in ("state", "action"):
        names = [getattr(log, f"{label}_names", None) for log in logs]
        is_named = [some is not None for some in names]
        if all(is_named) or not any(is_named):
            continue
        of_names = is_named.index(True)
        of_numbers = is_named.index(False)
        name = (names[of_names] or ("",))[0]
        raise ArgumentError(
            "all files",
            f"must have names as {label}, or numbers; {paths[of_names]!r} has"
            f" {_checks.show(name)}, and {paths[of_numbers]!r} has"
            f" {getattr(logs[of_numbers], label)[0]} (rename them in one of the two)",
        )


def _differs(cls: Any) -> Callable[[Any, Any], Any]:
    """Return the function by which a log of a class compares two states."""

    def differs(following: Any, state: Any) -> Any:
        """Return whether a next state and the state after it differ."""
        if isinstance(following, str | tuple) or isinstance(state, str | tuple):
            return following != state
        return cls._differs(np.asarray(following)[None], np.asarray(state)[None])

    return differs


def _row(columns: Mapping[str, Column], k: int) -> dict[str, Any]:
    """Return one row of columns."""
    row = {label: column[k] for label, column in columns.items()}
    return {
        label: value.item() if isinstance(value, np.generic) else value
        for label, value in row.items()
    }


def _is_first_run(columns: Mapping[str, Column]) -> BoolArray:
    """Return for each row whether it belongs to the first episode."""
    is_other = np.asarray(columns["episode"] != columns["episode"][0], dtype=np.bool_)
    return np.asarray(np.cumsum(is_other) == 0)


def _move_first(columns: Mapping[str, Column], shift: int) -> Column:
    """Return the timesteps, those of the first episode shifted."""
    return np.asarray(columns["timestep"] + shift * _is_first_run(columns))


def _join(cls: Any, whole: Any, logs: Sequence[Any], is_one: Sequence[bool]) -> Any:
    """Join the episodes that go on in the next log, of which ``whole`` has all rows."""
    if whole.episode is None:  # as another file has none
        return whole
    columns = whole.columns()
    episode = columns["episode"].copy()
    timestep = columns["timestep"].copy()
    truncated = columns["truncated"].copy()
    start = 0
    for log, goes_on in zip(logs, is_one, strict=True):
        if goes_on:
            stop = start + int(_is_first_run(log.columns()).sum())
            episode[start:stop] = episode[start - 1]
            timestep[start:stop] += timestep[start - 1] + 1
            truncated[start - 1] = False
        start += len(log)
    return cls(
        **columns | {"episode": episode, "timestep": timestep, "truncated": truncated}
    )
