"""Experiments on the error of zeta and of what rests on it.

They are fig1a and networks, and vary sample size, prior, distance, normalisation and
the ridge.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.special import xlogy

import oee_tabular as oee
from oee_tabular._sparse import csr_on_pattern, row_of_entry, row_sums
from oee_tabular.estimators import ModelBased, OffEnvironment, Simulator
from oee_tabular.exact import evaluate_policy, reweight
from oee_tabular.lab.experiment import (
    Cell,
    Panels,
    Row,
    Stream,
    add_slope,
    experiment,
    number,
)
from oee_tabular.lab.experiments import common
from oee_tabular.lab.experiments.common import (
    DATA,
    DELTAS,
    HALF_DECADES,
    HORIZON,
    SCALE,
    grids,
    sample_log,
    zeta_error,
)
from oee_tabular.plots import INK
from oee_tabular.ratio import Network, Quotient, action_displacement
from oee_tabular.ratio.support import aligned_counts
from oee_tabular.tasks import gridworld, gridworld_policy
from oee_tabular.typing import Array

DEFAULT = "default (tilt by evidence)"
QUOTIENT = "paper's quotient, tabular"
FITS: dict[str, dict[str, Any]] = {  # options of ``transition_ratio``
    DEFAULT: {},
    "maximum likelihood": {"prior": "none"},
    "simulator prior": {"prior": "simulator"},
    QUOTIENT: {"method": "ratio_of_ratios"},
    "linear class": {"method": "linear"},
}


def error_of_paper(row: Any) -> float:
    """Return the error of the paper's networks where a row of a table or summary is.

    Their data are the uniform policy's.
    """
    if row.get("data", "uniform") != "uniform":
        return np.nan
    grid = f"grid={row.get('grid', 10)}"
    return common.published_at("fig1a", grid, "mean_absolute_error_of_zeta", row["n"])


def draw_published(ax: Any, rows: pd.DataFrame) -> None:
    """Draw the paper's networks where they were published."""
    points = rows.drop_duplicates("n").sort_values("n")
    errors = [error_of_paper(row) for row in points.to_dict("records")]
    if np.isfinite(errors).any():
        ax.plot(
            points.n, errors, color=INK, marker="x", lw=1.2, label="paper's networks"
        )


ZetaPanels = functools.partial(
    common.ErrorPanels,
    "error",
    ylabel="mean |zeta error|",
    beneath=draw_published,
    bands=True,
)  # against n


