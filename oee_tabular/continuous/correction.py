"""Which correction a log supports: of the simulator's parameters, of its residuals, with how many last actions in the state.

The measure is the held-out one-step error of f + g, mean square over every row of the log in units of the displacement's
variance, summed over coordinates (``Coordinate.unexplained``). Fitted parameters come first where it is no larger with them.
Actions enter the state where earlier ones explain residuals, and as many as bring the error within a hundredth of a step of the
least. Where something hidden remains, no correction of a Markov state can be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from oee_tabular import _checks, _progress
from oee_tabular._checks import Seed
from oee_tabular.continuous import sentences
from oee_tabular.continuous.history import MAX_LAG, HistoryTask
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.parameters import ParameterFit
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import ContinuousTask, StatePolicy

MIN_GAIN = 0.01  # of a step's own deviation: a history that brings less is not kept
MAX_HIDDEN_LEFT = 0.2  # share of the hidden part that may be left with a history, for its value to be trusted
PREFERENCE = 1.05  # how much larger the error with fitted parameters may be


@dataclass(frozen=True, eq=False)
class Correction:
    """A simulator corrected by a log, and what was compared.

    Attributes
    ----------
    learned : ResidualSimulator, of a ``HistoryTask`` where ``steps`` is positive
    steps : last actions in its state
    fit : of the parameters, where it was taken
    plain : the ResidualSimulator of the simulator as it was given, without history
    reason : sentences on what was taken and why
    """

    learned: ResidualSimulator
    steps: int
    fit: ParameterFit | None
    plain: ResidualSimulator
    reason: str

    @cached_property
    def is_trusted(self) -> bool:
        """Whether no more than a fifth of what is hidden is left."""
        return not self.learned.units and self.learned.hidden_part <= MAX_HIDDEN_LEFT * self.plain.hidden_part

    @property
    def name(self) -> str:
        """Of its row in a report."""
        parts = ["parameters"] * (self.fit is not None) + ["residual"]
        parts += ["last action" if self.steps == 1 else f"last {self.steps} actions"] * (self.steps > 0)
        return f"oee ({', '.join(parts)})"

    @property
    def status(self) -> str:
        """Of the value in the corrected simulator: "ok", or why it cannot be trusted."""
        return "ok" if self.is_trusted else sentences.describe_flaw(self.learned)

    def policy(self, policy: StatePolicy) -> StatePolicy:
        """A policy of the simulator's states as one of the corrected simulator's."""
        return self.learned.task.policy(policy) if isinstance(self.learned.task, HistoryTask) and self.steps else policy


def choose_correction(
    task: ContinuousTask,
    log: ContinuousTransitions,
    *,
    history: int | Literal["auto"] = "auto",
    fit: ParameterFit | None = None,
    seed: Seed = None,
) -> Correction:
    """Correct the simulator by the log in the way that has the least held-out error.

    Parameters
    ----------
    task : ContinuousTask, the simulator
    log : ContinuousTransitions of the target
    history : last actions in the state; "auto" chooses among 0 to 5
    fit : of the simulator's parameters, to be compared with none
    seed : as in ``ResidualSimulator``
    """
    is_auto = isinstance(history, str) and history == "auto"
    if not is_auto and not (isinstance(history, int) and history == 0 and history is not False):
        history = _checks.positive_integer(history, "history")
    _progress.report_step("correction of the simulator by the log")
    plain = ResidualSimulator(task, log, seed=seed)
    learned, steps = _add_history(plain, log, history, seed)
    chosen = Correction(learned, steps, None, plain, sentences.history(plain, learned, steps, is_auto))
    if fit is None:
        return chosen
    fitted = ResidualSimulator(fit.task, log, seed=seed)
    learned, steps = _add_history(fitted, log, history, seed)
    is_taken = learned.held_out_error <= PREFERENCE * chosen.learned.held_out_error
    text = sentences.parameters(fit, fitted, learned, chosen.learned, is_taken)
    if is_taken:
        chosen = Correction(learned, steps, fit, plain, sentences.history(fitted, learned, steps, is_auto))
    return replace(chosen, reason=f"{text} {chosen.reason}".strip())


def _add_history(
    plain: ResidualSimulator, log: ContinuousTransitions, history: int | str, seed: Seed
) -> tuple[ResidualSimulator, int]:
    """The correction with the best number of last actions in the state, or the one that is asked for."""

    def learn(steps: int) -> ResidualSimulator:
        _progress.report_step(f"correction with {steps} earlier action{'s' * (steps > 1)} in the state")
        whole = HistoryTask(plain.task, steps)
        return ResidualSimulator(whole, whole.log(log), seed=seed) if steps else plain

    if isinstance(history, int):
        return learn(history), history
    hidden = [c.history for c in plain.coordinates if c.hidden]
    if not hidden or plain.units:
        return plain, 0
    first = max(hidden, key=lambda effect: effect.lag_r_squared)
    tried, errors = {0: plain}, [plain.held_out_error**0.5]
    for steps in range(first.lag if first.of == "action" else 1, MAX_LAG + 1):
        tried[steps] = learn(steps)
        errors.append(tried[steps].held_out_error ** 0.5)
        if min(errors[:-1]) - errors[-1] < MIN_GAIN / 3.0:
            break
    steps = next(k for k, error in zip(tried, errors, strict=True) if error <= min(errors) + MIN_GAIN)
    return tried[steps], steps
