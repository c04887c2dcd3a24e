"""Assignment 1: the risk whose minimiser is a ratio, and its minimiser in a box."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from oee_tabular.ratio import density_ratio
from oee_tabular.testing.assignments.drawing import draw_rows
from oee_tabular.testing.assignments.judging import Arguments, Kind, Mistake, Task
from oee_tabular.typing import Array, BoolArray

TINY = 1e-6  # a small probability
MINUTE = 1e-9  # the smallest ratio that is drawn


def _draw_risk(
    rng: np.random.Generator,
    *,
    size: int | None = None,
    has_zeros: bool = False,
) -> Arguments:
    size = int(rng.integers(3, 7)) if size is None else size
    p = draw_rows(rng, (size,), has_zeros=False)
    q = draw_rows(rng, (size,), has_zeros=False)
    g = rng.uniform(0.2, 3.0, size)
    if has_zeros:
        p[0] = 0.0
        p /= p.sum()
    return {"g": g, "p": p, "q": q}


def _draw_zero_ratio(rng: np.random.Generator) -> Arguments:
    drawn = _draw_risk(rng, has_zeros=True)
    drawn["g"][0] = 0.0
    return drawn


def _draw_tiny_probability(rng: np.random.Generator) -> Arguments:
    """Draw a p of 1e-6, and the g that is the ratio there."""
    drawn = _draw_risk(rng)
    drawn["p"][0] = 0.0
    drawn["p"] *= (1.0 - TINY) / drawn["p"].sum()
    drawn["p"][0] = TINY
    drawn["g"][0] = TINY / drawn["q"][0]
    return drawn


def _draw_minute_ratio(rng: np.random.Generator) -> Arguments:
    drawn = _draw_risk(rng)
    drawn["g"][0] = MINUTE
    return drawn


def _draw_unsimulated(rng: np.random.Generator) -> Arguments:
    """Draw an outcome of which q is 0, and p is not."""
    drawn = _draw_risk(rng)
    drawn["q"][-1] = 0.0
    drawn["q"] /= drawn["q"].sum()
    return drawn


def _draw_equal(rng: np.random.Generator) -> Arguments:
    drawn = _draw_risk(rng)
    return drawn | {"g": np.ones(len(drawn["q"])), "p": drawn["q"].copy()}


def _risk(g: Array, p: Array, q: Array) -> float:
    return float(q @ g - p[p > 0] @ np.log(g[p > 0]))


_ZERO = "where p = 0 the term p log g counts 0, also where g = 0."
_EXACT = (
    "a small number is no 0: take log g as it is, without a number that is added"
    " and without a floor."
)

RISK_KINDS = (
    Kind("", _draw_risk),
    Kind("p has a 0", partial(_draw_risk, has_zeros=True), _ZERO),
    Kind("p and g have a 0 in one place", _draw_zero_ratio, _ZERO),
    Kind("p has an entry of 1e-6", _draw_tiny_probability, _EXACT),
    Kind("g has an entry of 1e-9", _draw_minute_ratio, _EXACT),
    Kind(
        "q has a 0 and p has none",
        _draw_unsimulated,
        "q may be 0: divide nothing by it.",
    ),
    Kind(
        "g is 1 and p equals q",
        _draw_equal,
        "where g is 1 its logarithm is 0, and the risk is the sum of q.",
    ),
    Kind(
        "there is one outcome",
        partial(_draw_risk, size=1),
        "the arrays may have any length, also 1.",
    ),
    Kind(
        "there are 60 outcomes",
        partial(_draw_risk, size=60),
        "the arrays may have any length; sum over all of it.",
    ),
)


def _draw_box(
    rng: np.random.Generator,
    *,
    size: int | None = None,
    nu: float | None = None,
    mu: float | None = None,
    has_zeros: bool = False,
) -> Arguments:
    size = int(rng.integers(3, 7)) if size is None else size
    p = draw_rows(rng, (size,), has_zeros=False)
    q = draw_rows(rng, (size,), has_zeros=False)
    if has_zeros:
        p[: size // 3] = 0.0
        p /= p.sum()
    drawn_nu = round(float(rng.uniform(0.4, 0.8)), 2)
    drawn_mu = round(float(rng.uniform(1.3, 2.0)), 2)
    return {
        "p": p,
        "q": q,
        "nu": drawn_nu if nu is None else nu,
        "mu": drawn_mu if mu is None else mu,
    }


def _draw_both_ends(rng: np.random.Generator) -> Arguments:
    """Draw a plain case with ratios below, in and above the box."""
    while True:
        drawn = _draw_box(rng, size=int(rng.integers(5, 8)))
        ratio = drawn["p"] / drawn["q"]
        is_low, is_high = ratio < drawn["nu"], ratio > drawn["mu"]
        if is_low.any() and is_high.any() and not np.all(is_low | is_high):
            return drawn


def _draw_tiny_simulated(rng: np.random.Generator) -> Arguments:
    """Draw probabilities of 1e-6 whose ratio is between 0.5 and 2."""
    drawn = _draw_box(rng, nu=0.1, mu=5.0)
    for name in ("p", "q"):
        drawn[name][0] = 0.0
        drawn[name] /= drawn[name].sum()
        drawn[name][0] = TINY * float(rng.uniform(1.0, 2.0))
        drawn[name] /= drawn[name].sum()
    return drawn


def _draw_feasible(draw: Any, rng: np.random.Generator) -> Arguments:
    """Draw a box in which the outcomes with p > 0 alone can make the sum 1."""
    while True:
        drawn: Arguments = draw(rng)
        p, q = drawn["p"], drawn["q"]
        if q @ np.where(p > 0, drawn["mu"], drawn["nu"]) > 1.05:
            return drawn


def _draw_multiplier(rng: np.random.Generator, *, is_above: bool) -> Arguments:
    """Draw a box whose cut ratio sums to more than 1, or to less."""
    while True:
        drawn = _draw_both_ends(rng)
        gap = drawn["q"] @ np.clip(drawn["p"] / drawn["q"], drawn["nu"], drawn["mu"])
        if (gap > 1.03) if is_above else (gap < 0.97):
            return drawn


_BOX_ZERO = "where p = 0 the ratio is 0, and g is the lower end of the box."


def _is_zero(p: Array, *_: Any) -> BoolArray:
    return np.asarray(p == 0)


_BOX_ENDS = "the ends of the box are the arguments nu and mu, whatever they are."

BOX_KINDS = (
    Kind("", _draw_both_ends),
    Kind("p has a 0", partial(_draw_box, has_zeros=True), _BOX_ZERO, _is_zero),
    Kind("no ratio leaves the box", partial(_draw_box, nu=0.01, mu=100.0), _BOX_ENDS),
    Kind(
        "the box is from 0.95 to 1.05", partial(_draw_box, nu=0.95, mu=1.05), _BOX_ENDS
    ),
    Kind("the box is above 1", partial(_draw_box, nu=1.1, mu=1.6), _BOX_ENDS),
    Kind("the box is below 1", partial(_draw_box, nu=0.3, mu=0.9), _BOX_ENDS),
    Kind(
        "p and q have entries of 1e-6",
        _draw_tiny_simulated,
        "small probabilities have a ratio as large ones have: add nothing to them.",
    ),
    Kind(
        "the box begins at 0 and p has a 0",
        partial(_draw_box, nu=0.0, has_zeros=True),
        _BOX_ZERO,
        _is_zero,
    ),
    Kind(
        "there is one outcome",
        partial(_draw_box, size=1),
        "the arrays may have any length, also 1.",
    ),
    Kind(
        "there are 40 outcomes",
        partial(_draw_box, size=40),
        "the arrays may have any length.",
    ),
)


def _draw_concentrated(rng: np.random.Generator) -> Arguments:
    """Draw a p that is nearly all on an outcome that q seldom has, so that l is near -1."""
    q = np.concatenate([[0.02], 0.98 * (0.2 + rng.dirichlet(np.ones(4))) / 1.8])
    p = np.concatenate([[0.97], 0.03 * rng.dirichlet(np.full(4, 5.0))])
    return {"p": p, "q": q, "nu": 0.2, "mu": 3.0}


_ABOVE = "q @ g of the cut ratio is above 1: here l > 0, and 1 + l > 1."
_BELOW = "q @ g of the cut ratio is below 1: here l < 0, and 1 + l < 1."

NORMALISED_KINDS = (
    Kind("", partial(_draw_feasible, _draw_both_ends)),
    Kind(
        "the cut ratio sums to more than 1",
        partial(_draw_multiplier, is_above=True),
        _ABOVE,
    ),
    Kind(
        "the cut ratio sums to less than 1",
        partial(_draw_feasible, partial(_draw_multiplier, is_above=False)),
        _BELOW,
    ),
    Kind(
        "p has a 0",
        partial(_draw_feasible, partial(_draw_box, has_zeros=True)),
        _BOX_ZERO,
        _is_zero,
    ),
    Kind(
        "no ratio leaves the box",
        partial(_draw_box, nu=0.01, mu=100.0),
        "the ratio itself sums to 1 here, and l = 0.",
    ),
    Kind(
        "the box is from 0.95 to 1.05",
        partial(_draw_feasible, partial(_draw_box, nu=0.95, mu=1.06)),
        _BOX_ENDS,
    ),
    Kind(
        "the box is from 0.02 to 50, and p has zeros",
        partial(_draw_feasible, partial(_draw_box, nu=0.02, mu=50.0, has_zeros=True)),
        _BOX_ENDS,
    ),
    Kind(
        "p and q have entries of 1e-6",
        partial(_draw_feasible, _draw_tiny_simulated),
        "small probabilities have a ratio as large ones have: add nothing to them.",
    ),
    Kind(
        "there are 40 outcomes",
        partial(_draw_feasible, partial(_draw_box, size=40)),
        "the arrays may have any length.",
    ),
    Kind(
        "nearly all of p is on an outcome that q seldom has",
        _draw_concentrated,
        "l may be near -1, or large: search 1 + l from nearly 0 on, and far up.",
    ),
)


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
    kinds=RISK_KINDS,
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
            lambda g, p, q: q @ g - np.log(p @ g),
            "this is the logarithm of a mean; the mean of the logarithm is asked for.",
        ),
        Mistake(
            lambda g, p, q: q @ g - p @ np.log1p(g),
            "np.log1p(g) is log(1 + g); take np.log(g).",
        ),
        Mistake(
            lambda g, p, q: q[p > 0] @ g[p > 0] - p[p > 0] @ np.log(g[p > 0]),
            "where p = 0 only the term p log g is 0; q g counts there too.",
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
    kinds=BOX_KINDS,
    axes=("outcome",),
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
        Mistake(
            lambda p, q, nu, mu: np.clip(np.log(p / q), nu, mu),
            "this cuts the logarithm; the box is for the ratio p / q itself.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.clip(p - q, nu, mu),
            "this cuts the difference; the ratio p / q is a quotient.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.clip(p, nu, mu),
            "this cuts p itself; the box is for the ratio p / q.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.where(p / q < nu, mu, np.minimum(p / q, mu)),
            "what is below nu goes to nu, and not to mu.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.clip(p / q, 0.5, 2.0),
            "the box is from nu to mu, which are arguments, and not from 0.5 to 2.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.clip(p / q, 1.0 / mu, mu),
            "the lower end is nu, and not 1 / mu.",
        ),
    ),
)

NORMALISED = Task(
    name="1_normalised",
    call="normalised_minimiser(p, q, nu, mu)",
    kinds=NORMALISED_KINDS,
    axes=("outcome",),
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
        Mistake(
            lambda p, q, nu, mu: (
                np.clip(p / q, nu, mu) + 1.0 - q @ np.clip(p / q, nu, mu)
            ),
            "adding one number moves values out of the box; those inside of it share a"
            " factor.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.ones(len(p)),
            "g = 1 sums to 1 and is in the box; its risk is not the least.",
        ),
        Mistake(
            lambda p, q, nu, mu: (p / q) / np.sum(p / q),
            "it is q @ g that is 1, and not the sum of g; and g stays in the box.",
        ),
        Mistake(
            lambda p, q, nu, mu: np.full(len(p), nu),
            "this is the lower end everywhere: q @ g falls as l grows, so that l is too"
            " large.",
        ),
    ),
)

TASKS = (RISK, MINIMISER, NORMALISED)
