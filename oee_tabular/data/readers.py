"""The columns of a batch as a log has them, and (mask, rule, what is found) of the values that are none."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from oee_tabular._checks import BoolArray, Column, IntArray
from oee_tabular.mdp.naming import Name, numbers_of, suggest_name

LARGEST = 2**53  # from which on a float does not tell n from n + 1
_TRUE, _FALSE = ("true", "1", "1.0"), ("false", "0", "0.0")
Fault = tuple[BoolArray, str, str | Callable[[int], str]]  # rows, the rule, what was found ("": the value), or of a row


class Limits(NamedTuple):
    """What rows must keep to: numbers below ``states`` and ``actions``, or names; ``drop``: others are left out."""

    states: int = LARGEST
    actions: int = LARGEST
    drop: bool = False
    kept: int = 200_000
    state_names: tuple[Name, ...] | None = None
    action_names: tuple[Name, ...] | None = None


def _numbers(column: Column) -> Column:
    """Text as numbers, nan where it is none."""
    if column.dtype.kind not in "OUT":
        return column
    import pandas as pd

    return np.asarray(pd.to_numeric(pd.Series(column).astype(object), errors="coerce"))


def _whole(column: Column, low: int | None, high: int, above: str) -> tuple[IntArray, list[Fault]]:
    values = _numbers(column)
    faults: list[Fault] = []
    if values.dtype.kind == "f":
        odd = ~((np.abs(values) <= 2.0**53) & (values == np.floor(values)))
        if odd.any():
            faults.append((odd, "must be an integer", ""))
            values = np.where(odd, 0.0, values)
    if values.dtype.kind == "u" and values.dtype.itemsize == 8 and len(values) and values.max() >= 2**63:
        beyond = values >= 2**63
        faults.append((beyond, above, ""))
        values = np.where(beyond, 0, values)
    whole: IntArray = values.astype(np.int64, copy=False)
    if len(whole) and low is not None and whole.min() < low:
        faults.append((whole < low, f"must be at least {low}", ""))
    if len(whole) and whole.max() >= high:
        faults.append((whole >= high, above, ""))
    return whole, faults


def _range(size: int) -> str:
    return "must be below 2**53" if size == LARGEST else f"must be in 0..{size - 1}"


def _states(column: Column, limits: Limits) -> tuple[Column, list[Fault]]:
    return _named(column, limits.state_names, limits.states)


def _actions(column: Column, limits: Limits) -> tuple[Column, list[Fault]]:
    return _named(column, limits.action_names, limits.actions)


def _named(column: Column, names: tuple[Name, ...] | None, size: int) -> tuple[Column, list[Fault]]:
    """Numbers below ``size``, or where there are names texts of them (no name reads as a number)."""
    if names is None or column.dtype.kind not in "OUT":
        return _whole(column, 0, size, _range(size))
    lookup = numbers_of(names)
    code = np.array([lookup.get(item, -1) for item in column.tolist()], dtype=np.int64)
    unknown = code < 0
    if unknown.all() and not all(np.isnan(_numbers(column))):
        return _whole(column, 0, size, _range(size))
    if not unknown.any():
        return code, []
    rule = "must be one of the simulator's names"

    def told(k: int) -> str:
        return f"it is {column[k]!r}{suggest_name(column[k], names)}"

    return np.where(unknown, 0, code), [(unknown, rule, told)]


def _steps(column: Column, limits: Limits) -> tuple[Column, list[Fault]]:
    return _whole(column, 0, LARGEST, _range(LARGEST))


def _names(column: Column, limits: Limits) -> tuple[Column, list[Fault]]:
    if column.dtype.kind in "OUT" and len(column) and np.isnan(_numbers(column)).all():
        known = {text: _digest(str(text)) for text in set(column.tolist())}
        return np.array([known[text] for text in column.tolist()], dtype=np.int64), []
    return _whole(column, None, 2**63, "must be below 2**63")


def _digest(text: str) -> int:
    """63 bits: of 10^6 texts two are one with a probability of 10^-7."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1


def _rewards(column: Column, limits: Limits) -> tuple[Column, list[Fault]]:
    values = _numbers(column).astype(np.float64, copy=False)
    fine = np.isfinite(values)
    return values, [] if fine.all() else [(~fine, "must be finite", "")]


def _probabilities(column: Column, limits: Limits) -> tuple[Column, list[Fault]]:
    values = _numbers(column).astype(np.float64, copy=False)
    fine = (values >= 0) & (values <= 1)
    return values, [] if fine.all() else [(~fine, "must be in [0, 1]", "")]


def _flags(column: Column, limits: Limits) -> tuple[Column, list[Fault]]:
    if column.dtype.kind == "b":
        return column, []
    if column.dtype.kind in "iuf":
        ones = column == 1
        fine = ones | (column == 0)
        return ones, [] if fine.all() else [(~fine, "must be a boolean (or 0 or 1)", "")]
    words = np.char.lower(column.astype(str))
    true = np.isin(words, _TRUE)
    fine = true | np.isin(words, _FALSE)
    return true, [] if fine.all() else [(~fine, "must be a boolean (or 0 or 1)", "")]


READERS = {
    "state": _states,
    "action": _actions,
    "next_state": _states,
    "reward": _rewards,
    "terminated": _flags,
    "truncated": _flags,
    "episode": _names,
    "timestep": _steps,
    "behavior_probability": _probabilities,
}
