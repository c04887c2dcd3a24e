"""How sure: asymptotic variances, what planned collection saves, coverage and width of the intervals."""

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
from oee_tabular.exact import efficiency_bound, occupancy, optimal_policy, policy_value, ratio_of_ratios_variance
from oee_tabular.inference import interval
from oee_tabular.lab.experiments.common import SMALL_SCALE, error_of, grids, rmse, rmse_panels, small_grids
from oee_tabular.lab.findings import listed, percent, rank
from oee_tabular.lab.panels import Beside, Ranges, panels
from oee_tabular.lab.registry import Cell, Experiment, Row, Stream
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.plots.style import COLORS
from oee_tabular.simulate import sample_episodes, sample_transitions
from oee_tabular.tasks import gridworld_policy, named_task

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


def efficiency_finding(table: pd.DataFrame) -> str:
    """The exact variances, and how far they are from simulation."""
    means = table.groupby("estimator")[["exact", "ratio"]].mean()
    return f"n Var(J): {listed(means.exact)}; simulated within {percent((means.ratio - 1.0).abs().max())}"


EFFICIENCY = Experiment(
    "efficiency", "Asymptotic variances against simulation: the plug-in attains the bound, the quotient is far from it",
    axes={"n": (100_000,)}, repetitions=40, group="sureness",
    run=efficiency_cell, keys=("n", "estimator"), measures=("ratio", "scaled_variance", "exact"),
    finding=efficiency_finding,
    draw=Beside(
        [Ranges("scaled_variance", "estimator", beside="exact", title="n times the variance", xlabel="n Var(J)")],
        size=(6.4, 3.6),
    ),
)  # fmt: skip

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


COLLECTION = Experiment(
    "collection", "Planned collection: errors of what is recorded by design",
    axes={"n": (667, 2000, 6667, 20_000), "design": tuple(BEGUN_BY)}, smoke={"n": (667,), "design": ("uniform", "planned")},
    repetitions=100, group="sureness",
    run=collection_cell, keys=("n", "design", "estimator"), measures=("squared_error", "error", "foretold"),
    finding=rank("RMSE of both estimators", "error", "design", how=rmse),
    draw=rmse_panels("design", "estimator", title="{estimator}", slope=-0.5),
)  # fmt: skip

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


def coverage_finding(table: pd.DataFrame) -> str:
    """The smallest coverage of each kind over the cases."""
    least = table.groupby(["environment", "n", "method"]).covered.mean().groupby("method").min()
    names = [name for name in ("likelihood", "delta", "bootstrap", "robust") if name in least]
    return f"Least coverage over the cases, of {table.repetition.nunique()} logs: {listed(least[names], percent)}"


COVERAGE = Experiment(
    "coverage", "Intervals: how often they hold, and how wide they are",
    axes={"case": ("grid 1000", "grid 10000", "grid 100000", "rare 20000")}, smoke={"case": ("grid 1000",)},
    repetitions=200, group="sureness",
    run=coverage_cell, keys=("environment", "n", "method"), measures=("covered", "width"), finding=coverage_finding,
    draw=Beside(
        [
            Ranges("covered", "method", "case", title="coverage of nominal 95% intervals", mark=0.95,
                   xlabel="share of the intervals that cover the true value"),
            Ranges("width", "method", "case", title="mean width", xlabel="width times (1 - discount)", axes={"xscale": "log"}),
        ], size=(6.2, 4.6),
    ),
)  # fmt: skip


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
    "coverage_lake", "The default interval on FrozenLake", axes={"n": (20_000,)}, repetitions=400, group="sureness",
    run=lake_cell, keys=("n", "method"), measures=("covered", "width"), draw=draw_lake,
    finding=lambda table: f"{table.covered.mean():.1%} of {len(table)} intervals cover the true value (nominal 95%)",
)  # fmt: skip
