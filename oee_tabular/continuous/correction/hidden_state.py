"""A test of whether earlier actions matter, which the state would have to include.

Where steps are delayed, or an actuator has a memory, s' depends on more than (s, a).
What a correction g leaves over is then predicted by the actions and the residuals of
earlier steps, y_t by a_{t-1}, ..., a_{t-5} and y_{t-1}, ..., y_{t-5}. Independent
residuals cannot carry that, and every value that takes the state to be Markov is wrong.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from oee_tabular import _printing
from oee_tabular.continuous.correction.neighbors import Neighbors
from oee_tabular.continuous.log.transitions import (
    ContinuousTransitions,
)
from oee_tabular.continuous.task.base import (
    ContinuousTask,
)
from oee_tabular.typing import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from oee_tabular.continuous.correction.residual import ResidualSimulator
from oee_tabular.continuous.correction.history import earlier_rows

# what of an earlier step matters
Kind: TypeAlias = Literal["action", "residual"]
Block: TypeAlias = tuple[int, Kind]  # how many steps back, and what of them
FOLDS = 4
MAX_LAG = 5  # steps back that the test looks at, and that a report tries in the state
# rows by which the test is made; slow tasks step one state at a time
MIN_ROWS = 200
MAX_ROWS = 20_000
MAX_SLOW_ROWS = 3000
N_NEIGHBORS = 4  # whose mean residual is what (s, a) itself explains
NUMBERS = ("", "one step", "two steps", "three steps", "four steps", "five steps")
MAX_CLIPPED = 8.0  # root mean squares: what rows at contacts count at most
# What is explained must be so many standard errors over rows from 0, which fewer than
# 16 rows cannot make it.
MIN_STANDARD_ERRORS = 4.0


@dataclass(frozen=True)
class HistoryEffect:
    """What earlier actions and residuals explain of one coordinate's residual.

    Attributes
    ----------
    r_squared : float
        The share that all of the last five explain of the mean square that the present
        state and action leave, on episodes to which the regression was not fitted.
    lag : int
        How many steps back the action or residual lies that alone explains most.
    of : {'action', 'residual'}
        Which of the two it is.
    lag_r_squared : float
        The share of this mean square that it explains alone.
    part : float
        The root mean square of what they explain, in the coordinate's unit. Rows far
        from the others count with at most ``MAX_CLIPPED`` root mean squares.
    """

    r_squared: float = 0.0
    lag: int = 1
    of: Kind = "action"
    lag_r_squared: float = 0.0
    part: float = 0.0


def history_effects(
    task: ContinuousTask,
    log: ContinuousTransitions,
    actions: IntArray,
    residuals: Array,
    group: IntArray,
    *,
    is_smooth: BoolArray,
    is_free: BoolArray,
    least: Array,
    shares: Array | None = None,
) -> list[HistoryEffect]:
    """Compute what history explains of each coordinate's residual.

    What the action's own mean and the residuals near by explain is taken off first.
    Linear regressions on the last five actions, the steps that the simulator makes
    under them, and the last five residuals are fitted on smooth rows (no contacts), and
    on the actions alone at all free rows (no stops), because a delay of a command that
    rarely changes is a rare large residual too. Commands between the task's actions
    count by their ``shares`` (n, A) of them, as small changes of a command that stays
    next to one action show a delay as well. There is no effect where fewer than 200
    rows follow another, or where what is explained is below ``least`` (k,) among the
    rows that were looked at: a few odd rows do not make it larger.
    """
    earlier = earlier_rows(log, MAX_LAG)
    rows = np.flatnonzero((earlier[:, 0] >= 0) & is_free)
    rows = rows[: MAX_ROWS if task.steps_at_once else MAX_SLOW_ROWS]
    best = [HistoryEffect()] * residuals.shape[1]
    if len(rows) < MIN_ROWS:
        return best
    taken = np.eye(task.n_actions)[actions] if shares is None else shares
    # the last code stands for no action, as row -1 stands for no row
    codes = np.vstack([taken, np.zeros(task.n_actions)])
    acted = _actions_then(task, log, actions, rows, earlier[rows], codes)
    for is_usable, has_residuals in ((is_smooth, True), (is_free, False)):
        is_used = is_usable[rows]
        used = rows[is_used]
        if len(used) < MIN_ROWS:
            continue
        y, unit = _scale(residuals, is_usable)
        blocks = _stack_blocks(
            [block[is_used] for block in acted], y, earlier[used], has_residuals
        )
        near = _mean_near(task, log.state, actions, y, is_usable, group)[used]
        present = np.column_stack([codes[used], near])
        found = _explain(present, blocks, y[used], group[used] % FOLDS, unit, least)
        best = _take_larger(best, found)
    return best


def _scale(residuals: Array, is_usable: BoolArray) -> tuple[Array, Array]:
    """Return residuals in units of their size, clipped, and the units (k,).

    Rows that are not usable have 0.
    """
    unit = np.sqrt((residuals[is_usable] ** 2).mean(axis=0))
    scaled = residuals / np.where(unit > 0, unit, 1.0)
    return np.clip(scaled, -MAX_CLIPPED, MAX_CLIPPED) * is_usable[:, None], unit


def _take_larger(
    best: list[HistoryEffect], found: list[HistoryEffect]
) -> list[HistoryEffect]:
    """Return the effect of each coordinate that explains more."""
    return [
        new if new.r_squared > old.r_squared else old
        for old, new in zip(best, found, strict=True)
    ]


def _stack_blocks(
    acted: list[Array], y: Array, earlier: IntArray, has_residuals: bool
) -> dict[Block, Array]:
    """Return what each earlier step may explain by: its action, and its residual."""
    blocks: dict[Block, Array] = {}
    for k, block in enumerate(acted, start=1):
        blocks[k, "action"] = block
    if has_residuals:
        padded = np.vstack([y, np.zeros(y.shape[1])])  # -1 is no row
        for k, back in enumerate(earlier.T, start=1):
            blocks[k, "residual"] = padded[back]
    return blocks


def _actions_then(
    task: ContinuousTask,
    log: ContinuousTransitions,
    actions: IntArray,
    rows: IntArray,
    earlier: IntArray,
    codes: Array,
) -> list[Array]:
    """Return the inputs of regressions for each of the earlier steps.

    They are which action was taken then, and where the simulator would go under it now,
    beside where it goes.
    """
    states = log.state[rows]
    own = task.noiseless_step(states, actions[rows]).next_state
    inputs = []
    for back in earlier.T:
        then = np.where(back >= 0, actions[back], actions[rows])
        other = task.noiseless_step(states, then).next_state - own
        scale = other.std(axis=0)
        inputs.append(
            np.column_stack([codes[back], other[:, scale > 0] / scale[scale > 0]])
        )
    return inputs


def _explain(
    present: Array,
    blocks: dict[Block, Array],
    target: Array,
    fold: IntArray,
    unit: Array,
    least: Array,
) -> list[HistoryEffect]:
    """Return what the blocks of history explain of each target (n, k).

    ``present`` are the inputs without history; ``unit`` (k,) is the targets' unit, and
    effects that are unsure, or of at most ``least`` (k,), are none.
    """
    plain = _errors_held_out([present], target, fold)
    total = np.where(plain.any(axis=0), plain.sum(axis=0), np.inf)
    gained = plain - _errors_held_out([present, *blocks.values()], target, fold)

    def share_alone(block: Array) -> Array:
        """Return the share of each target's squares that one block explains, (k,)."""
        alone = _errors_held_out([present, block], target, fold)
        return np.asarray((plain - alone).sum(axis=0) / total)

    shares = {key: share_alone(block) for key, block in blocks.items()}
    whole = gained.sum(axis=0) / total
    n_deviations = MIN_STANDARD_ERRORS * len(target) ** 0.5
    is_sure = gained.sum(axis=0) > n_deviations * gained.std(axis=0)
    # of the squares that history takes away, not of all: the present may explain most
    parts = unit * np.sqrt(np.maximum(gained.mean(axis=0), 0.0))
    is_large = parts > least
    effects = [HistoryEffect()] * len(whole)
    for number in np.flatnonzero(is_sure & is_large & (whole > 0)):
        k = int(number)
        (lag, kind), share = max(shares.items(), key=lambda item: item[1][k])
        effects[k] = HistoryEffect(
            float(whole[k]), lag, kind, float(share[k]), float(parts[k])
        )
    return effects


