"""The first step of an evaluation: the log, the policies and the cells, checked."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular.continuous.evaluation.on_cells import OnCells
from oee_tabular.continuous.evaluation.policies import as_probabilities
from oee_tabular.continuous.evaluation.simulator import ContinuousSimulator, Settings
from oee_tabular.continuous.log.numbering import (
    describe_shares,
    number_log,
    share_commands,
)
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import ContinuousTask, StatePolicy
from oee_tabular.estimators.rewards import is_rounded
from oee_tabular.exceptions import (
    ArgumentError,
    DataWarning,
    DiscretizationWarning,
    NoCellsError,
)
from oee_tabular.typing import Array, SeedNumbers


@dataclass(frozen=True, eq=False)
class Prepared:
    """What an evaluation is made of, checked.

    Attributes
    ----------
    simulator : ContinuousSimulator
        The simulator.
    log : ContinuousTransitions
        The log, with the numbers of the task's actions.
    given_log : ContinuousTransitions
        The log as it was given.
    commanded_log : ContinuousTransitions
        What corrections are made of: the log as it was given where its commands lie
        between the task's actions, and otherwise the numbered one.
    settings : Settings
        The settings.
    horizon : int
        The number of rewards.
    discount : float
        Gamma, in [0, 1].
    seed : int or sequence of int or None
        The seed of all random numbers.
    policies : mapping from str to function
        The policies, as functions of states that give probabilities.
    cells : OnCells or None
        The simulator and the log on cells, where the rows on cells are asked for and
        the cells fit the log.
    tables : mapping from str to ndarray
        The policies on the cells; empty without.
    messages : tuple of str
        What is to be said of the log and the policies.
    """

    simulator: ContinuousSimulator
    log: ContinuousTransitions
    given_log: ContinuousTransitions
    commanded_log: ContinuousTransitions
    settings: Settings
    horizon: int
    discount: float
    seed: SeedNumbers
    policies: Mapping[str, StatePolicy]
    cells: OnCells | None
    tables: Mapping[str, Array]
    messages: tuple[str, ...]

    @property
    def episodes(self) -> int:
        """Return the number of Monte Carlo episodes of each value."""
        own = self.settings.episodes
        return self.simulator.episodes if own is None else own


def prepare(
    simulator: ContinuousSimulator,
    log: ContinuousTransitions,
    policies: Mapping[str, StatePolicy | Array],
    settings: Settings,
    *,
    behavior: StatePolicy | None,
    horizon: int,
    discount: float,
    seed: SeedNumbers,
) -> Prepared:
    """Number the log, make the cells if they are asked for, and check the policies.

    What warns here is kept for the report as well.
    """
    cells = None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        numbered = number_log(
            simulator.task, log, strict=settings.strict, behavior=behavior
        )
        shares = share_commands(simulator.task, log)
        if shares is not None:
            # not that commands are moved, which the correction does not do
            caught.clear()
            has_cells = settings.grid is not None
            message = describe_shares(simulator.task, shares, has_cells=has_cells)
            _checks.warn(message, DataWarning)
        if settings.grid is not None:
            try:
                cells = OnCells(simulator, numbered, settings, horizon, discount, seed)
            except NoCellsError as reason:
                _checks.warn(
                    f"The rows on the grid are left out: {reason}",
                    DiscretizationWarning,
                )
    of_user = [w for w in caught if issubclass(w.category, UserWarning)]
    categories = {str(w.message): w.category for w in of_user}
    messages = list(categories)
    for message, category in categories.items():
        _checks.warn(message, category)
    functions, tables = _check_policies(policies, simulator.task, cells)
    about_rewards = _describe_rewards(simulator.task, numbered)
    if about_rewards:
        messages.append(about_rewards)
    return Prepared(
        simulator,
        numbered,
        log,
        numbered if shares is None else log,
        settings,
        horizon,
        discount,
        seed,
        functions,
        cells,
        tables,
        tuple(messages),
    )


def _check_policies(
    policies: Mapping[str, StatePolicy | Array],
    task: ContinuousTask,
    cells: OnCells | None,
) -> tuple[dict[str, StatePolicy], dict[str, Array]]:
    """Return the policies as functions of states, and on the cells if there are any."""
    tables: dict[str, Array] = {}
    functions: dict[str, StatePolicy] = {}
    for name, policy in policies.items():
        if callable(policy):
            functions[name] = as_probabilities(policy, task.actions)
        elif cells is None:
            raise ArgumentError(
                f"policy {name!r}",
                "must be a function of states: there are no cells to be an array on",
            )
        if cells is not None:
            given = functions.get(name, policy)
            tables[name] = cells.model.policy(given, f"policy {name!r}")
            functions.setdefault(name, cells.model.policy_function(tables[name]))
    return functions, tables


def _describe_rewards(task: ContinuousTask, log: ContinuousTransitions) -> str:
    """Describe where the log's rewards are not the task's r(s, a, s').

    Returns "" where they are, or where either is unknown.
    """
    known = task.reward_between(log.state, log.action, log.next_state)
    if log.reward is None or known is None:
        return ""
    distance = np.abs(log.reward - known)
    bad = np.flatnonzero(distance > 1e-6 * float(np.abs(known).max()))
    if bad.size == 0:
        return ""
    k = int(distance.argmax())
    verb = "are rounded from" if is_rounded(log.reward, known) else "contradict"
    return (
        f"The log's rewards {verb} the simulator's r(s, a, s') in {bad.size} of"
        f" {len(log)} transitions. The reward of row {k} is {log.reward[k]:.9g} in the"
        f" log and {known[k]:.9g} in the simulator. The simulator's rewards are used"
    )
