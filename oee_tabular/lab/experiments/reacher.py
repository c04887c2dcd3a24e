"""Experiment fig3: the value of Reacher's policies on arms with other links.

The links are up to twice and down to half as long as the simulator's.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse

from oee_tabular.continuous import (
    ContinuousTask,
    Discretization,
    Reacher,
    ResidualSimulator,
    VisitedCells,
    discretize,
    monte_carlo_value,
    reacher_log,
    reacher_policy,
)
from oee_tabular.exact import policy_value
from oee_tabular.lab.experiment import Cell, Panels, Row, Stream, experiment, reach
from oee_tabular.lab.experiments.classic import LinearGaussian
from oee_tabular.lab.experiments.common import (
    distance_between,
    frequencies,
    mark_paper,
    published,
    select_deltas,
)
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import TransitionRatio
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array

DELTAS = (0.1, 0.3, 0.5, 0.7, 0.9)
SIMULATOR_LENGTH = 0.1  # m, of each link
HORIZON = 100  # rewards of a value
TRUTH_EPISODES = 4096
MODEL_EPISODES = 2048
STRENGTH = 0.1  # what the simulator's row is worth, in transitions
DEFENSIVE_SHARE = 0.1  # the averaged lengths' share of the defensive simulator
N_PAPER = 150_000
# Lengths of the randomised simulator in m; the paper's targets are among them.
LENGTHS = (0.05, 0.07, 0.1, 0.14, 0.2)
# Lengths 0.04 and 0.28 are added where the target's length is left out.
WIDER = (SIMULATOR_LENGTH, 0.04, 0.05, 0.07, 0.14, 0.2, 0.28)
CELLS = VisitedCells(3000)
VISITING = tuple(reacher_policy(delta) for delta in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9))
WEIGHTED = "OEE"
AVERAGED = "OEE, averaged lengths"
PLAIN = "OEE, plain simulator (defensive)"
UNKNOWN = "OEE, target's length left out"
UNKNOWN_AVERAGED = "OEE, averaged, target's length left out"
MODEL = "model, same cells"
LINEAR = "linear-Gaussian model"
ORACLE = "oracle, same cells"
RESIDUAL = "residual"
OWN_REWARD = "simulator, its own reward"
SIMULATOR = "simulator"
AVERAGE = "averaged-length simulator, same cells"
PUBLISHED = {WEIGHTED: "oee", OWN_REWARD: "simulated", MODEL: "mle"}


class Even(Reacher):
    """Reacher with episodes begun evenly over all angles (a shifted R2 sequence).

    Its values have the same mean with less noise.
    """

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Return states at rest, evenly over all angles."""
        steps = np.array([0.7548776662466927, 0.5698402909980532])
        place = (rng.random(2) + np.arange(n)[:, None] * steps) % 1.0
        return np.column_stack(
            [
                3.14 * (2.0 * place[:, 0] - 1.0),
                1.57 * (2.0 * place[:, 1] - 1.0),
                np.zeros((n, 2)),
            ]
        )


@functools.cache
def truth(length: float, reward_length: float) -> Array:
    """Compute the values (deltas,) of an arm by Monte Carlo.

    The arm has links of ``length``; rewards are by the distance that an arm with links
    of ``reward_length`` would see.
    """
    return monte_carlo_values(Even(length, reward_length), TRUTH_EPISODES, 3)


def monte_carlo_values(task: ContinuousTask, episodes: int, seed: int) -> Array:
    """Compute the values (deltas,) by Monte Carlo."""
    return np.array(
        [
            monte_carlo_value(
                task, reacher_policy(d), episodes, HORIZON, seed=[seed, k]
            ).value
            for k, d in enumerate(DELTAS)
        ]
    )


def values_of(mdp: FiniteMDP, policies: list[Array]) -> Array:
    """Compute the exact values (deltas,) of policies."""
    return np.array([policy_value(mdp, policy, horizon=HORIZON) for policy in policies])


