"""Mapping of names to families, each made when it is looked up."""

from __future__ import annotations

import difflib
import functools
import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._results import conform
from oee_tabular.lab.bench.family import Family, check_seed
from oee_tabular.lab.bench.shift import Maker


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
