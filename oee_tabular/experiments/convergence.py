"""How errors fall with n: rates, targets that the tilt misses, what normalisation and the ridge do, distance to the target."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._sparse import row_of_entry, row_sums
from oee_tabular.estimators import ModelBased, OffEnvironment, Problem, Simulator
from oee_tabular.exact import evaluate_policy, policy_value, reweight, weighted_return_moments
from oee_tabular.experiments.common import (
    DELTAS,
    HALF_DECADES,
    HORIZON,
    SIMULATED_SLIP,
    behavior_of,
    drawn,
    episodes_for,
    grids,
    halves,
    panels,
    rmse,
    series_of,
    zeta_error,
)
from oee_tabular.experiments.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import TransitionRatio, density_ratio, transition_ratio, true_ratio
from oee_tabular.ratio.quotient import simulator_weights
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.tasks import gridworld, gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

SCALE = 0.01  # values times (1 - discount)
MARK = 30_000  # n from which slopes are fitted

# ---- rate --------------------------------------------------------------------------------------------------------------

RATIOS: dict[str, Callable[..., TransitionRatio]] = {
    "maximum likelihood": partial(transition_ratio, prior="none"),
    "simulator prior, strength 1": partial(transition_ratio, prior="simulator", strength=1.0),
    "default": transition_ratio,
}


def rate_cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log: the first n moves of its episodes; three ratios, three policies."""
    n = int(settings["n"])
    simulator, target = grids(10)
    generator = stream.generator()
    log = episodes_for(target, behavior_of(str(settings["data"]), target), n, generator).first(n)
    problem = Problem(simulator, log, horizon=HORIZON)
    rows = []
    for name, fit in RATIOS.items():
        zeta = fit(log, simulator)
        for delta in DELTAS:
            policy = gridworld_policy(10, delta)
            value = OffEnvironment(zeta)(problem, policy).value
            error = SCALE * (value - policy_value(target, policy, horizon=HORIZON))
            rows.append({"ratio": name, "delta": delta, "error": error, "squared_error": error**2,
                         "zeta_error": zeta_error(zeta, target, simulator)})  # fmt: skip
    return rows


def fitted_slopes(table: pd.DataFrame, value: str = "squared_error", start: int = MARK) -> pd.Series:
    """Least-squares slope of log10 RMSE on log10 n, for each data policy, policy and ratio, from ``start`` on."""
    late = table[table.n >= start]
    points = late.groupby(["data", "delta", "ratio", "n"], sort=False)[value].mean().reset_index()
    return points.groupby(["data", "delta", "ratio"], sort=False)[["n", value]].apply(
        lambda g: 0.5 * np.polyfit(np.log10(g["n"]), np.log10(g[value]), 1)[0] if len(g) > 1 else np.nan
    )


