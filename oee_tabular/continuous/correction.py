"""Which correction a log supports: of the simulator's parameters, of its residuals, with how many last actions in the state.

The measure is the held-out one-step error of f + g, mean square over every row of the log in units of the displacement's
variance, summed over coordinates (``Coordinate.unexplained``). Fitted parameters come first where it is no larger with them.
Actions enter the state where earlier ones explain residuals, and as many as bring the error within a hundredth of a step of the
least. Where something hidden remains, no correction of a Markov state can be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from oee_tabular import _checks
from oee_tabular._checks import Seed
from oee_tabular.continuous.coordinate import describe_history
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
        return not self.learned.units and hidden_part(self.learned) <= LEFT * hidden_part(self.plain)

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
        return "ok" if self.is_trusted else describe_flaw(self.learned)

    @property
    def plain_status(self) -> str:
        """Of values that take the simulator's own state to be Markov."""
        return describe_flaw(self.plain)

    @property
    def warning(self) -> str:
        """Why no correction can be trusted; "" where one can."""
        return "" if self.is_trusted else f"No correction can be trusted, because {describe_flaw(self.learned)}."

    @property
    def advice(self) -> str:
        """What to do where no correction can be trusted."""
        if self.is_trusted or self.learned.units:
            return ""
        if self.history != "auto":
            return "Leave the number of last actions in the state open (history auto), which tries up to five."
        share = hidden_part(self.learned) / hidden_part(self.plain)
        tried = f"With the last {self.steps} actions in the state, {share:.0%} of that effect is left."
        if self.steps == 0:
            tried = f"Keeping the last actions in the state, up to {MAX_LAG}, does not help."
        return (
            f"{tried} Sensor noise, a slow actuator, or a quantity that is not recorded may be the cause. Filter the states, "
            "or record what is missing. Until then read the simulator's value, which has no interval."
        )


def describe_flaw(learned: ResidualSimulator) -> str:
    """What is wrong where columns are in other units, or history explains the residuals; "ok" where all is well."""
    if learned.units:
        return f"the log's columns seem to be in another unit than the simulator's: {learned.units}"
    told = describe_history(learned.coordinates)
    return f"the state is not all that the next one depends on (hidden state): {_lower(told[:-1])}" if told else "ok"


def hidden_part(learned: ResidualSimulator) -> float:
    """The largest part of a step, in its deviations, that history explains; 0 where the state is Markov."""
    parts = [c.history.part / c.displacement for c in learned.coordinates if c.hidden]
    return max(parts, default=0.0)


def held_out_error(learned: ResidualSimulator) -> float:
    """Mean square one-step error on held-out episodes, in units of the displacement's variance, summed over coordinates."""
    return sum(c.unexplained for c in learned.coordinates)


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
    candidates = [(None, task)] if fit is None else [(fit, fit.task), (None, task)]
    tried = [(used, *_with_history(base, log, history, seed)) for used, base in candidates]
    plain = tried[-1][1]
    errors = [held_out_error(learned) for _, _, learned, _ in tried]
    k = 0 if len(tried) == 1 or errors[0] <= PREFERENCE * errors[1] else 1
    used, _, learned, steps = tried[k]
    return Correction(learned, steps, used, plain, _explain(fit, tried, errors, k, history), history)


def _with_history(
    task: ContinuousTask, log: ContinuousTransitions, history: int | str, seed: Seed
) -> tuple[ResidualSimulator, ResidualSimulator, int]:
    """The correction without history, that with the best (or given) one, and how many actions that has."""

    def learn(steps: int) -> ResidualSimulator:
        whole = HistoryTask(task, steps)
        return ResidualSimulator(whole, whole.log(log), seed=seed)

    plain = ResidualSimulator(task, log, seed=seed)
    if isinstance(history, int):
        return plain, learn(history) if history else plain, history
    hidden = [c.history for c in plain.coordinates if c.hidden]
    if not hidden or plain.units:
        return plain, plain, 0
    first = max(hidden, key=lambda effect: effect.lag_r_squared)
    tried = {0: plain}
    for steps in range(first.lag if first.of == "action" else 1, MAX_LAG + 1):
        before = min(held_out_error(learned) for learned in tried.values()) ** 0.5
        tried[steps] = learn(steps)
        if before - held_out_error(tried[steps]) ** 0.5 < ENOUGH / 3.0:
            break
    least = min(held_out_error(learned) for learned in tried.values()) ** 0.5
    steps = next(k for k, learned in tried.items() if held_out_error(learned) ** 0.5 <= least + ENOUGH)
    return plain, tried[steps], steps


def _explain(
    fit: ParameterFit | None, tried: list[tuple[Any, ...]], errors: list[float], chosen: int, history: int | str
) -> str:
    """Which correction was taken, and why."""
    _, plain, learned, steps = tried[chosen]
    said = []
    if fit is not None:
        alone, both = (f"{error**0.5:.2g}" for error in reversed(errors))
        said.append(fit.describe())
        said.append(
            f"The value in front corrects the residuals of the {'fitted' if chosen == 0 else 'given'} simulator, because its "
            f"held-out one-step error is {'no larger' if chosen == 0 else 'smaller'} ({both} of a step's standard deviation "
            f"with fitted parameters, {alone} without)."
        )
    if steps:
        actions = "the last action" if steps == 1 else f"the last {steps} actions"
        text = f"The value in front has {actions} in the state"
        if history == "auto":
            text += f", because {_lower(describe_history(plain.coordinates))}"
            text += f" The held-out one-step error falls from {held_out_error(plain) ** 0.5:.2g} to "
            text += f"{held_out_error(learned) ** 0.5:.2g} of a step's standard deviation"
        said.append(f"{text}.")
    return " ".join(said)


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]
