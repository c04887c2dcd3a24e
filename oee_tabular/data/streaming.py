"""Logs larger than memory: files streamed to counts, one by one or in several processes, and gone on with after a stop.

A file is counted by itself, and the files' counts are added in their order: serial, processes and cluster give the same bits.
What was counted so far is written beside the result, whole or not at all, with a checksum and the files that it has: a run
that was stopped, however, goes on without counting a file twice.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _files, _workers
from oee_tabular._checks import Column
from oee_tabular.data import parts as files
from oee_tabular.data import tally
from oee_tabular.data.counted import Recording, TransitionCounts, holds_counts, sealed, unsealed
from oee_tabular.data.readers import LARGEST, Limits
from oee_tabular.data.sampling import Sample
from oee_tabular.data.tally import Counted
from oee_tabular.data.transitions import Transitions
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.naming import Name

PARTIAL = "transition_counts_partial"
SHARE = 0.1  # of the time that may go to writing down what was counted so far
SECONDS = 2.0  # between two such writings, at least


def count_log(
    path: files.Paths,
    *,
    simulator: FiniteMDP | None = None,
    n_states: int | None = None,
    n_actions: int | None = None,
    bad_rows: str = "refuse",
    kept_moves: int = 200_000,
    output: str | os.PathLike[str] | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: bool = False,
) -> TransitionCounts:
    """Count the moves of files of any size, in memory of the size of the counts; ``Transitions.open`` explains the rest."""
    if isinstance(path, str | os.PathLike) and holds_counts(path):
        return TransitionCounts.load(path)
    _checks.one_of(bad_rows, "bad_rows", ("refuse", "drop"))
    sizes, drops = _sizes(simulator, n_states, n_actions), bad_rows == "drop"
    limits = Limits(*sizes, drops, _checks.positive_integer(kept_moves, "kept_moves"))
    if simulator is not None:
        limits = limits._replace(state_names=simulator.state_names, action_names=simulator.action_names)
    given = (("state", limits.state_names), ("action", limits.action_names), ("next_state", limits.state_names))
    parts = files.found(path, [label for label, names in given if names is not None])
    if jobs != -1:
        _checks.positive_integer(jobs, "jobs")
    names = {files.plain_name(part, parts): part for part in parts}
    run = Run(names, limits, None if output is None else _files.local(output))
    run.resume()
    left = {name: part for name, part in names.items() if name not in run.done}
    calls = ((part, name, limits, int(run.sample.most), run.largest) for name, part in left.items())
    results = _workers.each(tally.count_part, calls, len(left), jobs=jobs, dask=dask)
    try:
        for name, found in zip(left, _shown(results, len(names), len(run.done), progress), strict=True):
            run.add(name, found)
    except BaseException:
        run.write()
        raise
    return run.finish()


def _sizes(simulator: FiniteMDP | None, n_states: int | None, n_actions: int | None) -> tuple[int, int]:
    """From which numbers on states and actions are bad."""
    if simulator is not None:
        _checks.instance(simulator, FiniteMDP, "simulator")
        if n_states is not None or n_actions is not None:
            raise ValueError("n_states and n_actions must be left out where simulator is given, which has its own")
        return simulator.n_states, simulator.n_actions
    states, actions = (
        LARGEST if size is None else _checks.positive_integer(size, name)
        for size, name in ((n_states, "n_states"), (n_actions, "n_actions"))
    )
    return states, actions


def _shown(results: Iterator[Any], total: int, done: int, progress: bool) -> Iterator[Any]:
    from tqdm import tqdm

    return iter(tqdm(results, total=total, initial=done, desc="counting", unit="file", disable=not progress))


@dataclass
class Run:
    """What was counted so far: the files' names with what they are known by, and their sums."""

    parts: dict[str, files.Part]
    limits: Limits
    output: str | None
    done: dict[str, str] = field(default_factory=dict)
    total: Counted | None = None

    def __post_init__(self) -> None:
        self.partial = None if self.output is None else f"{self.output.removesuffix('.npz')}.partial.npz"
        self.moves = tally.Growing()
        self.largest = 0  # different moves of a file
        self.sample, self.sampled = Sample(self.limits.kept), 0
        self.fresh, self.written, self.pause = False, time.monotonic(), SECONDS

    def add(self, name: str, found: Counted) -> None:
        """The counts of one more file."""
        self.moves.add(tally.rows_of(found.key, found.sums))
        self.largest = max(self.largest, len(found.key))
        self.total = _added(self.total, found)
        self._keep(found.sample, found.most)
        self.done[name] = files.fingerprint(self.parts[name])
        self.fresh = True
        if self.partial is not None and time.monotonic() - self.written >= self.pause:
            self.write()

    def write(self) -> None:
        """Write down what was counted so far, if it is more than what is written."""
        if self.partial is None or self.total is None or not self.fresh:
            return
        begun = time.monotonic()
        key, sums = tally.in_order(*self.moves.contents())
        arrays: dict[str, Column] = {
            "key": key,
            "sums": sums,
            "facts": self.total.facts,
            "told": np.array(
                json.dumps({"files": self.done, "settings": self._settings(), "reasons": self.total.reasons})
            ),
            "flags": np.array([self.total.rewarded, self.total.by_episodes]),
        }
        arrays |= {f"sample_{name}": column for name, column in self.sample.columns().items()}
        arrays["most"] = np.array(self.sample.most, dtype=np.uint64)
        _files.save_npz(self.partial, PARTIAL, sealed(arrays))
        self.fresh, self.written = False, time.monotonic()
        self.pause = max(SECONDS, (self.written - begun) / SHARE)

    def resume(self) -> None:
        """Go on where a run with the same settings was stopped; ValueError where its files are gone or others."""
        if self.partial is None or not os.path.exists(self.partial):
            return
        arrays = _files.load_npz(self.partial, PARTIAL)
        begin = f"; delete {self.partial!r} to begin again"
        with _files.parts_of(self.partial, "a count that was stopped"):
            arrays = unsealed(arrays)
            told = json.loads(str(arrays["told"]))
        if told["settings"] != self._settings():
            raise ValueError(
                f"settings must be those of the count that was stopped, {told['settings']}; they are {self._settings()}{begin}"
            )
        if not self.limits.drop and told["reasons"]:
            raise ValueError(f"bad_rows must be 'drop', as before the stop; it is 'refuse'{begin}")
        for name, known in told["files"].items():
            if name not in self.parts:
                raise ValueError(f"path must have the files that were counted before the stop; {name!r} is gone{begin}")
            if files.fingerprint(self.parts[name]) != known:
                raise ValueError(f"{self.parts[name].name!r} must be as it was counted; it has changed since{begin}")
        self.done = dict(told["files"])
        self.moves.add(tally.rows_of(arrays["key"], arrays["sums"]))
        sample = {name.removeprefix("sample_"): column for name, column in arrays.items() if name.startswith("sample_")}
        rewarded, by_episodes = (bool(flag) for flag in arrays["flags"])
        self.total = Counted(
            arrays["key"][:0], arrays["sums"][:0], arrays["facts"], tuple(told["reasons"]), rewarded, by_episodes, {}, 0
        )  # fmt: skip
        self._keep(sample, int(arrays["most"]))

    def _keep(self, rows: dict[str, Column], most: int) -> None:
        """Episodes of one more file, numbered on: they stay in the order of the files."""
        self.sample.most = min(self.sample.most, np.uint64(most))
        if rows:
            self.sample.add(rows | {"ordinal": rows["ordinal"] + self.sampled})
            self.sampled += int(rows["ordinal"].max(initial=-1)) + 1

    def finish(self) -> TransitionCounts:
        """The counts of all files, written where they are to be."""
        assert self.total is not None
        key, sums = tally.in_order(*self.moves.contents())
        if not len(key):
            raise ValueError(f"path must have at least one good row; of {len(self.parts)} files none has")
        found = _as_counts(key, sums, self.total, self.sample.columns())
        if self.output is not None:
            found.save(self.output)
        if self.partial is not None:
            Path(self.partial).unlink(missing_ok=True)
        return found

    def _settings(self) -> dict[str, Any]:
        """Those that files were counted under; a file without bad rows is counted alike whether they are dropped or not."""
        limits = self.limits
        found: dict[str, Any] = {"states": limits.states, "actions": limits.actions, "kept": limits.kept}
        names = {"state_names": limits.state_names, "action_names": limits.action_names}
        return found | {name: _digest(given) for name, given in names.items() if given is not None}


