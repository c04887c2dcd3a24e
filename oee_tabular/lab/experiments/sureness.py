"""How sure: coverage and width of the intervals."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular.estimators import Problem
from oee_tabular.exact import occupancy, optimal_policy, policy_value
from oee_tabular.inference import interval
from oee_tabular.lab.experiments.common import SMALL_SCALE, small_grids
from oee_tabular.lab.findings import number, percent
from oee_tabular.lab.panels import panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.plots.style import COLORS, marks
from oee_tabular.simulate import sample_episodes, sample_transitions
from oee_tabular.tasks import gridworld_policy, named_task

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

# ---- coverage ----------------------------------------------------------------------------------------------------------

BOX = {"lower_ratio": 0.25, "upper_ratio": 1.6}
METHODS: dict[str, dict[str, Any]] = {
    "delta": {"method": "delta"},
    "bootstrap": {"method": "bootstrap", "n_bootstrap": 400},
    "likelihood": {**BOX},
    "likelihood without box": {},
    "robust, box": {"method": "robust", **BOX},
    "robust": {"method": "robust"},
    "robust, anytime": {"method": "robust", "radius": "anytime"},
}


def coverage_cell(settings: Cell, stream: Stream) -> list[Row]:
    """5 x 5 grid, slip 0.3 simulated, 0.1 real, discount 0.95, infinite horizon, delta = 0.5; n rows drawn from the
    uniform policy's discounted occupancy, the goal left out; prior box 0.25 <= zeta <= 1.6. rare: two columns, which
    the policy needs, never recorded. Bars: 95% ranges of the share over the seeds. Widths: means.
    """
    kind, n = str(settings["case"]).split()[0], int(str(settings["case"]).split()[1])
    simulator, target = small_grids()
    share = occupancy(target, uniform_policy(target))
    share[24] = 0.0
    if kind == "rare":
        share[np.arange(25) % 5 >= 3] = 0.0
    log = sample_transitions(target, share / share.sum(), n, seed=stream.generator())
    policy = gridworld_policy(5, 0.5)
    problem, truth = Problem(simulator, log), policy_value(target, policy)
    rows = []
    for name, options in METHODS.items():
        found = interval(problem, policy, seed=int(settings["repetition"]), **options)
        covered = float(found.lower <= truth <= found.upper)
        rows.append(
            {"environment": kind, "n": n, "method": name, "covered": covered, "width": SMALL_SCALE * found.width}
        )
    return rows


def draw_coverage(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Coverage and width of each method."""
    names = list(METHODS)
    first, second = panels(figure, ["coverage of nominal 95% intervals", "mean width"], size=(6.2, 4.6))
    cases: list[Any] = list(table.groupby(["environment", "n"], sort=False).groups)
    for k, (kind, n) in enumerate(cases):
        part = table[(table.environment == kind) & (table.n == n)].groupby("method")
        label = f"n = {n}" + (", two columns never recorded" if kind == "rare" else "")
        height = np.arange(len(names)) + 0.14 * (k - (len(cases) - 1) / 2)
        share, count = part.covered.mean().reindex(names), part.covered.size().reindex(names)
        error = 1.96 * np.sqrt(share * (1 - share) / count)
        first.errorbar(share, height, xerr=error, ms=5, lw=1, label=label, **marks(k))
        second.plot(part.width.mean().reindex(names), height, ms=5, label=label, **marks(k))
    first.axvline(0.95, color="black", lw=1, ls=":")
    first.set_xlabel("share of the intervals that hold the true value")
    second.set_xlabel("width times (1 - discount)")
    for ax in (first, second):
        ax.set_yticks(range(len(names)), names)
        ax.invert_yaxis()
        ax.grid(visible=True, alpha=0.3)
    second.set_xscale("log")
    first.legend(fontsize="small", loc="lower left")


def coverage_finding(table: pd.DataFrame) -> str:
    """The smallest coverage of each kind over the cases, and how wide the robust ones are."""
    cases = table.pivot_table(["covered", "width"], ["environment", "n"], "method")
    least = cases.covered.min()
    wider = (cases.width["robust"] / cases.width["likelihood without box"]).max()
    return (
        f"Least coverage of {table.repetition.nunique()} logs: likelihood {percent(least['likelihood'])}, delta "
        f"{percent(least['delta'])}, bootstrap {percent(least['bootstrap'])}, robust "
        f"{percent(least['robust'])}, at most {number(wider)} times as wide as likelihood"
    )


COVERAGE = Experiment(
    id="coverage",
    title="Intervals: how often they hold, and how wide they are",
    axes={"case": ("grid 1000", "grid 10000", "grid 100000", "rare 20000")},
    smoke={"case": ("grid 1000",)},
    repetitions=200,
    run=coverage_cell,
    keys=("environment", "n", "method"),
    measures=("covered", "width"),
    draw=draw_coverage,
    finding=coverage_finding,
    group="sureness",
)


@functools.cache
def lakes() -> tuple[FiniteMDP, FiniteMDP]:
    """FrozenLake 8 x 8, success rate 1/3 simulated, 0.6 real."""
    made = [named_task(f"FrozenLake-v1:map_name=8x8,success_rate={rate}", discount=0.99).mdp for rate in ("1/3", "0.6")]
    return made[0], made[1]


def lake_cell(settings: Cell, stream: Stream) -> list[Row]:
    """FrozenLake 8 x 8, 1/3 simulated, 0.6 real; 20 000 transitions of a policy that is optimal with probability 0.49,
    the policy evaluated 0.7. The default 95% interval (profile likelihood) without a box.
    """
    simulator, target = lakes()
    best, uniform = optimal_policy(target), uniform_policy(target)
    policy, behavior = mix(best, uniform, 0.7), mix(best, uniform, 0.49)
    log = sample_episodes(target, behavior, 700, 100, seed=stream.generator()).select(np.arange(20_000))
    found = interval(Problem(simulator, log), policy)
    truth = policy_value(target, policy)
    return [
        {"method": "likelihood", "covered": float(found.lower <= truth <= found.upper), "width": found.width,
         "lower": found.lower, "upper": found.upper, "truth": truth, "unvisited_rows": found.diagnostics["unvisited_rows"]}
    ]  # fmt: skip


def draw_lake(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """A hundred of the intervals, those that miss marked."""
    (ax,) = panels(figure, ["the first 100 logs"], size=(5.6, 5.6))
    part = table.head(100).reset_index(drop=True)
    held: dict[str, Any] = {"color": COLORS[0], "lw": 1.2, "ls": "-", "label": "holds the true value"}
    missed: dict[str, Any] = {"color": COLORS[1], "lw": 2.4, "ls": "--", "label": "misses it"}
    for covered, style in ((1.0, held), (0.0, missed)):
        own = part[part.covered == covered]
        ax.hlines(own.index, own.lower, own.upper, **style)
    ax.axvline(float(part.truth.iloc[0]), color="black", lw=1, ls=":", label="true value")
    ax.set_xlabel("value (discounted sum of rewards)")
    ax.set_ylabel("log")
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")


COVERAGE_LAKE = Experiment(
    id="coverage_lake",
    title="The default interval on FrozenLake",
    axes={"n": (20_000,)},
    repetitions=400,
    run=lake_cell,
    keys=("n", "method"),
    measures=("covered", "width"),
    draw=draw_lake,
    finding=lambda table: f"{table.covered.mean():.1%} of {len(table)} intervals hold the true value (nominal 95%)",
    group="sureness",
)
