"""Experiments on changes and tasks that nobody tuned for: changes, residual_coverage.

They show what estimates are worth there, and how often their intervals cover the truth.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from oee_tabular.continuous import (
    CartPole,
    ContinuousTask,
    ContinuousTransitions,
    HistoryTask,
    LinearModel,
    MonteCarlo,
    Moves,
    ResidualSimulator,
    StatePolicy,
    cartpole_policy,
    compare_returns,
    corrected_value,
    discretize,
    kinova,
    monte_carlo_value,
    reacher_policy,
    record,
)
from oee_tabular.exact import policy_value
from oee_tabular.lab.experiment import (
    Cell,
    Row,
    Stream,
    experiment,
    listed,
    panels,
    percent,
    reach,
)
from oee_tabular.lab.experiments import classic
from oee_tabular.lab.experiments.cartpole import DELTAS as CARTPOLE_DELTAS
from oee_tabular.lab.experiments.kinova import arm_of, towards
from oee_tabular.lab.experiments.reacher import DELTAS as REACHER_DELTAS
from oee_tabular.lab.experiments.reacher import Even
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array, IntArray, Seed

DISCOUNT = 0.99


@dataclass(frozen=True)
class Change:
    """One change of one task.

    Attributes
    ----------
    simulator, target : ContinuousTask
        The target's states may have more coordinates after the simulator's; the log has
        the simulator's.
    policy : callable
        Share of random actions -> policy.
    sizes : tuple of int
        Numbers of transitions of a log.
    deltas : tuple of float
        Shares of random actions of the policies valued.
    horizon, episodes : int
        Numbers of rewards and of episodes of a value.
    scale : float
        Factor of values and errors.
    grid : tuple of int
        Vertices for the rows on a grid; without any there are no such rows.
    behavior : float
        Share of random actions of the policy that recorded the log.
    """

    simulator: ContinuousTask
    target: ContinuousTask
    policy: Callable[[float], StatePolicy]
    sizes: tuple[int, ...] = (20_000,)
    deltas: tuple[float, ...] = (0.1, 0.5)
    horizon: int = 200
    episodes: int = 4000
    scale: float = 1.0
    grid: tuple[int, ...] = ()
    behavior: float = 0.3

    def acting(self, delta: float) -> StatePolicy:
        """Return the policy on states that may have more coordinates."""
        policy = self.policy(delta)
        d = self.simulator.n_state
        return lambda states: policy(states[:, :d])

    def log(self, n: int, seed: Seed) -> ContinuousTransitions:
        """Record n transitions of the target, by the simulator's coordinates."""
        found = record(
            self.target,
            self.acting(self.behavior),
            n_transitions=n,
            max_steps=self.horizon,
            seed=seed,
        )
        d = self.simulator.n_state
        columns = found.columns()
        return ContinuousTransitions(
            **(columns | {k: columns[k][:, :d] for k in ("state", "next_state")})
        )

    def returns(self, task: ContinuousTask, delta: float) -> Array:
        """Simulate returns (episodes,); tasks that are alike share random numbers."""
        seed = np.random.SeedSequence(11, spawn_key=(round(100 * delta),))
        policy = self.acting(delta)
        found = compare_returns(
            [task], policy, self.episodes, self.horizon, discount=DISCOUNT, seed=seed
        )
        return np.asarray(self.scale * found[0])


@dataclass(frozen=True)
class Arm(Change):
    """Change of the Kinova stand-in.

    Values are means over the five goals; logs are of 10 runs to each.
    """

    def log(self, n: int, seed: Seed) -> ContinuousTransitions:
        """Record n transitions, 25 a run."""
        runs = n // (len(kinova.GOALS) * kinova.HORIZON)
        return kinova.record_goals(
            self.target,  # type: ignore[arg-type]
            n_runs=runs,
            delta=self.behavior,
            seed=seed,
        )

    def returns(self, task: ContinuousTask, delta: float) -> Array:
        """Simulate returns (episodes,), means over the goals."""
        found = []
        for goal in range(len(kinova.GOALS)):
            seed = np.random.SeedSequence(11, spawn_key=(round(100 * delta), goal))
            aim = towards(task, goal)
            policy = kinova.kinova_policy(goal, delta)
            found += [
                *compare_returns(
                    [aim],
                    policy,
                    self.episodes,
                    self.horizon,
                    discount=DISCOUNT,
                    seed=seed,
                )
            ]
        return np.asarray(np.mean(found, axis=0))


