"""Logged transitions: checked, counted, loaded and saved."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

from oee_tabular.data.counted import TransitionCounts
from oee_tabular.data.parts import Paths
from oee_tabular.data.transitions import Transitions

if TYPE_CHECKING:
    from oee_tabular.continuous.log import ContinuousTransitions


def _open(path: Paths, **options: Any) -> TransitionCounts:
    """Count a log of any size, in memory of the size of its counts: what ``Problem`` takes where no log fits.

    Parameters
    ----------
    path : file (.parquet, .csv, .npz), folder (with all inside, ``column=value`` folders as columns), pattern, or a list
    simulator : FiniteMDP, optional: whose states and actions there are, others are bad; where it has names, so may the log
    n_states, n_actions : int, optional, in its place: states and actions from there on are bad
    bad_rows : "refuse" | "drop": raise for the first row that is none of a log, or leave such rows out and count them;
        a row that is left out breaks its episode, whose other moves are still counted
    kept_moves : int, 200 000: whole episodes of so many moves are kept for importance sampling, drawn uniformly
    output : .npz to write the counts to; beside it stands what was counted when the run is stopped, and the same call goes
        on from there
    jobs : processes on this machine, -1: one a core; dask : address of a scheduler whose workers see the files
    progress : whether to show a bar

    Raises
    ------
    ValueError
        Names the file, the row or the column, the rule and what was found: files that are no tables, have other columns
        than the first, or rows that are none of a log, where they are refused. An episode stands in one file.
    OSError
        A file that is not there; no scheduler at the address.

    Notes
    -----
    Cost: O(rows); memory of the different moves, of a batch of 131 072 rows (CSV: 8 MiB), and of what is kept. Serial,
    processes and cluster give the same bits. Names of episodes that do not grow by 1 take 24 bytes an episode.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> for k in range(2):
    ...     Transitions([0, 1], [0, 0], [1, 2], episode=[0, 0]).save(folder / f"part-{k}.csv")
    >>> Transitions.open(folder)
    TransitionCounts(4 transitions, 2 different, of 2 files in 2 episodes of 2 steps: 0 terminated, 2 truncated;
                     states 0..2, actions 0..0; 2 whole episodes kept)
    """
    from oee_tabular.data.streaming import count_log

    return count_log(path, **options)


Transitions.open = staticmethod(_open)  # here, for counts are made of logs: logs need not know how they are counted


def read_log(source: Any, simulator: Any, name: str = "log") -> Transitions | TransitionCounts:
    """What was recorded, in the simulator's numbers, of whatever form it has.

    ``source``: Transitions, counts, a data frame, episodes as lists of steps, a path, or a list of paths, a pattern or a
    folder. ``name``: what errors call it.
    """
    from oee_tabular.data.counted import holds_counts
    from oee_tabular.data.transitions import as_log

    if isinstance(source, TransitionCounts):
        return source
    if isinstance(source, str | os.PathLike) and holds_counts(source):
        return TransitionCounts.load(source)
    return as_log(source, simulator, name)


__all__ = ["ContinuousTransitions", "TransitionCounts", "Transitions"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module("oee_tabular.continuous"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()})
