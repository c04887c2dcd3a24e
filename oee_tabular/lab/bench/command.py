"""Command ``oee bench``: a run whose league is written into a folder and printed."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from oee_tabular import _checks
from oee_tabular._progress import is_terminal
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.estimators import REFERENCES, split
from oee_tabular.lab.bench.league import (
    check_labels,
    labels_of,
    league_files,
    league_of,
)
from oee_tabular.lab.bench.mapping import Families
from oee_tabular.lab.bench.sources import families_at, find_family
from oee_tabular.lab.bench.sweep import SEEDS, SIZES, TIMEOUT_SECONDS, plan
from oee_tabular.lab.run import Store, run_and_write
from oee_tabular.report import check_output


def read_labels(labels: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Return name -> text of NAME=TEXT, whose names must be among ``names``."""
    texts: dict[str, str] = {}
    for label in labels:
        name, equals, text = (part.strip() for part in label.partition("="))
        if not equals:
            raise ArgumentError(
                "--label",
                "must be NAME=TEXT, such as oee='OEE (ours)'; got"
                f" {_checks.show(label)}",
            )
        if name in texts:
            raise ArgumentError(
                "--label", f"must be given once for each name; {name!r} is there twice"
            )
        texts[name] = text
    return check_labels(texts, names, "--label")


def read_sizes(sizes: str | None) -> Iterable[float]:
    """Return the numbers between commas; None stands for the default's."""
    try:
        return SIZES if sizes is None else [float(word) for word in split(sizes)]
    except ValueError:
        raise ArgumentError(
            "--sizes",
            "must be numbers with commas between them, 0.3,1,3; got"
            f" {_checks.show(sizes)}",
        ) from None


def bench(
    *,
    estimators: str,
    sizes: str | None,
    seeds: int,
    seed: int,
    families: str | None,
    timeout: float,
    output: Path,
    say: Callable[[str], None],
    jobs: int = 1,
    dask: str | None = None,
    fresh: bool = False,
    overwrite: bool = True,
    labels: Sequence[str] = (),
) -> None:
    """Do one run of ``oee bench`` and write its files.

    Bad arguments, families that cannot be made and folders with other settings are
    refused before it begins.
    """
    check_output(output, "--output")
    settings = plan(
        estimators,
        families=families,
        sizes=read_sizes(sizes),
        seeds=seeds,
        seed=seed,
        timeout=timeout,
    )
    names = [*REFERENCES, *map(str, settings.asked["estimators"])]
    texts = read_labels(labels, list(dict.fromkeys(names)))
    source = families if families is not None and ":" in families else None
    given = {
        "sizes": (sizes, None),
        "seeds": (seeds, SEEDS),
        "seed": (seed, 0),
        "families": (families, None),
        "timeout": (timeout, TIMEOUT_SECONDS),
    }
    command = f"oee bench --estimators {estimators}{write_options(given, labels)}"

    def write(store: Store) -> None:
        """Write the league of the finished cells and print it."""
        league = league_of(store.table().drop(columns="repetition")).with_labels(
            labels_of({name: name for name in names}) | texts
        )
        about = {
            name: find_family(source, name, seed).about
            for name in map(str, settings.axes["family"])
        }
        store.save(league_files(league, about, command))
        say(f"{league}\n")

    run_and_write(
        output,
        settings,
        write,
        say=say,
        jobs=jobs,
        dask=dask,
        fresh=fresh,
        overwrite=overwrite,
        progress=is_terminal(sys.stderr),
    )
    if families is None:
        for sentence in left_out(seed):
            say(sentence)


def write_options(
    given: Mapping[str, tuple[object, object]], labels: Sequence[str]
) -> str:
    """Write the options of a command that are not the default's: (value, default)."""
    words = [
        f" --{name} {value}"
        for name, (value, default) in given.items()
        if value != default
    ]
    words += [f" --label {shlex.quote(label)}" for label in labels]
    return "".join(words)


def left_out(seed: int) -> list[str]:
    """Return why some of the package's families are not there, a sentence each."""
    own = families_at(None, seed)
    return list(own.left_out.values()) if isinstance(own, Families) else []
