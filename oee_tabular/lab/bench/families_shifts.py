"""Families whose targets differ in more than one number: several parameters, the shape of a distribution, one place.

Other kinds: effects that depend on the state, seasons, heavy tails, mixtures with another MDP, low rank, hundreds of
successors, simulators that are right by luck. Each draws its parameters from a generator.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import optimize, stats

from oee_tabular._checks import Array
from oee_tabular.exact import optimal_policy, policy_value, state_values
from oee_tabular.lab.bench.family import Family, Moves, pair, poisson, shifted, spread
from oee_tabular.mdp import FiniteMDP


def from_tables(about: str, tables: tuple[Array, Array], rewards: Array, discount: float) -> Family:
    """A family from the simulator's and the target's probabilities, (S, A, S)."""
    simulator = FiniteMDP(tables[0], rewards, spread(len(rewards), slice(None)), discount)
    return pair(simulator, simulator.with_transitions(tables[1]), about)


def miss(family: Family) -> float:
    """By how much the true value is above the simulator's."""
    return family.truth - policy_value(family.simulator, family.policy)


def match_value(family_at: Callable[[float], Family], low: float, high: float) -> Family:
    """The family at the parameter in [low, high] where the simulator's value is right by luck."""
    return family_at(optimize.brentq(lambda parameter: miss(family_at(parameter)), low, high, xtol=1e-3))


def normalize(table: Array) -> Array:
    """Rows along the last axis that sum to 1."""
    return np.asarray(table / table.sum(axis=-1, keepdims=True))


def draw_garnet(rng: np.random.Generator, n_states: int = 40, n_actions: int = 3, n_successors: int = 5) -> Array:
    """(S, A, S) of random rows: ``n_successors`` random states with uniform Dirichlet probabilities."""
    table = np.zeros((n_states, n_actions, n_states))
    for s, a in np.ndindex(n_states, n_actions):
        table[s, a, rng.permutation(n_states)[:n_successors]] = rng.dirichlet(np.ones(n_successors))
    return table


def blackjack(rng: np.random.Generator) -> Family:
    """Own total 2 to 21, dealer's card 1 to 10, aces count 1; then lost, even, won; draw or stand."""

    def moves(s: int, stand: int, cards: Array) -> Moves:
        total, shown = s // 10 + 2, s % 10 + 1
        if s >= 200:
            return []
        if not stand:
            return [(p, 200 if total + card > 21 else s + 10 * card) for card, p in enumerate(cards, 1)]
        dealer = np.eye(32)[shown]
        for t in range(1, 17):
            dealer[t + 1 : t + 11] += dealer[t] * cards
        return [(dealer[t], 202 if t > 21 or t < total else 201 if t == total else 200) for t in range(17, 27)]

    deck = np.append(np.ones(9), 4.0) / 13
    real = deck * np.repeat([1.0, rng.uniform(1.4, 1.9), 1.0, rng.uniform(0.4, 0.7)], [4, 2, 3, 1])
    rewards = np.zeros((203, 2, 203))
    rewards[:200, :, 200], rewards[:200, :, 202] = -1.0, 1.0
    about = "High cards are rarer and middle ones more frequent than simulated."
    return shifted(moves, (203, 2), rewards, 0.99, (deck,), (normalize(real),), about, start=range(20, 150))


def blend_with_stranger(rng: np.random.Generator) -> Family:
    """A Garnet and another one that is mixed into it."""
    mine, other, rewards = draw_garnet(rng), draw_garnet(rng), rng.normal(size=(40, 3))
    about = "Three in ten transitions follow another MDP; simulated, one in twenty does."
    return from_tables(about, (0.95 * mine + 0.05 * other, 0.7 * mine + 0.3 * other), rewards, 0.95)