def estimates(
    model: Discretization, counts: sparse.csr_array, length: float
) -> tuple[dict[str, Array], dict[str, Row]]:
    """Compute all estimates on the cells.

    They are {series: (deltas,) values} and {series: facts}.
    """
    policies = [model.policy(reacher_policy(delta)) for delta in DELTAS]
    below = values_of(model.plain, policies)
    above = truth(SIMULATOR_LENGTH, length)
    found: dict[str, Array] = {}
    facts: dict[str, Row] = {
        SIMULATOR: {"uncovered": replace(model, mdp=model.plain).supported(counts)[1]}
    }
    for averaged, weighted, lengths in (
        (AVERAGED, WEIGHTED, LENGTHS),
        (UNKNOWN_AVERAGED, UNKNOWN, [other for other in WIDER if other != length]),
    ):
        is_known = lengths is LENGTHS
        average = np.isin(WIDER, lengths) / len(lengths)
        allowed, uncovered = model.mixture(average).supported(counts)
        weights = fit_among(model, allowed, lengths)
        mixtures = {
            averaged: average,
            weighted: defend(weights, average),
        }
        if is_known:
            mixtures[PLAIN] = defend(np.eye(len(WIDER))[0], average)
            found[AVERAGE] = values_of(model.mixture(average).mdp, policies)
        for name, shares in mixtures.items():
            simulator = model.mixture(shares).mdp
            zeta = transition_ratio(
                allowed, simulator, prior="simulator", strength=STRENGTH
            )
            found[name] = values_of(zeta.target_model(simulator), policies)
            facts[name] = {"uncovered": uncovered, **facts_of(zeta)}
            if is_known:
                own = float(weights[WIDER.index(length)])
                facts[name]["weight_of_true_length"] = own
    found[MODEL] = values_of(
        model.with_transitions(frequencies(counts, model.plain.n_actions)), policies
    )
    found |= {
        f"{name}, calibrated": values + above - below
        for name, values in found.items()
        if name != AVERAGE
    }
    found[ORACLE] = values_of(model.simulators[WIDER.index(length)], policies)
    found[SIMULATOR] = above
    found[OWN_REWARD] = truth(SIMULATOR_LENGTH, SIMULATOR_LENGTH)
    return found, facts


def defend(weights: Array, average: Array) -> Array:
    """Mix the averaged lengths into the weights of a simulator."""
    return np.asarray((1.0 - DEFENSIVE_SHARE) * weights + DEFENSIVE_SHARE * average)


def facts_of(zeta: TransitionRatio) -> Row:
    """Return how large a ratio is, and the share of pairs that it knows."""
    largest = float(zeta.values.data.max())
    return {
        "largest_zeta": largest,
        "d_inf": float(np.log(largest)),
        "visited": float(zeta.visited.mean()),
    }


def fit_among(
    model: Discretization, counts: sparse.csr_array, lengths: Sequence[float]
) -> Array:
    """Fit the weights (WIDER,) of these lengths that minimise the KL risk.

    The weights of the others are 0.
    """
    at = [WIDER.index(length) for length in lengths]
    weights = np.zeros(len(WIDER))
    weights[at] = replace(
        model, simulators=tuple(model.simulators[k] for k in at)
    ).fit_weights(counts)
    return weights


def setting_of(length: Any) -> str:
    """Return the paper's name of links of this length."""
    return f"link_length_ratio={float(length) / SIMULATOR_LENGTH}"


