"""Families by name, made when they are looked up, and those on grids and random MDPs.

The grids are the paper's, floors of 8 x 8 cells whose slip differs by place or by
motor, and Gymnasium's toy text; there are also patients with sepsis. Garnets are random
MDPs, of which the simulator gets the probabilities wrong in several ways.
"""

from __future__ import annotations

import difflib
import functools
import hashlib
import importlib.util
import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import conform
from oee_tabular._sparse import csr_on_pattern, row_of_entry
from oee_tabular.exact import optimal_policy, state_values
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench import families_chains as chains
from oee_tabular.lab.bench.families_shifts import FAMILIES as SHIFTS
from oee_tabular.lab.bench.family import (
    Family,
    Maker,
    PairOptions,
    check_seed,
    normalize,
    pair,
    scale_rows,
)
from oee_tabular.mdp import FiniteMDP, mix, uniform_policy
from oee_tabular.tasks import bus_engines, gridworld, gridworld_policy, toy_text

SIMULATOR_SLIP = 0.15  # slip of the floors
# The policy acts as the expert in half of the steps; uniform actions record the target.
PAPER: PairOptions = {
    "policy": gridworld_policy(10, 0.5),
    "recorded": 0.0,
    "length": 1000,
}
ROW, COLUMN = np.indices((8, 8)).reshape(2, 64, 1)
IS_MIDDLE = (ROW >= 3) & (ROW < 6) & (COLUMN >= 3) & (COLUMN < 6)
MONTHS_PER_BUS = 117  # of group 4: each of its 37 buses was recorded as long
MISSING_ICU = (
    "icu_sepsis is left out: it needs the package icu-sepsis (in a clone: pip install"
    " '.[bench]')."
)


def floor(slip: Any = SIMULATOR_SLIP) -> FiniteMDP:
    """Make a floor of 8 x 8 cells, started anywhere.

    ``slip`` is a number, or one for each cell, or one for each (cell, action).
    """
    share = np.broadcast_to(np.asarray(slip, dtype=np.float64), (64, 4)).copy()
    share[-1] = 0.0
    always = gridworld(8, 1.0).transitions
    never = gridworld(8, 0.0).transitions
    transitions = (
        sparse.diags_array(share.ravel()) @ always
        + sparse.diags_array(1.0 - share.ravel()) @ never
    )
    return FiniteMDP(
        transitions,
        0.2 * (ROW + COLUMN - 14.0).ravel(),
        normalize(np.append(np.ones(63), 0.0)),
        0.98,
    )


def one_way_grid() -> Family:
    """Make the paper's grid from its corner, with a log of its expert alone.

    Much of what the policy does is never recorded.
    """
    simulator, target = (gridworld(6, slip, discount=0.97) for slip in (0.3, 0.15))
    family = pair(
        "Moves slip less than simulated, and the log shows one way only.",
        simulator,
        target,
        optimal=0.6,
    )
    narrow = pair(family.about, simulator, target, optimal=0.97).policy
    return Family(simulator, target, family.policy, narrow, family.about)


def real_buses() -> Family:
    """Make the family of Rust's bus engines, whose target is measured.

    The wear of group 3 simulates that of group 4. The log's engines are replaced as
    often as the recorded ones, by bin.
    """
    buses = bus_engines()
    return Family(
        buses.simulator,
        buses.target,
        buses.policy,
        buses.data_policy,
        "Other buses of the same company wear less than the simulated ones.",
        length=MONTHS_PER_BUS,
    )


def icu_file() -> Path | None:
    """Return the table that the package icu-sepsis ships, or None without it.

    The package need not be imported.
    """
    package = importlib.util.find_spec("icu_sepsis")
    if package is None or not package.submodule_search_locations:
        return None
    return (
        Path(package.submodule_search_locations[0]) / "envs" / "assets" / "dynamics.npz"
    )


