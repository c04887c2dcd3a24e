"""Values and their intervals, side by side or as a forest plot; and the states where a policy spends its time, ranked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.plots.style import COLORS, ink, literally, marks, places, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_values(records: Sequence[Mapping[str, Any]], ax: Axes, *, unit: str = "") -> Axes:
    """Values with their intervals, grouped by policy; exact target values as black lines; returns ``ax``.

    The axis spans what is credible: estimates far outside it (an exploding product) are drawn as open markers at the
    edge, with their value.

    Parameters
    ----------
    records : a Report's ``records()``
    ax : matplotlib Axes
    unit : what a value is, the title

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> row = {"policy": "new", "estimator": "oee", "value": 1.0, "lower": 0.5, "upper": 1.5, "true_value": 1.2}
    >>> ax = plot_values([row, row | {"estimator": "pdis", "value": 9.0, "n_episodes": 10}], Figure().subplots())
    >>> [text.get_text() for text in ax.get_legend().get_texts()], [text.get_text() for text in ax.texts]
    (['oee', 'pdis', 'true value'], ['9'])
    """
    policies = list(dict.fromkeys(row["policy"] for row in records))
    estimators = list(dict.fromkeys(row["estimator"] for row in records))
    looks = [marks(k) for k in places(estimators)]
    low, high = credible_span(records)
    handles: dict[str, Any] = {}
    for row in records:
        group, member = policies.index(row["policy"]), estimators.index(row["estimator"])
        x = group + 0.8 * ((member + 0.5) / len(estimators) - 0.5)
        style = looks[member]
        color, marker = style["color"], style["marker"]
        value = row["value"]
        if not math.isfinite(value) or not low <= value <= high:
            edge = low if math.isfinite(value) and value < low else high
            handle: Any = ax.plot(x, edge, marker=marker, mfc="none", mec=color, ls="none", clip_on=False, ms=7)[0]
            text = f"{value:.2g}" if math.isfinite(value) else "no value"
            ax.annotate(
                text, (x, edge), xytext=(0, 8 if edge == low else -8), textcoords="offset points", rotation=90,
                ha="center", va="bottom" if edge == low else "top", fontsize=8, color=color,
            )  # fmt: skip
            handles.setdefault(row["estimator"], handle)
            continue
        if row["lower"] is not None:
            middle, half = 0.5 * (row["lower"] + row["upper"]), 0.5 * (row["upper"] - row["lower"])
            ax.errorbar(x, middle, yerr=half, fmt="none", color=color, capsize=3)
        handles.setdefault(row["estimator"], ax.plot(x, value, ms=6, **style)[0])
    for group, policy in enumerate(policies):
        truth = next((row["true_value"] for row in records if row["policy"] == policy), None)
        if truth is not None:
            line = ax.hlines(truth, group - 0.45, group + 0.45, colors=ink(), lw=1.2)
            handles.setdefault("true value", line)
    ax.set_ylim(low, high)
    ax.set_xlim(-0.6, len(policies) - 0.4)
    ax.set_xticks(range(len(policies)), policies)
    literally(ax.get_xticklabels())
    ax.set_xlabel("policy")
    ax.set_ylabel("value in the target")
    ax.set_title(unit, fontsize=9)
    ax.grid(axis="y", alpha=0.3)
    legend = ax.legend(handles.values(), handles.keys(), loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
    literally(legend.get_texts())
    return ax


def credible_span(records: Sequence[Mapping[str, Any]], *, margin: float = 0.5) -> tuple[float, float]:
    """Around truths, simulator and exact model values; wild estimates do not stretch it. ``margin`` on each side: a share."""
    calm = [
        row["value"]
        for row in records
        if row.get("row_sum_error", 0.0) < 1e-6 and "n_rollouts" not in row and "n_episodes" not in row
    ]
    anchors = [row["true_value"] for row in records if row["true_value"] is not None] + calm
    anchors += [
        row[end] for row in records for end in ("lower", "upper") if row["value"] in calm and row[end] is not None
    ]
    finite = [value for value in anchors if math.isfinite(value)] or [
        row["value"] for row in records if math.isfinite(row["value"])
    ]
    if not finite:
        return 0.0, 1.0
    low, high = min(finite), max(finite)
    room = margin * (high - low) or 0.5 * abs(high) or 0.5
    return low - room, high + room


def plot_intervals(
    names: Sequence[str],
    values: object,
    lower: object,
    upper: object,
    ax: Axes,
    *,
    truth: float | None = None,
    limits: tuple[float, float] | None = None,
    xlabel: str = "value (discounted sum of rewards)",
) -> Axes:
    """A forest plot: one line a name, from the top, with its value and interval; ``truth`` as a vertical line.

    Parameters
    ----------
    names : k names
    values, lower, upper : (k,); an end that is nan leaves the interval out, a nan value with an interval the marker
    ax : matplotlib Axes
    truth : number or None
    limits : of the axis; None: what values, ends and truth span. What lies outside is an open marker at the edge, with its
        value; a nan value is said in words
    xlabel : what the value is, with its unit

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_intervals(["oee", "pdis"], [0.20, 0.12], [0.16, 0.04], [0.23, 0.20], Figure().subplots(), truth=0.19)
    >>> [label.get_text() for label in ax.get_yticklabels()]
    ['pdis', 'oee']
    """
    centre, low, high = (
        _checks.float_array(a, name, ndim=1)
        for a, name in ((values, "values"), (lower, "lower"), (upper, "upper"))
    )  # fmt: skip
    if not len(names) == len(centre) == len(low) == len(high):
        raise ValueError(
            f"names, values, lower and upper must have one length; they have {len(names)}, {len(centre)}, {len(low)} and "
            f"{len(high)}"
        )
    left, right = _limits([centre, low, high], truth) if limits is None else limits
    if not left < right:
        raise ValueError(f"limits must be (low, high) with low < high; got {limits}")
    for k, place in enumerate(places(names)):
        style = marks(place)
        y = len(names) - 1 - k
        value = float(centre[k])
        if np.isfinite([low[k], high[k]]).all():
            inner = np.clip([low[k], high[k]], left, right)
            marker = "|" if math.isnan(value) else None  # an interval without a value has ends
            ax.plot(inner, [y, y], color=style["color"], lw=2.0, marker=marker, ms=9, mew=2.0)
        if left <= value <= right:
            ax.plot(value, y, ms=7, **style)
            continue
        if math.isnan(value) and np.isfinite([low[k], high[k]]).any():
            continue  # an interval alone
        edge = left if not math.isfinite(value) or value < left else right
        ax.plot(edge, y, ms=7, clip_on=False, **style | {"markerfacecolor": "none"})
        ax.annotate(
            f"{value:.3g}" if math.isfinite(value) else "no value", (edge, y), fontsize="small", va="bottom",
            xytext=(6 if edge == left else -6, 2), textcoords="offset points", ha="left" if edge == left else "right",
        )  # fmt: skip
    if truth is not None:
        ax.axvline(truth, color=ink(), lw=1.2, ls=(0, (4, 2)), zorder=0)
    ax.set_xlim(left, right)
    ax.set_ylim(-0.6, len(names) - 0.4)
    ax.set_yticks(range(len(names)), [shown(name) for name in reversed(names)])
    literally(ax.get_yticklabels())
    ax.tick_params(axis="y", length=0, pad=9)
    ax.spines["left"].set_visible(False)
    ax.locator_params(axis="x", nbins=5)
    ax.set_xlabel(xlabel)
    ax.grid(axis="x")
    return ax


def _limits(arrays: Sequence[object], truth: float | None) -> tuple[float, float]:
    """What finite numbers span, with a margin."""
    every = np.concatenate([*arrays, [] if truth is None else [truth]])
    finite = every[np.isfinite(every)]
    if not finite.size:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = 0.06 * (high - low) or 0.06 * abs(high) or 0.5
    return low - margin, high + margin


def plot_states(
    time: object,
    recorded: object,
    ax: Axes,
    *,
    seen: object = None,
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
