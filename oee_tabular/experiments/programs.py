"""What the program for a ratio does: distance to the target, normalisation, the ridge."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._sparse import on_pattern, row_of_entry, row_sums
from oee_tabular.estimators import OffEnvironment, Problem, Simulator
from oee_tabular.exact import evaluate_policy, policy_value, reweight, weighted_return_moments
from oee_tabular.experiments.common import (
    HALF_DECADES,
    HORIZON,
    SIMULATED_SLIP,
    drawn,
    grids,
    panels,
    series_of,
    zeta_error,
)
from oee_tabular.experiments.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import Quotient, transition_ratio, true_ratio
from oee_tabular.tasks import gridworld, gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

SCALE = 0.01  # values times (1 - discount)

# ---- renyi -------------------------------------------------------------------------------------------------------------


def renyi_cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log of a grid with the given slip: the exact value's error, the product's, and how far the target is."""
    slip, delta = float(settings["slip"]), 0.5
    simulator, target = gridworld(10, SIMULATED_SLIP), gridworld(10, slip)
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


def draw_renyi(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Against the slip, and against D_inf."""
    from oee_tabular.plots import plot_curves

    first, second = panels(figure, ["against the real slip (0.3 is simulated)", "against D_inf, the largest log ratio"])
    for ax, x, label in ((first, "slip", "real slip"), (second, "d_inf", "D_inf (nats)")):
        where = sorted(table[x].unique())
        curves = {
            name: np.where(y > 0, y, np.nan) for name, y in series_of(table, "estimator", x, "error", where).items()
        }
        curves["one oracle product, exact sd"] = table.groupby(x).oracle_product_sd.first().reindex(where).to_numpy()
        plot_curves(where, curves, ax, xlabel=label, ylabel="mean |error| of the value times (1 - discount)")
        ax.set_yscale("log")
        ax.set_ylim(1e-3, 1e4)


RENYI = Experiment(
    id="renyi",
    title="Error against the distance between simulator and target",
    axes={"slip": (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)},
    smoke={"slip": (0.1, 0.5)},
    run=renyi_cell,
    keys=("slip", "d_inf", "d_2", "estimator"),
    measures=("error", "oracle_product_sd"),
    draw=draw_renyi,
    caption=(
        "10 x 10 grid, slip 0.3 simulated, delta = 0.5, T = 200, n = 3162 moves of the uniform policy. Means over the "
        "seeds. D_inf = log max zeta; d_2 in the table is the largest log sum P zeta^2 of a row, the growth of a "
        "product's second moment in a step."
    ),
)

# ---- normalisation -----------------------------------------------------------------------------------------------------


def normalisation_cell(settings: Cell, stream: Stream) -> list[Row]:
    """The paper's program without, with the global, and with the rows' constraint; ridge 1 / sqrt(n), the paper's box."""
    n, delta = int(settings["n"]), 0.5
    simulator, target = grids(10)
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
            values = on_pattern(pattern, plain)
            sums = float(np.abs(row_sums(pattern, plain * pattern.data) - 1.0).max())
        value = evaluate_policy(reweight(simulator, values), policy, horizon=HORIZON).value
        rows.append({"normalisation": name, "error": abs(SCALE * (value - truth)), "row_sum_error": sums})
    return rows


def draw_normalisation(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """|error| on a logarithmic axis."""
    from oee_tabular.plots import plot_errors

    first, second = panels(figure, ["error of the exact value", "largest |sum of zeta P - 1| of a row"])
    n = sorted(table.n.unique())
    plot_errors(n, series_of(table, "normalisation", "n", "error", n, np.median), first, slope=None,
                ylabel="median |error| of the value times (1 - discount)")  # fmt: skip
    plot_errors(n, series_of(table, "normalisation", "n", "row_sum_error", n, np.median), second, slope=None,
                ylabel="median over seeds (no unit)")  # fmt: skip


NORMALISATION = Experiment(
    id="normalisation",
    title="What the constraint sum beta q = 1 does: none, global, by rows",
    axes={"n": HALF_DECADES},
    smoke={"n": (1000, 10_000)},
    run=normalisation_cell,
    keys=("n", "normalisation"),
    measures=("error", "row_sum_error"),
    draw=draw_normalisation,
    caption=(
        "10 x 10 grid, T = 200, delta = 0.5, n moves of the uniform policy against as many of the simulator; box [0.01,"
        " 10], ridge 1 / sqrt(n). none, global: two programs and their quotient; rows: zeta itself, sum_s' zeta P = 1 "
        "in every row. Medians over the seeds: without normalised rows the value is that of a kernel whose rows sum to "
        "anything, and can be astronomical."
    ),
)

# ---- lambda_n ----------------------------------------------------------------------------------------------------------

PENALTIES = ("sum g^2", "sum P g^2", "sum P (g - 1)^2", "-2 sum P log g", "quotient, sum g^2")
STRENGTHS = (0.0, 0.01, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)


def penalty_options(penalty: str, moves: float) -> dict[str, Any]:
    """Arguments of ``transition_ratio``; the penalty is worth ``moves`` moves: lambda_n = moves / n_sa."""
    if penalty == "-2 sum P log g":
        return {"prior": "simulator", "strength": moves}
    ridge = partial(_per_move, moves)
    if penalty == "quotient, sum g^2":
        return {"method": "ratio_of_ratios", "simulator_data": "exact", "ridge": ridge, "toward": None}
    return {
        "prior": "none",
        "ridge": ridge,
        "toward": {"sum g^2": None, "sum P g^2": 0.0, "sum P (g - 1)^2": 1.0}[penalty],
    }


def _per_move(moves: float, n: float) -> float:
    return moves / n


def lambda_cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log; every penalty at every strength."""
    n = int(settings["n"])
    simulator, target = grids(10)
    policy = gridworld_policy(10, 0.5)
    truth = policy_value(target, policy, horizon=HORIZON)
    behavior = uniform_policy(simulator)
    log = drawn(target, behavior, n, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON, behavior_policy=behavior)
    rows = []
    for penalty in PENALTIES:
        for moves in STRENGTHS:
            zeta = transition_ratio(log, simulator, **penalty_options(penalty, moves))
            value = OffEnvironment(zeta)(problem, policy).value
            rows.append({"penalty": penalty, "moves": moves, "zeta_error": zeta_error(zeta, target, simulator),
                         "value_error": abs(SCALE * (value - truth))})  # fmt: skip
    return rows


def draw_lambda(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """zeta's error against the strength, a panel for each n."""
    from oee_tabular.plots import plot_curves

    sizes = sorted(table.n.unique())
    for ax, n in zip(panels(figure, [f"n = {n}" for n in sizes]), sizes, strict=True):
        part = table[table.n == n]
        moves = sorted(part.moves.unique())
        curves = series_of(part, "penalty", "moves", "zeta_error", moves)
        plot_curves(
            moves, curves, ax, xlabel="moves that the penalty is worth", ylabel="mean |zeta error| (ratio, no unit)"
        )
        ax.set_xscale("symlog", linthresh=0.01)
        ax.set_yscale("log")


LAMBDA = Experiment(
    id="lambda_n",
    title="lambda_n and I(g): the paper's ridge and its alternatives, swept",
    axes={"n": (1000, 10_000, 100_000)},
    smoke={"n": (1000,)},
    run=lambda_cell,
    keys=("n", "penalty", "moves"),
    measures=("zeta_error", "value_error"),
    draw=draw_lambda,
    caption=(
        "10 x 10 grid, data of the uniform policy. The strength is the number of moves that the penalty is worth: "
        "lambda_n = moves / n_sa in a row, moves / n for the quotient's two programs (box [0.01, 10]). sum g^2: the "
        "paper's; sum P g^2: weighted by the simulator, with normalised rows the same program as sum P (g - 1)^2; -2 "
        "sum P log g: the Dirichlet prior. Means over seeds."
    ),
)
