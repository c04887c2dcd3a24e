"""Asymptotic variances against simulation, and what planned collection saves."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.data import Transitions
from oee_tabular.design import plan_data_collection
from oee_tabular.design.programs import collection_mdp
from oee_tabular.estimators import Estimator, ModelBased, OffEnvironment, Problem
from oee_tabular.exact import efficiency_bound, occupancy, policy_value, ratio_of_ratios_variance
from oee_tabular.lab.experiments.common import SMALL_SCALE, error_of, grids, rmse_panels, small_grids
from oee_tabular.lab.findings import listed, number, percent
from oee_tabular.lab.panels import panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.simulate import sample_episodes
from oee_tabular.tasks import gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

# ---- efficiency --------------------------------------------------------------------------------------------------------

CHUNK = 500


def efficiency_cell(settings: Cell, stream: Stream) -> list[Row]:
    """5 x 5 grid, slip 0.3 simulated, 0.1 real, discount 0.95; n = 10^5 rows drawn uniformly over (s, a) from each
    side, 500 logs a seed. Exact: efficiency_bound for the plug-in (the maximum-likelihood model),
    ratio_of_ratios_variance for the quotient.
    """
    n = int(settings["n"])
    simulator, target = grids(5, discount=0.95)
    policy = gridworld_policy(5, 0.5)
    share = np.full((25, 4), 0.01)
    assert simulator.transition_rewards is not None
    tables = (target.transitions, simulator.transitions, simulator.transition_rewards)
    p, q, reward = (table.toarray().reshape(25, 4, 25) for table in tables)  # r(s, a, s') is known
    generator = stream.generator()
    ours, theirs = (
        generator.multinomial(n, (share[:, :, None] * rows).reshape(-1), size=CHUNK).reshape(CHUNK, *rows.shape)
        for rows in (p, q)
    )
    likelihood = ours / ours.sum(axis=3, keepdims=True)
    moves = np.divide(ours, theirs, out=np.zeros(ours.shape), where=theirs > 0)
    kernel = moves * (theirs.sum(axis=3) / ours.sum(axis=3))[..., None] * q
    arguments = (simulator, target, policy, share, share)
    exact = {
        "plug-in": efficiency_bound(target, policy, share),
        "ratio of ratios": ratio_of_ratios_variance(*arguments),
        "ratio of ratios, rows normalised": ratio_of_ratios_variance(*arguments, rows="normalised"),
    }
    rows = []
    kernels = (likelihood, kernel, kernel / kernel.sum(axis=3, keepdims=True))
    for (name, bound), chances in zip(exact.items(), kernels, strict=True):
        system = np.eye(25) - 0.95 * np.einsum("sa,nsat->nst", policy, chances)
        paid = np.einsum("sa,nsat,sat->ns", policy, chances, reward)
        values = np.linalg.solve(system, paid[..., None])[..., 0] @ target.initial
        rows.append({"estimator": name, "scaled_variance": float(n * values.var(ddof=1)), "exact": float(bound),
                     "ratio": float(n * values.var(ddof=1) / bound)})  # fmt: skip
    return rows


def draw_efficiency(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """n times the simulated variance beside the exact one."""
    (ax,) = panels(figure, ["n times the variance of the value"], size=(6.4, 3.6))
    names = list(table.estimator.unique())
    found = table.groupby("estimator").agg({"scaled_variance": ["mean", "sem"], "exact": "first"}).reindex(names)
    place = np.arange(len(names))
    ax.plot(found["exact", "first"], place, "|", ms=26, mew=2.5, color="#0072B2", label="exact (the formula)")
    ax.errorbar(found["scaled_variance", "mean"], place, xerr=1.96 * found["scaled_variance", "sem"], fmt="o", ms=5,
                color="#D55E00", label="simulated, 95% range")  # fmt: skip
    ax.set_xscale("log")
    ticks = [100, 200, 500, 1000, 2000, 5000]
    ax.set_xticks(ticks, [str(tick) for tick in ticks])
    ax.minorticks_off()
    ax.set_xlim(100, 6000)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_yticks(place, names)
    ax.grid(visible=True, alpha=0.3)
    ax.set_xlabel("n Var(J), J a discounted sum of rewards (logarithmic)")
    ax.legend(fontsize="small", loc="lower right", markerscale=0.45)


def efficiency_finding(table: pd.DataFrame) -> str:
    """The quotient's variance beside the bound, and how far the formulas are from simulation."""
    exact = table.groupby("estimator").exact.first()
    off = (table.groupby("estimator").ratio.mean() - 1.0).abs().max()
    times = number(exact["ratio of ratios"] / exact["plug-in"])
    return f"The quotient's variance is {times} times the plug-in's; simulated within {percent(off)}"


