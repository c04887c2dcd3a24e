"""fig1a: the mean absolute error of zeta against the number of transitions; and with our own networks (networks)."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import xlogy

import oee_tabular as oee
from oee_tabular._checks import Array
from oee_tabular._sparse import csr_on_pattern, row_sums
from oee_tabular.lab.experiments.common import (
    DATA,
    HALF_DECADES,
    LONGEST,
    ErrorPanels,
    grids,
    published_at,
    sample_log,
    zeta_error,
)
from oee_tabular.lab.registry import Cell, Row, Stream, experiment
from oee_tabular.plots.style import INK
from oee_tabular.ratio import Network, Quotient, action_displacement
from oee_tabular.ratio.support import aligned_counts

DEFAULT, QUOTIENT = "default (tilt by evidence)", "paper's quotient, tabular"
FITS: dict[str, dict[str, Any]] = {  # options of ``transition_ratio``
    DEFAULT: {},
    "maximum likelihood": {"prior": "none"},
    "simulator prior": {"prior": "simulator"},
    QUOTIENT: {"method": "ratio_of_ratios"},
    "linear class": {"method": "linear"},
}


def errors_of_paper(summary: pd.DataFrame) -> list[float]:
    """The error of the paper's networks for each row of a summary; their data are the uniform policy's."""
    rows = summary if "grid" in summary else summary.assign(data="uniform", grid=10)
    return [
        published_at("fig1a", f"grid={grid}", "mean_absolute_error_of_zeta", n) if data == "uniform" else np.nan
        for data, grid, n in zip(rows["data"], rows["grid"], rows["n"], strict=True)
    ]


def draw_published(ax: Any, rows: pd.DataFrame) -> None:
    """The paper's networks, where they were published."""
    points = rows.drop_duplicates("n").sort_values("n")
    errors = errors_of_paper(points)
    if np.isfinite(errors).any():
        ax.plot(points.n, errors, color=INK, marker="x", lw=1.2, label="paper's networks")


ZetaPanels = functools.partial(
    ErrorPanels, "error", ylabel="mean |zeta error|", beneath=draw_published, bands=True
)  # against n


