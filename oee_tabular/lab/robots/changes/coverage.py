"""residual_coverage: how often the 95% interval of the residual row holds the truth."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.rows import corrected_value
from oee_tabular.lab.findings import percent, reach
from oee_tabular.lab.panels import panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.lab.robots.changes.cases import CASES, DISCOUNT, Change

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

POLICIES = {"CartPole, gravity 12.5": 0.4, "CartPole, all at once": 0.4, "Pendulum, mass, gravity": 0.5}
N = 20_000  # moves of a log
EPISODES, REFITS, PATHS = 1000, 10, 200
TRUTH = 400_000  # episodes


@functools.lru_cache(maxsize=8)
def truth(name: str) -> MonteCarlo:
    """Of the case's policy in its target."""
    case = CASES[name]
    policy = case.acting(POLICIES[name])
    return monte_carlo_value(case.target, policy, TRUTH, case.horizon, discount=DISCOUNT, seed=12)


@functools.lru_cache(maxsize=8)
def pair(name: str) -> tuple[Change, np.ndarray]:
    """The case, and returns in its target whose random numbers the corrected simulator shares."""
    case = replace(CASES[name], episodes=EPISODES, scale=1.0)
    return case, case.returns(case.target, POLICIES[name])


def cell(settings: Cell, stream: Stream) -> list[Row]:
    """Logs of 20 000 transitions, a policy each; sums of rewards. covered: share of the logs whose 95% interval (10 refits by
    200 episodes, the value by 1000) covers the truth of 400 000 rollouts. covered_paired: the same without the rollouts' noise,
    by rollouts that share their random numbers with the target's: |error| within Student's t times the standard error.
    """
    name = str(settings["case"])
    case, there = pair(name)
    log = case.log(N, stream.generator(use="log"))
    corrected = ResidualSimulator(case.simulator, log, seed=0)
    policy, seed = case.acting(POLICIES[name]), int(stream.generator(use="value").integers(2**31))
    found = corrected_value(
        corrected, policy, EPISODES, case.horizon, discount=DISCOUNT, refits=REFITS, paths=PATHS, seed=seed
    )
    low, high = found.interval or (np.nan, np.nan)  # none where the log seems to show hidden state: not covered
    apart = case.returns(corrected, POLICIES[name]) - there
    error, noise = float(apart.mean()), float(apart.std() / np.sqrt(apart.size))
    of_log = float(found.diagnostics.get("standard_error_of_the_log", np.nan))
    margin = float(stats.t.ppf(0.975, REFITS - 1))
    known = truth(name)
    return [
        {
            "value": found.value, "lower": low, "upper": high, "truth": known.value,
            "truth_standard_error": known.standard_error, "error": error, "noise": noise, "error_of_log": of_log,
            "covered": float(low <= known.value <= high),
            "covered_paired": float(abs(error) <= margin * np.hypot(of_log, noise)),
        }
    ]  # fmt: skip


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Errors against the standard errors that the log's refits told."""
    names = list(summary.case)
    for ax, name in zip(panels(figure, names, size=(4.2, 3.4)), names, strict=True):
        part = table[table.case == name]
        ax.plot(np.hypot(part.error_of_log, part.noise), np.abs(part.error), "o", ms=3)
        most = float(max(np.hypot(part.error_of_log, part.noise).max(), 1e-12))
        ax.plot([0.0, most], [0.0, most * float(stats.t.ppf(0.975, REFITS - 1))], "k:", lw=1)
        ax.set_xlabel("standard error told")
        ax.set_ylabel("|error|")


def finding(table: pd.DataFrame) -> str:
    """In what share of the logs of each case the interval holds the truth, and how often without the rollouts' noise."""
    held = table.groupby("case")[["covered", "covered_paired"]].mean()
    whole, paired = (reach(held[name], percent) for name in held)
    return (
        f"The 95% interval holds the truth in {whole} of the logs; without the rollouts' noise, drawn here, in {paired}"
    )


RESIDUAL_COVERAGE = Experiment(
    id="residual_coverage",
    title="How often the interval of the residual row holds the truth",
    axes={"case": tuple(POLICIES)},
    smoke={"case": ("CartPole, gravity 12.5",)},
    repetitions=100,
    run=cell,
    keys=("case",),
    measures=("covered", "covered_paired", "error", "noise", "error_of_log"),
    draw=draw,
    finding=finding,
    group="continuous",
)