EFFICIENCY = Experiment(
    id="efficiency",
    title="Asymptotic variances against simulation: the plug-in attains the bound, the quotient is far from it",
    axes={"n": (100_000,)},
    repetitions=40,
    run=efficiency_cell,
    keys=("n", "estimator"),
    measures=("ratio", "scaled_variance", "exact"),
    draw=draw_efficiency,
    finding=efficiency_finding,
    group="sureness",
)

# ---- collection --------------------------------------------------------------------------------------------------------

RESTART = 0.05


def _record(target: FiniteMDP, behavior: Array, n: int, generator: np.random.Generator) -> Transitions:
    """n moves: episodes that stop after each move with probability RESTART, and at the goal."""
    episodes = n // 3 + 100  # more than are needed
    log = sample_episodes(target, behavior, episodes, 300, seed=generator)
    assert log.timestep is not None
    assert log.episode is not None
    kept = np.flatnonzero(log.timestep < generator.geometric(RESTART, episodes)[log.episode])
    return log.select(kept[:n])


def _planned(known: Any, policy: Array, n: int) -> Array:
    return plan_data_collection(known, policy, n=n, sampling="behavior", restart=RESTART).behavior_policy


@functools.cache
def _before() -> Array:
    """The plan from the simulator alone, the same for every n."""
    return _planned(small_grids()[0], gridworld_policy(5, 0.5), 1)


TWO_STAGE = "two-stage"
BEGUN_BY: dict[str, Callable[[], Array]] = {  # the policies that the designs begin with
    "uniform": lambda: uniform_policy(small_grids()[1]),
    "on-policy": lambda: gridworld_policy(5, 0.5),
    "planned": _before,
    TWO_STAGE: _before,
}


@functools.cache
def _foretold(design: str, n: int) -> float:
    """sqrt(asymptotic variance / n) of maximum likelihood under the design; two stages: under the oracle's plan."""
    _, target = small_grids()
    policy = gridworld_policy(5, 0.5)
    behavior = _planned(target, policy, n) if design == TWO_STAGE else BEGUN_BY[design]()
    share = occupancy(collection_mdp(target, RESTART), behavior)
    return SMALL_SCALE * float(np.sqrt(efficiency_bound(target, policy, share) / n))


def collection_cell(settings: Cell, stream: Stream) -> list[Row]:
    """5 x 5 grid, discount 0.95, half expert half uniform; n moves of episodes that start again after each move with
    probability 0.05. planned: before any data; two-stage: a fifth as planned, then the plan from that log. Root mean
    square over the seeds. A plan minimises the variance of maximum likelihood; the default borrows from all rows, and
    no plan is made for it. Recording by the evaluated policy itself (on-policy) saves nearly as much.
    """
    n, design = int(settings["n"]), str(settings["design"])
    simulator, target = small_grids()
    policy, generator = gridworld_policy(5, 0.5), stream.generator()
    log = _record(target, BEGUN_BY[design](), n // 5 if design == TWO_STAGE else n, generator)
    if design == TWO_STAGE:
        rest = n - len(log)
        log = Transitions.concatenate(
            [log, _record(target, _planned(Problem(simulator, log), policy, rest), rest, generator)]
        )
    problem, truth = Problem(simulator, log), policy_value(target, policy)
    estimators: dict[str, Estimator] = {
        "maximum likelihood": ModelBased(fallback="simulator"),
        "default": OffEnvironment(),
    }
    errors = {name: error_of(fit(problem, policy).value, truth, SMALL_SCALE) for name, fit in estimators.items()}
    return [{"estimator": name, **error, "foretold": _foretold(design, n)} for name, error in errors.items()]


def collection_finding(table: pd.DataFrame) -> str:
    """What planned recording leaves of the squared error of uniform recording, the mean over n."""
    by = table.pivot_table("squared_error", ["estimator", "n"], "design")
    if not {"planned", "uniform"} <= set(by):
        return ""
    left = (by["planned"] / by["uniform"]).groupby("estimator").mean()
    return f"Planned recording leaves {listed(left, percent)} of uniform's squared error"


COLLECTION = Experiment(
    id="collection",
    title="Planned collection: errors of what is recorded by design",
    axes={"n": (667, 2000, 6667, 20_000), "design": tuple(BEGUN_BY)},
    smoke={"n": (667,), "design": ("uniform", "planned")},
    repetitions=100,
    run=collection_cell,
    keys=("n", "design", "estimator"),
    measures=("squared_error", "error", "foretold"),
    draw=rmse_panels("design", "estimator", title="{estimator}", slope=-0.5),
    finding=collection_finding,
    group="sureness",
)
