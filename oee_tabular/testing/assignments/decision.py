"""Assignment 8: a gain with its standard error, and whether to deploy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from statistics import NormalDist
from typing import Any

import numpy as np

from oee_tabular.exact import occupancy, state_values
from oee_tabular.testing.assignments.drawing import (
    Parts,
    draw_counts,
    draw_parts,
    draw_policy,
    draw_rows,
)
from oee_tabular.testing.assignments.judging import Arguments, Kind, Mistake, Task
from oee_tabular.typing import Array

Z = NormalDist().inv_cdf(0.975)
CHOICES = ("deploy", "keep", "record")


def _draw_gain(
    rng: np.random.Generator,
    *,
    discount: float | None = None,
    n_states: int | None = None,
    n_actions: int | None = None,
    has_zeros: bool = False,
    is_certain: bool = False,
    is_unequal: bool = False,
    is_same: bool = False,
) -> Arguments:
    parts = draw_parts(rng, discount=discount, n_states=n_states, n_actions=n_actions)
    target = draw_rows(rng, parts.P.shape, has_zeros=has_zeros)
    n = rng.integers(5, 40, size=parts.r.shape)
    if is_unequal:
        n[0], n[-1] = 3, 10_000
    counts = draw_counts(rng, n, target)
    running = draw_policy(rng, parts.r.shape, is_certain=is_certain)
    candidate = draw_policy(rng, parts.r.shape, is_certain=is_certain)
    return {
        "counts": counts,
        "r": parts.r,
        "mu": parts.mu,
        "discount": parts.discount,
        "running": running,
        "candidate": running.copy() if is_same else candidate,
    }


GAIN_KINDS = (
    Kind("", _draw_gain),
    Kind(
        "the log has zeros",
        partial(_draw_gain, has_zeros=True),
        "a transition that was never recorded has the frequency 0.",
    ),
    Kind(
        "both policies take one action in each state",
        partial(_draw_gain, is_certain=True),
        "probabilities of a policy may be 0 and 1; the formula holds as it is.",
    ),
    Kind(
        "the two policies are the same",
        partial(_draw_gain, is_same=True),
        "of one policy against itself the gain and its error are 0.",
    ),
    Kind(
        "the discount is 0.99",
        partial(_draw_gain, discount=0.99),
        "with a discount near 1 rewards count for hundreds of steps. Solve the linear"
        " system, or iterate until nothing changes any more.",
    ),
    Kind(
        "pairs have three transitions, and others 10 000",
        partial(_draw_gain, is_unequal=True),
        "each pair's variance is divided by its own count.",
    ),
    Kind(
        "there are more actions than states",
        partial(_draw_gain, n_states=2, n_actions=4),
        "the first axis counts states and the second one actions; take no number of"
        " the one for the other.",
    ),
    Kind(
        "there is one state",
        partial(_draw_gain, n_states=1, n_actions=3),
        "with one state every transition is certain, and the error is 0.",
    ),
)


def _slopes(
    counts: Array, r: Array, mu: Array, discount: float, policy: Array
) -> tuple[float, Array, Array]:
    """Return J in the frequencies, its slopes d V' by (s, a, s'), and the rows."""
    P = counts / counts.sum(axis=-1, keepdims=True)
    mdp = Parts(P, r, mu, discount).mdp
    V, d = state_values(mdp, policy), occupancy(mdp, policy)
    slopes = discount / (1.0 - discount) * np.asarray(d)[:, :, None] * V
    return float(mu @ V), slopes, P


def _deviation(slopes: Array, P: Array, n: Array) -> float:
    """Return the standard error of a function of the frequencies with these slopes."""
    mean = (P * slopes).sum(axis=-1, keepdims=True)
    variance = (P * (slopes - mean) ** 2).sum(axis=-1)
    return float(np.sqrt((variance / n).sum()))


def _gain(
    counts: Array,
    r: Array,
    mu: Array,
    discount: float,
    running: Array,
    candidate: Array,
) -> Array:
    old, old_slopes, P = _slopes(counts, r, mu, discount, running)
    new, new_slopes, _ = _slopes(counts, r, mu, discount, candidate)
    n = counts.sum(axis=-1)
    return np.array([new - old, _deviation(new_slopes - old_slopes, P, n)])


def _gain_by(error: Callable[..., float], sign: float = 1.0) -> Callable[..., Array]:
    """Return the gain with another standard error."""

    def wrong(
        counts: Array,
        r: Array,
        mu: Array,
        discount: float,
        running: Array,
        candidate: Array,
    ) -> Array:
        old, old_slopes, P = _slopes(counts, r, mu, discount, running)
        new, new_slopes, _ = _slopes(counts, r, mu, discount, candidate)
        n = counts.sum(axis=-1)
        return np.array([sign * (new - old), error(old_slopes, new_slopes, P, n)])

    return wrong


def _both(a: Array, b: Array, P: Array, n: Array) -> float:
    return _deviation(b - a, P, n)


GAIN = Task(
    name="8_gain",
    call="gain_and_error(counts, r, mu, discount, running, candidate)",
    kinds=GAIN_KINDS,
    solve=_gain,
    hint="with the frequencies P, the gain is J(candidate) - J(running). Its slope in"
    " P(s' | s, a) is discount / (1 - discount) times d(s, a) V(s') of the candidate less"
    " that of the running policy; the squared error is the sum over pairs of the slope's"
    " variance over s' by the row's count.",
    mistakes=(
        Mistake(
            _gain_by(_both, -1.0),
            "the gain is the candidate's value less the running one's.",
        ),
        Mistake(
            _gain_by(
                lambda a, b, P, n: np.hypot(_deviation(a, P, n), _deviation(b, P, n))
            ),
            "the two values come from one log and their errors are not independent;"
            " subtract the slopes, and take the variance then.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _deviation(a, P, n) + _deviation(b, P, n)),
            "the two errors add up only at worst; subtract the slopes, and take the"
            " variance then.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: abs(_deviation(b, P, n) - _deviation(a, P, n))),
            "standard errors are not subtracted; subtract the slopes.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _deviation(b, P, n)),
            "this is the error of the candidate's value alone.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _both(a, b, P, n) ** 2),
            "this is the variance; the standard error is its root.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _deviation(b - a, P, n / n)),
            "divide each row's variance by its count.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _deviation(b - a, P, n * 0 + n.sum())),
            "divide each row's variance by its own count, and not by the whole log's.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _both(a, b, P, n) * 1.96),
            "this is half the width of an interval; the standard error is asked for.",
        ),
        Mistake(
            _gain_by(
                lambda a, b, P, n: np.sqrt(((P * (b - a) ** 2).sum(axis=-1) / n).sum())
            ),
            "this is the mean square of the slopes; subtract the square of their mean"
            " in each row.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: 0.0),
            "the gain is an estimate; its standard error is not 0.",
        ),
        Mistake(
            _gain_by(
                lambda a, b, P, n: np.sqrt(
                    abs(_deviation(b, P, n) ** 2 - _deviation(a, P, n) ** 2)
                )
            ),
            "variances are not subtracted; subtract the slopes, and take the variance"
            " then.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _both(a, b, P, n) / np.sqrt(n.size)),
            "sum over all pairs, and take no mean over them.",
        ),
        Mistake(
            lambda *arguments: _gain(*arguments)[::-1],
            "the gain comes first and its error second.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _deviation(a, P, n)),
            "this is the error of the running policy's value alone.",
        ),
        Mistake(
            _gain_by(lambda a, b, P, n: _deviation(b - a, P, np.maximum(n - 1, 1))),
            "divide each row's variance by its count n, and not by n - 1.",
        ),
    ),
)


def _draw_decide(
    rng: np.random.Generator,
    *,
    distance: tuple[float, ...] = (3.0, -3.0, 0.5, -0.5, 1.3, -1.3, 1.8, -1.8),
    error: float | None = None,
    cost: float | None = None,
) -> Arguments:
    """Draw a gain at a distance from the cost, in standard errors."""
    if error is None:
        error = round(float(rng.uniform(0.1, 1.5)), 2)
    if cost is None:
        cost = round(float(rng.uniform(0.1, 1.0)), 2)
    unit = error if np.isfinite(error) and error > 0 else 1.0
    gain = cost + float(rng.choice(distance)) * unit
    return {"gain": gain, "error": error, "cost": cost}


_95 = "the interval is gain -+ 1.96 error; no other number than 1.96."
_UNKNOWN = "an error of nan or inf says that nothing is known: record."

DECIDE_KINDS = (
    Kind("", _draw_decide),
    Kind(
        "the gain is 1.963 errors above the cost",
        partial(_draw_decide, distance=(1.963,)),
        _95,
    ),
    Kind(
        "the gain is 1.957 errors below the cost",
        partial(_draw_decide, distance=(-1.957,)),
        _95,
    ),
    Kind(
        "the gain is 1.963 errors below the cost",
        partial(_draw_decide, distance=(-1.963,)),
        _95,
    ),
    Kind("the error is nan", partial(_draw_decide, error=float("nan")), _UNKNOWN),
    Kind("the error is inf", partial(_draw_decide, error=float("inf")), _UNKNOWN),
    Kind(
        "the error is 0",
        partial(_draw_decide, error=0.0, distance=(0.5, -0.5)),
        "with an error of 0 the interval is the gain itself.",
    ),
    Kind(
        "the error is 0 and the gain equals the cost",
        partial(_draw_decide, error=0.0, distance=(0.0,)),
        "a gain that equals the cost is neither above it nor below: record.",
    ),
    Kind("the cost is 0", partial(_draw_decide, cost=0.0), "the cost may be 0."),
    Kind(
        "the cost is negative",
        partial(_draw_decide, cost=-1.5, distance=(3.0,)),
        "the cost may be negative, where a change saves something.",
    ),
)


def _decide(gain: float, error: float, cost: float, z: float = Z) -> str:
    if not np.isfinite(error):
        return "record"
    if gain - z * error > cost:
        return "deploy"
    return "keep" if gain + z * error < cost else "record"


DECIDE = Task(
    name="8_decide",
    call="decide(gain, error, cost)",
    kinds=DECIDE_KINDS,
    solve=_decide,
    choices=CHOICES,
    hint="deploy if the whole 95% interval, gain -+ 1.96 error, is above the cost; keep"
    " if it is below; else record. An error of nan or inf says that nothing is known.",
    mistakes=(
        Mistake(
            lambda gain, error, cost: "deploy" if gain > cost else "keep",
            "the gain is an estimate; use its standard error.",
        ),
        Mistake(
            lambda gain, error, cost: _decide(gain, error, 0.0),
            "a change has a cost; compare with it, and not with 0.",
        ),
        Mistake(
            lambda gain, error, cost: _decide(gain, error, cost, 1.0),
            "one standard error on each side covers 68%, and not 95%.",
        ),
        Mistake(
            lambda gain, error, cost: _decide(gain, error, cost, 1.645),
            "1.645 is for one side; both decisions together need 1.96.",
        ),
        Mistake(
            lambda gain, error, cost: _decide(gain, error, cost, 2.0),
            "the interval is gain -+ 1.96 error, and not 2 errors.",
        ),
        Mistake(
            lambda gain, error, cost: _decide(gain, error, cost, 2.576),
            "2.576 is for 99%; the interval of 95% has 1.96.",
        ),
        Mistake(
            lambda gain, error, cost: _decide(gain, error, cost, 0.5 * Z),
            "the interval has 1.96 errors on each side, and not half of that.",
        ),
        Mistake(
            lambda gain, error, cost: (
                _decide(gain, error, cost) if np.isfinite(error) else "keep"
            ),
            "an error of nan or inf says that nothing is known: record, and do not keep.",
        ),
        Mistake(
            lambda gain, error, cost: (
                "deploy"
                if gain - Z * error > cost
                else "keep"
                if gain < cost
                else "record"
            ),
            "keep is a decision as well: it needs the whole interval below the cost.",
        ),
        Mistake(
            lambda gain, error, cost: "deploy" if gain - Z * error > cost else "keep",
            "an interval around the cost decides nothing: record more.",
        ),
        Mistake(
            lambda gain, error, cost: "deploy" if gain - Z * error > cost else "record",
            "an interval below the cost decides as well: keep the running policy.",
        ),
        Mistake(
            lambda gain, error, cost: "deploy" if gain + Z * error > cost else "keep",
            "this deploys where the upper end is above the cost, so wherever little is"
            " known.",
        ),
        Mistake(
            lambda gain, error, cost: (
                _decide(gain, error, cost)
                if np.isfinite(error)
                else ("deploy" if gain > cost else "keep")
            ),
            "an error of nan or inf says that nothing is known: record.",
        ),
        Mistake(
            lambda gain, error, cost: _decide(gain, np.nan_to_num(error), cost),
            "an error of nan says that nothing is known, and not that it is 0.",
        ),
        Mistake(
            lambda gain, error, cost: {
                "deploy": "keep",
                "keep": "deploy",
                "record": "record",
            }[_decide(gain, error, cost)],
            "deploy and keep are exchanged.",
        ),
    ),
)


def _draw_need(
    rng: np.random.Generator,
    *,
    above: float | None = None,
    error: float | None = None,
    cost: float | None = None,
    n: int | None = None,
) -> Arguments:
    """Draw a gain that is above the cost by a number."""
    cost = round(float(rng.uniform(0.1, 0.5)), 2) if cost is None else cost
    above = round(float(rng.uniform(0.2, 1.0)), 2) if above is None else above
    error = round(float(rng.uniform(0.3, 1.0)), 2) if error is None else error
    n = int(rng.integers(50, 900)) if n is None else n
    return {"gain": cost + above, "error": error, "cost": cost, "n": n}


_NEVER = "where the gain is not above the cost no number of transitions is enough: inf."

NEED_KINDS = (
    Kind("", _draw_need),
    Kind("the gain equals the cost", partial(_draw_need, above=0.0, cost=0.25), _NEVER),
    Kind("the gain is below the cost", partial(_draw_need, above=-0.7), _NEVER),
    Kind(
        "fewer transitions are enough",
        partial(_draw_need, error=0.01),
        "the least whole N is asked for, also where it is below n.",
    ),
    Kind(
        "the gain is just above the cost",
        partial(_draw_need, above=0.01),
        "N may be very large; it is not cut.",
    ),
    Kind("the cost is 0", partial(_draw_need, cost=0.0), "the cost may be 0."),
    Kind(
        "the cost is negative and the gain as well",
        partial(_draw_need, cost=-2.0),
        "the gain must exceed the cost, and not 0.",
    ),
    Kind(
        "the log has 5 transitions",
        partial(_draw_need, n=5),
        "round up to a whole number, also of a short log.",
    ),
)


def _need(gain: float, error: float, cost: float, n: int, z: float = Z) -> float:
    if gain <= cost:
        return float("inf")
    return float(np.ceil(n * (z * error / (gain - cost)) ** 2))


def _need_bounds(gain: float, error: float, cost: float, n: int) -> tuple[Any, Any]:
    """Allow 1.96 and its more exact value."""
    ends = [_need(gain, error, cost, n, z) for z in (1.9599, Z, 1.96)]
    return np.float64(min(ends)), np.float64(max(ends))


NEED = Task(
    name="8_need",
    call="transitions_needed(gain, error, cost, n)",
    kinds=NEED_KINDS,
    solve=_need,
    bounds=_need_bounds,
    tolerance=1e-9,
    hint="an error from n transitions is error * sqrt(n / N) with N; find the least"
    " whole N with gain - 1.96 error sqrt(n / N) >= cost. It is inf if gain <= cost.",
    mistakes=(
        Mistake(
            lambda gain, error, cost, n: np.ceil(n * 1.96 * error / (gain - cost)),
            "the error falls with the root of N, so that N grows with the square.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil(n * (error / (gain - cost)) ** 2),
            "the factor 1.96 is missing.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil(n * (1.96 * error / gain) ** 2),
            "the gain must exceed the cost, and not 0.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil((1.96 * error / (gain - cost)) ** 2),
            "the error is that of n transitions, and not of one; multiply by n.",
        ),
        Mistake(
            lambda gain, error, cost, n: (
                np.ceil(n * (1.96 * error / (gain - cost)) ** 2) - 1
            ),
            "round up: with one transition less the interval reaches the cost.",
        ),
        Mistake(
            lambda gain, error, cost, n: max(_need(gain, error, cost, n, 1.96) - n, 0),
            "this is what is still missing; the whole number is asked for.",
        ),
        Mistake(
            lambda gain, error, cost, n: n * (1.96 * error / (gain - cost)) ** 2,
            "transitions are whole; round up. And where gain <= cost none is enough.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil(
                n * (1.96 * error / (gain - cost)) ** 2
            ),
            "where the gain is below the cost no number of transitions is enough: inf.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil(
                n * (2 * 1.96 * error / (gain - cost)) ** 2
            ),
            "the distance from the gain to an end is half the width.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.floor(
                n * (1.96 * error / (gain - cost)) ** 2
            ),
            "round up: with one transition less the interval reaches the cost.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.round(
                n * (1.96 * error / (gain - cost)) ** 2
            ),
            "round up, and not to the nearest whole number.",
        ),
        Mistake(
            lambda gain, error, cost, n: max(
                _need(gain, error, cost, n, 1.96), float(n)
            ),
            "the least whole N is asked for, also where it is below n.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil(
                n * (1.645 * error / (gain - cost)) ** 2
            ),
            "1.645 is for one side; the interval has 1.96.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil(
                n * (2.0 * error / (gain - cost)) ** 2
            ),
            "the interval has 1.96 errors on each side, and not 2.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.ceil(
                n * (1.96 * error / (gain + cost)) ** 2
            ),
            "the cost is subtracted from the gain, and not added.",
        ),
        Mistake(
            lambda gain, error, cost, n: _need(gain, error, cost, n, 1.96) + 1,
            "this is one more than is needed: round up to the next whole number.",
        ),
        Mistake(
            lambda gain, error, cost, n: np.sqrt(_need(gain, error, cost, n, 1.96)),
            "N grows with the square of the error, and its root is not asked for.",
        ),
    ),
)

TASKS = (GAIN, DECIDE, NEED)
