"""Logged transitions of the target: loaded, checked, counted, saved.

A log is n transitions (s_i, a_i, s'_i), with what a recording may add, a column each,
(n,)::

    state, action, next_state   integers from 0, or names, which are matched to a
                                simulator's
    reward                      r_i, finite; nan if it is missing, and no column if all
                                are
    terminated                  the transition ended the task: all later rewards are 0
    truncated                   it ended the recording alone: the task would have
                                continued
    episode, timestep           rows of an episode are consecutive, t = 0, 1, ...;
                                s'_i = s_(i+1) inside of it
    behavior_probability        mu(a_i | s_i), in [0, 1]

Without episodes transitions are independent, and their states need not follow an MDP's
initial distribution. Estimates use their counts alone, (S*A, S), row s*A + a
(``log.counts(n_states, n_actions)``)::

    n(s, a, s') = #{i: s_i = s, a_i = a, s'_i = s'}
    n_gamma(s, a, s') = sum_i gamma^t_i [s_i = s, a_i = a, s'_i = s']
    rbar(s, a, s') = sum_i r_i / #{i with a reward}

n_gamma, with ``discount``, is the paper's discounted d, times n; rbar is taken over the
transitions that have a reward. Counts, with rewards, are sufficient for values, ratios,
tests and intervals. ``Transitions.open`` makes them of files of any size, in the memory
of the counts, with a sample of whole episodes for importance sampling.

- ``transitions.py``, ``columns.py``: the class ``Transitions``, and what every log has
- ``frames.py``: data frames of any library (narwhals), episodes as lists of steps,
  names, Minari data sets
- ``labels.py``: which column of a file or a frame is which column of a log;
  ``aliases.py``: what other projects call them
- ``rules.py``: what each column must hold, for arrays, tables and counts
- ``files.py``: npz, and which files a path, a pattern or a folder names
- ``tables.py``: CSV and parquet, in pieces
- ``counts.py``: the class ``TransitionCounts``; ``sums.py``: sums over the transitions
  of each (s, a, s')
- ``counting.py``: one file as counts; ``opening.py``: several, and whatever a log may
  be given as
- ``trials.py``: whole runs of a policy of which only the outcome was written

Guaranteed: a file is read by one thread in the order of its rows, and files are added
in the order of their names, so that one process, several and a cluster give the same
bits. An npz or a parquet file that was saved here carries a digest, and is refused
where it does not fit. An error names the file, the column, the row, the rule and the
value. Nothing is fetched.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from oee_tabular.data.counts import TransitionCounts
from oee_tabular.data.opening import has_labels as has_labels
from oee_tabular.data.opening import open_log
from oee_tabular.data.opening import read_log as read_log
from oee_tabular.data.transitions import Transitions
from oee_tabular.data.trials import Trials, success_simulator
from oee_tabular.data.trials import holds_trials as holds_trials
from oee_tabular.data.trials import require_fit as require_fit
from oee_tabular.data.trials import success_states as success_states

if TYPE_CHECKING:
    from oee_tabular.continuous import ContinuousTransitions


# here, for counts are made of logs: logs need not know how they are counted
Transitions.open = staticmethod(open_log)

__all__ = [
    "ContinuousTransitions",
    "TransitionCounts",
    "Transitions",
    "Trials",
    "success_simulator",
]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module("oee_tabular.continuous"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *globals()})
