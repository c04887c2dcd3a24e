"""Catalogue of all experiments by id, and ``oee reproduce``, which runs them."""

from __future__ import annotations

import difflib
import itertools
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from oee_tabular import _files, _writing
from oee_tabular._progress import is_terminal
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.experiment import Experiment, files_of
from oee_tabular.lab.experiments import (
    cartpole,
    changes,
    kinova,
    reacher,
    sureness,
    values,
    zeta,
)
from oee_tabular.lab.run import Store, refuse_links, require_modules, run_and_write
from oee_tabular.report import check_output

INDEX = "index.md"
# the last line of an index, without which an edited one would be lost
MARK = b"<!-- SHA-256 of what oee reproduce wrote above: "
MARK_END = b" -->\n"
EXPERIMENTS: dict[str, Experiment] = {
    experiment.id: experiment
    for experiment in (
        zeta.fig1a,
        values.fig1bcd,
        values.estimands,
        values.horizon,
        values.data_policy,
        zeta.rate,
        zeta.renyi,
        zeta.misspecified,
        zeta.normalisation,
        zeta.lambda_n,
        zeta.networks,
        values.frozen_lake,
        values.taxi,
        values.cliff_walking,
        sureness.coverage,
        sureness.coverage_lake,
        sureness.efficiency,
        sureness.collection,
        sureness.ranking,
        cartpole.fig2,
        cartpole.cartpole_resolution,
        cartpole.cartpole_data,
        cartpole.cartpole_choice,
        reacher.fig3,
        kinova.table1,
        changes.changes,
        changes.residual_coverage,
    )
}


def choose(names: Iterable[str], *, everything: bool = False) -> list[Experiment]:
    """Return the experiments of these ids, or of these groups, each once."""
    known = ", ".join(EXPERIMENTS)
    members = [
        [own.id for own in EXPERIMENTS.values() if own.group == name] or [name]
        for name in names
    ]
    wanted = list(dict.fromkeys(itertools.chain(*members)))
    if everything and wanted:
        raise ArgumentError(
            "--all", f"must be given without ids; got {', '.join(wanted)}"
        )
    if not everything and not wanted:
        raise ValueError(
            f"one experiment or more must be given, or --all; there are {known}"
        )
    for name in wanted:
        if name not in EXPERIMENTS:
            near = difflib.get_close_matches(name, EXPERIMENTS, n=3, cutoff=0.4)
            hint = f"; nearest: {', '.join(near)}" if near else ""
            raise ArgumentError(
                "experiment", f"must be one of {known}; got {name!r}{hint}"
            )
    return [EXPERIMENTS[name] for name in (EXPERIMENTS if everything else wanted)]


def listing() -> str:
    """List ids, numbers of cells of the full sweep, and titles, by group."""
    lines = []
    for group, members in itertools.groupby(
        EXPERIMENTS.values(), key=lambda experiment: experiment.group
    ):
        lines.append(f"{group}:")
        for own in members:
            lines.append(
                f"  {own.id:<19} {len(own.settings().cells()):>5} cells  {own.title}"
            )
    return "\n".join(lines)


def reproduce(
    names: Iterable[str],
    *,
    everything: bool,
    smoke: bool,
    seeds: int | None,
    seed: int,
    output: Path,
    say: Callable[[str], None],
    jobs: int = 1,
    dask: str | None = None,
    fresh: bool = False,
    overwrite: bool = True,
) -> None:
    """Run the experiments one after the other; the folder's index is written last.

    An experiment whose extra is not installed is left out with a sentence, and an error
    where nothing else was asked for. Folders with other settings are refused before
    anything runs. ``jobs``, ``dask`` and ``fresh`` are as in ``run_experiment``,
    and so is ``overwrite``.
    """
    if seeds is not None and seeds < 1:
        raise ArgumentError("--seeds", f"must be at least 1; got {seeds}")
    check_output(output, "--output")
    chosen: list[Experiment] = []
    missing: list[ImportError] = []
    for experiment in choose(names, everything=everything):
        try:
            require_modules(experiment)
            chosen.append(experiment)
        except ImportError as error:
            missing.append(error)
    if missing and not chosen:
        raise missing[0]
    folder = output / "smoke" if smoke else output
    prefix = "smoke/" if smoke else ""
    folders = ["smoke", *(f"{prefix}{own.id}" for own in chosen)]
    refuse_links(output, folders, are_folders=True)
    _require_own_index(folder, overwrite=overwrite)
    every = [
        experiment.settings(smoke=smoke, repetitions=seeds, seed=seed)
        for experiment in chosen
    ]
    if not fresh:
        for settings in every:
            Store(folder / settings.experiment.id, settings, overwrite=overwrite)
    for settings in every:
        target = folder / settings.experiment.id
        progress = is_terminal(sys.stderr)
        run_and_write(
            target,
            settings,
            save,
            say=say,
            jobs=jobs,
            dask=dask,
            fresh=fresh,
            overwrite=overwrite,
            progress=progress,
        )
    say(f"Index: {write_index(folder, overwrite=overwrite)}")
    for reason in missing:
        say(f"Left out: {reason}")


def save(store: Store) -> None:
    """Write the files of an experiment, all or none."""
    store.save(files_of(store.settings, store.table()))


def _require_own_index(output: Path, *, overwrite: bool) -> None:
    """Raise an ArgumentError where an index that no run wrote would be lost."""
    refuse_links(output, [INDEX])
    path = output / INDEX
    if overwrite or not path.exists():
        return
    text, _, mark = path.read_bytes().rpartition(MARK)
    if mark.removesuffix(MARK_END).decode("ascii", "replace") != _writing.sha256(text):
        raise ArgumentError(
            f"{str(path)!r}",
            "must be as the last oee reproduce of this version wrote it; it is not"
            " (--overwrite replaces it; --output names another folder)",
        )


def write_index(output: Path, *, overwrite: bool = True) -> Path:
    """Write ``index.md`` of all experiments that have results in the folder.

    A comment at its end has its digest.
    """
    parts = ["# Results"]
    for experiment in EXPERIMENTS.values():
        if (output / experiment.id / "summary.md").is_file():
            title = experiment.title
            folder = experiment.id
            parts += [
                f"## [{title}]({folder}/summary.md)",
                f"![{title}]({folder}/figure.png)",
                experiment.caption,
            ]
    text = ("\n\n".join(parts) + "\n\n").encode()
    mark = MARK + _writing.sha256(text).encode() + MARK_END
    _require_own_index(output, overwrite=overwrite)
    _files.write_all(output, {INDEX: text + mark})
    return output / INDEX
