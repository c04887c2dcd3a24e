"""Families whose targets have a distribution of another shape, often of one mean."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import optimize, stats

from oee_tabular.lab.bench.laws import cross, normalize, poisson
from oee_tabular.lab.bench.shift import Moves, shift
from oee_tabular.typing import Array, IntArray

DECK = np.append(np.ones(9), 4.0) / 13
OUTCOME = np.zeros((203, 2, 203))
OUTCOME[:200, :, 200] = -1.0
OUTCOME[:200, :, 202] = 1.0


def draw_deck(rng: np.random.Generator) -> tuple[Array]:
    """Draw the probabilities of cards 1 to 10 in the target of blackjack."""
    factors = [1, rng.uniform(1.4, 1.9), 1, rng.uniform(0.4, 0.7)]
    return (normalize(DECK * np.repeat(factors, [4, 2, 3, 1])),)


def blackjack(s: IntArray, stand: IntArray, cards: Array) -> Moves:
    """Return the transitions of blackjack, drawing or standing.

    States are the own total 2 to 21 and the dealer's card 1 to 10, aces counting 1;
    then lost, even and won.
    """
    total = s // 10 + 2
    drawn = np.arange(1, 11)
    final = np.arange(17, 27)
    dealer = np.eye(32)[1:11]
    for t in range(1, 17):
        dealer[:, t + 1 : t + 11] += dealer[:, t : t + 1] * cards
    yield (1 - stand) * cards, np.where(total + drawn > 21, 200, s + 10 * drawn)
    is_won = (final > 21) | (final < total)
    wins = np.where(is_won, 202, np.where(final == total, 201, 200))
    yield stand * dealer[s[:, :, 0] % 10, 17:27], wins


BLACKJACK = shift(
    "High cards are rarer and middle ones more frequent than simulated.",
    (203, 2),
    OUTCOME,
    0.99,
    (DECK,),
    draw_deck,
    blackjack,
    start=range(20, 150),
    ends=range(200, 203),
)


def epidemic_superspreading(
    infected: IntArray, action: IntArray, dispersion: float
) -> Moves:
    """Return the transitions of an epidemic of 0 to 30 infected people.

    Actions are open, distance and closed.
    """
    mean = 0.3 + np.array([0.45, 0.28, 0.15])[action] * infected * (1 - infected / 45)
    chance = dispersion / (dispersion + mean)
    new = np.asarray(stats.nbinom.pmf(np.arange(200), dispersion, chance))
    still_ill = np.asarray(stats.binom.pmf(np.arange(31), infected, 0.7))[:, 0]
    law = np.zeros((31, 3, 230))
    for i, a in np.ndindex(31, 3):
        law[i, a, : 200 + i] = np.convolve(new[i, a], still_ill[i, : i + 1])
    return [(law, np.arange(230))]


EPIDEMIC_SUPERSPREADING = shift(
    "A few infect many others: new infections have the simulated mean and a far"
    " larger variance.",
    (31, 3),
    -0.2 * np.arange(31.0)[:, None] - np.array([0.0, 0.8, 2.0]),
    0.95,
    (1000.0,),
    lambda rng: (rng.uniform(0.5, 1.0),),
    epidemic_superspreading,
    start=range(1, 8),
)
CLAIMS = np.arange(1, 61)


def find_law_of_mean_5(
    weights: Callable[[float], Any], low: float, high: float
) -> Array:
    """Find the distribution of claims with mean 5 in a family of weights."""

    def excess(parameter: float) -> float:
        """Return by how much the mean is above 5."""
        return float(normalize(weights(parameter)) @ CLAIMS - 5)

    return normalize(weights(optimize.brentq(excess, low, high)))


def insurance_claims(
    capital: IntArray, action: IntArray, claims: Array, frequency: float
) -> Moves:
    """Return the transitions of an insurer's capital, from 0 (ruin) to 49.

    Claims are 1 to 60, of which all, half or a quarter is kept.
    """
    income = np.minimum(capital + 3 - action, 49)
    return (1 - frequency, income), (
        frequency * claims,
        income - np.ceil(CLAIMS * 0.5**action).astype(int),
    )


INSURANCE_CLAIMS = shift(
    "Claims have a heavy tail at the simulated mean.",
    (50, 3),
    np.sqrt(np.arange(50.0)),
    0.97,
    (find_law_of_mean_5(lambda x: x**CLAIMS, 0.5, 0.99), 0.4),
    lambda rng: (
        find_law_of_mean_5(lambda x: CLAIMS**-x, 1.01, 4.0),
        rng.uniform(0.38, 0.45),
    ),
    insurance_claims,
    start=range(10, 41),
    ends=[0],
)
RETURNS = np.arange(-15, 16)


def portfolio_tails(wealth: IntArray, action: IntArray, law: Array) -> Moves:
    """Return the transitions of wealth from 0 (broke) to 40 on a logarithmic scale.

    Nothing, half or all of it is at risk.
    """
    after = wealth + np.round(0.5 * action * RETURNS).astype(int)
    return (0.8 * law, after), (0.2 * law, after - 1)


PORTFOLIO_TAILS = shift(
    "Returns have the heavy tails of Student's t; simulated, they are normal.",
    (41, 3),
    np.log1p(np.arange(41.0)),
    0.96,
    (stats.norm(0.5, 3.0).pdf(RETURNS),),
    lambda rng: (stats.t(rng.uniform(2, 3), 0.5, 1.7).pdf(RETURNS),),
    portfolio_tails,
    start=range(10, 31),
    ends=[0],
)
BATCHES = np.array([0, 3, 6, 10])
DEMAND = poisson(3.0, 30)
SALES = np.minimum(np.arange(31)[:, None], np.arange(31)) @ DEMAND


def random_yield(stock: IntArray, action: IntArray, dispersion: float) -> Moves:
    """Return the transitions of a stock of 0 to 30 with random yields.

    Batches are 0, 3, 6 and 10.
    """
    sold, good = np.divmod(np.arange(31 * 11), 11)
    # The mean yield is .7 whatever the dispersion.
    law = np.asarray(
        stats.betabinom.pmf(
            np.arange(11), BATCHES[action], 0.7 * dispersion, 0.3 * dispersion
        )
    )
    law[:, 0] = np.arange(11) == 0
    return [(cross(DEMAND, law), np.maximum(stock - sold, 0) + good)]


RANDOM_YIELD = shift(
    "A batch succeeds or fails as a whole, with the simulated mean.",
    (31, 4),
    (2 * SALES - 0.1 * np.arange(31))[:, None] - 0.3 * BATCHES - 0.5 * (BATCHES > 0),
    0.96,
    (1e4,),
    lambda rng: (rng.uniform(0.5, 1.0),),
    random_yield,
)
