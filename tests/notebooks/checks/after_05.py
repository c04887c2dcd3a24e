"""What the cells of notebook 05 leave is what its text says."""

import numpy as np


def after_05_04(errors, few, many):
    alone, weak, strong, better = (np.array(curve) for curve in errors.values())
    assert weak[few] < 0.5 * alone[few]
    assert strong[few] > alone[few]
    assert strong[many] > alone[many]
    assert (better < alone).all()


def after_05_12(fits, mean_error):
    assert mean_error(fits["shrunk to the tilt"]) < 0.1 * mean_error(
        fits["counts alone"]
    )


def after_05_13(exact):
    assert np.sum(np.abs(exact - 9 / 7) < 1e-12) == 98
    assert abs(exact[90] - 7 / 6) < 1e-12


def after_05_15(corner):
    assert abs(corner[0] / corner.sum() - (0.9 + 1 / 30)) < 0.02


def after_05_17(curves, grid, names):
    assert 2 < grid[curves[names[0]].argmax()] < 4
    assert grid[curves[names[1]].argmax()] > 1000


def after_05_24(table):
    assert (table[0, 2].mean(axis=1) < 0.06 * table[0, 0].mean(axis=1)).all()
    assert table[1, 2].mean() < table[1, 0].mean()
