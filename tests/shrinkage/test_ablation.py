"""The twin of tests/benchmarks/ablation.py: two of its families, and what it shows."""

import pandas as pd
import pytest
from benchmarks import ablation

from oee_tabular import shrinkage

SAVED = pd.read_csv(ablation.FOLDER / "cells.csv")
TABLE = ablation.summarise(SAVED)


def test_two_families_of_the_saved_table_are_made_again():
    names = ["corridor30", "machine"]
    made = ablation.measure(names, ablation.SIZES[:1], ablation.N_SEEDS)
    saved = SAVED[SAVED["family"].isin(names) & (SAVED["size"] == ablation.SIZES[0])]
    keys = ["family", "estimator"]
    pd.testing.assert_frame_equal(
        made.sort_values(keys).reset_index(drop=True),
        saved.sort_values(keys).reset_index(drop=True),
        rtol=1e-4,
        check_dtype=False,
    )


@pytest.mark.parametrize("size", ablation.SIZES)
def test_where_the_simulator_is_wrong_each_part_buys_something(size):
    """By more than three standard errors of the difference, taken as independent."""
    rows = TABLE[(TABLE["simulator"] == "wrong") & (TABLE["size"] == size)]
    rows = rows.set_index("estimator")

    def is_better(one, other):
        gain = rows["error"][other] - rows["error"][one]
        noise = rows["error_se"][[one, other]].pow(2).sum() ** 0.5
        return gain > 3.0 * noise

    default = "the default"
    assert is_better(default, "no prior (maximum likelihood)")
    assert is_better(default, "the simulator as prior, moved")
    assert is_better("tilt along all directions", "tilt along log P")
    assert rows["worst"].idxmin() == default
    assert rows["covers"][default] > 0.95


def test_the_page_and_the_door_have_the_saved_numbers():
    page = (ablation.FOLDER / "summary.md").read_text()
    assert page == ablation.write_page(TABLE)
    rows = TABLE[TABLE["size"] == 30].set_index(["estimator", "simulator"])
    for name in ablation.ESTIMATORS:
        wrong, right = rows.loc[name, "wrong"], rows.loc[name, "right"]
        words = [
            f"{wrong['error']:.2f}",
            f"{wrong['worst']:.1f}",
            f"{wrong['covers']:.0%}",
            f"{right['error']:.2f}",
            f"{right['covers']:.0%}",
        ]
        line = next(
            line
            for line in shrinkage.__doc__.splitlines()
            if line.strip().startswith(f"{name}  ")
        )
        assert line.strip().removeprefix(name).split() == words
