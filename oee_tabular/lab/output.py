"""From the rows of a sweep to its files: table.csv, summary.csv, summary.md, figure.svg and figure.png; and an index of all."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular import _files
from oee_tabular.lab.registry import Experiment, RunSettings
from oee_tabular.lab.store import Store, refuse_links

STATISTICS = ("mean", "sd", "se")  # of a measure over the seeds
TITLE_SIZE = 12.0  # points at most


def summary_of(experiment: Experiment, table: pd.DataFrame) -> pd.DataFrame:
    """Mean, sd, standard error of the measures and number of seeds at each point; the paper's number, and ours / paper."""
    grouped = table.groupby(list(experiment.keys), sort=False, dropna=False)
    parts: list[Any] = [grouped.size().rename("seeds")]
    for measure in experiment.measures:
        columns = [f"{measure}_{name}" for name in STATISTICS]
        parts.append(grouped[measure].agg(["mean", "std", "sem"]).set_axis(columns, axis=1))
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

    def draw(figure: Any) -> None:
        experiment.draw(table, summary, figure)
        share_legend(figure)
        set_title(figure, experiment.finding(table))

    return {f"figure.{kind}": content for kind, content in draw_bytes(draw, salt=experiment.id).items()}


def draw_bytes(draw: Callable[[Any], None], *, salt: str, kinds: tuple[str, ...] = ("svg", "png")) -> dict[str, bytes]:
    """The bytes of the figure that ``draw`` makes, by kind, without a date."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    metadata: dict[str, object] = {"svg": {"Date": None}, "png": {"Software": None}}
    contents = {}
    with mpl.rc_context({"svg.hashsalt": salt, "svg.fonttype": "none"}):
        figure = Figure(layout="constrained")
        draw(figure)
        for kind in kinds:
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=110, metadata=metadata[kind])
            contents[kind] = buffer.getvalue()
    return contents


def share_legend(figure: Any) -> None:
    """One legend below the panels instead of one in each, where one panel has the series of all and more than three."""
    drawn = [ax for ax in figure.axes if ax.get_legend() is not None]
    entries = [dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True)) for ax in drawn]
    most: dict[str, Any] = max(entries, key=len, default={})
    if len(most) <= 3 or any(entry.keys() - most.keys() for entry in entries):
        return
    for ax in drawn:
        ax.legend().remove()
    columns = int(figure.get_figwidth() * 11 / (max(map(len, most)) + 8))
    columns = min(max(1, columns), len(most))
    figure.legend(list(most.values()), list(most), loc="outside lower center", ncols=columns, fontsize="small")


def set_title(figure: Any, text: str) -> None:
    """The title of a whole figure: one line, in letters small enough for its width."""
    if text:
        title = figure.suptitle(text, fontsize=TITLE_SIZE)
        title.set_parse_math(False)
        width = title.get_window_extent().width
        title.set_fontsize(TITLE_SIZE * min(1.0, 0.98 * figure.bbox.width / width))


def markdown(settings: RunSettings, table: pd.DataFrame, summary: pd.DataFrame) -> str:
    """The summary as a page: its title, the figure with what it shows, how it was made, the numbers."""
    experiment = settings.experiment
    is_full = settings.as_dict()["axes"] == experiment.settings().as_dict()["axes"]
    command = f"oee reproduce {experiment.id}{'' if is_full else ' --smoke'} --seeds {settings.repetitions}"
    command += f" --seed {settings.seed}" if settings.seed else ""
    axes = "; ".join(f"{name} {', '.join(map(str, values))}" for name, values in settings.axes.items())
    parts = [
        f"# {experiment.title}",
        f"![{experiment.finding(table) or experiment.title}](figure.png)",
        experiment.caption,
        f"`{command}` ({axes}); every seed is in table.csv.",
        pipe_table(summary),
    ]
    return "\n\n".join(parts) + "\n"


def pipe_table(frame: pd.DataFrame) -> str:
    """A markdown table."""

    def text(value: object) -> str:
        if isinstance(value, float):
            return "" if np.isnan(value) else f"{value:.4g}"
        return str(value).replace("|", "\\|")

    rows: list[Iterable[object]] = [frame.columns, *frame.itertuples(index=False, name=None)]
    lines = ["| " + " | ".join(map(text, row)) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(frame.columns), *lines[1:]])


def index(output: Path, experiments: Iterable[Experiment]) -> Path:
    """``index.md`` of all experiments that have results in the folder."""
    parts = ["# Results"]
    for experiment in experiments:
        if (output / experiment.id / "summary.md").is_file():
            title, folder = experiment.title, experiment.id
            parts += [f"## [{title}]({folder}/summary.md)", f"![{title}]({folder}/figure.png)", experiment.caption]
    refuse_links(output, ["index.md"])
    _files.write_all(output, {"index.md": ("\n\n".join(parts) + "\n").encode()})
    return output / "index.md"
