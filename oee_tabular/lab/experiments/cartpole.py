"""CartPole under four gravities (fig2), and what its estimates depend on.

Other experiments vary the grid, the data and their quality, and the configuration.

Every estimate is made from one log in one documented configuration, the same for every
gravity and n:

    32 x 32 grid over (theta, theta'), the simulator (gravity 10) looked at in the
    log's own places, floor 0.001, zeta from soft counts with prior "simulator" and
    strength 0.01, exact evaluation, calibrated by the ratio.

``cartpole_choice`` compares others on logs that no other experiment reports. Moves from
or to states outside the grid, one in a million, are left out; ends of the track, which
(theta, theta') does not show, are taken as truncations. Values are (1 - discount)
sum_{t<100} discount^t r_t, discount 0.99: at most 0.634, a pole that never falls. The
truth, means of 400 000 episodes with standard errors of at most 3e-4, is in
``cartpole_truth.csv``. The simulator's own value, which calibration needs, has other
random numbers than the truth that estimates are held to.

    python -m oee_tabular.lab.experiments.cartpole

makes the table again, the same to the last bit (five minutes).
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy import sparse

from oee_tabular._sparse import row_sums
from oee_tabular.continuous import (
    PAPER_NOISE,
    CartPole,
    ContinuousTask,
    ContinuousTransitions,
    Discretization,
    Grid,
    GridInterpolation,
    MonteCarlo,
    ResidualSimulator,
    VisitedCells,
    cartpole_policy,
    continuous_simulator,
    discretize,
    monte_carlo_value,
    record,
    sampling_rows,
)
from oee_tabular.estimators import ImportanceSampling
from oee_tabular.exact import policy_value
from oee_tabular.lab.experiment import Cell, Panels, Row, Stream, experiment, listed
from oee_tabular.lab.experiments.classic import LinearGaussian
from oee_tabular.lab.experiments.common import (
    distance_between,
    frequencies,
    mark_paper,
    published,
    select_deltas,
)
from oee_tabular.mdp import FiniteMDP
from oee_tabular.plots import label_ends
from oee_tabular.ratio import TransitionRatio
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array

DELTAS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
GRAVITIES = (7.5, 10.0, 12.5, 15.0)
SIMULATOR_GRAVITY = 10.0
HORIZON = 100
EPISODES = 400_000
CASES = {
    "target": (GRAVITIES, PAPER_NOISE, False),
    "target without noise": (GRAVITIES, 0.0, False),  # Gymnasium's
    "simulator": ((SIMULATOR_GRAVITY,), PAPER_NOISE, False),
    "deterministic expert": ((SIMULATOR_GRAVITY,), PAPER_NOISE, True),
}


def simulate_truth(
    case: str, gravity: float, delta: float, episodes: int = EPISODES
) -> MonteCarlo:
    """Simulate one value of the table, with its own random numbers."""
    _, noise, deterministic = CASES[case]
    words = hashlib.sha256(f"cartpole {case} {gravity:g} {delta:g}".encode()).digest()
    return monte_carlo_value(
        CartPole(gravity, noise),
        cartpole_policy(delta, deterministic=deterministic),
        episodes,
        HORIZON,
        seed=np.frombuffer(words[:16], dtype=">u4").tolist(),
        normalized=True,
    )


def make_truths(episodes: int = EPISODES) -> pd.DataFrame:
    """Simulate the whole table of true values.

    Its columns are case, gravity, delta, value, standard_error and episodes.
    """
    rows = []
    for case, (gravities, _, _) in CASES.items():
        for gravity, delta in itertools.product(gravities, DELTAS):
            truth = simulate_truth(case, gravity, delta, episodes)
            rows.append(
                (case, gravity, delta, truth.value, truth.standard_error, episodes)
            )
    return pd.DataFrame(
        rows,
        columns=["case", "gravity", "delta", "value", "standard_error", "episodes"],
    )


@functools.cache
def truth_table() -> pd.DataFrame:
    """Load the true values that are shipped."""
    return pd.read_csv(Path(__file__).with_name("cartpole_truth.csv"))


def true_values(case: str, gravity: float, column: str = "value") -> Array:
    """Return the true values (6,) at each of ``DELTAS``, or their standard errors."""
    own = (
        truth_table()
        .query("case == @case and gravity == @gravity")
        .set_index("delta")[column]
    )
    return np.asarray(own.reindex(DELTAS), dtype=np.float64)


# ---- estimates of one log

VERTICES = 32
STRENGTH = 0.01
FLOOR = 1e-3
DISCOUNT = 0.99
BEHAVIOR = 0.3
VISITING = continuous_simulator("cartpole").policies
FINE_VERTICES = 320  # at which a task's values are within 0.1% of its own Monte Carlo
RESIDUAL = "residual"


def exact_values(mdp: FiniteMDP, policies: Iterable[Array]) -> Array:
    """Compute (1 - discount) times the value of each policy."""
    return np.array(
        [
            policy_value(mdp, policy, horizon=HORIZON, normalized=True)
            for policy in policies
        ]
    )


def policies_of(model: Discretization) -> list[Array]:
    """Return the six policies of ``DELTAS`` on the model's states."""
    return [model.policy(cartpole_policy(delta)) for delta in DELTAS]


