"""How errors fall with n, and what the program for a ratio does: rates, priors, distance, normalisation, the ridge."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._sparse import csr_on_pattern, row_of_entry, row_sums
from oee_tabular.estimators import ModelBased, OffEnvironment, Problem, Simulator
from oee_tabular.exact import evaluate_policy, policy_value, reweight, weighted_return_moments
from oee_tabular.lab.experiments.common import (
    DELTAS,
    HALF_DECADES,
    HORIZON,
    MEAN_ERROR,
    NORMALISED,
    SCALE,
    ZETA_ERROR,
    behavior_of,
    error_of,
    grids,
    halves,
    rmse,
    rmse_panels,
    sample_log,
    sample_pool,
    zeta_error,
)  # fmt: skip
from oee_tabular.lab.findings import number, rank
from oee_tabular.lab.panels import Beside, Errors, Panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import Quotient, TransitionRatio, transition_ratio, true_ratio
from oee_tabular.tasks import gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Fit = Callable[..., TransitionRatio]  # of log, simulator, policy

# ---- rate --------------------------------------------------------------------------------------------------------------

RATIOS: dict[str, Fit] = {
    "maximum likelihood": lambda log, simulator, _: transition_ratio(log, simulator, prior="none"),
    "simulator prior, strength 1": lambda log, simulator, _: transition_ratio(
        log, simulator, prior="simulator", strength=1.0
    ),
    "default": lambda log, simulator, policy: transition_ratio(log, simulator, values_of=policy, horizon=HORIZON),
}


def rate_cell(settings: Cell, stream: Stream) -> list[Row]:
    """The paper's 10 x 10 grid; the first n transitions of episodes of at most 1000 steps of the uniform policy, or of
    pi_0.5. Root mean square over the seeds of the error of the exact value, with lines of slope -1/2 and -1/4. The
    default is more accurate at every n, by less as n grows. With data of pi_0.5 and delta = 0.1, n = 10^6 is not yet
    large.
    """
    n = int(settings["n"])
    simulator, target = grids()
    log = sample_pool(target, behavior_of(str(settings["data"]), target), n, stream.generator()).first(n)
    problem = Problem(simulator, log, horizon=HORIZON)
    rows: list[Row] = []
    for name, fit in RATIOS.items():
        for delta in DELTAS:
            policy = gridworld_policy(10, delta)
            zeta = fit(log, simulator, policy)
            error = error_of(OffEnvironment(zeta)(problem, policy).value, policy_value(target, policy, horizon=HORIZON))
            rows.append({"ratio": name, "delta": delta, **error, "zeta_error": zeta_error(zeta, target, simulator)})
    return rows


def quarter_slope(ax: Axes, rows: pd.DataFrame) -> None:
    """A grey line of slope -1/4 from where the first curve begins."""
    n = np.sort(rows.n.unique())
    first = rows[(rows.n == n[0]) & (rows.ratio == rows.ratio.iloc[0])]
    line = rmse(first.error) * (n / n[0]) ** -0.25
    ax.plot(n, line, color="grey", lw=1, ls=(0, (1, 4)), label="slope -0.25", zorder=0)


RATE = Experiment(
    "rate", "The rate of the error, beside the paper's bound n^-1/4",
    axes={"data": ("uniform", "pi_0.5"), "n": (*HALF_DECADES, 1_000_000)},
    smoke={"data": ("uniform",), "n": (1000, 10_000)}, repetitions=60,
    run=rate_cell, keys=("data", "n", "delta", "ratio"), measures=("squared_error", "error", "zeta_error"),
    finding=rank("RMSE", "error", "ratio", how=rmse),
    draw=rmse_panels(
        "ratio", "data", "delta", title="data of {data}, delta = {delta:g}", slope=-0.5, beneath=quarter_slope, columns=3
    ),
)  # fmt: skip

# ---- misspecified ------------------------------------------------------------------------------------------------------

CHOICES: dict[str, OffEnvironment] = {
    "default": OffEnvironment(),
    "one tilt for all": OffEnvironment(ratio=partial(transition_ratio, prior="tilt")),
}


def misspecified_cell(settings: Cell, stream: Stream) -> list[Row]:
    """20 x 20 grid; the real slip is 0.1 on the left half and 0.5 on the right; data of the uniform policy. Root mean square
    over the seeds. With one theta for all the prior is wrong, and the value is moved from it (the share moved is in the
    table) towards maximum likelihood's.
    """
    n = int(settings["n"])
    simulator, target = halves(20)
    log = sample_log(target, uniform_policy(target), n, stream.generator())
    problem = Problem(simulator, log, horizon=HORIZON)
    rows: list[Row] = []
    for delta in DELTAS:
        policy = gridworld_policy(20, delta)
        truth = policy_value(target, policy, horizon=HORIZON)
        values = {
            "maximum likelihood": ModelBased()(problem, policy).value,
            "simulator": Simulator()(problem, policy).value,
        }
        moved = {}
        for name, estimator in CHOICES.items():
            estimate = estimator(problem, policy)
            values[name], moved[name] = estimate.value, estimate.diagnostics["moved"]
            values[f"{name}, one-step"] = estimate.diagnostics["one_step_value"]
        for name, value in values.items():
            rows.append({"delta": delta, "estimator": name, **error_of(value, truth), "moved": moved.get(name, np.nan)})
    return rows


MISSPECIFIED = Experiment(
    "misspecified", "A target that one tilt cannot express",
    axes={"n": HALF_DECADES}, smoke={"n": (1000, 3162)}, repetitions=20,
    run=misspecified_cell, keys=("n", "delta", "estimator"), measures=("squared_error", "error", "moved"),
    finding=rank("RMSE", "error", "estimator", how=rmse, names=("default", "one tilt for all", "maximum likelihood")),
    draw=rmse_panels("estimator", "delta"),
)  # fmt: skip

# ---- renyi -------------------------------------------------------------------------------------------------------------


def renyi_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, slip 0.3 simulated, delta = 0.5, T = 200, n = 3162 moves of the uniform policy. Means over the
    seeds. D_inf = log max zeta; d_2 in the table is the largest log sum P zeta^2 of a row, the growth of a product's
    second moment in a step.
    """
    slip, delta = float(settings["slip"]), 0.5
    simulator, target = grids(10, slip)
    policy = gridworld_policy(10, delta)
    log = sample_log(target, uniform_policy(target), 3162, stream.generator())
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
    return Panels(
        "error", "estimator", x, (), title, xlabel, MEAN_ERROR, {"one oracle product, exact sd": "oracle_product_sd"},
        log=True, axes={"ylim": (1e-3, 1e4)},
    )  # fmt: skip


