"""What a log says of one coordinate of the next state: how the target differs there, and whether it is Markov."""

from __future__ import annotations

from dataclasses import dataclass

from oee_tabular.continuous.history import HistoryEffect

SURE = 3.0  # standard errors of what g explains: the target differs
HIDDEN = 0.1  # share of what is left over that history explains: the state is not all that decides
TRIFLE = 0.03  # of a step's own deviation: less is no hidden state to speak of
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
    displacement : standard deviation of s' - s in the log (of the reward)
    explained : share of the residual's mean square, of every row, that g explains on episodes that it was not fitted to
    t_statistic : how many standard errors that share is from 0
    scatter : "none" | "simulator" | "log", where the noise about f + g is taken from
    history : what earlier actions and residuals explain of what is left over
    """

    name: str
    kind: str
    per_action: bool
    simulator_scatter: float
    residual_scatter: float
    left_over: float
    displacement: float
    explained: float
    t_statistic: float
    scatter: str
    history: HistoryEffect

    @property
    def differs(self) -> bool:
        """Whether the target's step differs from the simulator's: g is surely not zero, or the scatter is another."""
        alike = abs(self.left_over - self.simulator_scatter) <= ALIKE * self.simulator_scatter
        return self.t_statistic > SURE or (self.scatter == "log" and not alike)

    @property
    def unexplained(self) -> float:
        """Held-out mean square error of f + g, in units of the displacement's variance."""
        if self.displacement == 0.0:
            return 0.0
        return (1.0 - self.explained) * (self.residual_scatter / self.displacement) ** 2

    @property
    def hidden(self) -> bool:
        """Whether something that is not in the state decides: history explains what is left over, and that is no trifle."""
        return self.history.r_squared > HIDDEN and self.history.part > TRIFLE * self.displacement
