"""Experiments on uncertainty: variances, plans, intervals, the choice of a policy.

They compare asymptotic variances, what planned collection saves, coverage and width of
the intervals, and rules that say which policy is best.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pandas as pd

import oee_tabular as oee
from oee_tabular.design.programs import collection_mdp
from oee_tabular.estimators import ModelBased, OffEnvironment
from oee_tabular.exact import policy_value, ratio_of_ratios_variance
from oee_tabular.lab.bench.families import HELD, families
from oee_tabular.lab.experiment import (
    Cell,
    Panels,
    Row,
    Stream,
    experiment,
    listed,
    panels,
    percent,
)
from oee_tabular.lab.experiments.common import (
    SMALL_SCALE,
    RmsePanels,
    grids,
    signed_error,
    small_grids,
)
from oee_tabular.mdp import mix, uniform_policy
from oee_tabular.plots import plot_intervals
from oee_tabular.report import contest
from oee_tabular.tasks import gridworld_policy
from oee_tabular.typing import Array, IntArray

POLICY = gridworld_policy(5, 0.5)  # that is evaluated on the small grids


def plot_means(
    ax: Any, table: pd.DataFrame, y: str, curves: str, by: str, **options: Any
) -> None:
    """Plot means over the rows with 95% ranges, a group for each value of ``by``."""
    points = (
        table.groupby([by, curves], sort=False)[y].agg(["mean", "sem"]).reset_index()
    )
    mean = points["mean"]
    half = 1.96 * points["sem"]
    plot_intervals(
        list(points[curves]),
        mean,
        mean - half,
        mean + half,
        ax,
        groups=list(points[by]),
        **options,
    )


def compare_variances(table: pd.DataFrame) -> str:
    """Write the exact variances, and how far they are from simulation."""
    means = table.groupby("estimator")[["exact", "ratio"]].mean()
    return (
        f"n Var(J): {listed(means.exact)}; simulated within"
        f" {percent((means.ratio - 1.0).abs().max())}"
    )


def draw_variances(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw the simulated variances beside the exact ones."""
    (ax,) = panels(figure, ["n times the variance"], size=(6.4, 3.6))
    exact = table.groupby("estimator").exact.mean().to_dict()
    own = table.assign(what="simulated")
    plot_means(
        ax,
        own,
        "scaled_variance",
        "what",
        "estimator",
        truth=exact,
        truth_label="exact",
        xlabel="n Var(J)",
    )


@experiment(
    "Asymptotic variances against simulation: the plug-in attains the bound, the"
    " quotient is far from it",
    axes={"n": (100_000,)},
    repetitions=40,
    group="sureness",
    keys=("n", "estimator"),
    measures=("ratio", "scaled_variance", "exact"),
    finding=compare_variances,
    draw=draw_variances,
)
def efficiency(settings: Cell, stream: Stream) -> list[Row]:
    """5 x 5 grid, discount 0.95; n = 10^5 rows drawn uniformly over (s, a) from each
    side, 500 logs a seed. Exact: efficiency_bound for the plug-in (the
    maximum-likelihood model), ratio_of_ratios_variance for the quotient.
    """
    n = settings["n"]
    logs = 500
    simulator, target = grids(5, discount=0.95)
    share = np.full((25, 4), 0.01)
    assert simulator.transition_rewards is not None
    tables = (target.transitions, simulator.transitions, simulator.transition_rewards)
    # The rewards r(s, a, s') are known.
    p, q, reward = (table.toarray().reshape(25, 4, 25) for table in tables)
    generator = stream.generator()
    ours, theirs = (
        generator.multinomial(
            n, (share[:, :, None] * rows).reshape(-1), size=logs
        ).reshape(logs, *rows.shape)
        for rows in (p, q)
    )
    kernel = quotient_of_ratios(ours, theirs) * q
    arguments = (simulator, target, POLICY, share, share)
    normalised = ratio_of_ratios_variance(*arguments, rows="normalised")
    cases: dict[str, tuple[float, Array]] = {
        "plug-in": (
            oee.efficiency_bound(target, POLICY, share),
            ours / ours.sum(axis=3, keepdims=True),
        ),
        "ratio of ratios": (ratio_of_ratios_variance(*arguments), kernel),
        "ratio of ratios, rows normalised": (
            normalised,
            kernel / kernel.sum(axis=3, keepdims=True),
        ),
    }
    rows = []
    for name, (bound, chances) in cases.items():
        values = values_of_models(chances, reward, target.initial)
        variance = float(n * values.var(ddof=1))
        rows.append(
            {
                "estimator": name,
                "scaled_variance": variance,
                "exact": float(bound),
                "ratio": variance / bound,
            }
        )
    return rows


