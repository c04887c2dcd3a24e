"""What states and actions are called: names checked, looked up, stored, and the one way in which they are worded."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray

Name: TypeAlias = str | tuple[Any, ...]


@dataclass(frozen=True)
class Names:
    """The names of the states and of the actions, None where they have numbers alone.

    Examples
    --------
    >>> names = Names(("hall", ("room", 2)), ("left", "right"))
    >>> names.move(0, 1, 1), Names().move(0, 1, 1)
    ("s=hall, a=right -> s'=('room', 2)", "s=0, a=1 -> s'=1")
    >>> names.state(1), Names().state(1)
    ("('room', 2)", '1')
    """

    states: tuple[Name, ...] | None = None
    actions: tuple[Name, ...] | None = None

    def state(self, number: object) -> str:
        """A state in words: its name, or its number."""
        return worded(self.states, number)

    def action(self, number: object) -> str:
        """An action in words."""
        return worded(self.actions, number)

    def pair(self, state: object, action: object) -> str:
        """``s=hall, a=left``."""
        return f"s={self.state(state)}, a={self.action(action)}"

    def move(self, state: object, action: object, following: object) -> str:
        """``s=hall, a=left -> s'=kitchen``."""
        return f"{self.pair(state, action)} -> s'={self.state(following)}"


NAMELESS = Names()


def names_of(thing: object) -> Names:
    """The names that an MDP, or what stands for one, has; none where it has none."""
    found = getattr(thing, "names", NAMELESS)
    return found if isinstance(found, Names) else NAMELESS


def worded(names: tuple[Name, ...] | None, number: Any) -> str:
    """The name of a number, or the number where there are no names (or none of it)."""
    if names is None or not 0 <= int(number) < len(names):
        return str(int(number))
    return str(names[int(number)])


def check_names(value: object, name: str, size: int) -> tuple[Name, ...]:
    """``value`` as a tuple of ``size`` names: texts, or tuples of texts and numbers; no two alike, none that reads as a number.

    Raises
    ------
    ValueError
        With the place, the rule and the value found.

    Examples
    --------
    >>> check_names(["hall", (0, 1)], "state_names", 2)
    ('hall', (0, 1))
    >>> check_names(["hall", "hall"], "state_names", 2)
    Traceback (most recent call last):
    ValueError: state_names must differ; state_names[1] is 'hall', as state_names[0] is
    """
    given = _checks.collection(value, name, "a sequence of texts or tuples")
    if len(given) != size:
        raise ValueError(f"{name} must have {size} names, one for each; it has {len(given)}")
    names = tuple(plain(item) for item in given)
    first: dict[str, int] = {}
    for k, item in enumerate(names):
        if not is_name(item):
            raise ValueError(f"{name}[{k}] must be a text, or a tuple of texts and numbers; it is {item!r:.80}")
        text = str(item)
        if text.strip() != text or not text:
            raise ValueError(f"{name}[{k}] must not be empty, nor begin or end with a blank; it is {text!r:.80}")
        if reads_as_number(text):
            raise ValueError(
                f"{name}[{k}] must not read as a number, which a file does not tell from the number of a state or an action; "
                f"it is {text!r} (write {'s' + text!r})"
            )
        if text in first:
            raise ValueError(f"{name} must differ; {name}[{k}] is {item!r:.80}, as {name}[{first[text]}] is")
        first[text] = k
    return names


def plain(item: object) -> Any:
    """A name without numpy's types: lists and arrays in it are tuples."""
    if isinstance(item, np.generic) or (isinstance(item, np.ndarray) and item.ndim == 0):
        return item.item()
    if isinstance(item, tuple | list | np.ndarray):
        return tuple(plain(part) for part in item)
    return item


def is_name(item: object) -> bool:
    """A text, or a tuple of texts and numbers (or of such tuples) that is not empty."""
    if isinstance(item, tuple):
        return bool(item) and all(_is_part(part) for part in item)
    return isinstance(item, str)


def _is_part(part: object) -> bool:
    return isinstance(part, str | int) or (isinstance(part, float) and math.isfinite(part)) or is_name(part)


