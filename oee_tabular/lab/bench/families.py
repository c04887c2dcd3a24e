"""The families by name, made when they are looked up."""

from __future__ import annotations

import difflib
import functools
import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from oee_tabular import _checks
from oee_tabular.lab.bench import families_garnet as garnets
from oee_tabular.lab.bench import families_grids as grids
from oee_tabular.lab.bench import families_others as others
from oee_tabular.lab.bench import families_shifts as shifts
from oee_tabular.lab.bench import families_stock as stock
from oee_tabular.lab.bench.family import Family

HIGHER = "Customers ask for more than simulated."
LINE = (0.45, 0.5, 0.7)  # arrivals, slow and fast service of the simulated queue

MADE: Mapping[str, Callable[..., Family]] = {
    "inventory20": lambda: stock.inventory(4.0, 5.2, HIGHER),
    "inventory_slack": lambda: stock.inventory(4.0, 3.0, "Customers ask for less than simulated."),
    "inventory40": lambda: stock.inventory(7.0, 8.5, HIGHER, n_states=40, step=5, recorded="policy"),
    "inventory_identical": lambda: stock.inventory(4.0, 4.0, "The simulator of the stock is right."),
    "queue25": lambda: stock.queue(
        LINE, (0.55, 0.5, 0.7), "Jobs arrive more often than simulated.", recorded="uniform"
    ),
    "queue_slower": lambda: stock.queue(LINE, (0.45, 0.42, 0.6), "Service is slower than simulated."),
    "queue_identical": lambda: stock.queue(LINE, LINE, "The simulator of the queue is right.", recorded="policy"),
    "tandem9": lambda: stock.tandem(9),
    "machine": stock.machine,
    "forest12": stock.forest,
    "river_swim": stock.river_swim,
    "corridor30": stock.corridor,
    "mountain": stock.mountain,
    "paper_grid": lambda: grids.paper_grid(0.3, 0.1, "The paper's: moves slip less than simulated."),
    "paper_grid_reversed": lambda: grids.paper_grid(0.1, 0.3, "Moves slip more than simulated."),
    "floor_slippery": grids.slippery,
    "floor_motor": grids.motor,
    "floor_chequered": grids.chequered,
    "floor_wind": grids.wind,
    "floor_identical": grids.calm,
    "garnet_dirichlet100": garnets.changed(garnets.dirichlet(100.0), "Every row is a little off, at random."),
    "garnet_dirichlet10": garnets.changed(
        garnets.dirichlet(10.0), "Every row is far off, at random.", recorded="uniform"
    ),
    "garnet_replaced": garnets.changed(garnets.replaced, "A twentieth of the rows is wrong.", recorded="policy"),
    "garnet_worse": garnets.worse(40),
    "garnet_better": garnets.changed(
        garnets.along(0.25), "Every move is a little better than simulated, along V.", recorded="uniform"
    ),
    "garnet_one_action": garnets.changed(garnets.along(-0.5, action=0), "The moves of one action are worse."),
    "garnet_tempered": garnets.changed(garnets.tempered, "Moves are noisier than simulated.", recorded="policy"),
    "garnet_identical": garnets.identical,
    "frozen_lake": grids.frozen_lake,
    "taxi_rain": grids.taxi_rain,
    "cliff_walking": grids.cliff_walking,
    "icu_sepsis": others.icu_sepsis,
    "ageing_asset": others.ageing_asset,
    "epidemic": others.epidemic,
    "clinical_trial": others.clinical_trial,
    "parking": others.parking,
    "random_walk": others.random_walk,
    "sensors": others.sensors,
    "fishery": others.fishery,
    "traffic": others.traffic,
    "elevator": others.elevator,
    "gambler": others.gambler,
    "one_way_grid": grids.one_way_grid,
    **{make.__name__: make for make in shifts.FAMILIES},
}
HELD = tuple(make.__name__ for make in shifts.FAMILIES[1::2])  # whose results nobody saw while the default was chosen
LARGE: Mapping[str, Callable[..., Family]] = {
    "tandem45": lambda: stock.tandem(45),
    **{f"garnet_worse{n}": garnets.worse(n) for n in (10, 20, 80, 160)},
}


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

    def __init__(self, makers: Mapping[str, Callable[..., Family]], seed: int, left_out: Mapping[str, str]):
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
        try:
            if not inspect.signature(maker).parameters:
                return _fixed(maker)
            words = np.frombuffer(hashlib.sha256(name.encode()).digest()[:16], dtype=">u4")  # of the name alone
            return maker(np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=words.tolist())))
        except ValueError as error:
            raise ValueError(f"family {name!r}: {error}") from error


@functools.lru_cache(maxsize=64)
def _fixed(maker: Callable[[], Family]) -> Family:
    """A family without random parts: made once a process, whatever the seed."""
    return maker()


def check_seed(seed: object) -> int:
    """An integer from 0, or ValueError."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed must be an integer from 0; got {_checks.show(seed)}")
    return int(seed)


def families(seed: int = 0, *, large: bool = False) -> Families:
    """The families of environment shift of the benchmark.

    Parameters
    ----------
    seed : int from 0; what is random in a family (the Garnets) is another for each seed
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
    number = check_seed(seed)
    makers = dict(MADE) | (dict(LARGE) if large else {})
    left_out = {}
    if others.icu_file() is None:
        del makers["icu_sepsis"]
        left_out["icu_sepsis"] = others.MISSING_ICU
    return Families(makers, number, left_out)
