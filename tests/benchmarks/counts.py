"""Logs as counts beside DuckDB alone, for the same columns and sums: ``python tests/benchmarks/counts.py [transitions]``.

CPU seconds of this process in turns, medians. 10^9 transitions are projected from the slope between a tenth and all.
"""

import resource
import sys
import tempfile
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
from common import interleaved

import oee_tabular as oee

SUMS = "state, action, next_state, terminated, count(*), sum(reward), min(reward), max(reward)"


def write(folder, n):
    """A parquet and a CSV file of n transitions between 100 states with 4 actions."""
    rng = np.random.default_rng(0)
    columns = {"state": 100, "action": 4, "next_state": 100}
    frame = pd.DataFrame({name: rng.integers(high, size=n) for name, high in columns.items()})
    frame = frame.assign(reward=rng.normal(size=n).round(3), terminated=rng.random(n) < 0.01)
    frame.to_parquet(folder / f"{n}.parquet", index=False)
    frame.head(10**6).to_csv(folder / f"{n}.csv", index=False)


def duck(path):
    """The groups and their sums, unchecked."""
    with duckdb.connect(":memory:", config={"threads": 1}) as connection:
        return connection.execute(f"SELECT {SUMS} FROM read_parquet(?) GROUP BY ALL", [str(path)]).fetchnumpy()


if __name__ == "__main__":
    n = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10**7
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size in (n // 10, n):
            write(folder, size)
        calls = {
            "ours, a tenth": lambda: oee.Transitions.open(folder / f"{n // 10}.parquet"),
            "ours": lambda: oee.Transitions.open(folder / f"{n}.parquet"),
            "DuckDB": lambda: duck(folder / f"{n}.parquet"),
            "ours, CSV loaded": lambda: oee.Transitions.load(folder / f"{n}.csv"),
            "ours, CSV counted": lambda: oee.Transitions.open(folder / f"{n}.csv"),
        }
        times = {name: seconds for name, (seconds, _) in interleaved(calls, 3.0).items()}
        for name, seconds in times.items():
            print(f"{name:20} {seconds:.3f} s")
        slope = (times["ours"] - times["ours, a tenth"]) / (0.9 * n)
        print(f"ours / DuckDB {times['ours'] / times['DuckDB']:.2f}; 10^9 projected {1e9 * slope:.0f} s")
        print(f"most memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB, with writing the files")
