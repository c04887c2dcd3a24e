"""Names of states and actions: rules, numbers, and forms in files and sentences."""

from __future__ import annotations

import difflib
import json
import math
import re
import unicodedata
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._containers import is_labelled_series
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, IntArray, SupportsArray

Name: TypeAlias = str | tuple[Any, ...]

# names of all states or actions, in their order; a text is no sequence of names
NamesLike: TypeAlias = list[Any] | tuple[Any, ...] | SupportsArray


@dataclass(frozen=True)
class Names:
    """Hold the names of states and of actions; None where there are only numbers.

    >>> names = Names(("hall", ("room", 2)), ("left", "right"))
    >>> names.transition(0, 1, 1), Names().transition(0, 1, 1)
    ("s=hall, a=right -> s'=('room', 2)", "s=0, a=1 -> s'=1")
    """

    states: tuple[Name, ...] | None = None
    actions: tuple[Name, ...] | None = None

    def state(self, number: object) -> str:
        """Return the name of a state, or its number."""
        return name_text(self.states, number)

    def action(self, number: object) -> str:
        """Return the name of an action, or its number."""
        return name_text(self.actions, number)

    def pair(self, state: object, action: object) -> str:
        """Describe a state-action pair, ``s=hall, a=left``."""
        return f"s={self.state(state)}, a={self.action(action)}"

    def first_pairs(self, pairs: Any) -> str:
        """Describe the first three of (n, 2) state-action pairs; dots stand for more."""
        shown = "; ".join(self.pair(*pair) for pair in pairs[:3])
        return f"{shown}; ..." if len(pairs) > 3 else shown

    def transition(self, state: object, action: object, next_state: object) -> str:
        """Describe a transition, ``s=hall, a=left -> s'=kitchen``."""
        return f"{self.pair(state, action)} -> s'={self.state(next_state)}"

    def describe_state(self, state: int) -> str:
        """Name a state in a sentence, as in "state hall"."""
        return f"state {_quote(self.state(state))}"

    def describe_action(self, action: int) -> str:
        """Name an action in a sentence, as in "action left"."""
        return f"action {_quote(self.action_word(action) or self.action(action))}"

    def describe_pair(self, state: int, action: int) -> str:
        """Name a state-action pair in a sentence, as in "action left in state hall"."""
        return f"{self.describe_action(action)} in {self.describe_state(state)}"

    def label_pair(self, state: int, action: int) -> str:
        """Name a state-action pair in a table, as in "left in state hall"."""
        word = self.action_word(action)
        if word is None:
            return self.describe_pair(state, action)
        return f"{_quote(word)} in {self.describe_state(state)}"

    def is_named(self, state: int) -> bool:
        """Return whether a sentence calls a state by something else than its number."""
        return self.states is not None

    def action_word(self, action: int) -> str | None:
        """Return the name of an action; None where it has only a number."""
        return None if self.actions is None else self.action(action)


NAMELESS = Names()
# letters of Cyrillic and Greek, and dashes, that look like those on the right
_LIKE_LATIN = dict(
    zip(
        "АВЕЅІЈКМНОРСТХаеорсухѕіјһԁԛԝΑΒΕΖΗΙΚΜΝΟΡΤΥΧο\u2010\u2011\u2212",
        "ABESIJKMHOPCTXaeopcyxsijhdqwABEZHIKMNOPTYXo---",
        strict=True,
    )
)
# of no width, though they are letters or marks
_INVISIBLE = frozenset("\u034f\u115f\u1160\u3164\u180b\u180c\u180d") | frozenset(
    map(chr, range(0xFE00, 0xFE10))
)
MAX_NAME_DEPTH = 20  # of tuples in tuples; JSON of a name cannot exhaust the stack


def names_of(mdp: object) -> Names:
    """Return the names that an MDP, or what stands for one, has."""
    names: Names = getattr(mdp, "names", NAMELESS)
    return names


def _quote(name: str) -> str:
    """Quote a name of several words, so that a reader sees where it ends.

    Coordinates have their brackets instead.
    """
    has_brackets = name.startswith("(")
    return f"“{name}”" if " " in name and not has_brackets else name


def name_text(names: tuple[Name, ...] | None, number: Any) -> str:
    """Return the name of a number, or the number where it has none."""
    k = int(number)
    return str(k if names is None or not 0 <= k < len(names) else names[k])


