"""The rule that sees one number x ~ N(b, 1) and has the least worst ratio: the table of
``oee_tabular.lab.bench.league``.

    python tests/benchmarks/floor.py

The convex program over odd rules delta, linear between nodes and delta(x) = x beyond
the last one:
minimise t subject to sqrt(E (delta(x) - b)^2) <= t max(min(b, 1), 1/2) for b = 0, 1/8,
..., 9.
"""

import cvxpy as cp
import numpy as np
from scipy import stats

from oee_tabular.lab.bench.league import ERRORS, LEAST

NODES = np.linspace(0.0, 12.0, 97)
TOP = 12.0
BIASES = np.arange(0.0, 9.01, 0.125)


def scale(b):
    """The error that a ratio is relative to, in units of eff."""
    return np.maximum(np.minimum(b, 1.0), LEAST)


def minimax_ratios():
    """The least worst ratio, and the rule's ratio at each of ``ERRORS``."""
    x = np.linspace(-TOP - 8.0, TOP + 8.0, 2401)
    inside = np.abs(x) <= TOP
    basis = (
        np.array(
            [
                np.sign(x) * np.interp(np.abs(x), NODES, unit)
                for unit in np.eye(len(NODES))
            ]
        ).T
        * inside[:, None]
    )
    beyond = np.where(inside, 0.0, x)

    def weighted(b):
        return np.sqrt(stats.norm.pdf(x - b) * (x[1] - x[0])) / scale(b)

    rule = cp.Variable(len(NODES))
    worst = cp.Variable()
    rules = []
    for b in BIASES:  # a triangular factor in place of 2401 points
        factor = np.linalg.qr(
            weighted(b)[:, None] * np.column_stack([basis, beyond - b]), mode="r"
        )
        rules.append(cp.norm(factor[:, :-1] @ rule + factor[:, -1]) <= worst)
    cp.Problem(cp.Minimize(worst), rules).solve(solver="CLARABEL")
    delta = basis @ rule.value + beyond
    return float(worst.value), np.array(
        [np.linalg.norm(weighted(b) * (delta - b)) for b in ERRORS]
    )


if __name__ == "__main__":
    least, ratios = minimax_ratios()
    print(f"least worst ratio {least:.4f}")
    print(", ".join(f"{ratio:.3f}" for ratio in ratios))
