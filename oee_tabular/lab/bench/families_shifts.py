"""Families whose targets differ in several numbers, or in the shape of a distribution.

Other kinds are changes at one place, effects that depend on the state, seasons, heavy
tails, mixtures with another MDP, low rank, hundreds of successors, and simulators that
are right by luck. Each family draws its parameters from a generator.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import optimize, stats

from oee_tabular.exact import optimal_policy, policy_value, state_values
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import cross, normalize, poisson
from oee_tabular.lab.bench.shift import Maker, Moves, pair, shift
from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import Array, IntArray

DECK = np.append(np.ones(9), 4.0) / 13
OUTCOME = np.zeros((203, 2, 203))
OUTCOME[:200, :, 200] = -1.0
OUTCOME[:200, :, 202] = 1.0
ONE, TWO = np.divmod(np.arange(64), 8)
CLAIMS = np.arange(1, 61)
RETURNS = np.arange(-15, 16)
PREY, HUNTERS = np.divmod(np.arange(96), 8)
HARVESTS = np.array([0, 1, 3])
PRICES = np.array([1.0, 1.5, 2.0, 3.0])
STOCK = np.arange(176) % 16
BATCHES = np.array([0, 3, 6, 10])
DEMAND = poisson(3.0, 30)
SALES = np.minimum(np.arange(31)[:, None], np.arange(31)) @ DEMAND
LEVEL, SEASON = np.divmod(np.arange(60), 4)
SWING = np.array([1.0, 0.6, -0.8, -0.8])
CARS = np.arange(294) // 7 % 7, np.arange(294) % 7
RATES = np.array([[0.2, 0.3, 0.7, 0.3, 0.2, 0.2], [0.2, 0.2, 0.2, 0.3, 0.6, 0.3]])
X, Y = np.divmod(np.arange(81), 9)


def from_tables(
    about: str, tables: tuple[Array, Array], rewards: Array, discount: float
) -> Family:
    """Make a family of the simulator's and the target's probabilities (S, A, S)."""
    simulator = FiniteMDP(
        tables[0], rewards, np.full(len(rewards), 1 / len(rewards)), discount
    )
    return pair(about, simulator, tables[1])


def miss(family: Family) -> float:
    """Compute by how much the true value is above the simulator's."""
    return family.truth - policy_value(family.simulator, family.policy)


def match_value(
    family_at: Callable[[float], Family], low: float, high: float
) -> Family:
    """Find the family at the parameter where the simulator's value is right by luck.

    The parameter lies in [low, high].
    """
    parameter = optimize.brentq(
        lambda parameter: miss(family_at(parameter)), low, high, xtol=1e-3
    )
    return family_at(parameter)


def draw_garnet(
    rng: np.random.Generator,
    n_states: int = 40,
    n_actions: int = 3,
    n_successors: int = 5,
) -> Array:
    """Draw random probabilities (S, A, S).

    Each state-action pair leads to ``n_successors`` random states with uniform
    Dirichlet probabilities.
    """
    table = np.zeros((n_states, n_actions, n_states))
    for s, a in np.ndindex(n_states, n_actions):
        table[s, a, rng.permutation(n_states)[:n_successors]] = rng.dirichlet(
            np.ones(n_successors)
        )
    return table


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


def blend_with_stranger(rng: np.random.Generator) -> Family:
    """Make a Garnet into which another one is mixed."""
    mine = draw_garnet(rng)
    other = draw_garnet(rng)
    rewards = rng.normal(size=(40, 3))
    about = (
        "Three in ten transitions follow another MDP; simulated, one in twenty does."
    )
    return from_tables(
        about, (0.95 * mine + 0.05 * other, 0.7 * mine + 0.3 * other), rewards, 0.95
    )