def check_names(
    value: object, name: str, size: int, place_of: Callable[[int], str] | None = None
) -> tuple[Name, ...]:
    """Check that ``value`` is ``size`` different names and return them as a tuple.

    A name is a text that does not read as a number, or a tuple of texts and numbers.
    Names are kept in Unicode's composed form (NFC), and no two may look alike. In
    errors the k-th name is called ``name[k]``, or ``place_of(k)`` where that is given.

    >>> check_names(["hall", (0, 1)], "state_names", 2)
    ('hall', (0, 1))
    """
    given = _checks.collection(value, name, "a sequence of texts or tuples")
    if len(given) != size:
        raise ArgumentError(
            name, f"must have {size} names, one for each; it has {len(given)}"
        )
    names = tuple(to_plain(item) for item in given)
    place_of = place_of or f"{name}[{{}}]".format
    first: dict[str, int] = {}
    for k, item in enumerate(names):
        _require_name(item, place_of, k)
        look = _appearance(str(item))
        if look in first:
            other = first[look]
            is_same = str(item) == str(names[other])
            relation = "as" if is_same else "which looks as"
            raise ArgumentError(
                name,
                f"must differ; {place_of(k)} is {_checks.show(item)}, {relation}"
                f" {place_of(other)} {'is' if is_same else 'does'}"
                f"{_tell_apart(given[k], given[other])}",
            )
        first[look] = k
    return names


def valid_names(given: object, size: int) -> tuple[Name, ...] | None:
    """Return ``given`` as names, or None where they break a rule."""
    try:
        return None if given is None else check_names(given, "names", size)
    except ValueError:
        return None


def normalize(text: str) -> str:
    """Return a text in Unicode's composed form (NFC).

    An accent is written with its letter or after it, which no eye tells apart.
    """
    return text if text.isascii() else unicodedata.normalize("NFC", text)


def _appearance(text: str) -> str:
    """Return a text that is the same for texts that look alike.

    Invisible characters are left out, blanks are one, and letters of Greek and Cyrillic
    that look like Latin ones are these.
    """
    if text.isascii():
        return text
    seen = [
        " " if unicodedata.category(c) == "Zs" else _LIKE_LATIN.get(c, c)
        for c in normalize(text)
        if unicodedata.category(c) != "Cf" and c not in _INVISIBLE
    ]
    return "".join(seen)


def _tell_apart(item: object, other: object) -> str:
    """Return how the characters of two names that look alike differ, in words."""
    if str(item) == str(other):
        return ""
    shown = (ascii(str(one))[:80] for one in (item, other))
    return f" (in characters: {' and '.join(shown)})"


def _require_name(item: object, place_of: Callable[[int], str], k: int) -> None:
    """Raise an ArgumentError where an item is no name; errors call it ``place_of(k)``."""
    if not is_name(item):
        raise ArgumentError(
            place_of(k),
            "must be a text, or a tuple of texts and numbers; it is"
            f" {_checks.show(item)}",
        )
    text = str(item)
    if text.strip() != text or not text:
        raise ArgumentError(
            place_of(k),
            "must not be empty, nor begin or end with a blank; it is"
            f" {_checks.show(text)}",
        )
    if is_number_text(text):
        raise ArgumentError(
            place_of(k),
            "must not read as a number, which a file does not tell from the number"
            f" of a state or an action; it is {text!r} (write {'s' + text!r})",
        )


def to_plain(item: object, depth: int = 0) -> Any:
    """Return a name without numpy's types, its texts composed, lists in it as tuples.

    Its letters have one form, é in one sign where it was in two [1]. What is nested too
    deep stays as it is.

    [1] Unicode Standard Annex 15, form C.
    """
    # an array of another class may be masked, or have a unit
    if isinstance(item, np.generic) or (type(item) is np.ndarray and not item.ndim):
        item = item.item()
    if isinstance(item, str):
        return normalize(item)
    if isinstance(item, np.ndarray) and item.ndim == 0:  # masked, or with a unit
        return item
    if isinstance(item, tuple | list | np.ndarray) and depth < MAX_NAME_DEPTH:
        return tuple(to_plain(part, depth + 1) for part in item)
    return item