def quotient_of_ratios(ours: IntArray, theirs: IntArray) -> Array:
    """Return zeta as the quotient of two ratios of counts, 0 where it is 0 / 0."""
    quotient = np.divide(ours, theirs, out=np.zeros(ours.shape), where=theirs > 0)
    return np.asarray(quotient * (theirs.sum(axis=3) / ours.sum(axis=3))[..., None])


def values_of_models(chances: Array, reward: Array, initial: Array) -> Array:
    """Compute the policy's values in models (n, 25, 4, 25) with rewards r(s, a, s')."""
    system = np.eye(25) - 0.95 * np.einsum("sa,nsat->nst", POLICY, chances)
    rewards = np.einsum("sa,nsat,sat->ns", POLICY, chances, reward)
    return np.asarray(np.linalg.solve(system, rewards[..., None])[..., 0] @ initial)


RESTART = 0.05
TWO_STAGE = "two-stage"


def record(
    target: oee.FiniteMDP, behavior: Array, n: int, generator: np.random.Generator
) -> oee.Transitions:
    """Record n transitions.

    Episodes stop after each transition with probability RESTART, and at the goal.
    """
    episodes = n // 3 + 100  # more than are needed
    log = oee.sample_episodes(target, behavior, episodes, 300, seed=generator)
    assert log.timestep is not None
    assert log.episode is not None
    kept = np.flatnonzero(
        log.timestep < generator.geometric(RESTART, episodes)[log.episode]
    )
    return log.select(kept[:n])


def plan(known: Any, n: int) -> Array:
    """Plan the policy that should record, by what is known."""
    return oee.plan_data_collection(
        known, POLICY, n=n, sampling="behavior", restart=RESTART
    ).behavior_policy


@functools.cache
def first_policies() -> dict[str, Array]:
    """Return the policies that the designs begin with.

    The plan from the simulator alone is the same for every n.
    """
    simulator, _ = small_grids()
    planned = plan(simulator, 1)
    return {
        "uniform": oee.uniform_policy(simulator),
        "on-policy": POLICY,
        "planned": planned,
        TWO_STAGE: planned,
    }


@functools.cache
def predict_error(design: str, n: int) -> float:
    """Compute sqrt(asymptotic variance / n) of maximum likelihood under the design.

    Two stages have that of the oracle's plan.
    """
    _, target = small_grids()
    behavior = plan(target, n) if design == TWO_STAGE else first_policies()[design]
    share = oee.occupancy(collection_mdp(target, RESTART), behavior)
    return SMALL_SCALE * float(np.sqrt(oee.efficiency_bound(target, POLICY, share) / n))


@experiment(
    "Planned collection: errors of what is recorded by design",
    repetitions=100,
    group="sureness",
    axes={
        "n": (667, 2000, 6667, 20_000),
        "design": ("uniform", "on-policy", "planned", TWO_STAGE),
    },
    keys=("n", "design", "estimator"),
    measures=("squared_error", "error", "foretold"),
    draw=RmsePanels("design", by=("estimator",)),
)
def collection(settings: Cell, stream: Stream) -> list[Row]:
    """5 x 5 grid, discount 0.95; n transitions of episodes that start again after each
    with probability 0.05. planned: before any data; two-stage: a fifth as planned, then
    the plan from that log. Root mean square over the seeds. A plan minimises the
    variance of maximum likelihood; the default borrows from all rows, and no plan is
    made for it.
    """
    n = settings["n"]
    design = settings["design"]
    generator = stream.generator()
    simulator, target = small_grids()
    log = record(
        target,
        first_policies()[design],
        n // 5 if design == TWO_STAGE else n,
        generator,
    )
    if design == TWO_STAGE:
        rest = n - len(log)
        second = record(
            target, plan(oee.Problem(simulator, log), rest), rest, generator
        )
        log = oee.Transitions.concatenate([log, second])
    problem = oee.Problem(simulator, log)
    truth = oee.policy_value(target, POLICY)
    rows = []
    for name, fit in {
        "maximum likelihood": ModelBased(fallback="simulator"),
        "default": OffEnvironment(),
    }.items():
        error = signed_error(fit(problem, POLICY).value, truth, SMALL_SCALE)
        rows.append({"estimator": name, **error, "foretold": predict_error(design, n)})
    return rows


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


