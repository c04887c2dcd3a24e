"""networks: Figure 1a with our own networks, and their error split into approximation, sampling and optimisation.

On a finite MDP the risk of eq. 3.7 is a finite sum, so each part is a number and not an estimate:

    approximation = L(best of the class) - L(p / q)         best: a long full-batch fit on the population's shares
    sampling      = L(fitted to the log) - L(best)          the same fit on the log's counts
    optimisation  = L_n(trained) - L_n(fitted to the log)   batches and early stopping, in the log's risk, which they minimise

L is the population's risk, L_n the log's, each summed over the two ratios (s, a, s') and (s, a).
"""

from __future__ import annotations

import functools
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
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.ratio import Network, Quotient, transition_ratio
from oee_tabular.ratio.support import aligned_counts

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

BOX: dict[str, Any] = {"lower": 0.1, "upper": 10.0, "normalized": False}
TRAINED = Network((64, 64), "tanh", batch_size=512, n_iterations=4000, step_size=3e-3, patience=15)
FULL_BATCH = Network((64, 64), "tanh", batch_size=None, n_iterations=2000, step_size=1e-2, held_out=0.0)
NAMES = {
    "trained": "network, trained (Algorithm 1)", "log": "network, full batch on the log",
    "best": "network, full batch on the population", "table": "paper's quotient, tabular",
    "default": "default (average of candidates, evidence)",
}  # fmt: skip
PAPER = "paper's networks"
PARTS = ("approximation", "sampling", "optimisation")
Pair = tuple[Array, Array]


def _both(simulator: FiniteMDP, moves: Array) -> Pair:
    """Shares of (s, a, s') and of (s, a)."""
    shares = moves / moves.sum()
    return shares, row_sums(simulator.transitions, shares)


@functools.lru_cache(maxsize=4)
def _population(size: int) -> tuple[Pair, Pair]:
    """p and q of both ratios: what the moves of the uniform policy's episodes are drawn from."""
    found = []
    for mdp in reversed(grids(size)):
        share = occupancy(mdp.with_discount(1.0), uniform_policy(mdp), horizon=LONGEST, of="transition")
        live = np.repeat(~mdp.absorbing(), mdp.n_actions)
        found.append(_both(mdp, share.data * np.repeat(live, np.diff(share.indptr))))
    return found[0], found[1]


def _risk(ratios: Any, shares: tuple[Pair, Pair]) -> float:
    """Of both ratios together, nats."""
    return float(sum(q @ g - p @ np.log(g) for g, p, q in zip(ratios, *shares, strict=True)))


def _ratios(zeta: Any) -> list[Array]:
    return [fit.ratio for fit in zeta.details["beta"]]


@functools.lru_cache(maxsize=8)
def _best(size: int, seed: int, repetition: int) -> Any:
    """The best member of the class: the long fit on the population, scaled to counts."""
    simulator, _ = grids(size)
    (p, _), _ = _population(size)
    counts = simulator.transitions.copy()
    counts.data = p
    method = Quotient(**BOX, functions=FULL_BATCH, data="exact", behavior_policy=uniform_policy(simulator))
    return method.fit(counts, simulator, seed=[seed, repetition])


def cell(settings: Cell, stream: Stream) -> list[Row]:
    """One log: the three fits of the network, the table, the default; and the parts of the excess risk."""
    size, n = 10, int(settings["n"])
    simulator, target = grids(size)
    generator = stream.generator()
    log, simulated = (drawn(mdp, uniform_policy(mdp), n, generator) for mdp in (target, simulator))
    fits: dict[str, Any] = {"best": _best(size, stream.seed, int(settings["repetition"]))}
    for name, network in (("log", FULL_BATCH), ("trained", TRAINED)):
        method = Quotient(**BOX, functions=network, data=simulated)
        fits[name] = method.fit(log, simulator, seed=stream.generator(use="training"))
    fits["table"] = Quotient(**BOX, data=simulated).fit(log, simulator)
    population = _population(size)
    counts = (_both(simulator, _moves(simulator, log)), _both(simulator, _moves(simulator, simulated)))
    exact = [np.divide(p, q, out=np.ones_like(p), where=q > 0) for p, q in zip(*population, strict=True)]
    of = {name: _risk(_ratios(zeta), population) for name, zeta in fits.items()}
    own = {name: _risk(_ratios(fits[name]), counts) for name in ("log", "trained")}
    parts = (of["best"] - _risk(exact, population), of["log"] - of["best"], own["trained"] - own["log"])
    fits["default"] = transition_ratio(log, simulator)
    rows = [
        {"fit": text, "error": zeta_error(fits[name], target, simulator),
         "excess": of[name] - _risk(exact, population) if name in of else np.nan}
        for name, text in NAMES.items()
    ]  # fmt: skip
    return [row | dict(zip(PARTS, parts, strict=True)) if row["fit"] == NAMES["trained"] else row for row in rows]


def _moves(simulator: FiniteMDP, log: Transitions) -> Array:
    return aligned_counts(log.counts(simulator.n_states, simulator.n_actions), simulator)


def published(summary: pd.DataFrame) -> list[float]:
    """The paper's networks' error at the same n."""
    return [paper.at("fig1a", "grid=10", "mean_absolute_error_of_zeta", float(n)) for n in summary["n"]]


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Errors of zeta, and the parts of the trained networks' excess risk."""
    from oee_tabular.plots import plot_errors

    first, second = panels(figure, ["error of zeta", "the networks' excess risk, in parts"])
    n = sorted(table.n.unique())
    curves = series_of(table, "fit", "n", "error", n)
    points = paper.curve("fig1a", "grid=10", "mean_absolute_error_of_zeta").set_index("x")["mean"]
    curves[PAPER] = points.reindex(n).to_numpy(dtype=float)
    bands = quantile_bands(table, "fit", "n", "error", n)
    plot_errors(n, curves, first, bands=bands, slope=None, ylabel="mean |zeta error| (ratio, no unit)")
    own = table[table.fit == NAMES["trained"]].groupby("n")
    of_parts = {name: own[name].mean().reindex(n).clip(lower=0.0).to_numpy() for name in PARTS}
    of_parts["trained, in all (population's risk)"] = own.excess.mean().reindex(n).to_numpy()
    plot_errors(n, of_parts, second, slope=None, ylabel="excess risk of both ratios (nats)")


NETWORKS = Experiment(
    id="networks",
    title="Figure 1a with our own networks, and what their error is made of",
    axes={"n": HALF_DECADES},
    smoke={"n": HALF_DECADES[:1]},
    repetitions=3,
    smoke_repetitions=1,
    run=cell,
    keys=("n", "fit"),
    measures=("error", "excess", *PARTS),
    draw=draw,
    paper=published,
    requires=("jax", "equinox", "optax"),
    extra="neural",
    caption=(
        "10 x 10 grid, slip 0.3 simulated, 0.1 real, uniform policy, n moves of each. Network: one-hot s, a, s', two hidden "
        "layers of 64 tanh units, box [0.1, 10], Adam on batches of 512, stopped on 10% of the moves; the quotient of two. "
        "error: mean |zeta_hat - zeta|, the goal left out (zeta = 1 scores 0.570). excess: the population's risk of both "
        "ratios above its least, nats. Parts: approximation, the class's best (a long full-batch fit on the population); "
        "sampling, the same fit on the log, above that; optimisation, the trained networks' risk on the log above that "
        "fit's. Training stops early, short of the log's optimum: its excess is below the sum of the parts."
    ),
)  # fmt: skip