def is_name(item: object) -> bool:
    """Say whether ``item`` is a text, or a tuple of texts, numbers and tuples."""
    if not isinstance(item, tuple):
        return isinstance(item, str)
    return bool(item) and all(map(_is_part_of_name, item))


def _is_part_of_name(part: object) -> bool:
    """Say whether ``part`` is a finite number or itself a name."""
    if isinstance(part, float):
        return math.isfinite(part)
    return isinstance(part, int) or is_name(part)


def is_number_text(text: str) -> bool:
    """Say whether a file's reader would take ``text`` for a number or for nan."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def coordinates(names: tuple[Name, ...] | None) -> Array | None:
    """Return (S, c) coordinates where all names are tuples of c numbers, else None.

    It costs O(S c).
    """
    if not names or not all(map(_is_tuple_of_numbers, names)):
        return None
    try:
        return _checks.freeze(np.array(names, dtype=np.float64))
    except (OverflowError, ValueError):
        # an integer beyond floats; tuples of several lengths
        return None


def _is_tuple_of_numbers(name: Name) -> bool:
    """Say whether a name is a tuple of numbers alone."""
    return isinstance(name, tuple) and all(isinstance(x, int | float) for x in name)


MAX_LOOKUPS = 16  # tuples of names whose numbers are kept
# by the identity of a tuple, which takes O(1); the hash of a tuple takes O(S)
_LOOKUPS: dict[int, tuple[tuple[Name, ...], dict[Hashable, int]]] = {}


def numbers_of(names: tuple[Name, ...]) -> Mapping[Hashable, int]:
    """Return the mapping from names to numbers, made once for a tuple of names.

    A name that is a tuple is there by its text as well, "(0, 1)" or "(0,1)".
    """
    known, numbers = _LOOKUPS.get(id(names), ((), {}))
    if known is not names:
        named: dict[Hashable, int] = {item: k for k, item in enumerate(names)}
        texts: dict[Hashable, int] = {
            str(item): k for item, k in named.items() if isinstance(item, tuple)
        }
        dense = {str(text).replace(", ", ","): k for text, k in texts.items()}
        numbers = dense | texts | named
        if len(_LOOKUPS) >= MAX_LOOKUPS:
            _LOOKUPS.clear()
        _LOOKUPS[id(names)] = names, numbers
    return numbers


def number_of(
    item: object,
    names: tuple[Name, ...] | None,
    size: int,
    name: str,
    owner: str = "the MDP's",
) -> int:
    """Return the number of a state or an action that is given by name or number.

    Raises an ArgumentError with the nearest name where there is none.

    >>> try:
    ...     number_of("lefft", ("left", "right"), 2, "action")
    ... except ArgumentError as error:
    ...     print(error)
    action must be one of the MDP's names; it is 'lefft' (did you mean 'left'?)
    """
    given = to_plain(item)
    if _checks.is_integer(given):
        if not 0 <= given < size:
            raise ArgumentError(
                name, f"must be in 0..{size - 1}; it is {_checks.show(given)}"
            )
        return int(given)
    if not is_name(given):
        raise ArgumentError(
            name, f"must be a name or a number; it is {_checks.show(given)}"
        )
    if names is None:
        raise ArgumentError(
            name,
            f"must be a number in 0..{size - 1}, since"
            f" {owner.removesuffix(chr(39) + 's')} has no names here; it is"
            f" {_checks.show(given)} (give it names: with_names(state_names=...,"
            " action_names=...))",
        )
    number = numbers_of(names).get(given)
    if number is None:
        raise ArgumentError(
            name,
            f"must be one of {owner} names; it is"
            f" {_checks.show(given)}{suggest_name(given, names)}",
        )
    return number


def suggest_name(item: Name, names: tuple[Name, ...]) -> str:
    """Return `` (did you mean 'hall'?)``, or the first names where none is near."""
    alike = next(
        (n for n in names if _appearance(str(n)) == _appearance(str(item))), None
    )
    if alike is not None and str(alike) != str(item):
        return (
            f" (which looks like {str(alike)!r:.80}, in other characters:"
            f" {ascii(str(item))[:80]})"
        )
    texts = {str(name)[:80]: name for name in names}
    close = difflib.get_close_matches(str(item)[:80], list(texts), n=1)
    if close:
        return f" (did you mean {texts[close[0]]!r}?)"
    shown = ", ".join(map(repr, names[:5]))
    if len(names) > 5:
        shown += ", ..."
    return f" (they are {shown})"


# letters of a name of which one may be wrong; among shorter names many are near
MIN_LETTERS_OF_MISSPELT = 4
MAX_LETTERS_OF_MISSPELT = 80


def find_misspelt(
    candidates: Iterable[Name], names: Iterable[Name]
) -> dict[Name, list[Name]]:
    """Return, by a candidate, the other names of which it may be a misspelling.

    They differ by capitals, blanks and forms of letters alone, or by one letter that is
    wrong, missing, added or in the other order. Names that differ in a number, or in a
    letter or a roman numeral that stands for one, are those of a series. Words that an
    "a" in front negates (symptomatic, asymptomatic) are others, and so are those of a
    script without capitals, where one character is a word.

    Notes
    -----
    Two texts are one letter apart only where they are the same with at most one letter
    of each left out [1]. The cost is that of all names' letters.

    [1] W. Garbe, SymSpell.

    Examples
    --------
    >>> find_misspelt(["depto", "room_b", "end"], ["depot", "room_a", "hall"])
    {'depto': ['depot']}
    """
    given = list(dict.fromkeys(name for name in candidates if isinstance(name, str)))
    places: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for name in given:
        letters, series = _spelling(name)
        for part in _leave_letter_out(letters):
            places.setdefault((part, series), []).append(name)
    found: dict[Name, list[Name]] = {}
    texts = [name for name in names if isinstance(name, str)]
    for name in texts if places else ():
        letters, series = _spelling(name)
        near: dict[str, None] = {}
        for part in _leave_letter_out(letters):
            near.update(dict.fromkeys(places.get((part, series), ())))
        for candidate in near:
            if candidate != name and _is_one_letter_apart(
                _spelling(candidate)[0], letters
            ):
                found.setdefault(candidate, []).append(name)
    return {name: found[name] for name in given if name in found}


def find_misspelt_ends(
    names: Sequence[Name], is_end: BoolArray, n_rows: IntArray
) -> list[tuple[Name, Name]]:
    """Return states that no row leaves and that may be misspelt, with what was meant.

    Of two such states, the one of fewer rows may be the misspelling. One that resembles
    several states that rows leave is a code, and no misspelling.

    Parameters
    ----------
    names : sequence
        The names of the states.
    is_end : ndarray of bool of shape (S,)
        Which of them no row leaves.
    n_rows : ndarray of int of shape (S,)
        The number of rows in which each stands.
    """
    place = {name: k for k, name in enumerate(names)}
    weight = [(n, -k) for k, n in enumerate(n_rows.tolist())]
    ends = [names[k] for k in np.flatnonzero(is_end).tolist()]
    pairs = []
    for name, others in find_misspelt(ends, names).items():
        if sum(not is_end[place[other]] for other in others) > 1:
            continue
        for other in others:
            k = place[other]
            if not is_end[k] or weight[place[name]] < weight[k]:
                pairs.append((name, other))
                break
    return pairs


def _spelling(name: str) -> tuple[str, tuple[str, ...]]:
    """Return a name's letters without capitals, and what tells it within a series."""
    text = unicodedata.normalize("NFKC", name[:MAX_LETTERS_OF_MISSPELT])
    text = re.sub(r"(?<=[a-z])(?=[A-Z]\b)", " ", text)  # roomA
    # a minus after a letter or a digit is a hyphen
    pattern = r"(?<![^\W_])[-+\u2212]\d+|\d+|[^\W\d_]+|[-+\u2212]+$"
    parts = re.findall(pattern, _appearance(text).casefold())
    is_series = [
        part[-1].isdecimal()
        or not part.isalpha()  # grade A+
        or re.fullmatch("[ivx]+[a-d]?", part) is not None  # stage IIIb
        or (len(parts) > 1 and len(part) == 1)
        for part in parts
    ]
    pairs = list(zip(parts, is_series, strict=True))
    letters = "".join(part for part, is_number in pairs if not is_number)
    return letters, tuple(part for part, is_number in pairs if is_number)


