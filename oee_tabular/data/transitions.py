"""A log of transitions (s, a, s'), with the rest of what a recording may hold.

Episodes are ragged: a flat table with an episode number for each row, never padded. A *terminated* transition ends the
task (nothing is paid afterwards); a *truncated* one ends the recording only, and the task would have gone on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from oee_tabular import _checks, _printing
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import canonical
from oee_tabular.data import files
from oee_tabular.data.columns import Log, integers

if TYPE_CHECKING:
    from oee_tabular.data.counted import TransitionCounts


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Transitions(Log):
    """Logged moves of the target environment, one a row; checked when made and immutable.

    Parameters
    ----------
    state, action, next_state : (n,) integers from 0
    reward : (n,) finite numbers, optional
    terminated : (n,) booleans, optional
        The move ended the task. Default: none did.
    episode : (n,) integers, optional
        Rows of one episode stand together, in order; each row's next_state is the following row's state, and a
        terminated or truncated row is the last of its episode. Without it the rows are a bag of moves.
    timestep : (n,) integers from 0, optional
        t of each row; within an episode 0, 1, 2, ... (the default there).
    behavior_probability : (n,) numbers in [0, 1], optional
        Probability with which the behaviour policy took the recorded action.
    truncated : (n,) booleans, optional
        The recording stopped after this move although the task went on. Default: the last row of every episode that
        did not terminate.

    Raises
    ------
    ValueError
        Names the column, the row, the rule and the value found.

    Examples
    --------
    >>> log = Transitions([0, 1, 0], [0, 0, 1], [1, 2, 0], [0.0, 1.0, 0.0], terminated=[0, 1, 0], episode=[0, 0, 1])
    >>> log
    Transitions(3 transitions in 2 episodes of 1 to 2 steps: 1 terminated, 1 truncated;
                states 0..2, actions 0..1; rewards 0 to 1)
    """

    FILES: ClassVar[files.Format] = files.Format()

    state: IntArray
    action: IntArray
    next_state: IntArray

    @staticmethod
    def _moves(state: Any, action: Any, next_state: Any) -> dict[str, NDArray[Any] | None]:
        numbers = {"state": state, "action": action, "next_state": next_state}
        return {name: integers(column, name) for name, column in numbers.items()}

    @staticmethod
    def _apart(following: NDArray[Any], state: NDArray[Any]) -> BoolArray:
        return np.asarray(following != state)

    def __repr__(self) -> str:
        return f"Transitions({self.describe()})"

    def _repr_html_(self) -> str:
        rows = [(name.replace("_", " "), value) for name, value in self.summary().items() if value is not None]
        return _printing.facts("Transitions: a log", rows)

    @staticmethod
    def open(path: Any, **options: Any) -> TransitionCounts:
        """Count a log of any size, in memory of the size of its counts: what ``Problem`` takes where no log fits.

        Parameters
        ----------
        path : file (.parquet, .csv, .npz), folder (with all inside, ``column=value`` folders as columns), pattern, or a list
        n_states, n_actions : int, optional: states and actions from there on are bad
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
        TransitionCounts(4 transitions, 2 different, of 2 files in 2 episodes of 2 to 2 steps: 0 terminated, 2 truncated;
                         states 0..2, actions 0..0; 2 whole episodes kept)
        """
        from oee_tabular.data.streaming import count_log

        return count_log(path, **options)

    def counts(self, n_states: int, n_actions: int, *, discount: float | None = None) -> sparse.csr_array:
        """How often each (s, a, s') was seen: csr of shape (S*A, S), row s*A + a.

        With ``discount`` each move counts discount**timestep, the paper's discounted d (needs timesteps).
        Raises ValueError where a state or action is outside the given numbers.
        """
        weights = np.ones(len(self))
        if discount is not None:
            if self.timestep is None:
                raise ValueError("log must have timesteps (or episodes) to be counted with a discount; it has none")
            weights = _checks.number_in(discount, "discount", 0.0, 1.0) ** self.timestep.astype(np.float64)
        return counts_of(self, weights, n_states, n_actions)

    def moves(self) -> Moves:
        """Each row with the one move that it stands for and what it paid."""
        return Moves(np.ones(len(self)), self.reward, self.reward, self.reward)

    def led_to(self, next_state: IntArray) -> Transitions:
        """The same with other next states."""
        return Transitions(**(self.columns() | {"next_state": next_state}))

    @property
    def by_episodes(self) -> bool:
        """Whether moves may depend on those before them."""
        return self.episode is not None

    def summary(self) -> dict[str, Any]:
        """What the log holds, as plain numbers. Cost: O(n), or O(n log n) where the numbers are far above n."""
        states = np.concatenate([self.state, self.next_state])
        pairs = _numbered_pairs(self.state, self.action)
        return self._printed() | {"states_seen": _distinct(states), "state_action_pairs_seen": _distinct(pairs)}

    def _printed(self) -> dict[str, Any]:
        """The part of the summary that one line prints: a pass over each column, no sort."""
        starts = self.episode_starts
        lengths = None if starts is None else np.diff(starts)
        return {
            "transitions": len(self),
            "episodes": None if lengths is None else len(lengths),
            "episode_length_min": None if lengths is None else int(lengths.min()),
            "episode_length_max": None if lengths is None else int(lengths.max()),
            "terminated": int(self.terminated.sum()),
            "truncated": int(self.truncated.sum()),
            "states_seen": None,
            "largest_state": int(max(self.state.max(), self.next_state.max())),
            "largest_action": int(self.action.max()),
            "state_action_pairs_seen": None,
            "reward_min": None if self.reward is None else float(self.reward.min()),
            "reward_max": None if self.reward is None else float(self.reward.max()),
            "behavior_probability": self.behavior_probability is not None,
        }

    def describe(self) -> str:
        """The summary in one line."""
        facts = self._printed()
        text = f"{facts['transitions']} transitions"
        if facts["episodes"] is not None:
            text += f" in {facts['episodes']} episodes of {facts['episode_length_min']} to {facts['episode_length_max']} steps"
        text += f": {facts['terminated']} terminated, {facts['truncated']} truncated"
        text += f"; states 0..{facts['largest_state']}, actions 0..{facts['largest_action']}"
        if self.reward is not None:
            text += f"; rewards {facts['reward_min']:g} to {facts['reward_max']:g}"
        return text + ("; behaviour probabilities" if facts["behavior_probability"] else "")


class Moves(NamedTuple):
    """Of each row of a log: how many moves it stands for, the sum of their rewards, the least and the largest, (n,) each."""

    number: Array
    reward_sum: Array | None
    reward_min: Array | None
    reward_max: Array | None


def counts_of(log: Any, weights: Array, n_states: int, n_actions: int) -> sparse.csr_array:
    """The sums of the weights of the rows of each (s, a, s'): csr of shape (S*A, S); ValueError for numbers out of range."""
    _checks.positive_integer(n_states, "n_states")
    _checks.positive_integer(n_actions, "n_actions")
    _checks.require_memory(float(n_states) * n_actions, "n_states * n_actions", n_states * n_actions)
    for name, column, limit in (
        ("state", log.state, n_states),
        ("action", log.action, n_actions),
        ("next_state", log.next_state, n_states),
    ):
        bad = np.flatnonzero(column >= limit)
        if bad.size:
            given = "n_actions" if name == "action" else "n_states"
            raise ValueError(
                f"log.{name}[{bad[0]}] must be in 0..{limit - 1}; it is {column[bad[0]]} ({bad.size} such rows in all; "
                f"{given} is {limit})"
            )
    rows = log.state * n_actions + log.action
    matrix = sparse.csr_array((weights, (rows, log.next_state)), shape=(n_states * n_actions, n_states))
    return canonical(matrix, drop_zeros=True)


_SPARE = 8  # bytes of a table that counts, for each byte of the column: beyond it the column is sorted


def _numbered_pairs(state: IntArray, action: IntArray) -> IntArray:
    """One number for each different (s, a)."""
    width = int(action.max()) + 1
    if int(state.max()) < (_checks.LARGEST_INTEGER - width) // width:
        return state * width + action
    return np.unique(np.stack([state, action]), axis=1, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _distinct(numbers: IntArray) -> int:
    """How many different numbers there are: by a table where it is not much larger than the column, else by a sort.

    Measured at 10^7 numbers below 10^4, CPU time: the table takes 1/17 of the time of the sort.
    """
    if int(numbers.max()) < _SPARE * len(numbers):
        seen = np.zeros(int(numbers.max()) + 1, dtype=np.bool_)
        seen[numbers] = True
        return int(seen.sum())
    return len(np.unique(numbers))
