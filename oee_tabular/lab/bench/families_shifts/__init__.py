"""Families whose targets differ in several numbers, or in the shape of a distribution.

Other kinds are changes at one place, effects that depend on the state, seasons, heavy
tails, mixtures with another MDP, low rank, hundreds of successors, and simulators that
are right by luck. Each family draws its parameters from a generator.
"""

from __future__ import annotations

from oee_tabular.lab.bench.families_shifts.effects import (
    COUPLED_MAINTENANCE,
    PREDATOR_PREY,
    PRICING,
    TRAFFIC_HOURS,
    TWO_MOTORS,
    reservoir,
    router_fault,
)
from oee_tabular.lab.bench.families_shifts.luck import (
    lucky_garnet,
    lucky_queue,
)
from oee_tabular.lab.bench.families_shifts.shapes import (
    BLACKJACK,
    EPIDEMIC_SUPERSPREADING,
    INSURANCE_CLAIMS,
    PORTFOLIO_TAILS,
    RANDOM_YIELD,
)
from oee_tabular.lab.bench.families_shifts.tables import (
    blend_with_stranger,
    low_rank,
    scattered_points,
    web_pages,
)
from oee_tabular.lab.bench.shift import Maker

FAMILIES: dict[str, Maker] = {
    "blackjack": BLACKJACK,
    "blend_with_stranger": blend_with_stranger,
    "coupled_maintenance": COUPLED_MAINTENANCE,
    "epidemic_superspreading": EPIDEMIC_SUPERSPREADING,
    "insurance_claims": INSURANCE_CLAIMS,
    "low_rank": low_rank,
    "lucky_garnet": lucky_garnet,
    "lucky_queue": lucky_queue,
    "portfolio_tails": PORTFOLIO_TAILS,
    "predator_prey": PREDATOR_PREY,
    "pricing": PRICING,
    "random_yield": RANDOM_YIELD,
    "reservoir": reservoir,
    "router_fault": router_fault,
    "scattered_points": scattered_points,
    "traffic_hours": TRAFFIC_HOURS,
    "two_motors": TWO_MOTORS,
    "web_pages": web_pages,
}
