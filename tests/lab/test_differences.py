"""The twin of tests/benchmarks/differences.py: a few of its comparisons."""

import warnings

import pandas as pd
from benchmarks import differences


def test_the_default_tells_policies_apart_better_than_maximum_likelihood():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rows = [
            row
            for kind in ("thermostat", "dosing", "weeds")
            for repetition in range(2)
            for row in differences.rows_of(kind, repetition)
        ]
    table = pd.DataFrame(rows)
    assert len(table) > 100
    score = table.groupby("rule")["score"].mean()
    assert score["default"] < score["maximum likelihood"]
    assert not table["is_wrong"].any()
    assert table["covers"].mean() > 0.9
    assert table["is_tie"].any()
