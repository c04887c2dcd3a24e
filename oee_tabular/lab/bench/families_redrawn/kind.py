"""Kind of environments: a pair of models, drawn anew, with a near and a far policy."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oee_tabular.exact import optimal_policy
from oee_tabular.lab.bench.families_redrawn.draws import Generator
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.shift import Moves, shift
from oee_tabular.mdp import mix, uniform_policy
from oee_tabular.typing import Array


@dataclass(frozen=True, eq=False)
class Kind:
    """What ``shift`` needs for one kind of environments.

    ``draw`` gives the simulator's parameters and the target's; the other fields are as
    in ``shift``.
    """

    about: str
    shape: tuple[int, int]
    rewards: Any
    discount: float
    draw: Callable[[Generator], tuple[tuple[Any, ...], tuple[Any, ...]]]
    moves: Callable[..., Moves]
    start: Any = None
    ends: Any = ()
    length: int = 100
    recorded: Callable[[Family, Generator], Array] | None = None

    def make(self, rng: Generator) -> tuple[Family, Family]:
        """Draw a pair of models, and make its families with a near and a far policy."""
        believed, real = self.draw(rng)
        drawn = shift(
            self.about,
            self.shape,
            self.rewards,
            self.discount,
            believed,
            real,
            self.moves,
            start=slice(None) if self.start is None else self.start,
            ends=self.ends,
            length=self.length,
        )()
        recorded = None
        if self.recorded is not None:
            recorded = self.recorded(drawn, rng)
        return with_near_and_far(drawn, rng, recorded)


def with_near_and_far(
    drawn: Family, rng: Generator, recorded: Array | None = None
) -> tuple[Family, Family]:
    """Return a family twice, with a policy near the recorded one and one far from it.

    All are mixtures of the simulator's optimum and uniform actions: the recorded one
    has 15 to 50% of the optimum, the near one .15 more, the far one .95. With a
    recorded policy of its own, the near one has .1 of the optimum and the far one .6.
    """
    best = optimal_policy(drawn.simulator)
    if recorded is not None:
        near = replace(drawn, policy=mix(best, recorded, 0.1), data_policy=recorded)
        return near, replace(near, policy=mix(best, recorded, 0.6))
    uniform = uniform_policy(drawn.simulator)
    share = float(rng.uniform(0.15, 0.5))
    recorded = mix(best, uniform, share)
    near = replace(drawn, policy=mix(best, uniform, share + 0.15), data_policy=recorded)
    return near, replace(near, policy=mix(best, uniform, 0.95))


def make_pairs(
    makers: Mapping[str, Callable[[Generator], tuple[Family, Family]]],
    names: Mapping[str, str],
    seed: int,
) -> dict[str, Callable[[], Family]]:
    """Return makers of the near and the far family of each name, for ``Families``.

    Both have the same models at the same seed.
    """
    found: dict[str, Callable[[], Family]] = {}
    for name in names:
        draw = functools.cache(functools.partial(_draw, makers[name], name, seed))
        found[name] = functools.partial(_choose, draw, 0)
        found[f"{name}_far"] = functools.partial(_choose, draw, 1)
    return found


def _draw(
    make: Callable[[Generator], tuple[Family, Family]], name: str, seed: int
) -> tuple[Family, Family]:
    """Draw the models of a kind from random numbers of its own."""
    words = np.frombuffer(
        hashlib.sha256(name.encode("utf-8", "surrogatepass")).digest()[:16], dtype=">u4"
    )
    stream = np.random.SeedSequence(seed, spawn_key=words.tolist())
    return make(np.random.default_rng(stream))


def _choose(draw: Callable[[], tuple[Family, Family]], number: int) -> Family:
    """Return one of the two families that are drawn together."""
    return draw()[number]