def calibrate(
    name: str, mdp: FiniteMDP, simulator: FiniteMDP, policies: list[Array]
) -> dict[str, Array]:
    """Compute the values of a model, raw and calibrated.

    Calibrated values are multiplied by the simulator's own value, by Monte Carlo / its
    value on the same cells.
    """
    raw, inside = (exact_values(model, policies) for model in (mdp, simulator))
    return {
        name: raw,
        f"{name}, calibrated": raw
        * (true_values("simulator", SIMULATOR_GRAVITY) / inside),
    }


def target_log(
    kind: str,
    gravity: float,
    n: int,
    generator: np.random.Generator,
    behavior: float = BEHAVIOR,
) -> Any:
    """Record n transitions of the policy of delta = ``behavior``.

    ``kind`` is "compiled" (our dynamics, the paper's noise) or "gymnasium" (stepped, no
    noise).
    """
    policy = cartpole_policy(behavior)
    if kind == "gymnasium":
        task: Any = continuous_simulator(f"CartPole-v1:gravity={gravity}").task
        return task.record(policy, n_transitions=n, max_steps=HORIZON, seed=generator)
    return record(
        CartPole(gravity), policy, n_transitions=n, max_steps=HORIZON, seed=generator
    )


def fine_values(task: ContinuousTask) -> Array:
    """Compute the values in a task of the angle, exactly on a fine grid.

    Noise is left at 0.
    """
    model = discretize(task, cells=(FINE_VERTICES, FINE_VERTICES), closure_episodes=0)
    return exact_values(model.mdp, policies_of(model))


def importance_sampling(log: ContinuousTransitions, *, self_normalized: bool) -> Array:
    """Estimate by per-decision importance sampling on the log's whole episodes.

    The probabilities are those that policy and behaviour have in each state.
    """
    episode = log.columns()["episode"]
    is_cut = log.truncated & (log.columns()["timestep"] < HORIZON - 1)
    # The last episode is cut where the log ends.
    whole = log.first(len(log) - int(np.isin(episode, episode[is_cut]).sum()))
    estimator = ImportanceSampling(kind="per_decision", self_normalized=self_normalized)
    weigh = sampling_rows(
        {"": estimator}, whole, len(CartPole.actions), HORIZON, DISCOUNT
    )[""]
    return (1.0 - DISCOUNT) * np.array(
        [weigh(cartpole_policy(delta)).value for delta in DELTAS]
    )


@dataclass(frozen=True, eq=False)
class Corrected:
    """Off-environment evaluation on cells at a log's places.

    It has the simulator there, its zeta, and values raw and calibrated.
    """

    simulator: Discretization
    counts: sparse.csr_array
    uncovered: float
    zeta: TransitionRatio
    values: dict[str, Array]