def coupled_maintenance(rng: np.random.Generator) -> Family:
    """Two parts with wear 0 to 7; the action's bits say which are repaired."""

    def wear_distribution(wear: int, repaired: int, rate: float) -> Array:
        law = np.zeros(8)
        for before, p in ((0, 0.95), (wear, 0.05)) if repaired else ((wear, 1.0),):
            law[before] += p * (1 - rate)
            law[min(before + 1, 7)] += p * rate
        return law

    def moves(s: int, action: int, base: float, load: float) -> Moves:
        one, two = divmod(s, 8)
        rates = base + load * two / 7, base + load * one / 7
        laws = wear_distribution(one, action & 1, rates[0]), wear_distribution(two, action & 2, rates[1])
        return zip(np.outer(*laws).ravel(), range(64), strict=True)

    one, two = np.divmod(np.arange(64), 8)
    rewards = (4 - 0.08 * (one**2 + two**2))[:, None] - np.array([0.0, 1.5, 1.5, 2.5])
    real = 0.2, rng.uniform(0.3, 0.5)
    about = "A worn part wears out the other one; simulated, they wear independently."
    return shifted(moves, (64, 4), rewards, 0.96, (0.3, 0.0), real, about, recorded=0.8)


def epidemic_superspreading(rng: np.random.Generator) -> Family:
    """0 to 30 infected; open, distance, closed."""

    def moves(infected: int, action: int, dispersion: float) -> Moves:
        mean = 0.3 + (0.45, 0.28, 0.15)[action] * infected * (1 - infected / 45)
        new = stats.nbinom.pmf(np.arange(200), dispersion, dispersion / (dispersion + mean))
        still_ill = stats.binom.pmf(np.arange(infected + 1), infected, 0.7)
        return [(p, min(count, 30)) for count, p in enumerate(np.convolve(new, still_ill))]

    rewards = -0.2 * np.arange(31.0)[:, None] - np.array([0.0, 0.8, 2.0])
    real = (rng.uniform(0.5, 1.0),)
    about = "A few infect many others: new infections have the simulated mean and a far larger variance."
    return shifted(moves, (31, 3), rewards, 0.95, (1000.0,), real, about, start=range(1, 8))


def insurance_claims(rng: np.random.Generator) -> Family:
    """Capital 0 (ruin) to 49; claims of 1 to 60, of which all, half or a quarter is kept."""
    sizes = np.arange(1, 61)

    def distribution_of_mean_5(weights: Callable[[float], Any], low: float, high: float) -> Array:
        return normalize(weights(optimize.brentq(lambda x: normalize(weights(x)) @ sizes - 5, low, high)))

    def moves(capital: int, action: int, claims: Array, frequency: float) -> Moves:
        income = min(capital + (3, 2, 1)[action], 49)
        after = np.maximum(income - np.ceil(sizes * (1.0, 0.5, 0.25)[action]).astype(int), 0)
        return [(1 - frequency, income), *zip(frequency * claims, after, strict=True)] if capital else []

    thin, heavy = (
        distribution_of_mean_5(lambda x: x**sizes, 0.5, 0.99),
        distribution_of_mean_5(lambda x: sizes**-x, 1.01, 4.0),
    )
    real = heavy, rng.uniform(0.38, 0.45)
    about, rewards = "Claims have a heavy tail at the simulated mean.", np.sqrt(np.arange(50.0))
    return shifted(moves, (50, 3), rewards, 0.97, (thin, 0.4), real, about, start=range(10, 41))


def low_rank(rng: np.random.Generator) -> Family:
    """Rows are mixtures of four laws."""
    weights, factors = rng.dirichlet(np.full(4, 0.5), (60, 3)), rng.dirichlet(np.ones(60), 4)
    changed = factors.copy()
    changed[:2] = normalize(changed[:2] * rng.gamma(2.0, size=(2, 60)))
    about = "Rows are mixtures of four laws, two of which are wrong in the simulator."
    return from_tables(about, (weights @ factors, weights @ changed), rng.normal(size=(60, 3)), 0.95)


