"""fig1bcd: the value of three policies by every estimator; and why the paper saw its estimate beat its oracle (estimands)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._sparse import csr_on_pattern
from oee_tabular.estimators import OffEnvironment, Oracle, Problem
from oee_tabular.exact import occupancy, policy_value, weighted_return_moments
from oee_tabular.lab.experiments.common import DELTAS, HORIZON, MEAN_ERROR, SCALE, episodes_for, estimators_of, grids
from oee_tabular.lab.findings import number
from oee_tabular.lab.panels import Panels, panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.plots import label_ends, plot_errors
from oee_tabular.plots.style import marks
from oee_tabular.ratio import true_ratio
from oee_tabular.tasks import gridworld, gridworld_policy

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

N_ROLLOUTS = 100  # the products' own


CURVES = {  # and their names in ``oee evaluate``
    "simulator": "simulator",
    "OEE, exact": "oee",
    "OEE, product": "oee-product",
    "oracle, exact": "oracle",
    "oracle, product": "oracle-product",
    "model-based": "model-based",
    "IS": "is",
    "PDIS": "pdis",
    "WIS": "wis",
    "doubly robust": "dr",
    "marginalised": "marginalized",
}


def cell(settings: Cell, stream: Stream) -> list[Row]:
    """10 x 10 grid, slip 0.3 simulated, 0.1 real, T = 200, one reward r(s, a, s') everywhere; a log of n moves of the
    uniform policy. Left: means and the 10% to 90% range over the seeds, dashed the true values. Above: by models and
    ratios of dynamics; below: by ratios of policies, beside the same OEE. Importance sampling
    gets the whole episodes behind the drawn moves, cut at T, and the true behaviour policy; products are means of 100
    rollouts. Points outside the left panel's axis are in the table; exact_sd in table.csv is the products' exact
    standard deviation.
    """
    n = int(settings["n"])
    simulator, target = grids()
    generator = stream.generator()
    behavior = uniform_policy(target)
    pool = episodes_for(target, behavior, n, generator)
    problem = Problem(simulator, pool.draw(n, seed=generator), horizon=HORIZON, behavior_policy=behavior, episodes=pool)
    rollouts = stream.generator(use="rollouts")
    episodes = {name: {"episodes": pool.summary()["episodes"]} for name in ("IS", "PDIS", "WIS")}
    rows = []
    for delta in DELTAS:
        policy = gridworld_policy(10, delta)
        truth = SCALE * policy_value(target, policy, horizon=HORIZON)
        facts: dict[str, Row] = dict(episodes)
        fitted = OffEnvironment().fit(problem, policy, generator)
        for name, zeta in (("OEE, product", fitted), ("oracle, product", true_ratio(target, simulator))):
            moments = weighted_return_moments(simulator, zeta, policy, horizon=HORIZON)
            facts[name] = {"exact_sd": SCALE * float(np.sqrt(moments.variance / N_ROLLOUTS))}
        for name, estimate in estimators_of(CURVES, target).items():
            value = SCALE * estimate(problem, policy, seed=rollouts).value
            row = {"delta": delta, "estimator": name, "value": value, "truth": truth, "error": abs(value - truth)}
            rows.append(row | facts.get(name, {}))
    return rows


BY_MODEL = ("simulator", "OEE, exact", "OEE, product", "oracle, exact", "oracle, product", "model-based")
BY_EPISODES = ("IS", "OEE, exact", "PDIS", "WIS", "doubly robust", "marginalised")


def shown_size(table: pd.DataFrame) -> int:
    """The n whose values are shown: the paper's, or the largest that there is."""
    return 3162 if 3162 in set(table.n) else int(table.n.max())


def finding(table: pd.DataFrame) -> str:
    """The errors of OEE, of importance sampling and of the simulator."""
    n = shown_size(table)
    mean = table[table.n == n].groupby("estimator").error.mean()
    weights = mean[["IS", "PDIS", "WIS"]].min()
    return (
        f"At n = {n} OEE's values err by {number(mean['OEE, exact'])} on average, importance sampling's by "
        f"{number(weights)} at best, the simulator's by {number(mean['simulator'])}"
    )


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
    """Values at n = 3162, and their mean error over delta against n; ratios of the dynamics above, of policies below."""
    sizes = sorted(table.n.unique())
    n = shown_size(table)
    mean = table[table.n == n].groupby("estimator").error.mean()
    path, mixed = (str(mean[rows].idxmin()) for rows in (["IS", "PDIS", "WIS"], ["doubly robust", "marginalised"]))
    titles = [
        f"n = {n}: OEE is off by {mean['OEE, exact']:.2g}, the simulator by {mean['simulator']:.2g}",
        f"As products, its ratios err {mean['OEE, product'] / mean['OEE, exact']:.0f} times as much at n = {n}",
        f"Weights of whole paths are off by {mean[path]:.2g} at best ({path})",
        f"With a model beside them: off by {mean[mixed]:.2g} ({mixed})",
    ]
    axes = panels(figure, titles, columns=2, size=(6.4, 4.2))
    for names, (left, right) in zip((BY_MODEL, BY_EPISODES), (axes[:2], axes[2:]), strict=True):
        part = table[table.estimator.isin(names)]
        _values(part[part.n == n], names, left)
        by_n = part.groupby(["estimator", "n"]).error.mean()
        plot_errors(sizes, {name: by_n[name] for name in names}, right, slope=None, ylabel=MEAN_ERROR)
        label_ends(right)


def _values(part: pd.DataFrame, names: Sequence[str], ax: Axes) -> None:
    """Mean and 10% to 90% of the seeds, dashed the true values; colours and marks as in the panel to the right."""
    for k, name in enumerate(names):
        own = part[part.estimator == name]
        shift = (k - (len(names) - 1) / 2) * 0.045
        low, high = own.groupby("delta").value.quantile(0.1), own.groupby("delta").value.quantile(0.9)
        middle = own.groupby("delta").value.mean()
        ax.errorbar(middle.index + shift, middle, yerr=np.abs([middle - low, high - middle]), ms=4, lw=1, **marks(k))
    truth = part.groupby("delta").truth.first()
    ax.hlines(truth, truth.index - 0.17, truth.index + 0.17, color="black", lw=1, ls=(0, (4, 2)), zorder=0)
    ax.set_ylim(float(truth.min()) - 1.0, float(truth.max()) + 1.0)
    ax.set_xticks(list(DELTAS))
    ax.set_xlabel("delta: the policy is delta expert + (1 - delta) uniform")
    ax.set_ylabel("value times (1 - discount); dashed: true")


FIGURE_1BCD = Experiment(
    id="fig1bcd",
    title="Figure 1b, c, d: the value of three policies in the real grid",
    axes={"n": (1000, 3162, 10_000, 31_623)},
    smoke={"n": (3162,)},
    run=cell,
    keys=("n", "delta", "estimator"),
    measures=("error", "value"),
    draw=draw,
    finding=finding,
)


# ---- the published recipe ----------------------------------------------------------------------------------------------


TRUE = "true, r(s_t+1)"


def short_weight_value(simulator: FiniteMDP, target: FiniteMDP, policy: Array) -> float:
    """sum_t gamma^t E[r(s_{t+1})], s_t the target's, the last move the simulator's: a weight one move too short."""
    time = occupancy(target, policy, horizon=HORIZON)
    total = sum(simulator.discount**t for t in range(HORIZON))
    return float(total * np.sum(time * simulator.rewards))


def estimands(settings: Cell, stream: Stream) -> list[Row]:
    """The published code's true curve pays r(s_t+1), its OEE pays r(s_t), and its oracle pays r(s_t+1) with a weight
    that lacks the last move, self-normalised over 100 rollouts. All with the exact zeta, no estimation error at all:
    what differs is what is estimated. Exactly evaluated, the oracle's quantity is nearer the true curve than OEE's; as
    published, its rollouts put it farther off at most deltas. That OEE beats the oracle is no merit of an estimate.
    The first two are exact, the last is the mean distance over the seeds.
    """
    delta = float(settings["delta"])
    simulator, target = grids()
    current = gridworld(10, 0.1, pay="current")
    policy = gridworld_policy(10, delta)
    truth = policy_value(target, policy, horizon=HORIZON)
    oracle = Oracle(target, evaluation="monte_carlo", self_normalized=True, n_rollouts=N_ROLLOUTS)
    short = with_next_rewards_averaged(simulator)
    log = episodes_for(target, uniform_policy(target), 100, stream.generator()).draw(100, seed=0)
    shifted = Problem(short, log, horizon=HORIZON)
    sampled = oracle(shifted, policy, seed=stream.generator(use="rollouts")).value
    values = {
        TRUE: truth,
        "OEE's, r(s_t)": policy_value(current, policy, horizon=HORIZON),
        "oracle's, one move short": short_weight_value(simulator, target, policy),
        "the same, 100 rollouts": sampled,
    }
    return [
        {"quantity": name, "value": SCALE * value, "distance": SCALE * abs(value - truth)}
        for name, value in values.items()
    ]


def with_next_rewards_averaged(simulator: FiniteMDP) -> FiniteMDP:
    """The same MDP paying r(s, a) = sum_s' P r(s, a, s'): a product estimator then weighs r_t without the last ratio."""
    return FiniteMDP(csr_on_pattern(simulator.transitions, simulator.transitions.data), simulator.rewards, simulator.initial,
                     simulator.discount, layout=simulator.layout, state_names=simulator.state_names,
                     action_names=simulator.action_names)  # fmt: skip


def estimands_finding(table: pd.DataFrame) -> str:
    """How far from the true curve each of the others is, on average over delta."""
    mean = table[table.quantity != TRUE].groupby("quantity", sort=False).distance.mean()
    ours, oracle, rollouts = map(number, mean)
    return f"With the exact zeta OEE is off by {ours}, the oracle by {oracle}, its rollouts by {rollouts}"


ESTIMANDS = Experiment(
    id="estimands",
    title="The published recipe compares three different quantities",
    axes={"delta": tuple(round(0.1 * k, 1) for k in range(1, 10))},
    smoke={"delta": DELTAS},
    run=estimands,
    keys=("delta", "quantity"),
    measures=("value", "distance"),
    draw=Panels(
        "distance",
        "quantity",
        "delta",
        title="how far from the true curve",
        xlabel="delta",
        ylabel="|value - true value| times (1 - discount)",
        only=lambda table: table[table.quantity != TRUE],
        size=(6.4, 4.4),
    ),
    finding=estimands_finding,
)
