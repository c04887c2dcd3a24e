"""What each part of the default buys: python tests/benchmarks/ablation.py.

Each estimator lacks parts of ``OffEnvironment()``. They are run on the families of
``oee.bench``, which takes some minutes. Two tables are written to
``notebooks/results/ablation``: ``cells.csv`` by family, and ``summary.md``.
"""

from pathlib import Path

import numpy as np
import pandas as pd

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment
from oee_tabular.ratio import Conditional, NoPrior
from oee_tabular.shrinkage import Shrinkage, SoftThreshold

FOLDER = Path(__file__).parents[2] / "notebooks" / "results" / "ablation"
SIZES = (3.0, 30.0)  # transitions per stochastic state-action pair
N_SEEDS = 6


def without_move(prior):
    """Return the value of zeta * P with this prior, which is not moved."""
    return OffEnvironment(Conditional(prior), adjust=None)


ESTIMATORS = {
    "no prior (maximum likelihood)": without_move(NoPrior()),
    "the simulator as prior, kappa = 10": without_move(Shrinkage("simulator", 10.0)),
    "the simulator as prior": without_move(Shrinkage("simulator")),
    "tilt along log P": without_move(Shrinkage("tilt")),
    "tilt along all directions": without_move(Shrinkage("ridge")),
    "the simulator as prior, moved": OffEnvironment(
        Conditional(Shrinkage("simulator")), adjust=SoftThreshold()
    ),
    "the default": OffEnvironment(),
}


def measure(families, sizes, n_seeds):
    """Return a row for each family, size and estimator, over the seeds.

    ``error`` is the root mean square error in efficient standard errors, and ``se`` its
    standard error by the delta method; ``covered`` of ``intervals`` 95% intervals
    contain the target's value.
    """
    rows = oee.bench.run(
        ESTIMATORS, families=families, sizes=list(sizes), seeds=n_seeds
    ).table
    rows = rows[rows["estimator"].isin(ESTIMATORS) & (rows["bound"] > 0)]
    cells = []
    for (family, size, estimator), own in rows.groupby(
        ["family", "size", "estimator"], sort=False
    ):
        squares = own["error"] ** 2 / own["bound"]
        error = np.sqrt(squares.mean())
        inside = own["lower"].le(own["truth"]) & own["upper"].ge(own["truth"])
        cells.append(
            {
                "family": family,
                "simulator": "right" if own["identical"].iloc[0] else "wrong",
                "size": size,
                "estimator": estimator,
                "error": error,
                "se": squares.std() / np.sqrt(len(own)) / (2 * error) if error else 0,
                "covered": int(inside.sum()),
                "intervals": int(own["lower"].notna().sum()),
            }
        )
    return pd.DataFrame(cells)


def summarise(cells):
    """Return a row for each estimator: means over families, which count alike."""
    table = []
    for simulator in ("wrong", "right"):
        for size in sorted(cells["size"].unique()):
            for estimator in ESTIMATORS:
                own = cells[
                    (cells["simulator"] == simulator)
                    & (cells["size"] == size)
                    & (cells["estimator"] == estimator)
                ]
                if own.empty:
                    continue
                n = own["intervals"].sum()
                share = own["covered"].sum() / n
                table.append(
                    {
                        "simulator": simulator,
                        "size": size,
                        "estimator": estimator,
                        "families": len(own),
                        "error": own["error"].mean(),
                        "error_se": np.sqrt((own["se"] ** 2).sum()) / len(own),
                        "worst": own["error"].max(),
                        "covers": share,
                        "covers_se": np.sqrt(share * (1 - share) / n),
                    }
                )
    return pd.DataFrame(table)


def write_page(table):
    """Return the page that shows the table."""
    lines = [
        "# What each part of the default buys",
        "",
        f"Families of `oee bench`, {N_SEEDS} logs each. *size*: transitions per"
        " stochastic state-action pair. *error*: mean over families of the root mean"
        " square error, in units of the standard error of the best estimator for many"
        " transitions; ± its standard error. *worst*: the largest of a family."
        " *covers*: share of 95% intervals of the estimator that contain the target's"
        " value. *right*: the simulator is the target. Made by `python"
        " tests/benchmarks/ablation.py`; [cells.csv](cells.csv) has every family.",
        "",
        "| simulator | size | estimator | families | error | worst | covers |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.simulator} | {row.size:g} | {row.estimator} | {row.families} |"
        f" {row.error:.2f} ± {row.error_se:.2f} | {row.worst:.1f} |"
        f" {row.covers:.0%} ± {row.covers_se:.0%} |"
        for row in table.itertuples()
    ]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    made = measure(None, SIZES, N_SEEDS)
    FOLDER.mkdir(exist_ok=True)
    made.to_csv(FOLDER / "cells.csv", index=False, float_format="%.6g")
    page = write_page(summarise(made))
    (FOLDER / "summary.md").write_text(page)
    print(page)
