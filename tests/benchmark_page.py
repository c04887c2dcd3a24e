"""The tables of notebooks/benchmark.md from the saved cells: python tests/benchmark_page.py."""

from pathlib import Path

import numpy as np
import pandas as pd

from oee_tabular.lab.bench.league import FAR, NEAR, SURE_RATIO, geometric_mean

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "notebooks" / "benchmark.md"
RESULTS = ROOT / "notebooks" / "results"
OVER = {"ratio": "the default over the better reference", "floor": "the floor"}


def read_cells(run="bench"):
    """Return the saved cells of the default."""
    cells = pd.read_csv(RESULTS / run / "cells.csv")
    return cells[cells["estimator"] == "oee"]


def by_size(values):
    """Return the cells of a row, a number for each size."""
    return " | ".join(f"{value:.2f}" for value in values)


def main_table(cells):
    """Return the rows of the table by size."""
    rows = []
    for kind in ("held", "tuned"):
        sizes = cells[cells["families"] == kind].groupby("size")
        for column, text in OVER.items():
            means = sizes[column].apply(geometric_mean)
            rows.append(f"| *{kind}* families: {text} | {by_size(means)} |")
        sure = sizes["low"].apply(
            lambda low: f"{(low > SURE_RATIO).sum()} of {len(low)}"
        )
        rows.append(f"| *{kind}* families: surely above 1.1 | {' | '.join(sure)} |")
        over = sizes["over_likelihood"].apply(geometric_mean)
        rows.append(
            f"| *{kind}* families: RMSE over maximum likelihood's | {by_size(over)} |"
        )
    grid = cells[cells["family"] == "paper_grid"].set_index("size")["over_likelihood"]
    rows.append(f"| *tuned*, on the paper's grid: the same | {by_size(grid)} |")
    return rows


def distance_table(cells):
    """Return the rows of the table by the distance of the policy."""
    edges = {
        f"less than {NEAR} (near)": cells["distance"] < NEAR,
        f"{NEAR} to {FAR}": cells["distance"].between(NEAR, FAR, inclusive="left"),
        f"{FAR} and more (far)": cells["distance"] >= FAR,
    }
    rows = []
    for text, is_here in edges.items():
        some = cells[is_here]
        means = some.groupby("size")["over_likelihood"].apply(geometric_mean)
        number = some["family"].nunique()
        rows.append(f"| {text}, {number} families | {by_size(means)} |")
    return rows


def worst_table(cells, number=4):
    """Return the rows of the largest ratios, with few transitions and with more."""
    known = cells[(cells["simulator"] > 0) & ~cells["identical"]]
    columns = []
    for part in (known[known["size"] < 2], known[known["size"] > 2]):
        worst = part.sort_values("ratio", ascending=False).drop_duplicates("family")
        columns.append(
            [
                f"{row.family} ({row.families}) at {row.size:g} | {row.ratio:.1f}"
                for row in worst.head(number).itertuples()
            ]
        )
    return [f"| {' | '.join(pair)} |" for pair in zip(*columns, strict=True)]


def sentences(cells):
    """Return what the page says of the saved run in words, with its numbers."""
    right = cells[cells["identical"]]
    most = right[right["size"] >= 3]["over_likelihood"].max()
    worst = right.loc[right["ratio"].idxmax()] if right["ratio"].notna().any() else None
    found = [f"at most {most:.2f} from 3 on"]
    if worst is not None and np.isfinite(worst["ratio"]):
        found.append(
            f"up to {worst['ratio']:.1f}\n  ({worst['family']} at {worst['size']:g}"
        )
    return found


def interval_sentences(run="bench_intervals"):
    """Return what the page says of the printed intervals."""
    cells = pd.read_csv(RESULTS / run / "cells.csv")
    own = cells[cells["estimator"] == "evaluate"]
    shares = own.groupby("family")[["held", "logs", "se_held", "se_logs"]].sum()
    shares = shares[shares["logs"] >= 10]
    covers = shares["held"] / shares["logs"]
    plain = shares["se_held"] / shares["se_logs"]
    widths = own.groupby("size")[["width", "se_width"]].median()
    return {
        "logs": int(own["logs"].sum()),
        "coverage": own["held"].sum() / own["logs"].sum(),
        "worst": (covers.idxmin(), covers.min()),
        "plain": own["se_held"].sum() / own["se_logs"].sum(),
        "worst plain": (plain.idxmin(), plain.min()),
        "widths": (widths["width"] / widths["se_width"]).round(2).tolist(),
        "over eff": widths["width"].round(2).tolist(),
    }


if __name__ == "__main__":
    found = read_cells()
    for table in (main_table, distance_table, worst_table, sentences):
        print("\n".join(table(found)), end="\n\n")
    print(interval_sentences())
