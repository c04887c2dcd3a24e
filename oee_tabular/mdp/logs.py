"""What an MDP reads of a log; ``data``, which has the class of logs, stands above."""

from __future__ import annotations

from typing import Any, Protocol, Self

from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.naming import Name
from oee_tabular.typing import Array, BoolArray, IntArray


class LogLike(Protocol):
    """Describe the columns and names of a log, such as ``Transitions``."""

    @property
    def state(self) -> IntArray:
        """Return the (n,) states before the transitions."""

    @property
    def action(self) -> IntArray:
        """Return the (n,) actions."""

    @property
    def next_state(self) -> IntArray:
        """Return the (n,) states after the transitions."""

    @property
    def reward(self) -> Array | None:
        """Return the (n,) rewards, nan where one is missing; None without rewards."""

    @property
    def terminated(self) -> BoolArray:
        """Return whether each transition terminated its episode, (n,)."""

    @property
    def episode_starts(self) -> IntArray | None:
        """Return the row where each episode begins, and n; None without episodes."""

    @property
    def state_names(self) -> tuple[Name, ...] | None:
        """Return the names of the states; None where they are numbers."""

    @property
    def action_names(self) -> tuple[Name, ...] | None:
        """Return the names of the actions; None where they are numbers."""

    def numbered(self, simulator: Any, name: str = "log") -> Self:
        """Return the log in the numbers of a simulator's states and actions."""


def source_of_row(log: object, row: int) -> str:
    """Return the file of a row of a log of several files, and its place there.

    It is in parentheses, after a blank; empty where a log has one source.
    """
    describe = getattr(log, "_describe_source", None)
    return "" if describe is None else str(describe(row))


def require_log(log: object) -> None:
    """Raise an ArgumentError for what is no log."""
    is_class = isinstance(log, type)
    if is_class or not (hasattr(log, "numbered") and hasattr(log, "episode_starts")):
        hint = ""
        if hasattr(log, "columns") and not is_class:
            hint = " (of a data frame: Transitions.from_frame(log))"
        raise ArgumentError(
            "log", f"must be Transitions; got {type(log).__name__}{hint}"
        )