def _digest(names: tuple[Name, ...]) -> str:
    return hashlib.sha256(json.dumps(names).encode()).hexdigest()


def _added(total: Counted | None, found: Counted) -> Counted:
    """The facts of two; moves and samples are added elsewhere."""
    own = found._replace(key=found.key[:0], sums=found.sums[:0], sample={})
    if total is None:
        return own
    facts = total.facts + found.facts
    lengths = np.array([total.facts[tally.SHORTEST], found.facts[tally.SHORTEST]])
    facts[tally.SHORTEST] = lengths[lengths > 0].min() if lengths.any() else 0
    facts[tally.LONGEST] = max(total.facts[tally.LONGEST], found.facts[tally.LONGEST])
    return total._replace(facts=facts, reasons=(*total.reasons, *found.reasons)[: tally.REASONS])


def _as_counts(
    key: NDArray[np.int64], sums: NDArray[np.float64], total: Counted, kept: dict[str, Any]
) -> TransitionCounts:
    facts = [int(fact) for fact in total.facts]
    recording = Recording(
        total.by_episodes,
        facts[tally.EPISODES],
        facts[tally.SHORTEST],
        facts[tally.LONGEST],
        facts[tally.TRUNCATED],
        facts[tally.BROKEN],
        facts[tally.FILES],
        facts[tally.DROPPED],
        total.reasons,
    )
    rewards: dict[str, Any] = {}
    if total.rewarded:
        rewards = {name: sums[:, k].copy() for k, name in enumerate(("reward_sum", "reward_min", "reward_max"), 1)}
    sample = None
    if kept and len(kept["ordinal"]):
        columns = {name: column for name, column in kept.items() if name not in ("key", "ordinal")}
        episode = np.cumsum(np.diff(kept["ordinal"], prepend=kept["ordinal"][0]) != 0)
        sample = Transitions(**columns, episode=episode)
    return TransitionCounts(
        key[:, 0].copy(), key[:, 1].copy(), key[:, 2].copy(), sums[:, 0].copy(), key[:, 3] == 1, **rewards,
        recording=recording, sample=sample,
    )  # fmt: skip