def reads_as_number(text: str) -> bool:
    """Whether a file's reader would take ``text`` for a number, or for none at all (nan)."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def coordinates(names: tuple[Name, ...] | None) -> Array | None:
    """(S, c) of names that are all tuples of c numbers; None of others. O(S c).

    Examples
    --------
    >>> coordinates(((0, 0.5), (1, 0.5))).tolist(), coordinates(((0, 0), (1, "over")))
    ([[0.0, 0.5], [1.0, 0.5]], None)
    """
    if not names or any(not isinstance(name, tuple) or len(name) != len(names[0]) for name in names):
        return None
    if any(not isinstance(part, int | float) for name in names for part in name):
        return None
    try:
        return _checks.freeze(np.array(names, dtype=np.float64))
    except OverflowError:  # an integer beyond floats
        return None


class _Same:
    """A tuple of names as a key, by what it is and not by what it holds: found in O(1)."""

    def __init__(self, names: tuple[Name, ...]) -> None:
        self.names = names

    def __hash__(self) -> int:
        return id(self.names)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.names is other.names


@lru_cache(maxsize=16)
def _lookup(key: _Same) -> Mapping[Hashable, int]:
    found: dict[Hashable, int] = {
        str(item).replace(", ", ","): k for k, item in enumerate(key.names) if isinstance(item, tuple)
    }
    found |= {str(item): k for k, item in enumerate(key.names)}
    return MappingProxyType(found | {item: k for k, item in enumerate(key.names)})


def numbers_of(names: tuple[Name, ...]) -> Mapping[Hashable, int]:
    """Name -> number; a tuple is found by its text as well, "(0, 1)" or "(0,1)". Made once for a tuple: O(1) from then on."""
    return _lookup(_Same(names))


def number_of(
    item: object, names: tuple[Name, ...] | None, size: int, name: str, owner: str = "the simulator's"
) -> int:
    """The number of a state or an action given by name or by number; ValueError with the nearest name.

    Examples
    --------
    >>> number_of("left", ("left", "right"), 2, "action"), number_of(1, None, 2, "action")
    (0, 1)
    >>> number_of("lefft", ("left", "right"), 2, "action")
    Traceback (most recent call last):
    ValueError: action must be one of the simulator's names; it is 'lefft' (did you mean 'left'?)
    """
    given = plain(item)
    if isinstance(given, int) and not isinstance(given, bool):
        if not 0 <= given < size:
            raise ValueError(f"{name} must be in 0..{size - 1}; it is {given}")
        return given
    if not is_name(given):
        raise ValueError(f"{name} must be a name or a number; it is {given!r:.80}")
    if names is None:
        raise ValueError(
            f"{name} must be a number in 0..{size - 1}, since {owner.removesuffix(chr(39) + 's')} has no names here; it is "
            f"{given!r:.80} (give it names: with_names(state_names=..., action_names=...))"
        )
    found = numbers_of(names).get(given)
    if found is None:
        raise ValueError(f"{name} must be one of {owner} names; it is {given!r:.80}{nearest(given, names)}")
    return found


def nearest(item: Name, names: tuple[Name, ...]) -> str:
    """`` (did you mean 'hall'?)``, or the first names where none is near."""
    texts = {str(name)[:80]: name for name in names}
    close = difflib.get_close_matches(str(item)[:80], list(texts), n=1)
    if close:
        return f" (did you mean {texts[close[0]]!r}?)"
    return f" (they are {', '.join(map(repr, names[:5]))}{', ...' * (len(names) > 5)})"


def renumbered(
    codes: IntArray, own: tuple[Name, ...], names: tuple[Name, ...] | None, size: int, name: str
) -> IntArray:
    """Numbers by a log's own names as numbers by an MDP's; ValueError with the first row whose name it has not."""
    lookup = {} if names is None else numbers_of(names)
    table = np.array([lookup.get(item, -1) for item in own], dtype=np.int64)
    found = table[codes]
    bad = np.flatnonzero(found < 0)
    if bad.size:
        place = f"{name}[{bad[0]}]"
        try:
            number_of(own[int(codes[bad[0]])], names, size, place)
        except ValueError as error:
            missing = len(np.unique(codes[bad]))
            more = f"; {bad.size} such rows, of {missing} name{'s' * (missing > 1)}" if bad.size > 1 else ""
            raise ValueError(f"{error}{more}") from None
    return found


def to_text(names: Any) -> NDArray[Any]:
    """Names as an array of texts that a file holds: JSON, a tuple as a list."""
    return np.array([json.dumps(item) for item in names])


def from_text(stored: NDArray[Any], name: str) -> tuple[Name, ...]:
    """What ``to_text`` wrote; ValueError for what is none."""
    if stored.ndim != 1 or stored.dtype.kind != "U":
        raise ValueError(f"{name} must be texts; it has {stored.dtype} of shape {stored.shape}")
    try:
        return tuple(plain(json.loads(text)) for text in stored.tolist())
    except (ValueError, RecursionError):
        raise ValueError(f"{name} must be names as JSON; it has {stored.tolist()[0]!r:.80}") from None


def _meant(given: Any, names: tuple[Name, ...]) -> bool:
    """Whether a tuple is meant as a name, and not as a distribution over the states: it is one, or like one."""
    like = len(given) != len(names) and any(isinstance(name, tuple) and len(name) == len(given) for name in names)
    return given in numbers_of(names) or like or any(isinstance(part, str) for part in given)


def start_law(initial: object, names: tuple[Name, ...] | None, n_states: int) -> Any:
    """A first state, or a mapping state -> probability, as a distribution (S,); anything else as it is."""
    if isinstance(initial, Mapping):
        law = np.zeros(n_states)
        for state, probability in initial.items():
            k = number_of(state, names, n_states, "initial's state", "the MDP's")
            law[k] += _checks.number_in(probability, f"initial[{state!r}]", 0.0, 1.0)
        return law
    if isinstance(initial, np.ndarray) and initial.ndim > 0:
        return initial
    given = plain(initial)
    a_name = isinstance(given, str) or (isinstance(initial, tuple) and names is not None and _meant(given, names))
    if a_name or (isinstance(given, int) and not isinstance(given, bool)):
        law = np.zeros(n_states)
        law[number_of(given, names, n_states, "initial", "the MDP's")] = 1.0
        return law
    return initial
