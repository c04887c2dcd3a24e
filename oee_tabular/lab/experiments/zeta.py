"""fig1a: the mean absolute error of zeta against the number of transitions; and with our own networks (networks).

On a finite MDP the risk of eq. 3.7 is a finite sum, so each part of the networks' error is a number and not an estimate:

    approximation = L(best of the class) - L(p / q)         best: a long full-batch fit on the population's shares
    sampling      = L(fitted to the log) - L(best)          the same fit on the log's counts
    optimisation  = L_n(trained) - L_n(fitted to the log)   batches and early stopping, in the log's risk, which they minimise

L is the population's risk, L_n the log's, each summed over the two ratios (s, a, s') and (s, a).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums
from oee_tabular.data import Transitions
from oee_tabular.exact import occupancy
from oee_tabular.lab.experiments import paper
from oee_tabular.lab.experiments.common import (
    HALF_DECADES,
    LONGEST,
    ZETA_ERROR,
    behavior_of,
    grids,
    sample_log,
    zeta_error,
)
from oee_tabular.lab.findings import rank
from oee_tabular.lab.panels import Beside, Errors
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.ratio import Network, Quotient, TransitionRatio, action_displacement, transition_ratio
from oee_tabular.ratio.support import aligned_counts

if TYPE_CHECKING:
    import pandas as pd

Fit = Callable[[Transitions, FiniteMDP, np.random.Generator], TransitionRatio]

# ---- fig1a -------------------------------------------------------------------------------------------------------------

DEFAULT, QUOTIENT = "default (tilt by evidence)", "paper's quotient, tabular"


def published(size: int) -> dict[str, pd.Series[float]]:
    """The curve of the paper's networks on a grid, if it was published; its data are the uniform policy's."""
    points = paper.curve("fig1a", f"grid={size}", "mean_absolute_error_of_zeta")
    return {"paper's networks": points.set_index("x")["mean"]} if len(points) else {}


def published_errors(summary: pd.DataFrame) -> list[float]:
    """The point of that curve for each row of a summary; nan where there is none."""
    rows = {"data": "uniform", "grid": 10} | dict(summary)
    columns = (np.broadcast_to(rows[name], len(summary)) for name in ("data", "grid", "n"))
    return [
        paper.at("fig1a", f"grid={grid}", "mean_absolute_error_of_zeta", float(n)) if data == "uniform" else np.nan
        for data, grid, n in zip(*columns, strict=True)
    ]


def _linear(log: Transitions, simulator: FiniteMDP, _: np.random.Generator) -> TransitionRatio:
    size = round(simulator.n_states**0.5)
    places = np.column_stack(np.divmod(np.arange(simulator.n_states), size))
    return transition_ratio(log, simulator, method="linear", features=action_displacement(simulator, places))


FITS: dict[str, Fit] = {
    DEFAULT: lambda log, simulator, _: transition_ratio(log, simulator),
    "maximum likelihood": lambda log, simulator, _: transition_ratio(log, simulator, prior="none"),
    "simulator prior": lambda log, simulator, _: transition_ratio(log, simulator, prior="simulator"),
    QUOTIENT: lambda log, simulator, seed: transition_ratio(log, simulator, method="ratio_of_ratios", seed=seed),
    "linear class": _linear,
}


def zeta_cell(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |zeta_hat - zeta| over all (s, a, s') of the simulator's support, the goal left out (zeta = 1 scores 0.570).
    Lines: means over the seeds; bands: the smallest and the largest. n transitions drawn without replacement from
    episodes of at most 1000 steps. The linear class has indicators of (action, displacement).
    """
    simulator, target = grids(int(settings["grid"]))
    generator = stream.generator()
    log = sample_log(target, behavior_of(str(settings["data"]), target), int(settings["n"]), generator)
    fits = {name: fit(log, simulator, generator) for name, fit in FITS.items()}
    return [
        {"estimator": name, "error": zeta_error(zeta, target, simulator), "gap": zeta.gap}
        for name, zeta in fits.items()
    ]


FIGURE_1A = Experiment(
    "fig1a", "Figure 1a: error of the ratio of transition probabilities against sample size",
    axes={"data": ("uniform", "pi_0.5"), "grid": (10, 20, 40), "n": HALF_DECADES},
    smoke={"data": ("uniform",), "grid": (10,), "n": HALF_DECADES[:3]},
    run=zeta_cell, keys=("data", "grid", "n", "estimator"), measures=("error",), paper=published_errors,
    finding=rank("Mean error of zeta", "error", "estimator"),
    draw=Errors(
        "error", "estimator", by=("data", "grid"), title="{grid} x {grid}, data of {data}", ylabel=ZETA_ERROR,
        also=lambda rows: published(rows.grid.iloc[0]) if rows.data.iloc[0] == "uniform" else {}, bands=True, columns=3,
    ),
)  # fmt: skip

# ---- networks ----------------------------------------------------------------------------------------------------------

AFRESH, RECORDED = "sampled afresh", "a log of n moves"  # settings of the saved table
BOX: dict[str, Any] = {"lower": 0.1, "upper": 10.0, "normalized": False}
TRAINED = Network((32,), "tanh", batch_size=512, n_iterations=12_000, step_size=1e-2)
FULL_BATCH = Network((32,), "tanh", batch_size=None, n_iterations=5000, step_size=2e-2, held_out=0.0)
NAMES = {
    "trained": "network, trained (Algorithm 1)", "log": "network, full batch on the log",
    "best": "network, full batch on the population", "table": QUOTIENT,
    "default": DEFAULT,
}  # fmt: skip
PARTS = ("approximation", "sampling", "optimisation")
Pair = tuple[Array, Array]


