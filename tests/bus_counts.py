"""Counts of Rust's bus engines: python tests/bus_counts.py rust_bus_original.csv.

It writes oee_tabular/tasks/bus_engines.csv again from the file that the package
econirl 0.1.1 has in econirl/datasets. Without an argument it looks for that package.
"""

import csv
import importlib.util
import sys
from collections import Counter
from pathlib import Path

HERE = Path(__file__).parents[1] / "oee_tabular" / "tasks" / "bus_engines.csv"
COLUMNS = ("group", "bin", "replaced", "next_bin", "months")


def find_original():
    """Return the path of econirl's file, or None; the package is not imported."""
    package = importlib.util.find_spec("econirl")
    if package is None or not package.submodule_search_locations:
        return None
    path = Path(package.submodule_search_locations[0])
    return path / "datasets" / "rust_bus_original.csv"


def count_months(path):
    """Return group, bin, replaced, next bin and how many months had them, sorted.

    A month counts where the next month of the same bus is recorded.
    """
    with open(path, encoding="utf-8", newline="") as file:
        months = {
            (int(row["group"]), int(row["bus_id"]), int(row["period"])): row
            for row in csv.DictReader(file)
        }
    counts = Counter()
    for (group, bus, period), row in months.items():
        following = months.get((group, bus, period + 1))
        if following is not None:
            key = (
                group,
                int(row["mileage_bin"]),
                int(row["replaced"]),
                int(following["mileage_bin"]),
            )
            counts[key] += 1
    return [(*key, n) for key, n in sorted(counts.items())]


def read_header():
    """Return the lines of the shipped file that are comments."""
    lines = HERE.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith("#")]


def main():
    """Write the shipped file again under its own header."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else find_original()
    if path is None:
        sys.exit("econirl is not installed: give the path of rust_bus_original.csv")
    rows = [COLUMNS, *count_months(path)]
    lines = [*read_header(), *(",".join(map(str, row)) for row in rows)]
    HERE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