def lucky_garnet(rng: np.random.Generator) -> Family:
    """A Garnet tilted along V, up in half of the states and down in the others."""
    table, rewards, better = draw_garnet(rng), rng.normal(size=(40, 3)), rng.random(40) < 0.5
    simulator = FiniteMDP(table, rewards, np.full(40, 1 / 40), 0.95)
    z = stats.zscore(state_values(simulator, optimal_policy(simulator)))
    about = "Half of the states are better and half worse than simulated, which cancels by luck."

    def family_at(loss: float) -> Family:
        real = normalize(table * np.exp(np.where(better, 0.6, -loss)[:, None, None] * z))
        return from_tables(about, (table, real), rewards, 0.95)

    while miss(family_at(5.0)) > 0.0:  # the states drawn to be worse matter too little
        better = rng.random(40) < 0.5
    return match_value(family_at, 0.0, 5.0)


def lucky_queue(rng: np.random.Generator) -> Family:
    """0 to 29 jobs, slow or fast service."""

    def moves(jobs: int, fast: int, arrival: float, factor: float) -> Moves:
        done = factor * (0.5, 0.7)[fast] if jobs else 0.0
        up, down = arrival * (1 - done), (1 - arrival) * done
        return (up, min(jobs + 1, 29)), (down, max(jobs - 1, 0)), (1 - up - down, jobs)

    rewards = -0.1 * np.arange(30.0)[:, None] - np.array([0.0, 0.4])
    arrival, about = rng.uniform(0.34, 0.4), "Fewer arrivals and slower service than simulated, which cancel by luck."

    def family_at(factor: float) -> Family:
        return shifted(moves, (30, 2), rewards, 0.97, (0.45, 1.0), (arrival, factor), about)

    return match_value(family_at, 0.3, 1.0)


def portfolio_tails(rng: np.random.Generator) -> Family:
    """Wealth 0 (broke) to 40 on a logarithmic scale; nothing, half or all of it at risk."""
    returns = np.arange(-15, 16)

    def moves(wealth: int, action: int, law: Array) -> Moves:
        after = wealth + np.round((0.0, 0.5, 1.0)[action] * returns).astype(int)
        spent = [(share * law, (after - k).clip(0, 40)) for k, share in ((0, 0.8), (1, 0.2))]
        return [pair for p, where in spent for pair in zip(p, where, strict=True)] if wealth else []

    thin, heavy = stats.norm(0.5, 3.0).pdf(returns), stats.t(rng.uniform(2, 3), 0.5, 1.7).pdf(returns)
    about, rewards = (
        "Returns have the heavy tails of Student's t; simulated, they are normal.",
        np.log1p(np.arange(41.0)),
    )
    return shifted(moves, (41, 3), rewards, 0.96, (thin,), (heavy,), about, start=range(10, 31))


def predator_prey(rng: np.random.Generator) -> Family:
    """Prey 0 to 11, predators 0 to 7; harvests of 0, 1 and 3."""

    def moves(s: int, action: int, growth: float, death: float, bite: float) -> Moves:
        prey, hunters = divmod(s, 8)
        left = max(prey - (0, 1, 3)[action], 0)
        mean = max(0.3 + left * (1 + growth * (1 - left / 11)) - bite * left * hunters, 0.1)
        more = 0.2 + (1 - death) * hunters + 0.4 * bite * left * hunters
        return zip(np.outer(poisson(mean, 11), poisson(more, 7)).ravel(), range(96), strict=True)

    prey, hunters = np.divmod(np.arange(96), 8)
    rewards = np.minimum(prey[:, None], [0, 1, 3]) ** 0.7 - 0.05 * hunters[:, None]
    real = rng.uniform(0.5, 0.7), rng.uniform(0.3, 0.4), rng.uniform(0.05, 0.08)
    about = "Growth, death and hunting all differ from the simulator's."
    return shifted(moves, (96, 3), rewards, 0.95, (0.8, 0.5, 0.06), real, about)


def pricing(rng: np.random.Generator) -> Family:
    """Ten weeks, stock 0 to 15, four prices."""
    prices = np.array([1.0, 1.5, 2.0, 3.0])

    def moves(s: int, action: int, base: float, elasticity: float) -> Moves:
        week, stock = divmod(s, 16)
        demand = poisson(base * np.exp(-elasticity * (prices[action] - 1)), stock) if stock else [1.0]
        return [(p, s + 16 - sold) for sold, p in enumerate(demand)] if week < 10 else []

    stock = np.arange(176) % 16
    rewards = prices[:, None] * np.maximum(stock[:, None] - stock, 0)[:, None, :]
    real = rng.uniform(4.0, 5.0), rng.uniform(1.1, 1.5)
    about = "More customers come than simulated, and high prices deter more of them."
    return shifted(moves, (176, 4), rewards, 0.99, (3.5, 0.8), real, about, start=range(8, 16))