def _both(moves: Array) -> Pair:
    """Shares of (s, a, s') and of (s, a)."""
    shares = moves / moves.sum()
    return shares, row_sums(grids()[0].transitions, shares)


@functools.cache
def _population() -> tuple[Pair, Pair]:
    """p and q of both ratios: what the moves of the uniform policy's episodes are drawn from."""
    found = []
    for mdp in reversed(grids()):
        share = occupancy(mdp.with_discount(1.0), uniform_policy(mdp), horizon=LONGEST, of="transition")
        live = np.repeat(~mdp.absorbing(), mdp.n_actions)
        found.append(_both(share.data * np.repeat(live, np.diff(share.indptr))))
    return found[0], found[1]


def _risk(ratios: Any, shares: tuple[Pair, Pair]) -> float:
    """sum q g - sum p log g of both ratios together, nats."""
    return float(sum(q @ g - p @ np.log(g) for g, p, q in zip(ratios, *shares, strict=True)))


def _excess(ratios: Any, shares: tuple[Pair, Pair]) -> float:
    """Risk above that of p / q, of both ratios together, nats: sum p (u - 1 - log u), u = g q / p; q g where p = 0."""
    total = 0.0
    for g, p, q in zip(ratios, *shares, strict=True):
        seen = p > 0
        t = g[seen] * q[seen] / p[seen] - 1.0
        total += p[seen] @ np.maximum(t - np.log1p(t), 0.0) + q[~seen] @ g[~seen]
    return float(total)


def _ratios(zeta: Any) -> list[Array]:
    return [fit.ratio for fit in zeta.details["beta"]]


@functools.lru_cache(maxsize=8)
def _best(seed: int, repetition: int) -> Any:
    """The best member of the class: the long fit on the population, scaled to counts."""
    simulator, _ = grids()
    (p, _), _ = _population()
    counts = simulator.transitions.copy()
    counts.data = p
    method = Quotient(**BOX, functions=FULL_BATCH, data="exact", behavior_policy=uniform_policy(simulator))
    return method.fit(counts, simulator, seed=[seed, repetition])


def networks_cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, uniform policy, n transitions of the target. The simulator's transitions are sampled afresh at each
    iteration (Algorithm 1 as printed), or a log of n. Network: one hidden layer of 32 tanh units, box [0.1, 10], Adam on
    batches of 512, stopped on 10% of the transitions; the quotient of two. Excess: the population's risk of both ratios
    above its least, nats. Approximation: that of the class's best, a long full-batch fit on the population. Sampling: that
    of the same fit on the log, less approximation. Optimisation: risk on the log, the trained networks' less that fit's.
    What is below 1e-6 everywhere (1e-3 for errors) is not drawn.
    """
    n = int(settings["n"])
    simulator, target = grids()
    log = sample_log(target, uniform_policy(target), n, stream.generator("n"))
    data: Any = "exact"
    if settings["simulator"] == RECORDED:
        data = sample_log(simulator, uniform_policy(simulator), n, stream.generator("n", use="simulator"))
    quotient = Quotient(**BOX, data=data, behavior_policy=uniform_policy(simulator))
    fits = {"best": _best(stream.seed, int(settings["repetition"])), "table": quotient.fit(log, simulator)}
    for name, network in (("log", FULL_BATCH), ("trained", TRAINED)):
        fits[name] = replace(quotient, functions=network).fit(log, simulator, seed=stream.generator(use="training"))
    population = _population()
    counts = _both(_moves(log)), population[1] if data == "exact" else _both(_moves(data))
    excess = {name: _excess(_ratios(zeta), population) for name, zeta in fits.items()}
    own = {name: _risk(_ratios(fits[name]), counts) for name in ("log", "trained")}
    parts = (excess["best"], excess["log"] - excess["best"], own["trained"] - own["log"])
    fits["default"] = transition_ratio(log, simulator)
    rows: list[Row] = [
        {"fit": text, "error": zeta_error(fits[name], target, simulator), "excess": excess.get(name, np.nan)}
        for name, text in NAMES.items()
    ]
    rows[0] |= dict(zip(PARTS, parts, strict=True))  # the trained network's
    return rows


def _moves(log: Transitions) -> Array:
    simulator, _ = grids()
    return aligned_counts(log.counts(simulator.n_states, simulator.n_actions), simulator)


FIT_ERRORS = Errors(
    "error", "fit", title="error; simulator {simulator}", ylabel=ZETA_ERROR, also=lambda _: published(10), bands=True,
    least=1e-3,
)  # fmt: skip
EXCESS = Errors(
    "excess", title="excess in parts; simulator {simulator}", ylabel="excess risk of both ratios (nats)",
    extra={name: name for name in PARTS} | {"trained, in all (population's risk)": "excess"},
    only=lambda table: table[table.fit == NAMES["trained"]], least=1e-6, lowest=False,
)  # fmt: skip
NETWORKS = Experiment(
    "networks", "Figure 1a with our own networks, and what their error is made of",
    axes={"simulator": (AFRESH, RECORDED), "n": HALF_DECADES},
    smoke={"simulator": (RECORDED,), "n": HALF_DECADES[:1]}, repetitions=3, smoke_repetitions=1,
    run=networks_cell, keys=("simulator", "n", "fit"), measures=("error", "excess", *PARTS), paper=published_errors,
    finding=rank("Mean error of zeta", "error", "fit", names=[NAMES[name] for name in ("trained", "table", "default")]),
    draw=Beside([FIT_ERRORS, EXCESS], by=("simulator",), columns=2), requires=("jax", "equinox", "optax"), extra="neural",
)  # fmt: skip
