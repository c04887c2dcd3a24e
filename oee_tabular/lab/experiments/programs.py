"""What the program for a ratio does: distance to the target, normalisation, the ridge."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._sparse import csr_on_pattern, row_of_entry, row_sums
from oee_tabular.estimators import OffEnvironment, Problem, Simulator
from oee_tabular.exact import evaluate_policy, policy_value, reweight, weighted_return_moments
from oee_tabular.lab.experiments.common import (
    HALF_DECADES,
    HORIZON,
    MEAN_ERROR,
    NORMALISED,
    SCALE,
    drawn,
    grids,
    zeta_error,
)
from oee_tabular.lab.findings import listed, number, reach, span
from oee_tabular.lab.panels import Beside, Errors, Panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import Quotient, transition_ratio, true_ratio
from oee_tabular.tasks import gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

# ---- renyi -------------------------------------------------------------------------------------------------------------


def renyi_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, slip 0.3 simulated, delta = 0.5, T = 200, n = 3162 moves of the uniform policy. Means over the
    seeds. D_inf = log max zeta; d_2 in the table is the largest log sum P zeta^2 of a row, the growth of a product's
    second moment in a step.
    """
    slip, delta = float(settings["slip"]), 0.5
    simulator, target = grids(10, slip)
    policy = gridworld_policy(10, delta)
    log = drawn(target, uniform_policy(target), 3162, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON)
    zeta = transition_ratio(log, simulator, values_of=policy, horizon=HORIZON)
    truth = policy_value(target, policy, horizon=HORIZON)
    ratio = true_ratio(target, simulator).values.data
    second = row_sums(simulator.transitions, simulator.transitions.data * ratio**2)
    product = OffEnvironment(zeta, evaluation="monte_carlo", n_rollouts=100)
    values = {
        "simulator": Simulator()(problem, policy).value,
        "OEE, exact": OffEnvironment(zeta)(problem, policy).value,
        "OEE, product (100 rollouts)": product(problem, policy, seed=stream.generator(use="rollouts")).value,
    }
    moments = weighted_return_moments(simulator, true_ratio(target, simulator), policy, horizon=HORIZON)
    return [
        {
            "estimator": name,
            "error": abs(SCALE * (value - truth)),
            "d_inf": float(np.log(ratio.max())),
            "d_2": float(np.log(second.max())),
            "oracle_product_sd": SCALE * float(np.sqrt(moments.variance)),
        }
        for name, value in values.items()
    ]


def renyi_panel(x: str, title: str, xlabel: str) -> Panels:
    """Errors against a measure of distance, and the spread of a product with the true ratio."""
    spread = {"one oracle product, exact sd": "oracle_product_sd"}
    axes = {"ylim": (1e-3, 1e4)}
    return Panels("error", "estimator", x, (), title, xlabel, MEAN_ERROR, spread, log=True, axes=axes)


def renyi_finding(table: pd.DataFrame) -> str:
    """The largest error of each estimator, the smallest first."""
    worst = table.groupby(["estimator", "slip"]).error.mean().groupby("estimator").max().sort_values()
    return f"Real slip {reach(table.slip)}: errors at most {listed(worst)}"


RENYI = Experiment(
    id="renyi",
    title="Error against the distance between simulator and target",
    axes={"slip": (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)},
    smoke={"slip": (0.1, 0.5)},
    run=renyi_cell,
    keys=("slip", "d_inf", "d_2", "estimator"),
    measures=("error", "oracle_product_sd"),
    draw=Beside(
        [
            renyi_panel("slip", "against the real slip (0.3 is simulated)", "real slip"),
            renyi_panel("d_inf", "against D_inf, the largest log ratio", "D_inf (nats)"),
        ]
    ),
    finding=renyi_finding,
)

# ---- normalisation -----------------------------------------------------------------------------------------------------


