"""``oee bench``: read the arguments, run, write, print the league."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

from oee_tabular import _files
from oee_tabular.bench.families import families as own_families
from oee_tabular.bench.run import SEEDS, SIZES, Plan, carry_out, plan
from oee_tabular.experiments.store import Store, alone


def bench(
    *,
    estimators: str,
    sizes: str | None,
    seeds: int,
    seed: int,
    families: str | None,
    jobs: int,
    dask: str | None,
    output: Path,
    fresh: bool,
    say: Callable[[str], None],
) -> None:
    """One run; bad arguments, families that cannot be made and folders with other settings are refused before it begins."""
    if seeds < 1:
        raise ValueError(f"--seeds must be at least 1; got {seeds}")
    _files.local(output)
    planned = plan(
        _names(estimators), families=families, sizes=SIZES if sizes is None else _numbers(sizes), seeds=seeds, seed=seed
    )
    if not fresh:
        Store(output, planned.settings)
    start = time.perf_counter()
    with alone(output):
        found, sweep = carry_out(planned, output, jobs=jobs, dask=dask, fresh=fresh, progress=sys.stderr.isatty())
        about = {name: planned.source.family(name, seed).about for name in planned.source.names}
        found.save(output, about=about, command=_command(planned, estimators, sizes, families))
    say(str(found))
    say(f"\n{sweep} ({time.perf_counter() - start:.0f} s)")
    if families is None:
        for sentence in own_families(seed).left_out.values():
            say(sentence)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise ValueError(f"--sizes must be numbers with commas between them, 0.3,1,3; got {text!r}") from None


def _command(planned: Plan, estimators: str, sizes: str | None, families: str | None) -> str:
    """What makes the same folder again."""
    words = ["oee bench", f"--estimators {estimators}"]
    words += [] if sizes is None else [f"--sizes {sizes}"]
    words += [f"--seeds {planned.settings.repetitions}"] if planned.settings.repetitions != SEEDS else []
    words += [f"--seed {planned.settings.seed}"] if planned.settings.seed else []
    return " ".join([*words, *([] if families is None else [f"--families {families}"])])