def _leave_letter_out(text: str) -> set[str]:
    """Return a text, and the texts that it is with one letter left out."""
    texts = {text}
    if len(text) >= MIN_LETTERS_OF_MISSPELT:
        texts.update(text[:k] + text[k + 1 :] for k in range(len(text)))
    return texts


def _is_one_letter_apart(one: str, other: str) -> bool:
    """Return whether one edit makes a text of another that shares a shortening."""
    if one == other:
        return True
    if min(len(one), len(other)) < MIN_LETTERS_OF_MISSPELT:
        return False
    if one.upper() == one.lower():
        return False
    if len(one) != len(other):
        short, long = sorted((one, other), key=len)
        return long != f"a{short}"
    n_other = sum(a != b for a, b in zip(one, other, strict=True))
    return n_other == 1 or (n_other == 2 and sorted(one) == sorted(other))


def renumber(
    codes: IntArray,
    own: tuple[Name, ...],
    names: tuple[Name, ...] | None,
    size: int,
    name: str,
    source_of: Callable[[int], str] | None = None,
) -> IntArray:
    """Return numbers by a log's own names as numbers by an MDP's names.

    Raises a ValueError with the first row whose name the MDP does not have.
    ``source_of`` returns the file that a row is of, in words.
    """
    known = {} if names is None else numbers_of(names)
    numbers = np.array([known.get(item, -1) for item in own], dtype=np.int64)[codes]
    bad = np.flatnonzero(numbers < 0)
    if bad.size:
        source = "" if source_of is None else source_of(int(bad[0]))
        place = f"{name}[{bad[0]}]{source}"
        try:
            number_of(own[int(codes[bad[0]])], names, size, place, "the simulator's")
        except ArgumentError as error:
            more = _count_unknown(codes[bad])
            raise ArgumentError(error.argument, f"{error.rule}{more}") from None
    return numbers