class Delayed(HistoryTask):
    """Task that does what was asked for a step ago."""

    step = ContinuousTask.step

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Make one step; the first one does what is asked."""
        last = states[:, self.task.n_state :]
        done = np.where(last.any(axis=1), last.argmax(axis=1), actions)
        moved = super().moves(states, done, disturbance)
        moved.next_state[:, self.task.n_state :] = np.eye(self.n_actions)[actions]
        return moved


def _cartpole(episodes: int = 4000, **changes: Any) -> Change:
    """Return a change of CartPole."""
    target = classic.ChangedCartPole(**({"gravity": 10.0} | changes))
    return replace(_CARTPOLE, target=target, episodes=episodes)


_CARTPOLE = Change(
    CartPole(10.0),
    CartPole(10.0),
    cartpole_policy,
    sizes=(3000, 80_000),
    deltas=CARTPOLE_DELTAS,
    horizon=100,
    scale=1.0 - DISCOUNT,
    grid=(32, 32),
)
_PENDULUM = Change(
    classic.Pendulum(), classic.Pendulum(), classic.swinging, grid=(41, 41)
)
_CAR = Change(
    classic.MountainCar(), classic.MountainCar(), classic.rocking, grid=(40, 40)
)
_ACROBOT = Change(classic.Acrobot(), classic.Acrobot(), classic.pumping, horizon=500)
_CHAIN = Change(
    classic.Chain(),
    classic.Chain(),
    classic.braking,
    sizes=(20_000, 150_000),
    horizon=100,
)


def _reacher(length: float) -> Change:
    """Return a change of Reacher."""
    return Change(
        Even(0.1, length),
        Even(length),
        reacher_policy,
        sizes=(150_000,),
        deltas=REACHER_DELTAS,
        horizon=100,
        episodes=1000,
        behavior=0.5,
    )


def _arm(name: str) -> Change:
    """Return a change of the Kinova stand-in."""
    return Arm(
        arm_of("simulator"),
        arm_of(name),
        functools.partial(kinova.kinova_policy, 0),
        sizes=(1250,),
        deltas=(0.0, 0.3),
        horizon=kinova.HORIZON,
        episodes=100,
    )


CASES: dict[str, Change] = {
    "CartPole, gravity 7.5": _cartpole(gravity=7.5),
    "CartPole, gravity 12.5": _cartpole(gravity=12.5),
    "CartPole, gravity 15": _cartpole(gravity=15.0),
    "CartPole, gravity 11.3": _cartpole(gravity=11.3),
    "CartPole, pole x 1.3": _cartpole(pole=1.3),
    "CartPole, force x 0.8": _cartpole(force=0.8),
    "CartPole, friction": _cartpole(joint=2e-4, cart=0.05),
    "CartPole, wind": _cartpole(push=0.5),
    "CartPole, unchanged": _cartpole(),
    # Other noise differs from the truth's, so more of it is left in a difference.
    "CartPole, noise 0.03": _cartpole(10_000, gusts=0.03),
    "CartPole, all at once": _cartpole(
        10_000, gravity=11.3, pole=1.3, force=0.8, joint=2e-4, cart=0.05, gusts=0.03
    ),
    "CartPole, delay": replace(_CARTPOLE, target=Delayed(CartPole(10.0))),
    "Pendulum, mass, gravity": replace(
        _PENDULUM, target=classic.Pendulum(mass=1.2, gravity=11.0)
    ),
    "Pendulum, length": replace(_PENDULUM, target=classic.Pendulum(length=1.15)),
    "Pendulum, friction, torque": replace(
        _PENDULUM, target=classic.Pendulum(friction=0.1, torque=0.8)
    ),
    "MountainCar, gravity, force": replace(
        _CAR, target=classic.MountainCar(0.0027, 0.0009)
    ),
    "MountainCar, force x 1.2": replace(_CAR, target=classic.MountainCar(force=0.0012)),
    "Acrobot, mass, length": replace(
        _ACROBOT, target=classic.Acrobot(mass_2=1.3, length_1=1.15)
    ),
    "Acrobot, torque x 0.7": replace(_ACROBOT, target=classic.Acrobot(torque=0.7)),
    "Reacher, short": _reacher(0.05),
    "Reacher, 1.7 times": _reacher(0.17),
    "Reacher, long": _reacher(0.2),
    "Kinova, velocity x 1.4": _arm("velocity x 1.4"),
    "Kinova, six causes": _arm("everything"),
    "Chain, mass, springs": replace(
        _CHAIN, target=classic.Chain(mass=1.3, stiffness=1.4)
    ),
    "Chain, all at once": replace(
        _CHAIN, target=classic.Chain(1.2, 1.6, 0.3, 0.3, 0.7, 0.03)
    ),
}


# ---- the experiments

SIMULATOR = "simulator"
RESIDUAL = "residual"
HISTORY = "residual, last action"
LINEAR = "linear model"
CALIBRATED = "calibrated"
GRID = "grid"
# of the estimates on a grid
FLOOR = 1e-3
STRENGTH = 0.01
GRID_SEEDS = 1  # logs of a case that have the rows on a grid, the dearest
LOGS = {
    f"{name}, n = {n}": (name, n) for name, case in CASES.items() for n in case.sizes
}


@functools.lru_cache(maxsize=256)
def known(name: str, delta: float, *, simulator: bool = False) -> Array:
    """Return the returns (episodes,) in the target, or in the simulator."""
    case = CASES[name]
    return case.returns(case.simulator if simulator else case.target, delta)


def _row(case: Change, estimator: str, name: str, found: list[Array]) -> Row:
    """Return values, errors, and how much of an error may be Monte Carlo's."""
    truth = [known(name, delta) for delta in case.deltas]
    apart = [returns - right for returns, right in zip(found, truth, strict=True)]
    before = [
        known(name, delta, simulator=True) - right
        for delta, right in zip(case.deltas, truth, strict=True)
    ]
    error, of_simulator = (
        float(np.mean([abs(x.mean()) for x in each])) for each in (apart, before)
    )
    noise, truth_noise = (
        [x.std() / np.sqrt(x.size) for x in each] for each in (apart, truth)
    )
    row: Row = {
        "estimator": estimator,
        "error": error,
        "share": error / of_simulator if of_simulator > 0 else np.nan,
    }
    row |= {
        "noise": float(np.mean(noise)),
        "truth_standard_error": float(max(truth_noise)),
    }
    for delta, e, x in zip(case.deltas, apart, truth, strict=True):
        row |= {
            f"error_{delta:g}": float(e.mean()),
            f"truth_{delta:g}": float(x.mean()),
        }
    return row