RENYI = Experiment(
    "renyi", "Error against the distance between simulator and target",
    axes={"slip": (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)}, smoke={"slip": (0.1, 0.5)},
    run=renyi_cell, keys=("slip", "d_inf", "d_2", "estimator"), measures=("error", "oracle_product_sd"),
    finding=rank("Mean error", "error", "estimator", "slip"),
    draw=Beside(
        [
            renyi_panel("slip", "against the real slip (0.3 is simulated)", "real slip"),
            renyi_panel("d_inf", "against D_inf, the largest log ratio", "D_inf (nats)"),
        ]
    ),
)  # fmt: skip

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
    log = sample_log(target, behavior, n, stream.generator())
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


NORMALISATION = Experiment(
    "normalisation", "What the constraint sum beta q = 1 does: none, global, by rows",
    axes={"n": HALF_DECADES}, smoke={"n": (1000, 10_000)},
    run=normalisation_cell, keys=("n", "normalisation"), measures=("error", "row_sum_error"),
    finding=rank("Median error", "error", "normalisation", how=np.median),
    draw=Beside(
        [
            median_errors("error", "error of the exact value", f"median |error| {NORMALISED}"),
            median_errors("row_sum_error", "largest |sum of zeta P - 1| of a row", "median over seeds (no unit)"),
        ]
    ),
)  # fmt: skip

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
    log = sample_log(target, behavior, n, stream.generator())
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
        f"{number(error)} at n = {n} ({penalty}, worth {moves:g})"
        for n, penalty, moves, error in best.itertuples(index=False, name=None)
    )


LAMBDA = Experiment(
    "lambda_n", "lambda_n and I(g): the paper's ridge and its alternatives, swept",
    axes={"n": (1000, 10_000, 100_000)}, smoke={"n": (1000,)},
    run=lambda_cell, keys=("n", "penalty", "moves"), measures=("zeta_error", "value_error"), finding=lambda_finding,
    draw=Panels(
        "zeta_error", "penalty", "moves", by=("n",), xlabel="transitions that the penalty is worth", ylabel=ZETA_ERROR,
        log=True, beneath=from_no_penalty,
    ),
)  # fmt: skip