def published_error(row: Row) -> float:
    """Compute the mean over delta of |curve - true value| in the paper's figure.

    It is of the same curve, and nan where that was not published.
    """
    if row["series"] not in PUBLISHED or row["n"] != N_PAPER:
        return np.nan
    curves = (
        published("reacher", setting_of(row["length"]), name)
        for name in (PUBLISHED[row["series"]], "true_value")
    )
    return distance_between(*curves)


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw value against delta for each length, at the largest n.

    The paper's points are of its own expert and targets.
    """
    markers = {
        name: (name, marker)
        for name, marker in zip(
            ("true_value", *PUBLISHED.values()), "xo^s", strict=True
        )
    }
    shown = (WEIGHTED, RESIDUAL, MODEL, OWN_REWARD, SIMULATOR, UNKNOWN)
    own = table[(table.n == table.n.max()) & table.series.isin(shown)]
    Panels(
        "value",
        "series",
        "delta",
        ("length",),
        "links of {length:g} m",
        "delta: share of random actions",
        "value (discounted sum of 100 rewards)",
        extra={"true value": "truth"},
        bands=True,
        size=(6.4, 4.4),
        beneath=lambda ax, rows: mark_paper(
            ax, "reacher", setting_of(rows.length.iloc[0]), markers
        ),
    )(select_deltas(own, DELTAS), summary, figure)


def finding(table: pd.DataFrame) -> str:
    """Write the errors over the lengths, at the largest n."""
    n = table.n.max()
    means = table[table.n == n].groupby(["series", "length"]).error.mean()
    parts = [
        f"{name} {reach(means[name])}"
        for name in (RESIDUAL, WEIGHTED, UNKNOWN, MODEL, SIMULATOR)
        if name in means
    ]
    return f"Mean error of the value at n = {n}: " + "; ".join(parts)


@experiment(
    "Figure 3: the value of Reacher's policies on longer and on shorter arms",
    group="continuous",
    axes={"length": (0.2, 0.05), "n": (15_000, N_PAPER)},
    smoke={"n": (15_000,)},
    keys=("length", "n", "series"),
    measures=("error", "uncovered"),
    draw=draw,
    finding=finding,
    paper=published_error,
)
def fig3(settings: Cell, stream: Stream) -> list[Row]:
    """Discounted sums of 100 rewards of delta uniform + (1 - delta) expert; the
    simulator's links are 0.1 m, the target at a fixed place (errors compare with the
    paper's, values do not). Errors: means over delta against 4096 Monte Carlo episodes.
    Every curve but "simulator, its own reward" is paid by the target's fingertip. OEE's
    simulator is not the paper's: 3000 cells at the log's states; lengths .05 to .2 m,
    the target's among them, averaged or weighted by the convex risk; "left out":
    without the target's length; "plain": nine tenths of the 0.1 m arm. Chosen among 25
    variants on another seed of the same targets. Residual: the 0.1 m arm corrected by
    what the log's steps leave over its own, 2048 episodes; no other length is known to
    it.
    """
    length = float(settings["length"])
    n = int(settings["n"])
    target = Reacher(length)
    log = reacher_log(target, n, seed=stream.generator())
    others = [Reacher(other, length) for other in WIDER[1:]]
    model = discretize(
        Reacher(SIMULATOR_LENGTH, length),
        log,
        cells=CELLS,
        others=others,
        policies=VISITING,
        closure_episodes=0,
        seed=stream.sequence(use="cells"),
    )
    # Next states far from every cell go to the nearest one.
    with warnings.catch_warnings(action="ignore"):
        counts = model.counts(log, outside="nearest")
    found, facts = estimates(model, counts, length)
    found[RESIDUAL] = monte_carlo_values(
        ResidualSimulator(Even(SIMULATOR_LENGTH, length), log, seed=0),
        MODEL_EPISODES,
        4,
    )
    found[LINEAR] = monte_carlo_values(LinearGaussian(target, log), MODEL_EPISODES, 4)
    right = truth(length, length)
    rows = []
    for name, values in found.items():
        row: Row = {
            "series": name,
            "error": float(np.abs(values - right).mean()),
            "uncovered": np.nan,
        }
        rows.append(row | facts.get(name, {}))
        for delta, value, true in zip(DELTAS, values, right, strict=True):
            rows[-1] |= {f"value_{delta}": float(value), f"truth_{delta}": float(true)}
    return rows
