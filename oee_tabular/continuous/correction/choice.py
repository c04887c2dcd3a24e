"""The choice among corrections of a simulator, by their error on held-out episodes.

The error is that of one step f + g, mean square over every row of the log in units of
the displacement's variance, summed over coordinates (``Coordinate.unexplained``).
Fitted parameters come first where it is at most 5% larger with them. Actions enter the
state where earlier ones explain residuals, and as many as bring the error within a
hundredth of a step of the least. Where something hidden remains, no correction of a
Markov state can be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

from oee_tabular import _progress
from oee_tabular.continuous.correction.hidden_state import (
    MAX_LAG,
    hidden_state,
)
from oee_tabular.continuous.correction.history import (
    HistoryTask,
    check_n_actions,
)
from oee_tabular.continuous.correction.parameters import ParameterFit
from oee_tabular.continuous.correction.residual import ResidualSimulator
from oee_tabular.continuous.correction.sentences import (
    HIDDEN,
    describe_count,
    describe_flaw,
    describe_history,
    describe_starts,
    remedy,
)
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
)
from oee_tabular.typing import Seed

MIN_GAIN = 0.01  # of a step's own deviation: a history that brings less is not kept
# share of the hidden part that may be left with a history, for its value to be trusted
MAX_HIDDEN_LEFT = 0.2
# of the mean square errors with and without fitted parameters, up to which they are taken
MAX_ERROR_RATIO = 1.05


@dataclass(frozen=True, eq=False)
class Correction:
    """A simulator corrected by a log, and what was compared.

    Attributes
    ----------
    learned : ResidualSimulator
        The corrected simulator, of a ``HistoryTask`` where ``steps`` is positive.
    steps : int
        The number of last actions in its state.
    fit : ParameterFit or None
        The fit of the parameters, where it was taken.
    plain : ResidualSimulator
        The correction of the simulator as it was given, without history.
    reason : str
        Sentences on what was taken and why.
    """

    learned: ResidualSimulator
    steps: int
    fit: ParameterFit | None
    plain: ResidualSimulator
    reason: str

    @cached_property
    def is_trusted(self) -> bool:
        """Return whether at most a fifth of what is hidden is left."""
        return (
            not self.learned.units
            # of the simulator as it was given: with a history, the actions before an
            # episode are not known, and its first rows may fit less well for that
            and not self.plain.odd_starts.any()
            and self.learned.hidden_part <= MAX_HIDDEN_LEFT * self.plain.hidden_part
        )

    @cached_property
    def has_odd_starts(self) -> bool:
        """Return whether first rows of episodes do not fit the others."""
        return any(each.odd_starts.any() for each in (self.plain, self.learned))

    @property
    def name(self) -> str:
        """Return the name of its row in a report."""
        parts = ["residual"]
        if self.fit is not None:
            parts.insert(0, "parameters")
        if self.steps > 0:
            parts.append(f"last {describe_count(self.steps)}")
        return f"oee ({', '.join(parts)})"

    @property
    def status(self) -> str:
        """Return "ok", or why the corrected simulator's value cannot be trusted."""
        if self.is_trusted:
            return "ok"
        # what a history explains of false first rows is no reason to believe it
        return describe_starts(self.plain) or describe_flaw(self.learned)

    @property
    def doubt(self) -> tuple[str, str]:
        """Return why no value can be trusted, and a sentence of what shows it.

        The sentence is "" where the reason says it all; both are where all is well.
        """
        if self.is_trusted:
            return "", ""
        if self.learned.units or self.has_odd_starts:
            return self.status, ""
        effect = hidden_state(self.learned)
        return HIDDEN, f"{effect[0].upper()}{effect[1:]}."

    def policy(self, policy: StatePolicy) -> StatePolicy:
        """Return a policy of the simulator's states as one of the corrected states."""
        if isinstance(self.learned.task, HistoryTask) and self.steps:
            return self.learned.task.policy(policy)
        return policy

    def advice(self, *, is_auto: bool) -> str:
        """Advise what to do where history matters and no correction can be trusted.

        Returns "" elsewhere.
        """
        if self.is_trusted or self.learned.units:
            return ""
        if self.has_odd_starts:
            return (
                "The states of these rows may be those before a reset, or a motor may"
                " start late. Record the state in which an episode begins, or leave its"
                " first row out."
            )
        if not is_auto and self.steps <= MAX_LAG:
            return (
                f"Use history auto, which tries up to {MAX_LAG} last actions in the"
                " state."
            )
        text = f"Keeping the last actions in the state, up to {MAX_LAG}, does not help."
        if self.steps:
            text = (
                f"A correction that keeps the last {describe_count(self.steps)} in the"
                " state removes too little of this."
            )
        return f"{text} {remedy(self.learned, self.steps)}"


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
    task : ContinuousTask
        The simulator.
    log : ContinuousTransitions
        A log of the target.
    history : int or 'auto', default 'auto'
        The number of last actions in the state; 'auto' chooses among 0 to 5.
    fit : ParameterFit, optional
        A fit of the simulator's parameters, which is compared with none.
    seed : int, Generator or SeedSequence, optional
        The source of random numbers, as in ``ResidualSimulator``.

    Returns
    -------
    Correction
        The correction.
    """
    is_auto = isinstance(history, str) and history == "auto"
    given: Any = history
    if not is_auto:
        history = check_n_actions(given, "history")
    _progress.report_step("correction of the simulator by the log")
    plain = ResidualSimulator(task, log, seed=seed)

    def correct(base: ResidualSimulator, fit: ParameterFit | None) -> Correction:
        """Correct ``base`` with as much history as is asked for."""
        learned, steps = _add_history(base, log, history, seed)
        return Correction(
            learned, steps, fit, plain, describe_history(base, learned, steps, is_auto)
        )

    chosen = correct(plain, None)
    if fit is None:
        return chosen
    fitted = ResidualSimulator(fit.task, log, seed=seed)
    both = correct(fitted, fit)
    errors = [each.learned.held_out_error for each in (both, chosen)]
    is_taken = errors[0] <= MAX_ERROR_RATIO * errors[1]
    words = ("given", "clearly smaller")
    if is_taken:
        words = ("fitted", "not clearly larger")
    text = (
        f"{fit.describe()} The value in front corrects the residuals of the {words[0]}"
        f" simulator, because its held-out one-step error is {words[1]}"
        f" ({errors[0] ** 0.5:.2g} of a step's standard deviation with fitted"
        f" parameters, {errors[1] ** 0.5:.2g} without)."
    )
    if hidden_state(fitted):
        text += (
            " The fit ignores history, which matters here. Do not read its numbers as"
            " physics."
        )
    chosen = both if is_taken else chosen
    return replace(chosen, reason=f"{text} {chosen.reason}".strip())


def _add_history(
    plain: ResidualSimulator,
    log: ContinuousTransitions,
    history: int | Literal["auto"],
    seed: Seed,
) -> tuple[ResidualSimulator, int]:
    """Return the correction with the best, or the given, number of last actions."""

    def learn(steps: int) -> ResidualSimulator:
        """Correct the task with ``steps`` last actions in its state."""
        actions = "action" if steps == 1 else "actions"
        _progress.report_step(f"correction with {steps} earlier {actions} in the state")
        whole = HistoryTask(plain.task, steps)
        return ResidualSimulator(whole, whole.log(log), seed=seed)

    if history != "auto":
        return learn(history) if history else plain, history
    hidden = [c.history for c in plain.coordinates if c.hidden]
    if not hidden or plain.units or plain.odd_starts.any():
        return plain, 0
    first = max(hidden, key=lambda effect: effect.lag_r_squared)
    tried = {0: plain}
    for steps in range(first.lag if first.of == "action" else 1, MAX_LAG + 1):
        tried[steps] = learn(steps)
        *before, last = (each.held_out_error**0.5 for each in tried.values())
        if min(before) - last < MIN_GAIN / 3.0:
            break
    most = min(each.held_out_error for each in tried.values()) ** 0.5 + MIN_GAIN
    return next(
        (each, k) for k, each in tried.items() if each.held_out_error**0.5 <= most
    )