def off_environment(
    log: ContinuousTransitions,
    *,
    cells: Any = (VERTICES, VERTICES),
    strength: float = STRENGTH,
    form: Literal["angle", "full"] = "angle",
) -> Corrected:
    """Estimate in the documented configuration.

    Other cells and strength may be given, or cells of the whole state (``form``
    "full").
    """
    task = CartPole(SIMULATOR_GRAVITY, form=form)
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message=".*(ends do not show in the features|They are left out)"
        )
        simulator = discretize(
            task, log, cells=cells, floor=FLOOR, policies=VISITING, closure_episodes=0
        )
        counts, uncovered = simulator.supported(simulator.counts(log, outside="drop"))
    zeta = transition_ratio(counts, simulator.mdp, prior="simulator", strength=strength)
    model = zeta.target_model(simulator.mdp)
    values = calibrate("OEE", model, simulator.mdp, policies_of(simulator))
    return Corrected(simulator, counts, uncovered, zeta, values)


def estimates(
    log: ContinuousTransitions, gravity: float, *, noise: float
) -> tuple[dict[str, Array], Corrected]:
    """Return the estimates by name, (6,) values at each of ``DELTAS``.

    ``gravity`` and ``noise`` are for the oracle alone.
    """
    found = off_environment(log)
    model = found.simulator
    assert isinstance(model.cells, Grid)
    policies = policies_of(found.simulator)
    n_actions = found.simulator.task.n_actions
    cells = GridInterpolation(model.cells.shape, vertex_weight=0.0)
    looked = discretize(
        CartPole(SIMULATOR_GRAVITY), log, cells=cells, closure_episodes=0
    )
    seen = sparse.diags_array((row_sums(found.counts) > 0).astype(float))
    both = found.counts, sparse.csr_array(seen @ looked.mdp.transitions)
    counted, same = (
        model.mdp.with_transitions(frequencies(matrix, n_actions)) for matrix in both
    )
    target = discretize(CartPole(gravity, noise), cells=model, closure_episodes=0)
    return {
        "simulator": true_values("simulator", SIMULATOR_GRAVITY),
        **found.values,
        **calibrate("model-based", counted, same, policies),
        "linear model": fine_values(LinearGaussian(CartPole(), log, slice(2, 4))),
        "IS, per decision": importance_sampling(log, self_normalized=False),
        "IS, self-normalised": importance_sampling(log, self_normalized=True),
        **calibrate("oracle", target.mdp, model.plain, policies),
    }, found


PAPERS_N = 80_000
OTHER_GRAVITIES = (7.5, 12.5, 15.0)
TRUTHS = {
    "compiled": ("target", PAPER_NOISE),
    "gymnasium": ("target without noise", 0.0),
}
ERROR = "mean |error| of the value, times (1 - discount)"
ON_CELLS = (
    "simulator",
    "OEE",
    "OEE, calibrated",
    "model-based",
    "model-based, calibrated",
    "linear model",
)
OTHERS = (
    "OEE, calibrated",
    RESIDUAL,
    "IS, per decision",
    "IS, self-normalised",
    "oracle",
    "oracle, calibrated",
)
PAPERS = {
    "true_value": ("true", "x"),
    "oee": ("OEE", "o"),
    "mle": ("model (MLE)", "s"),
    "is": ("IS", "^"),
}

PAPERS_NAMES = {"OEE": "oee", "model-based": "mle", "IS": "is"}