def random_yield(rng: np.random.Generator) -> Family:
    """Stock 0 to 30, batches of 0, 3, 6 and 10."""
    batches, demand = np.array([0, 3, 6, 10]), poisson(3.0, 30)

    def moves(stock: int, action: int, dispersion: float) -> Moves:
        good = np.arange(batches[action] + 1)
        law = stats.betabinom.pmf(good, batches[action], 0.7 * dispersion, 0.3 * dispersion) if action else [1.0]
        left = np.minimum(np.maximum(stock - np.arange(31), 0)[:, None] + good, 30)
        return zip(np.outer(demand, law).ravel(), left.ravel(), strict=True)

    sales = np.minimum(np.arange(31)[:, None], np.arange(31)) @ demand
    rewards = (2 * sales - 0.1 * np.arange(31))[:, None] - 0.3 * batches - 0.5 * (batches > 0)
    about, real = "A batch succeeds or fails as a whole, with the simulated mean.", (rng.uniform(0.5, 1.0),)
    return shifted(moves, (31, 4), rewards, 0.96, (1e4,), real, about)


def reservoir(rng: np.random.Generator) -> Family:
    """Level 0 to 14 in four seasons; releases of 0 to 3."""

    def moves(s: int, action: int, inflows: Array) -> Moves:
        level, season = divmod(s, 4)
        left, following = max(level - action, 0), (season + 1) % 4
        return [(p, min(left + inflow, 14) * 4 + following) for inflow, p in enumerate(poisson(inflows[season], 14))]

    level, season = np.divmod(np.arange(60), 4)
    rewards = np.sqrt(np.minimum(level[:, None], np.arange(4))) * np.array([1.0, 0.8, 1.2, 1.5])[season][:, None]
    rewards -= np.select([level == 14, level == 0], [2.0, 3.0])[:, None]
    swing = rng.uniform(0.8, 1.1) * np.array([1.0, 0.6, -0.8, -0.8])
    about = "Seasons differ more than simulated, with the same inflow a year."
    return shifted(moves, (60, 4), rewards, 0.97, (1.7 + 0.2 * swing,), (1.7 + swing,), about)


def router_fault(rng: np.random.Generator) -> Family:
    """40 nodes with three links each; node 0 pays and sends the packet anywhere."""
    links = np.array([rng.permutation(40)[:3] for _ in range(40)])
    busiest = 1 + int(np.bincount(links.ravel(), minlength=40)[1:].argmax())

    def moves(node: int, link: int, works: float) -> Moves:
        p = works if node == busiest else 0.9
        lost = [(0.1 * (1 - p) / 3, k) for k in links[node]]
        return [(p, links[node, link]), (0.9 * (1 - p), node), *lost] if node else [(1 / 40, k) for k in range(40)]

    about, real = "The busiest node loses most packets; the others are as simulated.", (rng.uniform(0.1, 0.25),)
    rewards = np.append(5.0, -np.ones(39))
    return shifted(moves, (40, 3), rewards, 0.96, (0.9,), real, about, recorded=0.7)


def scattered_points(rng: np.random.Generator) -> Family:
    """200 points of the unit square; up, left and right."""
    points, ways = rng.random((200, 2)), 0.15 * np.array([[0, 1], [-1, 0], [1, 0]])

    def scatter(width: float, on_the_right: float) -> Array:
        strength = np.where(points[:, 0] > 0.5, on_the_right, 1.0)
        centers = points[:, None] + ways * strength[:, None, None]
        return normalize((1 + ((centers[:, :, None] - points) ** 2).sum(axis=3) / width**2) ** -4)

    rewards = np.exp(-((points - 0.8) ** 2).sum(axis=1) / 0.05)
    about = "Steps scatter more than simulated and are weaker on the right; each may lead to any of 200 points."
    return from_tables(about, (scatter(0.12, 1.0), scatter(rng.uniform(0.15, 0.2), 0.4)), rewards, 0.93)


