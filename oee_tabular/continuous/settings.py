"""How a continuous log is evaluated."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """How a continuous log is evaluated; what is None is the simulator's own.

    Attributes
    ----------
    grid : vertices along each feature; () for no cells
    outside : "error" | "nearest" | "drop", for states outside the grid; "drop" leaves out moves without support as well,
        however many (otherwise more than a hundredth leave out the rows on the grid)
    strict : an error, not a warning, for actions that are not in the task's set
    calibration : "ratio" | "difference" | "none"
    floor : defensive share, in [0, 1]
    episodes : of Monte Carlo, for each policy in the continuous simulator

    Examples
    --------
    >>> Settings(grid=(60, 60)).outside
    'error'
    """

    grid: tuple[int, ...] | None = None
    outside: str = "error"
    strict: bool = False
    calibration: str | None = None
    floor: float | None = None
    episodes: int | None = None
