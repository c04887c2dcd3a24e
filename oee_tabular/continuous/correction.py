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
from oee_tabular.continuous.history import MAX_LAG, HistoryTask
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.parameters import ParameterFit
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import ContinuousTask, StatePolicy

MIN_GAIN = 0.01  # of a step's own deviation: a history that brings less is not kept
MAX_HIDDEN_LEFT = 0.2  # share of the hidden part that may be left with a history, for its value to be trusted
PREFERENCE = 1.05  # how much larger the error with fitted parameters may be


NUMBERS = ("", "one step", "two steps", "three steps", "four steps", "five steps")
UNITS = "the log's columns seem to be in another unit than the simulator's: "


def hidden_state(learned: ResidualSimulator) -> str:
    """Which earlier action or residual matters, and by how much; "" where the state is Markov."""
    hidden = sorted((c for c in learned.coordinates if c.hidden), key=lambda c: -c.history.lag_r_squared)
    if not hidden:
        return ""
    effect = hidden[0].history
    same = [c.name for c in hidden if (c.history.lag, c.history.of) == (effect.lag, effect.of)]
    text = f"the {effect.of} of {NUMBERS[effect.lag]} ago explains {effect.lag_r_squared:.0%} of the residual in "
    text += " and ".join([", ".join(same[:-1]), same[-1]] if len(same) > 1 else same)
    more = f" (the last {NUMBERS[MAX_LAG].split()[0]} actions and residuals together: {effect.r_squared:.0%})"
    return text + more * (effect.r_squared > effect.lag_r_squared + 0.05)


def describe_flaw(learned: ResidualSimulator) -> str:
    """What is wrong where columns are in other units, or history explains the residuals; "ok" where all is well."""
    if learned.units:
        return f"{UNITS}{learned.units}"
    effect = hidden_state(learned)
    return f"the next state depends on more than the state and the action (hidden state): {effect}" if effect else "ok"


def difference(corrected: ResidualSimulator) -> str:
    """In which coordinates the log's residuals show that the target differs from the simulator."""
    changes = ", ".join(
        f"{c.name} (residuals {c.residual_scatter:.2g}, simulator's scatter {c.simulator_scatter:.2g}, "
        f"{max(c.explained, 0.0):.1%} explained)"
        for c in corrected.coordinates
        if c.differs
    )
    if not changes:
        return (
            "The log shows no difference between the target's steps and the simulator's. Its residuals s' - f(s, a) are as "
            "large as the simulator's own scatter."
        )
    text = f"The target's steps differ from the simulator's in {changes}."
    if corrected.units:
        return f"{UNITS.capitalize()}{corrected.units}. {text}"
    return (
        f"{text} Explained is the share of the residuals' mean square that the correction removes.{odd_row(corrected)}"
    )


def odd_row(corrected: ResidualSimulator) -> str:
    """The row that alone makes most of the unexplained residual of a coordinate, perhaps by an error; "" where none does."""
    for k, c in enumerate(corrected.coordinates):
        squares = corrected.left_over[:, k] ** 2
        row, total = int(squares.argmax()), float(squares.sum())
        if squares[row] > 0.5 * total and c.left_over**2 > 0.01 * c.residual_scatter**2:
            return (
                f" Row {row} of the log alone makes {squares[row] / total:.0%} of the unexplained residual in {c.name} (by "
                f"{corrected.left_over[row, k]:.3g}). If it is an error, leave it out, because every value depends on it."
            )
    return ""


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
        return "ok" if self.is_trusted else describe_flaw(self.learned)

    def policy(self, policy: StatePolicy) -> StatePolicy:
        """A policy of the simulator's states as one of the corrected simulator's."""
        return self.learned.task.policy(policy) if isinstance(self.learned.task, HistoryTask) and self.steps else policy

    def advice(self, *, is_auto: bool) -> str:
        """What to do where history explains residuals and no correction can be trusted; "" elsewhere."""
        if self.is_trusted or self.learned.units:
            return ""
        if not is_auto:
            return "Use history auto, which tries up to five last actions in the state."
        share = self.learned.hidden_part / self.plain.hidden_part
        text = f"With the last {self.steps} actions in the state, {share:.0%} of that effect is left."
        if self.steps == 0:
            text = f"Keeping the last actions in the state, up to {MAX_LAG}, does not help."
        return (
            f"{text} Sensor noise, a slow actuator, or a quantity that is not recorded may be the cause. Filter the states, "
            "or record what is missing. Until then read the simulator's value, which has no interval."
        )


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
    chosen = Correction(learned, steps, None, plain, describe_history(plain, learned, steps, is_auto))
    if fit is None:
        return chosen
    fitted = ResidualSimulator(fit.task, log, seed=seed)
    learned, steps = _add_history(fitted, log, history, seed)
    is_taken = learned.held_out_error <= PREFERENCE * chosen.learned.held_out_error
    text = _describe_fit(fit, fitted, learned, chosen.learned, is_taken)
    if is_taken:
        chosen = Correction(learned, steps, fit, plain, describe_history(fitted, learned, steps, is_auto))
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


def _describe_fit(
    fit: ParameterFit, plain: ResidualSimulator, fitted: ResidualSimulator, unfitted: ResidualSimulator, is_taken: bool
) -> str:
    """What was fitted, whether the value in front has it, and where a fit without history (``plain``) is no physics."""
    caution = " The fit ignores history, which matters here. Do not read its numbers as physics."
    both, alone = (f"{learned.held_out_error**0.5:.2g}" for learned in (fitted, unfitted))
    return (
        f"{fit.describe()} The value in front corrects the residuals of the {'fitted' if is_taken else 'given'} simulator, "
        f"because its held-out one-step error is {'no larger' if is_taken else 'smaller'} ({both} of a step's standard "
        f"deviation with fitted parameters, {alone} without).{caution if hidden_state(plain) else ''}"
    )


def describe_history(plain: ResidualSimulator, learned: ResidualSimulator, steps: int, is_auto: bool) -> str:
    """How many last actions are in the state, and why; "" where none are."""
    if not steps:
        return ""
    text = f"The value in front has the last {'action' if steps == 1 else f'{steps} actions'} in the state"
    if not is_auto:
        return f"{text}." if describe_flaw(learned) == "ok" else ""
    before, after = (f"{each.held_out_error**0.5:.2g}" for each in (plain, learned))
    text += f", because {hidden_state(plain)}. The held-out one-step error falls from {before} to {after} of a step's "
    text += "standard deviation."
    return text + f" At most {MAX_LAG} are tried; history {MAX_LAG + 3} keeps more." * (steps == MAX_LAG)
