"""What a log says of one coordinate of the next state: how the target differs there, and whether it is Markov."""

from __future__ import annotations

from dataclasses import dataclass

SURE = 3.0  # standard errors of what g explains: the target differs
HIDDEN = 0.05  # share of what is left over that history tells: the state is not all that decides
TRIFLE = 0.01  # the same share of the whole residual: a smooth rest of g is no hidden state
ALIKE = 0.05  # share by which two scatters that are the same may differ


@dataclass(frozen=True)
class Coordinate:
    """What was learned of one coordinate of the next state (or of the reward).

    Attributes
    ----------
    name : the coordinate's
    kind, per_action : the class of functions that g is of, and whether each action has its own coefficients
    simulator_scatter, residual_scatter : root mean squares, of the simulator's own step about f and of s' - f(s, a) in the log
    left_over : root mean square of s' - f(s, a) - g(s, a)
    explained : share of the residual's mean square that g explains on episodes that it was not fitted to
    surely : how many standard errors that share is from 0
    scatter : "none" | "simulator" | "log", where the noise about f + g is taken from
    told_by_history : share of what is left over that the action and the left-over before explain
    """

    name: str
    kind: str
    per_action: bool
    simulator_scatter: float
    residual_scatter: float
    left_over: float
    explained: float
    surely: float
    scatter: str
    told_by_history: float

    @property
    def differs(self) -> bool:
        """Whether the target's step differs from the simulator's: g is surely not zero, or the scatter is another."""
        alike = abs(self.left_over - self.simulator_scatter) <= ALIKE * self.simulator_scatter
        return self.surely > SURE or (self.scatter == "log" and not alike)

    @property
    def hidden(self) -> bool:
        """Whether something that is not in the state decides: told by history, and no trifle of the whole residual."""
        told = (
            self.told_by_history * (self.left_over / self.residual_scatter) ** 2 if self.residual_scatter > 0 else 0.0
        )
        return self.told_by_history > HIDDEN and told > TRIFLE
