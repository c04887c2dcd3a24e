"""Pictures. Functions draw on an ``ax``; colours are Okabe and Ito's, which colour-blind readers can tell apart."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#8C6D31")
MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")


def plot_values(records: Sequence[Mapping[str, Any]], ax: Axes, *, unit: str = "") -> None:
    """Values with their intervals, grouped by policy; exact target values as black lines.

    ``records`` are a Report's. The axis spans what is credible: estimates far outside it (an exploding product) are drawn
    as open markers at the edge, with their value.
    """
    policies = list(dict.fromkeys(row["policy"] for row in records))
    estimators = list(dict.fromkeys(row["estimator"] for row in records))
    low, high = _span(records)
    handles: dict[str, Any] = {}
    for row in records:
        group, member = policies.index(row["policy"]), estimators.index(row["estimator"])
        x = group + 0.8 * ((member + 0.5) / len(estimators) - 0.5)
        color, marker = COLORS[member % len(COLORS)], MARKERS[member % len(MARKERS)]
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
        spread = None
        if row["lower"] is not None:
            spread = np.array([[value - row["lower"]], [row["upper"] - value]])
        handle = ax.errorbar(x, value, yerr=spread, fmt=marker, color=color, capsize=3, ms=6)
        handles.setdefault(row["estimator"], handle)
    for group, policy in enumerate(policies):
        truth = next((row["true_value"] for row in records if row["policy"] == policy), None)
        if truth is not None:
            line = ax.hlines(truth, group - 0.45, group + 0.45, colors="black", lw=1.2)
            handles.setdefault("true value", line)
    ax.set_ylim(low, high)
    ax.set_xlim(-0.6, len(policies) - 0.4)
    ax.set_xticks(range(len(policies)), policies)
    ax.set_xlabel("policy")
    ax.set_ylabel("value in the target")
    ax.set_title(unit, fontsize=9)
    ax.grid(axis="y", alpha=0.3)
    ax.legend(handles.values(), handles.keys(), loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)


def _span(records: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Around truths, simulator and exact model values; wild estimates do not stretch it."""
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
    margin = 0.5 * (high - low) or 0.5 * abs(high) or 0.5
    return low - margin, high + margin


def figure_png(draw: Callable[[Axes], None], *, size: tuple[float, float] = (9.0, 4.8)) -> bytes:
    """The picture that ``draw`` makes on one axis, as the bytes of a PNG (no display, no global state)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    draw(figure.subplots())
    buffer = io.BytesIO()
    canvas: Any = FigureCanvasAgg(figure)
    canvas.print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()