def traffic_hours(rng: np.random.Generator) -> Family:
    """Six hours, queues of 0 to 6 from north and west; who has green."""

    def queue_distribution(waiting: int, is_green: bool, rate: float) -> Array:
        law, leave = np.zeros(7), stats.binom.pmf(np.arange(3), 2, 0.85 * is_green)
        for (served, come), p in np.ndenumerate(np.outer(leave, stats.binom.pmf(np.arange(3), 2, rate))):
            law[min(max(waiting - served, 0) + come, 6)] += p
        return law

    def moves(s: int, green: int, north: Array, west: Array) -> Moves:
        hour, both = s // 49, np.arange(49)
        laws = (
            queue_distribution(s // 7 % 7, green == 0, north[hour]),
            queue_distribution(s % 7, green == 1, west[hour]),
        )
        law, later = np.outer(*laws).ravel(), 49 * ((hour + 1) % 6)
        return [*zip(0.75 * law, 49 * hour + both, strict=True), *zip(0.25 * law, later + both, strict=True)]

    rates = np.array([[0.2, 0.3, 0.7, 0.3, 0.2, 0.2], [0.2, 0.2, 0.2, 0.3, 0.6, 0.3]])
    real = np.roll(rates[0], 1), rates[1] + rng.uniform(0.1, 0.2)
    rewards = -0.2 * (np.arange(294) // 7 % 7 + np.arange(294) % 7)
    about = "One rush hour comes later than simulated, and more cars come from the west."
    return shifted(moves, (294, 2), rewards, 0.95, tuple(rates), real, about)


def two_motors(rng: np.random.Generator) -> Family:
    """A table of 9 x 9 places; each motor moves by -1, 0 or 1; 40 steps."""

    def place_distribution(place: int, way: int, fails: float, overshoots: float) -> Array:
        law = np.zeros(9)
        shares = (fails, 1 - fails - overshoots, overshoots) if way else (0.03, 0.94, 0.03)
        for k, p in enumerate(shares):
            law[min(max(place + (k * way if way else k - 1), 0), 8)] += p
        return law

    def moves(s: int, action: int, wear: float, overshoots: float) -> Moves:
        (x, y), (x_way, y_way) = divmod(s, 9), divmod(action, 3)
        laws = (
            place_distribution(x, x_way - 1, 0.1 + wear * x / 8, 0.05),
            place_distribution(y, y_way - 1, 0.1, overshoots),
        )
        return zip(np.outer(*laws).ravel(), range(81), strict=True)

    x, y = np.divmod(np.arange(81), 9)
    rewards, real = -np.hypot(x - 6, y - 2) / 4, (rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.3))
    about = "One motor fails the more often the farther out it is, and the other one overshoots."
    return shifted(moves, (81, 9), rewards, 0.95, (0.0, 0.05), real, about, horizon=40)


def web_pages(rng: np.random.Generator) -> Family:
    """120 pages with two sets of four links; a reader may go to any page."""
    links, rewards, popular = draw_garnet(rng, 120, 2, 4), rng.normal(size=120), 1 / (1 + rng.permutation(120))
    jump = rng.uniform(0.3, 0.4)
    real = (1 - jump) * links + jump * normalize(popular)
    about = "Readers leave the links more often than simulated, and for popular pages."
    return from_tables(about, (0.85 * links + 0.15 / 120, real), rewards, 0.9)


FAMILIES = (  # in the order of the alphabet
    blackjack, blend_with_stranger, coupled_maintenance, epidemic_superspreading, insurance_claims, low_rank, lucky_garnet,
    lucky_queue, portfolio_tails, predator_prey, pricing, random_yield, reservoir, router_fault, scattered_points,
    traffic_hours, two_motors, web_pages,
)  # fmt: skip