def icu_sepsis() -> Family:
    """Make the family of patients with sepsis [1].

    Actions are five levels of the first drug; the second drug is given as the
    clinicians chose it. The discount is .99. In the target death is twice as likely and
    survival .7 times, with the rows scaled to sum to 1. The policy is the clinicians'
    levels.

    Reference: [1] K. Choudhary, D. Gupta, P. S. Thomas, ICU-Sepsis: a benchmark MDP
    built from real medical data, RLC 2024.
    """
    path = icu_file()
    if path is None:
        raise ImportError(MISSING_ICU)
    with np.load(path) as table:
        moves = table["tx_mat"]
        start = table["d_0"]
        chosen = table["expert_policy"]
    # 713 states are patients'; then come death, survival, and what follows.
    n_states = len(start)
    ends = slice(713, None)
    chosen = chosen.reshape(n_states, 5, 5)
    levels = chosen.sum(axis=2, keepdims=True)
    given = np.where(levels > 0, chosen / np.where(levels > 0, levels, 1.0), 0.2)
    averaged = np.einsum(
        "sab,sabt->sat", given, moves.reshape(n_states, 5, 5, n_states)
    )
    sicker = averaged.copy()
    sicker[:713, :, 713:715] *= [2.0, 0.7]
    rewards = np.zeros_like(averaged)
    rewards[:713, :, 714] = 1.0
    clinicians = levels[:, :, 0].copy()
    clinicians[ends] = 0.2
    clinicians = normalize(clinicians)
    simulator = FiniteMDP(normalize(averaged), rewards, start / start.sum(), 0.99)
    about = (
        "Patients are sicker than simulated: death is twice as likely, survival .7"
        " times."
    )
    return Family(
        simulator,
        simulator.with_transitions(normalize(sicker)),
        clinicians,
        mix(clinicians, uniform_policy(simulator), 0.5),
        about,
    )


def garnet(
    about: str,
    change: Callable[..., Any] | None = None,
    n_states: int = 40,
    recorded: float = 0.5,
) -> Maker:
    """Return a maker of Garnets, random MDPs of three actions.

    Each state-action pair leads to five random states with uniform Dirichlet
    probabilities, and r(s, a) is normal.

    Parameters
    ----------
    about : str
        One sentence that says what the simulator has wrong.
    change : callable, optional
        (p, row, z, rng) -> the target's weights of the simulator's transitions, which
        have the probabilities p; row is that of (s, a), z the next state's standardised
        value under the family's policy. None means no change.
    n_states : int, default 40
        Number of states.
    recorded : float, default 0.5
        The share of the policy in what records the target; the rest is uniform.
    """

    def make(rng: np.random.Generator) -> Family:
        """Draw a Garnet and the family of its change."""
        rows = 3 * n_states
        to = np.argsort(rng.random((rows, n_states)), axis=1)[:, :5]
        entries = (
            rng.dirichlet(np.ones(5), rows).ravel(),
            (np.repeat(np.arange(rows), 5), to.ravel()),
        )
        transitions = sparse.csr_array(entries, (rows, n_states))
        rewards = rng.normal(size=(n_states, 3))
        simulator = FiniteMDP(
            transitions, rewards, np.full(n_states, 1 / n_states), 0.95
        )
        target = simulator.transitions
        if change is not None:
            values = state_values(
                simulator,
                mix(optimal_policy(simulator), uniform_policy(simulator), 0.9),
            )
            z = ((values - values.mean()) / values.std())[target.indices]
            weights = change(target.data, row_of_entry(target), z, rng)
            target = scale_rows(csr_on_pattern(target, weights))
        return pair(about, simulator, target, recorded=recorded)

    return make


def make_worse(n_states: int = 40) -> Maker:
    """Return a maker of a Garnet that is a little worse everywhere along V."""
    about = "Each transition is a little worse than simulated, along V."
    return garnet(about, lambda p, row, z, rng: p * np.exp(-0.25 * z), n_states)


@suggest_keywords
def garnet_worse(n_states: int = 40, seed: int = 0) -> Family:
    """Make a Garnet whose target is a little worse everywhere along V.

    It is the family ``garnet_worse`` in any size.

    Parameters
    ----------
    n_states : int, default 40
        Number of states, at least 5.
    seed : int, default 0
        Seed from 0 that chooses the Garnet.

    Returns
    -------
    Family
        The random MDP and a target with probabilities proportional to P exp(-.25 z(V)),
        where z(V) is the standardised value of the next state.

    Raises
    ------
    ValueError
        If there are fewer than 5 states, or the seed is no integer from 0.

    See Also
    --------
    families : The families of the package by name.

    Examples
    --------
    >>> family = garnet_worse(10)
    >>> family.open_rows, family.truth < 20
    (30, True)
    """
    if _checks.positive_integer(n_states, "n_states") < 5:
        raise ArgumentError("n_states", f"must be at least 5; it is {n_states}")
    # a table of probabilities, and its copies
    _checks.require_memory(10.0 * float(n_states) ** 2, "n_states", n_states)
    return make_worse(n_states)(np.random.default_rng([check_seed(seed), n_states]))


