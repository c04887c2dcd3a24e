"""Two robots under one policy, in the simulator and in the target, as a GIF."""

from __future__ import annotations

import importlib.util
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.plots import style
from oee_tabular.plots.paths import cell_of_each, draw_cells, require_map
from oee_tabular.plots.slide_style import SLIDE_DPI, SLIDE_INCHES, has_slides
from oee_tabular.plots.style import COLORS, PAPER
from oee_tabular.typing import Array, PolicyLike, Seed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_INCHES = (6.4, 3.6)
DPI = 110
MAX_STEPS = 200
MAX_BYTES = 1_000_000
HOLD_SECONDS = 2.0  # for which the last picture stands


class Walk(NamedTuple):
    """Hold an episode: the points (x, y), (t + 1, 2), and the return at each."""

    points: Array
    returns: Array
    is_over: bool


@suggest_keywords
def animate_two(
    simulator: FiniteMDP,
    target: FiniteMDP,
    policy: PolicyLike,
    path: str | os.PathLike[str],
    *,
    seed: Seed,
    horizon: int = 40,
    frames_per_second: float = 4.0,
) -> Path:
    """Show one policy in the simulator and in the target, side by side, as a GIF.

    Each robot takes an episode of at most ``horizon`` steps, drawn with the same seed.
    Below it stand its step and the discounted sum of its rewards so far.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator, whose states lie on a grid (``map_of``).
    target : FiniteMDP
        The target, with the same states and actions.
    policy : array_like of shape (S, A), or one that ``policy_value`` takes
        The policy of both robots.
    path : str or path
        The .gif file, which is replaced if it is there. It appears whole or not at all.
    seed : int, Generator or SeedSequence
        Seed of both episodes; the same seed gives the same file.
    horizon : int, default 40
        The longest episode, from 1 to 200 steps. A step is a picture.
    frames_per_second : float, default 4
        Steps in a second, from 0.1 to 50.

    Returns
    -------
    Path
        The path of the file.

    Raises
    ------
    ValueError
        If the states lie on no grid, the two models have other states or actions, or
        the file would have more than 1 MB.
    ImportError
        If the package pillow is missing, with which matplotlib writes GIFs.

    See Also
    --------
    plot_paths : Draws whole episodes in one picture.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> grids = oee.tasks.gridworld(3, slip=0.0), oee.tasks.gridworld(3, slip=0.4)
    >>> expert = oee.tasks.gridworld_expert(3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = animate_two(*grids, expert, Path(folder) / "two.gif", seed=0)
    ...     file.read_bytes()[:6]
    b'GIF89a'
    """
    require_pillow()
    require_map(simulator, "simulator")
    _checks.instance(target, FiniteMDP, "target")
    for called, theirs, ours in (
        ("states", target.n_states, simulator.n_states),
        ("actions", target.n_actions, simulator.n_actions),
    ):
        if theirs != ours:
            raise ArgumentError(
                "target", f"must have the simulator's {ours} {called}; it has {theirs}"
            )
    pi = check_policy(policy, simulator)
    _files.require_ending(_files.local(path), (".gif",))
    n_steps = _checks.positive_integer(horizon, "horizon")
    if n_steps > MAX_STEPS:
        raise ArgumentError(
            "horizon",
            f"must be at most {MAX_STEPS}, one picture a step; it is {n_steps}",
        )
    speed = _checks.number_in(frames_per_second, "frames_per_second", 0.1, 50.0)
    # the same stream for both: a SeedSequence or a Generator would go on
    word = int(_checks.generator(seed).integers(2**63))
    walks = [walk(mdp, simulator, pi, n_steps, word) for mdp in (simulator, target)]
    content = _gif(simulator, walks, speed)
    if len(content) > MAX_BYTES:
        raise ArgumentError(
            "horizon",
            f"must be small enough for a GIF of at most 1 MB; at {n_steps} it has"
            f" {len(content) / 1e6:.1f} MB (pictures are smaller outside of slides())",
        )
    with _files.whole_file(path) as file:
        file.write(content)
    return Path(path)


