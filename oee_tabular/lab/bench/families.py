"""Families of the package by name, and which of them were kept aside."""

from __future__ import annotations

from collections.abc import Mapping

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.lab.bench.families_chains import CHAINS
from oee_tabular.lab.bench.families_garnets import GARNETS, LARGE_GARNETS
from oee_tabular.lab.bench.families_grids import FLOORS, TOY_TEXT, one_way_grid
from oee_tabular.lab.bench.families_measured import (
    MISSING_ICU,
    icu_file,
    icu_sepsis,
    real_buses,
)
from oee_tabular.lab.bench.families_shifts import FAMILIES as SHIFTS
from oee_tabular.lab.bench.families_stocks import STOCKS, tandem
from oee_tabular.lab.bench.families_trades import TRADES
from oee_tabular.lab.bench.family import check_seed
from oee_tabular.lab.bench.mapping import Families
from oee_tabular.lab.bench.shift import Maker

MADE: Mapping[str, Maker] = {
    **STOCKS,
    **CHAINS,
    **FLOORS,
    **GARNETS,
    **TOY_TEXT,
    "icu_sepsis": icu_sepsis,
    **TRADES,
    "one_way_grid": one_way_grid,
    **SHIFTS,
    "rust_buses": real_buses,
}
LARGE: Mapping[str, Maker] = {"tandem45": lambda: tandem(45), **LARGE_GARNETS}
HELD = (  # whose results nobody saw while the default was chosen
    "blend_with_stranger",
    "epidemic_superspreading",
    "low_rank",
    "lucky_queue",
    "predator_prey",
    "random_yield",
    "router_fault",
    "traffic_hours",
    "web_pages",
)
REAL = ("rust_buses",)  # whose simulator and target are both measured


@suggest_keywords
def families(seed: int = 0, *, large: bool = False) -> Families:
    """Return the families of environment shift of the benchmark.

    Parameters
    ----------
    seed : int, default 0
        Seed from 0. Random parts of a family (as those of the Garnets) differ between
        seeds.
    large : bool, default False
        Whether those are there that a run must name: ``tandem45``, which takes seconds
        a log, and ``garnet_worse`` with 10, 20, 80 and 160 states.

    Returns
    -------
    Families
        Name -> Family, made when it is looked up. ``icu_sepsis`` needs the extra
        ``bench``; without it ``left_out`` says so.

    Raises
    ------
    ValueError
        If the seed is no integer from 0, or ``large`` is no bool.

    See Also
    --------
    run : Measures estimators on these families.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> every = oee.bench.families()
    >>> len(every) > 34, every["inventory20"].about
    (True, 'Customers ask for more than simulated.')
    >>> oee.bench.families(1)["garnet_worse"].truth == every["garnet_worse"].truth
    False
    """
    _checks.boolean(large, "large")
    makers = {**MADE, **LARGE} if large else dict(MADE)
    left_out = {}
    if icu_file() is None:
        del makers["icu_sepsis"]
        left_out["icu_sepsis"] = MISSING_ICU
    return Families(makers, check_seed(seed), left_out)