def rows_of(
    values: dict[str, Array], case: str, gravity: float, found: Corrected | None = None
) -> list[Row]:
    """Return a row for each estimator.

    It has the mean |error| over the policies, and value and truth of each.
    """
    truth = true_values(case, gravity)
    facts: Row = {
        f"truth_{delta:g}": value for delta, value in zip(DELTAS, truth, strict=True)
    }
    facts["truth_standard_error"] = float(
        true_values(case, gravity, "standard_error").max()
    )
    if found is not None:
        facts |= {
            "visited": float(found.zeta.visited.mean()),
            "largest_zeta": float(found.zeta.values.data.max()),
        }
    return [
        {"estimator": name, "error": float(np.abs(value - truth).mean())}
        | {f"value_{delta:g}": x for delta, x in zip(DELTAS, value, strict=True)}
        | facts
        for name, value in values.items()
    ]


def published_error(gravity: float, estimator: str) -> float:
    """Compute the mean |error| of the paper's own curve from its own true curve.

    That of the simulator is between its two true curves.
    """
    setting = f"gravity={gravity}"
    name = PAPERS_NAMES.get(estimator.partition(",")[0])
    right = published("cartpole", setting, "true_value")
    if estimator == "simulator" and gravity != SIMULATOR_GRAVITY:
        return distance_between(
            published("cartpole", f"gravity={SIMULATOR_GRAVITY}", "true_value"), right
        )
    return (
        float("nan")
        if name is None
        else distance_between(published("cartpole", setting, name), right)
    )