def draw_rate(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """RMSE against n with slopes -1/2 and -1/4."""
    from oee_tabular.plots import plot_errors

    cases: list[Any] = list(table.groupby(["data", "delta"], sort=False).groups)
    n = sorted(table.n.unique())
    names = [f"data of {data}, delta = {delta:g}" for data, delta in cases]
    for ax, (data, delta) in zip(panels(figure, names, columns=3), cases, strict=True):
        part = table[(table.data == data) & (table.delta == delta)]
        curves = series_of(part, "ratio", "n", "error", n, rmse)
        first = next(iter(curves.values()))[0]
        ax.plot(
            n, first * (np.array(n) / n[0]) ** -0.25, color="grey", lw=1, ls=(0, (1, 4)), label="slope -0.25", zorder=0
        )
        plot_errors(n, curves, ax, slope=-0.5, ylabel="RMSE of the value times (1 - discount)")


RATE = Experiment(
    id="rate",
    title="The rate is n^-1/2, not the paper's bound n^-1/4",
    axes={"data": ("uniform", "pi_0.5"), "n": (*HALF_DECADES, 1_000_000)},
    smoke={"data": ("uniform",), "n": (1000, 10_000)},
    repetitions=60,
    run=rate_cell,
    keys=("data", "n", "delta", "ratio"),
    measures=("squared_error", "error", "zeta_error"),
    draw=draw_rate,
    caption=(
        "10 x 10 grid, T = 200; the first n moves of episodes of at most 1000 steps of the uniform policy, or of "
        "pi_0.5. Root mean square over the seeds of the error of the exact value, with lines of slope -1/2 and -1/4. "
        "The default is far more accurate while its tilt is as good as the data, and joins the others after that: its "
        "slope is flatter. Where the data policy hardly visits what the evaluated policy needs (data of pi_0.5, delta ="
        " 0.1), n = 10^6 is not yet large."
    ),
)

# ---- misspecified ------------------------------------------------------------------------------------------------------

CHOICES: dict[str, Callable[..., TransitionRatio]] = {
    "default": transition_ratio,
    "one tilt for all": partial(transition_ratio, smoothness=np.inf),
}


def misspecified_cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log; the exact and the one-step value of two ratios, maximum likelihood, the simulator."""
    n = int(settings["n"])
    simulator, target = halves(20)
    log = drawn(target, uniform_policy(target), n, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON)
    zetas = {name: fit(log, simulator) for name, fit in CHOICES.items()}
    rows = []
    for delta in DELTAS:
        policy = gridworld_policy(20, delta)
        truth = policy_value(target, policy, horizon=HORIZON)
        values = {
            "maximum likelihood": ModelBased()(problem, policy).value,
            "simulator": Simulator()(problem, policy).value,
        }
        told = {}
        for name, zeta in zetas.items():
            estimate = OffEnvironment(zeta)(problem, policy)
            values[name] = estimate.value
            values[f"{name}, one-step"] = estimate.diagnostics["one_step_value"]
            told[name] = "does not fit" in zeta.details["meaning"]
        for name, value in values.items():
            error = SCALE * (value - truth)
            rows.append({"delta": delta, "estimator": name, "error": error, "squared_error": error**2,
                         "says_it_does_not_fit": told.get(name, np.nan)})  # fmt: skip
    return rows


def draw_misspecified(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """RMSE against n for each policy."""
    from oee_tabular.plots import plot_errors

    deltas, n = sorted(table.delta.unique()), sorted(table.n.unique())
    for ax, delta in zip(panels(figure, [f"delta = {delta:g}" for delta in deltas]), deltas, strict=True):
        curves = series_of(table[table.delta == delta], "estimator", "n", "error", n, rmse)
        plot_errors(n, curves, ax, slope=None, ylabel="RMSE of the value times (1 - discount)")


MISSPECIFIED = Experiment(
    id="misspecified",
    title="A target that one tilt cannot express",
    axes={"n": HALF_DECADES},
    smoke={"n": (1000, 3162)},
    repetitions=20,
    run=misspecified_cell,
    keys=("n", "delta", "estimator"),
    measures=("squared_error", "error", "says_it_does_not_fit"),
    draw=draw_misspecified,
    caption=(
        "20 x 20 grid, slip 0.3 simulated; 0.1 real on the left half, 0.5 on the right; T = 200, data of the uniform "
        "policy. Root mean square over the seeds. The default finds that theta varies over the states; with one theta "
        "for all it is biased, and the one-step value takes the bias away with maximum likelihood's variance."
    ),
)

# ---- renyi -------------------------------------------------------------------------------------------------------------


def renyi_cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log of a grid with the given slip: the exact value's error, the product's, and how far the target is."""
    slip, delta = float(settings["slip"]), 0.5
    simulator, target = gridworld(10, SIMULATED_SLIP), gridworld(10, slip)
    policy = gridworld_policy(10, delta)
    log = drawn(target, uniform_policy(target), 3162, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON)
    zeta = transition_ratio(log, simulator)
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
    observed = aligned_counts(log.counts(100, 4), simulator)
    expected = simulator_weights(observed, log, simulator, None, behavior, stream.generator(use="simulator"), None)
    truth = policy_value(target, policy, horizon=HORIZON)
    options: dict[str, Any] = {"lower": 0.01, "upper": 10.0, "ridge": n**-0.5}
    rows = []
    for name in ("none", "global", "rows"):
        if name == "rows":
            zeta = transition_ratio(log, simulator, prior="none", toward=None, **options)
            sums, values = zeta.row_sum_error, zeta
        else:
            normalized = name == "global"
            moves = density_ratio(observed, expected, normalized=normalized, **options).ratio
            pairs = density_ratio(
                row_sums(pattern, observed), row_sums(pattern, expected), normalized=normalized, **options
            ).ratio
            quotient = moves / pairs[row_of_entry(pattern)]
            values = _csr(pattern, quotient)
            sums = float(np.abs(row_sums(pattern, quotient * pattern.data) - 1.0).max())
        value = evaluate_policy(reweight(simulator, values), policy, horizon=HORIZON).value
        rows.append({"normalisation": name, "error": abs(SCALE * (value - truth)), "row_sum_error": sums})
    return rows


def _csr(pattern: Any, data: Any) -> Any:
    from oee_tabular._sparse import on_pattern

    return on_pattern(pattern, data)


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
