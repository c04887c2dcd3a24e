"""The families by name, made when they are looked up."""

from __future__ import annotations

import difflib
import functools
import hashlib
import inspect
from collections.abc import Iterator, Mapping

import numpy as np

from oee_tabular import _checks
from oee_tabular.lab.bench import families_chains as chains
from oee_tabular.lab.bench import families_grids as grids
from oee_tabular.lab.bench.families_shifts import FAMILIES as SHIFTS
from oee_tabular.lab.bench.family import Family, Maker, check_seed

TABLES = (
    chains.FIRST,
    grids.FLOORS,
    grids.GARNETS,
    grids.TABLES,
    chains.TRADES,
    {"one_way_grid": grids.one_way_grid},
    SHIFTS,
)
MADE: Mapping[str, Maker] = {name: make for table in TABLES for name, make in table.items()}
LARGE: Mapping[str, Maker] = {"tandem45": lambda: chains.tandem(45), **grids.LARGE_GARNETS}
HELD = (  # whose results nobody saw while the default was chosen
    "blend_with_stranger", "epidemic_superspreading", "low_rank", "lucky_queue", "predator_prey", "random_yield",
    "router_fault", "traffic_hours", "web_pages",
)  # fmt: skip


class Families(Mapping[str, Family]):
    """Families by name, each made when it is first looked up, from random numbers of its own.

    Parameters
    ----------
    makers : name -> function of a generator, or without parameters, that makes the family
    seed : int from 0
    left_out : name -> a sentence that says why it is not there

    Attributes
    ----------
    seed, left_out

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mine = Families({"grid": lambda: oee.bench.families()["floor_motor"]}, seed=0, left_out={})
    >>> list(mine), mine["grid"].about
    (['grid'], 'One of the four motors is weak.')
    """

    def __init__(self, makers: Mapping[str, Maker], seed: int, left_out: Mapping[str, str]):
        self._makers, self._made = dict(makers), dict[str, Family]()
        self.seed, self.left_out = seed, dict(left_out)

    def __getitem__(self, name: str) -> Family:
        if name not in self._makers:
            raise KeyError(self.missing(name))
        if name not in self._made:
            self._made[name] = self._make(name)
        return self._made[name]

    def __contains__(self, name: object) -> bool:
        return name in self._makers

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)

    def __repr__(self) -> str:
        return f"Families(seed {self.seed}: {', '.join(self._makers)})"

    def missing(self, name: str) -> str:
        """Why ``name`` is not among the families, and which are near."""
        if name in self.left_out:
            return self.left_out[name]
        near = difflib.get_close_matches(str(name), list(self._makers), n=3, cutoff=0.4)
        hint = f"; nearest: {', '.join(near)}" if near else ""
        return f"family must be one of {', '.join(self._makers)}; got {_checks.show(name)}{hint}"

    def _make(self, name: str) -> Family:
        maker = self._makers[name]
        words = np.frombuffer(hashlib.sha256(name.encode()).digest()[:16], dtype=">u4")  # of the name alone
        try:
            if not inspect.signature(maker).parameters:
                return _make_fixed(maker)
            return maker(np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=words.tolist())))
        except ValueError as error:
            raise ValueError(f"family {name!r}: {error}") from error


@functools.lru_cache(maxsize=64)
def _make_fixed(maker: Maker) -> Family:
    """A family without random parts: made once a process, whatever the seed."""
    return maker()


def families(seed: int = 0, *, large: bool = False) -> Families:
    """The families of environment shift of the benchmark.

    Parameters
    ----------
    seed : int from 0; the random parts of a family (the Garnets) differ between seeds
    large : whether those are there that a run must name: ``tandem45``, which takes seconds a log, and ``garnet_worse`` with
        10, 20, 80 and 160 states

    Returns
    -------
    Families
        name -> Family, made when it is looked up. ``icu_sepsis`` needs the extra ``bench``; without it ``left_out`` says so.

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
    left_out = {} if grids.icu_file() else {"icu_sepsis": grids.MISSING_ICU}
    makers = {name: make for name, make in ({**MADE, **LARGE} if large else MADE).items() if name not in left_out}
    return Families(makers, check_seed(seed), left_out)
