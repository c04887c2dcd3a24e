"""table1 as data: its settings, what it says of itself, its figure from a table."""

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from oee_tabular.lab.output import figures, summary_of
from oee_tabular.lab.robots.kinova import (
    OEE,
    ORDER,
    PUBLISHED,
    REFERENCE,
    SIMULATOR,
    TABLE_1,
    TRUE,
    paper_value,
)


def made_up():
    rng = np.random.default_rng(0)
    rows = []
    for cell in TABLE_1.settings(repetitions=2).cells():
        for policy in (0.0, 0.3):
            for name in ORDER:
                value = -1.0 + 0.1 * rng.standard_normal()
                row = {"policy": policy, "estimator": name, "value": value, "error": value + 1, "removed": 0.5}
                rows.append({**cell, **row, "uncovered": 0.0, "left_out": 0.0})
    return pd.DataFrame(rows)


def test_it_is_laid_out_like_table_1_and_says_that_it_is_a_stand_in():
    table = made_up()
    summary = summary_of(TABLE_1, table)
    first = summary[(summary.target == REFERENCE) & (summary.data == 0.0) & (summary.policy == 0.0)].head(3)
    assert first.estimator.tolist() == [TRUE, OEE, SIMULATOR]
    assert_allclose(first.paper, [-0.911, -1.095, -1.181])
    assert summary.paper.notna().sum() == 6
    assert {"value_mean", "value_sd"} <= set(summary.columns)
    assert "stand-in" in TABLE_1.title
    assert "STAND-IN" in TABLE_1.caption
    assert [paper_value(name) for name in PUBLISHED] == [-0.911, -1.095, -1.181]
    made = figures(TABLE_1, table, summary)["figure.svg"].decode()
    assert "stand-in" in made
    assert "the real arm" in made