@experiment(
    "Figure 1a: error of the ratio of transition probabilities against sample size",
    axes={"data": tuple(DATA), "grid": (10, 20, 40), "n": HALF_DECADES},
    keys=("data", "grid", "n", "estimator"), measures=("error",), paper=errors_of_paper,
    draw=ZetaPanels("estimator", by=("data", "grid"), columns=3),
)  # fmt: skip
def fig1a(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |zeta_hat - zeta| over the simulator's support, the goal left out (zeta = 1 scores 0.570).
    Bands: smallest and largest. The linear class has indicators of (action, displacement).
    """
    size, generator = settings["grid"], stream.generator()
    simulator, target = grids(size)
    log = sample_log(target, DATA[settings["data"]], settings["n"], generator)
    places = np.column_stack(np.divmod(np.arange(size**2), size))
    rows = []
    for name, options in FITS.items():
        features: dict[str, Any] = (
            {"features": action_displacement(simulator, places)} if name == "linear class" else {}
        )
        zeta = oee.transition_ratio(log, simulator, seed=generator, **options, **features)
        rows.append({"estimator": name, "error": zeta_error(zeta, target, simulator), "gap": zeta.gap})
    return rows


RECORDED = "a log of n moves"  # a setting of the saved table
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


def pair_shares(transitions: Array) -> Pair:
    """Shares of (s, a, s') and of (s, a)."""
    shares = transitions / transitions.sum()
    return shares, row_sums(grids()[0].transitions, shares)


def log_shares(log: oee.Transitions) -> Pair:
    """Those of a log."""
    simulator, _ = grids()
    return pair_shares(aligned_counts(log.counts(simulator.n_states, simulator.n_actions), simulator))


@functools.cache
def population() -> tuple[Pair, Pair]:
    """p and q of both ratios: what the transitions of the uniform policy's episodes are drawn from."""
    pairs = []
    for mdp in reversed(grids()):
        share = oee.occupancy(mdp.with_discount(1.0), oee.uniform_policy(mdp), horizon=LONGEST, of="transition")
        live = np.repeat(~mdp.absorbing(), mdp.n_actions)
        pairs.append(pair_shares(share.data * np.repeat(live, np.diff(share.indptr))))
    return pairs[0], pairs[1]


def risk(ratios: list[Array], shares: tuple[Pair, Pair]) -> float:
    """sum q g - sum p log g (eq. 3.7, a finite sum here) of both ratios together, nats."""
    return float(sum(q @ g - xlogy(p, g).sum() for g, p, q in zip(ratios, *shares, strict=True)))


@functools.lru_cache(maxsize=8)
def best_of_class(seed: int, repetition: int) -> oee.TransitionRatio:
    """The long fit on the population, scaled to counts."""
    simulator, _ = grids()
    counts = csr_on_pattern(simulator.transitions, population()[0][0])
    method = Quotient(**BOX, functions=FULL_BATCH, data="exact", behavior_policy=oee.uniform_policy(simulator))
    return method.fit(counts, simulator, seed=[seed, repetition])


EXCESS = ErrorPanels(  # approximation is 0 but for rounding
    "excess", title="excess risk in parts", ylabel="excess risk of both ratios (nats)",
    extra={name: name for name in PARTS[1:]} | {"trained, in all (population's risk)": "excess"},
    only=lambda rows: rows[rows.fit == NAMES["trained"]],
)  # fmt: skip


@experiment(
    "Figure 1a with our own networks, and what their error is made of",
    axes={"simulator": ("sampled afresh", RECORDED), "n": HALF_DECADES}, repetitions=3,
    keys=("simulator", "n", "fit"), measures=("error", "excess", *PARTS), paper=errors_of_paper,
    draw=ZetaPanels(
        "fit", by=("simulator",), only=lambda rows: rows[rows.fit != NAMES["best"]], beside=[EXCESS], columns=2
    ),
    requires=("jax", "equinox", "optax"), extra="neural",
)  # fmt: skip
def networks(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, n transitions of the uniform policy; the simulator's sampled afresh at each iteration (Algorithm 1), or a
    log of n. One hidden layer of 32 tanh units, Adam on batches of 512. With L the population's risk and L_n the log's (nats):
    approximation = L(best of the class, fitted to the population) - L(p / q), sampling = L(fitted to the log, full batch)
    - L(best), optimisation = L_n(trained) - L_n(fitted to the log), excess = L - L(p / q).
    """
    n, is_recorded = settings["n"], settings["simulator"] == RECORDED
    simulator, target = grids()
    log = sample_log(target, 0.0, n, stream.generator("n"))
    data: Any = sample_log(simulator, 0.0, n, stream.generator("n", use="simulator")) if is_recorded else "exact"
    quotient = Quotient(**BOX, data=data, behavior_policy=oee.uniform_policy(simulator))
    fits = {"best": best_of_class(stream.seed, settings["repetition"]), "table": quotient.fit(log, simulator)}
    for name, network in (("log", FULL_BATCH), ("trained", TRAINED)):
        fits[name] = replace(quotient, functions=network).fit(log, simulator, seed=stream.generator(use="training"))
    shares = log_shares(log), log_shares(data) if is_recorded else population()[1]
    ratios = {name: [beta.ratio for beta in zeta.details["beta"]] for name, zeta in fits.items()}
    least = risk([p / np.where(q > 0, q, 1.0) for p, q in zip(*population(), strict=True)], population())
    excess = {name: risk(ratio, population()) - least for name, ratio in ratios.items()}
    optimisation = risk(ratios["trained"], shares) - risk(ratios["log"], shares)
    fits["default"] = oee.transition_ratio(log, simulator)
    rows: list[Row] = [
        {"fit": text, "error": zeta_error(fits[name], target, simulator), "excess": excess.get(name, np.nan)}
        for name, text in NAMES.items()
    ]
    rows[0] |= dict(zip(PARTS, (excess["best"], excess["log"] - excess["best"], optimisation), strict=True))
    return rows