def draw_figure_2(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw values and errors at each delta, under each gravity.

    They are those of the largest logs of the compiled target.
    """
    own = table[(table.target == "compiled") & (table.n == table.n.max())]
    shared: dict[str, Any] = {
        "curves": "estimator",
        "x": "delta",
        "xlabel": "delta (share of the uniform policy)",
    }
    errors = shared | {
        "title": "gravity {gravity:g} m/s²: errors",
        "ylabel": ERROR,
        "log": True,
    }
    Panels(
        "value",
        title="gravity {gravity:g} m/s²: values",
        ylabel="value times (1 - discount)",
        beneath=lambda ax, rows: mark_paper(
            ax, "cartpole", f"gravity={rows.gravity.iloc[0]}", PAPERS
        ),
        extra={"true value": "truth"},
        only=keep("OEE, calibrated"),
        **shared,
        beside=[
            Panels("error", only=keep(*names), **errors) for names in (ON_CELLS, OTHERS)
        ],
        by=("gravity",),
        columns=3,
        size=(6.0, 4.4),
    )(select_deltas(own, DELTAS), summary, figure)
    for ax in figure.axes:
        if not ax.get_title().endswith("values"):
            label_ends(ax)


def keep(*names: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Return a function that keeps the rows of these estimators."""
    return lambda rows: rows[rows.estimator.isin(names)]


def finding_2(table: pd.DataFrame) -> str:
    """Write the errors on gravities other than the simulator's, at the largest n."""
    n = table.n.max()
    own = table[
        (table.target == "compiled")
        & (table.n == n)
        & (table.gravity != SIMULATOR_GRAVITY)
    ]
    names = [
        RESIDUAL,
        "OEE, calibrated",
        "linear model",
        "IS, per decision",
        "IS, self-normalised",
        "simulator",
    ]
    means = (
        own[own.estimator.isin(names)].groupby("estimator").error.mean().sort_values()
    )
    return f"Mean error at n = {n} under other gravities: {listed(means)}"


def smallest(table: pd.DataFrame, column: str) -> pd.Series[float]:
    """Return the mean errors by the values of a column, the least first.

    The simulator's own is left out.
    """
    return (
        table[table.estimator != "simulator"]
        .groupby(column)
        .error.mean()
        .sort_values()[:3]
    )


@experiment(
    "Figure 2: CartPole under four gravities, with a simulator of gravity 10",
    group="continuous",
    axes={
        "target": ("compiled", "gymnasium"),
        "gravity": GRAVITIES,
        "n": (10_000, PAPERS_N),
    },
    smoke={"gravity": (15.0,), "n": (10_000,)},
    keys=("target", "gravity", "n", "estimator"),
    measures=("error",),
    draw=draw_figure_2,
    finding=finding_2,
    paper=lambda row: (  # for the target with its noise
        published_error(row["gravity"], row["estimator"])
        if (row["target"], row["n"]) == ("compiled", PAPERS_N)
        else float("nan")
    ),
)
def fig2(settings: Cell, stream: Stream) -> list[Row]:
    """Values are (1 - discount) times the discounted sum of 100 rewards, at most 0.634,
    of delta uniform + (1 - delta) expert; logs of delta = 0.3. The truth is a mean of
    400 000 episodes (standard error at most 0.0003). 32 x 32 vertices over angle and
    angular velocity, the simulator looked at in the log's places, strength 0.01.
    Calibrated: times the simulator's Monte Carlo value / its value on the grid. The
    oracle is the target itself on the same grid. Residual: the simulator corrected by
    what the log's steps leave over its own. Hollow grey marks: the paper's.
    """
    kind = str(settings["target"])
    gravity = float(settings["gravity"])
    log = target_log(kind, gravity, int(settings["n"]), stream.generator())
    case, noise = TRUTHS[kind]
    values, found = estimates(log, gravity, noise=noise)
    values[RESIDUAL] = fine_values(
        ResidualSimulator(CartPole(SIMULATOR_GRAVITY), log, seed=0)
    )
    return rows_of(values, case, gravity, found)


# ---- resolution, data quality, configuration

# what is discretised, and on which cells
STATES: dict[str, tuple[Literal["angle", "full"], Any]] = {
    **{f"{k} x {k}": ("angle", (k, k)) for k in (20, 32, 60, 100)},
    **{f"whole state, {k}^4 grid": ("full", (k,) * 4) for k in (10, 18)},
    **{f"whole state, {k} cells": ("full", k) for k in (1000, 5000)},
}
FULL_STRENGTH = 1.0  # of zeta on cells of the whole state


def draw_resolution(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw errors against n, raw and calibrated.

    Those without data are in the table.
    """
    panel = Panels(
        "error",
        "states",
        by=("estimator",),
        title="{estimator}",
        log=True,
        bands=True,
        ylabel=ERROR,
        axes={"xscale": "log"},
        columns=2,
        size=(6.0, 4.0),
    )
    panel(table[table.n > 0], summary, figure)


@experiment(
    "CartPole: error against the grid's resolution and against n, in two and in four"
    " dimensions",
    group="continuous",
    axes={
        "states": tuple(STATES),
        "n": (0, 3162, 10_000, 31_623, PAPERS_N),
        "gravity": OTHER_GRAVITIES,
    },
    smoke={
        "states": ("20 x 20", "32 x 32", "whole state, 1000 cells"),
        "n": (0, 10_000),
        "gravity": (15.0,),
    },
    repetitions=3,
    keys=("states", "n", "gravity", "estimator"),
    measures=("error", "number_of_states", "entries", "uncovered"),
    draw=draw_resolution,
    finding=lambda table: (
        f"Least error without data: {listed(smallest(table[table.n == 0], 'states'))}"
    ),
)
def cartpole_resolution(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |error| over six policies and three gravities. n = 0: the target itself on
    these states, no data; else estimates from n transitions, raw and calibrated. Two
    dimensions (angle, angular velocity) are exact for policies of the angle; no log
    covers a grid of the whole state. uncovered: share of the log's transitions without
    probability, which are left out.
    """
    (form, cells) = STATES[str(settings["states"])]
    n = int(settings["n"])
    gravity = float(settings["gravity"])
    if n > 0 and len(np.atleast_1d(cells)) == 4:
        return []
    if n > 0:
        log = target_log("compiled", gravity, n, stream.generator("n", "gravity"))
        whole = (
            {"cells": VisitedCells(cells, n_simulated=2000), "strength": FULL_STRENGTH}
            if form == "full"
            else {}
        )
        found = off_environment(log, **({"cells": cells, "form": form} | whole))
        values = found.values
        model = found.simulator
        uncovered = found.uncovered
    else:
        model = discretize(
            CartPole(SIMULATOR_GRAVITY, form=form),
            cells=cells,
            policies=VISITING,
            closure_episodes=0,
        )
        target = discretize(
            CartPole(gravity, form=form), cells=model, closure_episodes=0
        )
        raw, mended = calibrate("", target.mdp, model.mdp, policies_of(model)).values()
        values = {"target on these states": raw, "the same, calibrated": mended}
        uncovered = 0.0
    values = {"simulator": true_values("simulator", SIMULATOR_GRAVITY)} | values
    cost: Row = {
        "number_of_states": model.mdp.n_states,
        "entries": int(model.mdp.transitions.nnz),
    }
    return [
        row | cost | {"uncovered": uncovered}
        for row in rows_of(values, "target", gravity)
    ]


@experiment(
    "CartPole: which policy should record the log",
    group="continuous",
    repetitions=5,
    axes={
        "behavior": (0.0, BEHAVIOR, 0.6, 1.0),
        "gravity": OTHER_GRAVITIES,
        "n": (10_000, PAPERS_N),
    },
    smoke={"behavior": (0.0, 1.0), "gravity": (15.0,), "n": (10_000,)},
    keys=("behavior", "gravity", "n", "estimator"),
    measures=("error", "visited"),
    draw=Panels(
        "error",
        "estimator",
        "behavior",
        ("n", "gravity"),
        only=keep(*ON_CELLS),
        log=True,
        ylabel=ERROR,
        columns=3,
        xlabel="delta of the policy that recorded the log",
    ),
    finding=lambda table: (
        "OEE's calibrated error, by delta of the recording policy: "
        + listed(
            table[table.estimator == "OEE, calibrated"].groupby("behavior").error.mean()
        )
    ),
)
def cartpole_data(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |error| over six policies from logs that delta = 0 (the expert), 0.3, 0.6 or
    1 (uniform) recorded. visited: share of states and actions of the grid that the log
    has seen.
    """
    gravity = float(settings["gravity"])
    log = target_log(
        "compiled",
        gravity,
        int(settings["n"]),
        stream.generator(),
        float(settings["behavior"]),
    )
    values, found = estimates(log, gravity, noise=PAPER_NOISE)
    return rows_of(values, "target", gravity, found)


@experiment(
    "CartPole: how grid and strength were chosen",
    group="continuous",
    repetitions=4,
    axes={
        "vertices": (24, 32, 60),
        "strength": (0.01, 0.1, 0.3, 1.0),
        "gravity": OTHER_GRAVITIES,
        "n": (10_000, PAPERS_N),
    },
    smoke={
        "vertices": (24, 32),
        "strength": (0.01, 1.0),
        "gravity": (15.0,),
        "n": (10_000,),
    },
    keys=("vertices", "strength", "gravity", "n", "estimator"),
    measures=("error",),
    draw=Panels(
        "error",
        "vertices",
        "strength",
        ("n",),
        log=True,
        ylabel=ERROR,
        xlabel="strength of the prior (transitions a row)",
        only=keep("OEE, calibrated"),
        axes={"xscale": "log"},
    ),
    finding=lambda table: (
        f"Least error, by vertices: {listed(smallest(table, 'vertices'))}"
    ),
)
def cartpole_choice(settings: Cell, stream: Stream) -> list[Row]:
    """Mean |error| over six policies and three gravities of the calibrated estimate, by
    the vertices along each side and the strength of the prior, on logs of its own. fig2
    uses 32 and 0.01 everywhere.
    """
    gravity = float(settings["gravity"])
    log = target_log(
        "compiled", gravity, int(settings["n"]), stream.generator("gravity", "n")
    )
    found = off_environment(
        log,
        cells=(int(settings["vertices"]),) * 2,
        strength=float(settings["strength"]),
    )
    return rows_of(found.values, "target", gravity, found)


if __name__ == "__main__":
    make_truths().to_csv(
        Path(__file__).with_name("cartpole_truth.csv"), index=False, lineterminator="\n"
    )