FLOORS: dict[str, Maker] = {
    "paper_grid": lambda: pair(
        "The paper's: steps slip less than simulated.",
        gridworld(10, 0.3),
        gridworld(10, 0.1),
        **PAPER,
    ),
    "paper_grid_reversed": lambda: pair(
        "Steps slip more than simulated.",
        gridworld(10, 0.1),
        gridworld(10, 0.3),
        **PAPER,
    ),
    "floor_slippery": lambda: pair(
        "Nine cells in the middle of the floor are slippery, which the simulator does"
        " not know.",
        floor(),
        floor(np.where(IS_MIDDLE, 0.6, SIMULATOR_SLIP)),
    ),
    "floor_motor": lambda: pair(
        "One of the four motors is weak.",
        floor(),
        floor(np.array([0.55, SIMULATOR_SLIP, SIMULATOR_SLIP, SIMULATOR_SLIP])),
        recorded=0.0,
    ),
    "floor_chequered": lambda: pair(
        "Every other cell of the floor is more slippery than simulated.",
        floor(),
        floor(np.where((ROW + COLUMN) % 2, 0.4, SIMULATOR_SLIP)),
        recorded=0.9,
    ),
    "floor_wind": lambda: pair(
        "A wind blows along one direction, in a fifth of the steps; the simulator has"
        " none.",
        floor(),
        # The wind moves it a row up, whatever it does.
        0.8 * floor().transitions
        + 0.2 * floor().transitions[np.arange(64 * 4) // 4 * 4 + 1],
    ),
    "floor_identical": lambda: pair(
        "The simulator of the floor is right.", floor(), floor()
    ),
}
GARNETS: dict[str, Maker] = {
    "garnet_dirichlet100": garnet(
        "Every row is a little off, at random.",
        lambda p, row, z, rng: rng.gamma(100.0 * p) + np.finfo(float).tiny,
    ),
    "garnet_dirichlet10": garnet(
        "Every row is far off, at random.",
        lambda p, row, z, rng: rng.gamma(10.0 * p) + np.finfo(float).tiny,
        recorded=0.0,
    ),
    "garnet_replaced": garnet(
        "A twentieth of the rows is wrong.",
        lambda p, row, z, rng: np.where(
            np.isin(row, rng.permutation(120)[:6]), rng.exponential(size=p.size), p
        ),
        recorded=0.9,
    ),
    "garnet_worse": make_worse(),
    "garnet_better": garnet(
        "Each transition is a little better than simulated, along V.",
        lambda p, row, z, rng: p * np.exp(0.25 * z),
        recorded=0.0,
    ),
    "garnet_one_action": garnet(
        "The transitions of one action are worse.",
        lambda p, row, z, rng: p * np.exp(-0.5 * z * (row % 3 == 0)),
    ),
    "garnet_tempered": garnet(
        "Moves are noisier than simulated.", lambda p, row, z, rng: p**0.7, recorded=0.9
    ),
    "garnet_identical": garnet("The simulator of the random MDP is right."),
}
LARGE_GARNETS = {f"garnet_worse{n}": make_worse(n) for n in (10, 20, 80, 160)}
TOY_TEXT: dict[str, Maker] = {
    # FrozenLake 8 x 8: a step goes where it is meant with probability 1/3 simulated, .6
    # real
    "frozen_lake": lambda: pair(
        "The ice is less slippery than simulated.",
        *(
            toy_text("FrozenLake-v1", map_name="8x8", success_rate=rate)
            for rate in (1 / 3, 0.6)
        ),
    ),
    # A taxi in the rain goes where it is sent with probability .8 simulated, .6 real
    "taxi_rain": lambda: pair(
        "It rains harder than simulated: the taxi misses more turns.",
        *(
            toy_text("Taxi-v4", discount=0.95, is_rainy=True, rainy_probability=rate)
            for rate in (0.8, 0.6)
        ),
        recorded=0.9,
    ),
    # One action in ten is replaced by a random one in the simulator, three in ten in
    # the target
    "cliff_walking": lambda: pair(
        "The edge of the cliff is more slippery than simulated.",
        toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.1),
        toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.3).transitions,
        recorded=0.9,
    ),
    "icu_sepsis": icu_sepsis,
}