def _grid_returns(
    case: Change, name: str, log: ContinuousTransitions
) -> dict[str, list[Array]]:
    """Compute values with the log's zeta on a grid of the task's features.

    They are raw, and calibrated by the simulator's ratio.
    """
    # States outside and transitions without support are left out here.
    with warnings.catch_warnings(action="ignore"):
        model = discretize(
            case.simulator, log, cells=case.grid, floor=FLOOR, closure_episodes=0
        )
        counts, _ = model.supported(model.counts(log, outside="drop"))
    zeta = transition_ratio(counts, model.mdp, prior="simulator", strength=STRENGTH)
    corrected = zeta.target_model(model.mdp)
    found: dict[str, list[Array]] = {CALIBRATED: [], GRID: []}
    for delta in case.deltas:
        policy = model.policy(case.acting(delta))
        simulated = known(name, delta, simulator=True).mean()
        value, inside = (
            policy_value(mdp, policy, horizon=case.horizon)
            for mdp in (corrected, model.plain)
        )
        found[CALIBRATED].append(np.full(case.episodes, value * simulated / inside))
        found[GRID].append(np.full(case.episodes, case.scale * value))
    return found


def draw(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw what is left of the simulator's error, case by case."""
    (ax,) = panels(
        figure, ["error / the simulator's error, means over the seeds"], size=(8.2, 8.4)
    )
    part = summary[np.isfinite(summary.share_mean)]
    where = {case: k for k, case in enumerate(part.case.unique())}
    shown = {RESIDUAL: "o", HISTORY: "P", CALIBRATED: "s", LINEAR: "^", GRID: "x"}
    for k, (name, mark) in enumerate(shown.items()):
        own = part[part.estimator == name]
        ax.plot(
            np.maximum(own.share_mean, 1e-3),
            own.case.map(where),
            mark,
            color=f"C{k}",
            label=name,
            ms=6,
        )
    ax.axvline(1.0, color="black", lw=1, ls=":")
    ax.set_xscale("log")
    ax.set_yticks(range(len(where)), list(where), fontsize="small")
    ax.invert_yaxis()
    ax.grid(visible=True, alpha=0.3)
    ax.legend(fontsize="small", loc="lower right")


def finding(table: pd.DataFrame) -> str:
    """Write what each estimator leaves of the simulator's error, the least first.

    It is in the median of the cases that all have.
    """
    own = table[table.estimator.isin((RESIDUAL, LINEAR, CALIBRATED, GRID))]
    left = (
        own.pivot_table("share", "case", "estimator")
        .dropna()
        .median()
        .dropna()
        .sort_values()
    )
    if left.empty:
        return ""
    return f"Left of the simulator's error in the median case: {listed(left, percent)}"


@experiment(
    "Changes that nobody tuned for: the simulator corrected by the log's residuals, and"
    " others",
    group="continuous",
    axes={"case": tuple(LOGS)},
    smoke={
        "case": (
            "CartPole, force x 0.8, n = 3000",
            "MountainCar, force x 1.2, n = 20000",
        )
    },
    keys=("case", "estimator"),
    measures=("error", "share", "noise", "hidden", "differs"),
    draw=draw,
    finding=finding,
    requires=("mujoco",),
)
def changes(settings: Cell, stream: Stream) -> list[Row]:
    """Correct a simulator by a log of n transitions with 30% random actions (Reacher:
    half). Errors are means over policies of |value - truth|, values and truths by
    rollouts that share their random numbers; noise: the standard error of what is left.
    Two policies, 200 steps (CartPole: six, 100; Acrobot: 500; Reacher: five). grid:
    zeta on 32 x 32 to 41 x 41 vertices, for the first log; calibrated: times the
    simulator's rollouts / its value on the grid. hidden: share of the logs whose state
    is said not to be Markov.
    """
    name, n = LOGS[str(settings["case"])]
    case = CASES[name]
    log = case.log(n, stream.generator())
    corrected = ResidualSimulator(case.simulator, log, seed=0)
    hidden = any(coordinate.hidden for coordinate in corrected.coordinates)
    tasks: dict[str, ContinuousTask] = {RESIDUAL: corrected}
    if hidden:
        whole = HistoryTask(case.simulator)
        tasks[HISTORY] = ResidualSimulator(whole, whole.log(log), seed=0)
    if not name.startswith("Kinova"):  # 27 coordinates and 27 commands in 1250 moves
        tasks[LINEAR] = LinearModel(case.simulator, log)
    rows = [
        _row(
            case, SIMULATOR, name, [known(name, d, simulator=True) for d in case.deltas]
        )
    ]
    rows += [
        _row(case, what, name, [case.returns(task, d) for d in case.deltas])
        for what, task in tasks.items()
    ]
    if case.grid and int(settings["repetition"]) < GRID_SEEDS:
        rows += [
            _row(case, what, name, found)
            for what, found in _grid_returns(case, name, log).items()
        ]
    differs = any(coordinate.differs for coordinate in corrected.coordinates)
    return [
        {"n": n, **row, "hidden": float(hidden), "differs": float(differs)}
        for row in rows
    ]


POLICIES = {
    "CartPole, gravity 12.5": 0.4,
    "CartPole, all at once": 0.4,
    "Pendulum, mass, gravity": 0.5,
}
N = 20_000  # moves of a log
EPISODES = 1000  # of the value
REFITS = 10
PATHS = 200  # episodes of a refit
TRUTH = 400_000  # episodes


@functools.lru_cache(maxsize=8)
def truth(name: str) -> MonteCarlo:
    """Compute the value of the case's policy in its target."""
    case = CASES[name]
    policy = case.acting(POLICIES[name])
    return monte_carlo_value(
        case.target, policy, TRUTH, case.horizon, discount=DISCOUNT, seed=12
    )


@functools.lru_cache(maxsize=8)
def returns_of_target(name: str) -> tuple[Change, np.ndarray]:
    """Return the case, and returns in its target.

    The corrected simulator shares their random numbers.
    """
    case = replace(CASES[name], episodes=EPISODES, scale=1.0)
    return case, case.returns(case.target, POLICIES[name])


def draw_coverage(table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
    """Draw errors against the standard errors that the log's refits give."""
    names = list(summary.case)
    for ax, name in zip(panels(figure, names, size=(4.2, 3.4)), names, strict=True):
        part = table[table.case == name]
        ax.plot(np.hypot(part.error_of_log, part.noise), np.abs(part.error), "o", ms=3)
        most = float(max(np.hypot(part.error_of_log, part.noise).max(), 1e-12))
        ax.plot(
            [0.0, most],
            [0.0, most * float(stats.t.ppf(0.975, REFITS - 1))],
            "k:",
            lw=1,
        )
        ax.set_xlabel("standard error told")
        ax.set_ylabel("|error|")


def find_coverage(table: pd.DataFrame) -> str:
    """Write in what share of the logs of each case the interval covers the truth.

    It also says how often without the rollouts' noise.
    """
    held = table.groupby("case")[["covered", "covered_paired"]].mean()
    whole, paired = (reach(held[name], percent) for name in held)
    return (
        f"The 95% interval holds the truth in {whole} of the logs; without the"
        f" rollouts' noise, drawn here, in {paired}"
    )


@experiment(
    "How often the interval of the residual row holds the truth",
    group="continuous",
    repetitions=100,
    axes={"case": tuple(POLICIES)},
    smoke={"case": ("CartPole, gravity 12.5",)},
    keys=("case",),
    measures=("covered", "covered_paired", "error", "noise", "error_of_log"),
    draw=draw_coverage,
    finding=find_coverage,
)
def residual_coverage(settings: Cell, stream: Stream) -> list[Row]:
    """Count how often intervals cover, in logs of 20 000 transitions with a policy
    each; values are sums of rewards. covered: share of the logs whose 95% interval (10
    refits by 200 episodes, the value by 1000) covers the truth of 400 000 rollouts.
    covered_paired: the same without the rollouts' noise, by rollouts that share their
    random numbers with the target's: |error| within Student's t times the standard
    error.
    """
    name = str(settings["case"])
    case, there = returns_of_target(name)
    log = case.log(N, stream.generator(use="log"))
    corrected = ResidualSimulator(case.simulator, log, seed=0)
    policy = case.acting(POLICIES[name])
    seed = int(stream.generator(use="value").integers(2**31))
    found = corrected_value(
        corrected,
        policy,
        EPISODES,
        case.horizon,
        discount=DISCOUNT,
        refits=REFITS,
        paths=PATHS,
        seed=seed,
    )
    # There is no interval where the log seems to show hidden state: it does not cover.
    low, high = found.interval or (np.nan, np.nan)
    apart = case.returns(corrected, POLICIES[name]) - there
    error = float(apart.mean())
    noise = float(apart.std() / np.sqrt(apart.size))
    of_log = float(found.diagnostics.get("standard_error_of_the_log", np.nan))
    margin = float(stats.t.ppf(0.975, REFITS - 1))
    known = truth(name)
    return [
        {
            "value": found.value,
            "lower": low,
            "upper": high,
            "truth": known.value,
            "truth_standard_error": known.standard_error,
            "error": error,
            "noise": noise,
            "error_of_log": of_log,
            "covered": float(low <= known.value <= high),
            "covered_paired": float(abs(error) <= margin * np.hypot(of_log, noise)),
        }
    ]