@experiment(
    "Figure 1a: error of the ratio of transition probabilities against sample size",
    axes={"data": tuple(DATA), "grid": (10, 20, 40), "n": HALF_DECADES},
    keys=("data", "grid", "n", "estimator"),
    measures=("error",),
    paper=error_of_paper,
    draw=ZetaPanels("estimator", by=("data", "grid"), columns=3),
)
def fig1a(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |zeta_hat - zeta| over the simulator's support, the goal left out (zeta = 1
    scores 0.570).
    Bands: smallest and largest. The linear class has indicators of (action,
    displacement).
    """
    size = settings["grid"]
    generator = stream.generator()
    simulator, target = grids(size)
    log = sample_log(target, DATA[settings["data"]], settings["n"], generator)
    places = np.column_stack(np.divmod(np.arange(size**2), size))
    rows = []
    for name, options in FITS.items():
        features: dict[str, Any] = (
            {"features": action_displacement(simulator, places)}
            if name == "linear class"
            else {}
        )
        zeta = oee.transition_ratio(
            log, simulator, seed=generator, **options, **features
        )
        rows.append(
            {
                "estimator": name,
                "error": zeta_error(zeta, target, simulator),
                "gap": zeta.gap,
            }
        )
    return rows


RECORDED = "a log of n moves"  # a setting of the saved table
BOX: dict[str, Any] = {"lower": 0.1, "upper": 10.0, "normalized": False}
TRAINED = Network((32,), "tanh", batch_size=512, n_iterations=12_000, step_size=1e-2)
FULL_BATCH = Network(
    (32,), "tanh", batch_size=None, n_iterations=5000, step_size=2e-2, held_out=0.0
)
NAMES = {
    "trained": "network, trained (Algorithm 1)",
    "log": "network, full batch on the log",
    "best": "network, full batch on the population",
    "table": QUOTIENT,
    "default": DEFAULT,
}
PARTS = ("approximation", "sampling", "optimisation")
Pair = tuple[Array, Array]


def pair_shares(transitions: Array) -> Pair:
    """Return the shares of (s, a, s') and of (s, a)."""
    shares = transitions / transitions.sum()
    return shares, row_sums(grids()[0].transitions, shares)


def log_shares(log: oee.Transitions) -> Pair:
    """Return the shares of (s, a, s') and of (s, a) in a log."""
    simulator, _ = grids()
    return pair_shares(
        aligned_counts(log.counts(simulator.n_states, simulator.n_actions), simulator)
    )


@functools.cache
def population() -> tuple[Pair, Pair]:
    """Compute p and q of both ratios.

    The transitions of the uniform policy's episodes are drawn from them.
    """
    pairs = []
    for mdp in reversed(grids()):
        share = oee.occupancy(
            mdp.with_discount(1.0),
            oee.uniform_policy(mdp),
            horizon=common.MAX_EPISODE_STEPS,
            of="transition",
        )
        live = np.repeat(~mdp.absorbing(), mdp.n_actions)
        pairs.append(pair_shares(share.data * np.repeat(live, np.diff(share.indptr))))
    return pairs[0], pairs[1]


def risk(ratios: list[Array], shares: tuple[Pair, Pair]) -> float:
    """Compute sum q g - sum p log g of both ratios together, in nats.

    It is eq. 3.7, a finite sum here.
    """
    return float(
        sum(q @ g - xlogy(p, g).sum() for g, p, q in zip(ratios, *shares, strict=True))
    )


@functools.lru_cache(maxsize=8)
def best_of_class(seed: int, repetition: int) -> oee.TransitionRatio:
    """Fit the class for long on the population, scaled to counts."""
    simulator, _ = grids()
    counts = csr_on_pattern(simulator.transitions, population()[0][0])
    method = Quotient(
        **BOX,
        functions=FULL_BATCH,
        data="exact",
        behavior_policy=oee.uniform_policy(simulator),
    )
    return method.fit(counts, simulator, seed=[seed, repetition])


EXCESS = common.ErrorPanels(  # approximation is 0 but for rounding
    "excess",
    title="excess risk in parts",
    ylabel="excess risk of both ratios (nats)",
    extra={name: name for name in PARTS[1:]}
    | {"trained, in all (population's risk)": "excess"},
    only=lambda rows: rows[rows.fit == NAMES["trained"]],
)


@experiment(
    "Figure 1a with our own networks, and what their error is made of",
    axes={"simulator": ("sampled afresh", RECORDED), "n": HALF_DECADES},
    repetitions=3,
    keys=("simulator", "n", "fit"),
    measures=("error", "excess", *PARTS),
    paper=error_of_paper,
    draw=ZetaPanels(
        "fit",
        by=("simulator",),
        only=lambda rows: rows[rows.fit != NAMES["best"]],
        beside=[EXCESS],
        columns=2,
    ),
    requires=("jax", "equinox", "optax"),
    extra="neural",
)
def networks(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, n transitions of the uniform policy; the simulator's sampled afresh
    at each iteration (Algorithm 1), or a log of n. One hidden layer of 32 tanh units,
    Adam on batches of 512. With L the population's risk and L_n the log's (nats):
    approximation = L(best of the class, fitted to the population) - L(p / q), sampling
    = L(fitted to the log, full batch)
    - L(best), optimisation = L_n(trained) - L_n(fitted to the log), excess = L - L(p /
      q).
    """
    n = settings["n"]
    is_recorded = settings["simulator"] == RECORDED
    simulator, target = grids()
    log = sample_log(target, 0.0, n, stream.generator("n"))
    data: Any = (
        sample_log(simulator, 0.0, n, stream.generator("n", use="simulator"))
        if is_recorded
        else "exact"
    )
    quotient = Quotient(**BOX, data=data, behavior_policy=oee.uniform_policy(simulator))
    fits = {
        "best": best_of_class(stream.seed, settings["repetition"]),
        "table": quotient.fit(log, simulator),
    }
    for name, network in (("log", FULL_BATCH), ("trained", TRAINED)):
        fits[name] = replace(quotient, functions=network).fit(
            log, simulator, seed=stream.generator(use="training")
        )
    shares = log_shares(log), log_shares(data) if is_recorded else population()[1]
    ratios = {
        name: [beta.ratio for beta in zeta.details["beta"]]
        for name, zeta in fits.items()
    }
    least = risk(
        [p / np.where(q > 0, q, 1.0) for p, q in zip(*population(), strict=True)],
        population(),
    )
    excess = {name: risk(ratio, population()) - least for name, ratio in ratios.items()}
    optimisation = risk(ratios["trained"], shares) - risk(ratios["log"], shares)
    fits["default"] = oee.transition_ratio(log, simulator)
    rows: list[Row] = [
        {
            "fit": text,
            "error": zeta_error(fits[name], target, simulator),
            "excess": excess.get(name, np.nan),
        }
        for name, text in NAMES.items()
    ]
    rows[0] |= dict(
        zip(
            PARTS,
            (excess["best"], excess["log"] - excess["best"], optimisation),
            strict=True,
        )
    )
    return rows


# ---- rates, priors, distance, normalisation, the ridge

RATIOS: dict[str, dict[str, Any]] = {  # options of ``transition_ratio``
    "maximum likelihood": {"prior": "none"},
    "simulator prior, strength 1": {"prior": "simulator", "strength": 1.0},
    "default": {"horizon": HORIZON},  # of the policy's values
}


def add_quarter_slope(ax: Any, rows: pd.DataFrame) -> None:
    """Add the paper's bound from where the first curve begins."""
    errors = rows[rows.ratio == rows.ratio.iloc[0]].groupby("n").error.agg(common.rmse)
    add_slope(ax, errors.index.to_numpy(), errors.to_numpy(), -0.25)


@experiment(
    "The rate of the error, beside the paper's bound n^-1/4",
    axes={"data": tuple(DATA), "n": (*HALF_DECADES, 1_000_000)},
    repetitions=60,
    keys=("data", "n", "delta", "ratio"),
    measures=("squared_error", "error", "zeta_error"),
    draw=common.RmsePanels(
        "ratio", by=("data", "delta"), beneath=add_quarter_slope, columns=3
    ),
)
def rate(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid; the first n transitions of episodes of the uniform policy, or of
    pi_0.5. Root mean square over the seeds of the error of the exact value. With data
    of pi_0.5 and delta = 0.1, n = 10^6 is not yet large.
    """
    n = settings["n"]
    behavior = gridworld_policy(10, DATA[settings["data"]])
    simulator, target = grids()
    log = common.sample_pool(target, behavior, n, stream.generator()).first(n)
    problem = oee.Problem(simulator, log, horizon=HORIZON)
    rows: list[Row] = []
    for name, options in RATIOS.items():
        for delta in DELTAS:
            policy = gridworld_policy(10, delta)
            truth = oee.policy_value(target, policy, horizon=HORIZON)
            values_of: dict[str, Any] = (
                {"values_of": policy} if name == "default" else {}
            )
            zeta = oee.transition_ratio(log, simulator, **options, **values_of)
            error = common.signed_error(
                OffEnvironment(zeta)(problem, policy).value, truth
            )
            rows.append(
                {
                    "ratio": name,
                    "delta": delta,
                    **error,
                    "zeta_error": zeta_error(zeta, target, simulator),
                }
            )
    return rows


def halves(size: int) -> tuple[oee.FiniteMDP, oee.FiniteMDP]:
    """Return grids of slip 0.3 simulated, and of two slips in the target.

    These are 0.1 on the left half (small columns) and 0.5 on the right.
    """
    simulator, less, more = (gridworld(size, slip) for slip in (0.3, 0.1, 0.5))
    left = np.repeat(np.arange(size * size) % size < size // 2, 4).astype(float)
    mixed = (
        sparse.diags_array(left) @ less.transitions
        + sparse.diags_array(1 - left) @ more.transitions
    )
    return simulator, simulator.with_transitions(sparse.csr_array(mixed))


@experiment(
    "A target that one tilt cannot express",
    axes={"n": HALF_DECADES},
    repetitions=20,
    keys=("n", "delta", "estimator"),
    measures=("squared_error", "error", "moved"),
    draw=common.RmsePanels("estimator", by=("delta",)),
)
def misspecified(settings: Cell, stream: Stream) -> list[Row]:
    """20 x 20 grid; the real slip is 0.1 on the left half and 0.5 on the right. Root
    mean square over the seeds. One theta for all is wrong, and the value is moved
    towards maximum likelihood's by the share in the table.
    """
    simulator, target = halves(20)
    problem = oee.Problem(
        simulator,
        sample_log(target, 0.0, settings["n"], stream.generator()),
        horizon=HORIZON,
    )
    one_tilt = functools.partial(oee.transition_ratio, prior="tilt")
    rows: list[Row] = []
    for delta in DELTAS:
        policy = gridworld_policy(20, delta)
        truth = oee.policy_value(target, policy, horizon=HORIZON)
        plain = {"maximum likelihood": ModelBased(), "simulator": Simulator()}
        values = {
            name: (estimator(problem, policy).value, np.nan)
            for name, estimator in plain.items()
        }
        for name, estimator in {
            "default": OffEnvironment(),
            "one tilt for all": OffEnvironment(one_tilt),
        }.items():
            estimate = estimator(problem, policy)
            values[name] = estimate.value, estimate.diagnostics["moved"]
            values[f"{name}, one-step"] = estimate.diagnostics["one_step_value"], np.nan
        for name, (value, moved) in values.items():
            rows.append(
                {
                    "delta": delta,
                    "estimator": name,
                    **common.signed_error(value, truth),
                    "moved": moved,
                }
            )
    return rows


DistancePanels = functools.partial(
    Panels,
    "error",
    "estimator",
    ylabel=common.MEAN_ERROR,
    log=True,
    axes={"ylim": (1e-3, 1e4)},
    extra={"one oracle product, exact sd": "oracle_product_sd"},
)


@experiment(
    "Error against the distance between simulator and target",
    axes={"slip": (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)},
    keys=("slip", "d_inf", "d_2", "estimator"),
    measures=("error", "oracle_product_sd"),
    draw=DistancePanels(
        "slip",
        xlabel="real slip (0.3 is simulated)",
        beside=[DistancePanels("d_inf", xlabel="D_inf, the largest log ratio (nats)")],
    ),
)
def renyi(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, slip 0.3 simulated, delta = 0.5, 3162 transitions of the uniform
    policy. D_inf = log max zeta; d_2 in the table is the largest log sum P zeta^2 of a
    row, the growth of a product's second moment in a step.
    """
    simulator, target = grids(10, settings["slip"])
    policy = gridworld_policy(10, 0.5)
    log = sample_log(target, 0.0, 3162, stream.generator())
    problem = oee.Problem(simulator, log, horizon=HORIZON)
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    fitted = oee.transition_ratio(log, simulator, values_of=policy, horizon=HORIZON)
    product = OffEnvironment(fitted, evaluation="monte_carlo", n_rollouts=100)
    values = {
        "simulator": Simulator()(problem, policy).value,
        "OEE, exact": OffEnvironment(fitted)(problem, policy).value,
        "OEE, product (100 rollouts)": (
            product(problem, policy, seed=stream.generator(use="rollouts")).value
        ),
    }
    zeta = oee.true_ratio(target, simulator)
    ratio = zeta.values.data
    chances = simulator.transitions
    variance = oee.weighted_return_moments(
        simulator, zeta, policy, horizon=HORIZON
    ).variance
    facts = {
        "d_inf": float(np.log(ratio.max())),
        "d_2": float(np.log(row_sums(chances, chances.data * ratio**2).max())),
        "oracle_product_sd": SCALE * float(np.sqrt(variance)),
    }
    return [
        {"estimator": name, "error": abs(SCALE * (value - truth)), **facts}
        for name, value in values.items()
    ]


MedianPanels = functools.partial(
    common.ErrorPanels, curves="normalisation", how="median"
)


@experiment(
    "What the constraint sum beta q = 1 does: none, global, by rows",
    axes={"n": HALF_DECADES},
    keys=("n", "normalisation"),
    measures=("error", "row_sum_error"),
    draw=MedianPanels(
        "error",
        ylabel="median |error| of (1 - discount) J",
        beside=[
            MedianPanels(
                "row_sum_error", ylabel="median of the largest |sum of zeta P - 1|"
            )
        ],
    ),
)
def normalisation(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, delta = 0.5; box [0.01, 10], ridge 1 / sqrt(n). none, global: two
    programs and their quotient; rows: zeta itself, sum_s' zeta P = 1 in every row.
    Medians over the seeds: without normalised rows the value can be astronomical.
    """
    n = settings["n"]
    policy = gridworld_policy(10, 0.5)
    simulator, target = grids()
    pattern = simulator.transitions
    log = sample_log(target, 0.0, n, stream.generator())
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    options: dict[str, Any] = {
        "lower": 0.01,
        "upper": 10.0,
        "ridge": n**-0.5,
        "toward": None,
    }
    fits: dict[str, Any] = {}
    for name in ("none", "global"):
        quotient = Quotient(
            normalized=name == "global",
            behavior_policy=oee.uniform_policy(target),
            **options,
        )
        betas = quotient.fit(
            log, simulator, seed=stream.generator(use="simulator")
        ).details["beta"]
        # also where neither side has the transition
        plain = betas[0].ratio / betas[1].ratio[row_of_entry(pattern)]
        sums = row_sums(pattern, plain * pattern.data)
        fits[name] = csr_on_pattern(pattern, plain), float(np.abs(sums - 1.0).max())
    zeta = oee.transition_ratio(log, simulator, prior="none", **options)
    fits["rows"] = zeta, zeta.row_sum_error
    rows = []
    for name, (ratio, row_sum_error) in fits.items():
        value = evaluate_policy(
            reweight(simulator, ratio), policy, horizon=HORIZON
        ).value
        rows.append(
            {
                "normalisation": name,
                "error": abs(SCALE * (value - truth)),
                "row_sum_error": row_sum_error,
            }
        )
    return rows


STRENGTHS = (0.0, 0.01, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)
# options of ``transition_ratio``, besides the strength
PENALTIES: dict[str, dict[str, Any]] = {
    "sum g^2": {"prior": "none", "toward": None},
    "sum P g^2": {"prior": "none", "toward": 0.0},
    "sum P (g - 1)^2": {"prior": "none", "toward": 1.0},
    "sum P log g^-2": {"prior": "simulator"},
    "quotient, sum g^2": {
        "method": "ratio_of_ratios",
        "simulator_data": "exact",
        "toward": None,
    },
}


def find_best_penalty(table: pd.DataFrame) -> str:
    """Write the best penalty at each n."""
    means = table.groupby(["n", "penalty", "moves"]).zeta_error.mean()
    best: Any = means.loc[means.groupby("n").idxmin()].items()
    return "Least error of zeta: " + "; ".join(
        f"{number(error)} at n = {n} ({penalty}, worth {moves:g})"
        for (n, penalty, moves), error in best
    )


@experiment(
    "lambda_n and I(g): the paper's ridge and its alternatives, swept",
    axes={"n": (1000, 10_000, 100_000)},
    keys=("n", "penalty", "moves"),
    measures=("zeta_error", "value_error"),
    finding=find_best_penalty,
    draw=Panels(
        "zeta_error",
        "penalty",
        "moves",
        by=("n",),
        xlabel="transitions that the penalty is worth",
        log=True,
        ylabel="mean |zeta error|",
        beneath=lambda ax, rows: ax.set_xscale("symlog", linthresh=0.01),
    ),
)
def lambda_n(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid. The strength is the number of transitions that the penalty is
    worth: lambda_n = strength / n_sa in a row, / n for the quotient's two programs (box
    [0.01, 10]). sum g^2: the paper's; sum P log g^-2: the Dirichlet prior.
    """
    simulator, target = grids()
    policy = gridworld_policy(10, 0.5)
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    log = sample_log(target, 0.0, settings["n"], stream.generator())
    problem = oee.Problem(
        simulator, log, horizon=HORIZON, behavior_policy=oee.uniform_policy(simulator)
    )
    rows = []
    for penalty, options in PENALTIES.items():
        for moves in STRENGTHS:
            ridge = functools.partial(np.divide, moves)  # moves / n
            strength = (
                {"strength": moves}
                if options.get("prior") == "simulator"
                else {"ridge": ridge}
            )
            zeta = oee.transition_ratio(log, simulator, **options, **strength)
            value = OffEnvironment(zeta)(problem, policy).value
            errors = {
                "zeta_error": zeta_error(zeta, target, simulator),
                "value_error": abs(SCALE * (value - truth)),
            }
            rows.append({"penalty": penalty, "moves": moves, **errors})
    return rows
