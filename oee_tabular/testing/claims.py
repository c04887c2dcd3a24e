"""What an estimator says of itself: the words, and what they mean."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

CLAIMS: Mapping[str, str] = {
    "consistent": "its value tends to J_target as the log (and its rollouts) grow, where the log's behaviour has support",
    "unbiased": "its mean over logs is J_target at every number of episodes",
    "identical": "it is right where the target is the simulator (part of consistent)",
    "relabelling": "names of states and actions do not matter where the states keep their places (layout)",
    "scale": "rewards a r give a J, to 1e-8, from the same log and seed",
    "shift": "rewards r + b give J + b sum gamma^t, to 1e-8, from the same log and seed, nothing being absorbing",
    "padding": "rows in an absorbing state after the end of an episode change nothing",
    "after_end": "padding, whatever actions those rows have",
    "random": "other seeds may give other values; without this word they must give the same bits",
    "finite": "it answers problems with a horizon; claimed without infinite, those alone",
    "infinite": "it answers problems without a horizon; claimed without finite, those alone",
}
DEFAULT: frozenset[str] = frozenset({"consistent", "relabelling", "scale"})


def claims_of(estimator: Any, claims: Iterable[str] | None = None) -> frozenset[str]:
    """What an estimator claims: the words that say which laws it owes.

    ``claims``, else the estimator's own ``claims`` (a collection of words, or a method that returns one), else ``DEFAULT``.

    Parameters
    ----------
    estimator : any object
    claims : words of ``CLAIMS``, or None

    Raises
    ------
    ValueError
        A word that is none of ``CLAIMS`` (with the nearest one).

    Examples
    --------
    >>> from oee_tabular.estimators import Simulator
    >>> sorted(claims_of(Simulator()) - DEFAULT)
    ['after_end', 'identical', 'padding', 'shift']
    >>> claims_of(lambda problem, policy, *, seed=None: None) == DEFAULT
    True
    """
    found: Any = claims
    name = "claims"
    if found is None:
        name = f"{type(estimator).__name__}.claims"
        try:
            found = getattr(estimator, "claims", None)
            found = found() if callable(found) else found
        except Exception as error:
            raise ValueError(f"{name} must be a collection of words; it raises {error!r}") from None
    if found is None:
        return DEFAULT
    try:
        if isinstance(found, str):
            raise TypeError
        words = frozenset(found)
    except TypeError:
        raise ValueError(f"{name} must be a collection of words; it is {found!r}") from None
    for word in sorted(words, key=str):
        if word not in CLAIMS:
            near = difflib.get_close_matches(str(word), list(CLAIMS), n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise ValueError(f"{name} must be among {', '.join(CLAIMS)}; got {word!r}{hint}")
    return words
