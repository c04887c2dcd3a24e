"""Twenty-two kinds of environments that other families lack, redrawn by the seed.

Simulator and target are drawn anew for each seed. Each kind has two policies on one and
the same pair of models and the same recorded policy: a near one, and a far one (its
name ends in ``_far``).

Rules and constants of the interval were chosen on the kinds that ``SPLIT`` calls tuned.
The held ones were kept aside, and were run once when the choice was fixed.

================  ======================================================================
file              what is in it
================  ======================================================================
``kind``          ``Kind``: what a kind needs, its two policies, its name's generator
``draws``         how parameters are drawn
``coordinates``   states as places on grids
``places``        a windy floor, a patrol, a road, aisles, sailing
``queues``        callers, packets, jobs, bikes
``stores``        a battery, moisture, a depot and a shop, a warm room
``wear``          the engines of buses, sections of a road
``living``        doses of a drug, weeds, a pupil
``rounds``        an auction, a dialog, the game of pig
================  ======================================================================
"""

from collections.abc import Mapping

from oee_tabular.lab.bench.families_redrawn.kind import Kind
from oee_tabular.lab.bench.families_redrawn.living import (
    DOSING,
    TUTORING,
    WEEDS,
)
from oee_tabular.lab.bench.families_redrawn.places import (
    CROSSING,
    PATROL,
    SAILING,
    WAREHOUSE,
    WIND_COLUMNS,
)
from oee_tabular.lab.bench.families_redrawn.queues import (
    ADMISSION,
    BIKE_STATION,
    CALL_CENTRE,
    PACKET_ROUTING,
)
from oee_tabular.lab.bench.families_redrawn.rounds import (
    AUCTION,
    DIALOG,
    PIG,
)
from oee_tabular.lab.bench.families_redrawn.stores import (
    BATTERY,
    IRRIGATION,
    THERMOSTAT,
    TWO_ECHELON,
)
from oee_tabular.lab.bench.families_redrawn.wear import (
    BUS_ENGINES,
    BUS_MONTHS,
    ROAD_SECTIONS,
)

SPLIT: Mapping[str, str] = {
    "wind_columns": "tuned",
    "call_centre": "held",
    "patrol": "tuned",
    "battery": "held",
    "crossing": "tuned",
    "auction": "held",
    "irrigation": "held",
    "packet_routing": "tuned",
    "two_echelon": "tuned",
    "dialog": "held",
    "warehouse": "held",
    "dosing": "tuned",
    "bus_engines": "tuned",
    "bus_months": "tuned",
    "admission": "held",
    "weeds": "tuned",
    "bike_station": "held",
    "tutoring": "held",
    "thermostat": "tuned",
    "sailing": "held",
    "pig": "tuned",
    "road_sections": "held",
}
KINDS: Mapping[str, Kind] = {
    "wind_columns": WIND_COLUMNS,
    "call_centre": CALL_CENTRE,
    "patrol": PATROL,
    "battery": BATTERY,
    "crossing": CROSSING,
    "auction": AUCTION,
    "irrigation": IRRIGATION,
    "packet_routing": PACKET_ROUTING,
    "two_echelon": TWO_ECHELON,
    "dialog": DIALOG,
    "warehouse": WAREHOUSE,
    "dosing": DOSING,
    "bus_engines": BUS_ENGINES,
    "bus_months": BUS_MONTHS,
    "road_sections": ROAD_SECTIONS,
    "admission": ADMISSION,
    "weeds": WEEDS,
    "bike_station": BIKE_STATION,
    "tutoring": TUTORING,
    "thermostat": THERMOSTAT,
    "sailing": SAILING,
    "pig": PIG,
}