def require_pillow() -> None:
    """Raise an ImportError that names pillow where it is missing."""
    if importlib.util.find_spec("PIL") is None:
        raise ImportError(
            "pillow is not installed, with which matplotlib writes GIFs: pip install"
            " pillow"
        )


def walk(
    mdp: FiniteMDP, simulator: FiniteMDP, policy: Array, horizon: int, seed: int
) -> Walk:
    """Sample an episode as points on the simulator's map, with the return so far."""
    # imports numba, which other pictures do without
    from oee_tabular.simulate import sample_episodes

    log = sample_episodes(mdp, policy, 1, horizon, seed=seed)
    places = require_map(simulator, "simulator")
    states = [*log.state, log.next_state[-1]]
    cell = cell_of_each(simulator, places)[states]
    row, column = np.divmod(cell, len(places.columns))
    reward = np.asarray(log.reward) * mdp.discount ** np.arange(len(log))
    return Walk(
        np.column_stack([column, row]) + 0.5,
        np.concatenate([[0.0], np.cumsum(reward)]),
        bool(mdp.absorbing()[states[-1]]),
    )


class Robot:
    """Draw a robot on a map: where it is, where it was, and its return.

    Parameters
    ----------
    ax : Axes
        The axes, on which the cells are drawn.
    walked : Walk
        Its episode.
    color : str
        Its colour.
    """

    def __init__(self, ax: Axes, walked: Walk, color: str):
        self.ax = ax
        self.walked = walked
        trail: dict[str, Any] = {"solid_joinstyle": "round", "zorder": 4}
        (self.trail,) = ax.plot([], [], color=color, lw=2.0, alpha=0.6, **trail)
        look: dict[str, Any] = {"mfc": color, "mec": PAPER, "mew": 1.5, "zorder": 5}
        size = max(5.0, min(14.0, 60.0 / max(ax.get_xlim()[1], ax.get_ylim()[0])))
        (self.body,) = ax.plot([], [], "o", ms=size, **look)

    def show(self, step: int) -> None:
        """Draw the robot after so many steps, or at its end."""
        points, returns, is_over = self.walked
        last = len(points) - 1
        now = min(step, last)
        self.trail.set_data(*points[: now + 1].T)
        self.body.set_data(*points[now : now + 1].T)
        ended = " (the end)" if is_over and now == last else ""
        amount = f"{returns[now]:.2f}".replace("-", "\u2212")
        self.ax.set_xlabel(f"step {now}, return {amount}{ended}")


def _gif(mdp: FiniteMDP, walks: list[Walk], speed: float) -> bytes:
    """Return the bytes of the animation that matplotlib's writer makes."""
    from matplotlib.animation import PillowWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    places = require_map(mdp)
    with style.own_style(), tempfile.TemporaryDirectory() as folder:
        shape = SLIDE_INCHES if has_slides() else SIZE_INCHES
        dpi = SLIDE_DPI if has_slides() else DPI
        figure = Figure(figsize=shape, dpi=dpi, layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)
        robots = []
        for ax, called, color, walked in zip(
            figure.subplots(1, 2), ("simulator", "target"), COLORS, walks, strict=False
        ):
            draw_cells(mdp, places, ax)
            ax.set(title=called, ylabel="")
            robots.append(Robot(ax, walked, color))
            robots[-1].show(0)
        canvas.draw()
        figure.set_layout_engine("none")  # the places of the first picture are kept
        n_pictures = max(len(walked.points) for walked in walks)
        n_held = max(1, round(HOLD_SECONDS * speed))
        file = Path(folder) / "animation.gif"
        writer: Any = PillowWriter(fps=cast(int, speed))  # a float as well
        with writer.saving(figure, str(file), dpi):
            for step in [*range(n_pictures), *(n_held * [n_pictures - 1])]:
                for robot in robots:
                    robot.show(step)
                writer.grab_frame()
        return file.read_bytes()