def find_least_coverage(table: pd.DataFrame) -> str:
    """Write the smallest coverage of each kind over the cases."""
    least = (
        table.groupby(["environment", "n", "method"])
        .covered.mean()
        .groupby("method")
        .min()
    )
    shown = least.reindex(["likelihood", "delta", "bootstrap", "robust"]).dropna()
    return (
        f"Least coverage over the cases, of {table.repetition.nunique()} logs:"
        f" {listed(shown, percent)}"
    )


def draw_coverage(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw coverage and width of each method in each case."""
    left, right = panels(
        figure, ["coverage of nominal 95% intervals", "mean width"], size=(6.2, 7.6)
    )
    nominal = dict.fromkeys(table.case, 0.95)
    share = "share of the intervals that cover the true value"
    plot_means(
        left,
        table,
        "covered",
        "method",
        "case",
        truth=nominal,
        truth_label="95%",
        xlabel=share,
    )
    plot_means(
        right, table, "width", "method", "case", xlabel="width times (1 - discount)"
    )


@experiment(
    "Intervals: how often they hold, and how wide they are",
    repetitions=200,
    group="sureness",
    axes={"case": ("grid 1000", "grid 10000", "grid 100000", "rare 20000")},
    keys=("environment", "n", "method"),
    measures=("covered", "width"),
    finding=find_least_coverage,
    draw=draw_coverage,
)
def coverage(settings: Cell, stream: Stream) -> list[Row]:
    """5 x 5 grid, discount 0.95, delta = 0.5; n rows drawn from the uniform policy's
    discounted occupancy, the goal left out; prior box 0.25 <= zeta <= 1.6. rare: two
    columns, which the policy needs, never recorded.
    """
    kind, n = settings["case"].split()
    simulator, target = small_grids()
    share = oee.occupancy(target, oee.uniform_policy(target))
    share[24] = 0.0
    if kind == "rare":
        share[np.arange(25) % 5 >= 3] = 0.0
    log = oee.sample_transitions(
        target, share / share.sum(), int(n), seed=stream.generator()
    )
    problem = oee.Problem(simulator, log)
    truth = oee.policy_value(target, POLICY)
    rows = []
    for name, options in METHODS.items():
        interval = oee.interval(problem, POLICY, seed=settings["repetition"], **options)
        covered = float(interval.lower <= truth <= interval.upper)
        facts = {"environment": kind, "n": int(n), "method": name}
        rows.append(
            {**facts, "covered": covered, "width": SMALL_SCALE * interval.width}
        )
    return rows


def draw_lake(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw a hundred of the intervals; those that miss have another colour."""
    (ax,) = panels(figure, ["the first 100 logs"], size=(5.6, 5.6))
    part = table.head(100).reset_index(drop=True)
    ax.hlines(
        part.index,
        part.lower,
        part.upper,
        colors=["C0" if covered else "C1" for covered in part.covered],
    )
    ax.axvline(part.truth.iloc[0], color="black", lw=1, ls=":")
    ax.set(xlabel="value (discounted sum of rewards); dotted: true", ylabel="log")


@experiment(
    "The default interval on FrozenLake",
    axes={"n": (20_000,)},
    repetitions=400,
    group="sureness",
    keys=("n", "method"),
    measures=("covered", "width"),
    draw=draw_lake,
    finding=lambda table: (
        f"{table.covered.mean():.1%} of {len(table)} intervals cover the true value"
        " (nominal 95%)"
    ),
)
def coverage_lake(settings: Cell, stream: Stream) -> list[Row]:
    """FrozenLake 8 x 8, 1/3 simulated, 0.6 real; 20 000 transitions of a policy that is
    optimal with probability 0.49, the policy evaluated 0.7. The default 95% interval,
    without a box: unrecorded pairs may differ from the estimate by a factor of 3.
    """
    lake = families()["frozen_lake"]
    simulator = lake.simulator
    target = lake.target
    best = oee.optimal_policy(target)
    uniform = oee.uniform_policy(target)
    policy = oee.mix(best, uniform, 0.7)
    behavior = oee.mix(best, uniform, 0.49)
    log = oee.sample_episodes(
        target, behavior, 700, 100, seed=stream.generator()
    ).first(20_000)
    interval = oee.interval(oee.Problem(simulator, log), policy)
    truth = oee.policy_value(target, policy)
    return [
        {
            "method": "likelihood",
            "covered": float(interval.lower <= truth <= interval.upper),
            "width": interval.width,
            "lower": interval.lower,
            "upper": interval.upper,
            "truth": truth,
            "unrecorded_pairs": interval.diagnostics["unrecorded_pairs"],
        }
    ]


TUNED = (
    "inventory20",
    "queue25",
    "machine",
    "forest12",
    "river_swim",
    "corridor30",
    "floor_slippery",
    "floor_chequered",
    "garnet_dirichlet100",
    "garnet_worse",
    "garnet_tempered",
    "elevator",
)


def compare_rules(table: pd.DataFrame) -> str:
    """Write how often each rule is right, and how often contest is wrong."""
    share = {
        str(rule): rows[["right", "wrong", "cannot_say"]].mean()
        for rule, rows in table.groupby("rule")
    }
    ours = share["contest"]
    oee = share["largest value of oee"]
    return (
        f"contest is right in {percent(ours['right'])}, cannot say in"
        f" {percent(ours['cannot_say'])}, wrong in {percent(ours['wrong'])}; the"
        f" largest value of oee is wrong in {percent(oee['wrong'])}"
    )


@experiment(
    "Which policy is worth most: right, wrong, cannot say",
    axes={"family": (*TUNED, *HELD), "size": (3.0, 10.0, 30.0)},
    smoke={"family": ("machine",)},
    group="sureness",
    keys=("families", "size", "rule"),
    measures=("right", "wrong", "cannot_say"),
    finding=compare_rules,
    draw=Panels(
        "right",
        curves="rule",
        x="size",
        xlabel="transitions per stochastic pair",
        ylabel="share that is right",
        by=("families",),
        title="{families} families",
        axes={"xticks": (3, 10, 30)},
    ),
)
def ranking(settings: Cell, stream: Stream) -> list[Row]:
    """Three policies: the family's, four fifths of it, and the one that recorded the
    log (the rest of each is uniform). "contest" names the best policy or says that the
    log cannot tell; the others always name the one with the largest value.
    """
    family = families(int(settings["repetition"]))[str(settings["family"])]
    uniform = uniform_policy(family.simulator)
    policies = {
        "new": family.policy,
        "four fifths": mix(family.policy, uniform, 0.8),
        "recorded": family.data_policy,
    }
    values = {
        name: policy_value(family.target, policy, horizon=family.horizon)
        for name, policy in policies.items()
    }
    best = max(values, key=values.__getitem__)
    problem = family.problem(family.size(float(settings["size"])), stream.generator())
    report = contest(problem, policies)
    shown = {result.policy: result.estimate.value for result in report.results}
    likelihood = {
        name: ModelBased(fallback="simulator")(problem, policy).value
        for name, policy in policies.items()
    }
    named = {
        "contest": report.best,
        "largest value of oee": max(shown, key=shown.__getitem__),
        "largest value of maximum likelihood": max(
            likelihood, key=likelihood.__getitem__
        ),
    }
    kind = "held" if settings["family"] in HELD else "tuned"
    facts: Row = {"families": kind, "gap": values[best] - sorted(values.values())[-2]}
    return [
        {
            **facts,
            "rule": rule,
            "right": float(name == best),
            "wrong": float(name not in (best, None)),
            "cannot_say": float(name is None),
        }
        for rule, name in named.items()
    ]