def normalisation_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, T = 200, delta = 0.5, n moves of the uniform policy against as many of the simulator; box [0.01,
    10], ridge 1 / sqrt(n). none, global: two programs and their quotient; rows: zeta itself, sum_s' zeta P = 1 in
    every row. Medians over the seeds: without normalised rows the value is that of a kernel whose rows sum to
    anything, and can be astronomical.
    """
    n, delta = int(settings["n"]), 0.5
    simulator, target = grids()
    policy = gridworld_policy(10, delta)
    behavior = uniform_policy(target)
    log = drawn(target, behavior, n, stream.generator())
    pattern = simulator.transitions
    truth = policy_value(target, policy, horizon=HORIZON)
    options: dict[str, Any] = {"lower": 0.01, "upper": 10.0, "ridge": n**-0.5}
    rows = []
    for name in ("none", "global", "rows"):
        if name == "rows":
            zeta = transition_ratio(log, simulator, prior="none", toward=None, **options)
            sums, values = zeta.row_sum_error, zeta
        else:
            quotient = Quotient(normalized=name == "global", toward=None, behavior_policy=behavior, **options)
            fit = quotient.fit(log, simulator, seed=stream.generator(use="simulator"))
            moves, pairs = (beta.ratio for beta in fit.details["beta"])
            plain = (
                moves / pairs[row_of_entry(pattern)]
            )  # also where neither side has the move: 1 over the pair's ratio
            values = csr_on_pattern(pattern, plain)
            sums = float(np.abs(row_sums(pattern, plain * pattern.data) - 1.0).max())
        value = evaluate_policy(reweight(simulator, values), policy, horizon=HORIZON).value
        rows.append({"normalisation": name, "error": abs(SCALE * (value - truth)), "row_sum_error": sums})
    return rows


def median_errors(y: str, title: str, ylabel: str) -> Errors:
    """Medians over the seeds, of which some are astronomical."""
    return Errors(y, "normalisation", how=np.median, title=title, ylabel=ylabel)


def normalisation_finding(table: pd.DataFrame) -> str:
    """The largest median error of each program."""
    worst = table.groupby(["normalisation", "n"]).error.median().groupby("normalisation").max().sort_values()
    return f"{span(table)}, largest median error by what is normalised: {listed(worst)}"


NORMALISATION = Experiment(
    id="normalisation",
    title="What the constraint sum beta q = 1 does: none, global, by rows",
    axes={"n": HALF_DECADES},
    smoke={"n": (1000, 10_000)},
    run=normalisation_cell,
    keys=("n", "normalisation"),
    measures=("error", "row_sum_error"),
    draw=Beside(
        [
            median_errors("error", "error of the exact value", f"median |error| {NORMALISED}"),
            median_errors("row_sum_error", "largest |sum of zeta P - 1| of a row", "median over seeds (no unit)"),
        ]
    ),
    finding=normalisation_finding,
)

# ---- lambda_n ----------------------------------------------------------------------------------------------------------

STRENGTHS = (0.0, 0.01, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)


def _per_move(moves: float, n: float) -> float:
    return moves / n


def ridge(moves: float, toward: float | None) -> dict[str, Any]:
    """lambda_n = moves / n_sa in the rows' own programs."""
    return {"prior": "none", "ridge": partial(_per_move, moves), "toward": toward}


def quotient(moves: float) -> dict[str, Any]:
    """lambda_n = moves / n in the two programs of the quotient."""
    known = {"method": "ratio_of_ratios", "simulator_data": "exact", "toward": None}
    return known | {"ridge": partial(_per_move, moves)}


# arguments of ``transition_ratio``, where the penalty is worth so many moves
PENALTIES: dict[str, Callable[[float], dict[str, Any]]] = {
    "sum g^2": lambda moves: ridge(moves, None),
    "sum P g^2": lambda moves: ridge(moves, 0.0),
    "sum P (g - 1)^2": lambda moves: ridge(moves, 1.0),
    "-2 sum P log g": lambda moves: {"prior": "simulator", "strength": moves},
    "quotient, sum g^2": quotient,
}


def lambda_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, data of the uniform policy. The strength is the number of moves that the penalty is worth:
    lambda_n = moves / n_sa in a row, moves / n for the quotient's two programs (box [0.01, 10]). sum g^2: the paper's;
    sum P g^2: weighted by the simulator, with normalised rows the same program as sum P (g - 1)^2; -2 sum P log g: the
    Dirichlet prior. Means over seeds.
    """
    n = int(settings["n"])
    simulator, target = grids()
    policy = gridworld_policy(10, 0.5)
    truth = policy_value(target, policy, horizon=HORIZON)
    behavior = uniform_policy(simulator)
    log = drawn(target, behavior, n, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON, behavior_policy=behavior)
    rows = []
    for penalty, options in PENALTIES.items():
        for moves in STRENGTHS:
            zeta = transition_ratio(log, simulator, **options(moves))
            value = OffEnvironment(zeta)(problem, policy).value
            rows.append({"penalty": penalty, "moves": moves, "zeta_error": zeta_error(zeta, target, simulator),
                         "value_error": abs(SCALE * (value - truth))})  # fmt: skip
    return rows


def from_no_penalty(ax: Axes, rows: pd.DataFrame) -> None:
    """Strengths on a logarithmic axis that begins at 0."""
    ax.set_xscale("symlog", linthresh=0.01)


def lambda_finding(table: pd.DataFrame) -> str:
    """The best penalty at each n."""
    means = table.groupby(["n", "penalty", "moves"]).zeta_error.mean()
    best = means.loc[means.groupby("n").idxmin()].reset_index()
    return "Least error of zeta: " + "; ".join(
        f"{number(error)} at n = {n} ({penalty}, worth {moves:g} moves)"
        for n, penalty, moves, error in best.itertuples(index=False, name=None)
    )


LAMBDA = Experiment(
    id="lambda_n",
    title="lambda_n and I(g): the paper's ridge and its alternatives, swept",
    axes={"n": (1000, 10_000, 100_000)},
    smoke={"n": (1000,)},
    run=lambda_cell,
    keys=("n", "penalty", "moves"),
    measures=("zeta_error", "value_error"),
    draw=Panels(
        "zeta_error",
        "penalty",
        "moves",
        by=("n",),
        xlabel="moves that the penalty is worth",
        ylabel="mean |zeta error| (ratio, no unit)",
        log=True,
        beneath=from_no_penalty,
    ),
    finding=lambda_finding,
)
