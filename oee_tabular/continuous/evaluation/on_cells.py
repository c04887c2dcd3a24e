"""Rows of a report by a finite problem: a simulator and a log on cells.

The simulator is discretised at the log's own places, with the small defensive share of
its configuration; the log becomes numbered transitions and soft counts on the same
cells; zeta is fitted to the soft counts. Beside the raw value stands the calibrated
one, by the simulator without the defensive share.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._sparse import row_sums
from oee_tabular.continuous.discretization.build import CellsLike
from oee_tabular.continuous.discretization.cells import Grid
from oee_tabular.continuous.evaluation.rollouts import QUANTILE, refuse_impossible
from oee_tabular.continuous.evaluation.simulator import (
    ContinuousSimulator,
    Settings,
)
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.episodes import (
    MonteCarlo,
)
from oee_tabular.data import Transitions
from oee_tabular.estimators import (
    Estimate,
    Estimator,
    OffEnvironment,
    Problem,
    Simulator,
    calibrate,
)
from oee_tabular.estimators.diagnostics import Diagnostics
from oee_tabular.estimators.findings import Finding, missing_support
from oee_tabular.exact import policy_value
from oee_tabular.exceptions import DiscretizationWarning, NoCellsError
from oee_tabular.ratio import uncovered_share
from oee_tabular.shrinkage import transition_ratio
from oee_tabular.typing import Array, Seed

# The rows on the cells leave out up to this share of the log's transitions, those
# without support.
MAX_SHARE_LEFT_OUT = 0.01
CALIBRATED_FAR = (
    "calibration changes the value by {}. Rely on the corrected simulator instead."
)


class OnCells:
    """A simulator and a log on cells, and the ratio between the two.

    It is what does not depend on the policies.

    Parameters
    ----------
    simulator : ContinuousSimulator
        The simulator.
    log : ContinuousTransitions
        The log, whose actions are numbers.
    settings : Settings
        Where the cells lie (``grid``), and what is done with what lies outside of them.
    horizon : int
        The number of rewards.
    discount : float
        Gamma, in [0, 1].
    seed : int, Generator or SeedSequence, optional
        The source of the numbers that the log's states get.

    Attributes
    ----------
    model : Discretization
        The simulator on the cells.
    problem : Problem
        The log on the cells.
    facts : dict
        What the report says of them.

    Raises
    ------
    NoCellsError
        If too many transitions have no support.
    ValueError
        If the settings do not fit, or states lie outside the cells and
        ``settings.outside`` is "error".
    """

    def __init__(
        self,
        simulator: ContinuousSimulator,
        log: ContinuousTransitions,
        settings: Settings,
        horizon: int,
        discount: float,
        seed: Seed,
    ) -> None:
        floor = simulator.floor
        if settings.floor is not None:
            floor = _checks.number_in(settings.floor, "floor", 0.0, 1.0)
        cells: CellsLike | None = None
        if not isinstance(settings.grid, str):
            cells = settings.grid
        else:
            _checks.one_of(settings.grid, "grid", ("auto",), " (or cells)")
        self.model = model = simulator.discretize(
            log, cells=cells, floor=floor, discount=discount
        )
        counts = model.counts(log, outside=settings.outside)
        where = model.cells.extent()
        stream = _checks.seed_sequence(seed, (10**6 + 1,))
        encoded = model.encode(log, seed=stream, outside=settings.outside)
        # rewards differ within a cell: they are held against the task's own steps, not
        # against the cells' means
        columns = encoded.columns()
        columns.pop("reward", None)
        bag = Transitions(**columns)
        kept, share = model.supported(counts)
        if kept.nnz == 0 or (share > MAX_SHARE_LEFT_OUT and settings.outside != "drop"):
            raise NoCellsError(_describe_unsupported(share, where, floor))
        if share > 0.0:
            lost = row_sums(counts) - row_sums(kept)
            most = int(lost.argmax()) // model.task.n_actions
            _checks.warn(
                f"{share:.2g} of the log's transitions have no probability in the"
                f" simulator on {where}; the rows on the cells leave them out. Most of"
                f" them begin at state {most}",
                DiscretizationWarning,
            )
        episodes = encoded if encoded.episode is not None else None
        self.problem = Problem(
            model.mdp, bag, horizon=horizon, counts=kept, episodes=episodes
        )
        is_tied = model.task.is_translation_invariant and isinstance(model.cells, Grid)
        tie = model.displacement_ties() if is_tied else None
        self._zeta = transition_ratio(kept, model.mdp, tie=tie, **simulator.ratio)
        largest = float(self._zeta.values.data.max())
        self._support = {
            "uncovered_mass": uncovered_share(kept, model.plain),
            "largest_zeta": largest,
            "d_inf": float(np.log(largest)),
        }
        ratio = dict(simulator.ratio)
        if tie is not None:
            ratio = {"tie": "displacements"} | ratio
        self.facts: dict[str, Any] = {
            "simulator": self._describe(simulator.name),
            "log": (
                f"{len(log)} transitions of {log.n_state}-dimensional states; encoded:"
                f" {encoded.describe()}"
            ),
            "grid": where,
            "floor": floor,
            "ratio": ratio,
            "rows_left_out": len(log) - len(encoded),
            "moves_left_out": share,
            "closure_error": model.diagnostics["closure_error"],
            **self._support,
        }
        self._bounds = self._find_bounds(log, horizon, discount)

    def _find_bounds(
        self, log: ContinuousTransitions, horizon: int, discount: float
    ) -> tuple[float, float]:
        """Return what the rewards of the cells and of the log can sum to."""
        mdp = self.model.mdp
        rewards = [mdp.rewards.min(), mdp.rewards.max()]
        if log.reward is not None:
            rewards += [log.reward.min(), log.reward.max()]
        # after an end all rewards are 0
        if log.terminated.any() or mdp.absorbing().any():
            rewards.append(0.0)
        number = float(np.sum(discount ** np.arange(horizon)))
        return float(min(rewards)) * number, float(max(rewards)) * number

    def _describe(self, name: str) -> str:
        """Describe the simulator on cells in one line of a report."""
        model = self.model
        support = self._support
        places = ", looked at in the log's own places"
        if model.task.is_translation_invariant:
            places = ""
        text = f"{name} on {model.cells.extent()}{places}: {model.mdp!r}"
        if floor := model.metadata["floor"]:
            own = model.metadata["parameters"]
            others = model.metadata["others"]
            differing = []
            for parameters in others:
                changes = [(k, v) for k, v in parameters.items() if own.get(k) != v]
                differing.append(", ".join(f"{k}={v:.3g}" for k, v in changes))
            other = "a transition of the log"
            if others:
                other = f"one of {'; '.join(differing)}"
            text += (
                f"; defensive: with probability {floor:g} a step is {other} (plain:"
                " without)"
            )
        error = model.diagnostics["closure_error"]
        noise = model.diagnostics["closure_standard_error"]
        return (
            text
            + f"; closure error of the uniform policy {error:+.1%} (+-{noise:.1%});"
            f" uncovered mass {support['uncovered_mass']:.2g}, largest zeta"
            f" {support['largest_zeta']:.3g} (D_inf {support['d_inf']:.2g} nats)"
        )

    def plain(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """Compute the exact value in the simulator on the cells without a floor."""
        return Estimate(
            policy_value(self.model.plain, policy, horizon=self.problem.horizon)
        )

    def raw(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """Compute the off-environment value on the cells, and its ratio's support."""
        found = OffEnvironment(self._zeta)(self.problem, policy, seed=seed)
        missing = missing_support(*self._support.values())
        return replace(
            found,
            diagnostics=found.diagnostics | self._support,
            findings=(*found.findings, *missing),
        )

    def calibrated(
        self,
        simulate: Callable[[Array], MonteCarlo],
        kind: Literal["ratio", "difference"],
        scale: float,
    ) -> Estimator:
        """Return the estimator of the raw value, calibrated by ``simulate(policy)``.

        Its values do not lie beyond what the rewards can sum to.
        """

        def row(problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
            """Estimate the calibrated value of a policy."""
            below = self.plain(problem, policy).value
            found = calibrated_row(
                self.raw(problem, policy), simulate(policy), below, kind, scale
            )
            return refuse_impossible(
                found, *self._bounds, self.problem.horizon or 0, scale
            )

        return row

    def others(self, wanted: Mapping[str, Estimator]) -> dict[str, Estimator]:
        """Return the rows of finite estimators without calibration; oee's is last."""
        rows: dict[str, Estimator] = {}
        for name, estimator in wanted.items():
            if estimator != OffEnvironment():
                rows[name] = estimator
            has_floor = self.model.mdp is not self.model.plain
            if isinstance(estimator, Simulator) and has_floor:
                rows["simulator (plain)"] = self.plain
        if OffEnvironment() in wanted.values():
            rows["oee on the grid"] = self.raw
        return rows

    def describe_loss(
        self, simulate: Callable[[Array], MonteCarlo], tables: Mapping[str, Array]
    ) -> str:
        """Describe by how much the cells change the simulator's own values.

        No interval counts that.
        """
        parts = []
        for name, table in tables.items():
            value = simulate(table).value
            change = self.plain(self.problem, table).value - value
            parts.append(f"{change:+.3g} of {value:.3g} ({name})")
        changes = ", ".join(parts)
        return (
            "standard errors and intervals count the log's noise and not the error of"
            f" the cells. The cells change the simulator's own value by {changes}, and"
            " may change another environment's by more"
        )

    def add_features(self, text: str) -> str:
        """Return a warning with the features of the states that it numbers."""
        model = self.model

        def place(match: re.Match[str]) -> str:
            """Return the matched state with the mean features of its cell."""
            points = model.points[model.places.point_cell == int(match[1])]
            if len(points) == 0:  # no point stands for the terminal state
                return match[0]
            means = model.task.features(points).mean(axis=0)
            pairs = zip(model.task.feature_names, means, strict=True)
            features = ", ".join(f"{name}={value:.3g}" for name, value in pairs)
            return f"{match[0]} ({features})"

        return re.sub(r"\bstate (\d+)", place, text)


def calibrated_row(
    raw: Estimate,
    outside: MonteCarlo,
    below: float,
    kind: Literal["ratio", "difference"],
    scale: float,
) -> Estimate:
    """Return the raw value calibrated by the simulator's value, as a row of its own.

    It is multiplied by J_continuous / J_discretised of the simulator, or their
    difference is added.
    """
    found = calibrate(
        raw,
        discretised=below,
        continuous=outside.value,
        continuous_error=outside.standard_error,
        kind=kind,
    )
    value = found.diagnostics["calibrated_value"]
    error = found.diagnostics["calibrated_standard_error"]
    # values of the raw row are not those of this one, nor are its row sums
    facts = {
        name: x
        for name, x in found.diagnostics.items()
        if Diagnostics.unit_of(name) != "value" and name != "row_sum_error"
    }
    findings = list(found.findings)
    apart = abs(raw.value - value)
    own = abs(outside.value - below)
    # calibration then changes more than the cells did
    if apart > 1.01 * own + 2.0 * outside.standard_error:
        figure = (
            f"{apart * scale:.3g}, and the cells change the simulator's own value by"
            f" {own * scale:.3g} alone"
        )
        finding = Finding("calibrated far", apart * scale, CALIBRATED_FAR, figure)
        findings.append(finding)
    ends = None
    if found.interval is not None and error is not None:
        ends = (value - QUANTILE * error, value + QUANTILE * error)
    return replace(
        found,
        value=value,
        standard_error=error,
        interval=ends,
        diagnostics=facts | {"interval_method": "calibrated"},
        findings=tuple(findings),
        model_value=None,
        is_normal=True,
        is_from_log=True,
        is_from_episodes=False,
        is_headline=False,
    )


def _describe_unsupported(share: float, where: str, floor: float) -> str:
    """Describe a log of which too much is impossible on the cells, and ways out."""
    ways = [
        "a coarser grid (--grid NxM)",
        "without those transitions (--task-option outside=drop)",
    ]
    more = ""
    if floor > 0.0:
        more = f", with a defensive share of {floor:g}"
    else:
        ways.insert(0, "a defensive share (--task-option floor=0.001)")
    return (
        f"the log must stay where the simulator has probability: {share:.2g} of its"
        f" transitions have none on {where}{more}, and no ratio exists there. Ways out:"
        f" {', '.join(ways[:-1])}, or {ways[-1]}"
    )
