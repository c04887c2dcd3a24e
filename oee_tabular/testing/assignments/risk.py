"""Assignment 1: the risk whose minimiser is a ratio, and its minimiser in a box."""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular.ratio import density_ratio
from oee_tabular.testing.assignments.drawing import draw_rows
from oee_tabular.testing.assignments.judging import Arguments, Mistake, Task
from oee_tabular.typing import Array


def _draw_risk(rng: np.random.Generator, is_hard: bool) -> Arguments:
    size = int(rng.integers(3, 7))
    p = draw_rows(rng, (size,), has_zeros=is_hard)
    q = draw_rows(rng, (size,), has_zeros=False)
    # where p = 0 a hard case has a g of 0 or any other
    g = np.where((p > 0) | (rng.random(size) < 0.3), rng.uniform(0.2, 3.0, size), 0.0)
    return {"g": g, "p": p, "q": q}


def _risk(g: Array, p: Array, q: Array) -> float:
    return float(q @ g - p[p > 0] @ np.log(g[p > 0]))


def _draw_box(rng: np.random.Generator, is_hard: bool) -> Arguments:
    size = int(rng.integers(3, 7))
    p = draw_rows(rng, (size,), has_zeros=is_hard)
    q = draw_rows(rng, (size,), has_zeros=False)
    return {"p": p, "q": q, "nu": 0.5, "mu": round(float(rng.uniform(1.3, 2.0)), 2)}


def _draw_normalised(rng: np.random.Generator, is_hard: bool) -> Arguments:
    """Draw a box in which the outcomes with p > 0 alone can make the sum 1."""
    while True:
        drawn = _draw_box(rng, is_hard)
        p, q = drawn["p"], drawn["q"]
        if q @ np.where(p > 0, drawn["mu"], drawn["nu"]) > 1.05:
            return drawn


def _minimiser(p: Array, q: Array, nu: float, mu: float) -> Array:
    return density_ratio(p, q, lower=nu, upper=mu, normalized=False).ratio


def _normalised(p: Array, q: Array, nu: float, mu: float) -> Array:
    return density_ratio(p, q, lower=nu, upper=mu).ratio


def _rescale_after(p: Array, q: Array, nu: float, mu: float) -> Any:
    g = np.clip(p / q, nu, mu)
    return g / (q @ g)


RISK = Task(
    name="1_risk",
    call="risk(g, p, q)",
    draw=_draw_risk,
    solve=_risk,
    hint="the risk is the sum of q g less the sum of p log g.",
    mistakes=(
        Mistake(
            lambda g, p, q: q @ g + p @ np.log(g),
            "the second sum is subtracted; with a plus there is no minimum at p / q.",
        ),
        Mistake(
            lambda g, p, q: p @ g - q @ np.log(g),
            "p and q are exchanged: g is averaged over q, log g over p.",
        ),
        Mistake(
            lambda g, p, q: q @ g - q @ np.log(g),
            "log g is averaged over p, the target, and not over q.",
        ),
        Mistake(
            lambda g, p, q: p @ g - p @ np.log(g),
            "g is averaged over q, the simulator, and not over p.",
        ),
        Mistake(
            lambda g, p, q: np.mean(q * g - p * np.log(g)),
            "p and q are weights already: take the sum over x, and not the mean.",
        ),
        Mistake(
            lambda g, p, q: q @ g - p @ np.log2(g),
            "take the natural logarithm; with another base the minimum is elsewhere.",
        ),
        Mistake(
            lambda g, p, q: q @ g - p @ np.log10(g),
            "take the natural logarithm; with another base the minimum is elsewhere.",
        ),
        Mistake(
            lambda g, p, q: -(p @ np.log(g)),
            "the sum of q g is missing; without it the risk falls for ever as g grows.",
        ),
        Mistake(
            lambda g, p, q: 1.0 - (q @ g - p @ np.log(g)),
            "this is 1 less the risk; the divergence is 1 less the least risk.",
        ),
        Mistake(
            lambda g, p, q: p[p > 0] @ np.log(p[p > 0] / q[p > 0]),
            "this is the divergence, which does not depend on g.",
        ),
        Mistake(
            lambda g, p, q: np.sum(g - p * np.log(g)),
            "the first sum has the weights q.",
        ),
        Mistake(
            lambda g, p, q: q @ g - p @ np.log(g),
            "where p = 0 the term p log g counts 0, also where g = 0.",
        ),
    ),
)

MINIMISER = Task(
    name="1_minimiser",
    call="minimiser(p, q, nu, mu)",
    draw=_draw_box,
    solve=_minimiser,
    hint="the risk is a sum over x, so each g(x) is found alone; a convex term that"
    " would like to leave the box is least at the end.",
    tolerance=1e-6,
    mistakes=(
        Mistake(
            lambda p, q, nu, mu: p / q,
            "the ratio without the box; keep nu <= g <= mu.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.clip(q / p, nu, mu),
            "the ratio is p / q, the target over the simulator, and not q / p.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.minimum(p / q, mu),
            "the lower end nu of the box is missing.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.maximum(p / q, nu),
            "the upper end mu of the box is missing.",
        ),
        Mistake(
            _rescale_after,
            "here nothing makes the sum of q g equal to 1; leave the scale alone.",
        ),
        Mistake(
            _normalised,
            "this minimises under sum q g = 1 as well, which is the next exercise.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.where((p / q < nu) | (p / q > mu), 1.0, p / q),
            "what leaves the box goes to its nearer end, and not to 1.",
        ),
    ),
)

NORMALISED = Task(
    name="1_normalised",
    call="normalised_minimiser(p, q, nu, mu)",
    draw=_draw_normalised,
    solve=_normalised,
    hint="with a multiplier l of the constraint, g = p / ((1 + l) q) cut to the box; q @"
    " g falls as l grows, so that bisection finds the l with q @ g = 1.",
    tolerance=1e-6,
    mistakes=(
        Mistake(
            _minimiser,
            "the sum of q g is not 1 here. The values inside of the box must change.",
        ),
        Mistake(
            _rescale_after,
            "dividing by q @ g moves values out of the box. Only those inside of it"
            " share one factor.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.clip(_rescale_after(p, q, nu, mu), nu, mu),
            "cutting after the division changes q @ g again. Find the factor for which"
            " the cut values have q @ g = 1.",
        ),
        Mistake(
            lambda p, q, nu, mu: p / q,
            "the ratio without the box; keep nu <= g <= mu.",
        ),
    ),
)

TASKS = (RISK, MINIMISER, NORMALISED)
