"""The tables of notebooks/benchmark.md from the saved cells: python tests/benchmark_page.py."""

from pathlib import Path

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
    worst = right.loc[right["ratio"].idxmax()]
    sure = cells[cells["low"] > SURE_RATIO]
    return [
        f"at most {most:.2f} from 3 on",
        f"up to {worst['ratio']:.1f} ({worst['family']} at {worst['size']:g})",
        f"{(sure['b'] < 1).sum()} of the {len(sure)} cells that are surely above 1.1",
    ]


# rules of the study, as the page calls them
INTERVALS = {
    "quoted": "the quoted interval",
    "sampling": "its end at 1",
    "likelihood inf": "its end at infinity",
}
VALUES = {
    "default": "the default",
    "lengthened freely": "the same, with a change of any length",
    "simulator": "the simulator",
}


def study_table():
    """Return the rows of the interval's coverage and width, by half and rule."""
    rows = []
    for half in ("tuned", "held"):
        found = pd.read_csv(RESULTS / "unrecorded" / half / "interval.csv")
        for rule, text in INTERVALS.items():
            own = found[found["rule"] == rule].set_index(["sort", "size"])
            sizes = (1.0, 3.0, 10.0, 30.0)
            parts = [
                f"{own.covers['ordinary', size]:.3f}, {own.width['ordinary', size]:.2f}"
                for size in sizes
            ]
            faults = [f"{own.covers['fault', size]:.2f}" for size in sizes]
            cells = " | ".join([*parts, " ".join(faults)])
            rows.append(f"| *{half}*: {text} | {cells} |")
    return rows


def value_table():
    """Return the rows of the errors over maximum likelihood's, by half and rule."""
    rows = []
    for half in ("tuned", "held"):
        found = pd.read_csv(RESULTS / "unrecorded" / half / "value.csv")
        found = found[(found["over"] == "likelihood") & (found["what"] == "mean")]
        found = found.set_index("rule").drop(columns=["over", "what"])
        for rule, text in VALUES.items():
            rows.append(f"| *{half}*: {text} | {by_size(found.loc[rule])} |")
    return rows


def interval_sentences(run="bench_intervals"):
    """Return what the page says of the printed intervals, with its numbers."""
    cells = pd.read_csv(RESULTS / run / "cells.csv")
    own = cells[cells["estimator"] == "evaluate"]
    sums = own.groupby("family")[["held", "logs", "se_held", "se_logs"]].sum()
    sums = sums[sums["logs"] >= 10]
    covers = sums["held"] / sums["logs"]
    plain = sums["se_held"] / sums["se_logs"]
    width = own.groupby("size")["width"].median()
    all_plain = own["se_held"].sum() / own["se_logs"].sum()
    return [
        f"{own['held'].sum() / own['logs'].sum():.0%} of the {own['logs'].sum()} logs",
        f"{covers.min():.0%} for the worst family ({covers.idxmin()})",
        f"eff is {width[3]:.2f}, {width[10]:.2f} and {width[30]:.2f} at 3, 10 and 30",
        f"covers in {all_plain:.0%}, and in {plain.min():.0%} for its worst family"
        f" ({plain.idxmin()})",
    ]


def ranking_sentences():
    """Return what the page says of three policies, with its numbers."""
    table = pd.read_csv(RESULTS / "ranking" / "table.csv")
    mean = table.groupby("rule")[["right", "wrong", "cannot_say"]].mean()
    wrong = int(table[table["rule"] == "contest"]["wrong"].sum())
    number = (table["rule"] == "contest").sum()
    return [
        f"names the best policy in {mean.right['contest']:.0%} of the logs",
        f"other {mean.cannot_say['contest']:.0%} that the log cannot tell",
        f"a wrong one in {wrong} of the {number}",
        f"one in {mean.wrong['largest value of oee']:.1%}, with the largest"
        f" maximum-likelihood value in"
        f" {mean.wrong['largest value of maximum likelihood']:.1%}",
    ]


def all_lines():
    """Return all rows and sentences that the page must have."""
    cells = read_cells()
    tables = (main_table, distance_table, worst_table, sentences)
    lines = [line for table in tables for line in table(cells)]
    return [
        *lines,
        *study_table(),
        *value_table(),
        *interval_sentences(),
        *ranking_sentences(),
    ]


if __name__ == "__main__":
    print("\n".join(all_lines()))
