"""The picture of coverage for tasks without one of their own: the states where a policy spends its time, ranked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.plots.style import COLORS, ink, literally, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_states(
    time: Any,
    recorded: Any,
    ax: Axes,
    *,
    seen: Any = None,
    top: int = 20,
    names: Sequence[str] | None = None,
    xlabel: str = "share of the policy's discounted time (%)",
) -> Axes:
    """Bars of the states where a policy spends most time, each in the part that the log has seen and the part it has not.

    Parameters
    ----------
    time : (S,) shares, which sum to at most 1
    recorded : (S,) moves of the log from each state, written beside the bars
    ax : matplotlib Axes
    seen : (S,) share of the state's time that is in actions that the log has seen; None: 1 where moves are recorded
    top : how many states to show; those without time are left out
    names : of the states; None: their numbers
    xlabel : what the bars are, with the unit

    Returns
    -------
    ax

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_states([0.3, 0.7], [12, 0], Figure().subplots())
    >>> [label.get_text() for label in ax.get_yticklabels()]
    ['state 1', 'state 0']
    """
    share = _checks.float_array(time, "time", ndim=1)
    _checks.require_nonnegative(share, "time")
    moves = _checks.float_array(recorded, "recorded", ndim=1)
    known = (moves > 0).astype(np.float64) if seen is None else _checks.float_array(seen, "seen", ndim=1)
    for array, name in ((moves, "recorded"), (known, "seen")):
        if array.shape != share.shape:
            raise ValueError(f"{name} must have {len(share)} entries, one a state; it has {len(array)}")
    number = _checks.positive_integer(top, "top")
    order = np.argsort(-share, kind="stable")[:number]
    order = order[share[order] > 0]
    y = np.arange(len(order))[::-1]
    good, bad = 100.0 * share[order] * known[order], 100.0 * share[order] * (1.0 - known[order])
    ax.barh(y, good, color=COLORS[0], height=0.72, label="action recorded")
    ax.barh(y, bad, left=good, color="none", edgecolor=COLORS[1], hatch="////", height=0.72, label="never recorded")
    for place, state in zip(y, order, strict=True):
        count = moves[state]
        words = "none recorded" if count == 0 else f"{count:,.0f}".replace(",", "\u202f")
        ax.annotate(
            words, (100.0 * share[state], place), xytext=(4, 0), textcoords="offset points", va="center",
            fontsize="small", color=ink(),
        )  # fmt: skip
    labels = [f"state {s}" if names is None else shown(names[s]) for s in order]
    ax.set_yticks(y, labels)
    literally(ax.get_yticklabels())
    ax.tick_params(axis="y", length=0)
    most = float((100.0 * share[order]).max()) if len(order) else 1.0
    ax.set_xlim(0.0, 1.25 * most)
    ax.set_ylim(-0.6, max(len(order), 1) - 0.4)
    ax.set_xlabel(xlabel)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize="small", borderaxespad=0.2)
    return ax