def coupled_maintenance(
    s: IntArray, action: IntArray, base: float, load: float
) -> Moves:
    """Return the transitions of two parts with wear 0 to 7.

    The bits of the action say which parts are repaired.
    """

    def wear(part: IntArray, is_repaired: IntArray, rate: Array) -> Array:
        """Return the distribution of the next wear of one part."""
        k = np.arange(8)
        new = 0.95 * is_repaired
        old = np.where(is_repaired, 0.05, 1.0)
        law = (
            new * (1 - rate) * (k == 0)
            + new * rate * (k == 1)
            + old * (1 - rate) * (k == part)
        )
        return np.asarray(law + old * rate * (k == np.minimum(part + 1, 7)))

    one, two = np.divmod(s, 8)
    laws = (
        wear(one, action & 1, base + load * two / 7),
        wear(two, action // 2, base + load * one / 7),
    )
    return [(cross(*laws), np.arange(64))]


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


def low_rank(rng: np.random.Generator) -> Family:
    """Make a family whose rows are mixtures of four laws."""
    weights = rng.dirichlet(np.full(4, 0.5), (60, 3))
    factors = rng.dirichlet(np.ones(60), 4)
    changed = factors.copy()
    changed[:2] = normalize(changed[:2] * rng.gamma(2.0, size=(2, 60)))
    about = "Rows are mixtures of four laws, two of which are wrong in the simulator."
    return from_tables(
        about, (weights @ factors, weights @ changed), rng.normal(size=(60, 3)), 0.95
    )


def lucky_garnet(rng: np.random.Generator) -> Family:
    """Make a Garnet tilted along V, up in half of the states and down elsewhere."""
    table = draw_garnet(rng)
    rewards = rng.normal(size=(40, 3))
    better = rng.random(40) < 0.5
    simulator = FiniteMDP(table, rewards, np.full(40, 1 / 40), 0.95)
    z = stats.zscore(state_values(simulator, optimal_policy(simulator)))
    about = (
        "Half of the states are better and half worse than simulated, which cancels by"
        " luck."
    )

    def family_at(loss: float) -> Family:
        """Return the family whose worse states lose this much."""
        real = normalize(
            table * np.exp(np.where(better, 0.6, -loss)[:, None, None] * z)
        )
        return from_tables(about, (table, real), rewards, 0.95)

    # They are drawn again where the states drawn to be worse matter too little.
    while miss(family_at(5.0)) > 0.0:
        better = rng.random(40) < 0.5
    return match_value(family_at, 0.0, 5.0)


def lucky_queue(rng: np.random.Generator) -> Family:
    """Make a queue of 0 to 29 jobs with slow or fast service."""
    arrival = rng.uniform(0.34, 0.4)
    about = "Fewer arrivals and slower service than simulated, which cancel by luck."
    cost = -0.1 * np.arange(30.0)[:, None] - np.array([0.0, 0.4])

    def moves(jobs: IntArray, fast: IntArray, arrival: float, factor: float) -> Moves:
        """Return the transitions of the queue."""
        done = np.where(jobs > 0, factor * np.where(fast, 0.7, 0.5), 0.0)
        up = arrival * (1 - done)
        down = (1 - arrival) * done
        return (up, jobs + 1), (down, jobs - 1), (1 - up - down, jobs)

    def family_at(factor: float) -> Family:
        """Return the family whose service is this factor of the simulated one."""
        return shift(
            about, (30, 2), cost, 0.97, (0.45, 1.0), (arrival, factor), moves
        )()

    return match_value(family_at, 0.3, 1.0)


def portfolio_tails(wealth: IntArray, action: IntArray, law: Array) -> Moves:
    """Return the transitions of wealth from 0 (broke) to 40 on a logarithmic scale.

    Nothing, half or all of it is at risk.
    """
    after = wealth + np.round(0.5 * action * RETURNS).astype(int)
    return (0.8 * law, after), (0.2 * law, after - 1)


def predator_prey(
    s: IntArray, action: IntArray, growth: float, death: float, bite: float
) -> Moves:
    """Return the transitions of 0 to 11 prey and 0 to 7 predators.

    Harvests are 0, 1 and 3 prey.
    """
    hunters = HUNTERS[s]
    left = np.maximum(PREY[s] - HARVESTS[action], 0)
    mean = np.maximum(
        0.3 + left * (1 + growth * (1 - left / 11)) - bite * left * hunters, 0.1
    )
    more = 0.2 + (1 - death) * hunters + 0.4 * bite * left * hunters
    return [(cross(poisson(mean, 11), poisson(more, 7)), np.arange(96))]


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


def reservoir(rng: np.random.Generator) -> Family:
    """Make a reservoir of levels 0 to 14 in four seasons.

    Releases are 0 to 3.
    """
    rewards = (
        np.sqrt(np.minimum(LEVEL[:, None], np.arange(4)))
        * np.array([1.0, 0.8, 1.2, 1.5])[SEASON][:, None]
    )
    rewards -= np.select([LEVEL == 14, LEVEL == 0], [2.0, 3.0])[:, None]
    swing = rng.uniform(0.8, 1.1) * SWING
    about = "Seasons differ more than simulated, with the same inflow a year."

    def moves(s: IntArray, action: IntArray, inflows: Array) -> Moves:
        """Return the transitions of level and season."""
        left = np.maximum(LEVEL[s] - action, 0)
        return [
            (
                poisson(inflows[SEASON[s]], 14),
                np.minimum(left + np.arange(15), 14) * 4 + (SEASON[s] + 1) % 4,
            )
        ]

    return shift(
        about, (60, 4), rewards, 0.97, (1.7 + 0.2 * swing,), (1.7 + swing,), moves
    )()


def router_fault(rng: np.random.Generator) -> Family:
    """Make a network of 40 nodes with three links each, one of which fails.

    Node 0 gives a reward and sends the packet anywhere.
    """
    links = np.array([rng.permutation(40)[:3] for _ in range(40)])
    busiest = 1 + int(np.bincount(links.ravel(), minlength=40)[1:].argmax())
    about = "The busiest node loses most packets; the others are as simulated."
    real = (rng.uniform(0.1, 0.25),)

    def moves(node: IntArray, link: IntArray, works: float) -> Moves:
        """Return the transitions of a packet."""
        p = np.where(node == busiest, works, 0.9)
        goes = node > 0
        yield goes * p, links[node, link]
        yield goes * (0.9 * (1 - p)), node
        yield goes * (0.1 * (1 - p) / 3), links[node[:, :, 0]]
        yield (node == 0) / 40, np.arange(40)

    rewards = np.append(5.0, -np.ones(39))
    return shift(about, (40, 3), rewards, 0.96, (0.9,), real, moves, recorded=0.7)()


def scattered_points(rng: np.random.Generator) -> Family:
    """Make a family on 200 points of the unit square.

    Actions are up, left and right.
    """
    points = rng.random((200, 2))
    ways = 0.15 * np.array([[0, 1], [-1, 0], [1, 0]])

    def scatter(width: float, on_the_right: float) -> Array:
        """Return the probabilities (S, A, S) of steps of this width."""
        strength = np.where(points[:, 0] > 0.5, on_the_right, 1.0)
        centers = points[:, None] + ways * strength[:, None, None]
        return normalize(
            (1 + ((centers[:, :, None] - points) ** 2).sum(axis=3) / width**2) ** -4
        )

    rewards = np.exp(-((points - 0.8) ** 2).sum(axis=1) / 0.05)
    about = (
        "Steps scatter more than simulated and are weaker on the right; each may lead"
        " to any of 200 points."
    )
    return from_tables(
        about, (scatter(0.12, 1.0), scatter(rng.uniform(0.15, 0.2), 0.4)), rewards, 0.93
    )


def traffic_hours(s: IntArray, green: IntArray, north: Array, west: Array) -> Moves:
    """Return the transitions of two queues of cars over six hours.

    The queues from north and west have 0 to 6 cars; the action says who has green.
    """
    hour = s // 49
    both = np.arange(49)

    def queue(waiting: IntArray, is_green: IntArray, rate: Array) -> Array:
        """Return the distribution of the next length of one queue."""
        leave = np.asarray(stats.binom.pmf(np.arange(3), 2, 0.85 * is_green))
        come = np.asarray(stats.binom.pmf(np.arange(3), 2, rate))
        law = cross(leave, come)
        served, new = np.divmod(np.arange(9), 3)
        after = np.minimum(np.maximum(waiting - served, 0) + new, 6)
        lengths = [
            sum(law[..., k] * (after[..., k] == n) for k in range(9)) for n in range(7)
        ]
        return np.stack(lengths, axis=-1)

    law = cross(
        queue(CARS[0][s], 1 - green, north[hour]), queue(CARS[1][s], green, west[hour])
    )
    return (0.75 * law, 49 * hour + both), (0.25 * law, 49 * ((hour + 1) % 6) + both)


def two_motors(s: IntArray, action: IntArray, wear: float, overshoots: float) -> Moves:
    """Return the transitions on a table of 9 x 9 places, over 40 steps.

    Each motor moves by -1, 0 or 1.
    """

    def place(at: IntArray, way: IntArray, fails: Any, overshoots: float) -> Array:
        """Return the distribution of the next place along one axis."""
        # A motor that is asked to move goes 0, 1 or 2 places; at rest it drifts.
        shares = [
            np.where(way, fails, 0.03),
            np.where(way, 1 - fails - overshoots, 0.94),
            np.where(way, overshoots, 0.03),
        ]
        after = [np.clip(at + np.where(way, k * way, k - 1), 0, 8) for k in range(3)]
        parts = [p * (to == np.arange(9)) for p, to in zip(shares, after, strict=True)]
        return np.asarray(sum(parts))

    one = place(X[s], action // 3 - 1, 0.1 + wear * X[s] / 8, 0.05)
    return [(cross(one, place(Y[s], action % 3 - 1, 0.1, overshoots)), np.arange(81))]


def web_pages(rng: np.random.Generator) -> Family:
    """Make 120 pages with two sets of four links.

    A reader may go to any page.
    """
    links = draw_garnet(rng, 120, 2, 4)
    rewards = rng.normal(size=120)
    popular = 1 / (1 + rng.permutation(120))
    jump = rng.uniform(0.3, 0.4)
    real = (1 - jump) * links + jump * normalize(popular)
    about = "Readers leave the links more often than simulated, and for popular pages."
    return from_tables(about, (0.85 * links + 0.15 / 120, real), rewards, 0.9)


FAMILIES: dict[str, Maker] = {
    "blackjack": shift(
        "High cards are rarer and middle ones more frequent than simulated.",
        (203, 2),
        OUTCOME,
        0.99,
        (DECK,),
        draw_deck,
        blackjack,
        start=range(20, 150),
        ends=range(200, 203),
    ),
    "blend_with_stranger": blend_with_stranger,
    "coupled_maintenance": shift(
        "A worn part wears out the other one; simulated, they wear independently.",
        (64, 4),
        (4 - 0.08 * (ONE**2 + TWO**2))[:, None] - np.array([0.0, 1.5, 1.5, 2.5]),
        0.96,
        (0.3, 0.0),
        lambda rng: (0.2, rng.uniform(0.3, 0.5)),
        coupled_maintenance,
        recorded=0.8,
    ),
    "epidemic_superspreading": shift(
        "A few infect many others: new infections have the simulated mean and a far"
        " larger variance.",
        (31, 3),
        -0.2 * np.arange(31.0)[:, None] - np.array([0.0, 0.8, 2.0]),
        0.95,
        (1000.0,),
        lambda rng: (rng.uniform(0.5, 1.0),),
        epidemic_superspreading,
        start=range(1, 8),
    ),
    "insurance_claims": shift(
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
    ),
    "low_rank": low_rank,
    "lucky_garnet": lucky_garnet,
    "lucky_queue": lucky_queue,
    "portfolio_tails": shift(
        "Returns have the heavy tails of Student's t; simulated, they are normal.",
        (41, 3),
        np.log1p(np.arange(41.0)),
        0.96,
        (stats.norm(0.5, 3.0).pdf(RETURNS),),
        lambda rng: (stats.t(rng.uniform(2, 3), 0.5, 1.7).pdf(RETURNS),),
        portfolio_tails,
        start=range(10, 31),
        ends=[0],
    ),
    "predator_prey": shift(
        "Growth, death and hunting all differ from the simulator's.",
        (96, 3),
        np.minimum(PREY[:, None], HARVESTS) ** 0.7 - 0.05 * HUNTERS[:, None],
        0.95,
        (0.8, 0.5, 0.06),
        lambda rng: (
            rng.uniform(0.5, 0.7),
            rng.uniform(0.3, 0.4),
            rng.uniform(0.05, 0.08),
        ),
        predator_prey,
    ),
    # The states are ten weeks with a stock of 0 to 15; there are four prices.
    "pricing": shift(
        "More customers come than simulated, and high prices deter more of them.",
        (176, 4),
        PRICES[:, None] * np.maximum(STOCK[:, None] - STOCK, 0)[:, None, :],
        0.99,
        (3.5, 0.8),
        lambda rng: (rng.uniform(4.0, 5.0), rng.uniform(1.1, 1.5)),
        lambda s, a, base, elasticity: [
            (
                poisson(base * np.exp(-elasticity * (PRICES[a] - 1)), s % 16),
                s + 16 - np.arange(16),
            )
        ],
        start=range(8, 16),
        ends=range(160, 176),
    ),
    "random_yield": shift(
        "A batch succeeds or fails as a whole, with the simulated mean.",
        (31, 4),
        (2 * SALES - 0.1 * np.arange(31))[:, None]
        - 0.3 * BATCHES
        - 0.5 * (BATCHES > 0),
        0.96,
        (1e4,),
        lambda rng: (rng.uniform(0.5, 1.0),),
        random_yield,
    ),
    "reservoir": reservoir,
    "router_fault": router_fault,
    "scattered_points": scattered_points,
    "traffic_hours": shift(
        "One rush hour comes later than simulated, and more cars come from the west.",
        (294, 2),
        -0.2 * (CARS[0] + CARS[1]),
        0.95,
        RATES,
        lambda rng: (np.roll(RATES[0], 1), RATES[1] + rng.uniform(0.1, 0.2)),
        traffic_hours,
    ),
    "two_motors": shift(
        "One motor fails the more often the farther out it is, and the other one"
        " overshoots.",
        (81, 9),
        -np.hypot(X - 6, Y - 2) / 4,
        0.95,
        (0.0, 0.05),
        lambda rng: (rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.3)),
        two_motors,
        horizon=40,
    ),
    "web_pages": web_pages,
}
