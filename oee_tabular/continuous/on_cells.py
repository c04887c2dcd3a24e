"""A continuous simulator and a log on cells: the finite problem, its ratio, and the rows that rest on them.

The simulator is discretised at the log's own places, with the small defensive share of its configuration, whose reach the log
sets; the log becomes numbered moves and soft counts on the same cells; zeta is fitted to the soft counts. Beside the raw value
stands the calibrated one, by the simulator without the defensive share.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._sparse import row_sums
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.estimators import Calibrated, MonteCarloValue, Plain, Possible, Supported
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.sentences import described, left_out
from oee_tabular.continuous.simulator import ContinuousSimulator, Settings
from oee_tabular.continuous.support import within_support
from oee_tabular.continuous.task import StatePolicy
from oee_tabular.data import Transitions
from oee_tabular.estimators import Estimator, OffEnvironment, Problem
from oee_tabular.exact import policy_value
from oee_tabular.mdp import check_policy
from oee_tabular.ratio import transition_ratio, uncovered_share

LEFT_OUT = 0.01  # share of the log's moves without support that the rows on the cells may leave out
LONGEST = 100_000  # moves of the simulator's own log, by which the second calibration is


class NoCellsError(ValueError):
    """The cells cannot take the log; its text is the sentence that a report says in place of their rows."""


@dataclass(frozen=True, eq=False)
class OnCells:
    """What does not depend on the policies.

    Attributes
    ----------
    model, plain : the simulator on the cells, with the defensive share and without
    problem : of the model and the encoded log
    support : diagnostics of the ratio's support
    zeta : the ratio
    facts : for the report
    simulator, log : what it was made of
    settings : as given
    seed : of the simulator's own log
    """

    model: Discretization
    plain: Discretization
    problem: Problem
    support: dict[str, float]
    zeta: Any
    facts: dict[str, Any]
    simulator: ContinuousSimulator
    log: ContinuousTransitions
    settings: Settings
    seed: Any

    def raw(self) -> Estimator:
        """Off-environment evaluation on the cells."""
        return Supported(OffEnvironment(self.zeta), self.support)

    def calibrated(self, mc: MonteCarloValue, kind: str, bounds: tuple[float, float], scale: float) -> Estimator:
        """The same, calibrated by the plain simulator; refused beyond ``bounds``."""
        horizon = self.problem.horizon
        by = Calibrated(
            self.raw(),
            mc,
            lambda policy: policy_value(self.plain.mdp, policy, horizon=horizon),
            self._own(mc),
            kind,
            scale,
        )
        return Possible(by, *bounds, scale)

    def _own(self, mc: MonteCarloValue) -> Callable[[Array], float] | None:
        """Policy -> its value on the cells at a log of the simulator's own, recorded as the target's was."""
        if not self.simulator.at_log or self.simulator.cells_of_log:
            return None
        found: list[Discretization] = []

        def value(policy: Array) -> float:
            if not found:
                found.append(self._at_own_log())
            table = as_table(mc.functions[np.asarray(policy).tobytes()], found[0], "of the second calibration")
            return policy_value(found[0].mdp, table, horizon=self.problem.horizon)

        return value

    def _at_own_log(self) -> Discretization:
        tried = row_sums(self.problem.counts).reshape(self.problem.simulator.n_states, -1)
        tried = np.where(tried.sum(axis=1, keepdims=True) > 0, tried, 1.0)
        behavior = as_function(tried / tried.sum(axis=1, keepdims=True), self.model)
        own = record(
            self.simulator.task,
            behavior,
            n_transitions=min(len(self.log), LONGEST),
            max_steps=self.simulator.horizon,
            seed=self.seed,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # those of the log's places were told
            discount = self.problem.simulator.discount
            return self.simulator.build(grid=self.settings.grid, at=own, discount=discount)


def on_cells(
    simulator: ContinuousSimulator,
    log: ContinuousTransitions,
    settings: Settings,
    horizon: int,
    discount: float,
    seed: Seed,
) -> OnCells:
    """The simulator and the log (whose actions are numbers) on the cells.

    Raises
    ------
    NoCellsError
        There is no grid in the task's dimensions, or too many moves have no support.
    ValueError
        Settings that do not fit; states outside the grid, where ``settings.outside`` is "error".
    """
    if not simulator.has_cells(settings.grid):
        raise NoCellsError(simulator.no_cells(settings.grid))
    floor = simulator.floor if settings.floor is None else _checks.number_in(settings.floor, "floor", 0.0, 1.0)
    options: dict[str, Any] = {"grid": settings.grid, "at": log, "discount": discount}
    reach = simulator.reach(settings.grid, log)
    model = simulator.build(**options, floor=floor, reach=reach)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a grid that is too coarse was warned about
        plain = model if floor == 0.0 else simulator.build(**options, floor=0.0)
    counts = simulator.counts(model, log, outside=settings.outside)
    encoded = model.encode_log(log, seed=_checks.seed_sequence(seed, (10**6 + 1,)), outside=settings.outside)
    episodes = encoded if encoded.episode is not None else None
    # rewards differ within a cell: they are held against the task's own steps, not against the cells' means
    bag = Transitions(**{name: column for name, column in encoded.columns().items() if name != "reward"})
    share = uncovered_share(counts, model.mdp)
    if share > LEFT_OUT and settings.outside != "drop":
        raise NoCellsError(no_support(model, share, floor))
    if share > 0.0:
        kept, _ = within_support(counts, model)
        if kept.nnz == 0:
            raise NoCellsError(f"none of the log's moves has probability in the simulator on {model.cells.extent()}")
        warnings.warn(left_out(counts, kept, share, model), stacklevel=2)
        counts = kept
    problem = Problem(model.mdp, bag, horizon=horizon, counts=counts, episodes=episodes)
    zeta = transition_ratio(counts, model.mdp, **simulator.ratio_options(model))
    largest = float(zeta.values.data.max())
    support = {
        "uncovered_mass": uncovered_share(counts, plain.mdp),
        "largest_zeta": largest,
        "d_inf": float(np.log(largest)),
    }
    facts: dict[str, object] = {
        "simulator": described(simulator, model, floor, support),
        "log": f"{len(log)} transitions of {log.n_state}-dimensional states; encoded: {encoded.describe()}",
        "grid": model.cells.extent(),
        "floor": floor,
        "reach": reach,
        "ratio": ({} if simulator.tie is None else {"tie": "displacements"}) | dict(simulator.ratio),
        "rows_left_out": len(log) - len(encoded),
        "moves_left_out": share,
        **support,
    }
    closure = model.diagnostics.get("closure")
    if closure is not None:
        facts["closure_error"] = float(closure.error)
    own_seed = _checks.seed_sequence(seed, (10**6 + 3,))
    return OnCells(model, plain, problem, support, zeta, facts, simulator, log, settings, own_seed)


def no_support(model: Discretization, share: float, floor: float) -> str:
    """Why the cells cannot take the log, and the ways out that are not in force."""
    more = f", with a defensive share of {floor:g}" if floor > 0.0 else ""
    ways = [] if floor > 0.0 else ["a defensive share (--task-option floor=0.001)"]
    ways += ["a coarser grid (--task-option grid=NxM)", "without those moves (--task-option outside=drop)"]
    return (
        f"the log must stay where the simulator has probability: {share:.2g} of its moves have none on "
        f"{model.cells.extent()}{more}, and no ratio exists there. Ways out: {', '.join(ways[:-1])}, or {ways[-1]}"
    )


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


def as_table(policy: StatePolicy | Array, model: Discretization, name: str) -> Array:
    """(S, A) a policy on the cells; an array may leave out the state that is over."""
    if callable(policy):
        return check_policy(model.policy(policy), model.mdp, name=f"policy {name!r}")
    table = _checks.float_array(policy, f"policy {name!r}", ndim=(2,))
    if model.over is not None and table.shape == (model.cells.n_cells, model.task.n_actions):
        table = np.concatenate([table, np.full((1, model.task.n_actions), 1.0 / model.task.n_actions)])
    return check_policy(table, model.mdp, name=f"policy {name!r}")


def as_function(policy: StatePolicy | Array, model: Discretization) -> StatePolicy:
    """A policy of states: of an array, the mean over the cells that a state is shared out to."""
    if callable(policy):
        return policy
    table = np.asarray(policy, dtype=np.float64)[: model.cells.n_cells]

    def interpolated(states: Array) -> Array:
        found = model.cells.weights(model.task.features(states)) @ table
        return np.asarray(found / found.sum(axis=1, keepdims=True))

    return interpolated


def plain_rows(made: OnCells) -> Mapping[str, Estimator]:
    """The simulator on the cells without its defensive share, where it has one."""
    return {} if made.plain is made.model else {"simulator (plain)": Plain(made.plain.mdp)}