MADE: Mapping[str, Maker] = {
    **chains.FIRST,
    **FLOORS,
    **GARNETS,
    **TOY_TEXT,
    **chains.TRADES,
    "one_way_grid": one_way_grid,
    **SHIFTS,
    "rust_buses": real_buses,
}
LARGE: Mapping[str, Maker] = {"tandem45": lambda: chains.tandem(45), **LARGE_GARNETS}
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


class Families(Mapping[str, Family]):
    """Mapping of names to families, each made when it is first looked up.

    Each family is made from random numbers of its own.

    Parameters
    ----------
    makers : mapping of str to callable
        Name -> function of a generator, or without parameters, that makes the family.
    seed : int
        Seed from 0 of the random parts.
    left_out : mapping of str to str
        Name -> a sentence that says why the family is not there.

    Attributes
    ----------
    seed : int
        The seed of the random parts.
    left_out : dict of str to str
        Why some families are not there, by name.

    See Also
    --------
    families : The families of the package.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mine = Families(
    ...     {"grid": lambda: oee.bench.families()["floor_motor"]}, seed=0, left_out={}
    ... )
    >>> list(mine), mine["grid"].about
    (['grid'], 'One of the four motors is weak.')
    """

    def __init__(
        self, makers: Mapping[str, Maker], seed: int, left_out: Mapping[str, str]
    ):
        """Keep the makers; nothing is made yet."""
        self._makers = dict(conform(makers, "makers", dict[str, Callable[..., Any]]))
        self._made = dict[str, Family]()
        self.seed = check_seed(seed)
        self.left_out: dict[str, str] = dict(
            conform(left_out, "left_out", dict[str, str])
        )

    def __getitem__(self, name: str) -> Family:
        """Return the family of a name; KeyError says which are near."""
        if name not in self:
            raise KeyError(f"family {self.missing(name)}")
        if name not in self._made:
            self._made[name] = self._make(name)
        return self._made[name]

    def __contains__(self, name: object) -> bool:
        """Return whether there is a family of that name."""
        return isinstance(name, str) and name in self._makers

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._makers)

    def __len__(self) -> int:
        """Return the number of families."""
        return len(self._makers)

    def __repr__(self) -> str:
        """Return the seed and the names."""
        return f"Families(seed {_checks.show(self.seed)}: {', '.join(self._makers)})"

    def missing(self, name: str) -> str:
        """Return why a name is not among the families, and which names are near.

        Parameters
        ----------
        name : str
            A name that is not among the families.

        Returns
        -------
        str
            One sentence for an error.
        """
        if isinstance(name, str) and name in self.left_out:
            return self.left_out[name]
        given = name if isinstance(name, str) else _checks.show(name)
        near = difflib.get_close_matches(given, list(self._makers), n=3, cutoff=0.4)
        hint = ""
        if near:
            hint = f"; nearest: {', '.join(near)}"
        return (
            f"must be one of {', '.join(self._makers)}; got {_checks.show(name)}{hint}"
        )

    def _make(self, name: str) -> Family:
        """Make the family of a name, with a ValueError that names it."""
        # The numbers depend on the name and the seed, not on the other families.
        words = np.frombuffer(
            hashlib.sha256(name.encode("utf-8", "surrogatepass")).digest()[:16],
            dtype=">u4",
        )
        try:
            if not inspect.signature(self._makers[name]).parameters:
                return _require_family(_make_fixed(self._makers[name]), name)
            stream = np.random.SeedSequence(self.seed, spawn_key=words.tolist())
            made = self._makers[name](np.random.default_rng(stream))
            return _require_family(made, name)
        except ValueError as error:
            raise ValueError(f"family {name!r}: {error}") from error


def _require_family(made: object, name: str) -> Family:
    """Require what a maker returns to be a family, and return it."""
    return _checks.instance(made, Family, f"makers[{name!r}]()")


@functools.lru_cache(maxsize=64)
def _make_fixed(maker: Maker) -> Family:
    """Make a family without random parts once a process, whatever the seed."""
    return maker()


@suggest_keywords
def families(seed: int = 0, *, large: bool = False) -> Families:
    """Return the families of environment shift of the benchmark.

    Parameters
    ----------
    seed : int, default 0
        Seed from 0. The random parts of a family (the Garnets) differ between seeds.
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
