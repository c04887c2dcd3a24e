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
from oee_tabular.continuous.task import ContinuousTask

ENOUGH = 0.01  # of a step's own deviation: a history that brings less is not kept
LEFT = 0.2  # share of the hidden part that may be left with a history, for its value to be trusted
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
    history : as it was asked for, a number or "auto"
    """

    learned: ResidualSimulator
    steps: int
    fit: ParameterFit | None
    plain: ResidualSimulator
    reason: str
    history: int | Literal["auto"] = "auto"

    @cached_property
    def is_trusted(self) -> bool:
        """Whether no more than a fifth of what is hidden is left."""
        return not self.learned.units and self.learned.hidden_part <= LEFT * self.plain.hidden_part

    @property
    def name(self) -> str:
        """Of its row in a report."""
        parts = ["parameters"] * (self.fit is not None) + ["residual"]
        parts += ["last action" if self.steps == 1 else f"last {self.steps} actions"] * (self.steps > 0)
        return f"oee ({', '.join(parts)})"

    @property
    def whole(self) -> HistoryTask:
        """The task with its last actions in the state, which is corrected."""
        assert isinstance(self.learned.task, HistoryTask)
        return self.learned.task

    @property
    def status(self) -> str:
        """Of the value in the corrected simulator."""
        return "ok" if self.is_trusted else sentences.flaw(self.learned)

    @property
    def plain_status(self) -> str:
        """Of values that take the simulator's own state to be Markov."""
        return sentences.flaw(self.plain)

    @property
    def warning(self) -> str:
        """Why no correction can be trusted; "" where one can."""
        return "" if self.is_trusted else f"No correction can be trusted, because {sentences.flaw(self.learned)}."

    @property
    def advice(self) -> str:
        """What to do where no correction can be trusted."""
        return "" if self.is_trusted or self.learned.units else sentences.advice(self)


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
    if not (isinstance(history, str) and history == "auto"):
        is_zero = isinstance(history, int) and not isinstance(history, bool) and history == 0
        history = 0 if is_zero else _checks.positive_integer(history, "history")
    plain, learned, steps = _with_history(task, log, history, seed)
    reason = sentences.history(plain, learned, steps, history == "auto")
    chosen = Correction(learned, steps, None, plain, reason, history)
    if fit is None:
        return chosen
    unremembered, fitted, n = _with_history(fit.task, log, history, seed)
    is_taken = fitted.held_out_error <= PREFERENCE * learned.held_out_error
    told = sentences.parameters(fit, unremembered, fitted, learned, is_taken)
    if is_taken:
        reason = sentences.history(unremembered, fitted, n, history == "auto")
        chosen = Correction(fitted, n, fit, plain, reason, history)
    return replace(chosen, reason=f"{told} {chosen.reason}".strip())


def _with_history(
    task: ContinuousTask, log: ContinuousTransitions, history: int | str, seed: Seed
) -> tuple[ResidualSimulator, ResidualSimulator, int]:
    """The correction without history, that with the best (or given) one, and how many actions that has."""

    def learn(steps: int) -> ResidualSimulator:
        _progress.report_step(f"correction with {steps} earlier action{'s' * (steps > 1)} in the state")
        whole = HistoryTask(task, steps)
        return ResidualSimulator(whole, whole.log(log), seed=seed)

    _progress.report_step("correction of the simulator by the log")
    plain = ResidualSimulator(task, log, seed=seed)
    if isinstance(history, int):
        return plain, learn(history) if history else plain, history
    hidden = [c.history for c in plain.coordinates if c.hidden]
    if not hidden or plain.units:
        return plain, plain, 0
    first = max(hidden, key=lambda effect: effect.lag_r_squared)
    tried, least = {0: plain}, plain.held_out_error**0.5
    for steps in range(first.lag if first.of == "action" else 1, MAX_LAG + 1):
        tried[steps] = learn(steps)
        before, least = least, min(least, tried[steps].held_out_error ** 0.5)
        if before - tried[steps].held_out_error ** 0.5 < ENOUGH / 3.0:
            break
    steps = next(k for k, learned in tried.items() if learned.held_out_error**0.5 <= least + ENOUGH)
    return plain, tried[steps], steps
