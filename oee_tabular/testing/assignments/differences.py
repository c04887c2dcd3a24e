"""Two arrays of numbers: whether they agree, where they differ, and by what pattern."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from oee_tabular.typing import Array, BoolArray

# of an entry that is nearly 0, in a comparison entry by entry
ENTRY_FLOOR = 1e-3
MAX_SHOWN_ARGUMENTS = 3
PATTERN_TOLERANCE = 1e-6
ROUNDING = 1e-13
SMALLEST_CHANGE = 1e-2  # of the largest entry; a smaller one is an early stop
MAX_DIGITS = 6  # that an answer may have been rounded to


def is_between(
    found: Any,
    low: Any,
    high: Any,
    tolerance: float,
    floor: float = 1.0,
    *,
    is_entrywise: bool = False,
) -> BoolArray:
    """Return which numbers lie between two others, inf as itself.

    The tolerance is relative to the largest, or to ``floor`` where all are smaller: a
    standard error of 0 is the root of what rounding leaves.
    """
    found, low, high = (np.asarray(x, dtype=float) for x in (found, low, high))
    sizes = np.where(np.isfinite(high), np.abs(high), 0.0)
    if is_entrywise:
        room = tolerance * np.maximum(sizes, ENTRY_FLOOR)
    else:
        room = np.asarray(tolerance * max(floor, sizes.max(initial=0.0)))
    inside = (found >= low - room) & (found <= high + room)
    return np.asarray(inside | (found == low))


def show_both(found: float, right: float) -> str:
    """Write two numbers with as many digits as tell them apart."""
    for digits in range(6, 17):
        texts = f"{found:.{digits}g}", f"{right:.{digits}g}"
        if texts[0] != texts[1]:
            break
    return f"{texts[0]}, and {texts[1]} is right"


def say_difference(
    found: Array,
    right: Array,
    is_wrong: BoolArray,
    axes: tuple[str, ...],
    arguments: dict[str, Any],
) -> str:
    """Write where two results differ most, what is there, and how many entries differ.

    Entries that are numbers come before nan and inf: they say more of a mistake.
    """
    if not right.shape:
        return f"it returns {show_both(float(found), float(right))}."
    is_shown = is_wrong & np.isfinite(found) & np.isfinite(right)
    with np.errstate(invalid="ignore"):  # inf - inf, which is not shown
        gap = np.where(is_shown, np.abs(found - right), -1.0)
    if not is_shown.any():
        gap = np.where(is_wrong, 1.0, 0.0)
    at = tuple(int(k) for k in np.unravel_index(int(gap.argmax()), gap.shape))
    place = ", ".join(map(str, at))
    n_wrong = max(int(is_wrong.sum()), 1)
    both = show_both(float(found[at]), float(right[at]))
    said = f"entry [{place}] is {both}."
    names = [f"{axis} {k}" for axis, k in zip(axes, at, strict=False)]
    there = [
        f"{name} is {value[at]:.6g}"
        for name, value in arguments.items()
        if isinstance(value, np.ndarray) and value.shape == right.shape
    ][:MAX_SHOWN_ARGUMENTS]
    if names or there:
        said += f" This is {', '.join(names)}" if names else " There"
        if there:
            said += f"{', where' if names else ''} {' and '.join(there)}"
        said += "."
    if right.size > 1:
        is_or_are = "is" if n_wrong == 1 else "are"
        said += f" {n_wrong} of {right.size} entries {is_or_are} wrong."
    return said


def _factors(arguments: dict[str, Any]) -> Iterator[tuple[float, str]]:
    """Yield the factors that are forgotten or doubled, with their names."""
    for name, value in arguments.items():
        if np.ndim(value) == 0 and isinstance(value, int | float):
            yield float(value), name
            if value:
                yield 1.0 / value, f"1 / {name}"
            if 0.0 < value < 1.0:
                yield 1.0 - value, f"(1 - {name})"
                yield 1.0 / (1.0 - value), f"1 / (1 - {name})"
    yield 2.0, "2"
    yield 0.5, "1 / 2"


def explain_pattern(
    found: Array,
    right: Array,
    arguments: dict[str, Any],
    *,
    is_entrywise: bool = False,
) -> str:
    """Return a sentence on how a wrong result comes from the right one, or "".

    One number is any other times something, so that only arrays show a factor or a
    shift that has no name. ``is_entrywise``: whether small entries beside large ones
    must follow it too.
    """
    if not (np.all(np.isfinite(found)) and np.all(np.isfinite(right))):
        return ""
    if not found.any():
        return "all entries are 0" if right.shape else "it is 0"
    scale = max(float(np.abs(right).max(initial=0.0)), 1e-12)

    def is_same(other: Any, tolerance: float = PATTERN_TOLERANCE) -> bool:
        is_near = np.abs(found - other) <= tolerance * scale
        if is_entrywise:
            is_near &= is_between(found, other, other, tolerance, is_entrywise=True)
        return bool(np.all(is_near))

    if is_same(np.trunc(right), ROUNDING):
        return (
            "the fractions are cut off: // gives none, and an array of whole numbers"
            " keeps none, as np.zeros_like of whole numbers makes"
        )
    for digits in range(MAX_DIGITS + 1):
        if is_same(np.round(right, digits), ROUNDING):
            return f"the result is rounded to {digits} digits; leave it as it is"
    if is_same(-right):
        return "the sign is wrong: this is the right result times -1"
    for factor, name in _factors(arguments):
        if factor != 1.0 and is_same(factor * right):
            return f"this is the right result times {name}"
    return _explain_entries(found, right, is_same) if right.size > 2 else ""


def _explain_entries(found: Array, right: Array, is_same: Callable[[Any], bool]) -> str:
    """Return a sentence on an order, a factor or a shift of three or more entries."""
    if right.ndim == 2 and right.shape[0] == right.shape[1] and is_same(right.T):
        return "the two axes are exchanged"
    for first, second in itertools.combinations(range(right.ndim), 2):
        other = right.swapaxes(first, second)
        if right.ndim > 2 and other.shape == right.shape and is_same(other):
            return f"the axes {first} and {second} of the result are exchanged"
    most = float(found.max())
    if 0.0 < most < (1.0 - SMALLEST_CHANGE) * right.max() and is_same(
        np.minimum(right, most)
    ):
        return f"what is above {most:.6g} is cut off"
    if right.ndim == 1 and is_same(right[::-1]):
        return "these are the right numbers in the reverse order"
    largest = np.unravel_index(int(np.abs(right).argmax()), right.shape)
    if np.count_nonzero(right) > 2:
        factor = float(found[largest] / right[largest])
        if abs(factor - 1.0) > SMALLEST_CHANGE and is_same(factor * right):
            return f"every entry is the right one times {factor:.6g}"
    shift = float((found - right).mean())
    if abs(shift) > SMALLEST_CHANGE * np.abs(right).max() and is_same(right + shift):
        return f"every entry is the right one plus {shift:.6g}"
    return ""
