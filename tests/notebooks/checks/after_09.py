"""What the cells of notebook 09 leave is what its text says."""

import pandas as pd


def after_09_07(LENGTHS, uncovered, weights):
    assert uncovered["links of 0.1 m"] > 0.5
    assert uncovered["all five, averaged"] == 0
    assert weights[LENGTHS.index(0.05)] > 0.99


def after_09_09(errors):
    strong, tamed = (pd.Series(error) for error in errors.values())
    weighted = "OEE: weighted, and a tenth averaged"
    frequencies = "model-based, same cells"
    assert strong[weighted] < 0.5 * min(strong["simulator"], strong[frequencies])
    assert (
        tamed["simulator"]
        < 0.5 * tamed.drop(["simulator", "linear model, no cells"]).min()
    )


def after_09_12(mean, model, sim):
    assert (mean.loc["OEE"] < 0.5 * mean.loc[sim]).all()
    assert (mean.loc[model] < mean.loc["OEE, calibrated"]).all()


def after_09_19(alone, left_out, uncovered):
    assert uncovered > 0.1 > left_out
    assert alone.visited.mean() < 0.01


def after_09_22(table):
    assert abs(table.error["OEE, tied"]) < 0.3 * abs(table.error["simulator"])
    assert abs(table.error["OEE, not tied"]) > 0.5 * abs(table.error["simulator"])
    assert table.error["model-based"] < -1


def after_09_26(report):
    assert report[0][2] == [1, 1] != report[1][2]


def after_09_20(alone, boxes, forward, home):
    for box in boxes.values():
        assert alone.visited[box, forward] == (box == home)
