"""The values of a log's columns: the SQL that makes them of what a file has, and the words for what is none."""

from __future__ import annotations

import re
from typing import Any

from oee_tabular import _checks

KINDS = {
    "state": "integer", "action": "integer", "next_state": "integer", "reward": "number", "terminated": "flag",
    "truncated": "flag", "episode": "integer", "timestep": "integer", "behavior_probability": "number",
}  # fmt: skip
FLAGS = (("true", "1"), ("false", "0"))
RULES = {"integer": "must be an integer", "number": "must be finite", "flag": "must be a boolean (or 0 or 1)"}
HELD = {"integer": "integers", "number": "numbers", "flag": "booleans"}
NAMES_HINT = " (names take a simulator that has them: simulator=, --simulator)"
INTEGER = r"\s*[+-]?[0-9]+(\.0*)?\s*"  # DuckDB alone would also take 0x1, 1_0 and 1.5
INTEGER_TYPES = "U?(TINYINT|SMALLINT|INTEGER|BIGINT)"


def is_number(text: str) -> bool:
    """Whether a text is a number for Python."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def show_value(raw: Any) -> str:
    """A file's value as errors print it: texts that are no numbers in quotes."""
    return raw.strip() if isinstance(raw, str) and is_number(raw) and len(raw) < 80 else _checks.show(raw)


def has_kind(raw: Any, kind: str) -> bool:
    """Whether a value is one of a column's kind, which then breaks another rule."""
    if kind == "integer":
        return isinstance(raw, int) or bool(re.fullmatch(INTEGER, str(raw)))
    return kind != "number" or not isinstance(raw, str) or (is_number(raw) and "_" not in raw)


def sql_value(held: str, raw: str, kind: str) -> str:
    """The SQL of a column's value of a kind; NULL for what is none (of a number: infinity; nan stays)."""
    is_text = held == "VARCHAR"
    if kind == "text":
        return raw
    if kind == "flag":
        if held == "BOOLEAN":
            return raw
        if not is_text:
            return f"CASE {raw} WHEN 1 THEN true WHEN 0 THEN false END"
        cases = [("true", raw, "'True', '1', '1.0'"), ("false", raw, "'False', '0', '0.0'")]
        cases += [(word, f"lower(trim({raw}))", f"'{word}', '{digit}', '{digit}.0'") for word, digit in FLAGS]
        return "CASE " + " ".join(f"WHEN {given} IN ({words}) THEN {word}" for word, given, words in cases) + " END"
    if kind == "integer":
        if is_text:
            number = f"TRY_CAST({raw} AS BIGINT)"  # numbers as Python writes them are not matched: half of the time
            plain = f"CAST({number} AS VARCHAR) = {raw}"
            return f"CASE WHEN {plain} THEN {number} WHEN regexp_full_match({raw}, '{INTEGER}') THEN {number} END"
        if re.fullmatch(INTEGER_TYPES, held):
            return raw if held == "BIGINT" else f"TRY_CAST({raw} AS BIGINT)"
        whole = f"{raw} = floor({raw}) AND abs({raw}) <= 9007199254740992"
        return f"CASE WHEN {whole} THEN TRY_CAST({raw} AS BIGINT) END"
    if is_text:
        is_none = f"{raw} IS NOT NULL AND (TRY_CAST({raw} AS DOUBLE) IS NULL OR contains({raw}, '_'))"
        return f"CASE WHEN {is_none} THEN 'inf'::DOUBLE ELSE TRY_CAST({raw} AS DOUBLE) END"
    return f"CAST({raw} AS DOUBLE)"