def hidden_state(learned: ResidualSimulator) -> str:
    """Describe which earlier action or residual matters most to a correction.

    Returns "" where the state is Markov.
    """
    hidden = [c for c in learned.coordinates if c.hidden]
    # coordinates that are equal to rounding stay in the task's order
    hidden.sort(key=lambda c: -round(c.history.lag_r_squared, 6))
    if not hidden:
        return ""
    effect = hidden[0].history
    key = (effect.lag, effect.of)
    same = [f"“{c.name}”" for c in hidden if (c.history.lag, c.history.of) == key]
    text = (
        f"the {effect.of} of {NUMBERS[effect.lag]} ago explains"
        f" {effect.lag_r_squared:.0%} of the residual in {_printing.listing(same)} (a"
        " residual is what a step of the simulator leaves unexplained"
    )
    if effect.r_squared > effect.lag_r_squared + 0.05:
        text += (
            f"; the last {NUMBERS[MAX_LAG].split()[0]} actions and residuals together"
            f" explain {effect.r_squared:.0%}"
        )
    return f"{text})"


def _mean_near(
    task: ContinuousTask,
    states: Array,
    actions: IntArray,
    y: Array,
    is_usable: BoolArray,
    group: IntArray,
) -> Array:
    """Compute the mean (n, k) of the nearest rows of the same action in other folds.

    It is what (s, a) explains, however rough.
    """
    neighbors = Neighbors(task, states)
    mean = np.zeros_like(y)
    fold = group % FOLDS
    for a, f in itertools.product(np.unique(actions), range(FOLDS)):
        here = np.flatnonzero((actions == a) & (fold == f))
        there = np.flatnonzero((actions == a) & (fold != f) & is_usable)
        if len(here) and len(there) >= N_NEIGHBORS:
            near = neighbors.find(states[here], there, N_NEIGHBORS, key=(a, f))
            mean[here] = y[near].mean(axis=1)
    return mean


def _errors_held_out(inputs: list[Array], y: Array, fold: IntArray) -> Array:
    """Compute squared errors (n, k) of a linear regression on held-out folds."""
    x = np.column_stack(inputs)
    errors = np.empty_like(y)
    for f in range(FOLDS):
        inside = fold == f
        outside = fold != f
        gram = x[outside].T @ x[outside]
        gram[np.diag_indices_from(gram)] += 1e-6 * max(int(outside.sum()), 1)
        coefficients = np.linalg.solve(gram, x[outside].T @ y[outside])
        errors[inside] = (y[inside] - x[inside] @ coefficients) ** 2
    return errors
