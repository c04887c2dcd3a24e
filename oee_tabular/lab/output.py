"""From the rows of a sweep to its files: table.csv, summary.csv, summary.md, figure.svg and figure.png; and an index of all."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from oee_tabular import _files
from oee_tabular.lab.findings import entitle
from oee_tabular.lab.registry import Experiment, RunSettings
from oee_tabular.lab.store import Store, refuse_links

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATISTICS = ("mean", "sd", "se")  # of a measure over the seeds


def summary_of(experiment: Experiment, table: pd.DataFrame) -> pd.DataFrame:
    """Mean, sd, standard error of the measures and number of seeds at each point; the paper's number, and ours / paper."""
    grouped = table.groupby(list(experiment.keys), sort=False, dropna=False)
    parts: list[Any] = [grouped.size().rename("seeds")]
    for measure in experiment.measures:
        parts.append(
            grouped[measure].agg(["mean", "std", "sem"]).set_axis([f"{measure}_{name}" for name in STATISTICS], axis=1)
        )
    summary: pd.DataFrame = pd.concat(parts, axis=1).reset_index()
    if experiment.paper is not None:
        summary["paper"] = experiment.paper(summary)
        summary["ours / paper"] = summary[f"{experiment.measures[0]}_mean"] / summary["paper"]
    return summary


def write(store: Store) -> None:
    """Write the files of an experiment, all or none."""
    experiment, table = store.settings.experiment, store.table()
    summary = summary_of(experiment, table)
    contents = {
        "table.csv": _files.csv_bytes(table),
        "summary.csv": _files.csv_bytes(summary, float_format="%.6g"),
        "summary.md": markdown(store.settings, table, summary).encode(),
        **figures(experiment, table, summary),
    }
    refuse_links(store.folder)
    _files.write_all(store.folder, contents)


def figures(experiment: Experiment, table: pd.DataFrame, summary: pd.DataFrame) -> dict[str, bytes]:
    """The figure as svg and png: the same bytes for the same table."""

    def draw(figure: Figure) -> None:
        experiment.draw(table, summary, figure)
        share_legend(figure)
        entitle(figure, experiment.finding(table))

    return {f"figure.{kind}": content for kind, content in draw_bytes(draw, salt=experiment.id).items()}


def draw_bytes(
    draw: Callable[[Figure], None], *, salt: str, kinds: tuple[str, ...] = ("svg", "png")
) -> dict[str, bytes]:
    """The bytes of the figure that ``draw`` makes, by kind, without a date."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    metadata: dict[str, object] = {"svg": {"Date": None}, "png": {"Software": None}}
    found = {}
    with mpl.rc_context({"svg.hashsalt": salt, "svg.fonttype": "none"}):
        figure = Figure(layout="constrained")
        draw(figure)
        for kind in kinds:
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=110, metadata=metadata[kind])
            found[kind] = buffer.getvalue()
    return found


def share_legend(figure: Figure) -> None:
    """One legend below the panels instead of one in each, where the panels have the same series and more than three."""
    drawn = [ax for ax in figure.axes if ax.get_visible() and ax.get_legend() is not None]
    entries = [dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True)) for ax in drawn]
    every: dict[str, Any] = {}
    for entry in entries:
        every |= {label: handle for label, handle in entry.items() if label not in every}
    if not drawn or len(every) <= 3 or max(len(every) - len(entry) for entry in entries) > 3:
        return
    for ax in drawn:
        legend = ax.get_legend()
        assert legend is not None
        legend.remove()
    longest = max(map(len, every))
    columns = max(1, min(len(every), int(figure.get_figwidth() * 11 / (longest + 8))))
    figure.legend(list(every.values()), list(every), loc="outside lower center", ncols=columns, fontsize="small")


def heading(experiment: Experiment, table: pd.DataFrame) -> list[str]:
    """The first lines of the page: its title, and the figure with what it shows."""
    return [f"# {experiment.title}", "", f"![{experiment.finding(table) or experiment.title}](figure.png)"]


def markdown(settings: RunSettings, table: pd.DataFrame, summary: pd.DataFrame) -> str:
    """The summary as a page."""
    experiment = settings.experiment
    command = f"oee reproduce {experiment.id}"
    is_small = dict(settings.axes) != {name: tuple(values) for name, values in experiment.axes.items()}
    command += " --smoke" if is_small else ""
    if settings.repetitions != (experiment.smoke_repetitions if is_small else experiment.repetitions):
        command += f" --seeds {settings.repetitions}"
    command += f" --seed {settings.seed}" if settings.seed else ""
    axes = "; ".join(f"{name} {', '.join(map(str, values))}" for name, values in settings.axes.items())
    made = f"`{command}`, {settings.repetitions} seeds a cell ({axes}); every seed is in table.csv."
    return "\n\n".join(["\n".join(heading(experiment, table)), experiment.caption, made, pipe_table(summary)]) + "\n"


def pipe_table(frame: pd.DataFrame) -> str:
    """A markdown table."""

    def text(value: object) -> str:
        if isinstance(value, float):
            return "" if np.isnan(value) else f"{value:.4g}"
        return str(value).replace("|", "\\|")

    lines = ["| " + " | ".join(map(text, frame.columns)) + " |", "|" + "---|" * len(frame.columns)]
    lines += [
        "| " + " | ".join(text(value) for value in row) + " |" for row in frame.itertuples(index=False, name=None)
    ]
    return "\n".join(lines)


def index(output: Path, experiments: Iterable[Experiment]) -> Path:
    """``index.md`` of all experiments that have results in the folder."""
    parts = ["# Results"]
    for experiment in experiments:
        if (output / experiment.id / "summary.md").is_file():
            parts += [
                f"## [{experiment.title}]({experiment.id}/summary.md)",
                f"![{experiment.title}]({experiment.id}/figure.png)",
                experiment.caption,
            ]
    refuse_links(output, ["index.md"])
    _files.write_all(output, {"index.md": ("\n\n".join(parts) + "\n").encode()})
    return output / "index.md"
