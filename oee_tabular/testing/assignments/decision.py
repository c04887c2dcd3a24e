"""Assignment 8: a gain with its standard error, and whether to deploy."""

from __future__ import annotations

from collections.abc import Callable
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
from oee_tabular.testing.assignments.judging import Arguments, Mistake, Task
from oee_tabular.typing import Array

Z = NormalDist().inv_cdf(0.975)
CHOICES = ("deploy", "keep", "record")


def _draw_gain(rng: np.random.Generator, is_hard: bool) -> Arguments:
    parts = draw_parts(rng, False)
    target = draw_rows(rng, parts.P.shape, has_zeros=is_hard)
    n = rng.integers(5, 40, size=parts.r.shape)
    counts = draw_counts(rng, n, target)
    running = draw_policy(rng, parts.r.shape, is_hard=is_hard)
    candidate = draw_policy(rng, parts.r.shape, is_hard=is_hard)
    if is_hard and rng.random() < 0.3:
        candidate = running.copy()
    return {
        "counts": counts,
        "r": parts.r,
        "mu": parts.mu,
        "discount": parts.discount,
        "running": running,
        "candidate": candidate,
    }


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
    draw=_draw_gain,
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
    ),
)


def _draw_decide(rng: np.random.Generator, is_hard: bool) -> Arguments:
    gain, error = (
        round(float(rng.normal(0, 2)), 2),
        round(float(rng.uniform(0.1, 1.5)), 2),
    )
    cost = round(float(rng.uniform(0.0, 1.0)), 2)
    if is_hard:
        kind = int(rng.integers(5))
        if kind == 0:
            error = float(rng.choice([np.inf, np.nan]))
        elif kind == 1:
            gain = cost + (Z + float(rng.choice([-0.2, 0.2]))) * error
        elif kind == 2:
            gain = cost - (Z + float(rng.choice([-0.2, 0.2]))) * error
        elif kind == 3:
            error, gain = 0.0, cost + float(rng.choice([-0.5, 0.5]))
    return {"gain": gain, "error": error, "cost": cost}


def _decide(gain: float, error: float, cost: float, z: float = Z) -> str:
    if not np.isfinite(error):
        return "record"
    if gain - z * error > cost:
        return "deploy"
    return "keep" if gain + z * error < cost else "record"


DECIDE = Task(
    name="8_decide",
    call="decide(gain, error, cost)",
    draw=_draw_decide,
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


def _draw_need(rng: np.random.Generator, is_hard: bool) -> Arguments:
    cost = round(float(rng.uniform(0.0, 0.5)), 2)
    gain = cost + round(float(rng.uniform(0.2, 1.0)), 2)
    error = round(float(rng.uniform(0.3, 1.0)), 2)
    if is_hard and rng.random() < 0.3:
        gain = cost - float(rng.integers(0, 2))
    elif is_hard and rng.random() < 0.3:
        error = 0.01
    return {"gain": gain, "error": error, "cost": cost, "n": int(rng.integers(50, 900))}


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
    draw=_draw_need,
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
    ),
)

TASKS = (GAIN, DECIDE, NEED)
