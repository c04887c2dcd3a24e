"""The rows of a report that rest on a discretised task: the finite problem of a continuous simulator and a log, and its ratio.

The simulator is discretised at the log's own places, with the small defensive share of its configuration; the log becomes
numbered transitions and soft counts on the same cells; zeta is fitted to the soft counts. Beside the raw value stands the
calibrated one, by the simulator without the defensive share.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._sparse import row_sums
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import MonteCarlo
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.rows import QUANTILE, refuse_impossible
from oee_tabular.continuous.simulator import ContinuousSimulator, Settings
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimate, Estimator, OffEnvironment, Problem, Simulator, calibrate
from oee_tabular.estimators.base import IN_VALUES_UNIT
from oee_tabular.estimators.findings import Finding, missing_support
from oee_tabular.exact import policy_value
from oee_tabular.ratio import transition_ratio, uncovered_share

MAX_LEFT_OUT = 0.01  # share of the log's transitions without support that the rows on the cells may leave out
CALIBRATED_FAR = "calibration changes the value by {}. Rely on the corrected simulator instead."


class NoCellsError(ValueError):
    """The cells cannot take the log; its text is the sentence that a report says in place of their rows."""


@dataclass(frozen=True, eq=False)
class OnCells:
    """What does not depend on the policies: the simulator on the cells, the problem, its ratio, and facts for the report."""

    model: Discretization
    problem: Problem
    zeta: Any
    support: dict[str, float]
    facts: dict[str, Any]

    def plain(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """The simulator on the cells without its defensive share: exact."""
        return Estimate(policy_value(self.model.plain, policy, horizon=self.problem.horizon))

    def raw(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """Off-environment evaluation on the cells, and how far its ratio has support."""
        found = OffEnvironment(self.zeta)(self.problem, policy, seed=seed)
        told = missing_support(*self.support.values())
        return replace(found, diagnostics=found.diagnostics | self.support, findings=(*found.findings, *told))

    def calibrated(self, simulated: Any, log: ContinuousTransitions, kind: str, scale: float) -> Estimator:
        """The raw value calibrated by ``simulated(policy)``, Monte Carlo's; not beyond what the rewards can sum to."""
        horizon = self.problem.horizon or 0
        bounds = reward_bounds(self.problem, log, horizon)

        @one_thread
        def row(problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
            below = self.plain(problem, policy).value
            found = calibrated_row(self.raw(problem, policy), simulated(policy), below, kind, scale)
            return refuse_impossible(found, *bounds, horizon, scale)

        return row

    def others(self, wanted: Mapping[str, Estimator]) -> dict[str, Estimator]:
        """Of finite estimators by name the rows without calibration; oee's is last."""
        rows: dict[str, Estimator] = {}
        for name, estimator in wanted.items():
            if estimator != OffEnvironment():
                rows[name] = estimator
            if isinstance(estimator, Simulator) and self.model.mdp is not self.model.plain:
                rows["simulator (plain)"] = self.plain
        return rows | ({"oee on the grid": self.raw} if OffEnvironment() in wanted.values() else {})


def calibrated_row(raw: Estimate, outside: MonteCarlo, below: float, kind: str, scale: float) -> Estimate:
    """The raw value times J_continuous / J_discretised of the simulator, or plus their difference, in a row of its own."""
    found = calibrate(
        raw, discretised=below, continuous=outside.value, continuous_error=outside.standard_error, kind=kind
    )
    value, error = (found.diagnostics[f"calibrated_{what}"] for what in ("value", "standard_error"))
    raw_only = IN_VALUES_UNIT | {"row_sum_error", "calibrated_value", "calibrated_standard_error"}
    facts = {name: x for name, x in found.diagnostics.items() if name not in raw_only}
    told = list(found.findings)
    apart, own = abs(raw.value - value), abs(outside.value - below)
    if apart > 1.01 * own + 2.0 * outside.standard_error:  # calibration takes out more than was put in
        figure = f"{apart * scale:.3g}, and the cells change the simulator's own value by {own * scale:.3g} alone"
        told.append(Finding("calibrated far", apart * scale, CALIBRATED_FAR, figure))
    ends = None if found.interval is None or error is None else (value - QUANTILE * error, value + QUANTILE * error)
    return replace(
        found, value=value, standard_error=error, interval=ends, diagnostics=facts | {"interval_method": "calibrated"},
        findings=tuple(told), model_value=None, is_normal=True, is_from_log=True, is_from_episodes=False, is_headline=False,
    )  # fmt: skip


def on_cells(
    simulator: ContinuousSimulator,
    log: ContinuousTransitions,
    settings: Settings,
    horizon: int,
    discount: float,
    seed: Seed,
) -> OnCells:
    """The simulator and the log (whose actions are numbers) on the cells that ``settings.grid`` names.

    Raises
    ------
    NoCellsError
        Too many transitions have no support.
    ValueError
        Settings that do not fit; states outside the cells, where ``settings.outside`` is "error".
    """
    floor = simulator.floor if settings.floor is None else _checks.number_in(settings.floor, "floor", 0.0, 1.0)
    cells = None if settings.grid == "auto" else settings.grid
    model = simulator.discretize(log, cells=cells, floor=floor, discount=discount)
    counts = model.counts(log, outside=settings.outside)
    encoded = model.encode(log, seed=_checks.seed_sequence(seed, (10**6 + 1,)), outside=settings.outside)
    episodes = encoded if encoded.episode is not None else None
    # rewards differ within a cell: they are held against the task's own steps, not against the cells' means
    bag = Transitions(**{name: column for name, column in encoded.columns().items() if name != "reward"})
    kept, share = model.supported(counts)
    if kept.nnz == 0 or (share > MAX_LEFT_OUT and settings.outside != "drop"):
        ways = [] if floor > 0.0 else ["a defensive share (--task-option floor=0.001)"]
        ways += ["a coarser grid (--grid NxM)", "without those transitions (--task-option outside=drop)"]
        more = f", with a defensive share of {floor:g}" if floor > 0.0 else ""
        raise NoCellsError(
            f"the log must stay where the simulator has probability: {share:.2g} of its transitions have none on "
            f"{model.cells.extent()}{more}, and no ratio exists there. Ways out: {', '.join(ways[:-1])}, or {ways[-1]}"
        )
    if share > 0.0:
        most = int((row_sums(counts) - row_sums(kept)).argmax()) // model.task.n_actions
        warnings.warn(
            f"{share:.2g} of the log's transitions have no probability in the simulator on {model.cells.extent()}; the rows on "
            f"the cells leave them out. Most of them begin at state {most}",
            stacklevel=2,
        )
    problem = Problem(model.mdp, bag, horizon=horizon, counts=kept, episodes=episodes)
    tie = model.displacement_ties() if model.task.is_translation_invariant else None
    zeta = transition_ratio(kept, model.mdp, tie=tie, **simulator.ratio)
    largest = float(zeta.values.data.max())
    support = {
        "uncovered_mass": uncovered_share(kept, model.plain),
        "largest_zeta": largest,
        "d_inf": float(np.log(largest)),
    }
    facts: dict[str, object] = {
        "simulator": described(simulator, model, support),
        "log": f"{len(log)} transitions of {log.n_state}-dimensional states; encoded: {encoded.describe()}",
        "grid": model.cells.extent(),
        "floor": floor,
        "ratio": ({} if tie is None else {"tie": "displacements"}) | dict(simulator.ratio),
        "rows_left_out": len(log) - len(encoded),
        "moves_left_out": share,
        "closure_error": model.diagnostics["closure_error"],
        **support,
    }
    return OnCells(model, problem, zeta, support, facts)


def described(simulator: ContinuousSimulator, model: Discretization, support: Mapping[str, float]) -> str:
    """The simulator on cells, in one line of a report."""
    places = "" if model.task.is_translation_invariant else ", looked at in the log's own places"
    text = f"{simulator.name} on {model.cells.extent()}{places}: {model.mdp!r}"
    if floor := model.metadata["floor"]:
        own, others = model.metadata["parameters"], model.metadata["others"]
        differing = [", ".join(f"{k}={v:.3g}" for k, v in other.items() if own.get(k) != v) for other in others]
        other = f"one of {'; '.join(differing)}" if others else "a transition of the log"
        text += f"; defensive: with probability {floor:g} a step is {other} (plain: without)"
    error, noise = (model.diagnostics[f"closure_{what}"] for what in ("error", "standard_error"))
    return text + (
        f"; closure error of the uniform policy {error:+.1%} (+-{noise:.1%}); uncovered mass {support['uncovered_mass']:.2g}, "
        f"largest zeta {support['largest_zeta']:.3g} (D_inf {support['d_inf']:.2g} nats)"
    )


def name_loss(
    model: Discretization, simulate: Callable[[Array], MonteCarlo], tables: Mapping[str, Array], horizon: int
) -> str:
    """By how much the cells change the simulator's own values, which no interval counts."""
    values = {name: simulate(table).value for name, table in tables.items()}
    changes = ", ".join(
        f"{policy_value(model.plain, tables[name], horizon=horizon) - value:+.3g} of {value:.3g} ({name})"
        for name, value in values.items()
    )
    return (
        "standard errors and intervals count the log's noise and not the error of the cells. The cells change the simulator's "
        f"own value by {changes}, and may change another environment's by more"
    )


def add_features(text: str, model: Discretization) -> str:
    """A warning with the features of the states that it numbers."""
    n, names = model.cells.n_cells, model.task.feature_names

    def place(match: re.Match[str]) -> str:
        number = int(match[1])
        points = model.points[model.places.point_cell == number] if number < n else model.points[:0]
        if len(points) == 0:
            return match[0]
        at = model.task.features(points).mean(axis=0)
        return f"{match[0]} ({', '.join(f'{name}={value:.3g}' for name, value in zip(names, at, strict=True))})"

    return re.sub(r"\bstate (\d+)", place, text)


def reward_bounds(problem: Problem, log: ContinuousTransitions, horizon: int) -> tuple[float, float]:
    """The least and the most that ``horizon`` discounted rewards sum to: the log's, the simulator's, and 0 after an end."""
    model = problem.simulator
    paid = [model.rewards.min(), model.rewards.max()]
    if log.reward is not None:
        paid += [log.reward.min(), log.reward.max()]
    if log.terminated.any() or model.absorbing().any():
        paid.append(0.0)
    number = float(np.sum(model.discount ** np.arange(horizon)))
    return float(min(paid)) * number, float(max(paid)) * number