def _count_unknown(codes: IntArray) -> str:
    """Return the numbers of rows and of names that are unknown, in words, above one."""
    if len(codes) == 1:
        return ""
    missing = len(np.unique(codes))
    plural = "s" if missing > 1 else ""
    return f"; {len(codes)} such rows, of {missing} name{plural}"


def to_text(names: Any) -> NDArray[Any]:
    """Return names as the texts that a file holds: JSON, a tuple as a list."""
    return np.array([json.dumps(item) for item in names])


def from_text(stored: NDArray[Any], name: str) -> tuple[Name, ...]:
    """Return the names that ``to_text`` was given; ArgumentError for other arrays."""
    if stored.ndim != 1 or stored.dtype.kind != "U":
        raise ArgumentError(
            name, f"must be texts; it has {stored.dtype} of shape {stored.shape}"
        )
    try:
        return tuple(to_plain(json.loads(text)) for text in stored.tolist())
    except (ValueError, RecursionError):
        raise ArgumentError(
            name, f"must be names as JSON; it has {stored.tolist()[0]!r:.80}"
        ) from None


def initial_distribution(
    initial: Any, names: tuple[Name, ...] | None, n_states: int
) -> Any:
    """Return a first state, or a mapping from states to probabilities, as (S,).

    A Series with labels is a mapping. Anything else is returned as it is.
    """
    if is_labelled_series(initial):
        if not initial.index.is_unique:
            raise ArgumentError("initial", "must have each state once in its index")
        initial = initial.to_dict()
    is_scalar = getattr(initial, "ndim", 1) == 0
    is_tuple = isinstance(initial, tuple) and names is not None
    given = to_plain(initial) if is_scalar or is_tuple else initial
    if is_tuple:  # as many numbers as states are a distribution, unless they are a name
        is_numbers = all(isinstance(part, int | float) for part in given)
        is_distribution = len(given) == n_states and is_numbers
        is_tuple = not is_distribution or given in numbers_of(names or ())
    weights: Mapping[Any, Any] = initial if isinstance(initial, Mapping) else {}
    if is_tuple or isinstance(given, str) or _checks.is_integer(given):
        weights = {given: 1.0}
    elif weights is not initial:
        return initial
    distribution = np.zeros(n_states)
    called = "initial's state" if weights is initial else "initial"
    for state, weight in weights.items():
        number = number_of(state, names, n_states, called)
        distribution[number] += _checks.number_in(
            weight, f"initial[{state!r}]", 0.0, 1.0
        )
    return distribution
