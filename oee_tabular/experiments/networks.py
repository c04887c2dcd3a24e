"""networks: Figure 1a with our own networks, and their error split into approximation, sampling and optimisation.

On a finite MDP the risk of eq. 3.7 is a finite sum, so each part is a number and not an estimate:

    approximation = L(best of the class) - L(p / q)         best: a long full-batch fit on the population's shares
    sampling      = L(fitted to the log) - L(best)          the same fit on the log's counts
    optimisation  = L_n(trained) - L_n(fitted to the log)   batches and early stopping, in the log's risk, which they minimise

L is the population's risk, L_n the log's, each summed over the two ratios (s, a, s') and (s, a).
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums
from oee_tabular.data import Transitions
from oee_tabular.exact import occupancy
from oee_tabular.experiments import paper
from oee_tabular.experiments.common import (
    HALF_DECADES,
    LONGEST,
    drawn,
    grids,
    panels,
    quantile_bands,
    series_of,
    zeta_error,
)
from oee_tabular.experiments.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import uniform_policy
from oee_tabular.ratio import Network, Quotient, transition_ratio
from oee_tabular.ratio.support import aligned_counts

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

SIZE = 10
AFRESH, RECORDED = "sampled afresh", "a log of n moves"
BOX: dict[str, Any] = {"lower": 0.1, "upper": 10.0, "normalized": False}
TRAINED = Network((32,), "tanh", batch_size=512, n_iterations=12_000, step_size=1e-2)
FULL_BATCH = Network((32,), "tanh", batch_size=None, n_iterations=5000, step_size=2e-2, held_out=0.0)
NAMES = {
    "trained": "network, trained (Algorithm 1)", "log": "network, full batch on the log",
    "best": "network, full batch on the population", "table": "paper's quotient, tabular",
    "default": "default (average of candidates, evidence)",
}  # fmt: skip
PAPER = "paper's networks"
PARTS = ("approximation", "sampling", "optimisation")
Pair = tuple[Array, Array]


def _both(moves: Array) -> Pair:
    """Shares of (s, a, s') and of (s, a)."""
    shares = moves / moves.sum()
    return shares, row_sums(grids(SIZE)[0].transitions, shares)


@functools.cache
def _population() -> tuple[Pair, Pair]:
    """p and q of both ratios: what the moves of the uniform policy's episodes are drawn from."""
    found = []
    for mdp in reversed(grids(SIZE)):
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
    simulator, _ = grids(SIZE)
    (p, _), _ = _population()
    counts = simulator.transitions.copy()
    counts.data = p
    method = Quotient(**BOX, functions=FULL_BATCH, data="exact", behavior_policy=uniform_policy(simulator))
    return method.fit(counts, simulator, seed=[seed, repetition])


def cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log: the three fits of the network, the table, the default; and the parts of the excess risk."""
    n = int(settings["n"])
    simulator, target = grids(SIZE)
    log = drawn(target, uniform_policy(target), n, stream.generator("n"))
    data: Any = "exact"
    if settings["simulator"] == RECORDED:
        data = drawn(simulator, uniform_policy(simulator), n, stream.generator("n", use="simulator"))
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
    simulator, _ = grids(SIZE)
    return aligned_counts(log.counts(simulator.n_states, simulator.n_actions), simulator)


def published(summary: pd.DataFrame) -> list[float]:
    """The paper's networks' error at the same n."""
    return [paper.at("fig1a", "grid=10", "mean_absolute_error_of_zeta", float(n)) for n in summary["n"]]


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """For each kind of the simulator's data: errors of zeta, and the parts of the trained networks' excess risk."""
    from oee_tabular.plots import plot_errors

    kinds = list(dict.fromkeys(table.simulator))
    axes = panels(figure, [f"{what}; simulator {k}" for k in kinds for what in ("error", "excess in parts")], columns=2)
    n = sorted(table.n.unique())
    points = paper.curve("fig1a", "grid=10", "mean_absolute_error_of_zeta").set_index("x")["mean"]
    for kind, first, second in zip(kinds, axes[::2], axes[1::2], strict=True):
        rows = table[table.simulator == kind]
        curves = series_of(rows, "fit", "n", "error", n)
        curves[PAPER] = points.reindex(n).to_numpy(dtype=float)
        bands = quantile_bands(rows, "fit", "n", "error", n)
        shown = {name: y for name, y in curves.items() if np.nanmax(y) > 1e-3}
        bands = {name: band for name, band in bands.items() if name in shown}
        plot_errors(n, shown, first, bands=bands, slope=None, ylabel="mean |zeta error| (ratio, no unit)")
        own = rows[rows.fit == NAMES["trained"]].groupby("n")
        of_parts = {name: own[name].mean().reindex(n).to_numpy() for name in PARTS}
        of_parts["trained, in all (population's risk)"] = own.excess.mean().reindex(n).to_numpy()
        of_parts = {name: y for name, y in of_parts.items() if y.max() > 1e-6}
        plot_errors(n, of_parts, second, slope=None, ylabel="excess risk of both ratios (nats)")


NETWORKS = Experiment(
    id="networks",
    title="Figure 1a with our own networks, and what their error is made of",
    axes={"simulator": (AFRESH, RECORDED), "n": HALF_DECADES},
    smoke={"simulator": (RECORDED,), "n": HALF_DECADES[:1]},
    repetitions=3,
    smoke_repetitions=1,
    run=cell,
    keys=("simulator", "n", "fit"),
    measures=("error", "excess", *PARTS),
    draw=draw,
    paper=published,
    requires=("jax", "equinox", "optax"),
    extra="neural",
    caption=(
        "10 x 10 grid, slip 0.3 simulated, 0.1 real, uniform policy, n moves of the target. The simulator's moves are sampled "
        "afresh at each iteration (Algorithm 1 as printed), or a log of n. Network: one-hot s, a, s', one hidden layer of 32 "
        "tanh units, box [0.1, 10], Adam on batches of 512, stopped on 10% of the moves; the quotient of two. Error: mean "
        "|zeta_hat - zeta|, the goal left out (zeta = 1 scores 0.570). Excess: the population's risk of both ratios above its "
        "least, nats. Approximation: that of the class's best, a long full-batch fit on the population. Sampling: that of the "
        "same fit on the log, less approximation. Optimisation: risk on the log, the trained networks' less that fit's; they "
        "stop before they fit the log's noise, so in the population their excess is below the sum of the parts. "
        "What is below 1e-6 everywhere (1e-3 for errors) is not drawn."
    ),
)  # fmt: skip
